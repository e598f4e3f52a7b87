//! What a band of rows is computed in: planes with a margin on all sides, one set per thread, kept for ever.

use super::{BAND, MAX_HALO};
use std::sync::Mutex;

/// Values before the first of a row and behind its last, so that neighbours can be read without a question.
pub(super) const PAD: usize = 16;
/// Most rows that a band needs of a plane.
pub(super) const ROWS: usize = BAND + 2 * MAX_HALO;

/// A plane of [`ROWS`] rows.
#[derive(Debug, Default)]
pub(super) struct Plane {
    values: Vec<f32>,
    stride: usize,
}

impl Plane {
    pub(super) fn fit(&mut self, stride: usize, rows: usize) {
        self.stride = stride + 2 * PAD;
        self.values.clear();
        self.values.resize(self.stride * rows, 0.0);
    }

    /// A row with its margins: pixel x is at `PAD + x`.
    #[inline(always)]
    pub(super) fn row(&self, row: usize) -> &[f32] {
        &self.values[row * self.stride..(row + 1) * self.stride]
    }

    #[inline(always)]
    pub(super) fn row_mut(&mut self, row: usize) -> &mut [f32] {
        &mut self.values[row * self.stride..(row + 1) * self.stride]
    }
}

/// Planes of a node, all in view of the render pose.
#[derive(Debug, Default)]
pub(super) struct NodeScratch {
    /// The point it shows.
    pub(super) point: [Plane; 3],
    /// The direction in which that is seen.
    pub(super) direction: [Plane; 3],
    /// The normal there.
    pub(super) normal: [Plane; 3],
    /// The boundary there, 0 for none.
    pub(super) interface: Plane,
    /// 1 where the node knows the texel.
    pub(super) known: Plane,
    /// Distance from the parent's point.
    pub(super) reach: Plane,
}

/// Everything that a band is computed in.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    pub(super) nodes: Vec<NodeScratch>,
    /// 1 / z of the root.
    pub(super) inverse_depth: Plane,
    /// Normals where there is a boundary, of one row.
    pub(super) masked: [Plane; 3],
    /// The same, filtered along rows, with room for the filter's own halo.
    pub(super) filtered: [Plane; 3],
}

/// Rows of halo of the normals' filter.
pub(super) const FILTER_HALO: usize = 3;

/// One [`Scratch`] for each thread that may want one.
#[derive(Debug, Default)]
pub(super) struct ScratchPool {
    free: Mutex<Vec<Scratch>>,
    shape: (usize, usize),
}

impl ScratchPool {
    /// Makes room for frames of this shape.
    pub(super) fn fit(&mut self, nodes: usize, stride: usize) {
        let free = self.free.get_mut().unwrap_or_else(std::sync::PoisonError::into_inner);
        // One more: who asks need not be one of the pool's threads.
        let threads = rayon::current_num_threads() + 1;
        if self.shape == (nodes, stride) && free.len() >= threads {
            return;
        }
        self.shape = (nodes, stride);
        free.resize_with(threads, Scratch::default);
        for scratch in free {
            scratch.nodes.resize_with(nodes, NodeScratch::default);
            scratch.inverse_depth.fit(stride, ROWS);
            scratch.masked.iter_mut().for_each(|plane| plane.fit(stride, 1));
            scratch.filtered.iter_mut().for_each(|plane| plane.fit(stride, ROWS + 2 * FILTER_HALO));
            for node in &mut scratch.nodes {
                let NodeScratch { point, direction, normal, interface, known, reach } = node;
                let vectors = point.iter_mut().chain(direction).chain(normal);
                vectors.chain([interface, known, reach]).for_each(|plane| plane.fit(stride, ROWS));
            }
        }
    }

    /// Lends one out.
    pub(super) fn with<T>(&self, work: impl FnOnce(&mut Scratch) -> T) -> T {
        let lock = || self.free.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let mut scratch = lock().pop().unwrap_or_default();
        let result = work(&mut scratch);
        lock().push(scratch);
        result
    }
}
