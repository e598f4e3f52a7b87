//! Layers of a volume: per segment a logarithm of its optical depth, the depths of its two ends, and its source
//! radiance.
//!
//! An optical depth is coded by its logarithm, since what it does to a picture goes by ratios as long as the segment is
//! thin, and hardly changes where it is thick; the error of one segment is handed on to the next, so that the sum along
//! the ray, which is what the background is seen through, is off by half a step of the last one only. The source
//! radiance is then that of the coded optical depth: what the segment sends to the eye stays the same.
//!
//! A depth z is coded in equal steps of `1 / (z + b)` over the frame's range, with `b` a sixteenth of its far end: almost
//! the inverse depth, whose steps are equally wide on the display, but with a step of finite size at the eye, which may
//! be in the midst of the volume. The front of a segment is coded as the gap to the back of the one before it, which is
//! zero but at holes.

use super::shape::FrameShape;
use super::{DecodeError, PlaneKind};
use crate::frame::{ColorFormat, LayerRows, TreeRows, VolumeRange};

/// The optical depth of the smallest code but 0, whose segment is none.
const THINNEST: f32 = 1.0 / 4096.0;
/// The optical depth of the largest code: beyond, nothing comes through that could be seen.
const THICKEST: f32 = 24.0;
/// A source may be so many times brighter than what saturates the display; only a segment as thin as the inverse of it
/// could show more.
const BRIGHTEST: f32 = 8.0;

/// Codes of all layers of a strip, and the tables behind them.
#[derive(Debug, Default)]
pub(crate) struct LayersPlane {
    layers: Vec<LayerCodes>,
    depths: Table<(VolumeRange, u8)>,
    optical_depths: Table<u8>,
    sources: Table<(ColorFormat, u32)>,
    /// Decoder: code of the back of the segment before, per pixel.
    last_back: Vec<u32>,
    defined: Vec<bool>,
}

/// Codes of one layer.
#[derive(Debug, Default)]
struct LayerCodes {
    optical_depth: Vec<u32>,
    extent: [Vec<u32>; 2],
    source: [Vec<u32>; 3],
    defined: Vec<bool>,
    white: f32,
}

/// The value of every code, made anew where what it depends on changes.
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
    fn fill(&mut self, of: Of, bits: u8, value: impl Fn(u32) -> f32) -> &[f32] {
        if self.of.as_ref() != Some(&of) {
            self.values.clear();
            self.values.extend((0..1_u32 << bits).map(value));
            self.of = Some(of);
        }
        &self.values
    }
}

/// Depths and their codes, which rise with the depth.
#[derive(Clone, Copy, Debug)]
struct DepthScale {
    offset: f64,
    near: f64,
    span: f64,
    largest: f64,
}

impl DepthScale {
    fn new(range: VolumeRange, bits: u8) -> DepthScale {
        let offset = f64::from(range.far_m) / 16.0;
        let near = 1.0 / (f64::from(range.near_m) + offset);
        let far = 1.0 / (f64::from(range.far_m) + offset);
        DepthScale { offset, near, span: near - far, largest: f64::from((1_u32 << bits) - 1) }
    }

    /// The nearest code. What is no number counts as near.
    fn code(&self, depth: f32) -> u32 {
        let fraction = (self.near - 1.0 / (f64::from(depth).max(0.0) + self.offset)) / self.span;
        // A cast takes what is below 0, and NaN, to 0.
        (fraction * self.largest + 0.5).min(self.largest) as u32
    }

    fn depth(&self, code: u32) -> f32 {
        let inverse = self.near - f64::from(code) / self.largest * self.span;
        (1.0 / inverse - self.offset).max(0.0) as f32
    }
}

/// Optical depths and their codes.
#[derive(Clone, Copy, Debug)]
struct OpticalDepthScale {
    largest: f32,
    codes_per_log: f32,
}

impl OpticalDepthScale {
    fn new(bits: u8) -> OpticalDepthScale {
        let largest = ((1_u32 << bits) - 1) as f32;
        OpticalDepthScale { largest, codes_per_log: (largest - 1.0) / (THICKEST / THINNEST).ln() }
    }

