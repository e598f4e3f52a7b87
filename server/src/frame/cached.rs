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
//! Where things have moved since the last frame, light that has changed is forgotten first ([`super::sentinels`]); in
//! a view that rests the paths of step 2 are those of the pixels themselves, and what they find is mixed into the
//! picture after step 4 ([`super::rest`]).
//!
//! Limits: of the glossy lobes of a rough surface one ray is drawn per frame: they are noisy until the view rests.
//!
//! All that is decided in a frame is decided from the cache before it, and samples are added in the order of
//! the image, so a frame is a function of the scene and of the requests so far, not of the threads.
//!
//! Cost (gallery, 512x512, DRFF, one core of an EPYC at about 1 Mray/s of paths): geometry 140 ms, light 80 ms,
//! samples 1.5 us each; measured by `cargo run --release -p warplight-server --example equal_time`.

use super::rest::{PixelSum, Rest, Step};
use super::sentinels::Sentinel;
use super::{BAND_ROWS, Chain, Eye, FrameRenderer, FrameRequest, PixelOfBand, SceneVersion, tiled};
use crate::bsdf::{Bsdf, Lobes};
use crate::cache::{CacheSettings, Changes, Comparison, Deposits, IrradianceCache, LastLookup, Place, Stencils};
use crate::counters::{Counters, RayCounts};
use crate::integrator::sampler::Sampler;
use crate::integrator::{Arrival, Events, Gather, Met, Vertex};
use glam::Vec3;
use rayon::prelude::*;
use warplight_protocol::frame::{MAX_NODES, Tree, TreeRows};

/// Least width of the finest cells in pixels, seen head-on; at most twice that.
const CELL_PX: f32 = 2.0;
/// Branches of a baked specular chain below this weight are followed by chance only.
const MIN_BRANCH: f32 = 0.05;
/// Samples that a cell is taken to have more than it has: bounds how much likelier an empty one is chosen.
const KNOWN_SAMPLES: f32 = 4.0;
/// Samples of a cell beyond which it is chosen no less often: light may change.
const ENOUGH_SAMPLES: f32 = 512.0;
/// What a path that does not end in the cache takes over one that does (cornell, 5.2 rays instead of 1.7): keeps a
/// frame's time when a head comes to rest.
const REST_COST: f64 = 3.0;
/// Most samples from one point in one frame.
const MAX_PER_POINT: u32 = 64;

/// A diffuse surface that a node of a pixel shows, directly or at the end of a specular chain.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shaded {
    pub(super) vertex: Vertex,
    /// Factor on irradiance over pi: albedo and all that lies before it.
    weight: Vec3,
    pub(super) path_m: f32,
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
    /// Node pixels with a surface, each with its first entry in `shaded`; only of a view that rests.
    surfaces: Vec<Surface>,
    branches: Vec<Branch>,
    need: f64,
    sentinels: Vec<Sentinel>,
    comparisons: Vec<Comparison>,
    deposits: Deposits,
    stencils: Stencils,
    counts: RayCounts,
}

/// A surface that a node of a pixel shows, with all that is seen by its events.
#[derive(Clone, Copy, Debug)]
struct Surface {
    offset: u32,
    node: u8,
    /// Its first entry in the band's shaded points.
    first: u32,
}

/// What lives from frame to frame of one viewer.
#[derive(Debug)]
pub struct LiveFrames {
    cache: IrradianceCache,
    bands: Vec<Band>,
    rest: Rest,
    changes: Changes,
    /// Whose light the cache holds.
    version: Option<SceneVersion>,
}

/// A part of a specular chain that is yet to be followed.
#[derive(Clone, Copy, Debug)]
struct Branch {
    vertex: Vertex,
    weight: Vec3,
    path_m: f32,
    evaluated: Events,
    arrival: Arrival,
}

