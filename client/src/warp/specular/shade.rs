//! The radiance of every node at the pixels of a tile, weighted and added up: `L = L_D + F L_R + (1 - F) L_F`
//! (Lochmann, 3.2.12), the weights of a chain of boundaries having been multiplied by whoever followed it.
//!
//! Pixels go to the canvas at once. What a hole will be filled from is left behind as sums of 2 x 2 pixels: of each
//! child its own radiance, of the root the **composite**, since the root itself is black where its light is in its
//! children, and a pixel without a root has no children either. There, what is far weighs more than what is near: a
//! disocclusion shows what had been hidden.

use super::grid::{KNOWN, UNSEEN};
use super::holes::{BandState, Hole, Part};
use super::root::EDGE;
use super::tile::{Context, PIXELS, TilePixels};
use crate::lanes::{Floats, Integers, MAX_LANES, Portable};
use crate::warp::canvas::Canvas;
use crate::warp::prepared::Prepared;
use crate::warp::pyramid::{HALF, HalfBand, TILE};
use crate::warp::texture::{ALL_KNOWN, Footprint, SUBTEXELS, over_known};
use glam::{Vec3, Vec4};
use warplight_protocol::frame::MAX_NODES;

/// Where to fetch at all pixels of a tile.
pub(super) struct Footprints {
    first: [u32; PIXELS],
    x: [f32; PIXELS],
    y: [f32; PIXELS],
}

impl Footprints {
    pub(super) fn new() -> Footprints {
        Footprints { first: [0; PIXELS], x: [0.0; PIXELS], y: [0.0; PIXELS] }
    }

    /// Around these positions, each rounded to a step of a texel as texture units do: rounding errors of a
    /// thousandth of a pixel then change nothing. Rows are `pitch` apart.
    #[inline(always)]
    pub(super) fn around<F: Floats>(&mut self, u: &[f32], v: &[f32], (width, height): (usize, usize), pitch: usize) {
        for at in (0..u.len()).step_by(F::LANES) {
            let (column, x) = Footprints::along(F::load(u, at), width);
            let (row, y) = Footprints::along(F::load(v, at), height);
            (row * F::Integers::splat(pitch as i32) + column).store(&mut self.first, at);
            x.store(&mut self.x, at);
            y.store(&mut self.y, at);
        }
    }

    #[inline(always)]
    fn along<F: Floats>(position: F, size: usize) -> (F::Integers, F) {
        let steps = (position - F::splat(0.5)).within(0.0, size as f32 - 1.0);
        let rounded = steps.mul_add(F::splat(SUBTEXELS), F::splat(0.5)).truncate().to_floats();
        let position = rounded * F::splat(1.0 / SUBTEXELS);
        let first = position.min(F::splat((size as f32 - 1.5).max(0.0))).truncate();
        (first, position - first.to_floats())
    }

    #[inline(always)]
    pub(super) fn at(&self, index: usize) -> Footprint {
        Footprint { first: self.first[index] as usize, x: self.x[index], y: self.y[index] }
    }
}

/// How much a pixel of the composite counts for holes around it, by its inverse depth: what is far more than what is
/// near, since what a hole shows was hidden by what is near.
#[inline(always)]
pub(super) fn farness<F: Floats>(inverse_depth: F) -> F {
    let squared = inverse_depth.mul_add(inverse_depth, F::splat(1e-4));
    F::splat(1.0) / (squared * squared)
}

