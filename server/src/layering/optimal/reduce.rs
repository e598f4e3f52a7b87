//! Slices to bins: the borders between which a program chooses. The plain form, for any number of bins.

use crate::layering::Profile;
use crate::layering::profile::Composed;

/// Shares of a ray's length, opacity and optical depth in what a bin holds.
pub(super) const LENGTH: f32 = 0.4;
pub(super) const OPACITY: f32 = 0.45;
pub(super) const OPTICAL_DEPTH: f32 = 0.15;

/// Joins the slices of a ray to at most `most` bins. Empty ones stay apart from those with matter, as far as there is
/// room: of more changes than bins the last are joined.
pub(super) fn reduce(profile: &Profile, most: usize, bins: &mut Profile) {
    bins.clear();
    let Some(occupied) = profile.occupied() else { return };
    let optical_depths = &profile.optical_depth[occupied.clone()];
    let changes = optical_depths.windows(2).filter(|pair| (pair[0] > 0.0) != (pair[1] > 0.0)).count();
    let total: f32 = optical_depths.iter().sum();
    let occupied_m = optical_depths
        .iter()
        .zip(profile.depth[occupied.start..].windows(2))
        .map(|(&optical_depth, ends)| if optical_depth > 0.0 { ends[1] - ends[0] } else { 0.0 })
        .sum::<f32>();
    // Bins that are not needed where matter begins and ends: shared out by importance.
    let free = (most as f32 - changes as f32 - 1.0).max(1.0);
    let per_metre = LENGTH * free / occupied_m;
    let per_opacity = OPACITY * free / -(-total).exp_m1();
    let per_optical_depth = OPTICAL_DEPTH * free / total;

    bins.start(profile.depth[occupied.start]);
    let mut bin = Composed::default();
    let (mut importance, mut transmittance) = (0.0, 1.0_f32);
    for slice in occupied.clone() {
        let optical_depth = profile.optical_depth[slice];
        bin.add(optical_depth, profile.source[slice]);
        let end = profile.depth[slice + 1];
        if optical_depth > 0.0 {
            let opacity = -(-optical_depth).exp_m1();
            let length = end - profile.depth[slice];
            importance +=
                per_metre * length + per_opacity * transmittance * opacity + per_optical_depth * optical_depth;
            transmittance *= 1.0 - opacity;
        }
        let is_last = slice + 1 == occupied.end;
        let changes = !is_last && (optical_depth > 0.0) != (profile.optical_depth[slice + 1] > 0.0);
        let has_room = bins.len() + 1 < most;
        if is_last || (has_room && (changes || importance >= 1.0)) {
            let front = bins.depth.last().copied().unwrap_or_default();
            let segment = bin.segment(front, end).unwrap_or_default();
            bins.push(end, segment.optical_depth, segment.source);
            bin = Composed::default();
            // What is over counts for the next bin, unless matter ended.
            importance = if changes { 0.0 } else { (importance - 1.0).clamp(0.0, 1.0) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn profile(optical_depths: impl IntoIterator<Item = f32>) -> Profile {
        let mut profile = Profile::default();
        profile.start(1.0);
        for (index, optical_depth) in optical_depths.into_iter().enumerate() {
            profile.push(1.0 + 0.01 * (index + 1) as f32, optical_depth, Vec3::new(1.0, 0.1 * index as f32, 0.0));
        }
        profile
    }

    #[test]
    fn bins_do_what_the_slices_do_and_are_not_too_many() {
        for most in [1, 2, 8, 32, 56] {
            let ray = profile((0..300).map(|index| if index / 40 % 2 == 0 { 0.002 * (index % 7) as f32 } else { 0.0 }));
            let mut bins = Profile::default();
            reduce(&ray, most, &mut bins);
            assert!(bins.len() <= most && bins.len() >= most.min(8), "{} of {most}", bins.len());
            let ((a, t), (b, u)) = (ray.compose(), bins.compose());
            assert!((a - b).abs().max_element() < 1e-5 * a.max_element() && (t - u).abs() < 1e-6, "{a} {b}");
        }
    }

    #[test]
    fn matter_begins_and_ends_at_borders() {
        let ray = profile([0.0, 0.1, 0.1, 0.0, 0.0, 0.2, 0.0]);
        let mut bins = Profile::default();
        reduce(&ray, 32, &mut bins);
        for border in [1, 3, 5, 6] {
            assert!(bins.depth.contains(&ray.depth[border]), "{:?}", bins.depth);
        }
        assert_eq!(bins.occupied(), Some(0..bins.len()));
        reduce(&profile([0.0; 5]), 32, &mut bins);
        assert!(bins.is_empty());
    }

    #[test]
    fn a_homogeneous_ray_has_all_the_bins_there_are() {
        let mut bins = Profile::default();
        reduce(&profile([0.01; 400]), 32, &mut bins);
        assert!(bins.len() >= 30, "{}", bins.len());
    }
}
