//! `inspect`: which effects a scene calls for and why, and what its frames hold.
//!
//! Rays and times are measured on a small frame from the scene's first camera and scaled to the nominal one.
//! A ray costs much the same whatever it is for, so an effect's time is its share of the rays.

use super::{Failure, load_scene, print};
use crate::counters::Counters;
use crate::effects::{Effects, plan_of};
use crate::frame::{BAND_ROWS, FrameRenderer, FrameRequest};
use clap::Args;
use serde::Serialize;
use std::fmt::Write;
use std::sync::Arc;
use std::time::Instant;
use warplight_protocol::codec::FrameShape;
use warplight_protocol::frame::{FrameFormat, Interfaces, Plan, Tree};
use warplight_protocol::{Camera, ImageSize, Pose};

/// The frame that figures are given for, at one sample per pixel and node.
const NOMINAL: ImageSize = ImageSize::new(1024, 768);
/// The frame that is rendered for them.
const PROBE: ImageSize = ImageSize::new(192, 144);
const MAX_DEPTH: u32 = 8;

/// Arguments of `inspect`.
#[derive(Debug, Args)]
pub(super) struct InspectArgs {
    /// A built-in scene's name, or a path to scene.toml, .glb or .gltf.
    scene: String,
    /// Print one JSON document.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    schema: u32,
    scene: String,
    frame: FrameReport,
    effects: Vec<EffectReport>,
    plan: PlanReport,
    warnings: Vec<String>,
}

#[derive(Serialize)]
struct FrameReport {
    size: [u32; 2],
    spp: u32,
    max_depth: u32,
    primary_rays: u64,
    rays: u64,
    ms: f64,
}

#[derive(Serialize)]
struct EffectReport {
    name: &'static str,
    why: String,
    rays_per_frame: u64,
    ms_per_frame: f64,
}

#[derive(Serialize)]
struct PlanReport {
    nodes: Vec<String>,
    planes: Vec<PlaneReport>,
    bits_per_pixel: usize,
    volume_layers: u32,
}

#[derive(Serialize)]
struct PlaneReport {
    name: String,
    bits_per_pixel: usize,
}

/// Inspects the scene and prints what was found.
pub(super) fn run(args: &InspectArgs) -> Result<(), Failure> {
    let scene = Arc::new(load_scene(&args.scene)?);
    let effects = Effects::of(&scene);
    let plan = plan_of(&scene);
    let view = scene.cameras.first();
    let vertical_fov_rad = view.map_or(1.0, |camera| camera.vertical_fov_rad);
    let pose = view.map_or(scene.head, |camera| camera.pose);
    let exposure = scene.exposure;
    let warnings = scene.warnings.clone();
    let renderer = FrameRenderer::new(scene);
    let (frame, counted) = probe(&renderer, &plan, Camera::symmetric(vertical_fov_rad, PROBE), pose);
    let effects = effects
        .iter()
        .map(|effect| {
            let counter = effect.kind.counter();
            let rays_per_frame = counter
                .and_then(|name| counted.iter().find(|(counted, _)| *counted == name))
                .map_or(0, |&(_, rays)| rays);
            let ms_per_frame = frame.ms * rays_per_frame as f64 / frame.rays.max(1) as f64;
            EffectReport { name: effect.kind.name(), why: effect.why.clone(), rays_per_frame, ms_per_frame }
        })
        .collect();
    let camera = Camera::symmetric(vertical_fov_rad, NOMINAL);
    let plan = plan_report(plan, renderer.interfaces().clone(), camera, exposure);
    let report = Report { schema: 1, scene: args.scene.clone(), frame, effects, plan, warnings };
    print(&if args.json { serde_json::to_string(&report).map_err(Failure::runtime)? } else { in_words(&report) })
}

/// Renders the probe frame and scales what it took to the nominal one.
fn probe(renderer: &FrameRenderer, plan: &Plan, camera: Camera, pose: Pose) -> (FrameReport, [(&'static str, u64); 6]) {
    let request = FrameRequest { render_pose: pose, camera, plan: plan.clone(), spp: 1, max_depth: MAX_DEPTH, seed: 1 };
    let mut tree = Tree::new(pose, camera, plan.clone(), Interfaces::default());
    // The first frame warms caches and starts threads.
    renderer.render(&request, &mut tree, &Counters::default(), &|_| {});
    let counters = Counters::default();
    let start = Instant::now();
    renderer.render(&request, &mut tree, &counters, &|_| {});
    let seconds = start.elapsed().as_secs_f64();
    let scale = NOMINAL.pixels() as f64 / PROBE.pixels() as f64;
    let scaled = |rays: u64| (rays as f64 * scale).round() as u64;
    let counted = counters.snapshot();
    let frame = FrameReport {
        size: [NOMINAL.width, NOMINAL.height],
        spp: 1,
        max_depth: MAX_DEPTH,
        primary_rays: scaled(counted.primary),
        rays: scaled(counted.rays()),
        ms: seconds * scale * 1e3,
    };
    (frame, counted.named().map(|(name, rays)| (name, scaled(rays))))
}

fn plan_report(plan: Plan, interfaces: Interfaces, camera: Camera, exposure: f32) -> PlanReport {
    let shape =
        FrameShape { camera, plan, interfaces, format: FrameFormat::default(), strip_rows: BAND_ROWS as u16, exposure };
    let plan = &shape.plan;
    let planes: Vec<PlaneReport> = shape
        .planes()
        .into_iter()
        .map(|(node, kind, bits)| PlaneReport {
            name: format!("{}.{}", plan.name(usize::from(node)), kind.name()),
            bits_per_pixel: bits,
        })
        .collect();
    PlanReport {
        nodes: (0..plan.nodes().len()).map(|node| plan.letters(node)).collect(),
        bits_per_pixel: planes.iter().map(|plane| plane.bits_per_pixel).sum(),
        planes,
        volume_layers: 0,
    }
}

fn in_words(report: &Report) -> String {
    let mut text = String::new();
    let FrameReport { size: [width, height], ms, rays, .. } = report.frame;
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "{}: {rays} rays and {ms:.0} ms per frame of {width}x{height} at 1 sample per pixel",
        report.scene
    );
    let _ = writeln!(text, "effects");
    for effect in &report.effects {
        let _ = writeln!(
            text,
            "  {:24} {:>10} rays {:>8.1} ms  {}",
            effect.name, effect.rays_per_frame, effect.ms_per_frame, effect.why
        );
    }
    let _ = writeln!(text, "frame plan {{{}}}", report.plan.nodes.join(", "));
    for plane in &report.plan.planes {
        let _ = writeln!(text, "  {:24} {:>3} bits per pixel", plane.name, plane.bits_per_pixel);
    }
    let _ = write!(text, "  {:24} {:>3} bits per pixel before compression", "all", report.plan.bits_per_pixel);
    text
}
