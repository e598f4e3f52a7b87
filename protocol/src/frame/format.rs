//! What the planes are quantised to: the rungs of the ladder between bytes and accuracy.

use crate::tone::{ToneTable, linear_from_srgb8};
use half::f16;
use serde::{Deserialize, Serialize};
use std::sync::LazyLock;

/// How linear radiance becomes an integer per channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ColorFormat {
    /// 8 bits, linear up to the strip's white: the thesis's choice.
    Linear8,
    /// 8 bits, square-root companded up to the strip's white: steps that look alike, as with sRGB, but
    /// exact to invert.
    Root8,
    /// 10 bits, square-root companded.
    Root10,
    /// A half float per channel: no white, no clipping below 65504.
    Half,
    /// 8 bits by the transfer of displays (IEC 61966-2-1) up to the strip's white.
    Srgb8,
    /// Nine bits per channel and five of an exponent that all three share, as `RGB9_E5` of graphics cards
    /// (EXT_texture_shared_exponent): no white, no clipping below 65408. Each channel's code carries the exponent in its upper five bits, so that
    /// its value is known by itself; differences of channels then cost no more than those of their nine bits.
    Rgb9e5,
}

impl ColorFormat {
    /// Every format, by wire code.
    pub const ALL: [ColorFormat; 6] = [
        ColorFormat::Linear8,
        ColorFormat::Root8,
        ColorFormat::Root10,
        ColorFormat::Half,
        ColorFormat::Srgb8,
        ColorFormat::Rgb9e5,
    ];

    /// Whether codes that are close to each other always have values that are: not those of floats, where a carry moves
    /// into the exponent.
    pub const fn has_even_steps(self) -> bool {
        !matches!(self, ColorFormat::Half | ColorFormat::Rgb9e5)
    }

    /// Bits per channel.
    pub const fn bits(self) -> usize {
        match self {
            ColorFormat::Linear8 | ColorFormat::Root8 | ColorFormat::Srgb8 => 8,
            ColorFormat::Root10 => 10,
            ColorFormat::Rgb9e5 => (MANTISSA_BITS + EXPONENT_BITS) as usize,
            ColorFormat::Half => 16,
        }
    }

    /// The code of a linear value; not a number and below zero give 0, above `white` the largest.
    #[inline(always)]
    pub fn quantise(self, value: f32, white: f32) -> u16 {
        // Comparisons that NaN fails, and that are one instruction each.
        let value = if value > 0.0 { value } else { 0.0 };
        let fraction = |value: f32| if value < white { value / white } else { 1.0 };
        match self {
            ColorFormat::Linear8 => nearest_integer(fraction(value) * 255.0),
            ColorFormat::Root8 => nearest_integer(fraction(value).sqrt() * 255.0),
            ColorFormat::Root10 => nearest_integer(fraction(value).sqrt() * 1023.0),
            ColorFormat::Half => f16::from_f32(value.min(f16::MAX.to_f32())).to_bits(),
            ColorFormat::Srgb8 => u16::from(tone_table().srgb8_from_linear(fraction(value))),
            ColorFormat::Rgb9e5 => with_exponent(value, shared_exponent(value)),
        }
    }

    /// The codes of a colour: of each channel its own, but of [`ColorFormat::Rgb9e5`], whose channels share an exponent.
    #[inline(always)]
    pub fn quantise_color(self, color: [f32; 3], white: f32) -> [u16; 3] {
        match self {
            ColorFormat::Rgb9e5 => {
                // `max` drops NaN.
                let exponent = shared_exponent(color[0].max(color[1]).max(color[2]));
                color.map(|value| with_exponent(value, exponent))
            }
            _ => color.map(|value| self.quantise(value, white)),
        }
    }

    /// The linear value of a code.
    pub fn dequantise(self, code: u16, white: f32) -> f32 {
        match self {
            ColorFormat::Linear8 => f32::from(code) / 255.0 * white,
            ColorFormat::Root8 => (f32::from(code) / 255.0).powi(2) * white,
            ColorFormat::Root10 => (f32::from(code) / 1023.0).powi(2) * white,
            ColorFormat::Half => {
                let value = f16::from_bits(code).to_f32();
                if value.is_finite() { value.max(0.0) } else { 0.0 }
            }
            // One byte, as all codes of 8 bits.
            ColorFormat::Srgb8 => linear_from_srgb8(code as u8) * white,
            ColorFormat::Rgb9e5 => {
                let (mantissa, exponent) = (code & ((1 << MANTISSA_BITS) - 1), code >> MANTISSA_BITS);
                f32::from(mantissa) * step(exponent)
            }
        }
    }
}

