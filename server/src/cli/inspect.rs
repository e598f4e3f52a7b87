//! `inspect`: which effects a scene calls for and why, which it does not and why not, and what its frames hold.
//!
//! Rays, bytes and times are measured on a small frame from the scene's first camera and scaled by pixels to the nominal
//! one. What an effect costs is what a frame without it does not: the scene is rendered and encoded as it is and with
//! each effect switched off in turn, with the same nodes. An effect that ends paths early (a sky) saves time; effects share
//! rays, so their costs do not add up to the frame's. An effect that is off costs nothing: switched off again it changes
//! no byte, which a test of all scenes holds, so it is not measured here.

use super::{Failure, load_scene, print};
use crate::counters::{Counters, RayCounts};
use crate::effects::{Effects, plan_of, without};
use crate::frame::{BAND_ROWS, FrameRenderer, FrameRequest, LayersRequest};
use crate::march::MediaBounds;
use clap::Args;
use serde::Serialize;
use std::fmt::Write;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;
use warplight_protocol::codec::{FrameShape, StripEncoder};
use warplight_protocol::frame::{FrameFormat, Interfaces, Plan, Tree, VolumeFormat, VolumeRange};
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
    /// Those that are on.
    effects: Vec<EffectReport>,
    /// All others.
    off: Vec<OffReport>,
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
    bytes: u64,
    ms: f64,
}

#[derive(Serialize)]
struct OffReport {
    name: &'static str,
    why: &'static str,
}

#[derive(Serialize)]
struct EffectReport {
    name: &'static str,
    why: String,
    /// Rays of a frame less those of one without the effect; negative where it ends paths.
    rays_per_frame: i64,
    /// Bytes of a frame in the default format less those of one without it; negative where it makes a frame smoother.
    bytes_per_frame: i64,
    /// Time of a frame less that of one without it.
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
    let renderer = FrameRenderer::new(scene.clone());
    let probe_camera = Camera::symmetric(vertical_fov_rad, PROBE);
    let limited: Vec<FrameRenderer> = effects
        .iter()
        .map(|effect| {
            let (scene, simulated) = without(&scene, effect.kind);
            FrameRenderer::limited(Arc::new(scene), simulated)
        })
        .collect();
    // Turn by turn, so that what else the machine does falls on all alike.
    let mut probes: Vec<Probe> = std::iter::once(&renderer)
        .chain(&limited)
        .map(|renderer| Probe::new(renderer, &plan, probe_camera, pose))
        .collect();
    for _ in 0..PROBES {
        probes.iter_mut().for_each(Probe::render);
    }
    let figures: Vec<Figures> = probes.iter_mut().map(Probe::figures).collect();
    let whole = figures[0];
    let off = effects.off().map(|(kind, why)| OffReport { name: kind.name(), why }).collect();
    let effects = effects
        .iter()
        .zip(&figures[1..])
        .map(|(effect, rest)| EffectReport {
            name: effect.kind.name(),
            why: effect.why.clone(),
            rays_per_frame: whole.rays as i64 - rest.rays as i64,
            bytes_per_frame: whole.bytes as i64 - rest.bytes as i64,
            ms_per_frame: whole.ms - rest.ms,
        })
        .collect();
    let frame = FrameReport {
        size: [NOMINAL.width, NOMINAL.height],
        spp: 1,
        max_depth: MAX_DEPTH,
        primary_rays: whole.primary_rays,
        rays: whole.rays,
        bytes: whole.bytes,
        ms: whole.ms,
    };
    let camera = Camera::symmetric(vertical_fov_rad, NOMINAL);
    let has_media = !MediaBounds::of(&scene).is_empty();
    let plan = plan_report(plan, renderer.interfaces().clone(), camera, exposure, has_media);
    let report = Report { schema: 1, scene: args.scene.clone(), frame, effects, off, plan, warnings };
    print(&if args.json { serde_json::to_string(&report).map_err(Failure::runtime)? } else { in_words(&report) })
}

/// Frames that each figure is the median of.
const PROBES: usize = 7;

/// Samples of the light of every voxel, before what is timed.
const LIGHT_SPP: u32 = 1;

/// A small frame, rendered again and again.
struct Probe<'a> {
    renderer: &'a FrameRenderer,
    request: FrameRequest,
    tree: Tree,
    seconds: Vec<f64>,
    counted: RayCounts,
}

/// Of a frame of the nominal size.
#[derive(Clone, Copy)]
struct Figures {
    primary_rays: u64,
    rays: u64,
    bytes: u64,
    ms: f64,
}

