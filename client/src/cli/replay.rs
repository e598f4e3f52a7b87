//! `replay`: the main job.

use super::Failure;
use super::budget::BudgetArgs;
use super::coding::CodingArgs;
use super::optics::OpticsArgs;
use super::strip;
use super::trust::TrustArgs;
use crate::display::beside;
use crate::embedded;
use crate::link::LinkModel;
use crate::measure::compare;
use crate::net::Endpoint;
use crate::replay::{
    AssessedRefresh, Circumstances, ModelledTimes, Progress, ReplayPlan, assess, report_from, run_real, run_virtual,
};
use crate::report::page::{PageInput, PictureSet, write_page};
use crate::report::{ClockKind, summary};
use crate::trace::Trace;
use crate::warp::{Mode, Normals, Solver};
use anyhow::Context;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Parser, ValueEnum};
use image::RgbImage;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use warplight_protocol::camera::Projection;
use warplight_protocol::frame::Plan;
use warplight_protocol::message::{Prediction, Viewport};
use warplight_protocol::{Camera, ImageSize};
use warplight_server::metrics::{Metrics, http};
use warplight_server::scene::Scene;
use warplight_server::service::{DEFAULT_GUARD_DEG, DEFAULT_MAX_DEPTH, Estimator, Service, ServiceOptions, guard_deg};
use warplight_server::session::SampleBudget;

/// Compared refreshes of a replay by default: each costs a converged picture.
const DEFAULT_COMPARISONS: f64 = 6.0;
/// Pictures of more refreshes than these would make the page heavy.
const MAX_PICTURE_SETS: usize = 4;
/// Seconds replayed by default.
const DEFAULT_DURATION_S: f64 = 12.0;

/// Which clock a replay runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Clock {
    /// Real TCP and real time.
    Real,
    /// Discrete events over a modelled link: the same seed gives the same report to the byte.
    Virtual,
}

/// Something that is done or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Switch {
    /// It is done.
    On,
    /// It is not.
    Off,
}

/// What frames show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum View {
    /// What the display shows, and more on the sides to which the head turns.
    Plane,
    /// Everything around the head, on the six faces of a cube.
    Cube,
}

