//! Mode `specular`: every node warped as what it is, and put together for the eye of this moment.
//!
//! 1. [`grid`]: flows at the corners and centres of tiles of 8 x 8 pixels: the root's ([`root`]), then those of its
//!    children behind each boundary ([`chain`]).
//! 2. [`tile`]: where they agree they are interpolated (the root to 1/256 px, children to 0.04 px), elsewhere
//!    solved for at every pixel; radiance is fetched there and weighted with the Fresnel term of the novel ray.
//! 3. [`inpaint`]: what a node lacks is filled from around it, and added with its weight.
//! 4. Exposure and transfer to display codes.
//!
//! `L = L_D + F L_R + (1 - F) L_F`, recursively, in linear light (Lochmann, 3.2.6 to 3.2.12).
//!
//! Cost is that of the fetches: one per pixel and node that is seen there.

mod chain;
mod grid;
mod inpaint;
mod ladder;
mod motion;
mod root;
mod tile;

use super::lanes::Level;
use super::prepared::Prepared;
use super::tone::ToneTable;
use glam::Vec4;
use grid::{Grid, TILE};
use image::RgbImage;
use inpaint::Pyramid;
pub use ladder::Solver;
use motion::Motion;
use rayon::prelude::*;
use root::Splat;
use tile::{BandState, Context, Counts};
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
    /// Flows at every pixel, and the radiance there, weighted.
    Tiles,
    /// Fills holes.
    Fill,
    /// To display codes.
    Tone,
}

impl Stage {
    /// All of them.
    pub const ALL: [Stage; 5] = [Stage::Splat, Stage::Samples, Stage::Tiles, Stage::Fill, Stage::Tone];

    /// Name in benches.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Splat => "splat",
            Stage::Samples => "flow at samples",
            Stage::Tiles => "flow, fetch, composite",
            Stage::Fill => "holes",
            Stage::Tone => "tone",
        }
    }
}

/// Buffers of the mode, kept from picture to picture.
#[derive(Debug, Default)]
pub(super) struct Specular {
    splat: Splat,
    grid: Grid,
    /// Bands of a row of tiles: the pictures of all nodes, and the sum of all but the root's.
    planes: Vec<Vec4>,
    states: Vec<BandState>,
    pyramid: Pyramid,
    size: (usize, usize),
    node_count: usize,
}

impl Specular {
    /// Vectors of a band.
    fn band(&self) -> usize {
        let planes = self.node_count + usize::from(self.node_count > 1);
        planes * TILE * self.size.0
    }

    /// Warps all nodes, without filling what is unknown.
    pub(super) fn warp(&mut self, level: Level, frame: &Prepared, display_pose: &Pose, camera: &Camera) {
        self.splat(frame, display_pose, camera);
        self.sample(level, frame, display_pose, camera);
        self.tiles(level, frame, display_pose, camera);
    }

    /// Projects the frame's cells.
    pub(super) fn splat(&mut self, frame: &Prepared, display_pose: &Pose, camera: &Camera) {
        let motion = Motion::new(&frame.camera, &frame.pose, camera, display_pose);
        self.splat.forward(frame, &motion, camera);
    }

    /// Solves for the flows at corners and centres of tiles.
    pub(super) fn sample(&mut self, level: Level, frame: &Prepared, display_pose: &Pose, camera: &Camera) {
        let motion = Motion::new(&frame.camera, &frame.pose, camera, display_pose);
        self.size = (camera.size.width as usize, camera.size.height as usize);
        self.node_count = frame.node_count;
        self.grid.solve(level, frame, &motion, &self.splat, self.size);
    }

    /// Fills the tiles with flows, and with radiance what of it is known.
    pub(super) fn tiles(&mut self, level: Level, frame: &Prepared, display_pose: &Pose, camera: &Camera) {
        let motion = Motion::new(&frame.camera, &frame.pose, camera, display_pose);
        let (bands, band) = (self.grid.tiles_y, self.band());
        self.planes.resize(bands * band, Vec4::ZERO);
        self.states.resize_with(bands, BandState::default);
        for state in &mut self.states {
            state.present.resize(self.grid.tiles_x, 0);
            // Room for all that may be unknown, so that no later picture needs more.
            let most = frame.node_count * TILE * self.size.0;
            state.holes.clear();
            state.holes.reserve(most);
        }
        let Specular { splat, grid, planes, states, size, .. } = self;
        let context = Context { frame, motion: &motion, splat, grid, width: size.0, height: size.1 };
        planes.par_chunks_mut(band).zip(states).enumerate().for_each(|(tile_y, (planes, state))| {
            tile::tiles(level, &context, tile_y, planes, state);
        });
    }

