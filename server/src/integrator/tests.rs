//! Physics as the oracle: furnaces and closed forms.

use super::PathTracer;
use crate::film::Image;
use crate::scene::{Cutout, Environment, Falloff, Light, Scalar, Scene, Surface};
use crate::stability::bound;
use crate::testing::{SceneBuilder, colored, diffuse, emitter, glass, material, mirror, render, settings, solid};
use glam::{DVec3, Vec3};
use std::sync::Arc;
use warplight_protocol::{Camera, ImageSize, Pose};

const WHITE: Environment = Environment::Constant(Vec3::ONE);
/// Long enough that what is cut off is below every bound here.
const ENDLESS: u32 = 2000;

fn look(scene: Scene, eye: Vec3, target: Vec3, side_px: u32, spp: u32) -> Image {
    let camera = Camera::symmetric(0.8, ImageSize::new(side_px, side_px));
    let pose = Pose::look_at(eye.as_dvec3(), target.as_dvec3());
    render(&PathTracer::new(Arc::new(scene)), &camera, &pose, &settings(spp, ENDLESS, 1))
}

fn mean(image: &Image) -> DVec3 {
    image.radiance.iter().map(|radiance| radiance.as_dvec3()).sum::<DVec3>() / image.radiance.len() as f64
}

fn assert_mean(image: &Image, expected: DVec3, relative: f64) {
    let error = ((mean(image) - expected) / expected).abs().max_element();
    assert!(error < relative, "{} instead of {expected}: {error:.2e}", mean(image));
}

