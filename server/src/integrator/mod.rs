//! Light transport: a unidirectional path tracer.
//!
//! Third stage of the server: scene -> accel -> integrator -> film and frame.
//!
//! Method: Kajiya 1986 with next-event estimation and multiple importance sampling by the balance heuristic
//! (Veach 1997), Russian roulette, Lambert and smooth specular surfaces. Estimates are unbiased up to
//! `max_depth`; samples that are not finite are dropped and counted.
//!
//! Limits: smooth or diffuse surfaces only; media do not scatter and do not nest (a ray that leaves any
//! dielectric is in air); the eye is in air; light that reaches a diffuse surface through a dielectric is
//! found by chance only (caustics are noisy). Cost: two rays per diffuse bounce.

mod cutouts;
mod emitters;
#[cfg(test)]
mod far;
mod irradiance;
mod lights;
mod path;
#[cfg(test)]
mod reference;
pub mod sampler;
mod surroundings;
#[cfg(test)]
mod tests;

pub(crate) use irradiance::Gather;
pub(crate) use path::{Arrival, Events, Met, Vertex};

use crate::accel::Accel;
use crate::effects::Simulated;
use crate::scene::{Moved, Scene};
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