/// Fetches the radiance of all nodes at the pixels of a tile, and paints what is known of them.
#[inline(always)]
pub(super) fn shade<F: Floats>(
    context: &Context<'_>,
    tile: &TilePixels,
    (tile_x, tile_y): (usize, usize),
    (canvas, half, state): (&mut Canvas<'_>, &mut HalfBand<'_>, &mut BandState),
    [footprints, in_depths]: &mut [Footprints; 2],
) {
    let Context { frame, width, height, .. } = *context;
    if shade_plain::<F>(context, tile, (tile_x, tile_y), (canvas, half, state), footprints) {
        return;
    }
    let (left, rows) = (tile_x * TILE, TILE.min(height - tile_y * TILE));
    let columns = TILE.min(width - left);
    // By node, one bit per pixel.
    let mut missing = [0_u64; MAX_NODES];
    // Where known, the fourth number is 1.
    let mut sums = [Vec4::ZERO; PIXELS];
    let texture = frame.texture(0);
    footprints.around::<F>(&tile.u, &tile.v, frame.size(), texture.pitch);
    if !tile.smooth_root {
        in_depths.around::<F>(&tile.u, &tile.v, frame.size(), frame.layout.pitch);
    }
    state.counts[0].seen += (rows * columns) as u32;
    for row in 0..rows {
        for (index, sum) in sums.iter_mut().enumerate().skip(row * TILE).take(columns) {
            let radiance = if tile.state[index] != KNOWN {
                state.counts[0].undefined += 1;
                Vec4::ZERO
            } else if tile.smooth_root {
                over_known(texture.fetch::<F>(&footprints.at(index)))
            } else {
                let counts = same_surface(frame, &in_depths.at(index));
                over_known(texture.fetch_some(&footprints.at(index), counts))
            };
            missing[0] |= u64::from(radiance.w <= 0.0) << index;
            *sum = radiance;
        }
    }
    let mut holes = missing[0];
    for (child, missing) in missing.iter_mut().enumerate().take(frame.node_count).skip(1) {
        if tile.present >> child & 1 == 1 {
            let own;
            (own, *missing) = add_child::<F>(frame, tile, child, (rows, columns), &mut sums, footprints, state);
            for row in 0..HALF {
                *half.row(child, tile_x, row) = halved(&own, row);
            }
            holes |= *missing;
        }
    }
    for row in 0..rows {
        canvas.paint::<F>(row * width + left, &sums[row * TILE..row * TILE + columns]);
    }
    if holes != 0 {
        list_holes(frame, tile, left, holes, &missing, &mut sums, state);
    }
    let mut weights = [0.0; PIXELS];
    for at in (0..PIXELS).step_by(F::LANES) {
        farness(F::load(&tile.inverse_depth, at)).store(&mut weights, at);
    }
    for (sum, weight) in sums.iter_mut().zip(weights) {
        *sum *= weight;
    }
    for row in 0..HALF {
        *half.row(0, tile_x, row) = halved(&sums, row);
    }
    half.set_present(tile_x, tile.present | 1);
}

/// The same of a whole tile that shows the root alone, interpolated, if every texel it needs is known; most are. Tells
/// whether it was: else nothing has been painted.
#[inline(always)]
fn shade_plain<F: Floats>(
    context: &Context<'_>,
    tile: &TilePixels,
    (tile_x, tile_y): (usize, usize),
    (canvas, half, state): (&mut Canvas<'_>, &mut HalfBand<'_>, &mut BandState),
    footprints: &mut Footprints,
) -> bool {
    let Context { frame, width, height, .. } = *context;
    let (left, above) = (tile_x * TILE, tile_y * TILE);
    if !tile.smooth_root || !tile.known_root || tile.present != 0 || left + TILE > width || above + TILE > height {
        return false;
    }
    let texture = frame.texture(0);
    footprints.around::<F>(&tile.u, &tile.v, frame.size(), texture.pitch);
    let mut colors = [Vec4::ZERO; PIXELS];
    let mut least = Vec4::MAX;
    for (index, color) in colors.iter_mut().enumerate() {
        let fetched = texture.fetch::<F>(&footprints.at(index));
        least = least.min(fetched);
        *color = fetched.max(Vec4::ZERO);
    }
    if least.w < ALL_KNOWN {
        return false;
    }
    for row in 0..TILE {
        canvas.paint::<F>(row * width + left, &colors[row * TILE..(row + 1) * TILE]);
    }
    let mut weights = [0.0; MAX_LANES];
    farness(F::splat(tile.inverse_depth[PIXELS / 2])).store(&mut weights, 0);
    for row in 0..HALF {
        let cells = half.row(0, tile_x, row);
        *cells = halved(&colors, row);
        for cell in cells {
            *cell *= weights[0];
        }
    }
    half.set_present(tile_x, 1);
    state.counts[0].seen += PIXELS as u32;
    true
}

