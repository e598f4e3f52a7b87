//! What server and client agree on: spaces and poses, the ray tree and its planes, how they become
//! bits, and the messages that carry them.
//!
//! This crate does no input or output and reads no clock: bytes are pushed in, messages come out, and
//! every instant is an argument. `docs/wire-format.md` holds the byte tables.

pub mod budget;
pub mod camera;
pub mod codec;
pub mod curvature;
pub mod frame;
pub mod message;
pub mod optics;
pub mod pose;
#[cfg(test)]
mod stability;
pub mod time;
pub mod tone;
pub mod trust;
pub mod video;
pub mod wire;

pub use camera::{Camera, FieldOfView, ImageSize};
pub use pose::Pose;
pub use time::Timestamp;
pub use trust::Token;
