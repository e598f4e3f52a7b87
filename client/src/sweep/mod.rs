//! `sweep`: what accuracy costs, as a curve over one knob.
//!
//! A [`Knob`] is something that can be turned: it has a name, scenes it can be turned on, an error with a unit, what it
//! is bought with ([`Cost`]), and a function that measures its points on one scene. [`KNOBS`] is the table of all;
//! a stage adds its own by a row, and gets table, plot, JSON, Pareto front and resume without further ado. Those of the
//! surface warp are in `surface`, of volumes in `volume`, of the codec in `stream`, of the renderer in `render`, of a whole
//! session in `session`, of the head in `head`; what the points say is in `pareto`, what is written in [`write`], all knobs at
//! once in [`Sweeps`].
//!
//! Time comes in as an argument, [`Request::now`]: the command reads the clock. Errors and bytes of a sweep are the
//! same in every run, times are not; within one sweep the settings of a format take turns, so that ratios hold where
//! another program comes and goes.

mod all;
mod head;
mod holes;
mod pareto;
mod points;
mod precision;
mod render;
mod session;
mod settings;
mod stream;
mod surface;
mod volume;
mod write;

pub use all::{Conditions, Machine, Sweeps, date_from_unix};
pub use write::{table, write_files};

use crate::trace::Trace;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use warplight_protocol::ImageSize;
use warplight_protocol::budget::PointCost;
use warplight_protocol::codec::DecodeError;
use warplight_server::costs::CostTable;

/// Version of the document's form.
pub const SCHEMA: u32 = 1;

/// Scenes of a quick sweep, where they have to be rendered: the first of each knob, which are unlike each other.
const QUICK_SCENES: usize = 2;

/// What is measured, and how thoroughly.
#[derive(Clone, Copy)]
pub struct Request<'a> {
    /// Size of frames and display.
    pub size: ImageSize,
    /// Timed runs of each setting.
    pub runs: u32,
    /// Fewer settings, and fewer scenes where none is asked for.
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
    /// Milliseconds: of the client, or where the knob is the server's, of that.
    Time,
    /// Bytes of a frame.
    Bytes,
    /// Both: what is better in neither is not worth having.
    Both,
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
    /// Of a frame; of a second where the knob is how many there are in one; 0 where none is sent.
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
            // Bytes are the same in every run; of settings that have the same, time tells.
            Cost::Bytes | Cost::Both => self.bytes as f64,
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
    /// The table that a budget chooses from, of one scene's points, and whether it is that of the display; `None` of knobs
    /// that no budget chooses by.
    pub fn cost_table(&self, points: &[Point]) -> Option<(CostTable, bool)> {
        let is_display = match self.knob.as_str() {
            "display-point" => true,
            "frame-point" => false,
            _ => return None,
        };
        let cost = |point: &Point| PointCost {
            point: point.value.clone(),
            error: point.error,
            time_ms: point.time_ms,
            spread_ms: point.time_spread_ms,
        };
        let pixels = u64::from(self.size[0]) * u64::from(self.size[1]);
        Some((CostTable { metric: self.metric.clone(), pixels, points: points.iter().map(cost).collect() }, is_display))
    }

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
    /// Longest side of frames and display that it is measured at, and that of a quick sweep.
    pub most_side_px: [u32; 2],
    measure: Measure,
}

/// As large as is asked for.
const ANY_SIZE: [u32; 2] = [u32::MAX; 2];

/// A knob of the surface warp, on scenes in closed form.
const fn surface(name: &'static str, about: &'static str, cost: Cost, measure: Measure) -> Knob {
    Knob {
        name,
        about,
        cost,
        metric: "deg",
        scenes: &surface::SCENES,
        takes_any: false,
        most_side_px: ANY_SIZE,
        measure,
    }
}

/// A knob of volumes, on scenes with media.
const fn volume(name: &'static str, about: &'static str, cost: Cost, measure: Measure) -> Knob {
    Knob {
        name,
        about,
        cost,
        metric: "DSSIM",
        scenes: &volume::SCENES,
        takes_any: true,
        most_side_px: ANY_SIZE,
        measure,
    }
}

/// A knob of the codec, on live frames along a trace.
const fn stream(name: &'static str, about: &'static str, cost: Cost, measure: Measure) -> Knob {
    Knob {
        name,
        about,
        cost,
        metric: "FLIP",
        scenes: &stream::SCENES,
        takes_any: true,
        most_side_px: ANY_SIZE,
        measure,
    }
}

/// A knob of a march through volumes, or of their layering.
const fn march(name: &'static str, about: &'static str, metric: &'static str, measure: Measure) -> Knob {
    let (scenes, most_side_px) = (&volume::DETAILED, volume::DETAILED_SIDE_PX);
    Knob { name, about, cost: Cost::Time, metric, scenes, takes_any: true, most_side_px, measure }
}

/// A knob of the renderer, against converged pictures.
const fn render(name: &'static str, about: &'static str, scenes: &'static [&'static str], measure: Measure) -> Knob {
    let metric = "relative MSE";
    Knob { name, about, cost: Cost::Time, metric, scenes, takes_any: true, most_side_px: render::SIDE_PX, measure }
}

/// A knob of a session, from the server to the display.
const fn session(name: &'static str, about: &'static str, scenes: &'static [&'static str], measure: Measure) -> Knob {
    let (metric, cost, most_side_px) = ("FLIP", Cost::Bytes, session::SIDE_PX);
    Knob { name, about, cost, metric, scenes, takes_any: true, most_side_px, measure }
}

