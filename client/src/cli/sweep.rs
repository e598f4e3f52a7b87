//! `sweep`: accuracy against cost for one knob, as table, plots and JSON; for all of them as a page.

use super::Failure;
use crate::sweep::{
    Conditions, KNOBS, Knob, Machine, Request, Sweep, SweepError, Sweeps, date_from_unix, names, table, write_files,
};
use crate::trace::Trace;
use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::{Instant, SystemTime};
use warplight_protocol::ImageSize;
use warplight_server::costs::{CostFile, CostModel};

/// Timed runs of each setting by default, and of a quick sweep.
const RUNS: [u32; 2] = [9, 3];
/// Width and height by default, and of a quick sweep: errors depend on it, since differences over texels do.
const SIDE_PX: [u32; 2] = [1024, 512];
/// Most pixels of a frame: all planes of several frames are held at once.
const MAX_PIXELS: usize = 4096 * 4096;

/// Steps of the bar of all knobs.
const STEPS_OF_ALL: u64 = 1000;
/// Knobs whose points budgets choose from.
const BUDGETED: [&str; 2] = ["display-point", "frame-point"];

/// Arguments of `sweep`.
#[derive(Debug, Args)]
pub(super) struct SweepArgs {
    /// What is turned: solver, steps, normals, depth-bits, depth-coding, frame-age, head-translation, layers, angle, density, volume-compression, color, depth-bound, child-bound, zstd-level, spp, path-depth, denoiser, tree-depth, resolution, frame-rate, march-step, march-stride, layering, color-format, hole-filling, pose-format, prediction, horizon, precision, display-point, frame-point, or all of them.
    #[arg(value_name = "KNOB")]
    knob: Option<String>,
    /// Scene: mirror, chrome-ball, water or glass-ball; of a knob of volumes cube, cloud, phantom, shells or any other scene
    /// with media; of a knob of the codec, the renderer or the session gallery, pool, glass or any other scene; each other knob says which [default: all, the first two of those that are rendered with --quick].
    #[arg(long, value_name = "S")]
    scene: Option<String>,
    /// Of all: only these knobs.
    #[arg(long, value_name = "KNOB,...", value_delimiter = ',')]
    only: Vec<String>,
    /// Head trace (TUM text) of knob frame-age and of those of the codec, the renderer and the session; without it the built-in one.
    #[arg(long, value_name = "F.tum")]
    trace: Option<PathBuf>,
    /// Size of frames and display [default: 1024x1024, 512x512 with --quick]; knobs that are measured against path-traced
    /// pictures or fine steps take less, and say how much.
    #[arg(long, value_name = "WxH")]
    size: Option<ImageSize>,
    /// Timed runs of each setting [default: 9, 3 with --quick].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: Option<u32>,
    /// Folder for sweep-KNOB.json and plots; of all also index.html, accuracy.md and accuracy.json [default of all: out/accuracy].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Folder for the planes of a volume's layers of one --scene, as raw floats in DIR/source; what another codec made of
    /// them in a folder beside, with its size in a file `bytes`, is measured with the knob's own settings.
    #[arg(long, value_name = "DIR", requires = "scene")]
    planes: Option<PathBuf>,
    /// Samples per pixel of converged pictures: with them knobs of the codec also tell the FLIP to what
    /// is really seen, and those of the session have cleaner ones than by default.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=65_536))]
    reference_spp: u32,
    /// Write what display-point or frame-point measured into the cost model that budgets choose from: this file, or without
    /// one that beside each scene (of a built-in one in the user's cache).
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    model: Option<Option<PathBuf>>,
    /// Fewer settings, smaller frames.
    #[arg(long)]
    quick: bool,
    /// Print one JSON document instead of the table.
    #[arg(long)]
    json: bool,
}

impl From<SweepError> for Failure {
    fn from(error: SweepError) -> Failure {
        match error {
            SweepError::Wire(_) | SweepError::Write(_) => Failure::Run(error.into()),
            SweepError::UnknownKnob { .. } | SweepError::UnknownScene { .. } | SweepError::Scene(_) => {
                Failure::Input(error.to_string())
            }
        }
    }
}

/// Runs the command.
pub(super) fn run(arguments: &SweepArgs) -> Result<(), Failure> {
    let Some(name) = &arguments.knob else {
        return Err(Failure::Input(format!("KNOB: expected all or one of {}", names())));
    };
    if arguments.model.is_some() && name != "all" && !BUDGETED.contains(&name.as_str()) {
        return Err(Failure::Input(format!("--model: expected knob {} or all", BUDGETED.join(" or "))));
    }
    let trace = match &arguments.trace {
        Some(path) => Trace::read(path)?,
        None => Trace::built_in(),
    };
    let quick = usize::from(arguments.quick);
    let size = arguments.size.unwrap_or(ImageSize::new(SIDE_PX[quick], SIDE_PX[quick]));
    if size.width.min(size.height) < 64 || size.pixels() > MAX_PIXELS {
        return Err(Failure::Input("--size: expected at least 64x64 and at most 4096x4096 pixels in all".to_owned()));
    }
    let start = Instant::now();
    let now = || start.elapsed();
    let request = Request {
        size,
        runs: arguments.runs.unwrap_or(RUNS[quick]),
        quick: arguments.quick,
        trace: &trace,
        planes: arguments.planes.as_deref(),
        reference_spp: arguments.reference_spp,
        now: &now,
    };
    if name == "all" {
        return run_all(arguments, &request);
    }
    if !arguments.only.is_empty() {
        return Err(Failure::Input(format!("--only: expected only with KNOB all, found KNOB '{name}'")));
    }
    run_one(arguments, &request, Knob::named(name)?)
}

