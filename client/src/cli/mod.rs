//! The command line: what can be asked of the client, and how it ends.
//!
//! Exit status 0; 2 for bad arguments or input, with one line that says which; 1 for a failure at run time.

mod bench;
mod bench_codec;
mod bench_frames;
mod bench_volumes;
mod budget;
mod coding;
mod optics;
mod probe;
mod replay;
mod strip;
mod sweep;
mod trust;

use crate::replay::ReplayError;
use crate::trace;
use clap::{Parser, Subcommand};
use std::io::IsTerminal;
use std::process::ExitCode;

/// Reprojects remotely path-traced frames to a stream of head poses, and measures how well.
///
/// Without a command it runs the main job: the built-in head trace on the default scene against an embedded
/// server, with a report in out/index.html.
#[derive(Debug, Parser)]
#[command(name = "warplight-client", version)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Replay a head trace against a server and write a report.
    Replay(Box<replay::ReplayArgs>),
    /// Measure a link and a server, and whether the wanted mode fits.
    Probe(probe::ProbeArgs),
    /// Time the client's stages and the codec.
    Bench(bench::BenchArgs),
    /// Measure accuracy against cost over one knob.
    Sweep(sweep::SweepArgs),
    /// Look at, convert or make head traces.
    Trace(trace::cli::TraceArgs),
}

/// How a command fails.
#[derive(Debug, thiserror::Error)]
enum Failure {
    /// Arguments or input are at fault.
    #[error("{0}")]
    Input(String),
    /// Something went wrong at run time.
    #[error("{0:#}")]
    Run(#[from] anyhow::Error),
}

impl From<trace::TraceError> for Failure {
    fn from(error: trace::TraceError) -> Failure {
        Failure::Input(error.to_string())
    }
}

impl From<warplight_server::scene::SceneError> for Failure {
    fn from(error: warplight_server::scene::SceneError) -> Failure {
        Failure::Input(error.to_string())
    }
}

impl From<ReplayError> for Failure {
    fn from(error: ReplayError) -> Failure {
        Failure::Run(error.into())
    }
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let logs = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn".into());
    let colours = std::io::stderr().is_terminal();
    tracing_subscriber::fmt().with_env_filter(logs).with_writer(std::io::stderr).with_ansi(colours).init();
    let arguments = Arguments::parse();
    let outcome = match arguments.command {
        None => replay::run(&replay::ReplayArgs::default()),
        Some(Command::Replay(arguments)) => replay::run(&arguments),
        Some(Command::Probe(arguments)) => probe::run(&arguments),
        Some(Command::Bench(arguments)) => bench::run(&arguments),
        Some(Command::Sweep(arguments)) => sweep::run(&arguments),
        Some(Command::Trace(arguments)) => {
            trace::cli::run(&arguments).map(|text| println!("{text}")).map_err(Failure::from)
        }
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("error: {failure}");
            ExitCode::from(if matches!(failure, Failure::Input(_)) { 2 } else { 1 })
        }
    }
}