    /// The nearest code but 0.
    fn code(&self, optical_depth: f32) -> u32 {
        let log = (optical_depth.clamp(THINNEST, THICKEST) / THINNEST).ln();
        (1.5 + log * self.codes_per_log).min(self.largest) as u32
    }

    fn optical_depth(&self, code: u32) -> f32 {
        if code == 0 { 0.0 } else { THINNEST * ((code - 1) as f32 / self.codes_per_log).exp() }
    }
}

fn opacity(optical_depth: f32) -> f32 {
    -(-optical_depth).exp_m1()
}

impl LayersPlane {
    /// Makes the codes of all layers of these rows.
    pub(crate) fn quantise(&mut self, shape: &FrameShape, rows: &TreeRows<'_>) {
        let format = shape.format.volume;
        let depth_scale = DepthScale::new(shape.volume, format.depth_bits);
        let scale = OpticalDepthScale::new(format.optical_depth_bits);
        let optical_depths = self
            .optical_depths
            .fill(format.optical_depth_bits, format.optical_depth_bits, |code| scale.optical_depth(code));
        let pixels = rows.rows.len() * shape.camera.size.width as usize;
        self.layers.resize_with(rows.layers.len(), LayerCodes::default);
        for layer in &mut self.layers {
            let LayerCodes { optical_depth, extent: [gap, back], source: [first, second, third], defined, .. } = layer;
            for codes in [optical_depth, gap, back, first, second, third] {
                codes.clear();
                codes.resize(pixels, 0);
            }
            defined.clear();
            defined.resize(pixels, false);
        }
        self.last_back.clear();
        self.last_back.resize(pixels, 0);

        // Optical depths, with the error of each segment left to the next, and the ends.
        let count = self.layers.len();
        let largest = (1_u32 << format.depth_bits) - 1;
        for pixel in 0..pixels {
            let mut owed = 0.0;
            for (index, (codes, planes)) in self.layers.iter_mut().zip(&rows.layers).enumerate() {
                let optical_depth = planes.optical_depth[pixel];
                // Comparisons that NaN fails.
                if !(optical_depth > 0.0 && planes.back[pixel] > planes.front[pixel]) {
                    continue;
                }
                let code = scale.code((optical_depth + owed).max(0.7 * optical_depth));
                owed += optical_depth - optical_depths[code as usize];
                owed = owed.clamp(-1.0, 1.0);
                codes.optical_depth[pixel] = code;
                codes.defined[pixel] = true;
                // Every segment is at least one code long, and leaves as much to those behind it.
                let (last_back, behind) = (self.last_back[pixel], (count - 1 - index) as u32);
                let front = depth_scale.code(planes.front[pixel]).clamp(last_back, largest - 1 - behind);
                let back = depth_scale.code(planes.back[pixel]).clamp(front + 1, largest - behind);
                codes.extent[0][pixel] = front - last_back;
                codes.extent[1][pixel] = back;
                self.last_back[pixel] = back;
            }
        }
        for (codes, planes) in self.layers.iter_mut().zip(&rows.layers) {
            codes.quantise_source(shape, planes, optical_depths);
        }
    }

    /// Channels of codes, which pixels they are of (`None`: all), and the scale of a plane.
    pub(crate) fn channels(&mut self, layer: usize, kind: PlaneKind) -> (&mut [Vec<u32>], Option<&[bool]>, f32) {
        let LayerCodes { optical_depth, extent, source, defined, white } = &mut self.layers[layer];
        match kind {
            PlaneKind::Extent => (extent, Some(defined), 0.0),
            PlaneKind::Source => (source, Some(defined), *white),
            _ => (std::slice::from_mut(optical_depth), None, 0.0),
        }
    }

    /// Starts decoding a strip of so many pixels.
    pub(crate) fn begin(&mut self, pixels: usize) {
        self.last_back.clear();
        self.last_back.resize(pixels, 0);
    }

