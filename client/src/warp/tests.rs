//! Oracles: the unmoved head, the homography, the closed form of a plane.

use super::prepared::Prepared;
use super::*;
use crate::stability::bound;
use glam::{DQuat, DVec3, Vec2};
use warplight_protocol::ImageSize;
use warplight_protocol::frame::{Interfaces, Plan, flatten};
use warplight_protocol::optics::Interface;
use warplight_protocol::tone::display_from_radiance;

pub(super) const SIZE: ImageSize = ImageSize::new(96, 64);

pub(super) fn camera() -> Camera {
    Camera::symmetric(1.2, SIZE)
}

/// A smooth picture: linear in the direction to the texture coordinate, so that bilinear sampling of a small
/// step is nearly exact.
fn smooth(at: Vec2) -> Vec3 {
    Vec3::new(0.5 + 0.3 * (0.9 * at.x).sin(), 0.5 + 0.3 * (0.7 * at.y).cos(), 0.4 + 0.2 * (0.5 * (at.x + at.y)).sin())
}

/// A tilted plane `n . p = d` in view, textured by its x and y in view; returns texture position and distance.
fn on_plane(ray: Vec3, normal: Vec3, offset: f32) -> (Vec2, f32) {
    let depth = offset / ray.dot(normal);
    let point = ray * depth;
    (point.truncate(), point.length())
}

const NORMAL: Vec3 = Vec3::new(0.2, 0.1, -1.0);
const OFFSET: f32 = 3.0;

fn plane_tree(pose: Pose) -> Tree {
    let mut tree = Tree::new(pose, camera(), Plan::diffuse(), Interfaces::default());
    for pixel in 0..SIZE.pixels() {
        let (texture, distance) = on_plane(camera().ray_in_view(SIZE.pixel_centre(pixel)), NORMAL, OFFSET);
        tree.nodes[0].set_radiance(pixel, smooth(texture));
        tree.nodes[0].distance[pixel] = distance;
    }
    tree
}

/// Depths, skies, mirrors and glass without order: everything the identity must survive.
fn wild_tree(pose: Pose) -> Tree {
    let interfaces = Interfaces(vec![
        Interface::Mirror,
        Interface::Dielectric { eta: 1.5 },
        Interface::Dielectric { eta: 1.0 / 1.5 },
    ]);
    let mut tree = Tree::new(pose, camera(), Plan::solid(), interfaces);
    let mut random = rand_pcg::Pcg32::new(7, 11);
    let mut uniform = || {
        use rand_pcg::rand_core::Rng;
        random.next_u32() as f32 / u32::MAX as f32
    };
    for pixel in 0..SIZE.pixels() {
        for node in 0..4 {
            let radiance = Vec3::new(uniform(), uniform(), uniform());
            let distance = if uniform() < 0.1 { f32::INFINITY } else { 0.2 + 20.0 * uniform() };
            tree.nodes[node].set_radiance(pixel, radiance);
            tree.nodes[node].distance[pixel] = if node > 0 && uniform() < 0.3 { 0.0 } else { distance };
            if node == 0 || node == 2 {
                tree.nodes[node].interface[pixel] = (uniform() * 4.0).min(3.0) as u8;
                let normal = Vec3::new(uniform() - 0.5, uniform() - 0.5, 1.0).normalize();
                tree.nodes[node].set_normal(pixel, normal);
            }
        }
    }
    tree
}

pub(super) fn pose() -> Pose {
    Pose { position: DVec3::new(100.3, -7.1, 1e4), orientation: DQuat::from_euler(glam::EulerRot::YXZ, 0.7, -0.3, 0.2) }
}

/// The flattened picture, tone-mapped: the server's image.
fn image_of(tree: &Tree, exposure: f32) -> RgbImage {
    let mut radiance = vec![Vec3::ZERO; SIZE.pixels()];
    flatten(tree, 0..SIZE.pixels(), &mut radiance);
    let codes = radiance.iter().flat_map(|&radiance| display_from_radiance(radiance, exposure)).collect();
    RgbImage::from_raw(SIZE.width, SIZE.height, codes).unwrap()
}

