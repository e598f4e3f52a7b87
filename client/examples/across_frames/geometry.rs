//! Depths, normals and indices of a node, coded alone and with the frame before at the pose of the new one.

use super::before::{NO_GUESS, NormalsBefore};
use crate::pyramid::{self, Bits, Plane, Use};
use crate::warp;
use glam::{Vec2, Vec3};
use warplight_protocol::frame::{DepthBound, Tree};

/// What is promised about depths.
const PROMISE: DepthBound = DepthBound { error_centi_px: 25, motion_mm: 200, child_factor: 2 };
/// Octahedral coordinates have so many codes; 12 bits, the largest is even so that 0 has one.
const LARGEST: f32 = 4094.0;

/// Bits per frame of a kind of plane for each [`Use`].
pub(crate) type Row = [Bits; Use::ALL.len()];

/// What the planes of a node take, on average over all frames but the first.
#[derive(Debug, Default)]
pub(crate) struct Geometry {
    pub(crate) depth: Row,
    /// Normals as they are.
    pub(crate) normals: Row,
    /// Normals each coordinate of which may be wrong by a code and a half.
    pub(crate) coarse_normals: Row,
    /// Indices alone, and where they differ from the warped ones.
    pub(crate) indices: [f64; 2],
    /// Milliseconds of one thread: to carry depths forward, and to guess the root's normals.
    pub(crate) carry_ms: f64,
    pub(crate) guess_ms: f64,
}

/// The inverse depth of which half may be lost, by the default promise.
pub(crate) fn step_per_m(tree: &Tree, node: usize) -> f32 {
    2.0 * PROMISE.inverse_depth_error_per_m(tree.camera.focal_px().x, node == 0) as f32
}

/// Codes the planes of a node in all ways.
pub(crate) fn measure(trees: &[Tree], node: usize) -> Geometry {
    let mut geometry = Geometry::default();
    for pair in trees.windows(2) {
        let (old, new) = (&pair[0], &pair[1]);
        let (side, step) = (new.camera.size.width as usize, step_per_m(new, node));
        let (old_inverse, new_inverse) = (warp::inverse_depths(old, node, step), warp::inverse_depths(new, node, step));
        let start = std::time::Instant::now();
        let carried = warp::carried_forward(old, &old_inverse, node, &new.render_pose.view_from(&old.render_pose));
        geometry.carry_ms += 1e3 * start.elapsed().as_secs_f64();
        let defined: Vec<bool> = new.nodes[node].distance.iter().map(|&distance| distance > 0.0).collect();
        let values: Vec<f32> = warp::inverse_depths(new, node, 1e-9).iter().map(|value| value / step).collect();
        let guess: Vec<Option<f32>> = carried.iter().map(|&value| (value > 0.0).then_some(value / step)).collect();
        let plane = Plane { side, values: &values, defined: &defined, guess: &guess, whole: false };
        add(&mut geometry.depth, &plane);
        if new.nodes[node].interface.is_empty() {
            continue;
        }
        let (old, new) = (decoded(old, node, &old_inverse), decoded(new, node, &new_inverse));
        indices_and_normals(&old, &new, node, &mut geometry);
    }
    let share = 1.0 / (trees.len() - 1) as f64;
    for bits in [&mut geometry.depth, &mut geometry.normals, &mut geometry.coarse_normals].into_iter().flatten() {
        *bits = Bits { zstd: bits.zstd * share, entropy: bits.entropy * share };
    }
    geometry.indices = geometry.indices.map(|bits| bits * share);
    geometry.carry_ms *= share;
    geometry.guess_ms *= share;
    geometry
}

/// The tree as a receiver has it: depths of the root to the promise, normals of 12 bits.
fn decoded(tree: &Tree, node: usize, inverse: &[f32]) -> Tree {
    let mut tree = tree.clone();
    for (pixel, &inverse) in inverse.iter().enumerate() {
        if node == 0 && inverse > 0.0 {
            let ray = tree.camera.ray_in_view(tree.camera.size.pixel_centre(pixel));
            tree.nodes[0].distance[pixel] = ray.length() / inverse;
        }
        if tree.nodes[node].interface[pixel] > 0 {
            let normal = from_octahedral(octahedral(tree.nodes[node].normal_at(pixel)));
            tree.nodes[node].set_normal(pixel, normal);
        }
    }
    tree
}

fn indices_and_normals(old: &Tree, new: &Tree, node: usize, geometry: &mut Geometry) {
    let size = new.camera.size;
    let (before, now) = (&old.nodes[node], &new.nodes[node]);
    let mut guesses = vec![NO_GUESS; size.pixels()];
    let mut differences = now.interface.clone();
    if node == 0 {
        let known = NormalsBefore::new(old);
        let planes = (&now.distance[..], &now.interface[..]);
        let start = std::time::Instant::now();
        known.guess(&new.camera, &new.render_pose, 0..size.height, planes, 12, &mut guesses);
        geometry.guess_ms += 1e3 * start.elapsed().as_secs_f64();
        let step = step_per_m(new, 0);
        let (old_inverse, new_inverse) = (warp::inverse_depths(old, 0, step), warp::inverse_depths(new, 0, step));
        let places = warp::places_before(new, &new_inverse, old, &old_inverse, 0);
        for (difference, place) in differences.iter_mut().zip(places) {
            *difference ^= place.map_or(0, |at| before.interface[at.y as usize * size.width as usize + at.x as usize]);
        }
    }
    geometry.indices[0] += pyramid::zstd_bits(&now.interface);
    geometry.indices[1] += pyramid::zstd_bits(&differences);

    let side = size.width as usize;
    let defined: Vec<bool> = now.interface.iter().map(|&index| index > 0).collect();
    let codes: Vec<Vec2> = (0..defined.len())
        .map(|pixel| if defined[pixel] { octahedral(now.normal_at(pixel)) } else { Vec2::ZERO })
        .collect();
    for (row, scale) in [(&mut geometry.normals, 1.0), (&mut geometry.coarse_normals, 1.0 / 3.0)] {
        for axis in 0..2 {
            let values: Vec<f32> = codes.iter().map(|code| code[axis] * scale).collect();
            let known = |guess: &[u16; 2]| (*guess != NO_GUESS).then(|| f32::from(guess[axis]) * scale);
            let guess: Vec<Option<f32>> = guesses.iter().map(known).collect();
            let whole = scale == 1.0;
            add(row, &Plane { side, values: &values, defined: &defined, guess: &guess, whole });
        }
    }
}

fn add(row: &mut Row, plane: &Plane<'_>) {
    for (sum, how) in row.iter_mut().zip(Use::ALL) {
        *sum += pyramid::bits(plane, how);
    }
}

fn octahedral(normal: Vec3) -> Vec2 {
    let flat = normal.truncate() / (normal.x.abs() + normal.y.abs() + normal.z.abs());
    let folded = (Vec2::ONE - Vec2::new(flat.y, flat.x).abs()) * Vec2::ONE.copysign(flat);
    let code = if normal.z >= 0.0 { flat } else { folded };
    ((code * 0.5 + 0.5) * LARGEST).round()
}

fn from_octahedral(code: Vec2) -> Vec3 {
    let flat = code / (0.5 * LARGEST) - 1.0;
    let z = 1.0 - flat.x.abs() - flat.y.abs();
    let fold = (-z).max(0.0);
    (flat - Vec2::splat(fold).copysign(flat)).extend(z).normalize()
}
