//! `render`: one picture, or all planes of one ray-tree frame, to a file.

use super::picture::{PictureKind, WholeFile};
use super::{Failure, load_scene, print};
use crate::counters::Counters;
use crate::effects::plan_of;
use crate::film::{PixelFilter, RenderSettings, render_image};
use crate::frame::{FrameRenderer, FrameRequest};
use crate::integrator::PathTracer;
use crate::scene::Scene;
use anyhow::{anyhow, bail};
use clap::{Args, ValueEnum};
use glam::{DQuat, DVec3};
use indicatif::{ProgressBar, ProgressStyle};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use warplight_protocol::frame::{Interfaces, Plan, Tree, encode_thesis};
use warplight_protocol::{Camera, ImageSize, Pose};

/// Arguments of `render`.
#[derive(Debug, Args)]
pub(super) struct RenderArgs {
    /// A built-in scene's name, or a path to scene.toml, .xml (Mitsuba), .glb, .gltf, .obj or .ply.
    scene: String,
    /// Name of one of the scene's cameras; the first by default.
    #[arg(long, conflicts_with = "pose")]
    camera: Option<String>,
    /// world_from_view: position in metres and orientation as a quaternion.
    #[arg(long, value_name = "x y z qx qy qz qw", value_parser = parse_pose, allow_hyphen_values = true)]
    pose: Option<Pose>,
    /// Size of the picture in pixels; by default what the scene's file says, else 640x480.
    #[arg(long, value_name = "WxH")]
    size: Option<ImageSize>,
    /// Samples per pixel; by default what the scene's file says, else 64.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1 << 24))]
    spp: Option<u32>,
    /// Longest path in segments: 1 shows lights only, 2 direct light; by default what the scene's file says, else 16.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    max_depth: Option<u32>,
    /// Seed of all randomness.
    #[arg(long, value_name = "K", default_value_t = 1)]
    seed: u64,
    /// Stop at the end of the pass that runs then, with the samples there are.
    #[arg(long, value_name = "T", conflicts_with = "tree")]
    time_budget_ms: Option<u64>,
    /// Go on until the picture's standard error (root mean square over its pixels) is this part of its mean; --spp,
    /// by default 2^20, is the most that is spent on it. An .exr then has the error of each pixel as a layer.
    #[arg(long, value_name = "E", value_parser = parse_error, conflicts_with = "tree")]
    standard_error: Option<f64>,
    /// With --tree: its nodes, as D,R,F,FF,FFR; by default those that the scene calls for.
    #[arg(long, value_name = "NODES", requires = "tree")]
    plan: Option<Plan>,
    /// The file: .exr for linear RGB, .png for the scene's exposure and sRGB.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Write all planes of the ray-tree frame (.exr only).
    #[arg(long)]
    tree: bool,
    /// With --tree: write the frame as the thesis sends it, uncompressed: P (40 N + D + M) + 192 bits.
    #[arg(long, value_enum, value_name = "FORMAT", requires = "tree")]
    format: Option<TreeFormat>,
    /// Print figures as one JSON document.
    #[arg(long)]
    json: bool,
}

/// Forms of a ray-tree frame other than OpenEXR.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum TreeFormat {
    /// The raw bits of Lochmann's thesis, 3.2.4.
    Thesis,
}

/// How the picture is rendered: what the arguments say, else the scene, else the defaults.
#[derive(Clone, Copy)]
struct Quality {
    size: ImageSize,
    spp: u32,
    max_depth: u32,
}

impl Quality {
    fn of(args: &RenderArgs, scene: &Scene) -> Quality {
        let defaults = &scene.defaults;
        // Where the error decides when to stop, the number of samples is only a limit.
        let is_reference = args.standard_error.is_some();
        let default_spp = if is_reference { 1 << 20 } else { defaults.spp.unwrap_or(64) };
        Quality {
            size: args.size.or(defaults.size).unwrap_or(ImageSize::new(640, 480)),
            spp: args.spp.unwrap_or(default_spp),
            max_depth: args.max_depth.or(defaults.max_depth).unwrap_or(16),
        }
    }
}

/// What a rendering took.
struct Figures {
    spp: u32,
    elapsed: Duration,
    standard_error: Option<f64>,
}

