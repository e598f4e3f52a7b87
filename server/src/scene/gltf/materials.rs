//! glTF materials to surfaces: metallic-roughness (specification, 3.9) and the extensions that describe how
//! light meets a surface.
//!
//! | what the file says | surface |
//! |---|---|
//! | no metal, specular factor 0, nothing on top | `Diffuse`: exactly that |
//! | white smooth metal | `Mirror`: Schlick's reflectance of white is 1 at all angles |
//! | no metal, transmission 1, with thickness | `Dielectric`: refracts by KHR_materials_ior, absorbs by KHR_materials_volume |
//! | no metal, transmission 1, without thickness | `ThinDielectric`: a pane |
//! | unlit | black, emits its base colour |
//! | everything else | `Standard` |
//!
//! What this leaves out is noted, each feature once, with its users. Factors beyond their range are clamped to
//! it. A roughness r of glTF is an alpha of r^2.

use super::super::{
    Anisotropy, Coat, Color, Cutout, Distribution, Finish, Material, NormalMap, Part, Scalar, SceneError, Standard,
    Surface,
};
use super::Source;
use super::textures::{TextureUse, Textures};
use super::unsupported::Unsupported;
use glam::{Vec2, Vec3};
use gltf::material::AlphaMode;
use serde_json::Value;

/// Which set of texture coordinates each material uses.
pub(super) struct UvSets(Vec<u32>);

impl UvSets {
    /// The set of a material of the file, or of the default one.
    pub(super) fn of(&self, material: Option<usize>) -> u32 {
        material.and_then(|index| self.0.get(index).copied()).unwrap_or(0)
    }

    /// Index of the material of meshes that have none.
    pub(super) fn default_material(&self) -> usize {
        self.0.len()
    }
}

/// Reads all materials in the file's order, and behind them a white one for meshes that have none.
pub(super) fn read(source: &Source, part: &mut Part, unsupported: &mut Unsupported) -> Result<UvSets, SceneError> {
    let mut uv_sets = Vec::new();
    let mut textures = Textures::default();
    for (index, material) in source.document.materials().enumerate() {
        let name = material.name().map_or_else(|| format!("material {index}"), str::to_owned);
        let mut reader = Reader { source, part, unsupported, textures: &mut textures, name, uv_set: None };
        let read = reader.material(&material)?;
        uv_sets.push(reader.uv_set.unwrap_or(0));
        part.materials.push(read);
    }
    part.materials.push(Material::new("default", Surface::Diffuse { albedo: Color::Constant(Vec3::ONE) }));
    Ok(UvSets(uv_sets))
}

/// Extensions that change how a surface looks and are left out.
const LEFT_OUT: [(&str, &str); 4] = [
    ("KHR_materials_sheen", "sheen is left out"),
    ("KHR_materials_iridescence", "iridescence is left out"),
    ("KHR_materials_diffuse_transmission", "diffuse transmission is left out"),
    ("KHR_materials_pbrSpecularGlossiness", "specular-glossiness is left out: the base colour is used"),
];

/// Reads one material.
struct Reader<'a> {
    source: &'a Source,
    part: &'a mut Part,
    unsupported: &'a mut Unsupported,
    textures: &'a mut Textures,
    /// Of the material.
    name: String,
    /// The set of texture coordinates of its first texture.
    uv_set: Option<u32>,
}

