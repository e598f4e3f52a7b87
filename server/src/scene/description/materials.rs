//! `[[material]]`: what a surface does with light, in keys.
//!
//! Roughness in scene.toml is the perceptual one of glTF, whose square is the alpha of the distribution of
//! facets: steps of it look even.

use super::super::SceneError;
use super::super::material::{
    Anisotropy, Coat, Color, Cutout, Distribution, Finish, Material, NormalMap, Scalar, Standard, Surface,
};
use super::super::metals::{metal, metal_names};
use super::checks::Section;
use super::{ColorKeys, MAX_RADIANCE, Rgb, index_of, one};
use glam::{Vec2, Vec3};
use serde::Deserialize;
use std::collections::HashMap;

/// The kinds, each with its own keys; serde cannot refuse unknown keys where shared ones are flattened in, so
/// that what all have is written into each of them here.
macro_rules! material_entries {
    ($($kind:ident { $($keys:tt)* })*) => {
        #[derive(Debug, Deserialize)]
        #[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
        pub(super) enum MaterialEntry {
            $($kind {
                name: String,
                emission: Option<ColorKeys>,
                #[serde(default)]
                emission_two_sided: bool,
                #[serde(default)]
                one_sided: bool,
                normal_map: Option<NormalMapKeys>,
                cutout: Option<CutoutKeys>,
                $($keys)*
            },)*
        }

        impl MaterialEntry {
            fn shared(&self) -> SharedKeys<'_> {
                match self {
                    $(MaterialEntry::$kind {
                        name, emission, emission_two_sided, one_sided, normal_map, cutout, ..
                    } => SharedKeys {
                        name,
                        emission: emission.as_ref(),
                        emission_two_sided: *emission_two_sided,
                        one_sided: *one_sided,
                        normal_map: normal_map.as_ref(),
                        cutout: cutout.as_ref(),
                    },)*
                }
            }
        }
    };
}

material_entries! {
    Diffuse {
        albedo: ColorKeys,
    }
    Mirror {
        filter: Option<Rgb>,
    }
    Conductor {
        metal: Option<String>,
        eta: Option<Rgb>,
        k: Option<Rgb>,
        filter: Option<ColorKeys>,
        roughness: Option<ScalarKeys>,
        #[serde(default)]
        distribution: DistributionKey,
        anisotropy: Option<AnisotropyKeys>,
        #[serde(default = "yes")]
        compensated: bool,
    }
    Dielectric {
        ior: f32,
        abbe: Option<f32>,
        filter: Option<ColorKeys>,
        absorption: Option<Rgb>,
        roughness: Option<ScalarKeys>,
        #[serde(default)]
        distribution: DistributionKey,
        anisotropy: Option<AnisotropyKeys>,
        #[serde(default = "yes")]
        compensated: bool,
    }
    Pane {
        #[serde(default = "default_ior")]
        ior: f32,
        filter: Option<ColorKeys>,
        roughness: Option<ScalarKeys>,
        #[serde(default)]
        distribution: DistributionKey,
        anisotropy: Option<AnisotropyKeys>,
        #[serde(default = "yes")]
        compensated: bool,
    }
    Standard {
        base: ColorKeys,
        metallic: Option<ScalarKeys>,
        roughness: Option<ScalarKeys>,
        #[serde(default)]
        distribution: DistributionKey,
        anisotropy: Option<AnisotropyKeys>,
        #[serde(default = "yes")]
        compensated: bool,
        #[serde(default = "default_ior")]
        ior: f32,
        specular: Option<ScalarKeys>,
        specular_color: Option<ColorKeys>,
        transmission: Option<ScalarKeys>,
        coat: Option<CoatKeys>,
    }
}

/// What every kind has.
struct SharedKeys<'a> {
    name: &'a str,
    emission: Option<&'a ColorKeys>,
    emission_two_sided: bool,
    one_sided: bool,
    normal_map: Option<&'a NormalMapKeys>,
    cutout: Option<&'a CutoutKeys>,
}