/// White furnaces from a millimetre to ten kilometres.
#[test]
fn stability_leaving_a_surface_in_a_furnace() {
    let mut lost =
        bound!("leaving", "light lost or made in white furnaces, of what noise and the longest path allow", 1.0);
    type Thing = (&'static str, fn(Vec3, f32) -> SceneBuilder, f64);
    let things: [Thing; 6] = [
        ("diffuse sphere", |at, r| SceneBuilder::new().sphere(at, r, diffuse(1.0)), 1e-3),
        ("diffuse mesh", |at, r| SceneBuilder::new().ball(at, r, 3, false, diffuse(1.0)), 1e-3),
        ("mirror ball", |at, r| SceneBuilder::new().sphere(at, r, mirror()), 1e-5),
        ("glass ball", |at, r| SceneBuilder::new().sphere(at, r, glass(1.5)), 5e-3),
        ("glass mesh", |at, r| SceneBuilder::new().ball(at, r, 4, true, glass(1.5)), 5e-3),
        (
            "mirror in a corner",
            |at, r| {
                SceneBuilder::new().cube(at, r, diffuse(1.0)).sphere(at + Vec3::Z * r, r * 0.5, mirror()).floor(
                    at.y - 0.6 * r,
                    2.0 * r,
                    diffuse(1.0),
                )
            },
            3e-3,
        ),
    ];
    for scale in [1e-3, 1.0, 1e4] {
        for (name, thing, bound) in &things {
            let at = Vec3::new(0.4, 0.2, -0.3) * scale;
            let scene = thing(at, scale).environment(WHITE).build();
            let image = look(scene, at + Vec3::new(0.5, 1.0, 3.0) * scale, at, 24, 64);
            let error = (mean(&image) - DVec3::ONE).abs().max_element();
            lost.see(error / bound, format!("{name} at scale {scale}: off by {error:.2e}"));
        }
    }
}

#[test]
fn the_scaling_of_radiance_cancels_over_an_open_water_surface() {
    let scene =
        SceneBuilder::new().floor(0.0, 1.0, glass(1.33)).floor(-0.2, 50.0, diffuse(1.0)).environment(WHITE).build();
    // Light also comes in beside the surface, where it was never scaled: only a wide pool is a furnace.
    let wide =
        SceneBuilder::new().floor(0.0, 5000.0, glass(1.33)).floor(-0.2, 50.0, diffuse(1.0)).environment(WHITE).build();
    assert_mean(&look(wide, Vec3::new(0.0, 2.0, 0.1), Vec3::ZERO, 16, 1024), DVec3::ONE, 0.01);
    assert!(mean(&look(scene, Vec3::new(0.0, 2.0, 0.1), Vec3::ZERO, 8, 64)).is_finite());
}

#[test]
fn absorption_follows_beer_and_lambert() {
    let absorption = Vec3::new(0.5, 1.0, 0.0);
    // Index 1: nothing is reflected or bent, so only the way through the middle counts.
    let inside = material("tinted", solid(1.0, Vec3::ONE, absorption), Vec3::ZERO);
    let scene = SceneBuilder::new().cube(Vec3::ZERO, 2.0, inside).environment(WHITE).build();
    let camera = Camera::symmetric(1e-3, ImageSize::new(1, 1));
    let pose = Pose::look_at(DVec3::new(0.1, 0.2, 5.0), DVec3::new(0.1, 0.2, 0.0));
    let image = render(&PathTracer::new(Arc::new(scene)), &camera, &pose, &settings(4, 64, 1));
    assert!((image.radiance[0] - (-2.0 * absorption).exp()).length() < 1e-4, "{}", image.radiance[0]);
}

#[test]
fn a_filter_colours_each_crossing() {
    let filter = Vec3::new(0.5, 0.8, 1.0);
    let scene = |surface| {
        SceneBuilder::new().sphere(Vec3::ZERO, 1.0, material("filter", surface, Vec3::ZERO)).environment(WHITE).build()
    };
    let camera = Camera::symmetric(1e-3, ImageSize::new(1, 1));
    let pose = Pose::look_at(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO);
    let through = solid(1.0, filter, Vec3::ZERO);
    for (surface, expected) in [(through, filter * filter), (Surface::Mirror { filter }, filter)] {
        let image = render(&PathTracer::new(Arc::new(scene(surface))), &camera, &pose, &settings(4, 64, 1));
        assert!((image.radiance[0] - expected).length() < 1e-5, "{}", image.radiance[0]);
    }
}

/// In a closed body of albedo a that emits L everywhere, radiance is L / (1 - a).
#[test]
fn a_closed_emitter_sums_the_geometric_series() {
    let albedo = Vec3::new(0.5, 0.8, 0.0);
    let expected = DVec3::new(1.0 / 0.5, 1.0 / 0.2, 1.0);
    let glowing = || {
        let mut material = colored(albedo);
        material.emission = crate::scene::Color::Constant(Vec3::ONE);
        material.emission_two_sided = true;
        material
    };
    let bodies = [
        SceneBuilder::new().sphere(Vec3::ZERO, 1.0, glowing()).build(),
        SceneBuilder::new().cube(Vec3::ZERO, 2.0, glowing()).build(),
        // Scaled into the millimetres and kilometres.
        SceneBuilder::new().sphere(Vec3::ZERO, 1e-3, glowing()).build(),
        SceneBuilder::new().cube(Vec3::ZERO, 1e4, glowing()).build(),
    ];
    for (scene, scale) in bodies.into_iter().zip([1.0, 1.0, 1e-3, 5e3]) {
        let image = look(scene, Vec3::new(0.1, 0.2, 0.3) * scale, -Vec3::Z * scale, 16, 256);
        assert_mean(&image, expected, 0.01);
    }
}

/// A uniform sphere light over a plane: E = pi L (r/d)^2 cos, exactly, wherever all of it is above the
/// horizon (the configuration factor of a sphere).
#[test]
fn a_sphere_light_over_a_plane_matches_its_closed_form() {
    let (height, radius, albedo, radiance) = (2.0_f64, 0.5_f64, 0.6_f32, 3.0_f32);
    let light = Vec3::new(0.0, height as f32, 0.0);
    for (name, lamp) in [
        ("sphere", SceneBuilder::new().sphere(light, radius as f32, emitter(Vec3::splat(radiance)))),
        ("triangles", SceneBuilder::new().ball(light, radius as f32, 5, false, emitter(Vec3::splat(radiance)))),
    ] {
        let tracer = PathTracer::new(Arc::new(lamp.floor(0.0, 100.0, diffuse(albedo)).build()));
        for aside in [0.0_f64, 1.0, 3.0] {
            let camera = Camera::symmetric(1e-4, ImageSize::new(2, 2));
            let pose = Pose::look_at(DVec3::new(aside + 0.9, 0.9, 0.2), DVec3::new(aside, 0.0, 0.0));
            let image = render(&tracer, &camera, &pose, &settings(1 << 15, 2, 3));
            let distance2 = aside * aside + height * height;
            let irradiance =
                std::f64::consts::PI * f64::from(radiance) * radius * radius / distance2 * height / distance2.sqrt();
            let expected = f64::from(albedo) * irradiance / std::f64::consts::PI;
            // The mesh of 8192 triangles is 0.2 % smaller than its sphere.
            assert_mean(&image, DVec3::splat(expected), if name == "sphere" { 2e-3 } else { 1e-2 });
        }
    }
}

/// The radiance of a white floor's point lit by one light, seen from above.
fn floor_lit_by(light: Light, aside: f64) -> Vec3 {
    let mut scene = SceneBuilder::new().floor(0.0, 100.0, diffuse(1.0)).build();
    scene.lights = vec![light];
    let camera = Camera::symmetric(1e-4, ImageSize::new(1, 1));
    let pose = Pose::look_at(DVec3::new(aside + 0.3, 3.0, 0.2), DVec3::new(aside, 0.0, 0.0));
    render(&PathTracer::new(Arc::new(scene)), &camera, &pose, &settings(2, 2, 1)).radiance[0]
}

/// One light without extent is certain: two samples are exact.
#[test]
fn lights_without_extent_light_as_the_inverse_square_says() {
    let close = |found: Vec3, expected: Vec3| {
        assert!((found - expected).abs().max_element() <= 2e-4 * expected.max_element(), "{found} {expected}");
    };
    let intensity = Vec3::new(3.0, 2.0, 1.0);
    let position = Vec3::new(0.0, 2.0, 0.0);
    for aside in [0.0_f32, 1.0, 4.0] {
        let distance2 = aside * aside + 4.0;
        let cosine = 2.0 / distance2.sqrt();
        let expected = intensity * cosine / distance2 / std::f32::consts::PI;
        close(floor_lit_by(Light::Point { position, intensity }, aside.into()), expected);
        let (inner_rad, outer_rad, falloff) = (0.3, 0.9, Falloff::LinearInAngle);
        let spot = Light::Spot { position, axis: Vec3::NEG_Y, intensity, inner_rad, outer_rad, falloff };
        let within = ((outer_rad - cosine.acos()) / (outer_rad - inner_rad)).clamp(0.0, 1.0);
        close(floor_lit_by(spot, aside.into()), expected * within);
    }
    let sun = Light::Directional { direction: Vec3::new(0.6, -0.8, 0.0), irradiance: intensity };
    close(floor_lit_by(sun, 7.0), intensity * 0.8 / std::f32::consts::PI);
}

#[test]
fn what_stands_before_a_light_without_extent_shadows_it() {
    let lights = [
        Light::Point { position: Vec3::Y * 4.0, intensity: Vec3::ONE },
        Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::ONE },
    ];
    for light in lights {
        let mut scene =
            SceneBuilder::new().floor(0.0, 9.0, diffuse(1.0)).sphere(Vec3::Y * 2.0, 0.5, diffuse(0.0)).build();
        scene.lights = vec![light];
        let image = look(scene, Vec3::new(1.5, 0.8, 0.0), Vec3::new(0.0, 0.0, 0.0), 1, 4);
        assert_eq!(image.radiance[0], Vec3::ZERO);
    }
}

