//! A row of tiles: flows at every pixel, interpolated where corners and centre agree and solved for elsewhere, then
//! the radiance of every node there.

use super::chain::Chain;
use super::grid::{ChildSample, Grid, HOLE, KNOWN, RootPoint, TILE, UNSEEN, state_of};
use super::motion::Motion;
use super::root::{EDGE, RootSample, Splat, solve};
use crate::warp::lanes::{Floats, Integers, Level, Mask, kernel};
use crate::warp::prepared::Prepared;
use crate::warp::texture::{Footprint, SUBTEXELS, over_known};
use glam::{Vec3, Vec4};
use warplight_protocol::frame::MAX_NODES;

/// Pixels of a tile.
const PIXELS: usize = TILE * TILE;
/// Largest error at the centre of a tile whose root is interpolated: the step to which positions are rounded.
const ROOT_TOLERANCE_PX: f32 = 1.0 / 256.0;
/// The same of a child. Its solver is not more precise than that where it is not interpolated.
const CHILD_TOLERANCE_PX: f32 = 0.04;
/// The same of Fresnel weights: a quarter of a display code.
const WEIGHT_TOLERANCE: f32 = 1.0 / 1024.0;

/// A pixel of a node that has to be filled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hole {
    /// Column, and row within the band.
    pub(super) x: u16,
    pub(super) y: u16,
    pub(super) node: u16,
    /// Factor on what it will be filled with.
    pub(super) weights: Vec3,
}

/// What a band counts.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    /// Pixels at which a node is seen.
    pub(super) seen: u32,
    /// Those whose position was not found.
    pub(super) undefined: u32,
    /// Those that have to be filled: undefined, or the frame does not know what is there.
    pub(super) filled: u32,
}

/// What a band has beside its picture.
#[derive(Debug, Default)]
pub(super) struct BandState {
    pub(super) holes: Vec<Hole>,
    pub(super) counts: [Counts; MAX_NODES],
    /// Pixels with a hole of any node.
    pub(super) pixels_with_holes: u32,
    /// Tiles whose root, and tiles all of whose children were interpolated.
    pub(super) smooth: [u32; 2],
    /// Nodes that are in each tile: what is not, was not written.
    pub(super) present: Vec<u16>,
}

/// What the tiles of a row are made from.
pub(super) struct Context<'a> {
    pub(super) frame: &'a Prepared,
    pub(super) motion: &'a Motion,
    pub(super) splat: &'a Splat,
    pub(super) grid: &'a Grid,
    pub(super) width: usize,
    pub(super) height: usize,
}

/// Fields of all pixels of a tile.
#[derive(Clone, Copy)]
struct ChildPixels {
    u: [f32; PIXELS],
    v: [f32; PIXELS],
    state: [f32; PIXELS],
    weights: [[f32; PIXELS]; 3],
}

struct TilePixels {
    u: [f32; PIXELS],
    v: [f32; PIXELS],
    inverse_depth: [f32; PIXELS],
    state: [f32; PIXELS],
    children: [ChildPixels; MAX_NODES],
    /// Children that are seen anywhere in the tile.
    present: u16,
    /// Whether no texel of another surface can be near.
    smooth_root: bool,
}

/// Bilinear weight of the right corners at the pixels of a tile, of the lower ones, and the pixels themselves.
struct Places {
    x: [f32; PIXELS],
    y: [f32; PIXELS],
}

const PLACES: Places = {
    let mut places = Places { x: [0.0; PIXELS], y: [0.0; PIXELS] };
    let mut index = 0;
    while index < PIXELS {
        places.x[index] = (index % TILE) as f32 + 0.5;
        places.y[index] = (index / TILE) as f32 + 0.5;
        index += 1;
    }
    places
};

/// Interpolates a field between corners over the whole tile.
#[inline(always)]
fn interpolate<F: Floats>(corners: [f32; 4], to: &mut [f32; PIXELS]) {
    let [a, b, c, d] = corners;
    let side = 1.0 / TILE as f32;
    for at in (0..PIXELS).step_by(F::LANES) {
        let (x, y) = (F::load(&PLACES.x, at) * F::splat(side), F::load(&PLACES.y, at) * F::splat(side));
        let upper = x.mul_add(F::splat(b - a), F::splat(a));
        let lower = x.mul_add(F::splat(d - c), F::splat(c));
        y.mul_add(lower - upper, upper).store(to, at);
    }
}

