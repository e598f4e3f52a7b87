//! What the frame before saves when both ends warp it to the pose of the new one, against coding each frame alone and
//! against H.264's own motion compensation; tables in docs/measurements/2026-11-22-across-frames.md.
//!
//! `cargo run --release -p warplight-client --example across_frames -- SCENE TRACE.tum [frames] [hz] [start] [side]`
//!
//! Live frames of a built-in scene along a recorded trace, with a promise about depths (0.25 px for heads that move
//! 200 mm) and with normals of 12 bits. Colour is compared at an equal PSNR over defined pixels.

mod before;
mod colour;
mod geometry;
mod picture;
mod pyramid;
mod warp;

use anyhow::Context;
use colour::{Sequence, Way};
use glam::Vec2;
use picture::Picture;
use pyramid::Use;
use std::sync::Arc;
use warplight_client::trace::Trace;
use warplight_protocol::frame::{Interfaces, Tree};
use warplight_protocol::{Camera, ImageSize};
use warplight_server::cache::CacheSettings;
use warplight_server::counters::Counters;
use warplight_server::effects::plan_of;
use warplight_server::frame::{FrameRenderer, FrameRequest, LiveFrames};
use warplight_server::scene::Scene;

/// Quality at which ways are compared, in dB over defined pixels.
const TARGET_DB: f64 = 42.0;
/// Quantisers that hold it between them for every plane met so far.
const QUANTISERS: [u8; 8] = [10, 14, 18, 22, 26, 30, 34, 38];
/// Frames rendered before the first, until the light that is kept has settled.
const WARM_UP: u64 = 20;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let name = |index: usize, what: &str| arguments.get(index).with_context(|| format!("expected {what}"));
    let number = |index: usize, default: f64| arguments.get(index).map_or(Ok(default), |text| text.parse::<f64>());
    let scene = Scene::load(name(0, "a scene")?)?;
    let trace = Trace::read(name(1, "a trace")?.as_ref())?.placed_at(&scene.head);
    let (frames, hz, start, side) =
        (number(2, 6.0)? as u64, number(3, 10.0)?, number(4, 6.0)?, number(5, 1024.0)? as u32);
    let trees = render(scene, &trace, (frames.max(2), hz, start), side);
    let pairs = trees.windows(2).map(|pair| (&pair[0].render_pose, &pair[1].render_pose));
    let degrees: Vec<f64> = pairs.clone().map(|(old, new)| old.angle_to(new).to_degrees()).collect();
    let millimetres: Vec<f64> = pairs.map(|(old, new)| 1e3 * old.position.distance(new.position)).collect();
    println!("{degrees:.1?} degrees and {millimetres:.0?} mm from frame to frame; bits per pixel of the frame:");

    let pixels = trees[0].camera.size.pixels() as f64;
    let white = white_of(&trees[0]);
    let mut whole = Whole::default();
    for node in 0..trees[0].nodes.len() {
        let defined = trees.iter().map(|tree| tree.nodes[node].distance.iter().filter(|&&metres| metres > 0.0).count());
        let share = defined.sum::<usize>() as f64 / pixels / trees.len() as f64;
        println!("{}: {:.1} % of all pixels", trees[0].plan.name(node), 100.0 * share);
        if share > 0.0 {
            geometry_of(&trees, node, &mut whole);
            colour_of(&trees, node, white, &mut whole)?;
        }
    }
    whole.print();
    Ok(())
}