/// A black sheet that covers a part of every point darkens the sky behind it by that part; one with a threshold
/// is there or not.
#[test]
fn a_cutout_lets_through_what_it_does_not_cover() {
    let sheet = |opacity: f32, threshold: Option<f32>| {
        let mut material = diffuse(0.0);
        material.cutout = Some(Cutout { opacity: Scalar::Constant(opacity), threshold });
        let mut scene = SceneBuilder::new()
            .floor(0.0, 50.0, diffuse(1.0))
            .floor(1.0, 50.0, material)
            .environment(Environment::Constant(Vec3::ZERO))
            .build();
        scene.lights = vec![Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::ONE }];
        // Through the sheet, twice: to the floor, and from it to the light.
        mean(&look(scene, Vec3::new(0.0, 2.0, 0.1), Vec3::ZERO, 48, 64)).x * std::f64::consts::PI
    };
    for opacity in [0.25, 0.7] {
        let through = 1.0 - f64::from(opacity);
        // 147,456 samples of a yes or no with the probability through^2.
        let standard_error = (through.powi(2) * (1.0 - through.powi(2)) / 147_456.0).sqrt();
        let found = sheet(opacity, None);
        assert!((found - through * through).abs() < 4.0 * standard_error, "{found} for {opacity}");
    }
    assert!((sheet(0.25, Some(0.5)) - 1.0).abs() < 1e-3);
    assert_eq!(sheet(0.75, Some(0.5)), 0.0);
}

