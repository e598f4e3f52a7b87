//! Every pixel warped at the depth of its surface: backward flow by splat, 3x3 search and fixed-point
//! iteration (Bowles et al. 2012, "Iterative image warping"; Lochmann 3.2.7).
//!
//! 1. Each old pixel is projected into the new view and leaves its index there, the nearest winning.
//! 2. Each new pixel x starts from the nearest surface among the 3x3 around it, and solves
//!    `project(u) = x` by `u <- u + x - project(u)`.
//! 3. What does not converge is tried again from the pixel's own splat, and else is a hole.
//!
//! Cost: one projection per old pixel and two to four per new one. This is the plain form, against which the vectors of
//! `specular` are held.

use super::HOLE;
use super::reproject::Reprojection;
use super::source::Source;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use warplight_protocol::camera::MIN_DEPTH_M;
use warplight_protocol::{Camera, Pose};

/// Residual, in pixels, whose step is the last: the next residual is smaller by the change of scale and parallax per
/// pixel, a half where a head turns far, and so within the step of 1/256 to which samples are rounded.
const LAST_STEP_PX: f32 = 1.0 / 256.0;
/// Residual that is accepted after the last step: half a pixel further and a neighbour would be the answer.
const ACCEPTED_PX: f32 = 0.25;
/// Steps of the iteration; it contracts by the relative depth slope, four are the rule.
const MAX_STEPS: usize = 12;

/// Per new pixel the nearest old one: inverse depth in the upper half, index of the texel plus one in the
/// lower, 0 for none.
#[derive(Debug, Default)]
pub(super) struct Splat {
    nearest: Vec<AtomicU64>,
}

impl Splat {
    fn forward(&mut self, source: &Source, reprojection: &Reprojection, camera: &Camera) {
        self.nearest.resize_with(camera.size.pixels(), AtomicU64::default);
        self.nearest.par_iter_mut().for_each(|nearest| *nearest.get_mut() = 0);
        let old = source.camera();
        let width = camera.size.width as usize;
        let old_width = old.size.width as usize;
        (0..old.size.height as usize).into_par_iter().for_each(|row| {
            for texel in row * old_width..(row + 1) * old_width {
                let inverse_depth = source.inverse_depth(texel);
                let h = reprojection
                    .homogeneous(Vec2::new((texel - row * old_width) as f32 + 0.5, row as f32 + 0.5), inverse_depth);
                let pixel = h.truncate() / h.z;
                // Also false for what is no number.
                let inside = h.z >= MIN_DEPTH_M
                    && pixel.x >= 0.0
                    && pixel.y >= 0.0
                    && pixel.x < camera.size.width as f32
                    && pixel.y < camera.size.height as f32;
                if inside {
                    // Positive floats order like their bits.
                    let new_inverse_depth = (inverse_depth / h.z).max(0.0).to_bits();
                    let entry = u64::from(new_inverse_depth) << 32 | (texel as u64 + 1);
                    self.nearest[pixel.y as usize * width + pixel.x as usize].fetch_max(entry, Relaxed);
                }
            }
        });
    }

    fn at(&self, pixel: usize) -> u64 {
        self.nearest[pixel].load(Relaxed)
    }

    /// The nearest entry of the 3x3 around a pixel.
    fn nearest_around(&self, x: usize, y: usize, camera: &Camera) -> u64 {
        let (width, height) = (camera.size.width as usize, camera.size.height as usize);
        let mut nearest = 0;
        for row in y.saturating_sub(1)..(y + 2).min(height) {
            for column in x.saturating_sub(1)..(x + 2).min(width) {
                nearest = nearest.max(self.at(row * width + column));
            }
        }
        nearest
    }
}

/// Fills `radiance` with the old picture seen from `display_pose`.
pub(super) fn warp(source: &Source, display_pose: &Pose, camera: &Camera, splat: &mut Splat, radiance: &mut [Vec3]) {
    let reprojection = Reprojection::new(source.camera(), source.pose(), camera, display_pose);
    splat.forward(source, &reprojection, camera);
    let splat = &*splat;
    let width = camera.size.width as usize;
    radiance.par_chunks_mut(width).enumerate().for_each(|(y, radiance)| {
        for (x, radiance) in radiance.iter_mut().enumerate() {
            let target = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            let from =
                |entry: u64| solve(source, &reprojection, ((entry & 0xffff_ffff) as usize).checked_sub(1)?, target);
            let flow = from(splat.nearest_around(x, y, camera)).or_else(|| from(splat.at(y * width + x)));
            *radiance = flow.and_then(|pixel| source.radiance_of_surface_at(pixel)).unwrap_or(HOLE);
        }
    });
}

/// The position in the old picture, near the centre of the texel `start`, whose point is seen at `target` in the
/// new one.
#[inline]
fn solve(source: &Source, reprojection: &Reprojection, start: usize, target: Vec2) -> Option<Vec2> {
    let mut position = source.camera().size.pixel_centre(start);
    let mut inverse_depth = source.inverse_depth(start);
    let mut residual = f32::INFINITY;
    for _ in 0..MAX_STEPS {
        let missing = target - reprojection.pixel(position, inverse_depth)?;
        residual = missing.abs().max_element();
        position += missing;
        if residual < LAST_STEP_PX {
            break;
        }
        inverse_depth = source.inverse_depth_at(position)?;
    }
    // `position` has taken one more step since the residual was measured.
    (residual < ACCEPTED_PX).then_some(position)
}
