//! Points of a budget: what each way to make a refresh or a frame costs, and how far its picture is from what is really seen.
//!
//! Live frames along a head trace ([`Walk`]) are brought to the pose that the head has by the time they are shown, once for
//! every [`DisplayPoint`] (knob `display-point`) or every [`FramePoint`] (knob `frame-point`); the error is the mean FLIP to
//! converged pictures of the same poses. References are the same for all points, so their noise lifts all errors alike
//! and orders none of them. Points take turns, run by run, so that all see the same machine.
//!
//! What comes out is a table of a cost model (`sweep KNOB --model`), from which a budget chooses. Limits: surfaces only;
//! frames are not coded; the age of a frame is the same at every point, though frames that take less are younger.

mod display;
mod frame;

pub(super) use display::measure as of_display;
pub(super) use frame::measure as of_frame;

use super::surface::median_and_spread;
use super::{Point, Request, SweepError};
use crate::loopback::{Beat, Walk};
use crate::measure::{MeasureError, PIXELS_PER_DEGREE, flip};
use image::RgbImage;
use std::collections::BTreeMap;
use warplight_protocol::tone::ToneTable;

/// Scenes with mirrors, glass and water.
pub(super) const SCENES: [&str; 3] = ["gallery", "pool", "glass"];
/// Frames per second, their age when they are shown, and where in the trace the head has begun to move.
const BEAT: Beat = Beat { frames: 0, frame_hz: 5.0, age_secs: 0.1, start_secs: 2.0 };
/// Frames, and those of a quick sweep.
const FRAMES: [u32; 2] = [4, 2];
/// Samples per pixel of the references where a request names none, and of a quick sweep.
const REFERENCE_SPP: [u32; 2] = [48, 16];

/// The frames of a scene and what is really seen when each is shown.
fn walk_of(request: &Request<'_>, scene: &str) -> Result<(Walk, Vec<RgbImage>), SweepError> {
    let quick = usize::from(request.quick);
    let beat = Beat { frames: FRAMES[quick], ..BEAT };
    let walk =
        Walk::new(scene, request.trace, request.size, beat).map_err(|error| SweepError::Scene(error.to_string()))?;
    let spp = if request.reference_spp > 0 { request.reference_spp } else { REFERENCE_SPP[quick] };
    let (tone, size) = (ToneTable::default(), walk.shape.camera.size);
    let reference = |pose| {
        let radiance = walk.seen_from(pose, spp).into_iter();
        let codes = radiance.flat_map(|radiance| tone.display_from_radiance(radiance, walk.shape.exposure)).collect();
        RgbImage::from_raw(size.width, size.height, codes).unwrap_or_default()
    };
    let references = walk.display_poses.iter().map(reference).collect();
    Ok((walk, references))
}

/// Mean FLIP of two pictures.
fn error_of(reference: &RgbImage, picture: &RgbImage) -> Result<f64, SweepError> {
    let measured = |error: MeasureError| SweepError::Scene(error.to_string());
    flip(reference, picture, PIXELS_PER_DEGREE).map_err(measured)?.mean(None).map_err(measured)
}

/// What was measured of one point.
#[derive(Clone, Debug, Default)]
struct Measured {
    errors: Vec<f64>,
    millis: Vec<f64>,
    bytes: u64,
}

impl Measured {
    fn point(&self, scene: &str, value: String) -> Point {
        let (time_ms, time_spread_ms) = median_and_spread(&self.millis);
        Point {
            value,
            scene: scene.to_owned(),
            time_ms,
            time_spread_ms,
            error: self.errors.iter().sum::<f64>() / self.errors.len().max(1) as f64,
            bytes: self.bytes,
            pareto: false,
            more: BTreeMap::new(),
        }
    }
}
