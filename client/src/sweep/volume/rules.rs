//! Rules of layering at the same number of segments: what the server pays for a frame that is seen right from elsewhere.
//!
//! The error is the DSSIM before black, ten degrees further around, as with the knob `layers`; all frames are marched alike,
//! slabs too. Time is that of cutting the rays of a frame on all cores, without marching them: of so many batches of 64
//! neighbouring rays, spread over the frame, scaled to its pixels. The settings take turns.

use super::study::{Background, Study};
use super::{LIGHT_SPP, Point, Progress, Request, Setting, SweepError};
use crate::march::{Marcher, Method};
use crate::sweep::surface::median_and_spread;
use std::collections::BTreeMap;
use warplight_protocol::codec::PlaneKind;

/// Rays that are cut together, as in frames.
const BATCH: usize = 64;
/// Batches that are timed: 8192 rays take some ten megabytes.
const BATCHES: usize = 128;

/// Measures rules on a scene.
pub(in crate::sweep) fn measure(
    request: &Request<'_>,
    scene: &str,
    settings: &[Setting],
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let study = Study::new(scene, 1.0, request.size, LIGHT_SPP[usize::from(request.quick)])?;
    let total = settings.len() as u64 * (1 + u64::from(request.runs));
    let mut done = 0;
    let mut step = || {
        done += 1;
        progress(done, total);
    };
    let mut points = Vec::new();
    let mut marcher = Marcher::default();
    let mut picture = Vec::new();
    for setting in settings {
        let pose = study.pose(setting.degrees);
        let seen = study.seen(&pose);
        let received = study.received(study.tree(setting.format, setting.exactly), setting.format, setting.color)?;
        marcher.prepare(&received.tree);
        marcher.march(Method::Layers, &received.tree, &pose, &study.camera, None, &mut picture);
        let error = study.error(&pose, Background::Black, &picture, &seen)?;
        let of_layers = received.plane_bytes.iter().filter(|(kind, _)| PlaneKind::is_of_layer(**kind));
        let bytes: usize = of_layers.map(|(_, bytes)| bytes).sum();
        let more =
            [("psnr_db", error.psnr_db), ("bits_per_pixel", bytes as f64 * 8.0 / study.camera.size.pixels() as f64)];
        points.push(Point {
            value: setting.value.clone(),
            scene: scene.to_owned(),
            time_ms: 0.0,
            time_spread_ms: 0.0,
            error: error.dssim,
            bytes: bytes as u64,
            pareto: false,
            more: BTreeMap::from(more.map(|(name, value)| (name.to_owned(), value))),
        });
        step();
    }
    let batches = study.rays(BATCH, BATCHES);
    let rays: usize = batches.iter().map(Vec::len).sum();
    let scale = study.camera.size.pixels() as f64 / rays.max(1) as f64;
    let mut times = vec![Vec::new(); settings.len()];
    for _ in 0..request.runs {
        for (setting, times) in settings.iter().zip(&mut times) {
            let start = (request.now)();
            study.cut(setting, &batches);
            times.push(((request.now)() - start).as_secs_f64() * 1e3 * scale);
            step();
        }
    }
    for (point, times) in points.iter_mut().zip(&times) {
        (point.time_ms, point.time_spread_ms) = median_and_spread(times);
        point.more.insert("micros_per_ray".to_owned(), point.time_ms * 1e3 / study.camera.size.pixels() as f64);
    }
    Ok(points)
}
