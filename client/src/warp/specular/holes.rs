//! Pixels of which the latest frame does not know everything: first other frames are asked, then what is left is filled
//! from around it.
//!
//! A child whose place was not found is filled with what the frame shows of it at its parent's place, painted on, so that
//! the picture is never further off than where everything is; a disocclusion, and what is not known there either, by
//! push-pull ([`Pyramid`]).
//!
//! Other frames are earlier ones, or other faces of a frame that looks around. The same chain is solved in them, at
//! these pixels alone: the work is proportional to what is missing. A pixel is taken from another frame whole or not at
//! all, since its parts belong together.

use super::chain::Chain;
use super::grid::UNSEEN;
use super::root::{RootSample, solve_from};
use super::shade::{Footprints, farness, same_surface};
use super::tile::{Context, Counts};
use crate::lanes::{Floats, Level, MAX_LANES, Mask, kernel};
use crate::warp::canvas::Canvas;
use crate::warp::pyramid::{HALF, HalfBand, Pyramid, TILE};
use crate::warp::texture::over_known;
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use warplight_protocol::frame::MAX_NODES;

/// A pixel of which something is missing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hole {
    /// Column, and row within the band.
    pub(super) x: u16,
    pub(super) y: u16,
    /// First part that is missing, and the one after the last.
    pub(super) parts: [u32; 2],
    /// What is known.
    pub(super) sum: Vec3,
}

/// A node of a pixel that is missing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) node: u16,
    /// Factor on what it will be filled with.
    pub(super) weights: Vec3,
    /// What it is filled with if no other frame knows it; without weight where that comes from around it.
    pub(super) guess: Vec4,
}

/// What a band has beside its picture.
#[derive(Debug, Default)]
pub(super) struct BandState {
    pub(super) holes: Vec<Hole>,
    pub(super) parts: Vec<Part>,
    pub(super) counts: [Counts; MAX_NODES],
    /// Tiles whose root, and tiles all of whose children were interpolated.
    pub(super) smooth: [u32; 2],
}

impl BandState {
    /// Forgets the last picture, with room for all that may be missing, so that no later picture needs more.
    pub(super) fn reset(&mut self, width: usize, node_count: usize) {
        self.holes.clear();
        self.parts.clear();
        self.holes.reserve(TILE * width);
        self.parts.reserve(node_count * TILE * width);
        self.counts = [Counts::default(); MAX_NODES];
        self.smooth = [0; 2];
    }
}

/// Takes what is missing of a band from another frame, as far as that knows it.
#[inline(always)]
fn complete<F: Floats>(
    context: &Context<'_>,
    tile_y: usize,
    canvas: &mut Canvas<'_>,
    half: &mut HalfBand<'_>,
    state: &mut BandState,
) {
    let Context { frame, motion, splat, width, .. } = *context;
    let mut chain = Chain::<F>::new();
    let mut footprints = [Footprints::new(), Footprints::new()];
    let BandState { holes, parts, counts, .. } = state;
    let mut kept = 0;
    for first in (0..holes.len()).step_by(F::LANES) {
        let last = (first + F::LANES).min(holes.len());
        let (mut x, mut y) = ([0.0; MAX_LANES], [0.0; MAX_LANES]);
        let (mut nearest, mut farthest) = ([0.0; MAX_LANES], [0.0; MAX_LANES]);
        for lane in 0..F::LANES {
            let hole = &holes[(first + lane).min(last - 1)];
            (x[lane], y[lane]) = (f32::from(hole.x) + 0.5, f32::from(hole.y) + 0.5 + (tile_y * TILE) as f32);
            (nearest[lane], farthest[lane]) = splat.around(x[lane], x[lane], y[lane], y[lane]).unwrap_or((0.0, 0.0));
        }
        let pixels = (F::load(&x, 0), F::load(&y, 0));
        let root = solve_from(frame, motion, pixels, (F::load(&nearest, 0), F::load(&farthest, 0)), 0.0);
        if !root.known.any() {
            holes.copy_within(first..last, kept);
            kept += last - first;
            continue;
        }
        chain.follow(frame, motion, pixels, &root, true);
        let shown = fetch(context, &chain, &root, &mut footprints);
        let mut weights = [0.0; MAX_LANES];
        farness(root.inverse_depth).store(&mut weights, 0);
        for lane in 0..last - first {
            let (hole, radiance) = (holes[first + lane], shown[lane]);
            if radiance.w <= 0.0 {
                holes[kept] = hole;
                kept += 1;
                continue;
            }
            let (column, row) = (usize::from(hole.x), usize::from(hole.y));
            canvas.paint::<F>(row * width + column, &[radiance]);
            half.row(0, column / TILE, row / 2)[column / 2 % HALF] += radiance * weights[lane];
            for part in &parts[hole.parts[0] as usize..hole.parts[1] as usize] {
                counts[usize::from(part.node)].filled -= 1;
            }
        }
    }
    holes.truncate(kept);
}

kernel!(
    fn complete_band = complete(
        context: &Context<'_>, tile_y: usize, canvas: &mut Canvas<'_>, half: &mut HalfBand<'_>, state: &mut BandState,
    )
);

