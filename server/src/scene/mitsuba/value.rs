//! Parameters that are colours, numbers or textures.

use super::super::picture::{Encoding, decode, texels};
use super::super::texture::{ImageTexture, TexelFilter, Wrap};
use super::super::untrusted::{MAX_FILE_BYTES, MAX_IMAGE_BYTES, MAX_ITEMS, check_limit, read_file};
use super::super::{Color, Scalar, SceneError, Texture, TextureKind, Transfer};
use super::node::{Node, Plugin};
use super::spectrum::{Role, color_of_black_body, color_of_constant, color_of_samples};
use super::transform::read_uv;
use super::{Loader, ior};
use glam::{Affine2, Vec3};
use std::sync::Arc;

/// A colour, or a texture's element.
pub(super) enum Value<'a> {
    Constant(Vec3),
    Texture(&'a Node),
}

impl<'a> Loader<'a> {
    /// What a parameter holds; `None` where it is not there.
    pub(super) fn value(&self, plugin: &Plugin<'a>, name: &str, role: Role) -> Result<Option<Value<'a>>, SceneError> {
        let Some(child) = plugin.child(name) else { return Ok(None) };
        let node = self.resolve(child)?;
        let color = match node.tag {
            "texture" => return Ok(Some(Value::Texture(node))),
            "float" | "integer" => Vec3::splat(node.number(node.required("value")?)? as f32),
            "rgb" => rgb(node)?,
            "spectrum" => self.spectrum(node, role)?,
            other => {
                return Err(
                    child.error("<rgb>, <spectrum>, <float>, <texture> or a <ref> to one", format_args!("<{other}>"))
                );
            }
        };
        let most = if role == Role::Reflectance { 1.0 } else { MAX_VALUE };
        if color.cmpge(Vec3::ZERO).all() && color.cmple(Vec3::splat(most)).all() {
            return Ok(Some(Value::Constant(color)));
        }
        Err(child.error(format_args!("values from 0 to {most}"), color))
    }

    /// A colour; a texture that is not supported counts as one half.
    pub(super) fn color(
        &mut self,
        plugin: &Plugin<'a>,
        name: &str,
        default: f32,
        role: Role,
    ) -> Result<Color, SceneError> {
        Ok(match self.value(plugin, name, role)? {
            None => Color::Constant(Vec3::splat(default)),
            Some(Value::Constant(color)) => Color::Constant(color),
            Some(Value::Texture(node)) => match self.texture(node, None)? {
                Some(texture) => Color::Textured { texture, factor: Vec3::ONE },
                None => Color::Constant(Vec3::splat(0.5)),
            },
        })
    }

    /// A colour that is the same everywhere.
    pub(super) fn constant(&mut self, plugin: &Plugin<'a>, name: &str, role: Role) -> Result<Option<Vec3>, SceneError> {
        match self.value(plugin, name, role)? {
            None => Ok(None),
            Some(Value::Constant(color)) => Ok(Some(color)),
            Some(Value::Texture(node)) => {
                let what = format!("a texture of '{name}' is left out: one half stands for it");
                self.note(what, &node.label());
                Ok(Some(Vec3::splat(0.5)))
            }
        }
    }

    /// A number from 0 to `most`, or a texture of them.
    pub(super) fn scalar(
        &mut self,
        plugin: &Plugin<'a>,
        name: &str,
        default: f32,
        most: f32,
    ) -> Result<Scalar, SceneError> {
        Ok(match self.value(plugin, name, Role::Factor)? {
            None => Scalar::Constant(default),
            Some(Value::Constant(color)) if color.max_element() <= most => Scalar::Constant(color.x),
            Some(Value::Constant(color)) => {
                return Err(plugin.node.error(format_args!("{name} from 0 to {most}"), color.max_element()));
            }
            Some(Value::Texture(node)) => match self.texture(node, None)? {
                Some(texture) => Scalar::Textured { texture, channel: 0, factor: 1.0, squared: false },
                None => Scalar::Constant(default),
            },
        })
    }

    /// An index of refraction: a number, or the name of a material.
    pub(super) fn index(&self, plugin: &Plugin<'a>, name: &str, default: &str) -> Result<f64, SceneError> {
        match plugin.child(name) {
            Some(child) if child.tag == "string" => {
                let text = child.required("value")?;
                ior::index_of(text)
                    .ok_or_else(|| child.value_error(format_args!("a number or one of {}", ior::names()), text))
            }
            Some(_) => plugin.float(name, 1.0, 0.1..=10.0),
            None => Ok(ior::index_of(default).unwrap_or(1.0)),
        }
    }

    /// The index of a texture; `None` where its kind is not supported, which is noted. `raw` overrides what the
    /// texture says about its encoding.
    pub(super) fn texture(&mut self, node: &'a Node, raw: Option<bool>) -> Result<Option<u32>, SceneError> {
        let key = (std::ptr::from_ref(node), raw);
        if let Some(&known) = self.textures.get(&key) {
            return Ok(known);
        }
        let plugin = Plugin::new(node);
        let kind = match node.kind() {
            "bitmap" => Some(self.bitmap(&plugin, raw)?),
            "checkerboard" => {
                let mut color = |name: &str, default: f32| {
                    let color = self.constant(&plugin, name, Role::Reflectance)?;
                    Ok::<_, SceneError>(color.unwrap_or(Vec3::splat(default)).to_array())
                };
                Some(TextureKind::Checker { a: color("color0", 0.4)?, b: color("color1", 0.2)?, squares: [2.0, 2.0] })
            }
            "mesh_attribute" | "volume" => {
                self.note(format!("textures of kind '{}' are left out", node.kind()), &node.label());
                None
            }
            other => return Err(node.value_error("a texture of type bitmap or checkerboard", other)),
        };
        let texture_from_surface = match plugin.transform("to_uv")? {
            Some(transform) => read_uv(transform)?,
            None => Affine2::IDENTITY,
        };
        if kind.is_some() {
            self.note_unused(&plugin);
        }
        let index = match kind {
            None => None,
            Some(kind) => {
                let count = self.part.textures.len() as u64;
                check_limit(&node.place.file.name, "textures", MAX_ITEMS, count + 1)?;
                self.part.textures.push(Texture { kind, texture_from_surface });
                Some(count as u32)
            }
        };
        self.textures.insert(key, index);
        Ok(index)
    }

    /// An image. As in Mitsuba its first row is where v is 0, which is how v runs here, too.
    fn bitmap(&mut self, plugin: &Plugin<'a>, raw: Option<bool>) -> Result<TextureKind, SceneError> {
        let path = self.file(plugin)?;
        let texels = texels(&path.display().to_string(), &read_file(&path, MAX_FILE_BYTES)?)?;
        self.count(plugin, texels.bytes())?;
        let mut image = ImageTexture::new(Arc::new(texels));
        if raw.unwrap_or(plugin.boolean("raw", false)?) {
            image.transfer = Transfer::Linear;
        }
        image.filter = match plugin.string("filter_type")?.unwrap_or("bilinear") {
            "bilinear" => TexelFilter::Linear,
            "nearest" => TexelFilter::Nearest,
            other => return Err(plugin.node.error("filter_type bilinear or nearest", other)),
        };
        let wrap = match plugin.string("wrap_mode")?.unwrap_or("repeat") {
            "repeat" => Wrap::Repeat,
            "mirror" => Wrap::Mirror,
            "clamp" => Wrap::Clamp,
            other => return Err(plugin.node.error("wrap_mode repeat, mirror or clamp", other)),
        };
        image.wrap = [wrap; 2];
        plugin.without_effect(&["format", "accel"]);
        Ok(TextureKind::Image(image))
    }

    /// Counts what an image holds.
    pub(super) fn count(&mut self, plugin: &Plugin<'a>, bytes: u64) -> Result<(), SceneError> {
        self.image_bytes += bytes;
        check_limit(&plugin.node.place.file.name, "bytes of images", MAX_IMAGE_BYTES, self.image_bytes)
    }

    /// The image that the parameter `filename` names.
    pub(super) fn picture(
        &mut self,
        plugin: &Plugin<'a>,
        encoding: Encoding,
    ) -> Result<(u32, u32, Vec<[f32; 3]>), SceneError> {
        let path = self.file(plugin)?;
        let picture = decode(&path.display().to_string(), &read_file(&path, MAX_FILE_BYTES)?, encoding)?;
        self.count(plugin, size_of_val(picture.texels.as_slice()) as u64)?;
        Ok((picture.width, picture.height, picture.texels))
    }

    /// The path that the parameter `filename` names.
    pub(super) fn file(&self, plugin: &Plugin<'a>) -> Result<std::path::PathBuf, SceneError> {
        let name = plugin.string("filename")?.ok_or_else(|| plugin.node.error("the parameter 'filename'", "none"))?;
        Ok(self.tree.find(&plugin.node.place, name))
    }

    fn spectrum(&self, node: &'a Node, role: Role) -> Result<Vec3, SceneError> {
        if let Some(text) = node.attribute("value") {
            if text.contains(':') {
                let pairs = text.split([',', ' ', '\t', '\r', '\n']).filter(|word| !word.is_empty()).map(|word| {
                    let expected = || node.value_error("pairs of wavelength and value such as 400:0.5, 700:0.8", word);
                    let (wavelength, value) = word.split_once(':').ok_or_else(expected)?;
                    Ok((node.number(wavelength)?, node.number(value)?))
                });
                return self.samples(node, pairs.collect::<Result<_, SceneError>>()?, role);
            }
            return Ok(color_of_constant(node.number(text)?, role));
        }
        let plugin = Plugin::new(node);
        let scale = plugin.float("scale", 1.0, 0.0..=1e9)?;
        match node.kind() {
            "d65" => {
                let color = match plugin.child("color") {
                    Some(color) => rgb(color)?,
                    None => Vec3::ONE,
                };
                Ok(color * scale as f32)
            }
            "uniform" => Ok(color_of_constant(plugin.float("value", 1.0, 0.0..=1e9)?, role)),
            "blackbody" => Ok(color_of_black_body(plugin.float("temperature", 5000.0, 100.0..=1e6)?) * scale as f32),
            "srgb" => plugin.child("color").map_or(Err(node.error("the parameter 'color'", "none")), rgb),
            "irregular" => {
                let list = |name: &str| match plugin.string(name)? {
                    Some(text) => node.numbers(text),
                    None => Err(node.error(format_args!("the parameter '{name}'"), "none")),
                };
                let (wavelengths, values) = (list("wavelengths")?, list("values")?);
                if wavelengths.len() != values.len() {
                    return Err(node.error("as many wavelengths as values", "another number"));
                }
                self.samples(node, wavelengths.into_iter().zip(values).collect(), role)
            }
            "regular" => {
                let values = node.numbers(plugin.string("values")?.unwrap_or_default())?;
                let (first, last) = (
                    plugin.float("wavelength_min", 360.0, 1.0..=1e6)?,
                    plugin.float("wavelength_max", 830.0, 1.0..=1e6)?,
                );
                let step = (last - first) / (values.len().max(2) - 1) as f64;
                let samples = values.iter().enumerate().map(|(at, &value)| (first + step * at as f64, value));
                self.samples(node, samples.collect(), role)
            }
            other => Err(node.value_error(
                "a value, or the type d65, uniform, blackbody, srgb, regular or irregular",
                node.attribute("filename").unwrap_or(other),
            )),
        }
    }

    fn samples(&self, node: &Node, samples: Vec<(f64, f64)>, role: Role) -> Result<Vec3, SceneError> {
        let is_ascending = samples.windows(2).all(|pair| pair[0].0 < pair[1].0);
        if samples.len() < 2 || !is_ascending {
            return Err(
                node.error("two or more samples of ascending wavelength", format_args!("{} samples", samples.len()))
            );
        }
        Ok(color_of_samples(&samples, role))
    }
}

/// Largest value of what is no reflectance.
pub(super) const MAX_VALUE: f32 = 1e9;

/// A colour: three numbers or one, linear; or #rrggbb, sRGB.
fn rgb(node: &Node) -> Result<Vec3, SceneError> {
    let text = node.required("value")?;
    if let Some(hex) = text.trim().strip_prefix('#') {
        let is_hex = hex.len() == 6 && hex.bytes().all(|byte| byte.is_ascii_hexdigit());
        let channel = |at: usize| hex.get(at..at + 2).and_then(|pair| u8::from_str_radix(pair, 16).ok());
        let channels = (channel(0), channel(2), channel(4));
        return match channels {
            (Some(red), Some(green), Some(blue)) if is_hex => Ok(Vec3::from_array(
                [red, green, blue].map(|value| super::super::texels::linear_from_srgb(f32::from(value) / 255.0)),
            )),
            _ => Err(node.value_error("#rrggbb", text)),
        };
    }
    match node.numbers(text)?[..] {
        [grey] => Ok(Vec3::splat(grey as f32)),
        [red, green, blue] => Ok(Vec3::new(red as f32, green as f32, blue as f32)),
        _ => Err(node.value_error("one or three numbers, or #rrggbb", text)),
    }
}
