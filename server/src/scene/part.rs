//! What one file contributes to a scene: shapes with the materials and textures that they index.
//!
//! What lies far from the origin of the world keeps its precision: coordinates are counted from an origin of the
//! part's own, which the first shape decides ([`origin_for`]), and everything is moved there in f64 before it is
//! rounded to f32. Poses of cameras stay absolute.

use super::untrusted::MAX_COORDINATE_M;
use super::{Light, Material, Mesh, Motion, NamedCamera, RenderDefaults, SceneError, Sphere, Surface, Texture};
use crate::volume::Medium;
use glam::{DAffine3, DVec3, Vec3};

/// A piece of a scene; its indices are its own until it is appended to another.
#[derive(Clone, Debug, Default)]
pub(super) struct Part {
    /// What coordinates of shapes and lights are counted from, once the first shape has decided it.
    origin: Option<DVec3>,
    pub(super) mesh: Mesh,
    pub(super) spheres: Vec<Sphere>,
    pub(super) materials: Vec<Material>,
    pub(super) textures: Vec<Texture>,
    /// Media, each with the place of its grid's unit cube: world_from_unit.
    pub(super) media: Vec<(Medium, DAffine3)>,
    pub(super) lights: Vec<Light>,
    /// Of its lights.
    pub(super) motions: Vec<Motion>,
    pub(super) cameras: Vec<NamedCamera>,
    pub(super) defaults: RenderDefaults,
    /// One line each.
    pub(super) warnings: Vec<String>,
}

impl Part {
    /// What coordinates of shapes and lights are counted from, in world.
    pub(super) fn origin(&self) -> DVec3 {
        self.origin.unwrap_or(DVec3::ZERO)
    }

    /// Puts a mesh into the world, its materials renamed by `material`.
    pub(super) fn place(
        &mut self,
        mesh: &Mesh,
        world_from_mesh: &DAffine3,
        file: &str,
        material: impl Fn(u32) -> u32,
    ) -> Result<(), SceneError> {
        if self.origin.is_none() {
            let points = mesh.positions.iter().map(|position| world_from_mesh.transform_point3(position.as_dvec3()));
            if let Some((low, high)) = bounds(points) {
                self.settle(low, high);
            }
        }
        self.mesh.append(mesh, &self.about_origin(world_from_mesh), file, material)
    }

    /// Puts a sphere into the world; its radius is positive and all is finite.
    pub(super) fn place_sphere(&mut self, centre_in_world: DVec3, radius: f64, material: u32) {
        self.settle(centre_in_world - radius, centre_in_world + radius);
        let centre = (centre_in_world - self.origin()).as_vec3();
        self.spheres.push(Sphere { centre, radius: radius as f32, material });
    }

    /// Puts a light into the world.
    pub(super) fn place_light(&mut self, light: Light, world_from_light: &DAffine3) {
        self.lights.push(light.moved(&self.about_origin(world_from_light)));
    }

    /// The media about the origin.
    pub(super) fn placed_media(&self) -> Vec<Medium> {
        let placed = |(medium, world_from_unit): &(Medium, DAffine3)| {
            medium.clone().placed(&self.about_origin(world_from_unit).inverse())
        };
        self.media.iter().map(placed).collect()
    }

    /// Decides the origin by the box around the first shape. Lights that were there before are moved.
    fn settle(&mut self, low: DVec3, high: DVec3) {
        if self.origin.is_some() {
            return;
        }
        let origin = origin_for(low, high);
        let back = DAffine3::from_translation(-origin);
        self.lights.iter_mut().for_each(|light| *light = light.moved(&back));
        self.origin = Some(origin);
    }

    fn about_origin(&self, world_from_source: &DAffine3) -> DAffine3 {
        DAffine3::from_translation(-self.origin()) * *world_from_source
    }