/// Bits of a channel of [`ColorFormat::Rgb9e5`], and of the exponent.
const MANTISSA_BITS: u32 = 9;
const EXPONENT_BITS: u32 = 5;
/// What the exponent's code is above the exponent.
const EXPONENT_BIAS: i32 = 15;

fn tone_table() -> &'static ToneTable {
    static TABLE: LazyLock<ToneTable> = LazyLock::new(ToneTable::default);
    &TABLE
}

/// A step of a mantissa under the exponent of this code: a power of two, put together from its bits.
#[inline(always)]
fn step(exponent: u16) -> f32 {
    let power = i32::from(exponent & ((1 << EXPONENT_BITS) - 1)) - EXPONENT_BIAS - MANTISSA_BITS as i32;
    f32::from_bits(((power + 127) as u32) << 23)
}

/// The code of the smallest exponent under which a value is a mantissa, rounding included; the largest, if it never is.
#[inline(always)]
fn shared_exponent(largest: f32) -> u16 {
    const HIGHEST: i32 = (1 << EXPONENT_BITS) - 1;
    let value = if largest > 0.0 { largest } else { 0.0 };
    // Floor of the logarithm: a float's own exponent; that of what is subnormal is far below ours anyway.
    let floor = (value.to_bits() >> 23) as i32 - 127;
    let exponent = (floor + 1 + EXPONENT_BIAS).clamp(0, HIGHEST) as u16;
    let rounds_up = value / step(exponent) >= 511.5;
    (exponent + u16::from(rounds_up)).min(HIGHEST as u16)
}

/// The code of a value under an exponent; not a number and below zero give 0, what is too large the largest.
#[inline(always)]
fn with_exponent(value: f32, exponent: u16) -> u16 {
    let value = if value > 0.0 { value } else { 0.0 };
    let mantissa = nearest_integer((value / step(exponent)).min(511.0));
    // All of a black pixel is 0, whatever its exponent would be.
    exponent << MANTISSA_BITS | mantissa
}

/// Rounds 0 to 65535 half to even: the sum with 2^23 has no room for a fraction, and the integer in its lowest
/// bits. A quarter of the time of `round` and a cast that saturates.
#[inline(always)]
fn nearest_integer(value: f32) -> u16 {
    (value + 8_388_608.0).to_bits() as u16
}

/// How the radiance of nodes, and the source radiance of layers, travels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ColorCoding {
    /// Every code of the [`ColorFormat`] as it is.
    Exact,
    /// Each code within `error` of what it was.
    Bounded {
        /// Largest error in codes, [`ColorCoding::ERRORS`].
        error: u8,
    },
    /// As pictures of a video, one stream per node and per layer.
    Video {
        /// H.264's quantiser for the plane that matters most; others may have a coarser one. [`ColorCoding::QUANTISERS`].
        quantiser: u8,
    },
}

impl ColorCoding {
    /// Bounds have between 1 and 64 codes.
    pub const ERRORS: std::ops::RangeInclusive<u8> = 1..=64;
    /// The quantisers of H.264 for 8 bits.
    pub const QUANTISERS: std::ops::RangeInclusive<u8> = 0..=51;

    /// Whether its number is in its range, and `color` has codes of which this can be said.
    pub fn is_valid(&self, color: ColorFormat) -> bool {
        match self {
            ColorCoding::Exact => true,
            ColorCoding::Bounded { error } => Self::ERRORS.contains(error) && color.has_even_steps(),
            ColorCoding::Video { quantiser } => Self::QUANTISERS.contains(quantiser) && color.bits() == 8,
        }
    }
}

impl std::fmt::Display for ColorCoding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ColorCoding::Exact => write!(f, "exact"),
            ColorCoding::Bounded { error } => write!(f, "bounded:{error}"),
            ColorCoding::Video { quantiser } => write!(f, "video:{quantiser}"),
        }
    }
}

impl std::str::FromStr for ColorCoding {
    type Err = String;
    fn from_str(text: &str) -> Result<ColorCoding, String> {
        let (name, number) =
            text.split_once(':').map_or((text, None), |(name, number)| (name, Some(number.parse::<u8>())));
        match (name, number) {
            ("exact", None) => Ok(ColorCoding::Exact),
            ("bounded", Some(Ok(error))) if Self::ERRORS.contains(&error) => Ok(ColorCoding::Bounded { error }),
            ("video", Some(Ok(quantiser))) if Self::QUANTISERS.contains(&quantiser) => {
                Ok(ColorCoding::Video { quantiser })
            }
            _ => Err(format!("expected exact, bounded:1 to 64 or video:0 to 51, found '{text}'")),
        }
    }
}

