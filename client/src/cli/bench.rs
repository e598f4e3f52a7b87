//! `bench`: what each stage of the client costs, on frames made here.

use super::{Failure, bench_codec, bench_frames, bench_volumes};
use crate::lanes::Level;
use crate::warp::{Mode, Normals, Solver, Stage, Warper};
use anyhow::Context;
use clap::Args;
use image::RgbImage;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;
use warplight_protocol::codec::FrameShape;
use warplight_protocol::frame::{FrameFormat, Tree, VolumeRange};
use warplight_protocol::{Camera, ImageSize, Pose};
use warplight_server::counters::Counters;
use warplight_server::effects::plan_of;
use warplight_server::frame::{FrameRenderer, FrameRequest};
use warplight_server::scene::{DEFAULT_SCENE, Scene};
use warplight_server::stream::STRIP_ROWS;

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub(super) struct BenchArgs {
    /// Size of the frames.
    #[arg(long, default_value = "1024x1024", value_name = "WxH")]
    size: ImageSize,
    /// Scene whose frames are used: a built-in name, or a path.
    #[arg(long, default_value = DEFAULT_SCENE, value_name = "S")]
    scene: String,
    /// Counted runs of each stage.
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    runs: u32,
    /// Samples per pixel of the frame of case scene.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=4096))]
    spp: u32,
    /// How mode `specular` searches what boundaries show: frozen-distance[:STEPS], gauss-newton[:STEPS],
    /// descent[:STEPS], image-distance or unfolded.
    #[arg(long, default_value = "frozen-distance", value_name = "SOLVER")]
    solver: Solver,
    /// Only this case, or all that begin with this word.
    #[arg(long, default_value = "", value_name = "TEXT")]
    only: String,
    /// Where it has its normals from: transmitted, from-depth-gaussian or from-depth-bilateral.
    #[arg(long, default_value = Normals::Transmitted.name(), value_name = "NORMALS")]
    normals: Normals,
    /// Instruction set of warp and march: portable, avx2 or avx512, as far as this machine has it; the widest unless
    /// given.
    #[arg(long, value_name = "LEVEL")]
    level: Option<Level>,
    /// Folder for the planes of a frame of case codec, before and after each format, as raw floats.
    #[arg(long, value_name = "DIR")]
    planes: Option<PathBuf>,
    /// Print one JSON document.
    #[arg(long)]
    json: bool,
}

/// One measured stage.
#[derive(Debug, Serialize)]
pub(super) struct Row {
    pub(super) case: String,
    pub(super) stage: String,
    size: [u32; 2],
    /// Of a volume: segments per pixel, and how far around it the head has gone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) k: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) angle_deg: Option<f64>,
    runs: u32,
    min_ms: f64,
    pub(super) median_ms: f64,
    max_ms: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    bits_per_pixel: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    megapixels_per_s: Option<f64>,
}

/// A size, and how often to measure.
pub(super) struct Bench {
    pub(super) camera: Camera,
    pub(super) solver: Solver,
    pub(super) normals: Normals,
    pub(super) level: Level,
    pub(super) runs: u32,
    pub(super) rows: Vec<Row>,
    /// By case, the fractions of tiles whose root, and all of whose children, mode `specular` interpolated.
    pub(super) interpolated_tiles: BTreeMap<String, [f64; 2]>,
}

impl Bench {
    /// Times `work` after one run that is not counted.
    pub(super) fn time(&mut self, case: &str, stage: &str, mut work: impl FnMut()) {
        work();
        let millis = (0..self.runs)
            .map(|_| {
                let start = Instant::now();
                work();
                start.elapsed().as_secs_f64() * 1e3
            })
            .collect();
        self.push(case, stage, None, millis);
    }

    /// Takes in what was measured; without times it is a size alone.
    pub(super) fn push(&mut self, case: &str, stage: &str, bits_per_pixel: Option<f64>, mut millis: Vec<f64>) {
        millis.sort_by(f64::total_cmp);
        let at = |index: usize| millis.get(index).copied().unwrap_or(0.0);
        let median_ms = at(millis.len() / 2);
        let size = self.camera.size;
        self.rows.push(Row {
            case: case.to_owned(),
            stage: stage.to_owned(),
            size: [size.width, size.height],
            k: None,
            angle_deg: None,
            runs: millis.len() as u32,
            min_ms: at(0),
            median_ms,
            max_ms: at(millis.len().saturating_sub(1)),
            bits_per_pixel,
            megapixels_per_s: (median_ms > 0.0).then(|| size.pixels() as f64 * 1e-3 / median_ms),
        });
    }
}

