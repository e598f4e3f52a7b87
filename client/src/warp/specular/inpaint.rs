//! Holes of each node filled from around them: push-pull (Gortler et al. 1996, 4.3), pixels that the node does not
//! have being skipped.
//!
//! Pull: halve the picture until nothing is unknown, adding up radiance times weight and the weights. Push: on the way
//! back give each unknown cell the tent-weighted sum of the level above. A hole is the quotient. At the root what is
//! far weighs more than what is near, so that a disocclusion is filled from what had been hidden.

use super::grid::TILE;
use super::tile::BandState;
use glam::Vec4;
use rayon::prelude::*;

/// Levels within which far pixels weigh more: cells of up to 8 pixels, wider than what 5 cm of motion uncovers.
const LOCAL_LEVELS: usize = 3;

/// The levels above the picture; kept.
#[derive(Debug, Default)]
pub(super) struct Pyramid {
    levels: Vec<Level>,
    depth: usize,
}

#[derive(Debug, Default)]
struct Level {
    width: usize,
    height: usize,
    cells: Vec<Vec4>,
}

impl Level {
    fn fit(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        self.cells.resize(width * height, Vec4::ZERO);
    }

    /// Known cells count the same from here on.
    fn forget_weights(&mut self) {
        self.cells.par_iter_mut().with_min_len(4096).filter(|cell| cell.w > 0.0).for_each(|cell| *cell /= cell.w);
    }

    /// Tent-weighted sum around a cell of the level below.
    #[inline(always)]
    fn between(&self, x: usize, y: usize) -> Vec4 {
        // The centre of a child lies a quarter off that of its parent, towards this neighbour.
        let towards = |at: usize, size: usize| {
            let neighbour = if at.is_multiple_of(2) { (at / 2).saturating_sub(1) } else { at / 2 + 1 };
            neighbour.min(size - 1)
        };
        let (px, py, nx, ny) = (x / 2, y / 2, towards(x, self.width), towards(y, self.height));
        let at = |x: usize, y: usize| self.cells[y * self.width + x];
        0.5625 * at(px, py) + 0.1875 * (at(nx, py) + at(px, ny)) + 0.0625 * at(nx, ny)
    }
}

impl Pyramid {
    /// Builds all levels above a node's picture, which lies in bands of rows of tiles.
    pub(super) fn build(
        &mut self,
        node: usize,
        (width, height): (usize, usize),
        planes: &[Vec4],
        band: usize,
        states: &[BandState],
    ) {
        self.depth = 0;
        let (mut w, mut h) = (width, height);
        while self.depth == 0 || w > 1 || h > 1 {
            (w, h) = (w.div_ceil(2), h.div_ceil(2));
            if self.levels.len() == self.depth {
                self.levels.push(Level::default());
            }
            self.levels[self.depth].fit(w, h);
            self.depth += 1;
        }
        self.pull_picture(node, (width, height), planes, band, states);
        for depth in 1..self.depth {
            if depth == LOCAL_LEVELS {
                self.levels[..LOCAL_LEVELS].iter_mut().for_each(Level::forget_weights);
            }
            let (lower, upper) = self.levels.split_at_mut(depth);
            pull(&lower[depth - 1], &mut upper[0]);
        }
        for depth in (0..self.depth - 1).rev() {
            let (lower, upper) = self.levels.split_at_mut(depth + 1);
            push(&mut lower[depth], &upper[0]);
        }
    }

    /// What a hole at this pixel is filled with; black where nothing is known at all.
    pub(super) fn at(&self, x: usize, y: usize) -> glam::Vec3 {
        let value = self.levels[0].between(x, y);
        if value.w > 0.0 { value.truncate() / value.w } else { glam::Vec3::ZERO }
    }

    fn pull_picture(
        &mut self,
        node: usize,
        (width, height): (usize, usize),
        planes: &[Vec4],
        band: usize,
        states: &[BandState],
    ) {
        let level = &mut self.levels[0];
        let columns = level.width;
        let bands = level.cells.par_chunks_mut(columns * TILE / 2).zip(planes.par_chunks(band)).zip(states);
        bands.enumerate().for_each(|(tile_y, ((cells, planes), state))| {
            let plane = &planes[node * TILE * width..(node + 1) * TILE * width];
            for (row, cells) in cells.chunks_mut(columns).enumerate() {
                let last = (height - tile_y * TILE).min(2 * row + 2);
                for (tile, cells) in cells.chunks_mut(TILE / 2).enumerate() {
                    if node > 0 && state.present[tile] >> node & 1 == 0 {
                        cells.fill(Vec4::ZERO);
                        continue;
                    }
                    for (column, cell) in cells.iter_mut().enumerate() {
                        let x = tile * TILE + 2 * column;
                        let pair = |y: usize| {
                            let weighted = |value: Vec4| {
                                let weight = if node == 0 { farness(value.w) } else { value.w };
                                (value.truncate() * weight).extend(weight)
                            };
                            let row = &plane[y * width..(y + 1) * width];
                            weighted(row[x]) + row.get(x + 1).copied().map_or(Vec4::ZERO, weighted)
                        };
                        *cell = (2 * row..last).map(pair).fold(Vec4::ZERO, |sum, pair| sum + pair);
                    }
                }
            }
        });
    }
}

/// How much a pixel of the root counts, `known` being one more than its inverse depth and 0 where it is a hole:
/// what is far counts more than what is near, since what a hole shows was hidden by what is near.
#[inline(always)]
fn farness(known: f32) -> f32 {
    let inverse_depth = known - 1.0;
    let squared = inverse_depth * inverse_depth + 1e-4;
    if known > 0.0 { 1.0 / (squared * squared) } else { 0.0 }
}

fn pull(below: &Level, level: &mut Level) {
    let width = level.width;
    level.cells.par_chunks_mut(width).with_min_len(16).enumerate().for_each(|(y, cells)| {
        let rows = 2 * y..(2 * y + 2).min(below.height);
        for (x, cell) in cells.iter_mut().enumerate() {
            let columns = 2 * x..(2 * x + 2).min(below.width);
            let at = |row: usize| below.cells[row * below.width..][columns.clone()].iter().copied();
            *cell = rows.clone().flat_map(at).fold(Vec4::ZERO, |sum, value| sum + value);
        }
    });
}

fn push(level: &mut Level, above: &Level) {
    let width = level.width;
    level.cells.par_chunks_mut(width).with_min_len(16).enumerate().for_each(|(y, cells)| {
        for (x, cell) in cells.iter_mut().enumerate() {
            if cell.w <= 0.0 {
                // A cell above is the sum of four.
                *cell = above.between(x, y) * 0.25;
            }
        }
    });
}
