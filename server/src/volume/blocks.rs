//! Lowest and highest values of a grid, block by block: majorants, and where there is nothing.
//!
//! A block is [`Blocks::CELLS`]^3 cells of the grid; cell (i, j, k) is the box of 1/n about its value. Within
//! a block a trilinear sample reads at most one value beyond each of its faces, so the bounds are those of the
//! cells and of one more layer around them. (Local majorants over a coarse grid: Szirmay-Kalos et al. 2011;
//! Pharr et al. 2023, 11.4.3.)
//!
//! Cost: each value is read about twice when the grid is made; 8 bytes a block, 1/64 of the grid.

use rayon::prelude::*;

/// Bounds of a grid's values within blocks of cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Blocks {
    size: [u32; 3],
    bounds: Vec<(f32, f32)>,
    all: (f32, f32),
}

/// The roundings of three nested linear interpolations, relative to the largest value: a sample between
/// values that differ may leave their range by this much. Without it a majorant could be too low by an ulp.
const ROUNDING: f32 = 8.0 * f32::EPSILON;

impl Blocks {
    /// Cells along an edge of a block. Smaller ones follow the matter more closely and take more steps.
    pub const CELLS: u32 = 8;

    /// Of a grid of finite values, x fastest, channels interleaved.
    pub(super) fn new(size: [u32; 3], channels: u8, values: &[f32]) -> Blocks {
        let blocks = size.map(|cells| cells.div_ceil(Blocks::CELLS));
        let count = blocks.iter().map(|&count| count as usize).product::<usize>();
        let of = |index: usize| {
            let (x, rest) = (index as u32 % blocks[0], index as u32 / blocks[0]);
            widened(bounds_of(size, channels, values, [x, rest % blocks[1], rest / blocks[1]]))
        };
        // To wake other threads takes longer than a few blocks do.
        let bounds: Vec<(f32, f32)> =
            if count < 64 { (0..count).map(of).collect() } else { (0..count).into_par_iter().map(of).collect() };
        let all = bounds
            .iter()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |all, bounds| (all.0.min(bounds.0), all.1.max(bounds.1)));
        Blocks { size: blocks, bounds, all }
    }

    /// Blocks along each axis. The last may reach beyond the grid.
    pub fn size(&self) -> [u32; 3] {
        self.size
    }

    /// Lowest and highest value that a sample within the block can be, over all channels. A block beyond the
    /// last counts as the last.
    pub fn bounds(&self, block: [u32; 3]) -> (f32, f32) {
        let [x, y, z] = std::array::from_fn(|axis| block[axis].min(self.size[axis] - 1) as usize);
        self.bounds[(z * self.size[1] as usize + y) * self.size[0] as usize + x]
    }

    /// Lowest and highest value that any sample can be.
    pub fn all(&self) -> (f32, f32) {
        self.all
    }
}

/// Bounds of the values that samples in a block are made of.
fn bounds_of(size: [u32; 3], channels: u8, values: &[f32], block: [u32; 3]) -> (f32, f32) {
    let channels = usize::from(channels);
    let [nx, ny, _] = size.map(|cells| cells as usize);
    let range = |axis: usize| {
        let first = block[axis] * Blocks::CELLS;
        first.saturating_sub(1) as usize..(first + Blocks::CELLS + 1).min(size[axis]) as usize
    };
    let mut bounds = (f32::INFINITY, f32::NEG_INFINITY);
    for z in range(2) {
        for y in range(1) {
            let row = (z * ny + y) * nx;
            for value in &values[(row + range(0).start) * channels..(row + range(0).end) * channels] {
                bounds = (bounds.0.min(*value), bounds.1.max(*value));
            }
        }
    }
    bounds
}

fn widened((low, high): (f32, f32)) -> (f32, f32) {
    if low == high {
        return (low, high);
    }
    let margin = low.abs().max(high.abs()) * ROUNDING;
    // What is nowhere negative stays so, and empty space beside matter may be exactly empty.
    (if low >= 0.0 { (low - margin).max(0.0) } else { low - margin }, high + margin)
}

#[cfg(test)]
mod tests {
    use super::super::Grid;
    use super::*;
    use glam::{UVec3, Vec3};

    #[test]
    fn a_lone_value_is_seen_from_every_block_that_its_samples_reach() {
        let mut values = vec![0.0; 24 * 24 * 24];
        // The last cell of the first block along x, the first of the second along y.
        values[(4 * 24 + 8) * 24 + 7] = 3.0;
        let blocks = Blocks::new([24, 24, 24], 1, &values);
        assert_eq!(blocks.size(), [3, 3, 3]);
        for z in 0..3 {
            for y in 0..3 {
                for x in 0..3 {
                    let reached = x < 2 && y < 2 && z == 0;
                    assert_eq!(blocks.bounds([x, y, z]).1 >= 3.0, reached, "{x} {y} {z}");
                    assert_eq!(blocks.bounds([x, y, z]).0, 0.0);
                }
            }
        }
        assert!(blocks.all().0 == 0.0 && blocks.all().1 >= 3.0);
    }

    #[test]
    fn no_sample_in_a_block_is_beyond_its_bounds() {
        let size = [19u32, 8, 33];
        let count = size.iter().product::<u32>();
        let values: Vec<f32> =
            (0..count).map(|index| ((index.wrapping_mul(2_654_435_761) >> 8) as f32 / 65536.0 - 100.0) * 1e3).collect();
        let grid = Grid::new(size, 1, values).unwrap();
        let mut state = 1u32;
        let mut uniform = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        for _ in 0..200_000 {
            let unit = Vec3::new(uniform(), uniform(), uniform());
            let cell = (unit * UVec3::from_array(size).as_vec3()).as_uvec3();
            let (low, high) = grid.blocks().bounds((cell / Blocks::CELLS).to_array());
            let value = grid.sample(unit);
            assert!((low..=high).contains(&value), "{unit}: {value} not in {low}..={high}");
        }
    }

    #[test]
    fn a_constant_grid_has_its_value_as_both_bounds() {
        let blocks = Blocks::new([9, 1, 1], 1, &[0.3; 9]);
        assert_eq!((blocks.size(), blocks.all(), blocks.bounds([9, 9, 9])), ([2, 1, 1], (0.3, 0.3), (0.3, 0.3)));
    }
}
