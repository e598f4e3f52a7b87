//! What layers of volume cost: rays of view marched, and cut into four segments, for a frame of 1024x1024 pixels.
//!
//! `cargo bench -p warplight-server --bench layers [-- SCENE ...] [--frames N]`; with `WARPLIGHT_DATA` set also on the CT of
//! that folder, `torso`. Scenes: that one, built in ones by name, or files.
//!
//! A time is that of the frame's rays divided by the threads that work on them (`RAYON_NUM_THREADS`): 64 rays are marched,
//! then cut by one layering after the other while they are in the cache, as in a frame; each part is timed apart. What is
//! printed is the median of the frames. The plain program of the optimal layering takes minutes: it is given one row of
//! 64 of one frame, and its time is scaled.

use rayon::prelude::*;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};
use warplight_protocol::frame::Layering;
use warplight_protocol::{Camera, ImageSize};
use warplight_server::frame::FrameRenderer;
use warplight_server::layering::optimal::cut_plainly;
use warplight_server::layering::{Cutter, Profile, Segments};
use warplight_server::march::MediaBounds;
use warplight_server::scene::Scene;

const SIDE_PX: u32 = 1024;
const LAYERS: usize = 4;
/// Rays that are cut together, as in frames.
const BATCH: usize = 64;
/// One row of so many is cut by the plain program.
const PLAINLY: u32 = 64;
const LAYERINGS: [Layering; 3] = [Layering::Quantiles, Layering::Merged, Layering::Optimal];

/// What a frame took, summed over threads.
#[derive(Clone, Copy, Default)]
struct Times {
    march: Duration,
    cut: [Duration; LAYERINGS.len()],
    plain: Duration,
    steps: u64,
    slices: u64,
}

impl Times {
    fn plus(mut self, other: Times) -> Times {
        self.march += other.march;
        self.cut.iter_mut().zip(other.cut).for_each(|(sum, time)| *sum += time);
        self.plain += other.plain;
        self.steps += other.steps;
        self.slices += other.slices;
        self
    }
}

fn frame(renderer: &FrameRenderer, plainly: bool) -> Times {
    let named = &renderer.scene().cameras[0];
    let camera = Camera::symmetric(named.vertical_fov_rad, ImageSize::new(SIDE_PX, SIDE_PX));
    let range = MediaBounds::of(renderer.scene()).range(&named.pose);
    let view = renderer.media_in_view(&named.pose, camera);
    let row = |row: u32| {
        let mut times = Times::default();
        let mut march = Default::default();
        let mut rays = vec![Profile::default(); BATCH];
        let mut segments = vec![Segments::default(); BATCH];
        let mut cutter = Cutter::default();
        for first in (0..SIDE_PX as usize).step_by(BATCH) {
            let start = Instant::now();
            for (offset, profile) in rays.iter_mut().enumerate() {
                times.steps += view.profile(row as usize * SIDE_PX as usize + first + offset, &mut march, profile);
            }
            times.march += start.elapsed();
            times.slices += rays.iter().map(|ray| ray.len() as u64).sum::<u64>();
            for (layering, time) in LAYERINGS.into_iter().zip(&mut times.cut) {
                let start = Instant::now();
                cutter.cut(layering, LAYERS, range, &rays, &mut segments);
                *time += start.elapsed();
            }
            if plainly && row % PLAINLY == PLAINLY / 2 {
                let start = Instant::now();
                for (ray, segments) in rays.iter().zip(&mut segments) {
                    segments.clear();
                    cut_plainly(ray, LAYERS, segments);
                }
                times.plain += PLAINLY * start.elapsed();
            }
        }
        times
    };
    (0..SIDE_PX).into_par_iter().with_max_len(16).map(row).reduce(Times::default, Times::plus)
}

fn median(mut times: Vec<Duration>) -> f64 {
    times.sort();
    times[times.len() / 2].as_secs_f64() * 1e3 / rayon::current_num_threads() as f64
}

