//! What counts of a surface, and what a direction is worth to it.

use super::{Bsdf, Enclosure, LobeSample};
use glam::{Vec2, Vec3};

/// Which lobes count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Lobes {
    /// Light scattered below the surface: Lambert reflection.
    pub(crate) diffuse: bool,
    /// What else has no direction to speak of: light that met several facets; and a rough layer beside one that
    /// is nearly sharp.
    pub(crate) broad: bool,
    /// The rough reflection about the mirror direction. Where the surface is nearly sharp, all of what its
    /// [`super::Bsdf::nearly_sharp`] boundary reflects.
    pub(crate) reflected: bool,
    /// The rough transmission about the refracted direction.
    pub(crate) refracted: bool,
}

impl Lobes {
    pub(crate) const NONE: Lobes = Lobes { diffuse: false, broad: false, reflected: false, refracted: false };
    pub(crate) const DIFFUSE: Lobes = Lobes { diffuse: true, ..Lobes::NONE };
    pub(crate) const BROAD: Lobes = Lobes { broad: true, ..Lobes::NONE };
    pub(crate) const REFLECTED: Lobes = Lobes { reflected: true, ..Lobes::NONE };
    pub(crate) const REFRACTED: Lobes = Lobes { refracted: true, ..Lobes::NONE };
    /// Without Lambert reflection, which is known from elsewhere.
    pub(crate) const GLOSSY: Lobes = Lobes { diffuse: false, ..Lobes::ALL };
    pub(crate) const ALL: Lobes = Lobes { diffuse: true, broad: true, reflected: true, refracted: true };

    /// Whether any of `others` is among them.
    pub(crate) const fn have(self, others: Lobes) -> bool {
        self.diffuse && others.diffuse
            || self.broad && others.broad
            || self.reflected && others.reflected
            || self.refracted && others.refracted
    }

    /// How much facets send on that reflect this part of the light and let the rest through a filter.
    pub(crate) fn albedo_of_facets(self, reflectance: f32, filter: Vec3) -> f32 {
        let reflected = if self.have(Lobes::REFLECTED) { reflectance } else { 0.0 };
        let through = if self.have(Lobes::REFRACTED) { (1.0 - reflectance) * filter.max_element() } else { 0.0 };
        reflected + through
    }

    /// Probability that such a facet reflects: its reflectance, unless one lobe alone counts.
    pub(crate) fn probability_of_reflection(self, reflectance: f32) -> f32 {
        match (self.have(Lobes::REFLECTED), self.have(Lobes::REFRACTED)) {
            (true, true) => reflectance,
            (true, false) => 1.0,
            _ => 0.0,
        }
    }
}

/// What scatters light by a density, so that directions are drawn from it and lights are weighted against it.
pub(crate) trait Scatters {
    /// What it makes of light from the unit direction `towards`, and how probable that direction is.
    fn evaluate(&self, towards: Vec3) -> Evaluated;
    /// Draws where light may come from; `None` where the draw sends no light.
    fn sample(&self, choice: f32, u: Vec2) -> Option<LobeSample>;
    /// Whether facets scatter, and `choice` is made use of.
    fn is_glossy(&self) -> bool;
    /// The medium that light from `towards` runs through, on its way to this surface.
    fn medium_towards(&self, towards: Vec3) -> Enclosure;
}

/// Some of the lobes of a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LobesOf<'a> {
    pub(crate) bsdf: &'a Bsdf,
    pub(crate) lobes: Lobes,
}

impl Scatters for LobesOf<'_> {
    fn evaluate(&self, towards: Vec3) -> Evaluated {
        self.bsdf.evaluate(towards, self.lobes)
    }

    fn sample(&self, choice: f32, u: Vec2) -> Option<LobeSample> {
        self.bsdf.sample(choice, u, self.lobes)
    }

    fn is_glossy(&self) -> bool {
        self.bsdf.has(Lobes { diffuse: false, ..self.lobes })
    }

    fn medium_towards(&self, towards: Vec3) -> Enclosure {
        self.bsdf.medium_towards(towards)
    }
}

/// What the lobes make of light from one direction, and how probable the direction is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Evaluated {
    /// With the cosine.
    pub(crate) value: Vec3,
    /// Over solid angle.
    pub(crate) pdf: f32,
}

impl Evaluated {
    pub(crate) const NOTHING: Evaluated = Evaluated { value: Vec3::ZERO, pdf: 0.0 };

    pub(crate) fn add(&mut self, value: Vec3, pdf: f32) {
        self.value += value;
        self.pdf += pdf;
    }

    /// With the density divided by the sum of the weights that it was multiplied by.
    pub(crate) fn over(self, weights: f32) -> Evaluated {
        if weights > 0.0 { Evaluated { pdf: self.pdf / weights, ..self } } else { Evaluated::NOTHING }
    }
}
