//! Samples of the light on a diffuse surface, for the cache of live frames.
//!
//! The same walk as the path tracer's, with the albedo of its first surface left out and with an end: at a
//! diffuse surface further along whose cell is known well enough, the cell's mean stands for the rest of the
//! path. Where it is not, the path goes on, and what it finds is a sample for that cell, too: paths pay for
//! their own shortcuts. Some go on anyway, so that these cells keep learning.
//!
//! Light that paths hand on in this way has been reflected any number of times: a picture lit by the cache
//! holds the paths beyond `max_depth`, too. A limit below [`LEAST_DEPTH`] is meant to be seen, so there every
//! path is walked. Cost: about three rays per sample once the cache knows the scene.

use super::path::{ROULETTE_AFTER, SpecularEvents, Vertex};
use super::sampler::Sampler;
use super::{Boundary, PathTracer};
use crate::cache::{Deposits, IrradianceCache, Place};
use crate::counters::RayCounts;
use crate::scene::Surface;
use glam::Vec3;

/// Shorter limits of depth are kept to by every path.
const LEAST_DEPTH: u32 = 6;
/// Samples of a cell that a path may end in: fewer carry their noise into every cell that sees this one.
const MIN_SAMPLES: f32 = 24.0;
/// Paths that go on although they could end.
const REFRESH: f32 = 0.06;
/// Width of the cells that paths end in, in those of a visible point at the same distance.
const SECONDARY_CELLS: f32 = 8.0;
/// And at most in distances from the surface they light: nearby light has detail.
const CELL_PER_DISTANCE: f32 = 0.25;
/// Survival of a path in the roulette.
const MAX_SURVIVAL: f32 = 0.95;

/// What a sample of irradiance needs besides the scene.
pub(crate) struct Gather<'a> {
    pub(crate) cache: &'a IrradianceCache,
    /// Width of cells per metre of path.
    pub(crate) cell_per_m: f32,
    pub(crate) max_depth: u32,
    pub(crate) sampler: Sampler,
    pub(crate) counts: &'a mut RayCounts,
    /// Where samples at surfaces along the path are left.
    pub(crate) deposits: &'a mut Deposits,
}

impl PathTracer {
    /// One sample of the irradiance over pi at a diffuse vertex that the eye sees after `path_m` metres.
    pub(crate) fn irradiance(&self, vertex: &Vertex, path_m: f32, gather: &mut Gather<'_>) -> Vec3 {
        let mut radiance = self.direct_light(vertex, &mut gather.sampler, gather.counts);
        let Some(mut scattered) = self.scatter_cosine(vertex, &mut gather.sampler, gather.counts) else {
            return radiance;
        };
        let mut weight = Vec3::ONE;
        let mut segments = vertex.segments;
        let (mut path_m, mut from_surface_m) = (path_m, 0.0);
        loop {
            // Trace the next segment.
            let arrival = scattered.arrival;
            let direction = scattered.ray.direction;
            let Some((point, distance)) = self.surface_along(&scattered.ray) else {
                let through = scattered.medium.transmittance(f32::INFINITY) * self.weight_of_escape(direction, arrival);
                return radiance + weight * through * self.scene.environment.radiance(direction);
            };
            weight *= scattered.medium.transmittance(distance);
            segments += 1;
            path_m += distance;
            from_surface_m += distance;
            let next = Vertex { point, direction, medium: scattered.medium, segments };
            radiance += weight * self.emitted(&next, arrival);
            if segments >= gather.max_depth {
                return radiance;
            }

            // Pass on through specular surfaces.
            let Some(boundary) = Boundary::at(&self.scene, &next.point, direction) else {
                return radiance + weight * self.reflected_at(&next, path_m, from_surface_m, gather);
            };
            let passed =
                self.scatter_specular(&next, &boundary, SpecularEvents::ALL, &mut gather.sampler, gather.counts);
            let Some(passed) = passed else { return radiance };
            weight *= passed.weight;
            scattered = passed;
        }
    }

    /// What a diffuse surface further along the path sends back: from the cache, or by going on.
    fn reflected_at(&self, vertex: &Vertex, path_m: f32, from_surface_m: f32, gather: &mut Gather<'_>) -> Vec3 {
        let Surface::Diffuse { albedo } = &self.scene.materials[vertex.point.material as usize].surface else {
            return Vec3::ZERO;
        };
        if albedo.is_black() {
            return Vec3::ZERO;
        }
        let albedo = albedo.at(&self.scene.textures, vertex.point.uv);
        let visible_cell_m = path_m * gather.cell_per_m;
        let cell_m = (SECONDARY_CELLS * visible_cell_m).min(CELL_PER_DISTANCE * from_surface_m).max(visible_cell_m);
        let place = Place { position: vertex.point.position, normal: vertex.lit_normal(), cell_m };
        let may_end = gather.max_depth >= LEAST_DEPTH && gather.sampler.value() >= REFRESH;
        if may_end && let Some(mean) = gather.cache.mean_at(&place, MIN_SAMPLES) {
            return albedo * mean;
        }
        let mut survival = 1.0;
        if vertex.segments >= ROULETTE_AFTER {
            survival = albedo.max_element().min(MAX_SURVIVAL);
            if gather.sampler.value() >= survival {
                return Vec3::ZERO;
            }
        }
        let sample = self.irradiance(vertex, path_m, gather);
        if sample.is_finite() {
            gather.deposits.add_secondary(&place, sample);
        }
        albedo * sample / survival
    }
}
