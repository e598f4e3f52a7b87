//! Whole pictures: the mean of many paths per pixel, over the pixel's area or through its centre, with its
//! standard error.
//!
//! Samples are summed in f64, so a million of them lose nothing. This file reads no clock: whoever asks for
//! a picture is told after each pass how far it is, and may stop it there.

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
}

/// A picture in linear RGB, row 0 at the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Its size.
    pub size: ImageSize,
    /// Mean radiance per pixel.
    pub radiance: Vec<Vec3>,
    /// Standard error of that mean, as if samples were independent (they are stratified, so the true error
    /// is at most about this).
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

/// Sums over the samples of a pixel.
#[derive(Clone, Copy, Debug, Default)]
struct PixelSums {
    count: u32,
    radiance: DVec3,
    squares: DVec3,
}

impl PixelSums {
    fn add(&mut self, radiance: Vec3) {
        let radiance = radiance.as_dvec3();
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

/// Renders a picture. `after_pass` learns how many samples per pixel are done and may stop there.
pub fn render_image(
    tracer: &PathTracer,
    camera: &Camera,
    pose: &Pose,
    settings: &RenderSettings,
    counters: &Counters,
    after_pass: &mut dyn FnMut(u32) -> ControlFlow<()>,
) -> Image {
    let eye = Eye::new(pose, *camera);
    let width = camera.size.width as usize;
    let mut pixels = vec![PixelSums::default(); camera.size.pixels()];
    let mut done = 0;
    while done < settings.spp {
        let pass = done..(done + PASS_SPP).min(settings.spp);
        pixels.par_chunks_mut(width).enumerate().for_each(|(row, sums)| {
            let mut counts = RayCounts::default();
            for (column, sums) in sums.iter_mut().enumerate() {
                let pixel = row * width + column;
                for index in pass.clone() {
                    let mut sampler = Sampler::new(settings.seed, pixel as u64, index);
                    let ray = eye_ray(&eye, Vec2::new(column as f32, row as f32), settings.filter, &mut sampler);
                    let radiance = tracer.radiance(&ray, settings.max_depth, &mut sampler, &mut counts);
                    if radiance.is_finite() {
                        sums.add(radiance);
                    } else {
                        counts.dropped += 1;
                    }
                }
            }
            counters.add(&counts);
        });
        done = pass.end;
        if after_pass(done).is_break() {
            break;
        }
    }
    Image {
        size: camera.size,
        radiance: pixels.iter().map(|sums| sums.mean().as_vec3()).collect(),
        standard_error: pixels.iter().map(|sums| sums.standard_error().as_vec3()).collect(),
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

    /// numerics: accumulation of 1e6 samples, one of them at 1e8.
    #[test]
    fn a_million_samples_and_one_outlier_keep_their_mean() {
        let mut sums = PixelSums::default();
        let mut exact = 0.0_f64;
        for index in 0..1_000_000_u32 {
            let value = if index == 777 { 1e8 } else { 0.1 + (index % 97) as f32 * 1e-3 };
            sums.add(Vec3::splat(value));
            exact += f64::from(value);
        }
        assert!((sums.mean().x / (exact / 1e6) - 1.0).abs() < 1e-5);
        assert!(sums.standard_error().is_finite());
    }

    #[test]
    fn standard_error_is_that_of_the_mean() {
        let mut sums = PixelSums::default();
        (0..1000).for_each(|index| sums.add(Vec3::splat(f32::from(index % 2 == 0))));
        assert!((sums.standard_error().x - 0.5 / 999.0_f64.sqrt()).abs() < 1e-9);
    }
}
