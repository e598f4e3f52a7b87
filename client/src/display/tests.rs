//! Closed forms: a plane in focus, the circle of confusion, the parallax of two eyes.

use super::*;
use glam::{DQuat, DVec3, Vec2};
use std::time::Duration;
use warplight_protocol::ImageSize;
use warplight_protocol::frame::{Interfaces, Plan};

const SIZE: ImageSize = ImageSize::new(128, 96);

fn camera() -> Camera {
    Camera::symmetric(1.1, SIZE)
}

fn head() -> Pose {
    Pose { position: DVec3::new(3.0, -2.0, 1.0), orientation: DQuat::from_euler(glam::EulerRot::YXZ, 0.4, 0.1, -0.2) }
}

/// A wall at depth `depth_m` that faces the head, painted by pixel.
fn wall(depth_m: f32, paint: impl Fn(Vec2) -> Vec3) -> Tree {
    let mut tree = Tree::new(head(), camera(), Plan::diffuse(), Interfaces::default());
    for pixel in 0..SIZE.pixels() {
        let centre = SIZE.pixel_centre(pixel);
        tree.nodes[0].distance[pixel] = camera().ray_in_view(centre).length() * depth_m;
        tree.nodes[0].set_radiance(pixel, paint(centre));
    }
    tree
}

fn smooth(at: Vec2) -> Vec3 {
    Vec3::new(
        0.5 + 0.3 * (0.11 * at.x).sin(),
        0.5 + 0.3 * (0.09 * at.y).cos(),
        0.4 + 0.2 * (0.05 * (at.x + at.y)).sin(),
    )
}

fn shown(optics: &Optics, tree: &Tree, eye: Eye, mode: Mode, head_before: impl Fn(f64) -> Pose) -> RgbImage {
    let (mut warper, mut display, mut views, mut picture) =
        (Warper::default(), Display::default(), Vec::new(), RgbImage::default());
    optics.views(eye, head_before, &camera(), &mut views);
    warper.prepare(mode, tree);
    let statistics = display.show(optics, &mut warper, mode, tree, &views, 1.0, &mut picture);
    assert!((0.0..=1.0).contains(&statistics.hole_fraction));
    picture
}

fn inner() -> impl Iterator<Item = (u32, u32)> {
    (24..SIZE.height - 24).flat_map(|y| (24..SIZE.width - 24).map(move |x| (x, y)))
}

#[test]
fn without_optics_it_is_the_pinholes_picture_to_the_bit() {
    let tree = wall(2.0, smooth);
    let aside = Pose { position: head().position + DVec3::X * 0.03, ..head() };
    for mode in Mode::ALL {
        let (mut warper, mut expected) = (Warper::default(), RgbImage::default());
        warper.prepare(mode, &tree);
        warper.show(mode, &tree, &aside, &camera(), 1.0, &mut expected);
        assert!(shown(&Optics::default(), &tree, Eye::Middle, mode, |_| aside) == expected, "{mode:?}");
    }
}

#[test]
fn a_plane_in_focus_stays_sharp() {
    let lens = Lens { aperture_m: 0.04, focus_m: 2.0, samples: 24 };
    let optics = Optics { lens: Some(lens), ..Optics::default() };
    let tree = wall(2.0, smooth);
    let pinhole = shown(&Optics::default(), &tree, Eye::Middle, Mode::Diffuse, |_| head());
    let through_lens = shown(&optics, &tree, Eye::Middle, Mode::Diffuse, |_| head());
    for (x, y) in inner() {
        for channel in 0..3 {
            let codes = [&pinhole, &through_lens].map(|picture| picture.get_pixel(x, y).0[channel]);
            // Flows are good to 0.01 px, and no channel changes by more than 13 codes a pixel.
            assert!(codes[0].abs_diff(codes[1]) <= 1, "{x}, {y}: {codes:?}");
        }
    }
}

