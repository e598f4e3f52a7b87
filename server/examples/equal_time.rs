//! Live frames from the irradiance cache against plain path tracing of the same time per frame.
//!
//! A head moves slowly for two seconds at ten frames a second; the last frame is compared with a converged one
//! from its pose. Two independent references make the error unbiased by their own noise: E[(x - a)(x - b)].
//! Then the head rests for as long as it has moved. Prints times and relative MSE, the figures of each scene as a row
//! of a table, and writes the pictures. References are kept in the folder for the next run.
//!
//! `cargo run --release -p warplight-server --example equal_time -- [SCENE,...] [SIDE_PX] [BUDGET_MS] [REFERENCE_SPP] [DIR]`

use glam::{DVec3, Vec3};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use warplight_protocol::frame::{Tree, flatten};
use warplight_protocol::tone::display_from_radiance;
use warplight_protocol::{Camera, ImageSize, Pose};
use warplight_server::cache::CacheSettings;
use warplight_server::counters::Counters;
use warplight_server::effects::plan_of;
use warplight_server::frame::{FrameRenderer, FrameRequest, LiveFrames};
use warplight_server::scene::Scene;

const FRAMES: u32 = 20;
const FRAME_SECS: f64 = 0.1;
/// Frames for which it rests afterwards.
const RESTING: u32 = 20;
/// Speed of the head: about that of a person who stands and looks around.
const SPEED_M_PER_S: f64 = 0.12;
const TURN_RAD_PER_S: f64 = 0.12;

fn pose_at(head: &Pose, secs: f64) -> Pose {
    let orientation = glam::DQuat::from_rotation_y(TURN_RAD_PER_S * secs) * head.orientation;
    let way = DVec3::new((1.3 * secs).sin(), 0.3 * (2.0 * secs).sin(), 0.2 * secs);
    Pose { position: head.position + SPEED_M_PER_S * way, orientation }
}

fn picture(tree: &Tree) -> Vec<Vec3> {
    let mut radiance = vec![Vec3::ZERO; tree.camera.size.pixels()];
    flatten(tree, 0..radiance.len(), &mut radiance);
    radiance
}

fn write_png(path: &Path, side: u32, picture: &[Vec3], exposure: f32) -> Result<(), Box<dyn Error>> {
    let bytes = picture.iter().flat_map(|&radiance| display_from_radiance(radiance, exposure)).collect();
    image::RgbImage::from_raw(side, side, bytes).ok_or("size of the picture")?.save(path)?;
    Ok(())
}

/// A converged picture, from the folder if it is there.
fn reference(path: &Path, pixels: usize, render: impl FnOnce() -> Vec<Vec3>) -> Result<Vec<Vec3>, Box<dyn Error>> {
    if let Ok(bytes) = std::fs::read(path)
        && bytes.len() == pixels * 12
    {
        let floats: Vec<f32> = bytes.chunks_exact(4).map(|c| f32::from_le_bytes([c[0], c[1], c[2], c[3]])).collect();
        return Ok(floats.chunks_exact(3).map(Vec3::from_slice).collect());
    }
    let picture = render();
    let bytes: Vec<u8> = picture.iter().flat_map(|c| c.to_array()).flat_map(f32::to_le_bytes).collect();
    std::fs::write(path, bytes)?;
    Ok(picture)
}

/// Mean over pixels and channels of squared error over squared radiance.
fn relative_mse(picture: &[Vec3], references: &[Vec<Vec3>; 2]) -> f64 {
    let mut sum = 0.0;
    for (index, &x) in picture.iter().enumerate() {
        let [a, b] = [references[0][index], references[1][index]];
        let mean = 0.5 * (a + b);
        let error = (x - a) * (x - b) / (mean * mean + 0.01);
        sum += f64::from(error.element_sum()) / 3.0;
    }
    sum / picture.len() as f64
}

/// Relative difference of the means of all pixels.
fn relative_bias(picture: &[Vec3], references: &[Vec<Vec3>; 2]) -> f64 {
    let sum = |pixels: &[Vec3]| pixels.iter().map(|pixel| f64::from(pixel.element_sum())).sum::<f64>();
    2.0 * sum(picture) / (sum(&references[0]) + sum(&references[1])) - 1.0
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |index: usize, default: u32| arguments.get(index).map_or(Ok(default), |text| text.parse::<u32>());
    let names = arguments.first().map_or("gallery,cornell,pool", String::as_str);
    let (side, budget_ms, reference_spp) = (number(1, 512)?, number(2, 250)?, number(3, 64)?);
    let folder = arguments.get(4).map_or("/tmp/equal_time", String::as_str);
    std::fs::create_dir_all(folder)?;
    let mut table = String::from(
        "| scene | path tracing, spp | its relative MSE | in motion | times less | bias | at rest |\n|---|---|---|---|---|---|---|\n",
    );
    for name in names.split(',') {
        table += &compare(name, side, budget_ms, reference_spp, Path::new(folder))?;
    }
    println!("{table}pictures in {folder}");
    Ok(())
}

