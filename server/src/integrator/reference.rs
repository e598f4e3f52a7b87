//! Pictures of an independent renderer as the oracle (Mitsuba 3, see SOURCES.md of the test data): z-tests on
//! means of 8x8 blocks, and on the mean of the whole picture.
//!
//! The data is found by the environment variable WARPLIGHT_DATA; without it the tests say so and pass.

use super::PathTracer;
use crate::film::{PixelFilter, RenderSettings};
use crate::scene::{Environment, Light, Material, NamedCamera, Scene, Surface};
use crate::testing::{BLOCK_PX, SceneBuilder, block_means, critical_z, render, write_pictures};
use crate::volume::{Albedo, Matter, Medium, Phase};
use glam::{Affine3A, DVec3, Vec3};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use warplight_protocol::{Camera, ImageSize, Pose};

fn data_folder() -> Option<PathBuf> {
    let folder = std::env::var_os("WARPLIGHT_DATA").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("SKIPPED: WARPLIGHT_DATA does not name the folder of the test data");
    }
    folder
}

fn read_exr(path: &Path) -> (ImageSize, Vec<Vec3>) {
    let image = exr::prelude::read_first_rgba_layer_from_file(
        path,
        |size, _| (size.width(), vec![Vec3::ZERO; size.area()]),
        |(width, pixels): &mut (usize, Vec<Vec3>), at, (r, g, b, _): (f32, f32, f32, f32)| {
            pixels[at.1 * *width + at.0] = Vec3::new(r, g, b);
        },
    );
    let image = image.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let (width, pixels) = image.layer_data.channel_data.pixels;
    (ImageSize::new(width as u32, (pixels.len() / width) as u32), pixels)
}

/// A picture of somebody else's and how sure it is.
struct Reference {
    size: ImageSize,
    mean: Vec<Vec3>,
    /// Variance of the mean, per pixel and channel.
    variance: Vec<Vec3>,
}

impl Reference {
    /// `<path>_mean.exr` and `<path>_stderr.exr`.
    fn with_standard_error(path: &Path) -> Reference {
        let file = |part: &str| PathBuf::from(format!("{}_{part}.exr", path.display()));
        let (size, mean) = read_exr(&file("mean"));
        let (_, error) = read_exr(&file("stderr"));
        Reference { size, mean, variance: error.into_iter().map(|error| error * error).collect() }
    }

    /// `<path>.exr`, and `<path>_var.exr` with the variance of one of `spp` samples.
    fn with_variance(path: &Path, spp: f32) -> Reference {
        let file = |part: &str| PathBuf::from(format!("{}{part}.exr", path.display()));
        let (size, mean) = read_exr(&file(""));
        let (_, variance) = read_exr(&file("_var"));
        Reference { size, mean, variance: variance.into_iter().map(|variance| variance / spp).collect() }
    }
}

/// How far the two may differ beside chance, relative.
#[derive(Clone, Copy)]
struct Tolerance {
    /// In a block: no more than the reference renderer's own float arithmetic, what its longest path cuts off, and
    /// conventions that are documented to differ.
    block: f64,
    /// In the mean of the picture, per channel, beside three standard errors.
    image: f64,
}

/// Loads a scene and compares it with the reference. Depth is the scene's own unless given.
fn compare(name: &str, scene: &Path, reference: &Reference, spp: u32, max_depth: Option<u32>, tolerance: Tolerance) {
    let scene = Scene::load(&scene.to_string_lossy()).unwrap();
    compare_scene(name, scene, reference, spp, max_depth, tolerance);
}

