//! Planes of integers from coarse to fine, each within a bound of what it was.
//!
//! A grid of every 32nd sample (and of the last row, so that a strip ends in known samples) comes first; then each level
//! halves the distance. A level has three parts: the centres of four known samples, predicted from them along the diagonals;
//! then the samples between two known ones in a row, and in a column, predicted from those two and the two centres beside
//! them. Of the two pairs of opposite neighbours the one counts whose samples differ less, so that an edge is predicted along
//! itself; where both differ as much, the mean of all four. This is the interpolation of images by two orthogonal directions
//! on a quincunx grid (Zhang and Wu 2006), used for prediction.
//!
//! Prediction goes by the samples as they are *decoded*, so the residual in steps, `round((x - p) / step)`, bounds the error of
//! every sample by half a step, whatever was before it. How much the better pair differs is the residual's context
//! ([`super::residuals`]): on a smooth surface hardly any residual is not 0, and the coder knows where that is.
//!
//! Samples are integers with many units to a step, so that a surface is predicted to a fraction of a step, and both ends
//! agree to the bit. An undefined sample takes its own prediction: it costs nothing, and its neighbours see a continuation.
//!
//! Levels stand in order, so that a prefix of the bytes is a coarser plane: see [`Pyramid::decode_prefix`].
//!
//! Cost: nothing waits for the sample before it, so rows of a level vectorise; about 2 ns a sample and level.

mod levels;

use super::DecodeError;
use super::residuals::{CONTEXTS, EndsWithin, ResidualDecoder, ResidualEncoder};
use levels::{Level, Parts, Split, levels};

/// Samples are within 2^28 on either side of 0, so that the sum of four is no overflow.
pub(crate) const MOST: i32 = 1 << 28;
/// The first grid has the context of what differs most.
const BASE_CONTEXT: u8 = CONTEXTS as u8 - 1;
/// Set of distributions of the finest level, and of all others.
const FINEST_SET: usize = 0;
const COARSE_SET: usize = 1;

/// How samples are rounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Rounding {
    /// Units from one value that a sample may be rounded to, to the next: odd. The error is at most `(step - 1) / 2`.
    pub(crate) step: i32,
    /// Decoded samples are clamped to this range, in which every true one is.
    pub(crate) lowest: i32,
    pub(crate) highest: i32,
    /// Whether a sample of 0 must not become more than 0, if need be at an error of almost a step.
    pub(crate) keeps_zero: bool,
}

impl Rounding {
    /// Integers from 0 to `highest` that come back as they were.
    pub(crate) fn exact(highest: i32) -> Rounding {
        Rounding { step: 1, lowest: 0, highest, keeps_zero: false }
    }

    #[inline(always)]
    fn clamped(&self, predicted: i32, residual: i32) -> i32 {
        // Wrapping: whatever a peer sends.
        predicted.wrapping_add(residual.wrapping_mul(self.step)).clamp(self.lowest, self.highest)
    }
}

/// Codes planes; keeps its buffers from one to the next.
#[derive(Debug, Default)]
pub(crate) struct Pyramid {
    encoder: ResidualEncoder,
    decoder: ResidualDecoder,
    /// Decoded samples of the grid that is known, row by row.
    grid: Vec<i32>,
    finer: Vec<i32>,
    parts: Parts<i32>,
    predicted: Vec<i32>,
    residuals: Vec<i32>,
    contexts: Vec<u8>,
    /// Contexts, then residuals, of the samples that count.
    kept_contexts: Vec<u8>,
    kept_residuals: Vec<i32>,
    /// What is to be coded and which samples count, level by level from the finest.
    sources: Split<i32>,
    defined: Split<bool>,
}

/// The context of a difference of neighbours: how many of an eighth, a quarter, half of a step … it is above.
#[inline(always)]
fn context(difference: i32, step: i32) -> u8 {
    let eighths = 8 * difference.min(32 * step);
    let above = |steps: i32| i32::from(eighths > steps * step);
    (above(1) + above(2) + above(4) + above(8) + above(16) + above(32) + above(128)) as u8
}

/// In the middle of two.
#[inline(always)]
fn middle(a: i32, b: i32) -> i32 {
    (a + b + 1) >> 1
}

