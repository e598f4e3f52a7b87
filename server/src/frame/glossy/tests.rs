//! Frames with rough lobes, filtered and not, against converged ones.

use super::super::{FrameRenderer, FrameRequest, LiveFrames};
use crate::cache::CacheSettings;
use crate::counters::Counters;
use crate::effects::{EffectKind, Effects, plan_of};
use crate::scene::{Key, Light, Motion, Scene, Target};
use glam::{DQuat, DVec3, Vec3};
use std::sync::Arc;
use warplight_protocol::camera::Margins;
use warplight_protocol::frame::{Interfaces, Tree, flatten};
use warplight_protocol::{Camera, ImageSize, Timestamp};

const SIZE: ImageSize = ImageSize { width: 96, height: 64 };
/// Paths of a frame per pixel, beside the one ray per rough pixel.
const SPP: f64 = 0.5;

/// A head before a scene, at ten frames a second.
struct Viewer {
    renderer: FrameRenderer,
    live: LiveFrames,
    tree: Tree,
    request: FrameRequest,
}

impl Viewer {
    fn new(scene: Scene, denoises: bool) -> Viewer {
        let (pose, plan) = (scene.cameras[0].pose, plan_of(&scene));
        let camera = Camera::symmetric(scene.cameras[0].vertical_fov_rad, SIZE);
        let settings = CacheSettings { log2_blocks: 14, ..CacheSettings::default() };
        Viewer {
            renderer: FrameRenderer::new(Arc::new(scene)),
            live: if denoises { LiveFrames::new(settings) } else { LiveFrames::without_denoiser(settings) },
            tree: Tree::new(pose, camera, plan.clone(), Interfaces::default()),
            request: FrameRequest { render_pose: pose, camera, plan, volume: None, spp: 1, max_depth: 8, seed: 0 },
        }
    }

    fn of(name: &str, denoises: bool) -> Viewer {
        Viewer::new(Scene::load(name).unwrap(), denoises)
    }

    /// A frame of a head that moves aside by so much.
    fn frame(&mut self, step_m: f64) {
        self.request.seed += 1;
        self.request.render_pose.position.x += step_m;
        let samples = SPP * SIZE.pixels() as f64;
        self.renderer.render_live(
            &self.request,
            samples,
            &mut self.live,
            &mut self.tree,
            &Counters::default(),
            &|_| {},
        );
    }

    fn picture(&self) -> Vec<Vec3> {
        picture(&self.tree)
    }

    /// Pixels whose root shows a rough lobe.
    fn rough_pixels(&self) -> Vec<usize> {
        self.live.rough_pixels(SIZE.width as usize)
    }

    fn converged(&self, spp: u32, seed: u64) -> Vec<Vec3> {
        let request = FrameRequest { volume: None, spp, seed: 1000 + seed, ..self.request.clone() };
        let mut tree = self.tree.clone();
        self.renderer.render(&request, &mut tree, &Counters::default(), &|_| {});
        picture(&tree)
    }
}

fn picture(tree: &Tree) -> Vec<Vec3> {
    let mut picture = vec![Vec3::ZERO; tree.camera.size.pixels()];
    flatten(tree, 0..picture.len(), &mut picture);
    picture
}

fn rms(a: &[Vec3], b: &[Vec3], pixels: &[usize]) -> f64 {
    let squares = pixels.iter().map(|&pixel| f64::from((a[pixel] - b[pixel]).length_squared()));
    (squares.sum::<f64>() / pixels.len() as f64).sqrt()
}

/// Against two independent references, whose own noise drops out: E[(x - a)(x - b)].
fn relative_mse(picture: &[Vec3], references: &[Vec<Vec3>; 2], pixels: &[usize]) -> f64 {
    let of = |pixel: &usize| {
        let [x, a, b] = [picture[*pixel], references[0][*pixel], references[1][*pixel]];
        let mean = 0.5 * (a + b);
        f64::from(((x - a) * (x - b) / (mean * mean + 0.01)).element_sum()) / 3.0
    };
    pixels.iter().map(of).sum::<f64>() / pixels.len() as f64
}

