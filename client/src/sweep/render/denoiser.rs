//! How live frames find their light: by paths of their own, or from the irradiance cache, with and without the filter of
//! rough lobes; each with more and fewer paths.
//!
//! The head moves at a quarter of the trace's speed, as one does that looks at something; the error is that of the last
//! frame, seen from its own pose, before any codec. A frame of the cache has a past, one of paths has none. Equal time is a
//! vertical line through the plot; beside each point stands by how much path tracing in the same time would be worse, from
//! its most thorough setting, whose squared error is taken to fall as 1/n.

use super::{measured, named};
use crate::loopback::Walker;
use crate::measure::relative_mse;
use crate::sweep::surface::median_and_spread;
use crate::sweep::{Point, Progress, Request, SweepError};
use glam::Vec3;
use warplight_protocol::frame::{Tree, flatten};
use warplight_server::cache::CacheSettings;
use warplight_server::frame::LiveFrames;

/// Live frames in motion, and those of a quick sweep.
const FRAMES: [u32; 2] = [30, 12];
/// Between two frames, in seconds of the trace: ten frames per second at a quarter of its speed.
const BETWEEN_SECS: f64 = 0.025;
/// Where in the trace the motion begins.
const START_SECS: f64 = 2.0;
/// Samples per pixel of the references.
const REFERENCE_SPP: [u32; 2] = [256, 64];
/// Seeds of the references: no frame has them.
const REFERENCE_SEEDS: [u64; 2] = [1001, 1002];

/// How light is found.
#[derive(Clone, Copy, Debug)]
enum Light {
    Paths { spp: u32 },
    Cached { samples_per_px: f64, is_filtered: bool },
}

/// One setting.
#[derive(Clone, Debug)]
pub(in crate::sweep) struct Estimator {
    value: String,
    light: Light,
}

/// Every estimator with more and fewer paths.
pub(in crate::sweep) fn estimators(request: &Request<'_>) -> Vec<Estimator> {
    let (spp, per_px): (&[u32], &[f64]) = match request.quick {
        true => (&[1, 4], &[0.0625, 0.25]),
        false => (&[1, 2, 4, 8, 16], &[0.0625, 0.25, 1.0, 4.0]),
    };
    let paths = spp.iter().map(|&spp| Estimator { value: format!("path:{spp}"), light: Light::Paths { spp } });
    let cached = [true, false].into_iter().flat_map(|is_filtered| {
        let name = if is_filtered { "cache" } else { "cache-unfiltered" };
        per_px.iter().map(move |&samples_per_px| Estimator {
            value: format!("{name}:{samples_per_px}"),
            light: Light::Cached { samples_per_px, is_filtered },
        })
    });
    paths.chain(cached).collect()
}

/// Measures estimators on a scene.
pub(in crate::sweep) fn measure(
    request: &Request<'_>,
    scene: &str,
    estimators: &[Estimator],
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let quick = usize::from(request.quick);
    let walker = Walker::new(scene, request.trace).map_err(|error| SweepError::Scene(error.to_string()))?;
    let camera = Walker::camera(request.size);
    let frames = FRAMES[quick];
    let pose_at = |frame: u32| walker.pose_at(START_SECS + f64::from(frame) * BETWEEN_SECS);
    let total = 2 + estimators.len() as u64;
    let references =
        REFERENCE_SEEDS.map(|seed| walker.seen_from(&pose_at(frames - 1), camera, REFERENCE_SPP[quick], seed));
    progress(2, total);
    let [a, b] = &references;
    let mut points: Vec<Point> = Vec::new();
    // Of the most thorough path tracing: its error times its time.
    let mut error_ms_of_paths = None;
    for (index, estimator) in estimators.iter().enumerate() {
        let live = walker.live(camera, &walker.plan);
        let settings = CacheSettings::default();
        // Paths know nothing of the frame before: the last ones are enough, one for each timed run.
        let (mut live, first) = match estimator.light {
            Light::Paths { .. } => (live, frames.saturating_sub(request.runs.max(1))),
            Light::Cached { samples_per_px, is_filtered: true } => {
                (live.with(LiveFrames::new(settings), samples_per_px), 0)
            }
            Light::Cached { samples_per_px, is_filtered: false } => {
                (live.with(LiveFrames::without_denoiser(settings), samples_per_px), 0)
            }
        };
        let mut tree = live.empty();
        let mut times = Vec::new();
        for frame in first..frames {
            let pose = pose_at(frame);
            let start = (request.now)();
            match estimator.light {
                Light::Paths { spp } => live.render_by_paths(&pose, spp, &mut tree),
                Light::Cached { .. } => live.render(&pose, &mut tree),
            }
            times.push(((request.now)() - start).as_secs_f64() * 1e3);
        }
        let picture = own_picture(&tree);
        let error = relative_mse([&picture, &picture], [a, b]).map_err(measured)?.max(0.0);
        let (time_ms, time_spread_ms) = median_and_spread(&times);
        if let Light::Paths { .. } = estimator.light {
            error_ms_of_paths = Some(error * time_ms);
        }
        let of_paths = error_ms_of_paths.unwrap_or(0.0) / time_ms.max(f64::MIN_POSITIVE);
        let sum = |picture: &[Vec3]| picture.iter().map(|pixel| f64::from(pixel.element_sum())).sum::<f64>();
        let bias = 2.0 * sum(&picture) / (sum(a) + sum(b)).max(f64::MIN_POSITIVE) - 1.0;
        let more = [("times_better", of_paths / error.max(f64::MIN_POSITIVE)), ("bias", bias)];
        points.push(Point {
            value: estimator.value.clone(),
            scene: scene.to_owned(),
            time_ms,
            time_spread_ms,
            error,
            bytes: 0,
            pareto: false,
            more: named(more),
        });
        progress(3 + index as u64, total);
    }
    Ok(points)
}

/// What a frame shows to its own pose.
fn own_picture(tree: &Tree) -> Vec<Vec3> {
    let mut radiance = vec![Vec3::ZERO; tree.camera.size.pixels()];
    flatten(tree, 0..radiance.len(), &mut radiance);
    radiance
}
