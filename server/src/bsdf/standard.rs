//! Metal, plastic and their mixtures, with a clear coat: the material of glTF.
//!
//! Method: glTF 2.0 (Khronos 2021), appendix B, with KHR_materials_ior, specular, anisotropy, clearcoat and
//! (thin) transmission. From above: a coat of index 1.5; one layer of facets whose Schlick reflectance is the
//! mixture of the metal's and the plastic's; below it what is left of the light, scattered (Lambert) or let through
//! as by a thin rough wall.
//!
//! Where the appendix leaves the mixing open or loses light, this is done:
//!
//! - Scattering below reflecting layers: albedo / pi (1 - E(wo)) (1 - E(wi)) / (1 - E_avg), with E the
//!   directional albedo of all that is above (Kelemen and Szirmay-Kalos 2001, Kulla and Conty 2017). Reciprocal; white
//!   below keeps all light.
//! - Below the coat, reflection is weakened by the smaller of what the coat lets through in both directions:
//!   reciprocal, never more than is there.
//! - The part of the metal that meets several facets has the lobe of [`Multiple`]. The plastic's enters it.
//! - A transmission keeps all that the plastic does not reflect, by a factor that depends on the direction
//!   looked from alone, as in [`super::thin`].
//!
//! Where a layer's alpha is 0 it is no lobe but part of a sharp boundary; the lobes below it stay.

use super::energy::{Albedo, Multiple, Schlick};
use super::gloss::Gloss;
use super::lobes::{Evaluated, Lobes};
use super::microfacet::{Facets, reflect_about};
use super::roughness::{is_narrow, is_rough};
use crate::accel::SurfacePoint;
use crate::scene::{Distribution, Scene, Standard};
use glam::{Vec2, Vec3};

/// Reflectance of a clear coat along its normal: index 1.5 (KHR_materials_clearcoat).
const COAT: Schlick = Schlick { f0: Vec3::splat(0.04), f90: Vec3::ONE };

/// A clear coat at one point.
#[derive(Clone, Copy, Debug)]
struct CoatLayer {
    /// `None` where it is smooth.
    facets: Option<Facets>,
    strength: f32,
    albedo: Albedo,
}

/// The layers at one point, seen from one direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layers {
    /// `None` where it is smooth.
    facets: Option<Facets>,
    albedo: Albedo,
    coat: Option<CoatLayer>,
    /// Of the metal and the plastic together.
    mixture: Schlick,
    plastic: Schlick,
    /// Part that is metal, with several facets; `None` where nothing is.
    multiple: Option<(f32, Multiple)>,
    /// Factor on what goes through the plastic, without its Fresnel term.
    transmitted: Vec3,
    /// What multiple scattering adds to it, at least 1.
    transmitted_scale: Vec3,
    /// What is scattered below the layers, as of [`Layers::diffuse`].
    scattered: Vec3,
    /// 1 / (1 - E_avg) of the layers above.
    scattered_scale: Vec3,
    /// Part of the light that the coat lets through towards the eye.
    uncoated: f32,
    /// Cosine of the direction looked from.
    mu: f32,
    weights: [(Lobes, f32); 4],
}

impl Layers {
    /// `facets` are those of the finish, `None` where it is smooth; `mu` is the cosine of the direction looked
    /// from.
    pub(crate) fn new(
        scene: &Scene,
        standard: &Standard,
        point: &SurfacePoint,
        facets: Option<Facets>,
        mu: f32,
    ) -> Layers {
        let textures = &scene.textures;
        let unit = |value: f32| if value.is_finite() { value.clamp(0.0, 1.0) } else { 0.0 };
        let base = standard.base.at(textures, point.uv).clamp(Vec3::ZERO, Vec3::ONE);
        let metallic = unit(standard.metallic.at(textures, point.uv));
        let specular = unit(standard.specular.at(textures, point.uv));
        let transmission = unit(standard.transmission.at(textures, point.uv));
        let along_normal = ((standard.ior - 1.0) / (standard.ior + 1.0)).powi(2);
        let plastic = Schlick {
            f0: (along_normal * standard.specular_color.at(textures, point.uv)).clamp(Vec3::ZERO, Vec3::ONE) * specular,
            f90: Vec3::splat(specular),
        };
        let mixture = Schlick { f0: plastic.f0.lerp(base, metallic), f90: plastic.f90.lerp(Vec3::ONE, metallic) };
        let coat = standard.coat.and_then(|coat| {
            let strength = unit(coat.strength.at(textures, point.uv));
            let alpha = coat.alpha.at(textures, point.uv);
            let facets = is_rough(alpha).then(|| Facets::new(Distribution::Ggx, Vec2::splat(alpha)));
            let albedo = facets.map_or(Albedo::SMOOTH, |facets| Albedo::of(&facets));
            (strength > 0.0).then_some(CoatLayer { facets, strength, albedo })
        });
        let albedo = facets.map_or(Albedo::SMOOTH, |facets| Albedo::of(&facets));
        let multiple = (standard.finish.compensated && facets.is_some() && metallic > 0.0).then(|| {
            let mean = base + (Vec3::ONE - base) / 21.0;
            (metallic, Multiple::new(albedo, mean, mu))
        });
        let mut layers = Layers {
            facets,
            albedo,
            coat,
            mixture,
            plastic,
            multiple,
            transmitted: base * ((1.0 - metallic) * transmission),
            transmitted_scale: Vec3::ONE,
            scattered: base * ((1.0 - metallic) * (1.0 - transmission)),
            scattered_scale: Vec3::ONE,
            uncoated: 1.0,
            mu,
            weights: [(Lobes::BROAD, 0.0); 4],
        };
        layers.uncoated = layers.through_coat(mu);
        layers.look(standard.finish.compensated);
        layers
    }

