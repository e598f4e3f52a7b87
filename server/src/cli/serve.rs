//! `serve`: sessions of one scene, until the process is told to stop.

use super::{Failure, load_scene};
use crate::costs::KnownCosts;
use crate::net::{self, Identity};
use crate::service::{DEFAULT_GUARD_DEG, DEFAULT_MAX_DEPTH, Estimator, Service, ServiceOptions, guard_deg};
use crate::session::SampleBudget;
use anyhow::{Context, anyhow};
use clap::Args;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use warplight_protocol::frame::Plan;

/// Time for the samples of a frame, where no other is asked for.
const DEFAULT_BUDGET_MS: u64 = 80;

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub(super) struct ServeArgs {
    /// A built-in scene's name, or a path to scene.toml, .glb or .gltf.
    #[arg(long, value_name = "S", default_value = crate::scene::DEFAULT_SCENE)]
    scene: String,
    /// Where to listen.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7420")]
    listen: SocketAddr,
    /// Listen beyond this machine although something is missing: TLS, a token, or both.
    #[arg(long)]
    insecure: bool,
    /// Encrypt, with a certificate that clients know by its fingerprint, which is printed; made anew at each start
    /// unless it is kept in files.
    #[arg(long)]
    tls: bool,
    /// Keep the certificate in this file (PEM); made where neither it nor the key is there.
    #[arg(long, value_name = "FILE", requires = "tls", requires = "key")]
    certificate: Option<PathBuf>,
    /// Keep the certificate's key in this file (PEM).
    #[arg(long, value_name = "FILE", requires = "tls", requires = "certificate")]
    key: Option<PathBuf>,
    /// Serve only clients that know the token in this file; without it that of the variable WARPLIGHT_TOKEN, if there
    /// is one.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Also tell figures of the sessions, as Prometheus text at http://ADDR/metrics.
    #[arg(long, value_name = "ADDR")]
    metrics: Option<SocketAddr>,
    /// Samples per pixel and node of a frame; by default as many as the time budget allows.
    #[arg(long, value_name = "N", conflicts_with = "time_budget_ms", value_parser = clap::value_parser!(u32).range(1..=4096))]
    spp: Option<u32>,
    /// Time for a frame in milliseconds: frames have as many pixels, nodes and samples as fit [default: all pixels and
    /// nodes, and samples for 80 ms].
    #[arg(long, value_name = "T", value_parser = clap::value_parser!(u64).range(1..=60_000))]
    time_budget_ms: Option<u64>,
    /// Cost model of --time-budget-ms; its times are refreshed [default: that beside the scene where there is one, else the
    /// built-in one].
    #[arg(long, value_name = "FILE", requires = "time_budget_ms")]
    cost_model: Option<PathBuf>,
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
    let token = net::read_token(args.token_file.as_deref()).context("token").map_err(Failure::input)?;
    if !args.listen.ip().is_loopback() && !args.insecure {
        let missing = match (args.tls, token.is_none()) {
            (false, true) => "nothing is encrypted and anyone may connect: expected --tls and --token-file",
            (false, false) => "nothing is encrypted, the token neither: expected --tls",
            (true, true) => "anyone may connect: expected --token-file or WARPLIGHT_TOKEN",
            (true, false) => "",
        };
        if !missing.is_empty() {
            return Err(Failure::input(anyhow!(
                "--listen {}: beyond loopback {missing}, or a loopback address, or --insecure",
                args.listen
            )));
        }
    }
    let identity = match (&args.certificate, &args.key) {
        (Some(certificate), Some(key)) => Some(Identity::kept(certificate, key)),
        _ => args.tls.then(Identity::generate),
    };
    let identity = identity.transpose().context("--tls").map_err(Failure::input)?;
    if let Some(address) = args.metrics.filter(|address| !address.ip().is_loopback() && !args.insecure) {
        return Err(Failure::input(anyhow!(
            "--metrics {address}: beyond loopback anyone may read them: expected a loopback address, or --insecure"
        )));
    }
    let known = args.time_budget_ms.map(|_| KnownCosts::of(Some(&args.scene), args.cost_model.as_deref()));
    let known = known.transpose().context("--cost-model").map_err(Failure::input)?;
    if let Some(warning) = known.as_ref().and_then(|known| known.warning.as_ref()) {
        tracing::warn!("{warning}");
    }
    let scene = load_scene(&args.scene)?;
    let samples = match args.spp {
        Some(spp) => SampleBudget::Samples(spp),
        None => SampleBudget::Time(Duration::from_millis(args.time_budget_ms.unwrap_or(DEFAULT_BUDGET_MS))),
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
        // From here on a signal is heard, also one that comes while the scene is made ready.
        let stop = stop().context("waiting for signals").map_err(Failure::runtime)?;
        let mut service =
            Service::new(scene, options).context("starting the rendering threads").map_err(Failure::runtime)?;
        service.session.token = token;
        if let Some(known) = known {
            service.choose_points(Arc::new(Mutex::new(known)));
        }
        if let Some(address) = args.metrics {
            let at = crate::metrics::http::serve(address, service.metrics.clone())
                .with_context(|| format!("--metrics {address}"))
                .map_err(Failure::input)?;
            tracing::info!("figures at http://{at}/metrics");
        }
        let address = listener.local_addr().unwrap_or(args.listen);
        tracing::info!("serving '{}' at {address}", args.scene);
        if let Some(identity) = &identity {
            tracing::info!("the certificate has the fingerprint {}", identity.fingerprint());
            println!("{}", identity.fingerprint());
        }
        net::serve_until(listener, service, identity, stop).await.context("serving").map_err(Failure::runtime)
    })
}

/// Is there when the process is asked to stop.
#[cfg(unix)]
fn stop() -> std::io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let (mut terminate, mut interrupt) = (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    })
}

/// Is there when the process is asked to stop.
#[cfg(not(unix))]
fn stop() -> std::io::Result<impl Future<Output = ()>> {
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
    })
}
