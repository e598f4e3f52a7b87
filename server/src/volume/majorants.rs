//! Bounds of a medium's extinction along a ray, piece by piece: what tracking steps by.
//!
//! Between grid and integrator. A ray through the unit cube of a grid walks its blocks (3-D DDA, Amanatides and
//! Woo 1987); each piece has the highest extinction that a sample in the block can have (local majorants,
//! Szirmay-Kalos et al. 2011), so empty blocks are left in one step, and the lowest, which needs no sampling at
//! all (Novák et al. 2014). A homogeneous medium is one piece.
//!
//! Distances are along the ray, in its own units. Limits: a piece may end an ulp beyond its block; blocks bound
//! what lies half a cell around them, too. Cost: an addition and a comparison or two per block.

use super::{Blocks, Grid};
use crate::accel::Ray;
use glam::{Affine3A, Vec3};
use std::ops::Range;

/// A piece of a ray.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    /// Along the ray, in metres.
    pub range: Range<f32>,
    /// The grid's values are between these.
    pub values: (f32, f32),
}

/// The blocks of a grid along a ray, in order; they cover all of the ray's way through the unit cube.
#[derive(Clone, Debug)]
pub struct Majorants<'a> {
    blocks: &'a Blocks,
    block: [u32; 3],
    step: [i32; 3],
    /// Where the ray leaves the block along each axis.
    exit: Vec3,
    /// Blocks per unit of the cube.
    per_unit: Vec3,
    at: f32,
    end: f32,
    /// The ray in the unit cube.
    pub(crate) unit: Ray,
}

impl<'a> Majorants<'a> {
    /// Along a ray, within a range.
    pub fn new(grid: &'a Grid, unit_from_world: &Affine3A, ray: &Ray, range: Range<f32>) -> Majorants<'a> {
        let blocks = grid.blocks();
        let unit = Ray {
            origin: unit_from_world.transform_point3(ray.origin),
            direction: unit_from_world.transform_vector3(ray.direction),
        };
        // Slabs of the cube. Parallel to a slab and on its face gives NaN, which min and max pass over: inside.
        let inverse = unit.direction.recip();
        let (low, high) = (-unit.origin * inverse, (Vec3::ONE - unit.origin) * inverse);
        let mut within = range;
        for axis in 0..3 {
            within.start = within.start.max(low[axis].min(high[axis]));
            within.end = within.end.min(low[axis].max(high[axis]));
        }
        let mut walk = Majorants {
            blocks,
            block: [0; 3],
            step: [0; 3],
            exit: Vec3::INFINITY,
            per_unit: glam::UVec3::from_array(grid.size()).as_vec3() / Blocks::CELLS as f32,
            at: within.start,
            end: within.end,
            unit,
        };
        // Not a number anywhere, or outside: nothing.
        let is_ray = unit.origin.is_finite() && unit.direction.is_finite();
        if !(is_ray && walk.at < walk.end && walk.end.is_finite() && walk.at.is_finite()) {
            walk.end = walk.at;
            return walk;
        }
        let entry = unit.at(walk.at);
        for axis in 0..3 {
            let block = ((entry[axis] * walk.per_unit[axis]).max(0.0) as u32).min(blocks.size()[axis] - 1);
            walk.block[axis] = block;
            let direction = unit.direction[axis];
            if direction != 0.0 {
                walk.step[axis] = if direction > 0.0 { 1 } else { -1 };
                walk.exit[axis] = walk.exit_along(axis);
            }
        }
        walk
    }

    /// Where the ray leaves its block along an axis: from the face, since steps added up would drift.
    fn exit_along(&self, axis: usize) -> f32 {
        let face = (self.block[axis] + u32::from(self.step[axis] > 0)) as f32 / self.per_unit[axis];
        (face - self.unit.origin[axis]) / self.unit.direction[axis]
    }

    /// What is left of the ray's way through the cube.
    pub fn extent(&self) -> Range<f32> {
        self.at..self.end
    }
}

impl Iterator for Majorants<'_> {
    type Item = Segment;

