//! Names of cells: which cell of which grid a point of a surface falls into.
//!
//! Grids are cubic, one per level; a cell of level n is 2^n metres wide. Surfaces that face different ways
//! (by the dominant axis of the normal, with its sign) share no cell, so the two sides of a wall and the two
//! walls of a corner stay apart. Cells are kept in blocks of 4x4 along the surface, as far as the dominant axis
//! tells where that is: neighbours on a wall are neighbours in memory. A block's name is a 64-bit hash of
//! level, facing and place: among 2^16 blocks two share a name with a probability of 1e-10.

use glam::{IVec3, Vec3};

/// Which way a surface faces: the dominant axis of its normal, and the sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Facing(u8);

impl Facing {
    /// The facings that a unit normal counts as, with their shares, which sum to 1. Around the edges of the
    /// cube of directions it is two, so that a curved surface shows no seam there.
    pub(crate) fn of(normal: Vec3) -> [(Facing, f32); 2] {
        let size = normal.abs().to_array();
        let mut order = [0, 1, 2];
        if size[order[1]] > size[order[0]] {
            order.swap(0, 1);
        }
        if size[order[2]] > size[order[0]] {
            order.swap(0, 2);
        }
        if size[order[2]] > size[order[1]] {
            order.swap(1, 2);
        }
        let facing = |axis: usize| Facing(2 * axis as u8 + u8::from(normal[axis] < 0.0));
        // Shares change where the two largest components are within this ratio of each other.
        const EDGE: f32 = 0.75;
        let ratio = size[order[1]] / size[order[0]].max(f32::MIN_POSITIVE);
        let second = 0.5 * ((ratio - EDGE) / (1.0 - EDGE)).max(0.0);
        [(facing(order[0]), 1.0 - second), (facing(order[1]), second)]
    }
}

/// Levels that grids exist for: from 2^-40 m, less than f32 resolves anywhere near a scene, to 2^40 m.
const LEVELS: std::ops::RangeInclusive<i32> = -40..=40;

/// One grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    /// Cells per metre.
    cells_per_m: f32,
    /// The axis that the surface faces along.
    axis: u8,
    salt: u64,
}

impl Grid {
    /// The grid of a level for a facing.
    pub(crate) fn new(level: i32, facing: Facing) -> Grid {
        let level = level.clamp(*LEVELS.start(), *LEVELS.end());
        let salt = mixed(((8 * level + i32::from(facing.0)) as u64).wrapping_mul(GOLDEN));
        // 2^-level, by its bits.
        Grid { cells_per_m: f32::from_bits(((127 - level) as u32) << 23), axis: facing.0 / 2, salt }
    }

    /// The cell of a point.
    pub(crate) fn cell(&self, point: Vec3) -> IVec3 {
        floor(point * self.cells_per_m)
    }

    /// The cell with the smallest coordinates of the eight whose centres surround a point, and where between
    /// these centres the point lies, from 0 to 1.
    pub(crate) fn corner(&self, point: Vec3) -> (IVec3, Vec3) {
        let position = point * self.cells_per_m - 0.5;
        let corner = floor(position);
        (corner, position - corner.as_vec3())
    }

    /// The block of a cell, and which of its cells it is.
    pub(crate) fn address(&self, cell: IVec3) -> Address {
        let (depth, u, v) = match self.axis {
            0 => (cell.x, cell.y, cell.z),
            1 => (cell.y, cell.z, cell.x),
            _ => (cell.z, cell.x, cell.y),
        };
        let across = u64::from((u >> 2) as u32) | u64::from((v >> 2) as u32) << 32;
        let across = across ^ self.salt;
        let across = (across ^ (across >> 32)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let block = mixed(across.wrapping_add((depth as u64).wrapping_mul(GOLDEN))).max(1);
        Address { block, within: (u & 3 | (v & 3) << 2) as u8 }
    }
}

/// Where a cell is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Address {
    /// Name of its block: never 0.
    pub(crate) block: u64,
    /// Which of the block's cells, below [`BLOCK_CELLS`].
    pub(crate) within: u8,
}

/// Cells of a block.
pub(crate) const BLOCK_CELLS: usize = 16;

/// 2^64 over the golden ratio.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// The finaliser of SplitMix64 (Steele et al. 2014).
fn mixed(x: u64) -> u64 {
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Farther cells are all one: no scene reaches there, and the neighbours of a cell must have names as well.
const FARTHEST: Vec3 = Vec3::splat((1 << 30) as f32);

/// The largest whole numbers that are not larger. (The instruction for it is not in every processor's basic
/// set, and a call of the library costs more than all else here.)
fn floor(position: Vec3) -> IVec3 {
    let position = position.clamp(-FARTHEST, FARTHEST);
    let toward_zero = position.as_ivec3();
    toward_zero - IVec3::from(position.cmplt(toward_zero.as_vec3()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn shares_sum_to_one_and_change_without_a_jump() {
        let mut before: Option<[(Facing, f32); 2]> = None;
        for step in 0..=10_000_u16 {
            let angle = f32::from(step) * 1e-4 * std::f32::consts::TAU;
            let shares = Facing::of(Vec3::new(angle.cos(), 0.2, angle.sin()).normalize());
            assert!((shares[0].1 + shares[1].1 - 1.0).abs() < 1e-6 && shares[1].1 >= 0.0);
            let share_of = |shares: &[(Facing, f32); 2], facing| {
                shares.iter().filter(|share| share.0 == facing).map(|share| share.1).sum::<f32>()
            };
            if let Some(before) = before {
                for (facing, share) in before {
                    assert!((share - share_of(&shares, facing)).abs() < 0.01);
                }
            }
            before = Some(shares);
        }
    }

    #[test]
    fn opposite_sides_and_neighbouring_walls_share_no_cell() {
        for (a, b) in [(Vec3::Y, -Vec3::Y), (Vec3::X, Vec3::Y), (Vec3::Z, -Vec3::X)] {
            let [(a, whole), _] = Facing::of(a);
            let [(b, _), _] = Facing::of(b);
            assert!(a != b && whole == 1.0);
            assert_ne!(Grid::new(-5, a).address(IVec3::ZERO), Grid::new(-5, b).address(IVec3::ZERO));
        }
    }

    #[test]
    fn names_of_near_cells_differ() {
        let mut names = HashSet::new();
        let side = 24;
        for level in -4..4 {
            let grid = Grid::new(level, Facing(1));
            for index in 0..side * side * side {
                names.insert(
                    grid.address(IVec3::new(index % side, index / side % side, index / side / side) - side / 2),
                );
            }
        }
        assert_eq!(names.len() as i32, 8 * side * side * side);
        assert!(names.iter().all(|address| address.block != 0 && usize::from(address.within) < BLOCK_CELLS));
    }

    #[test]
    fn points_that_are_no_number_or_far_away_do_no_harm() {
        for bad in [f32::NAN, f32::INFINITY, -1e30, 1e30] {
            let grid = Grid::new(-60, Facing::of(Vec3::splat(bad))[0].0);
            grid.address(grid.cell(Vec3::splat(bad)));
            let (corner, _) = grid.corner(Vec3::splat(bad));
            grid.address(corner);
        }
    }
}