    /// What depends on the direction looked from.
    fn look(&mut self, compensated: bool) {
        let split = self.albedo.at(self.mu);
        if self.scattered != Vec3::ZERO {
            let mean = self.mean_reflected_above();
            self.scattered_scale = (Vec3::ONE - mean).max(Vec3::splat(1e-4)).recip();
            self.scattered *= Vec3::ONE - self.reflected_above(self.mu);
        }
        let let_through = Vec3::splat(split.element_sum()) - self.plastic.albedo(split);
        if compensated && self.facets.is_some() && self.transmitted != Vec3::ZERO {
            let wanted = Vec3::ONE - self.plastic.albedo(split);
            self.transmitted_scale = (wanted / let_through.max(Vec3::splat(1e-3))).clamp(Vec3::ONE, Vec3::splat(10.0));
        }

        // Lobes, and about what each sends on. Where one layer is nearly sharp and the other is rougher, the
        // rougher is no part of the reflection that a node may show.
        let narrow = |facets: &Option<Facets>| facets.is_none_or(|facets| is_narrow(facets.alpha));
        let coat_narrow = self.coat.is_some_and(|coat| narrow(&coat.facets));
        let base_narrow = narrow(&self.facets);
        let kind = |own: bool, other: bool| if other && !own { Lobes::BROAD } else { Lobes::REFLECTED };
        let of_coat =
            self.coat.filter(|coat| coat.facets.is_some()).map_or(0.0, |coat| self.coat_albedo(&coat, self.mu));
        let rough = if self.facets.is_some() { self.uncoated } else { 0.0 };
        let of_multiple = self.multiple.map_or(Vec3::ZERO, |(metallic, multiple)| metallic * multiple.albedo());
        self.weights = [
            (kind(coat_narrow, base_narrow), of_coat),
            (kind(base_narrow, coat_narrow), rough * self.mixture.albedo(split).max_element()),
            (Lobes::BROAD, rough * of_multiple.max_element()),
            (Lobes::REFRACTED, rough * (self.transmitted * self.transmitted_scale * let_through).max_element()),
        ];
    }

    fn coat_albedo(&self, coat: &CoatLayer, mu: f32) -> f32 {
        coat.strength * COAT.albedo(coat.albedo.at(mu)).x
    }

    /// Part of the light that passes the coat.
    fn through_coat(&self, mu: f32) -> f32 {
        self.coat.map_or(1.0, |coat| 1.0 - self.coat_albedo(&coat, mu))
    }

    /// Directional albedo of all that lies above the scattering plastic.
    fn reflected_above(&self, mu: f32) -> Vec3 {
        let uncoated = self.through_coat(mu);
        let plastic = self.plastic.albedo(self.albedo.at(mu));
        (Vec3::splat(1.0 - uncoated) + uncoated * plastic).min(Vec3::ONE)
    }

    /// Its mean over directions, weighted by the cosine.
    fn mean_reflected_above(&self) -> Vec3 {
        /// Gauss's rule of five points for the weight mu: 1e-3 for a product of two albedos.
        const POINTS: [(f32, f32); 5] = [
            (0.098_535_09, 0.015_747_914),
            (0.304_535_73, 0.073_908_87),
            (0.562_025_2, 0.146_387),
            (0.801_986_6, 0.167_174_64),
            (0.960_190_1, 0.096_781_59),
        ];
        match self.coat {
            None => self.plastic.albedo(self.albedo.average()),
            Some(_) => POINTS.into_iter().map(|(mu, weight)| 2.0 * weight * self.reflected_above(mu)).sum(),
        }
    }

    /// What the scattering plastic makes of the same radiance from everywhere.
    pub(crate) fn diffuse(&self) -> Vec3 {
        self.scattered
    }

    /// Factor on [`Layers::diffuse`] over pi for light from a direction of cosine `mu`; 1 on average.
    pub(crate) fn diffuse_factor(&self, mu: f32) -> Vec3 {
        (Vec3::ONE - self.reflected_above(mu)) * self.scattered_scale
    }

    /// What the layers that `counts` says of reflect along the mirror direction, as if they were smooth.
    fn reflectance_of(&self, counts: impl Fn(&Option<Facets>) -> bool) -> Vec3 {
        let coat = self.coat.filter(|coat| counts(&coat.facets));
        let coat = coat.map(|coat| coat.strength * COAT.reflectance(self.mu).x);
        let uncoated = coat.map_or(self.uncoated, |coat| 1.0 - coat);
        let base = if counts(&self.facets) { self.mixture.reflectance(self.mu) * uncoated } else { Vec3::ZERO };
        Vec3::splat(coat.unwrap_or(0.0)) + base
    }

