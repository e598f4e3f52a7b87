//! Depth planes: codes of inverse depth in equal steps from infinity (code 0) to the nearest point of the
//! strip (the largest code).
//!
//! The inverse of z is planar in screen space for every plane of the scene, so the gradient predictor
//! leaves almost nothing; and one step is the same number of displayed pixels at every depth:
//! `error_px = focal_px * translation_m * step / 2`.
//!
//! A code measures z at the root. At a child it measures either its distance from the parent's point, or the
//! z of the unfolded path: distances summed along the chain, divided by the length of the pixel's ray at z = 1.

use super::bounded_depth;
use super::shape::FrameShape;
use crate::Camera;
use crate::frame::{DepthBound, DepthCoding, DepthFormat, NodeRows, Plan, TreeRows, UNDEFINED};
use std::ops::Range;

/// The code of a positive depth; `near` is the smallest depth of the strip. Infinity is 0; everything
/// finite is at least 1. What is not above zero counts as near.
#[inline(always)]
pub(crate) fn quantise(depth: f32, near: f32, bits: u8) -> u32 {
    /// Added to a number below 2^32 it leaves the nearest integer in the lowest bits of the sum.
    const ROUND: f64 = (1_u64 << 52) as f64;
    let largest = f64::from(largest_code(bits));
    // f64: at 24 bits the quotient has no f32 digits to spare for rounding.
    let ratio = f64::from(near) / f64::from(depth);
    let steps = if depth > 0.0 && ratio < 1.0 { ratio * largest } else { largest };
    let code = ((steps + ROUND).to_bits() as u32).max(1);
    if depth == f32::INFINITY { 0 } else { code }
}

/// The depth of a code.
#[inline(always)]
pub(crate) fn dequantise(code: u32, near: f32, bits: u8) -> f32 {
    // Code 0 divides to infinity. A peer may name any near: what overflows is infinitely far, and nothing is
    // nearer than positive.
    let depth = f64::from(near) * (f64::from(largest_code(bits)) / f64::from(code as i32));
    (depth as f32).max(f32::MIN_POSITIVE)
}

const fn largest_code(bits: u8) -> u32 {
    (1 << bits) - 1
}

/// Turns distances into depths and back; keeps the lengths of the strip's rays from one node to the next.
#[derive(Debug, Default)]
pub(crate) struct DepthPlane {
    ray_lengths: Vec<f32>,
    metres: Vec<f32>,
    depths: Vec<f32>,
}

impl DepthPlane {
    /// Prepares for the rows of a strip.
    pub(crate) fn begin(&mut self, camera: &Camera, rows: Range<u32>) {
        ray_lengths(camera, rows, &mut self.ray_lengths);
    }

    /// The codes of a node's distances, and the depth of the largest code. Where `defined` is false the code
    /// is meaningless, and no such pixel moves the nearest depth.
    pub(crate) fn quantise(
        &mut self,
        shape: &FrameShape,
        rows: &TreeRows<'_>,
        node: usize,
        defined: &[bool],
        codes: &mut Vec<u32>,
    ) -> f32 {
        let near = self.measure(shape, rows, node, defined, is_relative(shape, node));
        let bits = shape.depth_bits(node);
        codes.clear();
        codes.extend(self.metres.iter().map(|&depth| quantise(depth, near, bits)));
        near
    }

    /// The samples of a node's distances within a bound, and the step that was chosen for them. Where `defined` is false
    /// the sample is meaningless.
    pub(crate) fn quantise_bounded(
        &mut self,
        shape: &FrameShape,
        bound: DepthBound,
        rows: &TreeRows<'_>,
        node: usize,
        defined: &[bool],
        samples: &mut Vec<i32>,
    ) -> f32 {
        let near = self.measure(shape, rows, node, defined, false);
        let step_per_m = bounded_depth::step_per_m(bound, &shape.camera, node == 0, near);
        bounded_depth::quantise(&self.metres, near, step_per_m, samples);
        step_per_m
    }

    /// Fills in the depths of a node, and returns the nearest; 1 m where all are infinite.
    fn measure(
        &mut self,
        shape: &FrameShape,
        rows: &TreeRows<'_>,
        node: usize,
        defined: &[bool],
        as_distance: bool,
    ) -> f32 {
        path_distances(&shape.plan, &rows.nodes, node, is_relative(shape, node), &mut self.metres);
        if !as_distance {
            for (metres, &length) in self.metres.iter_mut().zip(&self.ray_lengths) {
                *metres /= length;
            }
        }
        for (metres, &defined) in self.metres.iter_mut().zip(defined) {
            // The root knows every pixel: what it was not told lies at infinity.
            let unknown = if node == 0 { f32::INFINITY } else { UNDEFINED };
            *metres = if defined { *metres } else { unknown };
        }
        let near = nearest(&self.metres);
        if near.is_finite() { near } else { 1.0 }
    }

