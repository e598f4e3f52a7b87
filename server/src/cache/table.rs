//! The table of cells, in blocks: bounded, set-associative, the oldest replaced.
//!
//! A block is kept in one of the four places that its name allows; when all are taken by others, it replaces
//! the one that was lit longest ago. Lookups take a shared reference and write nothing. Deposits are added
//! by shard, each by one worker and in the order of the image, so that the contents do not depend on the
//! number of threads, and sums may be floats.
//!
//! Cost: 348 bytes per block; a lookup touches a cache line for the name and one for the cell.

use super::cell::{Address, BLOCK_CELLS};
use super::change::Fade;
use glam::Vec3;
use rayon::prelude::*;

/// Places that a name may take.
const WAYS: usize = 4;
/// Independent parts of the table.
pub(crate) const SHARDS: usize = 16;

/// What is known of the light on the surfaces in a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cell {
    /// Mean of the samples: irradiance over pi.
    pub(crate) mean: Vec3,
    /// Samples in the mean, at most the cap.
    pub(crate) count: f32,
    /// Mean of the squared luminance.
    pub(crate) square: f32,
}

/// Cells that lie side by side; those without samples are not known.
pub(crate) type Block = [Cell; BLOCK_CELLS];

/// A sample on its way into a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Deposit {
    pub(crate) address: Address,
    /// Level of its grid.
    pub(crate) level: i8,
    /// Which sample of its part of the frame it is of.
    pub(crate) sample: u32,
    /// Share of the sample that belongs to the cell.
    pub(crate) weight: f32,
    /// Irradiance over pi.
    pub(crate) value: Vec3,
}

/// Luminance (Rec. 709).
pub(crate) fn luminance(color: Vec3) -> f32 {
    color.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// Names of the blocks in a set of places, and when they were lit last.
#[derive(Clone, Copy, Debug, Default)]
struct Set {
    names: [u64; WAYS],
    last_frames: [u32; WAYS],
}

/// Where a block is: a place in one of its cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Site {
    pub(crate) position: Vec3,
    /// Width of its cells.
    pub(crate) cell_m: f32,
}

/// All cells.
#[derive(Debug)]
pub(crate) struct Table {
    sets: Vec<Set>,
    blocks: Vec<[Block; WAYS]>,
    sites: Vec<[Site; WAYS]>,
    sets_per_shard: usize,
}

impl Table {
    /// A table of 2^`log2_blocks` blocks, at least one set of places per shard.
    pub(crate) fn new(log2_blocks: u32) -> Table {
        let sets_per_shard = ((1_usize << log2_blocks) / SHARDS / WAYS).max(1);
        let sets = sets_per_shard * SHARDS;
        let empty = [[Cell::default(); BLOCK_CELLS]; WAYS];
        Table {
            sets: vec![Set::default(); sets],
            blocks: vec![empty; sets],
            sites: vec![[Site::default(); WAYS]; sets],
            sets_per_shard,
        }
    }

    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        self.sets.fill(Set::default());
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.sets[..]) + size_of_val(&self.blocks[..]) + size_of_val(&self.sites[..])
    }

    /// The block of a name, if it is known.
    pub(crate) fn block(&self, name: u64) -> Option<&Block> {
        let set = shard_of(name) * self.sets_per_shard + set_of(name, self.sets_per_shard);
        let place = self.sets[set].names.iter().position(|&known| known == name)?;
        Some(&self.blocks[set][place])
    }

    /// A cell, if it is known.
    pub(crate) fn cell(&self, address: Address) -> Option<&Cell> {
        self.block(address.block).map(|block| &block[usize::from(address.within)]).filter(|cell| cell.count > 0.0)
    }

    /// Adds the deposits of a frame. `deposits` yields, for a shard, its deposits in the order of the image,
    /// with where they are. A mean runs over at most about `max_count` samples.
    pub(crate) fn add<'a, I>(&mut self, frame: u32, max_count: f32, deposits: impl Fn(usize) -> I + Sync)
    where
        I: Iterator<Item = (&'a Deposit, Site)>,
    {
        let sets_per_shard = self.sets_per_shard;
        let sets = self.sets.par_chunks_mut(sets_per_shard);
        let blocks = self.blocks.par_chunks_mut(sets_per_shard);
        let sites = self.sites.par_chunks_mut(sets_per_shard);
        sets.zip(blocks).zip(sites).enumerate().for_each(|(shard, ((sets, blocks), sites))| {
            for (deposit, site) in deposits(shard) {
                let set = set_of(deposit.address.block, sets_per_shard);
                let place = sets[set].place_for(deposit.address.block, frame, &mut blocks[set]);
                sites[set][place] = site;
                blocks[set][place][usize::from(deposit.address.within)].add(deposit, max_count);
            }
        });
    }
}

