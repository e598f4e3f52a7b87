//! The plain intersector: every shape, one after the other. The oracle that the hierarchy is tested against.

use super::shape::Shape;
use super::triangle::ShearedRay;
use super::{Hit, Ray};
use crate::scene::Scene;

/// All shapes of a scene, without a hierarchy.
#[derive(Debug)]
pub struct BruteForce {
    shapes: Vec<Shape>,
}

impl BruteForce {
    /// Takes the shapes of a scene.
    pub fn new(scene: &Scene) -> BruteForce {
        BruteForce { shapes: Shape::all(scene).collect() }
    }

    /// The first surface along the ray; of two at the same distance the one of lower id.
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        let sheared = ShearedRay::new(ray.origin, ray.direction);
        let mut closest: Option<Hit> = None;
        for (primitive, shape) in (0..).zip(&self.shapes) {
            let nearest = closest.map_or(f32::INFINITY, |hit| hit.distance);
            if let Some((distance, barycentrics)) = shape.hit(ray, &sheared, nearest) {
                closest = Some(Hit { distance, primitive, barycentrics });
            }
        }
        closest
    }

    /// Whether any surface lies nearer than `max_distance` along the ray.
    pub fn occluded(&self, ray: &Ray, max_distance: f32) -> bool {
        let sheared = ShearedRay::new(ray.origin, ray.direction);
        self.shapes.iter().any(|shape| shape.hit(ray, &sheared, max_distance).is_some())
    }
}
