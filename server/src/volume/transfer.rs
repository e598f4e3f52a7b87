//! Transfer functions: what a value of a scan is, as extinction and colour.
//!
//! Piecewise linear between control points, constant beyond the outermost. The colour is the scattering
//! albedo, interpolated by itself, not multiplied with the extinction. Two points of the same value are a step.
//!
//! [`TransferFunction::at`] is post-classification: values are interpolated first. A look-up table of
//! `BUCKETS` entries says in which piece a value lies, so that the answer is that of the pieces, not of a
//! resampled table. [`TransferFunction::between`] is pre-integrated classification (Engel et al. 2001): the mean
//! over values that run linearly along a ray segment, by integrals over the pieces (their equation 8, without
//! attenuation inside the segment), so a thin shell between two samples is not missed. On a piece extinction
//! and colour are linear and their product is quadratic: Simpson's rule is exact on each.
//!
//! Cost: `at` is a multiplication, a look-up and usually one comparison; `between` adds two partial pieces and a
//! difference of prefix sums, in f64.

use glam::{DVec3, Vec3};

/// Entries of the look-up table: points closer than 1/4096 of the range share one, and cost a step each.
const BUCKETS: usize = 4096;
/// Most control points; drawn by hand they are below a hundred.
pub const MAX_POINTS: usize = 4096;

/// A corner of a transfer function.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlPoint {
    /// Of the grid.
    pub value: f32,
    /// Scattering albedo, each channel in [0, 1].
    pub color: Vec3,
    /// Extinction per metre, at least 0.
    pub extinction_per_m: f32,
}

/// Why control points are no transfer function.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TransferError {
    /// None or too many.
    #[error("transfer: expected 1 to {MAX_POINTS} points, found {0}")]
    Count(usize),
    /// Not ascending.
    #[error("transfer: point {index}: expected a value that is not below the one before, found {value}")]
    Order {
        /// From 1.
        index: usize,
        /// Its value.
        value: f32,
    },
    /// A number out of its range.
    #[error("transfer: point {index}: {field}: expected {expected}, found {found}")]
    Range {
        /// From 1.
        index: usize,
        /// Value, color or extinction.
        field: &'static str,
        /// What may stand there.
        expected: &'static str,
        /// What stands there.
        found: f32,
    },
}

/// Value to extinction per metre and colour, piecewise linear.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferFunction {
    points: Vec<ControlPoint>,
    /// The piece in which each bucket begins; piece i runs from point i to point i + 1.
    first_piece: Vec<u16>,
    /// Buckets per unit of value.
    buckets_per_value: f32,
    /// Integral of extinction and of extinction times colour up to each point.
    integrals: Vec<Integral>,
}

/// Of extinction, and of extinction times colour, over values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Integral {
    extinction: f64,
    color: DVec3,
}

impl TransferFunction {
    /// From points whose values do not descend.
    pub fn new(mut points: Vec<ControlPoint>) -> Result<TransferFunction, TransferError> {
        if points.is_empty() || points.len() > MAX_POINTS {
            return Err(TransferError::Count(points.len()));
        }
        check(&points)?;
        if points.len() == 1 {
            points.push(points[0]);
        }
        let (first, last) = (points[0].value, points[points.len() - 1].value);
        let span = last - first;
        let buckets_per_value = if span > 0.0 { BUCKETS as f32 / span } else { 0.0 };
        // A range too narrow for the reciprocal is a step.
        let buckets_per_value = if buckets_per_value.is_finite() { buckets_per_value } else { 0.0 };
        let last_piece = points.len() - 2;
        let mut piece = 0;
        let first_piece = (0..BUCKETS)
            .map(|bucket| {
                // One bucket early: a value's bucket is rounded.
                let value = first + span * (bucket.saturating_sub(1) as f32 / BUCKETS as f32);
                while piece < last_piece && buckets_per_value > 0.0 && points[piece + 1].value <= value {
                    piece += 1;
                }
                piece as u16
            })
            .collect();
        let mut sum = Integral::default();
        let mut integrals = vec![sum];
        for pair in points.windows(2) {
            sum = sum.plus(integral(pair, f64::from(pair[0].value), f64::from(pair[1].value)));
            integrals.push(sum);
        }
        Ok(TransferFunction { points, first_piece, buckets_per_value, integrals })
    }

    /// The control points; at least two, a single one stands there twice.
    pub fn points(&self) -> &[ControlPoint] {
        &self.points
    }