/// A knob of heads or numbers, on settings of its own instead of scenes.
const fn head(
    name: &'static str,
    about: &'static str,
    cost: Cost,
    metric: &'static str,
    scenes: &'static [&'static str],
    measure: Measure,
) -> Knob {
    Knob { name, about, cost, metric, scenes, takes_any: false, most_side_px: ANY_SIZE, measure }
}

/// The points that a budget chooses from, on live frames along a trace.
const fn point(name: &'static str, about: &'static str, measure: Measure) -> Knob {
    Knob {
        name,
        about,
        cost: Cost::Time,
        metric: "FLIP",
        scenes: &points::SCENES,
        takes_any: true,
        most_side_px: [512, 512],
        measure,
    }
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
    Knob { scenes: &stream::DARK_AND_BRIGHT, ..stream("color-format", "what a colour is rounded to", Cost::Bytes, |r, s, p| stream::measure(r, s, &stream::color_formats(), p)) },
    Knob { scenes: &holes::SCENES, ..stream("hole-filling", "what is put where a frame knows nothing", Cost::Time, holes::measure) },
    head("pose-format", "how a head's pose travels, by distance from the origin", Cost::Bytes, "px", &head::DISTANCES, head::pose_formats),
    head("prediction", "by which law a head's motion is continued for 60 ms", Cost::Time, "deg", &head::TRACES, head::predictions),
    head("horizon", "milliseconds a head's motion is continued for", Cost::None, "deg", &head::TRACES, head::horizons),
    head("precision", "how many bits: f32 and f64, forms of poses, of colour and of depth", Cost::Both, "FLIP", &precision::SCENES, precision::measure),
    stream("zstd-level", "effort of the general compressor", Cost::Time, |r, s, p| stream::measure(r, s, &stream::zstd_levels(r), p)),
    render("spp", "samples per pixel of a path-traced picture", &render::STILL_SCENES, render::spp),
    render("path-depth", "segments of the longest path", &render::DEPTH_SCENES, render::path_depth),
    render("denoiser", "how live frames find their light, and paths per pixel", &render::LIVE_SCENES, |r, s, p| render::denoiser(r, s, &render::estimators(r), p)),
    session("tree-depth", "nodes of a frame", &session::SCENES, |r, s, p| session::measure(r, s, &session::tree_depths(r), p)),
    session("resolution", "sides of a frame, in percent of the display's", &session::ROOM, |r, s, p| session::measure(r, s, &session::resolutions(r), p)),
    session("frame-rate", "frames per second; bytes and the server's time in one", &session::ROOM, |r, s, p| session::measure(r, s, &session::frame_rates(r), p)),
    march("march-step", "voxels of a step of the server", "relative error", volume::march_steps),
    Knob { most_side_px: volume::STRIDE_SIDE_PX, ..march("march-stride", "pixels of a step of the client", "DSSIM", volume::march_strides) },
    march("layering", "rule by which volumes are cut to layers", "DSSIM", |r, s, p| volume::measure_rules(r, s, &volume::rules(r), p)),
    point("display-point", "what the display's budget chooses from: steps and pixels of the warp", points::of_display),
    point("frame-point", "what the server's budget chooses from: pixels and nodes of a frame", points::of_frame),
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
    /// What was measured cannot be kept.
    #[error("{0}")]
    Write(String),
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

    /// The scenes of a sweep: the one asked for, or the knob's own, fewer of them where it is to be quick.
    fn scenes_of<'a>(&self, request: &Request<'_>, scene: Option<&'a str>) -> Result<Vec<&'a str>, SweepError> {
        match scene {
            None => {
                // Scenes in closed form, poses and places take no time to set up.
                let count = if request.quick && self.takes_any { QUICK_SCENES } else { usize::MAX };
                Ok(self.scenes.iter().copied().take(count).collect())
            }
            Some(scene) if self.takes_any || self.scenes.contains(&scene) => Ok(vec![scene]),
            Some(scene) => {
                let (expected, found) = (self.scenes.join(", "), scene.to_owned());
                Err(SweepError::UnknownScene { knob: self.name, expected, found })
            }
        }
    }

    /// Turns the knob on one scene, or on its own ([`Knob::scenes`], the first two of those that are rendered where it is to be quick); one that
    /// [takes any](Knob::takes_any) on every other scene, too. Where the size asked for is more than the knob is measured at, it
    /// is measured at that, and the sweep says so.
    ///
    /// # Errors
    /// A scene that it cannot be turned on.
    pub fn sweep(
        &'static self,
        request: &Request<'_>,
        scene: Option<&str>,
        progress: &mut dyn FnMut(&str, u64, u64),
    ) -> Result<Sweep, SweepError> {
        let scenes = self.scenes_of(request, scene)?;
        let most = self.most_side_px[usize::from(request.quick)];
        let request = &Request { size: shrunk(request.size, most), ..*request };
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

/// The size with its longest side at most so long.
fn shrunk(size: ImageSize, most: u32) -> ImageSize {
    let longest = size.width.max(size.height);
    if longest <= most {
        return size;
    }
    let side = |side: u32| ((u64::from(side) * u64::from(most) / u64::from(longest)) as u32).max(1);
    ImageSize::new(side(size.width), side(size.height))
}

#[cfg(test)]
mod tests;
