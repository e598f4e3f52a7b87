//! Holes filled from around them: push-pull (Gortler et al. 1996, 4.3), what is unknown being skipped.
//!
//! Pull: halve the picture until one cell is left, averaging what is known. Push: on the way back give each unknown
//! cell the tent-weighted mean of the level above.
//!
//! Every cell has a weight, the mean of those of its pixels. In cells of up to [`LOCAL_PX`] what weighs more counts more, so
//! that a disocclusion can be filled from the farther side; beyond, where nothing was uncovered but the picture ends, all
//! count the same, or what is farthest would reach across the whole picture.
//!
//! The picture itself is never read here: whoever makes it leaves sums of 2 x 2 pixels ([`Pyramid::half_bands`]), and
//! the half-size level is pushed to only around holes, when they ask ([`Pyramid::at`]). Cost: a sixteenth of the pixels
//! per node that has holes, and 16 reads per hole.

use super::filling::{Epipole, HoleFilling, background};
use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;

/// Side of the tiles in which sums are left.
pub(super) const TILE: usize = 8;
/// Side of a tile in sums.
pub(super) const HALF: usize = TILE / 2;
/// Side of the largest cells in whose averages weights count: wider than what moving a head uncovers between frames.
const LOCAL_PX: usize = 64;

/// The levels above a picture of several nodes; kept from picture to picture.
#[derive(Debug, Default)]
pub(super) struct Pyramid {
    nodes: usize,
    tiles: (usize, usize),
    /// Sums of 2 x 2 pixels: value times weight, weight. A band is a row of tiles; in it node by node, row by row.
    half: Vec<Vec4>,
    /// Nodes whose sums of a tile were written.
    present: Vec<u16>,
    /// From 4 x 4 pixels on, of one node.
    levels: Vec<Level>,
    depth: usize,
    /// What holes are filled with, and where points move along.
    filling: HoleFilling,
    epipole: Epipole,
}

/// Sums of a row of tiles.
#[derive(Debug)]
pub(super) struct HalfBand<'a> {
    cells: &'a mut [Vec4],
    present: &'a mut [u16],
    tiles: usize,
}

impl HalfBand<'_> {
    /// The cells of a row of a tile of a node.
    #[inline(always)]
    pub(super) fn row(&mut self, node: usize, tile: usize, row: usize) -> &mut [Vec4; HALF] {
        let first = ((node * HALF + row) * self.tiles + tile) * HALF;
        let (cells, _) = self.cells[first..].as_chunks_mut::<HALF>();
        &mut cells[0]
    }

    /// Says which nodes of a tile were written.
    #[inline(always)]
    pub(super) fn set_present(&mut self, tile: usize, nodes: u16) {
        self.present[tile] = nodes;
    }
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

    /// Tent-weighted mean around a cell of the level below.
    #[inline(always)]
    fn between(&self, x: usize, y: usize, is_local: bool) -> Vec4 {
        tent((x, y), (self.width, self.height), is_local, |x, y| self.cells[y * self.width + x])
    }
}

impl Level {
    /// Bilinear at a pixel, each cell being 4 x 4 of them.
    fn at_pixel<const LOCAL: bool>(&self, x: usize, y: usize) -> Vec4 {
        let along = |pixel: usize, size: usize| {
            // In eighths of a cell, from the centre of the first; pixels before that are clamped to it.
            let eighths = (2 * pixel + 1).saturating_sub(4);
            let first = (eighths / 8).min(size - 1);
            (first, (first + 1).min(size - 1), (eighths % 8) as f32 / 8.0)
        };
        let ((left, right, fx), (above, below, fy)) = (along(x, self.width), along(y, self.height));
        let mut mean = Mean::<LOCAL>::default();
        for (row, of_row) in [(above, 1.0 - fy), (below, fy)] {
            for (column, of_column) in [(left, 1.0 - fx), (right, fx)] {
                mean.add(self.cells[row * self.width + column], of_row * of_column);
            }
        }
        mean.cell()
    }
}

/// The mean of some known cells, each a value times its weight, and the weight: 0 for what is unknown. Weights count
/// in it if `LOCAL`.
#[derive(Clone, Copy, Default)]
struct Mean<const LOCAL: bool> {
    sum: Vec4,
    weight: f32,
    total: f32,
}

impl<const LOCAL: bool> Mean<LOCAL> {
    /// Adds a cell that counts `share`.
    #[inline(always)]
    fn add(&mut self, cell: Vec4, share: f32) {
        let share = if cell.w > 0.0 { share } else { 0.0 };
        self.sum += if LOCAL { cell * share } else { cell * (share / cell.w.max(f32::MIN_POSITIVE)) };
        self.weight += cell.w * share;
        self.total += share;
    }

