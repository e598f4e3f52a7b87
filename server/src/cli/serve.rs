//! `serve`: sessions of one scene, until the process is stopped.

use super::Failure;
use clap::Args;
use std::net::SocketAddr;

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub(super) struct ServeArgs {
    /// A built-in scene's name, or a path to scene.toml, .glb or .gltf.
    #[arg(long, default_value = "gallery")]
    pub(super) scene: String,
    /// Where to listen.
    #[arg(long, default_value = "127.0.0.1:7420")]
    pub(super) listen: SocketAddr,
    /// Samples per pixel and node of a frame.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub(super) spp: u32,
    /// Longest path in segments: 2 is direct light.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub(super) max_depth: u32,
    /// Seed of all randomness.
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
}

/// Serves until the process is stopped.
pub(super) fn run(args: &ServeArgs) -> Result<(), Failure> {
    Err(Failure::runtime(anyhow::anyhow!("serving '{}' at {} is not there yet", args.scene, args.listen)))
}