    /// Extinction per metre and albedo of a value.
    #[inline]
    pub fn at(&self, value: f32) -> (f32, Vec3) {
        let piece = self.piece(value);
        let (a, b) = (&self.points[piece], &self.points[piece + 1]);
        // f32's own max gives 0 for what is not a number; a step is at its lower end below it only.
        let part = ((value - a.value) / (b.value - a.value)).max(0.0);
        let part = if b.value > a.value { part.min(1.0) } else { f32::from(u8::from(value >= b.value)) };
        let extinction = a.extinction_per_m + (b.extinction_per_m - a.extinction_per_m) * part;
        (extinction, a.color + (b.color - a.color) * part)
    }

    /// Mean extinction, and mean of the colour weighted with extinction, over values that run linearly from
    /// `a` to `b`. Where there is no extinction the colour is that of the middle.
    pub fn between(&self, a: f32, b: f32) -> (f32, Vec3) {
        let (low, high) = (f64::from(a.min(b)), f64::from(a.max(b)));
        let length = high - low;
        // Also where one of them is not a number.
        if !length.is_finite() || length <= 0.0 {
            return self.at(a);
        }
        let Integral { extinction, color } = self.integral(low, high);
        if extinction <= 0.0 {
            return (0.0, self.at(a + (b - a) / 2.0).1);
        }
        ((extinction / length) as f32, (color / extinction).as_vec3())
    }

    /// The highest extinction of values from `low` to `high`.
    pub fn highest_extinction(&self, low: f32, high: f32) -> f32 {
        let inside = self.points.iter().filter(|point| (low..=high).contains(&point.value));
        inside.fold(self.at(low).0.max(self.at(high).0), |highest, point| highest.max(point.extinction_per_m))
    }

    /// The piece in which a value lies; below the first point the first, from the last point on the last.
    #[inline]
    fn piece(&self, value: f32) -> usize {
        // The cast saturates, and makes 0 of what is not a number.
        let bucket = ((value - self.points[0].value) * self.buckets_per_value) as usize;
        let mut piece = usize::from(self.first_piece[bucket.min(BUCKETS - 1)]);
        while piece + 2 < self.points.len() && value >= self.points[piece + 1].value {
            piece += 1;
        }
        piece
    }

    /// Over values from `low` to `high`, also beyond the outermost points.
    fn integral(&self, low: f64, high: f64) -> Integral {
        let (first, last) = (&self.points[0], &self.points[self.points.len() - 1]);
        let below = (high.min(f64::from(first.value)) - low).max(0.0);
        let above = (high - low.max(f64::from(last.value))).max(0.0);
        let mut sum = constant(first, below).plus(constant(last, above));
        let low = low.max(f64::from(first.value));
        let high = high.min(f64::from(last.value));
        if low >= high {
            return sum;
        }
        // Both are f32 values, so the casts are exact.
        let (from, to) = (self.piece(low as f32), self.piece(high as f32));
        let pair = |piece: usize| &self.points[piece..piece + 2];
        if from == to {
            return sum.plus(integral(pair(from), low, high));
        }
        sum = sum.plus(integral(pair(from), low, f64::from(self.points[from + 1].value)));
        sum = sum.plus(integral(pair(to), f64::from(self.points[to].value), high));
        sum.plus(self.integrals[to].minus(self.integrals[from + 1]))
    }
}

impl Integral {
    fn plus(self, other: Integral) -> Integral {
        Integral { extinction: self.extinction + other.extinction, color: self.color + other.color }
    }

    fn minus(self, other: Integral) -> Integral {
        Integral { extinction: self.extinction - other.extinction, color: self.color - other.color }
    }
}

fn constant(point: &ControlPoint, length: f64) -> Integral {
    let extinction = f64::from(point.extinction_per_m) * length;
    Integral { extinction, color: extinction * point.color.as_dvec3() }
}

/// Over a part of one piece, by Simpson's rule, which is exact for the quadratics that stand there.
fn integral(piece: &[ControlPoint], low: f64, high: f64) -> Integral {
    let (a, b) = (&piece[0], &piece[1]);
    let length = f64::from(b.value) - f64::from(a.value);
    if length <= 0.0 {
        return Integral::default();
    }
    let at = |value: f64| {
        let part = (value - f64::from(a.value)) / length;
        let extinction = f64::from(a.extinction_per_m) * (1.0 - part) + f64::from(b.extinction_per_m) * part;
        let color = a.color.as_dvec3().lerp(b.color.as_dvec3(), part);
        Integral { extinction, color: extinction * color }
    };
    let (start, middle, end) = (at(low), at((low + high) / 2.0), at(high));
    let sixth = (high - low) / 6.0;
    Integral {
        extinction: sixth * (start.extinction + 4.0 * middle.extinction + end.extinction),
        color: sixth * (start.color + 4.0 * middle.color + end.color),
    }
}

