//! Live frames: the ray tree with its diffuse light from the irradiance cache.
//!
//! A frame is made in four steps, each over all cores:
//! 1. geometry: the specular chain of every pixel, as in any frame; where it ends at diffuse surfaces, what
//!    they multiply the light by is noted (a [`Shaded`] point), and what is certain (emission, sky) is written.
//!    Specular events without a node are split here, too, down to where little light is left;
//! 2. selection and tracing: points are chosen for samples, the less their cell knows the likelier, and one
//!    path is traced from each ([`Gather`]);
//! 3. the samples are added to the cache;
//! 4. each point takes its irradiance from the cache, times its own albedo: textures stay sharp.
//!
//! All that is decided in a frame is decided from the cache before it, and samples are added in the order of
//! the image, so a frame is a function of the scene and of the requests so far, not of the threads.
//!
//! Cost (gallery, 512x512, DRFF, one core of an EPYC at about 1 Mray/s of paths): geometry 140 ms, light 80 ms,
//! samples 1.5 us each; measured by `cargo run --release -p warplight-server --example equal_time`.

use super::{BAND_ROWS, Chain, Eye, FrameRenderer, FrameRequest, PixelOfBand, tiled};
use crate::cache::{CacheSettings, Deposits, IrradianceCache, LastLookup, Place, Stencils};
use crate::counters::{Counters, RayCounts};
use crate::integrator::sampler::Sampler;
use crate::integrator::{Boundary, Gather, SpecularEvents, Vertex};
use crate::scene::{Scene, Surface};
use glam::Vec3;
use rayon::prelude::*;
use std::sync::Arc;
use warplight_protocol::frame::{MAX_NODES, Tree, TreeRows};

/// Least width of the finest cells in pixels, seen head-on; at most twice that.
const CELL_PX: f32 = 2.0;
/// Branches of a baked specular chain below this weight are followed by chance only.
const MIN_BRANCH: f32 = 0.05;
/// Samples that a cell is taken to have more than it has: bounds how much likelier an empty one is chosen.
const KNOWN_SAMPLES: f32 = 4.0;
/// Samples of a cell beyond which it is chosen no less often: light may change.
const ENOUGH_SAMPLES: f32 = 512.0;
/// Most samples from one point in one frame.
const MAX_PER_POINT: u32 = 64;

/// A diffuse surface that a node of a pixel shows, directly or at the end of a specular chain.
#[derive(Clone, Copy, Debug)]
struct Shaded {
    vertex: Vertex,
    /// Factor on irradiance over pi: albedo and all that lies before it.
    weight: Vec3,
    path_m: f32,
    /// Pixel within the band.
    offset: u32,
    node: u8,
    /// Wish for samples, relative to others.
    need: f32,
}

/// What a band of rows keeps from step to step, and its memory from frame to frame.
#[derive(Debug, Default)]
struct Band {
    shaded: Vec<Shaded>,
    branches: Vec<Branch>,
    need: f64,
    deposits: Deposits,
    stencils: Stencils,
    counts: RayCounts,
}

/// What lives from frame to frame of one viewer.
#[derive(Debug)]
pub struct LiveFrames {
    cache: IrradianceCache,
    bands: Vec<Band>,
    /// Whose light the cache holds.
    scene: Option<Arc<Scene>>,
}

/// A part of a specular chain that is yet to be followed.
#[derive(Clone, Copy, Debug)]
struct Branch {
    vertex: Vertex,
    weight: Vec3,
    path_m: f32,
    evaluated: SpecularEvents,
}

impl LiveFrames {
    /// Nothing seen yet.
    pub fn new(settings: CacheSettings) -> LiveFrames {
        LiveFrames { cache: IrradianceCache::new(settings), bands: Vec::new(), scene: None }
    }

    /// Bytes of the cache.
    pub fn cache_bytes(&self) -> usize {
        self.cache.bytes()
    }
}

