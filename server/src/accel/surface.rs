//! The surface at a hit: position, normals, texture coordinates, material; and how a ray leaves it.
//!
//! Self-intersection: a position is computed from the primitive and not along the ray, so its error is a few
//! roundings of the primitive's largest coordinate; rays start that far above the surface, on the side they
//! leave to (the reasoning of Wächter and Binder 2019, "A Fast and Robust Method for Avoiding
//! Self-Intersection", with the bound taken from the primitive instead of the position, so that it also holds
//! for a large triangle near the origin).
//!
//! Tangents run along growing u: of a triangle from its texture coordinates, constant over it (files' own
//! tangents are not read; MikkTSpace would average them at shared vertices), of a sphere along its parallels.
//! They are found only when asked for: by normal maps and by what is rougher in one direction. A normal map is
//! applied where a ray meets a surface ([`SurfacePoint::at`]).

use super::{Hit, Ray};
use crate::scene::{NormalMap, Scene};
use glam::{Vec2, Vec3};

/// Start of a ray above its surface, relative to the primitive's largest coordinate: a few roundings in the
/// position and in the intersection. Less gives acne, more light leaks through thin walls: 5 um at 10 m.
const OFFSET: f32 = 4.0 * f32::EPSILON;

/// Smallest cosine between the geometric normal and one tilted by a texture: 89.4 degrees. At 0 the shading
/// side would be undefined.
const LOWEST_TILT: f32 = 0.01;

/// A point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// In world, in metres.
    pub position: Vec3,
    /// Unit normal of the surface, to its outside.
    pub geometric_normal: Vec3,
    /// Unit normal for shading, interpolated between vertices, on the same side.
    pub shading_normal: Vec3,
    /// Texture coordinates.
    pub uv: Vec2,
    /// Index of the material.
    pub material: u32,
    /// Primitive id.
    pub primitive: u32,
    /// How far above the surface rays start, in metres.
    pub offset_m: f32,
}

impl SurfacePoint {
    /// The surface at a hit.
    pub fn at(scene: &Scene, ray: &Ray, hit: &Hit) -> SurfacePoint {
        let triangles = scene.mesh.triangles.len();
        let point = match (hit.primitive as usize).checked_sub(triangles) {
            None => SurfacePoint::on_triangle(scene, hit.primitive, hit.barycentrics),
            Some(sphere) => {
                let outward = ray.at(hit.distance) - scene.spheres[sphere].centre;
                SurfacePoint::on_sphere(scene, hit.primitive, outward.normalize_or(-ray.direction))
            }
        };
        match &scene.materials[point.material as usize].normal_map {
            None => point,
            Some(map) => point.with_normal_map(scene, map),
        }
    }

    /// The point of a triangle with these weights of its second and third vertex.
    pub fn on_triangle(scene: &Scene, primitive: u32, barycentrics: [f32; 2]) -> SurfacePoint {
        let mesh = &scene.mesh;
        let corners = mesh.triangles[primitive as usize].map(|corner| corner as usize);
        let [a, b, c] = corners.map(|corner| mesh.positions[corner]);
        let [v, w] = barycentrics;
        let u = 1.0 - v - w;
        let geometric_normal = (b - a).cross(c - a).normalize_or(Vec3::Y);
        let [na, nb, nc] = corners.map(|corner| mesh.normals.get(corner).copied().unwrap_or(Vec3::ZERO));
        // A face of one normal needs no mix of it.
        let is_flat = na == nb && nb == nc && na != Vec3::ZERO;
        let shading_normal = if is_flat { na } else { (u * na + v * nb + w * nc).normalize_or(geometric_normal) };
        let [ta, tb, tc] = corners.map(|corner| mesh.uvs.get(corner).copied().unwrap_or(Vec2::ZERO));
        SurfacePoint {
            position: u * a + v * b + w * c,
            geometric_normal,
            shading_normal: if shading_normal.dot(geometric_normal) < 0.0 { -shading_normal } else { shading_normal },
            uv: u * ta + v * tb + w * tc,
            material: mesh.materials[primitive as usize],
            primitive,
            offset_m: OFFSET * a.abs().max(b.abs()).max(c.abs()).max_element(),
        }
    }

    /// The point of a sphere whose outward normal is `normal`.
    pub fn on_sphere(scene: &Scene, primitive: u32, normal: Vec3) -> SurfacePoint {
        let sphere = &scene.spheres[primitive as usize - scene.mesh.triangles.len()];
        // As a globe: u runs once around from -Z, v from the north pole down.
        let u = 0.5 + normal.x.atan2(-normal.z) / std::f32::consts::TAU;
        let v = normal.y.clamp(-1.0, 1.0).acos() / std::f32::consts::PI;
        SurfacePoint {
            position: sphere.centre + sphere.radius * normal,
            geometric_normal: normal,
            shading_normal: normal,
            uv: Vec2::new(u, v),
            material: sphere.material,
            primitive,
            offset_m: OFFSET * (sphere.centre.abs().max_element() + sphere.radius),
        }
    }

