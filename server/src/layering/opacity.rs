//! Opacities of many slices: `1 - exp(-tau)` without a call for each.
//!
//! Part of the layering; most of its time were calls of `expm1`. Method: tau = n ln 2 + r with |r| at most half of ln 2 (ln 2
//! in two parts, so that n times the first is exact), expm1(-r) by its Taylor polynomial of degree 7, whose first term left out is 2e-8
//! of it, and `1 - exp(-tau) = (1 - 2^-n) - 2^-n expm1(-r)`. For n = 0 nothing is subtracted, so the smallest opacities
//! are as exact as the large ones: to 3e-7, a test says.
//!
//! Limits: tau is not negative; beyond 87 the opacity is 1. Cost: 20 instructions for as many slices as a vector holds;
//! it is inlined into functions that are compiled for an instruction set.

/// 1.5 * 2^23: a float to which a small one was added has that one, rounded to a whole number, in its lowest bits.
const ROUNDER: f32 = 12_582_912.0;
/// From here on 1 - exp(-tau) is 1, and 2^-n is no subnormal.
const OPAQUE: f32 = 87.0;
/// ln 2 = LN_2_HIGH + LN_2_LOW; the first has so few bits that its products with n are exact.
const LN_2_HIGH: f32 = 0.693_359_4;
const LN_2_LOW: f32 = -2.121_944_4e-4;

/// Fraction of what is behind that an optical depth does not let through.
#[inline(always)]
pub(super) fn opacity(optical_depth: f32) -> f32 {
    let x = if optical_depth < OPAQUE { optical_depth } else { OPAQUE };
    let rounded = x * std::f32::consts::LOG2_E + ROUNDER;
    let n = rounded - ROUNDER;
    let r = x - n * LN_2_HIGH - n * LN_2_LOW;
    let fourth = 1.0 / 24.0 - r * (1.0 / 120.0 - r * (1.0 / 720.0 - r * (1.0 / 5040.0)));
    // -expm1(-r)
    let part = r - r * r * (0.5 - r * (1.0 / 6.0 - r * fourth));
    // 2^-n: n from the exponent of 1.
    let scale = f32::from_bits(0x3f80_0000_u32.wrapping_sub(rounded.to_bits().wrapping_sub(ROUNDER.to_bits()) << 23));
    (1.0 - scale) + scale * part
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tau from 1e-30 to 1e4 against f64.
    #[test]
    fn opacities_are_those_of_f64() {
        let mut last = 0.0;
        for index in 0..=340_000 {
            let optical_depth = 10.0_f64.powf(-30.0 + 1e-4 * f64::from(index)) as f32;
            let (found, exact) = (opacity(optical_depth), -(-f64::from(optical_depth)).exp_m1());
            assert!((f64::from(found) / exact - 1.0).abs() < 3e-7, "{optical_depth}: {found} {exact}");
            // Rising, but for the rounding of the last place.
            assert!(found >= last * (1.0 - 3e-7) && found <= 1.0, "{optical_depth}");
            last = found;
        }
        assert_eq!([0.0, 90.0, 1e30, f32::INFINITY].map(opacity), [0.0, 1.0, 1.0, 1.0]);
    }
}
