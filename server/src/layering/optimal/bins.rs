//! Slices to bins, fast: what [`super::reduce`] does, for live frames.
//!
//! Opacities and sums are made for all slices first, in loops that the compiler turns into vectors; the walk over
//! the slices that is left is a chain of few additions and products, in f32. A bin is summed up in f64 every
//! [`EXACTLY`] slices, so that one of thousands is as exact as one of ten. A bin keeps its opacity: a segment of bins
//! needs no exponential then.
//!
//! Against the plain form: sums are added in another order, so a border may stand a slice earlier or later where the
//! share of a bin is full to rounding. What the bins do together is the same to 1e-6.

use super::reduce::{LENGTH, OPACITY, OPTICAL_DEPTH};
use super::{CANDIDATES, Profile};
use crate::layering::opacity::opacity;
use glam::{DVec3, Vec3};
use std::ops::Range;
use warplight_protocol::frame::VolumeSegment;

/// Slices that are summed in f32 before they are added in f64: 64 roundings are 4e-6 at worst, 5e-7 by chance.
const EXACTLY: usize = 64;
/// Partial sums of a loop: a vector of AVX-512.
const PARTS: usize = 16;

/// Bins of a ray, at most [`CANDIDATES`].
#[derive(Clone, Debug)]
pub(super) struct Bins {
    len: usize,
    /// Depths in view of the borders, one more than there are bins.
    depth: [f32; CANDIDATES + 1],
    optical_depth: [f32; CANDIDATES],
    opacity: [f32; CANDIDATES],
    source: [Vec3; CANDIDATES],
    /// Of the slices: opacities, and what they count for beside those.
    opacities: Vec<f32>,
    shares: Vec<f32>,
}

impl Default for Bins {
    fn default() -> Bins {
        Bins {
            len: 0,
            depth: [0.0; CANDIDATES + 1],
            optical_depth: [0.0; CANDIDATES],
            opacity: [0.0; CANDIDATES],
            source: [Vec3::ZERO; CANDIDATES],
            opacities: Vec::new(),
            shares: Vec::new(),
        }
    }
}

/// What some slices do together.
#[derive(Clone, Copy)]
struct Sum {
    radiance: DVec3,
    opacity: f64,
    optical_depth: f64,
    transmittance: f64,
}

impl Sum {
    const EMPTY: Sum = Sum { radiance: DVec3::ZERO, opacity: 0.0, optical_depth: 0.0, transmittance: 1.0 };

    #[inline(always)]
    fn add(&mut self, radiance: Vec3, opacity: f32, optical_depth: f32, transmittance: f64) {
        self.radiance += self.transmittance * radiance.as_dvec3();
        self.opacity += self.transmittance * f64::from(opacity);
        self.optical_depth += f64::from(optical_depth);
        self.transmittance *= transmittance;
    }

    /// Radiance of it were it infinitely thick. What is too thin to be seen has none.
    #[inline(always)]
    fn source(&self) -> Vec3 {
        let source = if self.opacity > 1e-30 { self.radiance / self.opacity } else { DVec3::ZERO };
        source.as_vec3()
    }
}

impl Bins {
    /// Number of bins.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Length of all bins, in metres; 0 without any.
    pub(super) fn length_m(&self) -> f32 {
        self.depth[self.len] - self.depth[0]
    }

    /// Where the bin ends, from the start of the first, in metres; its optical depth; its source radiance.
    #[inline(always)]
    pub(super) fn at(&self, bin: usize) -> (f32, f32, Vec3) {
        (self.depth[bin + 1] - self.depth[0], self.optical_depth[bin], self.source[bin])
    }

    /// The segment that does what these bins do together; `None` where they are empty.
    pub(super) fn segment(&self, bins: Range<usize>) -> Option<VolumeSegment> {
        let mut sum = Sum::EMPTY;
        for bin in bins.clone() {
            let opacity = self.opacity[bin];
            let left = 1.0 - f64::from(opacity);
            sum.add(opacity * self.source[bin], opacity, self.optical_depth[bin], left);
        }
        let (front_m, back_m) = (self.depth[bins.start], self.depth[bins.end]);
        let optical_depth = sum.optical_depth as f32;
        (optical_depth > 0.0 && back_m > front_m).then(|| VolumeSegment {
            front_m,
            back_m,
            optical_depth,
            source: sum.source(),
        })
    }

