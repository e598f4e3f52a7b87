use super::*;
use crate::scene::{Color, Environment, Finish, Light, Material, Surface};
use crate::testing::{SceneBuilder, diffuse, emitter};
use crate::volume::{Albedo, Grid, Matter};
use glam::{Affine3A, DVec3};
use std::sync::Arc;

/// A medium of these properties, the same everywhere.
pub(crate) fn homogeneous(extinction_per_m: Vec3, albedo: Vec3, g: f32) -> Medium {
    let matter = Matter::Homogeneous { extinction_per_m, albedo, emission: Vec3::ZERO };
    Medium { matter, phase: Phase { g } }
}

/// The same as a grid of three channels that fills a cube about the origin.
fn as_grid(extinction_per_m: Vec3, albedo: Vec3, g: f32, side: f32) -> Medium {
    let values: Vec<f32> = (0..20 * 20 * 20).flat_map(|_| extinction_per_m.to_array()).collect();
    let matter = Matter::Density {
        density: Arc::new(Grid::new([20; 3], 3, values).unwrap()),
        unit_from_world: Affine3A::from_scale_rotation_translation(
            Vec3::splat(1.0 / side),
            glam::Quat::IDENTITY,
            Vec3::splat(0.5),
        ),
        extinction_per_m: Vec3::ONE,
        albedo: Albedo::Constant(albedo),
        emission: Vec3::ZERO,
    };
    Medium { matter, phase: Phase { g } }
}

/// Blobs and holes within the same cube.
fn blobs(extinction_per_m: Vec3, albedo: Vec3, g: f32, side: f32) -> Medium {
    let value = |index: i32| {
        let [x, y, z] = [index % 20, index / 20 % 20, index / 400].map(|cell| cell as f32 * 0.6);
        (x.sin() + y.cos() + z.sin()).max(0.0)
    };
    let mut medium = as_grid(Vec3::ONE, albedo, g, side);
    if let Matter::Density { density, extinction_per_m: factor, .. } = &mut medium.matter {
        *density = Arc::new(Grid::new([20; 3], 1, (0..8000).map(value).collect()).unwrap());
        *factor = extinction_per_m;
    }
    medium
}

pub(crate) fn null(interior: u32) -> Material {
    Material { interior: Some(interior), ..Material::new("boundary", Surface::Null) }
}

pub(crate) fn tracer(builder: SceneBuilder, media: Vec<Medium>) -> PathTracer {
    let mut scene = builder.build();
    scene.media = media;
    PathTracer::new(Arc::new(scene))
}

const WHITE: Environment = Environment::Constant(Vec3::ONE);

/// Mean and its standard error of independent samples of the radiance along a ray.
fn radiance_of(tracer: &PathTracer, ray: &Ray, max_depth: u32, count: u32, seed: u64) -> (DVec3, DVec3) {
    let eye = tracer.enclosure_at(ray.origin);
    let mut counts = RayCounts::default();
    let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
    for index in 0..count {
        let mut sampler = Sampler::new(seed, u64::from(index), 0);
        let radiance = tracer.radiance(ray, eye, max_depth, &mut sampler, &mut counts).as_dvec3();
        assert!(radiance.is_finite() && radiance.min_element() >= 0.0, "{radiance}");
        sum += radiance;
        squares += radiance * radiance;
    }
    let mean = sum / f64::from(count);
    let variance = (squares / f64::from(count) - mean * mean).max(DVec3::ZERO) / f64::from(count);
    (mean, DVec3::new(variance.x.sqrt(), variance.y.sqrt(), variance.z.sqrt()))
}

/// 4.5 standard errors, and the roundings of f32.
#[track_caller]
fn agree(what: &str, (mean, error): (DVec3, DVec3), expected: DVec3) {
    let limit = 4.5 * error + 2e-5 * expected.abs();
    assert!((mean - expected).abs().cmple(limit).all(), "{what}: {mean} +- {error}, expected {expected}");
}

