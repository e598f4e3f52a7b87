//! Pixels to pixels: where a pixel of the old picture lies in the new one, given its inverse depth.
//!
//! A ray is linear in its pixel and a projection is a matrix, so the whole way is a homography and a parallax
//! (Hartley and Zisserman 2003, 13.1): `h = H (x, y, 1) + w p`, and the new pixel is `h.xy / h.z`. That holds for
//! w = 0, at infinity, too. Cost: 12 multiplications and a division.

use glam::{Mat3, Vec2, Vec3};
use warplight_protocol::camera::MIN_DEPTH_M;
use warplight_protocol::{Camera, Pose};

/// new_pixel_from_old_pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reprojection {
    homography: Mat3,
    parallax: Vec3,
}

impl Reprojection {
    /// From the old camera at `old_pose` to the new one at `new_pose`.
    pub(super) fn new(old: &Camera, old_pose: &Pose, new: &Camera, new_pose: &Pose) -> Reprojection {
        let new_from_old = new_pose.view_from(old_pose);
        let pixel_from_view = pixel_from_view(new);
        Reprojection {
            homography: pixel_from_view * new_from_old.rotation * view_from_pixel(old),
            parallax: pixel_from_view * new_from_old.translation,
        }
    }

    /// The columns of the homography and the parallax.
    pub(super) fn parts(&self) -> ([Vec3; 3], Vec3) {
        let Mat3 { x_axis, y_axis, z_axis } = self.homography;
        ([x_axis, y_axis, z_axis], self.parallax)
    }

    /// The new pixel in homogeneous form. Its third component is the new depth for every unit of the old one.
    #[inline(always)]
    pub(super) fn homogeneous(&self, pixel: Vec2, inverse_depth: f32) -> Vec3 {
        self.homography.x_axis * pixel.x
            + self.homography.y_axis * pixel.y
            + (self.homography.z_axis + self.parallax * inverse_depth)
    }

    /// The new pixel; `None` behind the eye.
    #[inline(always)]
    pub(super) fn pixel(&self, pixel: Vec2, inverse_depth: f32) -> Option<Vec2> {
        let h = self.homogeneous(pixel, inverse_depth);
        (h.z >= MIN_DEPTH_M).then(|| h.truncate() / h.z)
    }
}

/// Rays, scaled to z = -1, by homogeneous pixels.
pub(super) fn view_from_pixel(camera: &Camera) -> Mat3 {
    let (focal, centre) = (camera.focal_px(), camera.centre_px());
    Mat3::from_cols(
        Vec3::new(1.0 / focal.x, 0.0, 0.0),
        Vec3::new(0.0, -1.0 / focal.y, 0.0),
        Vec3::new(-centre.x / focal.x, centre.y / focal.y, -1.0),
    )
}

/// Homogeneous pixels by points in view; the third component is the depth.
fn pixel_from_view(camera: &Camera) -> Mat3 {
    let (focal, centre) = (camera.focal_px(), camera.centre_px());
    Mat3::from_cols(Vec3::new(focal.x, 0.0, 0.0), Vec3::new(0.0, -focal.y, 0.0), Vec3::new(-centre.x, -centre.y, -1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use warplight_protocol::{FieldOfView, ImageSize};

    #[test]
    fn it_is_unprojection_motion_and_projection_in_one() {
        let old =
            Camera::perspective(ImageSize::new(640, 480), FieldOfView { left: -1.2, right: 0.7, down: -0.9, up: 0.8 });
        let new = Camera::symmetric(1.3, ImageSize::new(512, 300));
        let old_pose = Pose { position: DVec3::new(5e3, 1.0, 2.0), orientation: DQuat::from_rotation_y(0.4) };
        let new_pose = Pose {
            position: old_pose.position + DVec3::new(0.1, -0.2, 0.05),
            orientation: old_pose.orientation * DQuat::from_euler(glam::EulerRot::YXZ, 0.1, -0.05, 0.2),
        };
        let reprojection = Reprojection::new(&old, &old_pose, &new, &new_pose);
        let motion = new_pose.view_from(&old_pose);
        for index in (0..old.size.pixels()).step_by(1009) {
            let pixel = old.size.pixel_centre(index);
            for inverse_depth in [0.0, 1e-4, 0.2, 3.0] {
                let point = motion.rotation * old.ray_in_view(pixel) + motion.translation * inverse_depth;
                let (expected, found) = (new.pixel_from_view(point), reprojection.pixel(pixel, inverse_depth));
                match (expected, found) {
                    (Some(expected), Some(found)) => assert!((expected - found).length() < 2e-3, "{expected} {found}"),
                    (expected, found) => assert_eq!(expected.is_some(), found.is_some()),
                }
            }
        }
    }
}
