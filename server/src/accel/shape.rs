//! What a ray can meet, by primitive id: the triangles of the mesh first, then the spheres.

use super::Ray;
use super::sphere::hit_sphere;
use super::triangle::ShearedRay;
use crate::scene::Scene;
use glam::Vec3;

/// A shape, with all that its intersection needs.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    Triangle([[f32; 3]; 3]),
    Sphere { centre: Vec3, radius: f32 },
}

impl Shape {
    /// The shapes of a scene, by primitive id.
    pub(super) fn all(scene: &Scene) -> impl Iterator<Item = Shape> + '_ {
        let positions = &scene.mesh.positions;
        let triangles = scene.mesh.triangles.iter();
        let triangles = triangles.map(|corners| Shape::Triangle(corners.map(|c| positions[c as usize].to_array())));
        let spheres = scene.spheres.iter();
        triangles.chain(spheres.map(|sphere| Shape::Sphere { centre: sphere.centre, radius: sphere.radius }))
    }

    /// Whether some ray can hit it: not a triangle two of whose vertices are one, whose determinant is 0 for
    /// every ray, and not what is no number or infinite.
    pub(super) fn can_be_hit(&self) -> bool {
        match self {
            Shape::Triangle([a, b, c]) => {
                [a, b, c].into_iter().flatten().all(|x| x.is_finite()) && a != b && b != c && c != a
            }
            Shape::Sphere { centre, radius } => centre.is_finite() && radius.is_finite() && *radius > 0.0,
        }
    }

    /// The box that holds every point at which its intersection test can find a hit; how much wider than the
    /// shape it must be is derived in `hierarchy`.
    pub(super) fn bounds(&self) -> (Vec3, Vec3) {
        /// In units of the largest side: the 7.01 roundings of half an epsilon that shearing can lose, twice.
        const PADDING: f32 = 8.0 * f32::EPSILON;
        /// Metres. Keeps boxes open along axes in which shape and ray are flat: see `traverse::Slabs`.
        const LEAST_PADDING: f32 = 1e-28;
        let (low, high) = match *self {
            Shape::Triangle([a, b, c]) => {
                let [a, b, c] = [Vec3::from(a), Vec3::from(b), Vec3::from(c)];
                (a.min(b).min(c), a.max(b).max(c))
            }
            Shape::Sphere { centre, radius } => (centre - radius, centre + radius),
        };
        let padding = PADDING * (high - low).max_element() + LEAST_PADDING;
        // Rounding in the sums above and below is less than one step of the result.
        ((low - padding).map(f32::next_down), (high + padding).map(f32::next_up))
    }

    /// Distance and barycentrics of the first hit nearer than `max_distance`.
    #[inline]
    pub(super) fn hit(&self, ray: &Ray, sheared: &ShearedRay, max_distance: f32) -> Option<(f32, [f32; 2])> {
        match self {
            Shape::Triangle(vertices) => sheared
                .hit(vertices)
                .filter(|hit| hit.distance < max_distance)
                .map(|hit| (hit.distance, hit.barycentrics())),
            Shape::Sphere { centre, radius } => hit_sphere(ray.origin, ray.direction, *centre, *radius)
                .filter(|&distance| distance < max_distance)
                .map(|distance| (distance, [0.0; 2])),
        }
    }
}
