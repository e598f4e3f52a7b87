//! How the normal of a surface turns along it, exactly: what a frame's shape operators are made of.
//!
//! A sphere's outward normal turns by `1/r` in every direction. Over a triangle the normal is interpolated between its
//! vertices, `n = N / |N|`, and its derivative is that of ray differentials (Igehy 1999, equations 14 to 16 without
//! the ray): N is linear in the barycentrics, these are linear in the position, and the derivative of a normalised
//! vector is `(dN - n (n . dN)) / |N|`. A flat triangle has none.
//!
//! A step is taken along the tangent plane of the interpolated normal and followed to the triangle's own plane along that
//! normal, as the quadric of the client does.
//!
//! Limits: normal maps are ignored, only the surface below them counts. So are edges: at one between flat triangles the
//! normal jumps, and no derivative says so. Cost: 100 flops, where it is asked for.

use super::SurfacePoint;
use crate::scene::Scene;
use glam::{DMat3, DVec3, Mat3, Vec3};

/// Least cosine between the interpolated and the geometric normal at which a step can be followed from one plane to
/// the other; below it the mesh is no picture of a smooth surface.
const LEAST_COSINE: f64 = 0.1;

impl SurfacePoint {
    /// The derivative of the interpolated normal on the outside: `gradient * x` is how it turns for a step x along the
    /// surface, in world and per metre. Finite; zero where the surface is flat.
    pub fn normal_gradient(&self, scene: &Scene) -> Mat3 {
        let gradient = match (self.primitive as usize).checked_sub(scene.mesh.triangles.len()) {
            Some(sphere) => {
                let outward = self.geometric_normal.as_dvec3();
                across(outward) * (1.0 / f64::from(scene.spheres[sphere].radius))
            }
            None => self.gradient_on_triangle(scene).unwrap_or(DMat3::ZERO),
        };
        let gradient = gradient.as_mat3();
        if gradient.is_finite() { gradient } else { Mat3::ZERO }
    }

    fn gradient_on_triangle(&self, scene: &Scene) -> Option<DMat3> {
        let mesh = &scene.mesh;
        let corners = mesh.triangles[self.primitive as usize].map(|corner| corner as usize);
        let normals = corners.map(|corner| mesh.normals.get(corner).copied().unwrap_or(Vec3::ZERO));
        let [na, nb, nc] = normals;
        if na == nb && nb == nc {
            return None;
        }
        let [na, nb, nc] = normals.map(|normal| normal.as_dvec3());
        let [a, b, c] = corners.map(|corner| mesh.positions[corner].as_dvec3());
        // f64: a triangle of a millimetre has an area whose square f32 does not hold.
        let (ab, ac, at) = (b - a, c - a, self.position.as_dvec3() - a);
        let area = ab.cross(ac);
        let over = 1.0 / area.length_squared();
        // Weights of the second and the third corner, and how they change along the triangle.
        let (along_v, along_w) = (ac.cross(area) * over, area.cross(ab) * over);
        let (v, w) = (along_v.dot(at), along_w.dot(at));
        let sum = (1.0 - v - w) * na + v * nb + w * nc;
        let normal = sum.try_normalize()?;
        // Followed from the tangent plane to the triangle's.
        let cosine = area.dot(normal);
        let is_usable = cosine.abs() > LEAST_COSINE * area.length();
        let follow = |along: DVec3| if is_usable { along - area * (along.dot(normal) / cosine) } else { along };
        let of_sum = outer(nb - na, follow(along_v)) + outer(nc - na, follow(along_w));
        let outside = if normal.dot(self.geometric_normal.as_dvec3()) < 0.0 { -1.0 } else { 1.0 };
        Some(across(normal) * of_sum * (outside / sum.length()))
    }
}

/// The projection to the plane across a unit vector.
fn across(normal: DVec3) -> DMat3 {
    DMat3::IDENTITY - outer(normal, normal)
}

/// The matrix that takes x to `to (along . x)`.
fn outer(to: DVec3, along: DVec3) -> DMat3 {
    DMat3::from_cols(to * along.x, to * along.y, to * along.z)
}

#[cfg(test)]
mod tests;
