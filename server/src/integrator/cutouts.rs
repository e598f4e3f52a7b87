//! Surfaces with holes: what a ray meets once it has passed through them.
//!
//! A hole with a soft edge lets a ray through with a probability. The number that decides is a hash of the ray,
//! the hit and a salt: drawn anew for every ray of a path, and always the same for the chain of a ray tree's
//! pixel, which has no samples and must not flicker.
//! Cost: one more ray per hole passed, and nothing in scenes without cutouts.

use super::PathTracer;
use super::sampler::{Sampler, mixed};
use crate::accel::{Hit, Ray, SurfacePoint};
use crate::scene::{Scene, Surface};

/// Holes in a row after which a ray is stopped: foliage has fewer, a cycle of rounding has no end.
const MAX_PASSED: u32 = 256;

impl PathTracer {
    /// The salt of a ray of a path.
    pub(crate) fn salt(&self, sampler: &mut Sampler) -> u32 {
        if self.has_cutouts { sampler.value().to_bits() } else { 0 }
    }

    /// The first surface along a ray that does not let it through, and its distance.
    pub(crate) fn surface_along(&self, ray: &Ray, salt: u32) -> Option<(SurfacePoint, f32)> {
        let hit = self.accel.closest(ray)?;
        let point = SurfacePoint::at(&self.scene, ray, &hit);
        if self.has_cutouts && lets_through(&self.scene, ray, &hit, &point, salt) {
            return self.surface_beyond(ray, &point, hit.distance, salt);
        }
        Some((point, hit.distance))
    }

    /// Whether light that comes along the ray from `distance` is stopped.
    pub(super) fn is_occluded(&self, ray: &Ray, distance: f32, salt: u32) -> bool {
        if !self.has_cutouts {
            return self.accel.occluded(ray, distance);
        }
        self.surface_along(ray, salt).is_some_and(|(_, met_at)| met_at < distance)
    }

    fn surface_beyond(
        &self,
        ray: &Ray,
        passed: &SurfacePoint,
        passed_at: f32,
        salt: u32,
    ) -> Option<(SurfacePoint, f32)> {
        let mut distance = passed_at;
        let mut rest = passed.leave(ray.direction);
        for _ in 0..MAX_PASSED {
            let hit = self.accel.closest(&rest)?;
            let point = SurfacePoint::at(&self.scene, &rest, &hit);
            distance += hit.distance;
            if !lets_through(&self.scene, &rest, &hit, &point, salt) {
                return Some((point, distance));
            }
            rest = point.leave(ray.direction);
        }
        None
    }
}

/// Whether any surface has holes.
pub(super) fn has_cutouts(scene: &Scene) -> bool {
    scene.materials.iter().any(|material| material.cutout.is_some() || material.surface == Surface::Null)
}

pub(super) fn lets_through(scene: &Scene, ray: &Ray, hit: &Hit, point: &SurfacePoint, salt: u32) -> bool {
    let material = &scene.materials[point.material as usize];
    if material.surface == Surface::Null {
        return true;
    }
    let Some(cutout) = &material.cutout else { return false };
    cutout.passes(&scene.textures, point.uv, || random(ray, hit, salt))
}

/// A number in [0, 1) that the ray, its hit and the salt decide.
fn random(ray: &Ray, hit: &Hit, salt: u32) -> f32 {
    let bits = ray.direction.to_array().into_iter().chain(hit.barycentrics).chain([hit.distance]).map(f32::to_bits);
    let hash = bits.chain([hit.primitive]).fold(u64::from(salt), |hash, bits| mixed(hash ^ u64::from(bits)));
    (hash >> 40) as f32 * (1.0 / (1 << 24) as f32)
}