impl Reader<'_> {
    fn material(&mut self, material: &gltf::Material) -> Result<Material, SceneError> {
        for (extension, what) in LEFT_OUT {
            if material.extension_value(extension).is_some() {
                self.note(what);
            }
        }
        let pbr = material.pbr_metallic_roughness();
        let [red, green, blue, alpha] = pbr.base_color_factor();
        let base_factor = Vec3::new(red, green, blue).clamp(Vec3::ZERO, Vec3::ONE);
        let base_texture = pbr.base_color_texture().map(|info| TextureUse::of(&info));
        let base = self.color(base_factor, base_texture)?;
        let mut read = Material::new(self.name.clone(), Surface::Null);
        read.cutout = self.cutout(material, alpha, base_texture)?;
        read.emission_two_sided = material.double_sided();
        if material.extension_value("KHR_materials_unlit").is_some() {
            read.surface = Surface::Diffuse { albedo: Color::Constant(Vec3::ZERO) };
            read.emission = base;
            return Ok(read);
        }
        read.surface = self.surface(material, base)?;
        read.emission = self.emission(material)?;
        if let Some(normals) = material.normal_texture() {
            let texture = self.texture(TextureUse::of_normals(&normals), true)?;
            read.normal_map =
                Some(NormalMap { texture, scale: Vec2::splat(normals.scale().clamp(-MAX_TILT, MAX_TILT)) });
        }
        Ok(read)
    }

    fn surface(&mut self, material: &gltf::Material, base: Color) -> Result<Surface, SceneError> {
        let pbr = material.pbr_metallic_roughness();
        let roughness_and_metalness = pbr.metallic_roughness_texture().map(|info| TextureUse::of(&info));
        let metallic = self.scalar(pbr.metallic_factor(), roughness_and_metalness, BLUE)?;
        let finish = Finish {
            distribution: Distribution::Ggx,
            alpha: self.alpha(pbr.roughness_factor(), roughness_and_metalness)?,
            anisotropy: self.anisotropy(material)?,
            compensated: true,
        };
        let coat = self.coat(material)?;
        let (mut specular, mut specular_color) = (Scalar::Constant(1.0), Color::Constant(Vec3::ONE));
        if let Some(extension) = material.specular() {
            let used = extension.specular_texture().map(|info| TextureUse::of(&info));
            specular = self.scalar(extension.specular_factor(), used, ALPHA)?;
            let used = extension.specular_color_texture().map(|info| TextureUse::of(&info));
            let factor = Vec3::from_array(extension.specular_color_factor());
            specular_color = self.color(factor.clamp(Vec3::ZERO, Vec3::splat(MAX_SPECULAR_COLOR)), used)?;
        }
        let transmission = match material.transmission() {
            None => NONE,
            Some(extension) => {
                let used = extension.transmission_texture().map(|info| TextureUse::of(&info));
                self.scalar(extension.transmission_factor(), used, RED)?
            }
        };

        let (is_plastic, is_opaque, is_clear) = (metallic == NONE, transmission == NONE, transmission == ALL);
        let has_own_reflectance = specular != ALL || specular_color != Color::Constant(Vec3::ONE);
        let is_solid = material.volume().is_some_and(|volume| volume.thickness_factor() > 0.0);
        if is_plastic && is_opaque && specular == NONE && coat.is_none() {
            return Ok(Surface::Diffuse { albedo: base });
        }
        if metallic == ALL && base == Color::Constant(Vec3::ONE) && finish.is_smooth() && coat.is_none() {
            return Ok(Surface::Mirror { filter: Vec3::ONE });
        }
        if is_plastic && is_clear && is_solid {
            if coat.is_some() {
                self.note("clear coats of solid glass are left out");
            }
            if has_own_reflectance {
                self.note("specular factors of solid glass are left out: its index says what it reflects");
            }
            let volume = material.volume();
            let absorption = volume.map_or(Vec3::ZERO, |volume| {
                absorption(Vec3::from_array(volume.attenuation_color()), volume.attenuation_distance())
            });
            let dispersion = self.number(material, "KHR_materials_dispersion", "dispersion", 0.0, MAX_DISPERSION)?;
            // An index of 1 is no boundary, and a rough one could not be drawn from.
            let ior = self.ior(material, MAX_SOLID_IOR).max(MIN_SOLID_IOR);
            return Ok(Surface::Dielectric { ior, dispersion, filter: base, absorption, finish });
        }
        let ior = self.ior(material, MAX_IOR);
        if is_plastic && is_clear && coat.is_none() && !has_own_reflectance {
            return Ok(Surface::ThinDielectric { ior: ior.clamp(MIN_SOLID_IOR, MAX_SOLID_IOR), filter: base, finish });
        }
        if !is_opaque && is_solid {
            self.note("solids that are partly opaque or metal are drawn as thin walls");
        }
        Ok(Surface::Standard(Standard { base, metallic, finish, ior, specular, specular_color, transmission, coat }))
    }

    /// KHR_materials_ior: 0 stands for an infinite index.
    fn ior(&mut self, material: &gltf::Material, most: f32) -> f32 {
        match material.ior() {
            None => DEFAULT_IOR,
            Some(0.0) => most,
            Some(ior) if ior >= 1.0 => ior.min(most),
            Some(_) => {
                self.note("an index of refraction below 1 is none: 1.5 is used");
                DEFAULT_IOR
            }
        }
    }

    fn coat(&mut self, material: &gltf::Material) -> Result<Option<Coat>, SceneError> {
        const NAME: &str = "KHR_materials_clearcoat";
        let Some(extension) = material.extension_value(NAME) else { return Ok(None) };
        let factor = self.number(material, NAME, "clearcoatFactor", 0.0, 1.0)?;
        let used = self.extension_texture(extension, "clearcoatTexture")?;
        let strength = self.scalar(factor, used, RED)?;
        if strength == NONE {
            return Ok(None);
        }
        let roughness = self.number(material, NAME, "clearcoatRoughnessFactor", 0.0, 1.0)?;
        let used = self.extension_texture(extension, "clearcoatRoughnessTexture")?;
        let alpha = self.alpha(roughness, used)?;
        if extension.get("clearcoatNormalTexture").is_some() {
            self.note("normal maps of clear coats are left out");
        }
        Ok(Some(Coat { strength, alpha }))
    }

    fn anisotropy(&mut self, material: &gltf::Material) -> Result<Anisotropy, SceneError> {
        const NAME: &str = "KHR_materials_anisotropy";
        let Some(extension) = material.extension_value(NAME) else { return Ok(Anisotropy::default()) };
        let strength = self.number(material, NAME, "anisotropyStrength", 0.0, 1.0)?;
        if strength == 0.0 {
            return Ok(Anisotropy::default());
        }
        let rotation_rad = self.number(material, NAME, "anisotropyRotation", -MAX_TURN_RAD, MAX_TURN_RAD)?;
        let used = self.extension_texture(extension, "anisotropyTexture")?;
        let texture = used.map(|used| self.texture(used, true)).transpose()?;
        Ok(Anisotropy { strength, rotation_rad, texture })
    }

    fn emission(&mut self, material: &gltf::Material) -> Result<Color, SceneError> {
        let strength = material.emissive_strength().unwrap_or(1.0);
        let emitted = Vec3::from_array(material.emissive_factor()) * strength;
        if !(emitted.min_element() >= 0.0 && emitted.max_element() <= MAX_RADIANCE) {
            return Err(self.malformed(format!("emission: expected 0 to {MAX_RADIANCE}, found {emitted}")));
        }
        self.color(emitted, material.emissive_texture().map(|info| TextureUse::of(&info)))
    }

    /// Where the alpha mode leaves holes.
    fn cutout(
        &mut self,
        material: &gltf::Material,
        factor: f32,
        base: Option<TextureUse>,
    ) -> Result<Option<Cutout>, SceneError> {
        let threshold = match material.alpha_mode() {
            AlphaMode::Opaque => return Ok(None),
            AlphaMode::Mask => Some(material.alpha_cutoff().unwrap_or(0.5).clamp(0.0, f32::MAX)),
            AlphaMode::Blend => None,
        };
        let opacity = self.scalar(factor, base, ALPHA)?;
        let is_whole = matches!(opacity, Scalar::Constant(opacity) if opacity >= threshold.unwrap_or(1.0));
        Ok((!is_whole).then_some(Cutout { opacity, threshold }))
    }

    fn color(&mut self, factor: Vec3, used: Option<TextureUse>) -> Result<Color, SceneError> {
        match used {
            Some(used) if factor != Vec3::ZERO => Ok(Color::Textured { texture: self.texture(used, false)?, factor }),
            _ => Ok(Color::Constant(factor)),
        }
    }

    /// One channel of a texture times a factor from 0 to 1.
    fn scalar(&mut self, factor: f32, used: Option<TextureUse>, channel: u8) -> Result<Scalar, SceneError> {
        self.channel(factor.clamp(0.0, 1.0), used, channel, false)
    }

    /// The alpha of a roughness whose texture is in green.
    fn alpha(&mut self, roughness: f32, used: Option<TextureUse>) -> Result<Scalar, SceneError> {
        self.channel(roughness.clamp(0.0, 1.0).powi(2), used, GREEN, true)
    }

    fn channel(
        &mut self,
        factor: f32,
        used: Option<TextureUse>,
        channel: u8,
        squared: bool,
    ) -> Result<Scalar, SceneError> {
        let Some(used) = used.filter(|_| factor != 0.0) else { return Ok(Scalar::Constant(factor)) };
        let texels = self.textures.texels(self.source, used)?;
        if let Some(value) = texels.constant(usize::from(channel)) {
            return Ok(Scalar::Constant(factor * if squared { value * value } else { value }));
        }
        // A colour's own texture has the same alpha, so that none is made for it alone.
        let texture = self.texture(used, channel != ALPHA)?;
        Ok(Scalar::Textured { texture, channel, factor, squared })
    }

    fn texture(&mut self, used: TextureUse, data: bool) -> Result<u32, SceneError> {
        if *self.uv_set.get_or_insert(used.uv_set) != used.uv_set {
            self.note("textures of one material have several sets of texture coordinates: all take the first's");
        }
        self.textures.index(self.source, &mut self.part.textures, used, data)
    }

    /// A texture that an extension names.
    fn extension_texture(&self, extension: &Value, key: &str) -> Result<Option<TextureUse>, SceneError> {
        let Some(info) = extension.get(key) else { return Ok(None) };
        let used = TextureUse::of_value(info);
        used.map(Some).ok_or_else(|| self.malformed(format!("{key}: expected an object with the index of a texture")))
    }

    /// A number of an extension, 0 where it is not there, clamped to its range.
    fn number(
        &self,
        material: &gltf::Material,
        extension: &str,
        key: &str,
        least: f32,
        most: f32,
    ) -> Result<f32, SceneError> {
        match material.extension_value(extension).and_then(|extension| extension.get(key)) {
            None => Ok(0.0),
            Some(value) => match value.as_f64() {
                Some(number) => Ok((number as f32).clamp(least, most)),
                None => Err(self.malformed(format!("{key}: expected a number, found {value}"))),
            },
        }
    }

    fn malformed(&self, reason: String) -> SceneError {
        let line = super::super::picture::one_line(&reason);
        self.source.malformed(format!("material '{}': {line}", self.name.escape_debug()))
    }

    fn note(&mut self, what: &'static str) {
        self.unsupported.note(what, &self.name);
    }
}