/// Renders and writes the file.
pub(super) fn run(args: &RenderArgs) -> Result<(), Failure> {
    // The thesis's bits are no picture: their file may be named as one likes.
    let kind = match args.format {
        Some(TreeFormat::Thesis) => PictureKind::Exr,
        None => PictureKind::of(&args.out).map_err(Failure::Input)?,
    };
    if args.tree && kind != PictureKind::Exr {
        return Err(Failure::input(anyhow!(
            "{}: --tree writes planes of floats: expected a path that ends in .exr",
            args.out.display()
        )));
    }
    let scene = Arc::new(load_scene(&args.scene)?);
    let quality = Quality::of(args, &scene);
    let (camera, pose) = view_of(&scene, args, quality.size).map_err(Failure::Input)?;
    let file = WholeFile::create(&args.out).map_err(Failure::Input)?;
    let counters = Counters::default();
    let figures = if args.tree {
        render_tree(scene, args, quality, (camera, pose), &counters, file)?
    } else {
        render_picture(scene, args, quality, (camera, pose), &counters, file, kind)?
    };
    let seconds = figures.elapsed.as_secs_f64();
    let samples = quality.size.pixels() as f64 * f64::from(figures.spp);
    let counted = counters.snapshot();
    if counted.dropped > 0 {
        tracing::warn!("{} samples were not finite and were dropped", counted.dropped);
    }
    if !args.json {
        tracing::info!(
            "{}: {} samples per pixel in {seconds:.2} s, {:.2} Msamples/s",
            args.out.display(),
            figures.spp,
            samples / seconds * 1e-6
        );
        return Ok(());
    }
    let document = serde_json::json!({
        "schema": 1,
        "scene": args.scene,
        "size": [quality.size.width, quality.size.height],
        "spp": figures.spp,
        "seconds": seconds,
        "samples_per_second": samples / seconds,
        "standard_error": figures.standard_error,
        "counters": counted.named().into_iter().collect::<std::collections::BTreeMap<_, _>>(),
    });
    print(&document.to_string())
}

