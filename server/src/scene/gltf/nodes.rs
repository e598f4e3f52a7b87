//! The tree of nodes: transforms are multiplied down, meshes and lights placed, cameras named.

use super::super::{NamedCamera, Part, SceneError};
use super::Source;
use super::lights;
use super::materials::UvSets;
use super::primitive::triangles;
use super::unsupported::Unsupported;
use glam::{DAffine3, DMat3, DMat4, DQuat, Mat4};
use gltf::Node;
use gltf::camera::Projection;
use warplight_protocol::Pose;

/// Places everything that the file's scene shows.
pub(super) fn read(
    source: &Source,
    uv_sets: &UvSets,
    part: &mut Part,
    unsupported: &mut Unsupported,
) -> Result<(), SceneError> {
    let mut visited = vec![false; source.document.nodes().len()];
    let mut pending: Vec<(Node, DAffine3)> = roots(source).into_iter().map(|node| (node, DAffine3::IDENTITY)).collect();
    pending.reverse();
    while let Some((node, world_from_parent)) = pending.pop() {
        // A second visit is a node with two parents, or a cycle.
        if std::mem::replace(&mut visited[node.index()], true) {
            return Err(source.malformed(format!("node {}: reached twice, expected a tree of nodes", node.index())));
        }
        let local = Mat4::from_cols_array_2d(&node.transform().matrix()).as_dmat4();
        let world_from_node = world_from_parent * affine(&local);
        if !world_from_node.is_finite() {
            return Err(source.malformed(format!("node {}: its transform is not finite", node.index())));
        }
        let name = node.name().map_or_else(|| format!("node {}", node.index()), str::to_owned);
        if let Some(mesh) = node.mesh() {
            if node.skin().is_some() {
                unsupported.note("skins are left out: meshes stand in their own pose", &name);
            }
            place(source, &mesh, &world_from_node, uv_sets, part, unsupported)?;
        }
        if let Some(camera) = node.camera() {
            match camera.projection() {
                Projection::Perspective(lens) => {
                    part.cameras.extend(view_point(name.clone(), &world_from_node, lens.yfov()))
                }
                Projection::Orthographic(_) => unsupported.note("orthographic cameras are left out", &name),
            }
        }
        if let Some(light) = node.light()
            && let Some(light) = lights::read(source, &light, &world_from_node, &name, unsupported)?
        {
            part.place_light(light, &DAffine3::from_translation(world_from_node.translation));
        }
        if node.extension_value("EXT_mesh_gpu_instancing").is_some() {
            unsupported.note("GPU instances are left out", &name);
        }
        let mut children: Vec<_> = node.children().map(|child| (child, world_from_node)).collect();
        children.reverse();
        pending.append(&mut children);
    }
    Ok(())
}

/// The roots of the default scene, else of the first one, else all nodes that are nobody's child.
fn roots(source: &Source) -> Vec<Node<'_>> {
    let document = &source.document;
    if let Some(scene) = document.default_scene().or_else(|| document.scenes().next()) {
        return scene.nodes().collect();
    }
    let mut is_child = vec![false; document.nodes().len()];
    document.nodes().for_each(|node| node.children().for_each(|child| is_child[child.index()] = true));
    document.nodes().filter(|node| !is_child[node.index()]).collect()
}

fn place(
    source: &Source,
    mesh: &gltf::Mesh,
    world_from_node: &DAffine3,
    uv_sets: &UvSets,
    part: &mut Part,
    unsupported: &mut Unsupported,
) -> Result<(), SceneError> {
    let user = mesh.name().map_or_else(|| format!("mesh {}", mesh.index()), str::to_owned);
    for primitive in mesh.primitives() {
        let material = primitive.material().index();
        let uv_set = uv_sets.of(material);
        let index = material.unwrap_or(uv_sets.default_material()) as u32;
        let Some(triangles) = triangles(source, &primitive, index, uv_set, &user, unsupported)? else { continue };
        part.place(&triangles, world_from_node, &source.file, |index| index)?;
    }
    Ok(())
}

/// A camera of a node; scaling and shear of the node do not reach it. `None` where the field of view is
/// none.
fn view_point(name: String, world_from_node: &DAffine3, vertical_fov_rad: f32) -> Option<NamedCamera> {
    let back = world_from_node.matrix3.z_axis.try_normalize()?;
    let right = world_from_node.matrix3.y_axis.cross(back).try_normalize()?;
    let orientation = DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back)).normalize();
    let pose = Pose { position: world_from_node.translation, orientation };
    let is_view = pose.is_valid() && (0.01..3.1).contains(&vertical_fov_rad);
    is_view.then_some(NamedCamera { name, pose, vertical_fov_rad })
}

fn affine(matrix: &DMat4) -> DAffine3 {
    let axis = |column: usize| matrix.col(column).truncate();
    DAffine3 { matrix3: DMat3::from_cols(axis(0), axis(1), axis(2)), translation: axis(3) }
}