#[test]
fn an_unmoved_head_sees_the_servers_image_to_the_bit() {
    for tree in [plane_tree(pose()), wild_tree(pose())] {
        let mut warper = Warper::default();
        for mode in Mode::ALL {
            let mut picture = RgbImage::default();
            warper.prepare(mode, &tree);
            let statistics = warper.show(mode, &tree, &tree.render_pose, &camera(), 0.8, &mut picture);
            assert_eq!(statistics.hole_fraction, 0.0, "{mode:?}");
            assert!(picture == image_of(&tree, 0.8), "{mode:?}");
        }
    }
}

/// Position in the old picture that a mode shows (of mode `diffuse` the plain form) at each pixel of the new one, found by warping a picture of
/// its own coordinates.
pub(super) fn flow_of(mode: Mode, tree: &Tree, display_pose: &Pose) -> Vec<Option<Vec2>> {
    let mut coordinates = tree.clone();
    for pixel in 0..SIZE.pixels() {
        coordinates.nodes[0].set_radiance(pixel, SIZE.pixel_centre(pixel).extend(0.0));
    }
    let mut source = Source::default();
    source.prepare(&coordinates);
    let mut radiance = vec![HOLE; SIZE.pixels()];
    match mode {
        Mode::None => rotation::warp(&source, source.pose(), &camera(), &mut radiance),
        Mode::Rotation => rotation::warp(&source, display_pose, &camera(), &mut radiance),
        Mode::Planar => {
            planar::warp(&source, planar::mean_inverse_depth(&source), display_pose, &camera(), &mut radiance);
        }
        Mode::Mesh => mesh::warp(&source, display_pose, &camera(), &mut mesh::Relief::default(), &mut radiance),
        Mode::Diffuse => {
            diffuse::warp(&source, display_pose, &camera(), &mut diffuse::Splat::default(), &mut radiance);
        }
        // Of surfaces these are mode `specular`.
        Mode::Specular | Mode::Slabs | Mode::MeanDepth => {
            let mut prepared = Prepared::default();
            prepared.prepare(Level::default(), tree);
            let flows = Specular::default().flows(Level::default(), &prepared, display_pose, &camera());
            return flows[0].iter().map(|flow| (!flow.is_nan()).then_some(*flow)).collect();
        }
    }
    radiance.into_iter().map(|value| (!value.is_nan()).then(|| value.truncate())).collect()
}

/// Away from the border, where half a pixel of the picture is repeated.
fn is_inner(pixel: Vec2) -> bool {
    pixel.x > 1.0 && pixel.y > 1.0 && pixel.x < SIZE.width as f32 - 1.0 && pixel.y < SIZE.height as f32 - 1.0
}

#[test]
fn a_turned_head_sees_the_homography() {
    let tree = plane_tree(pose());
    let turn = DQuat::from_euler(glam::EulerRot::YXZ, 0.05, 0.03, 0.08);
    let display_pose = Pose { orientation: tree.render_pose.orientation * turn, ..tree.render_pose };
    let old_from_new = tree.render_pose.view_from(&display_pose).rotation;
    for mode in Mode::ALL.into_iter().filter(|&mode| mode != Mode::None) {
        let (mut compared, mut worst) = (0, 0.0_f32);
        for (pixel, found) in flow_of(mode, &tree, &display_pose).into_iter().enumerate() {
            let ray = old_from_new * camera().ray_in_view(SIZE.pixel_centre(pixel));
            let expected = camera().pixel_from_view(ray).unwrap();
            if is_inner(expected) {
                worst = worst.max((found.expect("no hole inside") - expected).abs().max_element());
                compared += 1;
            }
        }
        assert!(compared > SIZE.pixels() / 2);
        assert!(worst < 0.01, "{mode:?}: {worst} px");
    }
}

