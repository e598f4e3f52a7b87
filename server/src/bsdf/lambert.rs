//! Lambert reflection: equal radiance to all sides, directions drawn by the cosine.
//!
//! Most surfaces of most scenes are nothing else: [`Lambert`] is what the integrator asks then, without making a
//! whole [`super::Bsdf`].

use super::lobes::{Evaluated, Scatters};
use super::{Enclosure, LobeSample};
use crate::accel::SurfacePoint;
use crate::scene::{Scene, Surface};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, TAU};

/// Two unit vectors that make a right-handed frame with the unit vector `normal`.
pub(crate) fn tangents(normal: Vec3) -> (Vec3, Vec3) {
    warplight_protocol::curvature::tangents(normal).into()
}

/// A direction about `normal` with the density cos / pi (Malley's method).
pub(crate) fn sample_cosine(normal: Vec3, u: Vec2) -> Vec3 {
    let (tangent, bitangent) = tangents(normal);
    let radius = u.x.sqrt();
    let (sine, cosine) = (TAU * u.y).sin_cos();
    let along = (1.0 - u.x).max(0.0).sqrt();
    (radius * cosine * tangent + radius * sine * bitangent + along * normal).normalize_or(normal)
}

/// Density of [`sample_cosine`] over solid angle.
pub(crate) fn pdf_cosine(normal: Vec3, direction: Vec3) -> f32 {
    normal.dot(direction).max(0.0) * FRAC_1_PI
}

/// A surface that does nothing but Lambert reflection, as one ray sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lambert {
    albedo: Vec3,
    /// On the side that the ray met.
    normal: Vec3,
    geometric_normal: Vec3,
    medium: Enclosure,
}

impl Lambert {
    /// At a point that a ray in `direction` through `medium` has met.
    pub(crate) fn new(point: &SurfacePoint, direction: Vec3, medium: Enclosure, albedo: Vec3) -> Lambert {
        let side = if direction.dot(point.geometric_normal) < 0.0 { 1.0 } else { -1.0 };
        let (normal, geometric_normal) = (side * point.shading_normal, side * point.geometric_normal);
        Lambert { albedo, normal, geometric_normal, medium }
    }

    /// The surface at `point`, if that is all it is.
    pub(crate) fn at(scene: &Scene, point: &SurfacePoint, direction: Vec3, medium: Enclosure) -> Option<Lambert> {
        let material = &scene.materials[point.material as usize];
        let Surface::Diffuse { albedo } = &material.surface else { return None };
        let is_seen = !material.one_sided || direction.dot(point.geometric_normal) < 0.0;
        is_seen.then(|| Lambert::new(point, direction, medium, albedo.at(&scene.textures, point.uv)))
    }

    /// What it makes of irradiance over pi.
    pub(crate) fn albedo(&self) -> Vec3 {
        self.albedo
    }

    /// Whether it reflects nothing.
    pub(crate) fn is_black(&self) -> bool {
        self.albedo == Vec3::ZERO
    }
}

impl Scatters for Lambert {
    fn evaluate(&self, towards: Vec3) -> Evaluated {
        let pdf = pdf_cosine(self.normal, towards);
        let is_above = towards.dot(self.geometric_normal) > 0.0;
        Evaluated { value: if is_above { self.albedo * pdf } else { Vec3::ZERO }, pdf }
    }

    fn sample(&self, _choice: f32, u: Vec2) -> Option<LobeSample> {
        let direction = sample_cosine(self.normal, u);
        let pdf = pdf_cosine(self.normal, direction);
        let is_above = direction.dot(self.geometric_normal) > 0.0 && pdf > 0.0;
        is_above.then_some(LobeSample { direction, weight: self.albedo, pdf, medium: self.medium, eta2: 1.0 })
    }

    fn is_glossy(&self) -> bool {
        false
    }

    fn medium_towards(&self, _towards: Vec3) -> Enclosure {
        self.medium
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::sampler::Sampler;

    #[test]
    fn frames_are_orthonormal_for_every_normal() {
        let mut sampler = Sampler::new(1, 2, 3);
        let mut normals = vec![Vec3::Z, -Vec3::Z, Vec3::new(1e-20, 0.0, -1.0), Vec3::new(0.0, 1e-4, -1.0).normalize()];
        normals.extend((0..1000).map(|_| Vec3::from([0; 3].map(|_| sampler.value() - 0.5)).normalize_or(Vec3::X)));
        for normal in normals {
            let (tangent, bitangent) = tangents(normal);
            for (a, b) in [(tangent, bitangent), (tangent, normal), (bitangent, normal)] {
                assert!(a.dot(b).abs() < 1e-6, "{normal}");
            }
            assert!((tangent.length() - 1.0).abs() < 1e-6 && (bitangent.length() - 1.0).abs() < 1e-6);
        }
    }

    /// A chi-square test of the sampler against its own density.
    #[test]
    fn directions_follow_their_density() {
        const CELLS: usize = 32;
        let normal = Vec3::new(0.3, -0.5, 0.8).normalize();
        let (tangent, bitangent) = tangents(normal);
        let mut counts = [[0_u32; CELLS]; CELLS];
        let samples = 200_000;
        for index in 0..samples {
            // Streams differ, so that samples are independent and not stratified.
            let direction = sample_cosine(normal, Sampler::new(5, index, 0).pair());
            let sine2 = 1.0 - direction.dot(normal).powi(2);
            let azimuth = direction.dot(bitangent).atan2(direction.dot(tangent)) / TAU + 0.5;
            let cell = |x: f32| ((x * CELLS as f32) as usize).min(CELLS - 1);
            // The sine squared of a cosine-distributed direction is uniform.
            counts[cell(sine2)][cell(azimuth)] += 1;
        }
        let expected = samples as f64 / (CELLS * CELLS) as f64;
        let chi2: f64 = counts.iter().flatten().map(|&count| (f64::from(count) - expected).powi(2) / expected).sum();
        let freedom = (CELLS * CELLS - 1) as f64;
        assert!((chi2 - freedom).abs() < 4.0 * (2.0 * freedom).sqrt(), "chi-square {chi2} for {freedom}");
    }
}