    fn next(&mut self) -> Option<Segment> {
        while self.at < self.end {
            let axis = self.exit.min_position();
            let exit = self.exit[axis];
            let values = self.blocks.bounds(self.block);
            let range = self.at..exit.min(self.end);
            let next = i64::from(self.block[axis]) + i64::from(self.step[axis]);
            if (0..i64::from(self.blocks.size()[axis])).contains(&next) && exit < self.end {
                self.block[axis] = next as u32;
                self.exit[axis] = self.exit_along(axis);
                self.at = self.at.max(exit);
            } else {
                // The last block, or rounding: it reaches to the end.
                self.at = self.end;
                return Some(Segment { range: range.start..self.end, values });
            }
            if range.start < range.end {
                return Some(Segment { range, values });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// Rays in all directions, also along the axes and in the planes between blocks: the pieces are in order, without
    /// gaps, as long as the ray's way through the cube, and no sample is beyond the bounds of its piece.
    #[test]
    fn pieces_cover_the_way_through_the_cube_and_bound_every_sample_on_it() {
        let size = [37_u32, 16, 70];
        let count = size.iter().product::<u32>();
        let values = (0..count).map(|index| (index.wrapping_mul(2_654_435_761) >> 20) as f32).collect();
        let grid = Arc::new(Grid::new(size, 1, values).unwrap());
        let placed = Affine3A::from_scale_rotation_translation(
            Vec3::new(0.5, 2.0, 1.0),
            glam::Quat::from_rotation_y(0.3),
            Vec3::splat(0.2),
        );
        for unit_from_world in [Affine3A::IDENTITY, placed] {
            for index in 0..4000_u16 {
                let part = |prime: f32| (f32::from(index) * prime.sqrt()).fract() * 2.0 - 1.0;
                let mut direction = Vec3::new(part(2.0), part(3.0), part(5.0));
                if index % 5 == 0 {
                    direction[usize::from(index) % 3] = 0.0;
                }
                if index % 7 == 0 {
                    direction = Vec3::AXES[usize::from(index) % 3];
                }
                let origin = Vec3::new(part(7.0), part(11.0), part(13.0)) * 2.0;
                // Through corners of blocks, and along their faces.
                let origin = if index % 3 == 0 { (origin * 2.0).round() / 2.0 } else { origin };
                let ray = Ray { origin, direction: direction.normalize() };
                let inside = |t: f32| {
                    let unit = unit_from_world.transform_point3(ray.at(t));
                    unit.cmpge(Vec3::splat(1e-5)).all() && unit.cmple(Vec3::splat(1.0 - 1e-5)).all()
                };
                let pieces: Vec<Segment> = Majorants::new(&grid, &unit_from_world, &ray, 0.0..8.0).collect();
                assert!(pieces.iter().all(|piece| piece.range.start < piece.range.end));
                assert!(pieces.windows(2).all(|pair| pair[0].range.end == pair[1].range.start), "{ray:?}");
                for step in 0..200_u16 {
                    let t = f32::from(step) * 0.04 + 0.013;
                    let piece = pieces.iter().find(|piece| piece.range.contains(&t));
                    assert!(piece.is_some() || !inside(t), "{ray:?} at {t}");
                    if let Some(piece) = piece.filter(|_| inside(t)) {
                        let value = grid.sample(unit_from_world.transform_point3(ray.at(t)));
                        assert!((piece.values.0..=piece.values.1).contains(&value), "{ray:?} at {t}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_ray_that_is_not_one_walks_nowhere() {
        let grid = Grid::new([9; 3], 1, vec![1.0; 729]).unwrap();
        let walk = |origin: Vec3, direction: Vec3, end: f32| {
            Majorants::new(&grid, &Affine3A::IDENTITY, &Ray { origin, direction }, 0.0..end).count()
        };
        assert_eq!(walk(Vec3::NAN, Vec3::X, 1.0), 0);
        assert_eq!(walk(Vec3::splat(0.5), Vec3::NAN, f32::NAN), 0);
        assert_eq!(walk(Vec3::splat(0.5), Vec3::X, 0.0), 0);
        assert_eq!(walk(Vec3::splat(2.0), Vec3::X, f32::INFINITY), 0);
        assert_eq!(walk(Vec3::splat(0.5), Vec3::X, f32::INFINITY), 2);
    }
}