#[test]
fn a_plane_seen_from_aside_is_its_closed_form() {
    let tree = plane_tree(pose());
    let aside = DVec3::new(0.05, -0.03, 0.04);
    let display_pose =
        Pose { position: tree.render_pose.position + tree.render_pose.orientation * aside, ..tree.render_pose };
    for mode in [Mode::Diffuse, Mode::Mesh, Mode::Specular] {
        let (mut compared, mut worst) = (0, 0.0_f32);
        for (pixel, found) in flow_of(mode, &tree, &display_pose).into_iter().enumerate() {
            // The new ray meets the plane where n . (aside + s ray) = d; the old picture shows that point there.
            let ray = camera().ray_in_view(SIZE.pixel_centre(pixel));
            let reach = (OFFSET - NORMAL.dot(aside.as_vec3())) / NORMAL.dot(ray);
            let expected = camera().pixel_from_view(aside.as_vec3() + ray * reach).unwrap();
            if is_inner(expected) {
                worst = worst.max((found.expect("no hole inside") - expected).abs().max_element());
                compared += 1;
            }
        }
        assert!(compared > SIZE.pixels() / 2);
        assert!(worst < 0.01, "{mode:?}: {worst} px");
    }
}

#[test]
fn what_stands_in_front_hides_and_what_it_hid_is_a_hole() {
    // A near square before a far wall; the head moves right by as much as shifts the square by 8 pixels.
    let focal = camera().focal_px().x;
    let (near, far) = (1.0_f32, 1e6_f32);
    let mut tree = Tree::new(Pose::IDENTITY, camera(), Plan::diffuse(), Interfaces::default());
    let is_square = |x: usize, y: usize| (40..56).contains(&x) && (20..40).contains(&y);
    for pixel in 0..SIZE.pixels() {
        let (x, y) = (pixel % 96, pixel / 96);
        let depth = if is_square(x, y) { near } else { far };
        let ray = camera().ray_in_view(SIZE.pixel_centre(pixel));
        tree.nodes[0].distance[pixel] = ray.length() * depth;
        tree.nodes[0].set_radiance(pixel, if is_square(x, y) { Vec3::X } else { Vec3::Y });
    }
    let display_pose = Pose { position: DVec3::X * f64::from(8.0 * near / focal), ..Pose::IDENTITY };
    let mut source = Source::default();
    source.prepare(&tree);
    let mut radiance = vec![HOLE; SIZE.pixels()];
    diffuse::warp(&source, &display_pose, &camera(), &mut diffuse::Splat::default(), &mut radiance);
    let flow = flow_of(Mode::Specular, &tree, &display_pose);
    for y in 22..38 {
        for x in 0..96 {
            let found = flow[y * 96 + x].map(|flow| flow.x - x as f32 - 0.5);
            match x {
                32..48 => assert!((found.unwrap() - 8.0).abs() < 1e-3, "square at {x}, {y}: {found:?}"),
                48..56 => assert_eq!(found, None, "disoccluded at {x}, {y}"),
                _ => assert!(found.unwrap().abs() < 1e-3, "wall at {x}, {y}: {found:?}"),
            }
        }
    }
    for y in 22..38 {
        for x in 0..96 {
            let shown = radiance[y * 96 + x];
            match x {
                32..48 => assert_eq!(shown, Vec3::X, "square at {x}, {y}"),
                48..56 => assert!(shown.is_nan(), "disoccluded at {x}, {y}: {shown}"),
                _ => assert_eq!(shown, Vec3::Y, "wall at {x}, {y}"),
            }
        }
    }
}

#[test]
fn diffuse_in_vectors_is_diffuse_in_plain_code() {
    let tree = plane_tree(pose());
    let display_pose = Pose { position: tree.render_pose.position + DVec3::new(0.03, 0.02, -0.04), ..tree.render_pose };
    let (mut source, mut plain) = (Source::default(), vec![HOLE; SIZE.pixels()]);
    source.prepare(&tree);
    diffuse::warp(&source, &display_pose, &camera(), &mut diffuse::Splat::default(), &mut plain);
    let (mut warper, mut radiance) = (Warper::default(), Vec::new());
    warper.prepare(Mode::Diffuse, &tree);
    warper.radiance(Mode::Diffuse, &tree, &display_pose, &camera(), &mut radiance);
    let known = || plain.iter().zip(&radiance).filter(|(plain, _)| !plain.is_nan());
    let worst = known().map(|(plain, fast)| (*plain - *fast).abs().max_element()).fold(0.0, f32::max);
    // Two steps of a 256th of a texel where the picture changes by 0.05 per texel, and textures of 12 bits.
    assert!(known().count() > SIZE.pixels() * 9 / 10 && worst < 1e-3, "{worst}");
}

