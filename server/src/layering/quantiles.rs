//! Layering at equal steps of opacity: the thesis's choice.
//!
//! Method: Lochmann et al. 2016. Between the first and the last matter of a ray, borders stand where the normalised
//! opacity `(1 - T(d)) / (1 - T(end))` reaches (i + 1/2) / (k - 1); with the two ends these are k segments. They put
//! detail where it matters to the picture of the render pose, and none into what is hidden there.
//!
//! Cost: two passes over the slices.

use super::{Profile, Segments};

/// Cuts a ray into at most `count` segments.
pub(super) fn cut(profile: &Profile, count: usize, segments: &mut Segments) {
    let Some(occupied) = profile.occupied() else { return };
    let total: f32 = profile.optical_depth[occupied.clone()].iter().sum();
    let opacity = -(-total).exp_m1();
    let inner = count - 1;
    let mut front = profile.depth[occupied.start];
    let mut above = 0.0;
    let mut reached = 0;
    for slice in occupied.clone() {
        let optical_depth = profile.optical_depth[slice];
        let below = above + optical_depth;
        while reached < inner {
            let wanted = (reached as f32 + 0.5) / inner as f32 * opacity;
            if -(-below).exp_m1() < wanted {
                break;
            }
            let part = (-(-wanted).ln_1p() - above) / optical_depth;
            // Not a number where the slice is empty, which no step can end in but by rounding.
            let part = if part > 0.0 { part.min(1.0) } else { 0.0 };
            let back = profile.depth[slice] + part * (profile.depth[slice + 1] - profile.depth[slice]);
            segments.extend(profile.segment_between(front, back));
            front = back;
            reached += 1;
        }
        above = below;
    }
    segments.extend(profile.segment_between(front, profile.depth[occupied.end]));
}