/// Median time of a moving frame with the filter of glossy light, and of the same frame without it. Both in turn, so
/// that whatever else the machine does falls on both.
fn filter_ms(renderer: &FrameRenderer, tree: &mut Tree, request: impl Fn(u32) -> FrameRequest) -> (f64, f64) {
    let mut live = [LiveFrames::new(CacheSettings::default()), LiveFrames::without_denoiser(CacheSettings::default())];
    let mut times: [Vec<f64>; 2] = Default::default();
    for frame in 0..=FRAMES {
        let request = request(frame);
        let samples = 0.125 * request.camera.size.pixels() as f64;
        for (live, times) in live.iter_mut().zip(&mut times) {
            let start = Instant::now();
            renderer.render_live(&request, samples, live, tree, &Counters::default(), &|_| ());
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    let [with, without] = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    });
    (with, without)
}

/// A row of the table.
fn compare(name: &str, side: u32, budget_ms: u32, reference_spp: u32, folder: &Path) -> Result<String, Box<dyn Error>> {
    let file = |name: String| folder.join(name);
    let scene = Arc::new(Scene::load(name)?);
    let (head, exposure, plan) = (scene.head, scene.exposure, plan_of(&scene));
    let camera = Camera::symmetric(80_f32.to_radians(), ImageSize::new(side, side));
    let renderer = FrameRenderer::new(scene);
    let mut tree = Tree::new(head, camera, plan.clone(), renderer.interfaces().clone());
    let request = |frame: u32, spp: u32, seed: u64| FrameRequest {
        render_pose: pose_at(&head, FRAME_SECS * f64::from(frame.min(FRAMES))),
        camera,
        plan: plan.clone(),
        volume: None,
        spp,
        max_depth: 8,
        seed,
    };

    let references = [1_u64, 2].map(|seed| {
        reference(&file(format!("reference_{name}_{side}_{reference_spp}_{seed}.f32")), camera.size.pixels(), || {
            let mut tree = tree.clone();
            renderer.render(&request(FRAMES, reference_spp, 1000 + seed), &mut tree, &Counters::default(), &|_| ());
            picture(&tree)
        })
    });
    let [a, b] = references;
    let references = [a?, b?];
    let mean: Vec<Vec3> = references[0].iter().zip(&references[1]).map(|(&a, &b)| 0.5 * (a + b)).collect();
    write_png(&file(format!("{name}_reference.png")), side, &mean, exposure)?;

    // Plain path tracing, at least one sample.
    let start = Instant::now();
    renderer.render(&request(FRAMES, 1, 7), &mut tree, &Counters::default(), &|_| ());
    let one_ms = start.elapsed().as_secs_f64() * 1e3;
    let spp = ((f64::from(budget_ms) / one_ms) as u32).max(1);
    renderer.render(&request(FRAMES, spp, 7), &mut tree, &Counters::default(), &|_| ());
    let plain = picture(&tree);
    let plain_error = relative_mse(&plain, &references);
    println!("path: {one_ms:.0} ms per sample and pixel, {spp} spp, relative MSE {plain_error:.5}");
    write_png(&file(format!("{name}_path.png")), side, &plain, exposure)?;

    // From the cache, with samples as time allows.
    let mut live = LiveFrames::new(CacheSettings::default());
    let (mut moving, mut bias, mut resting) = (0.0, 0.0, 0.0);
    let mut samples = 0.125 * camera.size.pixels() as f64;
    for frame in 0..=FRAMES + RESTING {
        let counters = Counters::default();
        let start = Instant::now();
        renderer.render_live(&request(frame, 1, u64::from(frame)), samples, &mut live, &mut tree, &counters, &|_| ());
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let shown = picture(&tree);
        let spp = samples / camera.size.pixels() as f64;
        print!(
            "cached frame {frame:>2}: {ms:>4.0} ms, {spp:.3} samples per pixel, {:.2} Mrays",
            counters.snapshot().rays() as f64 * 1e-6
        );
        let error = relative_mse(&shown, &references);
        match frame {
            FRAMES => (moving, bias) = (error, relative_bias(&shown, &references)),
            _ if frame == FRAMES + RESTING => resting = error,
            _ => {}
        }
        if frame >= FRAMES {
            print!(", relative MSE {error:.5}, {:.1} times less", plain_error / error);
        }
        println!();
        if [0, 1, 4, 10, 20, 40].contains(&frame) {
            write_png(&file(format!("{name}_cached_{frame:02}.png")), side, &shown, exposure)?;
        }
        // Never fewer than the server traces.
        samples = (samples * (f64::from(budget_ms) / ms).clamp(0.5, 1.5)).max(camera.size.pixels() as f64 / 64.0);
    }
    let (with_ms, without_ms) = filter_ms(&renderer, &mut tree, |frame| request(frame, 1, u64::from(frame)));
    println!(
        "frames with the filter of glossy light take {with_ms:.1} ms, without {without_ms:.1} ms: {:.1} ms, {:.1} percent",
        with_ms - without_ms,
        100.0 * (with_ms - without_ms) / with_ms
    );
    Ok(format!(
        "| {name} | {spp} | {plain_error:.4} | {moving:.5} | {:.0} | {bias:+.4} | {resting:.5} |\n",
        plain_error / moving
    ))
}
