//! Frames through the codec and back, in one process: what the wire does to them, and what that takes.
//!
//! For benches, sweeps and tests. The parts are those of a session, with their memory from frame to frame and strips spread
//! over all cores, as server and client spread them; only the sockets are missing.

mod walk;
mod walker;

pub use walk::{Beat, Walk};
pub use walker::{LiveWalk, Walker};

use crate::assemble::{PendingPictures, PictureDecoders};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use warplight_protocol::codec::{DecodeError, FrameShape, PlaneKind, StripDecoder, StripEncoder};
use warplight_protocol::frame::{ColorCoding, FrameId, Tree, TreeRows};
use warplight_protocol::message::PictureMessage;
use warplight_protocol::video::PictureHead;
use warplight_server::pictures::{EncodeJob, PictureSource, PictureStream};

/// Writes a plane as 32-bit floats, little-endian, row by row, for other programs to read.
///
/// # Errors
/// A file that cannot be written.
pub fn write_plane(file: &Path, values: &[f32]) -> io::Result<()> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    std::fs::write(file, bytes)
}

/// A sender and a receiver.
#[derive(Debug)]
pub struct Loopback {
    level: i32,
    encoders: Mutex<Vec<StripEncoder>>,
    decoders: Mutex<Vec<StripDecoder>>,
    source: PictureSource,
    pictures: PictureStream,
    picture_decoders: PictureDecoders,
    frames: u32,
}

impl Default for Loopback {
    fn default() -> Loopback {
        Loopback::new(StripEncoder::DEFAULT_LEVEL)
    }
}

/// A frame as bytes.
#[derive(Clone, Debug, Default)]
pub struct EncodedFrame {
    strips: Vec<Vec<u8>>,
    pictures: Vec<PictureMessage>,
    /// Bytes of every plane.
    pub plane_bytes: BTreeMap<(u8, PlaneKind), usize>,
}

impl EncodedFrame {
    /// Bytes of all of it.
    pub fn bytes(&self) -> usize {
        let pictures = self.pictures.iter().map(|picture| PictureHead::BYTES + picture.bytes.len());
        self.strips.iter().map(Vec::len).chain(pictures).sum()
    }

    /// Its strips, one after the other.
    pub fn concatenated(&self) -> Vec<u8> {
        self.strips.concat()
    }
}

/// A frame that went over the wire.
#[derive(Clone, Debug)]
pub struct ReceivedFrame {
    /// With the values that arrived.
    pub tree: Tree,
    /// Bytes of all of it.
    pub bytes: usize,
    /// Bytes of the planes of each kind.
    pub plane_bytes: BTreeMap<PlaneKind, usize>,
}

impl Loopback {
    /// One that compresses at this level of zstd.
    pub fn new(level: i32) -> Loopback {
        Loopback {
            level,
            encoders: Mutex::default(),
            decoders: Mutex::default(),
            source: PictureSource::default(),
            pictures: PictureStream::new(0),
            picture_decoders: PictureDecoders::default(),
            frames: 0,
        }
    }

    /// Encodes a frame of this shape. The tree is as it was afterwards: bands of it are handed out to be written.
    pub fn encode(&mut self, tree: &mut Tree, shape: &FrameShape) -> EncodedFrame {
        let bands = tree.bands_mut(u32::from(shape.strip_rows));
        let (encoders, level) = (&self.encoders, self.level);
        let encode = |band: TreeRows<'_>| {
            let idle = encoders.lock().unwrap_or_else(PoisonError::into_inner).pop();
            let mut encoder = idle.unwrap_or_else(|| StripEncoder::new(level));
            let mut strip = Vec::new();
            let planes = encoder.encode(shape, &band, &mut strip);
            encoders.lock().unwrap_or_else(PoisonError::into_inner).push(encoder);
            (strip, planes)
        };
        let coded: Vec<_> = bands.into_par_iter().map(encode).collect();
        let mut frame = EncodedFrame::default();
        for (strip, planes) in coded {
            for plane in planes {
                *frame.plane_bytes.entry((plane.node, plane.kind)).or_default() += plane.bytes;
            }
            frame.strips.push(strip);
        }
        self.encode_pictures(tree, shape, &mut frame);
        frame
    }

    /// Pictures are predicted from those of the frame that was encoded before. Where the codec fails there are none, and
    /// the frame is not whole.
    fn encode_pictures(&mut self, tree: &mut Tree, shape: &FrameShape, frame: &mut EncodedFrame) {
        self.frames += 1;
        let ColorCoding::Video { quantiser } = shape.format.color_coding else { return };
        let Some(pictures) = self.source.render(shape, tree) else { return };
        let job = EncodeJob { frame: FrameId(self.frames), quantiser, pictures };
        match self.pictures.encode(&job) {
            Ok(pictures) => frame.pictures = pictures,
            Err(error) => tracing::error!("{error}"),
        }
        for picture in &frame.pictures {
            let plane = (picture.head.node, picture.head.kind);
            *frame.plane_bytes.entry(plane).or_default() += PictureHead::BYTES + picture.bytes.len();
        }
    }

    /// Decodes a frame into a tree, which is made to fit. One with pictures must be the next after the last one decoded.
    ///
    /// # Errors
    /// Bytes that are no frame of this shape.
    pub fn decode(&mut self, frame: &EncodedFrame, shape: &FrameShape, tree: &mut Tree) -> Result<(), DecodeError> {
        shape.fit(tree, tree.render_pose);
        let mut pending = PendingPictures::of(shape);
        for picture in &frame.pictures {
            pending.push(picture.clone(), shape.camera.size)?;
        }
        if !pending.is_whole() {
            return Err(DecodeError::Malformed { field: "frame", expected: "a picture of each plane that is one" });
        }
        self.picture_decoders.decode(shape, &mut pending, tree)?;
        let decoders = &self.decoders;
        let bands = tree.bands_mut(u32::from(shape.strip_rows));
        bands.into_par_iter().zip(&frame.strips).try_for_each(|(mut band, strip)| {
            let idle = decoders.lock().unwrap_or_else(PoisonError::into_inner).pop();
            let mut decoder = idle.unwrap_or_default();
            let decoded = decoder.decode(shape, strip, &mut band).map(drop);
            decoders.lock().unwrap_or_else(PoisonError::into_inner).push(decoder);
            decoded
        })
    }

    /// Sends a tree as a frame of this shape.
    ///
    /// # Errors
    /// A shape that the tree does not have.
    pub fn send(&mut self, mut tree: Tree, shape: &FrameShape) -> Result<ReceivedFrame, DecodeError> {
        let frame = self.encode(&mut tree, shape);
        let mut received = shape.tree(tree.render_pose);
        self.decode(&frame, shape, &mut received)?;
        let mut plane_bytes = BTreeMap::new();
        for (&(_, kind), bytes) in &frame.plane_bytes {
            *plane_bytes.entry(kind).or_default() += bytes;
        }
        Ok(ReceivedFrame { tree: received, bytes: frame.bytes(), plane_bytes })
    }
}