impl FrameRenderer {
    /// Renders a frame from the cache, tracing about `samples` paths to add to it; `request.spp` does not
    /// count. Otherwise as [`FrameRenderer::render`].
    pub fn render_live(
        &self,
        request: &FrameRequest,
        samples: f64,
        live: &mut LiveFrames,
        tree: &mut Tree,
        counters: &Counters,
        on_band: &(dyn Fn(&TreeRows<'_>) + Sync),
    ) {
        if !live.scene.as_ref().is_some_and(|scene| Arc::ptr_eq(scene, self.scene())) {
            live.cache.clear();
            live.scene = Some(self.scene().clone());
        }
        tree.reset(request.render_pose, request.camera, &request.plan, &self.interfaces);
        let eye = Eye::new(&request.render_pose, request.camera);
        let cell_per_m = CELL_PX / request.camera.focal_px().min_element();
        let LiveFrames { cache, bands, .. } = live;
        let mut rows = tree.bands_mut(BAND_ROWS);
        bands.resize_with(rows.len(), Band::default);

        // Geometry, and what is certain.
        rows.par_iter_mut().zip(&mut *bands).for_each(|(rows, band)| {
            self.trace_band(request, &eye, rows, band);
            band.assess(cache, cell_per_m);
        });

        // Paths from the points that need them most.
        let per_need = samples / bands.iter().map(|band| band.need).sum::<f64>().max(f64::MIN_POSITIVE);
        let width = request.camera.size.width;
        rows.par_iter().zip(&mut *bands).for_each(|(rows, band)| {
            self.sample_band(request, rows.rows.start, width, per_need as f32, cell_per_m, cache, band);
        });
        cache.add(bands.iter().map(|band| &band.deposits));

        // Light from the cache.
        let cache = &*cache;
        rows.par_iter_mut().zip(&mut *bands).for_each(|(rows, band)| {
            band.light(cache, cell_per_m, rows);
            counters.add(&band.counts);
            on_band(rows);
        });
    }

    fn trace_band(&self, request: &FrameRequest, eye: &Eye, band: &mut TreeRows<'_>, into: &mut Band) {
        into.shaded.clear();
        into.counts = RayCounts::default();
        let first = (band.rows.start * request.camera.size.width) as usize;
        let Band { shaded, branches, counts, .. } = into;
        let mut chain: Chain = [None; MAX_NODES];
        for offset in tiled(request.camera.size.width, band.rows.len() as u32) {
            let at = PixelOfBand { pixel: first + offset, offset };
            self.trace_pixel(request, eye, at, &mut band.nodes, &mut chain, counts, |link, node, counts| {
                let evaluated = self.baked_events(request, link, node);
                branches.push(Branch { vertex: link.vertex, weight: link.factor, path_m: link.path_m, evaluated });
                let mut sampler = Sampler::new(request.seed, (at.pixel * MAX_NODES + node) as u64, 0);
                self.collect(branches, request.max_depth, &mut sampler, counts, |vertex, weight, path_m| {
                    shaded.push(Shaded { vertex, weight, path_m, offset: offset as u32, node: node as u8, need: 0.0 });
                })
            });
        }
    }

    /// Follows specular chains, `waiting` until none is, to all their ends: returns the emission and the sky
    /// that they show, and gives each diffuse surface with its weight to `on_diffuse`.
    fn collect(
        &self,
        waiting: &mut Vec<Branch>,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
        mut on_diffuse: impl FnMut(Vertex, Vec3, f32),
    ) -> Vec3 {
        let tracer = &self.tracer;
        let scene = tracer.scene();
        let mut radiance = Vec3::ZERO;
        while let Some(Branch { vertex, weight, path_m, evaluated }) = waiting.pop() {
            radiance += weight * tracer.emission(&vertex.point, vertex.direction);
            if vertex.segments >= max_depth {
                continue;
            }
            let Some(boundary) = Boundary::at(scene, &vertex.point, vertex.direction) else {
                let weight = weight * albedo_at(scene, &vertex);
                if weight != Vec3::ZERO {
                    on_diffuse(vertex, weight, path_m);
                }
                continue;
            };
            let reflected = evaluated.reflect.then_some((
                boundary.reflected,
                boundary.reflectance * boundary.reflected_factor,
                vertex.medium,
            ));
            let refracted = boundary.refracted.filter(|_| evaluated.refract);
            let refracted = refracted.map(|refracted| {
                (refracted.direction, (Vec3::ONE - boundary.reflectance) * refracted.factor, refracted.medium)
            });
            counts.reflect += u64::from(reflected.is_some());
            counts.refract += u64::from(refracted.is_some());
            for (direction, factor, medium) in reflected.into_iter().chain(refracted) {
                let Some(weight) = worth_following(weight * factor, sampler) else { continue };
                let ray = vertex.point.leave(direction);
                match tracer.surface_along(&ray) {
                    None => {
                        radiance +=
                            weight * medium.transmittance(f32::INFINITY) * scene.environment.radiance(direction);
                    }
                    Some((point, distance)) => waiting.push(Branch {
                        vertex: Vertex { point, direction, medium, segments: vertex.segments + 1 },
                        weight: weight * medium.transmittance(distance),
                        path_m: path_m + distance,
                        evaluated: SpecularEvents::ALL,
                    }),
                }
            }
        }
        radiance
    }

    #[allow(clippy::too_many_arguments)]
    fn sample_band(
        &self,
        request: &FrameRequest,
        first_row: u32,
        width: u32,
        per_need: f32,
        cell_per_m: f32,
        cache: &IrradianceCache,
        band: &mut Band,
    ) {
        let Band { shaded, deposits, counts, .. } = band;
        deposits.clear();
        let frame_shift = Sampler::new(request.seed, u64::MAX, 0).pair();
        // Points that are near follow each other, and so do their samples in the sequence: those of a cell are
        // stratified together (Ahmed and Wonka 2020).
        let mut index = 0;
        for point in shaded.iter() {
            let (column, row) = (point.offset % width, first_row + point.offset / width);
            // The R2 sequence over the image (Roberts 2018): chosen pixels keep apart from each other.
            let along = frame_shift.x
                + 0.754_877_7 * column as f32
                + 0.569_840_3 * row as f32
                + 0.618_034 * f32::from(point.node);
            let wanted = (per_need * point.need).min(MAX_PER_POINT as f32) + along.fract();
            for _ in 0..wanted as u32 {
                let sampler = Sampler::new(request.seed, u64::from(first_row) << 40, index);
                index += 1;
                let mut gather = Gather { cache, cell_per_m, max_depth: request.max_depth, sampler, counts, deposits };
                let value = self.tracer.irradiance(&point.vertex, point.path_m, &mut gather);
                if value.is_finite() {
                    deposits.add_visible(&point.place(cell_per_m), value);
                } else {
                    counts.dropped += 1;
                }
            }
        }
    }
}

impl Band {
    /// How much each point needs samples, from what the cache knows.
    fn assess(&mut self, cache: &IrradianceCache, cell_per_m: f32) {
        self.need = 0.0;
        let mut lookup = LastLookup::default();
        for point in &mut self.shaded {
            let samples = cache.samples_at(&point.place(cell_per_m), &mut lookup).min(ENOUGH_SAMPLES);
            point.need = point.weight.max_element().clamp(0.05, 1.0) / (samples + KNOWN_SAMPLES);
            self.need += f64::from(point.need);
        }
    }

    /// Adds the light of the cache to the rows.
    fn light(&mut self, cache: &IrradianceCache, cell_per_m: f32, rows: &mut TreeRows<'_>) {
        self.stencils.clear();
        for point in &self.shaded {
            let radiance = point.weight * self.stencils.irradiance(cache, &point.place(cell_per_m));
            let channels = &mut rows.nodes[usize::from(point.node)].radiance;
            for (channel, value) in channels.iter_mut().zip(radiance.to_array()) {
                channel[point.offset as usize] += value;
            }
        }
    }
}

impl Shaded {
    fn place(&self, cell_per_m: f32) -> Place {
        Place {
            position: self.vertex.point.position,
            normal: self.vertex.lit_normal(),
            cell_m: self.path_m * cell_per_m,
        }
    }
}

/// The weight of a branch, or by roulette nothing where it is small.
fn worth_following(weight: Vec3, sampler: &mut Sampler) -> Option<Vec3> {
    let largest = weight.max_element();
    if largest >= MIN_BRANCH {
        return Some(weight);
    }
    (sampler.value() * MIN_BRANCH < largest).then(|| weight * (MIN_BRANCH / largest))
}

fn albedo_at(scene: &Scene, vertex: &Vertex) -> Vec3 {
    match &scene.materials[vertex.point.material as usize].surface {
        Surface::Diffuse { albedo } if !albedo.is_black() => albedo.at(&scene.textures, vertex.point.uv),
        _ => Vec3::ZERO,
    }
}

#[cfg(test)]
mod tests;
