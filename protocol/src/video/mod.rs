//! Radiance as the pictures of a video: one H.264 stream for every node of a frame and every layer of its volume.
//!
//! Both ends of [`ColorCoding::Video`](crate::frame::ColorCoding): the server turns a plane of radiance into codes
//! ([`crate::frame::ColorFormat`], 8 bits), those into luma and chroma of half the resolution ([`color`]), fills what
//! the plane does not know ([`fill`]), and encodes it ([`PictureEncoder`]); the client decodes it ([`PictureDecoder`])
//! and goes the same way back. Masks, depths and all else stay in strips, exact or bounded: what of a picture is shown
//! is decided by them and never by the picture.
//!
//! - **Canvas.** A live frame changes its size with its guard band, a stream of pictures must not. So pictures have a
//!   [`Canvas`] of their own, and a [`Placement`] says where in it the frame lies: pixels of one direction stay where they
//!   are from frame to frame, whatever band is around them, and motion is that of the picture alone.
//! - **References.** A picture is predicted from the one before it of its plane, or is a key picture and needs none. It
//!   names the frame of its reference ([`PictureHead::reference`]), so that a receiver that lacks it refuses the picture
//!   instead of showing what nobody meant.
//! - **Parameter sets never travel**: both ends write them from the canvas (`parameters.rs`). So a peer can neither size a
//!   decoder's memory nor switch on what our encoder does not use.
//!
//! The codec is OpenH264 (C++), whose decoder is exact: what H.264 decodes to is defined to the bit, so the client holds
//! what the encoder predicts from, on any machine. It is called one picture at a time and on one thread; planes are
//! encoded and decoded in parallel by whoever calls.
//!
//! Limits: 8-bit formats, perspective pictures, canvases of up to 36864 macroblocks (level 5.2: 3072 x 3072 pixels).
//! Chroma has half the resolution, so at the finest quantisers edges of colour are still soft. Cost: see
//! `docs/measurements/2026-11-22-video.md`.

pub mod color;
mod decoder;
mod encoder;
pub mod fill;
mod parameters;
mod picture;
mod plane;
mod white;

pub use decoder::{Decoded, PictureDecoder};
pub use encoder::PictureEncoder;
pub use picture::{Canvas, Picture, PictureHead, Placement};
pub use plane::{dequantise, quantise};
pub use white::White;

/// Why a picture cannot be encoded or decoded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VideoError {
    /// The codec is out of memory, or refuses what it must accept: a fault of this build, not of a peer.
    #[error("the video codec failed: {doing} gave {code}")]
    Codec {
        /// What it was asked to do.
        doing: &'static str,
        /// What it said.
        code: i64,
    },
}

#[cfg(test)]
mod tests;
