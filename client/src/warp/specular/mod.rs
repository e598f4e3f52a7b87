//! Mode `specular`: every node warped as what it is, and put together for the eye of this moment.
//!
//! 1. [`grid`]: flows at the corners and centres of tiles of 8 x 8 pixels: the root's ([`root`]), then those of its
//!    children behind each boundary ([`chain`]).
//! 2. [`tile`]: where they agree they are interpolated (the root to 1/256 px, children to 0.04 px), elsewhere
//!    solved for at every pixel; [`shade`]: radiance is fetched there, weighted with the Fresnel term of the novel ray,
//!    and painted.
//! 3. [`holes`]: what the frame lacks is taken from other frames, and then filled from around it.
//!
//! `L = L_D + F L_R + (1 - F) L_F`, recursively, in linear light (Lochmann, 3.2.6 to 3.2.12).
//!
//! Cost is that of the fetches: one per pixel and node that is seen there.

mod chain;
mod grid;
mod holes;
mod image_distance;
mod ladder;
mod motion;
mod root;
mod shade;
mod tile;

use super::canvas::Canvas;
use super::filling::Epipole;
use super::prepared::Prepared;
use super::pyramid::{Pyramid, TILE};
use crate::lanes::Level;
use grid::Grid;
use holes::BandState;
pub use ladder::Solver;
use motion::Motion;
use rayon::prelude::*;
use root::Splat;
use tile::{Context, Counts};
use warplight_protocol::frame::MAX_NODES;
use warplight_protocol::{Camera, Pose};

/// What one node of a picture lacked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeStatistics {
    /// Pixels at which the node is seen, as a fraction of all.
    pub seen: f64,
    /// Of those, the ones whose place in the frame was not found.
    pub undefined: f64,
    /// Of those, the ones that were filled from around them.
    pub filled: f64,
}

/// The steps of a picture, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Projects cells of the frame: where to start from.
    Splat,
    /// Solves for the flows of all nodes at corners and centres of tiles.
    Samples,
    /// Flows at every pixel, and the radiance there, weighted and painted.
    Tiles,
    /// Holes: first from other frames, then from around.
    Fill,
}

impl Stage {
    /// All of them.
    pub const ALL: [Stage; 4] = [Stage::Splat, Stage::Samples, Stage::Tiles, Stage::Fill];

    /// Name in benches.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Splat => "splat",
            Stage::Samples => "flow at samples",
            Stage::Tiles => "flow, fetch, composite, tone",
            Stage::Fill => "holes",
        }
    }
}

/// Buffers of the mode, kept from picture to picture.
#[derive(Debug, Default)]
pub(super) struct Specular {
    splat: Splat,
    grid: Grid,
    states: Vec<BandState>,
    size: (usize, usize),
    node_count: usize,
}

/// Whence and whither a picture is brought.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<'a> {
    pub(super) level: Level,
    pub(super) display_pose: &'a Pose,
    pub(super) camera: &'a Camera,
}

impl View<'_> {
    fn motion(&self, frame: &Prepared) -> Motion {
        Motion::new(&frame.camera, &frame.pose, self.camera, self.display_pose)
    }

    fn size(&self) -> (usize, usize) {
        (self.camera.size.width as usize, self.camera.size.height as usize)
    }
}

