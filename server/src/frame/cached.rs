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
//! Of the glossy lobes of a rough surface one ray is drawn per frame; what it finds is kept apart and made smooth over
//! neighbours and frames ([`super::glossy`]).
//!
//! All that is decided in a frame is decided from the cache before it, and samples are added in the order of
//! the image, so a frame is a function of the scene and of the requests so far, not of the threads.
//!
//! Cost (gallery, 512x512, DRFF, one core of an EPYC at about 1 Mray/s of paths): geometry 140 ms, light 80 ms,
//! samples 1.5 us each; measured by `cargo run --release -p warplight-server --example equal_time`.

use super::glossy::{Glossy, GlossyPoint};
use super::rest::{PixelSum, Rest, Step};
use super::sentinels::Sentinel;
use super::{BAND_ROWS, Chain, Eye, FrameRenderer, FrameRequest, PixelOfBand, SceneVersion, tiled};
use crate::bsdf::{Bsdf, Gloss, Lambert, Lobes};
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
    /// Whether it is seen by way of a rough lobe.
    glossy: bool,
    /// Wish for samples, relative to others.
    need: f32,
}

/// What a band of rows keeps from step to step, and its memory from frame to frame.
#[derive(Debug, Default)]
struct Band {
    shaded: Vec<Shaded>,
    /// Node pixels with a surface, each with its first entry in `shaded`; only of a view that rests.
    surfaces: Vec<Surface>,
    /// What is seen by way of rough lobes, in the order of `shaded`.
    glossy: Vec<GlossyPoint>,
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
    glossy: Glossy,
    /// Whether the light of rough lobes is made smooth.
    denoises: bool,
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
    /// Whether a rough lobe lies before it.
    glossy: bool,
}

/// What a node pixel shows without the cache.
struct Collected {
    radiance: Vec3,
    /// What is seen by way of rough lobes, where there are any.
    glossy: Option<GlossyPoint>,
}

impl LiveFrames {
    /// Nothing seen yet.
    pub fn new(settings: CacheSettings) -> LiveFrames {
        LiveFrames {
            cache: IrradianceCache::new(settings),
            bands: Vec::new(),
            rest: Rest::default(),
            glossy: Glossy::default(),
            denoises: true,
            changes: Changes::default(),
            version: None,
        }
    }

    /// The same with the light of rough lobes as it is sampled: what is measured against.
    pub fn without_denoiser(settings: CacheSettings) -> LiveFrames {
        LiveFrames { denoises: false, ..LiveFrames::new(settings) }
    }

    /// What makes the light of rough lobes smooth.
    #[cfg(test)]
    pub(super) fn glossy(&self) -> &Glossy {
        &self.glossy
    }

    /// Pixels whose root shows a rough lobe.
    #[cfg(test)]
    pub(super) fn rough_pixels(&self, columns: usize) -> Vec<usize> {
        let bands = self.bands.iter().enumerate();
        let pixels = bands.flat_map(|(band, Band { glossy, .. })| {
            let first = band * BAND_ROWS as usize * columns;
            glossy.iter().filter(|point| point.node == 0).map(move |point| first + point.offset as usize)
        });
        pixels.collect()
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
            live.glossy.forget();
        }
        let before = live.version.replace(self.version);
        tree.reset(request.render_pose, request.camera, &request.plan, &self.interfaces);
        tree.set_layers(request.layers());
        let view = self.media_in_view(&request.render_pose, request.camera);
        let eye = view.eye();
        let cell_per_m = CELL_PX / request.camera.focal_px().min_element();
        let rests = live.rest.continues(request, self.version);
        let LiveFrames { cache, bands, rest, glossy, denoises, changes, .. } = live;
        let mut rows = tree.bands_mut(BAND_ROWS);
        bands.resize_with(rows.len(), Band::default);

        bands.par_iter_mut().for_each(|band| band.counts = RayCounts::default());