/// Between two rows that are not equally far.
fn between(distance_above: usize, distance_below: usize) -> impl Fn(i32, i32) -> i32 + Copy {
    let (above, below) = (distance_above as i64, distance_below as i64);
    move |a, b| (i64::from(a) * below + i64::from(b) * above).div_euclid(above + below) as i32
}

/// Predictions and contexts of one row of a part. With `COPIES`, what differs by more than two steps is not averaged but
/// copied from the larger of two neighbours.
struct RowOut<'a, const COPIES: bool> {
    predicted: &'a mut [i32],
    contexts: &'a mut [u8],
    step: i32,
}

impl<const COPIES: bool> RowOut<'_, COPIES> {
    /// One sample, from one pair.
    fn set(&mut self, at: usize, a: i32, b: i32, mid: impl Fn(i32, i32) -> i32) {
        let difference = (a - b).abs();
        self.predicted[at] = if COPIES && difference > 2 * self.step { a.max(b) } else { mid(a, b) };
        self.contexts[at] = context(difference, self.step);
    }

    /// The samples from `at` on, each from one pair.
    fn set_by_pair(&mut self, at: usize, a: &[i32], b: &[i32]) {
        for (x, (&a, &b)) in a.iter().zip(b).enumerate() {
            self.set(at + x, a, b, middle);
        }
    }

    /// The samples from `at` on, each from two pairs, a and b, c and d.
    #[inline(always)]
    fn set_by_pairs(
        &mut self,
        at: usize,
        [a, b]: [&[i32]; 2],
        mid: impl Fn(i32, i32) -> i32,
        [c, d]: [&[i32]; 2],
        other_mid: impl Fn(i32, i32) -> i32,
    ) {
        let (count, step) = (a.len(), self.step);
        let (b, c, d) = (&b[..count], &c[..count], &d[..count]);
        let (predicted, contexts) = (&mut self.predicted[at..at + count], &mut self.contexts[at..at + count]);
        for x in 0..count {
            let (a, b, c, d) = (a[x], b[x], c[x], d[x]);
            let (first, second) = ((a - b).abs(), (c - d).abs());
            let (a_mid, c_mid) = (mid(a, b), other_mid(c, d));
            let better = if first < second { a_mid } else { c_mid };
            let is_alike = (first - second).abs() < step;
            let difference = first.min(second);
            predicted[x] = if is_alike { (a_mid + c_mid) >> 1 } else { better };
            if COPIES && difference > 2 * step {
                predicted[x] = if first < second { a.max(b) } else { c.max(d) };
            } else if COPIES {
                predicted[x] = better;
            }
            contexts[x] = context(difference, step);
        }
    }
}

impl Pyramid {
    /// Appends the bytes of a plane, and replaces it by what they decode to. Where `defined` is false, samples may be
    /// anything in the range.
    pub(crate) fn encode(
        &mut self,
        width: usize,
        rounding: Rounding,
        defined: Option<&[bool]>,
        plane: &mut Vec<i32>,
        out: &mut Vec<u8>,
    ) {
        let height = plane.len() / width;
        self.encoder.begin();
        if plane.iter().all(|&sample| sample == 0) || defined.is_some_and(|defined| !defined.contains(&true)) {
            plane.fill(0);
            return self.encoder.finish(out);
        }
        self.sources.take_apart(width, height, plane);
        if let Some(defined) = defined {
            self.defined.take_apart(width, height, defined);
        }
        let has_mask = defined.is_some();
        self.encode_base(width, height, rounding, has_mask);
        let count = self.sources.levels.len();
        for (index, level) in levels(width, height).enumerate() {
            let behind = count - 1 - index;
            for part in 0..3 {
                self.predict::<false>(level, part, rounding.step);
                let source = &self.sources.level(behind)[part];
                let defined = has_mask.then(|| &self.defined.level(behind)[part][..]);
                self.residuals.resize(source.len(), 0);
                round_part(rounding, source, &self.predicted, defined, &mut self.residuals, &mut self.parts[part]);
                self.encoder.extend(&self.residuals, &self.contexts, defined);
                self.encoder.end_level(if behind == 0 { FINEST_SET } else { COARSE_SET });
            }
            self.merge(level);
        }
        self.encoder.finish(out);
        std::mem::swap(plane, &mut self.grid);
    }

