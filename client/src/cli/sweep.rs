//! `sweep`: accuracy against cost for one knob, as table, plots and JSON.

use super::Failure;
use crate::sweep::{Knob, Request, SweepError, names, table, write_files};
use crate::trace::Trace;
use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::Instant;
use warplight_protocol::ImageSize;

/// Timed runs of each setting by default, and of a quick sweep.
const RUNS: [u32; 2] = [9, 3];
/// Width and height by default, and of a quick sweep: errors depend on it, since differences over texels do.
const SIDE_PX: [u32; 2] = [1024, 512];
/// Most pixels of a frame: all planes of several frames are held at once.
const MAX_PIXELS: usize = 4096 * 4096;

/// Arguments of `sweep`.
#[derive(Debug, Args)]
pub(super) struct SweepArgs {
    /// What is turned: solver, steps, normals, depth-bits, depth-coding, frame-age, head-translation, layers, angle, density, volume-compression, color, depth-bound, child-bound or zstd-level.
    #[arg(value_name = "KNOB")]
    knob: Option<String>,
    /// Scene: mirror, chrome-ball, water or glass-ball; of a knob of volumes cube, cloud, phantom, shells or any other scene
    /// with media; of a knob of the codec gallery, pool, glass or any other scene [default: all].
    #[arg(long, value_name = "S")]
    scene: Option<String>,
    /// Head trace (TUM text) of knob frame-age and of those of the codec; without it the built-in one.
    #[arg(long, value_name = "F.tum")]
    trace: Option<PathBuf>,
    /// Size of frames and display [default: 1024x1024, 512x512 with --quick].
    #[arg(long, value_name = "WxH")]
    size: Option<ImageSize>,
    /// Timed runs of each setting [default: 9, 3 with --quick].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: Option<u32>,
    /// Folder for sweep-KNOB.json and plots.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Folder for the planes of a volume's layers of one --scene, as raw floats in DIR/source; what another codec made of
    /// them in a folder beside, with its size in a file `bytes`, is measured with the knob's own settings.
    #[arg(long, value_name = "DIR", requires = "scene")]
    planes: Option<PathBuf>,
    /// Samples per pixel of converged pictures: with them knobs of the codec also tell the FLIP to what is really seen.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=65_536))]
    reference_spp: u32,
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
            SweepError::Wire(_) => Failure::Run(error.into()),
            SweepError::UnknownKnob { .. } | SweepError::UnknownScene { .. } | SweepError::Scene(_) => {
                Failure::Input(error.to_string())
            }
        }
    }
}

/// Runs the command.
pub(super) fn run(arguments: &SweepArgs) -> Result<(), Failure> {
    let Some(knob) = &arguments.knob else {
        return Err(Failure::Input(format!("KNOB: expected one of {}", names())));
    };
    let knob = Knob::named(knob)?;
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
    let runs = arguments.runs.unwrap_or(RUNS[quick]);
    let planes = arguments.planes.as_deref();
    let request = Request {
        size,
        runs,
        quick: arguments.quick,
        trace: &trace,
        planes,
        reference_spp: arguments.reference_spp,
        now: &now,
    };
    let bar = bar();
    let sweep = knob.sweep(&request, arguments.scene.as_deref(), &mut |scene, done, all| {
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
    if arguments.json {
        print!("{}", sweep.to_json().context("sweep document")?);
    } else {
        println!("{}: {}; {}, {runs} runs", knob.name, knob.about, size);
        println!("{}", table(&sweep));
    }
    Ok(())
}

fn bar() -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg:>12} {wide_bar} {pos}/{len} {eta:>4}");
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
