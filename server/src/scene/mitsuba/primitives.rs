//! The meshes of Mitsuba's own shapes, with its texture coordinates, in its object space.
//!
//! Round shapes are polygons of [`SEGMENTS`] sides with exact normals: within a thousandth of their radius.

use super::super::Mesh;
use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Sides of a circle: its polygon is within 1 - cos(pi / 128) = 3e-4 of the radius.
const SEGMENTS: u32 = 128;

/// From -1 to 1 in x and y; the normal is +Z.
pub(super) fn rectangle() -> Mesh {
    let mut mesh = Mesh::default();
    push_quad(&mut mesh, Vec3::new(-1.0, -1.0, 0.0), Vec3::X * 2.0, Vec3::Y * 2.0, Vec3::Z);
    mesh
}

/// From -1 to 1 on all axes. On each face the texture has its first corner at `corner`, u along the first edge and
/// v along the second, as Mitsuba's table of vertices has it.
pub(super) fn cube() -> Mesh {
    let mut mesh = Mesh::default();
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    for (corner, u, v) in [
        (-x - y - z, z, x),
        (x + y + z, -x, -z),
        (x - y + z, y, -z),
        (-x - y + z, y, x),
        (-x - y - z, y, z),
        (-x + y - z, -y, x),
    ] {
        push_quad(&mut mesh, corner, u * 2.0, v * 2.0, v.cross(u));
    }
    mesh
}

fn push_quad(mesh: &mut Mesh, corner: Vec3, u: Vec3, v: Vec3, normal: Vec3) {
    let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    let [a, b, c, d] =
        corners.map(|(s, t): (f32, f32)| mesh.push_vertex(corner + s * u + t * v, normal, Vec2::new(s, t)));
    let is_turned = u.cross(v).dot(normal) < 0.0;
    for [a, b, c] in [[a, b, c], [a, c, d]] {
        mesh.push_triangle(if is_turned { [a, c, b] } else { [a, b, c] }, 0);
    }
}

/// Of radius 1 about the origin; the normal is +Z. u is the radius, v the angle.
pub(super) fn disk() -> Mesh {
    let mut mesh = Mesh::default();
    for segment in 0..SEGMENTS {
        let turn = |step: f32| (segment as f32 + step) / SEGMENTS as f32;
        let rim = |step: f32| Vec3::new((TAU * turn(step)).cos(), (TAU * turn(step)).sin(), 0.0);
        let middle = mesh.push_vertex(Vec3::ZERO, Vec3::Z, Vec2::new(0.0, turn(0.5)));
        let [from, to] = [0.0, 1.0].map(|step| mesh.push_vertex(rim(step), Vec3::Z, Vec2::new(1.0, turn(step))));
        mesh.push_triangle([middle, from, to], 0);
    }
    mesh
}

/// Of radius 1 about +Z, from 0 to 1, open at both ends; normals outwards. u is the angle, v the height.
pub(super) fn cylinder() -> Mesh {
    let mut mesh = Mesh::default();
    for segment in 0..=SEGMENTS {
        let turn = segment as f32 / SEGMENTS as f32;
        let (sine, cosine) = (TAU * turn).sin_cos();
        let out = Vec3::new(cosine, sine, 0.0);
        mesh.push_vertex(out, out, Vec2::new(turn, 0.0));
        mesh.push_vertex(out + Vec3::Z, out, Vec2::new(turn, 1.0));
    }
    for segment in 0..SEGMENTS {
        let a = 2 * segment;
        mesh.push_triangle([a, a + 2, a + 3], 0);
        mesh.push_triangle([a, a + 3, a + 1], 0);
    }
    mesh
}

/// Of radius 1 about the origin; u is the angle about +Z from +X, v the angle from +Z.
pub(super) fn sphere() -> Mesh {
    let mut mesh = Mesh::default();
    let rows = SEGMENTS / 2;
    for row in 0..=rows {
        for column in 0..=SEGMENTS {
            let (u, v) = (column as f32 / SEGMENTS as f32, row as f32 / rows as f32);
            let ((sine, cosine), (radius, height)) = ((TAU * u).sin_cos(), (PI * v).sin_cos());
            let out = Vec3::new(radius * cosine, radius * sine, height).normalize_or(Vec3::Z);
            mesh.push_vertex(out, out, Vec2::new(u, v));
        }
    }
    for row in 0..rows {
        for column in 0..SEGMENTS {
            let a = row * (SEGMENTS + 1) + column;
            let below = a + SEGMENTS + 1;
            if row > 0 {
                mesh.push_triangle([a, below, a + 1], 0);
            }
            if row + 1 < rows {
                mesh.push_triangle([a + 1, below, below + 1], 0);
            }
        }
    }
    mesh
}

