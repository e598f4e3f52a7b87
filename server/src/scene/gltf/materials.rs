//! glTF materials to the surfaces there are.
//!
//! Metallic-roughness materials (specification, 3.9) are reduced: transmission becomes a smooth dielectric,
//! a smooth metal a mirror of the base colour, everything else Lambert reflection of the base colour. What
//! this leaves out is noted, each feature once.

use super::super::picture::{Encoding, Picture, decode};
use super::super::untrusted::{MAX_TEXELS, check_limit};
use super::super::{Color, Material, Part, SceneError, Surface, Texture, TextureKind};
use super::Source;
use super::container::read_uri;
use super::unsupported::Unsupported;
use glam::Vec3;
use gltf::material::AlphaMode;
use gltf::texture::{Info, WrappingMode};
use std::collections::HashMap;

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
    let mut reader =
        Reader { source, part, unsupported, pictures: HashMap::new(), textures: HashMap::new(), texels: 0 };
    let mut uv_sets = Vec::new();
    for (index, material) in source.document.materials().enumerate() {
        uv_sets.push(reader.material(index, &material)?);
    }
    part.materials.push(Material {
        name: "default".to_owned(),
        surface: Surface::Diffuse { albedo: Color::Constant(Vec3::ONE) },
        emission: Color::Constant(Vec3::ZERO),
        emission_two_sided: false,
    });
    Ok(UvSets(uv_sets))
}

/// From here on a metal counts as one.
const METALLIC: f32 = 0.5;
/// Up to here a surface counts as smooth: the lobe is then narrower than about 2 degrees.
const SMOOTH: f32 = 0.1;
/// Transmission above this makes a surface clear.
const CLEAR: f32 = 0.5;

/// Extensions that change how a surface looks and are left out.
const LEFT_OUT: [(&str, &str); 8] = [
    ("KHR_materials_clearcoat", "clear coats are left out"),
    ("KHR_materials_sheen", "sheen is left out"),
    ("KHR_materials_anisotropy", "anisotropy is left out"),
    ("KHR_materials_iridescence", "iridescence is left out"),
    ("KHR_materials_dispersion", "dispersion is left out"),
    ("KHR_materials_diffuse_transmission", "diffuse transmission is left out"),
    ("KHR_materials_unlit", "unlit materials are lit"),
    ("KHR_materials_pbrSpecularGlossiness", "specular-glossiness is left out: the base colour is used"),
];

struct Reader<'a> {
    source: &'a Source,
    part: &'a mut Part,
    unsupported: &'a mut Unsupported,
    /// Mean of the data textures (roughness in green, metalness in blue) by image.
    pictures: HashMap<usize, Vec3>,
    /// Index of the scene's texture by image.
    textures: HashMap<usize, u32>,
    texels: u64,
}

