//! The layers of a frame, laid out for the vector walk.
//!
//! decode -> **packed** -> march. Of each pixel one record of depths, `K` words `front << 16 | back`, codes linear in z over
//! the range that the frame's segments cover (1/65535 of it), and one record of `2 K` words with what fills the segments:
//! extinction per step of code and along the axis of view, and source radiance, as `bf16` (8 bits of mantissa: a relative
//! error of 0.2 % at most, with the exponents of a float, since extinction and radiance have no range of their own). The
//! two are apart because most records of depths that a ray passes do not touch it. `K` is the number of layers rounded
//! up to 1, 2, 4 or 8. Around the picture runs a border of empty pixels, so that a position only needs clamping.
//!
//! Over the records lie tiles of 16 and of 64 pixels with the nearest front and the furthest back in them, by which
//! empty space is skipped. Cost: at 1024x1024 and four layers 96 MB of floats are read (a third of them twice) and 48 MB of words written.

use crate::lanes::{Floats, Integers, Level, MAX_LANES, kernel};
use rayon::prelude::*;
use warplight_protocol::frame::{LayerPlanes, MAX_LAYERS, Tree};

use super::view::Pinhole;

/// Side of a small tile.
pub(super) const TILE_PX: usize = 16;
/// Small tiles along the side of a large one.
pub(super) const TILES_PER_BLOCK: usize = 4;
/// Highest code of a depth.
pub(super) const LAST_CODE: f32 = 65_535.0;
/// Depths of a segment that is none: it begins behind its end.
const NONE: u32 = 0xffff_0000;

/// Pixels of a row that are packed layer by layer where there are many: of eight layers at once there are more planes than a processor reads
/// ahead in, and of more pixels the records leave its nearest cache.
const BLOCK_PX: usize = 128;
/// Layers that are packed pixel by pixel.
const MOST_AT_ONCE: usize = 4;
/// Fewest lanes of any level.
const MIN_LANES: usize = 8;

/// Lowest and highest code of depth in a tile; the first above the second where there is nothing.
pub(super) type CodeRange = [u16; 2];
const EMPTY: CodeRange = [u16::MAX, 0];

/// See above.
#[derive(Debug, Default)]
pub(super) struct Packed {
    /// Segments of a record: 1, 2, 4 or 8; 0 where there is no volume.
    pub(super) segments: usize,
    /// Columns and rows of the frame.
    pub(super) size_px: [usize; 2],
    /// Nearest front and furthest back, metres of depth.
    pub(super) depths_m: [f32; 2],
    /// Records, of pixel (x, y) at `(y + 1) pitch + x + 1`.
    pub(super) depths: Vec<u32>,
    pub(super) fillings: Vec<u32>,
    /// Small tiles row by row, and large ones.
    pub(super) tiles: Vec<CodeRange>,
    pub(super) blocks: Vec<CodeRange>,
}

impl Packed {
    /// Pixels from one row of records to the next.
    pub(super) fn pitch(&self) -> usize {
        self.size_px[0] + 2
    }

    /// Small tiles, or large ones, in a row and in a column.
    pub(super) fn tile_counts(&self, side_px: usize) -> [usize; 2] {
        self.size_px.map(|size| size.div_ceil(side_px))
    }

    /// Codes per metre of depth.
    pub(super) fn codes_per_m(&self) -> f32 {
        LAST_CODE / (self.depths_m[1] - self.depths_m[0])
    }

    /// Takes in a frame.
    pub(super) fn pack(&mut self, level: Level, tree: &Tree) {
        let size = tree.camera.size;
        self.size_px = [size.width as usize, size.height as usize];
        self.depths_m = range_of(level, tree);
        let [nearest, furthest] = self.depths_m;
        if !(nearest < furthest && tree.layers.len() <= MAX_LAYERS) {
            self.segments = 0;
            return;
        }
        self.segments = tree.layers.len().next_power_of_two();
        let [width, height] = self.size_px;
        let (segments, pitch) = (self.segments, self.pitch());
        let records = pitch * (height + 2);
        fit(&mut self.depths, records * segments);
        fit(&mut self.fillings, records * segments * 2);
        let [across, down] = self.tile_counts(TILE_PX);
        self.tiles.clear();
        self.tiles.resize(across * down, EMPTY);
        // The border of this frame may have been inside the last one. What fills its segments is fetched along with that
        // of other lanes, and zero times anything must be zero.
        for row in [0, height + 1] {
            self.depths[pitch * row * segments..][..pitch * segments].fill(NONE);
            self.fillings[pitch * row * segments * 2..][..pitch * segments * 2].fill(0);
        }

        let input = Input {
            layers: &tree.layers,
            width,
            segments,
            nearest,
            codes_per_m: self.codes_per_m(),
            frame: Pinhole::new(&tree.camera),
        };
        let rows = pitch * segments..pitch * (height + 1) * segments;
        let bands = self.depths[rows.clone()].par_chunks_mut(TILE_PX * pitch * segments);
        let bands =
            bands.zip(self.fillings[rows.start * 2..rows.end * 2].par_chunks_mut(TILE_PX * pitch * segments * 2));
        bands.zip(self.tiles.par_chunks_mut(across)).enumerate().for_each(|(band, ((depths, fillings), tiles))| {
            pack_band(level, &input, band * TILE_PX, depths, fillings, tiles);
        });
        self.gather_blocks();
    }