/// Arguments of `replay`.
#[derive(Debug, Args)]
pub(super) struct ReplayArgs {
    /// Server to connect to (host:port); without it a server is started inside this process.
    #[arg(long, value_name = "ADDR")]
    connect: Option<String>,
    #[command(flatten)]
    trust: TrustArgs,
    /// Scene of the embedded server: a built-in name, or a path to scene.toml, .glb or .gltf.
    #[arg(long, value_name = "S", conflicts_with = "connect")]
    scene: Option<String>,
    /// Head trace (TUM text); without it the built-in one.
    #[arg(long, value_name = "F.tum")]
    trace: Option<PathBuf>,
    /// How a frame is brought to the pose of the display.
    #[arg(long, default_value = Mode::Specular.name(), value_parser = modes())]
    mode: Mode,
    /// How mode `specular` searches what boundaries show: frozen-distance[:STEPS], gauss-newton[:STEPS],
    /// descent[:STEPS], image-distance or unfolded.
    #[arg(long, default_value = "frozen-distance", value_name = "SOLVER")]
    solver: Solver,
    /// Where mode `specular` has its normals from: transmitted, from-depth-gaussian or from-depth-bilateral.
    #[arg(long, default_value = Normals::Transmitted.name(), value_name = "NORMALS")]
    normals: Normals,
    /// How the server continues the motion of the head: none, constant (velocity), damped (turns die away) or adaptive (by
    /// what would have served this head best of late).
    #[arg(long, default_value = Prediction::Adaptive.name(), value_parser = predictions())]
    prediction: Prediction,
    /// Frames before the latest that are asked for what that does not know, 0 to 4.
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=4))]
    earlier_frames: u8,
    /// Which clock runs.
    #[arg(long, value_enum, default_value_t = Clock::Real)]
    clock: Clock,
    /// Modelled delay each way in milliseconds (virtual clock) [default: 20].
    #[arg(long, value_parser = non_negative)]
    latency_ms: Option<f64>,
    /// Modelled jitter either way in milliseconds (virtual clock) [default: 0].
    #[arg(long, value_parser = non_negative)]
    jitter_ms: Option<f64>,
    /// Modelled rate in megabits per second (virtual clock) [default: unlimited].
    #[arg(long, value_parser = positive)]
    rate_mbps: Option<f64>,
    /// The modelled link stands still for so many milliseconds, again and again (virtual clock) [default: 0].
    #[arg(long, value_parser = non_negative)]
    stall_ms: Option<f64>,
    /// From the start of one stall to the next in milliseconds (virtual clock) [default: 5000].
    #[arg(long, value_parser = positive, requires = "stall_ms")]
    stall_every_ms: Option<f64>,
    /// Seconds from connecting after which the modelled link is cut: what is under way is lost, and the client must connect
    /// again (virtual clock).
    #[arg(long, value_parser = positive)]
    cut_at_s: Option<f64>,
    /// Seconds for which it is cut (virtual clock) [default: 3].
    #[arg(long, value_parser = positive, requires = "cut_at_s")]
    cut_s: Option<f64>,
    /// Size of frames and display.
    #[arg(long, default_value = "384x384", value_name = "WxH")]
    size: ImageSize,
    /// Vertical field of view in degrees.
    #[arg(long, default_value_t = 80.0, value_parser = field_of_view)]
    fov_deg: f64,
    /// Frames asked of the server per second.
    #[arg(long, default_value_t = 10.0, value_parser = rate)]
    frame_hz: f64,
    /// Refreshes of the display per second.
    #[arg(long, default_value_t = 60.0, value_parser = rate)]
    display_hz: f64,
    /// Seconds to replay [default: the trace, at most 12].
    #[arg(long, value_parser = positive)]
    duration_s: Option<f64>,
    /// Compare every N-th refresh with the server's converged picture; 0 for none [default: 6 in all].
    #[arg(long, value_name = "N")]
    quality_every: Option<u64>,
    /// Samples per pixel of the converged picture.
    #[arg(long, default_value_t = 48, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    quality_spp: u32,
    /// Samples per pixel of a frame; on the real clock the default is what the time budget allows, on the
    /// virtual one 8.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=4096))]
    spp: Option<u32>,
    /// Time the embedded server has for a frame in milliseconds: frames have as many pixels, nodes and samples as fit
    /// [default: all pixels and nodes, and samples for 80 % of the frame interval].
    #[arg(long, value_parser = positive)]
    time_budget_ms: Option<f64>,
    /// Longest light path of the embedded server in segments.
    #[arg(long, default_value_t = DEFAULT_MAX_DEPTH, value_parser = clap::value_parser!(u32).range(1..=1000))]
    max_depth: u32,
    /// Nodes of a frame of the embedded server, as D,R,F,FF,FFR; by default those that the scene calls for.
    #[arg(long, value_name = "NODES", conflicts_with = "connect")]
    plan: Option<Plan>,
    /// Modes to compare, such as diffuse,specular [default: all].
    #[arg(long, value_name = "MODES", value_delimiter = ',', value_parser = modes())]
    modes: Vec<Mode>,
    #[command(flatten)]
    budget: BudgetArgs,
    #[command(flatten)]
    optics: OpticsArgs,
    /// Also write reference, diffuse and specular side by side as PNG, from the compared refresh in which the two modes
    /// differ most.
    #[arg(long, value_name = "F.png")]
    strip: Option<PathBuf>,
    /// What frames show.
    #[arg(long, value_enum, default_value_t = View::Plane)]
    viewport: View,
    /// Widest band that frames of the embedded server show beyond each side of a display that turns, in degrees; 0 for
    /// none [default: 12].
    #[arg(long, value_name = "MAX", conflicts_with = "connect", value_parser = guard_deg)]
    guard_deg: Option<f64>,
    #[command(flatten)]
    coding: CodingArgs,
    /// Tell figures while it runs, as Prometheus text at http://ADDR/metrics; a loopback address.
    #[arg(long, value_name = "ADDR")]
    metrics: Option<SocketAddr>,
    /// Whether rate, size and coding of frames give way where link or client cannot keep up.
    #[arg(long, value_enum, default_value_t = Switch::On)]
    adapt: Switch,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder for index.html and report.json.
    #[arg(long, default_value = "out")]
    out: PathBuf,
    /// Print report.json on stdout instead of a summary.
    #[arg(long)]
    json: bool,
}

impl Default for ReplayArgs {
    /// What clap makes of an empty command line.
    fn default() -> ReplayArgs {
        #[derive(Parser)]
        struct Alone {
            #[command(flatten)]
            replay: ReplayArgs,
        }
        Alone::parse_from(["replay"]).replay
    }
}