fn towards(from: Vec3, to: Vec3) -> Ray {
    Ray { origin: from, direction: (to - from).normalize() }
}

const UNBOUNDED: u32 = 1 << 20;

/// A medium that absorbs nothing, in light that is the same from everywhere, is not there. Every path ends in the
/// light with its full weight: not the mean alone, each sample is 1.
#[test]
fn a_white_medium_in_white_light_is_not_there() {
    let ray = towards(Vec3::new(0.1, 0.2, 3.0), Vec3::new(0.05, -0.1, 0.0));
    for g in [0.0, 0.8] {
        for (density, count) in [(0.01, 2000), (1.0, 2000), (100.0, 300), (1000.0, 20)] {
            let extinction = Vec3::splat(density);
            for medium in [
                homogeneous(extinction, Vec3::ONE, g),
                as_grid(extinction, Vec3::ONE, g, 1.0),
                blobs(extinction, Vec3::ONE, g, 1.0),
            ] {
                let scene = SceneBuilder::new().environment(WHITE).cube(Vec3::ZERO, 1.0, null(0));
                let (mean, error) = radiance_of(&tracer(scene, vec![medium]), &ray, UNBOUNDED, count, 1);
                let off = (mean - 1.0).abs().max_element();
                assert!(off < 2e-4 && error.max_element() < 1e-4, "{density} {g}: {mean} +- {error}");
            }
        }
    }
}

/// What is cut off by a limit of depth is missing, and nothing else.
#[test]
fn a_limit_of_depth_darkens_a_white_medium() {
    let scene = || SceneBuilder::new().environment(WHITE).cube(Vec3::ZERO, 1.0, null(0));
    let medium = || vec![homogeneous(Vec3::splat(4.0), Vec3::ONE, 0.0)];
    let ray = towards(Vec3::Z * 3.0, Vec3::ZERO);
    let at_depth = |depth| radiance_of(&tracer(scene(), medium()), &ray, depth, 20_000, 2);
    // One segment: light that comes straight through.
    agree("unscattered", at_depth(1), DVec3::splat((-4.0_f64).exp()));
    let means = [1, 2, 4, 8, 16, 64].map(|depth| at_depth(depth).0.x);
    assert!(means.windows(2).all(|pair| pair[0] < pair[1] + 0.01), "{means:?}");
    assert!(means[5] > 0.999, "{means:?}");
}

/// The same where colours are extinguished differently: no colour is lost to another.
#[test]
fn a_white_chromatic_medium_in_white_light_is_not_there() {
    let extinction = Vec3::new(0.5, 4.0, 20.0);
    let ray = towards(Vec3::Z * 3.0, Vec3::ZERO);
    for medium in [homogeneous(extinction, Vec3::ONE, 0.3), as_grid(extinction, Vec3::ONE, 0.3, 1.0)] {
        let scene = SceneBuilder::new().environment(WHITE).cube(Vec3::ZERO, 1.0, null(0));
        let found = radiance_of(&tracer(scene, vec![medium]), &ray, UNBOUNDED, 20_000, 3);
        agree("chromatic furnace", found, DVec3::ONE);
        assert!(found.1.max_element() < 0.02, "{found:?}");
    }
}

