//! From linear radiance to display codes: exposure, clamp, sRGB transfer (IEC 61966-2-1), 8 bits.
//!
//! Linear up to white, so that two pictures differ by what was rendered and not by a curve.

use glam::Vec3;

/// The display code of one linear channel value times `exposure`. Monotone; not a number and negative
/// values give 0, everything from 1 up gives 255.
pub fn srgb8_from_linear(linear: f32) -> u8 {
    let value = clamped(linear);
    let encoded = if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0 + 0.5) as u8
}

#[expect(clippy::manual_clamp, reason = "`max` drops NaN, `clamp` keeps it")]
#[inline]
fn clamped(linear: f32) -> f32 {
    linear.max(0.0).min(1.0)
}

/// Tone-maps a linear RGB radiance.
pub fn display_from_radiance(radiance: Vec3, exposure: f32) -> [u8; 3] {
    (radiance * exposure).to_array().map(srgb8_from_linear)
}

/// [`srgb8_from_linear`] by table, to the bit, for whole pictures.
#[derive(Clone, Debug)]
pub struct ToneTable {
    /// The smallest linear value of each code.
    first_of_code: [f32; 256],
    /// A code at or below that of each of the equal steps from 0 to 1.
    guess: Vec<u8>,
}

/// Steps of the table of guesses: fine enough that the code is the guess or the next, but near black.
const GUESSES: usize = 4096;

impl Default for ToneTable {
    fn default() -> ToneTable {
        let mut first_of_code = [0.0; 256];
        for (code, first) in first_of_code.iter_mut().enumerate().skip(1) {
            // Positive floats order like their bits, so bisection finds the very first.
            let (mut below, mut at) = (0_u32, 1.0_f32.to_bits());
            while at - below > 1 {
                let middle = below + (at - below) / 2;
                if usize::from(srgb8_from_linear(f32::from_bits(middle))) >= code {
                    at = middle
                } else {
                    below = middle
                }
            }
            *first = f32::from_bits(at);
        }
        let guess = (0..=GUESSES).map(|step| srgb8_from_linear(step as f32 / GUESSES as f32)).collect();
        ToneTable { first_of_code, guess }
    }
}

impl ToneTable {
    /// The display code of a linear channel value.
    #[inline]
    pub fn srgb8_from_linear(&self, linear: f32) -> u8 {
        let value = clamped(linear);
        // Rounded down, so the guess is never too large.
        let mut code = self.guess[(value * GUESSES as f32) as usize];
        while code < 255 && value >= self.first_of_code[usize::from(code) + 1] {
            code += 1;
        }
        code
    }

    /// Tone-maps a linear RGB radiance.
    #[inline]
    pub fn display_from_radiance(&self, radiance: Vec3, exposure: f32) -> [u8; 3] {
        (radiance * exposure).to_array().map(|channel| self.srgb8_from_linear(channel))
    }
}

/// The linear value of a display code.
pub fn linear_from_srgb8(code: u8) -> f32 {
    let encoded = f32::from(code) / 255.0;
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;

    #[test]
    fn every_display_code_survives_a_round_trip() {
        for code in 0..=255 {
            assert_eq!(srgb8_from_linear(linear_from_srgb8(code)), code);
        }
    }

    #[test]
    fn the_table_equals_the_formula() {
        let table = ToneTable::default();
        let around = |value: f32| [value.next_down(), value, value.next_up()];
        let thresholds = table.first_of_code.into_iter().flat_map(around);
        let steps = (0..=100_000).map(|step| step as f32 / 99_000.0);
        let extremes = [f32::NAN, f32::NEG_INFINITY, f32::INFINITY, -0.0, 1e-40, 1e8];
        for value in thresholds.chain(steps).chain(extremes) {
            assert_eq!(table.srgb8_from_linear(value), srgb8_from_linear(value), "{value}");
        }
    }

    #[test]
    fn stability_tone_mapping() {
        let rising = [f32::NEG_INFINITY, -1.0, -0.0, 0.0, 1e-45, 1e-40, 1e-6, 0.5, 1.0, 1e8, f32::INFINITY];
        let codes = rising.map(srgb8_from_linear);
        let mut falls = bound!("tone mapping", "codes that fall where radiance rises", 0.0);
        codes.windows(2).for_each(|pair| falls.count(pair[0] > pair[1], pair[0]));
        assert_eq!((codes[0], codes[10], srgb8_from_linear(f32::NAN)), (0, 255, 0));
        // The curve in f64, at every step of a code's own width and between; half a code is rounding, the rest is f32.
        let mut off = bound!("tone mapping", "off the curve in f64, in codes", 0.5 + 1e-4);
        for step in 0..=200_000 {
            let linear = (f64::from(step) / 200_000.0).powi(3) as f32;
            let x = f64::from(linear);
            let curve = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
            off.see((255.0 * curve - f64::from(srgb8_from_linear(linear))).abs(), linear);
        }
        let table = ToneTable::default();
        let mut finite = bound!("tone mapping", "exposed pictures of hard cases that differ by table and formula", 0.0);
        for (radiance, exposure) in rising.into_iter().flat_map(|r| [0.0, 1e-40, 1.0, 1e30].map(|e| (r, e))) {
            let radiance = Vec3::splat(radiance);
            let differs = table.display_from_radiance(radiance, exposure) != display_from_radiance(radiance, exposure);
            finite.count(differs, format!("{radiance} {exposure}"));
        }
    }
}
