//! Path-traced pictures by their samples, and by how long their paths may be.
//!
//! `spp`: the error is noise. Its square falls as 1/n where samples are independent, faster where they are stratified (Owen
//! 1997). Each timed run has a seed of its own, and the error is the mean of all.
//!
//! `path-depth`: the error is what longer paths would have brought. A path that may be longer begins as the shorter one with
//! the same random numbers does, and adds no negative light: so the difference to deep paths of the same seed holds no
//! noise but that of the missing light itself, and it falls in every pixel with every segment. Its square is the product of
//! two such differences, of independent seeds.

use super::{measured, named};
use crate::loopback::Walker;
use crate::measure::relative_mse;
use crate::sweep::surface::median_and_spread;
use crate::sweep::{Point, Progress, Request, SweepError};
use glam::Vec3;
use warplight_protocol::frame::{Plan, Tree};
use warplight_protocol::{Camera, Pose};
use warplight_server::counters::Counters;
use warplight_server::frame::FrameRequest;
use warplight_server::service::DEFAULT_MAX_DEPTH;

/// Where in the trace pictures are made.
const START_SECS: f64 = 0.5;
/// Seeds of two references. Those of pictures begin above.
const REFERENCE_SEEDS: [u64; 2] = [1, 2];
const FIRST_SEED: u64 = 100;

/// Samples per pixel, and those of the references, four times as many as the most: the error's own uncertainty comes from
/// the picture then.
const SPP: [(&[u32], u32); 2] = [(&[1, 2, 4, 8, 16, 32, 64], 256), (&[1, 2, 4, 8, 16], 64)];
/// Segments of a path; those that stand for all, of which a room of albedo 0.75 leaves a thousandth; samples per pixel.
const DEPTHS: [(&[u32], u32, u32); 2] = [(&[1, 2, 3, 4, 5, 6, 8, 10, 12, 16], 40, 64), (&[2, 3, 4, 6, 8, 12], 24, 8)];

/// A scene before a camera, to be path-traced.
struct Studio {
    walker: Walker,
    camera: Camera,
    pose: Pose,
}

impl Studio {
    fn new(request: &Request<'_>, scene: &str) -> Result<Studio, SweepError> {
        let walker = Walker::new(scene, request.trace).map_err(|error| SweepError::Scene(error.to_string()))?;
        let pose = walker.pose_at(START_SECS);
        Ok(Studio { walker, camera: Walker::camera(request.size), pose })
    }

    /// A picture, and what it took: milliseconds, and rays per pixel.
    fn picture(&self, request: &Request<'_>, spp: u32, max_depth: u32, seed: u64) -> (Vec<Vec3>, f64, f64) {
        let plan = Plan::diffuse();
        let mut tree = Tree::new(self.pose, self.camera, plan.clone(), Default::default());
        let frame =
            FrameRequest { render_pose: self.pose, camera: self.camera, plan, volume: None, spp, max_depth, seed };
        let counters = Counters::default();
        let start = (request.now)();
        self.walker.renderer.render(&frame, &mut tree, &counters, &|_| ());
        let ms = ((request.now)() - start).as_secs_f64() * 1e3;
        let pixels = self.camera.size.pixels();
        let radiance = (0..pixels).map(|pixel| tree.nodes[0].radiance_at(pixel)).collect();
        (radiance, ms, counters.snapshot().rays() as f64 / pixels as f64)
    }
}

/// Points by samples per pixel.
pub(in crate::sweep) fn spp(
    request: &Request<'_>,
    scene: &str,
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let (all, reference_spp) = SPP[usize::from(request.quick)];
    let studio = Studio::new(request, scene)?;
    let work = |spp: u32| u64::from(spp * request.runs);
    let total = 2 * u64::from(reference_spp) + all.iter().map(|&spp| work(spp)).sum::<u64>();
    let mut done = 0;
    let references = REFERENCE_SEEDS.map(|seed| {
        let (picture, ..) = studio.picture(request, reference_spp, DEFAULT_MAX_DEPTH, seed);
        done += u64::from(reference_spp);
        progress(done, total);
        picture
    });
    let [a, b] = &references;
    let mut points = Vec::new();
    for &spp in all {
        let (mut times, mut errors, mut rays) = (Vec::new(), Vec::new(), 0.0);
        for run in 0..request.runs {
            let seed = FIRST_SEED + u64::from(run);
            let (picture, ms, rays_per_px) = studio.picture(request, spp, DEFAULT_MAX_DEPTH, seed);
            errors.push(relative_mse([&picture, &picture], [a, b]).map_err(measured)?);
            times.push(ms);
            rays = rays_per_px;
        }
        done += work(spp);
        progress(done, total);
        let error = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        let more = [("rays_per_px", rays), ("error_spread", median_and_spread(&errors).1)];
        points.push(point(scene, spp, &times, error, named(more)));
    }
    Ok(points)
}

/// Points by the longest path.
pub(in crate::sweep) fn path_depth(
    request: &Request<'_>,
    scene: &str,
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let (depths, deep, spp) = DEPTHS[usize::from(request.quick)];
    let studio = Studio::new(request, scene)?;
    // A run for each seed at least: errors are the same however many there are.
    let runs = request.runs.max(2);
    let total = 2 + depths.len() as u64 * u64::from(runs);
    let mut done = 0;
    let mut step = || {
        done += 1;
        progress(done, total);
    };
    let references = REFERENCE_SEEDS.map(|seed| {
        let (picture, ..) = studio.picture(request, spp, deep, seed);
        step();
        picture
    });
    let [a, b] = &references;
    let mean_of = |pictures: [&[Vec3]; 2]| {
        pictures.iter().flat_map(|picture| picture.iter()).map(|pixel| f64::from(pixel.element_sum())).sum::<f64>()
    };
    let all_light = mean_of([a, b]).max(f64::MIN_POSITIVE);
    let mut points = Vec::new();
    for &depth in depths {
        let (mut pictures, mut times, mut rays) = ([const { Vec::new() }; 2], Vec::new(), 0.0);
        for run in 0..runs as usize {
            let (picture, ms, rays_per_px) = studio.picture(request, spp, depth, REFERENCE_SEEDS[run % 2]);
            pictures[run % 2] = picture;
            times.push(ms);
            rays = rays_per_px;
            step();
        }
        let [x, y] = &pictures;
        let error = relative_mse([x, y], [a, b]).map_err(measured)?;
        let missing = 1.0 - mean_of([x, y]) / all_light;
        let more = [("rays_per_px", rays), ("missing_light", missing)];
        points.push(point(scene, depth, &times, error, named(more)));
    }
    Ok(points)
}

fn point(scene: &str, value: u32, times: &[f64], error: f64, more: std::collections::BTreeMap<String, f64>) -> Point {
    let (time_ms, time_spread_ms) = median_and_spread(times);
    Point {
        value: value.to_string(),
        scene: scene.to_owned(),
        time_ms,
        time_spread_ms,
        // Where nothing is left of an error, the noise of its estimate may be below zero.
        error: error.max(0.0),
        bytes: 0,
        pareto: false,
        more,
    }
}