    /// Takes in another part, moved by `world_from_part`. `replacement` names a material of `self` for
    /// those of the other part that are not wanted. Spheres stay out of it: only whole scenes have them.
    pub(super) fn append(
        &mut self,
        part: Part,
        world_from_part: &DAffine3,
        file: &str,
        replacement: impl Fn(u32) -> Option<u32>,
    ) -> Result<(), SceneError> {
        let first_material = self.materials.len() as u32;
        let first_texture = self.textures.len() as u32;
        let first_medium = self.media.len() as u32;
        let material = |index: u32| replacement(index).unwrap_or(first_material + index);
        let world_from_source = *world_from_part;
        let world_from_part = *world_from_part * DAffine3::from_translation(part.origin());
        self.place(&part.mesh, &world_from_part, file, material)?;
        self.materials.extend(part.materials.into_iter().map(|mut material| {
            material.shift_textures(first_texture);
            [&mut material.interior, &mut material.exterior]
                .into_iter()
                .flatten()
                .for_each(|index| *index += first_medium);
            material
        }));
        self.textures.extend(part.textures);
        self.media.extend(part.media.into_iter().map(|(medium, at)| (medium, world_from_source * at)));
        part.lights.into_iter().for_each(|light| self.place_light(light, &world_from_part));
        self.cameras.extend(part.cameras);
        self.warnings.extend(part.warnings);
        Ok(())
    }

    /// Drops triangles and spheres that light does not meet, that send none and that bound no medium.
    pub(super) fn drop_unseen(&mut self) {
        let unseen: Vec<bool> = self
            .materials
            .iter()
            .map(|material| {
                material.surface == Surface::Null && material.emission.is_black() && !material.bounds_medium()
            })
            .collect();
        let seen = |&index: &u32| !unseen.get(index as usize).copied().unwrap_or(false);
        let mut keep = self.mesh.materials.iter().map(seen).collect::<Vec<_>>().into_iter();
        self.mesh.triangles.retain(|_| keep.next().unwrap_or(true));
        self.mesh.materials.retain(seen);
        self.spheres.retain(|sphere| seen(&sphere.material));
    }

    /// Whether any surface or medium sends light.
    pub(super) fn has_emission(&self) -> bool {
        let emits =
            |index: u32| self.materials.get(index as usize).is_some_and(|material| !material.emission.is_black());
        !self.lights.is_empty()
            || self.media.iter().any(|(medium, _)| medium.emission() != Vec3::ZERO)
            || self.mesh.materials.iter().any(|&index| emits(index))
            || self.spheres.iter().any(|sphere| emits(sphere.material))
    }
}

/// The lowest and the highest corner of the box around points; `None` without points.
pub(super) fn bounds(points: impl IntoIterator<Item = DVec3>) -> Option<(DVec3, DVec3)> {
    points.into_iter().fold(None, |bounds: Option<(DVec3, DVec3)>, point| {
        Some(bounds.map_or((point, point), |(low, high)| (low.min(point), high.max(point))))
    })
}

/// So many times its own extent from the origin of the world a shape counts as far away: nearer, f32 coordinates
/// resolve a millionth of it and nothing is gained.
const FAR: f64 = 16.0;

/// What coordinates are best counted from, given the box around the first shape of a scene: zero, or where the
/// shape is far away its middle, rounded to a power of two near its extent, so that coordinates that were whole
/// numbers stay so.
pub(super) fn origin_for(low: DVec3, high: DVec3) -> DVec3 {
    let (middle, extent) = ((low + high) / 2.0, (high - low).length());
    let is_far = middle.length() > FAR * extent && middle.abs().max_element() <= f64::from(MAX_COORDINATE_M);
    if !is_far {
        return DVec3::ZERO;
    }
    let step = extent.max(middle.length() * 1e-9).log2().floor().exp2();
    (middle / step).round() * step
}

#[cfg(test)]
mod tests {
    use super::super::{Color, ImageTexture, Surface, Texels, TextureKind};
    use super::*;
    use glam::{Vec2, Vec3};

