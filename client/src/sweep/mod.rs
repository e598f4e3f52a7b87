//! `sweep`: what accuracy costs, as a curve over one knob.
//!
//! A [`Knob`] is something that can be turned: it has a name, scenes it can be turned on, an error with a unit, what it
//! is bought with ([`Cost`]), and a function that measures its points on one scene. [`KNOBS`] is the table of all;
//! a stage adds its own by a row, and gets table, plot, JSON, Pareto front and resume without further ado. Those of the
//! surface warp are in `surface`; what the points say is in `pareto`, what is written in [`write`].
//!
//! Time comes in as an argument, [`Request::now`]: the command reads the clock. Errors and bytes of a sweep are the
//! same in every run, times are not; within one sweep the settings of a format take turns, so that ratios hold where
//! another program comes and goes.

mod pareto;
mod settings;
mod stream;
mod surface;
mod volume;
mod write;

pub use write::{table, write_files};

use crate::trace::Trace;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use warplight_protocol::ImageSize;
use warplight_protocol::codec::DecodeError;

/// Version of the document's form.
pub const SCHEMA: u32 = 1;

/// What is measured, and how thoroughly.
pub struct Request<'a> {
    /// Size of frames and display.
    pub size: ImageSize,
    /// Timed runs of each setting.
    pub runs: u32,
    /// Fewer settings.
    pub quick: bool,
    /// How the head moves, where a knob asks.
    pub trace: &'a Trace,
    /// A folder for the planes of a volume's layers, where other codecs find them and leave what they made of them.
    pub planes: Option<&'a std::path::Path>,
    /// Samples per pixel of the converged pictures that knobs of the codec are compared with, too; 0 for none.
    pub reference_spp: u32,
    /// Time since any fixed instant.
    pub now: &'a dyn Fn() -> Duration,
}

/// What a smaller error is paid with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Cost {
    /// Milliseconds of the client.
    Time,
    /// Bytes of a frame.
    Bytes,
    /// Nothing: the knob is a circumstance, not a choice.
    None,
}

/// One setting of a knob, measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// The setting.
    pub value: String,
    /// The scene.
    pub scene: String,
    /// Median time of a picture.
    pub time_ms: f64,
    /// Between the quartiles of that.
    pub time_spread_ms: f64,
    /// In the unit of the metric, smaller is better.
    pub error: f64,
    /// Of a frame.
    pub bytes: u64,
    /// Whether no other setting is at least as good in cost, error and what is undefined, and better in one of them.
    pub pareto: bool,
    /// Whatever else was measured, by name.
    #[serde(flatten)]
    pub more: BTreeMap<String, f64>,
}

impl Point {
    fn cost(&self, cost: Cost) -> f64 {
        match cost {
            Cost::Time => self.time_ms,
            Cost::Bytes => self.bytes as f64,
            Cost::None => 0.0,
        }
    }
}

/// A whole sweep: the JSON document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sweep {
    /// [`SCHEMA`].
    pub schema: u32,
    /// The knob.
    pub knob: String,
    /// The scene, or `all`; each point names its own.
    pub scene: String,
    /// Unit of the error.
    pub metric: String,
    /// What it is bought with.
    pub cost: Cost,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Timed runs of each setting.
    pub runs: u32,
    /// Settings, scene by scene.
    pub points: Vec<Point>,
    /// What the curve says.
    pub resume: String,
}

impl Sweep {
    /// The points of each scene.
    pub fn by_scene(&self) -> impl Iterator<Item = &[Point]> {
        self.points.chunk_by(|a, b| a.scene == b.scene)
    }
}

/// Says how many of how many steps are done.
pub type Progress<'a> = &'a mut dyn FnMut(u64, u64);

/// Measures the settings of a knob on one scene.
type Measure = fn(&Request<'_>, &str, Progress<'_>) -> Result<Vec<Point>, SweepError>;

/// Something that can be turned.
pub struct Knob {
    /// Name on the command line.
    pub name: &'static str,
    /// What it turns.
    pub about: &'static str,
    /// What a smaller error is paid with.
    pub cost: Cost,
    /// Unit of the error.
    pub metric: &'static str,
    /// Scenes it is turned on.
    pub scenes: &'static [&'static str],
    /// Whether any other scene will do, too.
    pub takes_any: bool,
    measure: Measure,
}

/// A knob of the surface warp, on scenes in closed form.
const fn surface(name: &'static str, about: &'static str, cost: Cost, measure: Measure) -> Knob {
    Knob { name, about, cost, metric: "deg", scenes: &surface::SCENES, takes_any: false, measure }
}

/// A knob of volumes, on scenes with media.
const fn volume(name: &'static str, about: &'static str, cost: Cost, measure: Measure) -> Knob {
    Knob { name, about, cost, metric: "DSSIM", scenes: &volume::SCENES, takes_any: true, measure }
}

/// A knob of the codec, on live frames along a trace.
const fn stream(name: &'static str, about: &'static str, cost: Cost, measure: Measure) -> Knob {
    Knob { name, about, cost, metric: "FLIP", scenes: &stream::SCENES, takes_any: true, measure }
}

