//! The server's budget: the most accurate frame that is rendered in time.
//!
//! Part of the session, asked for every live frame. Samples fill what time a frame has (`cost`); where even the pixels
//! take too long, frames are of a coarser **point**: fewer pixels, and fewer nodes, whose light their parents then bake.
//! Which one is decided by [`warplight_protocol::budget`] from a table of the scene's costs ([`crate::costs`]), whose times
//! every frame refreshes. What a point must fit into is [`PIXELS_PART`] of the budget: the rest is for samples, without
//! which light is not followed.
//!
//! Only where a budget was asked for; else frames are as large as the client asked for, however long they take. Scenes with
//! media keep all nodes, since pictures of their layers are told by their place behind them.

use super::{SampleBudget, SessionConfig};
use crate::costs::CostTable;
use std::time::Duration;
use warplight_protocol::Camera;
use warplight_protocol::ImageSize;
use warplight_protocol::budget::{Chooser, Tempo};
use warplight_protocol::frame::Plan;
use warplight_protocol::message::{Hello, Viewport};

/// Part of a frame's time that its pixels may take without any samples but the fewest.
const PIXELS_PART: f64 = 0.8;

/// One way to render a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FramePoint {
    /// Of each side that the client asked for, in percent.
    pub percent: u32,
    /// Nodes of the scene's plan that it does without, the last ones; the root is always there.
    pub without: usize,
}

const fn point(percent: u32, without: usize) -> FramePoint {
    FramePoint { percent, without }
}

impl FramePoint {
    /// All of what was asked for.
    pub const WHOLE: FramePoint = point(100, 0);

    /// All that a budget chooses from.
    pub const ALL: [FramePoint; 13] = [
        FramePoint::WHOLE,
        point(85, 0),
        point(70, 0),
        point(60, 0),
        point(50, 0),
        point(40, 0),
        point(30, 0),
        point(20, 0),
        point(100, 1),
        point(70, 1),
        point(50, 1),
        point(100, 2),
        point(50, 2),
    ];

    /// As tables name it.
    pub fn name(&self) -> String {
        let FramePoint { percent, without } = self;
        match without {
            0 => format!("{percent} % of each side, all nodes"),
            without => format!("{percent} % of each side, without {without} node(s)"),
        }
    }

    /// The point of this name.
    pub fn named(name: &str) -> Option<FramePoint> {
        FramePoint::ALL.into_iter().find(|point| point.name() == name)
    }

    /// The nodes of its frames.
    pub fn plan(&self, whole: &Plan) -> Plan {
        whole.first(whole.nodes().len().saturating_sub(self.without))
    }

    /// What its frames show of what a display shows.
    pub fn camera(&self, display: &Camera) -> Camera {
        let side = |px: u32| ((u64::from(px) * u64::from(self.percent)).div_ceil(100) as u32).max(px.min(16));
        let size = ImageSize::new(side(display.size.width), side(display.size.height));
        Camera { size, ..*display }
    }
}

/// The choice of one session.
#[derive(Clone, Debug)]
pub(super) struct FrameBudget {
    chooser: Chooser,
    points: Vec<FramePoint>,
    /// Pixels of the table.
    pixels: f64,
    budget_ms: f64,
}

impl FrameBudget {
    /// That of a session for this client, where its frames have a time and a table says what points cost.
    pub(super) fn of(config: &SessionConfig, hello: &Hello, cube: &Camera) -> Option<FrameBudget> {
        let (SampleBudget::Time(budget), Some(table)) = (config.samples, &config.costs) else { return None };
        let most_without = if config.media.is_empty() { config.plan.nodes().len() - 1 } else { 0 };
        let camera = if hello.viewport == Viewport::Cube { cube } else { &hello.camera };
        FrameBudget::new(table, budget, camera.size.pixels(), most_without)
    }

    /// For frames of so many pixels and nodes. `None` where the table knows no point.
    pub(super) fn new(table: &CostTable, budget: Duration, pixels: usize, most_without: usize) -> Option<FrameBudget> {
        let front = table.front(|name| FramePoint::named(name).is_some_and(|point| point.without <= most_without));
        let points = front.points().iter().filter_map(|point| FramePoint::named(&point.point)).collect();
        let (table_pixels, budget_ms) = (table.pixels.max(1) as f64, budget.as_secs_f64() * 1e3);
        let chooser = Chooser::new(front, PIXELS_PART * budget_ms, pixels as f64 / table_pixels, Tempo::FRAMES)?;
        Some(FrameBudget { chooser, points, pixels: table_pixels, budget_ms })
    }