#[inline(always)]
fn corners_of<T: Copy>(samples: &[T; 5], field: impl Fn(&T) -> f32) -> [f32; 4] {
    [field(&samples[0]), field(&samples[1]), field(&samples[2]), field(&samples[3])]
}

/// What is off at the centre if a field is interpolated.
#[inline(always)]
fn error_at_centre<T: Copy>(samples: &[T; 5], field: impl Fn(&T) -> f32) -> f32 {
    let corners = corners_of(samples, &field);
    (0.25 * (corners[0] + corners[1] + corners[2] + corners[3]) - field(&samples[4])).abs()
}

/// The roughness of the blocks that these positions lie in; everything where one is no position.
#[inline(always)]
fn roughness_around(frame: &Prepared, positions: [(f32, f32); 5]) -> u16 {
    let (width, height) = frame.size();
    let within = |value: f32, size: usize| (value.max(0.0) as usize).min(size - 1);
    let (mut left, mut right, mut above, mut below) = (f32::MAX, f32::MIN, f32::MAX, f32::MIN);
    for (u, v) in positions {
        (left, right) = (left.min(u), right.max(u));
        (above, below) = (above.min(v), below.max(v));
    }
    // Much larger than a tile: not smooth, whatever the texels between say.
    let extent = (right - left).max(below - above);
    if extent.is_nan() || extent > 4.0 * TILE as f32 {
        return u16::MAX;
    }
    frame.roughness(within(left, width), within(right, width), within(above, height), within(below, height))
}

/// Whether the root of a tile may be interpolated.
#[inline(always)]
fn is_root_smooth(context: &Context<'_>, corners: &[RootPoint; 5], (x, y): (usize, usize), rough: u16) -> bool {
    if rough & 1 != 0 || corners.iter().any(|corner| corner.state != KNOWN) {
        return false;
    }
    let (left, above) = ((x * TILE) as f32, (y * TILE) as f32);
    let centre = glam::Vec2::new(left, above) + 0.5 * TILE as f32;
    let error = error_at_centre(corners, |corner| corner.inverse_depth);
    let error_px = error * context.motion.parallax_px(centre);
    if error_px.is_nan() || error_px >= ROOT_TOLERANCE_PX {
        return false;
    }
    // Nothing nearer may be seen between the samples.
    let side = TILE as f32;
    let Some((nearest, _)) = context.splat.around(left, left + side - 1.0, above, above + side - 1.0) else {
        return false;
    };
    let depths = corners.map(|corner| corner.inverse_depth);
    let most = depths.into_iter().fold(f32::MIN, f32::max);
    let least = depths.into_iter().fold(f32::MAX, f32::min);
    nearest <= most + (most - least) + EDGE * most
}

/// Whether a child of a tile may be interpolated; `Some(false)` where it is seen at none of the samples.
#[inline(always)]
fn is_child_smooth(
    context: &Context<'_>,
    child: usize,
    samples: &[ChildSample; 5],
    roots: &[RootPoint; 5],
    rough_root: u16,
) -> Option<bool> {
    let same_boundary = roots.iter().all(|root| root.interface == roots[0].interface);
    // The mask of a child is that of its parent's boundary, whose edges are flagged where the root is.
    let flag = 1 << child;
    if !same_boundary || rough_root & flag != 0 {
        return None;
    }
    if samples.iter().all(|sample| sample.state == UNSEEN) {
        return Some(false);
    }
    if samples.iter().any(|sample| sample.state != KNOWN) {
        return None;
    }
    let error = error_at_centre(samples, |sample| sample.u).max(error_at_centre(samples, |sample| sample.v));
    let of_weights = (0..3).map(|channel| error_at_centre(samples, |sample| sample.weights[channel]));
    let rough = roughness_around(context.frame, samples.map(|sample| (sample.u, sample.v)));
    (error < CHILD_TOLERANCE_PX && of_weights.fold(0.0, f32::max) < WEIGHT_TOLERANCE && rough & flag == 0)
        .then_some(true)
}

impl TilePixels {
    #[inline(always)]
    fn new() -> TilePixels {
        let zero = [0.0; PIXELS];
        let child = ChildPixels { u: zero, v: zero, state: [UNSEEN; PIXELS], weights: [zero; 3] };
        TilePixels {
            u: zero,
            v: zero,
            inverse_depth: zero,
            state: [KNOWN; PIXELS],
            children: [child; MAX_NODES],
            present: 0,
            smooth_root: false,
        }
    }