    /// Writes a plane of a layer; those of the layers before it, and its own before this one, are there.
    pub(crate) fn dequantise(
        &mut self,
        shape: &FrameShape,
        kind: PlaneKind,
        white: f32,
        codes: &[Vec<u32>; 3],
        planes: &mut LayerRows<'_>,
    ) -> Result<(), DecodeError> {
        let format = shape.format.volume;
        match kind {
            PlaneKind::Extent => {
                let scale = DepthScale::new(shape.volume, format.depth_bits);
                let depths =
                    self.depths.fill((shape.volume, format.depth_bits), format.depth_bits, |code| scale.depth(code));
                let [gaps, backs, _] = codes;
                for (pixel, (&gap, &back)) in gaps.iter().zip(backs).enumerate() {
                    if !self.defined[pixel] {
                        (planes.front[pixel], planes.back[pixel]) = (0.0, 0.0);
                        continue;
                    }
                    let front = self.last_back[pixel] + gap;
                    if front >= back {
                        let expected = "segments in order, each with a length";
                        return Err(DecodeError::Malformed { field: "extent", expected });
                    }
                    planes.front[pixel] = depths[front as usize];
                    // Neighbouring codes may round to one float only at the far end of an absurd range.
                    planes.back[pixel] = depths[back as usize].max(depths[front as usize].next_up());
                    self.last_back[pixel] = back;
                }
            }
            PlaneKind::Source => {
                let bits = format.source.bits() as u8;
                let of = (format.source, white.to_bits());
                let values = self.sources.fill(of, bits, |code| format.source.dequantise(code as u16, white));
                let mask = (values.len() - 1) as u32;
                let [first, second, third] = codes;
                let [red, green, blue] = &mut planes.source;
                for (pixel, &code) in first.iter().enumerate() {
                    green[pixel] = values[(code & mask) as usize];
                    red[pixel] = values[(second[pixel].wrapping_add(code) & mask) as usize];
                    blue[pixel] = values[(third[pixel].wrapping_add(code) & mask) as usize];
                }
            }
            _ => {
                let scale = OpticalDepthScale::new(format.optical_depth_bits);
                let bits = format.optical_depth_bits;
                let values = self.optical_depths.fill(bits, bits, |code| scale.optical_depth(code));
                self.defined.clear();
                self.defined.extend(codes[0].iter().map(|&code| code > 0));
                for (value, &code) in planes.optical_depth.iter_mut().zip(&codes[0]) {
                    *value = values[code as usize];
                }
            }
        }
        Ok(())
    }
}

impl LayerCodes {
    /// The codes of the source radiance that, with the coded optical depth, sends what the segment sends.
    fn quantise_source(&mut self, shape: &FrameShape, planes: &LayerRows<'_>, optical_depths: &[f32]) {
        let color = shape.format.volume.source;
        let display_white = 1.0 / shape.exposure;
        let ratio = |pixel: usize| {
            let coded = optical_depths[self.optical_depth[pixel] as usize];
            opacity(planes.optical_depth[pixel]) / opacity(coded)
        };
        // White is what is there, as far as it can matter.
        let mut white = 0.0_f32;
        for (pixel, _) in self.defined.iter().enumerate().filter(|(_, defined)| **defined) {
            for channel in &planes.source {
                white = white.max(channel[pixel] * ratio(pixel));
            }
        }
        self.white = white.clamp(display_white / 64.0, BRIGHTEST * display_white);
        for (pixel, _) in self.defined.iter().enumerate().filter(|(_, defined)| **defined) {
            let ratio = ratio(pixel);
            let [red, green, blue] =
                planes.source.each_ref().map(|channel| u32::from(color.quantise(channel[pixel] * ratio, self.white)));
            self.source[0][pixel] = green;
            self.source[1][pixel] = red.wrapping_sub(green);
            self.source[2][pixel] = blue.wrapping_sub(green);
        }
        let mask = (1_u32 << color.bits()) - 1;
        for codes in &mut self.source[1..] {
            codes.iter_mut().for_each(|code| *code &= mask);
        }
    }
}

#[cfg(test)]
mod tests;
