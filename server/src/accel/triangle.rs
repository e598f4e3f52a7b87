//! Ray against triangle, watertight: one at a time, and eight at once.
//!
//! Method: Woop, Benthin and Wald 2013, "Watertight Ray/Triangle Intersection" (JCGT 2(1)). The triangle is
//! sheared so that the ray runs along an axis; then three two-dimensional edge functions decide. Both sides
//! are hit.
//!
//! Why nothing leaks: a sheared vertex depends on the vertex and the ray alone, so triangles that share it
//! see the very same point. The sign of an edge function is exact: two rounded products that differ are
//! ordered as the exact ones, and where they do not differ, f64 decides, in which the products are exact. Of
//! a closed mesh in the sheared plane one triangle at least then holds the ray, edges included. For the same
//! reason nothing here is a fused multiply-add: `fma(a, b, -round(c * d))` is not minus
//! `fma(c, d, -round(a * b))`, and a ray between two triangles would be outside of both. It also makes every
//! machine find the same bits.
//!
//! Limits: vertices must be finite. Cost: about 40 flops for one triangle or for eight.

use super::hierarchy::TriangleBlock;
use super::lanes::{LANES, Lanes, splat3};
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
    /// Distance along the ray in units of its direction's length, above 0.
    pub(super) distance: f32,
    /// Edge functions that belong to the second and third vertex, and the sum of all three.
    pub(super) edges: [f32; 3],
}

impl TriangleHit {
    /// Weights of the second and third vertex.
    pub(super) fn barycentrics(&self) -> [f32; 2] {
        let [v, w, determinant] = self.edges;
        [v / determinant, w / determinant]
    }
}

impl ShearedRay {
    #[inline]
    pub(super) fn new(origin: Vec3, direction: Vec3) -> ShearedRay {
        let length = direction.abs().to_array();
        let z = if length[0] > length[1] && length[0] > length[2] {
            0
        } else if length[1] > length[2] {
            1
        } else {
            2
        };
        let (x, y) = ([1, 2, 0][z], [2, 0, 1][z]);
        let direction = direction.to_array();
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

    /// The hit of the triangle at a distance above 0.
    pub(super) fn hit(&self, vertices: &[[f32; 3]; 3]) -> Option<TriangleHit> {
        let [a, b, c] = [self.sheared(&vertices[0]), self.sheared(&vertices[1]), self.sheared(&vertices[2])];
        let mut edges = [edge(&c, &b), edge(&a, &c), edge(&b, &a)];
        let mut outside = edges.iter().any(|&e| e < 0.0) && edges.iter().any(|&e| e > 0.0);
        if edges.contains(&0.0) && !outside {
            // On an edge to f32: decide in f64, where the products of two f32 are exact.
            let exact = [edge_f64(&c, &b), edge_f64(&a, &c), edge_f64(&b, &a)];
            outside = exact.iter().any(|&e| e < 0.0) && exact.iter().any(|&e| e > 0.0);
            edges = exact.map(|e| e as f32);
        }
        if outside {
            return None;
        }
        let [u, v, w] = edges;
        let determinant = u + v + w;
        let distance = (u * a[2] + v * b[2] + w * c[2]) / determinant;
        // Also refuses a triangle seen edge-on: its determinant is 0 and the distance no number.
        (distance > 0.0).then_some(TriangleHit { distance, edges: [v, w, determinant] })
    }
}

fn edge(p: &[f32; 3], q: &[f32; 3]) -> f32 {
    p[0] * q[1] - p[1] * q[0]
}

fn edge_f64(p: &[f32; 3], q: &[f32; 3]) -> f64 {
    f64::from(p[0]) * f64::from(q[1]) - f64::from(p[1]) * f64::from(q[0])
}

#[inline(always)]
fn wide_edge<L: Lanes>(l: L, p: [L::F32; 2], q: [L::F32; 2]) -> L::F32 {
    l.sub(l.mul(p[0], q[1]), l.mul(p[1], q[0]))
}

/// A [`ShearedRay`] for eight triangles at once.
#[derive(Clone, Copy)]
pub(super) struct WideShearedRay<L: Lanes> {
    one: ShearedRay,
    origin: [L::F32; 3],
    shear: [L::F32; 3],
}

/// Hits of the triangles of a block, lane by lane.
pub(super) struct BlockHits {
    /// A bit for each lane that was hit.
    pub(super) lanes: u32,
    distance: [f32; LANES],
    edges: [[f32; LANES]; 3],
}

impl BlockHits {
    #[inline(always)]
    pub(super) fn of_lane(&self, lane: usize) -> TriangleHit {
        TriangleHit { distance: self.distance[lane], edges: [0, 1, 2].map(|e| self.edges[e][lane]) }
    }
}

impl<L: Lanes> WideShearedRay<L> {
    #[inline(always)]
    pub(super) fn new(lanes: L, ray: &ShearedRay) -> WideShearedRay<L> {
        WideShearedRay {
            one: *ray,
            origin: splat3(lanes, ray.axes.map(|axis| ray.origin[axis])),
            shear: splat3(lanes, ray.shear),
        }
    }