/// How depths travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum DepthFormat {
    /// Codes of inverse depth, as they are.
    Codes {
        /// Bits of the root's, [`FrameFormat::DEPTH_BITS`].
        root_bits: u8,
        /// Bits of a child's.
        child_bits: u8,
    },
    /// As coarse as a promise allows.
    Bounded(DepthBound),
}

/// A promise about depth: whoever moves by so much sees no pixel further than so many pixels from its place.
///
/// A step of `d` in inverse depth moves a pixel by `focal_px * motion_m * d`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct DepthBound {
    /// Largest error of the root on the display, in hundredths of a pixel; [`DepthBound::ERRORS_CENTI_PX`].
    pub error_centi_px: u16,
    /// For heads that move so far from the render pose, in millimetres; [`DepthBound::MOTIONS_MM`].
    pub motion_mm: u16,
    /// How many times as large the error of a child may be, which is seen through its parent;
    /// [`DepthBound::CHILD_FACTORS`].
    pub child_factor: u8,
}

impl DepthBound {
    /// Errors from a hundredth of a pixel to 16 pixels.
    pub const ERRORS_CENTI_PX: std::ops::RangeInclusive<u16> = 1..=1600;
    /// Motions from a millimetre to 10 m.
    pub const MOTIONS_MM: std::ops::RangeInclusive<u16> = 1..=10_000;
    /// Children may be up to 16 times as coarse.
    pub const CHILD_FACTORS: std::ops::RangeInclusive<u8> = 1..=16;

    /// Whether every number is in its range.
    pub fn is_valid(&self) -> bool {
        Self::ERRORS_CENTI_PX.contains(&self.error_centi_px)
            && Self::MOTIONS_MM.contains(&self.motion_mm)
            && Self::CHILD_FACTORS.contains(&self.child_factor)
    }

    /// Largest error of inverse depth that keeps the promise, per metre, for a camera of so many pixels per tangent.
    pub fn inverse_depth_error_per_m(&self, focal_px: f32, is_root: bool) -> f64 {
        let error_px = 0.01 * f64::from(self.error_centi_px) * if is_root { 1.0 } else { f64::from(self.child_factor) };
        error_px / (f64::from(focal_px) * 0.001 * f64::from(self.motion_mm))
    }
}

impl Default for DepthBound {
    fn default() -> DepthBound {
        DepthBound { error_centi_px: 10, motion_mm: 200, child_factor: 2 }
    }
}

/// What the depth code of a child node measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum DepthCoding {
    /// The distance from the parent's point: the thesis's choice.
    Relative,
    /// The z of the unfolded path: distances summed along the chain, as if the specular surfaces were
    /// transparent. For a planar mirror that is the depth of the mirrored scene, whose inverse is planar
    /// in screen space for every plane.
    Unfolded,
}

/// How the media along a ray are cut into segments. What the server does; any receiver shows the result of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Layering {
    /// At equal steps of opacity: the thesis's choice.
    Quantiles,
    /// Where the colour changes: volumetric depth images.
    Merged,
    /// Where homogeneous segments differ least from the media, by dynamic programming.
    Optimal,
    /// At the same depths in every pixel: for the baseline that warps slabs as surfaces.
    Slabs,
}

impl Layering {
    /// Every layering, by wire code.
    pub const ALL: [Layering; 4] = [Layering::Quantiles, Layering::Merged, Layering::Optimal, Layering::Slabs];

    /// Name in reports and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Layering::Quantiles => "quantiles",
            Layering::Merged => "merged",
            Layering::Optimal => "optimal",
            Layering::Slabs => "slabs",
        }
    }
}

impl std::str::FromStr for Layering {
    type Err = String;
    fn from_str(text: &str) -> Result<Layering, String> {
        Layering::ALL.into_iter().find(|layering| layering.name() == text).ok_or_else(|| {
            let names = Layering::ALL.map(Layering::name).join(", ");
            format!("expected one of {names}, found '{text}'")
        })
    }
}