/// A ball-less room: a mirror that fills the view, black but for what it reflects, and before it a near square.
fn square_before_a_mirror() -> (Tree, Pose) {
    let mut tree = Tree::new(Pose::IDENTITY, camera(), Plan::mirror(), Interfaces(vec![Interface::Mirror]));
    for pixel in 0..SIZE.pixels() {
        let (x, y) = (pixel % 96, pixel / 96);
        let is_square = (40..56).contains(&x) && (20..40).contains(&y);
        let ray = camera().ray_in_view(SIZE.pixel_centre(pixel));
        tree.nodes[0].distance[pixel] = ray.length() * if is_square { 1.0 } else { 4.0 };
        if is_square {
            tree.nodes[0].set_radiance(pixel, Vec3::X);
        } else {
            tree.nodes[0].interface[pixel] = 1;
            tree.nodes[0].set_normal(pixel, Vec3::Z);
            tree.nodes[1].distance[pixel] = 1e3;
            tree.nodes[1].set_radiance(pixel, Vec3::Y);
        }
    }
    let aside = f64::from(8.0 / camera().focal_px().x);
    (tree, Pose { position: DVec3::X * aside, ..Pose::IDENTITY })
}

#[test]
fn what_is_uncovered_before_a_mirror_is_filled_with_what_the_mirror_shows() {
    let (tree, display_pose) = square_before_a_mirror();
    let (mut warper, mut radiance) = (Warper::default(), Vec::new());
    warper.prepare(Mode::Specular, &tree);
    let statistics = warper.radiance(Mode::Specular, &tree, &display_pose, &camera(), &mut radiance);
    assert!(statistics.nodes[0].filled > 0.01, "{statistics:?}");
    for y in 24..36 {
        for x in 49..54 {
            let shown = radiance[y * 96 + x];
            assert!((shown - Vec3::Y).abs().max_element() < 0.05, "{x}, {y}: {shown}");
        }
    }
}

#[test]
fn an_earlier_frame_knows_what_the_latest_does_not() {
    let (latest, display_pose) = square_before_a_mirror();
    // Before, the square was not there, and the mirror showed something else.
    let mut earlier = latest.clone();
    earlier.render_pose.position.y = 1e-4;
    for pixel in 0..SIZE.pixels() {
        let ray = camera().ray_in_view(SIZE.pixel_centre(pixel));
        earlier.nodes[0].distance[pixel] = ray.length() * 4.0;
        earlier.nodes[0].set_radiance(pixel, Vec3::ZERO);
        earlier.nodes[0].interface[pixel] = 1;
        earlier.nodes[0].set_normal(pixel, Vec3::Z);
        earlier.nodes[1].distance[pixel] = 1e3;
        earlier.nodes[1].set_radiance(pixel, Vec3::Z);
    }
    let (mut warper, mut radiance) = (Warper::default(), Vec::new());
    warper.set_earlier_frames(1);
    warper.prepare(Mode::Specular, &earlier);
    warper.prepare(Mode::Specular, &latest);
    let statistics = warper.radiance(Mode::Specular, &latest, &display_pose, &camera(), &mut radiance);
    // Two columns at the border are in neither.
    assert!((statistics.hole_fraction - 2.0 / 96.0).abs() < 1e-3, "{statistics:?}");
    for y in 24..36 {
        assert!((radiance[y * 96 + 52] - Vec3::Z).abs().max_element() < 1e-3, "{}", radiance[y * 96 + 52]);
        assert!((radiance[y * 96 + 20] - Vec3::Y).abs().max_element() < 1e-3, "{}", radiance[y * 96 + 20]);
    }
    warper.forget();
    warper.prepare(Mode::Specular, &latest);
    assert!(warper.radiance(Mode::Specular, &latest, &display_pose, &camera(), &mut radiance).hole_fraction > 0.035);
}

