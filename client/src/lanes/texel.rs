//! Radiance packed for a cheap bilinear fetch: four numbers of 16 bits per texel.
//!
//! Red, green, blue and whether the texel is known, each an unsigned float of 5 bits of exponent and 11 of
//! mantissa (one more than a half float has, since nothing is negative), offset by [`OFFSET`] so that zero has a
//! normal code and unpacking is a shift and an addition of integers. Relative error 2^-12, absolute error 2^-27 near
//! black, largest value 130,000: finer than any wire format but the half float's own.

use glam::Vec4;

/// What is added before packing: the smallest number with a code, 2^-15.
pub(crate) const OFFSET: f32 = 1.0 / 32_768.0;
/// Exponent of the smallest code, in the place of a float's exponent.
pub(super) const EXPONENT: u32 = 112 << 23;
/// Mantissa bits of a float that are dropped.
pub(super) const DROPPED: u32 = 12;

/// A texel.
pub(crate) type Texel = [u16; 4];

/// The code of a number that is not negative; what is not a number becomes zero.
#[inline(always)]
pub(crate) fn pack(value: f32) -> u16 {
    let value = if value > 0.0 { value } else { 0.0 };
    let bits = (value + OFFSET).to_bits() + (1 << (DROPPED - 1)) - EXPONENT;
    (bits >> DROPPED).min(0xffff) as u16
}

#[inline(always)]
fn widened(code: u16) -> f32 {
    f32::from_bits((u32::from(code) << DROPPED) + EXPONENT)
}

/// A texel, still with [`OFFSET`] on it.
#[inline(always)]
pub(crate) fn unpack(texel: Texel) -> Vec4 {
    let [red, green, blue, known] = texel;
    Vec4::new(widened(red), widened(green), widened(blue), widened(known))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip(value: f32) -> f32 {
        unpack([pack(value); 4]).x - OFFSET
    }

    #[test]
    fn a_packed_number_is_within_its_step() {
        for value in [0.0, 1e-9, 1e-6, 3e-5, 0.001, 0.2, 0.999, 1.0, 1.5, 255.0, 65_504.0, 120_000.0_f32] {
            let error = (round_trip(value) - value).abs();
            assert!(error <= (value + OFFSET) / 4096.0, "{value}: off by {error}");
        }
        assert_eq!((round_trip(0.0), round_trip(1.0) > 0.9997), (0.0, true));
        assert_eq!((pack(f32::NAN), pack(-1.0), pack(f32::INFINITY)), (0, 0, 0xffff));
    }
}
