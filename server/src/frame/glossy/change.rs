//! Has the light changed? Samples against history, tile by tile.
//!
//! Second step of the filter. A single sample says nothing about a change: its noise is as large as itself. The sum
//! over a tile of the differences between sample and history does: their scatter gives the standard error of the sum,
//! and what lies beyond some of those is a change (the temporal gradient of Schied et al. 2018, from the samples that
//! are there anyway). Where the light is c times as bright, history loses its frames as c says.
//!
//! Limits: changes within a tile that cancel, or that are smaller than its noise, are left to the scatter of the
//! neighbours ([`super::history`]) and to the length of the mean. Cost: one pass over the points.

use super::history::Reprojected;
use super::{Points, Site};
use crate::cache::luminance;
use warplight_protocol::ImageSize;

/// Rows and columns of a tile: 64 samples.
const TILE: usize = 8;
/// Standard errors that a change exceeds: fewer forget by chance, more overlook.
const SIGMAS: f32 = 3.0;
/// How fast frames are forgotten: a change by a third leaves one.
const DOUBT: f32 = 10.0;

/// Differences of samples from history, in luminance.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tile {
    difference: f32,
    squares: f32,
    sample: f32,
    history: f32,
}

/// Compares all points that have a history.
pub(super) fn compare(now: &Points, reprojected: &[Reprojected], tiles: &mut Vec<Tile>) {
    tiles.clear();
    let nodes = now.index.len() / now.size.pixels().max(1);
    tiles.resize(nodes * per_node(now.size), Tile::default());
    for (site, Reprojected { sample, history, .. }) in now.sites.iter().zip(reprojected) {
        if history.frames() <= 0.0 {
            continue;
        }
        let tile = &mut tiles[place(now.size, *site)];
        let (sample, history) = (luminance(*sample), history.luminance());
        tile.difference += sample - history;
        tile.squares += (sample - history) * (sample - history);
        tile.sample += sample;
        tile.history += history;
    }
}

impl Tile {
    /// The tile of a point.
    pub(super) fn at(tiles: &[Tile], size: ImageSize, site: Site) -> &Tile {
        &tiles[place(size, site)]
    }

    /// Frames of a history that still count.
    pub(super) fn kept(&self, frames: f32) -> f32 {
        let change = (self.difference.abs() - SIGMAS * self.squares.sqrt()).max(0.0);
        let change = change / self.sample.max(self.history).max(f32::MIN_POSITIVE);
        frames / (1.0 + frames * DOUBT * change * change)
    }
}

fn per_node(size: ImageSize) -> usize {
    (size.width as usize).div_ceil(TILE) * (size.height as usize).div_ceil(TILE)
}

fn place(size: ImageSize, Site { column, row, node }: Site) -> usize {
    let across = (size.width as usize).div_ceil(TILE);
    usize::from(node) * per_node(size) + usize::from(row) / TILE * across + usize::from(column) / TILE
}
