//! One stream of pictures, decoded by OpenH264.
//!
//! What comes from a peer is one slice and nothing else: [`PictureDecoder::decode`] looks at its header before the codec
//! sees it, and writes the parameter sets itself, so the size of what is decoded is the canvas that was announced and
//! checked. Concealment is off: a picture is decoded as it was meant, or refused. What the codec makes of a damaged slice
//! that still parses is a picture with wrong pixels, never undefined ones: it is not told apart from a right one.
//!
//! Limits: after an error the stream needs a key picture, and is given a new codec for it. Cost: 2 to 5 ms for a plane of
//! 1024 x 1024 where `nasm` was there at build time, about twice that without.

use super::encoder::call;
use super::parameters::{self, KEY_SLICE, SLICE_TYPE, START_CODE};
use super::{Canvas, VideoError};
use crate::codec::DecodeError;
use openh264_sys2 as h264;
use std::ffi::c_int;
use std::ptr::{from_mut, from_ref, null_mut};

/// Decodes the pictures of one plane.
#[derive(Debug, Default)]
pub struct PictureDecoder {
    codec: Option<Codec>,
    stream: Vec<u8>,
}

/// A picture that was decoded: rows of luma, and rows of chroma of half the size. It is the codec's memory.
#[derive(Clone, Copy, Debug)]
pub struct Decoded<'a> {
    /// Size of the luma.
    pub canvas: Canvas,
    /// Luma, blue and red: samples, and how far it is from row to row.
    pub planes: [(&'a [u8], usize); 3],
}

#[derive(Debug)]
struct Codec {
    handle: *mut h264::ISVCDecoder,
    canvas: Canvas,
}

// SAFETY: decoding without threads (the default); the codec is reached through `&mut` alone.
#[allow(unsafe_code)]
unsafe impl Send for Codec {}

const MISSING: VideoError = VideoError::Codec { doing: "looking for its functions", code: 0 };
const REFUSED: DecodeError =
    DecodeError::Malformed { field: "bytes of picture", expected: "one slice of a whole picture" };

impl PictureDecoder {
    /// Decodes a picture of this canvas; `key` says that it needs none before it.
    pub fn decode(&mut self, canvas: Canvas, key: bool, bytes: &[u8]) -> Result<Decoded<'_>, DecodeError> {
        if !canvas.is_valid() {
            let expected = "whole macroblocks, at most 36864 of them";
            return Err(DecodeError::Malformed { field: "canvas of picture", expected });
        }
        check_slice(bytes, key)?;
        // What fails leaves no codec behind, so that only a key picture can follow.
        let codec = self.codec.take().filter(|codec| codec.canvas == canvas);
        let mut codec = match codec {
            Some(codec) => codec,
            None if key => Codec::new(canvas).map_err(|_| REFUSED)?,
            None => {
                let expected = "a key picture first, and where the canvas changes";
                return Err(DecodeError::Malformed { field: "reference of picture", expected });
            }
        };
        self.stream.clear();
        if key {
            for set in [parameters::sequence(canvas), parameters::picture()] {
                self.stream.extend_from_slice(&START_CODE);
                self.stream.extend_from_slice(&set);
            }
        }
        self.stream.extend_from_slice(&START_CODE);
        self.stream.extend_from_slice(bytes);
        let planes = codec.decode(&self.stream).map_err(|_| REFUSED)?.ok_or(REFUSED)?;
        let codec = self.codec.insert(codec);
        Ok(codec.borrow(planes))
    }
}

/// Refuses whatever is not one slice that begins a picture, of the right kind.
fn check_slice(bytes: &[u8], key: bool) -> Result<(), DecodeError> {
    let [header, first, ..] = *bytes else {
        return Err(DecodeError::Truncated { field: "bytes of picture" });
    };
    let is_kind = if key { header == KEY_SLICE } else { header & 0x9f == SLICE_TYPE && header & 0x60 != 0 };
    // Numbers as in 9.1: first_mb_in_slice is 0, and slice_type I (2, 7) or P (0, 5) of this slice or of the picture.
    let is_whole = if key {
        first & 0xf0 == 0b1011_0000 || first == 0b1000_1000
    } else {
        first & 0xc0 == 0b1100_0000 || first & 0xfc == 0b1001_1000
    };
    // Three bytes of which the third would begin another unit.
    let is_one = !bytes.windows(3).any(|three| three[0] == 0 && three[1] == 0 && three[2] < 3);
    if is_kind && is_whole && is_one { Ok(()) } else { Err(REFUSED) }
}

