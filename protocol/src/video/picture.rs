//! What a picture is: its canvas, its place in it, and what stands before its bytes on the wire.

use crate::ImageSize;
use crate::codec::{DecodeError, PlaneKind};
use crate::frame::FrameId;

/// Size of the pictures of a stream, in pixels: whole macroblocks of 16 x 16.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Canvas {
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
}

impl Canvas {
    /// Side of a macroblock.
    pub const BLOCK_PX: usize = 16;
    /// Most macroblocks of a picture, by level 5.2 (ITU-T H.264, table A-1).
    pub const MAX_BLOCKS: usize = 36_864;
    /// Most pixels of a side, by the same level: the square root of eight times as many macroblocks.
    pub const MAX_SIDE_PX: u16 = 8688;

    /// The smallest that holds a frame.
    pub fn around(frame: ImageSize) -> Canvas {
        let whole = |px: u32| px.next_multiple_of(Self::BLOCK_PX as u32).min(u32::from(u16::MAX) / 16 * 16) as u16;
        Canvas { width: whole(frame.width), height: whole(frame.height) }
    }

    /// Pixels.
    pub fn pixels(&self) -> usize {
        usize::from(self.width) * usize::from(self.height)
    }

    /// Whether it has whole macroblocks, at least one and not too many for the codec.
    pub fn is_valid(&self) -> bool {
        let side = |px: u16| (16..=Self::MAX_SIDE_PX).contains(&px) && px.is_multiple_of(16);
        side(self.width) && side(self.height) && self.pixels() <= Self::MAX_BLOCKS * 256
    }
}

/// Where in its canvas a frame lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Placement {
    /// The canvas.
    pub canvas: Canvas,
    /// Column of the frame's first, even.
    pub x: u16,
    /// Row of the frame's first, even.
    pub y: u16,
}

impl Placement {
    /// A canvas is at most twice as wide and high as the frame in it, and this: what a guard band can come to and go
    /// from. So the limits on a frame bound what its pictures take.
    pub const SLACK_PX: usize = 128;

    /// Refuses what does not hold a frame of this size, and what is larger than it needs to be.
    pub fn check(&self, frame: ImageSize) -> Result<(), DecodeError> {
        let malformed = |field, expected| Err(DecodeError::Malformed { field, expected });
        let Canvas { width, height } = self.canvas;
        if !self.canvas.is_valid() {
            return malformed("canvas of picture", "whole macroblocks, at most 36864 of them");
        }
        let most = |px: u32| 2 * px as usize + Self::SLACK_PX;
        if usize::from(width) > most(frame.width) || usize::from(height) > most(frame.height) {
            return malformed("canvas of picture", "at most twice the frame and 128 px");
        }
        let fits =
            |at: u16, px: u32, side: u16| at.is_multiple_of(2) && u64::from(at) + u64::from(px) <= u64::from(side);
        if !fits(self.x, frame.width, width) || !fits(self.y, frame.height, height) {
            return malformed("place of picture", "even, and the frame within the canvas");
        }
        Ok(())
    }
}

/// What stands before the bytes of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PictureHead {
    /// The frame.
    pub frame: FrameId,
    /// Node of the plan, or layer of the volume.
    pub node: u8,
    /// [`PlaneKind::Radiance`] or [`PlaneKind::Source`].
    pub kind: PlaneKind,
    /// The frame whose picture of this plane it is predicted from; none for a key picture.
    pub reference: Option<FrameId>,
    /// Where the frame lies.
    pub placement: Placement,
    /// Radiance of the largest code.
    pub white: f32,
}

impl PictureHead {
    /// Bytes on the wire.
    pub const BYTES: usize = 22;

    /// The bytes of the table in `docs/wire-format.md`.
    pub fn to_bytes(&self) -> [u8; Self::BYTES] {
        let Placement { canvas, x, y } = self.placement;
        let mut bytes = [0; Self::BYTES];
        bytes[..4].copy_from_slice(&self.frame.0.to_le_bytes());
        bytes[4] = self.node;
        bytes[5] = self.kind as u8;
        bytes[6..10].copy_from_slice(&self.reference.map_or(0, |frame| frame.0).to_le_bytes());
        for (at, value) in [(10, canvas.width), (12, canvas.height), (14, x), (16, y)] {
            bytes[at..at + 2].copy_from_slice(&value.to_le_bytes());
        }
        bytes[18..].copy_from_slice(&self.white.to_le_bytes());
        bytes
    }

    /// Reads them; what cannot be of any frame is refused.
    pub fn from_bytes(bytes: &[u8; Self::BYTES]) -> Result<PictureHead, DecodeError> {
        let four = |at: usize| [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
        let two = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let kinds = [PlaneKind::Radiance, PlaneKind::Source];
        let kind = kinds.into_iter().find(|&kind| kind as u8 == bytes[5]);
        let expected = "radiance or source";
        let kind = kind.ok_or(DecodeError::Malformed { field: "kind of picture", expected })?;
        let white = f32::from_le_bytes(four(18));
        if !(white > 0.0 && white.is_finite()) {
            return Err(DecodeError::Malformed { field: "white of picture", expected: "a finite radiance above 0" });
        }
        let reference = u32::from_le_bytes(four(6));
        Ok(PictureHead {
            frame: FrameId(u32::from_le_bytes(four(0))),
            node: bytes[4],
            kind,
            reference: (reference != 0).then_some(FrameId(reference)),
            placement: Placement { canvas: Canvas { width: two(10), height: two(12) }, x: two(14), y: two(16) },
            white,
        })
    }
}

/// Luma and chroma of a canvas, row by row: a picture on its way to the encoder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Size of the luma; chroma has half of each side.
    pub canvas: Canvas,
    /// Luma.
    pub luma: Vec<u8>,
    /// Blue and red less luma, about 128.
    pub chroma: [Vec<u8>; 2],
}

impl Picture {
    /// A picture that is [`super::fill::NOTHING`] everywhere.
    pub fn new(canvas: Canvas) -> Picture {
        let pixels = canvas.pixels();
        let [luma, blue, red] = super::fill::NOTHING;
        Picture { canvas, luma: vec![luma; pixels], chroma: [vec![blue; pixels / 4], vec![red; pixels / 4]] }
    }
}
