//! Frames of closed forms for `bench`: the same on every machine, and with as many nodes as asked for.
//!
//! A room with balls in it; below a line that halves the picture lies a plane that reflects ({D, R}), and refracts into a
//! basin ({D, R, F}) or through a sheet of glass ({D, R, F, FF}).

use glam::{DQuat, DVec3, Vec3};
use warplight_protocol::frame::{Interfaces, Plan, Tree};
use warplight_protocol::optics::{Interface, reflect, refract};
use warplight_protocol::{Camera, Pose};

/// Height of the plane under the eye in metres.
const PLANE_M: f32 = 0.8;
/// Thickness of the sheet.
const SHEET_M: f32 = 0.05;
const GLASS: f32 = 1.5;

/// The pose to which the frames are warped: 5 cm aside and 2 degrees round, a tenth of a second of a lively head.
pub(super) fn moved(pose: &Pose) -> Pose {
    let turn = DQuat::from_rotation_y(2_f64.to_radians());
    Pose { position: pose.position + pose.orientation * DVec3::X * 0.05, orientation: pose.orientation * turn }
}

/// The plans that are timed.
pub(super) fn plans() -> [Plan; 4] {
    [Plan::diffuse(), Plan::mirror(), Plan::water(), Plan::solid()]
}

/// The last letters of a plan's nodes.
pub(super) fn name(plan: &Plan) -> String {
    (0..plan.nodes().len()).filter_map(|node| plan.letters(node).chars().last()).collect()
}

/// Distance to the room and its balls.
fn room(origin: Vec3, direction: Vec3) -> f32 {
    let (low, high) = (Vec3::new(-3.0, -2.5, -5.0), Vec3::new(3.0, 1.5, 3.0));
    let walls = ((low - origin) / direction).max((high - origin) / direction).min_element();
    let balls =
        [(Vec3::new(0.7, 0.2, -2.5), 0.4), (Vec3::new(-1.2, 0.5, -3.5), 0.5), (Vec3::new(0.2, -1.7, -3.0), 0.3)];
    let meet = |(centre, radius): (Vec3, f32)| {
        let from = origin - centre;
        let along = from.dot(direction);
        let root = along * along - from.length_squared() + radius * radius;
        (root > 0.0).then(|| -along - root.sqrt()).filter(|&distance| distance > 1e-4)
    };
    balls.into_iter().filter_map(meet).fold(walls, f32::min)
}

/// A pattern without noise.
pub(super) fn texture(point: Vec3) -> Vec3 {
    Vec3::splat(0.5) + 0.4 * Vec3::new((5.0 * point.x).sin(), (6.0 * point.y).cos(), (4.0 * (point.x + point.z)).sin())
}

/// A frame of this plan.
pub(super) fn frame(camera: Camera, plan: Plan) -> Tree {
    let interfaces = Interfaces(vec![Interface::Dielectric { eta: GLASS }, Interface::Dielectric { eta: 1.0 / GLASS }]);
    let mut tree = Tree::new(Pose::IDENTITY, camera, plan, interfaces);
    let nodes = tree.nodes.len();
    let mut put = |node: usize, pixel: usize, origin: Vec3, direction: Vec3, distance: f32| {
        tree.nodes[node].distance[pixel] = distance;
        tree.nodes[node].set_radiance(pixel, texture(origin + direction * distance));
    };
    let mut boundaries = Vec::new();
    for pixel in 0..camera.size.pixels() {
        let direction = camera.ray_in_view(camera.size.pixel_centre(pixel)).normalize();
        let to_plane = if direction.y < 0.0 { -PLANE_M / direction.y } else { f32::INFINITY };
        let straight = room(Vec3::ZERO, direction);
        if nodes == 1 || to_plane > straight {
            put(0, pixel, Vec3::ZERO, direction, straight);
            continue;
        }
        put(0, pixel, Vec3::ZERO, direction, to_plane);
        boundaries.push(pixel);
        let at = direction * to_plane;
        let reflected = reflect(direction, Vec3::Y);
        put(1, pixel, at, reflected, room(at, reflected));
        if nodes == 2 {
            continue;
        }
        let Some(refracted) = refract(direction, Vec3::Y, GLASS) else { continue };
        if nodes == 3 {
            put(2, pixel, at, refracted, room(at, refracted));
        } else {
            let through = SHEET_M / -refracted.y;
            put(2, pixel, at, refracted, through);
            let exit = at + refracted * through;
            put(3, pixel, exit, direction, room(exit, direction));
        }
    }
    for pixel in boundaries {
        for (node, interface) in [(0, 1), (2, 2)] {
            if tree.plan.has_children(node) {
                tree.nodes[node].interface[pixel] = interface;
                tree.nodes[node].set_normal(pixel, Vec3::Y);
            }
        }
    }
    tree
}