    /// Writes the distances of samples within a bound; those of the node's ancestors must be there already.
    pub(crate) fn dequantise_bounded(
        &mut self,
        shape: &FrameShape,
        rows: &mut TreeRows<'_>,
        node: usize,
        step_per_m: f32,
        defined: Option<&[bool]>,
        samples: &[i32],
    ) {
        bounded_depth::dequantise(samples, step_per_m, &mut self.depths);
        self.write(shape, rows, node, defined);
    }

    /// Writes the distances of codes; those of the node's ancestors must be there already.
    pub(crate) fn dequantise(
        &mut self,
        shape: &FrameShape,
        rows: &mut TreeRows<'_>,
        node: usize,
        near: f32,
        defined: Option<&[bool]>,
        codes: &[u32],
    ) {
        let bits = shape.depth_bits(node);
        self.depths.clear();
        self.depths.extend(codes.iter().map(|&code| dequantise(code, near, bits)));
        self.write(shape, rows, node, defined);
    }

    /// Writes the distances of depths.
    fn write(&mut self, shape: &FrameShape, rows: &mut TreeRows<'_>, node: usize, defined: Option<&[bool]>) {
        let (depths, lengths) = (&self.depths, &self.ray_lengths);
        let is_bounded = matches!(shape.format.depth, DepthFormat::Bounded(_));
        if is_relative(shape, node) && !is_bounded {
            rows.nodes[node].distance.copy_from_slice(depths);
        } else if node == 0 || is_relative(shape, node) {
            for ((distance, &depth), &length) in rows.nodes[node].distance.iter_mut().zip(depths).zip(lengths) {
                *distance = (depth * length).max(f32::MIN_POSITIVE);
            }
        } else {
            let parent = usize::from(shape.plan.nodes()[node].parent);
            path_distances(&shape.plan, &rows.nodes, parent, false, &mut self.metres);
            let before = self.metres.iter().zip(lengths);
            for ((distance, &depth), (&before, &length)) in rows.nodes[node].distance.iter_mut().zip(depths).zip(before)
            {
                *distance = beyond(before, depth * length);
            }
        }
        if let Some(defined) = defined {
            for (distance, &defined) in rows.nodes[node].distance.iter_mut().zip(defined) {
                *distance = if defined { *distance } else { UNDEFINED };
            }
        }
    }
}

/// The distance from a parent `before` metres along the path to a child `along_path` metres along it.
#[inline(always)]
fn beyond(before: f32, along_path: f32) -> f32 {
    // A child is beyond its parent, however coarse the code; from infinity to infinity is infinitely far.
    let distance = along_path - before;
    let distance = if distance.is_nan() { f32::INFINITY } else { distance };
    distance.max(before * 1e-6).max(f32::MIN_POSITIVE)
}

fn is_relative(shape: &FrameShape, node: usize) -> bool {
    node > 0 && shape.format.child_depth == DepthCoding::Relative
}

