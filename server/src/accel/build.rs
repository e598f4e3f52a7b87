//! A binary tree of boxes over shapes, by the surface area heuristic.
//!
//! Method: binned SAH (Wald 2007, "On fast Construction of SAH-based Bounding Volume Hierarchies"): of each
//! set of shapes the centroids are sorted into up to 32 bins along each axis, and the set is cut between two
//! bins where the sum over both sides of area times leaves is least. Eight triangles are a leaf, because
//! eight cost what one costs; a sphere is a leaf of its own.
//!
//! What holds by construction: no branch is longer than [`MAX_DEPTH`], since sets that have no levels to
//! spare are halved by count; sets whose centroids coincide are halved too. The tree does not depend on the
//! number of threads: cuts are functions of the set and its order, which only they change; bins of chunks
//! are joined in order. Boxes must be finite. Cost: 0.5 us per triangle on two cores.

use super::lanes::LANES;
use glam::Vec3A;

/// Most levels of boxes below the root. SAH rarely wants 40; 2^32 shapes need 32.
pub(super) const MAX_DEPTH: u32 = 56;

/// Most bins per axis. More finds hardly better cuts.
const BINS: usize = 32;

/// Sets at least this large are built as a task of their own.
const TASK_SHAPES: usize = 4096;

/// Sets at least this large are binned in chunks, of this size, in parallel.
const CHUNK_SHAPES: usize = 1 << 16;

/// An axis-parallel box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    pub(super) low: Vec3A,
    pub(super) high: Vec3A,
}

impl Bounds {
    pub(super) const EMPTY: Bounds = Bounds { low: Vec3A::splat(f32::INFINITY), high: Vec3A::splat(f32::NEG_INFINITY) };

    fn union(self, other: Bounds) -> Bounds {
        Bounds { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    fn with(self, point: Vec3A) -> Bounds {
        Bounds { low: self.low.min(point), high: self.high.max(point) }
    }

    /// Half of the surface; the chance of a random ray to meet the box is proportional to it.
    pub(super) fn half_area(self) -> f32 {
        let size = self.high - self.low;
        size.x * size.y + size.y * size.z + size.z * size.x
    }
}

/// A shape as the builder sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Boxed {
    pub(super) bounds: Bounds,
    /// Primitive id.
    pub(super) primitive: u32,
    /// Triangles share a leaf.
    pub(super) is_triangle: bool,
}

impl Boxed {
    /// Twice the centre of the box.
    fn centroid(&self) -> Vec3A {
        self.bounds.low + self.bounds.high
    }
}

/// A binary tree of boxes.
#[derive(Debug)]
pub(super) enum Tree {
    /// Shapes, as a range of the order that [`build`] left them in: up to eight triangles, or one sphere.
    Leaf { bounds: Bounds, first: usize, count: usize },
    /// Two trees.
    Inner { bounds: Bounds, children: Box<[Tree; 2]> },
}

impl Tree {
    pub(super) fn bounds(&self) -> Bounds {
        match self {
            Tree::Leaf { bounds, .. } | Tree::Inner { bounds, .. } => *bounds,
        }
    }
}

/// Builds the tree over at least one and at most 2^32 shapes, and puts them in the order of its leaves.
pub(super) fn build(shapes: &mut [Boxed]) -> Tree {
    subtree(shapes, 0, 0)
}

fn subtree(shapes: &mut [Boxed], first: usize, depth: u32) -> Tree {
    let (bounds, centroids) = extents(shapes);
    let count = shapes.len();
    if count == 1 || (count <= LANES && shapes.iter().all(|shape| shape.is_triangle)) {
        return Tree::Leaf { bounds, first, count };
    }
    let has_levels_to_spare = depth + count.next_power_of_two().ilog2() < MAX_DEPTH;
    let cut = if has_levels_to_spare { Cut::best(shapes, centroids) } else { None };
    let middle = cut.map_or(count / 2, |cut| partition(shapes, |shape| cut.is_low(shape)));
    let (low, high) = shapes.split_at_mut(middle);
    let mut build_low = || subtree(low, first, depth + 1);
    let mut build_high = || subtree(high, first + middle, depth + 1);
    let (low, high) =
        if count >= TASK_SHAPES { rayon::join(build_low, build_high) } else { (build_low(), build_high()) };
    Tree::Inner { bounds, children: Box::new([low, high]) }
}

/// Puts the shapes that are `low` first and says how many they are.
fn partition(shapes: &mut [Boxed], low: impl Fn(&Boxed) -> bool) -> usize {
    let (mut start, mut end) = (0, shapes.len());
    while start < end {
        if low(&shapes[start]) {
            start += 1;
        } else {
            end -= 1;
            shapes.swap(start, end);
        }
    }
    start
}

/// The boxes around shapes and around their centroids.
fn extents(shapes: &[Boxed]) -> (Bounds, Bounds) {
    let of_chunk = |chunk: &[Boxed]| {
        chunk.iter().fold((Bounds::EMPTY, Bounds::EMPTY), |(bounds, centroids), shape| {
            (bounds.union(shape.bounds), centroids.with(shape.centroid()))
        })
    };
    in_chunks(shapes, of_chunk, |a, b| (a.0.union(b.0), a.1.union(b.1)))
}

/// `of_chunk` over all shapes, the results of chunks joined in their order.
fn in_chunks<T: Send>(shapes: &[Boxed], of_chunk: impl Fn(&[Boxed]) -> T + Sync, join: impl Fn(T, T) -> T) -> T {
    use rayon::prelude::*;
    if shapes.len() < 2 * CHUNK_SHAPES {
        return of_chunk(shapes);
    }
    let (head, tail) = shapes.split_at(CHUNK_SHAPES);
    let (first, rest) =
        rayon::join(|| of_chunk(head), || tail.par_chunks(CHUNK_SHAPES).map(&of_chunk).collect::<Vec<T>>());
    rest.into_iter().fold(first, join)
}

#[derive(Clone, Copy)]
struct Bin {
    bounds: Bounds,
    count: u32,
}

impl Bin {
    const EMPTY: Bin = Bin { bounds: Bounds::EMPTY, count: 0 };

