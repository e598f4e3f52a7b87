//! The picture turned: a homography, exact for a head that only rotates, and all that can be done without
//! depth (asynchronous timewarp, van Waveren 2016).

use super::HOLE;
use super::source::Source;
use glam::Vec3;
use rayon::prelude::*;
use warplight_protocol::{Camera, Pose};

/// Fills `radiance` with the old picture turned to `display_pose`; holes beyond its border.
pub(super) fn warp(source: &Source, display_pose: &Pose, camera: &Camera, radiance: &mut [Vec3]) {
    let old_from_new = source.pose().view_from(display_pose).rotation;
    let width = camera.size.width as usize;
    radiance.par_chunks_mut(width).enumerate().for_each(|(row, radiance)| {
        for (x, radiance) in radiance.iter_mut().enumerate() {
            let ray = camera.ray_in_view(camera.size.pixel_centre(row * width + x));
            let pixel = source.camera().pixel_from_view(old_from_new * ray);
            *radiance = pixel.and_then(|pixel| source.radiance_at(pixel)).unwrap_or(HOLE);
        }
    });
}