    #[inline(always)]
    fn cell(&self) -> Vec4 {
        let over = if self.total > 0.0 { 1.0 / self.total } else { 0.0 };
        // A mean of values that count the same gets the mean of their weights.
        if LOCAL { self.sum * over } else { self.sum * (over * over * self.weight) }
    }
}

/// Tent-weighted mean of the known cells around a cell of the level below.
#[inline(always)]
fn tent(
    (x, y): (usize, usize),
    (width, height): (usize, usize),
    is_local: bool,
    at: impl Fn(usize, usize) -> Vec4,
) -> Vec4 {
    // The centre of a child lies a quarter off that of its parent, towards this neighbour.
    let towards = |at: usize, size: usize| {
        let neighbour = if at.is_multiple_of(2) { (at / 2).saturating_sub(1) } else { at / 2 + 1 };
        neighbour.min(size - 1)
    };
    let (px, py, nx, ny) = (x / 2, y / 2, towards(x, width), towards(y, height));
    let around = [(px, py, 0.5625), (nx, py, 0.1875), (px, ny, 0.1875), (nx, ny, 0.0625)];
    if is_local {
        let mut mean = Mean::<true>::default();
        around.into_iter().for_each(|(x, y, share)| mean.add(at(x, y), share));
        mean.cell()
    } else {
        let mut mean = Mean::<false>::default();
        around.into_iter().for_each(|(x, y, share)| mean.add(at(x, y), share));
        mean.cell()
    }
}

impl Pyramid {
    /// Chooses what holes are filled with.
    pub(super) fn set_filling(&mut self, filling: HoleFilling) {
        self.filling = filling;
    }

    /// Whether holes are filled at all.
    pub(super) fn leaves_holes(&self) -> bool {
        self.filling == HoleFilling::Leave
    }

    /// Says where points move along.
    pub(super) fn set_epipole(&mut self, epipole: Epipole) {
        self.epipole = epipole;
    }

    /// Whether weights count in cells of this level, the first having 4 x 4 pixels.
    fn is_local(&self, depth: usize) -> bool {
        self.filling != HoleFilling::Even && 4 << depth <= LOCAL_PX
    }

    /// Takes on the size of a picture of so many nodes.
    pub(super) fn fit(&mut self, (width, height): (usize, usize), nodes: usize) {
        self.nodes = nodes;
        self.tiles = (width.div_ceil(TILE), height.div_ceil(TILE));
        let tiles = self.tiles.0 * self.tiles.1;
        self.half.resize(tiles * nodes * HALF * HALF, Vec4::ZERO);
        self.present.resize(tiles, 0);
        let (mut w, mut h) = (self.tiles.0 * HALF, self.tiles.1 * HALF);
        self.depth = 0;
        while self.depth == 0 || w > 1 || h > 1 {
            (w, h) = (w.div_ceil(2), h.div_ceil(2));
            if self.levels.len() == self.depth {
                self.levels.push(Level::default());
            }
            self.levels[self.depth].fit(w, h);
            self.depth += 1;
        }
    }