    #[inline(always)]
    fn flow<F: Floats>(
        &mut self,
        context: &Context<'_>,
        chain: &mut Chain<F>,
        (x, y): (usize, usize),
        state: &mut BandState,
    ) {
        let Context { frame, motion, splat, grid, .. } = *context;
        let roots = grid.root(x, y);
        let rough = roughness_around(frame, roots.map(|root| (root.u, root.v)));
        self.smooth_root = is_root_smooth(context, &roots, (x, y), rough);
        self.present = 0;
        state.smooth[0] += u32::from(self.smooth_root);
        let mut smooth_children = true;
        let mut seen = 0;
        for child in 1..frame.node_count {
            let samples = grid.child(child, x, y);
            match is_child_smooth(context, child, &samples, &roots, rough).filter(|_| self.smooth_root) {
                None => smooth_children = false,
                Some(false) => {}
                Some(true) => {
                    seen |= 1 << child;
                    let to = &mut self.children[child];
                    interpolate::<F>(corners_of(&samples, |sample| sample.u), &mut to.u);
                    interpolate::<F>(corners_of(&samples, |sample| sample.v), &mut to.v);
                    for channel in 0..3 {
                        let corners = corners_of(&samples, |sample| sample.weights[channel]);
                        interpolate::<F>(corners, &mut to.weights[channel]);
                    }
                    to.state = [KNOWN; PIXELS];
                }
            }
        }
        state.smooth[1] += u32::from(smooth_children);
        if self.smooth_root {
            interpolate::<F>(corners_of(&roots, |root| root.inverse_depth), &mut self.inverse_depth);
        }
        let (left, above) = ((x * TILE) as f32, (y * TILE) as f32);
        let (width, height) = frame.size();
        for at in (0..PIXELS).step_by(F::LANES) {
            let (x, y) = (F::load(&PLACES.x, at) + F::splat(left), F::load(&PLACES.y, at) + F::splat(above));
            let root = if self.smooth_root {
                let inverse_depth = F::load(&self.inverse_depth, at);
                let (u, v, _) = motion.old_pixel(motion.at_infinity(x, y), inverse_depth);
                let inside =
                    !u.lt(F::zero()) & !v.lt(F::zero()) & u.lt(F::splat(width as f32)) & v.lt(F::splat(height as f32));
                RootSample { u, v, inverse_depth, known: inside }
            } else {
                solve_pixels(context, (x, y), (left, above), at, splat)
            };
            root.u.store(&mut self.u, at);
            root.v.store(&mut self.v, at);
            root.inverse_depth.store(&mut self.inverse_depth, at);
            F::splat(KNOWN).or(root.known, F::splat(HOLE)).store(&mut self.state, at);
            if !smooth_children {
                chain.follow(frame, motion, (x, y), &root);
                for child in 1..frame.node_count {
                    let sample = &chain.samples[child];
                    let to = &mut self.children[child];
                    sample.u.store(&mut to.u, at);
                    sample.v.store(&mut to.v, at);
                    state_of::<F>(sample.wanted, sample.known).store(&mut to.state, at);
                    for channel in 0..3 {
                        sample.weights[channel].store(&mut to.weights[channel], at);
                    }
                    seen |= u16::from(sample.wanted.any()) << child;
                }
            }
        }
        self.present = seen;
    }
}

/// Solves for the root at every pixel: from the nearest surface around, and where that fails from the farthest.
#[inline(always)]
fn solve_pixels<F: Floats>(
    context: &Context<'_>,
    pixels: (F, F),
    (left, above): (f32, f32),
    at: usize,
    splat: &Splat,
) -> RootSample<F> {
    let (mut nearest, mut farthest) = ([0.0; 16], [0.0; 16]);
    // Starts are those of cells: four pixels share one.
    for lane in (0..F::LANES).step_by(4) {
        let (x, y) = (left + PLACES.x[at + lane] + 1.0, above + PLACES.y[at + lane]);
        let (near, far) = splat.around(x, x, y, y).unwrap_or((0.0, 0.0));
        nearest[lane..lane + 4].fill(near);
        farthest[lane..lane + 4].fill(far);
    }
    let (frame, motion) = (context.frame, context.motion);
    let mut root = solve(frame, motion, pixels, F::load(&nearest, 0), 0.0);
    if (!root.known).any() {
        let again = solve(frame, motion, pixels, F::load(&farthest, 0), 0.0);
        root.u = root.u.or(root.known, again.u);
        root.v = root.v.or(root.known, again.v);
        root.inverse_depth = root.inverse_depth.or(root.known, again.inverse_depth);
        root.known = root.known | again.known;
    }
    root
}

