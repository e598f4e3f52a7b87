//! Depths and optical depths as integers: so many units to a code, so that what is predicted is predicted to a fraction of a
//! code, and is rounded by no more than half a code in all.

use super::{THICKEST, THINNEST};
use crate::codec::pyramid::Rounding;
use crate::frame::VolumeRange;

/// Units of a code of so many bits: odd, as a step is. Codes of more than 12 bits are finer than any prediction, and tables
/// of them would be large.
pub(super) fn units_of_code(bits: u8) -> i32 {
    if bits <= 12 { 15 } else { 1 }
}

/// The largest of samples of so many codes.
fn highest(codes: i32, bits: u8) -> i32 {
    (codes - 1) * units_of_code(bits)
}

/// Depths in units, which rise with the depth.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthScale {
    offset: f64,
    near: f64,
    span: f64,
    /// The units of the farthest.
    pub(super) highest: i32,
    step: i32,
}

impl DepthScale {
    pub(super) fn new(range: VolumeRange, bits: u8) -> DepthScale {
        let offset = f64::from(range.far_m) / 16.0;
        let near = 1.0 / (f64::from(range.near_m) + offset);
        let far = 1.0 / (f64::from(range.far_m) + offset);
        let highest = highest(1 << bits, bits);
        DepthScale { offset, near, span: near - far, highest, step: units_of_code(bits) }
    }

    /// The nearest unit. What is no number counts as near.
    pub(super) fn units(&self, depth: f32) -> i32 {
        let fraction = (self.near - 1.0 / (f64::from(depth).max(0.0) + self.offset)) / self.span;
        // A cast takes what is below 0, and NaN, to 0.
        (fraction * f64::from(self.highest) + 0.5).clamp(0.0, f64::from(self.highest)) as i32
    }

    pub(super) fn depth(&self, units: i32) -> f32 {
        let inverse = self.near - f64::from(units) / f64::from(self.highest) * self.span;
        (1.0 / inverse - self.offset).max(0.0) as f32
    }

    /// Within half a code.
    pub(super) fn rounding(&self) -> Rounding {
        Rounding { step: self.step, lowest: 0, highest: self.highest, keeps_zero: false }
    }

    /// The same of gaps, which may be below 0 by what the back before them is off.
    pub(super) fn gaps(&self) -> Rounding {
        Rounding { lowest: -self.step, ..self.rounding() }
    }
}

/// Optical depths in units of their logarithm.
#[derive(Clone, Copy, Debug)]
pub(super) struct OpticalDepthScale {
    /// The units of the thickest.
    pub(super) highest: i32,
    units_per_log: f32,
    step: i32,
}

impl OpticalDepthScale {
    pub(super) fn new(bits: u8) -> OpticalDepthScale {
        // A code less than there are: 0 was none.
        let highest = highest((1 << bits) - 1, bits);
        let units_per_log = highest as f32 / (THICKEST / THINNEST).ln();
        OpticalDepthScale { highest, units_per_log, step: units_of_code(bits) }
    }

    /// The nearest unit.
    pub(super) fn units(&self, optical_depth: f32) -> i32 {
        let log = (optical_depth.clamp(THINNEST, THICKEST) / THINNEST).ln();
        ((log * self.units_per_log + 0.5) as i32).min(self.highest)
    }

    pub(super) fn optical_depth(&self, units: i32) -> f32 {
        THINNEST * (units as f32 / self.units_per_log).exp()
    }

    /// Within half a code.
    pub(super) fn rounding(&self) -> Rounding {
        Rounding { step: self.step, lowest: 0, highest: self.highest, keeps_zero: false }
    }
}
