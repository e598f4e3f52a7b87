//! The effects a scene calls for, and the frame plan that follows: nothing else is simulated.
//!
//! Derived from the scene and from nothing else. An effect that is off costs nothing, and its counter stays
//! at zero.

mod closed;

use crate::scene::{Color, Environment, Material, Scene, Surface};
use closed::is_closed;
use glam::Vec3;
use warplight_protocol::frame::Plan;

/// A kind of light transport.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum EffectKind {
    /// Surfaces that shine.
    Emission,
    /// Light from beyond the scene.
    Environment,
    /// Light that surfaces scatter to one another.
    DiffuseInterreflection,
    /// Colours that vary over a surface.
    Textures,
    /// Mirrors, metals and the outside of transparent things.
    Reflection,
    /// Light bent through a transparent boundary.
    Refraction,
    /// Light lost inside a transparent medium.
    Absorption,
}

impl EffectKind {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            EffectKind::Emission => "emission",
            EffectKind::Environment => "environment",
            EffectKind::DiffuseInterreflection => "diffuse interreflection",
            EffectKind::Textures => "textures",
            EffectKind::Reflection => "reflection",
            EffectKind::Refraction => "refraction",
            EffectKind::Absorption => "absorption",
        }
    }

    /// The counter of the rays that it alone causes, if it has rays of its own.
    pub fn counter(self) -> Option<&'static str> {
        match self {
            EffectKind::Emission => Some("rays.shadow"),
            EffectKind::DiffuseInterreflection => Some("rays.diffuse"),
            EffectKind::Reflection => Some("rays.reflect"),
            EffectKind::Refraction => Some("rays.refract"),
            EffectKind::Environment | EffectKind::Textures | EffectKind::Absorption => None,
        }
    }
}

/// An effect and the material that calls for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Effect {
    /// Which.
    pub kind: EffectKind,
    /// What in the scene calls for it, in words.
    pub why: String,
}

/// All effects that a scene calls for, in the order of [`EffectKind`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Effects(Vec<Effect>);

impl Effects {
    /// The effects of a scene. Materials that no surface has call for nothing.
    pub fn of(scene: &Scene) -> Effects {
        let used = used_materials(scene);
        let mut effects = Vec::new();
        let mut call = |kind, why: Option<String>| effects.extend(why.map(|why| Effect { kind, why }));
        let because = |why: &'static str, calls: &dyn Fn(&Material) -> bool| {
            used.iter()
                .map(|&index| &scene.materials[index])
                .find(|&material| calls(material))
                .map(|material| format!("material '{}' {why}", material.name))
        };
        call(EffectKind::Emission, because("emits", &|material| !material.emission.is_black()));
        let environment = (!scene.environment.is_black()).then(|| match &scene.environment {
            Environment::Image { width, height, .. } => format!("rays that leave see an image of {width}x{height}"),
            _ => "rays that leave see a sky".to_owned(),
        });
        call(EffectKind::Environment, environment);
        call(
            EffectKind::DiffuseInterreflection,
            because(
                "scatters diffusely",
                &|material| matches!(&material.surface, Surface::Diffuse { albedo } if !albedo.is_black()),
            ),
        );
        call(EffectKind::Textures, because("has a texture", &is_textured));
        call(
            EffectKind::Reflection,
            because("reflects sharply", &|material| !matches!(material.surface, Surface::Diffuse { .. })),
        );
        call(
            EffectKind::Refraction,
            because("is transparent", &|material| matches!(material.surface, Surface::Dielectric { .. })),
        );
        call(
            EffectKind::Absorption,
            because(
                "absorbs inside",
                &|material| matches!(material.surface, Surface::Dielectric { absorption, .. } if absorption != Vec3::ZERO),
            ),
        );
        Effects(effects)
    }

    /// The effects, each once.
    pub fn iter(&self) -> impl Iterator<Item = &Effect> {
        self.0.iter()
    }

    /// Whether the scene calls for an effect.
    pub fn has(&self, kind: EffectKind) -> bool {
        self.0.iter().any(|effect| effect.kind == kind)
    }

    /// Names for reports.
    pub fn names(&self) -> Vec<String> {
        self.0.iter().map(|effect| effect.kind.name().to_owned()).collect()
    }
}

