//! Every compared refresh, warped by every mode, against the server's converged picture of the same pose: over the
//! whole picture, and over those of its pixels that show a specular surface.

use super::{Capture, Progress, Recording, ReplayError, ReplayPlan};
use crate::display::{Display, Eye, smooth_edges};
use crate::measure::{Compared, ImageError, compare, psnr_srgb8};
use crate::warp::{Mode, WarpStatistics, Warper};
use image::RgbImage;
use std::time::Duration;

/// One refresh by one mode.
#[derive(Clone, Debug)]
pub struct Assessment {
    /// The mode.
    pub mode: Mode,
    /// What it shows.
    pub picture: RgbImage,
    /// What it lacked.
    pub statistics: WarpStatistics,
    /// How far it is from the reference.
    pub compared: Compared,
    /// The same over the pixels of the reference that show a specular surface, where there are any.
    pub specular: Option<ImageError>,
}

/// What one eye sees at one refresh, by all modes.
#[derive(Clone, Debug)]
pub struct AssessedRefresh {
    /// When, since the first refresh.
    pub time: Duration,
    /// Whose picture it is.
    pub eye: Eye,
    /// The converged picture.
    pub reference: RgbImage,
    /// Pixels of the reference that show a specular surface, as a fraction of all.
    pub specular_fraction: f64,
    /// By mode, in the order of [`ReplayPlan::modes`].
    pub modes: Vec<Assessment>,
}

/// All compared refreshes.
#[derive(Clone, Debug, Default)]
pub struct QualityRun {
    /// In the order of time, the left eye before the right.
    pub refreshes: Vec<AssessedRefresh>,
    /// PSNR between two references of one pose by different samples: the noise of the reference.
    pub noise_psnr_db: Option<f64>,
    /// The same over the pixels that show a specular surface.
    pub specular_noise_psnr_db: Option<f64>,
}

/// Compares all captures of `recording`, warped as `plan` says.
pub fn assess(
    recording: &Recording,
    plan: &ReplayPlan,
    progress: &mut dyn FnMut(Progress),
) -> Result<QualityRun, ReplayError> {
    let mut studio = Studio { plan, warper: plan.warper(), display: Display::default(), spare: Vec::new() };
    let mut run = QualityRun::default();
    let total = (recording.captures.len() * plan.modes.len()) as u64;
    for (number, capture) in recording.captures.iter().enumerate() {
        let mut report = |mode: usize| progress(Progress::Comparing((number * plan.modes.len() + mode) as u64, total));
        run.refreshes.extend(studio.assess(capture, &mut report)?);
    }
    if let Some(eye) = recording.captures.first().and_then(|capture| capture.eyes.first()) {
        let pictures = (eye.reference.picture(eye.views.len()), recording.second_reference.picture(eye.views.len()));
        if let (Some(first), Some(second)) = pictures {
            run.noise_psnr_db = Some(psnr_srgb8(&first, &second, None)?);
            if let Some(mask) = eye.specular.as_deref().filter(|mask| mask.contains(&true)) {
                run.specular_noise_psnr_db = Some(psnr_srgb8(&first, &second, Some(mask))?);
            }
        }
    }
    Ok(run)
}

struct Studio<'a> {
    plan: &'a ReplayPlan,
    warper: Warper,
    display: Display,
    spare: Vec<u8>,
}

impl Studio<'_> {
    /// What each eye sees at a refresh, where its reference is there.
    fn assess(
        &mut self,
        capture: &Capture,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Vec<AssessedRefresh>, ReplayError> {
        let optics = &self.plan.optics;
        let exposure = capture.frame.begin.shape.exposure;
        let tree = &capture.frame.tree;
        let mut refreshes = Vec::new();
        for eye in &capture.eyes {
            let Some(mut reference) = eye.reference.picture(eye.views.len()) else { continue };
            if optics.smooth_edges {
                // A property of the display, not of what is compared.
                smooth_edges(&mut reference, &mut self.spare);
            }
            let mask = eye.specular.as_deref().filter(|mask| mask.contains(&true));
            let covered = mask.map_or(0, |mask| mask.iter().filter(|&&covered| covered).count());
            let specular_fraction = covered as f64 / self.plan.camera.size.pixels() as f64;
            let refresh =
                AssessedRefresh { time: capture.time, eye: eye.eye, reference, specular_fraction, modes: Vec::new() };
            refreshes.push((refresh, eye, mask));
        }
        for (index, &mode) in self.plan.modes.iter().enumerate() {
            progress(index);
            if !mode.is_told_apart_by(tree) {
                continue;
            }
            // As the display saw it: after the frames before.
            self.warper.forget();
            for earlier in capture.earlier.iter().rev() {
                self.warper.prepare(mode, &earlier.tree);
            }
            self.warper.prepare(mode, tree);
            // What was displayed is compared as it was displayed, other modes as they are.
            let point = capture.point.filter(|_| mode == self.plan.mode);
            self.warper.use_solver(point.map_or(self.plan.solver, |point| point.solver));
            for (refresh, eye, mask) in &mut refreshes {
                let mut picture = RgbImage::default();
                let Studio { warper, display, .. } = self;
                let mut views = eye.views.clone();
                if let Some(point) = point {
                    views.iter_mut().for_each(|view| view.camera = point.camera(&view.camera));
                }
                let size = self.plan.camera.size;
                let statistics =
                    display.show_enlarged(optics, warper, mode, tree, &views, exposure, size, &mut picture);
                let compared = compare(&refresh.reference, &picture, None)?;
                let specular = mask.map(|mask| compared.under_mask(&refresh.reference, &picture, mask)).transpose()?;
                refresh.modes.push(Assessment { mode, picture, statistics, compared, specular });
            }
        }
        Ok(refreshes.into_iter().map(|(refresh, ..)| refresh).collect())
    }
}
