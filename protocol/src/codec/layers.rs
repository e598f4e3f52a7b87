//! Layers of a volume: per segment a logarithm of its optical depth, the depths of its two ends, and its source radiance.
//!
//! An optical depth is coded by its logarithm, since what it does to a picture goes by ratios as long as the segment is
//! thin, and hardly changes where it is thick; the error of one segment is handed on to the next, so that the sum along
//! the ray, which is what the background is seen through, is off by half a step of the last one only. Which pixels have
//! the segment is a mask of its own before it.
//!
//! A depth z is coded in equal steps of `1 / (z + b)` over the frame's range, with `b` a sixteenth of its far end: almost
//! the inverse depth, whose steps are equally wide on the display, but with a step of finite size at the eye, which may
//! be in the midst of the volume. The front of a segment is coded as the gap to the back of the one before it *as decoded*,
//! which is zero but at holes; the back as it is.
//!
//! All of these go from coarse to fine ([`super::pyramid`]) within half a code, from finer units than codes: the error of a
//! code's rounding is there anyway, and is better spent on residuals of 0. What would come out of order by that is put in
//! order at both ends, which is never further from the truth: a front is at least the back before it, a back a unit
//! beyond its front.
//!
//! The source radiance is that of the coded optical depth: what the segment sends to the eye, `S (1 - exp(-tau))`, stays the
//! same. Coding what it sends instead took more bytes for worse pictures (docs/measurements/2026-11-22-codec.md).
//!
//! Cost per segment: a logarithm and an exponential to encode, tables to decode, and five planes of pyramids.

mod scales;

use super::DecodeError;
use super::channels::ChannelCoder;
use super::pyramid::Rounding;
use super::shape::FrameShape;
use crate::frame::{ColorFormat, LayerRows, VolumeRange};
use scales::{DepthScale, OpticalDepthScale};

/// The optical depth of the smallest code.
const THINNEST: f32 = 1.0 / 4096.0;
/// The optical depth of the largest code: beyond, nothing comes through that could be seen.
const THICKEST: f32 = 24.0;
/// A source may be so many times brighter than what saturates the display; only a segment as thin as the inverse of it
/// could show more.
const BRIGHTEST: f32 = 8.0;

/// What the layers of a strip share on either end, and the tables behind their samples.
#[derive(Debug, Default)]
pub(crate) struct LayersPlane {
    depths: Table<(VolumeRange, u8)>,
    optical_depths: Table<u8>,
    /// Of optical depths as coded.
    opacities: Table<u8>,
    sources: Table<(ColorFormat, u32)>,
    /// Back of the segment before, per pixel, as decoded, in units.
    last_back: Vec<i32>,
    /// Optical depth that the segments before had more than was coded.
    owed: Vec<f32>,
    /// Which pixels have the layer's segment.
    defined: Vec<bool>,
    /// Optical depths of the layer as decoded, in units; anything where there is none.
    thicknesses: Vec<i32>,
    fronts: Vec<i32>,
    backs: Vec<i32>,
    /// The layer's source: green, and red and blue less green.
    codes: [Vec<u32>; 3],
}

/// The value of every sample, made anew where what it depends on changes.
#[derive(Debug)]
struct Table<Of> {
    of: Option<Of>,
    values: Vec<f32>,
}

impl<Of> Default for Table<Of> {
    fn default() -> Table<Of> {
        Table { of: None, values: Vec::new() }
    }
}

impl<Of: PartialEq> Table<Of> {
    fn fill(&mut self, of: Of, highest: i32, value: impl Fn(i32) -> f32) -> &[f32] {
        if self.of.as_ref() != Some(&of) {
            self.values.clear();
            self.values.extend((0..=highest).map(value));
            self.of = Some(of);
        }
        &self.values
    }
}

fn opacity(optical_depth: f32) -> f32 {
    -(-optical_depth).exp_m1()
}

/// Fronts and backs from what was decoded: in order, and with room for the `behind` segments that may follow.
fn put_in_order(
    scale: &DepthScale,
    behind: i32,
    defined: &[bool],
    last_backs: &mut [i32],
    gaps: &mut [i32],
    backs: &mut [i32],
) {
    let pixels = defined.iter().zip(last_backs).zip(gaps).zip(backs);
    for (((&defined, last_back), gap), back) in pixels {
        let front = (*last_back + (*gap).max(0)).min(scale.highest - behind - 1);
        let end = (*back).clamp(front + 1, scale.highest - behind);
        (*gap, *back) = (front, end);
        *last_back = if defined { end } else { *last_back };
    }
}

const MASK: Rounding = Rounding { step: 1, lowest: 0, highest: 1, keeps_zero: false };

