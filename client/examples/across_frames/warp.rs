//! Where the pixels of a new frame lay in the frame before, and inverse depths carried forward.

use glam::{Vec2, Vec3};
use warplight_protocol::frame::Tree;
use warplight_protocol::pose::RigidMotion;

/// Inverse z of a node's unfolded points, rounded to a promise's steps as both ends know it; 0 where undefined or
/// infinitely far.
pub(crate) fn inverse_depths(tree: &Tree, node: usize, step_per_m: f32) -> Vec<f32> {
    let path = tree.plan.path(node);
    (0..tree.camera.size.pixels())
        .map(|pixel| {
            if tree.nodes[node].distance[pixel] <= 0.0 {
                return 0.0;
            }
            let metres: f32 = path.iter().map(|&on_path| tree.nodes[on_path].distance[pixel]).sum();
            let ray = tree.camera.ray_in_view(tree.camera.size.pixel_centre(pixel));
            (ray.length() / metres / step_per_m).round() * step_per_m
        })
        .collect()
}

/// For each pixel of a node of `new` where its point was seen in `old`; `None` where it was not.
pub(crate) fn places_before(
    new: &Tree,
    new_inverse: &[f32],
    old: &Tree,
    old_inverse: &[f32],
    node: usize,
) -> Vec<Option<Vec2>> {
    let old_from_new = old.render_pose.view_from(&new.render_pose);
    let (camera, size) = (&new.camera, new.camera.size);
    (0..size.pixels())
        .map(|pixel| {
            if new.nodes[node].distance[pixel] <= 0.0 {
                return None;
            }
            let ray = camera.ray_in_view(size.pixel_centre(pixel));
            let scaled = old_from_new.rotation * ray + old_from_new.translation * new_inverse[pixel];
            let place = camera.pixel_from_view(scaled)?;
            let (x, y) = (place.x.floor(), place.y.floor());
            if x < 0.0 || y < 0.0 || x >= size.width as f32 || y >= size.height as f32 {
                return None;
            }
            let there = y as usize * size.width as usize + x as usize;
            let expected = new_inverse[pixel] / -scaled.z;
            let is_same = (old_inverse[there] - expected).abs() <= 0.05 * expected + 1e-4;
            (old.nodes[node].distance[there] > 0.0 && is_same).then_some(place)
        })
        .collect()
}

/// Inverse depths of `old` as the new view sees them, by rasterising the mesh of its pixels; 0 where it has none.
pub(crate) fn carried_forward(old: &Tree, old_inverse: &[f32], node: usize, new_from_old: &RigidMotion) -> Vec<f32> {
    let size = old.camera.size;
    let (width, height) = (size.width as usize, size.height as usize);
    let mut nearest = vec![0.0_f32; width * height];
    // Position on the new picture and inverse z, which is linear on it for a plane.
    let corner = |pixel: usize| -> Option<Vec3> {
        (old.nodes[node].distance[pixel] > 0.0).then_some(())?;
        let scaled = new_from_old.rotation * old.camera.ray_in_view(size.pixel_centre(pixel))
            + new_from_old.translation * old_inverse[pixel];
        let place = old.camera.pixel_from_view(scaled)?;
        Some(place.extend(old_inverse[pixel] / -scaled.z))
    };
    let corners: Vec<Option<Vec3>> = (0..width * height).map(corner).collect();
    for y in 0..height - 1 {
        for x in 0..width - 1 {
            let at = y * width + x;
            let (Some(a), Some(b), Some(c), Some(d)) =
                (corners[at], corners[at + 1], corners[at + width], corners[at + width + 1])
            else {
                continue;
            };
            let (low, high) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
            // Across a silhouette there is no surface.
            if high.z > 1.05 * low.z + 1e-4 {
                continue;
            }
            triangle([a, b, c], width, height, &mut nearest);
            triangle([b, d, c], width, height, &mut nearest);
        }
    }
    nearest
}

fn triangle([a, b, c]: [Vec3; 3], width: usize, height: usize, nearest: &mut [f32]) {
    let cross = |p: Vec2, q: Vec2| p.x * q.y - p.y * q.x;
    let (a2, b2, c2) = (a.truncate(), b.truncate(), c.truncate());
    let area = cross(b2 - a2, c2 - a2);
    if area.abs() < 1e-6 {
        return;
    }
    let low = (a2.min(b2).min(c2) - 0.5).ceil().max(Vec2::ZERO);
    let high = (a2.max(b2).max(c2) - 0.5).floor().min(Vec2::new(width as f32 - 1.0, height as f32 - 1.0));
    let mut y = low.y;
    while y <= high.y {
        let mut x = low.x;
        while x <= high.x {
            let place = Vec2::new(x + 0.5, y + 0.5);
            let (u, v) = (cross(place - a2, c2 - a2) / area, cross(b2 - a2, place - a2) / area);
            if u >= -1e-3 && v >= -1e-3 && u + v <= 1.002 {
                let cell = &mut nearest[y as usize * width + x as usize];
                *cell = cell.max(a.z + u * (b.z - a.z) + v * (c.z - a.z));
            }
            x += 1.0;
        }
        y += 1.0;
    }
}