/// Gives each vertex the mean normal of its triangles, weighted by their angles there (Thürmer and Wüthrich 1998).
pub(super) fn smooth_normals(mesh: &mut Mesh) {
    let mut sums = vec![Vec3::ZERO; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let corners = triangle.map(|index| mesh.positions[index as usize]);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        for at in 0..3 {
            let to_next = (corners[(at + 1) % 3] - corners[at]).normalize_or_zero();
            let to_last = (corners[(at + 2) % 3] - corners[at]).normalize_or_zero();
            // Stable where the angle is small: twice the arc tangent of half of it.
            let angle = 2.0 * (to_next - to_last).length().atan2((to_next + to_last).length());
            sums[triangle[at] as usize] += normal * angle;
        }
    }
    mesh.normals = sums.into_iter().map(|sum| sum.normalize_or_zero()).collect();
}

/// Turns the surface over: what was outside is inside.
pub(super) fn flip(mesh: &mut Mesh) {
    mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    mesh.normals.iter_mut().for_each(|normal| *normal = -*normal);
}

/// Turns over triangles whose normals at the corners say that their outside is the other one: in Mitsuba the
/// normals decide, here the order of the corners does.
pub(super) fn turn_to_normals(mesh: &mut Mesh) {
    let (positions, normals) = (&mesh.positions, &mesh.normals);
    for triangle in &mut mesh.triangles {
        let [a, b, c] = triangle.map(|index| positions[index as usize]);
        let sum: Vec3 = triangle.iter().map(|&index| normals[index as usize]).sum();
        if (b - a).cross(c - a).dot(sum) < 0.0 {
            triangle.swap(1, 2);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_face_where_their_normals_point_and_closed_ones_are_closed() {
        let prism = 0.5 * SEGMENTS as f32 * (TAU / SEGMENTS as f32).sin();
        for (mesh, volume) in [
            (rectangle(), None),
            (cube(), Some(8.0)),
            (disk(), None),
            (cylinder(), None),
            (sphere(), Some(4.0 / 3.0 * PI)),
        ] {
            let (mut area, mut enclosed) = (Vec3::ZERO, 0.0);
            for triangle in &mesh.triangles {
                let [a, b, c] = triangle.map(|index| mesh.positions[index as usize]);
                let twice_area = (b - a).cross(c - a);
                let normal: Vec3 = triangle.iter().map(|&index| mesh.normals[index as usize]).sum();
                assert!(twice_area.normalize().dot(normal.normalize()) > 0.99);
                area += twice_area / 2.0;
                enclosed += a.dot(twice_area) / 6.0;
            }
            match volume {
                Some(volume) => assert!(area.length() < 1e-4 && (enclosed / volume - 1.0).abs() < 2e-3, "{enclosed}"),
                None => assert!(area.length() < 1e-3 || (area.z - 4.0).abs() < 1e-3 || (area.z - prism).abs() < 1e-3),
            }
        }
    }

    #[test]
    fn texture_coordinates_are_those_of_mitsuba() {
        let uv_at = |mesh: &Mesh, position: Vec3, normal: Vec3| {
            let near = |index: &usize| {
                (mesh.positions[*index] - position).length() < 1e-6 && (mesh.normals[*index] - normal).length() < 1e-6
            };
            mesh.uvs[(0..mesh.positions.len()).find(near).unwrap()]
        };
        assert_eq!(uv_at(&rectangle(), Vec3::new(-1.0, 1.0, 0.0), Vec3::Z), Vec2::Y);
        // From the table of src/shapes/cube.cpp.
        assert_eq!(uv_at(&cube(), Vec3::new(1.0, -1.0, -1.0), Vec3::NEG_Y), Vec2::Y);
        assert_eq!(uv_at(&cube(), Vec3::new(1.0, 1.0, 1.0), Vec3::Z), Vec2::ONE);
        assert_eq!(uv_at(&cube(), Vec3::new(-1.0, 1.0, -1.0), Vec3::NEG_Z), Vec2::ZERO);
        assert_eq!(uv_at(&cylinder(), Vec3::new(0.0, 1.0, 1.0), Vec3::Y), Vec2::new(0.25, 1.0));
        assert_eq!(uv_at(&sphere(), Vec3::Y, Vec3::Y), Vec2::new(0.25, 0.5));
    }

    #[test]
    fn normals_are_smoothed_by_angle_and_decide_the_outside() {
        let mut mesh = sphere();
        let exact = std::mem::take(&mut mesh.normals);
        smooth_normals(&mut mesh);
        let inner =
            |index: &usize| exact[*index].z.abs() < 0.99 && mesh.uvs[*index].x > 0.01 && mesh.uvs[*index].x < 0.99;
        assert!((0..exact.len()).filter(inner).all(|index| mesh.normals[index].dot(exact[index]) > 0.9999));
        let before = mesh.triangles.clone();
        mesh.triangles.iter_mut().step_by(2).for_each(|triangle| triangle.swap(1, 2));
        turn_to_normals(&mut mesh);
        assert_eq!(mesh.triangles, before);
    }
}
