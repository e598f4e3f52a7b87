//! Layered volume: what a ray meets before it ends at a surface, as a few homogeneous segments per pixel.
//!
//! Method: Lochmann et al. 2016 (VMV, "Real-time novel-view synthesis for volume
//! rendering using a piecewise-analytic representation"). Along the ray through a pixel's centre the
//! participating media between the eye and the root's surface are reduced to at most [`MAX_LAYERS`] segments of
//! constant extinction and constant source radiance. A segment of optical depth `tau` and source radiance `S` sends
//! `S (1 - exp(-tau))` to its front and lets `exp(-tau)` of what is behind it through; composed front to back that is
//! exactly what the ray gathers. A ray of another pose crosses the segments of many pixels, each along a part of its
//! length.
//!
//! The source radiance is kept, not what the segment sends: both `S` and `tau` are finite where the segment is almost
//! clear, and 8 bits of `S` are worth more than 8 bits of `S (1 - exp(-tau))`.

use serde::{Deserialize, Serialize};

/// Most segments of a pixel.
pub const MAX_LAYERS: usize = 8;

/// Between which depths in view all segments of a frame are. Known before the frame is rendered, from where the media
/// are; both 0 in a frame without layers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VolumeRange {
    /// Depth in view of the nearest, in metres.
    pub near_m: f32,
    /// Depth in view of the farthest, in metres.
    pub far_m: f32,
}

impl VolumeRange {
    /// The farthest that is accepted.
    pub const MOST_M: f32 = 1e9;

    /// Whether there is room between the two.
    pub fn is_valid(&self) -> bool {
        self.near_m >= 0.0 && self.near_m < self.far_m && (1e-9..=Self::MOST_M).contains(&self.far_m)
    }
}

/// One segment of every pixel, row by row. The segments of a pixel are ordered from the eye on and do not overlap; gaps
/// between them are empty space.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LayerPlanes {
    /// Depth in view (along the axis of view, not along the ray) where the segment starts, in metres.
    pub front: Vec<f32>,
    /// Depth in view where it ends: beyond its front wherever the optical depth is not zero.
    pub back: Vec<f32>,
    /// Optical depth from front to back along the ray through the pixel's centre; 0 where the pixel has no such segment.
    pub optical_depth: Vec<f32>,
    /// Linear RGB source radiance.
    pub source: [Vec<f32>; 3],
}

impl LayerPlanes {
    pub(super) fn resize(&mut self, pixels: usize) {
        let [red, green, blue] = &mut self.source;
        for plane in [&mut self.front, &mut self.back, &mut self.optical_depth, red, green, blue] {
            plane.resize(pixels, 0.0);
        }
    }

    /// The segment of a pixel; `None` where it has no such segment.
    pub fn at(&self, pixel: usize) -> Option<VolumeSegment> {
        let optical_depth = self.optical_depth[pixel];
        let source = self.source.each_ref().map(|channel| channel[pixel]).into();
        (optical_depth > 0.0).then(|| VolumeSegment {
            front_m: self.front[pixel],
            back_m: self.back[pixel],
            optical_depth,
            source,
        })
    }
}

/// A homogeneous part of a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VolumeSegment {
    /// Depth in view of its front.
    pub front_m: f32,
    /// Depth in view of its back.
    pub back_m: f32,
    /// Optical depth between them, along the ray of the pixel.
    pub optical_depth: f32,
    /// Linear RGB source radiance.
    pub source: glam::Vec3,
}

impl VolumeSegment {
    /// Fraction of what is behind it that does not come through: `1 - exp(-tau)`, exact for thin segments.
    pub fn opacity(&self) -> f32 {
        -(-self.optical_depth).exp_m1()
    }
}

/// Some rows of one layer's planes, to be written.
#[derive(Debug)]
pub struct LayerRows<'a> {
    /// See [`LayerPlanes::front`].
    pub front: &'a mut [f32],
    /// See [`LayerPlanes::back`].
    pub back: &'a mut [f32],
    /// See [`LayerPlanes::optical_depth`].
    pub optical_depth: &'a mut [f32],
    /// See [`LayerPlanes::source`].
    pub source: [&'a mut [f32]; 3],
}

impl LayerRows<'_> {
    /// Writes the segment of a pixel, counted from the first of the rows; `None` leaves the pixel without one.
    pub fn set(&mut self, pixel: usize, segment: Option<&VolumeSegment>) {
        let segment = segment.copied().unwrap_or_default();
        self.front[pixel] = segment.front_m;
        self.back[pixel] = segment.back_m;
        self.optical_depth[pixel] = segment.optical_depth;
        for (channel, value) in self.source.iter_mut().zip(segment.source.to_array()) {
            channel[pixel] = value;
        }
    }
}

/// Splits a layer into bands of `band_pixels` (the last may be shorter).
pub(super) fn bands(planes: &mut LayerPlanes, band_pixels: usize) -> impl Iterator<Item = LayerRows<'_>> {
    let [red, green, blue] = &mut planes.source;
    let source = red.chunks_mut(band_pixels).zip(green.chunks_mut(band_pixels)).zip(blue.chunks_mut(band_pixels));
    let depths = planes.front.chunks_mut(band_pixels).zip(planes.back.chunks_mut(band_pixels));
    let rest = planes.optical_depth.chunks_mut(band_pixels).zip(source);
    depths.zip(rest).map(|((front, back), (optical_depth, ((red, green), blue)))| LayerRows {
        front,
        back,
        optical_depth,
        source: [red, green, blue],
    })
}
