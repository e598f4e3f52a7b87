//! Ray against triangle, watertight.
//!
//! Method: Woop, Benthin and Wald 2013, "Watertight Ray/Triangle Intersection" (JCGT 2(1)). The triangle is
//! sheared so that the ray runs along an axis; then three two-dimensional edge functions decide, whose signs
//! are exact (f64 where f32 gives zero), so a ray never slips between two triangles that share an edge or
//! a vertex. Both sides are hit. Limits: vertices must be finite. Cost: about 40 flops per triangle, and one
//! division per ray.

use glam::Vec3;

/// What the test needs of a ray, found once per ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShearedRay {
    origin: [f32; 3],
    /// Axes of the permuted space; the ray's largest component lies along `axes[2]`.
    axes: [usize; 3],
    shear: [f32; 3],
}

/// Where a triangle was hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TriangleHit {
    /// Distance along the ray in units of its direction's length.
    pub(super) distance: f32,
    /// Weights of the second and third vertex.
    pub(super) barycentrics: [f32; 2],
}

impl ShearedRay {
    pub(super) fn new(origin: Vec3, direction: Vec3) -> ShearedRay {
        let direction = direction.to_array();
        let length = direction.map(f32::abs);
        let z = if length[0] > length[1] && length[0] > length[2] {
            0
        } else if length[1] > length[2] {
            1
        } else {
            2
        };
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let scale = 1.0 / direction[z];
        ShearedRay {
            origin: origin.to_array(),
            axes: [x, y, z],
            shear: [direction[x] * scale, direction[y] * scale, scale],
        }
    }

    /// The vertex as seen along the ray: two coordinates across it, one along it.
    fn sheared(&self, vertex: &[f32; 3]) -> [f32; 3] {
        let [x, y, z] = self.axes;
        let along = vertex[z] - self.origin[z];
        let across = |axis: usize, shear: f32| (vertex[axis] - self.origin[axis]) - shear * along;
        [across(x, self.shear[0]), across(y, self.shear[1]), self.shear[2] * along]
    }

    /// The hit of the triangle at a distance above 0 and below `max_distance`.
    pub(super) fn hit(&self, vertices: &[[f32; 3]; 3], max_distance: f32) -> Option<TriangleHit> {
        let [a, b, c] = [self.sheared(&vertices[0]), self.sheared(&vertices[1]), self.sheared(&vertices[2])];
        let mut edges = [edge(&c, &b), edge(&a, &c), edge(&b, &a)];
        if edges.contains(&0.0) {
            // On an edge to f32: decide in f64, where the products of two f32 are exact.
            edges = [edge_f64(&c, &b), edge_f64(&a, &c), edge_f64(&b, &a)];
        }
        let [u, v, w] = edges;
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let determinant = u + v + w;
        let distance = (u * a[2] + v * b[2] + w * c[2]) / determinant;
        // Also refuses a triangle seen edge-on: its determinant is 0 and the distance no number.
        (distance > 0.0 && distance < max_distance)
            .then(|| TriangleHit { distance, barycentrics: [v / determinant, w / determinant] })
    }
}

fn edge(p: &[f32; 3], q: &[f32; 3]) -> f32 {
    p[0] * q[1] - p[1] * q[0]
}

fn edge_f64(p: &[f32; 3], q: &[f32; 3]) -> f32 {
    (f64::from(p[0]) * f64::from(q[1]) - f64::from(p[1]) * f64::from(q[0])) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn barycentrics_give_back_the_point() {
        let triangle = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.5], [0.0, 1.0, -0.5]];
        let target = Vec3::from(triangle[0]) * 0.5 + Vec3::from(triangle[1]) * 0.3 + Vec3::from(triangle[2]) * 0.2;
        for origin in [Vec3::new(0.3, 0.2, 4.0), Vec3::new(-3.0, 1.0, -2.0), Vec3::new(1.0, -5.0, 0.1)] {
            let direction = (target - origin).normalize();
            let hit = ShearedRay::new(origin, direction).hit(&triangle, f32::INFINITY).unwrap();
            assert!((hit.distance - (target - origin).length()).abs() < 1e-5);
            assert!((hit.barycentrics[0] - 0.3).abs() < 1e-5 && (hit.barycentrics[1] - 0.2).abs() < 1e-5);
        }
    }

    /// numerics: ray/triangle, coplanar rays, slivers, zero area, axis-parallel rays from the plane itself.
    #[test]
    fn degenerate_cases_give_no_hit_or_a_finite_one() {
        let flat = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let point = [[0.5; 3]; 3];
        let sliver = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1e-30, 0.0]];
        for triangle in [flat, point, sliver] {
            for origin in [Vec3::ZERO, Vec3::new(-1.0, 0.0, 0.2), Vec3::splat(0.5), Vec3::new(0.5, 0.0, 1.0)] {
                for direction in [Vec3::X, Vec3::Y, -Vec3::Z, Vec3::new(1.0, 0.0, 0.5).normalize()] {
                    if let Some(hit) = ShearedRay::new(origin, direction).hit(&triangle, 1e30) {
                        assert!(hit.distance.is_finite() && hit.barycentrics.iter().all(|b| b.is_finite()));
                    }
                }
            }
        }
    }

    #[test]
    fn a_ray_through_a_shared_edge_hits_one_side_at_least() {
        let quad = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [1.0, 1.0, 0.3], [0.0, 1.0, 0.2_f32]];
        let halves = [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]];
        for step in 1..10_000 {
            let on_edge = Vec3::from(quad[0]).lerp(Vec3::from(quad[2]), step as f32 / 10_000.0);
            let origin = Vec3::new(0.1, 0.2 + step as f32 * 1e-4, 3.0);
            let ray = ShearedRay::new(origin, (on_edge - origin).normalize());
            assert!(halves.iter().any(|half| ray.hit(half, f32::INFINITY).is_some()), "step {step}");
        }
    }
}
