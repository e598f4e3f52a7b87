//! The client's budget: at every refresh the most accurate picture that is ready in time.
//!
//! Beside the display loop, on either clock. A [`DisplayBudget`] is asked for the [`DisplayPoint`] of the next refresh and
//! told what it took; which one fits is decided by [`warplight_protocol::budget`] from the table of a cost model, whose
//! times it refreshes. The time is that of the warp alone: a frame is taken in on another thread.
//!
//! Limits: points are steps and pixels of mode `specular`; what the table's scene is unlike, its errors are, too.

mod points;

pub use points::DisplayPoint;

use crate::report::{BudgetPoint, BudgetReport};
use std::collections::BTreeMap;
use std::time::Duration;
use warplight_protocol::budget::{Chooser, PointCost, Tempo};
use warplight_server::costs::CostTable;

/// The choice of the display's point, from refresh to refresh.
#[derive(Clone, Debug)]
pub struct DisplayBudget {
    chooser: Chooser,
    /// Those of the chooser, in its order.
    points: Vec<DisplayPoint>,
    /// Pixels of the table.
    pixels: f64,
    refreshes: Vec<u64>,
    late: u64,
    model: String,
}

impl DisplayBudget {
    /// One of `budget` for a refresh that warps so many pixels at full size, from a table of the model that is called
    /// `model`. `None` where the table knows no point.
    pub fn new(table: &CostTable, model: &str, budget: Duration, pixels: usize) -> Option<DisplayBudget> {
        let front = table.front(|name| DisplayPoint::named(name).is_some());
        let points: Vec<DisplayPoint> =
            front.points().iter().filter_map(|point| DisplayPoint::named(&point.point)).collect();
        let table_pixels = table.pixels.max(1) as f64;
        let work = pixels as f64 / table_pixels;
        let chooser = Chooser::new(front, budget.as_secs_f64() * 1e3, work, Tempo::DISPLAY)?;
        let refreshes = vec![0; points.len()];
        Some(DisplayBudget { chooser, points, pixels: table_pixels, refreshes, late: 0, model: model.to_owned() })
    }

    /// How the next refresh is made.
    pub fn point(&self) -> DisplayPoint {
        self.points[self.chooser.current()]
    }

    /// A refresh at that point took so long, whose display has so many pixels in all its views.
    pub fn measured(&mut self, took: Duration, pixels: usize) {
        let (point, millis) = (self.chooser.current(), took.as_secs_f64() * 1e3);
        self.refreshes[point] += 1;
        self.late += u64::from(millis > self.chooser.budget_ms());
        if self.chooser.measure(pixels as f64 / self.pixels, millis) {
            let name = self.point().name();
            tracing::debug!(millis, "the display's point is now {name}");
        }
    }

    /// What a refresh is said to take where time is modelled: `usual` times what the table says of this point over the
    /// usual one.
    pub fn modelled(&self, table: &CostTable, usual: Duration) -> Duration {
        let of = |point: DisplayPoint| {
            table.points.iter().find(|known| known.point == point.name()).map(|known| known.time_ms)
        };
        match (of(self.point()), of(DisplayPoint::USUAL)) {
            (Some(own), Some(usual_ms)) => usual.mul_f64(own / usual_ms),
            _ => usual,
        }
    }

    /// What is known of the times by now.
    pub fn chooser(&self) -> &Chooser {
        &self.chooser
    }

    /// What a report tells of it.
    pub fn report(&self) -> BudgetReport {
        let chooser = &self.chooser;
        let all = self.refreshes.iter().sum::<u64>().max(1) as f64;
        let known = |point: &PointCost, expected_ms: f64| BudgetPoint {
            point: point.point.clone(),
            expected_ms,
            error: point.error,
        };
        let used = self.points.iter().zip(&self.refreshes).filter(|(_, refreshes)| **refreshes > 0);
        BudgetReport {
            budget_ms: chooser.budget_ms(),
            model: self.model.clone(),
            point: self.point().name(),
            expected_ms: chooser.expected_ms(chooser.current()),
            error: chooser.points()[chooser.current()].error,
            next_better: chooser.next_better().map(|(next, expected_ms)| known(next, expected_ms)),
            front: chooser.points().iter().zip(0..).map(|(point, at)| known(point, chooser.expected_ms(at))).collect(),
            changes: u64::from(chooser.changes()),
            beyond_budget: self.late,
            shares: used.map(|(point, &refreshes)| (point.name(), refreshes as f64 / all)).collect::<BTreeMap<_, _>>(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use warplight_server::costs::CostModel;

    fn budget(budget_ms: f64, pixels: usize) -> DisplayBudget {
        let table = CostModel::built_in().display;
        DisplayBudget::new(&table, "built in", Duration::from_secs_f64(budget_ms * 1e-3), pixels).unwrap()
    }

    #[test]
    fn larger_displays_get_coarser_points_and_more_time_better_ones() {
        let table = CostModel::built_in().display;
        let usual = table.points.iter().find(|point| point.point == DisplayPoint::USUAL.name()).unwrap();
        let mut error = 0.0;
        for side in [128, 384, 1024, 2048, 4096] {
            let budget = budget(11.0, side * side);
            let own = table.points.iter().find(|point| point.point == budget.point().name()).unwrap().error;
            assert!(own >= error, "{side}: {:?}", budget.point());
            error = own;
        }
        let mut error = f64::INFINITY;
        for budget_ms in [1.0, 2.0, 5.0, 11.0, 30.0, 200.0] {
            let own = budget(budget_ms, table.pixels as usize).report().error;
            assert!(own <= error, "{budget_ms} ms");
            error = own;
        }
        assert!(error <= usual.error, "with all the time in the world nothing worse than usual");
    }

    #[test]
    fn the_report_tells_the_point_in_use_and_what_the_next_one_would_cost() {
        let mut budget = budget(11.0, 1024 * 1024);
        for _ in 0..100 {
            budget.measured(Duration::from_millis(10), 1024 * 1024);
        }
        let report = budget.report();
        assert_eq!((report.beyond_budget, report.model.as_str()), (0, "built in"));
        assert!((report.shares.values().sum::<f64>() - 1.0).abs() < 1e-9);
        if let Some(next) = &report.next_better {
            assert!(next.expected_ms > report.expected_ms && next.error < report.error);
            assert!(report.in_words().contains(&next.point));
        }
        assert!(report.in_words().contains(&report.point));
    }
}
