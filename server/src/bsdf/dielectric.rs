//! Rough glass and rough water: facets that reflect and refract.
//!
//! Method: Walter et al. 2007, equations 20 and 21, over [`super::microfacet`]. Radiance is scaled by 1/eta^2 on
//! the way into a medium, as at a smooth boundary. A visible facet is drawn first, then reflection or
//! refraction by its own Fresnel term, so that the weight of a sample is G1 of its direction (times filter and
//! 1/eta^2).
//!
//! Where the finish is compensated, both lobes are divided by the part of the light that they keep
//! ([`dielectric_albedo`]): what met several facets leaves as what met one. So energy is kept exactly, for
//! whatever arrives; reciprocity is not, by the ratio of the two directions' albedos, which matters to nobody
//! who follows light from the eye alone.

use super::gloss::Gloss;
use super::lobes::{Evaluated, Lobes};
use super::microfacet::{Facets, reflect_about};
use super::transmission::dielectric_albedo;
use crate::scene::Finish;
use glam::{Vec2, Vec3};
use warplight_protocol::optics::{fresnel_dielectric, refract};

/// A rough boundary seen from one direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RoughDielectric {
    facets: Facets,
    /// Index beyond over the index before.
    eta: f32,
    /// Factor on what is refracted.
    filter: Vec3,
    /// What multiple scattering adds, at least 1.
    scale: f32,
    /// Fraction reflected along the normal of the surface: by it the lobes are weighed against others.
    reflectance: f32,
}

impl RoughDielectric {
    pub(crate) fn new(finish: &Finish, facets: Facets, eta: f32, filter: Vec3, mu: f32) -> RoughDielectric {
        /// Facets are inclined: some reflect, and some refract beyond the critical angle of the surface.
        const LEAST: f32 = 0.01;
        let scale = if finish.compensated { 1.0 / dielectric_albedo(&facets, eta, mu).clamp(0.1, 1.0) } else { 1.0 };
        RoughDielectric {
            facets,
            eta,
            filter,
            scale,
            reflectance: fresnel_dielectric(mu, eta).clamp(LEAST, 1.0 - LEAST),
        }
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
            // A mirror turns a ray by twice what it is tilted by.
            let bend = 0.5 * (1.0 - 1.0 / self.eta).abs().min(1.0);
            gloss.add((1.0 - self.reflectance) * self.filter, alpha * bend);
        }
        gloss
    }

    pub(crate) fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: Lobes) -> Evaluated {
        if wi.z > 0.0 && lobes.have(Lobes::REFLECTED) {
            let Some(glint) = self.facets.glint(wo, wi) else { return Evaluated::NOTHING };
            let reflectance = fresnel_dielectric(glint.cosine, self.eta);
            Evaluated {
                value: Vec3::splat(reflectance * glint.value * self.scale),
                pdf: lobes.probability_of_reflection(reflectance) * glint.pdf,
            }
        } else if wi.z < 0.0 && lobes.have(Lobes::REFRACTED) {
            self.refracted(wo, wi, lobes).unwrap_or(Evaluated::NOTHING)
        } else {
            Evaluated::NOTHING
        }
    }

    fn refracted(&self, wo: Vec3, wi: Vec3, lobes: Lobes) -> Option<Evaluated> {
        let m = (wo + self.eta * wi).try_normalize()?;
        let m = if m.z < 0.0 { -m } else { m };
        let (cosine, beyond) = (wo.dot(m), -wi.dot(m));
        if cosine <= 0.0 || beyond <= 0.0 {
            return None;
        }
        let reflectance = fresnel_dielectric(cosine, self.eta);
        // Solid angle of facets over that of directions (Walter et al. 2007, equation 17).
        let jacobian = beyond / (cosine / self.eta - beyond).powi(2);
        let pdf = self.facets.pdf_visible(wo, m) * jacobian;
        if !(pdf > 0.0 && pdf.is_finite()) {
            return None;
        }
        let value = (1.0 - reflectance) * pdf * self.facets.visible(wi) * self.scale / (self.eta * self.eta);
        Some(Evaluated { value: self.filter * value, pdf: (1.0 - lobes.probability_of_reflection(reflectance)) * pdf })
    }

    pub(crate) fn sample(&self, wo: Vec3, choice: f32, u: Vec2, lobes: Lobes) -> Option<Vec3> {
        let m = self.facets.sample_visible(wo, u);
        let cosine = wo.dot(m);
        if choice < lobes.probability_of_reflection(fresnel_dielectric(cosine, self.eta)) {
            return Some(reflect_about(wo, m)).filter(|wi| wi.z > 0.0 && lobes.have(Lobes::REFLECTED));
        }
        refract(-wo, m, self.eta).filter(|wi| wi.z < 0.0 && lobes.have(Lobes::REFRACTED))
    }
}

/// Whether such facets blur what is refracted. What passes a boundary of index n is spread by alpha |1 - 1/n|:
/// below a few roundings of a direction (1e-7) that is no lobe, and exactly 0 where both sides are alike.
pub(crate) fn is_rough(facets: &Facets, ior: f32) -> bool {
    /// A fifth of what [`super::microfacet::SMOOTH_ALPHA`] asks of a reflection; glass of that alpha is rough.
    const LEAST_SPREAD: f32 = 2e-5;
    let bend = (ior - 1.0).abs().min((1.0 / ior - 1.0).abs());
    facets.alpha.max_element() * bend >= LEAST_SPREAD
}
