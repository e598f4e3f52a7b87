//! Pinhole cameras: image size and an asymmetric field of view, as head-mounted displays have.
//!
//! Spaces, by law of the project:
//! - **world**: metres, right-handed, +Y up.
//! - **view** (also *head*): the eye at the origin, +X right, +Y up, looking along -Z.
//! - **pixel**: +x right, +y down, the origin at the upper left corner of the image, so that the
//!   centre of the first pixel is (0.5, 0.5).
//!
//! Depth *z* of a point in view is `-point.z`, so it is positive in front of the eye; where a distance
//! along the ray is meant, it is called distance. Of a picture of six faces (`cube`) that holds in the view of a face.

mod cube;

pub use cube::{Face, MARGIN_RAD};

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

/// Whole pixels that a picture has more than another of the same focal length, on each side.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Margins {
    /// Columns on the left.
    pub left: u32,
    /// Columns on the right.
    pub right: u32,
    /// Rows below.
    pub down: u32,
    /// Rows above.
    pub up: u32,
}

/// How a picture is laid out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Projection {
    /// On a plane before the eye.
    #[default]
    Perspective,
    /// On the six faces of a cube around the eye, one below another: +x, -x, +y, -y, +z, -z of view.
    Cube,
}

/// What maps view to pixel: a pinhole camera, or six of them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image size; of a cube that of the whole picture, six times as high as wide.
    pub size: ImageSize,
    /// Field of view; of a cube that of each face.
    pub fov: FieldOfView,
    /// How the picture is laid out.
    pub projection: Projection,
}

/// Smallest depth that is projected, in metres; nearer points have no pixel.
pub const MIN_DEPTH_M: f32 = 1e-6;

impl Camera {
    /// A pinhole camera.
    pub const fn perspective(size: ImageSize, fov: FieldOfView) -> Camera {
        Camera { size, fov, projection: Projection::Perspective }
    }

    /// A pinhole camera with a symmetric field of view of `vertical_rad`.
    pub fn symmetric(vertical_rad: f32, size: ImageSize) -> Camera {
        Camera::perspective(size, FieldOfView::symmetric(vertical_rad, size))
    }

    /// Focal lengths in pixels, horizontal and vertical; of a cube those of each face.
    pub fn focal_px(&self) -> Vec2 {
        Vec2::new(
            self.size.width as f32 / (self.fov.right - self.fov.left),
            self.rows_of_face() as f32 / (self.fov.up - self.fov.down),
        )
    }

    /// The pixel position that the viewing axis meets; outside the image for extreme frusta. Of a cube the middle of
    /// a face, counted from its own first row.
    pub fn centre_px(&self) -> Vec2 {
        self.focal_px() * Vec2::new(-self.fov.left, self.fov.up)
    }

    /// The ray through `pixel`, scaled so that its z (of a cube: in the view of the face) is -1: times the depth z it
    /// is the point in view.
    pub fn ray_in_view(&self, pixel: Vec2) -> Vec3 {
        match self.projection {
            Projection::Perspective => self.ray_in_face(pixel),
            Projection::Cube => cube::ray_in_view(self, pixel),
        }
    }

    /// The pixel position of a point or, at infinity, of a direction; `None` behind the eye, nearer than
    /// [`MIN_DEPTH_M`] or where it is not finite. Of a cube it is in the face about whose axis the point lies.
    pub fn pixel_from_view(&self, point_in_view: Vec3) -> Option<Vec2> {
        match self.projection {
            Projection::Perspective => self.pixel_from_face(point_in_view),
            Projection::Cube => cube::pixel_from_view(self, point_in_view),
        }
    }

    fn ray_in_face(&self, pixel: Vec2) -> Vec3 {
        let slope = (pixel - self.centre_px()) / self.focal_px();
        Vec3::new(slope.x, -slope.y, -1.0)
    }

    fn pixel_from_face(&self, point: Vec3) -> Option<Vec2> {
        let depth = -point.z;
        if !(depth >= MIN_DEPTH_M && depth.is_finite()) {
            return None;
        }
        let slope = Vec2::new(point.x, -point.y) / depth;
        let pixel = slope * self.focal_px() + self.centre_px();
        pixel.is_finite().then_some(pixel)
    }

    /// The camera that shows more on each side at the same focal length: pixel (x, y) of this one is pixel
    /// (x + left, y + up) of that one, to 1e-3 px. A cube shows everything as it is.
    pub fn widened(&self, margins: Margins) -> Camera {
        if self.projection == Projection::Cube {
            return *self;
        }
        let focal = self.focal_px().as_dvec2();
        let size = ImageSize::new(
            self.size.width.saturating_add(margins.left).saturating_add(margins.right),
            self.size.height.saturating_add(margins.up).saturating_add(margins.down),
        );
        // f64: a focal length that is off by its last digit moves the far side of a wide picture.
        let beyond = |tangent: f32, px: u32, focal: f64| (f64::from(tangent) + f64::from(px) / focal) as f32;
        let fov = FieldOfView {
            left: -beyond(-self.fov.left, margins.left, focal.x),
            right: beyond(self.fov.right, margins.right, focal.x),
            down: -beyond(-self.fov.down, margins.down, focal.y),
            up: beyond(self.fov.up, margins.up, focal.y),
        };
        Camera::perspective(size, fov)
    }