    /// A corner of the triangles as seen along the ray: across it, and along it before scaling.
    #[inline(always)]
    fn sheared(&self, l: L, corner: &[[f32; LANES]; 3]) -> ([L::F32; 2], L::F32) {
        let [x, y, z] = self.one.axes;
        let along = l.sub(l.load(&corner[z]), self.origin[2]);
        let across_x = l.sub(l.sub(l.load(&corner[x]), self.origin[0]), l.mul(self.shear[0], along));
        let across_y = l.sub(l.sub(l.load(&corner[y]), self.origin[1]), l.mul(self.shear[1], along));
        ([across_x, across_y], along)
    }

    /// Eight times [`ShearedRay::hit`], to the bit, at distances above 0 and up to `limit`, itself included.
    #[inline(always)]
    pub(super) fn hit(&self, l: L, block: &TriangleBlock, limit: f32) -> Option<BlockHits> {
        let (a, a_along) = self.sheared(l, &block.vertices[0]);
        let (b, b_along) = self.sheared(l, &block.vertices[1]);
        let (c, c_along) = self.sheared(l, &block.vertices[2]);

        // The lanes without a triangle are no numbers, and inside of nothing.
        let [u, v, w] = [wide_edge(l, c, b), wide_edge(l, a, c), wide_edge(l, b, a)];
        let zero = l.splat(0.0);
        let inside = l.le(zero, l.min(l.min(u, v), w)) | l.le(l.max(l.max(u, v), w), zero);
        if inside == 0 {
            return None;
        }

        // Distances.
        let determinant = l.add(l.add(u, v), w);
        let az = l.mul(self.shear[2], a_along);
        let bz = l.mul(self.shear[2], b_along);
        let cz = l.mul(self.shear[2], c_along);
        let sum = l.add(l.add(l.mul(u, az), l.mul(v, bz)), l.mul(w, cz));
        let distance = l.div(sum, determinant);
        let reached = l.lt(zero, distance) & l.le(distance, l.splat(limit));
        let on_edge = inside & (l.eq(u, zero) | l.eq(v, zero) | l.eq(w, zero));
        let lanes = inside & reached;
        if lanes | on_edge == 0 {
            return None;
        }
        let mut hits =
            BlockHits { lanes, distance: l.store(distance), edges: [l.store(v), l.store(w), l.store(determinant)] };
        if on_edge != 0 {
            self.decide_on_edge(block, on_edge, limit, &mut hits);
        }
        Some(hits)
    }

    /// Does again, one by one, the lanes in which the ray meets an edge to f32.
    #[cold]
    #[inline(never)]
    fn decide_on_edge(&self, block: &TriangleBlock, on_edge: u32, limit: f32, hits: &mut BlockHits) {
        for lane in (0..LANES).filter(|lane| on_edge >> lane & 1 != 0) {
            hits.lanes &= !(1 << lane);
            let vertices = block.vertices.map(|corner| corner.map(|axis| axis[lane]));
            let Some(hit) = self.one.hit(&vertices).filter(|hit| hit.distance <= limit) else { continue };
            hits.lanes |= 1 << lane;
            hits.distance[lane] = hit.distance;
            for (edges, edge) in hits.edges.iter_mut().zip(hit.edges) {
                edges[lane] = edge;
            }
        }
    }
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
            let hit = ShearedRay::new(origin, direction).hit(&triangle).unwrap();
            let barycentrics = hit.barycentrics();
            assert!((hit.distance - (target - origin).length()).abs() < 1e-5);
            assert!((barycentrics[0] - 0.3).abs() < 1e-5 && (barycentrics[1] - 0.2).abs() < 1e-5);
        }
    }

    /// Coplanar rays, slivers, zero area, axis-parallel rays from the plane itself.
    #[test]
    fn degenerate_cases_give_no_hit_or_a_finite_one() {
        let flat = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let point = [[0.5; 3]; 3];
        let sliver = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1e-30, 0.0]];
        for triangle in [flat, point, sliver] {
            for origin in [Vec3::ZERO, Vec3::new(-1.0, 0.0, 0.2), Vec3::splat(0.5), Vec3::new(0.5, 0.0, 1.0)] {
                for direction in [Vec3::X, Vec3::Y, -Vec3::Z, Vec3::new(1.0, 0.0, 0.5).normalize()] {
                    if let Some(hit) = ShearedRay::new(origin, direction).hit(&triangle) {
                        assert!(hit.distance.is_finite() && hit.barycentrics().iter().all(|b| b.is_finite()));
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
            assert!(halves.iter().any(|half| ray.hit(half).is_some()), "step {step}");
        }
    }
}
