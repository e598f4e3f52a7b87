//! The Warplight server: scene -> effects -> integrator -> frame -> encode, and the commands around it.
//!
//! Each stage uses only what stands before it: [`scene`], [`effects`] (what the scene calls for), [`accel`],
//! [`cache`] and [`integrator`] (light transport), [`film`] (whole pictures) and [`frame`] (ray trees).

pub mod accel;
mod bsdf;
pub mod cache;
pub mod cli;
pub mod costs;
pub mod counters;
pub mod effects;
pub mod film;
pub mod frame;
pub mod integrator;
pub mod layering;
pub mod march;
pub mod metrics;
pub mod net;
pub mod pictures;
pub mod predict;
pub mod scene;
pub mod service;
pub mod session;
#[cfg(test)]
#[path = "../../protocol/src/stability.rs"]
mod stability;
pub mod stream;
#[cfg(test)]
mod testing;
pub mod volume;
