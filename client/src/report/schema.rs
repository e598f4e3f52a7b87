//! `report.json`, schema 1.
//!
//! Milliseconds, degrees, millimetres, bytes and megabits per second (10^6), as the names say. A spread that
//! nothing was measured for is `null`, never zero. Maps are ordered, so equal reports are equal bytes.

use super::{BudgetReport, Limit, Series, SpecularReport, Spikes};
use crate::measure::Percentiles;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Version of the report's form.
pub const SCHEMA: u32 = 1;

/// Everything a replay measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: u32,
    /// Name or path of the scene.
    pub scene: String,
    /// Name or path of the head trace.
    pub trace: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Which clock ran.
    pub clock: ClockKind,
    /// Width and height of the display in pixels.
    pub size: [u32; 2],
    /// The mode that was displayed; quality is that of every mode.
    pub mode: String,
    /// Effects the scene called for.
    pub effects: Vec<String>,
    /// What the display did.
    pub display: Display,
    /// Delays, in milliseconds.
    pub latency_ms: Latency,
    /// Delays far beyond the usual, and what made them so.
    #[serde(default)]
    pub spikes: Spikes,
    /// Why frames were less than was asked for.
    #[serde(default)]
    pub limits: Vec<Limit>,
    /// What the display's budget chose; `null` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<BudgetReport>,
    /// How well the head pose was predicted.
    pub prediction: Prediction,
    /// What frames showed beyond the display.
    pub viewport: Viewport,
    /// What went over the link.
    pub link: Link,
    /// What stands between frames and eyes; `null` for a pinhole.
    #[serde(default)]
    pub optics: Option<OpticsUsed>,
    /// Image error of every mode that was compared, in the order they are shown.
    pub quality: Vec<ModeQuality>,
    /// The reference that quality is measured against.
    pub reference: Option<Reference>,
    /// How mode `specular` was set, and what its nodes lacked.
    #[serde(default)]
    pub specular: SpecularReport,
    /// Rays, volume steps and other work, by name.
    pub counters: BTreeMap<String, u64>,
    /// Reasons to doubt this report; see [`super::doubts`].
    pub warnings: Vec<String>,
    /// What the plots show.
    pub series: Series,
}

/// Which clock ran.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ClockKind {
    /// The machine's.
    Real,
    /// A discrete-event clock with a modelled link.
    Virtual,
}

impl std::fmt::Display for ClockKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            ClockKind::Real => "real",
            ClockKind::Virtual => "virtual",
        })
    }
}

/// What the display did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Display {
    /// Refreshes per second.
    pub hz: f64,
    /// Refreshes in the replay.
    pub frames: u64,
    /// Refreshes for which no new image was ready.
    pub missed: u64,
}

/// Delays, in milliseconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Latency {
    /// From the head pose an image was warped to, to its presentation.
    pub motion_to_photon: Option<Percentiles>,
    /// From the head pose a frame was rendered for, to each of its presentations.
    pub frame_age: Option<Percentiles>,
    /// Time per stage: the intervals of [`crate::measure::Interval`] by their names, and `warp`, the time
    /// the warp of one display frame takes.
    pub stages: BTreeMap<String, Percentiles>,
    /// Offset between the clocks of client and server, where there are two.
    pub clock_offset: Option<ClockOffset>,
}

/// The server's clock as the client sees it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockOffset {
    /// Server's clock minus client's, in milliseconds, in the middle of the session.
    pub offset_ms: f64,
    /// Bound of its error, in milliseconds: half the shortest round trip, and how far off a steady drift is.
    pub error_ms: f64,
    /// How fast the offset changes, in parts per million.
    pub drift_ppm: f64,
}

/// How well the head pose was predicted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// By which law: none, constant, damped or adaptive.
    #[serde(default)]
    pub law: String,
    /// How far ahead the server predicts, mean in milliseconds.
    pub horizon_ms: f64,
    /// Angle between the predicted and the true head pose when the frame was shown first, in degrees.
    pub error_deg: Option<Percentiles>,
    /// Distance between them in millimetres.
    pub error_mm: Option<Percentiles>,
    /// Angle between the predicted pose and where the head was at the horizon that the server predicted for, in degrees: the
    /// error of the prediction alone.
    #[serde(default)]
    pub at_horizon_deg: Option<Percentiles>,
    /// Distance between them in millimetres.
    #[serde(default)]
    pub at_horizon_mm: Option<Percentiles>,
    /// What that would have been without any prediction, in degrees.
    #[serde(default)]
    pub unpredicted_deg: Option<Percentiles>,
    /// The same in millimetres.
    #[serde(default)]
    pub unpredicted_mm: Option<Percentiles>,
}

/// What frames showed beyond the display.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Viewport {
    /// Width of a frame's guard band on its widest side, in degrees; `null` for cubes, which show everything.
    pub guard_deg: Option<Percentiles>,
    /// Pixels of a frame for each of the display.
    pub pixels_per_display_pixel: Option<Percentiles>,
}

