//! Which surface does a ray meet first? Triangles and analytic spheres in one hierarchy.
//!
//! Second stage of the server, after the scene: the integrator asks, this answers. Primitive ids count the
//! triangles of the mesh first, then the spheres.
//!
//! Method: the hierarchy is the crate obvhs's: PLOC with reinsertion, then compressed 8-wide nodes (Ylitie et
//! al. 2017). The primitive tests are ours, watertight for triangles. Boxes are padded by what rounding in
//! the box test can lose, so a ray between two triangles that touch does not slip past their boxes either.
//! [`brute`] is the same query without a hierarchy, the oracle of the tests.
//!
//! Limits: rays must start within the reach of the scene (or a few times it): the padding is relative to the
//! scene's largest coordinate. Cost: 7 to 8 million incoherent rays a second on a core, from 84 to 320,000
//! triangles; obvhs's 2-wide nodes trace 20 to 45 % less.

pub mod brute;
mod sphere;
mod surface;
#[cfg(test)]
mod tests;
mod triangle;

pub use surface::SurfacePoint;

use crate::scene::Scene;
use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh;
use obvhs::ray::RayHit;
use sphere::hit_sphere;
use std::time::Duration;
use triangle::ShearedRay;

/// A half-line in world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts.
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
}

impl Ray {
    /// The point at `distance`.
    pub fn at(&self, distance: f32) -> Vec3 {
        self.origin + distance * self.direction
    }
}

/// The first surface along a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in metres.
    pub distance: f32,
    /// Triangles first, then spheres.
    pub primitive: u32,
    /// Weights of the second and third vertex of a triangle; zero for a sphere.
    pub barycentrics: [f32; 2],
}

/// A shape, with all that its intersection needs, in the order of the hierarchy's leaves.
#[derive(Clone, Copy, Debug)]
enum Shape {
    Triangle([[f32; 3]; 3]),
    Sphere { centre: Vec3, radius: f32 },
}

impl Shape {
    /// The shapes of a scene, by primitive id.
    fn all(scene: &Scene) -> Vec<Shape> {
        let positions = &scene.mesh.positions;
        let triangles = scene.mesh.triangles.iter();
        let triangles =
            triangles.map(|corners| Shape::Triangle(corners.map(|corner| positions[corner as usize].to_array())));
        let spheres = scene.spheres.iter();
        triangles.chain(spheres.map(|sphere| Shape::Sphere { centre: sphere.centre, radius: sphere.radius })).collect()
    }

    fn bounds(&self) -> (Vec3, Vec3) {
        match *self {
            Shape::Triangle([a, b, c]) => {
                let [a, b, c] = [Vec3::from(a), Vec3::from(b), Vec3::from(c)];
                (a.min(b).min(c), a.max(b).max(c))
            }
            Shape::Sphere { centre, radius } => (centre - radius, centre + radius),
        }
    }

    /// Distance and barycentrics of the first hit nearer than `max_distance`.
    #[inline]
    fn hit(&self, ray: &Ray, sheared: &ShearedRay, max_distance: f32) -> Option<(f32, [f32; 2])> {
        match self {
            Shape::Triangle(vertices) => {
                sheared.hit(vertices, max_distance).map(|hit| (hit.distance, hit.barycentrics))
            }
            Shape::Sphere { centre, radius } => hit_sphere(ray.origin, ray.direction, *centre, *radius, max_distance)
                .map(|distance| (distance, [0.0; 2])),
        }
    }
}

/// The hierarchy over all shapes of a scene.
pub struct Accel {
    hierarchy: CwBvh,
    /// Scale of the hierarchy's space: the scene's reach becomes 1 to 2 there.
    hierarchy_from_world: f32,
    /// In the order of the leaves, for locality.
    shapes: Vec<Shape>,
    /// Primitive id of each shape.
    primitives: Vec<u32>,
}

/// Padding of boxes relative to the scene's largest coordinate: three roundings of half an epsilon each in
/// the slab test, and one in the padding itself. Less leaks between boxes, more costs traversal steps.
const BOX_PADDING: f32 = 4.0 * f32::EPSILON;

