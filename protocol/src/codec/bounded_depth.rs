//! Depths within a bound: inverse depth in fixed point, in steps that keep a promise about displayed pixels.
//!
//! The promise ([`DepthBound`]): a head that moves by so much sees no pixel further than so many pixels from its place. A
//! step of `d` in `1 / z` moves a pixel by `focal_px * motion * d`, so inverse depth may be off by `h = error_px / (focal_px *
//! motion)`, with the larger focal length of the two axes. It holds from the f32 distance that goes in to the f32 distance
//! that comes out: what fixed point takes (a unit) and what f32 takes on the way (12 roundings, together less than 2^-20 of
//! the nearest point's inverse depth) is subtracted from `h` before a step is chosen. The step travels with the strip.
//!
//! Nearer than `2^-19 / h` f32 distances themselves are too coarse to promise anything (1 mm with the default bound at
//! 610 px); there the step stays at `h`. Nearer than 2^-22 of a step's inverse, depths are clamped. Infinity stays infinity;
//! what is so far that the bound allows it may become infinite.
//!
//! At a child the depth is that of the unfolded path, or of its own leg with [`DepthCoding::Relative`], each over the length
//! of the pixel's ray; the promise of a leg is then its own, and those along a path add.
//!
//! [`DepthBound`]: crate::frame::DepthBound
//! [`DepthCoding::Relative`]: crate::frame::DepthCoding::Relative

use super::DecodeError;
use super::pyramid::{MOST, Pyramid, Rounding};
use crate::Camera;
use crate::frame::DepthBound;

/// Units of fixed point in a step.
const UNITS: i32 = 63;

/// How inverse depths are rounded.
pub(crate) const ROUNDING: Rounding = Rounding { step: UNITS, lowest: -UNITS, highest: MOST, keeps_zero: true };

/// Roundings of f32 between the distance that goes in and the one that comes out, over the inverse depth.
const F32_ERROR: f64 = 1.0 / (1_u64 << 20) as f64;

/// The step in inverse depth that keeps the promise in a strip whose nearest point is at `near_m`.
pub(crate) fn step_per_m(bound: DepthBound, camera: &Camera, is_root: bool, near_m: f32) -> f32 {
    let focal_px = camera.focal_px().max_element();
    let error = bound.inverse_depth_error_per_m(focal_px, is_root);
    let left = (error - F32_ERROR / f64::from(near_m)).max(0.5 * error);
    // The largest error is half a step less half a unit, and a unit where a depth becomes fixed point.
    let step = 2.0 * left * f64::from(UNITS) / f64::from(UNITS + 1);
    // Rounded to f32 it may be too large by 2^-24, of which F32_ERROR has room: `error` is less than inverse depth there, or
    // a step is so wide that all is infinite.
    ((step * (1.0 - f64::from(f32::EPSILON))) as f32).clamp(f32::MIN_POSITIVE, f32::MAX)
}

/// The samples of depths. Infinity is 0; what is not above zero, and no number, counts as `near_m`.
pub(crate) fn quantise(depths: &[f32], near_m: f32, step_per_m: f32, samples: &mut Vec<i32>) {
    let per_unit = f64::from(UNITS) / f64::from(step_per_m);
    samples.clear();
    samples.extend(depths.iter().map(|&depth| {
        let depth_or_near = if depth > 0.0 { depth } else { near_m };
        let units = per_unit / f64::from(depth_or_near) + 0.5;
        // Room for the error, so that the clamp of a decoded sample is never below a true one.
        let units = units.clamp(1.0, f64::from(MOST - UNITS)) as i32;
        if depth == f32::INFINITY { 0 } else { units }
    }));
}

/// The depths of samples; what is not above 0 is infinite.
pub(crate) fn dequantise(samples: &[i32], step_per_m: f32, depths: &mut Vec<f32>) {
    let per_unit = f64::from(UNITS) / f64::from(step_per_m);
    depths.clear();
    depths.extend(samples.iter().map(|&sample| {
        let depth = (per_unit / f64::from(sample.max(1))) as f32;
        if sample > 0 { depth.max(f32::MIN_POSITIVE) } else { f32::INFINITY }
    }));
}

