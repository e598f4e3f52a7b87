//! How bright and how sharp the rough lobes of a surface are, as one ray sees it: what a filter of their light is
//! steered by.
//!
//! Beside the lobes themselves, for [`crate::frame`]. Light that lobes send back is divided by the reflectance before
//! it is averaged over neighbouring points and multiplied by it afterwards (textures of metal stay sharp), and how far
//! neighbours may be away follows from the alpha. So both may be approximate: the reflectance is that of one
//! microfacet lobe under even light, without the Fresnel term of single facets.

use super::{Bsdf, Glossy, Lobes};
use glam::Vec3;

/// Rough lobes in two numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Gloss {
    /// What they send back of light that is the same from everywhere, about.
    pub(crate) reflectance: Vec3,
    /// The least alpha among them, along the smoother direction; that of a lobe that is refracted is as much smaller as
    /// the boundary bends less than a mirror.
    pub(crate) alpha: f32,
}

impl Gloss {
    /// Of no lobe.
    pub(super) const NONE: Gloss = Gloss { reflectance: Vec3::ZERO, alpha: 1.0 };

    /// Adds a lobe.
    pub(super) fn add(&mut self, reflectance: Vec3, alpha: f32) {
        if reflectance != Vec3::ZERO {
            self.reflectance += reflectance;
            self.alpha = self.alpha.min(alpha);
        }
    }
}

impl Bsdf {
    /// The rough ones of these lobes.
    pub(crate) fn gloss(&self, lobes: Lobes) -> Gloss {
        match &self.glossy {
            Glossy::None => Gloss::NONE,
            Glossy::Conductor(lobe) => lobe.gloss(lobes),
            Glossy::Dielectric(lobe) => lobe.gloss(lobes),
            Glossy::Pane(lobe) => lobe.gloss(lobes),
            Glossy::Standard(lobe) => lobe.gloss(lobes),
        }
    }
}
