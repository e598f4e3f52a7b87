//! Pictures of everything around the eye: six pinhole cameras, one for each face of a cube.
//!
//! A client that asks for them never runs out of picture, however far the head turns; a frame has some ten times the
//! pixels. Layout: `size` is N x 6 N, the faces one below another in the order +x, -x, +y, -y, +z, -z of view. In
//! the view of a face +X is right, +Y up, and its axis is -Z; that of face -z is the view of the picture itself, the
//! other sides follow from it by a turn about +Y, the upper and the lower one by a turn about +X. These turns are exact.
//!
//! Orientation: faces lie along the axes of the render pose's view, as everything in a frame does. The server does not
//! turn the render pose of a cube with the head: its faces lie along the axes of the world. So a head that only turns
//! gets the same rays again, and what is summed per pixel goes on.
//!
//! Margin: a face shows [`MARGIN_RAD`] more than its quarter on each side, and up to 16 px that round N to a multiple of
//! [`FACE_STEP`]. So every direction has a pixel whose neighbours are of the same face, and no strip of 32 rows and no
//! tile holds pixels of two faces. The normals of a frame are in its view, not in that of their face.
//!
//! Cost of a pixel: a division and a permutation more than of a plane.

use super::{Camera, FieldOfView, ImageSize, Projection};
use glam::{Mat3, Vec2, Vec3};

/// What a face shows at least beyond a quarter, on each side: differences over neighbours and bilinear fetches need a
/// few pixels. A degree less and a face of 32 pixels would have hardly one.
pub const MARGIN_RAD: f32 = 5.0 * std::f32::consts::PI / 180.0;
/// Faces.
const FACES: u32 = 6;
/// Sides of faces are multiples of so many pixels: the rows of a strip.
const FACE_STEP: u32 = 32;
/// Widest face that is still as high as a picture may be.
const MAX_SIDE: u32 = ImageSize::MAX_SIDE / FACES / FACE_STEP * FACE_STEP;

/// A part of a picture that is a pinhole camera's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Its first row in the picture.
    pub first_row: u32,
    /// Its own camera.
    pub camera: Camera,
    /// Turns the view of the picture into that of the face: a permutation of axes with signs.
    pub face_from_view: Mat3,
}

impl Face {
    /// Turns the view of the face into that of the picture.
    pub fn view_from_face(&self) -> Mat3 {
        self.face_from_view.transpose()
    }
}

impl Camera {
    /// The cube around the eye of `display`, with the same focal length in pixels at the middle of each face, if that
    /// makes faces of at most `most_side` pixels; else with such faces.
    pub fn cube(display: &Camera, most_side: u32) -> Camera {
        let least = (std::f32::consts::FRAC_PI_4 + MARGIN_RAD).tan();
        let focal = display.focal_px().max_element();
        let most = (most_side.min(MAX_SIDE) / FACE_STEP * FACE_STEP).max(FACE_STEP);
        let wanted = (2.0 * least * focal / FACE_STEP as f32).ceil() * FACE_STEP as f32;
        let side = (wanted as u32).clamp(FACE_STEP, most);
        // Rounded up it shows a little more, cut down it has larger pixels; of a few pixels only it stays a face.
        let edge = (0.5 * side as f32 / focal).clamp(least, 2.0 * least);
        let fov = FieldOfView { left: -edge, right: edge, down: -edge, up: edge };
        Camera { size: ImageSize::new(side, FACES * side), fov, projection: Projection::Cube }
    }

    /// The pinhole cameras that the picture is made of: one, or six.
    pub fn faces(&self) -> impl ExactSizeIterator<Item = Face> + use<> {
        let (whole, rows) = (*self, self.rows_of_face());
        let count = if self.projection == Projection::Cube { FACES as usize } else { 1 };
        (0..count).map(move |index| Face {
            first_row: index as u32 * rows,
            camera: Camera::perspective(ImageSize::new(whole.size.width, rows), whole.fov),
            face_from_view: if count == 1 { Mat3::IDENTITY } else { view_from_face(index).transpose() },
        })
    }

    /// Rows of the picture that are one face's.
    pub fn rows_of_face(&self) -> u32 {
        match self.projection {
            Projection::Perspective => self.size.height,
            Projection::Cube => self.size.height / FACES,
        }
    }
}

/// Whether a cube has six square faces that leave no gap.
pub(super) fn is_whole(camera: &Camera) -> bool {
    let FieldOfView { left, right, down, up } = camera.fov;
    camera.size.width.checked_mul(FACES) == Some(camera.size.height) && right >= 1.0 && [-left, -down, up] == [right; 3]
}

pub(super) fn ray_in_view(camera: &Camera, pixel: Vec2) -> Vec3 {
    let rows = camera.rows_of_face() as f32;
    // Saturates: above the picture is the first face, below it the last.
    let face = ((pixel.y / rows) as usize).min(FACES as usize - 1);
    let ray = camera.ray_in_face(Vec2::new(pixel.x, pixel.y - face as f32 * rows));
    view_from_face(face) * ray
}

pub(super) fn pixel_from_view(camera: &Camera, point: Vec3) -> Option<Vec2> {
    let size = point.abs();
    let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 1 + usize::from(size.z > size.y) };
    let face = 2 * axis + usize::from(point[axis] < 0.0);
    let in_face = camera.pixel_from_face(view_from_face(face).transpose() * point)?;
    Some(in_face + Vec2::new(0.0, (face as u32 * camera.rows_of_face()) as f32))
}

