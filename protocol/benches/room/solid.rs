//! A solid of glass: an ellipsoid in closed form, whose exit surface bends differently at every pixel.

use glam::{Mat3, Quat, Vec3};
use warplight_protocol::codec::FrameShape;
use warplight_protocol::curvature::ShapeOperator;
use warplight_protocol::frame::{FrameFormat, Interfaces, Plan, Tree, VolumeRange};
use warplight_protocol::optics::{Interface, refract};
use warplight_protocol::{Camera, ImageSize, Pose};

const AXES: Vec3 = Vec3::new(0.6, 0.4, 0.25);
const CENTRE: Vec3 = Vec3::new(0.0, 0.0, -1.2);

/// The second of the two distances at which a line meets the ellipsoid, or the first.
fn meet(from: Vec3, direction: Vec3, second: bool) -> Option<f32> {
    let (from, direction) = (from / AXES, direction / AXES);
    let (a, b, c) = (direction.length_squared(), from.dot(direction), from.length_squared() - 1.0);
    let root = (b * b - a * c).sqrt();
    (root > 0.0).then(|| (if second { root - b } else { -root - b }) / a)
}

/// A frame of {D, R, F, FF} of which boundaries, normals and shapes are filled.
pub(crate) fn frame(side: u32, format: FrameFormat, strip_rows: u16) -> (FrameShape, Tree) {
    let shape = FrameShape {
        camera: Camera::symmetric(1.2, ImageSize::new(side, side)),
        plan: Plan::solid(),
        interfaces: Interfaces(vec![Interface::Dielectric { eta: 1.5 }, Interface::Dielectric { eta: 1.0 / 1.5 }]),
        format,
        volume: VolumeRange::default(),
        strip_rows,
        exposure: 1.0,
    };
    let mut tree = shape.tree(Pose::IDENTITY);
    let turn = Quat::from_euler(glam::EulerRot::YXZ, 0.7, -0.4, 1.1);
    let (view_from_own, own_from_view) = (Mat3::from_quat(turn), Mat3::from_quat(turn.inverse()));
    let eye = own_from_view * -CENTRE;
    let squared = AXES * AXES;
    for pixel in 0..shape.camera.size.pixels() {
        let ray = own_from_view * shape.camera.ray_in_view(shape.camera.size.pixel_centre(pixel)).normalize();
        tree.nodes[0].distance[pixel] = 3.0;
        let Some(distance) = meet(eye, ray, false) else { continue };
        let entry = eye + ray * distance;
        let normal = (entry / squared).normalize();
        tree.nodes[0].distance[pixel] = distance;
        tree.nodes[0].interface[pixel] = 1;
        tree.nodes[0].set_normal(pixel, view_from_own * normal);
        let Some(inside) = refract(ray, normal, 1.5) else { continue };
        let Some(distance) = meet(entry, inside, true) else { continue };
        let slope = (entry + inside * distance) / squared;
        let normal = -slope.normalize();
        // From inside: the derivative of -g / |g|.
        let across = Mat3::IDENTITY - Mat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
        let gradient = across * Mat3::from_diagonal(1.0 / squared) * (-1.0 / slope.length());
        let planes = &mut tree.nodes[2];
        planes.distance[pixel] = distance;
        planes.interface[pixel] = 2;
        planes.set_normal(pixel, view_from_own * normal);
        let gradient_in_view = view_from_own * gradient * own_from_view;
        planes.set_shape(pixel, ShapeOperator::of_gradient(view_from_own * normal, gradient_in_view));
    }
    (shape, tree)
}

/// The codes of its shape operators as the codec has them, but with one scale for the whole frame and undefined pixels left
/// to the predictor; and where they are defined.
pub(crate) fn shape_codes(shape: &FrameShape, tree: &Tree) -> (Vec<Vec<u32>>, Vec<bool>) {
    let planes = &tree.nodes[2];
    let bits = u32::from(shape.format.shape_bits);
    let scale = planes.shape.iter().flatten().fold(0.0_f32, |scale, entry| scale.max(entry.abs()));
    let code = |&entry: &f32| {
        let code =
            ((100.0 * entry.abs() / scale).ln_1p() / 100_f32.ln_1p() * ((1 << (bits - 1)) - 1) as f32).round() as i32;
        code.wrapping_mul(if entry < 0.0 { -1 } else { 1 }) as u32 & ((1 << bits) - 1)
    };
    let codes = planes.shape.iter().map(|entries| entries.iter().map(code).collect()).collect();
    (codes, planes.interface.iter().map(|&interface| interface > 0).collect())
}