    fn part() -> Part {
        let mut part = Part::default();
        for position in [Vec3::ZERO, Vec3::X, Vec3::Y] {
            part.mesh.push_vertex(position, Vec3::Z, Vec2::ZERO);
        }
        part.mesh.push_triangle([0, 1, 2], 0);
        let albedo = Color::Textured { texture: 0, factor: Vec3::ONE };
        part.materials.push(Material::new("paper", Surface::Diffuse { albedo }));
        let texels = Texels::from_linear_rgb(1, vec![[0.5; 3]]).unwrap();
        let kind = TextureKind::Image(ImageTexture::new(texels.into()));
        part.textures.push(Texture::new(kind));
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

    /// 10 km from the origin coordinates are as fine as at it.
    #[test]
    fn shapes_far_away_keep_their_coordinates_to_the_bit() {
        let far = DVec3::new(10_000.0, -3000.0, 10_000.0);
        let mut whole = Part::default();
        let light = Light::Point { position: Vec3::ZERO, intensity: Vec3::ONE };
        whole.place_light(light, &DAffine3::from_translation(far + DVec3::Y));
        for shift in [DVec3::ZERO, DVec3::new(0.125, 1e-6, 3.0)] {
            whole.append(part(), &DAffine3::from_translation(far + shift), "a.glb", |_| None).unwrap();
        }
        whole.place_sphere(far + 0.5, 0.25, 0);
        let origin = whole.origin();
        assert!((origin - far).length() < 2.0, "{origin}");
        let near = part().mesh.positions;
        let from_far = |position: Vec3| origin + position.as_dvec3() - far;
        for (placed, near) in whole.mesh.positions.iter().zip(&near) {
            assert_eq!(from_far(*placed), near.as_dvec3());
        }
        let shifted = from_far(whole.mesh.positions[3]) - DVec3::new(0.125, 1e-6, 3.0);
        assert!(shifted.length() < 1e-7, "{shifted}");
        assert_eq!(from_far(whole.spheres[0].centre), DVec3::splat(0.5));
        let Light::Point { position, .. } = whole.lights[0] else { panic!() };
        // It was there before the origin was known.
        assert!((from_far(position) - DVec3::Y).length() < 1e-3);
        // A part with an origin of its own, moved back to the world's.
        let mut back = Part::default();
        back.append(whole, &DAffine3::from_translation(-far), "a.toml", |_| None).unwrap();
        assert_eq!((back.origin(), &back.mesh.positions[..3]), (DVec3::ZERO, &near[..]));
    }

    #[test]
    fn the_origin_stays_where_shapes_are_about_it() {
        for (low, high) in [(-1.0, 1.0), (3.0, 5.0), (-10.0, -8.0)] {
            assert_eq!(origin_for(DVec3::splat(low), DVec3::splat(high)), DVec3::ZERO);
        }
        assert_eq!(origin_for(DVec3::splat(1e9), DVec3::splat(1e9 + 1.0)), DVec3::ZERO, "left to the limit");
        assert!(origin_for(DVec3::splat(7.0), DVec3::splat(7.0)).is_finite());
    }

    #[test]
    fn surfaces_that_light_does_not_meet_are_dropped_unless_they_shine_or_bound_a_medium() {
        let mut part = part();
        part.materials[0].surface = Surface::Null;
        let mut shining = part.clone();
        shining.materials[0].emission = Color::Constant(Vec3::ONE);
        let mut bounding = part.clone();
        bounding.materials[0].interior = Some(0);
        part.drop_unseen();
        shining.drop_unseen();
        assert_eq!((part.mesh.triangles.len(), part.mesh.materials.len(), shining.mesh.triangles.len()), (0, 0, 1));
        bounding.drop_unseen();
        assert_eq!(bounding.mesh.triangles.len(), 1);
    }

    #[test]
    fn a_replaced_material_is_ours() {
        let mut whole = part();
        whole.append(part(), &DAffine3::IDENTITY, "a.glb", |_| Some(0)).unwrap();
        assert_eq!(whole.mesh.materials, [0, 0]);
        assert!(!whole.has_emission());
    }
}
