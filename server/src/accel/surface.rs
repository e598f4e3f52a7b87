//! The surface at a hit: position, normals, texture coordinates, material; and how a ray leaves it.
//!
//! Self-intersection: a position is computed from the primitive and not along the ray, so its error is a few
//! roundings of the primitive's largest coordinate; rays start that far above the surface, on the side they
//! leave to (the reasoning of Wächter and Binder 2019, "A Fast and Robust Method for Avoiding
//! Self-Intersection", with the bound taken from the primitive instead of the position, so that it also holds
//! for a large triangle near the origin).

use super::{Hit, Ray};
use crate::scene::Scene;
use glam::{Vec2, Vec3};

/// Start of a ray above its surface, relative to the primitive's largest coordinate: a few roundings in the
/// position and in the intersection. Less gives acne, more light leaks through thin walls: 5 um at 10 m.
const OFFSET: f32 = 4.0 * f32::EPSILON;

/// A point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// In world, in metres.
    pub position: Vec3,
    /// Unit normal of the surface, to its outside.
    pub geometric_normal: Vec3,
    /// Unit normal for shading, interpolated between vertices, on the same side.
    pub shading_normal: Vec3,
    /// Texture coordinates.
    pub uv: Vec2,
    /// Index of the material.
    pub material: u32,
    /// Primitive id.
    pub primitive: u32,
    /// How far above the surface rays start, in metres.
    pub offset_m: f32,
}

impl SurfacePoint {
    /// The surface at a hit.
    pub fn at(scene: &Scene, ray: &Ray, hit: &Hit) -> SurfacePoint {
        let triangles = scene.mesh.triangles.len();
        match (hit.primitive as usize).checked_sub(triangles) {
            None => SurfacePoint::on_triangle(scene, hit.primitive, hit.barycentrics),
            Some(sphere) => {
                let outward = ray.at(hit.distance) - scene.spheres[sphere].centre;
                SurfacePoint::on_sphere(scene, hit.primitive, outward.normalize_or(-ray.direction))
            }
        }
    }

    /// The point of a triangle with these weights of its second and third vertex.
    pub fn on_triangle(scene: &Scene, primitive: u32, barycentrics: [f32; 2]) -> SurfacePoint {
        let mesh = &scene.mesh;
        let corners = mesh.triangles[primitive as usize].map(|corner| corner as usize);
        let [a, b, c] = corners.map(|corner| mesh.positions[corner]);
        let [v, w] = barycentrics;
        let u = 1.0 - v - w;
        let geometric_normal = (b - a).cross(c - a).normalize_or(Vec3::Y);
        let [na, nb, nc] = corners.map(|corner| mesh.normals.get(corner).copied().unwrap_or(Vec3::ZERO));
        let shading_normal = (u * na + v * nb + w * nc).normalize_or(geometric_normal);
        let [ta, tb, tc] = corners.map(|corner| mesh.uvs.get(corner).copied().unwrap_or(Vec2::ZERO));
        SurfacePoint {
            position: u * a + v * b + w * c,
            geometric_normal,
            shading_normal: if shading_normal.dot(geometric_normal) < 0.0 { -shading_normal } else { shading_normal },
            uv: u * ta + v * tb + w * tc,
            material: mesh.materials[primitive as usize],
            primitive,
            offset_m: OFFSET * a.abs().max(b.abs()).max(c.abs()).max_element(),
        }
    }

    /// The point of a sphere whose outward normal is `normal`.
    pub fn on_sphere(scene: &Scene, primitive: u32, normal: Vec3) -> SurfacePoint {
        let sphere = &scene.spheres[primitive as usize - scene.mesh.triangles.len()];
        // As a globe: u runs once around from -Z, v from the north pole down.
        let u = 0.5 + normal.x.atan2(-normal.z) / std::f32::consts::TAU;
        let v = normal.y.clamp(-1.0, 1.0).acos() / std::f32::consts::PI;
        SurfacePoint {
            position: sphere.centre + sphere.radius * normal,
            geometric_normal: normal,
            shading_normal: normal,
            uv: Vec2::new(u, v),
            material: sphere.material,
            primitive,
            offset_m: OFFSET * (sphere.centre.abs().max_element() + sphere.radius),
        }
    }

    /// The start of a ray that leaves to the side of `direction`.
    pub fn offset_towards(&self, direction: Vec3) -> Vec3 {
        let side = self.offset_m.copysign(self.geometric_normal.dot(direction));
        self.position + side * self.geometric_normal
    }

    /// The ray that leaves in this unit direction.
    pub fn leave(&self, direction: Vec3) -> Ray {
        Ray { origin: self.offset_towards(direction), direction }
    }
}
