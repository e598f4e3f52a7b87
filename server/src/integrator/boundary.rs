//! What a smooth specular surface does with a ray: where it is reflected and refracted, and with what weight.
//!
//! The path tracer and the ray tree must agree on the direction, the Fresnel weight and the normal of every
//! specular pixel, so both ask here. The weights are the protocol's own, which the client applies.
//!
//! Radiance is scaled by 1/eta^2 on the way into a medium of relative index eta (Veach 1997, 5.2), so that
//! entering and leaving cancel.

use crate::accel::SurfacePoint;
use crate::scene::{Scene, Surface};
use glam::Vec3;
use warplight_protocol::optics::{self, Interface};

/// The transparent medium a ray runs through: its absorption per metre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Medium {
    absorption: Vec3,
}

impl Medium {
    /// Nothing in the way.
    pub(crate) const AIR: Medium = Medium { absorption: Vec3::ZERO };

    /// What is left of radiance after `distance_m`, which may be infinite (Beer-Lambert).
    pub(crate) fn transmittance(&self, distance_m: f32) -> Vec3 {
        let along = |absorption: f32| if absorption > 0.0 { (-absorption * distance_m).exp() } else { 1.0 };
        if self.absorption == Vec3::ZERO { Vec3::ONE } else { Vec3::from(self.absorption.to_array().map(along)) }
    }
}

/// The refracted ray of a boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Refracted {
    pub(crate) direction: Vec3,
    /// Factor on the radiance that arrives by it, without Fresnel: filter and 1/eta^2.
    pub(crate) factor: Vec3,
    /// The medium it runs through.
    pub(crate) medium: Medium,
    /// The index beyond over the index before.
    pub(crate) eta: f32,
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
    /// Factor on the radiance that arrives by reflection, without Fresnel.
    pub(crate) reflected_factor: Vec3,
    /// The refracted ray, unless the surface is opaque or reflects totally.
    pub(crate) refracted: Option<Refracted>,
}

impl Boundary {
    /// The boundary at `point` for a ray in `direction`; `None` where the surface is not specular.
    pub(crate) fn at(scene: &Scene, point: &SurfacePoint, direction: Vec3) -> Option<Boundary> {
        let surface = &scene.materials[point.material as usize].surface;
        let from_outside = direction.dot(point.geometric_normal) < 0.0;
        let interface = interface_of(surface, from_outside)?;
        let side = if from_outside { 1.0 } else { -1.0 };
        let geometric_normal = side * point.geometric_normal;
        let normal = usable_normal(direction, side * point.shading_normal, geometric_normal, &interface);
        let refracted = match (*surface, interface) {
            (Surface::Dielectric { filter, absorption, .. }, Interface::Dielectric { eta }) => {
                optics::refract(direction, normal, eta).map(|direction| Refracted {
                    direction,
                    factor: filter / (eta * eta),
                    medium: if from_outside { Medium { absorption } } else { Medium::AIR },
                    eta,
                })
            }
            _ => None,
        };
        Some(Boundary {
            interface,
            normal,
            reflectance: interface.reflectance(-direction.dot(normal)),
            reflected: optics::reflect(direction, normal),
            reflected_factor: if let Surface::Mirror { filter } = *surface { filter } else { Vec3::ONE },
            refracted,
        })
    }
}

/// The interface that a surface shows to a ray from its outside or inside; `None` if it is not specular.
pub(crate) fn interface_of(surface: &Surface, from_outside: bool) -> Option<Interface> {
    match *surface {
        Surface::Diffuse { .. } => None,
        Surface::Mirror { .. } => Some(Interface::Mirror),
        Surface::Conductor { eta, k } => Some(Interface::Conductor { eta: eta.to_array(), k: k.to_array() }),
        Surface::Dielectric { ior, .. } => {
            Some(Interface::Dielectric { eta: if from_outside { ior } else { 1.0 / ior } })
        }
    }
}

/// The shading normal, unless a ray reflected or refracted by it would end on the wrong side of the surface.
fn usable_normal(direction: Vec3, shading: Vec3, geometric: Vec3, interface: &Interface) -> Vec3 {
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
    fn an_absorbing_medium_lets_nothing_through_from_infinity() {
        let medium = Medium { absorption: Vec3::new(0.0, 1.0, 1e-3) };
        assert_eq!(medium.transmittance(f32::INFINITY), Vec3::X);
        assert_eq!(medium.transmittance(0.0), Vec3::ONE);
        assert_eq!(Medium::AIR.transmittance(f32::INFINITY), Vec3::ONE);
        assert!((medium.transmittance(2.0).y - (-2.0_f32).exp()).abs() < 1e-7);
    }

    #[test]
    fn a_shading_normal_that_sends_light_through_the_surface_is_not_used() {
        let grazing = Vec3::new(0.995, -0.0999, 0.0).normalize();
        let tilted = Vec3::new(0.2, 1.0, 0.0).normalize();
        assert_eq!(usable_normal(grazing, tilted, Vec3::Y, &Interface::Mirror), Vec3::Y);
        let steep = Vec3::new(0.1, -1.0, 0.0).normalize();
        assert_eq!(usable_normal(steep, tilted, Vec3::Y, &Interface::Mirror), tilted);
    }
}
