//! What precision costs: the same done coarser and finer, in time, bytes and image error.
//!
//! Scenes are the places where precision was chosen:
//!
//! - `march`: layers of the cloud brought to a new pose in f32, in vectors and interpolated along epipolar lines, the same at
//!   four times the density of samples, and ray by ray in f64 ([`Method::Plain`]), which is what the pictures are compared
//!   with. The times are those of the programs as they are: the f32 one also has vectors, the f64 one none.
//! - `pose`: the gallery for a display pose that has travelled as twelve half floats, in our own form, and not at all.
//! - `color`: the gallery along a trace with 8 and 10 bits a channel, shared exponents and half floats, depth in 24 bits.
//! - `depth`: the same with 16 and 24 bits of depth, colour in half floats.
//!
//! The error is the FLIP of what is displayed to what it would be without. What f64 would give the surface warp is not
//! among them, since there is no such program: its tests compare its f32 with f64 oracles point by point.

use super::head::{POSE_FORMATS, PoseFormat};
use super::stream::{self, Setting};
use super::surface::median_and_spread;
use super::volume::cloud_study;
use super::{Point, Progress, Request, SweepError};
use crate::loopback::{Beat, Walk};
use crate::march::{Marcher, Method, STRIDE_PX};
use crate::measure::{MeasureError, PIXELS_PER_DEGREE, flip, psnr_srgb8};
use crate::warp::{Mode, Warper};
use image::RgbImage;
use std::collections::BTreeMap;
use std::hint::black_box;
use warplight_protocol::Pose;
use warplight_protocol::frame::ColorFormat;

/// Where precision was chosen.
pub(super) const SCENES: [&str; 4] = ["march", "pose", "color", "depth"];
/// The scene of all but the first.
const FRAMES_OF: &str = "gallery";
/// Degrees around the cloud.
const DEGREES: f64 = 10.0;

/// Every precision at a place.
pub(super) fn measure(request: &Request<'_>, place: &str, progress: Progress<'_>) -> Result<Vec<Point>, SweepError> {
    let (settings, renamed) = match place {
        "march" => return march(request, progress),
        "pose" => return pose(request, progress),
        "color" => {
            let formats = [ColorFormat::Root8, ColorFormat::Root10, ColorFormat::Rgb9e5, ColorFormat::Half];
            (formats.map(Setting::of_color).to_vec(), place)
        }
        _ => ([16, 24].map(Setting::of_depth).to_vec(), place),
    };
    let mut points = stream::measure(request, FRAMES_OF, &settings, progress)?;
    points.iter_mut().for_each(|point| point.scene = renamed.to_owned());
    Ok(points)
}

fn march(request: &Request<'_>, progress: Progress<'_>) -> Result<Vec<Point>, SweepError> {
    let (study, received) = cloud_study(request)?;
    let pose = study.pose(DEGREES);
    let settings = [
        ("f32", Method::Layers, STRIDE_PX),
        ("f32, denser", Method::Layers, STRIDE_PX / 4.0),
        ("f64", Method::Plain, STRIDE_PX),
    ];
    let mut marcher = Marcher::default();
    marcher.prepare(&received.tree);
    let mut pictures = settings.map(|_| Vec::new());
    let mut times_ms = settings.map(|_| Vec::new());
    for run in 0..=request.runs {
        for (index, (_, method, stride)) in settings.into_iter().enumerate() {
            marcher.set_stride(stride);
            let start = (request.now)();
            marcher.march(method, &received.tree, &pose, &study.camera, None, &mut pictures[index]);
            let end = (request.now)();
            if run > 0 {
                times_ms[index].push((end - start).as_secs_f64() * 1e3);
            }
        }
        progress(u64::from(run) + 1, u64::from(request.runs) + 1);
    }
    let pictures = pictures.map(|picture| study.before_black(&pose, &picture));
    let bytes =
        received.plane_bytes.iter().filter(|(kind, _)| kind.is_of_layer()).map(|(_, bytes)| bytes).sum::<usize>()
            as u64;
    let points = settings
        .iter()
        .zip(&pictures)
        .zip(&times_ms)
        .map(|(((name, ..), picture), times_ms)| point(name, "march", &pictures[2], picture, bytes, times_ms));
    points.collect()
}