impl LayersPlane {
    /// Starts a strip of so many pixels.
    pub(crate) fn begin(&mut self, pixels: usize) {
        self.last_back.clear();
        self.last_back.resize(pixels, 0);
        self.owed.clear();
        self.owed.resize(pixels, 0.0);
    }

    /// Appends the mask and the optical depths of a layer, those before it being there.
    pub(crate) fn encode_optical_depth(
        &mut self,
        shape: &FrameShape,
        planes: &LayerRows<'_>,
        coder: &mut ChannelCoder,
        out: &mut Vec<u8>,
    ) {
        let width = shape.camera.size.width as usize;
        let bits = shape.format.volume.optical_depth_bits;
        let scale = OpticalDepthScale::new(bits);
        let ends = planes.front.iter().zip(planes.back.iter());
        self.defined.clear();
        // Comparisons that NaN fails.
        self.defined.extend(
            planes
                .optical_depth
                .iter()
                .zip(ends)
                .map(|(&optical_depth, (front, back))| optical_depth > 0.0 && back > front),
        );
        self.fronts.clear();
        self.fronts.extend(self.defined.iter().map(|&defined| i32::from(defined)));
        coder.encode_samples(width, MASK, None, false, &mut self.fronts, out);

        self.thicknesses.clear();
        let wanted = planes.optical_depth.iter().zip(&self.owed).zip(&self.defined);
        self.thicknesses.extend(wanted.map(|((&optical_depth, owed), &defined)| match defined {
            true => scale.units((optical_depth + owed).max(0.7 * optical_depth)),
            false => 0,
        }));
        coder.encode_samples(width, scale.rounding(), Some(&self.defined), true, &mut self.thicknesses, out);
        let values = self.optical_depths.fill(bits, scale.highest, |units| scale.optical_depth(units));
        let pixels = self.owed.iter_mut().zip(&self.thicknesses).zip(&self.defined).zip(planes.optical_depth.iter());
        for (((owed, &units), &defined), &optical_depth) in pixels {
            if defined {
                *owed = (*owed + optical_depth - values[units as usize]).clamp(-1.0, 1.0);
            }
        }
    }

    /// Appends the gaps and the backs of the layer whose optical depths were encoded last.
    pub(crate) fn encode_extent(
        &mut self,
        shape: &FrameShape,
        layer: u8,
        planes: &LayerRows<'_>,
        coder: &mut ChannelCoder,
        out: &mut Vec<u8>,
    ) {
        let width = shape.camera.size.width as usize;
        let scale = DepthScale::new(shape.volume, shape.format.volume.depth_bits);
        self.fronts.clear();
        self.backs.clear();
        for (pixel, &defined) in self.defined.iter().enumerate() {
            let [front, back] = match defined {
                true => [scale.units(planes.front[pixel]), scale.units(planes.back[pixel])],
                false => [0; 2],
            };
            // Below 0 where the back before it was rounded beyond it.
            self.fronts.push((front - self.last_back[pixel]).max(scale.gaps().lowest));
            self.backs.push(back);
        }
        let defined = Some(&self.defined[..]);
        coder.encode_samples(width, scale.gaps(), defined, false, &mut self.fronts, out);
        coder.encode_samples(width, scale.rounding(), defined, true, &mut self.backs, out);
        self.put_in_order(shape, layer, &scale);
    }

    fn put_in_order(&mut self, shape: &FrameShape, layer: u8, scale: &DepthScale) {
        let behind = i32::from(shape.format.volume.layers) - 1 - i32::from(layer);
        put_in_order(scale, behind, &self.defined, &mut self.last_back, &mut self.fronts, &mut self.backs);
    }

    /// Codes of the source radiance that, with the coded optical depth, sends what the segment sends; which pixels they are
    /// of, and the largest code's value. The layer's optical depths were encoded last.
    pub(crate) fn source_codes(
        &mut self,
        shape: &FrameShape,
        planes: &LayerRows<'_>,
    ) -> (&mut [Vec<u32>], &[bool], f32) {
        let color = shape.format.volume.source;
        let display_white = 1.0 / shape.exposure;
        let [red, green, blue] = &planes.source;
        // White is what is there, as far as it can matter.
        let mut white = 0.0_f32;
        let ratios = self.ratios(shape, planes);
        for (pixel, &ratio) in ratios.iter().enumerate() {
            white = white.max(red[pixel].max(green[pixel]).max(blue[pixel]) * ratio);
        }
        let white = white.clamp(display_white / 64.0, BRIGHTEST * display_white);
        let mask = (1_u32 << color.bits()) - 1;
        for codes in &mut self.codes {
            codes.clear();
        }
        for (pixel, &ratio) in ratios.iter().enumerate() {
            let [red, green, blue] = match ratio > 0.0 {
                true => {
                    let source = [red[pixel] * ratio, green[pixel] * ratio, blue[pixel] * ratio];
                    color.quantise_color(source, white).map(u32::from)
                }
                false => [0; 3],
            };
            self.codes[0].push(green);
            self.codes[1].push(red.wrapping_sub(green) & mask);
            self.codes[2].push(blue.wrapping_sub(green) & mask);
        }
        (&mut self.codes, &self.defined, white)
    }

