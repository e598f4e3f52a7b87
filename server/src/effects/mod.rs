//! The effects a scene calls for, and the frame plan that follows: nothing else is simulated.
//!
//! Derived from the scene and from nothing else. An effect that is off costs nothing, and its counter stays
//! at zero; why it is off can be said, too. [`without`] switches one off, to see what it costs and what it shows:
//! one that is off anyway changes no byte of a frame.

mod ablation;
mod closed;

pub use ablation::{Simulated, without};

use crate::bsdf::interface_of;
use crate::scene::{Environment, Finish, Light, Material, Scalar, Scene, Surface};
use closed::is_closed;
use glam::Vec3;
use warplight_protocol::frame::Plan;

/// A kind of light transport.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum EffectKind {
    /// Surfaces that shine.
    Emission,
    /// Point, spot and directional lights.
    PointLights,
    /// Light from beyond the scene.
    Environment,
    /// Light that surfaces scatter to one another.
    DiffuseInterreflection,
    /// Colours that vary over a surface.
    Textures,
    /// Textures that tilt the shading normal.
    NormalMaps,
    /// Surfaces with holes.
    Cutouts,
    /// Mirrors, metals and the outside of transparent things.
    Reflection,
    /// Light bent through a transparent boundary.
    Refraction,
    /// Surfaces that reflect or refract into a lobe instead of one direction.
    RoughLobes,
    /// Clear layers over a surface.
    Coats,
    /// Light lost inside a transparent medium.
    Absorption,
    /// Colours that are refracted differently.
    Dispersion,
    /// Light scattered between surfaces.
    Media,
}

impl EffectKind {
    /// All there are, in the order of reports.
    pub const ALL: [EffectKind; 14] = [
        EffectKind::Emission,
        EffectKind::PointLights,
        EffectKind::Environment,
        EffectKind::DiffuseInterreflection,
        EffectKind::Textures,
        EffectKind::NormalMaps,
        EffectKind::Cutouts,
        EffectKind::Reflection,
        EffectKind::Refraction,
        EffectKind::RoughLobes,
        EffectKind::Coats,
        EffectKind::Absorption,
        EffectKind::Dispersion,
        EffectKind::Media,
    ];

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            EffectKind::Emission => "emission",
            EffectKind::PointLights => "point lights",
            EffectKind::Environment => "environment",
            EffectKind::DiffuseInterreflection => "diffuse interreflection",
            EffectKind::Textures => "textures",
            EffectKind::NormalMaps => "normal maps",
            EffectKind::Cutouts => "cutouts",
            EffectKind::Reflection => "reflection",
            EffectKind::Refraction => "refraction",
            EffectKind::RoughLobes => "rough lobes",
            EffectKind::Coats => "coats",
            EffectKind::Absorption => "absorption",
            EffectKind::Dispersion => "dispersion",
            EffectKind::Media => "media",
        }
    }

    /// The counter of the rays that it alone causes, if it has rays of its own.
    pub fn counter(self) -> Option<&'static str> {
        match self {
            EffectKind::DiffuseInterreflection => Some("rays.diffuse"),
            EffectKind::Reflection => Some("rays.reflect"),
            EffectKind::Refraction => Some("rays.refract"),
            EffectKind::RoughLobes => Some("rays.glossy"),
            EffectKind::Media => Some("rays.scatter"),
            EffectKind::Emission
            | EffectKind::PointLights
            | EffectKind::Environment
            | EffectKind::Textures
            | EffectKind::NormalMaps
            | EffectKind::Cutouts
            | EffectKind::Coats
            | EffectKind::Absorption
            | EffectKind::Dispersion => None,
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
        let used: Vec<&Material> = used_materials(scene).into_iter().map(|index| &scene.materials[index]).collect();
        let effects =
            EffectKind::ALL.into_iter().filter_map(|kind| Some(Effect { kind, why: why(kind, scene, &used)? }));
        Effects(effects.collect())
    }

    /// The effects, each once.
    pub fn iter(&self) -> impl Iterator<Item = &Effect> {
        self.0.iter()
    }

    /// Whether the scene calls for an effect.
    pub fn has(&self, kind: EffectKind) -> bool {
        self.0.iter().any(|effect| effect.kind == kind)
    }

    /// The effects that the scene does not call for, and what it lacks.
    pub fn off(&self) -> impl Iterator<Item = (EffectKind, &'static str)> {
        EffectKind::ALL.into_iter().filter_map(|kind| Some((kind, self.why_not(kind)?)))
    }

    /// Why an effect is off; `None` where it is on.
    pub fn why_not(&self, kind: EffectKind) -> Option<&'static str> {
        if self.has(kind) {
            return None;
        }
        let or_else = |needed: EffectKind, none: &'static str, plain: &'static str| {
            if self.has(needed) { plain } else { none }
        };
        Some(match kind {
            EffectKind::Emission => "no surface shines",
            EffectKind::PointLights => "no light is without extent",
            EffectKind::Environment => "nothing shines from beyond the scene",
            EffectKind::DiffuseInterreflection => "nothing scatters diffusely",
            EffectKind::Textures => "every surface is alike all over",
            EffectKind::NormalMaps => "no texture tilts a normal",
            EffectKind::Cutouts => "no surface has holes",
            EffectKind::Reflection => "nothing reflects",
            EffectKind::Refraction => "nothing is transparent",
            EffectKind::RoughLobes => {
                or_else(EffectKind::Reflection, "nothing reflects", "all that reflects is smooth")
            }
            EffectKind::Coats => "nothing is coated",
            EffectKind::Absorption => {
                or_else(EffectKind::Refraction, "nothing is transparent", "all that is transparent is clear inside")
            }
            EffectKind::Dispersion => {
                or_else(EffectKind::Refraction, "nothing is transparent", "all colours are refracted alike")
            }
            EffectKind::Media => "nothing is between the surfaces",
        })
    }

    /// Names for reports.
    pub fn names(&self) -> Vec<String> {
        self.0.iter().map(|effect| effect.kind.name().to_owned()).collect()
    }
}

