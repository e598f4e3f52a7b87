//! The Warplight client: reprojects the latest frame of a remote path tracer to the head pose of the moment.
//!
//! wire -> decode -> warp -> composite -> report; poses flow back. [`session`] (no clock, no socket),
//! [`assemble`] (strips to frames), [`warp`] (frames to pictures), [`march`] (layered volumes), [`display`] (what eyes, lenses and shutters make of them), [`trace`] (where the head is), [`replay`]
//! (all of it along a trace, in real or virtual time), [`measure`] and [`report`] (what came of it).

pub mod analytic;
pub mod assemble;
pub mod budget;
pub mod cli;
pub mod display;
pub mod embedded;
mod lanes;
pub mod link;
pub mod loopback;
pub mod march;
pub mod measure;
pub mod net;
pub mod replay;
pub mod report;
pub mod session;
#[cfg(test)]
#[path = "../../protocol/src/stability.rs"]
mod stability;
pub mod sweep;
pub mod trace;
pub mod warp;
