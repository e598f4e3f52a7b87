//! Baseline: one colour and one depth per pixel (Zellmann et al. 2012).
//!
//! The volume is taken for a surface: each pixel of the frame is a point with the colour and the opacity of its whole ray, at
//! the mean depth of what is seen along it, each part weighed with what it contributes (the best of the depths they
//! tried). Points are drawn with a depth buffer into the new view, a pixel each. What none falls into is filled along its
//! row or its column, whichever is bridged sooner; what is wider stays empty, and so does what lies beside an outline. Right where a ray ends at one dominant surface; what is seen through something else
//! moves with it, and matter is as thick from all sides. The mean within a homogeneous segment is exact, the fractions of
//! pixels are not: points are drawn to the nearest. Cost: a projection per pixel that is not empty.

use super::view::{Pinhole, Rays};
use super::walk::Frame;
use glam::{DVec2, DVec3, Vec4};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Pixels that are searched for a point to either side of a gap; what is wider stays empty.
const REACH_PX: usize = 24;
/// Ratio of depths from which on two sides of a gap are not the same surface.
const SAME_SURFACE: f32 = 1.03;
/// What the depth buffer holds where no point is.
const NOTHING: u64 = u64::MAX;

/// Points of a frame, and the buffers to draw them.
#[derive(Debug, Default)]
pub(super) struct MeanDepth {
    /// Radiance and transmittance of each pixel.
    colors: Vec<Vec4>,
    /// Depth in view of each pixel; 0 where it is empty.
    depths_m: Vec<f32>,
    /// Depth in the new view, its bits in the upper half, and the pixel it comes from.
    buffer: Vec<AtomicU64>,
}

impl MeanDepth {
    pub(super) fn prepare(&mut self, frame: &Frame<'_>) {
        let pixels = frame.tree.camera.size.pixels();
        self.colors.resize(pixels, Vec4::W);
        self.depths_m.resize(pixels, 0.0);
        let rows = self.colors.par_iter_mut().zip(&mut self.depths_m).with_min_len(1024);
        rows.enumerate().for_each(|(pixel, (color, depth_m))| {
            let mut gathered = super::transport::Transport::default();
            let (mut sum_m, mut weight) = (0.0, 0.0);
            for layer in 0..frame.tree.layers.len() {
                let Some(segment) = frame.segment(pixel, layer) else { continue };
                let before = gathered.transmittance;
                let tau = f64::from(segment.optical_depth);
                gathered.cross(tau, segment.source.as_dvec3());
                let share = before - gathered.transmittance;
                let (front, back) = (f64::from(segment.front_m), f64::from(segment.back_m));
                sum_m += share * (front + (back - front) * mean_place(tau));
                weight += share;
            }
            *color = gathered.radiance.as_vec3().extend(gathered.transmittance as f32);
            *depth_m = if weight > 0.0 { (sum_m / weight) as f32 } else { 0.0 };
        });
    }

    /// Draws the points; `surface_m` hides those behind it.
    pub(super) fn march(&mut self, frame: &Pinhole, rays: &Rays, surface_m: &[f32], out: &mut [Vec4]) {
        let [width, height] = rays.display.size_px;
        self.buffer.resize_with(width * height, AtomicU64::default);
        self.buffer.par_iter_mut().for_each(|entry| *entry.get_mut() = NOTHING);
        let display_from_frame = rays.frame_from_display.transpose();
        let buffer = &self.buffer;
        let points = self.depths_m.par_iter().enumerate().with_min_len(1024).filter(|(_, depth_m)| **depth_m > 0.0);
        points.for_each(|(pixel, depth_m)| {
            let at = DVec2::new((pixel % frame.size_px[0]) as f64, (pixel / frame.size_px[0]) as f64) + 0.5;
            let point: DVec3 = display_from_frame * (frame.ray(at) * f64::from(*depth_m) - rays.origin);
            let shown = rays.display.pixel(point);
            let is_seen = point.z > 0.0 && shown.min_element() >= 0.0;
            if !is_seen || shown.x >= width as f64 || shown.y >= height as f64 {
                return;
            }
            let index = shown.y as usize * width + shown.x as usize;
            if surface_m.get(index).is_none_or(|&surface_m| point.length() < f64::from(surface_m)) {
                // Floats above zero have the order of their bits.
                let entry = u64::from((point.z as f32).to_bits()) << 32 | pixel as u64;
                buffer[index].fetch_min(entry, Ordering::Relaxed);
            }
        });
        out.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
            for (column, out) in out.iter_mut().enumerate() {
                let found = self.point(row * width + column).map(|(_, color)| color);
                *out = found.unwrap_or_else(|| self.bridged(column, row, [width, height]));
            }
        });
    }

    /// The point that a pixel shows: its depth and its colour.
    fn point(&self, index: usize) -> Option<(f32, Vec4)> {
        let entry = self.buffer[index].load(Ordering::Relaxed);
        let color = self.colors.get((entry & 0xffff_ffff) as usize)?;
        (entry != NOTHING).then_some((f32::from_bits((entry >> 32) as u32), *color))
    }

    /// What a gap shows.
    fn bridged(&self, column: usize, row: usize, [width, height]: [usize; 2]) -> Vec4 {
        let at = (row * width + column) as isize;
        let side = |step: isize, limit: usize| {
            (1..=limit.min(REACH_PX)).find_map(|steps| {
                let (depth_m, color) = self.point((at + step * steps as isize) as usize)?;
                Some((steps as f32, depth_m, color))
            })
        };
        let row_step = width as isize;
        let in_row = side(-1, column).zip(side(1, width - 1 - column));
        let in_column = side(-row_step, row).zip(side(row_step, height - 1 - row));
        let narrower =
            [in_row, in_column].into_iter().flatten().min_by(|(a, b), (c, d)| (a.0 + b.0).total_cmp(&(c.0 + d.0)));
        match narrower {
            None => Vec4::W,
            Some(((_, left_m, color), (_, right_m, _))) if left_m > right_m * SAME_SURFACE => color,
            Some(((_, left_m, _), (_, right_m, color))) if right_m > left_m * SAME_SURFACE => color,
            Some(((left, _, left_color), (right, _, right_color))) => {
                left_color.lerp(right_color, left / (left + right))
            }
        }
    }
}

/// Where in a homogeneous segment, from 0 at its front to 1 at its back, what it sends comes from in the mean:
/// `1 / tau - exp(-tau) / (1 - exp(-tau))`.
fn mean_place(tau: f64) -> f64 {
    // Both terms run off together towards zero; there the first of the series is exact to 1e-9.
    if tau < 1e-3 { 0.5 - tau / 12.0 } else { 1.0 / tau + (-tau).exp() / (-tau).exp_m1() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_place_is_that_of_the_light() {
        for tau in [1e-12, 1e-4, 0.999e-3, 1.001e-3, 0.3, 5.0, 1e4] {
            let (mut sum, mut weight, steps) = (0.0, 0.0, 200_000);
            for step in 0..steps {
                let place = (f64::from(step) + 0.5) / f64::from(steps);
                sum += place * (-tau * place).exp();
                weight += (-tau * place).exp();
            }
            assert!((mean_place(tau) - sum / weight).abs() < 1e-4, "{tau}: {} {}", mean_place(tau), sum / weight);
        }
    }
}
