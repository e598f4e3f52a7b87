//! The vector walk against the plain one, and the plain one against what is known in closed form.

use super::phantom::{self, Phantom};
use super::*;
use glam::{DQuat, DVec3, Vec3};
use warplight_protocol::camera::{FieldOfView, ImageSize, Margins};
use warplight_protocol::frame::{Interfaces, Plan, VolumeSegment};

const SIDE_PX: u32 = 128;

fn marched(marcher: &mut Marcher, method: Method, tree: &Tree, pose: &Pose, camera: &Camera) -> Vec<Vec4> {
    let mut out = Vec::new();
    marcher.march(method, tree, pose, camera, None, &mut out);
    assert!(out.iter().all(|found| found.is_finite() && found.w >= 0.0 && found.w <= 1.0));
    out
}

fn prepared(tree: &Tree) -> Marcher {
    let mut marcher = Marcher::default();
    marcher.prepare(tree);
    marcher
}

/// Over radiance and transmittance, white being 1.
fn psnr(a: &[Vec4], b: &[Vec4]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from((*a - *b).length_squared())).sum();
    -10.0 * (sum / (4.0 * a.len() as f64)).log10()
}

/// The pose, moved in its own view and turned by what is given in degrees around x, y and z.
fn moved(pose: Pose, by_m: [f64; 3], turned_degrees: [f64; 3]) -> Pose {
    let [x, y, z] = turned_degrees.map(f64::to_radians);
    let turn = DQuat::from_rotation_y(y) * DQuat::from_rotation_x(x) * DQuat::from_rotation_z(z);
    Pose { position: pose.point_in_world(DVec3::from_array(by_m)), orientation: (pose.orientation * turn).normalize() }
}

/// A frame with one segment per pixel.
fn frame_of(camera: Camera, segment: impl Fn(usize) -> Option<VolumeSegment>) -> Tree {
    let mut tree = Tree::new(Pose::IDENTITY, camera, Plan::diffuse(), Interfaces::default());
    tree.set_layers(1);
    let mut bands = tree.bands_mut(u32::MAX);
    for pixel in 0..camera.size.pixels() {
        bands[0].layers[0].set(pixel, segment(pixel).as_ref());
    }
    drop(bands);
    tree
}

/// A slab of extinction 0.7 per metre from 2 to 3 m before the frame's eye.
fn slab(camera: Camera) -> Tree {
    frame_of(camera, |pixel| {
        let obliquity = camera.ray_in_view(camera.size.pixel_centre(pixel)).length();
        Some(VolumeSegment {
            front_m: 2.0,
            back_m: 3.0,
            optical_depth: 0.7 * obliquity,
            source: Vec3::new(0.5, 1.0, 2.0),
        })
    })
}

#[test]
fn an_unmoved_head_sees_the_pixels_own_segments() {
    let camera = phantom::camera(SIDE_PX);
    for phantom in Phantom::ALL {
        for layers in [1, 3, 4, 8] {
            let tree = phantom.frame(&phantom::orbit(0.0), &camera, layers);
            let mut marcher = prepared(&tree);
            let plain = marched(&mut marcher, Method::Plain, &tree, &tree.render_pose, &camera);
            let packets = marched(&mut marcher, Method::Layers, &tree, &tree.render_pose, &camera);
            for (pixel, found) in plain.iter().enumerate() {
                let mut expected = transport::Transport::default();
                for segment in tree.layers.iter().filter_map(|layer| layer.at(pixel)) {
                    expected.cross(f64::from(segment.optical_depth), segment.source.as_dvec3());
                }
                let expected = expected.radiance.as_vec3().extend(expected.transmittance as f32);
                assert!((*found - expected).abs().max_element() < 1e-5, "{phantom:?}: {found} instead of {expected}");
                // Extinction and radiance of a record have 8 bits of mantissa, and the walk ends at `OPAQUE`.
                let off = (packets[pixel] - expected).abs().max_element();
                assert!(
                    off < 1.0 / 256.0 + packets::OPAQUE,
                    "{phantom:?}, {layers}: {} for {expected}",
                    packets[pixel]
                );
            }
            assert!(psnr(&packets, &plain) > 55.0, "{phantom:?}, {layers}: {} dB", psnr(&packets, &plain));
        }
    }
}