/// Runs the command.
pub(super) fn run(arguments: &BenchArgs) -> Result<(), Failure> {
    let scene = Scene::load(&arguments.scene)?;
    let camera = Camera::symmetric(80_f32.to_radians(), arguments.size);
    let mut bench = Bench {
        camera,
        solver: arguments.solver,
        normals: arguments.normals,
        level: arguments.level.unwrap_or_default(),
        runs: arguments.runs,
        rows: Vec::new(),
        interpolated_tiles: BTreeMap::new(),
    };
    let only = arguments.only.as_str();
    let is_wanted = |case: &str| only.is_empty() || case == only || case.split(' ').next() == Some(only);
    if is_wanted(&format!("codec {}", scene.name)) {
        bench_codec::run(&mut bench, &arguments.scene, arguments.planes.as_deref())?;
    }
    let of_scene = format!("scene {}", scene.name);
    if is_wanted(&of_scene) {
        let frame = render(&scene, camera, arguments.spp);
        warp_stages(&mut bench, &of_scene, &frame, &bench_frames::moved(&frame.render_pose), scene.exposure);
    }
    for plan in bench_frames::plans() {
        let case = format!("surface {}", bench_frames::name(&plan));
        if is_wanted(&case) {
            let frame = bench_frames::frame(camera, plan);
            warp_stages(&mut bench, &case, &frame, &bench_frames::moved(&frame.render_pose), 1.0);
        }
    }
    bench_volumes::run(&mut bench, &is_wanted);
    if arguments.json {
        let threads = rayon::current_num_threads();
        let machine = serde_json::json!({ "threads": threads, "arch": std::env::consts::ARCH, "os": std::env::consts::OS, "level": bench.level.name() });
        let document = serde_json::json!({ "schema": 1, "machine": machine, "scene": scene.name, "spp": arguments.spp, "rows": bench.rows, "interpolated_tiles": bench.interpolated_tiles });
        println!("{}", serde_json::to_string(&document).context("bench document")?);
    } else {
        println!("level {}, {} threads", bench.level.name(), rayon::current_num_threads());
        println!("{:<32} {:<28} {:>9} {:>9} {:>9} {:>9}", "case", "stage", "min ms", "median", "max", "bit/px");
        for row in &bench.rows {
            let bits = row.bits_per_pixel.map_or_else(String::new, |bits| format!("{bits:.3}"));
            let mut case = row.case.clone();
            for (value, unit) in [(row.k.map(|k| k as f64), "layers"), (row.angle_deg, "deg")] {
                case.extend(value.map(|value| format!(", {value} {unit}")));
            }
            println!(
                "{:<32} {:<28} {:>9.2} {:>9.2} {:>9.2} {bits:>9}",
                case, row.stage, row.min_ms, row.median_ms, row.max_ms
            );
        }
        for (case, [root, children]) in &bench.interpolated_tiles {
            println!(
                "{case}: {:.0} % of the tiles have their root interpolated, {:.0} % all of their children",
                100.0 * root,
                100.0 * children
            );
        }
    }
    Ok(())
}

fn render(scene: &Scene, camera: Camera, spp: u32) -> Tree {
    let renderer = FrameRenderer::new(std::sync::Arc::new(scene.clone()));
    let request = FrameRequest {
        render_pose: scene.head,
        camera,
        plan: plan_of(scene),
        volume: None,
        spp,
        max_depth: 8,
        seed: 1,
    };
    let mut tree = Tree::new(scene.head, camera, request.plan.clone(), renderer.interfaces().clone());
    renderer.render(&request, &mut tree, &Counters::default(), &|_| ());
    tree
}

/// The frame as a format without shape operators brings it: the client then takes differences.
fn without_shapes(frame: &Tree) -> Tree {
    let mut tree = frame.clone();
    let shape = FrameShape {
        camera: frame.camera,
        plan: frame.plan.clone(),
        interfaces: frame.interfaces.clone(),
        format: FrameFormat { shape_bits: 0, ..FrameFormat::default() },
        volume: VolumeRange::default(),
        strip_rows: STRIP_ROWS,
        exposure: 1.0,
    };
    shape.fit(&mut tree, frame.render_pose);
    tree
}

fn warp_stages(bench: &mut Bench, case: &str, frame: &Tree, display_pose: &Pose, exposure: f32) {
    let mut warper = Warper::default();
    warper.set_level(bench.level);
    warper.set_solver(bench.solver);
    warper.set_normals(bench.normals);
    let camera = bench.camera;
    let mut picture = RgbImage::new(camera.size.width, camera.size.height);
    for mode in Mode::ALL {
        if mode == Mode::Specular && frame.nodes.iter().any(|planes| planes.shape_at(0).is_some()) {
            let frame = without_shapes(frame);
            bench.time(case, "prepare, no F.shape", || warper.prepare(mode, &frame));
        }
        let [prepare, total] = match mode {
            // What a display frame costs by default.
            Mode::Specular => ["prepare".to_owned(), "total".to_owned()],
            _ => [format!("{}: prepare", mode.name()), mode.name().to_owned()],
        };
        bench.time(case, &prepare, || warper.prepare(mode, frame));
        bench.time(case, &total, || {
            warper.show(mode, frame, display_pose, &camera, exposure, &mut picture);
        });
    }
    bench.interpolated_tiles.insert(case.to_owned(), warper.smooth_tiles());
    for stage in Stage::ALL {
        bench.time(case, stage.name(), || warper.run(stage, display_pose, &camera, exposure, &mut picture));
    }
}
