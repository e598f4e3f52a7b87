//! Whole pictures: the mean of many paths per pixel, over the pixel's area or through its centre, with its
//! standard error.
//!
//! Samples are summed in f64, so a million of them lose nothing. This file reads no clock: whoever asks for
//! a picture is told after each pass how far it is, and may stop it there.
//!
//! All samples of a pixel are stratified together, which is the least noisy but hides how large the error is: as
//! if they were independent, it is overstated. Where the error matters, samples come in batches, each stratified
//! in itself and independent of the others, and the scatter of their means is the error (Owen 1997, randomised
//! replicates).

use crate::accel::Ray;
use crate::counters::{Counters, RayCounts};
use crate::frame::Eye;
use crate::integrator::PathTracer;
use crate::integrator::sampler::Sampler;
use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use std::ops::ControlFlow;
use warplight_protocol::{Camera, ImageSize, Pose};

/// Samples per pixel of a pass: few enough that stopping is prompt, enough that threads seldom wait.
const PASS_SPP: u32 = 4;

/// Where in a pixel its samples lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFilter {
    /// Uniformly over the pixel's area.
    Box,
    /// At its centre, as in a ray-tree frame.
    Centre,
}

/// How a picture is rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Samples per pixel.
    pub spp: u32,
    /// Longest path in segments: 1 shows lights only, 2 direct light.
    pub max_depth: u32,
    /// Seed of all randomness.
    pub seed: u64,
    /// Where samples lie.
    pub filter: PixelFilter,
    /// Samples per pixel that are stratified together; `None` for all.
    pub batch_spp: Option<u32>,
}

/// A picture in linear RGB, row 0 at the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Its size.
    pub size: ImageSize,
    /// Mean radiance per pixel.
    pub radiance: Vec<Vec3>,
    /// Standard error of that mean: from the scatter of batches where there are at least two; else as if samples
    /// were independent (they are stratified, so the true error is at most about this).
    pub standard_error: Vec<Vec3>,
    /// Samples per pixel that were taken.
    pub spp: u32,
}

impl Image {
    /// Root mean square over pixels and channels of the standard error.
    pub fn rms_standard_error(&self) -> f64 {
        let sum: f64 = self.standard_error.iter().map(|error| f64::from(error.length_squared())).sum();
        (sum / (3 * self.standard_error.len()).max(1) as f64).sqrt()
    }
}

/// Sums over independent numbers: samples, or means of batches.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    count: u32,
    radiance: DVec3,
    squares: DVec3,
}

impl Sums {
    fn add(&mut self, radiance: DVec3) {
        self.count += 1;
        self.radiance += radiance;
        self.squares += radiance * radiance;
    }

    fn mean(&self) -> DVec3 {
        self.radiance / f64::from(self.count.max(1))
    }

    fn standard_error(&self) -> DVec3 {
        let variance = (self.squares / f64::from(self.count.max(1)) - self.mean() * self.mean()).max(DVec3::ZERO);
        // One sample knows nothing of its error: infinite would be honest, but no picture holds that.
        let root = |variance: f64| (variance / f64::from(self.count.saturating_sub(1).max(1))).sqrt();
        DVec3::new(root(variance.x), root(variance.y), root(variance.z))
    }
}

/// What is known of a pixel.
#[derive(Clone, Copy, Debug, Default)]
struct Pixel {
    samples: Sums,
    /// Samples of the batch that is not whole yet.
    batch: (u32, DVec3),
    batches: Sums,
}

impl Pixel {
    fn add(&mut self, radiance: Vec3) {
        self.samples.add(radiance.as_dvec3());
        self.batch = (self.batch.0 + 1, self.batch.1 + radiance.as_dvec3());
    }

    fn end_batch(&mut self) {
        let (count, sum) = std::mem::take(&mut self.batch);
        if count > 0 {
            self.batches.add(sum / f64::from(count));
        }
    }

    fn standard_error(&self) -> DVec3 {
        if self.batches.count > 1 { self.batches.standard_error() } else { self.samples.standard_error() }
    }
}

/// How far a picture is.
pub struct Progress<'a> {
    /// Samples per pixel that are done.
    pub spp: u32,
    pixels: &'a [Pixel],
}

impl Progress<'_> {
    /// Root mean square of the standard error over pixels and channels, relative to the picture's mean; `None`
    /// before there are enough independent batches to tell.
    pub fn relative_standard_error(&self) -> Option<f64> {
        /// With fewer, the scatter of their means is itself off by more than a third.
        const LEAST_BATCHES: u32 = 6;
        if self.pixels.iter().any(|pixel| pixel.batches.count < LEAST_BATCHES) {
            return None;
        }
        let (squares, mean) = self.pixels.iter().fold((0.0, 0.0), |(squares, mean), pixel| {
            (squares + pixel.standard_error().length_squared(), mean + pixel.samples.mean().element_sum())
        });
        let values = 3.0 * self.pixels.len() as f64;
        (mean > 0.0).then(|| (squares / values).sqrt() / (mean / values))
    }
}

