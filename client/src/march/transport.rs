//! What a ray gathers, segment by segment, from the eye on.
//!
//! A segment of optical depth tau and source radiance S sends `S (1 - exp(-tau))` to its front (Lochmann et al. 2016,
//! eq. 3.2 of the thesis, where it is written with the segment's opacity). A new ray that is `z'` long within a segment
//! of length `z` sees `tau' = tau z' / z`. Written with `expm1`, what it sends goes over into `S tau'` for thin segments,
//! where `1 - exp` in floats is zero below 6e-8 and off by 8 % at 1e-6.
//!
//! Two forms: [`Transport`] in f64, the plain one, and [`attenuation`] for lanes of floats, in powers of two.

use crate::lanes::{Floats, Integers};
use glam::DVec3;

/// The light that a ray has gathered, and how much of what is behind still comes through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Transport {
    pub(super) radiance: DVec3,
    pub(super) transmittance: f64,
}

impl Default for Transport {
    fn default() -> Transport {
        Transport { radiance: DVec3::ZERO, transmittance: 1.0 }
    }
}

impl Transport {
    /// Goes on through homogeneous matter.
    pub(super) fn cross(&mut self, optical_depth: f64, source: DVec3) {
        let opacity = -(-optical_depth).exp_m1();
        self.radiance += source * (self.transmittance * opacity);
        self.transmittance *= (-optical_depth).exp();
    }

    /// Goes on through something already composed.
    pub(super) fn compose(&mut self, behind: &Transport) {
        self.radiance += behind.radiance * self.transmittance;
        self.transmittance *= behind.transmittance;
    }
}