    /// Replaces a plane by the one that `bytes` are of.
    pub(crate) fn decode(
        &mut self,
        width: usize,
        height: usize,
        rounding: Rounding,
        defined: Option<&[bool]>,
        bytes: &[u8],
        plane: &mut Vec<i32>,
    ) -> Result<(), DecodeError> {
        let count = levels(width, height).count();
        if self.decode_levels(width, height, rounding, defined, bytes)? < count {
            return Err(DecodeError::Truncated { field: "residuals" });
        }
        self.decoder.finish()?;
        std::mem::swap(plane, &mut self.grid);
        Ok(())
    }

    /// The same of the first bytes of a plane, however many, as long as the first grid is among them: the finest levels
    /// that they do not hold are continued from those that they do. Between samples that differ by more than two steps
    /// there is the larger one, never a mean. Returns how many levels of five were there.
    pub(crate) fn decode_prefix(
        &mut self,
        width: usize,
        height: usize,
        rounding: Rounding,
        defined: Option<&[bool]>,
        bytes: &[u8],
        plane: &mut Vec<i32>,
    ) -> Result<usize, DecodeError> {
        let whole = self.decode_levels(width, height, rounding, defined, bytes)?;
        for level in levels(width, height).skip(whole) {
            for part in 0..3 {
                self.predict::<true>(level, part, rounding.step);
                self.parts[part].clear();
                self.parts[part].extend_from_slice(&self.predicted);
            }
            self.merge(level);
        }
        std::mem::swap(plane, &mut self.grid);
        Ok(whole)
    }

    fn decode_levels(
        &mut self,
        width: usize,
        height: usize,
        rounding: Rounding,
        defined: Option<&[bool]>,
        bytes: &[u8],
    ) -> Result<usize, DecodeError> {
        self.decoder.begin(bytes)?;
        if self.decoder.is_all_zero() && rounding.lowest <= 0 {
            // Then so are the first grid, all that is predicted from it, and most strips of masks.
            self.grid.clear();
            self.grid.resize(width * height, 0);
            return Ok(levels(width, height).count());
        }
        if let Some(defined) = defined {
            self.defined.take_apart(width, height, defined);
        }
        let has_mask = defined.is_some();
        self.decode_base(width, height, rounding, has_mask)?;
        let count = levels(width, height).count();
        for (index, level) in levels(width, height).enumerate() {
            let behind = count - 1 - index;
            let set = if behind == 0 { FINEST_SET } else { COARSE_SET };
            for part in 0..3 {
                self.predict::<false>(level, part, rounding.step);
                let defined = has_mask.then(|| &self.defined.level(behind)[part][..]);
                self.residuals.resize(self.contexts.len(), 0);
                if read_part(
                    &mut self.decoder,
                    set,
                    defined,
                    &self.contexts,
                    &mut self.kept_contexts,
                    &mut self.kept_residuals,
                    &mut self.residuals,
                )
                .is_err()
                {
                    return Ok(index);
                }
                let samples = self.predicted.iter().zip(&self.residuals);
                self.parts[part].clear();
                self.parts[part].extend(samples.map(|(&predicted, &residual)| rounding.clamped(predicted, residual)));
            }
            self.merge(level);
        }
        Ok(count)
    }