    /// Unit direction of growing u, across the shading normal; any where texture coordinates do not say.
    pub fn tangent(&self, scene: &Scene) -> Vec3 {
        self.tangents(scene)[0]
    }

    /// Unit directions of growing u and of shrinking v (upwards in an image), across the shading normal and each
    /// other. They are right-handed with the normal unless texture coordinates are mirrored.
    pub fn tangents(&self, scene: &Scene) -> [Vec3; 2] {
        let normal = self.shading_normal;
        let (along_u, along_v) = match (self.primitive as usize).checked_sub(scene.mesh.triangles.len()) {
            None => along_texture(scene, self.primitive),
            Some(_) => {
                let outward = self.geometric_normal;
                let east = Vec3::new(-outward.z, 0.0, outward.x);
                (east, outward.cross(east))
            }
        };
        let across = along_u - normal * normal.dot(along_u);
        let tangent = across.try_normalize().unwrap_or_else(|| normal.any_orthonormal_vector());
        let bitangent = normal.cross(tangent);
        [tangent, if bitangent.dot(along_v) > 0.0 { -bitangent } else { bitangent }]
    }

    /// With the shading normal tilted by a texture (glTF 2.0, 3.9.3). It stays on the side of the geometric one:
    /// a texture that would turn it under the surface leaves it just above.
    fn with_normal_map(self, scene: &Scene, map: &NormalMap) -> SurfacePoint {
        let Some(texture) = scene.textures.get(map.texture as usize) else { return self };
        let [right, up, out] = (2.0 * texture.sample(self.uv) - 1.0).to_array();
        let [tangent, bitangent] = self.tangents(scene);
        let tilted = map.scale.x * right * tangent + map.scale.y * up * bitangent + out * self.shading_normal;
        let tilted = tilted.normalize_or(self.shading_normal);
        let height = tilted.dot(self.geometric_normal);
        let lifted = tilted + (LOWEST_TILT - height).max(0.0) * self.geometric_normal;
        SurfacePoint { shading_normal: lifted.normalize_or(self.geometric_normal), ..self }
    }

    /// The start of a ray that leaves to the side of `direction`.
    pub fn offset_towards(&self, direction: Vec3) -> Vec3 {
        let side = self.offset_m.copysign(self.geometric_normal.dot(direction));
        self.position + side * self.geometric_normal
    }

    /// The ray that leaves in this unit direction.
    pub fn leave(&self, direction: Vec3) -> Ray {
        Ray { origin: self.offset_towards(direction), direction }
    }
}

