//! Views of media for frames: marching along rays of view through matter whose light is known.
//!
//! Stage of the server between the path tracer and the layering of a frame. What a medium scatters towards the eye does not
//! depend on the view if it scatters alike in all directions. So it is computed once per voxel of a [`LightGrid`], by path
//! tracing, and refined while frames are rendered; a ray of view only marches, through emission and absorption
//! (Max 1995). Where a medium scatters forwards, frames show it as if it did not; stills show it as it is.
//!
//! A ray takes steps of half a voxel of the medium's grid, skips blocks that are empty, and classifies each step by the
//! mean of the transfer function over it (pre-integration, Engel et al. 2001). It marches right through opaque matter:
//! from elsewhere what is behind it is seen.
//!
//! Cost: a sample of the grid per step in matter, and one of the light per half of its voxels.

mod bounds;
mod classify;
mod light;
mod step;
#[cfg(test)]
mod tests;

pub use bounds::MediaBounds;
pub use light::LightGrid;

use crate::accel::Ray;
use crate::bsdf::Enclosure;
use crate::integrator::{MediumInterval, PathTracer};
use crate::layering::Profile;
use step::Steps;

/// Marches through the media of one scene.
#[derive(Clone, Debug, Default)]
pub struct Marcher {
    media: Vec<Marched>,
}

/// A medium and the light in it.
#[derive(Clone, Debug)]
struct Marched {
    light: LightGrid,
    steps: Steps,
    /// Whether a ray of view may meet it.
    is_seen: bool,
}

/// Memory to work in.
#[derive(Clone, Debug, Default)]
pub struct Work {
    intervals: Vec<MediumInterval>,
}

impl Marcher {
    /// Prepares for the media of a scene; their light is dark until [`Marcher::refine`].
    pub fn new(tracer: &PathTracer) -> Marcher {
        let scene = tracer.scene();
        let media = scene.media.iter().enumerate().map(|(index, medium)| {
            let bounds = bounds::bounds_of(scene, index as u32);
            let light = LightGrid::new(medium, bounds);
            Marched { steps: Steps::new(medium, &light), light, is_seen: bounds.is_some() }
        });
        Marcher { media: media.collect() }
    }

    /// Whether there is nothing to march through.
    pub fn is_empty(&self) -> bool {
        !self.media.iter().any(|medium| medium.is_seen)
    }

    /// Adds about so many samples to the light of all media.
    pub fn refine(&mut self, tracer: &PathTracer, samples: usize, max_depth: u32, seed: u64) {
        let seen = self.media.iter().filter(|medium| medium.is_seen).count();
        let each = samples.div_ceil(seen.max(1));
        for (index, medium) in self.media.iter_mut().enumerate() {
            medium.light.refine(tracer, index as u32, each, max_depth, seed);
        }
    }

    /// Adds so many samples to the light of every voxel.
    pub fn refine_all(&mut self, tracer: &PathTracer, spp: u32, max_depth: u32, seed: u64) {
        for (index, medium) in self.media.iter_mut().enumerate() {
            let samples = medium.light.occupied() * spp as usize;
            medium.light.refine(tracer, index as u32, samples, max_depth, seed);
        }
    }

    /// Takes steps of so many voxels.
    pub(crate) fn set_step(&mut self, voxels: f32) {
        self.media.iter_mut().for_each(|medium| medium.steps.set_length(voxels));
    }

    /// Forgets the light: something has moved.
    pub fn forget_light(&mut self) {
        self.media.iter_mut().for_each(|medium| medium.light.forget());
    }

    /// Slices of what a ray goes through from its origin, which is inside of `enclosure`, to a surface at `distance_m` or
    /// to infinity. `depth_per_m` is the depth in view per distance along the ray.
    #[allow(clippy::too_many_arguments, reason = "a ray, what it is inside of, and where to write")]
    pub(crate) fn march(
        &self,
        tracer: &PathTracer,
        ray: &Ray,
        enclosure: Enclosure,
        distance_m: f32,
        depth_per_m: f32,
        work: &mut Work,
        profile: &mut Profile,
    ) -> u64 {
        profile.clear();
        if self.is_empty() {
            return 0;
        }
        work.intervals.clear();
        tracer.media_along(ray, enclosure, distance_m, &mut work.intervals);
        let mut steps = 0;
        for interval in &work.intervals {
            let Some(marched) = self.media.get(interval.medium as usize) else { continue };
            let medium = &tracer.scene().media[interval.medium as usize];
            steps +=
                marched.steps.march(medium, &marched.light, ray, interval.start..interval.end, depth_per_m, profile);
        }
        steps
    }
}