    fn gather_blocks(&mut self) {
        let [across, _] = self.tile_counts(TILE_PX);
        let [blocks_across, blocks_down] = self.tile_counts(TILE_PX * TILES_PER_BLOCK);
        self.blocks.clear();
        self.blocks.resize(blocks_across * blocks_down, EMPTY);
        for (row, tiles) in self.tiles.chunks(across).enumerate() {
            for (column, tile) in tiles.iter().enumerate() {
                let block = &mut self.blocks[row / TILES_PER_BLOCK * blocks_across + column / TILES_PER_BLOCK];
                *block = [block[0].min(tile[0]), block[1].max(tile[1])];
            }
        }
    }
}

fn fit(words: &mut Vec<u32>, len: usize) {
    // Memory that is taken anew is not paid for again: every record is written anyway.
    if words.len() < len {
        words.resize(len, 0);
    }
    words.truncate(len);
}

/// Nearest front and furthest back of all segments, in metres; the first above the second where there is none.
fn range_of(level: Level, tree: &Tree) -> [f32; 2] {
    const CHUNK: usize = 1 << 16;
    let pixels = tree.camera.size.pixels();
    let chunks = tree.layers.par_iter().flat_map(|layer| {
        (0..pixels.div_ceil(CHUNK)).into_par_iter().map(move |chunk| {
            let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(pixels);
            range_of_chunk(level, &layer.front[range.clone()], &layer.back[range.clone()], &layer.optical_depth[range])
        })
    });
    chunks.reduce(|| [f32::INFINITY, 0.0], |a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

/// What a segment must be to count: of finite depths that are in order, and of some matter.
#[inline(always)]
fn counts<F: Floats>(front: F, back: F, optical_depth: F) -> F::Mask {
    let zero = F::zero();
    !front.lt(zero) & front.lt(back) & back.lt(F::splat(MAX_DEPTH_M)) & zero.lt(optical_depth)
}

/// Depths beyond are no depths: their codes would leave nothing for the others.
pub(super) const MAX_DEPTH_M: f32 = 1e9;

#[inline(always)]
fn find_range<F: Floats>(front: &[f32], back: &[f32], optical_depth: &[f32]) -> [f32; 2] {
    let (mut nearest, mut furthest) = (F::splat(f32::INFINITY), F::zero());
    for at in (0..front.len()).step_by(F::LANES) {
        let (a, b) = (F::load(front, at), F::load(back, at));
        let counts = counts(a, b, F::load(optical_depth, at));
        nearest = nearest.min(a.or(counts, nearest));
        furthest = furthest.max(b.or(counts, furthest));
    }
    let mut lanes = [[0.0; MAX_LANES]; 2];
    nearest.store(&mut lanes[0], 0);
    furthest.store(&mut lanes[1], 0);
    let mut range = [f32::INFINITY, 0.0_f32];
    for (nearest, furthest) in lanes[0].iter().zip(&lanes[1]).take(F::LANES) {
        range = [range[0].min(*nearest), range[1].max(*furthest)];
    }
    range
}

kernel!(fn range_of_chunk = find_range(front: &[f32], back: &[f32], optical_depth: &[f32]) -> [f32; 2]);

struct Input<'a> {
    layers: &'a [LayerPlanes],
    width: usize,
    segments: usize,
    nearest: f32,
    codes_per_m: f32,
    frame: Pinhole,
}

/// Records of the rows from `first_row` on, and the tiles over them.
#[inline(always)]
fn pack_rows<F: Floats>(
    input: &Input<'_>,
    first_row: usize,
    depths: &mut [u32],
    fillings: &mut [u32],
    tiles: &mut [CodeRange],
) {
    let Input { layers, width, segments, .. } = *input;
    let record_row = (width + 2) * segments;
    for (row, depths) in depths.chunks_exact_mut(record_row).enumerate() {
        let fillings = &mut fillings[row * record_row * 2..][..record_row * 2];
        depths[..segments].fill(NONE);
        depths[record_row - segments..].fill(NONE);
        fillings[..segments * 2].fill(0);
        fillings[(record_row - segments) * 2..].fill(0);
        let slope_y = (((first_row + row) as f64 + 0.5 - input.frame.centre_px.y) / input.frame.focal_px.y) as f32;
        let slope_per_px = F::splat((1.0 / input.frame.focal_px.x) as f32);
        let first_slope = ((0.5 - input.frame.centre_px.x) / input.frame.focal_px.x) as f32;
        let block = if segments > MOST_AT_ONCE { BLOCK_PX } else { F::LANES };
        for start in (0..width).step_by(block) {
            let end = if start + block < width { start + block } else { width };
            let mut nearest = [F::splat(LAST_CODE); BLOCK_PX / MIN_LANES];
            let mut furthest = [F::zero(); BLOCK_PX / MIN_LANES];
            for segment in 0..segments {
                for (group, x) in (start..end).step_by(F::LANES).enumerate() {
                    let lanes = if F::LANES < end - x { F::LANES } else { end - x };
                    let mut words = [[NONE; MAX_LANES], [0; MAX_LANES], [0; MAX_LANES]];
                    if let Some(layer) = layers.get(segment) {
                        let slope_x = (F::ramp() + F::splat(x as f32)).mul_add(slope_per_px, F::splat(first_slope));
                        let square = slope_x.mul_add(slope_x, F::splat(1.0 + slope_y * slope_y));
                        let depth_per_distance = F::splat(1.0) / square.sqrt();
                        let pixel = (first_row + row) * width + x;
                        let codes = pack_segments(input, layer, pixel, depth_per_distance, &mut words);
                        nearest[group] = nearest[group].min(codes[0]);
                        furthest[group] = furthest[group].max(codes[1]);
                    }
                    for (lane, word) in words[0].iter().take(lanes).enumerate() {
                        let record = (x + lane + 1) * segments + segment;
                        depths[record] = *word;
                        fillings[record * 2] = words[1][lane];
                        fillings[record * 2 + 1] = words[2][lane];
                    }
                }
            }
            for (group, x) in (start..end).step_by(F::LANES).enumerate() {
                let lanes = if F::LANES < end - x { F::LANES } else { end - x };
                let mut codes = [[0.0; MAX_LANES]; 2];
                nearest[group].store(&mut codes[0], 0);
                furthest[group].store(&mut codes[1], 0);
                let tile = &mut tiles[x / TILE_PX];
                for (nearest, furthest) in codes[0].iter().zip(&codes[1]).take(lanes) {
                    *tile = [tile[0].min(*nearest as u16), tile[1].max(*furthest as u16)];
                }
            }
        }
    }
}

/// One segment of as many pixels as there are lanes: words of depths and of fillings; returns codes of fronts and backs.
#[inline(always)]
fn pack_segments<F: Floats>(
    input: &Input<'_>,
    layer: &LayerPlanes,
    pixel: usize,
    depth_per_distance: F,
    words: &mut [[u32; MAX_LANES]; 3],
) -> [F; 2] {
    let (front_m, back_m) = (F::load(&layer.front, pixel), F::load(&layer.back, pixel));
    let optical_depth = F::load(&layer.optical_depth, pixel);
    let counts = counts(front_m, back_m, optical_depth);
    let (scale, least) = (F::splat(input.codes_per_m), F::splat(input.nearest));
    let half = F::splat(0.5);
    let front = ((front_m - least) * scale + half).within(0.0, LAST_CODE - 1.0).truncate().to_floats();
    let back = ((back_m - least) * scale + half).within(0.0, LAST_CODE).truncate().to_floats();
    let back = back.max(front + F::splat(1.0));
    // What the segment holds stays the same, however its ends were rounded.
    let extinction = (optical_depth / (back - front) * depth_per_distance).within(0.0, LARGEST);
    let [red, green, blue] = &layer.source;
    let red = F::load(red, pixel);
    let green = F::load(green, pixel);
    let blue = F::load(blue, pixel);
    let largest = F::splat(LARGEST);
    let counts = counts & red.lt(largest) & green.lt(largest) & blue.lt(largest);
    let front = front.or(counts, F::splat(LAST_CODE));
    let back = back.or(counts, F::zero());
    let [depths, first, second] = words;
    (front.truncate().shift_up() + back.truncate()).store(depths, 0);
    extinction.pack_upper(red.within(0.0, LARGEST)).store(first, 0);
    green.within(0.0, LARGEST).pack_upper(blue.within(0.0, LARGEST)).store(second, 0);
    [front, back]
}

/// Largest number of a record: what is above it would not be finite as a `bf16`.
const LARGEST: f32 = 3e38;

kernel!(fn pack_band = pack_rows(
    input: &Input<'_>,
    first_row: usize,
    depths: &mut [u32],
    fillings: &mut [u32],
    tiles: &mut [CodeRange],
));
