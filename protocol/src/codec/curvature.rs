//! Shape operators as integers: three signed codes, companded, in parts of the largest entry of the strip.
//!
//! The error behind a solid is that of the normal, an error of S times the way from the texel's point to the new
//! one: some centimetres, whatever S is. But a surface that bends more is also smaller, and the way ends with it. So
//! neither equal nor purely relative steps are right, and the codes are companded by the mu law (Smith 1957),
//! `c = n ln(1 + mu |s| / scale) / ln(1 + mu)`: relative where S is large, linear below `scale / mu`. With mu = 100,
//! 8 bits and S down to a tenth of the largest the error is below 2.1 %, to a hundredth 3.7 %; linear codes are 4 and
//! 32 % off there, mu = 255 2.3 and 3.2 %. Ten bits divide it by four. Zero is exact, and so is the largest.
//!
//! Entries stand in the basis of the normal that the receiver will have, so they are turned to it before they are
//! coded: where the rounding of a normal crosses z = 0 its tangents are others. Codes are two's complement, so that a plane
//! is 0 and all residuals with it. A ball is a constant: the first row of a strip is filled with it on either side of what
//! has a boundary, so that what is below is predicted from it along every outline.

use super::normal;
use crate::curvature::{MAX_CURVATURE_PER_M, ShapeOperator};
use crate::frame::{FrameFormat, NodeRows};
use glam::Vec3;

/// Where companding turns from linear to relative: at a hundredth of the largest.
const MU: f32 = 100.0;

/// Largest code: the lowest, -2^(bits - 1), is not used.
const fn largest_code(bits: u8) -> i32 {
    (1 << (bits - 1)) - 1
}

/// Cells of an octave of `1 + MU v / scale`: at 12 bits a code is as wide as one.
const CELLS_LOG2: u32 = 9;

/// The codes of entries, by a table instead of a logarithm, which would take twice as long as all the rest.
#[derive(Debug, Default)]
pub(crate) struct Compander {
    bits: u8,
    /// Where code k ends and k + 1 begins: `(1 + MU)^((k + 1/2) / n)`.
    ends: Vec<f32>,
    /// The lowest code in each cell.
    cells: Vec<u16>,
    /// Entries of all codes, in parts of the scale.
    expanded: Vec<f32>,
}

impl Compander {
    /// Makes the tables, unless they are there.
    pub(crate) fn prepare(&mut self, bits: u8) {
        if self.bits == bits {
            return;
        }
        self.bits = bits;
        let (largest, base) = (largest_code(bits), 1.0 + f64::from(MU));
        self.ends.clear();
        self.ends.extend((0..largest).map(|code| base.powf((f64::from(code) + 0.5) / f64::from(largest)) as f32));
        self.cells.clear();
        let mut code = 0;
        for cell in 0..=Compander::cell(1.0 + MU) {
            let start = f32::from_bits(((cell as u32) << (23 - CELLS_LOG2)) + 1.0_f32.to_bits());
            while code < self.ends.len() && self.ends[code] <= start {
                code += 1;
            }
            self.cells.push(code as u16);
        }
        self.expanded.clear();
        self.expanded.extend((0..1 << bits).map(|code| expand(code, bits)));
    }

    /// The cell of a number from 1 to 1 + MU: exponent and first bits of the mantissa.
    #[inline(always)]
    fn cell(companded: f32) -> usize {
        ((companded.to_bits() - 1.0_f32.to_bits()) >> (23 - CELLS_LOG2)) as usize
    }

    /// The code of an entry; not a number is 0.
    #[inline]
    pub(crate) fn quantise(&self, entry: f32, scale: f32) -> u32 {
        let part = entry.abs() / scale;
        // Written so that NaN, and a scale of 0, fall through.
        let part = if part > 0.0 { part.min(1.0) } else { 0.0 };
        let companded = (1.0 + MU * part).min(1.0 + MU);
        let mut code = usize::from(self.cells[Compander::cell(companded)]);
        while code < self.ends.len() && self.ends[code] <= companded {
            code += 1;
        }
        let code = if entry < 0.0 { (code as u32).wrapping_neg() } else { code as u32 };
        code & ((1 << self.bits) - 1)
    }

    /// The entry of a code.
    #[inline(always)]
    pub(crate) fn dequantise(&self, code: u32, scale: f32) -> f32 {
        self.expanded[code as usize] * scale
    }
}