/// Units of distance of the traversal per unit of the hierarchy's space. The traversal passes over boxes
/// nearer than 1e-4 of its units (a constant in obvhs); so that becomes 1e-16 of the scene's reach, less than
/// any rounding.
const TRAVERSAL_UNITS: f32 = 1e12;

/// Shapes per leaf, the most that the nodes hold: measured fastest.
const LEAF_SHAPES: u32 = 3;

impl Accel {
    /// Builds the hierarchy.
    pub fn new(scene: &Scene) -> Accel {
        let shapes = Shape::all(scene);
        if shapes.is_empty() {
            return Accel { hierarchy: CwBvh::default(), hierarchy_from_world: 1.0, shapes, primitives: Vec::new() };
        }
        let bounds: Vec<(Vec3, Vec3)> = shapes.iter().map(Shape::bounds).collect();
        let reach = bounds.iter().fold(0.0_f32, |reach, (min, max)| reach.max(min.abs().max(max.abs()).max_element()));
        // A power of two, so that scaling rounds nothing; obvhs has absolute tolerances that suit this space.
        let hierarchy_from_world = (-reach.max(f32::MIN_POSITIVE).log2().floor()).clamp(-60.0, 60.0).exp2();
        let padding = reach * BOX_PADDING;
        let to_hierarchy = |point: Vec3| Vec3A::from(point * hierarchy_from_world);
        let boxes: Vec<Aabb> = bounds
            .iter()
            .map(|&(min, max)| Aabb::new(to_hierarchy(min - padding), to_hierarchy(max + padding)))
            .collect();
        let params = BvhBuildParams { max_prims_per_leaf: LEAF_SHAPES, ..BvhBuildParams::slow_build() };
        let hierarchy = build_cwbvh(&boxes, params, &mut Duration::default());
        let primitives = hierarchy.primitive_indices.clone();
        let shapes = primitives.iter().map(|&primitive| shapes[primitive as usize]).collect();
        Accel { hierarchy, hierarchy_from_world, shapes, primitives }
    }

    /// The first surface along the ray.
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        let sheared = ShearedRay::new(ray.origin, ray.direction);
        let mut closest = None;
        let mut nearest = f32::INFINITY;
        self.hierarchy.ray_traverse(self.traversal_ray(ray, f32::INFINITY), &mut RayHit::none(), |_, index| {
            let Some((distance, barycentrics)) = self.shapes[index].hit(ray, &sheared, nearest) else {
                return f32::INFINITY;
            };
            nearest = distance;
            closest = Some(Hit { distance, primitive: self.primitives[index], barycentrics });
            distance * self.traversal_units_per_m()
        });
        closest
    }

    /// Whether any surface lies nearer than `max_distance` along the ray.
    pub fn occluded(&self, ray: &Ray, max_distance: f32) -> bool {
        let sheared = ShearedRay::new(ray.origin, ray.direction);
        !self.hierarchy.ray_traverse_miss(self.traversal_ray(ray, max_distance), |_, index| {
            // Any hit is nearer than the end of the ray: the traversal only wants to know that there is one.
            self.shapes[index].hit(ray, &sheared, max_distance).map_or(f32::INFINITY, |_| 0.0)
        })
    }

    /// The ray in the hierarchy's space, with distances in the units of the traversal. Inverse components
    /// stay finite, so that a ray within a slab's plane gives 0 there and not `0 * inf`; -0 counts as
    /// positive, as it does in obvhs.
    fn traversal_ray(&self, ray: &Ray, max_distance: f32) -> obvhs::ray::Ray {
        const SMALLEST: f32 = 1e-18;
        let inverse = |d: f32| {
            let away_from_zero = if d < 0.0 { d.min(-SMALLEST) } else { d.max(SMALLEST) };
            TRAVERSAL_UNITS / away_from_zero
        };
        obvhs::ray::Ray {
            origin: (ray.origin * self.hierarchy_from_world).into(),
            direction: ray.direction.into(),
            inv_direction: ray.direction.to_array().map(inverse).into(),
            tmin: 0.0,
            tmax: max_distance * self.traversal_units_per_m(),
        }
    }

    fn traversal_units_per_m(&self) -> f32 {
        self.hierarchy_from_world * TRAVERSAL_UNITS
    }
}

impl std::fmt::Debug for Accel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Accel").field("shapes", &self.shapes.len()).finish_non_exhaustive()
    }
}
