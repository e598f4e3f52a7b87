//! Shapes made of triangles: quad, box, cylinder, and a water surface with waves.
//!
//! All shapes are centred on the origin of their own space; the scene's transform moves them. Texture
//! coordinates run over each face from 0 to `repeat`, v downwards, so that a picture stands upright.

use super::Mesh;
use glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// A sine wave on a water surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wave {
    /// Where it runs, in x and z; unit length.
    pub(super) direction: Vec2,
    /// Length of a period in metres.
    pub(super) length_m: f32,
    /// Amplitude in metres.
    pub(super) height_m: f32,
    /// Phase at the centre in radians.
    pub(super) phase_rad: f32,
}

/// The parallelogram `corner + s edge_u + t edge_v`; its outside is where `edge_u x edge_v` points to.
pub(super) fn quad(corner: Vec3, edge_u: Vec3, edge_v: Vec3, repeat: Vec2) -> Mesh {
    let mut mesh = Mesh::default();
    push_quad(&mut mesh, corner, edge_u, edge_v, repeat);
    mesh
}

/// A box of this size about the origin.
pub(super) fn cuboid(size: Vec3, repeat: Vec2) -> Mesh {
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let mut mesh = Mesh::default();
    // Front, back, right, left, top, bottom: each face's u runs right and its v up as seen from outside.
    for (u, v, out) in [(x, y, z), (-x, y, -z), (-z, y, x), (z, y, -x), (x, -z, y), (x, z, -y)] {
        push_quad(&mut mesh, (out - u - v) / 2.0, u, v, repeat);
    }
    mesh
}

/// A cylinder about +Y, from -height/2 to height/2, closed by discs, with smooth normals around.
pub(super) fn cylinder(radius: f32, height: f32, segments: u32, repeat: Vec2) -> Mesh {
    let mut mesh = Mesh::default();
    let (low, high) = (-height / 2.0, height / 2.0);
    let around = |index: u32| {
        let (sine, cosine) = (TAU * index as f32 / segments as f32).sin_cos();
        Vec3::new(cosine, 0.0, -sine)
    };
    for index in 0..=segments {
        let out = around(index);
        let u = repeat.x * index as f32 / segments as f32;
        mesh.push_vertex(out * radius + Vec3::Y * low, out, Vec2::new(u, repeat.y));
        mesh.push_vertex(out * radius + Vec3::Y * high, out, Vec2::new(u, 0.0));
    }
    for index in 0..segments {
        let a = 2 * index;
        mesh.push_triangle([a, a + 2, a + 3], 0);
        mesh.push_triangle([a, a + 3, a + 1], 0);
    }
    for (y, normal) in [(high, Vec3::Y), (low, Vec3::NEG_Y)] {
        let middle = mesh.push_vertex(Vec3::Y * y, normal, repeat / 2.0);
        for index in 0..=segments {
            let out = around(index);
            let uv = (Vec2::new(out.x, out.z) + 1.0) / 2.0 * repeat;
            mesh.push_vertex(out * radius + Vec3::Y * y, normal, uv);
        }
        for index in middle + 1..=middle + segments {
            let [b, c] = if normal.y > 0.0 { [index, index + 1] } else { [index + 1, index] };
            mesh.push_triangle([middle, b, c], 0);
        }
    }
    mesh
}

/// A water surface about the origin: a grid of `cells` over `size` (x and z, in metres), raised by the sum
/// of the waves, with their exact normals. Its outside is above.
pub(super) fn water(size: Vec2, cells: [u32; 2], waves: &[Wave], repeat: Vec2) -> Mesh {
    let mut mesh = Mesh::default();
    let [columns, rows] = cells;
    for row in 0..=rows {
        for column in 0..=columns {
            let uv = Vec2::new(column as f32 / columns as f32, row as f32 / rows as f32);
            let at = (uv - 0.5) * size;
            let (height, slope) = height_and_slope(at, waves);
            let normal = Vec3::new(-slope.x, 1.0, -slope.y).normalize();
            mesh.push_vertex(Vec3::new(at.x, height, at.y), normal, uv * repeat);
        }
    }
    for row in 0..rows {
        for column in 0..columns {
            let a = row * (columns + 1) + column;
            let below = a + columns + 1;
            mesh.push_triangle([a, below, below + 1], 0);
            mesh.push_triangle([a, below + 1, a + 1], 0);
        }
    }
    mesh
}