    /// Predicts a part of a level from the grid and the parts before it.
    fn predict<const COPIES: bool>(&mut self, level: Level, part: usize, step: i32) {
        let Level { rows, columns, rows_between, columns_between, half, .. } = level;
        let count = level.parts()[part];
        self.predicted.resize(count, 0);
        self.contexts.resize(count, 0);
        let grid = |row: usize| &self.grid[row * columns..(row + 1) * columns];
        let centres = |row: usize| &self.parts[0][row * columns_between..(row + 1) * columns_between];
        let part_columns = if part == 2 { columns } else { columns_between };
        if part_columns == 0 {
            return;
        }
        // Samples that have a known one on both sides.
        let inner = columns_between.min(columns - 1);
        let rows_of_part =
            self.predicted.chunks_exact_mut(part_columns).zip(self.contexts.chunks_exact_mut(part_columns));
        for (row, (predicted, contexts)) in rows_of_part.enumerate() {
            let mut out = RowOut::<COPIES> { predicted, contexts, step };
            match part {
                0 => {
                    let (above, below) = (grid(row), grid(row + 1));
                    let falling = [&above[..inner], &below[1..]];
                    let rising = [&above[1..=inner], &below[..inner]];
                    let distance = level.distance_below(row);
                    if distance == half {
                        out.set_by_pairs(0, falling, middle, rising, middle);
                        if inner < columns_between {
                            out.set(inner, above[inner], below[inner], middle);
                        }
                    } else {
                        let mid = between(half, distance);
                        out.set_by_pairs(0, falling, mid, rising, mid);
                        if inner < columns_between {
                            out.set(inner, above[inner], below[inner], mid);
                        }
                    }
                }
                1 => {
                    let own = grid(row);
                    // The first and the last row have centres on one side only.
                    if row > 0 && row < rows_between && row + 1 < rows {
                        let (above, below) = (centres(row - 1), centres(row));
                        out.set_by_pairs(0, [&own[..inner], &own[1..]], middle, [above, below], middle);
                        if inner < columns_between {
                            out.set(inner, above[inner], below[inner], middle);
                        }
                    } else {
                        out.set_by_pair(0, &own[..inner], &own[1..]);
                        if inner < columns_between {
                            out.set(inner, own[inner], own[inner], middle);
                        }
                    }
                }
                _ => {
                    let (above, below, own) = (grid(row), grid(row + 1), centres(row));
                    let mid = between(half, level.distance_below(row));
                    // The first column has a centre on one side only, and so may the last.
                    let end = columns_between.min(columns).max(1);
                    let pairs = ([&own[..end - 1], &own[1.min(own.len())..]], [&above[1..end], &below[1..end]]);
                    if level.distance_below(row) == half {
                        out.set_by_pairs(1, pairs.0, middle, pairs.1, middle);
                    } else {
                        out.set_by_pairs(1, pairs.0, middle, pairs.1, mid);
                    }
                    out.set(0, above[0], below[0], mid);
                    for x in end..columns {
                        out.set(x, above[x], below[x], mid);
                    }
                }
            }
        }
    }

    /// Makes the parts of a level and its grid the next grid.
    fn merge(&mut self, level: Level) {
        let Level { rows, columns, rows_between, columns_between, .. } = level;
        let width = columns + columns_between;
        self.finer.resize(width * (rows + rows_between), 0);
        let [centres, between_columns, between_rows] = &self.parts;
        let mut rows_out = self.finer.chunks_exact_mut(width);
        let mut write = |even: &[i32], odd: &[i32]| {
            let Some(out) = rows_out.next() else { return };
            let (pairs, last) = out.as_chunks_mut::<2>();
            for (pair, (&even, &odd)) in pairs.iter_mut().zip(even.iter().zip(odd)) {
                *pair = [even, odd];
            }
            if let Some(last) = last.first_mut() {
                *last = even[columns - 1];
            }
        };
        let row = |part: &'_ [i32], columns: usize, row: usize| -> std::ops::Range<usize> {
            debug_assert!(part.len() >= (row + 1) * columns);
            row * columns..(row + 1) * columns
        };
        for at in 0..rows {
            write(
                &self.grid[row(&self.grid, columns, at)],
                &between_columns[row(between_columns, columns_between, at)],
            );
            if at < rows_between {
                write(&between_rows[row(between_rows, columns, at)], &centres[row(centres, columns_between, at)]);
            }
        }
        std::mem::swap(&mut self.grid, &mut self.finer);
    }

    /// The first grid, by the gradient of decoded samples.
    fn encode_base(&mut self, width: usize, height: usize, rounding: Rounding, has_mask: bool) {
        let columns = base_columns(width, height);
        let count = self.sources.base.len();
        self.grid.clear();
        self.residuals.clear();
        for at in 0..count {
            let predicted = gradient(&self.grid, columns);
            let (mut residual, mut sample) = ([0], Vec::new());
            let defined = has_mask.then(|| &self.defined.base[at..=at]);
            round_part(rounding, &self.sources.base[at..=at], &[predicted], defined, &mut residual, &mut sample);
            self.grid.extend(sample);
            self.residuals.extend(residual);
        }
        self.contexts.clear();
        self.contexts.resize(count, BASE_CONTEXT);
        self.encoder.extend(&self.residuals, &self.contexts, has_mask.then_some(&self.defined.base[..]));
        self.encoder.end_level(COARSE_SET);
    }

    fn decode_base(
        &mut self,
        width: usize,
        height: usize,
        rounding: Rounding,
        has_mask: bool,
    ) -> Result<(), DecodeError> {
        let columns = base_columns(width, height);
        let count = columns * levels(width, height).next().map_or(0, |level| level.rows);
        self.contexts.clear();
        self.contexts.resize(count, BASE_CONTEXT);
        self.residuals.resize(count, 0);
        let defined = has_mask.then_some(&self.defined.base[..]);
        read_part(
            &mut self.decoder,
            COARSE_SET,
            defined,
            &self.contexts,
            &mut self.kept_contexts,
            &mut self.kept_residuals,
            &mut self.residuals,
        )
        .map_err(|_| DecodeError::Truncated { field: "first grid" })?;
        self.grid.clear();
        for at in 0..count {
            let predicted = gradient(&self.grid, columns);
            self.grid.push(rounding.clamped(predicted, self.residuals[at]));
        }
        Ok(())
    }
}