    /// Joins the slices of a ray, with the instructions that the machine has.
    pub(super) fn reduce(&mut self, profile: &Profile) {
        #[cfg(target_arch = "x86_64")]
        {
            if std::arch::is_x86_feature_detected!("avx512f") && std::arch::is_x86_feature_detected!("fma") {
                // SAFETY: the features have been found.
                #[allow(unsafe_code)]
                return unsafe { self.reduce_avx512(profile) };
            }
            if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
                // SAFETY: the features have been found.
                #[allow(unsafe_code)]
                return unsafe { self.reduce_avx2(profile) };
            }
        }
        self.reduce_portably(profile);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,fma")]
    fn reduce_avx512(&mut self, profile: &Profile) {
        self.reduce_portably(profile);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn reduce_avx2(&mut self, profile: &Profile) {
        self.reduce_portably(profile);
    }

    #[inline(always)]
    fn reduce_portably(&mut self, profile: &Profile) {
        self.len = 0;
        self.depth[0] = 0.0;
        let Some(occupied) = profile.occupied() else { return };
        let count = occupied.len();
        let optical_depth = &profile.optical_depth[occupied.clone()];
        let source = &profile.source[occupied.clone()];
        let depth = &profile.depth[occupied.start..occupied.end + 1];
        let (total, occupied_m, changes) = measure(optical_depth, depth);

        // Bins that are not needed where matter begins and ends: shared out by importance.
        let free = (CANDIDATES as f32 - changes - 1.0).max(1.0);
        let per_metre = LENGTH * free / occupied_m;
        let per_opacity = OPACITY * free / opacity(total);
        let per_optical_depth = OPTICAL_DEPTH * free / total;
        let Bins { opacities, shares, .. } = self;
        opacities.resize(opacities.len().max(count), 0.0);
        shares.resize(shares.len().max(count), 0.0);
        let (opacities, shares) = (&mut opacities[..count], &mut shares[..count]);
        for slice in 0..count {
            let own = optical_depth[slice];
            opacities[slice] = opacity(own);
            let length = if own > 0.0 { depth[slice + 1] - depth[slice] } else { 0.0 };
            shares[slice] = per_metre * length + per_optical_depth * own;
        }

        self.depth[0] = depth[0];
        let mut len = 0;
        let mut importance = 0.0;
        // Transmittance from the eye to the last of the bins, times the weight of opacity.
        let mut weight = per_opacity;
        let mut bin = Sum::EMPTY;
        let mut bin_left = 1.0;
        let (mut radiance, mut covered, mut sum, mut left) = (Vec3::ZERO, 0.0_f32, 0.0_f32, 1.0_f32);
        let mut next_flush = EXACTLY;
        for slice in 0..count {
            let own = optical_depth[slice];
            let seen = left * opacities[slice];
            radiance += seen * source[slice];
            covered += seen;
            sum += own;
            left *= 1.0 - opacities[slice];
            importance += shares[slice] + weight * bin_left * seen;
            let is_last = slice + 1 == count;
            let changes = !is_last && (own > 0.0) != (optical_depth[slice + 1] > 0.0);
            let ends = is_last || ((changes || importance >= 1.0) && len + 1 < CANDIDATES);
            if ends || slice >= next_flush {
                bin.add(radiance, covered, sum, f64::from(left));
                bin_left = bin.transmittance as f32;
                (radiance, covered, sum, left) = (Vec3::ZERO, 0.0, 0.0, 1.0);
                next_flush = slice + EXACTLY;
            }
            if ends {
                self.depth[len + 1] = depth[slice + 1];
                self.optical_depth[len] = bin.optical_depth as f32;
                self.opacity[len] = bin.opacity as f32;
                self.source[len] = bin.source();
                len += 1;
                weight *= bin_left;
                (bin, bin_left) = (Sum::EMPTY, 1.0);
                // What is over counts for the next bin, unless matter ended.
                importance = if changes { 0.0 } else { (importance - 1.0).clamp(0.0, 1.0) };
            }
        }
        self.len = len;
    }
}

/// Optical depth, length with matter, and how often matter begins or ends.
#[inline(always)]
fn measure(optical_depth: &[f32], depth: &[f32]) -> (f32, f32, f32) {
    let count = optical_depth.len();
    let (mut totals, mut lengths, mut changes) = ([0.0_f32; PARTS], [0.0_f32; PARTS], [0.0_f32; PARTS]);
    let mut start = 0;
    // The last slice has matter, and none behind it that it could differ from.
    while start + PARTS < count {
        let own = &optical_depth[start..start + PARTS];
        let next = &optical_depth[start + 1..start + PARTS + 1];
        let (front, back) = (&depth[start..start + PARTS], &depth[start + 1..start + PARTS + 1]);
        for part in 0..PARTS {
            totals[part] += own[part];
            lengths[part] += if own[part] > 0.0 { back[part] - front[part] } else { 0.0 };
            changes[part] += if (own[part] > 0.0) != (next[part] > 0.0) { 1.0 } else { 0.0 };
        }
        start += PARTS;
    }
    for slice in start..count {
        let (own, part) = (optical_depth[slice], slice - start);
        totals[part] += own;
        lengths[part] += if own > 0.0 { depth[slice + 1] - depth[slice] } else { 0.0 };
        changes[part] += if slice + 1 < count && (own > 0.0) != (optical_depth[slice + 1] > 0.0) { 1.0 } else { 0.0 };
    }
    (totals.iter().sum(), lengths.iter().sum(), changes.iter().sum())
}

#[cfg(test)]
impl Bins {
    /// The bins as slices.
    pub(super) fn to_profile(&self) -> Profile {
        Profile {
            depth: if self.len > 0 { self.depth[..=self.len].to_vec() } else { Vec::new() },
            optical_depth: self.optical_depth[..self.len].to_vec(),
            source: self.source[..self.len].to_vec(),
        }
    }