/// All knobs.
#[rustfmt::skip] // A table: a row each.
pub const KNOBS: &[Knob] = &[
    surface("solver", "how pictures of children are searched", Cost::Time, |r, s, p| surface::measure(r, s, &settings::solvers(r), p)),
    surface("steps", "steps of the solvers that have them", Cost::Time, |r, s, p| surface::measure(r, s, &settings::steps(r), p)),
    surface("normals", "where normals come from, and their bits", Cost::Bytes, |r, s, p| surface::measure(r, s, &settings::normals(r), p)),
    surface("depth-bits", "bits of depth, of root and of children", Cost::Bytes, |r, s, p| surface::measure(r, s, &settings::depth_bits(r), p)),
    surface("depth-coding", "what the depth of children measures", Cost::Bytes, |r, s, p| surface::measure(r, s, &settings::depth_codings(r), p)),
    surface("frame-age", "milliseconds a head has moved since", Cost::None, |r, s, p| surface::measure(r, s, &settings::frame_ages(r), p)),
    surface("head-translation", "centimetres a head has moved", Cost::None, |r, s, p| surface::measure(r, s, &settings::head_translations(r), p)),
    volume("layers", "segments of a pixel's volume, and how they are cut", Cost::Bytes, |r, s, p| volume::measure(r, s, &volume::layers(r), p)),
    volume("angle", "degrees a head has gone around, by method and layers", Cost::None, |r, s, p| volume::measure(r, s, &volume::angles(r), p)),
    volume("density", "factor on the extinction, by method", Cost::None, |r, s, p| volume::measure(r, s, &volume::densities(r), p)),
    volume("volume-compression", "bits of the planes of layers", Cost::Bytes, |r, s, p| volume::measure(r, s, &volume::compressions(r), p)),
    stream("color", "how colour travels", Cost::Bytes, |r, s, p| stream::measure(r, s, &stream::colors(r), p)),
    stream("depth-bound", "what is promised about depth, in displayed pixels", Cost::Bytes, |r, s, p| stream::measure(r, s, &stream::depth_bounds(r), p)),
    stream("child-bound", "how much coarser depths of children may be", Cost::Bytes, |r, s, p| stream::measure(r, s, &stream::child_bounds(r), p)),
    stream("zstd-level", "effort of the general compressor", Cost::Time, |r, s, p| stream::measure(r, s, &stream::zstd_levels(r), p)),
];

/// Why there is no sweep.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// Nobody knows this knob.
    #[error("KNOB: expected one of {}, found '{found}'", names())]
    UnknownKnob {
        /// What was asked for.
        found: String,
    },
    /// The knob is not turned on this scene.
    #[error("--scene: expected one of {expected} for knob {knob}, found '{found}'")]
    UnknownScene {
        /// The knob.
        knob: &'static str,
        /// Its scenes.
        expected: String,
        /// What was asked for.
        found: String,
    },
    /// A scene that is none, or that has nothing to be swept.
    #[error("{0}")]
    Scene(String),
    /// A strip just encoded was refused.
    #[error("decoding a frame just encoded: {0}")]
    Wire(#[from] DecodeError),
}

/// Names of all knobs.
pub fn names() -> String {
    KNOBS.iter().map(|knob| knob.name).collect::<Vec<_>>().join(", ")
}

impl Knob {
    /// The knob of this name.
    ///
    /// # Errors
    /// There is none.
    pub fn named(name: &str) -> Result<&'static Knob, SweepError> {
        let unknown = || SweepError::UnknownKnob { found: name.to_owned() };
        KNOBS.iter().find(|knob| knob.name == name).ok_or_else(unknown)
    }

    /// Turns the knob on one scene, or on all it can be turned on; one of volumes or of the codec on any other scene, too.
    ///
    /// # Errors
    /// A scene that it cannot be turned on.
    pub fn sweep(
        &'static self,
        request: &Request<'_>,
        scene: Option<&str>,
        progress: &mut dyn FnMut(&str, u64, u64),
    ) -> Result<Sweep, SweepError> {
        let scenes: Vec<&str> = match scene {
            None => self.scenes.to_vec(),
            Some(scene) if self.takes_any || self.scenes.contains(&scene) => vec![scene],
            Some(scene) => {
                let (expected, found) = (self.scenes.join(", "), scene.to_owned());
                return Err(SweepError::UnknownScene { knob: self.name, expected, found });
            }
        };
        let mut points = Vec::new();
        let mut resumes = Vec::new();
        for scene in &scenes {
            let mut curve = (self.measure)(request, scene, &mut |done, all| progress(scene, done, all))?;
            pareto::mark(&mut curve, self.cost);
            resumes.push(pareto::resume(&curve, self.cost, self.metric));
            points.extend(curve);
        }
        let resume = match (&scenes[..], &resumes[..]) {
            (_, [resume]) => resume.clone(),
            (scenes, resumes) => {
                let named: Vec<String> =
                    scenes.iter().zip(resumes).map(|(scene, resume)| format!("{scene}: {resume}")).collect();
                named.join("; ")
            }
        };
        Ok(Sweep {
            schema: SCHEMA,
            knob: self.name.to_owned(),
            scene: scene.unwrap_or("all").to_owned(),
            metric: self.metric.to_owned(),
            cost: self.cost,
            size: [request.size.width, request.size.height],
            runs: request.runs,
            points,
            resume,
        })
    }
}

#[cfg(test)]
mod tests;
