//! Strips to frames: decode, into planes ready to be warped.
//!
//! One tree is being filled while others are shown; trees that nobody shows any more are filled again, so a
//! running session allocates nothing.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use warplight_protocol::codec::{DecodeError, FrameShape, PlaneKind, StripDecoder};
use warplight_protocol::frame::{FrameId, Tree};
use warplight_protocol::message::{FrameBegin, FrameEnd, FramePurpose, StripMessage};
use warplight_protocol::{Camera, ImageSize, Pose, Timestamp};

/// Bytes by node and kind of plane.
pub type BytesPerPlane = BTreeMap<(u8, PlaneKind), u64>;

/// A frame that can be shown.
#[derive(Debug)]
pub struct ReadyFrame {
    /// Its head.
    pub begin: FrameBegin,
    /// What the server says it took.
    pub end: FrameEnd,
    /// Its planes.
    pub tree: Tree,
    /// When its last byte had arrived.
    pub received: Timestamp,
    /// When it was decoded.
    pub decoded: Timestamp,
    /// Time spent decoding its strips.
    pub decode_time: Duration,
    /// Bytes of its strips.
    pub bytes: u64,
}

/// Puts frames together.
#[derive(Debug, Default)]
pub struct Assembler {
    decoder: StripDecoder,
    current: Option<Partial>,
    retired: Vec<Arc<ReadyFrame>>,
    bytes_per_plane: BytesPerPlane,
}

#[derive(Debug)]
struct Partial {
    begin: FrameBegin,
    tree: Tree,
    strips_missing: usize,
    strip_seen: Vec<bool>,
    decode_time: Duration,
    bytes: u64,
}

impl Assembler {
    /// Starts a frame; one that was not finished is lost.
    pub fn begin(&mut self, begin: FrameBegin) {
        let shape = &begin.shape;
        let unfinished = self.current.take().map(|partial| partial.tree);
        let mut tree = unfinished.or_else(|| self.reuse()).unwrap_or_else(|| {
            let camera = Camera::symmetric(1.0, ImageSize::new(1, 1));
            Tree::new(Pose::IDENTITY, camera, shape.plan.clone(), shape.interfaces.clone())
        });
        tree.reset(begin.render_pose, shape.camera, &shape.plan, &shape.interfaces);
        let strips = shape.strips();
        self.current = Some(Partial {
            tree,
            strips_missing: strips,
            strip_seen: vec![false; strips],
            decode_time: Duration::ZERO,
            bytes: 0,
            begin,
        });
    }

    /// Decodes a strip. `elapsed` measures or models what that took: it is called once, after the work.
    pub fn strip(&mut self, strip: &StripMessage, elapsed: impl FnOnce() -> Duration) -> Result<(), DecodeError> {
        let wrong = |expected| Err(DecodeError::Malformed { field: "strip", expected });
        let Some(partial) = self.current.as_mut().filter(|partial| partial.begin.id == strip.frame) else {
            return wrong("one of the frame that has begun");
        };
        let shape: &FrameShape = &partial.begin.shape;
        let rows = StripDecoder::rows(shape, &strip.bytes)?;
        let index = (rows.start / u32::from(shape.strip_rows)) as usize;
        if std::mem::replace(&mut partial.strip_seen[index], true) {
            return wrong("each only once");
        }
        let mut bands = partial.tree.bands_mut(u32::from(shape.strip_rows));
        let planes = self.decoder.decode(shape, &strip.bytes, &mut bands[index])?;
        partial.strips_missing -= 1;
        partial.bytes += strip.bytes.len() as u64;
        partial.decode_time += elapsed();
        if partial.begin.purpose == FramePurpose::Live {
            for plane in planes {
                *self.bytes_per_plane.entry((plane.node, plane.kind)).or_default() += plane.bytes as u64;
            }
        }
        Ok(())
    }

    /// Ends a frame, whose strips must all be there.
    pub fn end(&mut self, end: FrameEnd, received: Timestamp, decoded: Timestamp) -> Result<Arc<ReadyFrame>, DecodeError> {
        let whole = |partial: &Partial| partial.begin.id == end.id && partial.strips_missing == 0;
        let Some(partial) = self.current.take().filter(whole) else {
            return Err(DecodeError::Malformed { field: "end of frame", expected: "all strips of the frame before it" });
        };
        let Partial { begin, tree, decode_time, bytes, .. } = partial;
        Ok(Arc::new(ReadyFrame { begin, end, tree, received, decoded, decode_time, bytes }))
    }

    /// Takes back a frame that will not be shown again; its memory is used once nobody else holds it.
    pub fn retire(&mut self, frame: Arc<ReadyFrame>) {
        self.retired.push(frame);
    }

    fn reuse(&mut self) -> Option<Tree> {
        let free = self.retired.iter().position(|frame| Arc::strong_count(frame) == 1)?;
        Arc::into_inner(self.retired.swap_remove(free)).map(|frame| frame.tree)
    }

    /// The frame that is under way, if any.
    pub fn current(&self) -> Option<FrameId> {
        self.current.as_ref().map(|partial| partial.begin.id)
    }

    /// Bytes of live frames by plane, so far.
    pub fn bytes_per_plane(&self) -> &BytesPerPlane {
        &self.bytes_per_plane
    }
}