/// Adds the weighted radiance of a child to the sums. Returns the radiance, and at which pixels it is not known.
#[inline(always)]
fn add_child<F: Floats>(
    frame: &Prepared,
    tile: &TilePixels,
    child: usize,
    (rows, columns): (usize, usize),
    sums: &mut [Vec4; PIXELS],
    footprints: &mut Footprints,
    state: &mut BandState,
) -> ([Vec4; PIXELS], u64) {
    let (pixels, texture) = (&tile.children[child], frame.texture(child));
    footprints.around::<F>(&pixels.u, &pixels.v, frame.size(), texture.pitch);
    let [red, green, blue] = &pixels.weights;
    let counts = &mut state.counts[child];
    let mut own = [Vec4::ZERO; PIXELS];
    let mut missing = 0;
    for row in 0..rows {
        for index in row * TILE..row * TILE + columns {
            let seen = pixels.state[index];
            if seen == UNSEEN {
                continue;
            }
            counts.seen += 1;
            let radiance = if seen == KNOWN {
                over_known(texture.fetch::<F>(&footprints.at(index)))
            } else {
                counts.undefined += 1;
                Vec4::ZERO
            };
            sums[index] += Vec4::new(red[index], green[index], blue[index], 0.0) * radiance;
            own[index] = radiance;
            missing |= u64::from(radiance.w <= 0.0) << index;
        }
    }
    (own, missing)
}

/// A row of sums of 2 x 2 pixels.
#[inline(always)]
fn halved(pixels: &[Vec4; PIXELS], row: usize) -> [Vec4; HALF] {
    let first = 2 * row * TILE;
    let (upper, lower) = (&pixels[first..first + TILE], &pixels[first + TILE..first + 2 * TILE]);
    let mut cells = [Vec4::ZERO; HALF];
    for (column, cell) in cells.iter_mut().enumerate() {
        *cell = (upper[2 * column] + upper[2 * column + 1]) + (lower[2 * column] + lower[2 * column + 1]);
    }
    cells
}

/// Notes pixels of which something is missing, and takes them out of the sums.
#[inline(never)]
fn list_holes(
    frame: &Prepared,
    tile: &TilePixels,
    left: usize,
    mut holes: u64,
    missing: &[u64; MAX_NODES],
    sums: &mut [Vec4; PIXELS],
    state: &mut BandState,
) {
    while holes != 0 {
        let index = holes.trailing_zeros() as usize;
        holes &= holes - 1;
        let first = state.parts.len() as u32;
        for node in (0..frame.node_count).filter(|&node| missing[node] >> index & 1 == 1) {
            state.counts[node].filled += 1;
            let weights = match node {
                0 => Vec3::ONE,
                _ => Vec3::from_array([0, 1, 2].map(|channel| tile.children[node].weights[channel][index])),
            };
            let guess = if node > 0 { painted_on(frame, node, (tile.u[index], tile.v[index])) } else { Vec4::ZERO };
            state.parts.push(Part { node: node as u16, weights, guess });
        }
        state.holes.push(Hole {
            x: (left + index % TILE) as u16,
            y: (index / TILE) as u16,
            parts: [first, state.parts.len() as u32],
            sum: sums[index].truncate(),
        });
        sums[index] = Vec4::ZERO;
    }
}

/// What the frame shows of a child at the root's place: no more than painted on, but what the scene really holds about
/// there, where nothing better is known. Without weight where that is not known either.
fn painted_on(frame: &Prepared, node: usize, (u, v): (f32, f32)) -> Vec4 {
    let texture = frame.texture(node);
    let ((column, x), (row, y)) = (between(u, frame.size().0), between(v, frame.size().1));
    over_known(texture.fetch::<Portable>(&Footprint { first: row * texture.pitch + column, x, y }))
}

/// The texel whose centre lies before a position, and how far behind it that is: [`Footprints`] of one.
fn between(position: f32, size: usize) -> (usize, f32) {
    let steps = (position - 0.5).max(0.0).min(size as f32 - 1.0) * SUBTEXELS + 0.5;
    let position = steps.trunc() / SUBTEXELS;
    let first = position.min((size as f32 - 1.5).max(0.0)) as usize;
    (first, position - first as f32)
}

/// Which texels of a footprint show the surface of the nearest one.
#[inline(always)]
pub(super) fn same_surface(frame: &Prepared, at: &Footprint) -> [bool; 4] {
    let pitch = frame.layout.pitch;
    let words = &frame.inverse_depth()[at.first..at.first + pitch + 2];
    let depths = [words[0], words[1], words[pitch], words[pitch + 1]];
    let own = f32::from_bits(depths[usize::from(at.x >= 0.5) + 2 * usize::from(at.y >= 0.5)]);
    let mut same = [false; 4];
    for (same, depth) in same.iter_mut().zip(depths) {
        let other = f32::from_bits(depth);
        *same = (other - own).abs() <= EDGE * own.max(other);
    }
    same
}