impl Specular {
    /// Paints the picture of the first frame, and what that does not know from the others, the first one that does.
    pub(super) fn warp<'a>(
        &mut self,
        view: &View<'_>,
        mut frames: impl Iterator<Item = &'a Prepared>,
        canvas: &mut Canvas<'_>,
        pyramid: &mut Pyramid,
    ) {
        let Some(frame) = frames.next() else { return };
        self.splat(view, frame);
        self.sample(view, frame);
        self.tiles(view, frame, canvas, pyramid);
        self.fill(view, frames, canvas, pyramid);
    }

    /// Projects the frame's cells.
    pub(super) fn splat(&mut self, view: &View<'_>, frame: &Prepared) {
        self.splat.forward(frame, &view.motion(frame), view.camera);
    }

    /// Solves for the flows at corners and centres of tiles.
    pub(super) fn sample(&mut self, view: &View<'_>, frame: &Prepared) {
        self.size = view.size();
        self.node_count = frame.node_count;
        self.grid.solve(view.level, frame, &view.motion(frame), &self.splat, self.size);
    }

    /// Fills the tiles with flows, and paints what of them is known.
    pub(super) fn tiles(&mut self, view: &View<'_>, frame: &Prepared, canvas: &mut Canvas<'_>, pyramid: &mut Pyramid) {
        let motion = view.motion(frame);
        let Specular { splat, grid, states, size, .. } = self;
        pyramid.fit(*size, frame.node_count);
        pyramid.set_epipole(Epipole::new(&frame.pose, view.display_pose, view.camera));
        states.resize_with(grid.tiles_y, BandState::default);
        states.iter_mut().for_each(|state| state.reset(size.0, frame.node_count));
        let context = Context { frame, motion: &motion, splat, grid, width: size.0, height: size.1 };
        let bands = canvas.runs(TILE * size.0).zip(pyramid.half_bands()).zip(states);
        bands.enumerate().for_each(|(tile_y, ((mut canvas, mut half), state))| {
            tile::tiles(view.level, &context, tile_y, &mut canvas, &mut half, state);
        });
    }

    /// Fills what is unknown: from other frames, and what they do not know either from around it.
    pub(super) fn fill<'a>(
        &mut self,
        view: &View<'_>,
        others: impl Iterator<Item = &'a Prepared>,
        canvas: &mut Canvas<'_>,
        pyramid: &mut Pyramid,
    ) {
        let Specular { splat, grid, states, size, .. } = self;
        for frame in others {
            if states.iter().all(|state| state.holes.is_empty()) {
                return;
            }
            let motion = view.motion(frame);
            splat.forward(frame, &motion, view.camera);
            let context = Context { frame, motion: &motion, splat, grid, width: size.0, height: size.1 };
            holes::complete_from(view.level, &context, canvas, pyramid, states);
        }
        holes::fill(size.0, canvas, pyramid, states);
    }

    /// Which pixels of the last picture were filled with what is not known of them.
    pub(super) fn filled(&self) -> Vec<bool> {
        let mut mask = vec![false; self.size.0 * self.size.1];
        holes::mark(self.size.0, &self.states, &mut mask);
        mask
    }

    /// What each node lacked in the last picture, and the fraction of pixels at which any lacked something.
    pub(super) fn statistics(&self) -> ([NodeStatistics; MAX_NODES], f64) {
        let pixels = (self.size.0 * self.size.1).max(1) as f64;
        let mut nodes = [NodeStatistics::default(); MAX_NODES];
        for (index, node) in nodes.iter_mut().enumerate().take(self.node_count) {
            let mut sum = Counts::default();
            for state in &self.states {
                sum.seen += state.counts[index].seen;
                sum.undefined += state.counts[index].undefined;
                sum.filled += state.counts[index].filled;
            }
            let of_seen = |count: u32| f64::from(count) / f64::from(sum.seen.max(1));
            *node = NodeStatistics {
                seen: f64::from(sum.seen) / pixels,
                undefined: of_seen(sum.undefined),
                filled: of_seen(sum.filled),
            };
        }
        let holes: usize = self.states.iter().map(|state| state.holes.len()).sum();
        (nodes, holes as f64 / pixels)
    }

    /// Tiles whose root was interpolated, and tiles all of whose children were, as fractions of all.
    pub(super) fn smooth_fractions(&self) -> [f64; 2] {
        let tiles = (self.grid.tiles_x * self.grid.tiles_y).max(1) as f64;
        [0, 1].map(|kind| self.states.iter().map(|state| f64::from(state.smooth[kind])).sum::<f64>() / tiles)
    }

    /// Where each node of each pixel is found in the frame.
    pub(super) fn flows(
        &mut self,
        level: Level,
        frame: &Prepared,
        display_pose: &Pose,
        camera: &Camera,
    ) -> Vec<Vec<glam::Vec2>> {
        let view = View { level, display_pose, camera };
        self.splat(&view, frame);
        self.sample(&view, frame);
        let motion = view.motion(frame);
        let Specular { splat, grid, size, .. } = self;
        let context = Context { frame, motion: &motion, splat, grid, width: size.0, height: size.1 };
        tile::flows(level, &context)
    }
}
