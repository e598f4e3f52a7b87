//! The frame that is measured: a room of 6 x 3 x 8 m in closed form, seen from its middle. A mirror hangs on the
//! far wall, a chrome ball and a glass ball (first interface only) lie on the floor.

pub(crate) mod solid;

use glam::{Vec2, Vec3};
use warplight_protocol::codec::FrameShape;
use warplight_protocol::frame::{ColorFormat, FrameFormat, Interfaces, NodePlanes, Plan, Tree, UNDEFINED, VolumeRange};
use warplight_protocol::optics::{Interface, reflect, refract};
use warplight_protocol::{Camera, ImageSize, Pose};

const LOW: Vec3 = Vec3::new(-3.0, -1.5, -5.0);
const HIGH: Vec3 = Vec3::new(3.0, 1.5, 3.0);
/// Centre, radius, interface (1 mirror, 2 metal, 3 glass).
const BALLS: [(Vec3, f32, u8); 2] = [(Vec3::new(-0.9, -0.8, -2.6), 0.7, 2), (Vec3::new(0.8, -1.0, -2.0), 0.5, 3)];
const MIRROR_LOW: Vec2 = Vec2::new(-1.5, -0.4);
const MIRROR_HIGH: Vec2 = Vec2::new(2.0, 1.2);

struct Hit {
    distance: f32,
    normal: Vec3,
    interface: u8,
    radiance: Vec3,
}

/// A frame of `side` x `side` pixels whose radiance has this standard deviation over its mean.
pub(crate) fn frame(side: u32, noise: f32, format: FrameFormat, strip_rows: u16) -> (FrameShape, Tree) {
    let gold = Interface::Conductor { eta: [0.18, 0.42, 1.37], k: [3.42, 2.35, 1.77] };
    let shape = FrameShape {
        camera: Camera::symmetric(1.4, ImageSize::new(side, side)),
        plan: Plan::water(),
        interfaces: Interfaces(vec![Interface::Mirror, gold, Interface::Dielectric { eta: 1.5 }]),
        format,
        volume: VolumeRange::default(),
        strip_rows,
        exposure: 1.0,
    };
    let mut tree = Tree::new(Pose::IDENTITY, shape.camera, shape.plan.clone(), shape.interfaces.clone());
    let mut random = 1_u64;
    for pixel in 0..shape.camera.size.pixels() {
        // Turned a little, since a room along the axes would flatter the depth.
        let turn = glam::Quat::from_euler(glam::EulerRot::YXZ, 0.2, -0.15, 0.05);
        let ray = shape.camera.ray_in_view(shape.camera.size.pixel_centre(pixel)).normalize();
        let direction = turn * ray;
        let hit = cast(Vec3::new(0.1, 0.1, 1.9), direction);
        let point = Vec3::new(0.1, 0.1, 1.9) + direction * hit.distance;
        put(&mut tree.nodes[0], pixel, &hit, noise, &mut random);
        tree.nodes[0].interface[pixel] = hit.interface;
        tree.nodes[0].set_normal(pixel, turn.inverse() * hit.normal);
        tree.nodes[1].distance[pixel] = UNDEFINED;
        tree.nodes[2].distance[pixel] = UNDEFINED;
        if hit.interface > 0 {
            let next = cast(point + hit.normal * 1e-3, reflect(direction, hit.normal));
            put(&mut tree.nodes[1], pixel, &next, noise, &mut random);
        }
        if hit.interface == 3 {
            let inside = refract(direction, hit.normal, 1.5).unwrap_or(direction);
            let through = cast_room(point, inside);
            put(&mut tree.nodes[2], pixel, &through, noise, &mut random);
        }
    }
    (shape, tree)
}

fn put(planes: &mut NodePlanes, pixel: usize, hit: &Hit, noise: f32, random: &mut u64) {
    planes.distance[pixel] = hit.distance;
    let mut gaussian = || (0..12).map(|_| unit(random)).sum::<f32>() - 6.0;
    // Most noise is of the brightness, a third of it of the colour.
    let common = gaussian();
    let noisy = hit.radiance.map(|value| value * (1.0 + noise * (0.94 * common + 0.34 * gaussian())).max(0.0));
    planes.set_radiance(pixel, noisy);
}

fn unit(random: &mut u64) -> f32 {
    *random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*random >> 40) as f32 / (1_u64 << 24) as f32
}

fn cast(origin: Vec3, direction: Vec3) -> Hit {
    let mut nearest = cast_room(origin, direction);
    for (centre, radius, interface) in BALLS {
        let to_centre = centre - origin;
        let along = to_centre.dot(direction);
        let inside = radius * radius - (to_centre - along * direction).length_squared();
        if inside > 0.0 && along - inside.sqrt() > 1e-3 && along - inside.sqrt() < nearest.distance {
            let distance = along - inside.sqrt();
            let normal = (origin + direction * distance - centre) / radius;
            nearest = Hit { distance, normal, interface, radiance: Vec3::ZERO };
        }
    }
    nearest
}

