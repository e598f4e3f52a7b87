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

use super::PathTracer;
use super::path::{Events, MAX_SURVIVAL, Met, ROULETTE_AFTER, Vertex};
use super::sampler::Sampler;
use crate::bsdf::{Bsdf, Lambert, Lobes};
use crate::cache::{Deposits, IrradianceCache, Place};
use crate::counters::RayCounts;
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

/// What a sample of irradiance needs besides the scene.
pub(crate) struct Gather<'a> {
    pub(crate) cache: &'a IrradianceCache,
    /// Width of cells per metre of path.
    pub(crate) cell_per_m: f32,
    /// Whether paths may end in the cache; else they are unbiased.
    pub(crate) may_end: bool,
    pub(crate) max_depth: u32,
    pub(crate) sampler: Sampler,
    pub(crate) counts: &'a mut RayCounts,
    /// Where samples at surfaces along the path are left.
    pub(crate) deposits: &'a mut Deposits,
}

/// What a path does at a surface whose Lambert reflection is known from the cache.
const BESIDE_DIFFUSE: Events = Events { emission: false, reflect: true, refract: true, lobes: Some(Lobes::GLOSSY) };

impl PathTracer {
    /// One sample of the irradiance over pi at a vertex with Lambert reflection that the eye sees after `path_m`
    /// metres.
    pub(crate) fn irradiance(&self, vertex: &Vertex, path_m: f32, gather: &mut Gather<'_>) -> Vec3 {
        let white = Lambert::new(&vertex.point, vertex.direction, vertex.medium, Vec3::ONE);
        let Gather { sampler, counts, .. } = gather;
        let mut radiance = self.direct_light(vertex, &white, 1.0, sampler, counts);
        let Some(mut scattered) = self.scatter_lobes(vertex, &white, 1.0, sampler, counts) else {
            return radiance;
        };
        let mut weight = Vec3::ONE;
        let mut from = *vertex;
        let (mut path_m, mut from_surface_m) = (path_m, 0.0);
        loop {
            // Trace the next segment.
            let Gather { max_depth, ref mut sampler, ref mut counts, .. } = *gather;
            let followed = self.follow(&from, &scattered, weight, 1.0, max_depth, sampler, counts);
            weight = followed.throughput;
            radiance += followed.gathered;
            let mut next = match followed.met {
                Met::Nothing { radiance: escaped } => return radiance + weight * escaped,
                Met::Surface(next) => next,
            };
            let distance = (next.point.position - scattered.ray.origin).length();
            path_m += distance;
            from_surface_m += distance;
            radiance += weight * self.emitted(&next, followed.arrival);
            if next.segments >= gather.max_depth {
                return radiance;
            }
            weight *= self.disperse(&mut next, &mut gather.sampler);

            // Lambert reflection is looked up; what else there is passes the path on.
            let bsdf = Bsdf::at(&self.scene, &next.point, next.direction, next.medium, next.channel);
            let diffuse = bsdf.albedo(Lobes::DIFFUSE);
            let others = bsdf.albedo(Lobes::GLOSSY) + bsdf.sharp().map_or(0.0, |_| 1.0);
            let of_diffuse = if others > 0.0 { diffuse / (diffuse + others) } else { 1.0 };
            if of_diffuse == 1.0 || gather.sampler.value() < of_diffuse {
                let weight = weight * bsdf.diffuse() / of_diffuse;
                return radiance + weight * self.irradiance_along(&next, &bsdf, path_m, from_surface_m, gather);
            }
            weight /= 1.0 - of_diffuse;
            let (direct, passed) = self.scatter(&next, &bsdf, BESIDE_DIFFUSE, &mut gather.sampler, gather.counts);
            radiance += weight * direct;
            let Some(passed) = passed else { return radiance };
            weight *= passed.weight;
            scattered = passed;
            from = next;
        }
    }

    /// Irradiance over pi at a surface further along the path: from the cache, or by going on.
    fn irradiance_along(
        &self,
        vertex: &Vertex,
        bsdf: &Bsdf,
        path_m: f32,
        from_surface_m: f32,
        gather: &mut Gather<'_>,
    ) -> Vec3 {
        let albedo = bsdf.albedo(Lobes::DIFFUSE);
        if albedo == 0.0 {
            return Vec3::ZERO;
        }
        let visible_cell_m = path_m * gather.cell_per_m;
        let cell_m = (SECONDARY_CELLS * visible_cell_m).min(CELL_PER_DISTANCE * from_surface_m).max(visible_cell_m);
        let place = Place { position: vertex.point.position, normal: vertex.lit_normal(), cell_m };
        let may_end = gather.may_end && gather.max_depth >= LEAST_DEPTH && gather.sampler.value() >= REFRESH;
        if may_end && let Some(mean) = gather.cache.mean_at(&place, MIN_SAMPLES) {
            return mean;
        }
        let mut survival = 1.0;
        if vertex.segments >= ROULETTE_AFTER {
            survival = albedo.min(MAX_SURVIVAL);
            if gather.sampler.value() >= survival {
                return Vec3::ZERO;
            }
        }
        let sample = self.irradiance(vertex, path_m, gather);
        if sample.is_finite() {
            gather.deposits.add_secondary(&place, sample);
        }
        sample / survival
    }
}
