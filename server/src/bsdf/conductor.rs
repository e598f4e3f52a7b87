//! Rough metal: facets that reflect by the exact Fresnel formula.
//!
//! Method: Walter et al. 2007, equation 20, over [`super::microfacet`]; where the finish is compensated, the light
//! that meets several facets comes back in the lobe of [`super::energy::Multiple`]. Cost: 50 ns to make, for the
//! mean reflectance (none without compensation), and as much for each value.

use super::energy::{Albedo, Multiple};
use super::gloss::Gloss;
use super::lobes::{Evaluated, Lobes};
use super::microfacet::{Facets, reflect_about};
use crate::scene::Finish;
use glam::{Vec2, Vec3};
use warplight_protocol::optics::Interface;

/// A rough metal seen from one direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RoughConductor {
    facets: Facets,
    interface: Interface,
    filter: Vec3,
    multiple: Option<Multiple>,
    /// About what each lobe sends on, by whose largest part it is chosen.
    single_albedo: Vec3,
    multiple_albedo: Vec3,
}

impl RoughConductor {
    pub(crate) fn new(finish: &Finish, facets: Facets, interface: Interface, filter: Vec3, mu: f32) -> RoughConductor {
        let albedo = Albedo::of(&facets);
        let multiple = finish.compensated.then(|| Multiple::new(albedo, mean_reflectance(&interface), mu));
        RoughConductor {
            facets,
            interface,
            filter,
            multiple,
            single_albedo: interface.reflectance(mu) * filter * albedo.white(mu),
            multiple_albedo: multiple.map_or(Vec3::ZERO, |multiple| multiple.albedo() * filter),
        }
    }

    fn weights(&self, lobes: Lobes) -> [f32; 2] {
        let count = |lobe, weight| if lobes.have(lobe) { weight } else { 0.0 };
        [
            count(Lobes::REFLECTED, self.single_albedo.max_element()),
            count(Lobes::BROAD, self.multiple_albedo.max_element()),
        ]
    }

    pub(crate) fn gloss(&self, lobes: Lobes) -> Gloss {
        let mut gloss = Gloss::NONE;
        if lobes.have(Lobes::REFLECTED) {
            gloss.add(self.single_albedo, self.facets.alpha.min_element());
        }
        if lobes.have(Lobes::BROAD) {
            gloss.add(self.multiple_albedo, 1.0);
        }
        gloss
    }

    pub(crate) fn albedo(&self, lobes: Lobes) -> f32 {
        self.weights(lobes).iter().sum()
    }

    pub(crate) fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: Lobes) -> Evaluated {
        let [single, multiple] = self.weights(lobes);
        let mut sum = Evaluated::NOTHING;
        if wi.z <= 0.0 {
            return sum;
        }
        if single > 0.0
            && let Some(glint) = self.facets.glint(wo, wi)
        {
            sum.add(self.interface.reflectance(glint.cosine) * self.filter * glint.value, single * glint.pdf);
        }
        if multiple > 0.0
            && let Some(lobe) = &self.multiple
        {
            sum.add(lobe.value(wi.z) * self.filter, multiple * lobe.pdf(wi.z));
        }
        sum.over(single + multiple)
    }

    pub(crate) fn sample(&self, wo: Vec3, choice: f32, u: Vec2, lobes: Lobes) -> Option<Vec3> {
        let [single, multiple] = self.weights(lobes);
        if choice * (single + multiple) < single {
            Some(reflect_about(wo, self.facets.sample_visible(wo, u)))
        } else {
            self.multiple.filter(|_| multiple > 0.0).map(|lobe| lobe.sample(u))
        }
    }
}

/// 2 F(mu) mu dmu, by Gauss's rule of three points for the weight mu: 0.2 % for real metals.
fn mean_reflectance(interface: &Interface) -> Vec3 {
    const POINTS: [(f32, f32); 3] =
        [(0.212_340_54, 0.069_826_98), (0.590_533_14, 0.229_241_1), (0.911_412_04, 0.200_931_9)];
    POINTS.into_iter().map(|(mu, weight)| 2.0 * weight * interface.reflectance(mu)).sum()
}
