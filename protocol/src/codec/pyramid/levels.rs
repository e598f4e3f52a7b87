//! The levels of a pyramid: which samples each has between those that are known, and a plane taken apart into them.

/// Distance of the samples of the first grid.
const BASE: usize = 32;
/// Rows and columns of the known grid of a level, and of the samples between.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Level {
    /// Distance from a known sample to one between.
    pub(super) half: usize,
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) rows_between: usize,
    pub(super) columns_between: usize,
    /// Distance of the last row between to the known row below it, which may be the last of all.
    pub(super) last_distance: usize,
}

impl Level {
    pub(super) fn of(width: usize, height: usize, half: usize) -> Level {
        let stride = 2 * half;
        let last = height - 1;
        let rows = last / stride + 1 + usize::from(!last.is_multiple_of(stride));
        let columns = (width - 1) / stride + 1;
        // The last row is known from the start.
        let rows_between = if last > half { (last - half - 1) / stride + 1 } else { 0 };
        let columns_between = if width > half { (width - 1 - half) / stride + 1 } else { 0 };
        let last_row = half + stride * rows_between.saturating_sub(1);
        let last_distance = half.min(last.saturating_sub(last_row)).max(1);
        Level { half, rows, columns, rows_between, columns_between, last_distance }
    }

    pub(super) fn distance_below(&self, row: usize) -> usize {
        if row + 1 == self.rows_between { self.last_distance } else { self.half }
    }

    /// Samples of the three parts: centres, between columns, between rows.
    pub(super) fn parts(&self) -> [usize; 3] {
        [self.rows_between * self.columns_between, self.rows * self.columns_between, self.rows_between * self.columns]
    }
}

/// The levels of a grid, coarsest first.
pub(super) fn levels(width: usize, height: usize) -> impl DoubleEndedIterator<Item = Level> {
    (0..BASE.ilog2()).rev().map(move |log| Level::of(width, height, 1 << log))
}

/// Samples of a level by part.
pub(super) type Parts<T> = [Vec<T>; 3];

/// A plane taken apart into the parts of its levels and the first grid.
#[derive(Debug)]
pub(super) struct Split<T> {
    /// Finest first.
    pub(super) levels: Vec<Parts<T>>,
    pub(super) base: Vec<T>,
    spare: Vec<T>,
}

impl<T> Default for Split<T> {
    fn default() -> Split<T> {
        Split { levels: Vec::new(), base: Vec::new(), spare: Vec::new() }
    }
}

impl<T: Copy + Default> Split<T> {
    pub(super) fn take_apart(&mut self, width: usize, height: usize, plane: &[T]) {
        self.base.clear();
        self.base.extend_from_slice(plane);
        self.levels.resize_with(levels(width, height).count(), Default::default);
        for (level, parts) in levels(width, height).rev().zip(&mut self.levels) {
            let finer = &self.base;
            let width = level.columns + level.columns_between;
            let coarse = &mut self.spare;
            coarse.clear();
            parts.iter_mut().for_each(Vec::clear);
            let [centres, between_columns, between_rows] = parts;
            for (index, row) in finer.chunks_exact(width).enumerate() {
                let is_between = index % 2 == 1 && index / 2 < level.rows_between;
                let (even, odd) = match is_between {
                    true => (&mut *between_rows, &mut *centres),
                    false => (&mut *coarse, &mut *between_columns),
                };
                even.extend(row.iter().step_by(2));
                odd.extend(row[1.min(row.len())..].iter().step_by(2));
            }
            std::mem::swap(&mut self.base, &mut self.spare);
        }
    }

    /// The parts of a level, by the number of levels behind it.
    pub(super) fn level(&self, behind: usize) -> &Parts<T> {
        &self.levels[behind]
    }
}
