//! What a ray of view goes through: slices of homogeneous matter from the eye on.

use super::opacity::opacity;
use glam::{DVec3, Vec3};
use warplight_protocol::frame::VolumeSegment;

/// Slices of a ray, one behind the other. Slice `i` reaches from `depth[i]` to `depth[i + 1]`.
#[derive(Clone, Debug, Default)]
pub struct Profile {
    /// Depths in view of the borders, rising, in metres; one more than there are slices, or none.
    pub depth: Vec<f32>,
    /// Optical depth of each slice along the ray; 0: empty.
    pub optical_depth: Vec<f32>,
    /// Source radiance of each slice: what it would send to its front were it infinitely thick.
    pub source: Vec<Vec3>,
}

impl Profile {
    /// Forgets all slices and keeps the memory.
    pub fn clear(&mut self) {
        self.depth.clear();
        self.optical_depth.clear();
        self.source.clear();
    }

    /// Starts at a depth; what lies between the last slice and there is empty.
    pub fn start(&mut self, depth_m: f32) {
        match self.depth.last() {
            None => self.depth.push(depth_m),
            Some(&last) if depth_m > last => self.push(depth_m, 0.0, Vec3::ZERO),
            Some(_) => {}
        }
    }

    /// Adds a slice that ends at a depth. What has no length or no number is nothing.
    pub fn push(&mut self, end_m: f32, optical_depth: f32, source: Vec3) {
        debug_assert!(!self.depth.is_empty(), "a ray starts somewhere");
        if self.depth.last().is_some_and(|&last| end_m > last) {
            let is_matter = optical_depth > 0.0 && optical_depth.is_finite() && source.is_finite();
            self.depth.push(end_m);
            self.optical_depth.push(if is_matter { optical_depth } else { 0.0 });
            self.source.push(if is_matter { source } else { Vec3::ZERO });
        }
    }

    /// Number of slices.
    pub fn len(&self) -> usize {
        self.optical_depth.len()
    }

    /// Whether there is no slice.
    pub fn is_empty(&self) -> bool {
        self.optical_depth.is_empty()
    }

    /// The slices from the first to behind the last that holds matter; `None` where none does.
    pub fn occupied(&self) -> Option<std::ops::Range<usize>> {
        let is_matter = |&optical_depth: &f32| optical_depth > 0.0;
        let first = self.optical_depth.iter().position(is_matter)?;
        let last = self.optical_depth.iter().rposition(is_matter)?;
        Some(first..last + 1)
    }

    /// Radiance that the whole ray gathers, and its transmittance.
    pub fn compose(&self) -> (Vec3, f32) {
        let mut ray = Composed::default();
        for (&optical_depth, &source) in self.optical_depth.iter().zip(&self.source) {
            ray.add(optical_depth, source);
        }
        (ray.radiance.as_vec3(), (-ray.optical_depth).exp() as f32)
    }

    /// The segment that does what these slices do together; `None` where they are empty.
    pub fn segment(&self, slices: std::ops::Range<usize>) -> Option<VolumeSegment> {
        let mut ray = Composed::default();
        for slice in slices.clone() {
            ray.add(self.optical_depth[slice], self.source[slice]);
        }
        ray.segment(self.depth[slices.start], self.depth[slices.end])
    }

    /// The segment that does what lies between two depths; `None` where that is empty.
    pub fn segment_between(&self, front_m: f32, back_m: f32) -> Option<VolumeSegment> {
        let mut ray = Composed::default();
        let first = self.depth.partition_point(|&depth| depth <= front_m).saturating_sub(1);
        for slice in first..self.len() {
            let (start, end) = (self.depth[slice], self.depth[slice + 1]);
            if start >= back_m {
                break;
            }
            let part = (end.min(back_m) - start.max(front_m)).max(0.0) / (end - start);
            ray.add(part * self.optical_depth[slice], self.source[slice]);
        }
        ray.segment(front_m, back_m)
    }
}

/// What a ray has gathered so far; in f64, since a ray may have 1e5 slices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Composed {
    radiance: DVec3,
    optical_depth: f64,
    transmittance: f64,
}

impl Default for Composed {
    fn default() -> Composed {
        Composed { radiance: DVec3::ZERO, optical_depth: 0.0, transmittance: 1.0 }
    }
}

