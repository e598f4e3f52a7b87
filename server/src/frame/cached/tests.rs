//! Frames from the cache against path-traced ones.

use super::*;
use crate::scene::{Environment, Scene};
use crate::testing::{BLOCK_PX, SceneBuilder, block_means, colored, diffuse, emitter, glass, mirror, write_pictures};
use glam::DVec3;
use std::sync::Arc;
use warplight_protocol::frame::{Interfaces, Plan, flatten};
use warplight_protocol::{Camera, ImageSize, Pose};

const SIDE: u32 = 64;

struct Viewer {
    renderer: FrameRenderer,
    live: LiveFrames,
    tree: Tree,
    request: FrameRequest,
}

impl Viewer {
    fn new(scene: Scene, pose: Pose, max_depth: u32) -> Viewer {
        Viewer::sized(SIDE, scene, pose, max_depth)
    }

    fn sized(side: u32, scene: Scene, pose: Pose, max_depth: u32) -> Viewer {
        let plan = crate::effects::plan_of(&scene);
        let camera = Camera::symmetric(1.0, ImageSize::new(side, side));
        Viewer {
            renderer: FrameRenderer::new(Arc::new(scene)),
            live: LiveFrames::new(CacheSettings { log2_blocks: 14, max_samples: 1e5 }),
            tree: Tree::new(pose, camera, Plan::diffuse(), Interfaces::default()),
            request: FrameRequest { render_pose: pose, camera, plan, volume: None, spp: 1, max_depth, seed: 0 },
        }
    }

    fn of(name: &str) -> Viewer {
        Viewer::of_size(SIDE, name)
    }

    fn of_size(side: u32, name: &str) -> Viewer {
        let scene = Scene::load(name).unwrap();
        let pose = scene.cameras.first().map_or(scene.head, |camera| camera.pose);
        Viewer::sized(side, scene, pose, 16)
    }

    /// A frame of a head that moves by too little to be seen, but is not at rest.
    fn frame(&mut self, spp: f64) -> RayCounts {
        self.request.render_pose.position.x += 1e-3 * if self.request.seed.is_multiple_of(2) { 1.0 } else { -1.0 };
        self.still_frame(spp)
    }

    fn still_frame(&mut self, spp: f64) -> RayCounts {
        self.request.seed += 1;
        let counters = Counters::default();
        let samples = spp * self.request.camera.size.pixels() as f64;
        self.renderer.render_live(&self.request, samples, &mut self.live, &mut self.tree, &counters, &|_| {});
        let counts = counters.snapshot();
        assert_eq!(counts.dropped, 0);
        assert!(self.picture().iter().all(|radiance| radiance.is_finite() && radiance.min_element() >= 0.0));
        counts
    }

    fn frames(&mut self, count: u32, spp: f64) {
        for _ in 0..count {
            self.frame(spp);
        }
    }

    fn picture(&self) -> Vec<Vec3> {
        let mut picture = vec![Vec3::ZERO; self.tree.camera.size.pixels()];
        flatten(&self.tree, 0..picture.len(), &mut picture);
        picture
    }

    fn path_traced(&mut self, spp: u32, seed: u64) -> Vec<Vec3> {
        let request = FrameRequest { volume: None, spp, seed, ..self.request.clone() };
        let mut tree = self.tree.clone();
        self.renderer.render(&request, &mut tree, &Counters::default(), &|_| {});
        let mut picture = vec![Vec3::ZERO; tree.camera.size.pixels()];
        flatten(&tree, 0..picture.len(), &mut picture);
        picture
    }
}

/// Mean squared error over squared radiance, of block means.
fn block_error(picture: &[Vec3], reference: &[Vec3]) -> f64 {
    let [a, b] = [picture, reference].map(|pixels| block_means(SIDE as usize, pixels, f64::from));
    a.iter().zip(&b).map(|(a, b)| (a - b).powi(2) / (b * b + 1e-2)).sum::<f64>() / a.len() as f64
}

fn sum(pixels: &[Vec3]) -> f64 {
    pixels.iter().map(|pixel| f64::from(pixel.element_sum())).sum()
}

#[test]
fn frames_converge_to_the_path_traced_picture() {
    for (name, spp, block_bound, bias_bound) in [("cornell", 256, 2e-3, 0.01), ("gallery", 256, 4e-3, 0.02)] {
        let mut viewer = Viewer::of(name);
        viewer.frames(40, 1.0);
        let (picture, reference) = (viewer.picture(), viewer.path_traced(spp, 9));
        let (error, bias) = (block_error(&picture, &reference), sum(&picture) / sum(&reference) - 1.0);
        println!("{name}: block error {error:.2e}, bias {bias:+.4}");
        if error > block_bound || bias.abs() > bias_bound {
            let folder = write_pictures(name, SIDE as usize, &[("cached", &picture), ("path", &reference)]);
            panic!(
                "{name}: relative MSE of {BLOCK_PX}-px blocks {error:.2e}, bias {bias:+.4}; see {}",
                folder.display()
            );
        }
    }
}

