//! Light that changes, and light that does not.

use super::*;
use crate::scene::{Key, Light, Motion, Target};
use warplight_protocol::Timestamp;

const FRAMES_PER_S: f64 = 8.0;
/// As many samples per frame as one of 512x512 pixels has with a tenth per pixel.
const SPP: f64 = 6.0;

fn key(at_secs: f64, translate: DVec3) -> Key {
    Key { at_secs, translate, rotate: glam::DQuat::IDENTITY }
}

/// A floor with a wall and a post on it, under a lamp that moves along `keys`.
fn room(keys: Vec<Key>) -> Viewer {
    let mut scene = SceneBuilder::new()
        .floor(0.0, 4.0, diffuse(0.6))
        .cube(Vec3::new(0.3, 0.5, 0.0), 1.0, diffuse(0.7))
        .quad(
            [(-4.0, 0.0), (4.0, 0.0), (4.0, 4.0), (-4.0, 4.0)].map(|(x, y)| Vec3::new(x, y, -2.0)),
            colored(Vec3::new(0.7, 0.4, 0.3)),
        )
        .environment(Environment::Constant(Vec3::splat(0.05)))
        .build();
    scene.lights = vec![Light::Point { position: Vec3::new(-1.5, 2.5, 1.5), intensity: Vec3::splat(20.0) }];
    scene.motions = vec![Motion { target: Target::Light(0), pivot: DVec3::ZERO, keys, period_secs: None }];
    let mut viewer = Viewer::new(scene, Pose::look_at(DVec3::new(0.0, 2.5, 5.0), DVec3::new(0.0, 0.5, 0.0)), 8);
    viewer.live = LiveFrames::new(CacheSettings { log2_blocks: 14, ..CacheSettings::default() });
    viewer
}

impl Viewer {
    fn frame_at(&mut self, secs: f64, spp: f64) {
        self.renderer.move_to(Timestamp { micros: (secs * 1e6).round() as u64 });
        self.frame(spp);
    }

    /// Frames from one instant to another, both included.
    fn frames_between(&mut self, from_secs: f64, to_secs: f64, spp: f64) {
        let frames = ((to_secs - from_secs) * FRAMES_PER_S).round() as u32;
        for frame in 0..=frames {
            self.frame_at(from_secs + f64::from(frame) / FRAMES_PER_S, spp);
        }
    }

    fn blocks(&self) -> Vec<f64> {
        block_means(SIDE as usize, &self.picture(), f64::from)
    }

    /// The picture that there should be at an instant, and the viewer back where it was.
    fn blocks_expected(&mut self, secs: f64) -> Vec<f64> {
        let now = self.renderer.version.time;
        self.renderer.move_to(Timestamp { micros: (secs * 1e6).round() as u64 });
        let picture = self.path_traced(64, 77);
        self.renderer.move_to(now);
        block_means(SIDE as usize, &picture, f64::from)
    }
}

fn rms(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

#[test]
fn half_a_second_after_a_lamp_has_jumped_nine_tenths_of_the_change_are_seen() {
    for (name, jump) in [("far", DVec3::new(3.0, 0.5, 0.0)), ("near", DVec3::new(0.6, 0.0, 0.0))] {
        let mut viewer = room(vec![key(5.0, DVec3::ZERO), key(5.001, jump)]);
        viewer.frames_between(0.0, 5.0, SPP);
        let before = viewer.blocks_expected(5.0);
        let settled = rms(&viewer.blocks(), &before);
        viewer.frames_between(5.0 + 1.0 / FRAMES_PER_S, 5.5, SPP);
        let expected = viewer.blocks_expected(5.5);
        let (change, error) = (rms(&before, &expected), rms(&viewer.blocks(), &expected));
        println!("{name}: change {change:.4}, error before {settled:.4}, half a second later {error:.4}");
        assert!(error < 0.1 * change + settled, "{name}: {error:.4} of {change:.4}, {settled:.4} before");
    }
}

#[test]
fn a_lamp_that_moves_slowly_is_followed_within_half_a_second() {
    for (name, speed) in [("slow", 0.1), ("walking", 1.0)] {
        let mut viewer = room(vec![key(0.0, DVec3::ZERO), key(8.0, DVec3::X * 8.0 * speed)]);
        viewer.frames_between(0.0, 3.0, SPP);
        let now = viewer.blocks_expected(3.0);
        let earlier = viewer.blocks_expected(2.5);
        let shown = viewer.blocks();
        // The picture as one between the two: by how much of half a second it is late, in least squares.
        let step: Vec<f64> = now.iter().zip(&earlier).map(|(now, earlier)| earlier - now).collect();
        let late: f64 = shown.iter().zip(&now).zip(&step).map(|((shown, now), step)| (shown - now) * step).sum();
        let lag_secs = 0.5 * late / step.iter().map(|step| step * step).sum::<f64>();
        println!("{name}: {lag_secs:.3} s late, off by {:.4} of {:.4}", rms(&shown, &now), rms(&now, &earlier));
        assert!(lag_secs.abs() < 0.45, "{name}: {lag_secs} s");
    }
}

#[test]
fn light_that_rests_does_not_flicker_whether_or_not_things_move_elsewhere() {
    for (name, keys) in [
        ("resting", vec![key(0.0, DVec3::ZERO)]),
        // Below the floor, whence it lights nothing that is seen.
        ("moving elsewhere", vec![key(0.0, DVec3::NEG_Y * 9.0), key(9.0, DVec3::new(3.0, -9.0, 0.0))]),
    ] {
        let mut viewer = room(keys);
        viewer.renderer = {
            let mut scene = viewer.renderer.scene().as_ref().clone();
            scene.lights.push(Light::Point { position: Vec3::new(1.5, 2.5, 2.0), intensity: Vec3::splat(20.0) });
            FrameRenderer::new(Arc::new(scene))
        };
        viewer.frames_between(0.0, 5.0, SPP);
        let mean = viewer.blocks().iter().sum::<f64>() / viewer.blocks().len() as f64;
        let mut flicker = Vec::new();
        // The view of every other frame is the same to the bit.
        let mut before = [viewer.blocks(), Vec::new()];
        for frame in 1..=16_usize {
            viewer.frame_at(5.0 + frame as f64 / FRAMES_PER_S, SPP);
            let now = viewer.blocks();
            if !before[frame % 2].is_empty() {
                flicker.push(rms(&now, &before[frame % 2]) / mean);
            }
            before[frame % 2] = now;
        }
        let worst = flicker.iter().fold(0.0, |worst: f64, &step| worst.max(step));
        println!("{name}: blocks change by {worst:.5} of the mean from frame to frame");
        assert!(worst < 0.01, "{name}: {flicker:.4?}");
    }
}
