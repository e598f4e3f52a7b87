//! What a smooth specular surface does with a ray: where it is reflected and refracted, and with what weight.
//!
//! The path tracer and the ray tree must agree on the direction, the Fresnel weight and the normal of every
//! specular pixel, so both ask here. The weights are the protocol's own, which the client applies.
//!
//! Radiance is scaled by 1/eta^2 on the way into a medium of relative index eta (Veach 1997, 5.2), so that
//! entering and leaving cancel.
//!
//! Where colours are refracted differently, indices follow Cauchy's formula of two terms,
//! n = A + B / lambda^2, through the index at 587.6 nm and the Abbe number (Born and Wolf, 2.3), at the lines
//! C, d and F: one wavelength stands for all of a colour.

use super::roughness::{may_be_narrow, may_be_narrow_scalar};
use super::{Channel, Enclosure};
use crate::scene::{Standard, Surface};
use glam::Vec3;
use warplight_protocol::optics::{self, Interface};

/// The refracted ray of a boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Refracted {
    pub(crate) direction: Vec3,
    /// Factor on the radiance that arrives by it, without Fresnel: filter and 1/eta^2.
    pub(crate) factor: Vec3,
    /// The medium it runs through.
    pub(crate) medium: Enclosure,
    /// The index beyond over the index before; 1 behind a pane.
    pub(crate) eta: f32,
}

impl Refracted {
    /// Whether it goes straight on into a medium other than the one that it comes through: the boundary is a pane
    /// between media, which shadow rays pass, too.
    pub(crate) fn passes(&self, before: Enclosure) -> bool {
        self.eta == 1.0 && self.medium != before
    }
}

/// A specular surface met by a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Boundary {
    /// As the client will know it.
    pub(crate) interface: Interface,
    /// Unit normal on the side the ray comes from.
    pub(crate) normal: Vec3,
    /// Fraction reflected.
    pub(crate) reflectance: Vec3,
    /// Where it is reflected to.
    pub(crate) reflected: Vec3,
    /// Factor on the radiance that arrives by reflection, without Fresnel. Where the surface reflects otherwise
    /// than its interface does, the ratio of the two for this ray.
    pub(crate) reflected_factor: Vec3,
    /// The refracted ray, unless the surface is opaque or reflects totally.
    pub(crate) refracted: Option<Refracted>,
}

impl Boundary {
    /// The boundary that this interface makes for a ray in `direction`. What goes through has the factor and the
    /// medium of `through`.
    pub(super) fn new(
        interface: Interface,
        normal: Vec3,
        direction: Vec3,
        reflected_factor: Vec3,
        through: Option<(Vec3, Enclosure)>,
    ) -> Boundary {
        let eta = if let Interface::Dielectric { eta } = interface { eta } else { 1.0 };
        let refracted = through.and_then(|(factor, medium)| {
            let direction = interface.refracted(direction, normal)?;
            Some(Refracted { direction, factor: factor / (eta * eta), medium, eta })
        });
        Boundary {
            interface,
            normal,
            reflectance: interface.reflectance(-direction.dot(normal)),
            reflected: optics::reflect(direction, normal),
            reflected_factor,
            refracted,
        }
    }
}

/// The interface that a surface shows to a ray from its outside or inside, where it is smooth or nearly sharp;
/// `None` if it is so nowhere. Colours that are refracted differently show that of the middle.
pub(crate) fn interface_of(surface: &Surface, from_outside: bool) -> Option<Interface> {
    match surface {
        Surface::Diffuse { .. } | Surface::Null => None,
        Surface::Mirror { .. } => Some(Interface::Mirror),
        Surface::Conductor { eta, k, finish, .. } => may_be_narrow(finish).then(|| conductor(*eta, *k)),
        Surface::Dielectric { ior, finish, .. } => {
            may_be_narrow(finish).then(|| dielectric(*ior, 0.0, from_outside, None))
        }
        Surface::ThinDielectric { ior, finish, .. } => may_be_narrow(finish).then_some(Interface::Pane { eta: *ior }),
        Surface::Standard(standard) => {
            let coated =
                standard.coat.is_some_and(|coat| coat.strength.most() > 0.0 && may_be_narrow_scalar(&coat.alpha));
            (coated || may_be_narrow(&standard.finish)).then(|| interface_of_standard(standard))
        }
    }
}

pub(super) fn conductor(eta: Vec3, k: Vec3) -> Interface {
    Interface::Conductor { eta: eta.to_array(), k: k.to_array() }
}

pub(super) fn dielectric(ior: f32, dispersion: f32, from_outside: bool, channel: Option<Channel>) -> Interface {
    let ior = index_of(ior, dispersion, channel);
    Interface::Dielectric { eta: if from_outside { ior } else { 1.0 / ior } }
}