/// Columns: right, up and back of each face.
fn view_from_face(face: usize) -> Mat3 {
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    match face {
        0 => Mat3::from_cols(z, y, -x),
        1 => Mat3::from_cols(-z, y, x),
        2 => Mat3::from_cols(x, z, -y),
        3 => Mat3::from_cols(x, -z, y),
        4 => Mat3::from_cols(-x, y, -z),
        _ => Mat3::IDENTITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Quat;

    fn cube() -> Camera {
        Camera::cube(&Camera::symmetric(1.4, ImageSize::new(128, 128)), u32::MAX)
    }

    #[test]
    fn faces_look_along_the_axes_of_view_and_are_turned_not_mirrored() {
        let axes = [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y, Vec3::Z, -Vec3::Z];
        for (index, (face, axis)) in cube().faces().zip(axes).enumerate() {
            assert_eq!(face.view_from_face() * Vec3::NEG_Z, axis);
            assert_eq!(face.face_from_view.determinant(), 1.0);
            assert_eq!(face.first_row, index as u32 * cube().size.width);
            let middle = Vec2::new(0.5, index as f32 + 0.5) * cube().size.width as f32;
            assert_eq!(cube().ray_in_view(middle), axis);
        }
        // The four sides are turns about +Y: what is up stays up.
        for (face, angle) in [(0, -1.0), (1, 1.0), (4, 2.0)] {
            let turn = Mat3::from_quat(Quat::from_rotation_y(angle * std::f32::consts::FRAC_PI_2));
            assert!(view_from_face(face).abs_diff_eq(turn, 1e-6));
        }
        for (face, angle) in [(2, 1.0), (3, -1.0)] {
            let turn = Mat3::from_quat(Quat::from_rotation_x(angle * std::f32::consts::FRAC_PI_2));
            assert!(view_from_face(face).abs_diff_eq(turn, 1e-6));
        }
    }

    #[test]
    fn rays_of_a_cube_are_those_of_its_faces_to_the_bit() {
        let cube = cube();
        for face in cube.faces() {
            for index in 0..face.camera.size.pixels() {
                let pixel = face.camera.size.pixel_centre(index);
                let ray = face.view_from_face() * face.camera.ray_in_view(pixel);
                assert_eq!(cube.ray_in_view(pixel + Vec2::new(0.0, face.first_row as f32)), ray);
            }
        }
        let plane = Camera::symmetric(1.0, ImageSize::new(8, 4));
        let faces: Vec<Face> = plane.faces().collect();
        assert_eq!(faces, [Face { first_row: 0, camera: plane, face_from_view: Mat3::IDENTITY }]);
    }

    /// Unproject/project over the whole sphere, ties of axes included.
    #[test]
    fn every_direction_has_a_pixel_in_the_middle_of_a_face_that_shows_it() {
        let cube = cube();
        let side = cube.size.width as f32;
        let focal = cube.focal_px().x;
        let inset = side / 2.0 - focal;
        assert!(inset > 4.0, "pixels beyond a quarter: {inset}");
        let mut directions: Vec<Vec3> = vec![];
        for x in -3..=3 {
            for y in -3..=3 {
                directions.extend((-3..=3).map(|z| Vec3::new(x as f32, y as f32, z as f32)));
            }
        }
        directions.retain(|direction| *direction != Vec3::ZERO);
        for direction in directions {
            for scale in [1e-3, 1.0, 1e9] {
                let pixel = cube.pixel_from_view(direction * scale).unwrap();
                let local = Vec2::new(pixel.x, pixel.y.rem_euclid(side));
                assert!(local.min_element() > inset - 0.01 && local.max_element() < side - inset + 0.01, "{local}");
                let back = cube.ray_in_view(pixel).normalize();
                assert!((back - direction.normalize()).length() < 1e-5, "{direction} came back as {back}");
            }
        }
        for nothing in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY, Vec3::splat(1e-8)] {
            assert_eq!(cube.pixel_from_view(nothing), None, "{nothing}");
        }
    }

    #[test]
    fn a_face_is_as_dense_as_the_display_where_there_is_room() {
        for (side, vertical_rad) in [(64, 1.4), (384, 1.4), (512, 0.9), (33, 2.0)] {
            let display = Camera::symmetric(vertical_rad, ImageSize::new(side, side));
            let cube = Camera::cube(&display, u32::MAX);
            assert!(cube.is_valid() && cube.size.width.is_multiple_of(FACE_STEP), "{cube:?}");
            let ratio = cube.focal_px().max_element() / display.focal_px().max_element();
            let is_tiny = cube.size.width == FACE_STEP;
            assert!((ratio - 1.0).abs() < 1e-5 || is_tiny && ratio >= 1.0, "{side} {vertical_rad}: {ratio}");
            assert!(cube.fov.right >= (std::f32::consts::FRAC_PI_4 + MARGIN_RAD).tan() - 1e-6);
            let smaller = Camera::cube(&display, 48);
            assert_eq!(smaller.size, ImageSize::new(32, 192));
            assert!(smaller.is_valid());
        }
        let large = Camera::cube(&Camera::symmetric(0.1, ImageSize::new(8192, 8192)), u32::MAX);
        assert!(large.is_valid() && large.size.width == 1344);
    }

    #[test]
    fn a_cube_with_a_gap_or_without_six_squares_is_not_valid() {
        let spoilt = |spoil: fn(&mut Camera)| {
            let mut camera = cube();
            spoil(&mut camera);
            camera.is_valid()
        };
        assert!(cube().is_valid());
        assert!(!spoilt(|camera| camera.size.height -= 1));
        assert!(!spoilt(|camera| camera.size.width = u32::MAX));
        assert!(!spoilt(|camera| camera.fov.left *= 1.01));
        assert!(!spoilt(|camera| camera.fov.up = f32::NAN));
        assert!(!spoilt(|camera| {
            camera.fov = FieldOfView { left: -0.9, right: 0.9, down: -0.9, up: 0.9 };
        }));
    }
}
