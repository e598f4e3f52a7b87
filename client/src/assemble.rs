//! Strips and pictures to frames: decode, into planes ready to be warped.
//!
//! One tree is being filled while others are shown; trees that nobody shows any more are filled again, so a
//! running session allocates nothing.

mod pictures;

pub(crate) use pictures::{PendingPictures, PictureDecoders};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use warplight_protocol::codec::{DecodeError, FrameShape, PlaneKind, StripDecoder};
use warplight_protocol::frame::Tree;
use warplight_protocol::message::{FrameBegin, FrameEnd, FramePurpose, PictureMessage, StripMessage};
use warplight_protocol::video::PictureHead;
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
    /// Time spent decoding its strips and pictures.
    pub decode_time: Duration,
    /// Bytes of its strips and pictures.
    pub bytes: u64,
    /// Bytes of its planes.
    pub bytes_per_plane: BytesPerPlane,
}

/// Puts frames together.
#[derive(Debug, Default)]
pub struct Assembler {
    decoder: StripDecoder,
    pictures: PictureDecoders,
    current: Option<Partial>,
    retired: Vec<Arc<ReadyFrame>>,
}

#[derive(Debug)]
struct Partial {
    begin: FrameBegin,
    tree: Tree,
    strips_missing: usize,
    strip_seen: Vec<bool>,
    pictures: PendingPictures,
    /// Also where there are none.
    are_pictures_decoded: bool,
    decode_time: Duration,
    bytes: u64,
    bytes_per_plane: BytesPerPlane,
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
        shape.fit(&mut tree, begin.render_pose);
        let strips = shape.strips();
        self.current = Some(Partial {
            tree,
            strips_missing: strips,
            strip_seen: vec![false; strips],
            pictures: PendingPictures::of(shape),
            are_pictures_decoded: shape.pictures().is_empty(),
            decode_time: Duration::ZERO,
            bytes: 0,
            bytes_per_plane: BytesPerPlane::new(),
            begin,
        });
    }

    /// Size of the frame that is being put together.
    pub fn size(&self) -> Option<ImageSize> {
        self.current.as_ref().map(|partial| partial.begin.shape.camera.size)
    }

    /// How many pictures the frame has that is being put together.
    pub fn pictures(&self) -> usize {
        self.current.as_ref().map_or(0, |partial| partial.begin.shape.pictures().len())
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
        for plane in planes {
            *partial.bytes_per_plane.entry((plane.node, plane.kind)).or_default() += plane.bytes as u64;
        }
        Ok(())
    }

    /// Takes in a picture of the frame whose strips are all there, and decodes them all with the last. `elapsed` is as for
    /// a strip.
    pub fn picture(&mut self, picture: PictureMessage, elapsed: impl FnOnce() -> Duration) -> Result<(), DecodeError> {
        let begun = |partial: &&mut Partial| partial.begin.id == picture.head.frame && partial.strips_missing == 0;
        let Some(partial) = self.current.as_mut().filter(begun) else {
            let expected = "one of the frame whose strips have come";
            return Err(DecodeError::Malformed { field: "picture", expected });
        };
        let plane = (picture.head.node, picture.head.kind);
        let bytes = (PictureHead::BYTES + picture.bytes.len()) as u64;
        let shape = &partial.begin.shape;
        partial.pictures.push(picture, shape.camera.size)?;
        if partial.pictures.is_whole() {
            self.pictures.decode(shape, &mut partial.pictures, &mut partial.tree)?;
            partial.are_pictures_decoded = true;
        }
        partial.bytes += bytes;
        partial.decode_time += elapsed();
        *partial.bytes_per_plane.entry(plane).or_default() += bytes;
        Ok(())
    }

    /// The session is lost: so is the frame that is being put together. True where it was live.
    pub fn abandon(&mut self) -> bool {
        self.current.take().is_some_and(|partial| partial.begin.purpose == FramePurpose::Live)
    }

    /// A session begins: its first pictures must be key pictures.
    pub fn new_session(&mut self) {
        self.current = None;
        self.pictures.forget();
    }

    /// Ends a frame, whose strips and pictures must all be there.
    pub fn end(
        &mut self,
        end: FrameEnd,
        received: Timestamp,
        decoded: Timestamp,
    ) -> Result<Arc<ReadyFrame>, DecodeError> {
        let whole = |partial: &Partial| {
            partial.begin.id == end.id && partial.strips_missing == 0 && partial.are_pictures_decoded
        };
        let Some(partial) = self.current.take().filter(whole) else {
            return Err(DecodeError::Malformed {
                field: "end of frame",
                expected: "all strips and pictures of the frame before it",
            });
        };
        let Partial { begin, tree, decode_time, bytes, bytes_per_plane, .. } = partial;
        Ok(Arc::new(ReadyFrame { begin, end, tree, received, decoded, decode_time, bytes, bytes_per_plane }))
    }

    /// Takes back a frame that will not be shown again; its memory is used once nobody else holds it.
    pub fn retire(&mut self, frame: Arc<ReadyFrame>) {
        self.retired.push(frame);
    }

    fn reuse(&mut self) -> Option<Tree> {
        let free = self.retired.iter().position(|frame| Arc::strong_count(frame) == 1)?;
        Arc::into_inner(self.retired.swap_remove(free)).map(|frame| frame.tree)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use warplight_protocol::codec::StripEncoder;
    use warplight_protocol::frame::{FrameFormat, FrameId, Interfaces, Plan, VolumeRange};
    use warplight_protocol::message::FramePurpose;

    fn shape() -> FrameShape {
        FrameShape {
            camera: Camera::symmetric(1.0, ImageSize::new(8, 20)),
            plan: Plan::mirror(),
            interfaces: Interfaces::default(),
            format: FrameFormat::exact(),
            volume: VolumeRange::default(),
            strip_rows: 8,
            exposure: 1.0,
        }
    }

    fn begin(id: u32) -> FrameBegin {
        let pose_time = Timestamp::ZERO;
        FrameBegin {
            id: FrameId(id),
            purpose: FramePurpose::Live,
            pose_time,
            horizon_micros: 0,
            scene_time: pose_time,
            render_pose: Pose::IDENTITY,
            shape: shape(),
        }
    }

    fn end(id: u32) -> FrameEnd {
        let zero = Timestamp::ZERO;
        FrameEnd {
            id: FrameId(id),
            pose_received: zero,
            render_start: zero,
            render_end: zero,
            encoded: zero,
            sent: zero,
            spp: 1,
        }
    }

    fn strips(id: u32) -> Vec<StripMessage> {
        let mut tree = Tree::new(Pose::IDENTITY, shape().camera, shape().plan, Interfaces::default());
        tree.nodes[0].distance.iter_mut().enumerate().for_each(|(pixel, distance)| *distance = 1.0 + pixel as f32);
        let mut encoder = StripEncoder::new(1);
        let strip = |band: &warplight_protocol::frame::TreeRows<'_>| {
            let mut bytes = Vec::new();
            encoder.encode(&shape(), band, &mut bytes);
            StripMessage { frame: FrameId(id), bytes }
        };
        tree.bands_mut(8).iter().map(strip).collect()
    }

    fn feed(assembler: &mut Assembler, strip: &StripMessage) -> Result<(), DecodeError> {
        assembler.strip(strip, || Duration::from_millis(1))
    }

    #[test]
    fn strips_in_any_order_make_a_frame() {
        let mut assembler = Assembler::default();
        assembler.begin(begin(1));
        for strip in strips(1).iter().rev() {
            feed(&mut assembler, strip).unwrap();
        }
        let frame = assembler.end(end(1), Timestamp { micros: 5 }, Timestamp { micros: 9 }).unwrap();
        assert_eq!(frame.decode_time, Duration::from_millis(3));
        assert_eq!(frame.bytes, strips(1).iter().map(|strip| strip.bytes.len() as u64).sum::<u64>());
        assert!(frame.tree.nodes[0].distance.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn a_frame_that_lacks_a_strip_or_has_one_twice_is_refused() {
        let mut assembler = Assembler::default();
        assembler.begin(begin(1));
        feed(&mut assembler, &strips(1)[0]).unwrap();
        assert!(feed(&mut assembler, &strips(1)[0]).is_err(), "twice");
        assert!(feed(&mut assembler, &strips(2)[1]).is_err(), "of another frame");
        assert!(assembler.end(end(1), Timestamp::ZERO, Timestamp::ZERO).is_err(), "not whole");
        assert!(feed(&mut assembler, &strips(1)[1]).is_err(), "of no frame");
    }

    #[test]
    fn memory_of_retired_frames_is_used_again_but_not_while_somebody_holds_them() {
        let mut assembler = Assembler::default();
        let mut make = |id: u32, retire: Option<Arc<ReadyFrame>>| {
            retire.into_iter().for_each(|frame| assembler.retire(frame));
            assembler.begin(begin(id));
            strips(id).iter().for_each(|strip| feed(&mut assembler, strip).unwrap());
            assembler.end(end(id), Timestamp::ZERO, Timestamp::ZERO).unwrap()
        };
        let memory = |frame: &ReadyFrame| frame.tree.nodes[0].distance.as_ptr();
        let first = make(1, None);
        let first_memory = memory(&first);
        let held = first.clone();
        let second = make(2, Some(first));
        assert_ne!(memory(&second), first_memory, "the first is still held");
        drop(held);
        let third = make(3, Some(second));
        assert_eq!(memory(&third), first_memory);
    }
}