impl Table {
    /// Takes samples from the cells of each block for which `fade_at` says so.
    pub(crate) fn fade(&mut self, fade_at: impl Fn(&Site) -> Option<Fade> + Sync) {
        let of_sets = self.blocks.par_iter_mut().zip(&self.sites).zip(&self.sets);
        of_sets.with_min_len(256).for_each(|((blocks, sites), set)| {
            for (place, block) in blocks.iter_mut().enumerate().filter(|(place, _)| set.names[*place] != 0) {
                if let Some(fade) = fade_at(&sites[place]) {
                    block.iter_mut().for_each(|cell| cell.count = fade.of(cell.count));
                }
            }
        });
    }
}

/// The shard of a block's name.
pub(crate) fn shard_of(name: u64) -> usize {
    name as usize % SHARDS
}

/// The set of places of a name within its shard.
fn set_of(name: u64, sets_per_shard: usize) -> usize {
    (name >> 32) as usize % sets_per_shard
}

impl Set {
    /// The place of a block that is lit now, which may be taken from another.
    fn place_for(&mut self, name: u64, frame: u32, blocks: &mut [Block; WAYS]) -> usize {
        let place = self.names.iter().position(|&known| known == name).unwrap_or_else(|| {
            // Empty places are of frame 0.
            let oldest = self.last_frames.iter().enumerate().min_by_key(|(_, last)| **last);
            let oldest = oldest.map_or(0, |(place, _)| place);
            self.names[oldest] = name;
            blocks[oldest] = Block::default();
            oldest
        });
        self.last_frames[place] = frame;
        place
    }
}

impl Cell {
    fn add(&mut self, deposit: &Deposit, max_count: f32) {
        self.count = (self.count + deposit.weight).min(max_count);
        let gain = (deposit.weight / self.count).min(1.0);
        let luminance = luminance(deposit.value);
        self.mean += gain * (deposit.value - self.mean);
        self.square += gain * (luminance * luminance - self.square);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deposit(block: u64, within: u8, value: f32) -> Deposit {
        Deposit { address: Address { block, within }, level: 0, sample: 0, value: Vec3::splat(value), weight: 1.0 }
    }

    fn add(table: &mut Table, frame: u32, deposits: &[Deposit]) {
        let of_shard = |shard| {
            let here = deposits.iter().filter(move |deposit| shard_of(deposit.address.block) == shard);
            here.map(|deposit| (deposit, Site::default()))
        };
        table.add(frame, 1000.0, of_shard);
    }

    #[test]
    fn a_cell_holds_the_mean_of_its_samples() {
        let mut table = Table::new(10);
        add(&mut table, 1, &[deposit(5, 3, 1.0), deposit(5, 3, 2.0), deposit(21, 3, 7.0), deposit(5, 3, 6.0)]);
        let cell = table.cell(Address { block: 5, within: 3 }).unwrap();
        assert_eq!((cell.mean, cell.count), (Vec3::splat(3.0), 3.0));
        assert!((cell.square - 41.0 / 3.0).abs() < 1e-5);
        assert_eq!(table.cell(Address { block: 21, within: 3 }).unwrap().mean, Vec3::splat(7.0));
        assert!(table.cell(Address { block: 5, within: 2 }).is_none() && table.block(37).is_none());
        table.clear();
        assert!(table.block(5).is_none());
    }

    #[test]
    fn a_mean_forgets_what_is_older_than_its_cap() {
        let mut table = Table::new(8);
        for frame in 1..=2000 {
            let deposits = [deposit(16, 0, if frame <= 1000 { 1.0 } else { 3.0 })];
            table.add(frame, 50.0, |shard| {
                deposits[..usize::from(shard == 0)].iter().map(|deposit| (deposit, Site::default()))
            });
        }
        let cell = table.cell(Address { block: 16, within: 0 }).unwrap();
        assert!((cell.mean.x - 3.0).abs() < 1e-4 && cell.count == 50.0);
    }

    #[test]
    fn memory_is_bounded_and_the_oldest_blocks_make_room() {
        let mut table = Table::new(12);
        let bytes = table.bytes();
        assert_eq!(bytes, 348 << 12);
        for frame in 1..100_u64 {
            // Names as scattered as those of real blocks.
            let names = (0..1000).map(|index| ((frame * 1000 + index).wrapping_mul(0x9e37_79b9_7f4a_7c15)).max(1));
            let deposits: Vec<Deposit> = names.map(|name| deposit(name, 7, 1.0)).collect();
            add(&mut table, frame as u32, &deposits);
            let known = deposits.iter().filter(|deposit| table.cell(deposit.address).is_some()).count();
            assert!(known >= 900, "{known} of the newest blocks");
        }
        assert_eq!(table.bytes(), bytes);
    }
}
