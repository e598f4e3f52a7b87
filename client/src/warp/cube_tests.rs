//! Frames that look around: every display, however it is turned, sees what is there.

use super::*;
use glam::{DQuat, DVec3};
use warplight_protocol::ImageSize;
use warplight_protocol::optics::Interface;

const SIZE: ImageSize = ImageSize::new(96, 64);

fn display() -> Camera {
    Camera::symmetric(1.2, SIZE)
}

/// Inside a ball of two metres, its colour by direction; its lower half is a mirror that shows another one, of a
/// kilometre.
fn ball(pose: Pose) -> Tree {
    let camera = Camera::cube(&display(), 512);
    let mut tree = Tree::new(pose, camera, Plan::mirror(), Interfaces(vec![Interface::Mirror]));
    for pixel in 0..camera.size.pixels() {
        let direction = camera.ray_in_view(camera.size.pixel_centre(pixel)).normalize();
        tree.nodes[0].distance[pixel] = 2.0;
        if direction.y > 0.0 {
            tree.nodes[0].set_radiance(pixel, color_of(direction));
            continue;
        }
        tree.nodes[0].interface[pixel] = 1;
        tree.nodes[0].set_normal(pixel, -direction);
        tree.nodes[1].distance[pixel] = 1e3;
        // What comes back from the wall that is looked at: straight from the other side.
        tree.nodes[1].set_radiance(pixel, color_of(-direction));
    }
    tree
}

fn color_of(direction: Vec3) -> Vec3 {
    Vec3::splat(0.5) + 0.3 * direction
}

#[test]
fn a_head_that_turns_sees_everything_of_a_cube() {
    let tree = ball(Pose { position: DVec3::new(3.0, 1.0, -2.0), ..Pose::IDENTITY });
    for mode in [Mode::Rotation, Mode::Diffuse, Mode::Specular] {
        let (mut warper, mut radiance) = (Warper::default(), Vec::new());
        warper.prepare(mode, &tree);
        for (yaw, pitch) in [(0.0, 0.0), (0.8, 0.1), (2.3, -0.7), (-1.6, 1.4), (3.1, 0.6)] {
            let turn = DQuat::from_euler(glam::EulerRot::YXZ, yaw, pitch, 0.2);
            let pose = Pose { orientation: turn, ..tree.render_pose };
            let statistics = warper.radiance(mode, &tree, &pose, &display(), &mut radiance);
            assert!(statistics.hole_fraction < 0.001, "{mode:?} at {yaw}, {pitch}: {statistics:?}");
            for (pixel, &shown) in radiance.iter().enumerate() {
                let ray = turn.as_quat() * display().ray_in_view(SIZE.pixel_centre(pixel)).normalize();
                let expected = if ray.y > 0.0 { color_of(ray) } else { color_of(-ray) };
                // The equator is an edge.
                let error = (shown - expected).abs().max_element();
                assert!(ray.y.abs() < 0.05 || error < 0.01, "{mode:?} at {yaw}, {pitch}, {pixel}: {shown}, {expected}");
            }
        }
    }
}