/// Renders a scene from its first camera and compares it with the reference. Depth is the scene's own unless given.
fn compare_scene(
    name: &str,
    scene: Scene,
    reference: &Reference,
    spp: u32,
    max_depth: Option<u32>,
    tolerance: Tolerance,
) {
    eprintln!("{name}: {:?}", scene.warnings);
    let view = scene.cameras[0].clone();
    let max_depth = max_depth.or(scene.defaults.max_depth).unwrap();
    if let Some(size) = scene.defaults.size {
        assert_eq!(size, reference.size);
    }
    let tracer = PathTracer::new(Arc::new(scene));
    let camera = Camera::symmetric(view.vertical_fov_rad, reference.size);
    // Sixteen independent batches: their scatter is the true error of stratified samples.
    let batch_spp = Some((spp / 16).max(1));
    let settings = RenderSettings { spp, max_depth, seed: 7, filter: PixelFilter::Box, batch_spp };
    let image = render(&tracer, &camera, &view.pose, &settings);

    let width = reference.size.width as usize;
    let means = [&image.radiance, &reference.mean].map(|pixels| block_means(width, pixels, f64::from));
    // Variance of a block's mean: the mean variance of its pixels over their number.
    let pixels = (BLOCK_PX * BLOCK_PX) as f64;
    let ours = block_means(width, &image.standard_error, |error| f64::from(error).powi(2) / pixels);
    let theirs = block_means(width, &reference.variance, |variance| f64::from(variance) / pixels);
    let z = |block: usize| {
        let systematic = tolerance.block * means[1][block];
        (means[0][block] - means[1][block]) / (ours[block] + theirs[block] + systematic * systematic).sqrt()
    };
    let blocks = means[0].len();
    // Blocks that are black in both have no variance and no difference.
    let worst = (0..blocks).map(|block| z(block).abs()).filter(|z| !z.is_nan()).fold(0.0, f64::max);
    let mean_of = |means: &[f64], channel: usize| means.iter().skip(channel).step_by(3).sum::<f64>();
    let channels = (0..3).map(|channel| {
        let reference = mean_of(&means[1], channel);
        let variance = mean_of(&ours, channel) + mean_of(&theirs, channel);
        ((mean_of(&means[0], channel) / reference - 1.0).abs(), variance.sqrt() / reference)
    });
    // The channel that is furthest off, with the standard error of that.
    let (off, error_of_mean) = channels.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
    eprintln!(
        "{name}: worst block |z| {worst:.2} of {blocks}, image means agree to {:.3} % (standard error {:.3} %)",
        off * 100.0,
        error_of_mean * 100.0
    );
    // All of a block's error may come from one pixel, such as at the edge of a shadow: sixteen batches of it.
    let limit = critical_z(blocks, 15.0);
    // Where a caustic is found by chance, the mean itself is not known any better than this.
    if worst > limit || off > tolerance.image + 3.0 * error_of_mean {
        let error: Vec<Vec3> = image.radiance.iter().zip(&reference.mean).map(|(a, b)| (*a - *b).abs()).collect();
        let pictures: [(&str, &[Vec3]); 3] =
            [("image", &image.radiance), ("reference", &reference.mean), ("error", &error)];
        let at = write_pictures(name, width, &pictures);
        panic!("{name}: |z| {worst:.2} (limit {limit:.2}), means off by {off:.4}; pictures in {}", at.display());
    }
}

#[test]
fn the_cornell_box_is_that_of_an_independent_renderer() {
    let Some(data) = data_folder() else { return };
    let reference = Reference::with_standard_error(&data.join("reference/rendered/cornell_box_128"));
    let tolerance = Tolerance { block: 0.0, image: 0.005 };
    compare("cornell_box_128", &data.join("scenes/CornellBox.glb"), &reference, 192, Some(48), tolerance);
}

/// Samples per pixel of the references of Mitsuba's own tests.
const MITSUBA_TEST_SPP: f32 = 32_000.0;

/// One of Mitsuba's own test scenes, with the camera, the size and the depth of its file.
fn compare_with_mitsuba(scene: &str, reference: &str, spp: u32, block: f64) {
    let Some(data) = data_folder() else { return };
    let folder = data.join("reference/mitsuba_tests/tests/scenes");
    let reference = Reference::with_variance(&folder.join(reference), MITSUBA_TEST_SPP);
    let name = scene.replace('/', "_");
    compare(&name, &folder.join(format!("{scene}.xml")), &reference, spp, None, Tolerance { block, image: 0.005 });
}

#[test]
fn mirrors_in_mirrors_are_those_of_mitsuba() {
    compare_with_mitsuba("infinite_mirrors/scene_path", "infinite_mirrors/refs/scene_ref_rgb", 1024, 0.0);
}

#[test]
fn a_sphere_in_parallel_light_is_that_of_mitsuba() {
    compare_with_mitsuba(
        "floating_sphere/test_directional_direct",
        "floating_sphere/refs/test_directional_ref_rgb",
        1024,
        0.0,
    );
}