    fn transmittance(&self) -> Vec3 {
        self.transmitted * (Vec3::ONE - self.plastic.reflectance(self.mu)) * self.uncoated
    }

    /// What the smooth layers reflect and let through; `None` where none is.
    pub(crate) fn sharp(&self) -> Option<(Vec3, Vec3)> {
        let reflected = self.reflectance_of(Option::is_none);
        let through = if self.facets.is_none() { self.transmittance() } else { Vec3::ZERO };
        (reflected != Vec3::ZERO || through != Vec3::ZERO).then_some((reflected, through))
    }

    /// The same of nearly sharp layers, as if they were smooth.
    pub(crate) fn nearly_sharp(&self) -> Option<(Vec3, Vec3)> {
        let narrow = |facets: &Option<Facets>| facets.is_some_and(|facets| is_narrow(facets.alpha));
        let reflected = self.reflectance_of(narrow);
        let through = if narrow(&self.facets) { self.transmittance() } else { Vec3::ZERO };
        (reflected != Vec3::ZERO || through != Vec3::ZERO).then_some((reflected, through))
    }

    fn weights(&self, lobes: Lobes) -> [f32; 4] {
        self.weights.map(|(lobe, weight)| if lobes.have(lobe) { weight } else { 0.0 })
    }

    pub(crate) fn albedo(&self, lobes: Lobes) -> f32 {
        self.weights(lobes).iter().sum()
    }

    pub(crate) fn gloss(&self, lobes: Lobes) -> Gloss {
        let [coat, base, multiple, through] = self.weights(lobes);
        let mut gloss = Gloss::NONE;
        if let Some(facets) = self.coat.and_then(|coat| coat.facets) {
            gloss.add(Vec3::splat(coat), facets.alpha.min_element());
        }
        if let Some(facets) = self.facets {
            let alpha = facets.alpha.min_element();
            if base > 0.0 {
                gloss.add(self.uncoated * self.mixture.albedo(self.albedo.at(self.mu)), alpha);
            }
            if multiple > 0.0 {
                let of_multiple = self.multiple.map_or(Vec3::ZERO, |(metallic, lobe)| metallic * lobe.albedo());
                gloss.add(self.uncoated * of_multiple, 1.0);
            }
            if through > 0.0 {
                gloss.add(self.uncoated * self.transmitted, alpha);
            }
        }
        gloss
    }

    pub(crate) fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: Lobes) -> Evaluated {
        let [coat, base, multiple, through] = self.weights(lobes);
        let mut sum = Evaluated::NOTHING;
        let uncoated = if self.coat.is_some() { self.uncoated.min(self.through_coat(wi.z.abs())) } else { 1.0 };
        if wi.z > 0.0 {
            if coat > 0.0
                && let Some(CoatLayer { facets: Some(facets), strength, .. }) = &self.coat
                && let Some(glint) = facets.glint(wo, wi)
            {
                sum.add(COAT.reflectance(glint.cosine) * (strength * glint.value), coat * glint.pdf);
            }
            if base > 0.0
                && let Some(glint) = self.facets.and_then(|facets| facets.glint(wo, wi))
            {
                sum.add(self.mixture.reflectance(glint.cosine) * (uncoated * glint.value), base * glint.pdf);
            }
            if multiple > 0.0
                && let Some((metallic, lobe)) = &self.multiple
            {
                sum.add(lobe.value(wi.z) * (uncoated * metallic), multiple * lobe.pdf(wi.z));
            }
        } else if wi.z < 0.0
            && through > 0.0
            && let Some(glint) = self.facets.and_then(|facets| facets.glint(wo, wi.with_z(-wi.z)))
        {
            let part = self.transmitted * self.transmitted_scale * (Vec3::ONE - self.plastic.reflectance(glint.cosine));
            sum.add(part * (uncoated * glint.value), through * glint.pdf);
        }
        sum.over(coat + base + multiple + through)
    }

    pub(crate) fn sample(&self, wo: Vec3, choice: f32, u: Vec2, lobes: Lobes) -> Option<Vec3> {
        let [coat, base, multiple, through] = self.weights(lobes);
        let mut left = choice * (coat + base + multiple + through);
        let drawn =
            |facets: Option<Facets>| Some(reflect_about(wo, facets?.sample_visible(wo, u))).filter(|wi| wi.z > 0.0);
        if left < coat {
            return drawn(self.coat.and_then(|coat| coat.facets));
        }
        left -= coat;
        if left < base {
            return drawn(self.facets);
        }
        left -= base;
        if left < multiple {
            return self.multiple.map(|(_, lobe)| lobe.sample(u));
        }
        let reflected = drawn(self.facets).filter(|_| through > 0.0)?;
        Some(reflected.with_z(-reflected.z))
    }
}
