//! Display codes of many channels at once: the sRGB curve (IEC 61966-2-1) as a polynomial of the fourth root.
//!
//! `255 (1.055 x^(5/12) - 0.055)` is smooth in `s = x^(1/4)` over the curve's part of [0, 1], so that degree 6 comes within
//! 6e-4 codes of it: a code differs from the exact one only where a value lies so near to a step, and then by one. Two
//! square roots and six multiplications for as many channels as there are lanes; a look-up per channel costs three
//! times that. What must be exact, the picture of an unmoved head, goes through
//! [`warplight_protocol::tone::ToneTable`].

use crate::lanes::Floats;
use std::sync::LazyLock;
use warplight_protocol::tone::ToneTable;

/// Interpolation at the Chebyshev nodes of [0.0031308^(1/4), 1], lowest power first.
const CURVE: [f32; 7] = [-15.233_448, 36.199_356, 345.416_02, -210.446_41, 158.355_58, -75.033_15, 15.742_249];
/// Below, the curve is a line.
const TOE: f32 = 0.003_130_8;

/// Display codes of linear values; of what is not a number, 0.
#[inline(always)]
pub(super) fn srgb8_from_linear<F: Floats>(linear: F) -> F::Integers {
    let value = linear.within(0.0, 1.0);
    let root = value.sqrt().sqrt();
    let mut curve = F::splat(CURVE[6]);
    for power in (0..6).rev() {
        curve = curve.mul_add(root, F::splat(CURVE[power]));
    }
    let code = (value * F::splat(255.0 * 12.92)).or(value.lt(F::splat(TOE)), curve);
    (code + F::splat(0.5)).truncate()
}

/// The exact table.
pub(super) fn exact() -> &'static ToneTable {
    static TABLE: LazyLock<ToneTable> = LazyLock::new(ToneTable::default);
    &TABLE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Level, kernel};
    use crate::stability::bound;

    #[inline(always)]
    fn all_codes<F: Floats>(values: &[f32], codes: &mut [u32]) {
        use crate::lanes::Integers;
        for at in (0..values.len()).step_by(F::LANES) {
            srgb8_from_linear(F::load(values, at)).store(codes, at);
        }
    }

    kernel!(fn run_all_codes = all_codes(values: &[f32], codes: &mut [u32]));

    #[test]
    fn the_curve_is_exact_but_for_values_next_to_a_step() {
        let steps: Vec<f32> = (0..=1_000_000).map(|step| step as f32 / 970_000.0).collect();
        for level in Level::available() {
            let mut codes = vec![0; steps.len()];
            run_all_codes(level, &steps, &mut codes);
            let exact = |value: &f32| i64::from(exact().srgb8_from_linear(*value));
            let differences = || codes.iter().zip(&steps).map(|(code, value)| (i64::from(*code) - exact(value)).abs());
            assert_eq!(differences().max(), Some(1), "{level:?}");
            // 6e-4 codes on either side of every step.
            let differing = differences().filter(|&difference| difference > 0).count();
            assert!(differing < steps.len() * 12 / 10_000, "{level:?}: {differing}");
        }
    }

    #[test]
    fn stability_tone_mapping_in_lanes() {
        let extremes = [f32::NAN, f32::NEG_INFINITY, -0.0, 0.0, 1e-40, 1.0, 1e8, f32::INFINITY];
        let mut wrong = bound!("tone mapping", "in lanes: hard cases whose code is not that of the formula", 0.0);
        let mut falls = bound!("tone mapping", "in lanes: codes that fall where radiance rises", 0.0);
        let rising: Vec<f32> = (0..160_000).map(|step| step as f32 / 155_000.0).collect();
        for level in Level::available() {
            let mut codes = vec![7; extremes.len()];
            run_all_codes(level, &extremes, &mut codes);
            for (value, code) in extremes.iter().zip(&codes) {
                wrong.count(
                    i64::from(*code) != i64::from(exact().srgb8_from_linear(*value)),
                    format!("{level:?} {value}"),
                );
            }
            let mut codes = vec![0; rising.len()];
            run_all_codes(level, &rising, &mut codes);
            codes.windows(2).for_each(|pair| falls.count(pair[0] > pair[1], format!("{level:?} {}", pair[0])));
        }
    }
}