#[test]
fn an_absorbing_medium_attenuates_what_is_behind_it_by_beer_and_lambert() {
    let sigma = Vec3::new(0.0, 0.7, 3.0);
    let expected = (-1.5 * sigma.as_dvec3()).exp();
    for medium in [homogeneous(sigma, Vec3::ZERO, 0.0), as_grid(sigma, Vec3::ZERO, 0.0, 1.5)] {
        let scene = SceneBuilder::new().environment(WHITE).cube(Vec3::ZERO, 1.5, null(0));
        let through = tracer(scene, vec![medium.clone()]);
        agree("sky", radiance_of(&through, &towards(Vec3::Z * 4.0, Vec3::ZERO), 8, 20_000, 4), expected);
        // From inside: half of the way. And with a lamp behind the boundary.
        let from_inside = radiance_of(&through, &towards(Vec3::ZERO, Vec3::X), 8, 20_000, 5);
        agree("eye inside", from_inside, (-0.75 * sigma.as_dvec3()).exp());
        let lamp =
            SceneBuilder::new().cube(Vec3::ZERO, 1.5, null(0)).sphere(Vec3::ZERO, 0.25, emitter(Vec3::splat(2.0)));
        let found = radiance_of(&tracer(lamp, vec![medium]), &towards(Vec3::Z * 4.0, Vec3::ZERO), 8, 20_000, 6);
        agree("lamp inside", found, 2.0 * (-0.5 * sigma.as_dvec3()).exp());
    }
}