    /// Slices that are at most as many as bins, as they are.
    pub(super) fn of_few(profile: &Profile) -> Bins {
        let mut bins = Bins { len: profile.len(), ..Bins::default() };
        bins.depth[..profile.depth.len()].copy_from_slice(&profile.depth);
        for bin in 0..profile.len() {
            bins.optical_depth[bin] = profile.optical_depth[bin];
            bins.opacity[bin] = opacity(profile.optical_depth[bin]);
            bins.source[bin] = profile.source[bin];
        }
        bins
    }
}

#[cfg(test)]
mod tests {
    use super::super::random;
    use super::super::reduce::reduce;
    use super::*;

    /// Patches of matter of many magnitudes from a hash.
    fn ray(seed: u32, slices: usize) -> Profile {
        let mut next = random(seed);
        let mut ray = Profile::default();
        ray.start(1.0 + next());
        let (mut is_matter, mut magnitude) = (true, -2.0);
        for slice in 0..slices {
            if next() < 0.04 {
                is_matter = !is_matter;
                magnitude = 5.0 * next() - 5.0;
            }
            let optical_depth = if is_matter { 10.0_f32.powf(magnitude + 0.3 * next()) } else { 0.0 };
            let end = ray.depth[slice] + 0.005 + 0.001 * next();
            ray.push(end, optical_depth, Vec3::new(next(), 0.1, 10.0 * next()));
        }
        ray
    }

    #[test]
    fn bins_are_those_of_the_plain_form() {
        let (mut bins, mut plain) = (Bins::default(), Profile::default());
        let mut same_borders = 0;
        for seed in 0..400 {
            let ray = ray(seed, [0, 1, 5, 16, 17, 40, 130, 600, 4000][seed as usize % 9]);
            bins.reduce(&ray);
            reduce(&ray, CANDIDATES, &mut plain);
            let found = bins.to_profile();
            assert!(found.len() <= CANDIDATES && found.len().abs_diff(plain.len()) <= 1, "{seed}");
            same_borders += usize::from(found.depth == plain.depth);
            if found.depth == plain.depth {
                for bin in 0..found.len() {
                    let (own, other) = (found.optical_depth[bin], plain.optical_depth[bin]);
                    assert!((own - other).abs() <= 4e-6 * other, "{seed}: {own} {other}");
                    let (own, other) = (found.source[bin], plain.source[bin]);
                    assert!((own - other).abs().max_element() <= 4e-6 * other.max_element(), "{seed}: {own} {other}");
                }
            }
            // Together they are the ray, as one segment and as many.
            let (radiance, transmittance) = ray.compose();
            let (own, left) = found.compose();
            assert!((own - radiance).abs().max_element() <= 4e-6 * radiance.max_element(), "{seed}");
            assert!((left - transmittance).abs() <= 1e-6, "{seed}");
            let whole = (!ray.is_empty()).then(|| bins.segment(0..bins.len())).flatten().unwrap_or_default();
            let shown = whole.opacity() * whole.source;
            assert!((shown - radiance).abs().max_element() <= 4e-6 * radiance.max_element(), "{seed}");
        }
        assert!(same_borders > 380, "{same_borders} of 400");
    }
}
