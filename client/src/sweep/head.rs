//! Points of the head: how its pose travels, and how it is continued.
//!
//! No frame is needed for these: the error of a pose is an angle, or how far a point that the head looks at is from its
//! place on the display. Poses are those of the trace.
//!
//! **How a pose travels** (`pose-format`): poses of the trace, brought as far from the origin as the scene's name says, are
//! written and read in each format. The error is that of the pixels of points [`POINT_M`] away, in f64. Beside the two
//! forms of the protocol stands a matrix of twelve floats of 32 bits, which nobody sends.
//!
//! **How a pose is continued** (`prediction`, `horizon`): the server's own [`Predictor`] hears the trace as a client samples
//! it, 60 times a second; the error is the angle to where the head was at the horizon. Scenes are the trace asked for and one
//! from a seed.

use super::surface::median_and_spread;
use super::{Point, Progress, Request, SweepError};
use crate::measure::Percentiles;
use crate::trace::Trace;
use glam::{DMat3, DQuat, DVec2, DVec3};
use std::collections::BTreeMap;
use std::hint::black_box;
use std::time::Duration;
use warplight_protocol::message::{PoseSample, Prediction};
use warplight_protocol::{Camera, Pose, Timestamp};
use warplight_server::predict::Predictor;

/// Distances from the origin, as scenes.
pub(super) const DISTANCES: [&str; 4] = ["1m", "10m", "100m", "1000m"];
/// Traces, as scenes: the one asked for, and another head's.
pub(super) const TRACES: [&str; 2] = ["trace", "synthetic"];
/// How far away is what the head looks at.
const POINT_M: f64 = 2.0;
/// Poses of the trace that travel, and those of a quick sweep.
const POSES: [u32; 2] = [300, 60];
/// Vertical field of view of the display, as that of sweeps of the codec.
const FOV_RAD: f32 = 1.4;
/// Refreshes of the display, at each of which a client says where the head is.
const DISPLAY_HZ: f64 = 60.0;
/// How far ahead prediction is asked for, where that is not the knob: a frame of two cores and a near network.
const HORIZON: Duration = Duration::from_millis(60);
/// Seed and seconds of the other head.
const SYNTHETIC: (u64, f64) = (1, 30.0);

/// A form of a pose: its name, its bytes, and what is read of what was written.
pub(super) struct PoseFormat {
    pub(super) name: &'static str,
    pub(super) bytes: u64,
    pub(super) travel: fn(&Pose) -> Option<Pose>,
}

pub(super) const POSE_FORMATS: [PoseFormat; 3] = [
    PoseFormat {
        name: "12 halves",
        bytes: Pose::HALF_BYTES as u64,
        travel: |pose| Pose::from_half_matrix(&pose.to_half_matrix()),
    },
    PoseFormat {
        name: "own",
        bytes: Pose::WIRE_BYTES as u64,
        travel: |pose| pose.to_wire().and_then(|bytes| Pose::from_wire(&bytes)),
    },
    PoseFormat { name: "12 floats", bytes: 48, travel: |pose| Some(in_floats(pose)) },
];

/// What is left of a pose in f32.
fn in_floats(pose: &Pose) -> Pose {
    let rotation = DMat3::from_quat(pose.orientation).as_mat3().as_dmat3();
    let x = rotation.x_axis.normalize();
    let z = x.cross(rotation.y_axis).normalize();
    let orientation = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z)).normalize();
    Pose { position: pose.position.as_vec3().as_dvec3(), orientation }
}

/// Every form of a pose, so far from the origin.
pub(super) fn pose_formats(
    request: &Request<'_>,
    scene: &str,
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let distance_m = scene.trim_end_matches('m').parse().unwrap_or(1.0);
    // Aside on the ground, so that two coordinates are large.
    let away = DVec3::new(1.0, 0.0, 1.0).normalize() * distance_m;
    let first = request.trace.pose_at(0.0).position;
    let count = POSES[usize::from(request.quick)];
    let poses: Vec<Pose> = (0..count)
        .map(|index| {
            let pose = request.trace.pose_at(request.trace.duration_secs() * f64::from(index) / f64::from(count));
            Pose { position: pose.position - first + away, ..pose }
        })
        .collect();
    let camera = Camera::symmetric(FOV_RAD, request.size);
    let mut points = Vec::new();
    let all = POSE_FORMATS.len() as u64;
    for format in &POSE_FORMATS {
        let mut errors = Errors::default();
        for pose in &poses {
            // What does not travel is as wrong as can be; none of these is of that kind.
            let travelled = (format.travel)(pose)
                .ok_or_else(|| SweepError::Scene(format!("--trace: a pose that {} cannot hold", format.name)))?;
            errors.add(pose, &travelled);
            errors.px.extend(pixel_errors(&camera, pose, &travelled));
        }
        let times = timed(request, poses.len(), || {
            for pose in &poses {
                black_box((format.travel)(black_box(pose)));
            }
        });
        let mean_px = errors.px.iter().sum::<f64>() / errors.px.len() as f64;
        let worst_px = errors.px.iter().copied().fold(0.0, f64::max);
        let more = [("worst_px", worst_px), ("mean_mm", mean(&errors.mm)), ("mean_deg", mean(&errors.deg))];
        points.push(point(format.name, scene, mean_px, format.bytes, times, more));
        progress(points.len() as u64, all);
    }
    Ok(points)
}