/// `1 - 2^-x` for x of 0 and more, to 2e-6 relative everywhere: with `x = n + f`, |f| <= 1/2, it is
/// `(1 - 2^-n) - 2^-n (2^-f - 1)`, and the last factor is `f` times a polynomial, so that nothing is lost as x goes to 0.
#[inline(always)]
pub(super) fn attenuation<F: Floats>(x: F) -> F {
    // Beyond 2^-100 nothing is left; no exponent runs over.
    let x = -x.min(F::splat(100.0));
    // Adding this rounds to whole numbers and leaves them in the lowest bits.
    let magic = F::splat(12_582_912.0);
    let shifted = x + magic;
    let whole = shifted - magic;
    let fraction = x - whole;
    let scale = (shifted.as_integers().shift_left_23() + F::Integers::splat(127 << 23)).as_floats();
    // (2^f - 1) / f: the series of exp(f ln 2); the first term left out is 1e-7 of the first.
    let series = F::splat(1.540_353e-4)
        .mul_add(fraction, F::splat(1.333_355_8e-3))
        .mul_add(fraction, F::splat(9.618_129e-3))
        .mul_add(fraction, F::splat(5.550_411e-2))
        .mul_add(fraction, F::splat(2.402_265e-1))
        .mul_add(fraction, F::splat(std::f32::consts::LN_2));
    (F::splat(1.0) - scale) - scale * (fraction * series)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Level, kernel};
    use crate::stability::bound;

    /// From almost clear to black, and from nothing of a segment to a thousandfold of it.
    #[test]
    fn stability_segment_reintegration() {
        let mut off = bound!("segment", "light of a part of a segment off f64, relative", 1e-5);
        let mut limit = bound!("segment", "of the thinnest, off its share z' / z, relative", 1e-5);
        let mut undefined = bound!("segment", "light that falls with tau, is below 0 or above its source", 0.0);
        let thicknesses = || (-120..=40).map(|exponent| 10.0_f64.powf(f64::from(exponent) * 0.1));
        let parts = [0.0, 1e-6, 1e-3, 0.5, 1.0, 30.0, 1000.0];
        for level in Level::available() {
            for part in parts {
                let x: Vec<f32> = thicknesses().map(|tau| (tau * part * std::f64::consts::LOG2_E) as f32).collect();
                let mut found = vec![0.0; x.len().next_multiple_of(16)];
                let mut padded = x.clone();
                padded.resize(found.len(), 0.0);
                run_attenuations(level, &padded, &mut found);
                for (index, (&x, &found)) in x.iter().zip(&found).enumerate() {
                    let oracle = -(-f64::from(x) * std::f64::consts::LN_2).exp_m1();
                    if oracle > 0.0 {
                        off.see((f64::from(found) / oracle - 1.0).abs(), format!("{level:?} {x}"));
                    }
                    undefined.count(!(0.0..=1.0).contains(&found), format!("{level:?} {x}"));
                    // Beyond opacity all are 1, to a rounding.
                    let before = found_before(&padded, index, level);
                    undefined.count(found < before - f32::EPSILON * before, format!("{level:?} {x} {before} {found}"));
                }
                if part > 0.0 {
                    let mut whole = vec![0.0; 16];
                    run_attenuations(level, &[(1e-12 * std::f64::consts::LOG2_E) as f32; 16], &mut whole);
                    let ratio = f64::from(found[0]) / f64::from(whole[0]);
                    // A thousandfold of 1e-12 is still thin: what is left out is 5e-10 of it.
                    limit.see((ratio / part - 1.0).abs(), format!("{level:?} {part}"));
                }
            }
        }
        let mut plain = bound!("segment", "the same in the plain walk", 1e-5);
        let mut last = 0.0;
        for tau in thicknesses() {
            for part in parts {
                let mut ray = Transport::default();
                ray.cross(tau * part, DVec3::ONE);
                let series = tau * part * (1.0 - tau * part * (0.5 - tau * part / 6.0));
                let oracle = if tau * part < 1e-3 { series } else { 1.0 - (-tau * part).exp() };
                if oracle > 0.0 {
                    plain.see((ray.radiance.x / oracle - 1.0).abs(), format!("{tau} {part}"));
                }
                assert!((ray.radiance.x + ray.transmittance - 1.0).abs() < 1e-12 && ray.transmittance >= 0.0);
            }
            let mut ray = Transport::default();
            ray.cross(tau, DVec3::ONE);
            assert!(ray.radiance.x > last || last == 1.0, "monotone");
            last = ray.radiance.x;
        }
    }

    /// The attenuation of the thickness before this one.
    fn found_before(x: &[f32], index: usize, level: Level) -> f32 {
        let mut found = vec![0.0; 16];
        run_attenuations(level, &[x[index.saturating_sub(1)]; 16], &mut found);
        if index == 0 { 0.0 } else { found[0] }
    }

    /// A hundred thousand thin segments are one thick one; one of 10^4 is black.
    #[test]
    fn stability_transmittance_of_a_marched_ray() {
        let mut off = bound!("transmittance", "1e5 segments of the march, relative", 1e-5);
        let mut beyond =
            bound!("transmittance", "negative in the march, or light above its source, or left of tau 1e4", 0.0);
        for tau in [1e-8, 3e-5, 1e-4] {
            let mut ray = Transport::default();
            for _ in 0..100_000 {
                ray.cross(tau, DVec3::ONE);
            }
            off.see((ray.transmittance / (-1e5 * tau).exp() - 1.0).abs(), tau);
            off.see((ray.radiance.x / -(-1e5 * tau).exp_m1() - 1.0).abs(), tau);
            ray.cross(1e4, DVec3::ONE);
            beyond.count(ray.transmittance != 0.0 || ray.radiance.x > 1.0 + 1e-9, tau);
        }
    }

    #[inline(always)]
    fn all_attenuations<F: Floats>(x: &[f32], results: &mut [f32]) {
        for at in (0..x.len()).step_by(F::LANES) {
            attenuation(F::load(x, at)).store(results, at);
        }
    }
    kernel!(fn run_attenuations = all_attenuations(x: &[f32], results: &mut [f32]));

    #[test]
    fn attenuation_in_lanes_is_that_in_f64_to_a_hundred_thousandth() {
        let x: Vec<f32> =
            (0..4000).map(|i| 10.0_f32.powf(i as f32 * 0.004 - 12.0)).chain([0.0, f32::INFINITY]).collect();
        for level in Level::available() {
            let mut results = vec![0.0; x.len()];
            run_attenuations(level, &x, &mut results);
            for (&x, &found) in x.iter().zip(&results) {
                let oracle = -(-f64::from(x) * std::f64::consts::LN_2).exp_m1();
                assert!((f64::from(found) - oracle).abs() <= 1e-5 * oracle, "{level:?} {x}: {found} {oracle}");
                assert!((0.0..=1.0).contains(&found), "{level:?} {x}: {found}");
            }
        }
    }
}