#[test]
fn a_frame_seen_from_its_own_pose_is_the_picture() {
    let camera = phantom::camera(SIDE_PX);
    for phantom in Phantom::ALL {
        let tree = phantom.frame(&phantom::orbit(0.0), &camera, 4);
        let plain = marched(&mut prepared(&tree), Method::Plain, &tree, &tree.render_pose, &camera);
        let truth = phantom.picture(&tree.render_pose, &camera);
        for (found, expected) in plain.iter().zip(&truth) {
            assert!((*found - *expected).abs().max_element() < 1e-5, "{phantom:?}: {found} instead of {expected}");
        }
    }
}

/// Poses from which the slab is seen, whose rays leave it at many angles.
fn poses_around() -> Vec<Pose> {
    let origin = Pose::IDENTITY;
    vec![
        moved(origin, [0.0; 3], [0.0, 12.0, 0.0]),
        moved(origin, [0.5, 0.0, 0.0], [0.0, 10.0, 0.0]),
        moved(origin, [-0.2, 0.3, 0.4], [-7.0, -3.0, 20.0]),
        moved(origin, [0.0, 0.0, 1.3], [0.0; 3]),
        moved(origin, [0.1, 0.0, -1.2], [0.0, 0.0, 45.0]),
        moved(origin, [0.1, 0.1, -2.4], [5.0, 5.0, 0.0]),
        moved(origin, [0.3, -0.1, -4.5], [0.0, 180.0, 0.0]),
    ]
}

#[test]
fn a_homogeneous_slab_is_what_its_closed_form_says_from_everywhere() {
    let camera =
        Camera::perspective(ImageSize::new(96, 80), FieldOfView { left: -0.9, right: 0.7, down: -0.6, up: 0.7 });
    let tree = slab(camera);
    let mut marcher = prepared(&tree);
    let display = Camera::symmetric(0.6, ImageSize::new(40, 30));
    let pinhole = Pinhole::new(&camera);
    let mut compared = 0;
    for pose in poses_around() {
        let plain = marched(&mut marcher, Method::Plain, &tree, &pose, &display);
        let packets = marched(&mut marcher, Method::Layers, &tree, &pose, &display);
        let rays = Rays::new(&tree.render_pose, &pose, &display);
        for (index, (plain, packets)) in plain.iter().zip(&packets).enumerate() {
            let ray = rays.through(index % 40, index / 40);
            let mut ends = [2.0, 3.0].map(|depth| (depth - ray.origin.z) / ray.direction.z);
            ends.sort_by(f64::total_cmp);
            let [enter, exit] = ends.map(|t| t.max(0.0));
            let inside = |t: f64| {
                let pixel = pinhole.pixel(ray.at(t));
                pixel.min_element() > 1.0 && pixel.x < 95.0 && pixel.y < 79.0
            };
            if !(enter < exit && inside(enter) && inside(exit)) {
                continue;
            }
            let opacity = -(-0.7 * (exit - enter) * ray.direction.length()).exp_m1();
            let expected = (DVec3::new(0.5, 1.0, 2.0) * opacity).as_vec3().extend(1.0 - opacity as f32);
            // The frame holds optical depths of whole pixels in floats.
            assert!((*plain - expected).abs().max_element() < 1e-5, "{pose:?} {index}: {plain} instead of {expected}");
            // Records have 8 bits of mantissa; a crossing takes the obliquity of the pixel it fetches, two columns off.
            assert!((*packets - expected).abs().max_element() < 0.012, "{pose:?} {index}: {packets} {expected}");
            compared += 1;
        }
    }
    assert!(compared > 4000, "{compared}");
}

