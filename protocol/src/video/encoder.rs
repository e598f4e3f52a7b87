//! One stream of pictures, encoded by OpenH264.
//!
//! The codec's own rate control is off: every picture has the quantiser that it is given, the same for all of its
//! macroblocks, because what an error costs in the displayed picture is known outside. Nothing decides by itself to
//! begin anew: key pictures come when they are asked for, and where the canvas changes. Off, too, is what is made for
//! cameras and screens: denoising, detection of backgrounds and of scene changes, adaptive quantisation, skipping.
//! CABAC and deblocking are on (figures in `docs/measurements/2026-11-22-video.md`). One reference, the picture before.
//!
//! Cost: 3 to 8 ms for a plane of 1024 x 1024 where `nasm` was there at build time, about three times that without.

use super::parameters::{self, KEY_SLICE, START_CODE};
use super::{Canvas, Picture, VideoError};
use openh264_sys2 as h264;
use std::ffi::c_int;
use std::ptr::{from_mut, from_ref, null_mut};

/// Encodes the pictures of one plane.
#[derive(Debug)]
pub struct PictureEncoder {
    codec: Option<Codec>,
}

/// A codec made for one canvas.
#[derive(Debug)]
struct Codec {
    handle: *mut h264::ISVCEncoder,
    canvas: Canvas,
    parameters: Box<h264::SEncParamExt>,
}

// SAFETY: the codec has no thread of its own (one slice, `iMultipleThreadIdc` 1) and keeps nothing by thread; it is
// reached through `&mut` alone, so by one thread at a time.
#[allow(unsafe_code)]
unsafe impl Send for Codec {}

impl Default for PictureEncoder {
    fn default() -> PictureEncoder {
        PictureEncoder::new()
    }
}

impl PictureEncoder {
    /// An encoder whose first picture will be a key picture.
    pub fn new() -> PictureEncoder {
        PictureEncoder { codec: None }
    }

    /// Encodes a picture at a quantiser of 0 to 51, as a key picture if `key`, if it is the first, or if its canvas is
    /// another; appends its bytes to `out` and tells whether it is a key picture.
    pub fn encode(
        &mut self,
        picture: &Picture,
        quantiser: u8,
        key: bool,
        out: &mut Vec<u8>,
    ) -> Result<bool, VideoError> {
        let usable = self.codec.take().filter(|codec| codec.canvas == picture.canvas);
        let is_new = usable.is_none();
        let mut codec = match usable {
            Some(codec) => codec,
            None => Codec::new(picture.canvas, quantiser)?,
        };
        codec.quantise_by(quantiser)?;
        // A codec that failed is not used again.
        codec.encode(picture, key || is_new, out)?;
        self.codec = Some(codec);
        Ok(key || is_new)
    }
}

/// Success, or what the codec said.
fn checked(doing: &'static str, code: c_int) -> Result<(), VideoError> {
    if code == 0 { Ok(()) } else { Err(VideoError::Codec { doing, code: i64::from(code) }) }
}

const MISSING: VideoError = VideoError::Codec { doing: "looking for its functions", code: 0 };

/// Calls a function of the codec's table.
macro_rules! call {
    ($handle:expr, $function:ident $(, $argument:expr)*) => {{
        let handle = $handle;
        // SAFETY: a handle is one that the codec made and has not destroyed, and its table outlives it; what the
        // arguments point to lives through the call and is as large as the codec's header says.
        #[allow(unsafe_code)]
        unsafe { (**handle).$function.ok_or(MISSING).map(|function| function(handle $(, $argument)*)) }
    }};
}
pub(super) use call;

impl Codec {
    fn new(canvas: Canvas, quantiser: u8) -> Result<Codec, VideoError> {
        if !canvas.is_valid() {
            return Err(VideoError::Codec { doing: "taking a canvas", code: 0 });
        }
        let mut handle = null_mut();
        // SAFETY: writes a handle, or leaves it as it is.
        #[allow(unsafe_code)]
        let made = unsafe { h264::source::APILoader::WelsCreateSVCEncoder(from_mut(&mut handle)) };
        checked("making an encoder", made)?;
        if handle.is_null() {
            return Err(MISSING);
        }
        let mut codec = Codec { handle, canvas, parameters: Box::default() };
        let mut quiet: c_int = h264::WELS_LOG_QUIET;
        let quiet = from_mut(&mut quiet).cast();
        call!(codec.handle, SetOption, h264::ENCODER_OPTION_TRACE_LEVEL, quiet)?;
        let parameters = from_mut(&mut *codec.parameters);
        checked("asking for defaults", call!(codec.handle, GetDefaultParams, parameters)?)?;
        let parameters = &mut *codec.parameters;
        (parameters.iPicWidth, parameters.iPicHeight) = (canvas.width.into(), canvas.height.into());
        parameters.iUsageType = h264::CAMERA_VIDEO_REAL_TIME;
        parameters.iRCMode = h264::RC_OFF_MODE;
        parameters.iComplexityMode = h264::MEDIUM_COMPLEXITY;
        // Rate control is off: no rate is reached with these, but the codec wants some.
        (parameters.iTargetBitrate, parameters.fMaxFrameRate) = (100_000_000, 30.0);
        (parameters.iTemporalLayerNum, parameters.iSpatialLayerNum) = (1, 1);
        (parameters.uiIntraPeriod, parameters.iNumRefFrame) = (0, 1);
        parameters.eSpsPpsIdStrategy = h264::CONSTANT_ID;
        parameters.iEntropyCodingModeFlag = 1;
        (parameters.iMinQp, parameters.iMaxQp) = (0, 51);
        parameters.iMultipleThreadIdc = 1;
        parameters.iLoopFilterDisableIdc = 0;
        parameters.bEnableFrameSkip = false;
        parameters.bEnableLongTermReference = false;
        parameters.bEnableDenoise = false;
        parameters.bEnableBackgroundDetection = false;
        parameters.bEnableAdaptiveQuant = false;
        parameters.bEnableSceneChangeDetect = false;
        parameters.bEnableFrameCroppingFlag = true;
        parameters.bPrefixNalAddingCtrl = false;
        let layer = &mut parameters.sSpatialLayers[0];
        (layer.iVideoWidth, layer.iVideoHeight) = (canvas.width.into(), canvas.height.into());
        (layer.iSpatialBitrate, layer.iMaxSpatialBitrate, layer.fFrameRate) = (100_000_000, 0, 30.0);
        (layer.uiProfileIdc, layer.uiLevelIdc) = (h264::PRO_HIGH, h264::LEVEL_5_2);
        layer.iDLayerQp = quantiser.into();
        layer.sSliceArgument.uiSliceMode = h264::SM_SINGLE_SLICE;
        layer.sSliceArgument.uiSliceNum = 1;
        let parameters = from_ref(parameters);
        checked("taking its parameters", call!(codec.handle, InitializeExt, parameters)?)?;
        Ok(codec)
    }

