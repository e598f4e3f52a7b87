//! The settings of each knob of the codec; all others stay at their defaults.

use super::super::Request;
use warplight_protocol::codec::StripEncoder;
use warplight_protocol::frame::{ColorCoding, ColorFormat, DepthBound, DepthFormat, FrameFormat};

/// One setting: how frames are coded.
#[derive(Clone, Debug)]
pub(in crate::sweep) struct Setting {
    pub(in crate::sweep) value: String,
    pub(in crate::sweep) format: FrameFormat,
    pub(in crate::sweep) zstd_level: i32,
}

impl Setting {
    /// A format, with nothing lost where the knob does not say otherwise.
    fn new(value: impl ToString, format: FrameFormat) -> Setting {
        Setting { value: value.to_string(), format, zstd_level: StripEncoder::DEFAULT_LEVEL }
    }
}

impl Setting {
    /// A format of colour alone: all else as fine as it gets.
    pub(in crate::sweep) fn of_color(color: ColorFormat) -> Setting {
        Setting::new(format!("{color:?}").to_lowercase(), FrameFormat { color, ..finest() })
    }

    /// So many bits of depth alone: all else as fine as it gets.
    pub(in crate::sweep) fn of_depth(bits: u8) -> Setting {
        Setting::new(format!("{bits} bits"), finest().with_depth_bits(bits, bits))
    }
}

/// Nothing coarser than it has to be.
fn finest() -> FrameFormat {
    FrameFormat { color: ColorFormat::Half, normal_bits: 16, shape_bits: 12, ..FrameFormat::exact() }
        .with_depth_bits(24, 24)
}

/// Every format of colour.
pub(in crate::sweep) fn color_formats() -> Vec<Setting> {
    ColorFormat::ALL.map(Setting::of_color).to_vec()
}

/// Colour that is coded as it is, and depths that hold the default promise.
fn plain() -> FrameFormat {
    let depth = DepthFormat::Bounded(DepthBound::default());
    FrameFormat { color: ColorFormat::Root8, color_coding: ColorCoding::Exact, depth, ..FrameFormat::default() }
}

/// Promises about depth, from a twentieth of a pixel to two; and codes, as they are.
pub(in crate::sweep) fn depth_bounds(request: &Request<'_>) -> Vec<Setting> {
    let (errors, bits): (&[u16], &[u8]) = match request.quick {
        true => (&[25, 100], &[16]),
        false => (&[5, 10, 25, 50, 100, 200], &[10, 12, 16, 24]),
    };
    let promised = errors.iter().map(|&error_centi_px| {
        let bound = DepthBound { error_centi_px, ..DepthBound::default() };
        let value = format!("{} px", f64::from(error_centi_px) * 0.01);
        Setting::new(value, FrameFormat { depth: DepthFormat::Bounded(bound), ..plain() })
    });
    let as_they_are =
        bits.iter().map(|&bits| Setting::new(format!("{bits} bits"), plain().with_depth_bits(bits, bits)));
    promised.chain(as_they_are).collect()
}

/// How much coarser children may be than the root.
pub(in crate::sweep) fn child_bounds(request: &Request<'_>) -> Vec<Setting> {
    let factors: &[u8] = if request.quick { &[1, 4] } else { &[1, 2, 4, 8, 16] };
    let setting = |&child_factor: &u8| {
        let bound = DepthBound { child_factor, ..DepthBound::default() };
        Setting::new(child_factor, FrameFormat { depth: DepthFormat::Bounded(bound), ..plain() })
    };
    factors.iter().map(setting).collect()
}

/// Codes of colour as they are, within bounds, and as video.
pub(in crate::sweep) fn colors(request: &Request<'_>) -> Vec<Setting> {
    let (formats, errors, quantisers): (&[ColorFormat], &[u8], &[u8]) = match request.quick {
        true => (&[ColorFormat::Root8], &[2], &[24, 32]),
        false => (&ColorFormat::ALL, &[1, 2, 4, 8, 16], &[16, 20, 24, 28, 32, 36, 40]),
    };
    let exact = formats.iter().map(|&color| {
        let name = format!("{color:?}").to_lowercase();
        Setting::new(name, FrameFormat { color, ..plain() })
    });
    let bounded = errors.iter().map(|&error| {
        let color_coding = ColorCoding::Bounded { error };
        Setting::new(format!("bounded:{error}"), FrameFormat { color_coding, ..plain() })
    });
    let video = quantisers.iter().map(|&quantiser| {
        let color_coding = ColorCoding::Video { quantiser };
        Setting::new(format!("video:{quantiser}"), FrameFormat { color_coding, ..plain() })
    });
    exact.chain(bounded).chain(video).collect()
}

/// Effort of the general compressor behind the predictors.
pub(in crate::sweep) fn zstd_levels(request: &Request<'_>) -> Vec<Setting> {
    let levels: &[i32] = if request.quick { &[1, 6] } else { &[-5, 1, 2, 3, 6, 9, 12] };
    levels.iter().map(|&zstd_level| Setting { zstd_level, ..Setting::new(zstd_level, plain()) }).collect()
}
