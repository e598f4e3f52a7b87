//! What fills the inside of a closed surface: how much light it takes away, scatters and sends, point by point.
//!
//! Between scene and integrator: a scene's media are named by the materials of their boundaries
//! (`Material::interior`), and the integrator flies through them; frames march through them.
//!
//! Three kinds: the same everywhere; a grid of densities; values of a scanner, classified by a transfer
//! function after they were interpolated. A grid fills its unit cube and nothing beyond it. Extinction and albedo
//! are per channel. Whatever a grid holds, extinction is not negative and albedo is within [0, 1].
//!
//! Cost: one trilinear sample a point, two with a grid of albedos.

use super::{Grid, Majorants, Phase, Segment, TransferFunction};
use crate::accel::Ray;
use glam::{Affine3A, DAffine3, Vec3};
use std::ops::Range;
use std::sync::Arc;

/// A medium.
#[derive(Clone, Debug)]
pub struct Medium {
    /// What it is made of.
    pub matter: Matter,
    /// How it scatters.
    pub phase: Phase,
}

/// What a medium is made of.
#[derive(Clone, Debug)]
pub enum Matter {
    /// The same everywhere.
    Homogeneous {
        /// Per metre and channel.
        extinction_per_m: Vec3,
        /// Part of the extinction that is scattering.
        albedo: Vec3,
        /// Radiance per metre.
        emission: Vec3,
    },
    /// In proportion to a grid's values.
    Density {
        /// Of 1 or 3 channels; what is below zero counts as zero.
        density: Arc<Grid>,
        /// The grid fills the unit cube.
        unit_from_world: Affine3A,
        /// Extinction where the density is 1.
        extinction_per_m: Vec3,
        /// Part of the extinction that is scattering.
        albedo: Albedo,
        /// Radiance per metre where the density is 1.
        emission: Vec3,
    },
    /// Values with a transfer function.
    Classified {
        /// Their first channel.
        values: Arc<Grid>,
        /// The grid fills the unit cube.
        unit_from_world: Affine3A,
        /// What the values are.
        transfer: Arc<TransferFunction>,
        /// Factor on the extinction.
        extinction_scale: f32,
    },
}

/// Part of the extinction that is scattering.
#[derive(Clone, Debug)]
pub enum Albedo {
    /// The same everywhere.
    Constant(Vec3),
    /// By a grid that fills the same cube as the density.
    Grid(Arc<Grid>),
}

/// Optical properties at a point, per metre.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Optical {
    /// Absorption and scattering together.
    pub extinction: Vec3,
    /// What is scattered.
    pub scattering: Vec3,
    /// Radiance that is sent, per metre.
    pub emission: Vec3,
}

impl Medium {
    /// At a point in world; nothing outside of a grid.
    pub fn at(&self, point: Vec3) -> Optical {
        match &self.matter {
            Matter::Homogeneous { .. } => self.at_unit(Vec3::ZERO),
            Matter::Density { unit_from_world, .. } | Matter::Classified { unit_from_world, .. } => {
                let unit = unit_from_world.transform_point3(point);
                let is_inside = unit.cmpge(Vec3::ZERO).all() && unit.cmple(Vec3::ONE).all();
                if is_inside { self.at_unit(unit) } else { Optical::default() }
            }
        }
    }

    /// At a point of the grid's unit cube.
    #[inline]
    pub(crate) fn at_unit(&self, unit: Vec3) -> Optical {
        let (extinction, emission) = match &self.matter {
            Matter::Homogeneous { extinction_per_m, emission, .. } => (*extinction_per_m, *emission),
            Matter::Density { density, extinction_per_m, emission, .. } => {
                let density = density.sample_rgb(unit).max(Vec3::ZERO);
                (density * *extinction_per_m, density * *emission)
            }
            Matter::Classified { values, transfer, extinction_scale, .. } => {
                let (extinction, albedo) = transfer.at(values.sample(unit));
                let extinction = Vec3::splat(extinction * extinction_scale);
                return Optical { extinction, scattering: extinction * albedo, emission: Vec3::ZERO };
            }
        };
        Optical { extinction, scattering: extinction * self.albedo_at_unit(unit), emission }
    }