    /// The quantiser of the next picture. Changing nothing else leaves references as they are.
    fn quantise_by(&mut self, quantiser: u8) -> Result<(), VideoError> {
        let quantiser = c_int::from(quantiser.min(51));
        let layer = &mut self.parameters.sSpatialLayers[0];
        if layer.iDLayerQp == quantiser {
            return Ok(());
        }
        layer.iDLayerQp = quantiser;
        let parameters = from_mut(&mut *self.parameters).cast();
        let option = h264::ENCODER_OPTION_SVC_ENCODE_PARAM_EXT;
        checked("taking a quantiser", call!(self.handle, SetOption, option, parameters)?)
    }

    fn encode(&mut self, picture: &Picture, key: bool, out: &mut Vec<u8>) -> Result<(), VideoError> {
        if key {
            checked("beginning anew", call!(self.handle, ForceIntraFrame, true)?)?;
        }
        let width = c_int::from(self.canvas.width);
        let [luma, blue, red] = [&picture.luma, &picture.chroma[0], &picture.chroma[1]];
        let pixels = self.canvas.pixels();
        if luma.len() != pixels || blue.len() != pixels / 4 || red.len() != pixels / 4 {
            return Err(VideoError::Codec { doing: "taking a picture", code: 0 });
        }
        let source = h264::SSourcePicture {
            iColorFormat: h264::videoFormatI420,
            iStride: [width, width / 2, width / 2, 0],
            // The codec only reads them.
            pData: [luma.as_ptr().cast_mut(), blue.as_ptr().cast_mut(), red.as_ptr().cast_mut(), null_mut()],
            iPicWidth: width,
            iPicHeight: self.canvas.height.into(),
            ..Default::default()
        };
        let mut encoded = Box::<h264::SFrameBSInfo>::default();
        let code = call!(self.handle, EncodeFrame, from_ref(&source), from_mut(&mut *encoded))?;
        checked("encoding a picture", code)?;
        let mut slices = 0;
        for unit in units(&encoded) {
            let is_key_slice = unit.first() == Some(&KEY_SLICE);
            match unit.first().map_or(0, |header| header & 31) {
                5 | 1 if is_key_slice == key => {
                    out.extend_from_slice(unit);
                    slices += 1;
                }
                7 if unit == parameters::sequence(self.canvas) => {}
                8 if unit == parameters::picture() => {}
                other => return Err(VideoError::Codec { doing: "writing a unit of type", code: other.into() }),
            }
        }
        if slices == 1 { Ok(()) } else { Err(VideoError::Codec { doing: "writing slices", code: slices }) }
    }
}

/// The units of what the codec wrote, without their start codes.
fn units(encoded: &h264::SFrameBSInfo) -> Vec<&[u8]> {
    let mut units = Vec::new();
    for layer in encoded.sLayerInfo.iter().take(encoded.iLayerNum.max(0) as usize) {
        let mut at = 0;
        for unit in 0..layer.iNalCount.max(0) as usize {
            // SAFETY: the codec fills in `iNalCount` lengths, and `pBsBuf` holds as many bytes as they add up to; both
            // are its own memory until it is called again, for which it must not be borrowed.
            #[allow(unsafe_code)]
            let bytes = unsafe {
                let length = (*layer.pNalLengthInByte.add(unit)).max(0) as usize;
                std::slice::from_raw_parts(layer.pBsBuf.add(at), length)
            };
            at += bytes.len();
            units.push(bytes.strip_prefix(&START_CODE).unwrap_or(bytes));
        }
    }
    units
}

impl Drop for Codec {
    fn drop(&mut self) {
        let _ = call!(self.handle, Uninitialize);
        // SAFETY: the handle is the codec's own, and nobody uses it after this.
        #[allow(unsafe_code)]
        unsafe {
            h264::source::APILoader::WelsDestroySVCEncoder(self.handle);
        }
    }
}
