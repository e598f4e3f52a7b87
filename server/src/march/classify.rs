//! What the values along a step are: the mean of a transfer function over it, fast.
//!
//! Part of the march. [`TransferFunction::between`] says the same in f64, from prefix sums; here sums run over the few pieces
//! that a step meets, in f32. Nothing is subtracted that is nearly equal, so that is enough. On a piece extinction and
//! colour are linear and their product is quadratic: Simpson's rule is exact (Engel et al. 2001, without attenuation
//! inside of the step).
//!
//! Cost: two look-ups, and some 30 operations on vectors of four for a step within one piece; each further piece costs a
//! third of that. Steps over more than [`MOST_PIECES`] take the other way.

use crate::volume::TransferFunction;
use glam::{Vec3, Vec4};
use std::sync::Arc;

/// Entries of the look-up table.
const BUCKETS: usize = 1024;
/// Pieces between two values that are still summed one by one.
const MOST_PIECES: usize = 8;

/// A transfer function, made ready.
#[derive(Clone, Debug)]
pub(super) struct Classes {
    pieces: Vec<Piece>,
    /// The piece in which each bucket begins, or one before it.
    first_piece: Vec<u16>,
    first: f32,
    buckets_per_value: f32,
    exact: Arc<TransferFunction>,
}

/// Where extinction (w) and colour (xyz) are linear. The outermost reach to infinity, and are constant.
#[derive(Clone, Copy, Debug)]
struct Piece {
    start: f32,
    end: f32,
    at_start: Vec4,
    per_value: Vec4,
    /// Integrals of extinction times colour, and of extinction, from start to end.
    whole: Vec4,
}

impl Piece {
    fn new(start: f32, end: f32, at_start: Vec4, at_end: Vec4) -> Piece {
        let length = end - start;
        let per_value = if length > 0.0 { (at_end - at_start) / length } else { Vec4::ZERO };
        let mut piece = Piece { start, end, at_start, per_value, whole: Vec4::ZERO };
        piece.whole = if length > 0.0 { length * piece.mean(start, end) } else { Vec4::ZERO };
        piece
    }

    #[inline(always)]
    fn at(&self, value: f32) -> Vec4 {
        // Rounding must not make matter of less than nothing.
        (self.at_start + (value - self.start) * self.per_value).max(Vec4::ZERO)
    }

    /// Means over values from `low` to `high`, both on the piece: of extinction times colour, and, as w, of extinction.
    #[inline(always)]
    fn mean(&self, low: f32, high: f32) -> Vec4 {
        let (a, b) = (self.at(low), self.at(high));
        let middle = 0.5 * (a + b);
        let scattering = (a.w * a + 4.0 * middle.w * middle + b.w * b) * (1.0 / 6.0);
        scattering.truncate().extend(middle.w)
    }
}

impl Classes {
    pub(super) fn new(transfer: &Arc<TransferFunction>) -> Classes {
        let points = transfer.points();
        let (first, last) = (&points[0], &points[points.len() - 1]);
        let corner = |point: &crate::volume::ControlPoint| point.color.extend(point.extinction_per_m);
        let mut pieces = vec![Piece::new(first.value, first.value, corner(first), corner(first))];
        // A step has no inside.
        pieces.extend(
            points
                .windows(2)
                .filter(|pair| pair[0].value < pair[1].value)
                .map(|pair| Piece::new(pair[0].value, pair[1].value, corner(&pair[0]), corner(&pair[1]))),
        );
        pieces.push(Piece::new(last.value, last.value, corner(last), corner(last)));
        let span = last.value - first.value;
        let buckets_per_value = if span > 0.0 { BUCKETS as f32 / span } else { 0.0 };
        let buckets_per_value = if buckets_per_value.is_finite() { buckets_per_value } else { 0.0 };
        let first_piece = (0..BUCKETS)
            .map(|bucket| {
                // Two buckets early: a value's bucket is rounded. What is before the first point is in bucket 0.
                let value = first.value + span * (bucket.saturating_sub(2) as f32 / BUCKETS as f32);
                let piece = pieces.partition_point(|piece| piece.start <= value) - 1;
                if bucket == 0 || buckets_per_value == 0.0 { 0 } else { piece as u16 }
            })
            .collect();
        Classes { pieces, first_piece, first: first.value, buckets_per_value, exact: Arc::clone(transfer) }
    }