#[test]
fn the_first_frame_is_smooth_and_later_ones_are_better() {
    let mut viewer = Viewer::of("gallery");
    let reference = viewer.path_traced(256, 9);
    let noisy = viewer.path_traced(1, 3);
    let error = |picture: &[Vec3]| {
        let of = |(x, r): (&Vec3, &Vec3)| f64::from(((x - r) * (x - r) / (r * r + 0.01)).element_sum());
        picture.iter().zip(&reference).map(of).sum::<f64>()
    };
    viewer.frame(0.5);
    let first = error(&viewer.picture());
    viewer.frames(20, 0.5);
    let later = error(&viewer.picture());
    let plain = error(&noisy);
    println!("plain {plain:.1}, first {first:.1}, later {later:.1}");
    assert!(first < plain / 4.0 && later < first / 2.0, "{plain} {first} {later}");
}

/// White in white: every sample is 1, so every pixel is, from the first frame.
#[test]
fn a_white_furnace_is_exact() {
    for thing in [
        SceneBuilder::new().sphere(Vec3::ZERO, 1.0, diffuse(1.0)),
        SceneBuilder::new().ball(Vec3::ZERO, 1.0, 3, true, diffuse(1.0)),
    ] {
        let scene = thing.environment(Environment::Constant(Vec3::ONE)).build();
        let mut viewer = Viewer::new(scene, Pose::look_at(DVec3::new(0.5, 1.0, 3.0), DVec3::ZERO), 64);
        viewer.frames(4, 1.0);
        let picture = viewer.picture();
        let worst = picture.iter().map(|pixel| (*pixel - Vec3::ONE).abs().max_element()).fold(0.0, f32::max);
        assert!(worst < 2e-2, "{worst}");
        assert!((sum(&picture) / picture.len() as f64 / 3.0 - 1.0).abs() < 2e-3);
    }
}

/// In a closed body of albedo a that emits L everywhere, radiance is L / (1 - a): paths of any length.
#[test]
fn a_closed_emitter_sums_the_geometric_series() {
    let albedo = Vec3::new(0.5, 0.8, 0.0);
    let mut glowing = colored(albedo);
    glowing.emission = crate::scene::Color::Constant(Vec3::ONE);
    glowing.emission_two_sided = true;
    let scene = SceneBuilder::new().cube(Vec3::ZERO, 2.0, glowing).build();
    // What a viewer's first samples find stays in the cache for long: one alone is off by 1 % (standard deviation).
    let viewers = 12;
    let mut mean = DVec3::ZERO;
    for viewer in 0..viewers {
        let pose = Pose::look_at(DVec3::new(0.1, 0.2, 0.3), -DVec3::Z);
        let seed = 1000 * viewer;
        let mut viewer = Viewer::new(scene.clone(), pose, 200);
        viewer.request.seed = seed;
        viewer.frames(30, 1.0);
        let picture = viewer.picture();
        let sum: DVec3 = picture.iter().map(|pixel| pixel.as_dvec3()).sum();
        mean += sum / (picture.len() as u64 * viewers) as f64;
    }
    assert!((mean / DVec3::new(2.0, 5.0, 1.0) - 1.0).abs().max_element() < 0.01, "{mean}");
}

#[test]
fn frames_do_not_depend_on_the_number_of_threads() {
    let frames = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut viewer = Viewer::of("gallery");
        pool.install(|| (0..4).map(|_| (viewer.frame(0.3), viewer.picture())).collect::<Vec<(RayCounts, Vec<Vec3>)>>())
    };
    let one = frames(1);
    assert!(frames(2) == one && frames(3) == one);
}

#[test]
fn another_scene_starts_from_nothing_and_memory_does_not_grow() {
    let room = |light: Vec3| {
        SceneBuilder::new()
            .floor(0.0, 3.0, diffuse(0.5))
            .sphere(Vec3::new(0.0, 3.0, 0.0), 0.5, emitter(light))
            .sphere(Vec3::new(0.6, 0.4, 0.0), 0.4, glass(1.5))
            .sphere(Vec3::new(-0.6, 0.4, 0.0), 0.4, mirror())
            .build()
    };
    let pose = Pose::look_at(DVec3::new(0.0, 1.5, 3.0), DVec3::ZERO);
    let mut red = Viewer::new(room(Vec3::X * 9.0), pose, 8);
    red.frames(3, 1.0);
    let bytes = red.live.cache_bytes();
    let mut blue = Viewer::new(room(Vec3::Z * 9.0), pose, 8);
    blue.live = red.live;
    blue.frame(1.0);
    assert!(blue.picture().iter().all(|pixel| pixel.x == 0.0));
    assert_eq!(blue.live.cache_bytes(), bytes);
}

#[test]
fn samples_are_as_many_as_asked_for_and_a_frame_without_any_shows_what_is_known() {
    let mut viewer = Viewer::of("cornell");
    let pixels = f64::from(SIDE * SIDE);
    viewer.frames(10, 1.0);
    for spp in [0.1, 1.0, 3.0] {
        let rays = viewer.frame(spp).diffuse as f64;
        assert!((0.5..4.0).contains(&(rays / (spp * pixels))), "{spp}: {rays} rays");
    }
    let before = sum(&viewer.picture());
    let counts = viewer.frame(0.0);
    assert_eq!((counts.diffuse, counts.shadow), (0, 0));
    assert!((sum(&viewer.picture()) / before - 1.0).abs() < 0.01);
}

mod moving;
mod resting;