impl LiveFrames {
    /// Nothing seen yet.
    pub fn new(settings: CacheSettings) -> LiveFrames {
        LiveFrames {
            cache: IrradianceCache::new(settings),
            bands: Vec::new(),
            rest: Rest::default(),
            changes: Changes::default(),
            version: None,
        }
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
        if live.version.is_none_or(|version| version.scene != self.version.scene) {
            live.cache.clear();
        }
        let before = live.version.replace(self.version);
        tree.reset(request.render_pose, request.camera, &request.plan, &self.interfaces);
        let eye = Eye::new(self.scene(), &request.render_pose, request.camera);
        let cell_per_m = CELL_PX / request.camera.focal_px().min_element();
        let rests = live.rest.continues(request, self.version);
        let LiveFrames { cache, bands, rest, changes, .. } = live;
        let mut rows = tree.bands_mut(BAND_ROWS);
        bands.resize_with(rows.len(), Band::default);

        bands.par_iter_mut().for_each(|band| band.counts = RayCounts::default());

        // Light that has changed since the last frame is forgotten.
        if let Some(before) = before.filter(|before| before.has_moved_to(&self.version)) {
            bands.par_iter_mut().for_each(|band| {
                let Band { sentinels, comparisons, counts, .. } = band;
                self.compare_sentinels(request, cache, cell_per_m, sentinels, comparisons, counts);
            });
            changes.begin(before.secs_to(&self.version));
            bands.iter().flat_map(|band| &band.comparisons).for_each(|comparison| changes.add(comparison));
            cache.fade(changes);
        }

        // Geometry, and what is certain.
        rows.par_iter_mut().zip(&mut *bands).for_each(|(rows, band)| {
            self.trace_band(request, &eye, rows, band);
            band.assess(cache, cell_per_m);
        });

        // Paths: of every pixel alike where the view rests, else from the points that need them most.
        let width = request.camera.size.width;
        if rests {
            let points: usize = bands.iter().map(|band| band.shaded.len().max(band.surfaces.len())).sum();
            let per_pixel = (samples / REST_COST / points.max(1) as f64).min(f64::from(MAX_PER_POINT));
            let step = rest.step(request, per_pixel);
            rows.par_iter().zip(&mut *bands).zip(rest.bands_mut()).for_each(|((rows, band), sums)| {
                self.sum_band(request, &step, rows, width, cell_per_m, cache, band, sums);
            });
        } else {
            let per_need = samples / bands.iter().map(|band| band.need).sum::<f64>().max(f64::MIN_POSITIVE);
            rows.par_iter().zip(&mut *bands).for_each(|(rows, band)| {
                self.sample_band(request, rows.rows.start, width, per_need as f32, cell_per_m, cache, band);
            });
        }
        if self.moves() {
            bands.par_iter_mut().for_each(|band| {
                let Band { shaded, sentinels, counts, .. } = band;
                self.leave_sentinels(request, cache, shaded, sentinels, counts);
            });
        }
        cache.add(bands.iter().map(|band| &band.deposits));

        // Light from the cache, and the mean of what was seen while at rest.
        let cache = &*cache;
        let finish = |rows: &TreeRows<'_>, band: &Band| {
            counters.add(&band.counts);
            on_band(rows);
        };
        rows.par_iter_mut().zip(&mut *bands).for_each(|(rows, band)| {
            if !(rests && rest.is_full()) {
                band.light(cache, cell_per_m, rows);
            }
            if !rests {
                finish(rows, band);
            }
        });
        if rests {
            rest.mix(&mut rows);
            rows.par_iter().zip(&*bands).for_each(|(rows, band)| finish(rows, band));
        }
    }

    fn trace_band(&self, request: &FrameRequest, eye: &Eye, band: &mut TreeRows<'_>, into: &mut Band) {
        into.shaded.clear();
        into.surfaces.clear();
        let first = (band.rows.start * request.camera.size.width) as usize;
        let Band { shaded, surfaces, branches, counts, .. } = into;
        let mut chain: Chain = [None; MAX_NODES];
        for offset in tiled(request.camera.size.width, band.rows.len() as u32) {
            let at = PixelOfBand { pixel: first + offset, offset };
            self.trace_pixel(request, eye, at, &mut band.nodes, &mut chain, counts, |link, node, counts| {
                let evaluated = self.baked_events(request, link, node);
                surfaces.push(Surface { offset: offset as u32, node: node as u8, first: shaded.len() as u32 });
                branches.push(Branch {
                    vertex: link.vertex,
                    weight: link.factor,
                    path_m: link.path_m,
                    evaluated,
                    arrival: Arrival::Certain,
                });
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
        while let Some(Branch { mut vertex, mut weight, path_m, evaluated, arrival }) = waiting.pop() {
            if evaluated.emission {
                radiance += weight * tracer.emitted(&vertex, arrival);
            }
            if vertex.segments >= max_depth {
                continue;
            }
            weight *= tracer.disperse(&mut vertex, sampler);
            let bsdf = Bsdf::at(scene, &vertex.point, vertex.direction, vertex.medium, vertex.channel);
            let lobes = evaluated.lobes.unwrap_or(Lobes::NONE);
            let diffuse = weight * bsdf.diffuse();
            if lobes.diffuse && diffuse != Vec3::ZERO {
                on_diffuse(vertex, diffuse, path_m);
            }
            // Sharp events are split; of lobes one ray is drawn.
            let split = [
                Events { refract: false, lobes: None, ..evaluated },
                Events { reflect: false, lobes: None, ..evaluated },
                Events { reflect: false, refract: false, lobes: Some(Lobes { diffuse: false, ..lobes }), ..evaluated },
            ];
            for events in split {
                let (direct, scattered) = tracer.scatter(&vertex, &bsdf, events, sampler, counts);
                radiance += weight * direct;
                let Some(scattered) = scattered else { continue };
                let Some(weight) = worth_following(weight * scattered.weight, sampler) else { continue };
                let (through, met) = tracer.follow(&vertex, &scattered, sampler);
                match met {
                    Met::Nothing { radiance: escaped } => radiance += weight * through * escaped,
                    Met::Surface(next) => waiting.push(Branch {
                        path_m: path_m + (next.point.position - scattered.ray.origin).length(),
                        vertex: next,
                        weight: weight * through,
                        evaluated: Events::ALL,
                        arrival: scattered.arrival,
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
            let along = frame_shift.x + scattered(column, row, point.node);
            let wanted = (per_need * point.need).min(MAX_PER_POINT as f32) + along.fract();
            for _ in 0..wanted as u32 {
                let sampler = Sampler::new(request.seed, u64::from(first_row) << 40, index);
                index += 1;
                let max_depth = request.max_depth;
                let mut gather = Gather { cache, cell_per_m, may_end: true, max_depth, sampler, counts, deposits };
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

impl FrameRenderer {
    /// Adds samples of the radiance of the pixels of a resting band to their sums.
    #[allow(clippy::too_many_arguments)]
    fn sum_band(
        &self,
        request: &FrameRequest,
        step: &Step,
        rows: &TreeRows<'_>,
        width: u32,
        cell_per_m: f32,
        cache: &IrradianceCache,
        band: &mut Band,
        sums: &mut [PixelSum],
    ) {
        let Band { shaded, surfaces, deposits, counts, .. } = band;
        deposits.clear();
        for (index, surface) in surfaces.iter().enumerate() {
            let end = surfaces.get(index + 1).map_or(shaded.len(), |next| next.first as usize);
            let points = &shaded[surface.first as usize..end];
            let (offset, node) = (surface.offset as usize, usize::from(surface.node));
            // How many is decided without looking at what the pixel shows: a choice by value would be a bias.
            let (column, row) = (surface.offset % width, rows.rows.start + surface.offset / width);
            let ahead = f64::from(scattered(column, row, surface.node).fract());
            let due = (step.before + ahead) as u32..(step.after + ahead) as u32;
            let certain = Vec3::from_array([0, 1, 2].map(|channel: usize| rows.nodes[node].radiance[channel][offset]));
            let sum = &mut sums[Rest::place(node, offset, width as usize)];
            for sample in due {
                let stream = u64::from(row * width + column) * MAX_NODES as u64 + u64::from(surface.node);
                let sampler = Sampler::new(step.seed, stream, sample);
                let max_depth = request.max_depth;
                let mut gather = Gather { cache, cell_per_m, may_end: false, max_depth, sampler, counts, deposits };
                let mut radiance = certain;
                for point in points {
                    let value = self.tracer.irradiance(&point.vertex, point.path_m, &mut gather);
                    radiance += point.weight * value;
                    if value.is_finite() {
                        gather.deposits.add_visible(&point.place(cell_per_m), value);
                    }
                }
                if radiance.is_finite() {
                    sum.add(radiance);
                } else {
                    gather.counts.dropped += 1;
                }
            }
        }
    }
}

/// The R2 sequence over the image (Roberts 2018): pixels with near values keep apart from each other.
fn scattered(column: u32, row: u32, node: u8) -> f32 {
    0.754_877_7 * column as f32 + 0.569_840_3 * row as f32 + 0.618_034 * f32::from(node)
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

#[cfg(test)]
mod tests;
