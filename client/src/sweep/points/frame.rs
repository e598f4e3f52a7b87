//! Points of a frame: its pixels and its nodes, from the irradiance cache as in a session.
//!
//! Time is that of a frame with the fewest samples, which is what a point must fit into; what a frame holds is as
//! bright as the cache of its own point makes it, filled by as many samples at every point.

use super::super::{Point, Progress, Request, SweepError};
use super::{BEAT, Measured, error_of, walk_of};
use crate::warp::{Mode, Warper};
use image::RgbImage;
use std::sync::Arc;
use warplight_protocol::Pose;
use warplight_protocol::frame::{Interfaces, Tree};
use warplight_server::cache::CacheSettings;
use warplight_server::counters::Counters;
use warplight_server::frame::{FrameRenderer, FrameRequest, LiveFrames};
use warplight_server::scene::Scene;
use warplight_server::service::DEFAULT_MAX_DEPTH;
use warplight_server::session::FramePoint;

/// Frames that fill in the light before the first that counts.
const FIRST_FRAMES: u32 = 12;
/// Samples per pixel of the display that fill it, of every frame.
const FILL_SPP: f64 = 0.25;
/// Samples per pixel of a frame that has no time for more.
const LEAST_SPP: f64 = 1.0 / 64.0;

/// Measures all points on a scene.
pub(in crate::sweep) fn measure(
    request: &Request<'_>,
    scene: &str,
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let (walk, references) = walk_of(request, scene)?;
    let display = walk.shape.camera;
    let loaded = Scene::load(scene).map_err(|error| SweepError::Scene(error.to_string()))?;
    let head = request.trace.placed_at(&loaded.head);
    let pose_at = |frame: u32| head.pose_at(BEAT.start_secs + f64::from(frame) / BEAT.frame_hz);
    let renderer = FrameRenderer::new(Arc::new(loaded));
    let nodes = walk.shape.plan.nodes().len();
    let points: Vec<FramePoint> = FramePoint::ALL.into_iter().filter(|point| point.without < nodes).collect();
    let mut measured = vec![Measured::default(); points.len()];
    let mut lives: Vec<LiveFrames> = points.iter().map(|_| LiveFrames::new(CacheSettings::default())).collect();
    let counters = Counters::default();
    let render = |point: &FramePoint, pose: Pose, seed: u32, spp: f64, live: &mut LiveFrames, tree: &mut Tree| {
        let frame = FrameRequest {
            render_pose: pose,
            camera: point.camera(&display),
            plan: point.plan(&walk.shape.plan),
            volume: None,
            spp: 1,
            max_depth: DEFAULT_MAX_DEPTH,
            seed: u64::from(seed) + 1,
        };
        let samples = spp * display.size.pixels() as f64;
        renderer.render_live(&frame, samples, live, tree, &counters, &|_| ());
    };
    let mut tree = Tree::new(Pose::IDENTITY, display, walk.shape.plan.clone(), Interfaces::default());
    for (point, live) in points.iter().zip(&mut lives) {
        (0..FIRST_FRAMES).for_each(|number| render(point, pose_at(0), number, FILL_SPP, live, &mut tree));
    }
    let mut warper = Warper::default();
    let mut picture = RgbImage::default();
    let all = u64::from(request.runs) + references.len() as u64;
    for (number, (reference, display_pose)) in references.iter().zip(&walk.display_poses).enumerate() {
        for ((point, live), measured) in points.iter().zip(&mut lives).zip(&mut measured) {
            let frame = number as u32;
            render(point, pose_at(frame), FIRST_FRAMES + frame, FILL_SPP, live, &mut tree);
            warper.forget();
            warper.prepare(Mode::Specular, &tree);
            warper.show(Mode::Specular, &tree, display_pose, &display, walk.shape.exposure, &mut picture);
            measured.errors.push(error_of(reference, &picture)?);
        }
        progress(number as u64 + 1, all);
    }
    for run in 0..request.runs {
        let seed = 1000 + run;
        for ((point, live), measured) in points.iter().zip(&mut lives).zip(&mut measured) {
            // A head that moves a little: a view that rests has other costs.
            let mut pose = pose_at(run % references.len() as u32);
            pose.position.x += 1e-4 * f64::from(run + 1);
            let start = (request.now)();
            let part = point.camera(&display).size.pixels() as f64 / display.size.pixels() as f64;
            render(point, pose, seed, LEAST_SPP * part, live, &mut tree);
            measured.millis.push(((request.now)() - start).as_secs_f64() * 1e3);
        }
        progress(references.len() as u64 + u64::from(run) + 1, all);
    }
    Ok(points.iter().zip(&measured).map(|(point, measured)| measured.point(scene, point.name())).collect())
}