/// How far points that are seen all over the display are from their places, in pixels.
fn pixel_errors(camera: &Camera, pose: &Pose, travelled: &Pose) -> Vec<f64> {
    let focal = camera.focal_px().as_dvec2();
    let parts = [0.1_f32, 0.3, 0.5, 0.7, 0.9];
    let size = glam::Vec2::new(camera.size.width as f32, camera.size.height as f32);
    let pixels = parts.into_iter().flat_map(|x| parts.map(|y| size * glam::Vec2::new(x, y)));
    let error = |pixel| {
        let ray = camera.ray_in_view(pixel).as_dvec3();
        let point = pose.point_in_world(ray * POINT_M);
        let seen = travelled.orientation.inverse() * (point - travelled.position);
        let tangent = |v: DVec3| DVec2::new(v.x, v.y) / -v.z;
        ((tangent(seen) - tangent(ray)) * focal).length()
    };
    pixels.map(error).collect()
}

/// Every law at the same horizon.
pub(super) fn predictions(
    request: &Request<'_>,
    scene: &str,
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let settings = Prediction::ALL.map(|law| (law.name().to_owned(), law, HORIZON));
    continued(request, scene, &settings, progress)
}

/// The default law, further and further ahead.
pub(super) fn horizons(request: &Request<'_>, scene: &str, progress: Progress<'_>) -> Result<Vec<Point>, SweepError> {
    let millis: &[u64] = if request.quick { &[20, 60, 100] } else { &[10, 20, 40, 60, 80, 100, 150, 200] };
    let setting = |&millis: &u64| (millis.to_string(), Prediction::default(), Duration::from_millis(millis));
    continued(request, scene, &millis.iter().map(setting).collect::<Vec<_>>(), progress)
}

fn continued(
    request: &Request<'_>,
    scene: &str,
    settings: &[(String, Prediction, Duration)],
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let other;
    let trace = if scene == TRACES[0] {
        request.trace
    } else {
        let (seed, secs) = SYNTHETIC;
        other =
            Trace::synthesise(seed, secs, 2.0 * DISPLAY_HZ).map_err(|error| SweepError::Scene(error.to_string()))?;
        &other
    };
    // All settings at the same instants.
    let farthest = settings.iter().map(|(_, _, horizon)| *horizon).max().unwrap_or_default();
    let last = trace.duration_secs() - farthest.as_secs_f64();
    let at: Vec<f64> = (0..).map(|index| f64::from(index) / DISPLAY_HZ).take_while(|secs| *secs <= last).collect();
    let samples: Vec<PoseSample> = at
        .iter()
        .map(|&secs| PoseSample {
            time: Timestamp { micros: 1_000_000 + (secs * 1e6).round() as u64 },
            pose: trace.pose_at(secs),
        })
        .collect();
    if samples.len() < 2 {
        return Err(SweepError::Scene(format!("--trace: expected one of more than {farthest:?}")));
    }
    let mut points = Vec::new();
    for (value, law, horizon) in settings {
        let follow = |mut each: Box<dyn FnMut(usize, Pose) + '_>| {
            let mut predictor = Predictor::new(*law);
            for (index, sample) in samples.iter().enumerate() {
                predictor.push(*sample);
                each(index, predictor.predict(*horizon).unwrap_or(sample.pose));
            }
        };
        let (mut errors, mut unpredicted) = (Errors::default(), Errors::default());
        follow(Box::new(|index, pose| {
            let truth = trace.pose_at(at[index] + horizon.as_secs_f64());
            errors.add(&truth, &pose);
            unpredicted.add(&truth, &samples[index].pose);
        }));
        let times = timed(request, samples.len(), || {
            follow(Box::new(|_, pose| {
                black_box(pose);
            }));
        });
        let p95 = |samples: &[f64]| Percentiles::from_samples(samples).map_or(0.0, |spread| spread.p95);
        let more = [
            ("p95_deg", p95(&errors.deg)),
            ("mean_mm", mean(&errors.mm)),
            ("p95_mm", p95(&errors.mm)),
            ("unpredicted_deg", mean(&unpredicted.deg)),
        ];
        points.push(point(value, scene, mean(&errors.deg), 0, times, more));
        progress(points.len() as u64, settings.len() as u64);
    }
    Ok(points)
}