/// The torso of the data, dense in bones and thin in flesh, as a scene file.
fn torso(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut file = tempfile::Builder::new().suffix(".toml").tempfile()?;
    let volume = folder.join("volumes/ct_torso_3mm.nrrd");
    write!(
        file,
        r#"
        head = {{ position = [1.6, 1.0, -4.4], look_at = [0.0, 0.0, 0.0] }}
        camera = [{{ name = "front", position = [1.6, 1.0, -4.4], look_at = [0.0, 0.0, 0.0], vertical_fov_deg = 38.0 }}]
        environment = {{ kind = "gradient", zenith = [0.5, 0.6, 0.8], horizon = [0.7, 0.7, 0.7], nadir = [0.2, 0.2, 0.2] }}
        [[light]]
        kind = "directional"
        direction = [-0.5, -0.75, -0.6]
        irradiance = [1.6, 1.5, 1.4]
        [[volume]]
        name = "torso"
        source = {{ kind = "file", file = "{}" }}
        up = "z"
        size = [2.0, 1.84, 1.66]
        transfer = [
            [-200.0, [0.9, 0.7, 0.45], 0.0], [-120.0, [0.95, 0.8, 0.5], 0.5], [-60.0, [0.95, 0.8, 0.5], 0.5],
            [-10.0, [0.8, 0.3, 0.2], 1.2], [60.0, [0.8, 0.25, 0.2], 2.0], [130.0, [0.85, 0.5, 0.4], 3.0],
            [200.0, [0.95, 0.9, 0.8], 18.0], [500.0, [1.0, 0.97, 0.9], 60.0], [1200.0, [0.9, 0.95, 1.0], 90.0],
        ]
        "#,
        volume.display()
    )?;
    file.flush()?;
    Ok(file)
}

fn main() {
    // `cargo bench` adds an argument of its own.
    let mut scenes: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let mut frames = 5;
    if let Some(at) = scenes.iter().position(|argument| argument == "--frames") {
        frames = scenes
            .get(at + 1)
            .and_then(|count| count.parse::<usize>().ok())
            .expect("--frames: expected a number")
            .max(1);
        scenes.drain(at..at + 2);
    }
    if scenes.is_empty() {
        scenes = ["phantom", "cloud", "cube", "torso"].map(str::to_owned).into();
    }
    println!("{SIDE_PX}x{SIDE_PX}, k = {LAYERS}, {} threads, medians of {frames}, ms", rayon::current_num_threads());
    println!(
        "{:12} {:>6} {:>9} {:>9}  +{:>9} {:>9} {:>9} {:>9}",
        "scene", "march", "Msteps", "Mslices", "quantiles", "merged", "optimal", "plain"
    );
    for name in &scenes {
        let ct = match std::env::var("WARPLIGHT_DATA") {
            _ if name != "torso" => None,
            Ok(folder) => Some(torso(Path::new(&folder)).expect("a temporary file")),
            Err(_) => {
                eprintln!("no torso: WARPLIGHT_DATA is not set");
                continue;
            }
        };
        let file = ct.as_ref().map_or(name.into(), |file| file.path().to_string_lossy());
        let renderer = FrameRenderer::new(Scene::load(&file).expect("a scene").into());
        renderer.refine_all_light(1, 2, 0);
        let times: Vec<Times> = (0..frames).map(|index| frame(&renderer, index == 0)).collect();
        let of = |part: &dyn Fn(&Times) -> Duration| median(times.iter().map(part).collect());
        let [quantiles, merged, optimal] = std::array::from_fn(|index| of(&|times: &Times| times.cut[index]));
        let plain = median(vec![times[0].plain]);
        println!(
            "{name:12} {:6.0} {:9.1} {:9.1}  +{quantiles:9.0} {merged:9.0} {optimal:9.0} {plain:9.0}",
            of(&|times| times.march),
            times[0].steps as f64 * 1e-6,
            times[0].slices as f64 * 1e-6,
        );
    }
}
