//! Pinhole cameras: image size and an asymmetric field of view, as head-mounted displays have.
//!
//! Spaces, by law of the project:
//! - **world**: metres, right-handed, +Y up.
//! - **view** (also *head*): the eye at the origin, +X right, +Y up, looking along -Z.
//! - **pixel**: +x right, +y down, the origin at the upper left corner of the image, so that the
//!   centre of the first pixel is (0.5, 0.5).
//!
//! Depth *z* of a point in view is `-point.z`, so it is positive in front of the eye; where a distance
//! along the ray is meant, it is called distance.

use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// Width and height of an image in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ImageSize {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl ImageSize {
    /// Longest side that is accepted anywhere, in pixels.
    pub const MAX_SIDE: u32 = 8192;

    /// A size of `width` x `height` pixels.
    pub const fn new(width: u32, height: u32) -> ImageSize {
        ImageSize { width, height }
    }

    /// Number of pixels.
    pub const fn pixels(self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Whether both sides are between 1 and [`ImageSize::MAX_SIDE`].
    pub const fn is_valid(self) -> bool {
        self.width >= 1 && self.height >= 1 && self.width <= Self::MAX_SIDE && self.height <= Self::MAX_SIDE
    }

    /// Centre of pixel number `index`, counted row by row.
    pub fn pixel_centre(self, index: usize) -> Vec2 {
        let width = self.width as usize;
        Vec2::new((index % width) as f32 + 0.5, (index / width) as f32 + 0.5)
    }
}

impl std::fmt::Display for ImageSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl std::str::FromStr for ImageSize {
    type Err = String;
    fn from_str(text: &str) -> Result<ImageSize, String> {
        let expected = || format!("expected WIDTHxHEIGHT, each 1 to {}, found '{text}'", ImageSize::MAX_SIDE);
        let (width, height) = text.split_once('x').ok_or_else(expected)?;
        let size = ImageSize {
            width: width.parse().map_err(|_| expected())?,
            height: height.parse().map_err(|_| expected())?,
        };
        if size.is_valid() { Ok(size) } else { Err(expected()) }
    }
}

/// The four half-angles of a view frustum as tangents; left and down are negative for a frustum that
/// holds the viewing axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldOfView {
    /// x / -z of the left edge.
    pub left: f32,
    /// x / -z of the right edge.
    pub right: f32,
    /// y / -z of the lower edge.
    pub down: f32,
    /// y / -z of the upper edge.
    pub up: f32,
}

impl FieldOfView {
    /// A symmetric frustum of `vertical_rad` for an image of `size` with square pixels.
    pub fn symmetric(vertical_rad: f32, size: ImageSize) -> FieldOfView {
        let up = (vertical_rad * 0.5).tan();
        let right = up * size.width as f32 / size.height as f32;
        FieldOfView { left: -right, right, down: -up, up }
    }

    /// Finite, not empty and narrower than 179.99 degrees.
    pub fn is_valid(&self) -> bool {
        const MAX_TANGENT: f32 = 1.2e4;
        let inside = |t: f32| t.abs() < MAX_TANGENT;
        inside(self.left)
            && inside(self.right)
            && inside(self.down)
            && inside(self.up)
            && self.right - self.left > 1e-6
            && self.up - self.down > 1e-6
    }
}

/// A pinhole camera: what maps view to pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image size.
    pub size: ImageSize,
    /// Field of view.
    pub fov: FieldOfView,
}

/// Smallest depth that is projected, in metres; nearer points have no pixel.
pub const MIN_DEPTH_M: f32 = 1e-6;

impl Camera {
    /// A camera with a symmetric field of view of `vertical_rad`.
    pub fn symmetric(vertical_rad: f32, size: ImageSize) -> Camera {
        Camera { size, fov: FieldOfView::symmetric(vertical_rad, size) }
    }

    /// Focal lengths in pixels, horizontal and vertical.
    pub fn focal_px(&self) -> Vec2 {
        Vec2::new(
            self.size.width as f32 / (self.fov.right - self.fov.left),
            self.size.height as f32 / (self.fov.up - self.fov.down),
        )
    }

    /// The pixel position that the viewing axis meets; outside the image for extreme frusta.
    pub fn centre_px(&self) -> Vec2 {
        self.focal_px() * Vec2::new(-self.fov.left, self.fov.up)
    }

    /// The ray through `pixel`, scaled so that its z is -1: times the depth z it is the point in view.
    pub fn ray_in_view(&self, pixel: Vec2) -> Vec3 {
        let slope = (pixel - self.centre_px()) / self.focal_px();
        Vec3::new(slope.x, -slope.y, -1.0)
    }

    /// The pixel position of a point or, at infinity, of a direction; `None` behind the eye, nearer than
    /// [`MIN_DEPTH_M`] or where it is not finite.
    pub fn pixel_from_view(&self, point_in_view: Vec3) -> Option<Vec2> {
        let depth = -point_in_view.z;
        if !(depth >= MIN_DEPTH_M && depth.is_finite()) {
            return None;
        }
        let slope = Vec2::new(point_in_view.x, -point_in_view.y) / depth;
        let pixel = slope * self.focal_px() + self.centre_px();
        pixel.is_finite().then_some(pixel)
    }

    /// Whether size and field of view are usable.
    pub fn is_valid(&self) -> bool {
        self.size.is_valid() && self.fov.is_valid()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asymmetric() -> Camera {
        Camera { size: ImageSize::new(640, 480), fov: FieldOfView { left: -1.2, right: 0.7, down: -0.9, up: 0.8 } }
    }

    #[test]
    fn corners_of_the_image_are_the_edges_of_the_frustum() {
        let camera = asymmetric();
        let upper_left = camera.ray_in_view(Vec2::ZERO);
        assert!((upper_left - Vec3::new(-1.2, 0.8, -1.0)).length() < 1e-6);
        let lower_right = camera.ray_in_view(Vec2::new(640.0, 480.0));
        assert!((lower_right - Vec3::new(0.7, -0.9, -1.0)).length() < 1e-6);
    }

    /// numerics: unproject/project, off-axis and 179 degrees, from millimetres to the horizon.
    #[test]
    fn unproject_then_project_returns_the_pixel_to_a_thousandth() {
        let wide = Camera::symmetric(179.0_f32.to_radians(), ImageSize::new(1024, 1024));
        for camera in [asymmetric(), wide] {
            for index in (0..camera.size.pixels()).step_by(997) {
                let pixel = camera.size.pixel_centre(index);
                for depth in [1e-3, 1.0, 1e3, 1e9] {
                    let back = camera.pixel_from_view(camera.ray_in_view(pixel) * depth).unwrap();
                    assert!((back - pixel).length() < 1e-3, "{pixel} at {depth} m came back as {back}");
                }
            }
        }
    }

    /// numerics: unproject/project, behind the eye, at it, and what is no number.
    #[test]
    fn a_point_without_a_pixel_is_undefined() {
        let camera = asymmetric();
        for z in [0.0, -1e-7, 1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(camera.pixel_from_view(Vec3::new(0.1, 0.1, z)), None, "z = {z}");
        }
        assert_eq!(camera.pixel_from_view(Vec3::new(f32::NAN, 0.0, -1.0)), None);
    }

    #[test]
    fn sizes_are_read_and_refused_in_words() {
        assert_eq!("512x256".parse::<ImageSize>().unwrap(), ImageSize::new(512, 256));
        for bad in ["", "512", "0x4", "9000x2", "axb", "4x-1"] {
            assert!(bad.parse::<ImageSize>().unwrap_err().contains("expected WIDTHxHEIGHT"));
        }
    }
}
