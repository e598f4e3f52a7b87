//! Points of a session: how far the display is from what is really seen, by which nodes, how large and how often frames are.
//!
//! A head walks along a trace while live frames are rendered at a steady rate, coded, decoded, and warped to the poses that
//! the head has at a few instants of the display. What each instant shows is the newest frame that was begun at least
//! [`LATENCY_SECS`] before: a frame is between that and a beat more old, as in a session without jitter. The error is the
//! mean FLIP to converged pictures from the display's poses: it holds all there is, the noise and blur of live frames, what
//! coding takes away, and what the warp does not know. What does not change with the knob is in all of its points; so that of
//! `tree-depth` is taken where a display shows a mirror, glass or water, if it does anywhere, and that of all stands beside it.
//! There the head is also [`ASIDE_M`] to the right of where the trace has it: a head that mostly turns moves pictures in
//! mirrors by less than a pixel of a small display, whatever they are taken to be painted on.
//!
//! Time is that of the client for a picture: taking the frame in and showing it. Beside it stand the server's for a frame.
//! Of the knob `frame-rate` bytes are those of a second, and time is what the server works in it.
//!
//! Displays are small ([`SIDE_PX`]), since path-traced pictures stand behind every point.

mod settings;

use super::surface::median_and_spread;
use super::{Point, Progress, Request, SweepError};
use crate::loopback::{Loopback, Walker};
use crate::measure::{MeasureError, PIXELS_PER_DEGREE, dssim, flip};
use crate::warp::{Mode, Warper};
use glam::DVec3;
use image::RgbImage;
pub(super) use settings::{Setting, frame_rates, resolutions, tree_depths};
use std::collections::BTreeMap;
use warplight_protocol::tone::ToneTable;
use warplight_protocol::{ImageSize, Pose};

/// Scenes with reflections, refractions and both.
pub(super) const SCENES: [&str; 2] = ["gallery", "glass"];
/// Where the head has the most to walk around in, for knobs of time and size.
pub(super) const ROOM: [&str; 1] = ["gallery"];
/// Longest side of the display, and that of a quick sweep.
pub(super) const SIDE_PX: [u32; 2] = [256, 128];
/// From the pose of a frame until it can be shown: rendering, coding and the way.
const LATENCY_SECS: f64 = 0.05;
/// Into the trace, where the head has begun to move: when the first frame is rendered.
const START_SECS: f64 = 2.0;
/// Instants of the display after the first frame can be shown, in seconds: ages in a beat of 0.4 s, and in each half of one
/// that is left, are spread over the beat. The first four are those of a quick sweep.
const INSTANTS_SECS: [f64; 8] = [0.06, 0.29, 0.53, 0.77, 0.16, 0.39, 0.63, 0.68];
/// How far aside displays are where nodes are compared: a step of half a foot, of a head whose frames have stopped coming.
const ASIDE_M: f64 = 0.15;
/// Samples per pixel of the converged pictures, where nobody asks for others.
const REFERENCE_SPP: [u32; 2] = [64, 32];

/// An instant of the display.
struct Display {
    /// After the first frame can be shown.
    secs: f64,
    pose: Pose,
    /// What is really seen.
    reference: RgbImage,
    /// Where that is a surface whose light may have nodes of its own; nothing where there is none.
    specular: Option<Vec<bool>>,
}

/// What was measured of a setting.
#[derive(Default)]
struct Sums {
    flip: f64,
    flip_specular: f64,
    dssim: f64,
    age_secs: f64,
    bytes: usize,
    frames: u32,
    render_ms: Vec<f64>,
    prepare_ms: Vec<f64>,
    show_ms: Vec<f64>,
    both_ms: Vec<f64>,
}

/// Measures settings on a scene.
pub(super) fn measure(
    request: &Request<'_>,
    scene: &str,
    settings: &[Setting],
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let walker = Walker::new(scene, request.trace).map_err(|error| SweepError::Scene(error.to_string()))?;
    let quick = usize::from(request.quick);
    let instants = if request.quick { &INSTANTS_SECS[..4] } else { &INSTANTS_SECS[..] };
    let total = (instants.len() * (1 + settings.len())) as u64;
    let mut done = 0;
    let mut step = || {
        done += 1;
        progress(done, total);
    };
    let spp = if request.reference_spp > 0 { request.reference_spp } else { REFERENCE_SPP[quick] };
    let mut displays = Vec::new();
    for &secs in instants {
        let aside_m = if settings.iter().any(Setting::is_of_nodes) { ASIDE_M } else { 0.0 };
        let mut pose = walker.pose_at(START_SECS + LATENCY_SECS + secs);
        pose.position += pose.orientation * DVec3::X * aside_m;
        let specular = walker.specular_from(&pose, Walker::camera(request.size));
        let specular = specular.contains(&true).then_some(specular);
        displays.push(Display { secs, pose, reference: reference(&walker, request.size, &pose, spp), specular });
        step();
    }
    let mut points = Vec::new();
    for setting in settings {
        let sums = shown(request, &walker, setting, &displays, &mut step)?;
        points.push(point(scene, setting, displays.len() as f64, &sums));
    }
    Ok(points)
}