fn base_columns(width: usize, height: usize) -> usize {
    levels(width, height).next().map_or(0, |level| level.columns)
}

/// The gradient at the next sample of a grid that is known so far.
fn gradient(grid: &[i32], columns: usize) -> i32 {
    let at = grid.len();
    let above = |back: usize| grid[at - columns - back];
    match (at % columns, at / columns) {
        (0, 0) => 0,
        (0, _) => above(0),
        (_, 0) => grid[at - 1],
        _ => grid[at - 1] + above(0) - above(1),
    }
}

/// Residuals of samples, and what they decode to.
fn round_part(
    rounding: Rounding,
    source: &[i32],
    predicted: &[i32],
    defined: Option<&[bool]>,
    residuals: &mut [i32],
    decoded: &mut Vec<i32>,
) {
    /// Added to a number below 2^31 it leaves the nearest integer in the lowest bits of the sum.
    const ROUND: f64 = 1.5 * (1_u64 << 52) as f64;
    let per_unit = 1.0 / f64::from(rounding.step);
    let down = if rounding.keeps_zero { (rounding.step - 1) / 2 } else { 0 };
    for ((residual, &source), &predicted) in residuals.iter_mut().zip(source).zip(predicted) {
        // Rounded down, 0 does not become more.
        let difference = source - predicted - if source == 0 { down } else { 0 };
        *residual = (f64::from(difference) * per_unit + ROUND).to_bits() as i32;
    }
    if let Some(defined) = defined {
        residuals.iter_mut().zip(defined).for_each(|(residual, &defined)| *residual *= i32::from(defined));
    }
    decoded.clear();
    let samples = predicted.iter().zip(&*residuals);
    decoded.extend(samples.map(|(&predicted, &residual)| rounding.clamped(predicted, residual)));
}

/// Reads the residuals of a part; those that do not count are 0.
fn read_part(
    decoder: &mut ResidualDecoder,
    set: usize,
    defined: Option<&[bool]>,
    contexts: &[u8],
    kept_contexts: &mut Vec<u8>,
    kept_residuals: &mut Vec<i32>,
    residuals: &mut [i32],
) -> Result<(), EndsWithin> {
    let Some(defined) = defined else { return decoder.level(set, contexts, residuals) };
    kept_contexts.resize(contexts.len(), 0);
    let mut kept = 0;
    for (&context, &defined) in contexts.iter().zip(defined) {
        kept_contexts[kept] = context;
        kept += usize::from(defined);
    }
    kept_residuals.resize(contexts.len() + 1, 0);
    decoder.level(set, &kept_contexts[..kept], &mut kept_residuals[..kept])?;
    let mut at = 0;
    for (residual, &defined) in residuals.iter_mut().zip(defined) {
        *residual = kept_residuals[at] * i32::from(defined);
        at += usize::from(defined);
    }
    Ok(())
}

#[cfg(test)]
mod tests;