/// A number, or a channel of a texture.
#[derive(Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a number, a texture's name, or { texture = name, channel = \"red\", factor = number }"
)]
pub(super) enum ScalarKeys {
    Number(f32),
    Texture(String),
    Scaled(ScaledChannelKeys),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ScaledChannelKeys {
    texture: String,
    channel: Option<ChannelKey>,
    #[serde(default = "one")]
    factor: f32,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ChannelKey {
    Red,
    Green,
    Blue,
    Alpha,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum DistributionKey {
    #[default]
    Ggx,
    Beckmann,
}

#[derive(Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "expected an anisotropy: a number or { strength = number, rotation_deg = number, texture = name }"
)]
pub(super) enum AnisotropyKeys {
    Strength(f32),
    Turned(TurnedAnisotropyKeys),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TurnedAnisotropyKeys {
    #[serde(default = "one")]
    strength: f32,
    #[serde(default)]
    rotation_deg: f32,
    texture: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CoatKeys {
    strength: Option<ScalarKeys>,
    roughness: Option<ScalarKeys>,
}

#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "expected a normal map: a texture's name or { texture = name, scale = number }")]
pub(super) enum NormalMapKeys {
    Texture(String),
    Scaled(ScaledNormalMapKeys),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ScaledNormalMapKeys {
    texture: String,
    #[serde(default = "one")]
    scale: f32,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CutoutKeys {
    opacity: ScalarKeys,
    threshold: Option<f32>,
}

fn yes() -> bool {
    true
}

fn default_ior() -> f32 {
    1.5
}

impl MaterialEntry {
    pub(super) fn name(&self) -> &str {
        self.shared().name
    }
}

/// The material of an entry; `textures` are indices by name.
pub(super) fn material(
    section: &Section,
    textures: &HashMap<String, u32>,
    entry: &MaterialEntry,
) -> Result<Material, SceneError> {
    let keys = entry.shared();
    let check = Check { section, textures };
    let mut material = Material::new(keys.name, check.surface(entry)?);
    if keys.one_sided && matches!(material.surface, Surface::Dielectric { .. } | Surface::ThinDielectric { .. }) {
        return Err(section.error("one_sided", "an opaque kind of material", "a transparent one"));
    }
    material.one_sided = keys.one_sided;
    if let Some(emission) = keys.emission {
        material.emission = check.color("emission", emission, MAX_RADIANCE)?;
        material.emission_two_sided = keys.emission_two_sided;
    }
    material.normal_map = keys.normal_map.map(|keys| check.normal_map(keys)).transpose()?;
    if let Some(CutoutKeys { opacity, threshold }) = keys.cutout {
        let opacity = check.scalar("cutout: opacity", opacity, ChannelKey::Alpha)?;
        let threshold = threshold.map(|value| section.number("cutout: threshold", value, 0.0..=1.0)).transpose()?;
        material.cutout = Some(Cutout { opacity, threshold });
    }
    Ok(material)
}

/// Range checks of one material.
struct Check<'a> {
    section: &'a Section<'a>,
    textures: &'a HashMap<String, u32>,
}

impl Check<'_> {
    fn surface(&self, entry: &MaterialEntry) -> Result<Surface, SceneError> {
        let section = self.section;
        let filter = |keys: &Option<ColorKeys>| {
            keys.as_ref().map_or(Ok(Color::Constant(Vec3::ONE)), |keys| self.color("filter", keys, 1.0))
        };
        Ok(match entry {
            MaterialEntry::Diffuse { albedo, .. } => Surface::Diffuse { albedo: self.color("albedo", albedo, 1.0)? },
            MaterialEntry::Mirror { filter, .. } => {
                Surface::Mirror { filter: section.rgb("filter", filter.unwrap_or(Rgb::Grey(1.0)), 0.0..=1.0)? }
            }
            MaterialEntry::Conductor {
                metal: named,
                eta,
                k,
                filter: by,
                roughness,
                distribution,
                anisotropy,
                compensated,
                ..
            } => {
                let (eta, k) = conductor(section, named.as_deref(), *eta, *k)?;
                let finish = self.finish(roughness.as_ref(), 0.0, *distribution, anisotropy.as_ref(), *compensated)?;
                Surface::Conductor { eta, k, filter: filter(by)?, finish }
            }
            MaterialEntry::Dielectric {
                ior,
                abbe,
                filter: by,
                absorption,
                roughness,
                distribution,
                anisotropy,
                compensated,
                ..
            } => Surface::Dielectric {
                ior: section.number("ior", *ior, MIN_IOR..=MAX_IOR)?,
                // As KHR_materials_dispersion has it.
                dispersion: abbe.map_or(Ok(0.0), |abbe| section.number("abbe", abbe, ABBE).map(|abbe| 20.0 / abbe))?,
                filter: filter(by)?,
                absorption: section.rgb("absorption", absorption.unwrap_or(Rgb::Grey(0.0)), 0.0..=MAX_ABSORPTION)?,
                finish: self.finish(roughness.as_ref(), 0.0, *distribution, anisotropy.as_ref(), *compensated)?,
            },
            MaterialEntry::Pane { ior, filter: by, roughness, distribution, anisotropy, compensated, .. } => {
                Surface::ThinDielectric {
                    ior: section.number("ior", *ior, MIN_IOR..=MAX_IOR)?,
                    filter: filter(by)?,
                    finish: self.finish(roughness.as_ref(), 0.0, *distribution, anisotropy.as_ref(), *compensated)?,
                }
            }
            MaterialEntry::Standard {
                base,
                metallic,
                roughness,
                distribution,
                anisotropy,
                compensated,
                ior,
                specular,
                specular_color,
                transmission,
                coat,
                ..
            } => {
                let number = |field: &str, keys: &Option<ScalarKeys>, default: f32| {
                    keys.as_ref()
                        .map_or(Ok(Scalar::Constant(default)), |keys| self.scalar(field, keys, ChannelKey::Red))
                };
                let specular_color = specular_color.as_ref().map_or(Ok(Color::Constant(Vec3::ONE)), |keys| {
                    self.color("specular_color", keys, MAX_SPECULAR_COLOR)
                })?;
                let coat = coat.as_ref().map(|CoatKeys { strength, roughness }| -> Result<Coat, SceneError> {
                    let alpha = self.alpha("coat: roughness", roughness.as_ref(), 0.0)?;
                    Ok(Coat { strength: number("coat: strength", strength, 1.0)?, alpha })
                });
                Surface::Standard(Standard {
                    base: self.color("base", base, 1.0)?,
                    metallic: number("metallic", metallic, 0.0)?,
                    finish: self.finish(roughness.as_ref(), 1.0, *distribution, anisotropy.as_ref(), *compensated)?,
                    ior: section.number("ior", *ior, 1.0..=MAX_IOR)?,
                    specular: number("specular", specular, 1.0)?,
                    specular_color,
                    transmission: number("transmission", transmission, 0.0)?,
                    coat: coat.transpose()?,
                })
            }
        })
    }

    fn finish(
        &self,
        roughness: Option<&ScalarKeys>,
        default: f32,
        distribution: DistributionKey,
        anisotropy: Option<&AnisotropyKeys>,
        compensated: bool,
    ) -> Result<Finish, SceneError> {
        let (strength, rotation_deg, texture) = match anisotropy {
            None => (0.0, 0.0, None),
            Some(AnisotropyKeys::Strength(strength)) => (*strength, 0.0, None),
            Some(AnisotropyKeys::Turned(keys)) => (keys.strength, keys.rotation_deg, keys.texture.as_ref()),
        };
        let anisotropy = Anisotropy {
            strength: self.section.number("anisotropy: strength", strength, 0.0..=1.0)?,
            rotation_rad: self.section.number("anisotropy: rotation_deg", rotation_deg, -360.0..=360.0)?.to_radians(),
            texture: texture.map(|name| self.texture("anisotropy: texture", name)).transpose()?,
        };
        let distribution = match distribution {
            DistributionKey::Ggx => Distribution::Ggx,
            DistributionKey::Beckmann => Distribution::Beckmann,
        };
        let alpha = self.alpha("roughness", roughness, default)?;
        Ok(Finish { distribution, alpha, anisotropy, compensated })
    }

    /// The alpha of a roughness: its square.
    fn alpha(&self, field: &str, roughness: Option<&ScalarKeys>, default: f32) -> Result<Scalar, SceneError> {
        let roughness = roughness.map(|keys| self.scalar(field, keys, ChannelKey::Red)).transpose()?;
        Ok(match roughness.unwrap_or(Scalar::Constant(default)) {
            Scalar::Constant(roughness) => Scalar::Constant(roughness * roughness),
            Scalar::Textured { texture, channel, factor, .. } => {
                Scalar::Textured { texture, channel, factor: factor * factor, squared: true }
            }
        })
    }

    /// A number from 0 to 1, or a channel of a texture, `usual` unless it is named.
    fn scalar(&self, field: &str, keys: &ScalarKeys, usual: ChannelKey) -> Result<Scalar, SceneError> {
        let (name, channel, factor) = match keys {
            ScalarKeys::Number(value) => return Ok(Scalar::Constant(self.section.number(field, *value, 0.0..=1.0)?)),
            ScalarKeys::Texture(name) => (name, None, 1.0),
            ScalarKeys::Scaled(keys) => (&keys.texture, keys.channel, keys.factor),
        };
        let texture = self.texture(field, name)?;
        let factor = self.section.number(field, factor, 0.0..=1.0)?;
        Ok(Scalar::Textured { texture, channel: channel.unwrap_or(usual) as u8, factor, squared: false })
    }

    fn color(&self, field: &str, keys: &ColorKeys, most: f32) -> Result<Color, SceneError> {
        let (name, factor) = match keys {
            ColorKeys::Plain(color) => return Ok(Color::Constant(self.section.rgb(field, *color, 0.0..=most)?)),
            ColorKeys::Texture(name) => (name, Vec3::ONE),
            ColorKeys::Scaled(scaled) => (&scaled.texture, self.section.rgb(field, scaled.factor, 0.0..=most)?),
        };
        Ok(Color::Textured { texture: self.texture(field, name)?, factor })
    }

    fn normal_map(&self, keys: &NormalMapKeys) -> Result<NormalMap, SceneError> {
        let (name, scale) = match keys {
            NormalMapKeys::Texture(name) => (name, 1.0),
            NormalMapKeys::Scaled(keys) => (&keys.texture, keys.scale),
        };
        let scale = self.section.number("normal_map: scale", scale, -10.0..=10.0)?;
        Ok(NormalMap { texture: self.texture("normal_map", name)?, scale: Vec2::splat(scale) })
    }

    fn texture(&self, field: &str, name: &str) -> Result<u32, SceneError> {
        index_of(self.textures, self.section, field, "texture", name)
    }
}

fn conductor(
    section: &Section,
    named: Option<&str>,
    eta: Option<Rgb>,
    k: Option<Rgb>,
) -> Result<(Vec3, Vec3), SceneError> {
    match (named, eta, k) {
        (Some(name), None, None) => metal(name).ok_or_else(|| {
            section.error("metal", format_args!("one of {}", metal_names()), format_args!("'{}'", name.escape_debug()))
        }),
        (None, Some(eta), Some(k)) => Ok((section.rgb("eta", eta, 1e-3..=1e3)?, section.rgb("k", k, 0.0..=1e3)?)),
        _ => Err(section.error("metal", "either metal, or both eta and k", "another combination")),
    }
}

/// An index of 1 is no boundary at all.
const MIN_IOR: f32 = 1.0001;
/// Above germanium (4) nothing transparent exists.
const MAX_IOR: f32 = 10.0;
/// Glasses have 20 to 90; below, colours part more than in anything there is.
const ABBE: std::ops::RangeInclusive<f32> = 5.0..=1e4;
/// Per metre: opaque within a hundredth of a millimetre.
const MAX_ABSORPTION: f32 = 1e6;
/// Reflectance at normal incidence is capped at 1; of index 1.5 that takes 25.
const MAX_SPECULAR_COLOR: f32 = 1e3;