/// What in the scene calls for an effect, in words; `None` where nothing does.
fn why(kind: EffectKind, scene: &Scene, used: &[&Material]) -> Option<String> {
    let because = |why: &'static str, calls: &dyn Fn(&Material) -> bool| {
        used.iter().find(|material| calls(material)).map(|material| format!("material '{}' {why}", material.name))
    };
    match kind {
        EffectKind::Emission => because("emits", &|material| !material.emission.is_black()),
        EffectKind::PointLights => {
            let lights: Vec<&Light> = scene.lights.iter().filter(|light| light.strength() != Vec3::ZERO).collect();
            (!lights.is_empty()).then(|| format!("{} lights without extent", lights.len()))
        }
        EffectKind::Environment => (!scene.environment.is_black()).then(|| match &scene.environment {
            Environment::Image { width, height, .. } => format!("rays that leave see an image of {width}x{height}"),
            _ => "rays that leave see a sky".to_owned(),
        }),
        EffectKind::DiffuseInterreflection => {
            because("scatters diffusely", &|material| scatters_diffusely(&material.surface))
        }
        EffectKind::Textures => because("has a texture", &|material| material.textures().next().is_some()),
        EffectKind::NormalMaps => because("has a normal map", &|material| material.normal_map.is_some()),
        EffectKind::Cutouts => because("has holes", &|material| material.cutout.is_some()),
        EffectKind::Reflection => because("reflects", &|material| reflects(&material.surface)),
        EffectKind::Refraction => because("is transparent", &|material| is_transparent(&material.surface)),
        EffectKind::RoughLobes => because("is rough", &|material| is_rough(&material.surface)),
        EffectKind::Coats => because(
            "is coated",
            &|material| matches!(&material.surface, Surface::Standard(standard) if standard.coat.is_some()),
        ),
        EffectKind::Absorption => because(
            "absorbs inside",
            &|material| matches!(material.surface, Surface::Dielectric { absorption, .. } if absorption != Vec3::ZERO),
        ),
        EffectKind::Dispersion => because("disperses colours", &|material| material.surface.is_dispersive()),
        EffectKind::Media => because("bounds a medium", &|material| {
            [material.interior, material.exterior].iter().flatten().any(|&index| (index as usize) < scene.media.len())
        }),
    }
}

