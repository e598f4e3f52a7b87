//! The layers of a frame: what rays of view go through before they end at the root's surface.

use super::{Eye, FrameRenderer, FrameRequest, LayersRequest};
use crate::counters::RayCounts;
use crate::integrator::PathTracer;
use crate::layering::optimal::cut_plainly;
use crate::layering::{Cutter, Profile, Segments};
use crate::march::{self, Marcher};
use glam::Vec4;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, PoisonError, RwLock, RwLockReadGuard};
use warplight_protocol::frame::{Layering, TreeRows};
use warplight_protocol::{Camera, Pose};

/// Rays that are cut together.
const BATCH: usize = 64;

/// The media of a scene, the light in them, and memory of the workers.
#[derive(Debug)]
pub(super) struct Media {
    marcher: RwLock<Marcher>,
    works: Mutex<Vec<Work>>,
}

/// Memory of a worker.
#[derive(Debug, Default)]
struct Work {
    march: march::Work,
    rays: Vec<Profile>,
    segments: Vec<Segments>,
    cutter: Cutter,
}

/// The media as an eye sees them. While it is there their light is not refined.
#[derive(Debug)]
pub struct MediaInView<'a> {
    renderer: &'a FrameRenderer,
    camera: Camera,
    eye: Eye,
    marcher: RwLockReadGuard<'a, Marcher>,
}

impl Media {
    pub(super) fn new(tracer: &PathTracer) -> Media {
        Media { marcher: RwLock::new(Marcher::new(tracer)), works: Mutex::default() }
    }

    pub(super) fn forget_light(&mut self) {
        self.marcher.get_mut().unwrap_or_else(PoisonError::into_inner).forget_light();
    }
}

impl FrameRenderer {
    /// Another renderer of the same scene, whose things move by themselves; in its media the light of this one.
    pub fn copy(&self) -> FrameRenderer {
        let mut copy = FrameRenderer::limited(Arc::new(self.scene().as_ref().clone()), self.tracer.simulated);
        let marcher = self.media.marcher.read().unwrap_or_else(PoisonError::into_inner);
        *copy.media.marcher.get_mut().unwrap_or_else(PoisonError::into_inner) = marcher.clone();
        copy
    }

    /// Adds so many samples to the light that frames see in media. Frames that are being rendered end first.
    pub fn refine_light(&self, samples: usize, max_depth: u32, seed: u64) {
        let mut marcher = self.media.marcher.write().unwrap_or_else(PoisonError::into_inner);
        marcher.refine(&self.tracer, samples, max_depth, seed);
    }

    /// Adds so many samples to the light of every voxel.
    pub fn refine_all_light(&self, spp: u32, max_depth: u32, seed: u64) {
        let mut marcher = self.media.marcher.write().unwrap_or_else(PoisonError::into_inner);
        marcher.refine_all(&self.tracer, spp, max_depth, seed);
    }

    /// Has views of media take steps of so many voxels of their grids, and not of half a one: for whoever measures what steps
    /// cost. From a 64th to 64.
    pub fn set_march_step(&self, voxels: f32) {
        let mut marcher = self.media.marcher.write().unwrap_or_else(PoisonError::into_inner);
        marcher.set_step(voxels);
    }

    /// The picture of the media alone, without layers: of each pixel what its ray gathers before it ends at the root's
    /// surface, and, as w, what that is seen through. What a frame's layers show to their own pose.
    pub fn media_picture(&self, pose: &Pose, camera: Camera) -> Vec<Vec4> {
        let view = self.media_in_view(pose, camera);
        let pixels = (0..camera.size.pixels()).into_par_iter().map_init(Default::default, |(work, profile), pixel| {
            view.profile(pixel, work, profile);
            let (radiance, transmittance) = profile.compose();
            radiance.extend(transmittance)
        });
        pixels.collect()
    }

    /// The media as they are seen from a pose.
    pub fn media_in_view(&self, pose: &Pose, camera: Camera) -> MediaInView<'_> {
        let marcher = self.media.marcher.read().unwrap_or_else(PoisonError::into_inner);
        MediaInView { renderer: self, camera, eye: self.eye_at(pose, camera), marcher }
    }
}

impl MediaInView<'_> {
    /// Whose view it is.
    pub(super) fn eye(&self) -> Eye {
        self.eye
    }

    /// Makes a profile of what the ray through the centre of a pixel goes through before it ends at a surface; gives the
    /// number of steps in matter.
    pub fn profile(&self, pixel: usize, work: &mut march::Work, profile: &mut Profile) -> u64 {
        let surface = self.renderer.tracer.surface_along(&self.eye.ray_through_centre(pixel), 0);
        self.march(pixel, surface.map_or(f32::INFINITY, |(_, distance)| distance), work, profile)
    }

    /// Fills the layers of a band whose root's distances are there.
    pub(super) fn march_band(&self, request: &FrameRequest, band: &mut TreeRows<'_>, counts: &mut RayCounts) {
        let Some(LayersRequest { format, range, exactly }) = request.volume else { return };
        let works = &self.renderer.media.works;
        let mut work = works.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default();
        let first = (band.rows.start * self.camera.size.width) as usize;
        let pixels = band.nodes[0].distance.len();
        work.rays.resize_with(BATCH, Profile::default);
        work.segments.resize_with(BATCH, Segments::default);
        for start in (0..pixels).step_by(BATCH) {
            let count = BATCH.min(pixels - start);
            for (offset, profile) in (start..start + count).zip(&mut work.rays) {
                let distance = band.nodes[0].distance[offset];
                counts.steps += self.march(first + offset, distance, &mut work.march, profile);
            }
            let (rays, segments) = (&work.rays[..count], &mut work.segments[..count]);
            if exactly && format.layering == Layering::Optimal {
                for (ray, segments) in rays.iter().zip(segments.iter_mut()) {
                    segments.clear();
                    cut_plainly(ray, band.layers.len(), segments);
                }
            } else {
                work.cutter.cut(format.layering, band.layers.len(), range, rays, segments);
            }
            for (offset, segments) in (start..start + count).zip(segments) {
                for (index, layer) in band.layers.iter_mut().enumerate() {
                    layer.set(offset, segments.get(index));
                }
            }
        }
        works.lock().unwrap_or_else(PoisonError::into_inner).push(work);
    }

    /// What the ray through the centre of a pixel goes through.
    fn march(&self, pixel: usize, distance_m: f32, work: &mut march::Work, profile: &mut Profile) -> u64 {
        let centre = self.camera.size.pixel_centre(pixel);
        let depth_per_m = self.camera.ray_in_view(centre).length().recip();
        let ray = self.eye.ray_through(centre);
        self.marcher.march(&self.renderer.tracer, &ray, self.eye.inside, distance_m, depth_per_m, work, profile)
    }
}