    /// Means over values that run linearly from `a` to `b`: of extinction times colour, and of extinction, per metre.
    #[inline]
    pub(super) fn between(&self, a: f32, b: f32) -> (Vec3, f32) {
        let (low, high) = if a < b { (a, b) } else { (b, a) };
        let (from, to) = (self.piece(low), self.piece(high));
        let mean = if from >= to {
            self.pieces[from].mean(low, high)
        } else if to - from > MOST_PIECES {
            let (extinction, color) = self.exact.between(a, b);
            (extinction * color).extend(extinction)
        } else {
            let (first, last) = (&self.pieces[from], &self.pieces[to]);
            let mut sum = (first.end - low) * first.mean(low, first.end);
            for piece in &self.pieces[from + 1..to] {
                sum += piece.whole;
            }
            sum += (high - last.start) * last.mean(last.start, high);
            sum / (high - low)
        };
        (mean.truncate(), mean.w)
    }

    #[inline(always)]
    fn piece(&self, value: f32) -> usize {
        // The cast saturates, and makes 0 of what is not a number.
        let bucket = ((value - self.first) * self.buckets_per_value) as usize;
        let mut piece = usize::from(self.first_piece[bucket.min(BUCKETS - 1)]);
        while piece + 1 < self.pieces.len() && value >= self.pieces[piece + 1].start {
            piece += 1;
        }
        piece
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::ControlPoint;

    fn transfer(points: &[(f32, [f32; 3], f32)]) -> Arc<TransferFunction> {
        let point = |&(value, color, extinction_per_m): &(f32, [f32; 3], f32)| ControlPoint {
            value,
            color: Vec3::from_array(color),
            extinction_per_m,
        };
        Arc::new(TransferFunction::new(points.iter().map(point).collect()).unwrap())
    }

    /// Air, skin, a gap, a shell of one unit, a step to bone; one point; one step; many points.
    fn transfers() -> Vec<Arc<TransferFunction>> {
        let scan = [
            (-1000.0, [0.0; 3], 0.0),
            (-200.0, [0.9, 0.7, 0.4], 0.0),
            (-100.0, [1.0, 0.8, 0.5], 0.5),
            (0.0, [0.8, 0.3, 0.2], 0.0),
            (100.0, [0.2, 0.3, 1.0], 0.0),
            (100.5, [0.1, 1.0, 0.3], 300.0),
            (101.0, [0.2, 0.3, 1.0], 0.0),
            (400.0, [0.9, 0.9, 0.8], 1.0),
            (400.0, [1.0, 1.0, 0.9], 60.0),
            (1500.0, [0.9, 0.95, 1.0], 90.0),
        ];
        let wave = |index: u16| {
            let phase = 0.3 * f32::from(index);
            (3.0 * f32::from(index) - 700.0, [0.5 + 0.5 * phase.sin(), 0.5, 0.1], 5.0 + 5.0 * phase.cos())
        };
        let many: Vec<_> = (0..500).map(wave).collect();
        vec![
            transfer(&scan),
            transfer(&[(3.0, [0.5, 0.6, 0.7], 2.0)]),
            transfer(&[(0.0, [0.1; 3], 0.0), (0.0, [0.9; 3], 7.0)]),
            transfer(&many),
        ]
    }

    #[test]
    fn steps_are_what_the_exact_form_says() {
        for (index, transfer) in transfers().iter().enumerate() {
            let classes = Classes::new(transfer);
            let highest = transfer.highest_extinction(-2e3, 2e3);
            for step in 0..200_000u32 {
                let hash = |salt: u32| ((step + salt).wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32;
                let a = 2800.0 * hash(0) - 1200.0;
                // From one value to another over none, few and all pieces.
                let b = a + [0.0, 1e-3, 0.3, 20.0, 900.0][step as usize % 5] * (2.0 * hash(7) - 1.0);
                let (scattering, extinction) = classes.between(a, b);
                let (exact, color) = transfer.between(a, b);
                // A few roundings of the highest extinction that the sum may hold.
                let tolerance = 2e-6 * highest;
                assert!((extinction - exact).abs() <= tolerance, "{index}: {a} {b}: {extinction} {exact}");
                let difference = (scattering - exact * color).abs().max_element();
                assert!(difference <= tolerance, "{index}: {a} {b}: {scattering} {}", exact * color);
                // Empty is empty.
                assert!(exact > 0.0 || extinction == 0.0, "{index}: {a} {b}: {extinction}");
            }
        }
    }

    #[test]
    fn values_at_the_corners_belong_to_a_piece() {
        for transfer in transfers() {
            let classes = Classes::new(&transfer);
            for value in transfer.points().iter().map(|point| point.value).chain([-1e30, 1e30]) {
                let (extinction, _) = transfer.at(value);
                assert!((classes.between(value, value).1 - extinction).abs() <= 1e-6 * extinction, "{value}");
            }
            let (_, extinction) = classes.between(f32::NAN, 0.0);
            assert!(extinction.is_nan() || extinction >= 0.0);
        }
    }
}