/// A mode as a value; of volumes alone one would say `layers` for `specular`.
fn named(mode: Mode) -> PossibleValue {
    let value = PossibleValue::new(mode.name());
    if mode == Mode::Specular { value.alias("layers") } else { value }
}

fn modes() -> impl TypedValueParser<Value = Mode> {
    PossibleValuesParser::new(Mode::ALL.map(named)).try_map(|name| name.parse::<Mode>())
}

fn predictions() -> impl TypedValueParser<Value = Prediction> {
    PossibleValuesParser::new(Prediction::ALL.map(Prediction::name))
        .map(|name| Prediction::ALL.into_iter().find(|prediction| prediction.name() == name).unwrap_or_default())
}

pub(super) fn number(text: &str, expected: &str, accepts: impl Fn(f64) -> bool) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if accepts(value) => Ok(value),
        _ => Err(format!("expected {expected}")),
    }
}

pub(super) fn positive(text: &str) -> Result<f64, String> {
    number(text, "a number above 0, at most 86400", |value| value > 0.0 && value <= 86_400.0)
}

fn non_negative(text: &str) -> Result<f64, String> {
    number(text, "a number from 0 to 60000", |value| (0.0..=60_000.0).contains(&value))
}

pub(super) fn rate(text: &str) -> Result<f64, String> {
    number(text, "a rate from 0.01 to 1000 Hz", |value| (0.01..=1000.0).contains(&value))
}

pub(super) fn field_of_view(text: &str) -> Result<f64, String> {
    number(text, "an angle from 1 to 170 degrees", |value| (1.0..=170.0).contains(&value))
}

/// Runs the command.
pub(super) fn run(arguments: &ReplayArgs) -> Result<(), Failure> {
    let mut plan = plan_of(arguments)?;
    let scene = arguments.connect.is_none().then(|| scene_of(arguments));
    let known = arguments.budget.model(scene)?;
    plan.budget = arguments.budget.plan(&known);
    let bar = bar(arguments.json);
    let mut progress = |step| show(&bar, step);
    let mut warnings: Vec<String> = known.warning.iter().cloned().collect();
    let known = Arc::new(Mutex::new(known));
    let (recording, link) = match arguments.clock {
        Clock::Virtual => {
            let service = service_of(arguments, 0, &mut warnings)?;
            let link = link_of(arguments);
            let times = ModelledTimes { render: time_budget(arguments), ..ModelledTimes::default() };
            (run_virtual(&plan, service, link, times, arguments.seed, &mut progress)?, Some(link))
        }
        Clock::Real => {
            let modelled = [
                ("--latency-ms", arguments.latency_ms),
                ("--jitter-ms", arguments.jitter_ms),
                ("--rate-mbps", arguments.rate_mbps),
                ("--stall-ms", arguments.stall_ms),
                ("--cut-at-s", arguments.cut_at_s),
            ];
            if let Some((flag, _)) = modelled.iter().find(|(_, value)| value.is_some()) {
                return Err(Failure::Input(format!("{flag}: it models a link, which needs --clock virtual")));
            }
            let endpoint = match &arguments.connect {
                Some(address) => arguments.trust.endpoint(address)?,
                None => {
                    // The display keeps a core to itself.
                    let cores = std::thread::available_parallelism().map_or(1, usize::from);
                    let mut service = service_of(arguments, cores.saturating_sub(1).max(1), &mut warnings)?;
                    if arguments.time_budget_ms.is_some() {
                        service.choose_points(known.clone());
                    }
                    Endpoint::plain(embedded::start(service).context("starting the embedded server")?.to_string())
                }
            };
            let recording = run_real(&plan, endpoint, &mut progress)?;
            if let Some(budget) = &recording.budget {
                known.lock().unwrap_or_else(PoisonError::into_inner).refresh(Some(budget.chooser()), None)?;
            }
            (recording, None)
        }
    };
    let quality = assess(&recording, &plan, &mut progress)?;
    bar.finish_and_clear();

    let circumstances = Circumstances {
        trace: arguments.trace.as_ref().map_or_else(|| "built-in".to_owned(), |path| path.display().to_string()),
        seed: arguments.seed,
        clock: if arguments.clock == Clock::Virtual { ClockKind::Virtual } else { ClockKind::Real },
        link,
        warnings,
    };
    let report = report_from(&plan, &recording, &quality, circumstances);
    std::fs::create_dir_all(&arguments.out).with_context(|| format!("{}", arguments.out.display()))?;
    let json_path = arguments.out.join("report.json");
    report.write(&json_path).with_context(|| format!("{}", json_path.display()))?;
    if let Some(path) = &arguments.strip {
        strip::write(path, &quality, &report.trace)?;
    }
    let page_path = arguments.out.join("index.html");
    let pictures = pictures_of(quality)?;
    write_page(&page_path, PageInput { report: &report, pictures: &pictures })
        .with_context(|| format!("{}", page_path.display()))?;
    if arguments.json {
        println!("{}", report.to_json().context("report.json")?);
    } else {
        println!("{}", summary(&report, &page_path));
    }
    Ok(())
}

