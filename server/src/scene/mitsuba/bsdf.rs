//! Mitsuba's BSDFs as materials.
//!
//! Opaque ones are black from behind unless within `twosided`. Rough ones are not compensated for light that meets
//! several facets, as Mitsuba's are not; their distribution is Beckmann's where none is named. Plastics and the
//! principled BSDF become the nearest mix of layers, with a warning.

use super::super::metals::metal;
use super::super::{
    Coat, Color, Cutout, Distribution, Finish, Material, NormalMap, Scalar, SceneError, Standard, Surface,
};
use super::Loader;
use super::node::{Node, Plugin};
use super::spectrum::Role;
use glam::{Vec2, Vec3};

/// Deepest nesting of BSDFs in each other.
const MAX_NESTED: usize = 16;

/// BSDFs of Mitsuba that have no counterpart here.
const LEFT_OUT: [&str; 10] = [
    "blendbsdf",
    "measured",
    "measured_polarized",
    "hair",
    "pplastic",
    "polarizer",
    "retarder",
    "circular",
    "acousticbsdf",
    "principledthin",
];

impl<'a> Loader<'a> {
    /// The material of a BSDF.
    pub(super) fn material(&mut self, node: &'a Node) -> Result<Material, SceneError> {
        if let Some(known) = self.materials.get(&std::ptr::from_ref(node)) {
            return Ok(known.clone());
        }
        let material = self.bsdf(node, 0)?;
        self.materials.insert(std::ptr::from_ref(node), material.clone());
        Ok(material)
    }

    fn bsdf(&mut self, node: &'a Node, depth: usize) -> Result<Material, SceneError> {
        if depth > MAX_NESTED {
            return Err(node.error(format_args!("at most {MAX_NESTED} BSDFs in each other"), "more, or a cycle"));
        }
        let plugin = Plugin::new(node);
        let label = node.label();
        let opaque = |surface: Surface| Material { one_sided: true, ..Material::new(label.clone(), surface) };
        let material = match node.kind() {
            "diffuse" => {
                opaque(Surface::Diffuse { albedo: self.color(&plugin, "reflectance", 0.5, Role::Reflectance)? })
            }
            "conductor" => {
                let surface = self.conductor(&plugin, Finish::SMOOTH)?;
                opaque(surface)
            }
            "roughconductor" => {
                let finish = self.finish(&plugin)?;
                opaque(self.conductor(&plugin, finish)?)
            }
            "dielectric" | "roughdielectric" | "thindielectric" => {
                let is_rough = node.kind() == "roughdielectric";
                let finish = if is_rough { self.finish(&plugin)? } else { Finish::SMOOTH };
                let surface = self.dielectric(&plugin, finish)?;
                Material::new(label.clone(), surface)
            }
            "plastic" | "roughplastic" => {
                let finish = if node.kind() == "plastic" { Finish::SMOOTH } else { self.finish(&plugin)? };
                opaque(self.plastic(&plugin, finish)?)
            }
            "principled" => {
                let standard = self.principled(&plugin)?;
                let is_opaque = standard.transmission == Scalar::Constant(0.0);
                Material { one_sided: is_opaque, ..opaque(Surface::Standard(standard)) }
            }
            "null" => Material::new(label.clone(), Surface::Null),
            "twosided" => {
                let nested = self.nested(&plugin)?;
                if nested.len() > 1 {
                    self.note("surfaces of two BSDFs have the first on both sides", &label);
                }
                let first = nested.first().ok_or_else(|| node.error("a <bsdf> within", "none"))?;
                Material { one_sided: false, ..self.bsdf(first, depth + 1)? }
            }
            "mask" => {
                let nested = self.only_nested(&plugin)?;
                let opacity = self.scalar(&plugin, "opacity", 0.5, 1.0)?;
                Material { cutout: Some(Cutout { opacity, threshold: None }), ..self.bsdf(nested, depth + 1)? }
            }
            "bumpmap" => {
                self.note("bump maps are left out", &label);
                // Its texture may have any name.
                plugin.children(|child| child.tag == "texture" || child.name() == "scale");
                let nested = self.only_nested(&plugin)?;
                self.bsdf(nested, depth + 1)?
            }
            "normalmap" => {
                let nested = self.only_nested(&plugin)?;
                let normal_map = self.normal_map(&plugin)?;
                Material { normal_map, ..self.bsdf(nested, depth + 1)? }
            }
            other if LEFT_OUT.contains(&other) => {
                let nested = self.nested(&plugin)?;
                if let Some(first) = nested.first() {
                    self.note(
                        format!("BSDFs of type '{other}' are left out: their first part stands for them"),
                        &label,
                    );
                    return self.bsdf(first, depth + 1);
                }
                self.note(format!("BSDFs of type '{other}' are left out: diffuse reflection stands for them"), &label);
                return Ok(opaque(Surface::Diffuse { albedo: Color::Constant(Vec3::splat(0.5)) }));
            }
            other => {
                let expected = "a type such as diffuse, conductor, roughconductor, dielectric, roughdielectric, \
                                thindielectric, plastic, roughplastic, principled, null, twosided, mask, bumpmap or normalmap";
                return Err(node.value_error(expected, other));
            }
        };
        self.note_unused(&plugin);
        Ok(Material { name: label, ..material })
    }