fn check(points: &[ControlPoint]) -> Result<(), TransferError> {
    for (index, point) in points.iter().enumerate() {
        let range = |field, expected, found| Err(TransferError::Range { index: index + 1, field, expected, found });
        if !(-super::grid::MAX_VALUE..=super::grid::MAX_VALUE).contains(&point.value) {
            return range("value", "a number from -1e30 to 1e30", point.value);
        }
        if let Some(&channel) = point.color.as_ref().iter().find(|channel| !(0.0..=1.0).contains(*channel)) {
            return range("color", "0 to 1", channel);
        }
        if !(0.0..=MAX_EXTINCTION_PER_M).contains(&point.extinction_per_m) {
            return range("extinction", "0 to 1e9 per metre", point.extinction_per_m);
        }
        if index > 0 && point.value < points[index - 1].value {
            return Err(TransferError::Order { index: index + 1, value: point.value });
        }
    }
    Ok(())
}

/// Highest extinction per metre: a mean free path of a nanometre is a surface by any measure.
pub const MAX_EXTINCTION_PER_M: f32 = 1e9;

#[cfg(test)]
mod tests {
    use super::*;

    fn point(value: f32, color: [f32; 3], extinction_per_m: f32) -> ControlPoint {
        ControlPoint { value, color: Vec3::from_array(color), extinction_per_m }
    }

    /// Air, skin, a gap, a thin bright shell, a step to bone.
    fn scan() -> TransferFunction {
        TransferFunction::new(vec![
            point(-1000.0, [0.0; 3], 0.0),
            point(-200.0, [0.9, 0.6, 0.5], 0.0),
            point(60.0, [0.9, 0.5, 0.4], 12.0),
            point(150.0, [0.8, 0.3, 0.2], 0.0),
            point(200.0, [0.1, 0.9, 0.1], 0.0),
            point(200.5, [0.2, 1.0, 0.2], 900.0),
            point(201.0, [0.1, 0.9, 0.1], 0.0),
            point(700.0, [0.9, 0.9, 0.8], 1.0),
            point(700.0, [1.0, 1.0, 0.9], 50.0),
            point(3000.0, [1.0, 1.0, 1.0], 80.0),
        ])
        .unwrap()
    }

    /// Without a table, in f64.
    fn exact(points: &[ControlPoint], value: f64) -> (f64, DVec3) {
        let after = points.iter().position(|point| f64::from(point.value) > value);
        let (a, b) = match after {
            Some(0) => (points[0], points[0]),
            Some(after) => (points[after - 1], points[after]),
            None => (points[points.len() - 1], points[points.len() - 1]),
        };
        let length = f64::from(b.value) - f64::from(a.value);
        let part = if length > 0.0 { (value - f64::from(a.value)) / length } else { 0.0 };
        let extinction = f64::from(a.extinction_per_m) * (1.0 - part) + f64::from(b.extinction_per_m) * part;
        (extinction, a.color.as_dvec3().lerp(b.color.as_dvec3(), part))
    }

    #[test]
    fn the_table_answers_like_the_pieces() {
        let transfer = scan();
        let mut values: Vec<f32> = (0..50_000).map(|index| -1200.0 + index as f32 * 0.1).collect();
        values.extend(transfer.points().iter().flat_map(|p| [p.value.next_down(), p.value, p.value.next_up()]));
        for value in values {
            let (extinction, color) = transfer.at(value);
            let (expected, expected_color) = exact(transfer.points(), f64::from(value));
            // Roundings of the part, times the height of the piece.
            assert!((f64::from(extinction) - expected).abs() < 1e-6 * 900.0, "{value}: {extinction}, {expected}");
            assert!((color.as_dvec3() - expected_color).abs().max_element() < 2e-6, "{value}");
        }
    }