/// The nodes that a scene's frames have: {D} where all is diffuse, {D, R} with mirrors and metals, {D, R, F}
/// with an open refracting boundary such as water, {D, R, F, FF} with solids, which light must leave again.
pub fn plan_of(scene: &Scene) -> Plan {
    let used = used_materials(scene);
    let of_surface = |wanted: fn(&Surface) -> bool| {
        used.iter().copied().filter(move |&index| wanted(&scene.materials[index].surface))
    };
    let mut dielectrics = of_surface(|surface| matches!(surface, Surface::Dielectric { .. })).peekable();
    if dielectrics.peek().is_some() {
        let any_solid = dielectrics.any(|material| is_solid(scene, material as u32));
        return if any_solid { Plan::solid() } else { Plan::water() };
    }
    let any_specular = of_surface(|surface| !matches!(surface, Surface::Diffuse { .. })).next().is_some();
    if any_specular { Plan::mirror() } else { Plan::diffuse() }
}

/// Whether a transparent material bounds a solid: a sphere, or triangles without a border.
fn is_solid(scene: &Scene, material: u32) -> bool {
    scene.spheres.iter().any(|sphere| sphere.material == material) || is_closed(&scene.mesh, material)
}

/// Indices of the materials that some surface has, in order.
fn used_materials(scene: &Scene) -> Vec<usize> {
    let mut used = vec![false; scene.materials.len()];
    let of_spheres = scene.spheres.iter().map(|sphere| sphere.material);
    for material in scene.mesh.materials.iter().copied().chain(of_spheres) {
        used[material as usize] = true;
    }
    (0..used.len()).filter(|&index| used[index]).collect()
}

fn is_textured(material: &Material) -> bool {
    let textured = |color: &Color| matches!(color, Color::Textured { .. });
    textured(&material.emission) || matches!(&material.surface, Surface::Diffuse { albedo } if textured(albedo))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{SceneBuilder, diffuse, emitter, glass, mirror};

    #[test]
    fn the_plan_follows_from_the_surfaces() {
        let room = || SceneBuilder::new().cube(Vec3::ZERO, 5.0, diffuse(0.5));
        let small_pane = [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Z, Vec3::Z];
        assert_eq!(plan_of(&room().build()), Plan::diffuse());
        assert_eq!(plan_of(&room().sphere(Vec3::ZERO, 1.0, mirror()).build()), Plan::mirror());
        assert_eq!(plan_of(&room().quad(small_pane, glass(1.33)).build()), Plan::water());
        assert_eq!(plan_of(&room().sphere(Vec3::ZERO, 1.0, glass(1.5)).build()), Plan::solid());
        assert_eq!(plan_of(&room().cube(Vec3::ZERO, 1.0, glass(1.5)).build()), Plan::solid());
    }

    #[test]
    fn an_unused_material_calls_for_nothing() {
        let mut scene = SceneBuilder::new().cube(Vec3::ZERO, 5.0, diffuse(0.5)).build();
        scene.materials.push(glass(1.5));
        assert_eq!(plan_of(&scene), Plan::diffuse());
        assert_eq!(Effects::of(&scene).names(), ["diffuse interreflection"]);
    }

    #[test]
    fn each_effect_names_the_material_that_calls_for_it() {
        let scene = SceneBuilder::new()
            .cube(Vec3::ZERO, 5.0, diffuse(0.5))
            .sphere(Vec3::ZERO, 1.0, glass(1.5))
            .sphere(Vec3::Y * 3.0, 0.5, emitter(Vec3::ONE))
            .build();
        let effects = Effects::of(&scene);
        assert_eq!(effects.names(), ["emission", "diffuse interreflection", "reflection", "refraction"]);
        let refraction = effects.iter().find(|effect| effect.kind == EffectKind::Refraction).unwrap();
        assert_eq!(refraction.why, "material 'glass' is transparent");
        assert!(!effects.has(EffectKind::Absorption) && !effects.has(EffectKind::Environment));
    }
}
