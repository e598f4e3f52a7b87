//! Interpolation between cells: the value of a pixel.
//!
//! In each grid the eight cells around a point are mixed by trilinear weights times their samples (normalised
//! convolution, Knutsson and Westin 1993): cells without a surface drop out by themselves. What a grid says is
//! then moved towards what the next coarser one says, by as much as its own noise exceeds the differences that
//! are to be expected between the two (the linear estimator of least mean squared error): flat light is
//! smoothed far, and the edge of a shadow, which is more than noise, is kept. The finest grid fades out as the
//! next one takes over with distance, so that there is no ring where levels change.
//!
//! Neighbouring pixels lie between the same cells: those are looked up once and kept in a small direct-mapped
//! table, which saves nine lookups in ten. Cost: 60 to 150 ns per point.

use super::table::luminance;
use super::{Facing, Grid, IrradianceCache, LEVELS, Place, level_of};
use glam::{IVec3, Vec3, Vec4};

/// Expected difference between a cell and the next coarser grid, relative to its light. Less blurs soft shadows
/// until there are thousands of samples, more leaves noise.
const EXPECTED_CHANGE: f32 = 0.07;
/// A difference counts as an edge beyond so many standard errors, once there are enough samples.
const EDGE_SIGMAS: f32 = 2.0;
/// Least variance of a sample relative to its mean squared, as long as there are few.
const GUESSED_VARIANCE: f32 = 0.7;
/// How many samples the variance found by a coarser grid is worth.
const GUESS_SAMPLES: f32 = 24.0;
/// Samples below which a difference hardly ever counts as an edge: one bright path among few is no edge.
const EDGE_SAMPLES: f32 = 30.0;
/// Coarser grids are not asked for less than this share.
const NEGLIGIBLE: f32 = 0.04;
/// Entries of the table: 160 KiB, so that it stays in the second-level cache.
const ENTRIES: usize = 1024;

/// The cells around a corner, or a mixture of them.
#[derive(Clone, Copy, Debug)]
struct Stencil {
    corner_name: u64,
    /// Mean times samples, and samples.
    sums: [Vec4; 8],
    /// Mean squared luminance times samples.
    squares: [f32; 8],
}

/// Stencils that were found lately; belongs to one worker and to one state of the cache.
#[derive(Debug)]
pub(crate) struct Stencils {
    entries: Vec<Stencil>,
}

/// What one grid says of a point.
#[derive(Clone, Copy)]
struct Estimate {
    mean: Vec3,
    samples: f32,
    /// Variance of one sample's luminance.
    variance: f32,
}

impl Default for Stencils {
    fn default() -> Stencils {
        let empty = Stencil { corner_name: 0, sums: [Vec4::ZERO; 8], squares: [0.0; 8] };
        Stencils { entries: vec![empty; ENTRIES] }
    }
}

impl Stencils {
    /// Forgets what was found: for another state of the cache.
    pub(crate) fn clear(&mut self) {
        self.entries.iter_mut().for_each(|entry| entry.corner_name = 0);
    }

    /// Irradiance over pi at a place; black where nothing is known.
    pub(crate) fn irradiance(&mut self, cache: &IrradianceCache, place: &Place) -> Vec3 {
        let (finest, fade) = level_of(place.cell_m);
        let mut sum = Vec3::ZERO;
        for (facing, share) in Facing::of(place.normal) {
            if share > 0.0 {
                sum += share * self.through_levels(cache, facing, finest, fade, place.position);
            }
        }
        sum
    }

    /// Mixes the grids from the finest on, until coarser ones no longer matter.
    fn through_levels(&mut self, cache: &IrradianceCache, facing: Facing, finest: i32, fade: f32, at: Vec3) -> Vec3 {
        let mut known = [(Estimate::NONE, 0.0); LEVELS as usize];
        let (mut count, mut left) = (0, 1.0);
        for level in finest..finest + LEVELS {
            let Some(estimate) = self.estimate(cache, &Grid::new(level, facing), at) else { continue };
            let trust = if level == finest { 1.0 - fade } else { 1.0 };
            known[count] = (estimate, trust);
            count += 1;
            left *= 1.0 - trust * estimate.share(luminance(estimate.mean), estimate.variance) * estimate.certainty();
            if left < NEGLIGIBLE {
                break;
            }
        }
        let Some(last) = count.checked_sub(1) else { return Vec3::ZERO };
        let (mut value, mut variance) = (known[last].0.mean, known[last].0.variance);
        for &(estimate, trust) in known[..last].iter().rev() {
            value = value.lerp(estimate.mean, trust * estimate.share(luminance(value), variance));
            variance = estimate.pooled(variance);
        }
        value
    }