#[test]
fn rough_glass_is_that_of_mitsuba() {
    compare_with_mitsuba(
        "bsdf_spheres/test_roughdielectric_path",
        "bsdf_spheres/refs/test_roughdielectric_ref_rgb",
        4096,
        0.0,
    );
}

/// The scenes of Mitsuba's own tests with media.
fn compare_media_with_mitsuba(name: &str, integrator: &str, spp: u32, block: f64) {
    let scene = format!("participating_media/test_{name}_{integrator}");
    compare_with_mitsuba(&scene, &format!("participating_media/refs/test_{name}_ref_rgb"), spp, block);
}

#[test]
fn a_ball_of_fog_is_that_of_mitsuba() {
    compare_media_with_mitsuba("homo_null_envmap", "volpath", 256, 0.0);
}

#[test]
fn a_chromatic_ball_of_fog_is_that_of_mitsuba() {
    compare_media_with_mitsuba("homo_spectral_sigmat", "volpathmis", 256, 0.0);
}

#[test]
fn a_grid_of_smoke_is_that_of_mitsuba() {
    compare_media_with_mitsuba("hetero_sigmat", "volpath", 256, 0.0);
}

#[test]
fn a_chromatic_grid_of_smoke_is_that_of_mitsuba() {
    compare_media_with_mitsuba("hetero_spectral_sigmat", "volpathmis", 256, 0.0);
}

#[test]
fn surfaces_inside_a_medium_are_those_of_mitsuba() {
    compare_media_with_mitsuba("homo_obj_inside_medium", "volpath", 256, 0.0);
}

#[test]
fn an_area_light_on_fog_behind_a_pane_is_that_of_mitsuba() {
    compare_media_with_mitsuba("homo_area_light", "volpath", 256, 0.0);
}

#[test]
fn a_spot_on_rough_glass_with_an_absorbing_inside_is_that_of_mitsuba() {
    // Caustics are found by chance.
    compare_media_with_mitsuba("homo_roughdielectric_spot", "volpath", 1024, 0.0);
}

/// The cloud of the Walt Disney Animation Studios at a sixteenth, in a sky and a sun.
#[test]
fn a_cloud_is_that_of_an_independent_renderer() {
    let Some(data) = data_folder() else { return };
    let reference = Reference::with_standard_error(&data.join("reference/rendered/cloud_wdas16_96"));
    let loaded = crate::volume::load(&data.join("volumes/cloud_wdas16_u16.nrrd"), None).unwrap();
    let size = Vec3::new(1.26, 0.86, 1.54);
    let matter = Matter::Density {
        density: Arc::new(loaded.grid),
        unit_from_world: Affine3A::from_translation(Vec3::splat(0.5)) * Affine3A::from_scale(size.recip()),
        extinction_per_m: Vec3::splat(20.0 / 65535.0),
        albedo: Albedo::Constant(Vec3::splat(0.9)),
        emission: Vec3::ZERO,
    };
    let boundary = Material { interior: Some(0), ..Material::new("box", Surface::Null) };
    let mut scene = SceneBuilder::new()
        .environment(Environment::Constant(Vec3::new(0.5, 0.6, 0.8)))
        .cube(Vec3::ZERO, 1.0, boundary)
        .build();
    scene.mesh.positions.iter_mut().for_each(|position| *position *= size);
    scene.media = vec![Medium { matter, phase: Phase::ISOTROPIC }];
    let direction = Vec3::new(-1.0, -2.0, -1.0).normalize();
    scene.lights = vec![Light::Directional { direction, irradiance: Vec3::new(3.0, 2.8, 2.4) }];
    let pose = Pose::look_at(DVec3::new(0.0, 0.25, 2.6), DVec3::ZERO);
    scene.cameras = vec![NamedCamera { name: "a".to_owned(), pose, vertical_fov_rad: 30.0_f32.to_radians() }];
    // Where the sky is all that is seen nothing scatters, and what is left is the rounding of f32.
    compare_scene("cloud_wdas16_96", scene, &reference, 64, Some(64), Tolerance { block: 1e-6, image: 0.005 });
}
