//! The picture turned: a homography, exact for a head that only rotates, and all that can be done without
//! depth (asynchronous timewarp, van Waveren 2016).

use super::HOLE;
use super::reproject::Reprojection;
use super::source::Source;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use warplight_protocol::camera::Projection;
use warplight_protocol::{Camera, Pose};

/// Fills `radiance` with the old picture turned to `display_pose`; holes beyond its border.
pub(super) fn warp(source: &Source, display_pose: &Pose, camera: &Camera, radiance: &mut [Vec3]) {
    if source.camera().projection == Projection::Cube {
        return warp_cube(source, display_pose, camera, radiance);
    }
    // The other way round than a splat: from the new picture into the old one, both at infinity.
    let old_from_new = Reprojection::new(camera, display_pose, source.camera(), source.pose());
    let width = camera.size.width as usize;
    radiance.par_chunks_mut(width).enumerate().for_each(|(y, radiance)| {
        for (x, radiance) in radiance.iter_mut().enumerate() {
            let pixel = old_from_new.pixel(Vec2::new(x as f32 + 0.5, y as f32 + 0.5), 0.0);
            *radiance = pixel.and_then(|pixel| source.radiance_at(pixel)).unwrap_or(HOLE);
        }
    });
}

/// The same from a picture of everything around the eye.
fn warp_cube(source: &Source, display_pose: &Pose, camera: &Camera, radiance: &mut [Vec3]) {
    let turn = source.pose().view_from(display_pose).rotation;
    let width = camera.size.width as usize;
    radiance.par_chunks_mut(width).enumerate().for_each(|(y, radiance)| {
        for (x, radiance) in radiance.iter_mut().enumerate() {
            let ray = turn * camera.ray_in_view(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
            *radiance =
                source.camera().pixel_from_view(ray).and_then(|pixel| source.radiance_at(pixel)).unwrap_or(HOLE);
        }
    });
}
