//! What a scene made only of diffuse things pays for the surfaces that it does not have.
//!
//! Two builds render the same frames in turn, one of which has no code for anything but diffuse surfaces; each runs as a
//! process of its own for a round, so that what else the machine does falls on both alike. Printed are the medians of their
//! times per frame, the ratio of each round's two with its median and quartiles, and the same for two rounds of the full
//! build, which is the noise. Both builds must give the same radiance, to the bit.
//!
//! ```text
//! cargo build --release -p warplight-server --example diffuse_cost --features diffuse-only --target-dir target/diffuse-only
//! cargo run --release -p warplight-server --example diffuse_cost -- target/diffuse-only/release/examples/diffuse_cost [SCENE]
//! ```

use std::error::Error;
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;
use warplight_protocol::frame::{Interfaces, Tree};
use warplight_protocol::{Camera, ImageSize};
use warplight_server::cache::CacheSettings;
use warplight_server::counters::Counters;
use warplight_server::effects::{EffectKind, Effects, plan_of};
use warplight_server::frame::{FrameRenderer, FrameRequest, LiveFrames};
use warplight_server::scene::Scene;

const SIDE_PX: u32 = 256;
/// Frames of each estimator in a round, and rounds.
const FRAMES: u64 = 5;
const ROUNDS: usize = 11;
/// What a process is started with to be one round.
const ROUND: &str = "--round";

/// Median seconds of a frame by path tracing and of a live frame, and what their radiance sums up to, bit by bit.
fn round(name: &str) -> Result<([f64; 2], u64), Box<dyn Error>> {
    let scene = Scene::load(name)?;
    if Effects::of(&scene).has(EffectKind::Reflection) {
        return Err(format!("{name}: expected a scene in which nothing reflects").into());
    }
    let (pose, vertical_fov_rad) = (scene.cameras[0].pose, scene.cameras[0].vertical_fov_rad);
    let camera = Camera::symmetric(vertical_fov_rad, ImageSize::new(SIDE_PX, SIDE_PX));
    let plan = plan_of(&scene);
    let renderer = FrameRenderer::new(Arc::new(scene));
    let mut tree = Tree::new(pose, camera, plan.clone(), Interfaces::default());
    let mut live = LiveFrames::new(CacheSettings::default());
    let (mut seconds, mut bits) = ([Vec::new(), Vec::new()], 0_u64);
    for frame in 0..=FRAMES {
        let request = FrameRequest {
            render_pose: pose,
            camera,
            plan: plan.clone(),
            volume: None,
            spp: 4,
            max_depth: 8,
            seed: frame + 1,
        };
        for (is_live, seconds) in [false, true].into_iter().zip(&mut seconds) {
            let start = Instant::now();
            if is_live {
                let samples = camera.size.pixels() as f64;
                renderer.render_live(&request, samples, &mut live, &mut tree, &Counters::default(), &|_| {});
            } else {
                renderer.render(&request, &mut tree, &Counters::default(), &|_| {});
            }
            // The first frame warms caches and starts threads.
            if frame > 0 {
                seconds.push(start.elapsed().as_secs_f64());
            }
            for value in tree.nodes[0].radiance.iter().flatten() {
                bits = bits.rotate_left(5) ^ u64::from(value.to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            }
        }
    }
    Ok((seconds.map(|mut seconds| quantile(&mut seconds, 0.5)), bits))
}

fn quantile(values: &mut [f64], part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * part).round() as usize]
}

/// A round in a process of its own.
fn run(program: &str, scene: &str) -> Result<([f64; 2], u64), Box<dyn Error>> {
    let output = Command::new(program).args([ROUND, scene]).output().map_err(|error| format!("{program}: {error}"))?;
    let text = String::from_utf8(output.stdout)?;
    let words: Vec<&str> = text.split_whitespace().collect();
    let [path, live, bits] = words[..] else {
        return Err(format!("{program}: {}", String::from_utf8_lossy(&output.stderr)).into());
    };
    Ok(([path.parse()?, live.parse()?], bits.parse()?))
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let usage = "expected the path of the build without other surfaces, and perhaps a scene";
    let (first, scene) = (arguments.get(1).ok_or(usage)?, arguments.get(2).map_or("cornell", String::as_str));
    if first == ROUND {
        let (seconds, bits) = round(scene)?;
        println!("{} {} {bits}", seconds[0], seconds[1]);
        return Ok(());
    }
    let own = std::env::current_exe()?.display().to_string();
    let mut times: [[Vec<f64>; 3]; 2] = Default::default();
    for index in 0..ROUNDS {
        // Each comes first as often as the others.
        let mut order = [0, 1, 2];
        order.rotate_left(index % 3);
        let mut expected = None;
        for build in order {
            let (seconds, bits) = run(if build == 1 { first } else { &own }, scene)?;
            if *expected.get_or_insert(bits) != bits {
                return Err(format!("{scene}: the builds show different radiance").into());
            }
            for (times, seconds) in times.iter_mut().zip(seconds) {
                times[build].push(seconds);
            }
        }
    }
    println!("{scene}, {SIDE_PX}x{SIDE_PX}, {ROUNDS} rounds of {FRAMES} frames");
    for (name, [full, diffuse, again]) in ["path traced, 4 spp", "live, 1 sample per pixel"].into_iter().zip(&mut times)
    {
        let ratios = |of: &[f64]| {
            let mut ratios: Vec<f64> = full.iter().zip(of).map(|(full, other)| full / other).collect();
            [0.25, 0.5, 0.75].map(|part| quantile(&mut ratios, part))
        };
        let ([low, ratio, high], [noise_low, noise, noise_high]) = (ratios(diffuse), ratios(again));
        let [full, diffuse] = [full, diffuse].map(|seconds| 1e3 * quantile(seconds, 0.5));
        println!(
            "{name}: {full:.2} ms a frame, {diffuse:.2} ms without the code of other surfaces: \
             {ratio:.3} ({low:.3} to {high:.3}); the same build twice {noise:.3} ({noise_low:.3} to {noise_high:.3})"
        );
    }
    Ok(())
}