fn scatters_diffusely(surface: &Surface) -> bool {
    match surface {
        Surface::Diffuse { albedo } => !albedo.is_black(),
        Surface::Standard(standard) => !standard.base.is_black() && !is_constant(&standard.metallic, 1.0),
        _ => false,
    }
}

fn reflects(surface: &Surface) -> bool {
    match surface {
        Surface::Diffuse { .. } | Surface::Null => false,
        Surface::Standard(standard) => {
            !is_constant(&standard.specular, 0.0) || !is_constant(&standard.metallic, 0.0) || standard.coat.is_some()
        }
        _ => true,
    }
}

fn is_transparent(surface: &Surface) -> bool {
    match surface {
        Surface::Dielectric { .. } | Surface::ThinDielectric { .. } => true,
        Surface::Standard(standard) => !is_constant(&standard.transmission, 0.0),
        _ => false,
    }
}

fn is_rough(surface: &Surface) -> bool {
    finishes(surface).any(|finish| !finish.is_smooth())
}

/// How smooth its layers are that reflect.
fn finishes(surface: &Surface) -> impl Iterator<Item = Finish> {
    let (first, coat) = match surface {
        Surface::Conductor { finish, .. }
        | Surface::Dielectric { finish, .. }
        | Surface::ThinDielectric { finish, .. } => (Some(*finish), None),
        Surface::Standard(standard) => {
            let coat = standard.coat.map(|coat| Finish { alpha: coat.alpha, ..Finish::SMOOTH });
            (reflects(surface).then_some(standard.finish), coat)
        }
        Surface::Diffuse { .. } | Surface::Mirror { .. } | Surface::Null => (None, None),
    };
    first.into_iter().chain(coat)
}

fn is_constant(scalar: &Scalar, value: f32) -> bool {
    *scalar == Scalar::Constant(value)
}

/// The nodes that a scene's frames have: {D} where all is diffuse or rough, {D, R} with mirrors and metals,
/// {D, R, F} with an open refracting boundary such as water or a pane, {D, R, F, FF} with solids, which light
/// must leave again.
pub fn plan_of(scene: &Scene) -> Plan {
    let used = used_materials(scene);
    let has_nodes = |index: &usize| interface_of(&scene.materials[*index].surface, true).is_some();
    let sharp: Vec<usize> = used.into_iter().filter(has_nodes).collect();
    let refracts = |index: usize| {
        matches!(scene.materials[index].surface, Surface::Dielectric { .. } | Surface::ThinDielectric { .. })
    };
    let is_solid_glass = |index: usize| {
        matches!(scene.materials[index].surface, Surface::Dielectric { .. }) && is_solid(scene, index as u32)
    };
    if sharp.iter().any(|&index| is_solid_glass(index)) {
        Plan::solid()
    } else if sharp.iter().any(|&index| refracts(index)) {
        Plan::water()
    } else if sharp.is_empty() {
        Plan::diffuse()
    } else {
        Plan::mirror()
    }
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
        assert_eq!(effects.why_not(EffectKind::Refraction), None);
        assert_eq!(effects.why_not(EffectKind::RoughLobes), Some("all that reflects is smooth"));
        assert_eq!(effects.off().count() + effects.iter().count(), EffectKind::ALL.len(), "on or off, each once");
    }
}