/// Renders a picture. `after_pass` learns how far it is and may stop there.
pub fn render_image(
    tracer: &PathTracer,
    camera: &Camera,
    pose: &Pose,
    settings: &RenderSettings,
    counters: &Counters,
    after_pass: &mut dyn FnMut(&Progress<'_>) -> ControlFlow<()>,
) -> Image {
    let eye = Eye::new(tracer.scene(), pose, *camera);
    let inside = tracer.enclosure_at(eye.position());
    let width = camera.size.width as usize;
    let mut pixels = vec![Pixel::default(); camera.size.pixels()];
    let batch_spp = settings.batch_spp.unwrap_or(u32::MAX).max(1);
    let mut done = 0;
    while done < settings.spp {
        let (batch, first) = (done / batch_spp, done % batch_spp);
        let pass = first..(first + PASS_SPP).min(batch_spp).min(first + settings.spp - done);
        let seed = settings.seed.wrapping_add(u64::from(batch) << 32);
        pixels.par_chunks_mut(width).enumerate().for_each(|(row, pixels)| {
            let mut counts = RayCounts::default();
            for (column, sums) in pixels.iter_mut().enumerate() {
                let pixel = row * width + column;
                for index in pass.clone() {
                    let mut sampler = Sampler::new(seed, pixel as u64, index);
                    let ray = eye_ray(&eye, Vec2::new(column as f32, row as f32), settings.filter, &mut sampler);
                    let radiance = tracer.radiance(&ray, inside, settings.max_depth, &mut sampler, &mut counts);
                    if radiance.is_finite() {
                        sums.add(radiance);
                    } else {
                        counts.dropped += 1;
                    }
                }
                if pass.end == batch_spp {
                    sums.end_batch();
                }
            }
            counters.add(&counts);
        });
        done += pass.end - pass.start;
        if after_pass(&Progress { spp: done, pixels: &pixels }).is_break() {
            break;
        }
    }
    Image {
        size: camera.size,
        radiance: pixels.iter().map(|pixel| pixel.samples.mean().as_vec3()).collect(),
        standard_error: pixels.iter().map(|pixel| pixel.standard_error().as_vec3()).collect(),
        spp: done,
    }
}

fn eye_ray(eye: &Eye, corner: Vec2, filter: PixelFilter, sampler: &mut Sampler) -> Ray {
    let within = match filter {
        PixelFilter::Box => sampler.pair(),
        PixelFilter::Centre => Vec2::splat(0.5),
    };
    eye.ray_through(corner + within)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;
    use crate::testing::{SceneBuilder, diffuse, emitter};

    #[test]
    fn stability_accumulation() {
        let mut off = bound!("accumulation", "mean of a pixel, relative", 1e-5);
        let mut sums = Sums::default();
        let mut exact = 0.0_f64;
        for index in 0..1_000_000_u32 {
            let value = if index == 777 { 1e8 } else { 0.1 + (index % 97) as f32 * 1e-3 };
            sums.add(DVec3::splat(value.into()));
            exact += f64::from(value);
        }
        off.see((sums.mean().x / (exact / 1e6) - 1.0).abs(), "a million samples");
        assert!(sums.standard_error().is_finite());
    }

    #[test]
    fn standard_error_is_that_of_the_mean() {
        let mut sums = Sums::default();
        (0..1000).for_each(|index| sums.add(DVec3::splat(f64::from(index % 2 == 0))));
        assert!((sums.standard_error().x - 0.5 / 999.0_f64.sqrt()).abs() < 1e-9);
    }

    /// The scatter of batches is the true error of stratified samples: the error over many seeds agrees with it.
    #[test]
    fn the_error_of_batches_is_the_scatter_over_seeds() {
        let scene = SceneBuilder::new()
            .floor(0.0, 5.0, diffuse(0.7))
            .sphere(Vec3::new(0.5, 2.0, 0.0), 0.5, emitter(Vec3::splat(4.0)))
            .build();
        let tracer = PathTracer::new(std::sync::Arc::new(scene));
        let camera = Camera::symmetric(0.6, ImageSize::new(16, 16));
        let pose = Pose::look_at(DVec3::new(0.0, 1.5, 3.0), DVec3::ZERO);
        let image = |seed| {
            let batch_spp = Some(16);
            let settings = RenderSettings { spp: 128, max_depth: 3, seed, filter: PixelFilter::Box, batch_spp };
            render_image(&tracer, &camera, &pose, &settings, &Counters::default(), &mut |_| ControlFlow::Continue(()))
        };
        let images: Vec<Image> = (0..24).map(image).collect();
        let (mut scatter, mut claimed) = (0.0, 0.0);
        for pixel in 0..camera.size.pixels() {
            let mut sums = Sums::default();
            for image in &images {
                sums.add(image.radiance[pixel].as_dvec3());
                claimed += f64::from(image.standard_error[pixel].x).powi(2) / images.len() as f64;
            }
            scatter += sums.standard_error().x.powi(2) * images.len() as f64;
        }
        // 256 pixels with 23 and 7 degrees of freedom each: the ratio is known to about 5 %.
        assert!((claimed / scatter - 1.0).abs() < 0.2, "{}", claimed / scatter);
    }

    #[test]
    fn a_wanted_error_is_known_once_there_are_enough_batches() {
        let scene = SceneBuilder::new().environment(crate::scene::Environment::Constant(Vec3::ONE)).build();
        let tracer = PathTracer::new(std::sync::Arc::new(scene));
        let settings =
            RenderSettings { spp: 1 << 20, max_depth: 3, seed: 1, filter: PixelFilter::Box, batch_spp: Some(4) };
        let camera = Camera::symmetric(0.6, ImageSize::new(4, 4));
        let mut stop = |progress: &Progress<'_>| match progress.relative_standard_error() {
            Some(error) if error <= 0.0 => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        };
        let image = render_image(&tracer, &camera, &Pose::IDENTITY, &settings, &Counters::default(), &mut stop);
        assert_eq!(image.spp, 24);
    }
}