    /// Fills what is unknown.
    pub(super) fn fill(&mut self) {
        let band = self.band();
        let Specular { planes, states, pyramid, size, node_count, .. } = self;
        for node in 0..*node_count {
            if states.iter().all(|state| state.counts[node].filled == 0) {
                continue;
            }
            pyramid.build(node, *size, planes, band, states);
            let pyramid = &*pyramid;
            planes.par_chunks_mut(band).zip(&*states).enumerate().for_each(|(tile_y, (planes, state))| {
                for hole in state.holes.iter().filter(|hole| usize::from(hole.node) == node) {
                    let (x, y) = (usize::from(hole.x), usize::from(hole.y));
                    let radiance = pyramid.at(x, tile_y * TILE + y);
                    let to = if node == 0 { 0 } else { *node_count * TILE * size.0 } + y * size.0 + x;
                    planes[to] += (radiance * hole.weights).extend(0.0);
                }
            });
        }
    }

    /// Adds up all nodes and writes display codes.
    pub(super) fn tone(&self, tone: &ToneTable, exposure: f32, picture: &mut RgbImage) {
        let width = self.size.0;
        let sum = self.node_count * TILE * width;
        let bands = picture.par_chunks_mut(3 * TILE * width).zip(self.planes.par_chunks(self.band()));
        bands.zip(&self.states).for_each(|((codes, planes), state)| {
            let (roots, sums) = planes.split_at(sum);
            let white = |value: Vec4| {
                let [red, green, blue, _] = (value * exposure).to_array();
                [red, green, blue].map(|channel| tone.srgb8_from_linear(channel))
            };
            for (y, codes) in codes.chunks_mut(3 * width).enumerate() {
                for (tile, codes) in codes.chunks_mut(3 * TILE).enumerate() {
                    let first = y * width + tile * TILE;
                    let (codes, _) = codes.as_chunks_mut::<3>();
                    let roots = &roots[first..first + codes.len()];
                    if state.present[tile] == 0 {
                        codes.iter_mut().zip(roots).for_each(|(code, root)| *code = white(*root));
                    } else {
                        let sums = &sums[first..first + codes.len()];
                        codes.iter_mut().zip(roots.iter().zip(sums)).for_each(|(code, (a, b))| *code = white(*a + *b));
                    }
                }
            }
        });
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
        let holes: u32 = self.states.iter().map(|state| state.pixels_with_holes).sum();
        (nodes, f64::from(holes) / pixels)
    }

    /// Tiles whose root was interpolated, and tiles all of whose children were, as fractions of all.
    pub(super) fn smooth_fractions(&self) -> [f64; 2] {
        let tiles = (self.grid.tiles_x * self.grid.tiles_y).max(1) as f64;
        [0, 1].map(|kind| self.states.iter().map(|state| f64::from(state.smooth[kind])).sum::<f64>() / tiles)
    }

    /// Where each node of each pixel is found in the frame.
    #[cfg(test)]
    pub(super) fn flows(
        &mut self,
        level: Level,
        frame: &Prepared,
        display_pose: &Pose,
        camera: &Camera,
    ) -> Vec<Vec<glam::Vec2>> {
        let motion = Motion::new(&frame.camera, &frame.pose, camera, display_pose);
        let size = (camera.size.width as usize, camera.size.height as usize);
        self.splat.forward(frame, &motion, camera);
        self.grid.solve(level, frame, &motion, &self.splat, size);
        let Specular { splat, grid, .. } = self;
        let context = Context { frame, motion: &motion, splat, grid, width: size.0, height: size.1 };
        tile::flows(level, &context)
    }
}
