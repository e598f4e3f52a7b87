//! Frames that show more than the display: the display's grid is the middle of theirs.

use super::prepared::Prepared;
use super::*;
use glam::{DQuat, DVec3, Vec2};
use warplight_protocol::ImageSize;
use warplight_protocol::camera::Margins;
use warplight_protocol::frame::{Interfaces, Plan, flatten};
use warplight_protocol::tone::display_from_radiance;

const DISPLAY: ImageSize = ImageSize::new(80, 56);
const MARGINS: Margins = Margins { left: 32, right: 16, down: 0, up: 16 };

fn display() -> Camera {
    Camera::symmetric(1.2, DISPLAY)
}

/// A frame of a wall five metres away, with a picture of its own pixels' coordinates.
fn wall_of_coordinates() -> Tree {
    let camera = display().widened(MARGINS);
    let pose = Pose { position: DVec3::new(3.0, 1.5, -2.0), orientation: DQuat::from_rotation_y(0.4) };
    let mut tree = Tree::new(pose, camera, Plan::mirror(), Interfaces::default());
    for pixel in 0..camera.size.pixels() {
        let centre = camera.size.pixel_centre(pixel);
        tree.nodes[0].distance[pixel] = 5.0 * camera.ray_in_view(centre).length();
        tree.nodes[0].set_radiance(pixel, centre.extend(1.0) / 256.0);
    }
    tree
}

/// The frame's picture where the display shows it.
fn middle_of(tree: &Tree) -> RgbImage {
    let size = tree.camera.size;
    let mut radiance = vec![Vec3::ZERO; size.pixels()];
    flatten(tree, 0..size.pixels(), &mut radiance);
    RgbImage::from_fn(DISPLAY.width, DISPLAY.height, |x, y| {
        let pixel = (y + MARGINS.up) * size.width + x + MARGINS.left;
        image::Rgb(display_from_radiance(radiance[pixel as usize], 1.0))
    })
}

#[test]
fn an_unmoved_head_sees_the_middle_of_a_wider_frame_to_the_bit() {
    let tree = wall_of_coordinates();
    let mut warper = Warper::default();
    for mode in Mode::ALL {
        let mut picture = RgbImage::default();
        warper.prepare(mode, &tree);
        let statistics = warper.show(mode, &tree, &tree.render_pose, &display(), 1.0, &mut picture);
        assert_eq!(statistics.hole_fraction, 0.0, "{mode:?}");
        assert!(picture == middle_of(&tree), "{mode:?}");
    }
}

#[test]
fn a_stale_picture_is_the_middle_of_a_wider_frame_wherever_the_head_is() {
    let tree = wall_of_coordinates();
    let mut warper = Warper::default();
    let mut picture = RgbImage::default();
    warper.prepare(Mode::None, &tree);
    let turned = Pose { orientation: tree.render_pose.orientation * DQuat::from_rotation_y(1.0), ..tree.render_pose };
    warper.show(Mode::None, &tree, &turned, &display(), 1.0, &mut picture);
    assert!(picture == middle_of(&tree));
}

#[test]
fn a_turned_head_finds_in_a_wider_frame_what_a_frame_of_the_displays_size_lacks() {
    let tree = wall_of_coordinates();
    // To the left by about 25 px at the edge, and up.
    let turn = DQuat::from_euler(glam::EulerRot::YXZ, 0.25, 0.06, 0.0);
    let display_pose = Pose { orientation: tree.render_pose.orientation * turn, ..tree.render_pose };
    let old_from_new = tree.render_pose.view_from(&display_pose).rotation;
    let frame = tree.camera;
    let expected: Vec<Vec2> = (0..DISPLAY.pixels())
        .map(|pixel| frame.pixel_from_view(old_from_new * display().ray_in_view(DISPLAY.pixel_centre(pixel))).unwrap())
        .collect();
    let inner = |at: Vec2| {
        let (width, height) = (frame.size.width as f32, frame.size.height as f32);
        at.x > 1.0 && at.y > 1.0 && at.x < width - 1.0 && at.y < height - 1.0
    };
    let beyond = |at: Vec2| at.x < MARGINS.left as f32 || at.y < MARGINS.up as f32;
    let in_band = expected.iter().filter(|&&at| inner(at) && beyond(at)).count();
    assert!(in_band > DISPLAY.pixels() / 5, "{in_band} pixels need the band");
    let mut source = Source::default();
    source.prepare(&tree);
    let mut prepared = Prepared::default();
    prepared.prepare(Level::default(), &tree);
    // Diffuse is the pipeline of specular on a tree of one node.
    for mode in [Mode::Rotation, Mode::Specular] {
        let mut radiance = vec![HOLE; DISPLAY.pixels()];
        if mode == Mode::Rotation {
            rotation::warp(&source, &display_pose, &display(), &mut radiance);
        } else {
            let flows = Specular::default().flows(Level::default(), &prepared, &display_pose, &display());
            radiance = flows[0].iter().map(|flow| flow.extend(1.0) / 256.0).collect();
        }
        for (pixel, (&expected, found)) in expected.iter().zip(&radiance).enumerate() {
            if inner(expected) {
                let found = found.truncate() * 256.0;
                // 1/512 px of rounding to steps of 1/256, and the solver's own 0.01 px.
                assert!((found - expected).abs().max_element() < 0.012, "{mode:?} at {pixel}: {found}, {expected}");
            }
        }
    }
}