fn render(scene: Scene, trace: &Trace, (frames, hz, start): (u64, f64, f64), side: u32) -> Vec<Tree> {
    let plan = plan_of(&scene);
    let renderer = FrameRenderer::new(Arc::new(scene));
    let camera = Camera::symmetric(80_f32.to_radians(), ImageSize::new(side, side));
    let mut live = LiveFrames::new(CacheSettings::default());
    let mut tree = Tree::new(trace.pose_at(start), camera, plan.clone(), Interfaces::default());
    let mut trees = Vec::new();
    for turn in 0..WARM_UP + frames {
        let frame = turn.saturating_sub(WARM_UP);
        let render_pose = trace.pose_at(start + frame as f64 / hz);
        let plan = plan.clone();
        let request = FrameRequest { render_pose, camera, plan, volume: None, spp: 1, max_depth: 8, seed: turn + 1 };
        let budget = 0.25 * camera.size.pixels() as f64;
        renderer.render_live(&request, budget, &mut live, &mut tree, &Counters::default(), &|_| {});
        if turn >= WARM_UP {
            trees.push(tree.clone());
        }
    }
    trees
}

/// The radiance that all but a thousandth of the root stays below: codes have one white for all frames.
fn white_of(tree: &Tree) -> f32 {
    let mut brightest: Vec<f32> =
        (0..tree.camera.size.pixels()).map(|at| tree.nodes[0].radiance_at(at).max_element()).collect();
    brightest.sort_by(f32::total_cmp);
    brightest[brightest.len() - 1 - brightest.len() / 1000].max(1e-3)
}

/// Bits per pixel of whole frames, part by part.
#[derive(Default)]
struct Whole {
    /// Of zstd and of entropy: depths, normals, coarse normals; alone and with the frame before.
    geometry: [[[f64; 2]; 3]; 2],
    indices: [f64; 2],
    /// H.264 with motion everywhere; the best way of each node without and with warped pictures.
    colour: [f64; 3],
}

fn geometry_of(trees: &[Tree], node: usize, whole: &mut Whole) {
    let pixels = trees[0].camera.size.pixels() as f64;
    let geometry = geometry::measure(trees, node);
    println!("  {:24} {:>16} {:>16} {:>16}", "zstd / entropy", "alone", "guess always", "guess at edges");
    let rows = [&geometry.depth, &geometry.normals, &geometry.coarse_normals];
    for (index, (name, row)) in ["depth", "normals, exact", "normals, within 1.5 codes"].iter().zip(rows).enumerate() {
        let cells: Vec<String> =
            row.iter().map(|bits| format!("{:7.4} / {:6.4}", bits.zstd / pixels, bits.entropy / pixels)).collect();
        println!("  {name:25} {}", cells.join(" "));
        for (measure, sums) in whole.geometry.iter_mut().enumerate() {
            let bits = |how: usize| if measure == 0 { row[how].zstd } else { row[how].entropy } / pixels;
            sums[index][0] += bits(0);
            sums[index][1] += (0..Use::ALL.len()).map(bits).fold(f64::INFINITY, f64::min);
        }
    }
    let indices = geometry.indices.map(|bits| bits / pixels);
    println!("  indices {:.4}, differing from the warped {:.4}", indices[0], indices[1]);
    println!(
        "  depths carried in {:.0} ms, normals guessed in {:.1} ms of one thread",
        geometry.carry_ms, geometry.guess_ms
    );
    whole.indices[0] += indices[0];
    whole.indices[1] += indices[0].min(indices[1]);
}