impl Probe<'_> {
    fn new<'a>(renderer: &'a FrameRenderer, plan: &Plan, camera: Camera, pose: Pose) -> Probe<'a> {
        let bounds = MediaBounds::of(renderer.scene());
        let request = FrameRequest {
            render_pose: pose,
            camera,
            plan: plan.clone(),
            volume: (!bounds.is_empty()).then(|| LayersRequest {
                format: VolumeFormat::default(),
                range: bounds.range(&pose),
                exactly: false,
            }),
            spp: 1,
            max_depth: MAX_DEPTH,
            seed: 1,
        };
        let tree = Tree::new(pose, camera, plan.clone(), Interfaces::default());
        if request.volume.is_some() {
            // A session has some light in its media before long; without, layers would be black and cost no bytes.
            renderer.refine_all_light(LIGHT_SPP, MAX_DEPTH, 1);
        }
        let mut probe = Probe { renderer, request, tree, seconds: Vec::new(), counted: RayCounts::default() };
        // The first frame warms caches and starts threads.
        probe.render();
        probe.seconds.clear();
        probe
    }

    fn render(&mut self) {
        let counters = Counters::default();
        let start = Instant::now();
        self.renderer.render(&self.request, &mut self.tree, &counters, &|_| {});
        self.seconds.push(start.elapsed().as_secs_f64());
        self.counted = counters.snapshot();
    }

    /// Bytes of the frame's strips, rendered once more.
    fn bytes(&mut self) -> usize {
        let scene = self.renderer.scene();
        let shape = FrameShape {
            camera: self.request.camera,
            plan: self.request.plan.clone(),
            interfaces: self.renderer.interfaces().clone(),
            format: FrameFormat {
                volume: self.request.volume.map_or(VolumeFormat::NONE, |volume| volume.format),
                ..FrameFormat::default()
            },
            volume: self.request.volume.map_or_else(VolumeRange::default, |volume| volume.range),
            strip_rows: BAND_ROWS as u16,
            exposure: scene.exposure,
        };
        let bytes = AtomicUsize::new(0);
        let encoder = Mutex::new(StripEncoder::new(StripEncoder::DEFAULT_LEVEL));
        self.renderer.render(&self.request, &mut self.tree, &Counters::default(), &|band| {
            let mut strip = Vec::new();
            encoder.lock().unwrap_or_else(PoisonError::into_inner).encode(&shape, band, &mut strip);
            bytes.fetch_add(strip.len(), Ordering::Relaxed);
        });
        bytes.into_inner()
    }

    fn figures(&mut self) -> Figures {
        let mut seconds = self.seconds.clone();
        seconds.sort_by(f64::total_cmp);
        let scale = NOMINAL.pixels() as f64 / PROBE.pixels() as f64;
        let scaled = |rays: u64| (rays as f64 * scale).round() as u64;
        Figures {
            primary_rays: scaled(self.counted.primary),
            rays: scaled(self.counted.rays()),
            bytes: scaled(self.bytes() as u64),
            ms: seconds[seconds.len() / 2] * scale * 1e3,
        }
    }
}

fn plan_report(plan: Plan, interfaces: Interfaces, camera: Camera, exposure: f32, has_media: bool) -> PlanReport {
    let layers = if has_media { VolumeFormat::default() } else { VolumeFormat::NONE };
    let (format, volume) = (FrameFormat { volume: layers, ..FrameFormat::default() }, VolumeRange::default());
    let shape = FrameShape { camera, plan, interfaces, format, volume, strip_rows: BAND_ROWS as u16, exposure };
    let plan = &shape.plan;
    let planes: Vec<PlaneReport> = shape
        .planes()
        .into_iter()
        .map(|(node, kind, bits)| PlaneReport { name: kind.name_in(plan, node), bits_per_pixel: bits })
        .collect();
    PlanReport {
        nodes: (0..plan.nodes().len()).map(|node| plan.letters(node)).collect(),
        bits_per_pixel: planes.iter().map(|plane| plane.bits_per_pixel).sum(),
        planes,
        volume_layers: u32::from(layers.layers),
    }
}

fn in_words(report: &Report) -> String {
    let mut text = String::new();
    let FrameReport { size: [width, height], ms, rays, bytes, .. } = report.frame;
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "{}: {rays} rays, {bytes} bytes and {ms:.0} ms per frame of {width}x{height} at 1 sample per pixel",
        report.scene
    );
    let _ = writeln!(text, "effects");
    for effect in &report.effects {
        let _ = writeln!(
            text,
            "  on   {:24} {:>10} rays {:>9} bytes {:>8.1} ms  {}",
            effect.name, effect.rays_per_frame, effect.bytes_per_frame, effect.ms_per_frame, effect.why
        );
    }
    for effect in &report.off {
        let _ = writeln!(text, "  off  {:24} {:>41}  {}", effect.name, "-", effect.why);
    }
    let _ = writeln!(text, "frame plan {{{}}}", report.plan.nodes.join(", "));
    for plane in &report.plan.planes {
        let _ = writeln!(text, "  {:24} {:>3} bits per pixel", plane.name, plane.bits_per_pixel);
    }
    let _ = write!(text, "  {:24} {:>3} bits per pixel before compression", "all", report.plan.bits_per_pixel);
    text
}