/// Distance from the eye along the chain of rays to a node's points, or `alone` from its parent's.
fn path_distances(plan: &Plan, nodes: &[NodeRows<'_>], node: usize, alone: bool, metres: &mut Vec<f32>) {
    metres.clear();
    metres.extend_from_slice(nodes[node].distance);
    let mut at = node;
    while at != 0 && !alone {
        at = usize::from(plan.nodes()[at].parent);
        for (sum, &distance) in metres.iter_mut().zip(nodes[at].distance.iter()) {
            // What is no distance adds nothing.
            *sum += if distance > 0.0 { distance } else { 0.0 };
        }
    }
}

/// Lengths of the rays through the pixels of some rows, per metre of z.
fn ray_lengths(camera: &Camera, rows: Range<u32>, lengths: &mut Vec<f32>) {
    let (focal, centre) = (camera.focal_px(), camera.centre_px());
    let face_rows = camera.rows_of_face().max(1);
    let slope_x: Vec<f32> = (0..camera.size.width).map(|x| (x as f32 + 0.5 - centre.x) / focal.x).collect();
    lengths.clear();
    for y in rows {
        let slope_y = ((y % face_rows) as f32 + 0.5 - centre.y) / focal.y;
        lengths.extend(slope_x.iter().map(|&slope_x| (slope_x * slope_x + slope_y * slope_y + 1.0).sqrt()));
    }
}

/// The smallest positive depth; infinite where there is none.
fn nearest(depths: &[f32]) -> f32 {
    // Eight minima side by side: one alone would wait for itself at every pixel.
    let mut lanes = [f32::INFINITY; 8];
    let (eights, rest) = depths.as_chunks::<8>();
    let keep_nearer = |near: &mut f32, depth: f32| *near = if depth > 0.0 && depth < *near { depth } else { *near };
    for eight in eights {
        lanes.iter_mut().zip(eight).for_each(|(near, &depth)| keep_nearer(near, depth));
    }
    rest.iter().for_each(|&depth| keep_nearer(&mut lanes[0], depth));
    lanes.into_iter().fold(f32::INFINITY, f32::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn inverse_depth_is_within_half_a_step(near in 1e-3..10.0_f32, ratio in 1.0..1e6_f32, bits in 8..=24_u8) {
            let depth = near * ratio;
            let code = quantise(depth, near, bits);
            let back = dequantise(code, near, bits);
            let step = 1.0 / f64::from(largest_code(bits));
            let error = (f64::from(near) / f64::from(depth) - f64::from(near) / f64::from(back)).abs();
            // Half a step, but never less than a whole one for what is nearly infinite.
            let bound = if code == 1 { step } else { step * 0.5 };
            prop_assert!(error <= bound * 1.001 + 1.2e-7, "{} of {}", error, bound);
            prop_assert_eq!(quantise(back, near, bits).abs_diff(code), 0);
        }
    }

    #[test]
    fn stability_depth_code() {
        // A code is a step of near / z; f32 adds a rounding of the depth that comes out, of at most 2^-24 of the largest code.
        let mut round_trip = bound!("depth code", "round trip, in codes of 8 to 20 bits", 0.5 + 1.0 / 16.0);
        for bits in [8, 12, 16, 20] {
            let largest = f64::from(largest_code(bits));
            for (near, step) in
                [1e-3_f32, 0.1, 1.0, 10.0].into_iter().flat_map(|near| (0..20_000).map(move |s| (near, s)))
            {
                let depth = near * 1e6_f32.powf(step as f32 / 20_000.0);
                let code = quantise(depth, near, bits);
                let exact = largest * f64::from(near) / f64::from(depth);
                // What is nearly infinite has the first code, and not that of infinity.
                if exact >= 0.5 {
                    let back = largest * f64::from(near) / f64::from(dequantise(code, near, bits));
                    round_trip.see((back - exact).abs(), format!("{depth} of {near} in {bits} bits"));
                }
            }
        }
        let mut wrong = bound!("depth code", "hard cases without the code they should have", 0.0);
        for bits in [8, 16, 24] {
            let largest = largest_code(bits);
            assert_eq!(quantise(f32::INFINITY, 1.0, bits), 0);
            assert_eq!(quantise(f32::MAX, 1.0, bits), 1);
            for at_near in [1.0, 0.5, 0.0, -0.0, -3.0, 1e-40, f32::NAN, f32::NEG_INFINITY] {
                wrong.count(quantise(at_near, 1.0, bits) != largest, at_near);
            }
            assert_eq!(dequantise(0, 1.0, bits), f32::INFINITY);
            assert_eq!(dequantise(largest, 0.25, bits), 0.25);
        }
        assert!(dequantise(1, f32::MIN_POSITIVE, 8) > 0.0);
        assert!(dequantise(255, f32::from_bits(1), 8) > 0.0);
        assert_eq!(dequantise(1, f32::MAX, 8), f32::INFINITY);
    }

    #[test]
    fn ray_lengths_are_those_of_the_camera() {
        let mut camera = Camera::symmetric(1.2, crate::ImageSize::new(13, 9));
        camera.fov.left *= 0.7;
        let cube = Camera::cube(&camera, 32);
        // Of the cube rows on either side of a seam.
        for (camera, rows) in [(camera, 2..7), (cube, 27..40), (cube, 159..192)] {
            let width = camera.size.width as usize;
            let mut lengths = Vec::new();
            ray_lengths(&camera, rows.clone(), &mut lengths);
            assert_eq!(lengths.len(), rows.len() * width);
            for (index, &length) in lengths.iter().enumerate() {
                let pixel = camera.size.pixel_centre(rows.start as usize * width + index);
                // The axes of a face are those of view in another order, and so is the sum of squares.
                assert!((length / camera.ray_in_view(pixel).length() - 1.0).abs() <= 2.0 * f32::EPSILON, "{pixel}");
            }
        }
    }

    #[test]
    fn the_nearest_is_the_smallest_above_zero() {
        let mut depths = vec![f32::INFINITY, f32::NAN, -1.0, 0.0, 7.0, 3.0];
        for _ in 0..20 {
            assert_eq!(nearest(&depths), 3.0);
            depths.insert(0, 4.0);
        }
        assert_eq!(nearest(&[f32::NAN, 0.0, f32::INFINITY]), f32::INFINITY);
    }

    #[test]
    fn a_child_is_beyond_its_parent() {
        assert_eq!(beyond(2.0, 5.0), 3.0);
        assert!(beyond(2.0, 1.0) > 0.0 && beyond(0.0, 0.0) > 0.0);
        for before in [0.0, 1.0, f32::MAX, f32::INFINITY] {
            assert_eq!(beyond(before, f32::INFINITY), f32::INFINITY);
        }
        assert_eq!(beyond(f32::INFINITY, 3.0), f32::INFINITY);
    }
}