#[test]
fn a_display_that_is_part_of_the_frame_shows_that_part_to_the_bit() {
    let tree = wild_tree(pose());
    let whole = image_of(&tree, 0.8);
    let (focal, centre) = (camera().focal_px(), camera().centre_px());
    let (left, above, size) = (9, 5, ImageSize::new(70, 44));
    let (right, below) = (left + size.width, above + size.height);
    let fov = warplight_protocol::FieldOfView {
        left: (left as f32 - centre.x) / focal.x,
        right: (right as f32 - centre.x) / focal.x,
        down: (centre.y - below as f32) / focal.y,
        up: (centre.y - above as f32) / focal.y,
    };
    let display = Camera::perspective(size, fov);
    for mode in [Mode::Diffuse, Mode::Specular] {
        let (mut warper, mut picture) = (Warper::default(), RgbImage::default());
        warper.prepare(mode, &tree);
        warper.show(mode, &tree, &tree.render_pose, &display, 0.8, &mut picture);
        for (x, y, color) in picture.enumerate_pixels() {
            assert_eq!(color, whole.get_pixel(x + left, y + above), "{mode:?} {x}, {y}");
        }
    }
}

#[test]
fn nothing_infinite_or_undefined_leaves_the_warp() {
    let mut warper = Warper::default();
    let mut picture = RgbImage::default();
    for tree in [plane_tree(pose()), wild_tree(pose())] {
        for turn in [0.1, 1.5, std::f64::consts::PI] {
            let display_pose = Pose {
                position: tree.render_pose.position + DVec3::new(0.5, 0.1, 3.0),
                orientation: tree.render_pose.orientation * DQuat::from_rotation_y(turn),
            };
            for mode in Mode::ALL {
                warper.prepare(mode, &tree);
                let statistics = warper.show(mode, &tree, &display_pose, &camera(), 1.0, &mut picture);
                assert!((0.0..=1.0).contains(&statistics.hole_fraction));
            }
        }
    }
}

/// A mirror behind which all is infinitely far, behind which nothing is known, of which only single texels are, and one that
/// bends so that a point is seen in it twice; from where the mirror's texels lie beside the picture, too.
#[test]
fn stability_specular_flow() {
    let mut undefined = bound!("specular flow", "channels of a picture that are no number, infinite or negative", 0.0);
    let mut uncounted =
        bound!("specular flow", "pictures of a mirror that knows nothing in which that is not counted", 0.0);
    let solvers = [
        Solver::default(),
        Solver::FrozenDistance { steps: Some(255) },
        Solver::GaussNewton { steps: 30 },
        Solver::Descent { steps: 100 },
        Solver::ImageDistance,
        Solver::Unfolded,
    ];
    for case in ["flat energy", "no valid neighbour", "single texels", "two optima"] {
        let mut tree = Tree::new(pose(), camera(), Plan::mirror(), Interfaces(vec![Interface::Mirror]));
        for pixel in 0..SIZE.pixels() {
            let at = SIZE.pixel_centre(pixel) / Vec2::new(96.0, 64.0) - 0.5;
            tree.nodes[0].distance[pixel] = camera().ray_in_view(SIZE.pixel_centre(pixel)).length() * 2.0;
            tree.nodes[0].interface[pixel] = 1;
            // Concave across and convex along: what is reflected at the left is reflected at the right again.
            let bent = Vec3::new((12.0 * at.x).sin() * 0.5, 2.0 * at.y, 1.0).normalize();
            tree.nodes[0].set_normal(pixel, if case == "two optima" { bent } else { Vec3::Z });
            tree.nodes[1].set_radiance(pixel, Vec3::new(0.2, 0.5, 0.8));
            tree.nodes[1].distance[pixel] = match case {
                "flat energy" => f32::INFINITY,
                "no valid neighbour" => 0.0,
                "single texels" if !pixel.is_multiple_of(5) => 0.0,
                _ => 3.0,
            };
        }
        for (solver, (aside, turn)) in solvers
            .into_iter()
            .flat_map(|solver| [(1e-9, 0.0), (0.1, 0.05), (3.0, 0.9), (50.0, 3.1)].map(|m| (solver, m)))
        {
            let display_pose = Pose {
                position: tree.render_pose.position + DVec3::new(aside, 0.3 * aside, 0.0),
                orientation: tree.render_pose.orientation * DQuat::from_rotation_y(turn),
            };
            let (mut warper, mut radiance) = (Warper::default(), Vec::new());
            warper.set_solver(solver);
            warper.prepare(Mode::Specular, &tree);
            let statistics = warper.radiance(Mode::Specular, &tree, &display_pose, &camera(), &mut radiance);
            for channel in radiance.iter().flat_map(|radiance| radiance.to_array()) {
                undefined
                    .count(!channel.is_finite() || channel < 0.0, format!("{case}, {solver}, {aside} m: {channel}"));
            }
            let mirror = statistics.nodes[1];
            assert!((0.0..=1.0).contains(&mirror.undefined) && (0.0..=1.0).contains(&statistics.hole_fraction));
            let is_counted = mirror.seen == 0.0 || mirror.undefined == 1.0;
            uncounted
                .count(case == "no valid neighbour" && !is_counted, format!("{solver}, {aside} m: {statistics:?}"));
        }
    }
}

