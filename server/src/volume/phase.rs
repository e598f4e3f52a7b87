//! How a medium scatters: where light goes from a point that it did not get past.
//!
//! Method: Henyey and Greenstein 1941, one parameter, the mean cosine g of the angle of deflection; drawn
//! exactly by inversion. Directions are those of travel: a deflection of 0 goes straight on.
//!
//! Limits: |g| is kept below [`Phase::MOST`], where the lobe is 0.1 degrees wide and its peak still far from
//! the largest f32.

use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// A phase function.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Phase {
    /// Mean cosine of the angle of deflection: 0 isotropic, towards 1 forward; within (-1, 1).
    pub g: f32,
}

impl Phase {
    /// The same in all directions.
    pub const ISOTROPIC: Phase = Phase { g: 0.0 };
    /// Largest |g|.
    pub const MOST: f32 = 0.999;

    /// Density over solid angle of a deflection with this cosine.
    pub fn density(self, cosine: f32) -> f32 {
        let g = self.usable();
        // 1 + g^2 - 2 g cos, without cancellation towards the peak.
        let squared = (1.0 - g.abs()).powi(2) + 2.0 * (g.abs() - g * cosine.clamp(-1.0, 1.0));
        (1.0 - g * g) / (4.0 * PI * squared * squared.sqrt())
    }

    /// A direction of travel after one along the unit vector `direction`, by its density.
    pub fn sample(self, direction: Vec3, u: Vec2) -> Vec3 {
        let g = self.usable();
        let axis = if g < 0.0 { -direction } else { direction };
        let g = g.abs();
        // The inverse of the cumulative density as 1 - cos, in which nothing cancels about the peak.
        let h = 2.0 * u.x;
        let from_peak = h * ((1.0 - g) / (1.0 + g - g * h)).powi(2) * (1.0 + g - 0.5 * g * h);
        let sine = (from_peak * (2.0 - from_peak)).max(0.0).sqrt();
        let (tangent, bitangent) = axis.any_orthonormal_pair();
        let (sin_phi, cos_phi) = (TAU * u.y).sin_cos();
        (sine * (cos_phi * tangent + sin_phi * bitangent) + (1.0 - from_peak) * axis).normalize_or(axis)
    }

    fn usable(self) -> f32 {
        if self.g.is_nan() { 0.0 } else { self.g.clamp(-Phase::MOST, Phase::MOST) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::sampler::Sampler;
    use crate::testing::chi_square::compare;

    /// From isotropic to lobes of a tenth of a degree, forward and back.
    #[test]
    fn deflections_are_drawn_by_their_density() {
        let direction = Vec3::new(0.36, -0.48, 0.8);
        for g in [0.0, 1e-6, 2e-3, 0.3, -0.5, 0.8, -0.95, 0.99] {
            let phase = Phase { g };
            let axis = if g < 0.0 { -direction } else { direction };
            let draw = |index| Some(phase.sample(direction, Sampler::new(3, u64::from(index), 0).pair()));
            let outcome = compare(axis, 100_000, draw, |towards| phase.density(direction.dot(towards)));
            // 670 cells, each integrated to 1e-6.
            assert!((outcome.integral - 1.0).abs() < 7e-4, "{g}: {outcome:?}");
            // Normal: 99.99 % of honest samplers stay below.
            assert!(outcome.z < 3.8, "{g}: {outcome:?}");
        }
    }

    #[test]
    fn the_mean_cosine_is_the_parameter() {
        for g in [0.0, 0.3, -0.7, 0.9] {
            let count = 20_000;
            let cosine = |index| Phase { g }.sample(Vec3::Z, Sampler::new(5, 0, index).pair()).z;
            let mean = (0..count).map(|index| f64::from(cosine(index))).sum::<f64>() / f64::from(count);
            assert!((mean - f64::from(g)).abs() < 1e-3, "{g}: {mean}");
        }
    }

    #[test]
    fn any_parameter_gives_directions_and_densities() {
        for g in [f32::NAN, 1.0, -1.0, 1e30, f32::NEG_INFINITY, -0.0] {
            for u in [Vec2::ZERO, Vec2::splat(1.0 - f32::EPSILON / 2.0), Vec2::new(0.5, 0.25)] {
                let towards = Phase { g }.sample(Vec3::Y, u);
                assert!(towards.is_normalized(), "{g} {u}");
                let density = Phase { g }.density(towards.y);
                assert!(density > 0.0 && density.is_finite(), "{g} {u}: {density}");
            }
        }
    }
}
