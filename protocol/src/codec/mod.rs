//! Planes to bits and back: encoder and decoder of each coding stand in one file.
//!
//! A frame travels in strips of rows, each of which is decodable alone. Quantised samples are predicted
//! from their neighbours, the residuals bit-packed and entropy-coded with zstd.

pub mod bits;
mod curvature;
mod depth;
mod error;
mod interface;
mod layers;
mod limits;
mod mask;
mod normal;
mod plane;
mod radiance;
pub mod samples;
mod shape;
mod strip;

pub use error::DecodeError;
pub use limits::Limits;
pub use plane::{PLANE_HEADER_BYTES, PlaneBytes, PlaneKind};
pub use shape::FrameShape;
pub use strip::{STRIP_HEADER_BYTES, StripDecoder, StripEncoder};
