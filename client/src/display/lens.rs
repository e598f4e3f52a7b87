//! A thin lens from one frame: many pinholes in its aperture, whose pictures agree on the plane in focus (Cook, Porter
//! and Carpenter 1984).
//!
//! The pinhole at (u, v) in the plane of the lens sees the point (x, y, -f) of the plane in focus under the tangent
//! (x - u) / f; so its field of view is that of the middle, sheared by -(u, v) / f. A point at depth d is spread over a
//! circle of the diameter `aperture |1/f - 1/d|` in tangents.
//!
//! Points are those of a sunflower (Vogel 1979): an even cover of the disc for any number, and the same every time.

use glam::{DVec2, DVec3, Vec2};
use warplight_protocol::{Camera, FieldOfView, Pose};

/// A lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Diameter in metres.
    pub aperture_m: f64,
    /// Depth z of the plane in focus, in metres.
    pub focus_m: f64,
    /// Pinholes.
    pub samples: usize,
}

/// The golden angle in radians, pi (3 - sqrt 5).
const GOLDEN_RAD: f64 = 2.399_963_229_728_653;

impl Lens {
    /// Pinhole number `sample` of `count`, from the middle of the lens: right and up, in metres.
    pub(super) fn point_m(&self, sample: usize, count: usize) -> DVec2 {
        let radius = 0.5 * self.aperture_m * ((sample as f64 + 0.5) / count as f64).sqrt();
        DVec2::from_angle(GOLDEN_RAD * sample as f64) * radius
    }

    /// What is seen through the pinhole at `point_m`.
    pub(super) fn view(&self, pose: &Pose, camera: &Camera, point_m: DVec2) -> (Pose, Camera) {
        let aside = pose.orientation * DVec3::new(point_m.x, point_m.y, 0.0);
        let Vec2 { x, y } = (point_m / self.focus_m).as_vec2();
        let FieldOfView { left, right, down, up } = camera.fov;
        let fov = FieldOfView { left: left - x, right: right - x, down: down - y, up: up - y };
        (Pose { position: pose.position + aside, ..*pose }, Camera { fov, ..*camera })
    }
}
