//! Rays of the display in the space of the frame.
//!
//! Epipolar geometry is simplest where the frame's own pixels are: x to the right, y *down*, z the depth in the view
//! of the render pose, the eye of the frame at the origin. A point (x, y, z) then has the pixel `(f x, f y) / z + c`,
//! and a ray of the display is a line whose image is straight. Everything here is f64, once per picture or packet;
//! only the vector form rounds it.

use glam::{DMat3, DVec2, DVec3};
use warplight_protocol::{Camera, Pose};

/// A pinhole camera in f64.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pinhole {
    /// Focal lengths in pixels.
    pub(super) focal_px: DVec2,
    /// Where the axis of view meets the picture.
    pub(super) centre_px: DVec2,
    /// Columns and rows.
    pub(super) size_px: [usize; 2],
}

impl Pinhole {
    pub(super) fn new(camera: &Camera) -> Pinhole {
        let fov = camera.fov;
        let [left, right, down, up] = [fov.left, fov.right, fov.down, fov.up].map(f64::from);
        let (width, height) = (camera.size.width, camera.size.height);
        let focal_px = DVec2::new(f64::from(width) / (right - left), f64::from(height) / (up - down));
        let size_px = [width as usize, height as usize];
        Pinhole { focal_px, centre_px: focal_px * DVec2::new(-left, up), size_px }
    }

    /// Direction through a position in the picture, of depth 1.
    pub(super) fn ray(&self, pixel: DVec2) -> DVec3 {
        ((pixel - self.centre_px) / self.focal_px).extend(1.0)
    }

    /// Position in the picture of a point before the eye.
    pub(super) fn pixel(&self, point: DVec3) -> DVec2 {
        point.truncate() / point.z * self.focal_px + self.centre_px
    }

    /// Length of the ray through the centre of a pixel per unit of depth.
    pub(super) fn obliquity(&self, column: usize, row: usize) -> f64 {
        self.ray(DVec2::new(column as f64 + 0.5, row as f64 + 0.5)).length()
    }
}

/// A ray: `origin + t direction`, t from 0 on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ray {
    pub(super) origin: DVec3,
    /// Of any length but zero.
    pub(super) direction: DVec3,
}

impl Ray {
    pub(super) fn at(&self, t: f64) -> DVec3 {
        self.origin + self.direction * t
    }
}

/// All rays of a display in the space of a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rays {
    /// The eye of the display.
    pub(super) origin: DVec3,
    /// Turns directions in the space of the display into those of the frame.
    pub(super) frame_from_display: DMat3,
    /// The camera of the display.
    pub(super) display: Pinhole,
}

impl Rays {
    pub(super) fn new(render_pose: &Pose, display_pose: &Pose, camera: &Camera) -> Rays {
        // Both spaces have y and z the other way round than views have.
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let view_from_world = render_pose.orientation.inverse();
        let turn = DMat3::from_quat((view_from_world * display_pose.orientation).normalize());
        Rays {
            origin: flip * (view_from_world * (display_pose.position - render_pose.position)),
            frame_from_display: flip * turn * flip,
            display: Pinhole::new(camera),
        }
    }

    /// Direction through a position in the picture of the display, of depth 1 there; linear in the position.
    pub(super) fn direction(&self, pixel: DVec2) -> DVec3 {
        self.frame_from_display * self.display.ray(pixel)
    }

    /// The ray through the centre of a pixel of the display.
    pub(super) fn through(&self, column: usize, row: usize) -> Ray {
        let direction = self.direction(DVec2::new(column as f64 + 0.5, row as f64 + 0.5));
        Ray { origin: self.origin, direction }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, Vec2};
    use warplight_protocol::ImageSize;

    #[test]
    fn a_point_on_a_ray_of_the_display_is_where_the_cameras_say() {
        let camera = Camera::symmetric(1.1, ImageSize::new(64, 48));
        let frame_pose = Pose { position: DVec3::new(3.0, 1.0, -2.0), orientation: DQuat::from_rotation_y(0.7) };
        let orientation = DQuat::from_rotation_y(0.8) * DQuat::from_rotation_x(0.2) * DQuat::from_rotation_z(0.3);
        let display_pose = Pose { position: DVec3::new(3.2, 1.1, -2.3), orientation };
        let rays = Rays::new(&frame_pose, &display_pose, &camera);
        for (column, row) in [(0, 0), (63, 47), (20, 31)] {
            let in_view = camera.ray_in_view(Vec2::new(column as f32 + 0.5, row as f32 + 0.5)).as_dvec3() * 4.0;
            let in_world = display_pose.point_in_world(in_view);
            let in_frame = frame_pose.orientation.inverse() * (in_world - frame_pose.position);
            let expected = camera.pixel_from_view(in_frame.as_vec3()).unwrap().as_dvec2();
            let found = Pinhole::new(&camera).pixel(rays.through(column, row).at(4.0));
            assert!((found - expected).length() < 1e-3, "{found} instead of {expected}");
        }
    }
}
