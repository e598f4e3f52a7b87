//! Layering at the same depths in every pixel: slabs, for the baseline that warps each of them as one surface.
//!
//! Method: Müller et al. 1999. The range of the
//! frame is cut at equal distances; what a slab holds of a ray is shrunk to where there is matter, so that the middle of
//! a segment is near the mean depth of what it shows.

use super::{Profile, Segments};
use warplight_protocol::frame::VolumeRange;

/// Cuts a ray into as many segments as there are slabs, the empty ones left out.
pub(super) fn cut(profile: &Profile, count: usize, range: VolumeRange, segments: &mut Segments) {
    let Some(occupied) = profile.occupied() else { return };
    let border = |slab: usize| range.near_m + (range.far_m - range.near_m) * slab as f32 / count as f32;
    for slab in 0..count {
        // Rounding must not leave matter before the first or behind the last slab.
        let front = if slab == 0 { 0.0 } else { border(slab) };
        let back = if slab + 1 == count { f32::INFINITY } else { border(slab + 1) };
        let matter = |slice: &usize| {
            profile.optical_depth[*slice] > 0.0 && profile.depth[slice + 1] > front && profile.depth[*slice] < back
        };
        let (first, last) = (occupied.clone().find(matter), occupied.clone().rfind(matter));
        let segment = first.zip(last).and_then(|(first, last)| {
            profile.segment_between(profile.depth[first].max(front), profile.depth[last + 1].min(back))
        });
        // A slab keeps its number: an empty one is a segment of nothing.
        segments.push(segment.unwrap_or_default());
    }
}