    /// Column and row of `wider` at which the picture of this camera begins, if its pixels are pixels of that one.
    pub fn offset_in(&self, wider: &Camera) -> Option<[u32; 2]> {
        /// A quarter of the step of 1/256 px to which positions are rounded wherever pictures are sampled.
        const SAME_PX: f32 = 1.0 / 1024.0;
        if [self.projection, wider.projection] != [Projection::Perspective; 2] {
            return (self == wider).then_some([0, 0]);
        }
        let offset = wider.centre_px() - self.centre_px();
        let whole = offset.round();
        let side = self.size.width.max(self.size.height) as f32;
        let stretch = (wider.focal_px() / self.focal_px() - 1.0).abs().max_element() * side;
        let fits = whole.min_element() >= 0.0
            && whole.x as u32 + self.size.width <= wider.size.width
            && whole.y as u32 + self.size.height <= wider.size.height;
        let same = (offset - whole).abs().max_element() <= SAME_PX && stretch <= SAME_PX;
        (fits && same).then_some([whole.x as u32, whole.y as u32])
    }

    /// Whether size and field of view are usable, and those of a cube are those of one.
    pub fn is_valid(&self) -> bool {
        let is_whole = self.projection == Projection::Perspective || cube::is_whole(self);
        self.size.is_valid() && self.fov.is_valid() && is_whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;

    fn asymmetric() -> Camera {
        Camera::perspective(ImageSize::new(640, 480), FieldOfView { left: -1.2, right: 0.7, down: -0.9, up: 0.8 })
    }

    #[test]
    fn corners_of_the_image_are_the_edges_of_the_frustum() {
        let camera = asymmetric();
        let upper_left = camera.ray_in_view(Vec2::ZERO);
        assert!((upper_left - Vec3::new(-1.2, 0.8, -1.0)).length() < 1e-6);
        let lower_right = camera.ray_in_view(Vec2::new(640.0, 480.0));
        assert!((lower_right - Vec3::new(0.7, -0.9, -1.0)).length() < 1e-6);
    }

    #[test]
    fn stability_unproject_and_project() {
        let wide = Camera::symmetric(179.0_f32.to_radians(), ImageSize::new(1024, 1024));
        let cube = Camera::cube(&asymmetric(), 512);
        let mut round_trip = bound!("unproject", "round trip, px", 1e-3);
        for (camera, stride) in [(asymmetric(), 97), (wide, 97), (cube, 997)] {
            let corners = [0, camera.size.width as usize - 1, camera.size.pixels() - 1];
            for index in (0..camera.size.pixels()).step_by(stride).chain(corners) {
                let pixel = camera.size.pixel_centre(index);
                for depth in [1e-3, 1.0, 1e3, 1e9] {
                    let back = camera.pixel_from_view(camera.ray_in_view(pixel) * depth).unwrap();
                    // Beyond its quarter of the sphere a face of a cube is left to its neighbour.
                    let is_neighbours = camera.projection == Projection::Cube && (back - pixel).length() > 1.0;
                    if !is_neighbours {
                        round_trip.see((back - pixel).length().into(), format!("{pixel} at {depth} m"));
                    }
                }
            }
        }
        let mut pixels = bound!("unproject", "undefined points that have a pixel", 0.0);
        let camera = asymmetric();
        for z in [0.0, -0.0, -1e-45, -1e-7, 1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            pixels.count(camera.pixel_from_view(Vec3::new(0.1, 0.1, z)).is_some(), z);
        }
        for x in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            pixels.count(camera.pixel_from_view(Vec3::new(x, 0.0, -1.0)).is_some(), x);
            pixels.count(camera.pixel_from_view(Vec3::new(0.0, x, -1.0)).is_some(), x);
        }
    }

    #[test]
    fn a_wider_picture_has_the_pixels_of_the_narrower_one() {
        let margins = Margins { left: 48, right: 16, down: 0, up: 112 };
        for camera in [asymmetric(), Camera::symmetric(1.4, ImageSize::new(2048, 2048))] {
            let wider = camera.widened(margins);
            assert_eq!(wider.size, ImageSize::new(camera.size.width + 64, camera.size.height + 112));
            for index in (0..camera.size.pixels()).step_by(4999) {
                let pixel = camera.size.pixel_centre(index);
                let same = wider.pixel_from_view(camera.ray_in_view(pixel)).unwrap();
                assert!((same - pixel - Vec2::new(48.0, 112.0)).length() < 1e-3, "{pixel} is {same}");
            }
            assert_eq!(camera.offset_in(&wider), Some([48, 112]));
            assert_eq!(camera.offset_in(&camera), Some([0, 0]));
            assert_eq!(wider.offset_in(&camera), None, "not the other way round");
        }
    }

    #[test]
    fn pictures_of_other_grids_have_no_offset() {
        let camera = Camera::symmetric(1.0, ImageSize::new(64, 64));
        let wider = camera.widened(Margins { left: 8, right: 8, down: 8, up: 8 });
        assert_eq!(Camera::symmetric(1.001, camera.size).offset_in(&wider), None, "another focal length");
        let mut between = camera;
        let half = 0.5 / camera.focal_px().x;
        (between.fov.left, between.fov.right) = (camera.fov.left + half, camera.fov.right + half);
        assert_eq!(between.offset_in(&wider), None, "half a pixel aside");
    }

    #[test]
    fn sizes_are_read_and_refused_in_words() {
        assert_eq!("512x256".parse::<ImageSize>().unwrap(), ImageSize::new(512, 256));
        for bad in ["", "512", "0x4", "9000x2", "axb", "4x-1"] {
            assert!(bad.parse::<ImageSize>().unwrap_err().contains("expected WIDTHxHEIGHT"));
        }
    }
}