/// Errors of poses: turns in degrees, places in millimetres, pixels.
#[derive(Default)]
struct Errors {
    deg: Vec<f64>,
    mm: Vec<f64>,
    px: Vec<f64>,
}

impl Errors {
    fn add(&mut self, truth: &Pose, pose: &Pose) {
        self.deg.push(truth.angle_to(pose).to_degrees());
        self.mm.push(truth.position.distance(pose.position) * 1e3);
    }
}

fn mean(samples: &[f64]) -> f64 {
    samples.iter().sum::<f64>() / samples.len().max(1) as f64
}

/// Milliseconds for each of `count` poses, by run.
fn timed(request: &Request<'_>, count: usize, mut run: impl FnMut()) -> Vec<f64> {
    (0..request.runs)
        .map(|_| {
            let start = (request.now)();
            run();
            ((request.now)() - start).as_secs_f64() * 1e3 / count as f64
        })
        .collect()
}

fn point<const N: usize>(
    value: &str,
    scene: &str,
    error: f64,
    bytes: u64,
    times: Vec<f64>,
    more: [(&str, f64); N],
) -> Point {
    let (time_ms, time_spread_ms) = median_and_spread(&times);
    Point {
        value: value.to_owned(),
        scene: scene.to_owned(),
        time_ms,
        time_spread_ms,
        error,
        bytes,
        pareto: false,
        more: BTreeMap::from(more.map(|(name, value)| (name.to_owned(), value))),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::swept;
    use super::*;

    /// Halves of a coordinate of 0.7, 7, 71 and 707 m are 2^-11, 2^-8, 2^-4 and 1/2 m apart. Our own steps are of 2^-20 m
    /// and 2^-29: a point 2 m away is displaced by at most sqrt(3) 2^-21 m, so by 0.42e-6 in tangents straight ahead, and
    /// less than 2.4 times that at the border, where the tangent is at most 1.4.
    #[test]
    fn halves_get_coarser_with_the_distance_and_our_own_form_does_not() {
        let sweep = swept("pose-format", None, 128);
        let halves: Vec<f64> = sweep
            .by_scene()
            .map(|points| points.iter().find(|point| point.value == "12 halves").unwrap().error)
            .collect();
        assert!(halves.windows(2).all(|pair| pair[0] < pair[1]), "{halves:?}");
        let focal_px = f64::from(
            Camera::symmetric(FOV_RAD, warplight_protocol::ImageSize::new(sweep.size[0], sweep.size[1])).focal_px().x,
        );
        for points in sweep.by_scene() {
            let own = points.iter().find(|point| point.value == "own").unwrap();
            assert!(own.error < 1e-6 * focal_px && own.bytes == 25, "{own:?}");
        }
        // Half a metre apart, 2 m away: a tenth and more of the focal length, but for luck.
        assert!(halves[3] > 0.02 * focal_px, "{halves:?}");
    }

    /// What the mixture is the default for, and what its own tests claim on other heads.
    #[test]
    fn the_default_law_is_at_or_below_the_others() {
        let sweep = swept("prediction", None, 64);
        for points in sweep.by_scene() {
            let of = |name: &str| points.iter().find(|point| point.value == name).unwrap();
            let adaptive = of(Prediction::default().name());
            assert!(adaptive.error <= of("none").error && adaptive.error <= of("constant").error, "{points:?}");
            assert_eq!(of("none").error, of("none").more["unpredicted_deg"]);
        }
    }

    #[test]
    fn the_further_ahead_the_larger_is_the_error_and_it_is_below_that_of_none() {
        let sweep = swept("horizon", Some("trace"), 64);
        assert!(sweep.points.windows(2).all(|pair| pair[0].error < pair[1].error), "{sweep:?}");
        assert!(sweep.points.iter().all(|point| point.error < point.more["unpredicted_deg"]));
    }
}