impl Reader<'_> {
    /// Reads one material and returns the set of texture coordinates that it uses.
    fn material(&mut self, index: usize, material: &gltf::Material) -> Result<u32, SceneError> {
        let name = material.name().map_or_else(|| format!("material {index}"), str::to_owned);
        self.note_left_out(material, &name);
        let pbr = material.pbr_metallic_roughness();
        let [red, green, blue, _] = pbr.base_color_factor();
        let base_factor = Vec3::new(red, green, blue).clamp(Vec3::ZERO, Vec3::ONE);
        let (mut metallic, mut roughness) = (pbr.metallic_factor(), pbr.roughness_factor());
        if let Some(info) = pbr.metallic_roughness_texture() {
            let mean = self.mean(&info)?;
            metallic *= mean.z;
            roughness *= mean.y;
            self.unsupported.note("textures of roughness and metalness are averaged", &name);
        }

        let transmission = material.transmission();
        let transmitted = transmission.as_ref().map_or(0.0, |transmission| transmission.transmission_factor());
        if transmission.is_some_and(|transmission| transmission.transmission_texture().is_some()) {
            self.unsupported.note("textures of transmission are left out", &name);
        }
        let base_texture = pbr.base_color_texture();
        let surface = if transmitted > CLEAR && metallic < METALLIC {
            if roughness > SMOOTH {
                self.unsupported.note("rough transmission is drawn smooth", &name);
            }
            self.note_texture_of_specular(base_texture.as_ref(), &name);
            self.dielectric(material, base_factor, &name)
        } else if metallic >= METALLIC && roughness < SMOOTH {
            self.note_texture_of_specular(base_texture.as_ref(), &name);
            Surface::Mirror { filter: base_factor }
        } else {
            if transmitted > 0.0 {
                self.unsupported.note("transmission is left out where it is weak or the base is metal", &name);
            }
            if metallic >= METALLIC {
                self.unsupported.note("rough metal is drawn as a diffuse surface", &name);
            } else if material.specular().is_none_or(|specular| specular.specular_factor() > 0.0) {
                self.unsupported.note("the dielectric coat over the base colour is left out", &name);
            }
            Surface::Diffuse { albedo: self.color(base_factor, base_texture.as_ref(), &name)? }
        };

        let strength = material.emissive_strength().unwrap_or(1.0);
        let emitted = Vec3::from_array(material.emissive_factor()) * strength;
        if !(emitted.min_element() >= 0.0 && emitted.max_element() <= MAX_RADIANCE) {
            let reason =
                format!("material '{}': emission: expected 0 to {MAX_RADIANCE}, found {emitted}", name.escape_debug());
            return Err(self.source.malformed(reason));
        }
        let emissive_texture = material.emissive_texture();
        let emission = match emitted == Vec3::ZERO {
            true => Color::Constant(Vec3::ZERO),
            false => self.color(emitted, emissive_texture.as_ref(), &name)?,
        };
        let uv_set =
            [base_texture, emissive_texture].into_iter().flatten().map(|info| info.tex_coord()).next().unwrap_or(0);
        self.part.materials.push(Material { name, surface, emission, emission_two_sided: material.double_sided() });
        Ok(uv_set)
    }

    fn dielectric(&mut self, material: &gltf::Material, filter: Vec3, name: &str) -> Surface {
        let ior = material.ior().unwrap_or(1.5);
        // 0 stands for an infinite index (KHR_materials_ior); an index below 1 is none.
        let ior = if (1.0..=MAX_IOR).contains(&ior) { ior } else { MAX_IOR };
        let volume = material.volume();
        if volume.as_ref().is_none_or(|volume| volume.thickness_factor() == 0.0) {
            self.unsupported.note("thin-walled transmission is drawn as a solid", name);
        }
        let absorption = volume.map_or(Vec3::ZERO, |volume| {
            absorption(Vec3::from_array(volume.attenuation_color()), volume.attenuation_distance())
        });
        Surface::Dielectric { ior, filter, absorption }
    }

    fn note_texture_of_specular(&mut self, info: Option<&Info>, name: &str) {
        if info.is_some() {
            self.unsupported.note("base colour textures of mirrors and glass are left out", name);
        }
    }

    fn note_left_out(&mut self, material: &gltf::Material, name: &str) {
        for (extension, what) in LEFT_OUT {
            if material.extension_value(extension).is_some() {
                self.unsupported.note(what, name);
            }
        }
        if material.normal_texture().is_some() {
            self.unsupported.note("normal maps are left out", name);
        }
        if material.alpha_mode() != AlphaMode::Opaque {
            self.unsupported.note("alpha is left out: surfaces are opaque", name);
        }
    }

    fn color(&mut self, factor: Vec3, info: Option<&Info>, name: &str) -> Result<Color, SceneError> {
        let Some(info) = info else { return Ok(Color::Constant(factor)) };
        if info.extension_value("KHR_texture_transform").is_some() {
            self.unsupported.note("texture transforms are left out", name);
        }
        let sampler = info.texture().sampler();
        if sampler.wrap_s() == WrappingMode::MirroredRepeat || sampler.wrap_t() == WrappingMode::MirroredRepeat {
            self.unsupported.note("mirrored textures repeat instead", name);
        }
        let image = info.texture().source();
        let texture = match self.textures.get(&image.index()) {
            Some(&texture) => texture,
            None => {
                let Picture { width, height, texels } = self.picture(&image, Encoding::ByFormat)?;
                let texture = self.part.textures.len() as u32;
                self.part.textures.push(Texture { kind: TextureKind::Image { width, height, texels } });
                self.textures.insert(image.index(), texture);
                texture
            }
        };
        Ok(Color::Textured { texture, factor })
    }

    /// The mean of a data texture.
    fn mean(&mut self, info: &Info) -> Result<Vec3, SceneError> {
        let image = info.texture().source();
        if let Some(&mean) = self.pictures.get(&image.index()) {
            return Ok(mean);
        }
        let picture = self.picture(&image, Encoding::Linear)?;
        let sum = picture.texels.iter().fold(glam::DVec3::ZERO, |sum, &texel| sum + Vec3::from_array(texel).as_dvec3());
        let mean = (sum / picture.texels.len() as f64).as_vec3();
        self.pictures.insert(image.index(), mean);
        Ok(mean)
    }

    fn picture(&mut self, image: &gltf::Image, encoding: Encoding) -> Result<Picture, SceneError> {
        let source = self.source;
        let name = format!("{}: image {}", source.file, image.index());
        let picture = match image.source() {
            gltf::image::Source::View { view, .. } => decode(&name, source.view(&view)?, encoding)?,
            gltf::image::Source::Uri { uri, .. } => {
                decode(&name, &read_uri(&source.file, &source.folder, uri)?, encoding)?
            }
        };
        self.texels += picture.texels.len() as u64;
        check_limit(&source.file, "texels", MAX_TEXELS, self.texels)?;
        Ok(picture)
    }
}

/// Brightest radiance that is loaded, as in scene.toml.
const MAX_RADIANCE: f32 = 1e6;
/// Stands for an infinite index of refraction.
const MAX_IOR: f32 = 10.0;

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