/// Light scattered once in a ball, from a point light and from parallel light: the integral along the eye's ray
/// in closed form but for one quadrature.
#[test]
fn light_scattered_once_is_the_integral_along_the_ray() {
    let (sigma, albedo, g) = (Vec3::new(1.2, 0.4, 2.5), Vec3::new(0.8, 0.5, 0.9), 0.4);
    let ray = towards(Vec3::new(0.3, 0.1, 4.0), Vec3::new(0.1, 0.05, 0.0));
    let radius = 1.0;
    let chord = |origin: DVec3, direction: DVec3| {
        let (b, c) = (origin.dot(direction), origin.length_squared() - radius * radius);
        let root = (b * b - c).max(0.0).sqrt();
        (-b - root, -b + root)
    };
    let lights = [
        Light::Point { position: Vec3::new(-0.5, 2.0, 1.0), intensity: Vec3::new(3.0, 2.0, 5.0) },
        Light::Directional { direction: Vec3::new(0.6, -0.8, 0.0), irradiance: Vec3::new(1.0, 2.0, 0.5) },
        Light::Point { position: Vec3::new(0.2, -0.3, 0.1), intensity: Vec3::ONE },
    ];
    for light in lights {
        let (enter, leave) = chord(ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let steps = 20_000;
        let step = (leave - enter) / f64::from(steps);
        let sigma64 = sigma.as_dvec3();
        let expected: DVec3 = (0..steps)
            .map(|index| {
                let t = enter + (f64::from(index) + 0.5) * step;
                let point = ray.origin.as_dvec3() + t * ray.direction.as_dvec3();
                let (to_light, irradiance, within) = match light {
                    Light::Directional { direction, irradiance } => {
                        let to_light = -direction.as_dvec3();
                        (to_light, irradiance.as_dvec3(), chord(point, to_light).1)
                    }
                    Light::Point { position, intensity } => {
                        let way = position.as_dvec3() - point;
                        let to_light = way.normalize();
                        let within = chord(point, to_light).1.min(way.length());
                        (to_light, intensity.as_dvec3() / way.length_squared(), within)
                    }
                    Light::Spot { .. } => unreachable!(),
                };
                let phase = f64::from(Phase { g }.density(ray.direction.dot(to_light.as_vec3())));
                let left = (-sigma64 * (t - enter + within)).exp();
                sigma64 * albedo.as_dvec3() * phase * left * irradiance * step
            })
            .sum();
        for medium in [homogeneous(sigma, albedo, g), as_grid(sigma, albedo, g, 2.0)] {
            // A sphere is met exactly; triangles would be off by more than the noise.
            let mut scene = SceneBuilder::new().sphere(Vec3::ZERO, radius as f32, null(0)).build();
            (scene.lights, scene.media) = (vec![light], vec![medium]);
            let found = radiance_of(&PathTracer::new(Arc::new(scene)), &ray, 2, 60_000, 7);
            agree(&format!("{light:?}"), found, expected);
        }
    }
}

/// All orders, a lamp and a sky, surfaces inside: a homogeneous medium and a grid of the same values agree.
#[test]
fn a_constant_grid_is_a_homogeneous_medium() {
    let (sigma, albedo) = (Vec3::new(2.0, 0.5, 6.0), Vec3::new(0.9, 0.7, 0.95));
    let found = [homogeneous(sigma, albedo, 0.5), as_grid(sigma, albedo, 0.5, 2.0)].map(|medium| {
        let scene = SceneBuilder::new()
            .environment(Environment::Constant(Vec3::new(0.2, 0.4, 0.8)))
            .cube(Vec3::ZERO, 2.0, null(0))
            .sphere(Vec3::new(0.3, 0.0, 0.2), 0.3, diffuse(0.8))
            .sphere(Vec3::new(-0.4, 0.5, 0.0), 0.2, emitter(Vec3::splat(4.0)));
        radiance_of(&tracer(scene, vec![medium]), &towards(Vec3::new(0.0, 0.5, 3.0), Vec3::ZERO), 32, 60_000, 8)
    });
    let error = (found[0].1 * found[0].1 + found[1].1 * found[1].1).map(f64::sqrt);
    let z = (found[0].0 - found[1].0) / error;
    assert!(z.abs().max_element() < 4.5, "{z}: {found:?}");
}

/// The two ways to a light agree: drawn and met, weighted against each other, or met by chance alone. A lamp in fog,
/// seen by scattered light.
#[test]
fn lamps_are_weighed_right_against_the_phase_function() {
    let scene = |g: f32, lamp: Material| {
        let builder = SceneBuilder::new().sphere(Vec3::ZERO, 3.0, null(0)).sphere(Vec3::X, 0.6, lamp);
        tracer(builder, vec![homogeneous(Vec3::splat(0.4), Vec3::splat(0.9), g)])
    };
    let ray = towards(Vec3::new(-0.5, 0.0, 2.0), Vec3::new(-0.5, 0.3, 0.0));
    for g in [0.0, 0.9, -0.6] {
        let weighed = radiance_of(&scene(g, emitter(Vec3::ONE)), &ray, 6, 100_000, 9);
        // Without lights to draw from, and so without a weight against them.
        let mut chance = scene(g, emitter(Vec3::ONE));
        chance.lights = super::super::lights::Lights::new(&SceneBuilder::new().build());
        let by_chance = radiance_of(&chance, &ray, 6, 100_000, 10);
        let error = (weighed.1 * weighed.1 + by_chance.1 * by_chance.1).map(f64::sqrt);
        let z = ((weighed.0 - by_chance.0) / error).abs().max_element();
        assert!(z < 4.5 && weighed.1.x < by_chance.1.x, "{g}: {z}, {weighed:?} {by_chance:?}");
    }
}

/// In a white medium in white light radiance is 1 everywhere; in a clear one it is the mean of what surrounds a point.
#[test]
fn what_arrives_at_a_point_is_the_mean_radiance_around_it() {
    let albedo = Vec3::new(1.0, 0.5, 0.25);
    let mean = |tracer: &PathTracer, point: Vec3, count: u32| {
        let mut counts = RayCounts::default();
        let mut sum = DVec3::ZERO;
        for index in 0..count {
            let mut sampler = Sampler::new(11, u64::from(index), 0);
            sum += tracer.incident_mean(point, 0, UNBOUNDED, &mut sampler, &mut counts).as_dvec3() / f64::from(count);
        }
        sum
    };
    let scene = || SceneBuilder::new().environment(WHITE).cube(Vec3::ZERO, 1.0, null(0));
    let clear = tracer(scene(), vec![homogeneous(Vec3::splat(1e-6), albedo, 0.0)]);
    assert!((mean(&clear, Vec3::splat(0.1), 100) - 1.0).abs().max_element() < 1e-4);
    let white = tracer(scene(), vec![homogeneous(Vec3::splat(20.0), Vec3::ONE, 0.0)]);
    assert!((mean(&white, Vec3::splat(0.2), 100) - 1.0).abs().max_element() < 1e-4);
    // A lamp that fills (1 - cos) / 2 of the sphere of directions.
    let lamp = SceneBuilder::new().sphere(Vec3::ZERO, 1.0, null(0)).sphere(Vec3::X * 5.0, 2.0, emitter(Vec3::ONE));
    let lit = tracer(lamp, vec![homogeneous(Vec3::splat(1e-6), albedo, 0.0)]);
    let part = 0.5 * (1.0 - (1.0_f64 - 0.16).sqrt());
    // Of drawn and met lights, weighted: half a percent of scatter at 20,000 samples.
    let found = mean(&lit, Vec3::ZERO, 20_000);
    assert!((found / part - 1.0).abs().max_element() < 0.02, "{found}");
}

/// A pane around a medium lets light straight through in both directions: shadow rays find what chance finds, and a white
/// inside of smooth or rough glass is not there either.
#[test]
fn white_media_inside_of_glass_and_panes_are_not_there() {
    let ray = towards(Vec3::new(0.1, 0.2, 3.0), Vec3::new(0.05, -0.1, 0.0));
    let filter = Color::Constant(Vec3::ONE);
    let rough = Finish::isotropic(crate::scene::Distribution::Ggx, crate::scene::Scalar::Constant(0.3));
    for surface in [
        Surface::ThinDielectric { ior: 1.33, filter, finish: Finish::SMOOTH },
        crate::testing::solid(1.5, Vec3::ONE, Vec3::ZERO),
        Surface::ThinDielectric { ior: 1.5, filter, finish: rough },
    ] {
        let boundary = Material { interior: Some(0), ..Material::new("boundary", surface) };
        let scene = SceneBuilder::new().environment(WHITE).sphere(Vec3::ZERO, 1.0, boundary);
        let media = vec![homogeneous(Vec3::splat(2.0), Vec3::ONE, 0.3)];
        let found = radiance_of(&tracer(scene, media), &ray, UNBOUNDED, 20_000, 12);
        // Rough panes lose half a percent of energy between facets.
        let off = (found.0 - 1.0).abs().max_element();
        assert!(off < 4.5 * found.1.max_element() + 6e-3, "{surface:?}: {found:?}");
    }
}

/// A lamp beyond a pane that bounds the fog: drawn through the pane or met by chance, on average the same.
#[test]
fn lamps_are_found_through_panes_that_bound_a_medium() {
    let pane = Surface::ThinDielectric {
        ior: 1.33,
        filter: Color::Constant(Vec3::new(1.0, 0.8, 0.5)),
        finish: Finish::SMOOTH,
    };
    let scene = || {
        let boundary = Material { interior: Some(0), ..Material::new("pane", pane) };
        let builder = SceneBuilder::new()
            .sphere(Vec3::ZERO, 1.0, boundary)
            .sphere(Vec3::Y * 3.0, 1.0, emitter(Vec3::ONE))
            .sphere(Vec3::NEG_Y * 0.6, 0.2, diffuse(0.8));
        tracer(builder, vec![homogeneous(Vec3::splat(1.0), Vec3::splat(0.9), 0.2)])
    };
    let ray = towards(Vec3::new(0.0, 0.2, 3.0), Vec3::new(0.0, -0.3, 0.0));
    let weighed = radiance_of(&scene(), &ray, 8, 100_000, 13);
    let mut chance = scene();
    chance.lights = super::super::lights::Lights::new(&SceneBuilder::new().build());
    let by_chance = radiance_of(&chance, &ray, 8, 100_000, 14);
    let error = (weighed.1 * weighed.1 + by_chance.1 * by_chance.1).map(f64::sqrt);
    let z = ((weighed.0 - by_chance.0) / error).abs().max_element();
    assert!(z < 4.5 && weighed.1.x < by_chance.1.x, "{z}, {weighed:?} {by_chance:?}");
}