fn mean(picture: &[Vec3], pixels: &[usize]) -> f64 {
    pixels.iter().map(|&pixel| f64::from(picture[pixel].element_sum())).sum::<f64>() / pixels.len() as f64
}

/// Of forty frames of a head that walks aside at 0.02 m/s, with the filter and without.
struct Walk {
    /// Rms of the last twenty frames, each against the one before.
    flicker: [f64; 2],
    /// Mean of the last twenty frames over that of converged pictures, less 1.
    bias: [f64; 2],
    /// Relative MSE of the last frame where its root shows a rough lobe, and of all of it.
    error: [f64; 2],
    error_of_all: [f64; 2],
}

impl Walk {
    fn of(name: &str, scene: &Scene) -> Walk {
        const STEP_M: f64 = 0.002;
        let mut viewers = [true, false].map(|denoises| Viewer::new(scene.clone(), denoises));
        let mut squares = [0.0; 2];
        let mut means = [0.0; 2];
        for frame in 0..40 {
            let before = viewers.each_ref().map(Viewer::picture);
            viewers.iter_mut().for_each(|viewer| viewer.frame(STEP_M));
            if frame >= 20 {
                let pixels = viewers[0].rough_pixels();
                for (index, viewer) in viewers.iter().enumerate() {
                    squares[index] += rms(&viewer.picture(), &before[index], &pixels).powi(2) / 20.0;
                    means[index] += mean(&viewer.picture(), &pixels) / 20.0;
                }
            }
        }
        let pixels = viewers[0].rough_pixels();
        let all: Vec<usize> = (0..SIZE.pixels()).collect();
        let truth = [1, 2].map(|seed| viewers[0].converged(512, seed));
        let error_of =
            |pixels: &[usize]| viewers.each_ref().map(|viewer| relative_mse(&viewer.picture(), &truth, pixels));
        let bright = 0.5 * (mean(&truth[0], &pixels) + mean(&truth[1], &pixels));
        let walk = Walk {
            flicker: squares.map(f64::sqrt),
            bias: means.map(|mean| mean / bright - 1.0),
            error: error_of(&pixels),
            error_of_all: error_of(&all),
        };
        let Walk { flicker, bias, error, error_of_all } = &walk;
        let times = |[a, b]: &[f64; 2]| b / a;
        println!(
            "{name}: {} rough pixels; flicker {flicker:.4?}, {:.1} times less; relative MSE {error:.5?}, {:.1} times less; of all \
             pixels {error_of_all:.5?}, {:.1} times less; bias {bias:+.4?}, references differ by {:+.4}",
            pixels.len(),
            times(flicker),
            times(error),
            times(error_of_all),
            mean(&truth[0], &pixels) / mean(&truth[1], &pixels) - 1.0,
        );
        walk
    }
}

#[test]
fn what_rough_lobes_show_is_steady_near_the_truth_and_as_bright() {
    let scene = Scene::load("materials").unwrap();
    let walk = Walk::of("materials", &scene);
    assert!(walk.flicker[0] * 4.0 < walk.flicker[1]);
    assert!(walk.error[0] * 3.0 < walk.error[1] && walk.error_of_all[0] * 3.0 < walk.error_of_all[1]);
    // Without lights of no extent, whose caustics are found by chance alone.
    let walk = Walk::of("without caustics", &Scene { lights: Vec::new(), ..scene });
    assert!(walk.flicker[0] * 4.0 < walk.flicker[1]);
    assert!(walk.bias[0].abs() < 0.02, "{:?}", walk.bias);
}