impl Composed {
    #[inline(always)]
    pub(super) fn add(&mut self, optical_depth: f32, source: Vec3) {
        if optical_depth > 0.0 {
            let opacity = f64::from(opacity(optical_depth));
            self.radiance += self.transmittance * opacity * source.as_dvec3();
            self.transmittance *= 1.0 - opacity;
            self.optical_depth += f64::from(optical_depth);
        }
    }

    pub(super) fn segment(&self, front_m: f32, back_m: f32) -> Option<VolumeSegment> {
        let optical_depth = self.optical_depth as f32;
        let opacity = -(-self.optical_depth).exp_m1();
        (optical_depth > 0.0 && back_m > front_m).then(|| VolumeSegment {
            front_m,
            back_m,
            optical_depth,
            // An optical depth so small that it has no inverse lets nothing be seen.
            source: if opacity > 1e-30 { (self.radiance / opacity).as_vec3() } else { Vec3::ZERO },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;

    fn profile(slices: &[(f32, f32)]) -> Profile {
        let mut profile = Profile::default();
        profile.start(1.0);
        for (index, &(optical_depth, source)) in slices.iter().enumerate() {
            profile.push(1.0 + 0.5 * (index + 1) as f32, optical_depth, Vec3::splat(source));
        }
        profile
    }

    #[test]
    fn a_segment_does_what_its_slices_do() {
        let profile = profile(&[(0.3, 1.0), (0.0, 0.0), (2.0, 0.2), (1e-7, 5.0)]);
        let (radiance, transmittance) = profile.compose();
        let whole = profile.segment(0..4).unwrap();
        assert!((whole.source * whole.opacity() - radiance).abs().max_element() < 1e-6);
        assert!((1.0 - whole.opacity() - transmittance).abs() < 1e-7);
        let (front, back) = (profile.segment(0..1).unwrap(), profile.segment(1..4).unwrap());
        let composed = front.source * front.opacity() + (1.0 - front.opacity()) * back.source * back.opacity();
        assert!((composed - radiance).abs().max_element() < 1e-6);
        assert_eq!(profile.segment(1..2), None);
    }

    #[test]
    fn between_borders_it_takes_the_parts_of_slices() {
        let profile = profile(&[(0.3, 1.0), (0.8, 0.5)]);
        let part = profile.segment_between(1.25, 1.75).unwrap();
        assert!((part.optical_depth - 0.15 - 0.4).abs() < 1e-6);
        assert_eq!(
            profile.segment_between(0.0, 9.0).unwrap().optical_depth,
            profile.segment(0..2).unwrap().optical_depth
        );
        assert_eq!(profile.segment_between(5.0, 9.0), None);
    }

    #[test]
    fn stability_transmittance_of_a_profile() {
        let mut off = bound!("transmittance", "1e5 slices of a profile, relative", 1e-5);
        for tau in [1e-8_f32, 3e-5, 1e-4] {
            let mut many = Profile::default();
            many.start(0.0);
            for index in 0..100_000 {
                many.push((index + 1) as f32, tau, Vec3::ONE);
            }
            let (radiance, transmittance) = many.compose();
            let exact = -1e5 * f64::from(tau);
            off.see((f64::from(transmittance) / exact.exp() - 1.0).abs(), tau);
            off.see((f64::from(radiance.x) / -exact.exp_m1() - 1.0).abs(), tau);
            let whole = many.segment(0..100_000).unwrap();
            off.see((f64::from(whole.optical_depth) / -exact - 1.0).abs(), tau);
        }
        let mut opaque = Profile::default();
        opaque.start(0.0);
        opaque.push(1.0, 1e4, Vec3::ONE);
        assert_eq!(opaque.compose(), (Vec3::ONE, 0.0));
    }

    #[test]
    fn what_is_no_matter_is_empty() {
        let mut profile = Profile::default();
        profile.start(1.0);
        profile.push(2.0, f32::NAN, Vec3::ONE);
        profile.push(3.0, 1.0, Vec3::NAN);
        profile.push(2.5, 1.0, Vec3::ONE);
        profile.push(4.0, f32::INFINITY, Vec3::ONE);
        assert_eq!((profile.len(), profile.occupied()), (3, None));
        assert_eq!(Profile::default().occupied(), None);
        assert_eq!(Profile::default().compose(), (Vec3::ZERO, 1.0));
    }
}
