//! Pictures of a frame: which are expected, and from bytes to radiance.
//!
//! A frame's pictures come after its strips. They are kept until the last is there and then decoded in parallel, each by
//! the decoder of its plane, which holds the picture before. What a picture shows where a node knows nothing is written,
//! too: nothing reads it, because the validity that came in the strips says so.

use rayon::prelude::*;
use warplight_protocol::ImageSize;
use warplight_protocol::codec::{DecodeError, FrameShape, PlaneKind};
use warplight_protocol::frame::{ColorFormat, FrameId, Tree};
use warplight_protocol::message::PictureMessage;
use warplight_protocol::video::{PictureDecoder, dequantise};

type Plane = (u8, PlaneKind);

/// The decoders of a session, one for each plane.
#[derive(Debug, Default)]
pub(crate) struct PictureDecoders {
    planes: Vec<(Plane, PlaneDecoder)>,
}

#[derive(Debug, Default)]
struct PlaneDecoder {
    decoder: PictureDecoder,
    /// The frame whose picture was decoded last.
    reference: Option<FrameId>,
}

/// Pictures of the frame that is being put together.
#[derive(Debug, Default)]
pub(crate) struct PendingPictures {
    expected: Vec<Plane>,
    arrived: Vec<Option<PictureMessage>>,
}

impl PendingPictures {
    /// What a frame of this shape has.
    pub(crate) fn of(shape: &FrameShape) -> PendingPictures {
        let expected = shape.pictures();
        PendingPictures { arrived: vec![None; expected.len()], expected }
    }

    /// Takes one in: of a plane of the frame, for the first time, and placed so that it holds the frame.
    pub(crate) fn push(&mut self, picture: PictureMessage, size: ImageSize) -> Result<(), DecodeError> {
        let plane = (picture.head.node, picture.head.kind);
        let wrong = |expected| Err(DecodeError::Malformed { field: "picture", expected });
        let Some(index) = self.expected.iter().position(|&expected| expected == plane) else {
            return wrong("a plane of the frame that is a picture");
        };
        picture.head.placement.check(size)?;
        match self.arrived[index].replace(picture) {
            None => Ok(()),
            Some(_) => wrong("each plane only once"),
        }
    }

    /// Whether all have arrived.
    pub(crate) fn is_whole(&self) -> bool {
        self.arrived.iter().all(Option::is_some)
    }
}

impl PictureDecoders {
    /// Of another session: nothing that was decoded is a reference any more.
    pub(crate) fn forget(&mut self) {
        self.planes.clear();
    }

    /// Decodes the pictures of a frame into its tree.
    pub(crate) fn decode(
        &mut self,
        shape: &FrameShape,
        pending: &mut PendingPictures,
        tree: &mut Tree,
    ) -> Result<(), DecodeError> {
        // In the order of the frame's pictures: nodes, then layers. What a frame lacks has no references any more.
        let mut kept = std::mem::take(&mut self.planes);
        for &plane in &pending.expected {
            let known = kept.iter().position(|(of, _)| *of == plane);
            self.planes.push(known.map_or_else(|| (plane, PlaneDecoder::default()), |at| kept.swap_remove(at)));
        }
        let has = |kind| pending.expected.iter().any(|plane| plane.1 == kind);
        let nodes = tree.nodes.iter_mut().filter(|_| has(PlaneKind::Radiance));
        let nodes = nodes.map(|planes| (shape.format.color, &mut planes.radiance));
        let layers = tree.layers.iter_mut().filter(|_| has(PlaneKind::Source));
        let layers = layers.map(|planes| (shape.format.volume.source, &mut planes.source));
        let targets: Vec<_> = nodes.chain(layers).collect();
        let pictures: Vec<_> = pending.arrived.iter_mut().filter_map(Option::take).collect();
        let size = shape.camera.size;
        let planes = self.planes.par_iter_mut().zip(pictures).zip(targets);
        planes.try_for_each(|(((_, plane), picture), (color, radiance))| plane.decode(&picture, color, size, radiance))
    }
}

impl PlaneDecoder {
    fn decode(
        &mut self,
        picture: &PictureMessage,
        color: ColorFormat,
        size: ImageSize,
        radiance: &mut [Vec<f32>; 3],
    ) -> Result<(), DecodeError> {
        let head = &picture.head;
        // What fails leaves no reference.
        let known = self.reference.take();
        if head.reference.is_some() && head.reference != known {
            let expected = "the picture before it of its plane, or none";
            return Err(DecodeError::Malformed { field: "reference of picture", expected });
        }
        let decoded = self.decoder.decode(head.placement.canvas, head.reference.is_none(), &picture.bytes)?;
        let radiance = radiance.each_mut().map(Vec::as_mut_slice);
        dequantise(color, head.white, size, &decoded, &head.placement, radiance);
        self.reference = Some(head.frame);
        Ok(())
    }
}
