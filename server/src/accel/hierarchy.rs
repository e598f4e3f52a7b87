//! The hierarchy in memory: nodes of eight boxes, blocks of eight triangles, spheres.
//!
//! Method: a binary tree by `build`, whose nodes are opened, the largest first, until each has eight
//! children (Wald et al. 2008, "Getting Rid of Packets"). Boxes are kept whole, in f32, coordinate by
//! coordinate, so that a node is tested with six loads: 256 bytes, four cache lines.
//!
//! ## Boxes that no hit escapes
//!
//! With u for half an epsilon. A sheared vertex (see `triangle`) is, along the axis x across the ray, X - S Z
//! with an error below u (2 |X| + 5 |S Z|), where X and Z are its exact distances from the origin of the ray
//! and |S| <= 1 the slope: one rounding in each difference, two in S, one in its product, and one in the
//! last difference, which counts for X and for S Z. Edge functions decide exactly for these points. So if a
//! triangle of size E is found hit, the exact ray passes, at some t, within 7.01 u (|t dx| + E) of a point of
//! the exact triangle, along x and along y, and at t it is level with that point along z: of the triangle's
//! three errors take the mean with the hit's barycentrics, and |X| <= |t dx| + E. Boxes are padded by the
//! part with E (`shape`); the part with t is a relative error of t, in which the slab test has its own
//! (Ize 2013, "Robust BVH Ray Traversal"): three roundings, of the difference, the inverse and the product.
//! Together, near <= t (1 + 10.1 u) and far >= t (1 - 10.1 u). [`WIDENING`] of far, and of the limit that
//! near is compared with, makes that up with a margin of three, for the roundings of the distance itself.
//!
//! A sphere is hit to f64, so its box needs the padding only.
//!
//! Limits: a triangle seen so much on edge that its distance is not known to 40 roundings may be passed over
//! for something that is as near within that error. Never is a ray let through.

use super::build::{Bounds, Boxed, Tree, build};
use super::lanes::LANES;
use super::shape::Shape;
use glam::Vec3;

/// Factor on the far end of boxes and rays in comparisons with the near end: above, 1 + 20.3 u is needed.
pub(super) const WIDENING: f32 = 1.0 + 32.0 * f32::EPSILON;

/// Eight children and their boxes, the largest first.
#[repr(C, align(64))]
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Node {
    /// By axis, then low and high. A place without a child holds an empty box.
    pub(super) bounds: [[[f32; LANES]; 2]; 3],
    pub(super) children: [Child; LANES],
}

impl Node {
    const EMPTY: Node =
        Node { bounds: [[[f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]]; 3], children: [Child(0); LANES] };
}

/// Where a child is found: in the two highest bits of what kind, below them its index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Child(u32);

impl Child {
    pub(super) const ROOT: Child = Child(0);
    const LEAF: u32 = 1 << 31;
    const SPHERE: u32 = 1 << 30;

    pub(super) fn is_node(self) -> bool {
        self.0 & Child::LEAF == 0
    }

    pub(super) fn is_sphere(self) -> bool {
        self.0 & Child::SPHERE != 0
    }

    pub(super) fn index(self) -> usize {
        (self.0 & (Child::SPHERE - 1)) as usize
    }
}

/// Eight triangles, or fewer; the rest are no numbers.
#[repr(C, align(64))]
#[derive(Clone, Debug)]
pub(super) struct TriangleBlock {
    /// By corner, then axis.
    pub(super) vertices: [[[f32; LANES]; 3]; 3],
    /// Primitive ids.
    pub(super) primitives: [u32; LANES],
}

/// A sphere.
#[derive(Clone, Copy, Debug)]
pub(super) struct SphereLeaf {
    pub(super) centre: Vec3,
    pub(super) radius: f32,
    /// Primitive id.
    pub(super) primitive: u32,
}

/// A tree over shapes.
#[derive(Default)]
pub(super) struct Hierarchy {
    /// The root first; none without shapes.
    pub(super) nodes: Vec<Node>,
    pub(super) blocks: Vec<TriangleBlock>,
    pub(super) spheres: Vec<SphereLeaf>,
}

