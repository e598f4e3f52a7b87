//! A replay: a head trace is walked through in time, poses go up, frames come down, every display refresh is
//! warped, and everything is noted down.
//!
//! `virtual_clock` and `real_clock` drive the same sessions, the one in modelled time and the other over
//! TCP; both give a [`Recording`], from which `quality` and `report` make what is written.

mod clock;
mod intake;
mod quality;
mod real_clock;
mod recording;
mod reference;
mod report;
mod screen;
mod shown;
mod spikes;
mod virtual_clock;

pub use quality::{AssessedRefresh, Assessment, QualityRun, assess};
pub use real_clock::run as run_real;
pub use recording::{Capture, DisplayRecord, FrameRecord, Recording};
pub use reference::{EyeCapture, MeanOfStills};
pub use report::{Circumstances, report_from};
pub use virtual_clock::{ModelledTimes, run as run_virtual};

use crate::budget::DisplayBudget;
use crate::display::Optics;
use crate::session::SessionEnd;
use crate::trace::Trace;
use crate::warp::{Mode, Normals, Solver, Warper};
use std::sync::Arc;
use std::time::Duration;
use warplight_protocol::Camera;
use warplight_protocol::Pose;
use warplight_protocol::Token;
use warplight_protocol::frame::FrameFormat;
use warplight_protocol::message::{Capabilities, Hello, Prediction, Viewport};
use warplight_server::costs::CostTable;
use warplight_server::metrics::Metrics;

/// What to replay.
#[derive(Clone, Debug)]
pub struct ReplayPlan {
    /// Where the head goes, by itself; it is put where the scene has its person.
    pub trace: Trace,
    /// How much of it.
    pub duration: Duration,
    /// Camera of the display.
    pub camera: Camera,
    /// What frames show of what is around it.
    pub viewport: Viewport,
    /// Frames asked of the server per second.
    pub frame_hz: f64,
    /// Refreshes of the display per second.
    pub display_hz: f64,
    /// What is shown.
    pub mode: Mode,
    /// How mode `specular` searches pictures of children.
    pub solver: Solver,
    /// Where it has its normals from.
    pub normals: Normals,
    /// Frames before the latest that are kept, to be asked for what that does not know.
    pub earlier_frames: usize,
    /// What is compared.
    pub modes: Vec<Mode>,
    /// What stands between the frames and the eyes.
    pub optics: Optics,
    /// Formats of the planes.
    pub format: FrameFormat,
    /// Thousand bits per second that live frames shall take; 0 for as many as they need.
    pub target_kbps: u32,
    /// How the server continues the motion of the head.
    pub prediction: Prediction,
    /// Whether live frames may give way where link or client cannot keep up.
    pub adapt: bool,
    /// Where figures go while it runs.
    pub metrics: Option<Arc<Metrics>>,
    /// Every so many refreshes one is compared with the reference; 0 for none.
    pub quality_every: u64,
    /// Samples per pixel of the reference.
    pub quality_spp: u32,
    /// Time for the picture of a refresh, and the table its point is chosen from.
    pub budget: Option<BudgetPlan>,
}

/// A budget of the display.
#[derive(Clone, Debug)]
pub struct BudgetPlan {
    /// Time for the picture of a refresh.
    pub time: Duration,
    /// What points cost.
    pub table: CostTable,
    /// Where the table comes from, in words.
    pub model: String,
}

impl ReplayPlan {
    /// What the client says first.
    pub fn hello(&self) -> Hello {
        Hello {
            capabilities: Capabilities::ALL,
            software: concat!("warplight-client ", env!("CARGO_PKG_VERSION")).to_owned(),
            camera: self.camera,
            viewport: self.viewport,
            frame_hz: self.frame_hz as f32,
            format: self.format,
            target_kbps: self.target_kbps,
            prediction: self.prediction,
            token: Token::NONE,
            adapt: self.adapt,
        }
    }

    /// A warper as the plan wants it.
    pub fn warper(&self) -> Warper {
        let mut warper = Warper::default();
        warper.set_solver(self.solver);
        warper.set_normals(self.normals);
        warper.set_earlier_frames(self.earlier_frames);
        warper.set_normal_bits(self.format.normal_bits);
        warper
    }

    /// The display's budget, at its beginning.
    pub fn display_budget(&self) -> Option<DisplayBudget> {
        let BudgetPlan { time, table, model } = self.budget.as_ref()?;
        DisplayBudget::new(table, model, *time, self.pixels_of_a_refresh())
    }

    /// Pixels that are warped for a refresh, at full size.
    pub fn pixels_of_a_refresh(&self) -> usize {
        self.camera.size.pixels() * self.optics.eyes().len() * self.optics.samples()
    }

    /// Refreshes in the replay.
    pub fn refreshes(&self) -> u64 {
        (self.duration.as_secs_f64() * self.display_hz).round() as u64
    }

    /// Time between two refreshes.
    pub fn refresh_interval(&self) -> Duration {
        Duration::from_secs_f64(1.0 / self.display_hz)
    }

    /// Time of a refresh since the first.
    pub fn refresh_time(&self, number: u64) -> Duration {
        Duration::from_secs_f64(number as f64 / self.display_hz)
    }

    /// How many comparisons are to be made by the refresh of this number. The first comes after half a period,
    /// when the session is under way; one whose refresh was missed is made at the next.
    pub fn comparisons_by(&self, number: u64) -> u64 {
        (number + self.quality_every.div_ceil(2)).checked_div(self.quality_every).unwrap_or(0)
    }

    /// Head poses in the scene, where its person stands at `head`.
    pub fn placed_trace(&self, head: &Pose) -> Trace {
        self.trace.placed_at(head)
    }
}

/// Why a replay failed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// No session could be opened, or one ended for good.
    #[error(transparent)]
    Session(#[from] SessionEnd),
    /// The server could not be reached.
    #[error("{address}: {source}")]
    Connect {
        /// Where.
        address: String,
        /// Why not.
        source: std::io::Error,
    },
    /// The threads beside the display.
    #[error("starting the threads beside the display: {0}")]
    Threads(std::io::Error),
    /// No frame arrived.
    #[error("no frame arrived within {0:?}")]
    NoFrame(Duration),
    /// A picture could not be encoded.
    #[error(transparent)]
    Video(#[from] warplight_protocol::video::VideoError),
    /// An image metric could not be computed.
    #[error("image metric: {0}")]
    Measure(#[from] crate::measure::MeasureError),
}

/// How far a replay has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// Waiting for the first frame.
    Connecting,
    /// Refreshes shown, of so many.
    Displaying(u64, u64),
    /// References received, of so many.
    Reference(u64, u64),
    /// Modes compared, of so many.
    Comparing(u64, u64),
}