/// Depths of a strip as far as the first bytes of its depth plane tell them.
#[derive(Clone, Debug, PartialEq)]
pub struct CoarseDepth {
    /// Depth in view of every pixel, above zero or infinite. What the bytes do not reach is continued from what they do:
    /// between samples that differ by more than two steps there is the nearer one, never a depth between them.
    pub depths_m: Vec<f32>,
    /// How many of the [`CoarseDepth::LEVELS`] were whole.
    pub levels: usize,
}

impl CoarseDepth {
    /// Levels behind the first grid.
    pub const LEVELS: usize = 5;

    /// Reads any number of first bytes of the payload of a bounded depth plane. Its header tells the step; `defined` is the
    /// node's validity, `None` for the root. Refused are bytes that end before the first grid does.
    pub fn from_prefix(
        width: usize,
        height: usize,
        step_per_m: f32,
        defined: Option<&[bool]>,
        payload: &[u8],
    ) -> Result<CoarseDepth, DecodeError> {
        let pixels = width.checked_mul(height).filter(|&pixels| pixels > 0);
        if pixels.is_none() || defined.is_some_and(|defined| Some(defined.len()) != pixels) {
            return Err(DecodeError::Malformed { field: "size of depth", expected: "pixels, and a flag for each" });
        }
        if !(step_per_m > 0.0 && step_per_m.is_finite()) {
            return Err(DecodeError::Malformed { field: "step of depth", expected: "a positive number" });
        }
        let (mut samples, mut depths_m) = (Vec::new(), Vec::new());
        let levels = Pyramid::default().decode_prefix(width, height, ROUNDING, defined, payload, &mut samples)?;
        dequantise(&samples, step_per_m, &mut depths_m);
        Ok(CoarseDepth { depths_m, levels })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ImageSize;
    use proptest::prelude::*;

    proptest! {
        /// Depth code of bounded depth: near, far, infinite; the warped error is below the promised pixels.
        #[test]
        fn depths_are_within_the_bound_before_any_residual(depth in 1e-2..1e5_f32, error in 1..=200_u16) {
            let camera = Camera::symmetric(1.4, ImageSize::new(1024, 1024));
            let bound = DepthBound { error_centi_px: error, motion_mm: 100, child_factor: 1 };
            let h = bound.inverse_depth_error_per_m(camera.focal_px().max_element(), true);
            let step = step_per_m(bound, &camera, true, depth.min(0.5));
            prop_assert!(f64::from(step) <= 2.0 * h && f64::from(step) >= 0.95 * h);
            let (mut samples, mut back) = (Vec::new(), Vec::new());
            quantise(&[depth, f32::INFINITY], 0.5, step, &mut samples);
            prop_assert!(samples[0] > 0 && samples[1] == 0);
            // The largest residual error that the rounding allows.
            let most = (UNITS - 1) / 2;
            dequantise(&[samples[0] - most, samples[0] + most, samples[1]], step, &mut back);
            for is in &back[..2] {
                prop_assert!((1.0 / f64::from(depth) - 1.0 / f64::from(*is)).abs() <= h, "{} {}", depth, is);
            }
            prop_assert_eq!(back[2], f32::INFINITY);
        }
    }

    /// Depth code of behind, subnormal, no number; and what is nearer than fixed point can say.
    #[test]
    fn extreme_depths_have_samples() {
        let mut samples = Vec::new();
        quantise(&[f32::NAN, -1.0, 0.0, 2.0, 1e-45, f32::MAX], 2.0, 1e-3, &mut samples);
        assert_eq!(samples[..3], [samples[3]; 3]);
        assert_eq!(samples[4..], [MOST - UNITS, 1]);
        let mut depths = Vec::new();
        for step in [f32::MIN_POSITIVE, 1e-3, f32::MAX] {
            dequantise(&[i32::MIN, -1, 0, 1, MOST], step, &mut depths);
            assert!(depths.iter().all(|&depth| depth > 0.0), "{step} {depths:?}");
        }
        let camera = Camera::symmetric(1.4, ImageSize::new(64, 64));
        for near in [f32::from_bits(1), 1e-3, 1e30] {
            let step = step_per_m(DepthBound::default(), &camera, true, near);
            assert!(step > 0.0 && step.is_finite(), "{near}");
        }
    }

    /// Smooth, with spikes, in steps: of the pixels that a prefix reaches each keeps the promise already, f32 in and f32
    /// out; those between are continued from them, nearer to the truth with every level.
    #[test]
    fn every_prefix_of_a_depth_keeps_the_promise_where_it_reaches() {
        let (width, height) = (97, 70);
        let camera = Camera::symmetric(1.4, ImageSize::new(width, height));
        let bound = DepthBound { error_centi_px: 10, motion_mm: 200, child_factor: 1 };
        let h = bound.inverse_depth_error_per_m(camera.focal_px().max_element(), true);
        let smooth = |x: u32, y: u32| 0.8 + 0.03 * x as f32 + 0.007 * y as f32;
        let spiky = |x, y| if (7 * x + 13 * y) % 31 == 0 { 0.5 + 0.01 * y as f32 } else { smooth(x, y) };
        let stepped = |x: u32, y: u32| 1.0 + 3.0 * (x / 17 % 3) as f32 + (y / 11 % 2) as f32;
        type Surface<'a> = (&'a str, &'a dyn Fn(u32, u32) -> f32);
        let surfaces: [Surface; 3] = [("smooth", &smooth), ("spiky", &spiky), ("stepped", &stepped)];
        for (name, surface) in surfaces {
            let depths: Vec<f32> = (0..width * height).map(|at| surface(at % width, at / width)).collect();
            let nearest = depths.iter().copied().fold(f32::INFINITY, f32::min);
            let step = step_per_m(bound, &camera, true, nearest);
            let (mut samples, mut bytes) = (Vec::new(), Vec::new());
            quantise(&depths, nearest, step, &mut samples);
            Pyramid::default().encode(width as usize, ROUNDING, None, &mut samples, &mut bytes);
            let mut mean_of_level = [f64::INFINITY; CoarseDepth::LEVELS + 1];
            for end in 0..=bytes.len() {
                let read = CoarseDepth::from_prefix(width as usize, height as usize, step, None, &bytes[..end]);
                let Ok(coarse) = read else {
                    assert!(mean_of_level[0].is_infinite(), "{name}: {end} bytes are refused, fewer are not");
                    continue;
                };
                let stride = 32 >> coarse.levels;
                let mut sum = 0.0;
                for (at, (was, is)) in depths.iter().zip(&coarse.depths_m).enumerate() {
                    let (x, y) = (at as u32 % width, at as u32 / width);
                    let error = (1.0 / f64::from(*was) - 1.0 / f64::from(*is)).abs();
                    let is_reached = x % stride == 0 && y % stride == 0;
                    assert!(!is_reached || error <= h, "{name}, {end} bytes, {x} {y}: {was} {is}");
                    sum += error;
                }
                mean_of_level[coarse.levels] = sum / depths.len() as f64;
            }
            assert!(mean_of_level[CoarseDepth::LEVELS] <= h, "{name}");
            // Spikes are no plane that a coarser one could be like.
            // Levels that take no byte come with the one before.
            let seen: Vec<f64> = mean_of_level.into_iter().filter(|mean| mean.is_finite()).collect();
            let falls = seen.len() > 2 && seen.windows(2).all(|pair| pair[1] <= pair[0]);
            assert!(falls || name == "spiky", "{name}: {mean_of_level:?}");
        }
    }

    #[test]
    fn a_prefix_of_depth_is_refused_by_name_or_is_depth() {
        let mut samples: Vec<i32> = (0..40 * 33).map(|at| if at % 40 < 17 { 0 } else { 900 + 7 * at }).collect();
        let mut bytes = Vec::new();
        Pyramid::default().encode(40, ROUNDING, None, &mut samples, &mut bytes);
        let mut levels = Vec::new();
        for end in 0..=bytes.len() {
            match CoarseDepth::from_prefix(40, 33, 0.01, None, &bytes[..end]) {
                Ok(coarse) => {
                    assert!(coarse.depths_m.len() == 40 * 33 && coarse.depths_m.iter().all(|&depth| depth > 0.0));
                    levels.push(coarse.levels);
                }
                Err(error) => assert!(levels.is_empty() && error.to_string().contains("truncated"), "{error}"),
            }
        }
        assert!(levels.is_sorted() && levels.last() == Some(&CoarseDepth::LEVELS), "{levels:?}");
        assert!(CoarseDepth::from_prefix(0, 3, 0.01, None, &bytes).is_err());
        assert!(CoarseDepth::from_prefix(40, 33, f32::NAN, None, &bytes).is_err());
        assert!(CoarseDepth::from_prefix(40, 33, 0.01, Some(&[true]), &bytes).is_err());
    }
}
