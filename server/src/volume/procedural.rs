//! Volumes of our own, made from a seed when a scene is loaded.
//!
//! Each is a density or a field over the unit cube, as a function of a point; `fill` evaluates it at the middle
//! of every cell, on all cores. The same seed gives the same volume on every machine but for the last digits:
//! randomness comes from integer hashes (`noise`), never from a clock or an address.

mod cloud;
mod noise;
mod phantom;
mod shells;

use super::{Grid, GridError};
use glam::Vec3;
use rayon::prelude::*;

/// A volume that is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Procedural {
    /// One cumulus; values are densities from 0 to 1.
    Cloud {
        /// Each gives another cloud.
        seed: u32,
    },
    /// A layer of cumuli, y up; values are densities from 0 to 1.
    Clouds {
        /// Each gives another field.
        seed: u32,
        /// Part of the sky that is covered, about; 0 to 1.
        cover: f32,
    },
    /// A head as tomographers draw it, z up; values are those of a scan with bone at 1 and brain at 0.2.
    Phantom,
    /// Spheres inside each other; values are distances from the centre, 1 at the faces of the cube, and a
    /// pattern.
    Shells,
}

impl Procedural {
    /// Its values on a grid. A cloud is denser noise the finer the grid: what cells cannot hold is left out.
    pub fn grid(self, size: [u32; 3]) -> Result<Grid, GridError> {
        match self {
            Procedural::Cloud { seed } => {
                let cloud = cloud::Cloud::new(seed);
                fill(size, |point| cloud.density(point))
            }
            Procedural::Clouds { seed, cover } => {
                let field = cloud::Field::new(seed, cover, size);
                fill(size, |point| field.density(point))
            }
            Procedural::Phantom => {
                // Edges three cells wide: narrower ones are stairs, each of which shows where a transfer function picks out
                // a value in between.
                let width = (6.0 / size.into_iter().max().unwrap_or(1).max(1) as f32).min(0.1);
                fill(size, |point| phantom::value(point * 2.0 - 1.0, width))
            }
            Procedural::Shells => fill(size, |point| shells::value(point * 2.0 - 1.0)),
        }
    }
}

/// A grid of a function of points in the unit cube.
fn fill(size: [u32; 3], value: impl Fn(Vec3) -> f32 + Sync) -> Result<Grid, GridError> {
    let [nx, ny, nz] = size.map(|side| side as usize);
    let count = nx.checked_mul(ny).and_then(|area| area.checked_mul(nz)).filter(|&count| count < 1 << 31);
    let count = count.ok_or(GridError::Size(size[0], size[1], size[2]))?;
    let mut values = vec![0.0; count];
    let cell = Vec3::ONE / Vec3::from_array(size.map(|side| side as f32));
    values.par_chunks_mut(nx.max(1)).enumerate().for_each(|(row, values)| {
        let (y, z) = (row % ny, row / ny);
        for (x, slot) in values.iter_mut().enumerate() {
            *slot = value((Vec3::new(x as f32, y as f32, z as f32) + 0.5) * cell);
        }
    });
    Grid::new(size, 1, values)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Procedural; 4] = [
        Procedural::Cloud { seed: 3 },
        Procedural::Clouds { seed: 3, cover: 0.5 },
        Procedural::Phantom,
        Procedural::Shells,
    ];

    #[test]
    fn a_seed_is_one_volume_and_another_seed_another() {
        for procedural in ALL {
            let grid = |procedural: Procedural| procedural.grid([24, 20, 28]).unwrap();
            assert_eq!(grid(procedural), grid(procedural));
            assert_eq!((grid(procedural).size(), grid(procedural).not_finite()), ([24, 20, 28], 0));
        }
        for (a, b) in [(0, 1), (7, 8), (u32::MAX, 0)] {
            let cloud = |seed| Procedural::Cloud { seed }.grid([24; 3]).unwrap();
            assert_ne!(cloud(a), cloud(b));
        }
    }

    #[test]
    fn a_volume_leaves_room_at_its_faces() {
        // Matter that is cut off by the box shows the box.
        for procedural in [Procedural::Cloud { seed: 1 }, Procedural::Cloud { seed: 2 }, Procedural::Phantom] {
            let side = 48;
            let grid = procedural.grid([side; 3]).unwrap();
            for (index, value) in grid.values().iter().enumerate() {
                let index = index as u32;
                let at = [index % side, index / side % side, index / side / side];
                let is_outermost = at.iter().any(|&axis| axis == 0 || axis == side - 1);
                assert!(!is_outermost || *value == 0.0, "{procedural:?} {at:?}: {value}");
            }
        }
    }

    #[test]
    fn densities_are_within_their_range_and_there_is_some_of_each() {
        for (procedural, size) in ALL.into_iter().zip([[48; 3], [96, 16, 96]]) {
            let grid = procedural.grid(size).unwrap();
            assert!(grid.values().iter().all(|value| (0.0..=1.0).contains(value)));
            let filled = grid.values().iter().filter(|value| **value > 0.0).count() as f64 / grid.values().len() as f64;
            let full = grid.values().iter().filter(|value| **value > 0.5).count();
            assert!((0.03..0.7).contains(&filled) && full > 100, "{procedural:?}: {filled} {full}");
        }
    }

    #[test]
    fn any_grid_size_will_do() {
        for procedural in ALL {
            for size in [[1, 1, 1], [1, 9, 2], [300, 1, 1]] {
                assert_eq!(procedural.grid(size).unwrap().size(), size);
            }
            assert!(procedural.grid([0, 1, 1]).is_err());
            assert!(procedural.grid([u32::MAX; 3]).is_err());
        }
    }
}
