//! Where the media are that a ray of view may meet, and so between which depths all layers of a frame are.

use crate::scene::{Scene, Surface};
use glam::{BVec3, DVec3, Vec3};
use warplight_protocol::Pose;
use warplight_protocol::frame::VolumeRange;

/// A box in world for each medium.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MediaBounds {
    boxes: Vec<(DVec3, DVec3)>,
}

impl MediaBounds {
    /// Of the media of a scene that have boundaries which let rays of view through unchanged.
    pub fn of(scene: &Scene) -> MediaBounds {
        let boxes = (0..scene.media.len() as u32).filter_map(|medium| bounds_of(scene, medium));
        MediaBounds {
            boxes: boxes.map(|(low, high)| (scene.origin + low.as_dvec3(), scene.origin + high.as_dvec3())).collect(),
        }
    }

    /// Whether there are none: frames of such a scene have no layers.
    pub fn is_empty(&self) -> bool {
        self.boxes.is_empty()
    }

    /// The middle of the box around all of them; zero if there are none.
    pub fn middle(&self) -> DVec3 {
        let around = self
            .boxes
            .iter()
            .copied()
            .reduce(|(low, high), (other_low, other_high)| (low.min(other_low), high.max(other_high)));
        around.map_or(DVec3::ZERO, |(low, high)| 0.5 * (low + high))
    }

    /// Depths in view between which all of them are, seen from a pose. Where nothing is before the eye, some range.
    pub fn range(&self, pose: &Pose) -> VolumeRange {
        let (near, far) = self.depths(pose);
        // A little more, for what is rounded on the way from the grid of a medium to the eye.
        let slack = 1e-5 * (near.abs() + far.abs());
        let range = VolumeRange { near_m: (near - slack).max(0.0) as f32, far_m: (far + slack) as f32 };
        if range.is_valid() { range } else { VolumeRange { near_m: 0.0, far_m: 1.0 } }
    }

    fn depths(&self, pose: &Pose) -> (f64, f64) {
        let forward = pose.orientation * DVec3::NEG_Z;
        let corners = self.boxes.iter().flat_map(|&(low, high)| {
            (0..8).map(move |bits| DVec3::select(BVec3::new(bits & 1 > 0, bits & 2 > 0, bits & 4 > 0), high, low))
        });
        corners
            .map(|corner| (corner - pose.position).dot(forward))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(near, far), depth| (near.min(depth), far.max(depth)))
    }
}

/// The box around what a ray of view may see of a medium, counted from the scene's origin; `None` where there is none, as for
/// what is inside of glass.
pub(super) fn bounds_of(scene: &Scene, medium: u32) -> Option<(Vec3, Vec3)> {
    let bounds = |material: u32| {
        let material = &scene.materials[material as usize];
        material.surface == Surface::Null && material.interior == Some(medium)
    };
    let mut points: Option<(Vec3, Vec3)> = None;
    let mut include = |point: Vec3| {
        let (low, high) = points.unwrap_or((point, point));
        points = Some((low.min(point), high.max(point)));
    };
    let triangles = scene.mesh.triangles.iter().zip(&scene.mesh.materials).filter(|(_, material)| bounds(**material));
    triangles.flat_map(|(triangle, _)| triangle).for_each(|&vertex| include(scene.mesh.positions[vertex as usize]));
    for sphere in scene.spheres.iter().filter(|sphere| bounds(sphere.material)) {
        include(sphere.centre - sphere.radius);
        include(sphere.centre + sphere.radius);
    }
    points
}
