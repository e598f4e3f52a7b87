//! The walk of a ray through a hierarchy, for any vector instructions.
//!
//! Method: a stack of what is still to be visited (Wald et al. 2008, "Getting Rid of Packets"): a node's
//! eight boxes are tested at once, the nearest child that is met is visited next and the others wait, farther
//! ones deeper; whatever waits and is found to lie behind a hit is dropped. Who only asks whether there is a
//! hit visits larger children first and leaves at the first hit. Of two surfaces at the same distance the one of lower id is hit, so the answer
//! does not depend on the shape of the tree, or on the instructions.
//!
//! Rays that are not finite hit nothing. Cost: see [`super`].

use super::Ray;
use super::hierarchy::{Child, Hierarchy, Node, SphereLeaf, WIDENING};
use super::lanes::{LANES, Lanes, splat3};
use super::sphere::hit_sphere;
use super::stack::{Entry, Stack};
use super::triangle::{ShearedRay, TriangleHit, WideShearedRay};

/// The nearest hit so far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearest {
    /// Distance of the hit; without one, how far the ray goes.
    pub(super) distance: f32,
    /// Primitive id of the hit, and where it is on a triangle.
    pub(super) hit: Option<(u32, Option<TriangleHit>)>,
}

impl Nearest {
    /// Nothing was hit yet.
    pub(super) const NONE: Nearest = Nearest { distance: f32::INFINITY, hit: None };

    #[inline(always)]
    fn offer(&mut self, distance: f32, primitive: u32, on_triangle: Option<TriangleHit>) {
        let is_first = || self.hit.is_some_and(|(other, _)| primitive < other);
        if distance < self.distance || (distance == self.distance && is_first()) {
            *self = Nearest { distance, hit: Some((primitive, on_triangle)) };
        }
    }
}

/// What the box test needs of a ray.
struct Slabs<L: Lanes> {
    origin: [L::F32; 3],
    /// Distance along the ray per metre along an axis.
    near_inverse: [L::F32; 3],
    /// The same, widened: see `hierarchy`.
    far_inverse: [L::F32; 3],
    /// Which side of boxes is met first.
    near_side: [usize; 3],
}

impl<L: Lanes> Slabs<L> {
    #[inline(always)]
    fn new(l: L, ray: &Ray) -> Slabs<L> {
        /// Metres per metre. A ray along a plane has an infinite inverse, which times 0 is no number. With
        /// this instead, the least padding of a box (1e-28 m) is 1e10 m deep: the box is open to the ray.
        const LARGEST: f32 = 1e38;
        let direction = ray.direction.to_array();
        let inverse = direction.map(|d| (1.0 / d).clamp(-LARGEST, LARGEST));
        Slabs {
            origin: splat3(l, ray.origin.to_array()),
            near_inverse: splat3(l, inverse),
            far_inverse: splat3(l, inverse.map(|i| i * WIDENING)),
            near_side: direction.map(|d| usize::from(d.is_sign_negative())),
        }
    }

    /// The children whose boxes the ray meets before `limit`, which is widened, and where it enters them.
    #[inline(always)]
    fn meet(&self, l: L, node: &Node, limit: f32) -> (u32, L::F32) {
        let [near_x, far_x] = self.along_axis(l, node, 0);
        let [near_y, far_y] = self.along_axis(l, node, 1);
        let [near_z, far_z] = self.along_axis(l, node, 2);
        let near = l.max(l.max(near_x, near_y), l.max(near_z, l.splat(0.0)));
        let far = l.min(l.min(far_x, far_y), l.min(far_z, l.splat(limit)));
        (l.le(near, far), near)
    }

    /// Where the ray enters and leaves the slabs of the boxes along an axis.
    #[inline(always)]
    fn along_axis(&self, l: L, node: &Node, axis: usize) -> [L::F32; 2] {
        let (bounds, near) = (&node.bounds[axis], self.near_side[axis] & 1);
        [
            l.mul(l.sub(l.load(&bounds[near]), self.origin[axis]), self.near_inverse[axis]),
            l.mul(l.sub(l.load(&bounds[near ^ 1]), self.origin[axis]), self.far_inverse[axis]),
        ]
    }
}

fn is_finite(ray: &Ray) -> bool {
    ray.origin.is_finite() && ray.direction.is_finite()
}

#[inline(always)]
fn prefetch<L: Lanes>(l: L, hierarchy: &Hierarchy, child: Child) {
    if child.is_node() {
        if let Some(node) = hierarchy.nodes.get(child.index()) {
            l.prefetch(node);
        }
    } else if !child.is_sphere()
        && let Some(block) = hierarchy.blocks.get(child.index())
    {
        l.prefetch(block);
    }
}