/// A point light over the table is gone from one frame to the next: far away at once.
#[test]
fn light_that_is_switched_off_is_gone_within_half_a_second() {
    let mut scene = Scene::load("materials").unwrap();
    scene.lights.truncate(1);
    let key = |at_secs: f64, away: f64| Key { at_secs, translate: DVec3::Z * away, rotate: DQuat::IDENTITY };
    let keys = vec![key(0.0, 0.0), key(2.0, 0.0), key(2.001, 1e4)];
    assert!(matches!(scene.lights[0], Light::Spot { .. }));
    scene.motions = vec![Motion { target: Target::Light(0), pivot: DVec3::ZERO, keys, period_secs: None }];
    let mut viewer = Viewer::new(scene, true);
    let frame_at = |viewer: &mut Viewer, tenths: u64| {
        viewer.renderer.move_to(Timestamp { micros: tenths * 100_000 });
        viewer.frame(if tenths.is_multiple_of(2) { 1e-3 } else { -1e-3 });
    };
    (0..=20).for_each(|tenths| frame_at(&mut viewer, tenths));
    let (lit, pixels) = (viewer.converged(64, 1), viewer.rough_pixels());
    let mut late = Vec::new();
    for tenths in 21..=25 {
        frame_at(&mut viewer, tenths);
        let dark = viewer.converged(64, 2);
        // By how much of the change the picture is behind, in least squares.
        let change = pixels.iter().map(|&pixel| (lit[pixel] - dark[pixel]).as_dvec3());
        let shown = viewer.picture();
        let left = pixels.iter().map(|&pixel| (shown[pixel] - dark[pixel]).as_dvec3());
        let behind: f64 = left.zip(change.clone()).map(|(left, change)| left.dot(change)).sum();
        late.push(behind / change.map(|change| change.length_squared()).sum::<f64>());
    }
    println!("left of the light after 1 to 5 frames: {late:.4?}");
    assert!(late[4].abs() < 0.1, "{late:?}");
}

#[test]
fn without_rough_lobes_nothing_is_kept_and_nothing_changes() {
    for name in Scene::built_in_names() {
        let scene = Scene::load(name).unwrap();
        if Effects::of(&scene).has(EffectKind::RoughLobes) {
            continue;
        }
        let mut viewers = [true, false].map(|denoises| Viewer::of(name, denoises));
        for _ in 0..3 {
            viewers.iter_mut().for_each(|viewer| viewer.frame(1e-3));
            let [filtered, plain] = viewers.each_ref().map(|viewer| &viewer.tree);
            assert!(filtered == plain, "{name}");
        }
        let glossy = viewers[0].live.glossy();
        assert_eq!(glossy.now.index.capacity() + glossy.light.capacity() + glossy.samples.capacity(), 0, "{name}");
    }
}

#[test]
fn filtered_frames_do_not_depend_on_the_number_of_threads() {
    let frames = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut viewer = Viewer::of("materials", true);
        pool.install(|| {
            (0..5)
                .map(|_| {
                    viewer.frame(2e-3);
                    viewer.tree.clone()
                })
                .collect::<Vec<Tree>>()
        })
    };
    let one = frames(1);
    assert!(frames(2) == one && frames(3) == one);
}

#[test]
fn a_frame_that_changes_its_size_keeps_the_history_of_what_it_still_shows() {
    let mut viewer = Viewer::of("materials", true);
    let display = viewer.request.camera;
    let frames_of = |viewer: &Viewer| {
        let histories = &viewer.live.glossy().now.history;
        histories.iter().map(super::History::frames).sum::<f32>() / histories.len() as f32
    };
    for _ in 0..12 {
        viewer.frame(1e-4);
    }
    let settled = frames_of(&viewer);
    let margins = Margins { left: 16, right: 0, down: 0, up: 16 };
    viewer.request.camera = display.widened(margins);
    viewer.frame(1e-4);
    let wide = frames_of(&viewer);
    viewer.request.camera = display;
    viewer.frame(1e-4);
    let narrow = frames_of(&viewer);
    // Of the wider frame a third is new, and has seen one frame.
    let part = display.size.pixels() as f32 / (display.size.width as f32 + 16.0) / (display.size.height as f32 + 16.0);
    println!("frames of history: {settled} settled, {wide} wider, {narrow} back");
    assert!(settled > 6.0 && narrow > 0.9 * settled && wide > 0.8 * part * settled, "{settled} {wide} {narrow}");
}