/// A bright point out of focus becomes a disc of the diameter `aperture |1/focus - 1/depth|` in tangents.
#[test]
fn a_point_out_of_focus_is_its_circle_of_confusion() {
    let (depth_m, focus_m, aperture_m) = (1.0, 4.0, 0.1);
    let middle = Vec2::new(64.5, 48.5);
    let tree = wall(depth_m, |at| if (at - middle).length() < 0.1 { Vec3::ONE } else { Vec3::ZERO });
    let lens = Lens { aperture_m: f64::from(aperture_m), focus_m: f64::from(focus_m), samples: 400 };
    let (mut warper, mut views) = (Warper::default(), Vec::new());
    Optics { lens: Some(lens), ..Optics::default() }.views(Eye::Middle, |_| head(), &camera(), &mut views);
    warper.prepare(Mode::Diffuse, &tree);
    let (mut sum, mut sample) = (vec![Vec3::ZERO; SIZE.pixels()], Vec::new());
    for view in &views {
        warper.radiance(Mode::Diffuse, &tree, &view.pose, &view.camera, &mut sample);
        sum.iter_mut().zip(&sample).for_each(|(sum, sample)| *sum += *sample / views.len() as f32);
    }
    let radius_px = 0.5 * aperture_m * (1.0 / depth_m - 1.0 / focus_m) * camera().focal_px().x;
    assert!(radius_px > 2.5, "{radius_px}");
    let (mut total, mut second, mut first) = (0.0, 0.0, Vec2::ZERO);
    for (pixel, radiance) in sum.iter().enumerate() {
        let off = SIZE.pixel_centre(pixel) - middle;
        total += radiance.x;
        first += off * radiance.x;
        second += off.length_squared() * radiance.x;
        // Bilinear fetches spread the point by less than a pixel each way.
        assert!(radiance.x == 0.0 || off.length() < radius_px + 1.5, "{off}");
    }
    // A texel is as much light as a pixel, and a disc's second moment is half its squared radius; the tent of the
    // bilinear fetch adds 1/6 for each axis.
    assert!((total - 1.0).abs() < 0.02 && (first / total).length() < 0.05, "{total} {first}");
    let expected = 0.5 * radius_px * radius_px + 1.0 / 3.0;
    assert!((second / total / expected - 1.0).abs() < 0.05, "{} {expected}", second / total);
}

#[test]
fn two_eyes_see_a_wall_shifted_by_its_parallax() {
    let (depth_m, distance_m) = (1.5_f32, 0.063_f32);
    let optics = Optics { eye_distance_m: Some(f64::from(distance_m)), ..Optics::default() };
    assert_eq!(optics.eyes(), [Eye::Left, Eye::Right]);
    // A ramp along the rows: codes tell positions.
    let tree = wall(depth_m, |at| Vec3::splat(warplight_protocol::tone::linear_from_srgb8(20 + at.x as u8)));
    let [left, right] = [Eye::Left, Eye::Right].map(|eye| shown(&optics, &tree, eye, Mode::Diffuse, |_| head()));
    let parallax_px = distance_m / depth_m * camera().focal_px().x;
    for (x, y) in inner() {
        let [left, right] = [&left, &right].map(|picture| f32::from(picture.get_pixel(x, y).0[0]));
        // The left eye sees the wall further to the right: what it shows at a place lies further left. One code a
        // pixel, rounded at either end.
        assert!((right - left - parallax_px).abs() <= 1.0, "{x}, {y}: {left} {right}, {parallax_px}");
    }
    assert_eq!(beside(&left, &right).dimensions(), (256, 96));
    assert_eq!(beside(&left, &right).get_pixel(130, 7), right.get_pixel(2, 7));
}

#[test]
fn a_shutter_at_rest_changes_nothing_and_one_in_motion_blurs_along_it() {
    let shutter = Shutter { open: Duration::from_millis(20), samples: 8 };
    let optics = Optics { shutter: Some(shutter), ..Optics::default() };
    let edge = wall(1.0, |at| if at.x < 64.0 { Vec3::ONE } else { Vec3::ZERO });
    let rest = shown(&optics, &edge, Eye::Middle, Mode::Rotation, |_| head());
    assert!(rest == shown(&Optics::default(), &edge, Eye::Middle, Mode::Rotation, |_| head()));
    // 8 px over the time it is open, past the edge: the mean of a step over the way is a ramp of that length.
    let focal = f64::from(camera().focal_px().x);
    let turned = |before_secs: f64| {
        let angle = 8.0 / focal * before_secs / 0.020;
        Pose { orientation: head().orientation * DQuat::from_rotation_y(angle), ..head() }
    };
    let (mut views, mut warper) = (Vec::new(), Warper::default());
    optics.views(Eye::Middle, turned, &camera(), &mut views);
    assert_eq!(views.len(), 8);
    warper.prepare(Mode::Rotation, &edge);
    let (mut sum, mut sample) = ([0.0; SIZE.width as usize], Vec::new());
    for view in &views {
        warper.radiance(Mode::Rotation, &edge, &view.pose, &view.camera, &mut sample);
        let row = 48 * SIZE.width as usize;
        (0..sum.len()).for_each(|x| sum[x] += sample[row + x].x / 8.0);
    }
    // The head turned left further back, so the edge was further right: at x + 0.5 the light has gone with the
    // progress of (x + 0.5 - 64) / 8. Eight samples are steps of 1/8, a bilinear fetch spreads by another.
    for (x, &found) in sum.iter().enumerate().skip(58).take(22) {
        let expected = (1.0 - (x as f32 + 0.5 - 64.0) / 8.0).clamp(0.0, 1.0);
        assert!((found - expected).abs() < 0.13, "{x}: {found} {expected}");
    }
}
