//! Layering by dynamic programming: the segments that differ least from the matter along a ray.
//!
//! Along a ray let P(z) = (0.7 tau, B), where tau is the optical depth from the eye to z and B the unattenuated integral
//! of extinction times source radiance, per channel. Matter of constant extinction and constant source makes P a straight
//! line, so the cost of a segment from z_i to z_j is the weighted squared distance of P from the chord between its ends,
//! summed over the candidate borders between them. The weight of a border is the length of the ray around it times its
//! transmittance from the eye, but at least `HIDDEN`, which fades with the optical depth before it (`FADING`): what is
//! hidden from the render pose is seen from another one (worth 3 to 4 dB there). Segments neither start nor end in empty
//! space. One run finds the best k segments for every k.
//!
//! Candidates: `reduce` joins the slices of a ray to at most [`CANDIDATES`] bins, with a border wherever matter begins or
//! ends, and as many bins in a stretch as its share of length, opacity and optical depth calls for; `bins` does the same
//! fast. `plain` is the program written down in f64; `lanes` runs it for 16 rays at once.
//!
//! Cost: k times the square of the number of bins, per ray.

#[allow(clippy::needless_range_loop, reason = "a loop indexes many rows alike, and becomes vectors")]
mod bins;
#[allow(clippy::needless_range_loop, reason = "a loop over lanes indexes many rows alike, and becomes vectors")]
mod lanes;
mod plain;
mod reduce;
#[allow(clippy::needless_range_loop, reason = "a loop over lanes indexes many rows alike, and becomes vectors")]
mod vector;

pub use plain::cut as cut_plainly;

use super::{Profile, Segments};

/// Bins of a ray for a live frame.
pub const CANDIDATES: usize = 32;
/// Bins of a ray where time does not matter.
pub const MANY_CANDIDATES: usize = 56;
/// Least weight of what is hidden, but for what lies behind so much that it is seen from nowhere near.
const HIDDEN: f32 = 0.05;
/// That fades with this part of the optical depth before it. Without fading, the inside of something almost opaque costs
/// more than its surface, and takes all segments (at ten times its density, a scan of a torso is 30 % worse off for it).
const FADING: f32 = 0.25;
/// Weight of an optical depth of 1 against a unit of unattenuated radiance.
const OPTICAL_DEPTH_WEIGHT: f32 = 0.7;
/// Most optical depth that counts of one bin: beyond, it is a wall, and the cost of the bins before it must still matter.
const WALL: f32 = 2.0;
/// Cost of a segment for being one: its squared visible optical depth, and a fifth of its squared part of the ray's length.
/// Where several cuts are as good it prefers those of even parts.
const EVENNESS: f32 = 2e-5;
const LENGTH_EVENNESS: f32 = 0.2;

/// Cuts many rays at once; keeps its memory.
#[derive(Debug, Default)]
pub struct Programs {
    bins: Vec<bins::Bins>,
    lanes: Box<lanes::Lanes>,
}

impl Programs {
    /// Cuts each ray into at most `count` segments.
    pub(super) fn cut(&mut self, count: usize, rays: &[Profile], segments: &mut [Segments]) {
        self.bins.resize_with(vector::LANES, Default::default);
        for (rays, segments) in rays.chunks(vector::LANES).zip(segments.chunks_mut(vector::LANES)) {
            let bins = &mut self.bins[..rays.len()];
            for (ray, bins) in rays.iter().zip(bins.iter_mut()) {
                bins.reduce(ray);
            }
            self.lanes.solve(count, bins);
            for (lane, (bins, segments)) in bins.iter().zip(segments).enumerate() {
                self.lanes.for_each_segment(lane, count, bins.len(), |range| segments.extend(bins.segment(range)));
            }
        }
    }
}

/// Numbers from 0 to 1 by xorshift32 (Marsaglia 2003), for rays of tests.
#[cfg(test)]
fn random(seed: u32) -> impl FnMut() -> f32 {
    let mut state = seed.wrapping_mul(0x9e37_79b9) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        f64::from(state) as f32 / u32::MAX as f32
    }
}