    /// Opacities of the layer over those as coded, 0 where there is none.
    fn ratios(&mut self, shape: &FrameShape, planes: &LayerRows<'_>) -> Vec<f32> {
        let bits = shape.format.volume.optical_depth_bits;
        let scale = OpticalDepthScale::new(bits);
        let coded = self.opacities.fill(bits, scale.highest, |units| opacity(scale.optical_depth(units)));
        let pixels = planes.optical_depth.iter().zip(&self.defined).zip(&self.thicknesses);
        pixels
            .map(|((&optical_depth, &defined), &units)| match defined {
                true => opacity(optical_depth) / coded[units as usize],
                false => 0.0,
            })
            .collect()
    }

    /// Which pixels have the segment whose optical depths were decoded last.
    pub(crate) fn defined(&self) -> &[bool] {
        &self.defined
    }

    /// Reads mask and optical depths of a layer.
    pub(crate) fn decode_optical_depth(
        &mut self,
        shape: &FrameShape,
        planes: &mut LayerRows<'_>,
        coder: &mut ChannelCoder,
        bytes: &[u8],
    ) -> Result<(), DecodeError> {
        let size = [shape.camera.size.width as usize, self.last_back.len() / shape.camera.size.width as usize];
        let bits = shape.format.volume.optical_depth_bits;
        let scale = OpticalDepthScale::new(bits);
        let rest = coder.decode_samples(size, MASK, None, false, bytes, &mut self.fronts)?;
        self.defined.clear();
        self.defined.extend(self.fronts.iter().map(|&defined| defined > 0));
        coder.decode_samples(size, scale.rounding(), Some(&self.defined), true, rest, &mut self.thicknesses)?;
        let values = self.optical_depths.fill(bits, scale.highest, |units| scale.optical_depth(units));
        let pixels = planes.optical_depth.iter_mut().zip(&self.thicknesses).zip(&self.defined);
        for ((value, &units), &defined) in pixels {
            *value = if defined { values[units as usize] } else { 0.0 };
        }
        Ok(())
    }

    /// Reads the ends of the layer whose optical depths were decoded last.
    pub(crate) fn decode_extent(
        &mut self,
        shape: &FrameShape,
        layer: u8,
        planes: &mut LayerRows<'_>,
        coder: &mut ChannelCoder,
        bytes: &[u8],
    ) -> Result<(), DecodeError> {
        let size = [shape.camera.size.width as usize, self.last_back.len() / shape.camera.size.width as usize];
        let bits = shape.format.volume.depth_bits;
        let scale = DepthScale::new(shape.volume, bits);
        let defined = Some(&self.defined[..]);
        let rest = coder.decode_samples(size, scale.gaps(), defined, false, bytes, &mut self.fronts)?;
        coder.decode_samples(size, scale.rounding(), defined, true, rest, &mut self.backs)?;
        self.put_in_order(shape, layer, &scale);
        let depths = self.depths.fill((shape.volume, bits), scale.highest, |units| scale.depth(units));
        for (pixel, &defined) in self.defined.iter().enumerate() {
            (planes.front[pixel], planes.back[pixel]) = (0.0, 0.0);
            if defined {
                let front = depths[self.fronts[pixel] as usize];
                planes.front[pixel] = front;
                // Neighbouring units may round to one float only at the far end of an absurd range.
                planes.back[pixel] = depths[self.backs[pixel] as usize].max(front.next_up());
            }
        }
        Ok(())
    }

    /// Writes the source radiance of codes of the layer whose optical depths were decoded last.
    pub(crate) fn dequantise_source(
        &mut self,
        shape: &FrameShape,
        white: f32,
        codes: &[Vec<u32>; 3],
        planes: &mut LayerRows<'_>,
    ) {
        let color = shape.format.volume.source;
        let mask = (1_u32 << color.bits()) - 1;
        let values =
            self.sources.fill((color, white.to_bits()), mask as i32, |code| color.dequantise(code as u16, white));
        let value = |code: u32| values[(code & mask) as usize];
        let [first, second, third] = codes;
        let [red, green, blue] = &mut planes.source;
        for (pixel, &code) in first.iter().enumerate() {
            green[pixel] = value(code);
            red[pixel] = value(second[pixel].wrapping_add(code));
            blue[pixel] = value(third[pixel].wrapping_add(code));
        }
    }
}

#[cfg(test)]
mod tests;
