//! What it costs a live frame to change its size, as guard bands do.
//!
//! Three viewers of one scene move alike at ten frames a second: one with frames of the display's size, one with a guard
//! band, and one whose frames have the band every other time. Printed are the median time per megapixel of the last
//! thirty of sixty frames, and the relative MSE of the display's part of the last frame against two independent
//! references. If a change of size lost anything or took time of its own, the third would be worse than the others.
//!
//! `cargo run --release -p warplight-server --example frame_sizes -- [SCENE,...] [SIDE_PX]`

use glam::{DQuat, DVec3, Vec3};
use std::error::Error;
use std::sync::Arc;
use std::time::Instant;
use warplight_protocol::camera::Margins;
use warplight_protocol::frame::{Interfaces, Tree, flatten};
use warplight_protocol::{Camera, ImageSize, Pose};
use warplight_server::cache::CacheSettings;
use warplight_server::counters::Counters;
use warplight_server::effects::plan_of;
use warplight_server::frame::{FrameRenderer, FrameRequest, LiveFrames};
use warplight_server::scene::Scene;

const FRAMES: u64 = 60;
/// Samples per pixel.
const SPP: f64 = 0.5;
const REFERENCE_SPP: u32 = 128;
const BAND: Margins = Margins { left: 48, right: 16, down: 0, up: 16 };

struct Viewer {
    live: LiveFrames,
    tree: Tree,
    millis_per_megapixel: Vec<f64>,
}

/// The display's part of a frame's picture.
fn shown(tree: &Tree, display: &Camera) -> Option<Vec<Vec3>> {
    let [left, top] = display.offset_in(&tree.camera)?.map(|at| at as usize);
    let (width, pitch) = (display.size.width as usize, tree.camera.size.width as usize);
    let mut radiance = vec![Vec3::ZERO; display.size.pixels()];
    for (y, row) in radiance.chunks_mut(width).enumerate() {
        let first = (y + top) * pitch + left;
        flatten(tree, first..first + width, row);
    }
    Some(radiance)
}

fn pose_at(head: &Pose, frame: u64) -> Pose {
    let secs = frame as f64 * 0.1;
    let orientation = head.orientation * DQuat::from_rotation_y(0.1 * (1.5 * secs).sin());
    Pose { position: head.position + DVec3::new(0.05 * (1.3 * secs).sin(), 0.0, 0.01 * secs), orientation }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let scenes = arguments.first().map_or("gallery,materials", String::as_str);
    let side: u32 = arguments.get(1).map_or(Ok(256), |text| text.parse())?;
    for name in scenes.split(',') {
        let scene = Scene::load(name)?;
        let head = scene.cameras.first().map_or(scene.head, |camera| camera.pose);
        let plan = plan_of(&scene);
        let renderer = FrameRenderer::new(Arc::new(scene));
        let display = Camera::symmetric(80_f32.to_radians(), ImageSize::new(side, side));
        let wide = display.widened(BAND);
        let mut viewers = [(); 3].map(|()| Viewer {
            live: LiveFrames::new(CacheSettings::default()),
            tree: Tree::new(head, display, plan.clone(), Interfaces::default()),
            millis_per_megapixel: Vec::new(),
        });
        let request = |frame: u64, camera| FrameRequest {
            render_pose: pose_at(&head, frame),
            camera,
            plan: plan.clone(),
            volume: None,
            spp: REFERENCE_SPP,
            max_depth: 8,
            seed: frame + 1,
        };
        for frame in 0..FRAMES {
            let alternating = if frame % 2 == 0 { wide } else { display };
            for (viewer, camera) in viewers.iter_mut().zip([display, wide, alternating]) {
                let Viewer { live, tree, millis_per_megapixel } = viewer;
                let megapixels = camera.size.pixels() as f64 * 1e-6;
                let counters = Counters::default();
                let start = Instant::now();
                renderer.render_live(&request(frame, camera), SPP * megapixels * 1e6, live, tree, &counters, &|_| {});
                if frame >= FRAMES / 2 {
                    millis_per_megapixel.push(start.elapsed().as_secs_f64() * 1e3 / megapixels);
                }
            }
        }
        let references = [1001, 1002].map(|seed| {
            let mut tree = Tree::new(head, display, plan.clone(), Interfaces::default());
            let request = FrameRequest { seed, ..request(FRAMES - 1, display) };
            renderer.render(&request, &mut tree, &Counters::default(), &|_| {});
            shown(&tree, &display).unwrap_or_default()
        });
        for (viewer, size) in viewers.iter_mut().zip(["display", "with band", "alternating"]) {
            let picture = shown(&viewer.tree, &display).ok_or("a frame without the display's pixels")?;
            let error: f64 = picture
                .iter()
                .zip(references[0].iter().zip(&references[1]))
                .map(|(x, (a, b))| {
                    let mean = 0.5 * (*a + *b);
                    f64::from(((*x - *a) * (*x - *b) / (mean * mean + 0.01)).element_sum()) / 3.0
                })
                .sum();
            viewer.millis_per_megapixel.sort_by(f64::total_cmp);
            let median = viewer.millis_per_megapixel[viewer.millis_per_megapixel.len() / 2];
            println!(
                "{name:>12} {size:>12}: {median:.0} ms per megapixel, relative MSE {:.2e}",
                error / picture.len() as f64
            );
        }
    }
    Ok(())
}
