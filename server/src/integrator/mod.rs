//! Light transport: a unidirectional path tracer.
//!
//! Third stage of the server: scene -> accel -> integrator -> film and frame.
//!
//! Method: Kajiya 1986 with next-event estimation and multiple importance sampling by the balance heuristic
//! (Veach 1997), Russian roulette, Lambert and smooth specular surfaces. Estimates are unbiased up to
//! `max_depth`; samples that are not finite are dropped and counted.
//!
//! Between surfaces a path may run through media (`media`), which are flown through by delta tracking (`flight`) and
//! whose boundaries say what it is inside of (`boundaries`). Scenes without any decide that once per segment.
//!
//! Limits: without media of the scene's a ray that leaves any dielectric is in air, and so is the eye; light that
//! reaches a diffuse surface or a medium through a dielectric is found by chance only (caustics are noisy).
//! Cost: two rays per diffuse bounce or scattering.

mod boundaries;
mod cutouts;
mod emitters;
#[cfg(test)]
mod far;
mod flight;
mod irradiance;
mod lights;
mod media;
mod path;
#[cfg(test)]
mod reference;
pub mod sampler;
mod surroundings;
#[cfg(test)]
mod tests;

pub use boundaries::MediumInterval;
pub(crate) use irradiance::Gather;
pub(crate) use media::Departure;
pub(crate) use path::{Arrival, Events, Met, Vertex};

use crate::accel::Accel;
use crate::effects::Simulated;
use crate::scene::{Material, Moved, Scene};
use lights::Lights;
use std::sync::Arc;

/// A scene made ready for tracing.
#[derive(Debug)]
pub struct PathTracer {
    pub(crate) scene: Arc<Scene>,
    pub(crate) accel: Accel,
    lights: Lights,
    /// Whether any surface has holes.
    has_cutouts: bool,
    /// Whether any surface bounds a medium that scatters.
    pub(crate) has_media: bool,
    /// Whether any surface refracts colours differently.
    has_dispersion: bool,
    /// All, but for a measurement of what an effect costs.
    pub(crate) simulated: Simulated,
}

impl PathTracer {
    /// Builds the hierarchy and the tables of lights.
    pub fn new(scene: Arc<Scene>) -> PathTracer {
        PathTracer::limited(scene, Simulated::ALL)
    }

    /// One that follows some events only.
    pub fn limited(scene: Arc<Scene>, simulated: Simulated) -> PathTracer {
        crate::bsdf::prepare(&scene);
        PathTracer {
            simulated,
            accel: Accel::new(&scene),
            lights: Lights::new(&scene),
            has_media: !scene.media.is_empty() && scene.materials.iter().any(Material::bounds_medium),
            has_cutouts: cutouts::has_cutouts(&scene),
            has_dispersion: scene.materials.iter().any(|material| material.surface.is_dispersive()),
            scene,
        }
    }

    /// Changes where things are, and makes ready again what depends on it; whether anything did. The scene is copied
    /// first if it is shared.
    pub(crate) fn change(&mut self, place: impl FnOnce(&mut Scene) -> Moved) -> bool {
        let moved = place(Arc::make_mut(&mut self.scene));
        if moved.surfaces {
            self.accel = Accel::new(&self.scene);
        }
        if moved != Moved::default() {
            self.lights.update(&self.scene, moved);
        }
        moved != Moved::default()
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }
}