/// Takes the lowest bit off a mask.
#[inline(always)]
fn next_lane(lanes: &mut u32) -> usize {
    let lane = lanes.trailing_zeros() as usize % LANES;
    *lanes &= *lanes - 1;
    lane
}

/// Takes the highest bit off a mask.
#[inline(always)]
fn last_lane(lanes: &mut u32) -> usize {
    let lane = lanes.ilog2() as usize % LANES;
    *lanes ^= 1 << lane;
    lane
}

/// Looks for a hit nearer than `nearest`.
#[inline(always)]
pub(super) fn closest<L: Lanes>(l: L, hierarchy: &Hierarchy, ray: &Ray, nearest: &mut Nearest) {
    if hierarchy.nodes.is_empty() || !is_finite(ray) {
        return;
    }
    let slabs = Slabs::new(l, ray);
    let sheared = WideShearedRay::new(l, &ShearedRay::new(ray.origin, ray.direction));
    let mut limit = nearest.distance * WIDENING;
    let mut stack = Stack::new();
    let mut child = Child::ROOT;
    loop {
        if child.is_node() {
            let node = &hierarchy.nodes[child.index()];
            let (mut met, near) = slabs.meet(l, node, limit);
            if met != 0 {
                let first = next_lane(&mut met);
                child = node.children[first];
                if met == 0 {
                    continue;
                }
                prefetch(l, hierarchy, child);
                let near = l.store(near);
                let mut waiting = 0;
                let mut nearest_child = Entry { child, distance: near[first] };
                while met != 0 {
                    let lane = next_lane(&mut met);
                    let mut entry = Entry { child: node.children[lane], distance: near[lane] };
                    prefetch(l, hierarchy, entry.child);
                    if entry.distance < nearest_child.distance {
                        std::mem::swap(&mut entry, &mut nearest_child);
                    }
                    stack.push_sorted(entry, waiting);
                    waiting += 1;
                }
                child = nearest_child.child;
                continue;
            }
        } else if child.is_sphere() {
            let SphereLeaf { centre, radius, primitive } = hierarchy.spheres[child.index()];
            if let Some(distance) = hit_sphere(ray.origin, ray.direction, centre, radius) {
                nearest.offer(distance, primitive, None);
                limit = nearest.distance * WIDENING;
            }
        } else {
            let block = &hierarchy.blocks[child.index()];
            if let Some(hits) = sheared.hit(l, block, nearest.distance) {
                let mut lanes = hits.lanes;
                while lanes != 0 {
                    let lane = next_lane(&mut lanes);
                    let hit = hits.of_lane(lane);
                    nearest.offer(hit.distance, block.primitives[lane], Some(hit));
                }
                limit = nearest.distance * WIDENING;
            }
        }
        child = loop {
            let Some(entry) = stack.pop() else { return };
            if entry.distance <= limit {
                break entry.child;
            }
        };
    }
}

/// Whether any surface lies nearer than `max_distance` along the ray.
#[inline(always)]
pub(super) fn occluded<L: Lanes>(l: L, hierarchy: &Hierarchy, ray: &Ray, max_distance: f32) -> bool {
    if hierarchy.nodes.is_empty() || !is_finite(ray) {
        return false;
    }
    let slabs = Slabs::new(l, ray);
    let sheared = WideShearedRay::new(l, &ShearedRay::new(ray.origin, ray.direction));
    let limit = max_distance * WIDENING;
    let mut stack = Stack::new();
    let mut child = Child::ROOT;
    loop {
        if child.is_node() {
            let node = &hierarchy.nodes[child.index()];
            let (mut met, _) = slabs.meet(l, node, limit);
            if met != 0 {
                child = node.children[next_lane(&mut met)];
                if met != 0 {
                    prefetch(l, hierarchy, child);
                }
                while met != 0 {
                    let other = node.children[last_lane(&mut met)];
                    prefetch(l, hierarchy, other);
                    stack.push(Entry { child: other, distance: 0.0 });
                }
                continue;
            }
        } else if child.is_sphere() {
            let SphereLeaf { centre, radius, .. } = hierarchy.spheres[child.index()];
            if hit_sphere(ray.origin, ray.direction, centre, radius).is_some_and(|distance| distance < max_distance) {
                return true;
            }
        } else if let Some(hits) = sheared.hit(l, &hierarchy.blocks[child.index()], max_distance) {
            let mut lanes = hits.lanes;
            while lanes != 0 {
                if hits.of_lane(next_lane(&mut lanes)).distance < max_distance {
                    return true;
                }
            }
        }
        let Some(entry) = stack.pop() else { return false };
        child = entry.child;
    }
}
