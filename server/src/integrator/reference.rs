//! Pictures of an independent renderer as the oracle (Mitsuba 3, see SOURCES.md of the test data): z-tests on
//! means of 8x8 blocks.
//!
//! The data is found by the environment variable WARPLIGHT_DATA; without it the tests say so and pass.

use super::PathTracer;
use crate::film::{PixelFilter, RenderSettings};
use crate::scene::Scene;
use crate::testing::{block_means, critical_z, render, write_pictures};
use glam::Vec3;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use warplight_protocol::{Camera, ImageSize};

const SIZE: ImageSize = ImageSize::new(128, 128);

fn data_folder() -> Option<PathBuf> {
    let folder = std::env::var_os("WARPLIGHT_DATA").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("SKIPPED: WARPLIGHT_DATA does not name the folder of the test data");
    }
    folder
}

fn read_exr(path: &Path) -> Vec<Vec3> {
    let image = exr::prelude::read_first_rgba_layer_from_file(
        path,
        |size, _| vec![Vec3::ZERO; size.area()],
        |pixels: &mut Vec<Vec3>, at, (r, g, b, _): (f32, f32, f32, f32)| pixels[at.1 * 128 + at.0] = Vec3::new(r, g, b),
    );
    let image = image.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    assert_eq!(image.layer_data.size.area(), SIZE.pixels(), "{}", path.display());
    image.layer_data.channel_data.pixels
}

/// Renders a scene from its first camera and compares it with the reference of that name. The two may
/// differ by `relative` in a block beside chance: that is no more than the reference renderer's own float
/// arithmetic, and what its longest path cuts off.
fn compare(name: &str, scene: &str, spp: u32, relative: f64, relative_of_image: f64) {
    let Some(data) = data_folder() else { return };
    let reference = read_exr(&data.join(format!("reference/rendered/{name}_mean.exr")));
    let reference_error = read_exr(&data.join(format!("reference/rendered/{name}_stderr.exr")));
    let scene = Scene::load(&data.join(format!("scenes/{scene}")).to_string_lossy()).unwrap();
    let view = scene.cameras[0].clone();
    let tracer = PathTracer::new(Arc::new(scene));
    let camera = Camera::symmetric(view.vertical_fov_rad, SIZE);
    let settings = RenderSettings { spp, max_depth: 48, seed: 7, filter: PixelFilter::Box };
    let image = render(&tracer, &camera, &view.pose, &settings);

    let means = [&image.radiance, &reference].map(|pixels| block_means(128, pixels, f64::from));
    // Variance of a block's mean: the mean variance of its pixels over their number.
    let variances = [&image.standard_error, &reference_error]
        .map(|pixels| block_means(128, pixels, |error| f64::from(error).powi(2) / 64.0));
    let z = |block: usize| {
        let systematic = relative * means[1][block];
        (means[0][block] - means[1][block])
            / (variances[0][block] + variances[1][block] + systematic * systematic).sqrt()
    };
    let blocks = means[0].len();
    let worst = (0..blocks).map(|block| z(block).abs()).fold(0.0, f64::max);
    let mean_of = |means: &[f64], channel: usize| means.iter().skip(channel).step_by(3).sum::<f64>();
    let off = (0..3)
        .map(|channel| (mean_of(&means[0], channel) / mean_of(&means[1], channel) - 1.0).abs())
        .fold(0.0, f64::max);
    eprintln!("{name}: worst block |z| {worst:.2} of {blocks}, image means agree to {:.3} %", off * 100.0);
    let limit = critical_z(blocks, 15.0 + f64::from(spp));
    if worst > limit || off > relative_of_image {
        let error: Vec<Vec3> = image.radiance.iter().zip(&reference).map(|(a, b)| (*a - *b).abs()).collect();
        let at = write_pictures(name, 128, &[("image", &image.radiance), ("reference", &reference), ("error", &error)]);
        panic!("{name}: |z| {worst:.2} (limit {limit:.2}), means off by {off:.4}; pictures in {}", at.display());
    }
}

#[test]
fn the_cornell_box_is_that_of_an_independent_renderer() {
    compare("cornell_box_128", "CornellBox.glb", 192, 0.0, 0.005);
}
