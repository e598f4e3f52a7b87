//! Flows at the corners and centres of tiles: where they agree, a tile is interpolated, and most do.

use super::chain::Chain;
use super::motion::Motion;
use super::root::{Splat, solve_from};
use crate::lanes::{Floats, Level, MAX_LANES, kernel};
use crate::warp::prepared::Prepared;
use crate::warp::pyramid::TILE;
use rayon::prelude::*;

/// Fields of a sample that are the root's: position, new inverse depth, [`State`], boundary.
const ROOT_FIELDS: usize = 5;
/// Fields of each child: position, [`State`], weights.
const CHILD_FIELDS: usize = 6;
/// Positions this far beyond the border still count at corners, which lie on the border of the picture themselves.
const MARGIN_PX: f32 = 2.0 * TILE as f32;

/// Whether a node is seen at a pixel, as a float among floats.
pub(super) const UNSEEN: f32 = 0.0;
/// Seen, and its position was found.
pub(super) const KNOWN: f32 = 1.0;
/// Seen, but what it shows is unknown.
pub(super) const HOLE: f32 = 2.0;

/// Position, state and weights of a child.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ChildSample {
    pub(super) u: f32,
    pub(super) v: f32,
    pub(super) state: f32,
    pub(super) weights: [f32; 3],
}

/// What the root shows.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RootPoint {
    pub(super) u: f32,
    pub(super) v: f32,
    pub(super) inverse_depth: f32,
    pub(super) state: f32,
    pub(super) interface: f32,
}

/// Samples of all corners (rows 2 i) and centres (rows 2 i + 1) of the tiles.
#[derive(Debug, Default)]
pub(super) struct Grid {
    values: Vec<f32>,
    stride: usize,
    fields: usize,
    pub(super) tiles_x: usize,
    pub(super) tiles_y: usize,
}

/// Writes the sample of a child in planes of fields.
#[inline(always)]
pub(super) fn state_of<F: Floats>(wanted: F::Mask, known: F::Mask) -> F {
    F::splat(KNOWN).or(known, F::splat(HOLE)).or(wanted, F::splat(UNSEEN))
}

impl Grid {
    /// Solves for all samples.
    pub(super) fn solve(
        &mut self,
        level: Level,
        frame: &Prepared,
        motion: &Motion,
        splat: &Splat,
        size: (usize, usize),
    ) {
        self.tiles_x = size.0.div_ceil(TILE);
        self.tiles_y = size.1.div_ceil(TILE);
        self.stride = (self.tiles_x + 1).next_multiple_of(16);
        self.fields = ROOT_FIELDS + CHILD_FIELDS * (frame.node_count - 1);
        let row = self.stride * self.fields;
        self.values.resize((2 * self.tiles_y + 1) * row, 0.0);
        let stride = self.stride;
        self.values
            .par_chunks_mut(row)
            .enumerate()
            .for_each(|(index, values)| grid_row(level, frame, motion, splat, index, stride, values));
    }

    #[inline(always)]
    fn at(&self, row: usize, field: usize, column: usize) -> f32 {
        self.values[(row * self.fields + field) * self.stride + column]
    }

    /// The four corners and the centre of a tile: upper left, upper right, lower left, lower right, centre.
    #[inline(always)]
    fn places(x: usize, y: usize) -> [(usize, usize); 5] {
        [(2 * y, x), (2 * y, x + 1), (2 * y + 2, x), (2 * y + 2, x + 1), (2 * y + 1, x)]
    }

    #[inline(always)]
    pub(super) fn root(&self, x: usize, y: usize) -> [RootPoint; 5] {
        Grid::places(x, y).map(|(row, column)| {
            let at = |field| self.at(row, field, column);
            RootPoint { u: at(0), v: at(1), inverse_depth: at(2), state: at(3), interface: at(4) }
        })
    }

    #[inline(always)]
    pub(super) fn child(&self, child: usize, x: usize, y: usize) -> [ChildSample; 5] {
        let first = ROOT_FIELDS + CHILD_FIELDS * (child - 1);
        Grid::places(x, y).map(|(row, column)| {
            let at = |field| self.at(row, first + field, column);
            ChildSample { u: at(0), v: at(1), state: at(2), weights: [at(3), at(4), at(5)] }
        })
    }
}

#[inline(always)]
fn solve_row<F: Floats>(
    frame: &Prepared,
    motion: &Motion,
    splat: &Splat,
    row: usize,
    stride: usize,
    values: &mut [f32],
) {
    let offset = if row.is_multiple_of(2) { 0.0 } else { 0.5 };
    let y = (row / 2) as f32 + offset;
    let side = TILE as f32;
    let mut chain = Chain::<F>::new();
    for first in (0..stride).step_by(F::LANES) {
        let x = (F::ramp() + F::splat(first as f32 + offset)) * F::splat(side);
        let pixels = (x, F::splat(y * side));
        let (mut nearest, mut farthest) = ([0.0; MAX_LANES], [0.0; MAX_LANES]);
        for lane in 0..F::LANES {
            let x = ((first + lane) as f32 + offset) * side;
            (nearest[lane], farthest[lane]) = splat.around(x, x, y * side, y * side).unwrap_or((0.0, 0.0));
        }
        let starts = (F::load(&nearest, 0), F::load(&farthest, 0));
        let root = solve_from(frame, motion, pixels, starts, MARGIN_PX);
        let interface = chain.follow(frame, motion, pixels, &root, false);
        let always = F::zero().lt(F::splat(1.0));
        let of_root = [root.u, root.v, root.inverse_depth, state_of::<F>(always, root.known), interface];
        for (field, value) in of_root.into_iter().enumerate() {
            value.store(&mut values[field * stride..(field + 1) * stride], first);
        }
        for child in 1..frame.node_count {
            let sample = &chain.samples[child];
            let [red, green, blue] = sample.weights;
            let fields = [sample.u, sample.v, state_of::<F>(sample.wanted, sample.known), red, green, blue];
            let before = ROOT_FIELDS + CHILD_FIELDS * (child - 1);
            for (field, value) in fields.into_iter().enumerate() {
                value.store(&mut values[(before + field) * stride..(before + field + 1) * stride], first);
            }
        }
    }
}

kernel!(fn grid_row = solve_row(
    frame: &Prepared, motion: &Motion, splat: &Splat, row: usize, stride: usize, values: &mut [f32],
));
