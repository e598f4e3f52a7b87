//! Points of hole filling: how what the frame does not know differs from what is really there.
//!
//! Live frames of a scene ([`Walk`]) are warped, uncoded, to where the head is [`AGE_SECS`] later, far enough that it sees
//! behind things. It does not turn meanwhile: what a turn brings in at the border is the guard band's affair, and would be
//! most of what is filled. The error is the FLIP to the converged picture of that pose over the pixels that were filled
//! ([`Warper::filled_pixels`]), the same for all methods; that over the whole picture stands beside it. Time is that of a
//! whole picture, methods taking turns; what a method costs is its difference to `leave`.

use super::stream::reference;
use super::surface::median_and_spread;
use super::{Point, Progress, Request, SweepError};
use crate::loopback::{Beat, Walk};
use crate::measure::{MeasureError, PIXELS_PER_DEGREE, flip};
use crate::warp::{HoleFilling, Mode, Warper};
use image::RgbImage;
use std::collections::BTreeMap;
use warplight_protocol::Pose;

/// A room with many things in it, and one with few.
pub(super) const SCENES: [&str; 2] = ["gallery", "cornell"];
/// Frames, and those of a quick sweep.
const FRAMES: [u32; 2] = [8, 2];
/// From one to the next, along the trace, and into it where the head has begun to move.
const FRAME_HZ: f64 = 0.5;
const START_SECS: f64 = 2.0;
/// As old as frames get where the network stalls: what is uncovered is then wide enough to look at.
const AGE_SECS: f64 = 0.4;
/// Samples per pixel of what is really seen where none are asked for, and of a quick sweep: its noise is in every error.
const REFERENCE_SPP: [u32; 2] = [64, 16];

/// Every method on a scene.
pub(super) fn measure(request: &Request<'_>, scene: &str, progress: Progress<'_>) -> Result<Vec<Point>, SweepError> {
    let quick = usize::from(request.quick);
    let beat = Beat { frames: FRAMES[quick], frame_hz: FRAME_HZ, age_secs: AGE_SECS, start_secs: START_SECS };
    let walk =
        Walk::new(scene, request.trace, request.size, beat).map_err(|error| SweepError::Scene(error.to_string()))?;
    let spp = if request.reference_spp > 0 { request.reference_spp } else { REFERENCE_SPP[quick] };
    let measured = |error: MeasureError| SweepError::Scene(error.to_string());
    let mut sums = HoleFilling::ALL.map(|_| Sums::default());
    let mut warper = Warper::default();
    let mut picture = RgbImage::default();
    let (mut known, mut filled_pixels) = (0, 0);
    for (frame, (tree, later)) in walk.frames.iter().zip(&walk.display_poses).enumerate() {
        let pose = &Pose { position: later.position, orientation: tree.render_pose.orientation };
        let truth = reference(&walk, pose, spp);
        warper.prepare(Mode::Specular, tree);
        for run in 0..=request.runs {
            for (filling, sums) in HoleFilling::ALL.into_iter().zip(&mut sums) {
                warper.set_hole_filling(filling);
                let start = (request.now)();
                warper.show(Mode::Specular, tree, pose, &walk.shape.camera, walk.shape.exposure, &mut picture);
                let end = (request.now)();
                if run > 0 {
                    sums.times_ms.push((end - start).as_secs_f64() * 1e3);
                    continue;
                }
                // The first run is for the picture, and warms up.
                let mask = warper.filled_pixels();
                let count = mask.iter().filter(|filled| **filled).count();
                let map = flip(&truth, &picture, PIXELS_PER_DEGREE).map_err(measured)?;
                sums.flip_all += map.mean(None).map_err(measured)? * mask.len() as f64;
                if count > 0 {
                    sums.flip_filled += map.mean(Some(&mask)).map_err(measured)? * count as f64;
                }
                if filling == HoleFilling::default() {
                    (known, filled_pixels) = (known + mask.len(), filled_pixels + count);
                }
            }
        }
        warper.forget();
        progress(frame as u64 + 1, u64::from(FRAMES[quick]));
    }
    if filled_pixels == 0 {
        return Err(SweepError::Scene(format!(
            "--scene {scene}: expected one in which the head sees behind something"
        )));
    }
    let point = |(filling, sums): (HoleFilling, &Sums)| {
        let (time_ms, time_spread_ms) = median_and_spread(&sums.times_ms);
        let more = [("flip_whole", sums.flip_all / known as f64), ("filled", filled_pixels as f64 / known as f64)];
        Point {
            value: filling.name().to_owned(),
            scene: scene.to_owned(),
            time_ms,
            time_spread_ms,
            error: sums.flip_filled / filled_pixels as f64,
            bytes: 0,
            pareto: false,
            more: BTreeMap::from(more.map(|(name, value)| (name.to_owned(), value))),
        }
    };
    Ok(HoleFilling::ALL.into_iter().zip(&sums).map(point).collect())
}

/// Of a method, over all frames.
#[derive(Default)]
struct Sums {
    flip_filled: f64,
    flip_all: f64,
    times_ms: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use super::super::tests::{error_of, swept};

    #[test]
    fn any_filling_is_nearer_to_what_is_there_than_black() {
        let sweep = swept("hole-filling", Some("gallery"), 128);
        for name in ["even push-pull", "background", "push-pull"] {
            assert!(error_of(&sweep, name) < error_of(&sweep, "leave"), "{name}: {sweep:?}");
        }
        // All methods fill the same pixels, so errors of whole pictures are in the same order.
        assert!(
            sweep.points.iter().all(|point| point.more["filled"] > 1e-3 && point.more["filled"] < 0.2),
            "{sweep:?}"
        );
        let whole = |name: &str| sweep.points.iter().find(|point| point.value == name).unwrap().more["flip_whole"];
        assert!(whole("push-pull") < whole("leave"));
    }
}
