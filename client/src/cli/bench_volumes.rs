//! Volumes for `bench`: what a frame with layers costs when it comes, and what every refresh of the display costs then.
//!
//! The phantoms of [`crate::march::phantom`] before an environment at infinity, seen from an orbit: a frame of `k`
//! segments per pixel from its start, pictures from so many degrees further on. Stages: `prepare` is taking in a frame;
//! `surfaces`, `march` and `composite, tone` are the parts of a picture, `total` the whole of it as a display asks for it.
//! The environment is the cheapest of surfaces (a tree of one node, nothing nearer than infinity), so `total` less
//! `surfaces` is what a volume adds to any frame.

use super::bench::Bench;
use super::bench_frames::texture;
use crate::march::phantom::{self, Phantom};
use crate::warp::{MediaStage, Mode, Warper};
use image::RgbImage;
use warplight_protocol::frame::Tree;
use warplight_protocol::{Camera, Pose};

/// Segments per pixel, and the angles that they are looked at from.
const POINTS: [(usize, &[f64]); 3] = [(2, &[10.0]), (4, &[5.0, 10.0, 15.0]), (8, &[10.0])];

/// Field of view of the frames: 40 % of them is the phantom.
const FOV_RAD: f32 = 60.0 * std::f32::consts::PI / 180.0;

/// Times those that are wanted.
pub(super) fn run(bench: &mut Bench, is_wanted: &dyn Fn(&str) -> bool) {
    for phantom in Phantom::ALL {
        let case = format!("volume {}", phantom.name());
        if is_wanted(&case) {
            for (k, angles_deg) in POINTS {
                time(bench, &case, phantom, k, angles_deg);
            }
        }
    }
}

/// The phantom before an environment.
fn frame(phantom: Phantom, pose: &Pose, camera: &Camera, k: usize) -> Tree {
    let mut tree = phantom.frame(pose, camera, k);
    for pixel in 0..camera.size.pixels() {
        let in_view = camera.ray_in_view(camera.size.pixel_centre(pixel)).as_dvec3();
        let direction = (pose.orientation * in_view).normalize().as_vec3();
        tree.nodes[0].set_radiance(pixel, texture(direction));
    }
    tree
}

fn time(bench: &mut Bench, case: &str, phantom: Phantom, k: usize, angles_deg: &[f64]) {
    let camera = Camera::symmetric(FOV_RAD, bench.camera.size);
    let tree = frame(phantom, &phantom::orbit(0.0), &camera, k);
    let mut warper = Warper::default();
    warper.set_level(bench.level);
    let mut picture = RgbImage::new(camera.size.width, camera.size.height);
    for (index, &angle_deg) in angles_deg.iter().enumerate() {
        let pose = phantom::orbit(angle_deg.to_radians());
        let first = bench.rows.len();
        if index == 0 {
            bench.time(case, "prepare", || warper.prepare(Mode::Specular, &tree));
            bench.rows[first].k = Some(k);
        }
        let first = bench.rows.len();
        bench.time(case, "total", || {
            warper.show(Mode::Specular, &tree, &pose, &camera, 1.0, &mut picture);
        });
        for stage in MediaStage::ALL {
            bench.time(case, stage.name(), || {
                warper.run_media(stage, &tree, &pose, &camera, 1.0, &mut picture);
            });
        }
        for row in &mut bench.rows[first..] {
            (row.k, row.angle_deg) = (Some(k), Some(angle_deg));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Level;
    use crate::warp::{Normals, Solver};
    use std::collections::BTreeMap;
    use warplight_protocol::ImageSize;

    #[test]
    fn every_volume_has_rows_for_its_layers_and_angles() {
        let mut bench = Bench {
            camera: Camera::symmetric(1.0, ImageSize::new(32, 32)),
            solver: Solver::default(),
            normals: Normals::Transmitted,
            level: Level::Portable,
            runs: 1,
            rows: Vec::new(),
            interpolated_tiles: BTreeMap::new(),
        };
        run(&mut bench, &|case| case == "volume cloud");
        let of = |stage: &str| -> Vec<(usize, f64)> {
            let rows = bench.rows.iter().filter(|row| row.stage == stage && row.median_ms > 0.0);
            rows.filter_map(|row| row.k.zip(row.angle_deg)).collect()
        };
        let expected = [(2, 10.0), (4, 5.0), (4, 10.0), (4, 15.0), (8, 10.0)];
        for stage in ["total", "surfaces", "march", "composite, tone"] {
            assert_eq!(of(stage), expected, "{stage}");
        }
        let prepared = bench.rows.iter().filter(|row| row.stage == "prepare");
        let prepared: Vec<_> = prepared.map(|row| (row.k, row.angle_deg)).collect();
        assert_eq!(
            prepared,
            [(Some(2), None), (Some(4), None), (Some(8), None)],
            "no matter from where it is looked at"
        );
        assert!(bench.rows.iter().all(|row| row.case == "volume cloud"));
        let document = serde_json::to_string(&bench.rows[1]).unwrap();
        assert!(document.contains(r#""k":2,"angle_deg":10.0"#), "{document}");
    }

    /// The parts of a picture are the picture.
    #[test]
    fn the_stages_in_their_order_make_the_whole() {
        let camera = Camera::symmetric(FOV_RAD, ImageSize::new(48, 40));
        let tree = frame(Phantom::Ct, &phantom::orbit(0.0), &camera, 4);
        let pose = phantom::orbit(0.1);
        let mut warper = Warper::default();
        warper.prepare(Mode::Specular, &tree);
        let [mut whole, mut parts] = [RgbImage::new(48, 40), RgbImage::new(48, 40)];
        warper.show(Mode::Specular, &tree, &pose, &camera, 1.0, &mut whole);
        for stage in MediaStage::ALL {
            warper.run_media(stage, &tree, &pose, &camera, 1.0, &mut parts);
        }
        assert_eq!(whole, parts);
        assert!(whole.pixels().any(|pixel| pixel.0 != whole.get_pixel(0, 0).0), "not all the same");
    }
}