/// One knob: its table or its document.
fn run_one(arguments: &SweepArgs, request: &Request<'_>, knob: &'static Knob) -> Result<(), Failure> {
    let bar = bar();
    let sweep = knob.sweep(request, arguments.scene.as_deref(), &mut |scene, done, all| {
        if bar.message() != scene {
            bar.set_message(scene.to_owned());
            bar.set_length(all);
            bar.reset_eta();
        }
        bar.set_position(done);
    });
    bar.finish_and_clear();
    let sweep = sweep?;
    if let Some(folder) = &arguments.out {
        let paths = write_files(&sweep, folder).with_context(|| format!("{}", folder.display()))?;
        if !arguments.json {
            for path in paths {
                eprintln!("{}", path.display());
            }
        }
    }
    if let Some(file) = &arguments.model {
        write_models(&sweep, file.as_deref())?;
    }
    if arguments.json {
        print!("{}", sweep.to_json().context("sweep document")?);
    } else {
        let [width, height] = sweep.size;
        println!("{}: {}; {width}x{height}, {} runs", knob.name, knob.about, request.runs);
        println!("{}", table(&sweep));
    }
    Ok(())
}

/// Every knob: a page, a document, and a line for each as it is done.
fn run_all(arguments: &SweepArgs, request: &Request<'_>) -> Result<(), Failure> {
    if arguments.planes.is_some() {
        return Err(Failure::Input("--planes: expected with a knob of volumes, found KNOB 'all'".to_owned()));
    }
    let knobs = match &arguments.only[..] {
        [] => KNOBS.iter().collect(),
        only => only.iter().map(|name| Knob::named(name)).collect::<Result<Vec<_>, _>>()?,
    };
    // Days since 1970 are what a clock knows; before, there was none of ours.
    let since_epoch = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let conditions = Conditions {
        date: date_from_unix(since_epoch.as_secs()),
        machine: Machine::here(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        wire_version: warplight_protocol::message::VERSION,
        size: [request.size.width, request.size.height],
        runs: request.runs,
        quick: request.quick,
        scene: arguments.scene.clone(),
        trace: arguments.trace.as_ref().map(|path| path.display().to_string()),
    };
    let folder = arguments.out.as_deref().unwrap_or(Path::new("out/accuracy"));
    let bar = bar();
    bar.set_length(STEPS_OF_ALL);
    let mut progress = |knob: &str, part: f64| {
        if bar.message() != knob {
            bar.set_message(knob.to_owned());
        }
        bar.set_position((part * STEPS_OF_ALL as f64) as u64);
    };
    // What is done stays, whatever comes after.
    let mut done = |sweep: &Sweep, secs: f64| -> Result<(), SweepError> {
        bar.suspend(|| eprintln!("{:<20} {secs:6.1} s  {}", sweep.knob, sweep.resume));
        write_files(sweep, folder)
            .map(drop)
            .map_err(|error| SweepError::Write(format!("{}: {error}", folder.display())))
    };
    let all = Sweeps::measure(&knobs, request, conditions, &mut progress, &mut done);
    bar.finish_and_clear();
    let all = all?;
    for (knob, why) in &all.skipped {
        eprintln!("{knob:<20} not measured: {why}");
    }
    if let Some(file) = &arguments.model {
        for sweep in &all.sweeps {
            write_models(sweep, file.as_deref())?;
        }
    }
    let paths = all.write(folder).with_context(|| format!("{}", folder.display()))?;
    let total: f64 = all.seconds.values().sum();
    eprintln!("{:<20} {total:6.1} s", "in all");
    if arguments.json {
        print!("{}", all.to_json().context("sweep document")?);
    } else {
        for path in paths {
            println!("{}", path.display());
        }
    }
    Ok(())
}

/// Puts the tables of a sweep into the cost models of its scenes.
fn write_models(sweep: &Sweep, named: Option<&Path>) -> Result<(), Failure> {
    let of_scene: Vec<_> = sweep.by_scene().collect();
    if named.is_some() && of_scene.len() > 1 {
        return Err(Failure::Input("--model: a file holds the model of one scene: name it with --scene".to_owned()));
    }
    for points in of_scene {
        let Some(scene) = points.first().map(|point| point.scene.as_str()) else { continue };
        let Some((table, is_display)) = sweep.cost_table(points) else { continue };
        let file = named.map(|path| CostFile::at(path.to_owned())).or_else(|| CostFile::beside(scene));
        let Some(file) = file else {
            return Err(Failure::Input("--model: there is no cache folder: expected a FILE".to_owned()));
        };
        // What another sweep has measured stays, on the same machine.
        let known = file.exists().then(|| file.read()).transpose()?;
        let mut model = known.filter(CostModel::is_of_this_machine).unwrap_or_else(|| CostModel::empty(scene));
        *(if is_display { &mut model.display } else { &mut model.frame }) = table;
        file.write(&model)?;
        eprintln!("{}", file.path().display());
    }
    Ok(())
}

fn bar() -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg:>18} {wide_bar} {pos}/{len} {eta:>4}");
    ProgressBar::new(1).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

#[cfg(test)]
mod tests {
    use crate::sweep::KNOBS;

    #[test]
    fn the_help_names_every_knob() {
        let source = include_str!("sweep.rs");
        let line = source.lines().find(|line| line.contains("/// What is turned:")).unwrap();
        assert!(KNOBS.iter().all(|knob| line.contains(knob.name)), "{line}");
    }
}
