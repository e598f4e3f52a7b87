//! A face of a frame that looks around, as a frame of its own: a tree of one pinhole camera, which is all that the rest of
//! the warp knows.
//!
//! Normals are turned into the view of the face. Shape operators are left out: their basis does not turn with them, and
//! differences of normals do instead. Cost: a copy of the face's planes.

use rayon::prelude::*;
use warplight_protocol::Pose;
use warplight_protocol::camera::Face;
use warplight_protocol::frame::Tree;

/// Makes `to` the tree of this face of `tree`.
pub(super) fn copy_face(tree: &Tree, face: &Face, to: &mut Tree) {
    let turn = glam::DQuat::from_mat3(&face.view_from_face().as_dmat3());
    let pose = Pose { orientation: (tree.render_pose.orientation * turn).normalize(), ..tree.render_pose };
    to.reset(pose, face.camera, &tree.plan, &tree.interfaces);
    let first = face.first_row as usize * face.camera.size.width as usize;
    let pixels = first..first + face.camera.size.pixels();
    to.nodes.par_iter_mut().zip(&tree.nodes).for_each(|(to, from)| {
        for (to, from) in to.radiance.iter_mut().zip(&from.radiance) {
            to.copy_from_slice(&from[pixels.clone()]);
        }
        to.distance.copy_from_slice(&from.distance[pixels.clone()]);
        to.shape.iter_mut().for_each(Vec::clear);
        if to.interface.is_empty() {
            return;
        }
        to.interface.copy_from_slice(&from.interface[pixels.clone()]);
        for pixel in 0..to.interface.len() {
            to.set_normal(pixel, face.face_from_view * from.normal_at(first + pixel));
        }
    });
}
