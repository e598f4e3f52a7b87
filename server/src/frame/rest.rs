//! A head that rests sees the unbiased picture: radiance per pixel, summed over the frames of one view.
//!
//! Part of live frames. The cache gives a smooth picture at once, with a blur of some pixels that never goes
//! away. As long as pose, camera, plan, depth and scene stay what they are, every node pixel also keeps the sums
//! of path samples of its whole radiance, none of which ends in the cache, so that their mean is the path tracer's.
//! What is shown goes from the one to the other.
//!
//! Method: for tiles of 8x8 pixels the squared bias of the cache is estimated as the squared difference between
//! the two less the variance of the mean, which is pooled over the tile. The weight of the mean is the linear
//! estimator's of least squared error, `w = b^2 / (b^2 + v/n)` with both between the centres of tiles, and at
//! least `n / FULL_SAMPLES`: noise of at most one part in [`FULL_SAMPLES`] of a sample's variance is the price for
//! being unbiased in the end. So nothing jumps, tiles whose cache is right stay smooth, and sharp shadows appear
//! first. All pixels progress evenly, and the samples of a pixel follow one low-discrepancy sequence.
//!
//! Limits: a view counts as the same within [`TOLERANCE_PX`] of the first, for things not nearer than [`NEAREST_M`];
//! what is kept is a mean over such views. A picture that becomes smaller keeps the sums of what it still shows, one
//! that becomes larger begins anew: then the head has begun to move. `max_depth` holds for these paths, as it does for stills. Cost: 32 bytes per
//! node and pixel, and about the time of one more pass over the picture.

use super::{BAND_ROWS, FrameRequest, SceneVersion};
use crate::cache::luminance;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use warplight_protocol::ImageSize;
use warplight_protocol::frame::TreeRows;

/// Views that differ by less count as one: a hundredth of the blur that is to be removed.
const TOLERANCE_PX: f64 = 0.02;
/// A head that moves aside moves things at this distance by up to [`TOLERANCE_PX`].
const NEAREST_M: f64 = 0.3;
/// Samples from which on a pixel shows nothing but their mean. Fewer leave noise where the cache was better, more
/// leave the cache's blur where its size could not be told from noise.
pub(super) const FULL_SAMPLES: f32 = 256.0;
/// Rows and columns of a tile.
const TILE: usize = 8;
/// Samples beyond the first of each pixel that a tile needs before its variance means anything.
const MIN_FREEDOM: f32 = 128.0;
/// Variance relative to the squared mean that is expected before samples say more, and how many samples that is worth,
/// as in the cache: few samples miss the rare bright ones.
const GUESSED_VARIANCE: f32 = 0.7;
const GUESS_SAMPLES: f32 = 64.0;
/// Part by which the variance of the mean may be underestimated: a tile has some dozens of samples of a long-tailed
/// distribution. Less shows noise early, more shows shadows late.
const DOUBT: f32 = 0.5;

/// Sums of a pixel of a node.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PixelSum {
    radiance: DVec3,
    /// Mean squared luminance.
    square: f32,
    pub(super) samples: u32,
}

/// What a tile of a node knows of the two estimates.
#[derive(Clone, Copy, Debug, Default)]
struct Tile {
    /// Squared difference of the cache from the truth, in luminance.
    bias2: f32,
    /// Variance of one sample.
    variance: f32,
}

/// The view that rests.
#[derive(Clone, Debug)]
struct Anchor {
    request: FrameRequest,
    version: SceneVersion,
}

/// Sums over the frames of a view that does not change.
#[derive(Debug, Default)]
pub(super) struct Rest {
    anchor: Option<Anchor>,
    /// By band, node and pixel of the band.
    sums: Vec<PixelSum>,
    tiles: Vec<Tile>,
    columns: usize,
    nodes: usize,
    /// Rows of tiles of a face, between which nothing is interpolated.
    tile_rows_of_face: usize,
    /// Samples that a pixel has by now, up to one.
    progress: f64,
}

/// What a resting frame does for a band.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Samples per pixel before this frame, and after it.
    pub(super) before: f64,
    pub(super) after: f64,
    /// Of the whole rest, so that a pixel's samples are of one sequence.
    pub(super) seed: u64,
}

impl Rest {
    /// Whether this frame shows what the last one did or a part of it, in the same state of the scene. Otherwise the
    /// rest begins anew with this view.
    pub(super) fn continues(&mut self, request: &FrameRequest, version: SceneVersion) -> bool {
        let anchor = self.anchor.as_ref().filter(|anchor| anchor.version.shows_what(&version));
        let part = anchor.and_then(|anchor| part_of(&anchor.request, request));
        match (part, &mut self.anchor) {
            (Some(offset), Some(anchor)) if anchor.request.camera != request.camera => {
                let before = anchor.request.camera.size;
                anchor.request.camera = request.camera;
                self.crop(before, offset, request);
            }
            (Some(_), _) => {}
            (None, anchor) => {
                *anchor = Some(Anchor { request: request.clone(), version });
                self.progress = 0.0;
            }
        }
        part.is_some()
    }

