//! The picture as a plane: the homography of a plane at one depth, parallel to the old image.
//!
//! Baseline between `rotation` and `diffuse`: it knows how far away the scene is, but not its shape. Planar
//! reprojection with one depth per frame is what displays do with an application that gives a depth to focus on
//! (Lochmann 3.2.7; Hartley and Zisserman 2003, 13.1): `h = (H + w p e_z^T) (x, y, 1)` with w = 1 / z.
//!
//! The depth is the fairest that one number can be: parallax is proportional to 1 / z, so the mean of 1 / z over the
//! picture is the plane whose squared error of parallax, summed over the pixels, is least for a small translation.
//! Rotation and translation are exact for that plane. Reflections are painted on.
//!
//! Cost: one projection and one bilinear fetch a pixel.

use super::HOLE;
use super::reproject::Reprojection;
use super::source::Source;
use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;
use warplight_protocol::{Camera, Pose};

/// Mean of 1 / z over the old picture; what is infinitely far counts as 0.
pub(super) fn mean_inverse_depth(source: &Source) -> f32 {
    let pixels = source.camera().size.pixels();
    let known = (0..pixels).map(|texel| f64::from(source.inverse_depth(texel))).filter(|inverse| inverse.is_finite());
    (known.sum::<f64>() / pixels.max(1) as f64) as f32
}

/// Fills `radiance` with the old picture on the plane z = 1 / `inverse_depth`, seen from `display_pose`; holes beyond
/// its border, and everywhere if the eye is in the plane or behind it.
pub(super) fn warp(source: &Source, inverse_depth: f32, display_pose: &Pose, camera: &Camera, radiance: &mut [Vec3]) {
    let ([x, y, z], parallax) = Reprojection::new(source.camera(), source.pose(), camera, display_pose).parts();
    let new_from_old = DMat3::from_cols(x.as_dvec3(), y.as_dvec3(), (z + parallax * inverse_depth).as_dvec3());
    // Seen from behind the picture would be its own mirror image; from within the plane it is a line.
    if new_from_old.determinant() * new_from_old_sign(x, y, z) <= f64::EPSILON {
        radiance.fill(HOLE);
        return;
    }
    let old_from_new = new_from_old.inverse();
    let width = camera.size.width as usize;
    radiance.par_chunks_mut(width).enumerate().for_each(|(y, radiance)| {
        for (x, radiance) in radiance.iter_mut().enumerate() {
            let h = old_from_new * DVec3::new(x as f64 + 0.5, y as f64 + 0.5, 1.0);
            let pixel = (h.z > 0.0).then(|| (h.truncate() / h.z).as_vec2());
            *radiance = pixel.and_then(|pixel| source.radiance_at(pixel)).unwrap_or(HOLE);
        }
    });
}

/// The sign that the determinant has for an eye before the plane: that of the homography at infinity.
fn new_from_old_sign(x: Vec3, y: Vec3, z: Vec3) -> f64 {
    DMat3::from_cols(x.as_dvec3(), y.as_dvec3(), z.as_dvec3()).determinant().signum()
}

#[cfg(test)]
mod tests {
    use crate::warp::tests::{SIZE, camera, flow_of, pose};
    use crate::warp::{Mode, Warper};
    use glam::{DQuat, DVec3, Vec3};
    use warplight_protocol::Pose;
    use warplight_protocol::frame::{Interfaces, Plan, Tree};

    /// Depth z of each pixel.
    fn tree_of_depth(depth: impl Fn(usize) -> f32) -> Tree {
        let mut tree = Tree::new(pose(), camera(), Plan::diffuse(), Interfaces::default());
        for pixel in 0..SIZE.pixels() {
            let ray = camera().ray_in_view(SIZE.pixel_centre(pixel));
            tree.nodes[0].distance[pixel] = ray.length() * depth(pixel);
        }
        tree
    }

    fn moved(by: DVec3, turn: DQuat) -> Pose {
        let pose = pose();
        Pose { position: pose.position + pose.orientation * by, orientation: pose.orientation * turn }
    }

    #[test]
    fn a_plane_that_faces_the_head_is_its_closed_form() {
        const DEPTH: f32 = 2.5;
        let tree = tree_of_depth(|_| DEPTH);
        let aside = DVec3::new(0.07, -0.04, 0.2);
        let display_pose = moved(aside, DQuat::from_euler(glam::EulerRot::YXZ, 0.06, -0.04, 0.1));
        let old_from_new = tree.render_pose.view_from(&display_pose).rotation;
        let (mut compared, mut worst) = (0, 0.0_f32);
        for (pixel, found) in flow_of(Mode::Planar, &tree, &display_pose).into_iter().enumerate() {
            // The new ray meets z = -DEPTH where aside.z + s ray.z = -DEPTH.
            let ray = old_from_new * camera().ray_in_view(SIZE.pixel_centre(pixel));
            let reach = (DEPTH + aside.z as f32) / -ray.z;
            let Some(expected) = camera().pixel_from_view(aside.as_vec3() + ray * reach) else { continue };
            if expected.cmpgt(glam::Vec2::ONE).all() && expected.cmplt(glam::Vec2::new(95.0, 63.0)).all() {
                worst = worst.max((found.expect("no hole inside") - expected).abs().max_element());
                compared += 1;
            } else if !(-1.0..97.0).contains(&expected.x) || !(-1.0..65.0).contains(&expected.y) {
                assert_eq!(found, None, "outside the picture at {expected}");
            }
        }
        assert!(compared > SIZE.pixels() / 2);
        // Fetches round to 1/256 px.
        assert!(worst < 0.01, "{worst} px");
    }

    #[test]
    fn the_depth_is_the_mean_of_inverse_depths_and_the_sky_counts() {
        let tree = tree_of_depth(|pixel| if pixel % 2 == 0 { 0.5 } else { f32::INFINITY });
        let mut warper = Warper::default();
        warper.prepare(Mode::Planar, &tree);
        assert!((warper.mean_inverse_depth - 1.0).abs() < 1e-6, "{}", warper.mean_inverse_depth);
    }

    #[test]
    fn an_eye_in_the_plane_or_behind_it_sees_nothing() {
        let tree = tree_of_depth(|_| 1.0);
        for forward in [1.0, 1.5] {
            let display_pose = moved(DVec3::new(0.0, 0.0, -forward), DQuat::IDENTITY);
            assert!(flow_of(Mode::Planar, &tree, &display_pose).iter().all(Option::is_none), "{forward} m ahead");
        }
        let turned_away = moved(Vec3::ZERO.as_dvec3(), DQuat::from_rotation_y(std::f64::consts::PI));
        assert!(flow_of(Mode::Planar, &tree, &turned_away).iter().all(Option::is_none));
    }
}