/// Motions of a head around the phantoms; all of them are accepted by the vector walk.
fn motions() -> Vec<(&'static str, Pose)> {
    let start = phantom::orbit(0.0);
    vec![
        ("10 degrees around", phantom::orbit(10.0_f64.to_radians())),
        ("turned", moved(start, [0.0; 3], [3.0, 8.0, 0.0])),
        ("roll", moved(start, [0.0; 3], [0.0, 0.0, 20.0])),
        ("roll and aside", moved(start, [0.1, 0.05, 0.0], [0.0, 0.0, 20.0])),
        ("forward", moved(start, [0.0, 0.0, -0.3], [0.0; 3])),
        ("backward", moved(start, [0.0, 0.0, 0.3], [0.0; 3])),
        ("up", moved(start, [0.0, 0.25, 0.0], [-8.0, 0.0, 0.0])),
        ("aslant", moved(start, [-0.15, 0.2, -0.1], [-6.0, -4.0, 5.0])),
        ("into the matter", moved(start, [0.1, 0.0, -1.3], [0.0, 10.0, 0.0])),
    ]
}

/// At 1024 pixels in a row. What the walk is off by lies along edges and is half a pixel wide there, so that its square
/// falls with the number of pixels in a row.
const LEAST_DB: f64 = 45.0;

/// The same at 128.
const LEAST_DB_OF_SMALL: f64 = LEAST_DB - 9.0;

/// Some rows of a camera, as pixels of its own.
fn strip(camera: Camera, first_row: u32, rows: u32) -> Camera {
    let fov = camera.fov;
    let per_row = (fov.up - fov.down) / camera.size.height as f32;
    let [up, down] = [first_row, first_row + rows].map(|row| fov.up - per_row * row as f32);
    Camera::perspective(ImageSize::new(camera.size.width, rows), FieldOfView { up, down, ..fov })
}

/// As it is used: frames of 1024x1024, and the stride that a marcher has. Compared are 32 rows of each picture, those around the epipole
/// of a head that goes straight on among them.
#[test]
fn the_vector_walk_is_the_plain_walk_on_every_motion() {
    let camera = phantom::camera(1024);
    for phantom in Phantom::ALL {
        let tree = phantom.frame(&phantom::orbit(0.0), &camera, 4);
        let mut marcher = prepared(&tree);
        for (motion, pose) in motions() {
            let (mut plain, mut packets) = (Vec::new(), Vec::new());
            for first_row in [120, 376, 508, 760] {
                let display = strip(camera, first_row, 8);
                plain.extend(marched(&mut marcher, Method::Plain, &tree, &pose, &display));
                let mut out = Vec::new();
                let statistics = marcher.march(Method::Layers, &tree, &pose, &display, None, &mut out);
                assert!(statistics.plain_fraction == 0.0, "{phantom:?} {motion}: {statistics:?}");
                packets.extend(out);
            }
            let found = psnr(&packets, &plain);
            println!("{phantom:?} {motion}: {found:.1} dB");
            assert!(found > LEAST_DB, "{phantom:?} {motion}: {found:.1} dB");
        }
    }
}

#[test]
fn every_level_walks_alike() {
    let camera = phantom::camera(SIDE_PX);
    let tree = Phantom::Ct.frame(&phantom::orbit(0.0), &camera, 5);
    for (motion, pose) in motions() {
        let pictures: Vec<Vec<Vec4>> = (0..Marcher::levels())
            .map(|level| {
                let mut marcher = Marcher::default();
                marcher.set_level(level);
                marcher.set_stride(1.0);
                marcher.prepare(&tree);
                marched(&mut marcher, Method::Layers, &tree, &pose, &camera)
            })
            .collect();
        for (level, picture) in pictures.iter().enumerate() {
            // Packets of other widths have planes elsewhere; lanes alike differ by rounding alone.
            let found = psnr(picture, &pictures[0]);
            assert!(found > 33.0, "{motion}, level {level}: {found:.1} dB");
        }
    }
}

