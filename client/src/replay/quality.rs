//! Every compared refresh, warped by every mode, against the server's converged picture of the same pose.

use super::{Progress, Recording, ReplayError};
use crate::measure::{Compared, compare, psnr_srgb8};
use crate::warp::{Mode, WarpStatistics, Warper};
use image::RgbImage;
use std::time::Duration;
use warplight_protocol::Camera;

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
}

/// One refresh by all modes.
#[derive(Clone, Debug)]
pub struct AssessedRefresh {
    /// When, since the first refresh.
    pub time: Duration,
    /// The converged picture.
    pub reference: RgbImage,
    /// By mode, in the order of [`Mode::ALL`].
    pub modes: Vec<Assessment>,
}

/// All compared refreshes.
#[derive(Clone, Debug, Default)]
pub struct QualityRun {
    /// In the order of time.
    pub refreshes: Vec<AssessedRefresh>,
    /// PSNR between two references of one pose by different samples: the noise of the reference.
    pub noise_psnr_db: Option<f64>,
}

/// Compares all captures of `recording`.
pub fn assess(
    recording: &Recording,
    camera: &Camera,
    progress: &mut dyn FnMut(Progress),
) -> Result<QualityRun, ReplayError> {
    let mut warper = Warper::default();
    let mut run = QualityRun::default();
    let total = (recording.captures.len() * Mode::ALL.len()) as u64;
    for capture in &recording.captures {
        let Some(reference) = &capture.reference else { continue };
        let mut modes = Vec::new();
        for mode in Mode::ALL {
            progress(Progress::Comparing((run.refreshes.len() * Mode::ALL.len() + modes.len()) as u64, total));
            let mut picture = RgbImage::default();
            let exposure = capture.frame.begin.shape.exposure;
            let tree = &capture.frame.tree;
            warper.prepare(mode, tree);
            let statistics = warper.show(mode, tree, &capture.display_pose, camera, exposure, &mut picture);
            let compared = compare(reference, &picture, None)?;
            modes.push(Assessment { mode, picture, statistics, compared });
        }
        run.refreshes.push(AssessedRefresh { time: capture.time, reference: reference.clone(), modes });
    }
    let first = recording.captures.first().and_then(|capture| capture.reference.as_ref());
    if let (Some(first), Some(second)) = (first, &recording.second_reference) {
        run.noise_psnr_db = Some(psnr_srgb8(first, second, None)?);
    }
    Ok(run)
}