/// Height of the water in metres, and its derivatives along x and z.
fn height_and_slope(at: Vec2, waves: &[Wave]) -> (f32, Vec2) {
    waves.iter().fold((0.0, Vec2::ZERO), |(height, slope), wave| {
        let wave_number = wave.direction * (TAU / wave.length_m);
        let (sine, cosine) = (wave_number.dot(at) + wave.phase_rad).sin_cos();
        (height + wave.height_m * sine, slope + wave_number * (wave.height_m * cosine))
    })
}

fn push_quad(mesh: &mut Mesh, corner: Vec3, edge_u: Vec3, edge_v: Vec3, repeat: Vec2) {
    let normal = edge_u.cross(edge_v).normalize_or_zero();
    let vertex = |mesh: &mut Mesh, s: f32, t: f32| {
        mesh.push_vertex(corner + s * edge_u + t * edge_v, normal, Vec2::new(s, 1.0 - t) * repeat)
    };
    let [a, b] = [vertex(mesh, 0.0, 0.0), vertex(mesh, 1.0, 0.0)];
    let [c, d] = [vertex(mesh, 1.0, 1.0), vertex(mesh, 0.0, 1.0)];
    mesh.push_triangle([a, b, c], 0);
    mesh.push_triangle([a, c, d], 0);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geometric_normals(mesh: &Mesh) -> impl Iterator<Item = (Vec3, Vec3, Vec3)> {
        mesh.triangles.iter().map(|triangle| {
            let [a, b, c] = triangle.map(|index| mesh.positions[index as usize]);
            let shading = triangle.map(|index| mesh.normals[index as usize]).iter().sum::<Vec3>().normalize();
            ((b - a).cross(c - a), shading, (a + b + c) / 3.0)
        })
    }

    /// Gauss: a closed surface of area vectors sums to zero, and its volume is a third of the flux.
    #[test]
    fn closed_shapes_are_closed_and_face_outwards() {
        let prism_area = 32.0 / 2.0 * (TAU / 32.0).sin() * 0.25;
        let shapes =
            [(cuboid(Vec3::new(1.0, 2.0, 3.0), Vec2::ONE), 6.0), (cylinder(0.5, 3.0, 32, Vec2::ONE), 3.0 * prism_area)];
        for (mesh, expected) in shapes {
            let (mut area, mut volume) = (Vec3::ZERO, 0.0);
            for (twice_area, shading, middle) in geometric_normals(&mesh) {
                area += twice_area / 2.0;
                volume += twice_area.dot(middle) / 6.0;
                assert!(twice_area.normalize().dot(shading) > 0.99);
            }
            assert!(area.length() < 1e-4 && (volume - expected).abs() < 1e-4, "{area} {volume} {expected}");
        }
    }

    #[test]
    fn water_faces_up_and_its_normals_are_the_surface_s() {
        let wave = |x: f32, length_m| Wave {
            direction: Vec2::new(x, 1.0).normalize(),
            length_m,
            height_m: 0.01,
            phase_rad: x,
        };
        let mesh = water(Vec2::new(2.0, 3.0), [200, 300], &[wave(0.3, 0.5), wave(-1.0, 0.8)], Vec2::ONE);
        for (twice_area, shading, _) in geometric_normals(&mesh) {
            let geometric = twice_area.normalize();
            assert!(geometric.y > 0.9 && geometric.dot(shading) > 0.9999, "{geometric} {shading}");
        }
    }

    #[test]
    fn a_picture_on_a_wall_stands_upright() {
        let wall = quad(Vec3::ZERO, Vec3::X, Vec3::Y, Vec2::ONE);
        assert_eq!(wall.normals[0], Vec3::Z);
        let upper_left = wall.positions.iter().position(|&p| p == Vec3::Y).unwrap();
        assert_eq!(wall.uvs[upper_left], Vec2::ZERO);
        let mesh = cuboid(Vec3::ONE, Vec2::ONE);
        let corner = Vec3::new(-0.5, 0.5, 0.5);
        let front = (0..4).find(|&index| mesh.positions[index] == corner).unwrap();
        assert_eq!(mesh.uvs[front], Vec2::ZERO);
    }
}