/// Where to fetch at all pixels of a tile.
struct Footprints {
    first: [u32; PIXELS],
    x: [f32; PIXELS],
    y: [f32; PIXELS],
}

impl Footprints {
    /// Around these positions, each rounded to a step of a texel as texture units do: rounding errors of a
    /// thousandth of a pixel then change nothing. Rows are `pitch` apart.
    #[inline(always)]
    fn around<F: Floats>(
        &mut self,
        u: &[f32; PIXELS],
        v: &[f32; PIXELS],
        (width, height): (usize, usize),
        pitch: usize,
    ) {
        for at in (0..PIXELS).step_by(F::LANES) {
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
    fn at(&self, index: usize) -> Footprint {
        Footprint { first: self.first[index] as usize, x: self.x[index], y: self.y[index] }
    }
}

/// Fetches the radiance of all nodes at the pixels of a tile and adds up the children's.
#[inline(always)]
fn shade<F: Floats>(
    context: &Context<'_>,
    tile: &TilePixels,
    (tile_x, tile_y): (usize, usize),
    planes: &mut [Vec4],
    state: &mut BandState,
    [footprints, in_depths]: &mut [Footprints; 2],
) {
    let Context { frame, width, height, .. } = *context;
    let plane = TILE * width;
    let (left, rows) = (tile_x * TILE, TILE.min(height - tile_y * TILE));
    let columns = TILE.min(width - left);
    let mut holes_at = 0_u64;
    // The root.
    let (texture, inverse_depths) = (frame.texture(0), frame.inverse_depth());
    footprints.around::<F>(&tile.u, &tile.v, frame.size(), texture.pitch);
    let depth_pitch = frame.layout.pitch;
    if !tile.smooth_root {
        in_depths.around::<F>(&tile.u, &tile.v, frame.size(), depth_pitch);
    }
    state.counts[0].seen += (rows * columns) as u32;
    for row in 0..rows {
        let shown = &mut planes[row * width + left..][..columns];
        for (column, shown) in shown.iter_mut().enumerate() {
            let index = row * TILE + column;
            let radiance = if tile.state[index] != KNOWN {
                state.counts[0].undefined += 1;
                Vec4::ZERO
            } else if tile.smooth_root {
                over_known(texture.fetch(&footprints.at(index)))
            } else {
                let counts = same_surface(&in_depths.at(index), inverse_depths, depth_pitch);
                over_known(texture.fetch_some(&footprints.at(index), counts))
            };
            *shown = if radiance.w > 0.0 {
                radiance.with_w(1.0 + tile.inverse_depth[index])
            } else {
                holes_at |= 1 << index;
                state.counts[0].filled += 1;
                state.holes.push(Hole { x: (left + column) as u16, y: row as u16, node: 0, weights: Vec3::ONE });
                Vec4::ZERO
            };
        }
    }
    // Its children.
    if tile.present == 0 {
        state.pixels_with_holes += holes_at.count_ones();
        return;
    }
    let mut sums = [Vec4::ZERO; PIXELS];
    for child in 1..frame.node_count {
        if tile.present >> child & 1 == 0 {
            continue;
        }
        let (pixels, texture) = (&tile.children[child], frame.texture(child));
        footprints.around::<F>(&pixels.u, &pixels.v, frame.size(), texture.pitch);
        let [red, green, blue] = &pixels.weights;
        let counts = &mut state.counts[child];
        for row in 0..rows {
            let shown = &mut planes[child * plane + row * width + left..][..columns];
            for (column, shown) in shown.iter_mut().enumerate() {
                let index = row * TILE + column;
                let seen = pixels.state[index];
                if seen == UNSEEN {
                    *shown = Vec4::ZERO;
                    continue;
                }
                let weights = Vec4::new(red[index], green[index], blue[index], 0.0);
                counts.seen += 1;
                let radiance = if seen == KNOWN {
                    over_known(texture.fetch(&footprints.at(index)))
                } else {
                    counts.undefined += 1;
                    Vec4::ZERO
                };
                *shown = if radiance.w > 0.0 {
                    sums[index] += weights * radiance;
                    radiance
                } else {
                    holes_at |= 1 << index;
                    counts.filled += 1;
                    let weights = weights.truncate();
                    state.holes.push(Hole { x: (left + column) as u16, y: row as u16, node: child as u16, weights });
                    Vec4::ZERO
                };
            }
        }
    }
    for row in 0..rows {
        let sum = &mut planes[frame.node_count * plane + row * width + left..][..columns];
        sum.copy_from_slice(&sums[row * TILE..row * TILE + columns]);
    }
    state.pixels_with_holes += holes_at.count_ones();
}

/// Which texels of a footprint show the surface of the nearest one.
#[inline(always)]
fn same_surface(at: &Footprint, inverse_depths: &[u32], pitch: usize) -> [bool; 4] {
    let words = &inverse_depths[at.first..at.first + pitch + 2];
    let depths = [words[0], words[1], words[pitch], words[pitch + 1]];
    let own = f32::from_bits(depths[usize::from(at.x >= 0.5) + 2 * usize::from(at.y >= 0.5)]);
    let mut same = [false; 4];
    for (same, depth) in same.iter_mut().zip(depths) {
        let other = f32::from_bits(depth);
        *same = (other - own).abs() <= EDGE * own.max(other);
    }
    same
}

#[inline(always)]
fn make_tiles<F: Floats>(context: &Context<'_>, tile_y: usize, planes: &mut [Vec4], state: &mut BandState) {
    let mut chain = Chain::<F>::new();
    let mut tile = TilePixels::new();
    let zero = [0.0; PIXELS];
    let mut footprints = [(); 2].map(|()| Footprints { first: [0; PIXELS], x: zero, y: zero });
    for tile_x in 0..context.grid.tiles_x {
        tile.flow::<F>(context, &mut chain, (tile_x, tile_y), state);
        state.present[tile_x] = tile.present;
        shade::<F>(context, &tile, (tile_x, tile_y), planes, state, &mut footprints);
    }
}

kernel!(fn row_of_tiles = make_tiles(
    context: &Context<'_>, tile_y: usize, planes: &mut [Vec4], state: &mut BandState,
));

/// Where the nodes of every pixel of a row of tiles are found in the frame; not a number where they are not.
#[cfg(test)]
#[inline(always)]
fn list_flows<F: Floats>(context: &Context<'_>, tile_y: usize, flows: &mut [Vec<glam::Vec2>], state: &mut BandState) {
    let mut chain = Chain::<F>::new();
    let mut tile = TilePixels::new();
    for tile_x in 0..context.grid.tiles_x {
        tile.flow::<F>(context, &mut chain, (tile_x, tile_y), state);
        for (node, flows) in flows.iter_mut().enumerate() {
            for index in 0..PIXELS {
                let (x, y) = (tile_x * TILE + index % TILE, tile_y * TILE + index / TILE);
                if x >= context.width || y >= context.height {
                    continue;
                }
                let child = &tile.children[node];
                let (u, v, is) = match node {
                    0 => (tile.u[index], tile.v[index], tile.state[index]),
                    _ if tile.present >> node & 1 == 0 => (0.0, 0.0, UNSEEN),
                    _ => (child.u[index], child.v[index], child.state[index]),
                };
                let found = if is == KNOWN { glam::Vec2::new(u, v) } else { glam::Vec2::NAN };
                flows[y * context.width + x] = found;
            }
        }
    }
}

#[cfg(test)]
kernel!(fn row_of_flows = list_flows(
    context: &Context<'_>, tile_y: usize, flows: &mut [Vec<glam::Vec2>], state: &mut BandState,
));

/// The flow of every node, by pixel.
#[cfg(test)]
pub(super) fn flows(level: Level, context: &Context<'_>) -> Vec<Vec<glam::Vec2>> {
    let mut flows = vec![vec![glam::Vec2::NAN; context.width * context.height]; context.frame.node_count];
    for tile_y in 0..context.grid.tiles_y {
        row_of_flows(level, context, tile_y, &mut flows, &mut BandState::default());
    }
    flows
}

/// Makes a row of tiles.
pub(super) fn tiles(level: Level, context: &Context<'_>, tile_y: usize, planes: &mut [Vec4], state: &mut BandState) {
    state.holes.clear();
    state.counts = [Counts::default(); MAX_NODES];
    state.pixels_with_holes = 0;
    state.smooth = [0; 2];
    row_of_tiles(level, context, tile_y, planes, state);
}