/// The formats of the layers of a volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct VolumeFormat {
    /// Segments of a pixel, at most [`super::MAX_LAYERS`]; 0: none. A frame whose scene has no volume has none.
    pub layers: u8,
    /// Where segments begin and end.
    pub layering: Layering,
    /// Bits of the depth of either end, [`VolumeFormat::DEPTH_BITS`].
    pub depth_bits: u8,
    /// Bits of the logarithm of the optical depth, [`VolumeFormat::OPTICAL_DEPTH_BITS`].
    pub optical_depth_bits: u8,
    /// Source radiance.
    pub source: ColorFormat,
}

impl VolumeFormat {
    /// Depths have between 8 and 16 bits.
    pub const DEPTH_BITS: std::ops::RangeInclusive<u8> = 4..=16;
    /// Optical depths have between 6 and 16 bits.
    pub const OPTICAL_DEPTH_BITS: std::ops::RangeInclusive<u8> = 4..=16;

    /// No volume.
    pub const NONE: VolumeFormat = VolumeFormat {
        layers: 0,
        layering: Layering::Optimal,
        depth_bits: 12,
        // 8 show before white: their last half step is 2 % of an optical depth. 2 more cost 0.2 bits per pixel.
        optical_depth_bits: 10,
        source: ColorFormat::Root8,
    };

    /// Whether every number is in its range.
    pub fn is_valid(&self) -> bool {
        usize::from(self.layers) <= super::MAX_LAYERS
            && Self::DEPTH_BITS.contains(&self.depth_bits)
            && Self::OPTICAL_DEPTH_BITS.contains(&self.optical_depth_bits)
    }
}

impl Default for VolumeFormat {
    fn default() -> VolumeFormat {
        VolumeFormat { layers: 4, ..VolumeFormat::NONE }
    }
}

/// The formats of a frame's planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct FrameFormat {
    /// Radiance of every node.
    pub color: ColorFormat,
    /// How that radiance travels.
    pub color_coding: ColorCoding,
    /// How depths travel.
    pub depth: DepthFormat,
    /// What a child's depth measures.
    pub child_depth: DepthCoding,
    /// Bits of each of the two octahedral coordinates of a normal, [`FrameFormat::NORMAL_BITS`].
    pub normal_bits: u8,
    /// Bits of each of the three entries of a shape operator, [`FrameFormat::SHAPE_BITS`]; 0: they are not sent, and the
    /// client makes do with differences of normals.
    pub shape_bits: u8,
    /// The layers of a volume.
    pub volume: VolumeFormat,
}

impl FrameFormat {
    /// Depth codes have between 8 and 24 bits: f32 arithmetic resolves no more.
    pub const DEPTH_BITS: std::ops::RangeInclusive<u8> = 8..=24;
    /// Octahedral coordinates have between 6 and 16 bits.
    pub const NORMAL_BITS: std::ops::RangeInclusive<u8> = 6..=16;
    /// Entries of a shape operator have between 6 and 12 bits, where they are sent.
    pub const SHAPE_BITS: std::ops::RangeInclusive<u8> = 6..=12;

    /// Codes of 8 bits of colour and 16 of depth, as they are.
    pub fn exact() -> FrameFormat {
        FrameFormat { color_coding: ColorCoding::Exact, ..FrameFormat::default() }.with_depth_bits(16, 16)
    }

    /// The thesis's quantisation: linear 8-bit colour, 16-bit depth relative to the parent, no shape operators.
    pub fn thesis() -> FrameFormat {
        let (color, child_depth) = (ColorFormat::Linear8, DepthCoding::Relative);
        FrameFormat { color, child_depth, shape_bits: 0, ..FrameFormat::exact() }
    }

    /// The same with depths of so many bits.
    pub fn with_depth_bits(self, root_bits: u8, child_bits: u8) -> FrameFormat {
        FrameFormat { depth: DepthFormat::Codes { root_bits, child_bits }, ..self }
    }

    /// Whether every width is in its range.
    pub fn is_valid(&self) -> bool {
        let depth_is_valid = match &self.depth {
            DepthFormat::Codes { root_bits, child_bits } => {
                Self::DEPTH_BITS.contains(root_bits) && Self::DEPTH_BITS.contains(child_bits)
            }
            DepthFormat::Bounded(bound) => bound.is_valid(),
        };
        depth_is_valid
            && self.color_coding.is_valid(self.color)
            && Self::NORMAL_BITS.contains(&self.normal_bits)
            && (self.shape_bits == 0 || Self::SHAPE_BITS.contains(&self.shape_bits))
            && self.volume.is_valid()
    }
}