impl Hierarchy {
    /// Over those of a scene's shapes that are `chosen` by their primitive id.
    pub(super) fn new(shapes: &[Shape], chosen: impl Fn(usize) -> bool + Sync) -> Hierarchy {
        use rayon::prelude::*;
        let boxed = |(primitive, shape): (usize, &Shape)| {
            let (low, high) = shape.bounds();
            let bounds = Bounds { low: low.into(), high: high.into() };
            let is_triangle = matches!(shape, Shape::Triangle(_));
            Boxed { bounds, primitive: primitive as u32, is_triangle }
        };
        let mut order: Vec<Boxed> = shapes
            .par_iter()
            .enumerate()
            .filter(|(primitive, shape)| chosen(*primitive) && shape.can_be_hit())
            .map(boxed)
            .collect();
        let mut hierarchy = Hierarchy::default();
        if !order.is_empty() {
            let tree = build(&mut order);
            hierarchy.nodes.push(Node::EMPTY);
            hierarchy.fill(0, &tree, shapes, &order);
        }
        hierarchy
    }

    /// Makes the node `place` of the root of a tree, and all that is below it.
    fn fill(&mut self, place: usize, root: &Tree, shapes: &[Shape], order: &[Boxed]) {
        let mut children = vec![root];
        while let Some(opened) = largest_inner(&children).filter(|_| children.len() < LANES) {
            let Tree::Inner { children: inner, .. } = children[opened] else { break };
            let [low, high] = &**inner;
            children[opened] = low;
            children.push(high);
        }
        // Whoever looks for any hit goes through them in this order: 25 % less time in a million triangles.
        children.sort_by(|a, b| b.bounds().half_area().total_cmp(&a.bounds().half_area()));
        let mut node = Node::EMPTY;
        let mut below = Vec::with_capacity(LANES);
        for (lane, &child) in children.iter().enumerate() {
            let bounds = child.bounds();
            for axis in 0..3 {
                node.bounds[axis][0][lane] = bounds.low[axis];
                node.bounds[axis][1][lane] = bounds.high[axis];
            }
            node.children[lane] = match *child {
                Tree::Leaf { first, count, .. } => self.leaf(&order[first..first + count], shapes),
                Tree::Inner { .. } => {
                    self.nodes.push(Node::EMPTY);
                    below.push((self.nodes.len() - 1, child));
                    Child(self.nodes.len() as u32 - 1)
                }
            };
        }
        self.nodes[place] = node;
        for (place, tree) in below {
            self.fill(place, tree, shapes, order);
        }
    }

    fn leaf(&mut self, leaf: &[Boxed], shapes: &[Shape]) -> Child {
        let mut block = TriangleBlock { vertices: [[[f32::NAN; LANES]; 3]; 3], primitives: [u32::MAX; LANES] };
        for (lane, &Boxed { primitive, .. }) in leaf.iter().enumerate() {
            match shapes[primitive as usize] {
                Shape::Sphere { centre, radius } => {
                    self.spheres.push(SphereLeaf { centre, radius, primitive });
                    return Child(Child::LEAF | Child::SPHERE | (self.spheres.len() as u32 - 1));
                }
                Shape::Triangle(vertices) => {
                    block.primitives[lane] = primitive;
                    for (corner, vertex) in block.vertices.iter_mut().zip(vertices) {
                        for (axis, coordinate) in corner.iter_mut().zip(vertex) {
                            axis[lane] = coordinate;
                        }
                    }
                }
            }
        }
        self.blocks.push(block);
        Child(Child::LEAF | (self.blocks.len() as u32 - 1))
    }
}

impl std::fmt::Debug for Hierarchy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [nodes, blocks, spheres] = [self.nodes.len(), self.blocks.len(), self.spheres.len()];
        write!(f, "Hierarchy({nodes} nodes, {blocks} blocks, {spheres} spheres)")
    }
}

/// The tree that a random ray is most likely to meet, of those that can be opened.
fn largest_inner(trees: &[&Tree]) -> Option<usize> {
    let inner = trees.iter().enumerate().filter(|(_, tree)| matches!(tree, Tree::Inner { .. }));
    inner.max_by(|(_, a), (_, b)| a.bounds().half_area().total_cmp(&b.bounds().half_area())).map(|(index, _)| index)
}
