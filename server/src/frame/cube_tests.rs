//! Pictures of six faces against those of six pinhole cameras, and their temporal state across seams.

use super::{FrameRenderer, FrameRequest, LiveFrames};
use crate::cache::CacheSettings;
use crate::counters::Counters;
use crate::effects::plan_of;
use crate::scene::Scene;
use glam::{DMat3, DQuat, DVec3, Vec3};
use std::sync::Arc;
use warplight_protocol::camera::Face;
use warplight_protocol::frame::{Interfaces, Plan, Tree, flatten};
use warplight_protocol::{Camera, ImageSize, Pose};

fn cube(display_side: u32) -> Camera {
    Camera::cube(&Camera::symmetric(1.4, ImageSize::new(display_side, display_side)), u32::MAX)
}

fn empty_tree() -> Tree {
    Tree::new(Pose::IDENTITY, Camera::symmetric(1.0, ImageSize::new(1, 1)), Plan::diffuse(), Interfaces::default())
}

/// The pose of a face's own camera.
fn pose_of(face: &Face, pose: &Pose) -> Pose {
    let turn = DQuat::from_mat3(&DMat3::from_cols_array(&face.view_from_face().to_cols_array().map(f64::from)));
    Pose { orientation: pose.orientation * turn, ..*pose }
}

fn rendered(renderer: &FrameRenderer, request: &FrameRequest) -> Tree {
    let mut tree = empty_tree();
    renderer.render(request, &mut tree, &Counters::default(), &|_| {});
    tree
}

fn picture(tree: &Tree) -> Vec<Vec3> {
    let mut picture = vec![Vec3::ZERO; tree.camera.size.pixels()];
    flatten(tree, 0..picture.len(), &mut picture);
    picture
}

#[test]
fn the_six_faces_of_a_cube_are_six_perspective_pictures() {
    let scene = Scene::load("gallery").unwrap();
    let plan = plan_of(&scene);
    // Turned, so that no face lies along anything of the scene.
    let turn = DQuat::from_euler(glam::EulerRot::YXZ, 0.4, 0.2, -0.1);
    let pose = Pose { orientation: scene.head.orientation * turn, ..scene.head };
    let renderer = FrameRenderer::new(Arc::new(scene));
    let camera = cube(24);
    let whole = FrameRequest { render_pose: pose, camera, plan, volume: None, spp: 6, max_depth: 4, seed: 3 };
    let cube = rendered(&renderer, &whole);
    let cube_picture = picture(&cube);
    let nodes = cube.plan.nodes().len();
    assert_eq!(nodes, 4);
    let (mut compared, mut astray, mut normals) = (0_usize, 0_usize, 0_usize);
    for (index, face) in camera.faces().enumerate() {
        let request = FrameRequest {
            render_pose: pose_of(&face, &pose),
            camera: face.camera,
            seed: 4 + index as u64,
            ..whole.clone()
        };
        let plane = rendered(&renderer, &request);
        let first = (face.first_row * camera.size.width) as usize;
        let pixels = face.camera.size.pixels();
        for (cube, plane) in cube.nodes.iter().zip(&plane.nodes) {
            for pixel in 0..pixels {
                let (a, b) = (cube.distance[first + pixel], plane.distance[pixel]);
                compared += 1;
                // Rays differ by their rounding, 1e-7 rad or so, which curved glass makes more of.
                let same = a == b || (a - b).abs() < 1e-3 * b.abs();
                astray += usize::from(!same);
                if !same || plane.interface.get(pixel).is_none_or(|&interface| interface == 0) {
                    continue;
                }
                assert_eq!(cube.interface[first + pixel], plane.interface[pixel]);
                let in_view = face.view_from_face() * plane.normal_at(pixel);
                normals += 1;
                astray += usize::from((in_view - cube.normal_at(first + pixel)).length() > 1e-3);
            }
        }
        // Other random numbers, the same mean: differences of pixels have mean zero, with a standard error of their own.
        // Flattening gives both the Fresnel weights of their own rays and normals.
        let differences = picture(&plane).into_iter().zip(&cube_picture[first..first + pixels]).map(|(a, b)| a - *b);
        let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
        for difference in differences.map(Vec3::as_dvec3) {
            sum += difference;
            squares += difference * difference;
        }
        // Eighteen numbers: 4.5 standard errors are exceeded by chance once in 8,000 runs.
        let sigmas = sum / squares.max(DVec3::splat(1e-12)).map(f64::sqrt);
        assert!(sigmas.abs().max_element() < 4.5, "face {index}: {sigmas} standard errors");
    }
    assert!(normals > 100, "{normals} pixels have a boundary");
    // A ray on an edge may pass it on the other side.
    assert!(astray as f64 <= 2e-3 * compared as f64, "{astray} of {compared} differ");
}

#[test]
fn live_frames_of_a_cube_converge_to_the_path_traced_cube_on_every_face() {
    for name in ["cornell", "materials"] {
        let scene = Scene::load(name).unwrap();
        let (plan, head) = (plan_of(&scene), scene.head);
        let pose = Pose { orientation: DQuat::IDENTITY, ..head };
        let renderer = FrameRenderer::new(Arc::new(scene));
        let mut request =
            FrameRequest { render_pose: pose, camera: cube(13), plan, volume: None, spp: 1, max_depth: 5, seed: 0 };
        let pixels = request.camera.size.pixels();
        let mut live = LiveFrames::new(CacheSettings { log2_blocks: 14, max_samples: 1e5 });
        let mut tree = empty_tree();
        // The last ones at rest.
        for frame in 0..24 {
            request.seed = frame + 1;
            request.render_pose.position.x += if frame < 12 { 1e-3 } else { 0.0 };
            let samples = 16.0 * pixels as f64;
            renderer.render_live(&request, samples, &mut live, &mut tree, &Counters::default(), &|_| {});
        }
        let reference =
            picture(&rendered(&renderer, &FrameRequest { volume: None, spp: 256, seed: 99, ..request.clone() }));
        let shown = picture(&tree);
        assert!(shown.iter().all(|radiance| radiance.is_finite() && radiance.min_element() >= 0.0));
        for (index, face) in request.camera.faces().enumerate() {
            let first = (face.first_row * request.camera.size.width) as usize;
            let part = first..first + face.camera.size.pixels();
            let mean = |picture: &[Vec3]| picture[part.clone()].iter().map(|x| f64::from(x.element_sum())).sum::<f64>();
            let (found, expected) = (mean(&shown), mean(&reference));
            // The cache's bias and the noise of both; a face taken for another would be off by a factor.
            assert!((found - expected).abs() < 0.08 * expected + 1e-3, "{name}, face {index}: {found} for {expected}");
        }
    }
}