        // Light that has changed since the last frame is forgotten.
        let moved = before.filter(|before| before.has_moved_to(&self.version));
        if let Some(before) = moved {
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
            view.march_band(request, rows, &mut band.counts);
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
        let is_full = rests && rest.is_full();
        let is_glossy = bands.iter().any(|band| !band.glossy.is_empty());
        rows.par_iter_mut().zip(&mut *bands).for_each(|(rows, band)| {
            if !is_full {
                band.light(cache, cell_per_m, rows);
            }
            if !rests && !is_glossy {
                finish(rows, band);
            }
        });
        if !is_glossy {
            glossy.forget();
        } else if !is_full {
            let points = bands.iter().map(|band| band.glossy.as_slice());
            if *denoises {
                glossy.begin(&eye, request.camera.size, request.plan.nodes().len());
                points.clone().enumerate().for_each(|(band, points)| glossy.add_band(band, points));
                let kept = |position, path_m: f32, frames| {
                    let fade = changes.fade_at(position, path_m * cell_per_m);
                    fade.map_or(frames, |fade| fade.of(frames))
                };
                let has_changed = moved.is_some() && changes.any();
                glossy.filter(if has_changed { Some(&kept) } else { None });
                glossy.show(&mut rows, points);
            } else {
                let sampled = rows.iter_mut().zip(points);
                sampled.for_each(|(rows, points)| points.iter().for_each(|point| point.add_to(rows, point.radiance)));
            }
        }
        if rests {
            rest.mix(&mut rows);
        }
        if rests || is_glossy {
            rows.par_iter().zip(&*bands).for_each(|(rows, band)| finish(rows, band));
        }
    }

