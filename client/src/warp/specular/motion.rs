//! From pixels of the display back to the view of the frame.

use crate::lanes::{Floats, Vector};
use crate::warp::reproject::{Reprojection, view_from_pixel};
use glam::{Vec2, Vec3};
use warplight_protocol::{Camera, Pose};

/// Pixels of the new picture in terms of the old view.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    /// Homogeneous old pixel at infinity, by columns: x, y, 1.
    pixel: [Vec3; 3],
    /// Its change with the new inverse depth.
    parallax: Vec3,
    /// The new eye in the old view.
    pub(super) eye: Vec3,
    /// Ray in the old view, its new z being -1, by columns.
    ray: [Vec3; 3],
    /// Focal lengths and centre of the new camera, and old_view_to_new's inverse for forward projection.
    pub(super) forward: Reprojection,
}

impl Motion {
    pub(super) fn new(old: &Camera, old_pose: &Pose, new: &Camera, new_pose: &Pose) -> Motion {
        let (pixel, parallax) = Reprojection::new(new, new_pose, old, old_pose).parts();
        let old_from_new = old_pose.view_from(new_pose);
        let rays = old_from_new.rotation * view_from_pixel(new);
        Motion {
            pixel,
            parallax,
            eye: old_from_new.translation,
            ray: [rays.x_axis, rays.y_axis, rays.z_axis],
            forward: Reprojection::new(old, old_pose, new, new_pose),
        }
    }

    /// What does not depend on the depth of a new pixel: its old pixel at infinity, homogeneous.
    #[inline(always)]
    pub(super) fn at_infinity<F: Floats>(&self, x: F, y: F) -> Vector<F> {
        linear(&self.pixel, x, y)
    }

    /// The old pixel of a new one at this new inverse depth, and old depth over new depth.
    #[inline(always)]
    pub(super) fn old_pixel<F: Floats>(&self, at_infinity: Vector<F>, inverse_depth: F) -> (F, F, F) {
        let [x, y, z] = at_infinity.along(Vector::splat(self.parallax), inverse_depth).0;
        let over = F::splat(1.0) / z;
        (x * over, y * over, z)
    }

    /// The new inverse depth of what the old picture shows at this old inverse depth, on the same ray: the
    /// intersection with a plane that faces the old camera. Not above zero where that is behind the eye.
    #[inline(always)]
    pub(super) fn new_inverse_depth<F: Floats>(&self, at_infinity: Vector<F>, old_inverse_depth: F) -> F {
        // 1 / old = z (1 / new), z = a + p new: solved for new.
        let before = F::splat(1.0) - old_inverse_depth * F::splat(self.parallax.z);
        old_inverse_depth * at_infinity.0[2] / before
    }

    /// The ray through a new pixel in the old view.
    #[inline(always)]
    pub(super) fn ray<F: Floats>(&self, x: F, y: F) -> Vector<F> {
        linear(&self.ray, x, y)
    }

    /// Largest motion of the old pixel, in pixels, per unit of the new inverse depth at a new pixel.
    pub(super) fn parallax_px(&self, at: Vec2) -> f32 {
        let h = self.pixel[0] * at.x + self.pixel[1] * at.y + self.pixel[2];
        let p = self.parallax;
        ((p.truncate() - h.truncate() / h.z * p.z) / h.z).abs().max_element()
    }
}

#[inline(always)]
fn linear<F: Floats>(columns: &[Vec3; 3], x: F, y: F) -> Vector<F> {
    let [a, b, c] = *columns;
    Vector::splat(c).along(Vector::splat(a), x).along(Vector::splat(b), y)
}