/// Where the codec keeps what it decoded.
struct Planes {
    at: [*mut u8; 3],
    strides: [usize; 2],
}

impl Codec {
    fn new(canvas: Canvas) -> Result<Codec, VideoError> {
        // The codec's `long` has 32 or 64 bits.
        fn failed(doing: &'static str, code: impl Into<i64>) -> VideoError {
            VideoError::Codec { doing, code: code.into() }
        }
        let mut handle = null_mut();
        // SAFETY: writes a handle, or leaves it as it is.
        #[allow(unsafe_code)]
        let made = unsafe { h264::source::APILoader::WelsCreateDecoder(from_mut(&mut handle)) };
        if made != 0 || handle.is_null() {
            return Err(failed("making a decoder", made));
        }
        let codec = Codec { handle, canvas };
        let mut quiet: c_int = h264::WELS_LOG_QUIET;
        let quiet = from_mut(&mut quiet).cast();
        call!(codec.handle, SetOption, h264::DECODER_OPTION_TRACE_LEVEL, quiet)?;
        let mut parameters =
            h264::SDecodingParam { eEcActiveIdc: h264::ERROR_CON_DISABLE, bParseOnly: false, ..Default::default() };
        parameters.sVideoProperty.eVideoBsType = h264::VIDEO_BITSTREAM_AVC;
        match call!(codec.handle, Initialize, from_ref(&parameters))? {
            0 => Ok(codec),
            code => Err(failed("taking its parameters", code)),
        }
    }

    /// The one picture that the stream holds, if it does.
    fn decode(&mut self, stream: &[u8]) -> Result<Option<Planes>, VideoError> {
        let Ok(length) = c_int::try_from(stream.len()) else { return Ok(None) };
        let mut planes = [null_mut::<u8>(); 3];
        let mut about = h264::SBufferInfo::default();
        let destination = from_mut(&mut planes).cast();
        let state = call!(self.handle, DecodeFrameNoDelay, stream.as_ptr(), length, destination, from_mut(&mut about))?;
        if state != 0 {
            return Err(VideoError::Codec { doing: "decoding a picture", code: i64::from(state) });
        }
        if about.iBufferStatus == 0 {
            // In the high profile the codec holds a picture back, although none is shown before it.
            let destination = from_mut(&mut planes).cast();
            let state = call!(self.handle, FlushFrame, destination, from_mut(&mut about))?;
            if state != 0 || about.iBufferStatus == 0 {
                return Ok(None);
            }
        }
        // SAFETY: a union of one variant.
        #[allow(unsafe_code)]
        let memory = unsafe { about.UsrData.sSystemBuffer };
        let [width, height] = [self.canvas.width, self.canvas.height].map(c_int::from);
        let is_canvas = memory.iWidth == width && memory.iHeight == height;
        let has_rows = memory.iStride[0] >= width && memory.iStride[1] >= width / 2;
        if !is_canvas || !has_rows || planes.iter().any(|plane| plane.is_null()) {
            return Ok(None);
        }
        Ok(Some(Planes { at: planes, strides: memory.iStride.map(|stride| stride as usize) }))
    }

    /// The picture, for as long as the codec is not asked for another.
    fn borrow(&mut self, Planes { at, strides }: Planes) -> Decoded<'_> {
        let (width, height) = (usize::from(self.canvas.width), usize::from(self.canvas.height));
        let plane = |at: *mut u8, stride: usize, width: usize, height: usize| {
            // SAFETY: the codec's picture has `height` rows of `stride` samples, of which the last row has at least
            // `width`; it is kept until the codec is called again, which needs this borrow to be over.
            #[allow(unsafe_code)]
            let samples = unsafe { std::slice::from_raw_parts(at.cast_const(), (height - 1) * stride + width) };
            (samples, stride)
        };
        let planes = [
            plane(at[0], strides[0], width, height),
            plane(at[1], strides[1], width / 2, height / 2),
            plane(at[2], strides[1], width / 2, height / 2),
        ];
        Decoded { canvas: self.canvas, planes }
    }
}

impl Drop for Codec {
    fn drop(&mut self) {
        let _ = call!(self.handle, Uninitialize);
        // SAFETY: the handle is the codec's own, and nobody uses it after this.
        #[allow(unsafe_code)]
        unsafe {
            h264::source::APILoader::WelsDestroyDecoder(self.handle);
        }
    }
}
