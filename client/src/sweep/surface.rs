//! Points of the surface warp: error against ray-traced truth, bytes of the frame, time of preparing and showing it.
//!
//! A scene in closed form ([`crate::analytic`]) is rendered once, sent through the wire in the format of a setting,
//! and warped to its moves. The error is the median angle, over all moves, of the last node's flow; p95, the part
//! above a degree and the part at which nothing was found stand beside it. Bytes are those of all planes but the
//! normals where a setting has them from depth: nobody would send them.
//!
//! Time is that of `prepare` and of a whole picture (flow, fetch, composite, holes, tone). Settings of one format take
//! turns, so that all see the same machine.

use super::settings::Setting;
use super::{Point, Progress, Request, SweepError};
use crate::analytic::{AnalyticScene, FlowErrors, Truth, through_the_wire};
use crate::loopback::ReceivedFrame;
use crate::measure::Percentiles;
use crate::warp::{Mode, Normals, Warper};
use image::RgbImage;
use std::collections::BTreeMap;
use warplight_protocol::codec::PlaneKind;
use warplight_protocol::{Camera, Pose};

/// What is timed of a setting.
#[derive(Default)]
struct Times {
    prepare_ms: Vec<f64>,
    warp_ms: Vec<f64>,
    whole_ms: Vec<f64>,
}

/// Those swept, in the order of [`AnalyticScene::SWEPT`].
pub(super) const SCENES: [&str; 4] = [
    AnalyticScene::SWEPT[0].name(),
    AnalyticScene::SWEPT[1].name(),
    AnalyticScene::SWEPT[2].name(),
    AnalyticScene::SWEPT[3].name(),
];

/// Measures settings on a scene.
pub(super) fn measure(
    request: &Request<'_>,
    scene_name: &str,
    settings: &[Setting],
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let Some(scene) = AnalyticScene::SWEPT.into_iter().find(|scene| scene.name() == scene_name) else {
        return Ok(Vec::new());
    };
    let camera = Camera::symmetric(std::f32::consts::FRAC_PI_2, request.size);
    let eye = scene.eye();
    let tree = scene.tree(&camera, &eye);
    let mut truths: Option<(&[Pose], Vec<Truth>)> = None;
    let mut points = Vec::new();
    let mut warper = Warper::default();
    // Rounds: one for the error, the others for time.
    let all = settings.len() as u64 * (1 + u64::from(request.runs));
    let mut done = 0;
    let mut step = |done: &mut u64| {
        *done += 1;
        progress(*done, all);
    };
    for group in settings.chunk_by(|a, b| a.format == b.format) {
        let Some(first) = group.first() else { continue };
        let received = through_the_wire(tree.clone(), first.format)?;
        let mut errors = Vec::new();
        for setting in group {
            let moved = |by: &Pose| moved(&eye, by);
            if truths.as_ref().is_none_or(|(moves, _)| *moves != setting.moves) {
                let of = |by: &Pose| Truth::new(scene, &camera, &eye, &moved(by));
                truths = Some((&setting.moves, setting.moves.iter().map(of).collect()));
            }
            set(&mut warper, setting);
            warper.prepare(Mode::Specular, &received.tree);
            let truths = truths.iter().flat_map(|(_, truths)| truths);
            errors.push(FlowErrors::pooled(truths.zip(&setting.moves).map(|(truth, by)| {
                let flows = warper.flows(&moved(by), &camera);
                flows.last().map(|flow| truth.errors_of(flow)).unwrap_or_default()
            })));
            step(&mut done);
        }
        let mut times: Vec<Times> = group.iter().map(|_| Times::default()).collect();
        let mut picture = RgbImage::default();
        for run in 0..request.runs as usize {
            for (setting, times) in group.iter().zip(&mut times) {
                set(&mut warper, setting);
                let display = moved(&eye, &setting.moves[run % setting.moves.len()]);
                let start = (request.now)();
                warper.prepare(Mode::Specular, &received.tree);
                let prepared = (request.now)();
                warper.show(Mode::Specular, &received.tree, &display, &camera, 1.0, &mut picture);
                let end = (request.now)();
                times.prepare_ms.push((prepared - start).as_secs_f64() * 1e3);
                times.warp_ms.push((end - prepared).as_secs_f64() * 1e3);
                times.whole_ms.push((end - start).as_secs_f64() * 1e3);
                step(&mut done);
            }
        }
        for ((setting, errors), times) in group.iter().zip(errors).zip(times) {
            points.push(point(scene, setting, &errors, &times, &received));
        }
    }
    Ok(points)
}

fn moved(eye: &Pose, by: &Pose) -> Pose {
    Pose {
        position: eye.position + eye.orientation * by.position,
        orientation: (eye.orientation * by.orientation).normalize(),
    }
}

fn set(warper: &mut Warper, setting: &Setting) {
    warper.set_solver(setting.solver);
    warper.set_normals(setting.normals);
    warper.set_normal_bits(setting.format.normal_bits);
}

fn point(
    scene: AnalyticScene,
    setting: &Setting,
    errors: &FlowErrors,
    times: &Times,
    received: &ReceivedFrame,
) -> Point {
    let spare = match setting.normals {
        Normals::Transmitted => 0,
        _ => received.plane_bytes.get(&PlaneKind::Normal).copied().unwrap_or(0),
    };
    let (time_ms, time_spread_ms) = median_and_spread(&times.whole_ms);
    let more = [
        ("p95_deg", errors.p95_deg()),
        ("above_a_degree", errors.above_a_degree()),
        ("undefined", errors.undefined()),
        ("pixels", errors.count() as f64),
        ("prepare_ms", median_and_spread(&times.prepare_ms).0),
        ("warp_ms", median_and_spread(&times.warp_ms).0),
        ("least_ms", times.whole_ms.iter().copied().reduce(f64::min).unwrap_or(0.0)),
    ];
    Point {
        value: setting.value.clone(),
        scene: scene.name().to_owned(),
        time_ms,
        time_spread_ms,
        error: errors.median_deg(),
        bytes: (received.bytes - spare) as u64,
        pareto: false,
        more: BTreeMap::from(more.map(|(name, value)| (name.to_owned(), value))),
    }
}

/// Median and the distance of the quartiles; zero of nothing.
pub(super) fn median_and_spread(samples: &[f64]) -> (f64, f64) {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |fraction: f64| sorted.get((sorted.len() as f64 * fraction) as usize).copied().unwrap_or(0.0);
    let median = Percentiles::from_samples(samples).map_or(0.0, |spread| spread.p50);
    (median, at(0.75) - at(0.25))
}
