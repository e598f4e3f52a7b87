//! The server's converged pictures that displayed ones are compared with, put together from stills.
//!
//! What a display shows of an eye is a mean of views ([`crate::display`]), and so is its reference: one still for each
//! view, from the same pose, through the same camera and at the same time, with so many samples that all together have
//! those that were asked for. What is compared is thus the warp, and not how many samples stand for a lens. One more
//! still, with nodes, tells which pixels show a specular surface; and the first reference is asked for twice, which
//! tells its noise.

use super::shown::Shown;
use super::{Capture, Recording, ReplayPlan};
use crate::display::{Eye, View};
use crate::trace::Trace;
use glam::Vec3;
use image::RgbImage;
use std::time::Duration;
use warplight_protocol::frame::Tree;
use warplight_protocol::message::StillRequest;
use warplight_protocol::tone::display_from_radiance;
use warplight_protocol::{Camera, Pose, Timestamp};

/// What one eye sees at a compared refresh.
#[derive(Clone, Debug)]
pub struct EyeCapture {
    /// Whose picture it is.
    pub eye: Eye,
    /// world_from_view of the eye.
    pub pose: Pose,
    /// Of what the picture is the mean.
    pub views: Vec<View>,
    /// The converged picture.
    pub reference: MeanOfStills,
    /// The pixels that show a specular surface, row by row; none where the frames have no such surfaces.
    pub specular: Option<Vec<bool>>,
}

/// Stills of one size, as they arrive.
#[derive(Clone, Debug, Default)]
pub struct MeanOfStills {
    sum: Vec<Vec3>,
    size: (u32, u32),
    exposure: f32,
    count: usize,
}

impl MeanOfStills {
    fn add(&mut self, still: &Tree, exposure: f32) {
        let size = still.camera.size;
        self.sum.resize(size.pixels(), Vec3::ZERO);
        for (pixel, sum) in self.sum.iter_mut().enumerate() {
            *sum += still.nodes[0].radiance_at(pixel);
        }
        self.size = (size.width, size.height);
        self.exposure = exposure;
        self.count += 1;
    }

    /// The picture, once all `expected` stills are there.
    pub fn picture(&self, expected: usize) -> Option<RgbImage> {
        if self.count == 0 || self.count < expected {
            return None;
        }
        let mut picture = RgbImage::new(self.size.0, self.size.1);
        for (code, sum) in picture.pixels_mut().zip(&self.sum) {
            code.0 = display_from_radiance(*sum / self.count as f32, self.exposure);
        }
        Some(picture)
    }
}

/// What a still is for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    capture: usize,
    eye: usize,
    part: Part,
}

#[derive(Clone, Copy, Debug)]
enum Part {
    /// One of the views.
    View(usize),
    /// Which pixels show what.
    Surfaces,
    /// One of the views once more.
    Again(usize),
}

impl Capture {
    /// The refresh at `time`, which was `scene_time` by the client's clock, when the latest of `shown` was; none if that is none.
    pub(super) fn new(
        plan: &ReplayPlan,
        trace: &Trace,
        time: Duration,
        scene_time: Timestamp,
        shown: &Shown,
    ) -> Option<Capture> {
        let frame = shown.latest()?.clone();
        let head_before = |before_secs: f64| trace.pose_at(time.as_secs_f64() - before_secs);
        let eyes = plan.optics.eyes().iter().map(|&eye| {
            let mut views = Vec::new();
            plan.optics.views(eye, head_before, &plan.camera, &mut views);
            let pose = plan.optics.eye_pose(eye, &head_before(0.0));
            EyeCapture { eye, pose, views, reference: MeanOfStills::default(), specular: None }
        });
        let (display_pose, eyes) = (head_before(0.0), eyes.collect());
        Some(Capture {
            time,
            scene_time,
            display_pose,
            frame,
            earlier: shown.earlier().cloned().collect(),
            eyes,
            point: None,
        })
    }

    fn still(&self, number: u32, pose: Pose, camera: Camera, before_secs: f64, spp: u32) -> StillRequest {
        let before_micros = (before_secs * 1e6).round() as u64;
        let scene_time = Timestamp { micros: self.scene_time.micros.saturating_sub(before_micros) };
        StillRequest { number, pose, scene_time, spp, camera, with_nodes: false }
    }
}

impl Recording {
    /// The stills that are needed, numbered from 0.
    pub fn reference_requests(&mut self, plan: &ReplayPlan) -> Vec<StillRequest> {
        let has_children = self.plan.as_ref().is_some_and(|plan| plan.nodes().len() > 1);
        self.wanted.clear();
        for (capture, views_of) in self.captures.iter().map(|capture| &capture.eyes).enumerate() {
            for (eye, EyeCapture { views, .. }) in views_of.iter().enumerate() {
                let surfaces = has_children.then_some(Part::Surfaces);
                let parts = (0..views.len()).map(Part::View).chain(surfaces);
                self.wanted.extend(parts.map(|part| Wanted { capture, eye, part }));
            }
        }
        if let Some(EyeCapture { views, .. }) = self.captures.first().and_then(|capture| capture.eyes.first()) {
            let again = (0..views.len()).map(Part::Again);
            self.wanted.extend(again.map(|part| Wanted { capture: 0, eye: 0, part }));
        }
        let request = |(number, wanted): (u32, &Wanted)| {
            let capture = &self.captures[wanted.capture];
            let eye = &capture.eyes[wanted.eye];
            match wanted.part {
                Part::View(view) | Part::Again(view) => {
                    let View { pose, camera, before_secs } = eye.views[view];
                    let spp = plan.quality_spp.div_ceil(eye.views.len() as u32);
                    capture.still(number, pose, camera, before_secs, spp)
                }
                Part::Surfaces => {
                    let request = capture.still(number, eye.pose, plan.camera, 0.0, 1);
                    StillRequest { with_nodes: true, ..request }
                }
            }
        };
        (0..).zip(&self.wanted).map(request).collect()
    }

    /// Takes in the answer to a request.
    pub fn reference_arrived(&mut self, number: u32, still: &Tree, exposure: f32) {
        let Some(Wanted { capture, eye, part }) = self.wanted.get(number as usize).copied() else { return };
        let eye = &mut self.captures[capture].eyes[eye];
        match part {
            Part::View(_) => eye.reference.add(still, exposure),
            Part::Again(_) => self.second_reference.add(still, exposure),
            Part::Surfaces => {
                let is_specular = |&interface: &u8| still.interfaces.at(interface).is_some();
                eye.specular = Some(still.nodes[0].interface.iter().map(is_specular).collect());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use warplight_protocol::ImageSize;
    use warplight_protocol::frame::{Interfaces, Plan};

    #[test]
    fn stills_are_averaged_in_linear_light_and_only_when_all_are_there() {
        let camera = Camera::symmetric(1.0, ImageSize::new(3, 2));
        let still = |value: f32| {
            let mut tree = Tree::new(Pose::IDENTITY, camera, Plan::diffuse(), Interfaces::default());
            (0..6).for_each(|pixel| tree.nodes[0].set_radiance(pixel, Vec3::splat(value)));
            tree
        };
        let mut mean = MeanOfStills::default();
        assert!(mean.picture(0).is_none(), "nothing asked for is no picture");
        mean.add(&still(0.1), 2.0);
        assert!(mean.picture(2).is_none());
        mean.add(&still(0.3), 2.0);
        // The mean of 0.1 and 0.3, times 2.
        assert_eq!(mean.picture(2).unwrap().get_pixel(2, 1).0, display_from_radiance(Vec3::splat(0.4), 1.0));
    }
}