    /// Keeps the sums of the part of the picture that is still shown.
    fn crop(&mut self, before: ImageSize, [left, top]: [u32; 2], request: &FrameRequest) {
        // Nothing has been summed yet.
        if self.progress == 0.0 {
            return;
        }
        let (band, size) = (BAND_ROWS as usize, request.camera.size);
        let (old_columns, columns) = (before.width as usize, size.width as usize);
        let [old_per_band, per_band] = [old_columns, columns].map(|columns| self.nodes * band * columns);
        let mut sums = vec![PixelSum::default(); size.height.div_ceil(BAND_ROWS) as usize * per_band];
        for row in 0..size.height as usize {
            let old_row = row + top as usize;
            for node in 0..self.nodes {
                let from = old_row / band * old_per_band
                    + Rest::place(node, old_row % band * old_columns + left as usize, old_columns);
                let to = row / band * per_band + Rest::place(node, row % band * columns, columns);
                sums[to..to + columns].copy_from_slice(&self.sums[from..from + columns]);
            }
        }
        self.sums = sums;
    }

    /// Begins a resting frame that adds so many samples per pixel.
    pub(super) fn step(&mut self, request: &FrameRequest, samples_per_pixel: f64) -> Step {
        let size = request.camera.size;
        self.columns = size.width as usize;
        self.nodes = request.plan.nodes().len();
        self.tile_rows_of_face = (request.camera.rows_of_face() as usize).div_ceil(TILE).max(1);
        let bands = size.height.div_ceil(BAND_ROWS) as usize;
        if self.progress == 0.0 {
            self.sums.clear();
            self.sums.resize(bands * self.sums_per_band(), PixelSum::default());
        }
        self.tiles.resize(bands * self.tiles_per_band(), Tile::default());
        debug_assert_eq!(self.sums.len(), bands * self.sums_per_band());
        let before = self.progress;
        self.progress += samples_per_pixel.max(1e-6);
        let seed = self.anchor.as_ref().map_or(0, |anchor| anchor.request.seed);
        Step { before, after: self.progress, seed }
    }

    /// Sums of each band, in order.
    pub(super) fn bands_mut(&mut self) -> impl IndexedParallelIterator<Item = &mut [PixelSum]> {
        let per_band = self.sums_per_band();
        self.sums.par_chunks_mut(per_band)
    }

    /// Where a node's pixel of a band has its sum.
    pub(super) fn place(node: usize, offset: usize, columns: usize) -> usize {
        node * BAND_ROWS as usize * columns + offset
    }

    /// Samples that each pixel has by now, up to one.
    #[cfg(test)]
    pub(super) fn progress(&self) -> f64 {
        self.progress
    }

    /// Whether the cache is no longer shown anywhere.
    pub(super) fn is_full(&self) -> bool {
        self.progress >= f64::from(FULL_SAMPLES) + 1.0
    }

    /// Mixes the means into the rows, which hold the picture of the cache.
    pub(super) fn mix(&mut self, rows: &mut [TreeRows<'_>]) {
        let (sums_per_band, tiles_per_band) = (self.sums_per_band(), self.tiles_per_band());
        let Rest { sums, tiles, columns, nodes, tile_rows_of_face, .. } = self;
        let (columns, nodes, rows_of_face) = (*columns, *nodes, *tile_rows_of_face);
        let across = columns.div_ceil(TILE);
        let sums_of = sums.par_chunks(sums_per_band);
        tiles.par_chunks_mut(tiles_per_band).zip(sums_of).zip(&*rows).for_each(|((tiles, sums), rows)| {
            for (index, tile) in tiles.iter_mut().enumerate() {
                let (node, row, column) = (index / across / TILE_ROWS, index / across % TILE_ROWS, index % across);
                *tile = Tile::of(rows, sums, node, columns, (row * TILE, column * TILE));
            }
        });
        let tiles = &*tiles;
        let sums_of = sums.par_chunks(sums_per_band);
        rows.par_iter_mut().zip(sums_of).enumerate().for_each(|(band, (rows, sums))| {
            let bands = tiles.len() / tiles_per_band;
            let tile_at = |node: usize, row: usize, column: usize| {
                let row = row.min(bands * TILE_ROWS - 1);
                tiles[row / TILE_ROWS * tiles_per_band + (node * TILE_ROWS + row % TILE_ROWS) * across + column]
            };
            for node in 0..nodes {
                for offset in 0..rows.nodes[node].distance.len() {
                    let sum = &sums[Rest::place(node, offset, columns)];
                    if sum.samples == 0 {
                        continue;
                    }
                    // Between the centres of four tiles.
                    let (row, column) = (band * BAND_ROWS as usize + offset / columns, offset % columns);
                    let between = |index: usize, count: usize| {
                        let position = ((index as f32 + 0.5) / TILE as f32 - 0.5).clamp(0.0, (count - 1) as f32);
                        (position as usize, (position as usize + 1).min(count - 1), position.fract())
                    };
                    let first = row / (rows_of_face * TILE) * rows_of_face;
                    let (top, bottom, down) = between(row - first * TILE, rows_of_face.min(bands * TILE_ROWS - first));
                    let (top, bottom) = (first + top, first + bottom);
                    let (left, right, along) = between(column, across);
                    let upper = tile_at(node, top, left).mixed(&tile_at(node, top, right), along);
                    let lower = tile_at(node, bottom, left).mixed(&tile_at(node, bottom, right), along);
                    let weight = upper.mixed(&lower, down).weight_of(sum.samples as f32);
                    for (channel, mean) in rows.nodes[node].radiance.iter_mut().zip(sum.mean().to_array()) {
                        channel[offset] += weight * (mean - channel[offset]);
                    }
                }
            }
        });
    }

    fn sums_per_band(&self) -> usize {
        self.nodes * BAND_ROWS as usize * self.columns
    }

    fn tiles_per_band(&self) -> usize {
        self.nodes * TILE_ROWS * self.columns.div_ceil(TILE)
    }
}

/// Rows of tiles in a band.
const TILE_ROWS: usize = BAND_ROWS as usize / TILE;

impl PixelSum {
    /// Adds a sample.
    pub(super) fn add(&mut self, radiance: Vec3) {
        self.samples += 1;
        self.radiance += radiance.as_dvec3();
        let luminance = luminance(radiance);
        self.square += (luminance * luminance - self.square) / self.samples as f32;
    }

