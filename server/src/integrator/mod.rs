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

mod boundary;
mod emitters;
mod irradiance;
mod lambert;
mod path;
#[cfg(test)]
mod reference;
pub mod sampler;
mod surroundings;
#[cfg(test)]
mod tests;

pub(crate) use boundary::{Boundary, Medium, interface_of};
pub(crate) use irradiance::Gather;
pub(crate) use path::{SpecularEvents, Vertex};

use crate::accel::Accel;
use crate::scene::Scene;
use emitters::Emitters;
use std::sync::Arc;
use surroundings::Surroundings;

/// A scene made ready for tracing.
#[derive(Debug)]
pub struct PathTracer {
    pub(crate) scene: Arc<Scene>,
    pub(crate) accel: Accel,
    emitters: Emitters,
    surroundings: Option<Surroundings>,
}

impl PathTracer {
    /// Builds the hierarchy and the tables of lights.
    pub fn new(scene: Arc<Scene>) -> PathTracer {
        PathTracer {
            accel: Accel::new(&scene),
            emitters: Emitters::new(&scene),
            surroundings: Surroundings::new(&scene.environment),
            scene,
        }
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }
}
