//! Where a ray comes from one medium into another, and what a point is inside of.
//!
//! The medium of an eye is found once per pose, by the boundaries between it and the far distance. Surfaces of
//! [`Surface::Null`] and holes are passed; whatever else a ray meets ends it.
//!
//! Limits: bodies are taken to be closed; of one that is open, such as the surface of a sea, a point is inside if
//! two of three rays say so.

use super::PathTracer;
use super::cutouts::lets_through;
use crate::accel::{Ray, SurfacePoint};
use crate::bsdf::Enclosure;
use crate::scene::{Scene, Surface};
use glam::Vec3;

/// Boundaries that a ray may pass before it is stopped: more are a cycle of rounding.
pub(super) const MAX_PASSED: u32 = 4096;

/// A part of a ray that lies within one medium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MediumInterval {
    /// Along the ray, in metres.
    pub start: f32,
    /// May be infinite.
    pub end: f32,
    /// Index in the scene's media.
    pub medium: u32,
}

/// Where a ray through boundaries of media has ended.
pub(crate) struct Passed {
    /// Distance to the first real surface, or as far as was asked for.
    pub(crate) distance: f32,
    /// What the ray is inside of there.
    pub(crate) medium: Enclosure,
    pub(crate) surface: Option<SurfacePoint>,
}

impl PathTracer {
    /// The parts of a ray that lie within media, from an origin inside of `medium` up to the first real surface or
    /// `max_distance`; appended to `intervals`.
    pub(crate) fn media_along(
        &self,
        ray: &Ray,
        medium: Enclosure,
        max_distance: f32,
        intervals: &mut Vec<MediumInterval>,
    ) -> Passed {
        self.pass_media(ray, medium, max_distance, |interval| intervals.push(interval))
    }

    /// The same, giving each part to `on_interval`.
    pub(crate) fn pass_media(
        &self,
        ray: &Ray,
        medium: Enclosure,
        max_distance: f32,
        mut on_interval: impl FnMut(MediumInterval),
    ) -> Passed {
        let (mut rest, mut start, mut medium) = (*ray, 0.0, medium);
        for _ in 0..MAX_PASSED {
            let hit = self.accel.closest(&rest).filter(|hit| start + hit.distance < max_distance);
            let end = hit.map_or(max_distance, |hit| start + hit.distance);
            if let Some(index) = medium.innermost().filter(|_| start < end) {
                on_interval(MediumInterval { start, end, medium: index });
            }
            let Some(hit) = hit else { return Passed { distance: end, medium, surface: None } };
            let point = SurfacePoint::at(&self.scene, &rest, &hit);
            if !lets_through(&self.scene, &rest, &hit, &point, 0) {
                return Passed { distance: end, medium, surface: Some(point) };
            }
            medium = beyond(&self.scene, medium, &point, ray.direction);
            rest = point.leave(ray.direction);
            start = end;
        }
        Passed { distance: start, medium, surface: None }
    }

    /// What a point is inside of, as a ray that starts there needs to know: found once per pose.
    ///
    /// Along a ray to infinity a body that the point is inside of is left once more than it is entered. Three rays
    /// are asked, since one may slip through an edge, and two that agree are believed.
    pub(crate) fn enclosure_at(&self, point: Vec3) -> Enclosure {
        if !self.has_media {
            return Enclosure::AIR;
        }
        // Along no axis and no diagonal, on which meshes have their edges.
        const DIRECTIONS: [Vec3; 3] =
            [Vec3::new(0.267, 0.916, 0.301), Vec3::new(-0.683, 0.311, 0.661), Vec3::new(0.471, -0.293, -0.832)];
        let [a, b, c] =
            DIRECTIONS.map(|direction| self.enclosure_by(Ray { origin: point, direction: direction.normalize() }));
        if b == c { b } else { a }
    }

    fn enclosure_by(&self, mut ray: Ray) -> Enclosure {
        // Bodies that were left before they were entered, the innermost first, and how often others were entered.
        let mut around: Vec<u32> = Vec::new();
        let mut entered: Vec<u32> = Vec::new();
        let mut outside = None;
        for index in 0..MAX_PASSED {
            let Some(hit) = self.accel.closest(&ray) else { break };
            let point = SurfacePoint::at(&self.scene, &ray, &hit);
            let material = &self.scene.materials[point.material as usize];
            if material.bounds_medium() {
                let leaves = ray.direction.dot(point.geometric_normal) > 0.0;
                match (leaves, material.interior) {
                    (true, Some(medium)) => match entered.iter().rposition(|&known| known == medium) {
                        Some(known) => {
                            entered.remove(known);
                        }
                        None => around.push(medium),
                    },
                    (false, Some(medium)) => entered.push(medium),
                    (_, None) => {}
                }
                if index == 0 && !leaves {
                    outside = material.exterior;
                }
            }
            ray = point.leave(ray.direction);
        }
        let outermost = if around.is_empty() { outside } else { None };
        around.into_iter().rev().chain(outermost).fold(Enclosure::AIR, Enclosure::and_medium)
    }
}

/// What is beyond a surface that lets a ray through.
pub(super) fn beyond(scene: &Scene, medium: Enclosure, point: &SurfacePoint, direction: Vec3) -> Enclosure {
    let material = &scene.materials[point.material as usize];
    // A hole in any other surface is none in the body behind it.
    if material.surface != Surface::Null {
        return medium;
    }
    medium.across(material, direction.dot(point.geometric_normal) < 0.0)
}

#[cfg(test)]
mod tests;