    fn union(self, other: Bin) -> Bin {
        Bin { bounds: self.bounds.union(other.bounds), count: self.count + other.count }
    }

    /// Expected cost of all leaves, up to constant factors: how likely they are met times how many they are.
    fn cost(&self) -> f32 {
        if self.count == 0 { 0.0 } else { self.bounds.half_area() * self.count.div_ceil(LANES as u32) as f32 }
    }
}

/// From a centroid to its bins.
#[derive(Clone, Copy)]
struct Binning {
    origin: Vec3A,
    bins_per_unit: Vec3A,
    bins: usize,
}

impl Binning {
    fn new(centroids: Bounds, shapes: usize) -> Binning {
        let bins = BINS.min((shapes / 2).max(4));
        // Half a bin is left over, so that rounding never makes one too many.
        let size = (centroids.high - centroids.low).max(Vec3A::splat(f32::MIN_POSITIVE));
        let bins_per_unit = (Vec3A::splat(bins as f32 - 0.5) / size).min(Vec3A::splat(f32::MAX));
        Binning { origin: centroids.low, bins_per_unit, bins }
    }

    fn bins_of(&self, shape: &Boxed) -> [usize; 3] {
        let bins = (shape.centroid() - self.origin) * self.bins_per_unit;
        bins.to_array().map(|bin| (bin as usize).min(self.bins - 1))
    }
}

/// Where a set of shapes is cut: before a bin along an axis.
#[derive(Clone, Copy)]
struct Cut {
    binning: Binning,
    axis: usize,
    bin: usize,
}

impl Cut {
    /// The cut of least cost that leaves shapes on both sides.
    fn best(shapes: &[Boxed], centroids: Bounds) -> Option<Cut> {
        if centroids.high.cmple(centroids.low).all() {
            return None;
        }
        let binning = Binning::new(centroids, shapes.len());
        let of_chunk = |chunk: &[Boxed]| {
            let mut bins = [[Bin::EMPTY; BINS]; 3];
            for shape in chunk {
                for (bins, bin) in bins.iter_mut().zip(binning.bins_of(shape)) {
                    bins[bin] = bins[bin].union(Bin { bounds: shape.bounds, count: 1 });
                }
            }
            bins
        };
        let bins = in_chunks(shapes, of_chunk, |mut a, b| {
            for (a, b) in a.iter_mut().flatten().zip(b.iter().flatten()) {
                *a = a.union(*b);
            }
            a
        });
        let mut best: Option<(f32, Cut)> = None;
        for (axis, bins) in bins.iter().enumerate() {
            let mut high_costs = [0.0; BINS];
            let mut high = Bin::EMPTY;
            for bin in (1..binning.bins).rev() {
                high = high.union(bins[bin]);
                high_costs[bin] = high.cost();
            }
            let mut low = Bin::EMPTY;
            for bin in 1..binning.bins {
                low = low.union(bins[bin - 1]);
                let both_sides = low.count > 0 && (low.count as usize) < shapes.len();
                let cost = low.cost() + high_costs[bin];
                if both_sides && best.is_none_or(|(least, _)| cost < least) {
                    best = Some((cost, Cut { binning, axis, bin }));
                }
            }
        }
        best.map(|(_, cut)| cut)
    }

