//! Layering where the colour changes: volumetric depth images.
//!
//! Method: Frey et al. 2013 ("Explorable volumetric depth images from raycasting"). Slices join the segment before them
//! while what they show, colour and opacity over a reference length, differs from the segment's mean by less than a
//! threshold; the threshold of each ray is the smallest that needs no more segments than there are, by bisection. Each
//! segment has its own front and back, so that empty space between two is no part of either.
//!
//! Cost: a pass over the slices for each of [`STEPS`] thresholds.

use super::{Profile, Segments};
use glam::{Vec3, Vec4};
use std::ops::Range;
use warplight_protocol::frame::VolumeRange;

/// Bisections of the threshold: to 1/2000 of the largest difference there can be of unit colours.
const STEPS: u32 = 11;
/// Part of the frame's range over which a slice's opacity is compared.
const REFERENCE: f32 = 0.015;

/// Cuts a ray into at most `count` segments. `slices` and `features` are memory to work in.
pub(super) fn cut(profile: &Profile, count: usize, range: VolumeRange, work: &mut Work, segments: &mut Segments) {
    if profile.occupied().is_none() {
        return;
    }
    let reference_m = REFERENCE * (range.far_m - range.near_m);
    work.features.clear();
    work.features.extend((0..profile.len()).map(|slice| {
        let length = profile.depth[slice + 1] - profile.depth[slice];
        let opacity = -(-profile.optical_depth[slice] / length * reference_m).exp_m1();
        (opacity * profile.source[slice]).extend(opacity)
    }));
    // What any threshold joins.
    let brightest = profile.source.iter().copied().fold(Vec3::ONE, Vec3::max).max_element();
    let (mut low, mut high) = (0.0, 1.5 * brightest);
    for _ in 0..STEPS {
        let middle = 0.5 * (low + high);
        join(profile, &work.features, middle, count, &mut work.slices);
        if work.slices.len() <= count {
            high = middle;
        } else {
            low = middle;
        }
    }
    join(profile, &work.features, high, count, &mut work.slices);
    segments.extend(work.slices.iter().take(count).filter_map(|slices| profile.segment(slices.clone())));
}

/// Memory to work in.
#[derive(Debug, Default)]
pub(super) struct Work {
    features: Vec<Vec4>,
    slices: Vec<Range<usize>>,
}

/// Joins slices that differ by less than the threshold; gives up once there are more than `most` segments.
fn join(profile: &Profile, features: &[Vec4], threshold: f32, most: usize, joined: &mut Vec<Range<usize>>) {
    joined.clear();
    let mut mean = Vec4::ZERO;
    let mut members = 0.0;
    let mut current: Option<Range<usize>> = None;
    for (slice, &feature) in features.iter().enumerate() {
        let is_matter = profile.optical_depth[slice] > 0.0;
        match &mut current {
            Some(range) if (feature - mean).abs().max_element() <= threshold => {
                members += 1.0;
                mean += (feature - mean) / members;
                if is_matter {
                    range.end = slice + 1;
                }
            }
            _ => {
                joined.extend(current.take());
                if joined.len() > most {
                    return;
                }
                if is_matter {
                    current = Some(slice..slice + 1);
                    (mean, members) = (feature, 1.0);
                }
            }
        }
    }
    joined.extend(current);
}
