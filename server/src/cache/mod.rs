//! Irradiance kept in world space from frame to frame.
//!
//! What a Lambert surface sends on does not depend on the view: albedo times irradiance over pi. So the
//! irradiance that path samples find is gathered in the cells of a hash grid and outlives the frame, the
//! pose, and the mirror it was seen in. A pixel's value is interpolated between the cells around it.
//!
//! Method: hashed grids of surface points as in Binder, Fricke and Keller 2018 ("Fast Path Space Filtering by
//! Jittered Spatial Hashing") and Gautron 2020 ("Real-Time Ray-Traced Ambient Occlusion of Complex Scenes using
//! Spatial Hashing"), with three changes. Lookups interpolate between the eight cells around the point
//! (weighted by their samples) instead of jittering it. Every sample goes into `LEVELS` grids of doubling
//! width, and an estimate shrinks towards that of the next coarser grid by as much as it is uncertain: the
//! first frame is smooth, and detail follows. Samples are added in the order of the image, shard by shard,
//! never by racing threads: contents are a function of the sequence of frames alone.
//!
//! Limits: within a cell light is taken as constant (bilinear between cells): contact shadows narrower than
//! two cells are blurred. Light that changes without being noticed by `Changes` is followed at the pace of
//! [`CacheSettings::max_samples`]. Cost: 22 bytes per cell, and per frame what [`crate::frame`] states.

mod cell;
mod change;
mod stencil;
mod table;

use cell::{Address, Facing, Grid};
pub(crate) use change::{Changes, Comparison};
pub(crate) use stencil::Stencils;
pub(crate) use table::luminance;

use glam::Vec3;
use table::{Deposit, SHARDS, Site, Table, shard_of};

/// Grids that a sample of a visible point goes into, each twice as wide as the one before: 16 times between
/// the finest and the coarsest, where a first frame has about a hundred samples per cell.
pub(crate) const LEVELS: i32 = 5;
/// Grids that a sample of a point further along a path goes into: nobody looks at them closely.
const SECONDARY_LEVELS: i32 = 2;

/// How a cache keeps light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CacheSettings {
    /// Blocks of 16 cells in the table, as a power of two.
    pub log2_blocks: u32,
    /// Samples that a cell's mean runs over: more converge further, fewer follow changing light sooner.
    pub max_samples: f32,
}

impl Default for CacheSettings {
    fn default() -> CacheSettings {
        // 23 MB, a million cells: a frame of 1024x1024 pixels lights a quarter of them.
        CacheSettings { log2_blocks: 16, max_samples: 4096.0 }
    }
}

/// The light on the surfaces of one scene.
#[derive(Debug)]
pub struct IrradianceCache {
    settings: CacheSettings,
    table: Table,
    frame: u32,
}

/// The cell that was asked for last.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LastLookup {
    address: Option<Address>,
    samples: f32,
}

/// A point of a surface as the cache sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// In world.
    pub(crate) position: Vec3,
    /// Unit normal on the lit side.
    pub(crate) normal: Vec3,
    /// Width of the cells that suit its view, in metres.
    pub(crate) cell_m: f32,
}

impl IrradianceCache {
    /// An empty cache.
    pub fn new(settings: CacheSettings) -> IrradianceCache {
        IrradianceCache { settings, table: Table::new(settings.log2_blocks), frame: 0 }
    }

    /// Forgets everything: for another scene.
    pub fn clear(&mut self) {
        self.table.clear();
        self.frame = 0;
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.table.bytes()
    }

    /// Samples known at a place, in the finest grid that its view asks for. Neighbours often ask for the same
    /// cell: `last` is what was asked before.
    pub(crate) fn samples_at(&self, place: &Place, last: &mut LastLookup) -> f32 {
        let [(facing, _), _] = Facing::of(place.normal);
        let grid = Grid::new(level_of(place.cell_m).0, facing);
        let address = grid.address(grid.cell(place.position));
        if last.address != Some(address) {
            let samples = self.table.cell(address).map_or(0.0, |cell| cell.count);
            *last = LastLookup { address: Some(address), samples };
        }
        last.samples
    }

    /// Mean irradiance over pi of the cell of a place, if it rests on at least `min_samples`.
    pub(crate) fn mean_at(&self, place: &Place, min_samples: f32) -> Option<Vec3> {
        let [(facing, _), _] = Facing::of(place.normal);
        let first = level_of(place.cell_m).0;
        (first..first + SECONDARY_LEVELS).find_map(|level| {
            let grid = Grid::new(level, facing);
            let cell = self.table.cell(grid.address(grid.cell(place.position)))?;
            (cell.count >= min_samples).then_some(cell.mean)
        })
    }

    /// Adds the samples of a frame, part by part.
    pub(crate) fn add<'a>(&mut self, parts: impl Iterator<Item = &'a Deposits> + Clone + Sync) {
        self.frame = self.frame.wrapping_add(1).max(1);
        self.table.add(self.frame, self.settings.max_samples, |shard| {
            let sites = |part: &'a Deposits| move |deposit: &Deposit| part.site_of(deposit);
            parts.clone().flat_map(move |part| {
                let site = sites(part);
                part.shards[shard].iter().map(move |deposit| (deposit, site(deposit)))
            })
        });
    }

    /// Forgets samples where light has changed.
    pub(crate) fn fade(&mut self, changes: &Changes) {
        if changes.any() {
            self.table.fade(|site| changes.fade_at(site.position, site.cell_m));
        }
    }
}

/// The samples of a part of a frame, by shard.
#[derive(Debug, Default)]
pub(crate) struct Deposits {
    shards: [Vec<Deposit>; SHARDS],
    positions: Vec<Vec3>,
}

impl Deposits {
    pub(crate) fn clear(&mut self) {
        self.shards.iter_mut().for_each(Vec::clear);
        self.positions.clear();
    }

    /// A sample at a visible point.
    pub(crate) fn add_visible(&mut self, place: &Place, value: Vec3) {
        self.add(place, value, LEVELS);
    }

    /// A sample at a point further along a path.
    pub(crate) fn add_secondary(&mut self, place: &Place, value: Vec3) {
        self.add(place, value, SECONDARY_LEVELS);
    }

    /// Where the sample of a deposit was taken.
    fn site_of(&self, deposit: &Deposit) -> Site {
        Site { position: self.positions[deposit.sample as usize], cell_m: f32::from(deposit.level).exp2() }
    }

    fn add(&mut self, place: &Place, value: Vec3, levels: i32) {
        let first = level_of(place.cell_m).0;
        let sample = self.positions.len() as u32;
        self.positions.push(place.position);
        for (facing, weight) in Facing::of(place.normal) {
            if weight <= 0.0 {
                continue;
            }
            for level in first..first + levels {
                let grid = Grid::new(level, facing);
                let address = grid.address(grid.cell(place.position));
                self.shards[shard_of(address.block)].push(Deposit {
                    address,
                    level: level as i8,
                    sample,
                    value,
                    weight,
                });
            }
        }
    }
}

/// The level of the grid whose cells are at most this wide, and how far it is to the next, from 0 to 1.
fn level_of(cell_m: f32) -> (i32, f32) {
    let level = cell_m.log2().clamp(-100.0, 100.0);
    (level.floor() as i32, level - level.floor())
}

#[cfg(test)]
mod tests;