    fn mean(&self) -> Vec3 {
        (self.radiance / f64::from(self.samples.max(1))).as_vec3()
    }
}

impl Tile {
    fn of(rows: &TreeRows<'_>, sums: &[PixelSum], node: usize, columns: usize, (top, left): (usize, usize)) -> Tile {
        let height = rows.rows.len();
        let radiance = &rows.nodes[node].radiance;
        let (mut freedom, mut squares) = (0.0, 0.0);
        let (mut pixels, mut difference2, mut inverse, mut shown2) = (0.0, 0.0, 0.0, 0.0);
        for row in top..(top + TILE).min(height) {
            for column in left..(left + TILE).min(columns) {
                let offset = row * columns + column;
                let sum = &sums[Rest::place(node, offset, columns)];
                if sum.samples == 0 {
                    continue;
                }
                let samples = sum.samples as f32;
                let mean = luminance(sum.mean());
                let shown = luminance(Vec3::from_array([0, 1, 2].map(|channel: usize| radiance[channel][offset])));
                freedom += samples - 1.0;
                squares += samples * (sum.square - mean * mean).max(0.0);
                pixels += 1.0;
                shown2 += shown * shown;
                difference2 += (mean - shown) * (mean - shown);
                inverse += 1.0 / samples;
            }
        }
        if freedom < MIN_FREEDOM {
            return Tile { bias2: 0.0, variance: 0.0 };
        }
        let guess = GUESSED_VARIANCE * shown2 / pixels;
        let variance = (squares + GUESS_SAMPLES * guess) / (freedom + GUESS_SAMPLES);
        Tile { bias2: ((difference2 - (1.0 + DOUBT) * variance * inverse) / pixels).max(0.0), variance }
    }

    fn mixed(&self, other: &Tile, t: f32) -> Tile {
        let mix = |a: f32, b: f32| a + t * (b - a);
        Tile { bias2: mix(self.bias2, other.bias2), variance: mix(self.variance, other.variance) }
    }

    /// Weight of a mean of so many samples.
    fn weight_of(&self, samples: f32) -> f32 {
        let noise = self.variance / samples;
        let by_error = if self.bias2 > 0.0 { self.bias2 / (self.bias2 + noise) } else { 0.0 };
        by_error.max(samples / FULL_SAMPLES).min(1.0)
    }
}

/// Where in the picture of `a` that of `b` begins, if it shows the same or a part of it, as far as [`TOLERANCE_PX`]
/// tells.
fn part_of(a: &FrameRequest, b: &FrameRequest) -> Option<[u32; 2]> {
    let tolerance_rad = TOLERANCE_PX / f64::from(a.camera.focal_px().max_element());
    let same = a.plan == b.plan
        && a.max_depth == b.max_depth
        && a.render_pose.angle_to(&b.render_pose) <= tolerance_rad
        && (a.render_pose.position - b.render_pose.position).length() <= tolerance_rad * NEAREST_M;
    if same { b.camera.offset_in(&a.camera) } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;

    #[test]
    fn stability_accumulation_at_rest() {
        let mut off = bound!("accumulation", "mean of a pixel at rest, relative", 1e-5);
        for outlier in [0, 777, 999_999] {
            let (mut sum, mut exact) = (PixelSum::default(), 0.0_f64);
            for index in 0..1_000_000_u32 {
                let value = if index == outlier { 1e8 } else { 0.1 + (index % 97) as f32 * 1e-3 };
                sum.add(Vec3::splat(value));
                exact += f64::from(value) / 1e6;
            }
            off.see((f64::from(sum.mean().x) / exact - 1.0).abs(), outlier);
        }
    }
}
