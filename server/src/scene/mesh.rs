//! Shapes: one triangle soup, and analytic spheres.

use super::SceneError;
use super::untrusted::{MAX_COORDINATE_M, MAX_TRIANGLES, MAX_VERTICES, check_limit};
use glam::{DAffine3, DMat3, Vec2, Vec3};

/// Indexed triangles with their shading attributes.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions in world, in metres.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one per vertex; zero where the geometric normal is to be used.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, one per vertex; (0, 0) is the upper left corner of a texture.
    pub uvs: Vec<Vec2>,
    /// Vertex indices; counter-clockwise seen from the outside.
    pub triangles: Vec<[u32; 3]>,
    /// Index of the material of each triangle.
    pub materials: Vec<u32>,
}

/// A sphere, its outside being the outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Centre in world, in metres.
    pub centre: Vec3,
    /// Radius in metres, above 0.
    pub radius: f32,
    /// Index of its material.
    pub material: u32,
}

impl Mesh {
    /// The lowest and the highest corner of the box around all vertices; `None` without vertices.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let &first = self.positions.first()?;
        Some(self.positions.iter().fold((first, first), |(low, high), &p| (low.min(p), high.max(p))))
    }

    /// Adds a vertex and returns its index.
    pub(super) fn push_vertex(&mut self, position: Vec3, normal: Vec3, uv: Vec2) -> u32 {
        self.positions.push(position);
        self.normals.push(normal);
        self.uvs.push(uv);
        (self.positions.len() - 1) as u32
    }

    /// Adds a triangle of vertices that exist.
    pub(super) fn push_triangle(&mut self, vertices: [u32; 3], material: u32) {
        self.triangles.push(vertices);
        self.materials.push(material);
    }

    /// Puts `part` behind what is there, moved by `world_from_part` (formed in f64, so that a deep chain of
    /// nodes loses nothing) and its materials renamed by `material`. A mirroring transform turns the
    /// triangles over, so that their outside stays the outside.
    pub(crate) fn append(
        &mut self,
        part: &Mesh,
        world_from_part: &DAffine3,
        file: &str,
        material: impl Fn(u32) -> u32,
    ) -> Result<(), SceneError> {
        check_limit(file, "triangles", MAX_TRIANGLES, (self.triangles.len() + part.triangles.len()) as u64)?;
        check_limit(file, "vertices", MAX_VERTICES, (self.positions.len() + part.positions.len()) as u64)?;
        let first = self.positions.len() as u32;
        let linear = world_from_part.matrix3;
        let normal_from_part = cofactors(&linear);
        for (index, position) in part.positions.iter().enumerate() {
            let moved = world_from_part.transform_point3(position.as_dvec3()).as_vec3();
            if !moved.is_finite() || moved.abs().max_element() > MAX_COORDINATE_M {
                return Err(SceneError::Field {
                    file: file.to_owned(),
                    field: format!("vertex {index}"),
                    expected: format!("coordinates within {MAX_COORDINATE_M} m"),
                    found: format!("{moved}"),
                });
            }
            self.positions.push(moved);
        }
        let turn = |&normal: &Vec3| (normal_from_part * normal.as_dvec3()).normalize_or_zero().as_vec3();
        self.normals.extend(part.normals.iter().map(turn));
        self.uvs.extend_from_slice(&part.uvs);
        let mirrored = linear.determinant() < 0.0;
        self.triangles.extend(part.triangles.iter().map(|&[a, b, c]| {
            let [b, c] = if mirrored { [c, b] } else { [b, c] };
            [first + a, first + b, first + c]
        }));
        self.materials.extend(part.materials.iter().map(|&index| material(index)));
        Ok(())
    }

    /// Drops triangles without a usable normal and returns how many there were.
    pub(super) fn drop_degenerate(&mut self) -> usize {
        let before = self.triangles.len();
        let keep: Vec<bool> = self.triangles.iter().map(|&triangle| !self.is_degenerate(triangle)).collect();
        let mut kept = keep.iter();
        self.triangles.retain(|_| kept.next().is_some_and(|&keep| keep));
        let mut kept = keep.iter();
        self.materials.retain(|_| kept.next().is_some_and(|&keep| keep));
        before - self.triangles.len()
    }

    fn is_degenerate(&self, triangle: [u32; 3]) -> bool {
        let [a, b, c] = triangle.map(|index| self.positions[index as usize].as_dvec3());
        let (ab, ac, bc) = (b - a, c - a, c - b);
        let longest_squared = ab.length_squared().max(ac.length_squared()).max(bc.length_squared());
        ab.cross(ac).length() <= MIN_RELATIVE_AREA * longest_squared
    }
}

/// Twice the area over the longest edge squared: a triangle this thin, with f32 vertices, has no normal
/// that means anything. A larger value would drop slivers that some scans have.
const MIN_RELATIVE_AREA: f64 = 1e-9;

/// Cofactor matrix: turns normals as `matrix` turns surfaces, also where the matrix is singular, and for a
/// mirroring one, whose sign is taken out so that normals stay outside.
fn cofactors(matrix: &DMat3) -> DMat3 {
    let (x, y, z) = (matrix.x_axis, matrix.y_axis, matrix.z_axis);
    let sign = if matrix.determinant() < 0.0 { -1.0 } else { 1.0 };
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn triangle(c: Vec3) -> Mesh {
        let mut mesh = Mesh::default();
        for position in [Vec3::ZERO, Vec3::X, c] {
            mesh.push_vertex(position, Vec3::Z, Vec2::ZERO);
        }
        mesh.push_triangle([0, 1, 2], 0);
        mesh
    }

    #[test]
    fn triangles_without_area_are_dropped_with_their_material() {
        let mut mesh = triangle(Vec3::Y);
        mesh.push_vertex(Vec3::X * 0.5, Vec3::Z, Vec2::ZERO);
        mesh.push_triangle([0, 1, 3], 1);
        mesh.push_triangle([0, 0, 2], 2);
        mesh.push_triangle([0, 3, 2], 3);
        assert_eq!(mesh.drop_degenerate(), 2);
        assert_eq!(mesh.materials, [0, 3]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 3, 2]]);
    }

    #[test]
    fn a_mirrored_instance_keeps_its_outside_outside() {
        for scale in [DVec3::new(-1.0, 1.0, 1.0), DVec3::new(2.0, 1.0, 0.5), DVec3::new(-1.0, -1.0, 1.0)] {
            let mut world = Mesh::default();
            world.append(&triangle(Vec3::Y), &DAffine3::from_scale(scale), "test", |m| m).unwrap();
            let [a, b, c] = world.triangles[0].map(|index| world.positions[index as usize]);
            let geometric = (b - a).cross(c - a).normalize();
            assert!((geometric - world.normals[0]).length() < 1e-6, "{scale}: {geometric} {}", world.normals[0]);
        }
    }

    #[test]
    fn coordinates_that_are_no_number_or_too_far_are_refused() {
        for bad in [f32::NAN, f32::INFINITY, 2e6] {
            let error = Mesh::default().append(&triangle(Vec3::splat(bad)), &DAffine3::IDENTITY, "a.glb", |m| m);
            assert!(error.unwrap_err().to_string().starts_with("a.glb: vertex 2: expected coordinates"));
        }
    }
}
