//! What one file contributes to a scene: shapes with the materials and textures that they index.

use super::{Color, Material, Mesh, NamedCamera, SceneError, Sphere, Surface, Texture};
use glam::DAffine3;

/// A piece of a scene; its indices are its own until it is appended to another.
#[derive(Clone, Debug, Default)]
pub(super) struct Part {
    pub(super) mesh: Mesh,
    pub(super) spheres: Vec<Sphere>,
    pub(super) materials: Vec<Material>,
    pub(super) textures: Vec<Texture>,
    pub(super) cameras: Vec<NamedCamera>,
    /// One line each.
    pub(super) warnings: Vec<String>,
}

impl Part {
    /// Takes in another part, moved by `world_from_part`. `replacement` names a material of `self` for
    /// those of the other part that are not wanted. Spheres stay out of it: only scene.toml has them.
    pub(super) fn append(
        &mut self,
        part: Part,
        world_from_part: &DAffine3,
        file: &str,
        replacement: impl Fn(u32) -> Option<u32>,
    ) -> Result<(), SceneError> {
        let first_material = self.materials.len() as u32;
        let first_texture = self.textures.len() as u32;
        let material = |index: u32| replacement(index).unwrap_or(first_material + index);
        self.mesh.append(&part.mesh, world_from_part, file, material)?;
        self.materials.extend(part.materials.into_iter().map(|mut material| {
            material.shift_textures(first_texture);
            material
        }));
        self.textures.extend(part.textures);
        self.cameras.extend(part.cameras);
        self.warnings.extend(part.warnings);
        Ok(())
    }

    /// Whether any surface sends light.
    pub(super) fn has_emission(&self) -> bool {
        let emits =
            |index: u32| self.materials.get(index as usize).is_some_and(|material| !material.emission.is_black());
        self.mesh.materials.iter().any(|&index| emits(index))
            || self.spheres.iter().any(|sphere| emits(sphere.material))
    }
}

impl Material {
    fn shift_textures(&mut self, first: u32) {
        let shift = |color: &mut Color| {
            if let Color::Textured { texture, .. } = color {
                *texture += first;
            }
        };
        shift(&mut self.emission);
        if let Surface::Diffuse { albedo } = &mut self.surface {
            shift(albedo);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::TextureKind;
    use super::*;
    use glam::{Vec2, Vec3};

    fn part() -> Part {
        let mut part = Part::default();
        for position in [Vec3::ZERO, Vec3::X, Vec3::Y] {
            part.mesh.push_vertex(position, Vec3::Z, Vec2::ZERO);
        }
        part.mesh.push_triangle([0, 1, 2], 0);
        let albedo = Color::Textured { texture: 0, factor: Vec3::ONE };
        let emission = Color::Constant(Vec3::ZERO);
        let surface = Surface::Diffuse { albedo };
        part.materials.push(Material { name: "paper".to_owned(), surface, emission, emission_two_sided: false });
        let kind = TextureKind::Image { width: 1, height: 1, texels: vec![[0.5; 3]] };
        part.textures.push(Texture { kind });
        part
    }

    #[test]
    fn indices_follow_their_part() {
        let mut whole = part();
        whole.append(part(), &DAffine3::IDENTITY, "a.glb", |_| None).unwrap();
        assert_eq!(whole.mesh.materials, [0, 1]);
        assert_eq!(whole.mesh.triangles[1], [3, 4, 5]);
        let Surface::Diffuse { albedo: Color::Textured { texture, .. } } = whole.materials[1].surface else { panic!() };
        assert_eq!(texture, 1);
    }

    #[test]
    fn a_replaced_material_is_ours() {
        let mut whole = part();
        whole.append(part(), &DAffine3::IDENTITY, "a.glb", |_| Some(0)).unwrap();
        assert_eq!(whole.mesh.materials, [0, 0]);
        assert!(!whole.has_emission());
    }
}