/// The composite at some pixels; without weight where anything of it is not known.
#[inline(always)]
fn fetch<F: Floats>(
    context: &Context<'_>,
    chain: &Chain<F>,
    root: &RootSample<F>,
    [footprints, in_depths]: &mut [Footprints; 2],
) -> [Vec4; MAX_LANES] {
    let frame = context.frame;
    let (mut u, mut v) = ([0.0; MAX_LANES], [0.0; MAX_LANES]);
    let mut sums = [Vec4::ZERO; MAX_LANES];
    root.u.store(&mut u, 0);
    root.v.store(&mut v, 0);
    let texture = frame.texture(0);
    footprints.around::<F>(&u[..F::LANES], &v[..F::LANES], frame.size(), texture.pitch);
    in_depths.around::<F>(&u[..F::LANES], &v[..F::LANES], frame.size(), frame.layout.pitch);
    let known = root.known.bits();
    for lane in (0..F::LANES).filter(|lane| known >> lane & 1 == 1) {
        let counts = same_surface(frame, &in_depths.at(lane));
        sums[lane] = over_known(texture.fetch_some(&footprints.at(lane), counts));
    }
    for child in 1..frame.node_count {
        let sample = &chain.samples[child];
        let (wanted, known) = (sample.wanted.bits(), sample.known.bits());
        if wanted == 0 {
            continue;
        }
        sample.u.store(&mut u, 0);
        sample.v.store(&mut v, 0);
        let mut weights = [[UNSEEN; MAX_LANES]; 3];
        for (to, weight) in weights.iter_mut().zip(sample.weights) {
            weight.store(to, 0);
        }
        let texture = frame.texture(child);
        footprints.around::<F>(&u[..F::LANES], &v[..F::LANES], frame.size(), texture.pitch);
        for lane in (0..F::LANES).filter(|lane| wanted >> lane & 1 == 1) {
            let mut radiance = Vec4::ZERO;
            if known >> lane & 1 == 1 {
                radiance = over_known(texture.fetch::<F>(&footprints.at(lane)));
            }
            let weights = Vec4::new(weights[0][lane], weights[1][lane], weights[2][lane], 0.0);
            sums[lane] =
                if radiance.w > 0.0 && sums[lane].w > 0.0 { sums[lane] + weights * radiance } else { Vec4::ZERO };
        }
    }
    sums
}

/// Takes what is missing from another frame, as far as that knows it.
pub(super) fn complete_from(
    level: Level,
    context: &Context<'_>,
    canvas: &mut Canvas<'_>,
    pyramid: &mut Pyramid,
    states: &mut [BandState],
) {
    let bands = canvas.runs(TILE * context.width).zip(pyramid.half_bands()).zip(states);
    bands.enumerate().for_each(|(tile_y, ((mut canvas, mut half), state))| {
        complete_band(level, context, tile_y, &mut canvas, &mut half, state);
    });
}

/// Marks the pixels that are filled with what is not known of them.
pub(super) fn mark(width: usize, states: &[BandState], mask: &mut [bool]) {
    for (tile_y, BandState { holes, parts, .. }) in states.iter().enumerate() {
        for hole in holes {
            let of_hole = &parts[hole.parts[0] as usize..hole.parts[1] as usize];
            if of_hole.iter().any(|part| part.guess.w <= 0.0) {
                mask[(tile_y * TILE + usize::from(hole.y)) * width + usize::from(hole.x)] = true;
            }
        }
    }
}

/// Fills what is still missing from around it.
pub(super) fn fill(width: usize, canvas: &mut Canvas<'_>, pyramid: &mut Pyramid, states: &mut [BandState]) {
    let missing = |state: &BandState| {
        let parts = |hole: &Hole| state.parts[hole.parts[0] as usize..hole.parts[1] as usize].iter();
        let unguessed = state.holes.iter().flat_map(parts).filter(|part| part.guess.w <= 0.0);
        unguessed.fold(0_u32, |nodes, part| nodes | 1 << part.node)
    };
    let missing = states.par_iter().map(missing).reduce(|| 0, |a, b| a | b);
    states.par_iter_mut().for_each(|BandState { holes, parts, .. }| {
        for hole in holes {
            for part in &parts[hole.parts[0] as usize..hole.parts[1] as usize] {
                // Without weight it is black.
                hole.sum += part.weights * part.guess.truncate();
            }
        }
    });
    let wanted = if pyramid.leaves_holes() { 0 } else { missing };
    for node in (0..MAX_NODES).filter(|node| wanted >> node & 1 == 1) {
        pyramid.build(node);
        let pyramid = &*pyramid;
        states.par_iter_mut().enumerate().for_each(|(tile_y, BandState { holes, parts, .. })| {
            for hole in holes {
                let of_hole = &parts[hole.parts[0] as usize..hole.parts[1] as usize];
                for part in of_hole.iter().filter(|part| usize::from(part.node) == node && part.guess.w <= 0.0) {
                    let (x, y) = (usize::from(hole.x), tile_y * TILE + usize::from(hole.y));
                    hole.sum += part.weights * pyramid.at(node, x, y);
                }
            }
        });
    }
    canvas.runs(TILE * width).zip(states).for_each(|(mut canvas, state)| {
        for hole in &state.holes {
            canvas.paint_exactly(usize::from(hole.y) * width + usize::from(hole.x), &[hole.sum]);
        }
    });
}
