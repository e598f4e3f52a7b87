//! `serve`: sessions of one scene, until the process is told to stop.

use super::{Failure, load_scene};
use crate::net;
use crate::service::{DEFAULT_GUARD_DEG, DEFAULT_MAX_DEPTH, Estimator, Service, ServiceOptions, guard_deg};
use crate::session::SampleBudget;
use anyhow::{Context, anyhow};
use clap::Args;
use std::net::SocketAddr;
use std::time::Duration;
use warplight_protocol::frame::Plan;

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub(super) struct ServeArgs {
    /// A built-in scene's name, or a path to scene.toml, .glb or .gltf.
    #[arg(long, value_name = "S", default_value = crate::scene::DEFAULT_SCENE)]
    scene: String,
    /// Where to listen.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7420")]
    listen: SocketAddr,
    /// Listen beyond this machine although nothing is encrypted and nobody is asked who they are.
    #[arg(long)]
    insecure: bool,
    /// Samples per pixel and node of a frame; by default as many as the time budget allows.
    #[arg(long, value_name = "N", conflicts_with = "time_budget_ms", value_parser = clap::value_parser!(u32).range(1..=4096))]
    spp: Option<u32>,
    /// Time for a frame in milliseconds.
    #[arg(long, value_name = "T", default_value_t = 80, value_parser = clap::value_parser!(u64).range(1..=60_000))]
    time_budget_ms: u64,
    /// How live frames find the light on diffuse surfaces.
    #[arg(long, value_name = "E", value_enum, default_value_t)]
    estimator: Estimator,
    /// Longest path in segments: 2 is direct light.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_MAX_DEPTH, value_parser = clap::value_parser!(u32).range(1..=1000))]
    max_depth: u32,
    /// Threads that render; 0 for one per core.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u16).range(0..=1024))]
    threads: u16,
    /// Seed of all randomness.
    #[arg(long, value_name = "K", default_value_t = 1)]
    seed: u64,
    /// Nodes of a frame, as D,R,F,FF,FFR; by default those that the scene calls for.
    #[arg(long, value_name = "NODES")]
    plan: Option<Plan>,
    /// Widest band that a frame shows beyond each side of a display that turns, in degrees; 0 for none.
    #[arg(long, value_name = "MAX", default_value_t = DEFAULT_GUARD_DEG, value_parser = guard_deg)]
    guard_deg: f64,
}

/// Serves until SIGINT or SIGTERM.
pub(super) fn run(args: &ServeArgs) -> Result<(), Failure> {
    if !args.listen.ip().is_loopback() && !args.insecure {
        return Err(Failure::input(anyhow!(
            "--listen {}: beyond loopback anyone may connect and nothing is encrypted: expected a loopback address, or --insecure",
            args.listen
        )));
    }
    let scene = load_scene(&args.scene)?;
    let samples = match args.spp {
        Some(spp) => SampleBudget::Samples(spp),
        None => SampleBudget::Time(Duration::from_millis(args.time_budget_ms)),
    };
    let options = ServiceOptions {
        samples,
        estimator: args.estimator,
        max_depth: args.max_depth,
        seed: args.seed,
        threads: usize::from(args.threads),
        still_threads: usize::from(args.threads),
        plan: args.plan.clone(),
        guard_deg: args.guard_deg,
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("starting the network")
        .map_err(Failure::runtime)?;
    runtime.block_on(async {
        // A port in use is bad input, and known before the scene is made ready.
        let listener = net::listen(args.listen)
            .await
            .with_context(|| format!("--listen {}", args.listen))
            .map_err(Failure::input)?;
        let service =
            Service::new(scene, options).context("starting the rendering threads").map_err(Failure::runtime)?;
        tracing::info!("serving '{}' at {}", args.scene, args.listen);
        tokio::select! {
            served = net::serve(listener, service) => served.context("serving").map_err(Failure::runtime),
            stop = stopped() => stop.context("waiting for signals").map_err(Failure::runtime),
        }
    })
}

/// Returns when the process is asked to stop.
async fn stopped() -> std::io::Result<()> {
    #[cfg(unix)]
    {
        let mut terminate = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())?;
        tokio::select! {
            interrupt = tokio::signal::ctrl_c() => interrupt,
            _ = terminate.recv() => Ok(()),
        }
    }
    #[cfg(not(unix))]
    tokio::signal::ctrl_c().await
}