fn colour_of(trees: &[Tree], node: usize, white: f32, whole: &mut Whole) -> anyhow::Result<()> {
    let size = trees[0].camera.size;
    let step = geometry::step_per_m(&trees[0], node);
    let inverse: Vec<Vec<f32>> = trees.iter().map(|tree| warp::inverse_depths(tree, node, step)).collect();
    let pictures: Vec<Picture> =
        trees.iter().map(|tree| Picture::of(&tree.nodes[node], size.width as usize, white)).collect();
    let (mut places, mut shifts) = (vec![Vec::new()], vec![[0; 2]]);
    let (mut seen, mut defined, mut error) = (0, 0, 0.0);
    for new in 1..trees.len() {
        let old = new - 1;
        let found = warp::places_before(&trees[new], &inverse[new], &trees[old], &inverse[old], node);
        let moved = found.iter().enumerate().filter_map(|(at, place)| Some((*place)? - size.pixel_centre(at)));
        shifts.push(shifted(shifts[old], moved.collect()));
        let mut trusted = pictures[new].clone();
        trusted.defined = found.iter().map(Option::is_some).collect();
        seen += trusted.defined.iter().filter(|&&is| is).count();
        defined += pictures[new].defined.iter().filter(|&&is| is).count();
        error += trusted.mean_squared_error(&pictures[old].warped(&found));
        places.push(found);
    }
    let error = error / (trees.len() - 1) as f64;
    println!(
        "  seen before {:.1} %, and there predicted to {:.1} dB",
        100.0 * seen as f64 / defined as f64,
        decibels(error)
    );
    let sequence = Sequence { pictures, places, shifts };
    let mut best = [f64::INFINITY; 2];
    for way in Way::ALL {
        let mut curve = Vec::new();
        for quantiser in QUANTISERS {
            let (error, bits) = sequence.stream(way, quantiser)?;
            curve.push((decibels(error), bits / size.pixels() as f64));
        }
        let Some(bits) = at_target(&curve) else {
            println!("  {way:?}: none at {TARGET_DB} dB, {curve:.2?}");
            continue;
        };
        println!("  {way:?}: {bits:.4} at {TARGET_DB} dB");
        if way == Way::Motion {
            whole.colour[0] += bits;
        }
        best[1] = best[1].min(bits);
        if !way.is_warped() {
            best[0] = best[0].min(bits);
        }
    }
    whole.colour[1] += best[0];
    whole.colour[2] += best[1];
    Ok(())
}

/// How far pictures are rolled, after these pixels moved by so much: even, for the chromas.
fn shifted(before: [i32; 2], mut moved: Vec<Vec2>) -> [i32; 2] {
    std::array::from_fn(|axis| {
        moved.sort_by(|a, b| a[axis].total_cmp(&b[axis]));
        let median = moved.get(moved.len() / 2).map_or(0.0, |moved| moved[axis]);
        before[axis] + 2 * (median * 0.5).round() as i32
    })
}

fn decibels(mean_squared_error: f64) -> f64 {
    10.0 * (255.0 * 255.0 / mean_squared_error.max(1e-9)).log10()
}

/// Bits at the target, between two quantisers; geometric, as rate goes with quality.
fn at_target(curve: &[(f64, f64)]) -> Option<f64> {
    let pair = curve.windows(2).find(|pair| pair[0].0 >= TARGET_DB && pair[1].0 < TARGET_DB)?;
    let t = (TARGET_DB - pair[0].0) / (pair[1].0 - pair[0].0);
    Some((pair[0].1.ln() * (1.0 - t) + pair[1].1.ln() * t).exp())
}

impl Whole {
    fn print(&self) {
        let [motion, chosen, warped] = self.colour;
        println!(
            "whole frame: colour {motion:.3} with motion, {chosen:.3} with the best of each node, {warped:.3} warping too"
        );
        for (measure, geometry) in ["zstd", "entropy"].iter().zip(&self.geometry) {
            let [depth, exact, coarse] = geometry;
            for (name, normals) in [("exact", exact), ("within 1.5 codes", coarse)] {
                let alone = depth[0] + normals[0] + self.indices[0] + chosen;
                let normals_too = alone - normals[0] + normals[1] - self.indices[0] + self.indices[1];
                let depth_too = normals_too - depth[0] + depth[1];
                let all = depth_too - chosen + warped;
                let less = |bits: f64| 100.0 * (1.0 - bits / alone);
                println!(
                    "  {measure}, normals {name}: {alone:.3}; with guesses for normals and indices {normals_too:.3} \
                     (-{:.1} %), depths {depth_too:.3} (-{:.1} %), colour {all:.3} (-{:.1} %)",
                    less(normals_too),
                    less(depth_too),
                    less(all)
                );
            }
        }
    }
}
