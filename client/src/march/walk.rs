//! The plain walk: every ray by itself, pixel by pixel, in f64.
//!
//! For each pixel that the ray crosses ([`super::crossings`]) the segments of its record are cut with the part of the ray
//! in the pixel's frustum, nearest first or furthest first, whichever the ray meets first, and composed
//! ([`super::transport`]). A segment's extinction is its optical depth over its length along the ray of its own pixel;
//! planes of constant depth bound it, so the part of a ray within is found by depth, and for a ray across the view by
//! being between them at all. From the render pose itself this is the sum of the pixel's own segments.
//!
//! What lies behind the last segment of a pixel is empty here: the frame knows nothing of what hides behind something
//! opaque, and to prolong the last segment would throw beams of light. Exact in all motions; a microsecond per pixel
//! crossed, so it is the oracle of [`super::packets`], and takes over where that one cannot go.

use super::crossings::{Crossing, Crossings};
use super::packed::MAX_DEPTH_M;
use super::transport::Transport;
use super::view::{Pinhole, Ray};
use warplight_protocol::frame::{Tree, VolumeSegment};

/// A frame to be walked through.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame<'a> {
    pub(super) tree: &'a Tree,
    pub(super) pinhole: Pinhole,
    /// Nearest front and furthest back, metres of depth; see [`super::packed::Packed::depths_m`].
    depths_m: [f64; 2],
}

/// Depth below which nothing is looked for, in parts of the furthest: the frame's own eye has no pixel.
const NEAREST_PART: f64 = 1e-9;

impl<'a> Frame<'a> {
    pub(super) fn new(tree: &'a Tree, depths_m: [f32; 2]) -> Frame<'a> {
        let [nearest, furthest] = depths_m.map(f64::from);
        let depths_m = [nearest.max(furthest * NEAREST_PART), furthest];
        Frame { tree, pinhole: Pinhole::new(&tree.camera), depths_m }
    }

    /// A segment of a pixel that is one: of finite depths in order, and of some matter.
    pub(super) fn segment(&self, pixel: usize, layer: usize) -> Option<VolumeSegment> {
        self.tree.layers[layer].at(pixel).filter(|segment| {
            segment.front_m >= 0.0
                && segment.front_m < segment.back_m
                && segment.back_m < MAX_DEPTH_M
                && segment.source.is_finite()
        })
    }

    /// What a ray gathers up to `t = farthest`.
    pub(super) fn march(&self, ray: &Ray, farthest: f64) -> Transport {
        let mut gathered = Transport::default();
        let [near, far] = self.depths_m;
        if near < far {
            for crossing in Crossings::new(&self.pinhole, ray, [near, far], farthest) {
                self.cross(ray, &crossing, &mut gathered);
            }
        }
        gathered
    }

    /// Goes through the segments of one pixel.
    fn cross(&self, ray: &Ray, crossing: &Crossing, gathered: &mut Transport) {
        let layers = self.tree.layers.len();
        let pixel = crossing.row * self.pinhole.size_px[0] + crossing.column;
        let length_per_depth = self.pinhole.obliquity(crossing.column, crossing.row);
        let length_per_t = ray.direction.length();
        for order in 0..layers {
            let layer = if ray.direction.z >= 0.0 { order } else { layers - 1 - order };
            let Some(segment) = self.segment(pixel, layer) else { continue };
            let within = part_within(ray, crossing, f64::from(segment.front_m), f64::from(segment.back_m));
            if within > 0.0 {
                let length_m = f64::from(segment.back_m - segment.front_m) * length_per_depth;
                let extinction_per_m = f64::from(segment.optical_depth) / length_m;
                gathered.cross(extinction_per_m * within * length_per_t, segment.source.as_dvec3());
            }
        }
    }
}

/// How much of a crossing, in the ray's parameter, is between two depths; below zero if nothing is.
fn part_within(ray: &Ray, crossing: &Crossing, front: f64, back: f64) -> f64 {
    let (depth, slope) = (ray.origin.z, ray.direction.z);
    if slope == 0.0 {
        return if front <= depth && depth < back { crossing.exit - crossing.enter } else { -1.0 };
    }
    let (a, b) = ((front - depth) / slope, (back - depth) / slope);
    a.max(b).min(crossing.exit) - a.min(b).max(crossing.enter)
}
