//! The root: inverse depth, points, directions, and where it is rough.

use super::scratch::{PAD, Scratch};
use super::{BAND, BLOCK, Band, CELL, Input, clear_boundaries, records, smooth};
use crate::lanes::{Floats, Integers, Mask, Vector};

/// Neighbours whose inverse depths differ by more than this fraction lie on different surfaces.
pub(super) const EDGE: f32 = 0.05;
/// Relative change of slope of the inverse depth from texel to texel up to which a block is smooth: within a tile of 8
/// it bends the inverse depth by 1.6 %, and what is left of that the check at the centre sees.
const BEND: f32 = 0.002;
/// The same in parts of the nearest inverse depth: two steps of a 16-bit depth.
const DEPTH_STEPS: f32 = 4e-5;

/// Decodes the root's rows, those of the halo included, and tells whether any boundary is among them.
#[inline(always)]
pub(super) fn decode<F: Floats>(input: &Input<'_>, band: &mut Band<'_>, scratch: &mut Scratch) -> bool {
    let has_boundaries = interfaces(input, band.first, 0, scratch);
    inverse_depths::<F>(input, band, scratch, has_boundaries);
    flag_edges::<F>(input, band, scratch);
    cells(input, band, scratch);
    if input.has_children[0] {
        if has_boundaries {
            smooth::normals::<F>(input, band.first, 0, scratch);
            records::write_surface::<F>(input, band, 0, scratch);
        } else {
            clear_boundaries(input, band, 0);
        }
    }
    has_boundaries
}

/// Boundaries of a node as floats.
#[inline(always)]
pub(super) fn interfaces(input: &Input<'_>, first: usize, node: usize, scratch: &mut Scratch) -> bool {
    let mut any = 0;
    if !input.has_children[node] {
        return false;
    }
    for row in 0..input.rows() {
        let to = &mut scratch.nodes[node].interface.row_mut(row)[PAD..PAD + input.width];
        match input.image_row(first, row) {
            Some(y) => {
                let from = &input.tree.nodes[node].interface[y * input.width..(y + 1) * input.width];
                for (to, &from) in to.iter_mut().zip(from) {
                    *to = f32::from(from);
                    any |= from;
                }
            }
            None => to.fill(0.0),
        }
    }
    any != 0
}

#[inline(always)]
fn inverse_depths<F: Floats>(input: &Input<'_>, band: &mut Band<'_>, scratch: &mut Scratch, has_boundaries: bool) {
    let camera = &input.tree.camera;
    let (focal, centre) = (camera.focal_px(), camera.centre_px());
    let Scratch { nodes, inverse_depth, .. } = scratch;
    let root = &mut nodes[0];
    for row in 0..input.rows() {
        let Some(y) = input.image_row(band.first, row) else {
            root.known.row_mut(row).fill(0.0);
            continue;
        };
        let distances = &input.tree.nodes[0].distance[y * input.width..(y + 1) * input.width];
        let slope_y = -(y as f32 + 0.5 - centre.y) / focal.y;
        let interior = (input.halo..input.halo + BAND).contains(&row);
        for x in (0..input.width).step_by(F::LANES) {
            let slope_x = (F::ramp() + F::splat(x as f32 + 0.5 - centre.x)) * F::splat(1.0 / focal.x);
            let length = slope_x.mul_add(slope_x, F::splat(slope_y * slope_y + 1.0)).sqrt();
            let distance = F::load(distances, x);
            // What is undefined at the root lies at infinity.
            let inverse = (length / distance).or(F::zero().lt(distance), F::zero());
            inverse.store(&mut inverse_depth.row_mut(row)[PAD..], x);
            if interior {
                let at = (row - input.halo) * input.layout.pitch;
                inverse.as_integers().store(&mut band.planes[at..at + input.layout.stride], x);
            }
            if has_boundaries {
                let over = F::splat(1.0) / length;
                let direction = Vector([slope_x * over, F::splat(slope_y) * over, -over]);
                for axis in 0..3 {
                    direction.0[axis].store(&mut root.direction[axis].row_mut(row)[PAD..], x);
                    (direction.0[axis] * distance).store(&mut root.point[axis].row_mut(row)[PAD..], x);
                }
                let finite = distance.lt(F::splat(f32::INFINITY)) & F::zero().lt(distance);
                F::splat(1.0).or(finite, F::zero()).store(&mut root.known.row_mut(row)[PAD..], x);
            }
        }
    }
}