/// What a standard surface looks most like: a pane where light goes through, a mirror where it is metal, else a
/// dielectric: of the coat where only the coat may be sharp. What it reflects in truth is in the factors of its
/// boundary.
pub(super) fn interface_of_standard(standard: &Standard) -> Interface {
    /// Below it an interface reflects so little that the ratio to what Schlick's formula gives at grazing
    /// angles would be without bounds.
    const LEAST_INDEX: f32 = 1.05;
    const COAT_INDEX: f32 = 1.5;
    let eta = if standard.ior.is_finite() { standard.ior.clamp(LEAST_INDEX, 1e3) } else { COAT_INDEX };
    let base_narrow = may_be_narrow(&standard.finish);
    if standard.transmission.most() > 0.0 && base_narrow {
        Interface::Pane { eta }
    } else if standard.metallic.most() >= 0.5 && base_narrow {
        Interface::Mirror
    } else if standard.coat.is_some_and(|coat| coat.strength.most() > 0.0) {
        Interface::Dielectric { eta: COAT_INDEX }
    } else {
        Interface::Dielectric { eta }
    }
}

/// The relative index for a colour; of the middle without one.
pub(super) fn index_of(ior: f32, dispersion: f32, channel: Option<Channel>) -> f32 {
    /// Fraunhofer's lines C, d and F in micrometres.
    const C: f32 = 0.6563;
    const D: f32 = 0.5876;
    const F: f32 = 0.4861;
    let wavelength = match channel {
        Some(Channel::Red) => C,
        Some(Channel::Blue) => F,
        Some(Channel::Green) | None => return ior,
    };
    if dispersion == 0.0 {
        return ior;
    }
    let per_square = |wavelength: f32| 1.0 / (wavelength * wavelength);
    let at_wavelength = |index: f32| {
        let spread = (index - 1.0) * dispersion / 20.0;
        let b = spread / (per_square(F) - per_square(C));
        (index + b * (per_square(wavelength) - per_square(D))).max(1.0)
    };
    // Below 1 it is the outside that disperses: a bubble.
    if ior >= 1.0 { at_wavelength(ior) } else { 1.0 / at_wavelength(1.0 / ior) }
}

/// The shading normal, unless a ray reflected or refracted by it would end on the wrong side of the surface.
pub(super) fn usable_normal(direction: Vec3, shading: Vec3, geometric: Vec3, interface: &Interface) -> Vec3 {
    let seen = direction.dot(shading) < 0.0;
    let reflects_outside = || optics::reflect(direction, shading).dot(geometric) > 0.0;
    let refracts_inside = || match *interface {
        Interface::Dielectric { eta } => {
            optics::refract(direction, shading, eta).is_none_or(|refracted| refracted.dot(geometric) < 0.0)
        }
        _ => true,
    };
    if seen && reflects_outside() && refracts_inside() { shading } else { geometric }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shading_normal_that_sends_light_through_the_surface_is_not_used() {
        let grazing = Vec3::new(0.995, -0.0999, 0.0).normalize();
        let tilted = Vec3::new(0.2, 1.0, 0.0).normalize();
        assert_eq!(usable_normal(grazing, tilted, Vec3::Y, &Interface::Mirror), Vec3::Y);
        let steep = Vec3::new(0.1, -1.0, 0.0).normalize();
        assert_eq!(usable_normal(steep, tilted, Vec3::Y, &Interface::Mirror), tilted);
    }

    #[test]
    fn indices_of_the_three_lines_give_the_abbe_number_back() {
        for (ior, abbe) in [(1.5168_f32, 64.17_f32), (1.7847, 25.76), (2.417, 55.3)] {
            let index = |channel| index_of(ior, 20.0 / abbe, Some(channel));
            let (red, green, blue) = (index(Channel::Red), index(Channel::Green), index(Channel::Blue));
            assert!(red < green && green < blue && green == ior);
            assert!(((green - 1.0) / (blue - red) - abbe).abs() < 2e-3 * abbe);
            assert!((index_of(1.0 / ior, 20.0 / abbe, Some(Channel::Red)) * red - 1.0).abs() < 1e-6, "a bubble");
        }
        // Schott's data sheet for N-BK7: 1.51432 at the line C, 1.52238 at F; a formula of two terms is off by 1e-4.
        assert!((index_of(1.5168, 20.0 / 64.17, Some(Channel::Red)) - 1.514_32).abs() < 2e-4);
        assert!((index_of(1.5168, 20.0 / 64.17, Some(Channel::Blue)) - 1.522_38).abs() < 2e-4);
    }
}
