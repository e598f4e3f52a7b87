//! Frames of the scenes, as the client gets them: traced, quantised, coded and decoded by the formats of the wire.

use super::AnalyticScene;
use crate::loopback::{Loopback, ReceivedFrame};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use warplight_protocol::codec::{DecodeError, FrameShape};
use warplight_protocol::frame::{FrameFormat, Interfaces, Tree, VolumeRange};
use warplight_protocol::optics::Interface;
use warplight_protocol::{Camera, Pose};

/// Rows of a strip, as the server sends them.
const STRIP_ROWS: u16 = 32;

/// Sends a tree without layers over the wire in this format.
pub fn through_the_wire(tree: Tree, format: FrameFormat) -> Result<ReceivedFrame, DecodeError> {
    let shape = FrameShape {
        camera: tree.camera,
        plan: tree.plan.clone(),
        interfaces: tree.interfaces.clone(),
        format,
        volume: VolumeRange::default(),
        strip_rows: STRIP_ROWS,
        exposure: 1.0,
    };
    Loopback::default().send(tree, &shape)
}

/// Radiance of the room: smooth, so that bytes are those of a picture without noise.
fn pattern(point: DVec3) -> Vec3 {
    let [x, y, z] = point.as_vec3().to_array();
    Vec3::splat(0.5) + 0.4 * Vec3::new((5.0 * x).sin(), (6.0 * y).cos(), (4.0 * (x + z)).sin())
}

impl AnalyticScene {
    /// The frame of this pose, unquantised.
    pub fn tree(self, camera: &Camera, pose: &Pose) -> Tree {
        let (camera, size) = (*camera, camera.size);
        let interface = self.eta().map_or(Interface::Mirror, |eta| Interface::Dielectric { eta: eta as f32 });
        let back = self.eta().map_or(Interface::Mirror, |eta| Interface::Dielectric { eta: 1.0 / eta as f32 });
        let mut tree = Tree::new(*pose, camera, self.plan(), Interfaces(vec![interface, back]));
        let last = tree.nodes.len() - 1;
        let chains: Vec<_> = (0..size.pixels())
            .into_par_iter()
            .map(|pixel| self.chain_at(&camera, pose, size.pixel_centre(pixel).as_dvec2()))
            .collect();
        for (pixel, chain) in chains.into_iter().enumerate() {
            let ray = camera.ray_in_view(size.pixel_centre(pixel)).as_dvec3().normalize();
            let Some((distance, bounces)) = chain else {
                let direction = pose.orientation * ray;
                let distance = self.room(pose.position, direction);
                tree.nodes[0].distance[pixel] = distance as f32;
                tree.nodes[0].set_radiance(pixel, pattern(pose.position + direction * distance));
                continue;
            };
            let in_view = |direction: DVec3| (pose.orientation.inverse() * direction).as_vec3();
            tree.nodes[0].distance[pixel] = distance as f32;
            tree.nodes[0].interface[pixel] = 1;
            tree.nodes[0].set_normal(pixel, in_view(bounces[0].normal));
            match &bounces[..] {
                [bounce] => {
                    tree.nodes[last].distance[pixel] = bounce.reach as f32;
                    tree.nodes[last].set_radiance(pixel, pattern(bounce.shown()));
                }
                [first, second] => {
                    tree.nodes[2].distance[pixel] = first.reach as f32;
                    tree.nodes[2].interface[pixel] = 2;
                    tree.nodes[2].set_normal(pixel, in_view(second.normal));
                    tree.nodes[2].set_shape(pixel, self.exit_shape());
                    tree.nodes[3].distance[pixel] = second.reach as f32;
                    tree.nodes[3].set_radiance(pixel, pattern(second.shown()));
                }
                _ => unreachable!("one bounce or two"),
            }
        }
        tree
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use warplight_protocol::ImageSize;

    #[test]
    fn what_arrives_is_what_was_sent_up_to_the_steps_of_the_format() {
        let camera = Camera::symmetric(1.5, ImageSize::new(128, 96));
        for scene in AnalyticScene::SWEPT {
            let sent = scene.tree(&camera, &scene.eye());
            let received = through_the_wire(sent.clone(), FrameFormat::exact()).unwrap();
            assert!(received.bytes >= received.plane_bytes.values().sum(), "{scene:?}");
            let boundaries = sent.nodes[0].interface.iter().filter(|&&interface| interface != 0).count();
            assert!(boundaries > sent.nodes[0].interface.len() / 20, "{scene:?} {boundaries}");
            for (sent, got) in sent.nodes[0].distance.iter().zip(&received.tree.nodes[0].distance) {
                // A step is 2^-16 of the nearest inverse depth, which is at most 12 times this one in these rooms.
                assert!((sent - got).abs() < sent * 12.0 / 65_535.0, "{scene:?} {sent} {got}");
            }
        }
    }
}
