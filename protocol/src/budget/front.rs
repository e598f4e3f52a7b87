//! The front of accuracy against time: settings of which none is beaten in both.

use serde::{Deserialize, Serialize};

/// A setting, measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointCost {
    /// What is set, in words that do not change between releases without need: a table is matched by them.
    pub point: String,
    /// In the unit of its table, smaller is better.
    pub error: f64,
    /// Median time of a picture of the table's pixels.
    pub time_ms: f64,
    /// Between the quartiles of that.
    pub spread_ms: f64,
}

impl PointCost {
    /// Whether its numbers are some: nothing else may enter a front.
    pub fn is_valid(&self) -> bool {
        self.error.is_finite()
            && self.error >= 0.0
            && self.time_ms.is_finite()
            && self.time_ms > 0.0
            && self.spread_ms.is_finite()
            && self.spread_ms >= 0.0
    }
}

/// Points in the order of their time, each with a smaller error than all before it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Front {
    points: Vec<PointCost>,
}

impl Front {
    /// Of any points; those that are beaten, and those that are no numbers, are left out. O(n log n).
    pub fn of(points: impl IntoIterator<Item = PointCost>) -> Front {
        let mut sorted: Vec<PointCost> = points.into_iter().filter(PointCost::is_valid).collect();
        sorted.sort_by(|a, b| a.time_ms.total_cmp(&b.time_ms).then(a.error.total_cmp(&b.error)));
        let mut least = f64::INFINITY;
        sorted.retain(|point| {
            let is_better = point.error < least;
            least = least.min(point.error);
            is_better
        });
        Front { points: sorted }
    }

    /// Its points, the fastest first, the most accurate last.
    pub fn points(&self) -> &[PointCost] {
        &self.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point(time_ms: f64, error: f64) -> PointCost {
        PointCost { point: format!("{time_ms} {error}"), error, time_ms, spread_ms: 0.0 }
    }

    proptest! {
        #[test]
        fn no_point_of_a_front_is_beaten_and_every_other_one_is(
            points in prop::collection::vec((0.1_f64..10.0, 0.0_f64..1.0), 0..40),
        ) {
            let all: Vec<PointCost> = points.into_iter().map(|(time_ms, error)| point(time_ms, error)).collect();
            let front = Front::of(all.clone());
            let is_beaten = |one: &PointCost| all.iter().any(|other| {
                other.time_ms <= one.time_ms && other.error <= one.error && (other.time_ms, other.error) != (one.time_ms, one.error)
            });
            for one in &all {
                prop_assert_eq!(front.points().iter().any(|kept| kept == one), !is_beaten(one));
            }
            prop_assert!(front.points().windows(2).all(|pair| pair[0].time_ms < pair[1].time_ms && pair[0].error > pair[1].error));
        }
    }

    #[test]
    fn what_is_no_number_is_not_on_a_front() {
        let bad =
            [point(f64::NAN, 0.0), point(0.0, 0.0), point(1.0, f64::NAN), point(1.0, -1.0), point(f64::INFINITY, 0.0)];
        assert_eq!(Front::of(bad).points(), &[]);
    }
}