    /// How the next frame is rendered.
    pub(super) fn point(&self) -> FramePoint {
        self.points[self.chooser.current()]
    }

    /// A frame of that point with so many pixels took so long without its samples; true where the nodes are others from
    /// now on.
    pub(super) fn measured(&mut self, pixels: usize, millis: f64) -> bool {
        let before = self.point();
        // As if it were whole: the table knows what its part is.
        let part = f64::from(before.percent) * 1e-2;
        let work = pixels as f64 / (part * part) / self.pixels;
        if self.chooser.measure(work, millis) {
            tracing::info!("frames are now of {}", self.in_words());
        }
        self.point().without != before.without
    }

    /// What is known of the times by now.
    pub(super) fn chooser(&self) -> &Chooser {
        &self.chooser
    }

    /// Point, its time, and what the next better one would take.
    pub(super) fn in_words(&self) -> String {
        let (chooser, whole) = (&self.chooser, 1.0 / PIXELS_PART);
        let expected = chooser.expected_ms(chooser.current()) * whole;
        let next = chooser.next_better().map_or_else(
            || "nothing is better".to_owned(),
            |(next, millis)| format!("next better {} needs {:.0} ms", next.point, millis * whole),
        );
        format!("{}, {expected:.0} ms of {:.0}; {next}", self.point().name(), self.budget_ms)
    }

    /// Whether there is a better one.
    pub(super) fn is_less(&self) -> bool {
        self.chooser.next_better().is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use warplight_protocol::budget::PointCost;

    fn table() -> CostTable {
        let cost = |point: FramePoint| {
            let part = f64::from(point.percent) * 1e-2;
            let time_ms = 300.0 * part * part * (1.0 - 0.2 * point.without as f64);
            PointCost { point: point.name(), error: 0.1 / part + 0.02 * point.without as f64, time_ms, spread_ms: 1.0 }
        };
        CostTable { metric: "FLIP".to_owned(), pixels: 10_000, points: FramePoint::ALL.map(cost).to_vec() }
    }

    fn run(budget: &mut FrameBudget, slower: f64, frames: u32) -> FramePoint {
        for _ in 0..frames {
            let point = budget.point();
            let known = table().points.into_iter().find(|known| known.point == point.name()).unwrap();
            let part = f64::from(point.percent) * 1e-2;
            budget.measured((10_000.0 * part * part) as usize, known.time_ms * slower);
        }
        budget.point()
    }

    fn budget(millis: u64, without: usize) -> FrameBudget {
        FrameBudget::new(&table(), Duration::from_millis(millis), 10_000, without).unwrap()
    }

    #[test]
    fn more_time_is_never_a_smaller_frame_and_less_time_never_a_larger_one() {
        let mut least = 0;
        for millis in [20, 50, 100, 150, 200, 300, 500] {
            let percent = run(&mut budget(millis, 0), 1.0, 400).percent;
            assert!(percent >= least, "{millis} ms");
            least = percent;
        }
        assert_eq!(least, 100);
    }

    #[test]
    fn a_cost_that_jumps_is_followed_down_and_up_again() {
        let mut budget = budget(500, 0);
        assert_eq!(run(&mut budget, 1.0, 50), FramePoint::WHOLE);
        let down = run(&mut budget, 4.0, 10);
        assert!(down.percent <= 50 && budget.is_less(), "{down:?}");
        assert!(budget.in_words().contains("next better"));
        assert_eq!(run(&mut budget, 1.0, 300), FramePoint::WHOLE);
        assert!(budget.in_words().contains("nothing is better"));
    }

    #[test]
    fn nodes_are_given_up_only_where_they_may_be() {
        for millis in [20, 50, 100, 150, 200, 300] {
            assert_eq!(run(&mut budget(millis, 0), 1.0, 100).without, 0);
        }
        let plan = Plan::solid();
        assert_eq!(FramePoint { percent: 50, without: 9 }.plan(&plan), Plan::diffuse());
        assert_eq!(FramePoint::named("50 % of each side, without 2 node(s)").unwrap().plan(&plan), Plan::mirror());
    }
}
