//! Points of volumes: structural dissimilarity against what is really seen, bytes of the layers, time of a display frame.
//!
//! A frame with layers is rendered once for a setting, sent through the wire, and brought to a pose further around the
//! media. The error is the DSSIM before black; that before white and before the environment, and the PSNR, stand beside it.
//! Time is that of a whole display frame, settings taking turns.

mod elsewhere;
mod rules;
mod settings;
mod steps;
mod study;

use super::surface::median_and_spread;
use super::{Point, Progress, Request, SweepError};
use crate::loopback::ReceivedFrame;
use crate::march::Marcher;
pub(super) use rules::measure as measure_rules;
pub(super) use settings::{Setting, angles, compressions, densities, layers, rules};
use std::collections::BTreeMap;
pub(super) use steps::{march_steps, march_strides};
pub(super) use study::Study;
use study::{Background, PictureError};
use warplight_protocol::codec::PlaneKind;

/// The built-in scenes of the thesis's kinds: a cube, a cloud, a scan, nested shells.
pub(super) const SCENES: [&str; 4] = ["cube", "cloud", "phantom", "shells"];
/// Scenes of the two marches and of the rules of layering: fine detail, and surfaces within each other.
pub(super) const DETAILED: [&str; 2] = ["cloud", "shells"];
/// Longest side of their frames, and of those of a quick sweep: their references take many small steps.
pub(super) const DETAILED_SIDE_PX: [u32; 2] = [512, 256];
/// The same for the client's march, whose strides are those of pixels.
pub(super) const STRIDE_SIDE_PX: [u32; 2] = [1024, 512];
/// Samples of the light in each voxel, and those of a quick sweep: noise of the light is in both pictures.
const LIGHT_SPP: [u32; 2] = [8, 2];

/// A setting that has been prepared.
struct Shown<'a> {
    setting: &'a Setting,
    received: ReceivedFrame,
    errors: [PictureError; 3],
    prepare_ms: Vec<f64>,
    march_ms: Vec<f64>,
}

/// The cloud, and a frame of it as it arrives where no knob is turned.
pub(super) fn cloud_study(request: &Request<'_>) -> Result<(Study, ReceivedFrame), SweepError> {
    let study = Study::new(SCENES[1], 1.0, request.size, LIGHT_SPP[usize::from(request.quick)])?;
    let Setting { format, color, exactly, .. } = Setting::of_default();
    let received = study.received(study.tree(format, exactly), format, color)?;
    Ok((study, received))
}

/// Measures settings on a scene, and, where there is a folder of planes, what other codecs made of them.
pub(super) fn measure(
    request: &Request<'_>,
    scene: &str,
    settings: &[Setting],
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let mut points = measure_here(request, scene, settings, progress)?;
    if let Some(folder) = request.planes {
        points.extend(elsewhere::measure(request, scene, folder)?);
    }
    Ok(points)
}

fn measure_here(
    request: &Request<'_>,
    scene: &str,
    settings: &[Setting],
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let quick = usize::from(request.quick);
    let all = settings.len() as u64 * (1 + u64::from(request.runs));
    let mut done = 0;
    let mut points = Vec::new();
    let mut marcher = Marcher::default();
    let mut picture = Vec::new();
    for group in settings.chunk_by(|a, b| a.density == b.density) {
        let Some(first) = group.first() else { continue };
        let study = Study::new(scene, first.density, request.size, LIGHT_SPP[quick])?;
        let mut seen: Option<(f64, Vec<glam::Vec4>)> = None;
        let mut all_shown = Vec::new();
        for setting in group {
            let display_pose = study.pose(setting.degrees);
            if seen.as_ref().is_none_or(|(degrees, _)| *degrees != setting.degrees) {
                seen = Some((setting.degrees, study.seen(&display_pose)));
            }
            let received =
                study.received(study.tree(setting.format, setting.exactly), setting.format, setting.color)?;
            marcher.set_stride(setting.stride_px);
            marcher.prepare(&received.tree);
            marcher.march(setting.method, &received.tree, &display_pose, &study.camera, None, &mut picture);
            let mut errors = [PictureError::default(); 3];
            for (error, background) in errors.iter_mut().zip(Background::ALL) {
                if let Some((_, seen)) = &seen {
                    *error = study.error(&display_pose, background, &picture, seen)?;
                }
            }
            all_shown.push(Shown { setting, received, errors, prepare_ms: Vec::new(), march_ms: Vec::new() });
            done += 1;
            progress(done, all);
        }
        for _ in 0..request.runs {
            for shown in &mut all_shown {
                let Shown { setting, received, prepare_ms, march_ms, .. } = shown;
                let display_pose = study.pose(setting.degrees);
                marcher.set_stride(setting.stride_px);
                let start = (request.now)();
                marcher.prepare(&received.tree);
                let prepared = (request.now)();
                marcher.march(setting.method, &received.tree, &display_pose, &study.camera, None, &mut picture);
                let end = (request.now)();
                prepare_ms.push((prepared - start).as_secs_f64() * 1e3);
                march_ms.push((end - prepared).as_secs_f64() * 1e3);
                done += 1;
                progress(done, all);
            }
        }
        points.extend(all_shown.iter().map(|shown| point(scene, shown)));
    }
    Ok(points)
}

fn point(scene: &str, shown: &Shown<'_>) -> Point {
    let Shown { setting, received, errors, prepare_ms, march_ms } = shown;
    let (time_ms, time_spread_ms) = median_and_spread(march_ms);
    let of_layers = |kind: &PlaneKind| kind.is_of_layer();
    let bytes: usize = received.plane_bytes.iter().filter(|(kind, _)| of_layers(kind)).map(|(_, bytes)| bytes).sum();
    let [black, white, environment] = errors;
    let more = [
        ("dssim_white", white.dssim),
        ("dssim_environment", environment.dssim),
        ("psnr_db", black.psnr_db),
        ("bits_per_pixel", bytes as f64 * 8.0 / received.tree.camera.size.pixels() as f64),
        ("prepare_ms", median_and_spread(prepare_ms).0),
    ];
    Point {
        value: setting.value.clone(),
        scene: scene.to_owned(),
        time_ms,
        time_spread_ms,
        error: black.dssim,
        bytes: bytes as u64,
        pareto: false,
        more: BTreeMap::from(more.map(|(name, value)| (name.to_owned(), value))),
    }
}