/// The walls from within; through the window in the ceiling there is nothing.
fn cast_room(origin: Vec3, direction: Vec3) -> Hit {
    let to_wall = |axis: usize| {
        let wall = if direction[axis] > 0.0 { HIGH[axis] } else { LOW[axis] };
        ((wall - origin[axis]) / direction[axis]).max(0.0)
    };
    let axis = (0..3).min_by(|&a, &b| to_wall(a).total_cmp(&to_wall(b))).unwrap_or(0);
    let distance = to_wall(axis);
    let point = origin + direction * distance;
    let normal = -Vec3::AXES[axis] * direction[axis].signum();
    if axis == 1 && direction.y > 0.0 && point.x.abs() < 1.0 && point.z.abs() < 1.0 {
        return Hit { distance: f32::INFINITY, normal, interface: 0, radiance: Vec3::new(0.6, 0.8, 1.0) };
    }
    let on_wall = point.truncate();
    if axis == 2 && direction.z < 0.0 && on_wall.cmpgt(MIRROR_LOW).all() && on_wall.cmplt(MIRROR_HIGH).all() {
        return Hit { distance, normal, interface: 1, radiance: Vec3::ZERO };
    }
    let tile = |scale: f32| {
        let cell = (point * scale).floor();
        if (cell.x + cell.y + cell.z).rem_euclid(2.0) < 1.0 { 1.0 } else { 0.6 }
    };
    let grain = 1.0 + 0.1 * (point.x * 37.0 + point.z * 11.0).sin() * (point.y * 29.0 - point.z * 17.0).cos();
    let light = 0.25 + 0.75 / (0.5 + (point - Vec3::new(0.0, HIGH.y, 0.0)).length_squared() * 0.3);
    let albedo = [Vec3::new(0.7, 0.3, 0.2), Vec3::new(0.6, 0.55, 0.5), Vec3::new(0.3, 0.45, 0.6)][axis];
    Hit { distance, normal, interface: 0, radiance: albedo * (tile(2.0) * grain * light) }
}

/// A plane as integers: name, bits, channels, and which pixels count.
type Codes = (&'static str, usize, Vec<Vec<u32>>, Vec<bool>);

/// Codes of the kinds of planes.
pub(crate) fn planes_of_codes(shape: &FrameShape, tree: &Tree) -> Vec<Codes> {
    let color = shape.format.color;
    let pixels = shape.camera.size.pixels();
    let mut planes = Vec::new();
    for (name, node) in [("root.radiance", 0), ("reflect.radiance", 1)] {
        let code = |channel: usize, pixel: usize| {
            u32::from(ColorFormat::quantise(color, tree.nodes[node].radiance[channel][pixel], 1.0))
        };
        let mask = (1 << color.bits()) - 1;
        let difference = |channel: usize| {
            (0..pixels).map(|pixel| code(channel, pixel).wrapping_sub(code(1, pixel)) & mask).collect()
        };
        let channels = vec![(0..pixels).map(|pixel| code(1, pixel)).collect(), difference(0), difference(2)];
        planes.push((name, color.bits(), channels, defined(tree, node)));
    }
    for (name, node) in [("root.depth16", 0), ("reflect.depth16", 1)] {
        planes.push((name, 16, vec![depth_codes(tree, node, 16)], defined(tree, node)));
    }
    planes.push(("root.depth24", 24, vec![depth_codes(tree, 0, 24)], defined(tree, 0)));
    let has_interface = tree.nodes[0].interface.iter().map(|&interface| interface > 0).collect();
    planes.push(("root.normal12", 12, normal_codes(tree), has_interface));
    planes.push((
        "root.interface",
        2,
        vec![tree.nodes[0].interface.iter().map(|&i| i.into()).collect()],
        defined(tree, 0),
    ));
    planes
}

fn defined(tree: &Tree, node: usize) -> Vec<bool> {
    tree.nodes[node].distance.iter().map(|&distance| distance != UNDEFINED).collect()
}

/// As the codec has them, but with one nearest depth for the whole frame.
fn depth_codes(tree: &Tree, node: usize, bits: u32) -> Vec<u32> {
    let z = |pixel: usize| {
        let ray = tree.camera.ray_in_view(tree.camera.size.pixel_centre(pixel)).length();
        let before = if node > 0 { tree.nodes[0].distance[pixel] } else { 0.0 };
        f64::from((tree.nodes[node].distance[pixel] + before) / ray)
    };
    let pixels = 0..tree.camera.size.pixels();
    let known = pixels.clone().filter(|&pixel| tree.nodes[node].distance[pixel] != UNDEFINED);
    let near = known.map(z).fold(f64::INFINITY, f64::min);
    let largest = f64::from((1_u32 << bits) - 1);
    pixels.map(|pixel| (near / z(pixel) * largest).min(largest).round() as u32).collect()
}

/// The octahedral map.
fn normal_codes(tree: &Tree) -> Vec<Vec<u32>> {
    let code = |pixel: usize| {
        let normal = tree.nodes[0].normal_at(pixel);
        let unit = normal / normal.abs().element_sum();
        let folded = (Vec2::ONE - Vec2::new(unit.y.abs(), unit.x.abs())) * unit.truncate().signum();
        ((if unit.z >= 0.0 { unit.truncate() } else { folded }) * 0.5 + 0.5) * 4094.0
    };
    let pixels = 0..tree.camera.size.pixels();
    vec![pixels.clone().map(|p| code(p).x.round() as u32).collect(), pixels.map(|p| code(p).y.round() as u32).collect()]
}