    fn is_low(&self, shape: &Boxed) -> bool {
        self.binning.bins_of(shape)[self.axis] < self.bin
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::sampler::Sampler;

    fn boxed(centre: Vec3A, half: f32, primitive: u32) -> Boxed {
        Boxed {
            bounds: Bounds { low: centre - half, high: centre + half },
            primitive,
            is_triangle: !primitive.is_multiple_of(7),
        }
    }

    fn scattered(count: u32) -> Vec<Boxed> {
        let mut sampler = Sampler::new(21, 0, 0);
        let mut point = || Vec3A::from([0; 3].map(|_| sampler.value()));
        (0..count).map(|primitive| boxed(point(), 0.01, primitive)).collect()
    }

    /// Depth, after a look at whether boxes hold what they should and leaves are what they may be.
    fn checked_depth(tree: &Tree, shapes: &[Boxed]) -> u32 {
        match tree {
            Tree::Leaf { bounds, first, count } => {
                let leaf = &shapes[*first..first + count];
                assert!(leaf.len() == 1 || (leaf.len() <= LANES && leaf.iter().all(|shape| shape.is_triangle)));
                assert_eq!(*bounds, leaf.iter().fold(Bounds::EMPTY, |all, shape| all.union(shape.bounds)));
                0
            }
            Tree::Inner { bounds, children } => {
                assert_eq!(*bounds, children[0].bounds().union(children[1].bounds()));
                1 + children.iter().map(|child| checked_depth(child, shapes)).max().unwrap()
            }
        }
    }

    fn is_whole(shapes: &[Boxed]) -> bool {
        let mut primitives: Vec<u32> = shapes.iter().map(|shape| shape.primitive).collect();
        primitives.sort_unstable();
        primitives.into_iter().eq(0..shapes.len() as u32)
    }

    #[test]
    fn every_shape_is_in_one_leaf() {
        for count in [1, 2, 7, 8, 9, 100, 20_000] {
            let mut shapes = scattered(count);
            let tree = build(&mut shapes);
            assert!(checked_depth(&tree, &shapes) < 30);
            assert!(is_whole(&shapes));
        }
    }

    #[test]
    fn a_million_shapes_in_one_place_are_halved() {
        let mut shapes: Vec<Boxed> = (0..1_000_000).map(|primitive| boxed(Vec3A::ONE, 1.0, primitive)).collect();
        let tree = build(&mut shapes);
        assert!(checked_depth(&tree, &shapes) <= 20);
        assert!(is_whole(&shapes));
    }

    /// Each cut takes off a few of the largest: SAH would go on for as many levels as f32 has powers of two.
    #[test]
    fn no_branch_is_longer_than_the_stack_is_made_for() {
        let place = |index: u32| 2.0_f32.powi(index as i32 % 250 - 125);
        let mut shapes: Vec<Boxed> =
            (0..100_000).map(|index| boxed(Vec3A::splat(place(index)), 1e-3 * place(index), 7 * index)).collect();
        let depth = checked_depth(&build(&mut shapes), &shapes);
        assert!((30..=MAX_DEPTH).contains(&depth), "{depth}");
    }

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let tree = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut shapes = scattered(300_000);
            let tree = pool.install(|| build(&mut shapes));
            (format!("{tree:?}"), shapes.iter().map(|shape| shape.primitive).collect::<Vec<_>>())
        };
        assert!(tree(1) == tree(5));
    }
}
