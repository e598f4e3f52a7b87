//! Steps of the two marches: the server's through a medium, the client's through layers.
//!
//! `march-step`: the server takes steps of so many voxels of a medium's grid. The error is that of the picture it marches for
//! its own pose, without any layers, against the same march in steps of a 16th of a voxel: the mean difference of radiance
//! over its mean. A step is classified by the mean between its ends, so what a step misses is of second order where a grid
//! is smooth. Time is that of the picture.
//!
//! `march-stride`: the client's vector walk takes common steps of so many pixels of the frame, halved at outlines and doubled
//! within matter. The error is the DSSIM to its plain sibling, which goes through every pixel that a ray crosses, in f64, ten
//! degrees further around. Time is that of the march. A walk of few pixels has its least number of steps whatever the stride,
//! so that on small frames coarse strides are all one.

use super::study::{Background, Study};
use super::{LIGHT_SPP, Point, Progress, Request, Setting, SweepError};
use crate::march::{Marcher, Method};
use crate::sweep::surface::median_and_spread;
use glam::Vec4;
use std::collections::BTreeMap;

/// Steps in voxels, and those of a quick sweep.
const STEPS: [&[f32]; 2] = [&[8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.125], &[4.0, 2.0, 1.0, 0.5]];
/// The step that stands for none.
const FINE_STEP: f32 = 1.0 / 16.0;
/// Strides in pixels.
const STRIDES: [&[f32]; 2] = [&[16.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.25], &[2.0, 1.0, 0.5, 0.25]];

/// Measures the server's steps on a scene.
pub(in crate::sweep) fn march_steps(
    request: &Request<'_>,
    scene: &str,
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let quick = usize::from(request.quick);
    let study = Study::new(scene, 1.0, request.size, LIGHT_SPP[quick])?;
    let pose = study.pose(0.0);
    study.set_march_step(FINE_STEP);
    let fine = study.seen(&pose);
    let total = 1 + STEPS[quick].len() as u64;
    progress(1, total);
    let mut points = Vec::new();
    for (index, &voxels) in STEPS[quick].iter().enumerate() {
        study.set_march_step(voxels);
        let (mut picture, mut times) = (Vec::new(), Vec::new());
        for _ in 0..request.runs.max(1) {
            let start = (request.now)();
            picture = study.seen(&pose);
            times.push(((request.now)() - start).as_secs_f64() * 1e3);
        }
        let more = [
            ("opacity_error", relative_difference(&picture, &fine, |media| [1.0 - media.w; 3])),
            ("dssim", study.error(&pose, Background::Black, &picture, &fine)?.dssim),
        ];
        let error = relative_difference(&picture, &fine, |media| media.truncate().to_array());
        points.push(point(scene, voxels, &times, error, more));
        progress(2 + index as u64, total);
    }
    Ok(points)
}

/// Measures the client's strides on a scene.
pub(in crate::sweep) fn march_strides(
    request: &Request<'_>,
    scene: &str,
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let quick = usize::from(request.quick);
    let setting = Setting::of_default();
    let study = Study::new(scene, setting.density, request.size, LIGHT_SPP[quick])?;
    let received = study.received(study.tree(setting.format, false), setting.format, setting.color)?;
    let pose = study.pose(setting.degrees);
    let mut marcher = Marcher::default();
    marcher.prepare(&received.tree);
    let (mut exact, mut picture) = (Vec::new(), Vec::new());
    marcher.march(Method::Plain, &received.tree, &pose, &study.camera, None, &mut exact);
    let total = 1 + STRIDES[quick].len() as u64;
    progress(1, total);
    let mut points = Vec::new();
    for (index, &stride_px) in STRIDES[quick].iter().enumerate() {
        marcher.set_stride(stride_px);
        let (mut times, mut packet_steps) = (Vec::new(), 0);
        for _ in 0..request.runs.max(1) {
            let start = (request.now)();
            let statistics = marcher.march(Method::Layers, &received.tree, &pose, &study.camera, None, &mut picture);
            times.push(((request.now)() - start).as_secs_f64() * 1e3);
            packet_steps = statistics.packet_steps;
        }
        let dssim = study.error(&pose, Background::Black, &picture, &exact)?.dssim;
        let more = [
            ("opacity_error", relative_difference(&picture, &exact, |media| [1.0 - media.w; 3])),
            ("packet_steps", packet_steps as f64),
        ];
        points.push(point(scene, stride_px, &times, dssim, more));
        progress(2 + index as u64, total);
    }
    Ok(points)
}

/// Mean absolute difference over the mean, of something of the media.
fn relative_difference(picture: &[Vec4], exact: &[Vec4], of: impl Fn(Vec4) -> [f32; 3]) -> f64 {
    let (mut difference, mut sum) = (0.0, 0.0);
    for (&shown, &exact) in picture.iter().zip(exact) {
        for (shown, exact) in of(shown).into_iter().zip(of(exact)) {
            difference += f64::from((shown - exact).abs());
            sum += f64::from(exact.abs());
        }
    }
    difference / sum.max(f64::MIN_POSITIVE)
}

fn point(scene: &str, value: f32, times: &[f64], error: f64, more: [(&str, f64); 2]) -> Point {
    let (time_ms, time_spread_ms) = median_and_spread(times);
    Point {
        value: value.to_string(),
        scene: scene.to_owned(),
        time_ms,
        time_spread_ms,
        error,
        bytes: 0,
        pareto: false,
        more: BTreeMap::from(more.map(|(name, value)| (name.to_owned(), value))),
    }
}