#[test]
fn a_narrower_display_sees_the_middle_of_a_wider_frame() {
    let display =
        Camera::perspective(ImageSize::new(90, 70), FieldOfView { left: -0.5, right: 0.4, down: -0.3, up: 0.4 });
    let camera = display.widened(Margins { left: 13, right: 6, down: 9, up: 11 });
    let tree = Phantom::Cube.frame(&phantom::orbit(0.0), &camera, 2);
    let mut marcher = prepared(&tree);
    for method in [Method::Plain, Method::Layers] {
        let whole = marched(&mut marcher, method, &tree, &tree.render_pose, &camera);
        let part = marched(&mut marcher, method, &tree, &tree.render_pose, &display);
        for (index, found) in part.iter().enumerate() {
            let expected = whole[(index / 90 + 11) * camera.size.width as usize + index % 90 + 13];
            assert!((*found - expected).abs().max_element() < 2e-5, "{method:?} {index}: {found} {expected}");
        }
    }
}

#[test]
fn a_surface_ends_the_rays() {
    let camera = Camera::symmetric(0.8, ImageSize::new(33, 31));
    let tree = slab(camera);
    let mut marcher = prepared(&tree);
    let pose = moved(Pose::IDENTITY, [0.3, 0.0, 0.2], [0.0, 6.0, 3.0]);
    let rays = Rays::new(&tree.render_pose, &pose, &camera);
    // Half of the slab, nothing of it, all of it.
    for (depth_m, is_reached) in [(2.5, true), (1.9, false), (1e9, true)] {
        let distance = |index: usize| {
            let ray = rays.through(index % 33, index / 33);
            ((depth_m - ray.origin.z) / ray.direction.z * ray.direction.length()) as f32
        };
        let surface_m: Vec<f32> = (0..camera.size.pixels()).map(distance).collect();
        let [mut plain, mut packets, mut free] = [const { Vec::new() }; 3];
        marcher.march(Method::Plain, &tree, &pose, &camera, Some(&surface_m), &mut plain);
        marcher.march(Method::Layers, &tree, &pose, &camera, Some(&surface_m), &mut packets);
        marcher.march(Method::Plain, &tree, &pose, &camera, None, &mut free);
        let mut compared = 0;
        for (index, ((plain, packets), free)) in plain.iter().zip(&packets).zip(&free).enumerate() {
            let ray = rays.through(index % 33, index / 33);
            let opacity_to = |part: f64| -(-0.7 * part / ray.direction.z * ray.direction.length()).exp_m1();
            let expected = opacity_to(if is_reached { depth_m.min(3.0) - 2.0 } else { 0.0 });
            // At the edges of the frame a ray is not in the slab for its whole depth.
            if (f64::from(free.w) - 1.0 + opacity_to(1.0)).abs() < 1e-5 {
                assert!((f64::from(plain.w) - 1.0 + expected).abs() < 1e-5, "{depth_m}: {plain} {expected}");
                assert!((*plain - *packets).abs().max_element() < 0.012, "{depth_m}: {plain} {packets}");
                compared += 1;
            }
        }
        assert!(compared > 400, "{compared}");
    }
}

#[test]
fn rays_across_the_view_are_left_to_the_plain_walk() {
    let camera = phantom::camera(SIDE_PX);
    let tree = Phantom::Cloud.frame(&phantom::orbit(0.0), &camera, 4);
    let mut marcher = prepared(&tree);
    let pose = phantom::orbit(80.0_f64.to_radians());
    let plain = marched(&mut marcher, Method::Plain, &tree, &pose, &camera);
    let mut out = Vec::new();
    let statistics = marcher.march(Method::Layers, &tree, &pose, &camera, None, &mut out);
    assert!(statistics.plain_fraction > 0.1 && statistics.plain_fraction < 0.9, "{statistics:?}");
    assert!(out.iter().all(|found| found.is_finite()));
    assert!(psnr(&out, &plain) > LEAST_DB_OF_SMALL, "{} dB", psnr(&out, &plain));
    // From behind, forwards through the layers from the last on.
    let pose = phantom::orbit(std::f64::consts::PI);
    let plain = marched(&mut marcher, Method::Plain, &tree, &pose, &camera);
    let packets = marched(&mut marcher, Method::Layers, &tree, &pose, &camera);
    assert!(plain.iter().any(|found| found.w < 0.5));
    assert!(psnr(&packets, &plain) > LEAST_DB_OF_SMALL, "from behind: {} dB", psnr(&packets, &plain));
}

