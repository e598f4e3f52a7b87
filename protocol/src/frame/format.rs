//! What the planes are quantised to: the rungs of the ladder between bytes and accuracy.

use half::f16;
use serde::{Deserialize, Serialize};

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
}

impl ColorFormat {
    /// Every format, by wire code.
    pub const ALL: [ColorFormat; 4] =
        [ColorFormat::Linear8, ColorFormat::Root8, ColorFormat::Root10, ColorFormat::Half];

    /// Bits per channel.
    pub const fn bits(self) -> usize {
        match self {
            ColorFormat::Linear8 | ColorFormat::Root8 => 8,
            ColorFormat::Root10 => 10,
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
        }
    }
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
            ColorCoding::Bounded { error } => Self::ERRORS.contains(error) && color != ColorFormat::Half,
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
                    assert_eq!(format.quantise(format.dequantise(code, white), white), code, "{format:?}");
                }
            }
        }
    }

    /// numerics: tone and colour codes of 0, subnormal, 1e8, negative, infinite and no number.
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