    /// Where the sums of each row of tiles go.
    pub(super) fn half_bands(&mut self) -> impl IndexedParallelIterator<Item = HalfBand<'_>> {
        let tiles = self.tiles.0;
        let bands = self.half.par_chunks_mut(tiles * self.nodes * HALF * HALF).zip(self.present.par_chunks_mut(tiles));
        bands.map(move |(cells, present)| HalfBand { cells, present, tiles })
    }

    /// Builds the levels of a node from its sums.
    pub(super) fn build(&mut self, node: usize) {
        let (tiles, nodes) = (self.tiles.0, self.nodes);
        let row = tiles * HALF;
        let counts_evenly = !self.is_local(0);
        let quarter = &mut self.levels[0];
        let bands = self.half.par_chunks(row * nodes * HALF).zip(self.present.par_chunks(tiles));
        quarter.cells.par_chunks_mut(row).zip(bands).for_each(|(cells, (half, present))| {
            let half = &half[node * HALF * row..(node + 1) * HALF * row];
            for (y, cells) in cells.chunks_mut(row / 2).enumerate() {
                let (upper, lower) = (&half[2 * y * row..][..row], &half[(2 * y + 1) * row..][..row]);
                for (x, cell) in cells.iter_mut().enumerate() {
                    let is_there = present[x / (HALF / 2)] >> node & 1 == 1;
                    let cells = [upper[2 * x], upper[2 * x + 1], lower[2 * x], lower[2 * x + 1]];
                    *cell = match is_there {
                        true if counts_evenly => mean_of::<false>(cells),
                        true => mean_of::<true>(cells),
                        false => Vec4::ZERO,
                    };
                }
            }
        });
        for depth in 1..self.depth {
            let is_local = self.is_local(depth);
            let (lower, upper) = self.levels.split_at_mut(depth);
            let (below, level) = (&lower[depth - 1], &mut upper[0]);
            if is_local { pull::<true>(below, level) } else { pull::<false>(below, level) }
        }
        for depth in (0..self.depth - 1).rev() {
            let is_local = self.is_local(depth + 1);
            let (lower, upper) = self.levels.split_at_mut(depth + 1);
            push(&mut lower[depth], &upper[0], is_local);
        }
    }

    /// What a hole of the node built last is filled with at this pixel; black where nothing is known at all.
    pub(super) fn at(&self, node: usize, x: usize, y: usize) -> Vec3 {
        match self.filling {
            HoleFilling::Leave => return Vec3::ZERO,
            HoleFilling::Background => {
                if let Some(farther) = background(self, self.epipole, node, x, y) {
                    return farther;
                }
            }
            HoleFilling::Even | HoleFilling::PushPull => {}
        }
        let is_local = self.is_local(0);
        let size = (self.tiles.0 * HALF, self.tiles.1 * HALF);
        let near = tent((x, y), size, true, |x, y| self.known_half(node, x, y));
        // Far from everything known, the level above is all there is: no need to push it down to sums.
        let value = if near.w > 0.0 {
            tent((x, y), size, is_local, |x, y| self.half_at(node, x, y))
        } else if is_local {
            self.levels[0].at_pixel::<true>(x, y)
        } else {
            self.levels[0].at_pixel::<false>(x, y)
        };
        if value.w > 0.0 { value.truncate() / value.w } else { Vec3::ZERO }
    }

    /// The sum of 2 x 2 pixels, without weight where none is known.
    #[inline(always)]
    fn known_half(&self, node: usize, x: usize, y: usize) -> Vec4 {
        let (tiles, band) = (self.tiles.0, y / HALF);
        if self.present[band * tiles + x / HALF] >> node & 1 == 1 {
            self.half[((band * self.nodes + node) * HALF + y % HALF) * tiles * HALF + x]
        } else {
            Vec4::ZERO
        }
    }

    /// The sum of 2 x 2 pixels around a place, in sums; without weight where none is known, `None` beyond the border.
    pub(super) fn known_around(&self, node: usize, at: Vec2) -> Option<Vec4> {
        let size = (self.tiles.0 * HALF, self.tiles.1 * HALF);
        let is_inside = at.x >= 0.0 && at.y >= 0.0 && at.x < size.0 as f32 && at.y < size.1 as f32;
        is_inside.then(|| self.known_half(node, at.x as usize, at.y as usize))
    }

    #[inline(always)]
    fn half_at(&self, node: usize, x: usize, y: usize) -> Vec4 {
        let known = self.known_half(node, x, y);
        if known.w > 0.0 { known } else { self.levels[0].between(x, y, self.is_local(0)) }
    }

    /// Fills the pixels of a picture that are not numbers, and tells how many they were.
    pub(super) fn fill(&mut self, radiance: &mut [Vec3], width: usize) -> usize {
        let holes = radiance.par_iter().with_min_len(4096).filter(|radiance| radiance.is_nan()).count();
        if holes == 0 {
            return 0;
        }
        // The baselines know nothing of where points move along, each pixel counting the same.
        self.epipole = Epipole::default();
        self.fit((width, radiance.len() / width), 1);
        let known = |value: &Vec3| if value.is_nan() { Vec4::ZERO } else { value.extend(1.0) };
        self.half_bands().zip(radiance.par_chunks(width * TILE)).for_each(|(mut half, radiance)| {
            for tile in 0..half.tiles {
                half.set_present(tile, 1);
                for row in 0..HALF {
                    *half.row(0, tile, row) = [Vec4::ZERO; HALF];
                }
            }
            for (y, row) in radiance.chunks(width).enumerate() {
                for (pair, values) in row.chunks(2).enumerate() {
                    half.row(0, pair / HALF, y / 2)[pair % HALF] += values.iter().map(known).sum::<Vec4>();
                }
            }
        });
        self.build(0);
        let pyramid = &*self;
        radiance.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, radiance) in row.iter_mut().enumerate().filter(|(_, radiance)| radiance.is_nan()) {
                *radiance = pyramid.at(0, x, y);
            }
        });
        holes
    }
}

#[inline(always)]
fn mean_of<const LOCAL: bool>(cells: [Vec4; 4]) -> Vec4 {
    let mut mean = Mean::<LOCAL>::default();
    cells.into_iter().for_each(|cell| mean.add(cell, 1.0));
    mean.cell()
}

fn pull<const LOCAL: bool>(below: &Level, level: &mut Level) {
    let width = level.width;
    level.cells.par_chunks_mut(width).with_min_len(16).enumerate().for_each(|(y, cells)| {
        for (x, cell) in cells.iter_mut().enumerate() {
            let mut mean = Mean::<LOCAL>::default();
            for row in 2 * y..(2 * y + 2).min(below.height) {
                for column in 2 * x..(2 * x + 2).min(below.width) {
                    mean.add(below.cells[row * below.width + column], 1.0);
                }
            }
            *cell = mean.cell();
        }
    });
}