#[test]
fn depth_counts_segments() {
    let scene = || {
        let lamp = emitter(Vec3::ONE);
        SceneBuilder::new().sphere(Vec3::Y * 3.0, 0.5, lamp).cube(Vec3::ZERO, 8.0, diffuse(0.5)).build()
    };
    let tracer = PathTracer::new(Arc::new(scene()));
    let camera = Camera::symmetric(1.2, ImageSize::new(16, 16));
    let pose = Pose::look_at(DVec3::new(0.0, 0.0, 3.0), DVec3::new(0.0, 2.0, 0.0));
    let brightness = |max_depth| mean(&render(&tracer, &camera, &pose, &settings(64, max_depth, 1))).x;
    let [nothing, lamp, direct, indirect] = [0, 1, 2, 3].map(brightness);
    assert_eq!(nothing, 0.0);
    assert!(lamp > 0.0 && direct > 1.1 * lamp && indirect > 1.02 * direct, "{lamp} {direct} {indirect}");
}

/// The environment drawn by its brightness, by the surface alone, and as the sum of both.
#[test]
fn a_small_bright_spot_in_the_sky_lights_a_plane_as_its_solid_angle_says() {
    let (width, height) = (64, 32);
    let mut texels = vec![[0.0; 3]; 64 * 32];
    for row in 4..6 {
        for column in 30..34 {
            texels[row * 64 + column] = [50.0, 20.0, 5.0];
        }
    }
    let sky = Environment::Image { width, height, texels, image_from_world: Environment::turned_about_y(0.3) };
    // Irradiance by summing over a fine grid of directions.
    let (mut irradiance, steps) = (DVec3::ZERO, 1000);
    for row in 0..steps {
        let polar = std::f64::consts::FRAC_PI_2 * (f64::from(row) + 0.5) / f64::from(steps);
        for column in 0..2 * steps {
            let azimuth = std::f64::consts::TAU * (f64::from(column) + 0.5) / f64::from(2 * steps);
            let direction = DVec3::new(polar.sin() * azimuth.cos(), polar.cos(), polar.sin() * azimuth.sin());
            let solid_angle =
                polar.sin() * std::f64::consts::FRAC_PI_2 * std::f64::consts::TAU / f64::from(2 * steps * steps);
            irradiance += sky.radiance(direction.as_vec3()).as_dvec3() * direction.y * solid_angle;
        }
    }
    let scene = SceneBuilder::new().floor(0.0, 10.0, diffuse(0.5)).environment(sky).build();
    let image = look(scene, Vec3::new(0.0, 3.0, 0.1), Vec3::ZERO, 16, 256);
    assert_mean(&image, irradiance * 0.5 / std::f64::consts::PI, 5e-3);
}

#[test]
fn a_picture_does_not_depend_on_the_number_of_threads() {
    let scene = SceneBuilder::new()
        .sphere(Vec3::ZERO, 1.0, glass(1.5))
        .floor(-1.0, 9.0, diffuse(0.7))
        .environment(WHITE)
        .build();
    let tracer = PathTracer::new(Arc::new(scene));
    let camera = Camera::symmetric(1.0, ImageSize::new(32, 32));
    let pose = Pose::look_at(DVec3::new(0.0, 1.0, 4.0), DVec3::ZERO);
    let with_threads = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render(&tracer, &camera, &pose, &settings(8, 8, 5)))
    };
    assert_eq!(with_threads(1), with_threads(3));
}
