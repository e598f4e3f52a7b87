//! From what a ray goes through to the few segments of a layered frame.
//!
//! Stage of the server between the march through a volume and the frame. A [`Profile`] holds the slices of one ray, a
//! layering cuts it into at most k segments, each of which does what its slices do together: seen from the render
//! pose, every layering gives the same picture, to rounding. They differ by what another pose sees.
//!
//! - `quantiles`: equal steps of opacity (the thesis).
//! - `merged`: own front and back, joined by colour (volumetric depth images).
//! - [`optimal`]: the segments that differ least from the matter, by dynamic programming (ours).
//! - `slabs`: the same depths in every pixel, for a baseline.

mod merged;
mod opacity;
pub mod optimal;
mod profile;
mod quantiles;
mod slabs;
#[cfg(test)]
mod tests;

pub use profile::Profile;

use warplight_protocol::frame::{Layering, VolumeRange, VolumeSegment};

/// The segments of a ray, from the eye on; one without optical depth is none.
pub type Segments = Vec<VolumeSegment>;

/// Cuts rays; keeps its memory from one to the next.
#[derive(Debug, Default)]
pub struct Cutter {
    merging: merged::Work,
    programs: optimal::Programs,
}

impl Cutter {
    /// Cuts each of the rays into at most `count` segments, in depths of `range`.
    pub fn cut(
        &mut self,
        layering: Layering,
        count: usize,
        range: VolumeRange,
        rays: &[Profile],
        segments: &mut [Segments],
    ) {
        segments.iter_mut().for_each(Vec::clear);
        if count == 0 {
            return;
        }
        if layering == Layering::Optimal {
            return self.programs.cut(count, rays, segments);
        }
        for (ray, segments) in rays.iter().zip(segments) {
            match layering {
                Layering::Quantiles => quantiles::cut(ray, count, segments),
                Layering::Merged => merged::cut(ray, count, range, &mut self.merging, segments),
                Layering::Slabs => slabs::cut(ray, count, range, segments),
                // Above, many at once.
                Layering::Optimal => {}
            }
        }
    }
}
