//! What makes the pictures of a replay: the warper, the display, and the budget that chooses how.

use super::ReplayPlan;
use crate::assemble::ReadyFrame;
use crate::budget::{DisplayBudget, DisplayPoint};
use crate::display::{Display, View};
use crate::trace::Trace;
use crate::warp::Warper;
use image::RgbImage;
use std::time::Duration;

/// Everything of a refresh, kept from one to the next.
#[derive(Debug)]
pub(super) struct Screen {
    pub(super) warper: Warper,
    pub(super) budget: Option<DisplayBudget>,
    display: Display,
    views: Vec<View>,
    pictures: [RgbImage; 2],
}

impl Screen {
    pub(super) fn new(plan: &ReplayPlan) -> Screen {
        Screen {
            warper: plan.warper(),
            budget: plan.display_budget(),
            display: Display::default(),
            views: Vec::new(),
            pictures: [RgbImage::default(), RgbImage::default()],
        }
    }

    /// How the next refresh is made, where a budget says so.
    pub(super) fn point(&self) -> Option<DisplayPoint> {
        self.budget.as_ref().map(DisplayBudget::point)
    }

    /// Shows `frame`, which was taken in last, to a head that moves along `trace`, at `time` of it.
    pub(super) fn show(&mut self, plan: &ReplayPlan, trace: &Trace, time: Duration, frame: &ReadyFrame) {
        let point = self.point();
        let Screen { warper, display, views, pictures, .. } = self;
        if let Some(point) = point {
            warper.use_solver(point.solver);
        }
        let camera = point.map_or(plan.camera, |point| point.camera(&plan.camera));
        let exposure = frame.begin.shape.exposure;
        let head_before = |before_secs: f64| trace.pose_at(time.as_secs_f64() - before_secs);
        for (&eye, picture) in plan.optics.eyes().iter().zip(pictures) {
            plan.optics.views(eye, head_before, &camera, views);
            let size = plan.camera.size;
            display.show_enlarged(&plan.optics, warper, plan.mode, &frame.tree, views, exposure, size, picture);
        }
    }

    /// The refresh took so long.
    pub(super) fn took(&mut self, plan: &ReplayPlan, took: Duration) {
        if let Some(budget) = &mut self.budget {
            budget.measured(took, plan.pixels_of_a_refresh());
        }
    }
}