#[test]
fn what_is_no_segment_is_nothing() {
    let camera = Camera::symmetric(0.8, ImageSize::new(20, 20));
    let good = VolumeSegment { front_m: 2.0, back_m: 3.0, optical_depth: 1.0, source: Vec3::ONE };
    let bad = [
        VolumeSegment { front_m: f32::NAN, ..good },
        VolumeSegment { back_m: f32::INFINITY, ..good },
        VolumeSegment { front_m: -1.0, ..good },
        VolumeSegment { front_m: 3.0, back_m: 2.0, ..good },
        VolumeSegment { front_m: 2.5, back_m: 2.5, ..good },
        VolumeSegment { optical_depth: f32::NAN, ..good },
        VolumeSegment { optical_depth: f32::INFINITY, ..good },
        VolumeSegment { source: Vec3::splat(f32::NAN), ..good },
        VolumeSegment { source: Vec3::splat(f32::INFINITY), ..good },
    ];
    let tree = frame_of(camera, |pixel| Some(if pixel % 3 == 0 { good } else { bad[pixel % bad.len()] }));
    let empty = frame_of(camera, |_| None);
    let pose = moved(Pose::IDENTITY, [0.2, 0.1, 0.3], [0.0, 3.0, 30.0]);
    let mut marcher = Marcher::default();
    for method in Method::ALL {
        marcher.prepare(&tree);
        let found = marched(&mut marcher, method, &tree, &pose, &camera);
        assert!(found.iter().any(|found| found.w < 0.9), "{method:?} shows what is good");
        marcher.prepare(&empty);
        let found = marched(&mut marcher, method, &empty, &pose, &camera);
        assert!(found.iter().all(|found| *found == Vec4::W), "{method:?} shows nothing");
    }
}

/// A frame that is a surface: there all methods are right.
#[test]
fn the_baselines_show_an_opaque_plane_where_it_is() {
    let camera = Camera::symmetric(0.9, ImageSize::new(96, 96));
    let stripes = |pixel: usize| Vec3::splat(0.5 + 0.4 * ((pixel % 96) as f32 * 0.2).sin());
    let tree = frame_of(camera, |pixel| {
        Some(VolumeSegment { front_m: 1.999, back_m: 2.001, optical_depth: 50.0, source: stripes(pixel) })
    });
    let mut marcher = prepared(&tree);
    let pose = moved(Pose::IDENTITY, [0.15, 0.05, 0.1], [0.0, 2.0, 0.0]);
    let truth = marched(&mut marcher, Method::Plain, &tree, &pose, &camera);
    for method in [Method::Slabs, Method::MeanDepth] {
        let found = marched(&mut marcher, method, &tree, &pose, &camera);
        for row in 10..86 {
            for column in 10..80 {
                let (a, b) = (truth[row * 96 + column], found[row * 96 + column]);
                // A pixel aside is 0.08 in radiance.
                assert!((a - b).abs().max_element() < 0.09, "{method:?} {column} {row}: {b} instead of {a}");
            }
        }
        let unmoved = marched(&mut marcher, method, &tree, &tree.render_pose, &camera);
        let own = marched(&mut marcher, Method::Plain, &tree, &tree.render_pose, &camera);
        assert!(psnr(&unmoved, &own) > 60.0, "{method:?}: {} dB", psnr(&unmoved, &own));
    }
}

#[test]
fn layers_are_nearer_to_the_truth_than_the_baselines() {
    let camera = phantom::camera(256);
    let pose = phantom::orbit(10.0_f64.to_radians());
    for phantom in Phantom::ALL {
        let tree = phantom.frame(&phantom::orbit(0.0), &camera, 4);
        let truth = phantom.picture(&pose, &camera);
        let mut marcher = prepared(&tree);
        let [layers, slabs, mean_depth] = [Method::Layers, Method::Slabs, Method::MeanDepth]
            .map(|method| psnr(&marched(&mut marcher, method, &tree, &pose, &camera), &truth));
        assert!(layers > slabs && layers > mean_depth, "{phantom:?}: {layers:.1}, {slabs:.1}, {mean_depth:.1} dB");
    }
}
