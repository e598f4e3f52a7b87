//! The uncompressed frame of the thesis (Lochmann, 3.2.4): our first oracle for bytes, and one point of
//! the accuracy ladder.
//!
//! `P (40 N + D + M) + 12 * 16` bits for P pixels and N nodes: per pixel and node linear RGB of 8 bits each
//! and a depth of 16, then D bits of validity (one for each child) and M bits of material; at the end the pose
//! as twelve half floats. Depth is inverse distance from the parent in equal steps up to the nearest point
//! of the frame, whose value both ends are told beforehand, as the thesis tells the projection.

use super::{Interfaces, Plan, Tree, UNDEFINED};
use crate::codec::bits::{BitReader, BitWriter};
use crate::frame::ColorFormat;
use crate::{Camera, Pose};
use glam::Vec3;

/// Why bytes are no frame of this form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ThesisError {
    /// The length is not the one that plan and size call for.
    #[error("thesis frame: {found} bytes, expected {expected}")]
    Length {
        /// Bytes found.
        found: usize,
        /// Bytes called for.
        expected: usize,
    },
    /// The matrix is not a rotation.
    #[error("thesis frame: the pose is not a rotation")]
    Pose,
}

/// Size of a frame in bits: `P (40 N + D + M) + 192`.
pub fn thesis_bits(camera: &Camera, plan: &Plan, interfaces: &Interfaces) -> usize {
    let nodes = plan.nodes().len();
    camera.size.pixels() * (40 * nodes + (nodes - 1) + interfaces.bits()) + 12 * 16
}

/// Writes `tree`; `white` is the radiance of the largest code, `near_m` the distance of the largest depth code.
pub fn encode_thesis(tree: &Tree, white: f32, near_m: f32) -> Vec<u8> {
    let mut bits = BitWriter::default();
    for pixel in 0..tree.camera.size.pixels() {
        for (index, planes) in tree.nodes.iter().enumerate() {
            let distance = planes.distance[pixel];
            for channel in &planes.radiance {
                bits.write(u64::from(ColorFormat::Linear8.quantise(channel[pixel], white)), 8);
            }
            bits.write(depth_code(distance, near_m), 16);
            if index > 0 {
                bits.write(u64::from(distance != UNDEFINED), 1);
            }
        }
        let interface = tree.nodes[0].interface.get(pixel).copied().unwrap_or(0);
        bits.write(u64::from(interface), tree.interfaces.bits());
    }
    let pose = tree.render_pose.to_half_matrix();
    for pair in pose.chunks_exact(2) {
        bits.write(u64::from(u16::from_le_bytes([pair[0], pair[1]])), 16);
    }
    bits.finish()
}

/// Reads what [`encode_thesis`] wrote. The tree has no normals; deeper nodes show the interface of the root.
pub fn decode_thesis(
    bytes: &[u8],
    camera: Camera,
    plan: Plan,
    interfaces: Interfaces,
    white: f32,
    near_m: f32,
) -> Result<Tree, ThesisError> {
    let expected = thesis_bits(&camera, &plan, &interfaces).div_ceil(8);
    let length = ThesisError::Length { found: bytes.len(), expected };
    if bytes.len() != expected {
        return Err(length);
    }
    let mut bits = BitReader::new(bytes);
    let mut read = |count: usize| bits.read(count).ok_or(length);
    let mut tree = Tree::new(Pose::IDENTITY, camera, plan, interfaces);
    for pixel in 0..tree.camera.size.pixels() {
        for node in 0..tree.nodes.len() {
            let mut color = [0.0; 3];
            for channel in &mut color {
                *channel = ColorFormat::Linear8.dequantise(read(8)? as u16, white);
            }
            let code = read(16)?;
            let defined = node == 0 || read(1)? == 1;
            let planes = &mut tree.nodes[node];
            planes.set_radiance(pixel, Vec3::from_array(color));
            planes.distance[pixel] = if defined { distance_of(code, near_m) } else { UNDEFINED };
        }
        let interface = read(tree.interfaces.bits())? as u8;
        for node in 0..tree.nodes.len() {
            if let Some(own) = tree.nodes[node].interface.get_mut(pixel) {
                *own = interface;
            }
        }
    }
    let mut pose = [0; Pose::HALF_BYTES];
    for pair in pose.chunks_exact_mut(2) {
        pair.copy_from_slice(&(read(16)? as u16).to_le_bytes());
    }
    tree.render_pose = Pose::from_half_matrix(&pose).ok_or(ThesisError::Pose)?;
    Ok(tree)
}

