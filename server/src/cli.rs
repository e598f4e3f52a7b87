//! The command line of `warplight-server`.
//!
//! One subcommand is one file. Results go to stdout, everything else to stderr. Exit status: 0, or 2 for bad
//! arguments or input, or 1 for a failure at run time, with one line that says what was expected.

mod inspect;
mod picture;
mod render;
mod serve;

use crate::scene::Scene;
use clap::{Parser, Subcommand};
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

/// Path-traces a scene and streams it as ray trees.
#[derive(Debug, Parser)]
#[command(name = "warplight-server", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve sessions of a scene.
    Serve(serve::ServeArgs),
    /// Render one picture or one frame to a file.
    Render(render::RenderArgs),
    /// Say which effects a scene calls for, and what its frames hold.
    Inspect(inspect::InspectArgs),
}

/// Why a command ended early; each is told once, here.
#[derive(Debug)]
enum Failure {
    /// Arguments or input are wrong: exit status 2.
    Input(anyhow::Error),
    /// Something went wrong at run time: exit status 1.
    Runtime(anyhow::Error),
}

impl Failure {
    fn input(error: impl Into<anyhow::Error>) -> Failure {
        Failure::Input(error.into())
    }

    fn runtime(error: impl Into<anyhow::Error>) -> Failure {
        Failure::Runtime(error.into())
    }
}

/// Runs the command that the arguments of the process ask for.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    // Another subscriber may be there where the library is embedded: then that one is right.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .try_init();
    let done = match cli.command {
        Command::Serve(args) => serve::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Inspect(args) => inspect::run(&args),
    };
    let (status, error) = match done {
        Ok(()) => return ExitCode::SUCCESS,
        Err(Failure::Input(error)) => (2, error),
        Err(Failure::Runtime(error)) => (1, error),
    };
    eprintln!("error: {error:#}");
    ExitCode::from(status)
}

/// Loads a scene and tells what in it is not supported.
fn load_scene(spec: &str) -> Result<Scene, Failure> {
    let scene = Scene::load(spec).map_err(Failure::input)?;
    for warning in &scene.warnings {
        tracing::warn!("{warning}");
    }
    Ok(scene)
}

/// Writes a result to stdout; a reader that has gone away is a failure, not a panic.
fn print(text: &str) -> Result<(), Failure> {
    writeln!(std::io::stdout(), "{text}").map_err(Failure::runtime)
}