    fn trace_band(&self, request: &FrameRequest, eye: &Eye, band: &mut TreeRows<'_>, into: &mut Band) {
        into.shaded.clear();
        into.surfaces.clear();
        into.glossy.clear();
        let first = (band.rows.start * request.camera.size.width) as usize;
        let Band { shaded, surfaces, glossy, branches, counts, .. } = into;
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
                    glossy: false,
                });
                let mut sampler = Sampler::new(request.seed, (at.pixel * MAX_NODES + node) as u64, 0);
                let (offset, node) = (offset as u32, node as u8);
                let collected = self.collect(branches, request.max_depth, &mut sampler, counts, |diffuse| {
                    shaded.push(Shaded { offset, node, ..diffuse });
                });
                glossy.extend(collected.glossy.map(|point| {
                    // The image of what a nearly sharp lobe reflects is where its node says.
                    let is_image = link.boundary.is_none() && link.events.lobes.is_some_and(|lobes| !lobes.diffuse);
                    let surface_m = (link.vertex.point.position - eye.position).length();
                    let beyond_m = if is_image { (link.path_m - surface_m).max(0.0) } else { f32::INFINITY };
                    GlossyPoint { offset, node, beyond_m, ..point }
                }));
                collected.radiance
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
        mut on_diffuse: impl FnMut(Shaded),
    ) -> Collected {
        let tracer = &self.tracer;
        let scene = tracer.scene();
        // What is certain, and what is seen by way of rough lobes.
        let mut radiance = [Vec3::ZERO; 2];
        let mut point: Option<GlossyPoint> = None;
        while let Some(Branch { mut vertex, mut weight, path_m, evaluated, arrival, glossy }) = waiting.pop() {
            if evaluated.emission {
                radiance[usize::from(glossy)] += weight * tracer.emitted(&vertex, arrival);
            }
            if vertex.segments >= max_depth {
                continue;
            }
            weight *= tracer.disperse(&mut vertex, sampler);
            let lobes = evaluated.lobes.unwrap_or(Lobes::NONE);
            // What is diffuse alone has nothing to split: most surfaces of most scenes.
            if let Some(lambert) = Lambert::at(scene, &vertex.point, vertex.direction, vertex.medium) {
                let diffuse = weight * lambert.albedo();
                if lobes.diffuse && diffuse != Vec3::ZERO {
                    on_diffuse(Shaded { vertex, weight: diffuse, path_m, glossy, offset: 0, node: 0, need: 0.0 });
                }
                continue;
            }
            let bsdf = Bsdf::at(scene, &vertex.point, vertex.direction, vertex.medium, vertex.channel);
            let diffuse = weight * bsdf.diffuse();
            if lobes.diffuse && diffuse != Vec3::ZERO {
                on_diffuse(Shaded { vertex, weight: diffuse, path_m, glossy, offset: 0, node: 0, need: 0.0 });
            }
            // Sharp events are split; of lobes one ray is drawn.
            let split = [
                Events { refract: false, lobes: None, ..evaluated },
                Events { reflect: false, lobes: None, ..evaluated },
                Events { reflect: false, refract: false, lobes: Some(Lobes { diffuse: false, ..lobes }), ..evaluated },
            ];
            let rough = Lobes { diffuse: false, ..lobes };
            if !glossy && bsdf.has(rough) {
                note(&mut point, &vertex, weight, path_m, &bsdf.gloss(rough));
            }
            for (events, glossy) in split.into_iter().zip([glossy, glossy, true]) {
                let (direct, scattered) = tracer.scatter(&vertex, &bsdf, events, sampler, counts);
                radiance[usize::from(glossy)] += weight * direct;
                let Some(scattered) = scattered else { continue };
                let Some(weight) = worth_following(weight * scattered.weight, sampler) else { continue };
                let followed = tracer.follow(&vertex, &scattered, weight, 1.0, max_depth, sampler, counts);
                radiance[usize::from(glossy)] += followed.gathered;
                match followed.met {
                    Met::Nothing { radiance: escaped } => {
                        radiance[usize::from(glossy)] += followed.throughput * escaped;
                    }
                    Met::Surface(next) => waiting.push(Branch {
                        path_m: path_m + (next.point.position - scattered.ray.origin).length(),
                        vertex: next,
                        weight: followed.throughput,
                        evaluated: Events::ALL,
                        arrival: followed.arrival,
                        glossy,
                    }),
                }
            }
        }
        let [certain, sampled] = radiance;
        let glossy = point.map(|point| GlossyPoint { radiance: sampled, ..point });
        Collected { radiance: certain, glossy }
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
        let Band { shaded, surfaces, glossy, deposits, counts, .. } = band;
        deposits.clear();
        let mut glossy = glossy.iter().peekable();
        for (index, surface) in surfaces.iter().enumerate() {
            let end = surfaces.get(index + 1).map_or(shaded.len(), |next| next.first as usize);
            let points = &shaded[surface.first as usize..end];
            let (offset, node) = (surface.offset as usize, usize::from(surface.node));
            // How many is decided without looking at what the pixel shows: a choice by value would be a bias.
            let (column, row) = (surface.offset % width, rows.rows.start + surface.offset / width);
            let ahead = f64::from(scattered(column, row, surface.node).fract());
            let due = (step.before + ahead) as u32..(step.after + ahead) as u32;
            let mut certain =
                Vec3::from_array([0, 1, 2].map(|channel: usize| rows.nodes[node].radiance[channel][offset]));
            if let Some(point) = glossy.next_if(|point| (point.offset, point.node) == (surface.offset, surface.node)) {
                certain += point.radiance;
            }
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
        let mut glossy = self.glossy.iter_mut().peekable();
        for point in &self.shaded {
            let radiance = point.weight * self.stencils.irradiance(cache, &point.place(cell_per_m));
            if point.glossy {
                // In the same order: those before it have no diffuse surface behind their lobe.
                let is_of = |glossy: &GlossyPoint| (glossy.offset, glossy.node) == (point.offset, point.node);
                while glossy.next_if(|glossy| !is_of(glossy)).is_some() {}
                if let Some(glossy) = glossy.peek_mut() {
                    glossy.radiance += radiance;
                }
                continue;
            }
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

/// Notes the rough lobes of a surface, beside those of others in the same pixel.
fn note(point: &mut Option<GlossyPoint>, vertex: &Vertex, weight: Vec3, path_m: f32, gloss: &Gloss) {
    let albedo = weight * gloss.reflectance;
    match point {
        Some(point) => {
            point.albedo += albedo;
            point.alpha = point.alpha.min(gloss.alpha);
        }
        None => {
            *point = Some(GlossyPoint {
                offset: 0,
                node: 0,
                material: vertex.point.material,
                position: vertex.point.position,
                normal: vertex.lit_normal(),
                alpha: gloss.alpha,
                path_m,
                beyond_m: f32::INFINITY,
                albedo,
                radiance: Vec3::ZERO,
            });
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