/// The entry of a code, in parts of the scale.
fn expand(code: u32, bits: u8) -> f32 {
    let shift = 32 - u32::from(bits);
    let signed = (code << shift) as i32 >> shift;
    let largest = largest_code(bits);
    match signed.abs().min(largest) {
        // To the bit, so that what is coded again stays.
        code if code == largest => 1.0_f32.copysign(signed as f32),
        code => {
            let part = (f64::from(code) / f64::from(largest) * f64::from(MU).ln_1p()).exp_m1() / f64::from(MU);
            (part as f32).copysign(signed as f32)
        }
    }
}

/// Turns shape operators into codes and back; keeps its tables from one strip to the next.
#[derive(Debug, Default)]
pub(crate) struct ShapePlane {
    entries: [Vec<f32>; 3],
    counts: Vec<bool>,
    compander: Compander,
}

impl ShapePlane {
    /// The codes of a node's shape operators, and the largest entry: 0 where all is flat. Where `has_interface` is
    /// false the codes are meaningless.
    pub(crate) fn quantise(
        &mut self,
        format: &FrameFormat,
        width: usize,
        planes: &NodeRows<'_>,
        has_interface: &[bool],
        codes: &mut [Vec<u32>; 3],
    ) -> f32 {
        self.compander.prepare(format.shape_bits);
        let mut scale = 0.0_f32;
        self.entries.iter_mut().for_each(Vec::clear);
        for (pixel, &has_interface) in has_interface.iter().enumerate() {
            let shape = if has_interface { received(format, planes, pixel) } else { ShapeOperator::FLAT };
            for (entries, entry) in self.entries.iter_mut().zip(shape.to_array()) {
                scale = scale.max(entry.abs());
                entries.push(entry);
            }
        }
        for (codes, entries) in codes.iter_mut().zip(&self.entries) {
            codes.clear();
            // Most are those of the pixel before.
            let mut last = (0.0, 0);
            codes.extend(entries.iter().map(|&entry| {
                if entry != last.0 {
                    last = (entry, self.compander.quantise(entry, scale));
                }
                last.1
            }));
        }
        self.fill_first_row(width, has_interface, codes);
        scale
    }

    /// The samples that count: those with a boundary, and the whole first row.
    pub(crate) fn counts(&self) -> &[bool] {
        &self.counts
    }

    /// Gives samples of the first row that have no boundary the code of the one before them that has, or of the first.
    fn fill_first_row(&mut self, width: usize, has_interface: &[bool], codes: &mut [Vec<u32>; 3]) {
        self.counts.clear();
        self.counts.extend_from_slice(has_interface);
        let Some(first) = has_interface.iter().position(|&has_interface| has_interface) else { return };
        for codes in codes {
            let mut last = codes[first];
            for (code, &has_interface) in codes[..width].iter_mut().zip(has_interface) {
                last = if has_interface { *code } else { last };
                *code = last;
            }
        }
        self.counts[..width].fill(true);
    }

    /// Writes the shape operators of a plane of codes, all finite.
    pub(crate) fn dequantise(&mut self, bits: u8, scale: f32, codes: &[Vec<u32>; 3], planes: &mut NodeRows<'_>) {
        self.compander.prepare(bits);
        if scale == 0.0 {
            planes.shape.iter_mut().for_each(|entries| entries.fill(0.0));
            return;
        }
        for (entries, codes) in planes.shape.iter_mut().zip(codes) {
            for (entry, &code) in entries.iter_mut().zip(codes) {
                *entry = self.compander.dequantise(code, scale);
            }
        }
    }
}

