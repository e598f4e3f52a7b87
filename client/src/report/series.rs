//! Measurements over time: what the plots of the page show, and what others may plot again.
//!
//! Columns of equal length per series. Time is in seconds since the first pose of the trace.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// All series of a report.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Per refresh of the display.
    pub display: DisplaySeries,
    /// Per frame that arrived.
    pub frames: FrameSeries,
    /// Per compared display frame, by mode.
    pub quality: BTreeMap<String, QualitySeries>,
}

/// One entry per refresh of the display.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DisplaySeries {
    /// When.
    pub time_s: Vec<f64>,
    /// Age of the frame that is shown, in milliseconds; `null` before the first frame.
    pub frame_age_ms: Vec<Option<f64>>,
    /// From the display pose to its presentation, in milliseconds; `null` where nothing was presented.
    pub motion_to_photon_ms: Vec<Option<f64>>,
}

/// One entry per frame that arrived.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameSeries {
    /// When it arrived.
    pub time_s: Vec<f64>,
    /// Its size on the wire.
    pub bytes: Vec<u64>,
}

/// One entry per compared display frame of a mode.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct QualitySeries {
    /// When it was displayed.
    pub time_s: Vec<f64>,
    /// PSNR in dB.
    pub psnr_db: Vec<f64>,
    /// The same over the pixels that show a specular surface; `null` where there are none.
    #[serde(default)]
    pub specular_psnr_db: Vec<Option<f64>>,
    /// `(1 - SSIM) / 2`.
    pub dssim: Vec<f64>,
    /// Mean FLIP.
    pub flip: Vec<f64>,
    /// Part of the pixels that nothing was known for.
    pub hole_fraction: Vec<f64>,
}