/// Largest difference between two pictures in display codes, and the fraction of channels that differ.
fn difference(a: &RgbImage, b: &RgbImage) -> (u8, f64) {
    let differences = || a.iter().zip(b.iter()).map(|(a, b)| a.abs_diff(*b));
    let differing = differences().filter(|&difference| difference > 0).count();
    (differences().max().unwrap(), differing as f64 / a.len() as f64)
}

#[test]
fn an_almost_unmoved_head_goes_through_all_solvers_and_sees_almost_the_servers_image() {
    let tree = plane_tree(pose());
    let display_pose = Pose { position: tree.render_pose.position + DVec3::X * 1e-9, ..tree.render_pose };
    let mut picture = RgbImage::default();
    let mut warper = Warper::default();
    warper.prepare(Mode::Specular, &tree);
    let statistics = warper.show(Mode::Specular, &tree, &display_pose, &camera(), 0.8, &mut picture);
    assert_eq!(statistics.hole_fraction, 0.0);
    // Textures have 12 bits: a code that a value stands next to may be the other one.
    let (largest, fraction) = difference(&picture, &image_of(&tree, 0.8));
    assert!(largest <= 1 && fraction < 0.05, "{largest} {fraction}");
}

#[test]
fn every_level_prepares_the_same_planes_from_trees_without_order() {
    let tree = wild_tree(pose());
    let prepared = |level| {
        let mut prepared = Prepared::default();
        prepared.prepare(level, &tree);
        prepared
    };
    let plain = prepared(Level::Portable);
    for level in Level::available() {
        let other = prepared(level);
        let (mut compared, mut worst) = (0, 0.0_f32);
        for child in 1..4 {
            let (a, b) = (plain.record(child), other.record(child));
            for y in 0..SIZE.height as usize {
                for x in 0..SIZE.width as usize {
                    let at = y * plain.layout.pitch + x;
                    assert_eq!(a[3][at] == 0, b[3][at] == 0, "{level:?}: record of {child} at {x}, {y}");
                    if a[3][at] == 0 {
                        continue;
                    }
                    for axis in 0..3 {
                        let (a, b) = (f32::from_bits(a[axis][at]), f32::from_bits(b[axis][at]));
                        assert!(a.is_finite() && b.is_finite());
                        worst = worst.max((a - b).abs() / a.abs().max(20.0));
                    }
                    compared += 1;
                }
            }
        }
        // Twenty metres away a rounding of each of some thirty operations.
        assert!(compared > 100 && worst < 32.0 * f32::EPSILON, "{level:?}: {compared}, {worst}");
    }
}