fn push(level: &mut Level, above: &Level, is_local: bool) {
    let width = level.width;
    level.cells.par_chunks_mut(width).with_min_len(16).enumerate().for_each(|(y, cells)| {
        for (x, cell) in cells.iter_mut().enumerate() {
            if cell.w <= 0.0 {
                *cell = above.between(x, y, is_local);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use warplight_protocol::{Camera, ImageSize, Pose};

    /// A bright thing before a dark wall that has moved to the right: what it has uncovered is wall.
    #[test]
    fn only_the_background_continues_what_lies_behind() {
        let (width, height) = (64, 64);
        let value = |x: usize| match x {
            0..24 => (0.1, 0.01),
            24..40 => (f32::NAN, 0.0),
            _ => (0.9, 1.0),
        };
        // Weights are the larger the farther: here what they are of the wall.
        let weight = |nearness: f32| 1.0 / (0.01 + nearness);
        let mut filled = [0.0; 4];
        for (filling, filled) in HoleFilling::ALL.into_iter().zip(&mut filled) {
            let mut pyramid = Pyramid::default();
            pyramid.set_filling(filling);
            pyramid.fit((width, height), 1);
            pyramid.half_bands().for_each(|mut half| {
                for tile in 0..half.tiles {
                    half.set_present(tile, 1);
                    for row in 0..HALF {
                        for column in 0..HALF {
                            let x = 2 * (tile * HALF + column);
                            let known = |x: usize| match value(x) {
                                (radiance, _) if radiance.is_nan() => Vec4::ZERO,
                                (radiance, nearness) => Vec3::splat(radiance).extend(1.0) * weight(nearness),
                            };
                            half.row(0, tile, row)[column] = 2.0 * (known(x) + known(x + 1));
                        }
                    }
                }
            });
            let camera = Camera::symmetric(1.0, ImageSize::new(64, 64));
            let moved = Pose { position: glam::DVec3::NEG_X * 0.1, ..Pose::IDENTITY };
            pyramid.set_epipole(Epipole::new(&Pose::IDENTITY, &moved, &camera));
            pyramid.build(0);
            *filled = pyramid.at(0, 36, 32).x;
        }
        let [leave, even, background, push_pull] = filled;
        assert_eq!(leave, 0.0);
        assert!((background - 0.1).abs() < 1e-6, "{background}");
        // The middle of a cell nearer to the bright thing: even means lean to it, weighted ones to the wall.
        assert!(even > 0.4 && push_pull < 0.5 * even && push_pull > 0.1, "{filled:?}");
    }

    const HOLE: Vec3 = Vec3::NAN;

    #[test]
    fn a_picture_without_holes_is_left_alone() {
        let mut radiance = vec![Vec3::splat(0.3); 12];
        assert_eq!(Pyramid::default().fill(&mut radiance, 4), 0);
        assert!(radiance.iter().all(|&radiance| radiance == Vec3::splat(0.3)));
    }

    #[test]
    fn holes_in_a_constant_become_the_constant_and_known_pixels_stay() {
        for (width, height) in [(1, 1), (1, 7), (7, 1), (13, 9), (64, 64)] {
            let mut radiance = vec![Vec3::new(0.25, 0.5, 1.0); width * height];
            for hole in (1..radiance.len()).filter(|index| index % 3 != 0) {
                radiance[hole] = HOLE;
            }
            let mut pyramid = Pyramid::default();
            pyramid.fill(&mut radiance, width);
            assert!(radiance.iter().all(|&value| (value - Vec3::new(0.25, 0.5, 1.0)).length() < 1e-6));
        }
    }

    #[test]
    fn nothing_known_is_black() {
        let mut radiance = vec![HOLE; 35];
        assert_eq!(Pyramid::default().fill(&mut radiance, 7), 35);
        assert!(radiance.iter().all(|&radiance| radiance == Vec3::ZERO));
    }

    #[test]
    fn a_gap_is_bridged_smoothly() {
        let mut radiance: Vec<Vec3> =
            (0..64).map(|x| if (20..44).contains(&x) { HOLE } else { Vec3::splat(x as f32) }).collect();
        Pyramid::default().fill(&mut radiance, 64);
        let values: Vec<f32> = radiance.iter().map(|radiance| radiance.x).collect();
        // Between the means of the cells of four pixels on either side.
        assert!(values[20..44].iter().all(|value| (17.5..=45.5).contains(value)), "{values:?}");
        assert!(values[22] < values[32] && values[32] < values[42], "{values:?}");
    }
}