    #[test]
    fn means_between_values_are_integrals() {
        let transfer = scan();
        let ends = [
            (-1200.0, 4000.0),
            (199.0, 202.0),
            (200.2, 200.3),
            (-100.0, 60.0),
            (700.0, 900.0),
            (650.0, 750.0),
            (5000.0, 6000.0),
        ];
        for (a, b) in ends {
            // The midpoint rule with steps that end at every kink: error below 1e-8 of the sum.
            let mut corners = vec![f64::from(a), f64::from(b)];
            corners.extend(
                transfer.points().iter().map(|p| f64::from(p.value)).filter(|v| *v > f64::from(a) && *v < f64::from(b)),
            );
            corners.sort_by(f64::total_cmp);
            let (mut sum, mut color) = (0.0, DVec3::ZERO);
            for pair in corners.windows(2) {
                let step = (pair[1] - pair[0]) / 4096.0;
                for index in 0..4096 {
                    let (extinction, albedo) = exact(transfer.points(), pair[0] + (f64::from(index) + 0.5) * step);
                    sum += extinction * step;
                    color += extinction * albedo * step;
                }
            }
            let expected = (sum / f64::from(b - a), color / sum);
            for (extinction, albedo) in [transfer.between(a, b), transfer.between(b, a)] {
                assert!(
                    (f64::from(extinction) / expected.0 - 1.0).abs() < 1e-6,
                    "{a} {b}: {extinction} {}",
                    expected.0
                );
                assert!((albedo.as_dvec3() - expected.1).abs().max_element() < 1e-6, "{a} {b}");
            }
        }
    }

    #[test]
    fn over_no_range_at_all_the_mean_is_the_value() {
        let transfer = scan();
        for value in [-2000.0, -100.0, 59.99, 60.0, 200.25, 650.0, 1234.5, 9e9] {
            let (extinction, color) = transfer.at(value);
            for next in [value, value.next_up()] {
                let (mean, mean_color) = transfer.between(value, next);
                // Neighbouring values lie 6e-5 apart at most where 3600 per unit is the steepest slope.
                assert!((mean - extinction).abs() <= 2e-5 * 3600.0 + extinction * 1e-6, "{value}: {mean} {extinction}");
                assert!((mean_color - color).abs().max_element() < 1e-3, "{value}");
            }
        }
    }

    #[test]
    fn bounds_hold_over_every_range() {
        let transfer = scan();
        assert_eq!(transfer.highest_extinction(190.0, 210.0), 900.0);
        assert_eq!(transfer.highest_extinction(-500.0, -300.0), 0.0);
        assert_eq!(transfer.highest_extinction(-500.0, 60.0), 12.0);
        for (low, high) in [(-900.0, 59.0), (61.0, 200.2), (699.0, 700.0), (800.0, 9000.0)] {
            let bound = transfer.highest_extinction(low, high);
            let highest = (0..=1000).map(|i| transfer.at(low + (high - low) * i as f32 / 1000.0).0).fold(0.0, f32::max);
            assert!(highest <= bound && bound <= highest * 1.001, "{low} {high}: {highest} {bound}");
        }
    }

    #[test]
    fn one_point_is_the_same_everywhere_and_a_lone_step_steps() {
        let constant = TransferFunction::new(vec![point(5.0, [0.5; 3], 2.0)]).unwrap();
        for value in [f32::MIN, -1.0, 5.0, 9.0, f32::MAX, f32::NAN, f32::INFINITY] {
            assert_eq!(constant.at(value), (2.0, Vec3::splat(0.5)));
            assert_eq!(constant.between(value, 7.0), (2.0, Vec3::splat(0.5)));
        }
        let step = TransferFunction::new(vec![point(1.0, [0.0; 3], 0.0), point(1.0, [1.0; 3], 4.0)]).unwrap();
        assert_eq!([0.9, 1.0, 1.1].map(|value| step.at(value).0), [0.0, 4.0, 4.0]);
        assert!((step.between(0.0, 4.0).0 - 3.0).abs() < 1e-6);
    }

    #[test]
    fn nonsense_is_refused_in_words() {
        let error = |points| TransferFunction::new(points).unwrap_err().to_string();
        assert_eq!(error(vec![]), "transfer: expected 1 to 4096 points, found 0");
        let descending = vec![point(1.0, [0.0; 3], 0.0), point(0.5, [0.0; 3], 0.0)];
        assert_eq!(
            error(descending),
            "transfer: point 2: expected a value that is not below the one before, found 0.5"
        );
        assert!(error(vec![point(f32::NAN, [0.0; 3], 0.0)]).contains("point 1: value: expected"));
        assert!(error(vec![point(0.0, [0.0, 1.5, 0.0], 0.0)]).contains("color: expected 0 to 1, found 1.5"));
        assert!(error(vec![point(0.0, [0.0; 3], -1.0)]).contains("extinction: expected 0 to 1e9 per metre, found -1"));
        assert!(error(vec![point(0.0, [0.0; 3], f32::INFINITY)]).contains("found inf"));
    }
}
