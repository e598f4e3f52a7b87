//! Planes to bits and back: encoder and decoder of each coding stand in one file.
//!
//! A frame travels in strips of rows, each of which is decodable alone. Codes that must come back as they were are mostly
//! predicted row by row, the residuals bit-packed and entropy-coded with zstd ([`samples`]). What need only be within a bound,
//! and masks and indices, goes from coarse to fine, with rANS behind it (`pyramid`, `residuals`).

pub mod bits;
mod bounded_depth;
mod channels;
mod curvature;
mod depth;
mod error;
mod interface;
mod layers;
mod limits;
mod normal;
mod plane;
mod pyramid;
mod radiance;
mod residuals;
pub mod samples;
mod shape;
mod strip;

pub use bounded_depth::CoarseDepth;
pub use error::DecodeError;
pub use limits::Limits;
pub use plane::{PLANE_HEADER_BYTES, PlaneBytes, PlaneKind};
pub(crate) use radiance::white as radiance_white;
pub use shape::FrameShape;
pub use strip::{STRIP_HEADER_BYTES, StripDecoder, StripEncoder};