impl Default for FrameFormat {
    fn default() -> FrameFormat {
        FrameFormat {
            color: ColorFormat::Root8,
            // A code is a just noticeable step: half of the bytes, and nobody sees it.
            color_coding: ColorCoding::Bounded { error: 1 },
            depth: DepthFormat::Bounded(DepthBound::default()),
            child_depth: DepthCoding::Unfolded,
            normal_bits: 12,
            shape_bits: 8,
            volume: VolumeFormat::NONE,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_the_nearest() {
        for quarter in 0..4 * 65_535_u32 {
            let value = quarter as f32 / 4.0;
            assert_eq!(f32::from(nearest_integer(value)), value.round_ties_even(), "{value}");
        }
    }

    #[test]
    fn every_code_survives_a_round_trip() {
        for format in ColorFormat::ALL {
            for white in [0.25, 1.0, 16.0] {
                let codes = if format == ColorFormat::Half { f16::MAX.to_bits() } else { (1 << format.bits()) - 1 };
                for code in 0..=codes {
                    let value = format.dequantise(code, white);
                    let again = format.quantise(value, white);
                    // Several codes of a shared exponent have one value, of which the finest is sent.
                    assert_eq!(format.dequantise(again, white), value, "{format:?} {code}");
                    assert!(format == ColorFormat::Rgb9e5 || again == code, "{format:?} {code} {again}");
                }
            }
        }
    }

    /// Half a step of the brightest channel's mantissa, which is at least 255.75 before it is rounded: one of 511.5 parts; no
    /// other channel is off by more.
    #[test]
    fn a_shared_exponent_is_off_by_half_a_step_of_the_brightest_channel() {
        let format = ColorFormat::Rgb9e5;
        let mut state = 1_u32;
        let mut random = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            // Exponents that have a normal step.
            f32::from_bits((state >> 9) | ((127 - 14 + (state % 29)) << 23))
        };
        for _ in 0..100_000 {
            let color = [random(), random(), random()];
            let codes = format.quantise_color(color, 1.0);
            assert!(codes.iter().all(|code| code >> MANTISSA_BITS == codes[0] >> MANTISSA_BITS), "{color:?}");
            let largest = color[0].max(color[1]).max(color[2]);
            for (value, code) in color.into_iter().zip(codes) {
                let error = (format.dequantise(code, 1.0) - value).abs();
                assert!(error <= largest / 511.5, "{color:?}: {error}");
            }
        }
        // What rounds up to the next power of two; the largest; beyond; black; what is no number.
        for (color, expected) in [
            ([511.75, 3.0, 0.0], [512.0, 4.0, 0.0]),
            ([65_408.0, 1e9, f32::INFINITY], [65_408.0; 3]),
            ([0.0, -1.0, f32::NAN], [0.0; 3]),
            ([1e-30, 0.0, 0.0], [0.0; 3]),
        ] {
            let codes = format.quantise_color(color, 1.0);
            assert_eq!(codes.map(|code| format.dequantise(code, 1.0)), expected, "{color:?}");
        }
        assert_eq!(format.quantise_color([f32::NAN, 0.25, f32::NEG_INFINITY], 1.0)[1] & 511, 256);
    }

    #[test]
    fn codes_of_displays_are_those_of_the_tone() {
        for code in 0..=255_u8 {
            let value = linear_from_srgb8(code);
            assert_eq!(ColorFormat::Srgb8.quantise(4.0 * value, 4.0), u16::from(code));
            assert_eq!(ColorFormat::Srgb8.dequantise(code.into(), 4.0), 4.0 * value);
        }
    }

    /// Tone and colour codes of 0, subnormal, 1e8, negative, infinite and no number.
    #[test]
    fn extreme_radiance_gives_a_finite_monotone_code() {
        for format in ColorFormat::ALL {
            assert_eq!(format.quantise(f32::NAN, 1.0), 0);
            assert_eq!(format.quantise(-1.0, 1.0), 0);
            assert_eq!(format.quantise(-0.0, 1.0), 0);
            let rising = [0.0, 1e-40, 1e-6, 0.3, 1.0, 1e8, f32::INFINITY];
            let codes = rising.map(|value| format.quantise(value, 1.0));
            assert!(codes.windows(2).all(|pair| pair[0] <= pair[1]));
            assert!(codes.iter().all(|&code| format.dequantise(code, 1.0).is_finite()));
        }
        assert_eq!(ColorFormat::Half.dequantise(u16::MAX, 1.0), 0.0);
    }
}