fn plan_of(arguments: &ReplayArgs) -> Result<ReplayPlan, Failure> {
    if arguments.clock == Clock::Virtual && arguments.connect.is_some() {
        return Err(Failure::Input(
            "--connect: a server elsewhere has a clock of its own; use --clock real".to_owned(),
        ));
    }
    let projection = match arguments.viewport {
        View::Plane => Projection::Perspective,
        View::Cube => Projection::Cube,
    };
    let unable = arguments.modes.iter().chain([&arguments.mode]).find(|mode| !mode.shows(projection));
    if let Some(mode) = unable {
        let able = Mode::ALL.into_iter().filter(|mode| mode.shows(projection)).map(Mode::name);
        return Err(Failure::Input(format!(
            "--viewport cube: mode {} knows one plane only, expected {}",
            mode.name(),
            able.collect::<Vec<_>>().join(", ")
        )));
    }
    let trace = match &arguments.trace {
        Some(path) => Trace::read(path)?,
        None => Trace::built_in(),
    };
    let duration_s = arguments.duration_s.unwrap_or(DEFAULT_DURATION_S).min(trace.duration_secs());
    let spacing = (duration_s * arguments.display_hz / DEFAULT_COMPARISONS).max(1.0) as u64;
    let is_compared = |mode: &Mode| arguments.modes.is_empty() || arguments.modes.contains(mode);
    if arguments.strip.is_some() && !strip::MODES.iter().all(is_compared) {
        return Err(Failure::Input("--strip: it shows diffuse and specular, so --modes must name both".to_owned()));
    }
    Ok(ReplayPlan {
        trace,
        duration: Duration::from_secs_f64(duration_s),
        camera: Camera::symmetric((arguments.fov_deg as f32).to_radians(), arguments.size),
        frame_hz: arguments.frame_hz,
        display_hz: arguments.display_hz,
        viewport: match arguments.viewport {
            View::Plane => Viewport::Plane,
            View::Cube => Viewport::Cube,
        },
        mode: arguments.mode,
        solver: arguments.solver,
        normals: arguments.normals,
        earlier_frames: usize::from(arguments.earlier_frames),
        format: arguments.coding.format(),
        target_kbps: arguments.coding.target_kbps(),
        prediction: arguments.prediction,
        adapt: arguments.adapt == Switch::On,
        metrics: arguments.metrics.map(metrics_at).transpose()?,
        modes: Mode::ALL.into_iter().filter(|mode| is_compared(mode) && mode.shows(projection)).collect(),
        optics: arguments.optics.optics(),
        quality_every: arguments.quality_every.unwrap_or(spacing),
        quality_spp: arguments.quality_spp,
        budget: None,
    })
}

/// Figures that are told at a loopback address while the replay runs.
fn metrics_at(address: SocketAddr) -> Result<Arc<Metrics>, Failure> {
    if !address.ip().is_loopback() {
        return Err(Failure::Input(format!("--metrics {address}: anyone may read them: expected a loopback address")));
    }
    let metrics = Arc::new(Metrics::default());
    let at = http::serve(address, metrics.clone())
        .map_err(|error| Failure::Input(format!("--metrics {address}: {error}")))?;
    tracing::info!("figures at http://{at}/metrics");
    Ok(metrics)
}

fn time_budget(arguments: &ReplayArgs) -> Duration {
    Duration::from_secs_f64(arguments.time_budget_ms.unwrap_or(800.0 / arguments.frame_hz) * 1e-3)
}

fn scene_of(arguments: &ReplayArgs) -> &str {
    arguments.scene.as_deref().unwrap_or(warplight_server::scene::DEFAULT_SCENE)
}