    /// Part of the extinction that is scattering, at a point in world.
    pub fn albedo_at(&self, point: Vec3) -> Vec3 {
        match &self.matter {
            Matter::Homogeneous { .. } => self.albedo_at_unit(Vec3::ZERO),
            Matter::Density { unit_from_world, .. } | Matter::Classified { unit_from_world, .. } => {
                self.albedo_at_unit(unit_from_world.transform_point3(point))
            }
        }
    }

    fn albedo_at_unit(&self, unit: Vec3) -> Vec3 {
        let albedo = match &self.matter {
            Matter::Homogeneous { albedo, .. } | Matter::Density { albedo: Albedo::Constant(albedo), .. } => *albedo,
            Matter::Density { albedo: Albedo::Grid(grid), .. } => grid.sample_rgb(unit),
            Matter::Classified { values, transfer, .. } => transfer.at(values.sample(unit)).1,
        };
        albedo.clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// Bounds of the extinction over all channels along a ray, in metres; where there are none there is nothing.
    pub fn segments_of_majorant<'a>(
        &'a self,
        ray: &Ray,
        range: Range<f32>,
    ) -> impl Iterator<Item = (Range<f32>, f32)> + 'a {
        let (whole, walk) = match self.walk(ray, range.clone()) {
            Some(walk) => (None, Some(walk)),
            None => (Some((range, self.majorant((1.0, 1.0)))), None),
        };
        let along = walk.into_iter().flatten();
        let along = along.map(move |Segment { range, values }| (range, self.majorant(values)));
        whole.into_iter().chain(along)
    }

    /// The blocks of its grid along a ray; `None` for a medium without one.
    pub(crate) fn walk<'a>(&'a self, ray: &Ray, range: Range<f32>) -> Option<Majorants<'a>> {
        match &self.matter {
            Matter::Homogeneous { .. } => None,
            Matter::Density { density: grid, unit_from_world, .. }
            | Matter::Classified { values: grid, unit_from_world, .. } => {
                Some(Majorants::new(grid, unit_from_world, ray, range))
            }
        }
    }

    /// The highest extinction of any channel where the grid's values are within these bounds.
    pub(crate) fn majorant(&self, (low, high): (f32, f32)) -> f32 {
        match &self.matter {
            Matter::Homogeneous { extinction_per_m, .. } => extinction_per_m.max_element(),
            Matter::Density { extinction_per_m, .. } => high.max(0.0) * extinction_per_m.max_element(),
            Matter::Classified { transfer, extinction_scale, .. } => {
                transfer.highest_extinction(low, high) * extinction_scale
            }
        }
    }

    /// Extinction that is everywhere at least, where the grid's values are within these bounds.
    pub(crate) fn minorant(&self, (low, _): (f32, f32)) -> Vec3 {
        match &self.matter {
            Matter::Homogeneous { extinction_per_m, .. } => *extinction_per_m,
            Matter::Density { extinction_per_m, .. } => low.max(0.0) * *extinction_per_m,
            Matter::Classified { .. } => Vec3::ZERO,
        }
    }

    /// Radiance per metre where a grid's value is 1.
    pub(crate) fn emission(&self) -> Vec3 {
        match &self.matter {
            Matter::Homogeneous { emission, .. } | Matter::Density { emission, .. } => *emission,
            Matter::Classified { .. } => Vec3::ZERO,
        }
    }

    /// Makes it so many times denser.
    pub fn scale(&mut self, factor: f32) {
        match &mut self.matter {
            Matter::Homogeneous { extinction_per_m, emission, .. }
            | Matter::Density { extinction_per_m, emission, .. } => {
                *extinction_per_m *= factor;
                *emission *= factor;
            }
            Matter::Classified { extinction_scale, .. } => *extinction_scale *= factor,
        }
    }

    /// With its grid's unit cube where `unit_from_world` says.
    pub(crate) fn placed(mut self, unit_from_world: &DAffine3) -> Medium {
        match &mut self.matter {
            Matter::Homogeneous { .. } => {}
            Matter::Density { unit_from_world: placed, .. } | Matter::Classified { unit_from_world: placed, .. } => {
                *placed = Affine3A::from_mat3_translation(
                    unit_from_world.matrix3.as_mat3(),
                    unit_from_world.translation.as_vec3(),
                );
            }
        }
        self
    }
}