    /// What the cells of a grid around a point say, if any is known.
    fn estimate(&mut self, cache: &IrradianceCache, grid: &Grid, position: Vec3) -> Option<Estimate> {
        let (corner, t) = grid.corner(position);
        let address = grid.address(corner);
        // Names are hashes: one bit more or less does not make two of them equal.
        let corner_name = address.block ^ u64::from(address.within) << 1;
        let entry = &mut self.entries[(corner_name ^ (corner_name >> 20)) as usize % ENTRIES];
        if entry.corner_name != corner_name {
            entry.corner_name = corner_name;
            // Most of the eight are in one or two blocks.
            let mut last = [(0, None); 2];
            for (index, (sum, square)) in (0_i32..).zip(entry.sums.iter_mut().zip(&mut entry.squares)) {
                let address = grid.address(corner + IVec3::new(index & 1, index >> 1 & 1, index >> 2));
                let block = match last.iter().find(|(name, _)| *name == address.block) {
                    Some(&(_, block)) => block,
                    None => {
                        let block = cache.table.block(address.block);
                        last = [(address.block, block), last[0]];
                        block
                    }
                };
                let cell = block.map(|block| &block[usize::from(address.within)]);
                (*sum, *square) = cell.map_or((Vec4::ZERO, 0.0), |cell| {
                    ((cell.mean * cell.count).extend(cell.count), cell.square * cell.count)
                });
            }
        }
        let u = Vec3::ONE - t;
        let (low, high) = (u.z, t.z);
        let planar = Vec4::new(u.x * u.y, t.x * u.y, u.x * t.y, t.x * t.y).to_array();
        let (mut sum, mut square) = (Vec4::ZERO, 0.0);
        for (index, planar) in planar.into_iter().enumerate() {
            sum += planar * (low * entry.sums[index] + high * entry.sums[index + 4]);
            square += planar * (low * entry.squares[index] + high * entry.squares[index + 4]);
        }
        (sum.w > 0.0).then(|| {
            let mean = sum.truncate() / sum.w;
            let luminance = luminance(mean);
            Estimate { mean, samples: sum.w, variance: (square / sum.w - luminance * luminance).max(0.0) }
        })
    }
}

impl Estimate {
    const NONE: Estimate = Estimate { mean: Vec3::ZERO, samples: 0.0, variance: 0.0 };

    /// The variance of a sample where a coarser grid has found `coarser`: few samples miss the rare bright ones.
    fn pooled(&self, coarser: f32) -> f32 {
        (self.variance * self.samples + coarser * GUESS_SAMPLES) / (self.samples + GUESS_SAMPLES)
    }

    /// 0 where there are too few samples, or too dark ones, to judge their own noise; 1 at best.
    fn certainty(&self) -> f32 {
        if luminance(self.mean) > 0.0 { self.samples / (self.samples + GUESS_SAMPLES) } else { 0.0 }
    }

    /// How much this estimate counts against a coarser one of luminance `expected`, whose samples have the
    /// variance `coarser`.
    fn share(&self, expected: f32, coarser: f32) -> f32 {
        let guess = GUESSED_VARIANCE * expected * expected / (1.0 + self.samples / GUESS_SAMPLES);
        let noise = self.pooled(coarser).max(guess) / self.samples;
        let difference = luminance(self.mean) - expected;
        let by_chance = EDGE_SIGMAS * EDGE_SIGMAS * noise * (1.0 + EDGE_SAMPLES / self.samples);
        let edge = (difference * difference - by_chance).max(0.0);
        let change = EXPECTED_CHANGE * EXPECTED_CHANGE * expected * expected + edge;
        if change + noise > 0.0 { change / (change + noise) } else { 1.0 }
    }
}