const NONE: Scalar = Scalar::Constant(0.0);
const ALL: Scalar = Scalar::Constant(1.0);
const RED: u8 = 0;
const GREEN: u8 = 1;
const BLUE: u8 = 2;
const ALPHA: u8 = 3;

/// Brightest radiance that is loaded, as in scene.toml.
const MAX_RADIANCE: f32 = 1e6;
/// Of KHR_materials_ior.
const DEFAULT_IOR: f32 = 1.5;
/// Stands for an infinite index where only its reflectance counts: 0.996 at normal incidence.
const MAX_IOR: f32 = 1e3;
/// The range of indices of solids and panes, as in scene.toml.
const MIN_SOLID_IOR: f32 = 1.0001;
const MAX_SOLID_IOR: f32 = 10.0;
/// An Abbe number of 5; glass has 20 and more, and the extension's models 1 at most.
const MAX_DISPERSION: f32 = 4.0;
/// Reflectance at normal incidence is capped at 1 anyway; of index 1.5 that takes 25.
const MAX_SPECULAR_COLOR: f32 = 1e3;
/// Beyond it a mapped normal lies on the horizon in any case.
const MAX_TILT: f32 = 1e3;
/// Many turns; beyond it the sine of an f32 means nothing.
const MAX_TURN_RAD: f32 = 1e3;

/// Beer-Lambert per metre: white light becomes `color` after `distance_m` (KHR_materials_volume).
fn absorption(color: Vec3, distance_m: f32) -> Vec3 {
    if !(distance_m > 0.0 && distance_m.is_finite()) {
        return Vec3::ZERO;
    }
    // A channel of 0 would be infinite: what is left of 1e-6 is black in any picture.
    let transmitted = color.clamp(Vec3::splat(1e-6), Vec3::ONE);
    (-transmitted.map(f32::ln) / distance_m).clamp(Vec3::ZERO, Vec3::splat(1e6))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absorption_gives_the_colour_back_after_its_distance() {
        let color = Vec3::new(0.1, 0.5, 0.9);
        let absorbed = absorption(color, 0.25);
        assert!(((-absorbed * 0.25).map(f32::exp) - color).length() < 1e-6);
        assert_eq!(absorption(color, f32::INFINITY), Vec3::ZERO);
        assert_eq!(absorption(Vec3::ONE, 1.0), Vec3::ZERO);
        assert!(absorption(Vec3::ZERO, 1e-9).is_finite());
    }
}
