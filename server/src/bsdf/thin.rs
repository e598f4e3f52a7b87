//! A rough pane: a thin plate whose faces scatter.
//!
//! Method: facets that reflect as a pane does, with all that runs to and fro between the faces
//! ([`Interface::Pane`]); what they let through leaves mirrored through the surface, blurred as much as the
//! reflection, which is what two rough faces close to each other do to first order (Burley 2015 treats thin
//! surfaces so). Both lobes are divided by the part of the light that they keep where the finish is compensated, as
//! in [`super::dielectric`].

use super::energy::Albedo;
use super::gloss::Gloss;
use super::lobes::{Evaluated, Lobes};
use super::microfacet::{Facets, reflect_about};
use crate::scene::Finish;
use glam::{Vec2, Vec3};
use warplight_protocol::optics::reflectance_of_pane;

/// A rough pane seen from one direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RoughPane {
    facets: Facets,
    /// Index of the plate over that around it.
    eta: f32,
    /// Factor on what goes through.
    filter: Vec3,
    /// What multiple scattering adds, at least 1.
    scale: f32,
    reflectance: f32,
}

impl RoughPane {
    pub(crate) fn new(finish: &Finish, facets: Facets, eta: f32, filter: Vec3, mu: f32) -> RoughPane {
        /// Facets are inclined: none reflects all, none nothing.
        const LEAST: f32 = 0.01;
        let scale = if finish.compensated { 1.0 / Albedo::of(&facets).white(mu).clamp(0.1, 1.0) } else { 1.0 };
        RoughPane { facets, eta, filter, scale, reflectance: reflectance_of_pane(mu, eta).clamp(LEAST, 1.0 - LEAST) }
    }

    pub(crate) fn albedo(&self, lobes: Lobes) -> f32 {
        lobes.albedo_of_facets(self.reflectance, self.filter)
    }

    pub(crate) fn gloss(&self, lobes: Lobes) -> Gloss {
        let mut gloss = Gloss::NONE;
        let alpha = self.facets.alpha.min_element();
        if lobes.have(Lobes::REFLECTED) {
            gloss.add(Vec3::splat(self.reflectance), alpha);
        }
        if lobes.have(Lobes::REFRACTED) {
            gloss.add((1.0 - self.reflectance) * self.filter, alpha);
        }
        gloss
    }

    pub(crate) fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: Lobes) -> Evaluated {
        let through = wi.z < 0.0;
        let counts = lobes.have(if through { Lobes::REFRACTED } else { Lobes::REFLECTED });
        let Some(glint) = self.facets.glint(wo, wi.with_z(wi.z.abs())).filter(|_| counts && wi.z != 0.0) else {
            return Evaluated::NOTHING;
        };
        let reflectance = reflectance_of_pane(glint.cosine, self.eta);
        let reflects = lobes.probability_of_reflection(reflectance);
        let (part, probability) = if through {
            (self.filter * (1.0 - reflectance), 1.0 - reflects)
        } else {
            (Vec3::splat(reflectance), reflects)
        };
        Evaluated { value: part * glint.value * self.scale, pdf: probability * glint.pdf }
    }

    pub(crate) fn sample(&self, wo: Vec3, choice: f32, u: Vec2, lobes: Lobes) -> Option<Vec3> {
        let m = self.facets.sample_visible(wo, u);
        let wi = reflect_about(wo, m);
        if wi.z <= 0.0 {
            return None;
        }
        let reflects = choice < lobes.probability_of_reflection(reflectance_of_pane(wo.dot(m), self.eta));
        let counts = lobes.have(if reflects { Lobes::REFLECTED } else { Lobes::REFRACTED });
        counts.then(|| if reflects { wi } else { wi.with_z(-wi.z) })
    }
}