const LARGEST_DEPTH_CODE: f32 = 65_535.0;

fn depth_code(distance: f32, near_m: f32) -> u64 {
    if distance == f32::INFINITY || distance == UNDEFINED {
        return 0;
    }
    (near_m / distance * LARGEST_DEPTH_CODE).round().clamp(1.0, LARGEST_DEPTH_CODE) as u64
}

fn distance_of(code: u64, near_m: f32) -> f32 {
    if code == 0 { f32::INFINITY } else { near_m * LARGEST_DEPTH_CODE / code as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ImageSize;
    use crate::optics::Interface;

    #[test]
    fn the_size_is_the_thesis_formula_to_the_bit() {
        let size = ImageSize::new(8, 4);
        let camera = Camera::symmetric(1.0, size);
        // N nodes, D = N - 1 validity bits, M material bits.
        for (plan, entries, n, d, m) in [
            (Plan::diffuse(), 0, 1, 0, 0),
            (Plan::mirror(), 1, 2, 1, 1),
            (Plan::water(), 3, 3, 2, 2),
            (Plan::solid(), 4, 4, 3, 3),
        ] {
            let interfaces = Interfaces(vec![Interface::Mirror; entries]);
            let bits = size.pixels() * (n * 40 + d + m) + 12 * 16;
            assert_eq!(thesis_bits(&camera, &plan, &interfaces), bits);
            let tree = Tree::new(Pose::IDENTITY, camera, plan, interfaces);
            assert_eq!(encode_thesis(&tree, 1.0, 0.1).len(), bits.div_ceil(8));
        }
    }

    #[test]
    fn a_frame_comes_back_to_its_steps() {
        let camera = Camera::symmetric(1.0, ImageSize::new(6, 5));
        let interfaces = Interfaces(vec![Interface::Mirror, Interface::Dielectric { eta: 1.5 }]);
        let mut tree = Tree::new(Pose::IDENTITY, camera, Plan::water(), interfaces);
        for pixel in 0..30 {
            for node in 0..3 {
                let planes = &mut tree.nodes[node];
                planes.set_radiance(pixel, Vec3::new(0.1, 0.5, 0.9) * (pixel as f32 / 30.0));
                planes.distance[pixel] = if node == 2 && pixel % 3 == 0 { UNDEFINED } else { 0.5 + pixel as f32 };
            }
            tree.nodes[0].interface[pixel] = (pixel % 3) as u8;
        }
        let bytes = encode_thesis(&tree, 1.0, 0.5);
        let back = decode_thesis(&bytes, camera, tree.plan.clone(), tree.interfaces.clone(), 1.0, 0.5).unwrap();
        for node in 0..3 {
            for pixel in 0..30 {
                let (was, is) = (&tree.nodes[node], &back.nodes[node]);
                assert!((was.radiance_at(pixel) - is.radiance_at(pixel)).abs().max_element() <= 0.5 / 255.0 + 1e-6);
                assert!((was.distance[pixel] - is.distance[pixel]).abs() < 0.02);
            }
        }
        assert_eq!(back.nodes[0].interface, tree.nodes[0].interface);
        for end in 0..bytes.len() {
            assert!(
                decode_thesis(&bytes[..end], camera, tree.plan.clone(), tree.interfaces.clone(), 1.0, 0.5).is_err()
            );
        }
    }
}