/// Directions of growing u and of growing v on a triangle, not of unit length; zero where it has none.
fn along_texture(scene: &Scene, primitive: u32) -> (Vec3, Vec3) {
    let mesh = &scene.mesh;
    let corners = mesh.triangles[primitive as usize].map(|corner| corner as usize);
    let [a, b, c] = corners.map(|corner| mesh.positions[corner]);
    let [ta, tb, tc] = corners.map(|corner| mesh.uvs.get(corner).copied().unwrap_or(Vec2::ZERO));
    let (ab, ac, uv_ab, uv_ac) = (b - a, c - a, tb - ta, tc - ta);
    // position = a + ab s + ac t, (u, v) = ta + uv_ab s + uv_ac t, solved for the derivatives by u and by v.
    let area = uv_ab.perp_dot(uv_ac);
    let along_u = (ab * uv_ac.y - ac * uv_ab.y) * area.signum();
    let along_v = (ac * uv_ab.x - ab * uv_ac.x) * area.signum();
    let is_usable = area != 0.0 && along_u.is_finite() && along_v.is_finite();
    if is_usable { (along_u, along_v) } else { (Vec3::ZERO, Vec3::ZERO) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::Accel;
    use crate::scene::{ImageTexture, Material, Texels, Texture, TextureKind};
    use crate::testing::{SceneBuilder, diffuse};
    use std::sync::Arc;

    /// A square that faces up, with u along +X and v along +Z; mirrored it has u along -X.
    fn floor(material: Material, mirrored: bool) -> Scene {
        let mut scene = SceneBuilder::new().floor(0.0, 1.0, material).build();
        for (uv, position) in scene.mesh.uvs.iter_mut().zip(&scene.mesh.positions) {
            *uv = 0.5 + 0.5 * Vec2::new(if mirrored { -position.x } else { position.x }, position.z);
        }
        scene
    }

    fn with_map(rgb: [f32; 3], scale: f32) -> (Material, Texture) {
        let texels = Texels::from_linear_rgb(1, vec![rgb]).unwrap();
        let normal_map = Some(NormalMap { texture: 0, scale: Vec2::splat(scale) });
        let texture = Texture::new(TextureKind::Image(ImageTexture::new(Arc::new(texels))));
        (Material { normal_map, ..diffuse(0.5) }, texture)
    }

    fn looking_down_at(scene: &Scene, x: f32, z: f32) -> SurfacePoint {
        let ray = Ray { origin: Vec3::new(x, 5.0, z), direction: Vec3::NEG_Y };
        SurfacePoint::at(scene, &ray, &Accel::new(scene).closest(&ray).unwrap())
    }

    #[test]
    fn tangents_run_along_u_and_up_the_image() {
        for (mirrored, tangent) in [(false, Vec3::X), (true, Vec3::NEG_X)] {
            let scene = floor(diffuse(0.5), mirrored);
            let found = looking_down_at(&scene, 0.3, -0.2).tangents(&scene);
            assert!((found[0] - tangent).length() < 1e-6, "{found:?}");
            assert!((found[1] - Vec3::NEG_Z).length() < 1e-6, "{found:?}");
        }
    }

    #[test]
    fn tangents_of_a_sphere_run_along_its_parallels_and_up() {
        let scene = SceneBuilder::new().sphere(Vec3::new(3.0, 1.0, 2.0), 0.5, diffuse(0.5)).build();
        let step = 1e-3_f32;
        for index in 0..200_u16 {
            let angle = f32::from(index) * 0.7;
            let outward = Vec3::new(angle.sin(), (angle * 1.3).sin() * 0.9, angle.cos()).normalize();
            let point = SurfacePoint::on_sphere(&scene, 0, outward);
            let [tangent, up] = point.tangents(&scene);
            assert!(tangent.dot(outward).abs() < 1e-6 && tangent.dot(up).abs() < 1e-6);
            // A step along the tangent makes u grow and leaves v, one along the other makes v shrink.
            let beside = SurfacePoint::on_sphere(&scene, 0, (outward + step * tangent).normalize());
            let grown = beside.uv - point.uv;
            assert!((grown.x > 0.0 || grown.x < -0.9) && grown.y.abs() < 0.01 * grown.x.abs(), "{grown}");
            let above = SurfacePoint::on_sphere(&scene, 0, (outward + step * up).normalize());
            assert!(above.uv.y < point.uv.y);
        }
        let pole = SurfacePoint::on_sphere(&scene, 0, Vec3::Y).tangents(&scene);
        assert!(pole.iter().all(|tangent| tangent.is_normalized()) && pole[0].dot(pole[1]).abs() < 1e-6);
    }

    #[test]
    fn a_surface_without_texture_coordinates_has_some_tangent() {
        for degenerate in [Vec2::ZERO, Vec2::INFINITY, Vec2::splat(f32::MAX)] {
            let mut scene = floor(diffuse(0.5), false);
            scene.mesh.uvs.iter_mut().for_each(|uv| *uv *= degenerate);
            let [tangent, bitangent] = looking_down_at(&scene, 0.1, 0.1).tangents(&scene);
            assert!(tangent.is_normalized() && bitangent.is_normalized());
            assert!(tangent.y.abs() < 1e-6 && bitangent.y.abs() < 1e-6 && tangent.dot(bitangent).abs() < 1e-6);
        }
    }

    #[test]
    fn a_normal_map_tilts_to_the_right_and_up_the_image() {
        // 0.6 to the right, 0.8 out of the surface.
        let right = [0.8, 0.5, 0.9];
        for (mirrored, x) in [(false, 0.6), (true, -0.6)] {
            let (material, texture) = with_map(right, 1.0);
            let mut scene = floor(material, mirrored);
            scene.textures.push(texture);
            let normal = looking_down_at(&scene, 0.2, 0.4).shading_normal;
            assert!((normal - Vec3::new(x, 0.8, 0.0)).length() < 1e-6, "{normal}");
        }
        let (material, texture) = with_map([0.5, 0.8, 0.9], 1.0);
        let mut scene = floor(material, false);
        scene.textures.push(texture);
        let normal = looking_down_at(&scene, 0.2, 0.4).shading_normal;
        assert!((normal - Vec3::new(0.0, 0.8, -0.6)).length() < 1e-6, "{normal}");
    }

    #[test]
    fn a_mapped_normal_is_unit_and_stays_above_its_surface() {
        for rgb in [[1.0, 1.0, 0.0], [0.0, 0.5, 0.5], [0.5, 0.5, 0.0], [0.5; 3], [0.0; 3], [0.5, 0.5, 1.0]] {
            for scale in [0.0, 1.0, -3.0, 1e30] {
                let (material, texture) = with_map(rgb, scale);
                let mut scene = floor(material, false);
                scene.textures.push(texture);
                let normal = looking_down_at(&scene, -0.5, 0.4).shading_normal;
                assert!((normal.length() - 1.0).abs() < 1e-5 && normal.y > 0.009, "{rgb:?} {scale}: {normal}");
            }
        }
    }
}
