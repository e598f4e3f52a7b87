//! Which surface does a ray meet first? Triangles and analytic spheres in one hierarchy.
//!
//! Second stage of the server, after the scene: the integrator asks, this answers. Primitive ids count the
//! triangles of the mesh first, then the spheres.
//!
//! Method: a binary tree by the surface area heuristic (`build`), made into nodes of eight boxes and blocks
//! of eight triangles (`hierarchy`), walked with eight numbers at once (`traverse`) in whatever vector
//! instructions the machine has (`lanes`, `x86`). The triangle test is watertight (`triangle`), and boxes
//! are as much wider as rounding calls for (`hierarchy`), so a ray between two triangles that touch slips past
//! neither them nor their boxes. [`brute`] is the same query without a hierarchy, the oracle of the tests:
//! the answer is the same bits with each kind of instructions and without a hierarchy.
//!
//! Shapes that move are a hierarchy of their own, so that [`Accel::moved`] rebuilds only that.
//!
//! Limits: 2^30 blocks of triangles. Rays may start anywhere. Cost: 30 to 60 ns for a ray in a room, 120 to 300 ns in a
//! million triangles, on one core; plain code takes up to twice that.

pub mod brute;
mod build;
mod curvature;
mod hierarchy;
mod kernel;
mod lanes;
mod shape;
mod sphere;
mod stack;
mod surface;
#[cfg(test)]
mod tests;
mod traverse;
mod triangle;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use surface::SurfacePoint;

use crate::scene::Scene;
use glam::Vec3;
use hierarchy::Hierarchy;
use kernel::Kernel;
use shape::Shape;
use std::sync::Arc;
use traverse::Nearest;

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

/// The hierarchies over all shapes of a scene.
#[derive(Clone, Debug)]
pub struct Accel {
    still: Arc<Hierarchy>,
    moving: Option<Arc<Hierarchy>>,
    kernel: Kernel,
}

impl Accel {
    /// Builds the hierarchy of a scene in which nothing moves.
    pub fn new(scene: &Scene) -> Accel {
        Accel::with_moving(scene, &[])
    }

    /// Builds the hierarchies of a scene whose shapes move where `moving` says so, by primitive id; those
    /// beyond its end stand still.
    pub fn with_moving(scene: &Scene, moving: &[bool]) -> Accel {
        let shapes: Vec<Shape> = Shape::all(scene).collect();
        let moves = |primitive: usize| moving.get(primitive).copied().unwrap_or(false);
        let still = Hierarchy::new(&shapes, |primitive| !moves(primitive));
        let moving = moving.contains(&true).then(|| Arc::new(Hierarchy::new(&shapes, moves)));
        Accel { still: Arc::new(still), moving, kernel: Kernel::detected() }
    }

    /// The same for a scene in which the shapes that move have done so. What stands still is shared.
    pub fn moved(&self, scene: &Scene, moving: &[bool]) -> Accel {
        let shapes: Vec<Shape> = Shape::all(scene).collect();
        let moves = |primitive: usize| moving.get(primitive).copied().unwrap_or(false);
        Accel { moving: Some(Arc::new(Hierarchy::new(&shapes, moves))), ..self.clone() }
    }

    /// The same, once for each kind of vector instructions that this machine has, the fastest first: for tests
    /// and benches.
    pub fn by_instructions(&self) -> impl Iterator<Item = Accel> {
        Kernel::all().map(|kernel| Accel { kernel, ..self.clone() })
    }

    /// The vector instructions that it is walked with.
    pub fn instructions(&self) -> &'static str {
        self.kernel.name()
    }

    /// The first surface along the ray; of two at the same distance the one of lower id.
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        let mut nearest = Nearest::NONE;
        self.kernel.closest(&self.still, ray, &mut nearest);
        if let Some(moving) = &self.moving {
            self.kernel.closest(moving, ray, &mut nearest);
        }
        nearest.hit.map(|(primitive, on_triangle)| Hit {
            distance: nearest.distance,
            primitive,
            barycentrics: on_triangle.map_or([0.0; 2], |hit| hit.barycentrics()),
        })
    }

    /// Whether any surface lies nearer than `max_distance` along the ray.
    pub fn occluded(&self, ray: &Ray, max_distance: f32) -> bool {
        self.kernel.occluded(&self.still, ray, max_distance)
            || self.moving.as_ref().is_some_and(|moving| self.kernel.occluded(moving, ray, max_distance))
    }
}