fn service_of(arguments: &ReplayArgs, threads: usize, warnings: &mut Vec<String>) -> Result<Service, Failure> {
    const VIRTUAL_SPP: u32 = 8;
    let scene = Scene::load(scene_of(arguments))?;
    warnings.extend(scene.warnings.iter().cloned());
    let samples = match (arguments.spp, arguments.clock) {
        (Some(spp), _) => SampleBudget::Samples(spp),
        (None, Clock::Virtual) => SampleBudget::Samples(VIRTUAL_SPP),
        (None, Clock::Real) => SampleBudget::Time(time_budget(arguments)),
    };
    let (estimator, max_depth, seed) = (Estimator::default(), arguments.max_depth, arguments.seed);
    let plan = arguments.plan.clone();
    let guard_deg = arguments.guard_deg.unwrap_or(DEFAULT_GUARD_DEG);
    let options = ServiceOptions { samples, estimator, max_depth, seed, threads, still_threads: 0, plan, guard_deg };
    Ok(Service::new(scene, options).context("starting the rendering threads")?)
}

fn link_of(arguments: &ReplayArgs) -> LinkModel {
    const DEFAULT_LATENCY_MS: f64 = 20.0;
    const DEFAULT_STALL_EVERY_MS: f64 = 5000.0;
    const DEFAULT_CUT_S: f64 = 3.0;
    let millis = |value: f64| Duration::from_secs_f64(value * 1e-3);
    LinkModel {
        latency: millis(arguments.latency_ms.unwrap_or(DEFAULT_LATENCY_MS)),
        jitter: millis(arguments.jitter_ms.unwrap_or(0.0)),
        rate_bits_per_sec: arguments.rate_mbps.map(|rate| rate * 1e6),
        stall: arguments
            .stall_ms
            .map(|stall| (millis(arguments.stall_every_ms.unwrap_or(DEFAULT_STALL_EVERY_MS)), millis(stall))),
        cut: arguments.cut_at_s.map(|at| (millis(1e3 * at), millis(1e3 * arguments.cut_s.unwrap_or(DEFAULT_CUT_S)))),
    }
}

fn pictures_of(quality: crate::replay::QualityRun) -> Result<Vec<PictureSet>, Failure> {
    // The two eyes of a refresh follow each other.
    let refreshes: Vec<&[AssessedRefresh]> = quality.refreshes.chunk_by(|a, b| a.time == b.time).collect();
    let every = refreshes.len().div_ceil(MAX_PICTURE_SETS).max(1);
    refreshes.into_iter().skip(every / 2).step_by(every).map(picture_set).collect()
}

/// A refresh as the page shows it: the picture of the one eye, or those of both side by side.
fn picture_set(eyes: &[AssessedRefresh]) -> Result<PictureSet, Failure> {
    let all =
        |of: &dyn Fn(&AssessedRefresh) -> RgbImage| eyes.iter().map(of).reduce(|left, right| beside(&left, &right));
    let reference = all(&|eye| eye.reference.clone()).unwrap_or_default();
    let (first, of_both) = (&eyes[0], if eyes.len() > 1 { ", both eyes" } else { "" });
    let mut modes = Vec::new();
    for (index, assessment) in first.modes.iter().enumerate() {
        let picture = all(&|eye| eye.modes[index].picture.clone()).unwrap_or_default();
        let map = all(&|eye| eye.modes[index].compared.map.to_magma()).unwrap_or_default();
        let error = match eyes {
            [_] => assessment.compared.error,
            _ => compare(&reference, &picture, None).context("comparing both eyes")?.error,
        };
        modes.push((assessment.mode.name().to_owned(), picture, map, error));
    }
    let time_s = first.time.as_secs_f64();
    Ok(PictureSet { title: format!("{time_s:.1} s into the trace{of_both}"), time_s, reference, modes })
}

fn bar(quiet: bool) -> ProgressBar {
    if quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg:>12} {wide_bar} {pos}/{len} {eta:>4}");
    ProgressBar::new(1).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn show(bar: &ProgressBar, step: Progress) {
    let (message, done, all) = match step {
        Progress::Connecting => ("connecting", 0, 1),
        Progress::Displaying(done, all) => ("displaying", done, all),
        Progress::Reference(done, all) => ("reference", done, all),
        Progress::Comparing(done, all) => ("comparing", done, all),
    };
    if bar.length() != Some(all) || done == 0 {
        bar.set_length(all);
        bar.set_message(message);
        bar.reset_eta();
    }
    bar.set_position(done);
}