/// The shape operator of a pixel in the basis of its normal as the receiver will have it; flat where the planes have
/// none.
pub(crate) fn received(format: &FrameFormat, planes: &NodeRows<'_>, pixel: usize) -> ShapeOperator {
    let entry = |axis: usize| planes.shape[axis].get(pixel).copied().unwrap_or(0.0);
    let shape = ShapeOperator { s11: entry(0), s12: entry(1), s22: entry(2) };
    let shape = if shape.s12 == 0.0 && shape.s11 == shape.s22 {
        shape
    } else {
        let normal = Vec3::new(planes.normal[0][pixel], planes.normal[1][pixel], planes.normal[2][pixel]);
        let rounded = normal::dequantise(normal::quantise(normal, format.normal_bits), format.normal_bits);
        shape.turned(normal, rounded)
    };
    let within = |entry: f32| {
        if entry.is_nan() { 0.0 } else { entry.clamp(-MAX_CURVATURE_PER_M, MAX_CURVATURE_PER_M) }
    };
    ShapeOperator::from_array(shape.to_array().map(within))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Half a step of the companded code, expanded: the relative error of what is far above `scale / MU`.
    fn relative_error(bits: u8) -> f32 {
        (0.5 / largest_code(bits) as f32 * MU.ln_1p()).exp_m1()
    }

    fn compander(bits: u8) -> Compander {
        let mut compander = Compander::default();
        compander.prepare(bits);
        compander
    }

    fn quantise(entry: f32, scale: f32, bits: u8) -> u32 {
        compander(bits).quantise(entry, scale)
    }

    /// By the logarithm, before it is rounded.
    fn companded(entry: f32, scale: f32, bits: u8) -> f64 {
        let part = f64::from(entry) / f64::from(scale);
        (f64::from(MU) * part.abs()).ln_1p() / f64::from(MU).ln_1p() * f64::from(largest_code(bits)) * part.signum()
    }

    #[test]
    fn the_table_is_the_logarithm() {
        for bits in FrameFormat::SHAPE_BITS {
            let compander = compander(bits);
            for step in -20_000..=20_000_i16 {
                let entry = f32::from(step) / 20_000.0 * 3.5;
                let signed =
                    ((compander.quantise(entry, 3.5) << (32 - u32::from(bits))) as i32) >> (32 - u32::from(bits));
                // In the middle between two codes rounding of an f32 up to 101 decides, over the slope of the logarithm.
                let exact = companded(entry, 3.5, bits);
                let margin = 1e-6 * f64::from(largest_code(bits));
                assert!((f64::from(signed) - exact).abs() <= 0.5 + margin, "{bits} bits, {entry}: {signed} {exact}");
            }
        }
    }

    proptest! {
        /// With g = exp(L (y + d)) - 1 over mu, the error at half a step d is at most (exp(L d) - 1)(|s| + scale / mu).
        #[test]
        fn entries_come_back_within_the_companded_half_step(
            exponent in -4.0..4.0_f32, below in 0.0..6.0_f32, negative in any::<bool>(), bits in FrameFormat::SHAPE_BITS
        ) {
            let scale = 10_f32.powf(exponent);
            let entry = scale * 10_f32.powf(-below) * if negative { -1.0 } else { 1.0 };
            let back = expand(quantise(entry, scale, bits), bits) * scale;
            let bound = relative_error(bits) * (entry.abs() + scale / MU);
            prop_assert!((back - entry).abs() <= bound * 1.001 + scale * 1e-6, "{} {} of {}", entry, back, scale);
            prop_assert!(back == 0.0 || back.signum() == entry.signum());
        }
    }

    #[test]
    fn the_error_of_eight_bits_is_the_one_stated() {
        assert!(relative_error(8) < 0.0184);
        // Down to a tenth and to a hundredth of the largest.
        assert!(relative_error(8) * 1.1 < 0.021 && relative_error(8) * 2.0 < 0.037);
        assert!(relative_error(10) * 4.0 < relative_error(8) * 1.01);
    }

    #[test]
    fn codes_are_their_own_and_zero_and_the_largest_are_exact() {
        for bits in FrameFormat::SHAPE_BITS {
            for code in 0..1_u32 << bits {
                let again = quantise(expand(code, bits) * 7.5, 7.5, bits);
                // The lowest code is read as the one above it.
                let expected = if code == 1 << (bits - 1) { code + 1 } else { code };
                assert_eq!(again, expected, "{bits} bits");
            }
            assert_eq!(expand(quantise(0.0, 3.0, bits), bits), 0.0);
            for exact in [0.3_f32, -0.3] {
                assert_eq!(expand(quantise(exact, 0.3, bits), bits) * 0.3, exact);
            }
        }
    }

    /// As docs/wire-format.md has them.
    #[test]
    fn codes_are_those_of_the_document() {
        let codes = [0.0, 1.0, -1.0, 0.5, 0.1, -0.1, 0.01, 1e-4].map(|entry| quantise(entry * 4.0, 4.0, 8));
        // 127 ln 51 / ln 101 = 108.20, 127 ln 11 / ln 101 = 65.99, 127 ln 2 / ln 101 = 19.07.
        assert_eq!(codes, [0, 127, 256 - 127, 108, 66, 256 - 66, 19, 0]);
        assert!((expand(66, 8) - 0.100_057).abs() < 1e-5);
    }

    /// Entries that are no number, infinite, subnormal; a scale of zero.
    #[test]
    fn extreme_entries_have_codes() {
        for scale in [0.0, 1e-45, 1.0, MAX_CURVATURE_PER_M] {
            for entry in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -0.0, 1e-45, f32::MAX] {
                let code = quantise(entry, scale, 8);
                assert!(code < 256 && (expand(code, 8) * scale).is_finite(), "{entry} {scale}");
            }
            assert_eq!(quantise(f32::NAN, scale, 8), 0);
        }
    }
}