/// What went over the link.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Link {
    /// Bytes from the server, all messages.
    pub down_bytes: u64,
    /// Bytes to the server.
    pub up_bytes: u64,
    /// Mean rate from the server in megabits per second.
    pub down_mbps: f64,
    /// Frames the server began to send: those shown, replaced and lost.
    pub frames_sent: u64,
    /// Frames that were shown at least once.
    pub frames_shown: u64,
    /// Frames that arrived and gave way to a newer one before they were shown, or came with the end.
    pub frames_replaced: u64,
    /// Frames that had begun to arrive when the connection was lost.
    #[serde(default)]
    pub frames_lost: u64,
    /// Frames that gave way to a newer one before they were sent.
    #[serde(default)]
    pub frames_unsent: u64,
    /// How often the connection was made again.
    pub reconnects: u64,
    /// Modelled one-way delay in milliseconds; `null` on a real link, as are the next two.
    pub latency_ms: Option<f64>,
    /// Modelled jitter in milliseconds.
    pub jitter_ms: Option<f64>,
    /// Modelled rate in megabits per second; `null` is unlimited.
    pub rate_mbps: Option<f64>,
    /// Length of modelled stalls in milliseconds; `null` for none.
    #[serde(default)]
    pub stall_ms: Option<f64>,
    /// Time from one to the next.
    #[serde(default)]
    pub stall_every_ms: Option<f64>,
    /// When the modelled link is cut, in seconds; `null` for not at all.
    #[serde(default)]
    pub cut_at_s: Option<f64>,
    /// For how long.
    #[serde(default)]
    pub cut_s: Option<f64>,
    /// Encoded bytes per plane, over all frames.
    pub planes: BTreeMap<String, u64>,
}

/// Image error of one mode, over all compared display frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModeQuality {
    /// Name of the mode.
    pub mode: String,
    /// PSNR in dB; here the *smallest* is the worst.
    pub psnr_db: Option<Percentiles>,
    /// `(1 - SSIM) / 2` on luminance.
    pub dssim: Option<Percentiles>,
    /// Mean FLIP.
    pub flip: Option<Percentiles>,
    /// Part of the pixels that nothing was known for, 0 to 1.
    pub hole_fraction: Option<Percentiles>,
    /// Display frames that were compared.
    pub compared_frames: u64,
    /// The same over the pixels of the reference that show a specular surface; `null` where there are none.
    #[serde(default)]
    pub specular: Option<SpecularQuality>,
    /// By eye, where each has a picture of its own; empty else.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub eyes: BTreeMap<String, EyeQuality>,
}

/// Image error of one mode over those pixels of the reference that show a specular surface: whose root has a mirror,
/// water or glass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpecularQuality {
    /// PSNR in dB.
    pub psnr_db: Option<Percentiles>,
    /// `(1 - SSIM) / 2` on luminance; windows reach over the border of such surfaces.
    pub dssim: Option<Percentiles>,
    /// Mean FLIP.
    pub flip: Option<Percentiles>,
    /// Those pixels as a part of all, 0 to 1.
    pub pixel_fraction: Option<Percentiles>,
}

/// Image error of one mode and eye.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EyeQuality {
    /// PSNR in dB.
    pub psnr_db: Option<Percentiles>,
    /// `(1 - SSIM) / 2` on luminance.
    pub dssim: Option<Percentiles>,
    /// Mean FLIP.
    pub flip: Option<Percentiles>,
}

/// What made more than a pinhole's picture of each frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OpticsUsed {
    /// Distance of the eyes in millimetres; `null` for one picture.
    pub eye_distance_mm: Option<f64>,
    /// Diameter of the lens in millimetres; `null` for a pinhole.
    pub aperture_mm: Option<f64>,
    /// Depth in focus in metres.
    pub focus_m: Option<f64>,
    /// How long the shutter is open, in milliseconds; `null` for an instant.
    pub shutter_ms: Option<f64>,
    /// Warps that each picture is the mean of.
    pub samples: u64,
    /// Whether edges are smoothed, in what is displayed and in the reference.
    pub smooth_edges: bool,
}

impl OpticsUsed {
    /// A sentence or two for people.
    pub fn in_words(&self) -> String {
        let mut parts = Vec::new();
        if let Some(distance_mm) = self.eye_distance_mm {
            parts.push(format!("for two eyes {distance_mm:.0} mm apart"));
        }
        if let (Some(aperture_mm), Some(focus_m)) = (self.aperture_mm, self.focus_m) {
            parts.push(format!("through a lens of {aperture_mm:.1} mm focused at {focus_m:.2} m"));
        }
        if let Some(shutter_ms) = self.shutter_ms {
            parts.push(format!("with a shutter that is open for {shutter_ms:.1} ms"));
        }
        let mut text = if parts.is_empty() {
            String::new()
        } else {
            let samples = self.samples;
            let pictures = parts.join(", ");
            format!(
                "All pictures are made from one frame {pictures}, as the mean of {samples} warp(s) each; references likewise."
            )
        };
        if self.smooth_edges {
            text += if text.is_empty() { "" } else { " " };
            text += "Edges are smoothed, in what is displayed and in the reference.";
        }
        text
    }
}

/// The reference that quality is measured against.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reference {
    /// Samples per pixel.
    pub spp: u64,
    /// PSNR in dB between the reference and one more rendering with as many other samples: no mode can be
    /// told from perfect beyond this. `null` where it was not measured.
    pub noise_psnr_db: Option<f64>,
    /// The same over the pixels that show a specular surface.
    #[serde(default)]
    pub specular_noise_psnr_db: Option<f64>,
}
