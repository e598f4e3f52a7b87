//! Normals freed from the steps of their code, and of nothing else.
//!
//! A normal of 2 x 12 octahedral bits is off by up to 0.01 degrees, and the slope of a direction that is reflected at
//! it, from texel to texel, by a tenth. A binomial filter of 7 x 7 texels takes that away; but it must not blur what
//! is really there, waves and edges. So the filtered normal replaces the coded one only as far as the code's own
//! step reaches: in every component by at most [`STEP`].

use super::root::image_row;
use super::scratch::{FILTER_HALO, PAD, Plane, ROWS, Scratch};
use super::{HALO, Input};
use crate::warp::lanes::{Floats, Vector};

/// Half a step of a 12-bit octahedral coordinate on [-1, 1], and as much again for what the fold to the sphere and
/// normalisation make of it.
const STEP: f32 = 2.0 / 4095.0;
/// Binomial coefficients of a seven-tap filter, from the centre outwards.
const TAPS: [f32; 4] = [20.0, 15.0, 6.0, 1.0];

/// Fills the normals of a node, those of the halo included.
#[inline(always)]
pub(super) fn normals<F: Floats>(input: &Input<'_>, first: usize, node: usize, scratch: &mut Scratch) {
    if node > 0 {
        super::root::interfaces(input, first, node, scratch);
    }
    along_rows::<F>(input, first, node, scratch);
    let Scratch { nodes, filtered, .. } = scratch;
    let to = &mut nodes[node];
    for row in 0..ROWS {
        let Some(y) = image_row(first, row, input.height) else { continue };
        let coded = input.tree.nodes[node].normal.each_ref().map(|axis| &axis[y * input.width..(y + 1) * input.width]);
        for x in (0..input.width).step_by(F::LANES) {
            let is_boundary = F::zero().lt(F::load(to.interface.row(row), PAD + x));
            if !Vector::<F>::any(is_boundary) {
                continue;
            }
            let smooth =
                Vector([across(&filtered[0], row, x), across(&filtered[1], row, x), across(&filtered[2], row, x)])
                    .normalize();
            let coded = Vector([F::load(coded[0], x), F::load(coded[1], x), F::load(coded[2], x)]);
            let [a, b, c] = (smooth - coded).0;
            let correction = Vector([a.within(-STEP, STEP), b.within(-STEP, STEP), c.within(-STEP, STEP)]);
            let normal = (coded + correction).normalize();
            for axis in 0..3 {
                normal.0[axis].store(&mut to.normal[axis].row_mut(row)[PAD..], x);
            }
        }
    }
}

/// Filters across the rows around one.
#[inline(always)]
fn across<F: Floats>(filtered: &Plane, row: usize, x: usize) -> F {
    let mut sum = F::load(filtered.row(row + FILTER_HALO), PAD + x) * F::splat(TAPS[0]);
    for (distance, &tap) in TAPS.iter().enumerate().skip(1) {
        let above = F::load(filtered.row(row + FILTER_HALO - distance), PAD + x);
        let below = F::load(filtered.row(row + FILTER_HALO + distance), PAD + x);
        sum = (above + below).mul_add(F::splat(tap), sum);
    }
    sum
}

/// Filters the normals that have a boundary along their rows.
#[inline(always)]
fn along_rows<F: Floats>(input: &Input<'_>, first: usize, node: usize, scratch: &mut Scratch) {
    let planes = &input.tree.nodes[node];
    for row in 0..ROWS + 2 * FILTER_HALO {
        let y = (first + row).checked_sub(HALO + FILTER_HALO).filter(|&y| y < input.height);
        for axis in 0..3 {
            let filtered = scratch.filtered[axis].row_mut(row);
            let Some(y) = y else {
                filtered.fill(0.0);
                continue;
            };
            let pixels = y * input.width..(y + 1) * input.width;
            let masked = scratch.masked[axis].row_mut(0);
            let normals = planes.normal[axis][pixels.clone()].iter().zip(&planes.interface[pixels]);
            for (masked, (&normal, &interface)) in masked[PAD..].iter_mut().zip(normals) {
                *masked = if interface != 0 { normal } else { 0.0 };
            }
            let masked = &*masked;
            for x in (0..input.width).step_by(F::LANES) {
                let mut sum = F::load(masked, PAD + x) * F::splat(TAPS[0]);
                for (distance, &tap) in TAPS.iter().enumerate().skip(1) {
                    let pair = F::load(masked, PAD + x - distance) + F::load(masked, PAD + x + distance);
                    sum = pair.mul_add(F::splat(tap), sum);
                }
                sum.store(&mut filtered[PAD..], x);
            }
        }
    }
}
