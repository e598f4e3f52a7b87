//! A row of tiles: flows at every pixel, interpolated where corners and centre agree and solved for elsewhere.

use super::chain::Chain;
use super::grid::{ChildSample, Grid, HOLE, KNOWN, RootPoint, UNSEEN, state_of};
use super::holes::BandState;
use super::motion::Motion;
use super::root::{EDGE, RootSample, Splat, solve_from};
use super::shade::{Footprints, shade};
use crate::lanes::{Floats, Level, MAX_LANES, Mask, kernel};
use crate::warp::canvas::Canvas;
use crate::warp::prepared::{BOUNDARY_ENDS, Prepared};
use crate::warp::pyramid::{HalfBand, TILE};
use warplight_protocol::frame::MAX_NODES;

/// Pixels of a tile.
pub(super) const PIXELS: usize = TILE * TILE;
/// Largest error at the centre of a tile whose root is interpolated: the step to which positions are rounded.
const ROOT_TOLERANCE_PX: f32 = 1.0 / 256.0;
/// The same of a child. Its solver is not more precise than that where it is not interpolated.
const CHILD_TOLERANCE_PX: f32 = 0.04;
/// The same of Fresnel weights: a quarter of a display code.
const WEIGHT_TOLERANCE: f32 = 1.0 / 1024.0;

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
pub(super) struct ChildPixels {
    pub(super) u: [f32; PIXELS],
    pub(super) v: [f32; PIXELS],
    pub(super) state: [f32; PIXELS],
    pub(super) weights: [[f32; PIXELS]; 3],
}

/// What a tile shows, and where in the frame.
pub(super) struct TilePixels {
    pub(super) u: [f32; PIXELS],
    pub(super) v: [f32; PIXELS],
    pub(super) inverse_depth: [f32; PIXELS],
    pub(super) state: [f32; PIXELS],
    pub(super) children: [ChildPixels; MAX_NODES],
    /// Children that are seen anywhere in the tile.
    pub(super) present: u16,
    /// Whether the root was interpolated: no texel of another surface can be near.
    pub(super) smooth_root: bool,
    /// Whether the root is known at every pixel.
    pub(super) known_root: bool,
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

/// The roughness of the blocks that these positions and the texels next to them lie in; everything where one is no
/// position.
#[inline(always)]
fn roughness_around(frame: &Prepared, positions: [(f32, f32); 5]) -> u16 {
    let (width, height) = frame.size();
    let within = |value: f32, size: usize| (value.max(0.0) as usize).min(size - 1);
    let (mut left, mut right, mut above, mut below) = (f32::MAX, f32::MIN, f32::MAX, f32::MIN);
    for (u, v) in positions {
        (left, right) = (left.min(u - 1.0), right.max(u + 1.0));
        (above, below) = (above.min(v - 1.0), below.max(v + 1.0));
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
            known_root: false,
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
        self.known_root = true;
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
            self.known_root &= !(!root.known).any();
            F::splat(KNOWN).or(root.known, F::splat(HOLE)).store(&mut self.state, at);
            if !smooth_children {
                chain.follow(frame, motion, (x, y), &root, rough & BOUNDARY_ENDS != 0);
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

/// Solves for the root at every pixel.
#[inline(always)]
fn solve_pixels<F: Floats>(
    context: &Context<'_>,
    pixels: (F, F),
    (left, above): (f32, f32),
    at: usize,
    splat: &Splat,
) -> RootSample<F> {
    let (mut nearest, mut farthest) = ([0.0; MAX_LANES], [0.0; MAX_LANES]);
    // Starts are those of cells: four pixels share one.
    for lane in (0..F::LANES).step_by(4) {
        let (x, y) = (left + PLACES.x[at + lane] + 1.0, above + PLACES.y[at + lane]);
        let (near, far) = splat.around(x, x, y, y).unwrap_or((0.0, 0.0));
        nearest[lane..lane + 4].fill(near);
        farthest[lane..lane + 4].fill(far);
    }
    solve_from(context.frame, context.motion, pixels, (F::load(&nearest, 0), F::load(&farthest, 0)), 0.0)
}

/// Notes where the root is, for whoever puts something before it.
fn note_depths(context: &Context<'_>, tile: &TilePixels, (tile_x, tile_y): (usize, usize), canvas: &mut Canvas<'_>) {
    let left = tile_x * TILE;
    let (rows, columns) = (TILE.min(context.height - tile_y * TILE), TILE.min(context.width - left));
    let mut known = [false; PIXELS];
    for (known, &state) in known.iter_mut().zip(&tile.state) {
        *known = state == KNOWN;
    }
    for row in 0..rows {
        let pixels = row * TILE..row * TILE + columns;
        canvas.note_depths(row * context.width + left, &tile.inverse_depth[pixels.clone()], &known[pixels]);
    }
}

#[inline(always)]
fn make_tiles<F: Floats>(
    context: &Context<'_>,
    tile_y: usize,
    canvas: &mut Canvas<'_>,
    half: &mut HalfBand<'_>,
    state: &mut BandState,
) {
    let mut chain = Chain::<F>::new();
    let mut tile = TilePixels::new();
    let mut footprints = [Footprints::new(), Footprints::new()];
    for tile_x in 0..context.grid.tiles_x {
        tile.flow::<F>(context, &mut chain, (tile_x, tile_y), state);
        if let Canvas::Behind { .. } = canvas {
            note_depths(context, &tile, (tile_x, tile_y), canvas);
        }
        shade::<F>(context, &tile, (tile_x, tile_y), (canvas, half, state), &mut footprints);
    }
}

kernel!(
    /// Makes a row of tiles.
    pub(super) fn tiles = make_tiles(
        context: &Context<'_>, tile_y: usize, canvas: &mut Canvas<'_>, half: &mut HalfBand<'_>, state: &mut BandState,
    )
);

/// Where the nodes of every pixel of a row of tiles are found in the frame; not a number where they are not.
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

kernel!(fn row_of_flows = list_flows(
    context: &Context<'_>, tile_y: usize, flows: &mut [Vec<glam::Vec2>], state: &mut BandState,
));

/// The flow of every node, by pixel.
pub(super) fn flows(level: Level, context: &Context<'_>) -> Vec<Vec<glam::Vec2>> {
    let mut flows = vec![vec![glam::Vec2::NAN; context.width * context.height]; context.frame.node_count];
    for tile_y in 0..context.grid.tiles_y {
        row_of_flows(level, context, tile_y, &mut flows, &mut BandState::default());
    }
    flows
}
