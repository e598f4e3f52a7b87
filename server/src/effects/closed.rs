//! Does a mesh enclose a volume? Decides whether a transparent material is a solid or a boundary.
//!
//! Method: every edge must be run through as often in one direction as in the other. Vertices count as one
//! where their positions agree exactly, since loaders split them at seams of normals and textures. Cost: one
//! hash insertion per edge.

use crate::scene::Mesh;
use std::collections::HashMap;

/// Whether the triangles of `material` are a closed surface; false where there are none.
pub(super) fn is_closed(mesh: &Mesh, material: u32) -> bool {
    let mut vertex_at: HashMap<[u32; 3], u32> = HashMap::new();
    let mut balance: HashMap<(u32, u32), i32> = HashMap::new();
    for (corners, _) in mesh.triangles.iter().zip(&mesh.materials).filter(|&(_, &of)| of == material) {
        let corners = corners.map(|corner| {
            // Adding zero makes -0 and 0 the same bits.
            let position = (mesh.positions[corner as usize] + 0.0).to_array().map(f32::to_bits);
            let next = vertex_at.len() as u32;
            *vertex_at.entry(position).or_insert(next)
        });
        for (from, to) in [(0, 1), (1, 2), (2, 0)].map(|(from, to)| (corners[from], corners[to])) {
            *balance.entry((from.min(to), from.max(to))).or_insert(0) += if from < to { 1 } else { -1 };
        }
    }
    !balance.is_empty() && balance.iter().all(|(&(from, to), &count)| count == 0 || from == to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{SceneBuilder, glass};
    use glam::Vec3;

    #[test]
    fn a_cube_is_closed_until_a_triangle_is_missing() {
        let mut mesh = SceneBuilder::new().cube(Vec3::ONE, 2.0, glass(1.5)).build().mesh;
        assert!(is_closed(&mesh, 0));
        assert!(!is_closed(&mesh, 1));
        mesh.triangles.pop();
        mesh.materials.pop();
        assert!(!is_closed(&mesh, 0));
    }
}