fn pose(request: &Request<'_>, progress: Progress<'_>) -> Result<Vec<Point>, SweepError> {
    let beat = Beat { frames: 1, frame_hz: 1.0, age_secs: 0.1, start_secs: 2.0 };
    let walk = Walk::new(FRAMES_OF, request.trace, request.size, beat)
        .map_err(|error| SweepError::Scene(error.to_string()))?;
    let (tree, pose) = (&walk.frames[0], walk.display_poses[0]);
    let [halves, own, _] = &POSE_FORMATS;
    let as_it_is = PoseFormat { name: "7 f64", bytes: 56, travel: |pose| Some(*pose) };
    let forms = [halves, own, &as_it_is];
    let mut warper = Warper::default();
    warper.prepare(Mode::Specular, tree);
    let mut show = |pose: &Pose| {
        let mut picture = RgbImage::default();
        warper.show(Mode::Specular, tree, pose, &walk.shape.camera, walk.shape.exposure, &mut picture);
        picture
    };
    let untouched = show(&pose);
    let mut points = Vec::new();
    for &PoseFormat { name, bytes, travel } in forms {
        let travelled = travel(&pose).ok_or_else(|| SweepError::Scene(format!("a pose that {name} cannot hold")))?;
        // One alone is quicker than a clock is fine.
        const REPEATED: u32 = 1000;
        let time = |_| {
            let start = (request.now)();
            for _ in 0..REPEATED {
                black_box(travel(black_box(&pose)));
            }
            ((request.now)() - start).as_secs_f64() * 1e3 / f64::from(REPEATED)
        };
        let times_ms: Vec<f64> = (0..request.runs).map(time).collect();
        points.push(point(name, "pose", &untouched, &show(&travelled), bytes, &times_ms)?);
        progress(points.len() as u64, forms.len() as u64);
    }
    Ok(points)
}

fn point(
    value: &str,
    scene: &str,
    finest: &RgbImage,
    picture: &RgbImage,
    bytes: u64,
    times_ms: &[f64],
) -> Result<Point, SweepError> {
    let measured = |error: MeasureError| SweepError::Scene(error.to_string());
    let (time_ms, time_spread_ms) = median_and_spread(times_ms);
    Ok(Point {
        value: value.to_owned(),
        scene: scene.to_owned(),
        time_ms,
        time_spread_ms,
        error: flip(finest, picture, PIXELS_PER_DEGREE).and_then(|map| map.mean(None)).map_err(measured)?,
        bytes,
        pareto: false,
        more: BTreeMap::from([("psnr_db".to_owned(), psnr_srgb8(finest, picture, None).map_err(measured)?)]),
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::{error_of, swept};

    #[test]
    fn more_bits_leave_less_error_and_take_no_fewer_bytes() {
        for (place, coarser_first) in [
            ("color", &["root8", "root10", "half"][..]),
            ("depth", &["16 bits", "24 bits"]),
            ("pose", &["12 halves", "7 f64"]),
        ] {
            let sweep = swept("precision", Some(place), 96);
            let points: Vec<_> = coarser_first
                .iter()
                .map(|value| sweep.points.iter().find(|point| point.value == *value).unwrap())
                .collect();
            for pair in points.windows(2) {
                assert!(pair[1].error < pair[0].error && pair[1].bytes >= pair[0].bytes, "{place}: {pair:?}");
            }
        }
    }

    /// A difference of one code of 255 in a pixel is a FLIP of some thousandths there; samples between which is interpolated
    /// may be off by more than that here and there, but not on the whole.
    #[test]
    fn marching_in_floats_is_marching_in_doubles_to_the_eye() {
        let sweep = swept("precision", Some("march"), 96);
        assert_eq!(error_of(&sweep, "f64"), 0.0);
        assert!(
            error_of(&sweep, "f32, denser") <= error_of(&sweep, "f32") && error_of(&sweep, "f32") < 0.01,
            "{sweep:?}"
        );
    }
}