fn render_picture(
    scene: Arc<Scene>,
    args: &RenderArgs,
    quality: Quality,
    (camera, pose): (Camera, Pose),
    counters: &Counters,
    file: WholeFile,
    kind: PictureKind,
) -> Result<Figures, Failure> {
    let exposure = scene.exposure;
    let tracer = PathTracer::new(scene);
    let settings = RenderSettings {
        spp: quality.spp,
        max_depth: quality.max_depth,
        seed: args.seed,
        filter: PixelFilter::Box,
        batch_spp: args.standard_error.map(|_| BATCH_SPP),
    };
    let budget = args.time_budget_ms.map_or(Duration::MAX, Duration::from_millis);
    let bar = progress_bar(quality.spp);
    let start = Instant::now();
    let image = render_image(&tracer, &camera, &pose, &settings, counters, &mut |progress| {
        bar.set_position(u64::from(progress.spp));
        let known = args.standard_error.and_then(|wanted| Some((wanted, progress.relative_standard_error()?)));
        if let Some((wanted, reached)) = known {
            // Falls with the root of the number of samples.
            bar.set_length((f64::from(progress.spp) * (reached / wanted).powi(2).max(1.0)) as u64);
            bar.set_message(format!("error {:.3} % of {:.3} %", reached * 100.0, wanted * 100.0));
        }
        let is_good = known.is_some_and(|(wanted, reached)| reached <= wanted);
        if start.elapsed() < budget && !is_good { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    });
    let elapsed = start.elapsed();
    bar.finish_and_clear();
    match kind {
        PictureKind::Exr => file.write_exr(&image, args.standard_error.is_some()),
        PictureKind::Png => file.write_png(&image, exposure),
    }
    .map_err(Failure::Runtime)?;
    Ok(Figures { spp: image.spp, elapsed, standard_error: Some(image.rms_standard_error()) })
}

fn render_tree(
    scene: Arc<Scene>,
    args: &RenderArgs,
    quality: Quality,
    (camera, pose): (Camera, Pose),
    counters: &Counters,
    file: WholeFile,
) -> Result<Figures, Failure> {
    let (plan, exposure) = (args.plan.clone().unwrap_or_else(|| plan_of(&scene)), scene.exposure);
    let renderer = FrameRenderer::new(scene);
    let mut tree = Tree::new(pose, camera, plan.clone(), Interfaces::default());
    let request = FrameRequest {
        render_pose: pose,
        camera,
        plan,
        volume: None,
        spp: quality.spp,
        max_depth: quality.max_depth,
        seed: args.seed,
    };
    let bar = progress_bar(quality.size.height);
    let start = Instant::now();
    renderer.render(&request, &mut tree, counters, &|band| bar.inc(u64::from(band.rows.end - band.rows.start)));
    let elapsed = start.elapsed();
    bar.finish_and_clear();
    match args.format {
        None => file.write_tree(&tree),
        Some(TreeFormat::Thesis) => {
            let finite = tree.nodes.iter().flat_map(|node| &node.distance).filter(|distance| **distance > 0.0);
            let near_m = finite.copied().fold(f32::MAX, f32::min);
            file.write_bytes(&encode_thesis(&tree, 1.0 / exposure, near_m))
        }
    }
    .map_err(Failure::Runtime)?;
    Ok(Figures { spp: quality.spp, elapsed, standard_error: None })
}

/// Shown on stderr, and only where that is a terminal.
fn progress_bar(steps: u32) -> ProgressBar {
    let style = ProgressStyle::with_template("render {bar:40} {pos}/{len} {elapsed}, {eta} left {msg}");
    ProgressBar::new(u64::from(steps)).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// The camera and where it stands.
fn view_of(scene: &Scene, args: &RenderArgs, size: ImageSize) -> anyhow::Result<(Camera, Pose)> {
    /// Where neither the arguments nor the scene say it: about what a person takes in at once.
    const DEFAULT_VERTICAL_FOV_RAD: f32 = 1.0;
    let named = match &args.camera {
        None => scene.cameras.first(),
        Some(name) => match scene.cameras.iter().find(|camera| camera.name == *name) {
            Some(camera) => Some(camera),
            None => {
                let known: Vec<&str> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
                bail!("--camera: expected one of {}, found '{name}'", known.join(", "))
            }
        },
    };
    let vertical_fov_rad = named.map_or(DEFAULT_VERTICAL_FOV_RAD, |camera| camera.vertical_fov_rad);
    let pose = args.pose.or(named.map(|camera| camera.pose)).unwrap_or(scene.head);
    Ok((Camera::symmetric(vertical_fov_rad, size), pose))
}

/// Samples that are stratified together where the error is asked for: of 16 batches on, more would gain little.
const BATCH_SPP: u32 = 16;

fn parse_error(text: &str) -> Result<f64, String> {
    let expected = || format!("expected a part of the picture's mean from 1e-6 to 1, found '{text}'");
    text.parse().ok().filter(|error| (1e-6..=1.0).contains(error)).ok_or_else(expected)
}

fn parse_pose(text: &str) -> Result<Pose, String> {
    let expected = || format!("expected 7 numbers 'x y z qx qy qz qw' with a quaternion of length 1, found '{text}'");
    let numbers: Vec<f64> =
        text.split_whitespace().map(|word| word.parse().map_err(|_| expected())).collect::<Result<_, _>>()?;
    let [x, y, z, qx, qy, qz, qw] = numbers[..] else { return Err(expected()) };
    let orientation = DQuat::from_xyzw(qx, qy, qz, qw);
    // People type three digits: near enough to 1 to be meant so.
    let near_unit = (orientation.length() - 1.0).abs() < 1e-2;
    let pose = Pose { position: DVec3::new(x, y, z), orientation: orientation.normalize() };
    if near_unit && pose.position.is_finite() && pose.is_valid() { Ok(pose) } else { Err(expected()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_seven_numbers_with_a_unit_quaternion() {
        let pose = parse_pose("1 -2 3.5 0 0.707 0 0.707").unwrap();
        assert_eq!(pose.position, DVec3::new(1.0, -2.0, 3.5));
        assert!((pose.orientation.length() - 1.0).abs() < 1e-12);
        for bad in
            ["", "1 2 3", "1 2 3 0 0 0 0", "1 2 3 0 0 0 1 9", "nan 0 0 0 0 0 1", "a 0 0 0 0 0 1", "1e9 0 0 0 0 0 1"]
        {
            assert!(parse_pose(bad).unwrap_err().starts_with("expected 7 numbers"), "{bad}");
        }
    }
}