    fn nested(&self, plugin: &Plugin<'a>) -> Result<Vec<&'a Node>, SceneError> {
        let mut nested = Vec::new();
        for child in plugin.children(|child| child.tag == "bsdf" || child.tag == "ref") {
            let node = self.resolve(child)?;
            if node.tag == "bsdf" {
                nested.push(node);
            }
        }
        Ok(nested)
    }

    fn only_nested(&self, plugin: &Plugin<'a>) -> Result<&'a Node, SceneError> {
        self.nested(plugin)?.first().copied().ok_or_else(|| plugin.node.error("a <bsdf> within", "none"))
    }

    /// Roughness: `distribution`, and `alpha` or `alpha_u` and `alpha_v`.
    fn finish(&mut self, plugin: &Plugin<'a>) -> Result<Finish, SceneError> {
        let distribution = match plugin.string("distribution")?.unwrap_or("beckmann") {
            "beckmann" => Distribution::Beckmann,
            "ggx" => Distribution::Ggx,
            other => return Err(plugin.node.value_error("the distribution beckmann or ggx", other)),
        };
        plugin.without_effect(&["sample_visible"]);
        let finish = if plugin.has("alpha_u") || plugin.has("alpha_v") {
            let along = |scalar: Scalar| if let Scalar::Constant(alpha) = scalar { Some(alpha) } else { None };
            let (u, v) = (self.scalar(plugin, "alpha_u", 0.1, 1.0)?, self.scalar(plugin, "alpha_v", 0.1, 1.0)?);
            match (along(u), along(v)) {
                (Some(u), Some(v)) => Finish::along_axes(distribution, u, v),
                _ => {
                    self.note(
                        "textures of alpha_u and alpha_v: the first counts in all directions",
                        &plugin.node.label(),
                    );
                    Finish::isotropic(distribution, u)
                }
            }
        } else {
            Finish::isotropic(distribution, self.scalar(plugin, "alpha", 0.1, 1.0)?)
        };
        Ok(Finish { compensated: false, ..finish })
    }

    fn conductor(&mut self, plugin: &Plugin<'a>, finish: Finish) -> Result<Surface, SceneError> {
        let filter = self.color(plugin, "specular_reflectance", 1.0, Role::Reflectance)?;
        if plugin.has("eta") || plugin.has("k") {
            let outside = self.index(plugin, "ext_eta", "vacuum")? as f32;
            let eta = self.constant(plugin, "eta", Role::Factor)?.unwrap_or(Vec3::ZERO) / outside;
            let k = self.constant(plugin, "k", Role::Factor)?.unwrap_or(Vec3::ONE) / outside;
            return Ok(Surface::Conductor { eta, k, filter, finish });
        }
        let name = plugin.string("material")?.unwrap_or("none");
        let ours = match name {
            "none" => {
                // An index of i reflects everything at all angles.
                let (eta, k) = (Vec3::ZERO, Vec3::ONE);
                return Ok(match filter {
                    Color::Constant(filter) if finish.is_smooth() => Surface::Mirror { filter },
                    _ => Surface::Conductor { eta, k, filter, finish },
                });
            }
            "Ag" => "silver",
            "Al" => "aluminium",
            "Au" => "gold",
            "Cr" => "chromium",
            "Cu" | "Cu_palik" => "copper",
            "W" => "tungsten",
            other if OTHER_METALS.contains(&other) => {
                self.note(
                    format!("the indices of '{other}' are not known: chromium stands for it"),
                    &plugin.node.label(),
                );
                "chromium"
            }
            other => {
                let expected = "eta and k, or a material such as none, Ag, Al, Au, Cr, Cu or W";
                return Err(plugin.node.value_error(expected, other));
            }
        };
        let (eta, k) = metal(ours).unwrap_or((Vec3::ZERO, Vec3::ONE));
        Ok(Surface::Conductor { eta, k, filter, finish })
    }

    fn dielectric(&mut self, plugin: &Plugin<'a>, finish: Finish) -> Result<Surface, SceneError> {
        let ior = (self.index(plugin, "int_ior", "bk7")? / self.index(plugin, "ext_ior", "air")?) as f32;
        if self.color(plugin, "specular_reflectance", 1.0, Role::Reflectance)? != Color::Constant(Vec3::ONE) {
            self.note("specular_reflectance of dielectrics is left out", &plugin.node.label());
        }
        let filter = self.color(plugin, "specular_transmittance", 1.0, Role::Reflectance)?;
        Ok(match plugin.node.kind() {
            "thindielectric" => Surface::ThinDielectric { ior, filter, finish },
            _ => Surface::Dielectric { ior, dispersion: 0.0, filter, absorption: Vec3::ZERO, finish },
        })
    }

    fn plastic(&mut self, plugin: &Plugin<'a>, finish: Finish) -> Result<Surface, SceneError> {
        self.note("plastics become a reflecting layer over Lambert reflection", &plugin.node.label());
        plugin.without_effect(&["nonlinear"]);
        let ior = (self.index(plugin, "int_ior", "polypropylene")? / self.index(plugin, "ext_ior", "air")?) as f32;
        Ok(Surface::Standard(Standard {
            base: self.color(plugin, "diffuse_reflectance", 0.5, Role::Reflectance)?,
            metallic: Scalar::Constant(0.0),
            finish,
            ior: ior.max(1.0),
            specular: Scalar::Constant(1.0),
            specular_color: self.color(plugin, "specular_reflectance", 1.0, Role::Reflectance)?,
            transmission: Scalar::Constant(0.0),
            coat: None,
        }))
    }

    fn principled(&mut self, plugin: &Plugin<'a>) -> Result<Standard, SceneError> {
        self.note("principled BSDFs become a mix of metal, coloured plastic and a clear coat", &plugin.node.label());
        let base = self.color(plugin, "base_color", 0.5, Role::Reflectance)?;
        let alpha = match self.scalar(plugin, "roughness", 0.5, 1.0)? {
            Scalar::Constant(roughness) => Scalar::Constant(roughness * roughness),
            textured => {
                self.note("textures of roughness count as alpha", &plugin.node.label());
                textured
            }
        };
        let ior = if plugin.has("eta") {
            plugin.float("eta", 1.5, 1.0..=10.0)?
        } else {
            // (eta - 1)^2 / (eta + 1)^2 = 0.08 specular.
            let root = (0.08 * plugin.float("specular", 0.5, 0.0..=1.0)?).sqrt();
            (1.0 + root) / (1.0 - root)
        };
        let (coat, gloss) =
            (self.scalar(plugin, "clearcoat", 0.0, 1.0)?, plugin.float("clearcoat_gloss", 0.0, 0.0..=1.0)?);
        let coat = (coat != Scalar::Constant(0.0)).then(|| {
            // Disney's coat is a quarter of a full one, with alpha from 0.1 to 0.001.
            let strength = match coat {
                Scalar::Constant(strength) => Scalar::Constant(0.25 * strength),
                Scalar::Textured { texture, channel, factor, squared } => {
                    Scalar::Textured { texture, channel, factor: 0.25 * factor, squared }
                }
            };
            Coat { strength, alpha: Scalar::Constant((0.1 + (0.001 - 0.1) * gloss) as f32) }
        });
        Ok(Standard {
            base,
            metallic: self.scalar(plugin, "metallic", 0.0, 1.0)?,
            finish: Finish { compensated: false, ..Finish::isotropic(Distribution::Ggx, alpha) },
            ior: ior as f32,
            specular: Scalar::Constant(1.0),
            specular_color: Color::Constant(Vec3::ONE),
            transmission: self.scalar(plugin, "spec_trans", 0.0, 1.0)?,
            coat,
        })
    }

    /// Mitsuba's green runs with v, downwards here; ours is glTF's, upwards: it is turned over.
    fn normal_map(&mut self, plugin: &Plugin<'a>) -> Result<Option<NormalMap>, SceneError> {
        let Some(child) = plugin.child("normalmap").or_else(|| plugin.children(|child| child.tag == "texture").pop())
        else {
            return Err(plugin.node.error("a <texture> named normalmap", "none"));
        };
        let node = self.resolve(child)?;
        let Some(texture) = self.texture(node, Some(true))? else { return Ok(None) };
        Ok(Some(NormalMap { texture, scale: Vec2::new(1.0, -1.0) }))
    }
}

/// Other names in Mitsuba's table of indices.
const OTHER_METALS: [&str; 34] = [
    "a-C",
    "AlAs",
    "AlAs_palik",
    "AlSb",
    "AlSb_palik",
    "Be",
    "Be_palik",
    "CsI",
    "CsI_palik",
    "Cu2O",
    "Cu2O_palik",
    "CuO",
    "CuO_palik",
    "d-C",
    "d-C_palik",
    "Hg",
    "Hg_palik",
    "HgTe",
    "HgTe_palik",
    "Ir",
    "Ir_palik",
    "K",
    "K_palik",
    "Li",
    "Li_palik",
    "MgO",
    "Mo",
    "Na_palik",
    "Nb",
    "Ni_palik",
    "Rh",
    "Se",
    "SiC",
    "TiN",
];