/// Flags blocks where the inverse depth is not nearly planar.
#[inline(always)]
fn flag_edges<F: Floats>(input: &Input<'_>, band: &mut Band<'_>, scratch: &Scratch) {
    let rows = BAND.min(input.height - band.first);
    let nearest = (0..rows)
        .flat_map(|row| &scratch.inverse_depth.row(input.halo + row)[PAD..PAD + input.width])
        .fold(0.0_f32, |nearest, &inverse| if inverse > nearest { inverse } else { nearest });
    let steps = F::splat(DEPTH_STEPS * nearest);
    for row in 0..rows {
        let y = band.first + row;
        let here = scratch.inverse_depth.row(input.halo + row);
        let above = scratch.inverse_depth.row(input.halo + row - usize::from(y > 0));
        let below = scratch.inverse_depth.row(input.halo + row + usize::from(y + 1 < input.height));
        let vertical = y > 0 && y + 1 < input.height;
        for x in (0..input.width).step_by(F::LANES) {
            let own = F::load(here, PAD + x);
            let tolerance = own.mul_add(F::splat(BEND), steps);
            let bend = |before: F, after: F| tolerance.lt((before + after - own - own).abs());
            let mut rough = bend(F::load(here, PAD + x - 1), F::load(here, PAD + x + 1));
            let mut bits = inner_columns(rough, x, input.width);
            if vertical {
                rough = bend(F::load(above, PAD + x), F::load(below, PAD + x));
                bits |= rough.bits() & columns(x, input.width);
            }
            flag(input, band.roughness, row, x, bits, 1);
        }
    }
}

/// The lanes that are columns of the picture.
#[inline(always)]
pub(super) fn columns(x: usize, width: usize) -> u32 {
    let count = (width - x).min(16);
    (1 << count) - 1
}

/// Of a question about both neighbours: not those at the border.
#[inline(always)]
fn inner_columns(mask: impl Mask, x: usize, width: usize) -> u32 {
    let first = u32::from(x == 0);
    let inner = columns(x, width - 1);
    mask.bits() & if x < width - 1 { inner & !first } else { 0 }
}

/// Flags the blocks of up to 16 texels from x on.
#[inline(always)]
pub(super) fn flag(input: &Input<'_>, roughness: &mut [u16], row: usize, x: usize, bits: u32, flag: u16) {
    if bits == 0 {
        return;
    }
    let at = row / BLOCK * input.width.div_ceil(BLOCK) + x / BLOCK;
    if bits & 0xff != 0 {
        roughness[at] |= flag;
    }
    if bits & 0xff00 != 0 {
        roughness[at + 1] |= flag;
    }
}

/// Nearest and farthest of each cell.
#[inline(always)]
fn cells(input: &Input<'_>, band: &mut Band<'_>, scratch: &Scratch) {
    let columns = input.width.div_ceil(CELL);
    for (row, cells) in band.cells.chunks_mut(columns).enumerate() {
        cells.fill([0.0, f32::INFINITY]);
        for y in row * CELL..(row * CELL + CELL).min(input.height.saturating_sub(band.first)) {
            let values = &scratch.inverse_depth.row(input.halo + y)[PAD..PAD + input.width];
            for (cell, values) in cells.iter_mut().zip(values.chunks(CELL)) {
                for &value in values {
                    cell[0] = if value > cell[0] { value } else { cell[0] };
                    cell[1] = if value < cell[1] { value } else { cell[1] };
                }
            }
        }
    }
}
