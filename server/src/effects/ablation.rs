//! Switching off one effect: what is left of the scene, and what of light transport.
//!
//! Most effects are switched off by taking away what calls for them, so that the integrator need not know of
//! it. Three are events that a surface shares with others (a boundary that both reflects and refracts): these
//! are told to the integrator. An effect that the scene does not call for leaves everything as it is.

use super::EffectKind;
use crate::scene::{Color, Environment, Finish, Scalar, Scene, Surface, Texture};
use glam::{Vec2, Vec3, Vec4};

/// Which events the integrator follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Simulated {
    /// Rays from Lambert surfaces; without, they show direct light alone.
    pub interreflection: bool,
    /// Sharp and glossy reflection.
    pub reflection: bool,
    /// Sharp and rough refraction.
    pub refraction: bool,
}

impl Simulated {
    /// Everything that the scene calls for.
    pub const ALL: Simulated = Simulated { interreflection: true, reflection: true, refraction: true };
}

/// The scene and the integrator's events without an effect.
pub fn without(scene: &Scene, kind: EffectKind) -> (Scene, Simulated) {
    let mut scene = scene.clone();
    let mut simulated = Simulated::ALL;
    match kind {
        EffectKind::Emission => {
            scene.materials.iter_mut().for_each(|material| material.emission = Color::Constant(Vec3::ZERO));
        }
        EffectKind::PointLights => scene.lights.clear(),
        EffectKind::Environment => scene.environment = Environment::Black,
        EffectKind::DiffuseInterreflection => simulated.interreflection = false,
        EffectKind::Textures => replace_textures(&mut scene),
        EffectKind::NormalMaps => scene.materials.iter_mut().for_each(|material| material.normal_map = None),
        EffectKind::Cutouts => scene.materials.iter_mut().for_each(|material| material.cutout = None),
        EffectKind::Reflection => simulated.reflection = false,
        EffectKind::Refraction => simulated.refraction = false,
        EffectKind::RoughLobes => scene.materials.iter_mut().for_each(|material| make_smooth(&mut material.surface)),
        EffectKind::Coats => {
            for material in &mut scene.materials {
                if let Surface::Standard(standard) = &mut material.surface {
                    standard.coat = None;
                }
            }
        }
        EffectKind::Media => {
            scene.media.clear();
            scene.materials.iter_mut().for_each(|material| (material.interior, material.exterior) = (None, None));
        }
        EffectKind::Absorption | EffectKind::Dispersion => {
            for material in &mut scene.materials {
                if let Surface::Dielectric { absorption, dispersion, .. } = &mut material.surface {
                    if kind == EffectKind::Absorption {
                        *absorption = Vec3::ZERO;
                    } else {
                        *dispersion = 0.0;
                    }
                }
            }
        }
    }
    (scene, simulated)
}

/// Every texture becomes its mean.
fn replace_textures(scene: &mut Scene) {
    let means: Vec<Vec4> = scene.textures.iter().map(mean_of).collect();
    let mean = |texture: u32| means.get(texture as usize).copied().unwrap_or(Vec4::ONE);
    for material in &mut scene.materials {
        let (colors, scalars, _) = material.parameters_mut();
        for color in colors {
            if let Color::Textured { texture, factor } = *color {
                *color = Color::Constant(factor * mean(texture).truncate());
            }
        }
        for scalar in scalars {
            if let Scalar::Textured { texture, channel, factor, squared } = *scalar {
                let value = mean(texture)[usize::from(channel.min(3))];
                *scalar = Scalar::Constant(factor * if squared { value * value } else { value });
            }
        }
    }
}

fn mean_of(texture: &Texture) -> Vec4 {
    const SIDE: u32 = 64;
    // A picture is averaged over itself, whatever part of it a surface shows.
    let texture = Texture::new(texture.kind.clone());
    let at = |index: u32| (index as f32 + 0.5) / SIDE as f32;
    let texel = |index: u32| texture.sample_rgba(Vec2::new(at(index % SIDE), at(index / SIDE)));
    let sum: Vec4 = (0..SIDE * SIDE).map(texel).sum();
    sum / (SIDE * SIDE) as f32
}

fn make_smooth(surface: &mut Surface) {
    match surface {
        Surface::Conductor { finish, .. }
        | Surface::Dielectric { finish, .. }
        | Surface::ThinDielectric { finish, .. } => *finish = Finish::SMOOTH,
        Surface::Standard(standard) => {
            standard.finish = Finish::SMOOTH;
            if let Some(coat) = &mut standard.coat {
                coat.alpha = Scalar::Constant(0.0);
            }
        }
        Surface::Diffuse { .. } | Surface::Mirror { .. } | Surface::Null => {}
    }
}