/// What is really seen, as it is displayed.
fn reference(walker: &Walker, size: ImageSize, pose: &Pose, spp: u32) -> RgbImage {
    let tone = ToneTable::default();
    let radiance = walker.seen_from(pose, Walker::camera(size), spp, 0);
    let codes =
        radiance.into_iter().flat_map(|radiance| tone.display_from_radiance(radiance, walker.exposure)).collect();
    RgbImage::from_raw(size.width, size.height, codes).unwrap_or_default()
}

/// The frames of a setting, and what the displays show of them.
fn shown(
    request: &Request<'_>,
    walker: &Walker,
    setting: &Setting,
    displays: &[Display],
    step: &mut impl FnMut(),
) -> Result<Sums, SweepError> {
    let mut sums = Sums::default();
    let ms = |from: std::time::Duration, to: std::time::Duration| (to - from).as_secs_f64() * 1e3;
    let measured = |error: MeasureError| SweepError::Scene(error.to_string());
    let display_camera = Walker::camera(request.size);
    let camera = Walker::camera(setting.size_of_frame(request.size));
    let plan = setting.plan.as_ref().unwrap_or(&walker.plan);
    let shape = walker.shape(camera, plan.clone());
    // An instant that a frame is ready at shows it, whatever its product with the rate rounds to.
    let newest = |display: &Display| (display.secs * setting.frame_hz + 1e-6) as u32;
    let last = displays.iter().map(newest).max().unwrap_or(0);
    let mut live = walker.live(camera, plan);
    live.fill_light(&walker.pose_at(START_SECS));
    let mut loopback = Loopback::default();
    let (mut warper, mut picture) = (Warper::default(), RgbImage::default());
    let mut tree = live.empty();
    let mut decoded = shape.tree(tree.render_pose);
    for frame in 0..=last {
        let secs = f64::from(frame) / setting.frame_hz;
        let start = (request.now)();
        live.render(&walker.pose_at(START_SECS + secs), &mut tree);
        sums.render_ms.push(ms(start, (request.now)()));
        let encoded = loopback.encode(&mut tree, &shape);
        decoded.render_pose = tree.render_pose;
        loopback.decode(&encoded, &shape, &mut decoded)?;
        (sums.bytes, sums.frames) = (sums.bytes + encoded.bytes(), sums.frames + 1);
        for display in displays.iter().filter(|display| newest(display) == frame) {
            for _ in 0..request.runs.max(1) {
                // As the first picture of a frame: what it costs to take it in is in all.
                warper.forget();
                let start = (request.now)();
                warper.prepare(Mode::Specular, &decoded);
                let prepared = (request.now)();
                warper.show(Mode::Specular, &decoded, &display.pose, &display_camera, shape.exposure, &mut picture);
                let end = (request.now)();
                sums.prepare_ms.push(ms(start, prepared));
                sums.show_ms.push(ms(prepared, end));
                sums.both_ms.push(ms(start, end));
            }
            let map = flip(&display.reference, &picture, PIXELS_PER_DEGREE).map_err(measured)?;
            sums.flip += map.mean(None).map_err(measured)?;
            sums.flip_specular += map.mean(display.specular.as_deref()).map_err(measured)?;
            sums.dssim += dssim(&display.reference, &picture, None).map_err(measured)?;
            sums.age_secs += display.secs + LATENCY_SECS - secs;
            step();
        }
    }
    Ok(sums)
}

fn point(scene: &str, setting: &Setting, displays: f64, sums: &Sums) -> Point {
    let per_second = if setting.is_per_second { setting.frame_hz } else { 1.0 };
    let times = if setting.is_per_second { &sums.render_ms } else { &sums.both_ms };
    let (time_ms, time_spread_ms) = median_and_spread(times);
    let bytes = sums.bytes as f64 / f64::from(sums.frames.max(1));
    let error = if setting.is_of_nodes() { sums.flip_specular } else { sums.flip } / displays;
    let more = [
        ("flip_of_all", sums.flip / displays),
        ("dssim", sums.dssim / displays),
        ("age_ms", sums.age_secs * 1e3 / displays),
        ("mbps", bytes * 8e-6 * setting.frame_hz),
        ("render_ms", median_and_spread(&sums.render_ms).0),
        ("prepare_ms", median_and_spread(&sums.prepare_ms).0),
        ("warp_ms", median_and_spread(&sums.show_ms).0),
    ];
    Point {
        value: setting.value.clone(),
        scene: scene.to_owned(),
        time_ms: time_ms * per_second,
        time_spread_ms: time_spread_ms * per_second,
        error,
        bytes: (bytes * per_second) as u64,
        pareto: false,
        more: BTreeMap::from(more.map(|(name, value)| (name.to_owned(), value))),
    }
}
