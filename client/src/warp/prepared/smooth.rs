//! Normals freed from the steps of their code, and of nothing else.
//!
//! A normal of 2 x 12 octahedral bits is off by up to 0.01 degrees, and the slope of a direction that is reflected at
//! it, from texel to texel, by a tenth. A binomial filter of 7 x 7 texels takes that away; but it must not blur what
//! is really there, waves and edges. So the filtered normal replaces the coded one only as far as the code's own step
//! reaches: in every component by at most [`step`]. Normals from depth were filtered before (`normals`) and stay as
//! they are.

use super::Input;
use super::scratch::{FILTER_HALO, PAD, Plane, Scratch};
use crate::lanes::{Floats, Vector};

/// Half a step of an octahedral coordinate of so many bits on [-1, 1], and as much again for what the fold to the
/// sphere and normalisation make of it.
pub(super) fn step(bits: u8) -> f32 {
    2.0 / ((1_u32 << bits.min(24)) - 1) as f32
}

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
    for row in 0..input.rows() {
        let Some(y) = input.image_row(first, row) else { continue };
        let pixels = y * input.width..(y + 1) * input.width;
        let coded = [input.normal(node, 0, &pixels), input.normal(node, 1, &pixels), input.normal(node, 2, &pixels)];
        let step = input.normal_step;
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
            let correction = Vector([a.within(-step, step), b.within(-step, step), c.within(-step, step)]);
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
    for row in 0..input.rows() + 2 * FILTER_HALO {
        let y = (first + row).checked_sub(input.halo + FILTER_HALO).filter(|&y| y < input.height);
        for axis in 0..3 {
            let filtered = scratch.filtered[axis].row_mut(row);
            let Some(y) = y else {
                filtered.fill(0.0);
                continue;
            };
            let pixels = y * input.width..(y + 1) * input.width;
            let masked = scratch.masked[axis].row_mut(0);
            let normals = input.normal(node, axis, &pixels).iter().zip(&planes.interface[pixels]);
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
