//! Textures that materials name: images are read once and shared, however many samplers and transforms look
//! at them.
//!
//! Wrap modes and the magnification filter come from the sampler (specification, 3.8.4); minification filters
//! are about mipmaps, which a path tracer's many samples do without. A transform (KHR_texture_transform) is
//! part of the texture. A channel that is the same everywhere becomes a constant, so that what it decides (is
//! it metal? is it clear?) is known before rendering.

use super::super::picture::texels;
use super::super::texels::{Texels, Transfer};
use super::super::texture::{ImageTexture, TexelFilter, Wrap};
use super::super::untrusted::{MAX_IMAGE_BYTES, check_limit};
use super::super::{SceneError, Texture, TextureKind};
use super::Source;
use super::container::read_uri;
use glam::{Affine2, Mat2, Vec2};
use gltf::texture::{MagFilter, WrappingMode};
use serde_json::Value;
use std::collections::HashMap;
use std::sync::Arc;

/// What a material says about one of its textures.
#[derive(Clone, Copy, Debug)]
pub(super) struct TextureUse {
    /// Index in the file's textures, not checked.
    pub(super) texture: usize,
    /// Set of texture coordinates.
    pub(super) uv_set: u32,
    pub(super) texture_from_surface: Affine2,
}

impl TextureUse {
    pub(super) fn new(texture: usize, uv_set: u32, transform: Option<&Value>) -> TextureUse {
        let uv_override = transform.and_then(|transform| transform.get("texCoord")?.as_u64());
        TextureUse {
            texture,
            uv_set: uv_override.and_then(|set| u32::try_from(set).ok()).unwrap_or(uv_set),
            texture_from_surface: transform.map_or(Affine2::IDENTITY, texture_from_surface),
        }
    }

    pub(super) fn of(info: &gltf::texture::Info) -> TextureUse {
        TextureUse::new(info.texture().index(), info.tex_coord(), info.extension_value(TRANSFORM))
    }

    pub(super) fn of_normals(normals: &gltf::material::NormalTexture) -> TextureUse {
        TextureUse::new(normals.texture().index(), normals.tex_coord(), normals.extension_value(TRANSFORM))
    }

    /// From a textureInfo that the crate has not read; `None` where it has no index.
    pub(super) fn of_value(info: &Value) -> Option<TextureUse> {
        let texture = usize::try_from(info.get("index")?.as_u64()?).ok()?;
        let uv_set = info.get("texCoord").and_then(Value::as_u64).and_then(|set| u32::try_from(set).ok());
        let transform = info.get("extensions").and_then(|extensions| extensions.get(TRANSFORM));
        Some(TextureUse::new(texture, uv_set.unwrap_or(0), transform))
    }
}

const TRANSFORM: &str = "KHR_texture_transform";

/// Scaled, then turned counter-clockwise as one sees it (v grows downwards), then moved.
fn texture_from_surface(transform: &Value) -> Affine2 {
    let number = |value: Option<&Value>, default: f32| value.and_then(Value::as_f64).map_or(default, |v| v as f32);
    let pair = |key: &str, default: f32| {
        let value = transform.get(key);
        Vec2::new(number(value.and_then(|v| v.get(0)), default), number(value.and_then(|v| v.get(1)), default))
    };
    let (sine, cosine) = number(transform.get("rotation"), 0.0).sin_cos();
    let turn = Mat2::from_cols(Vec2::new(cosine, -sine), Vec2::new(sine, cosine));
    let matrix2 = turn * Mat2::from_diagonal(pair("scale", 1.0));
    let moved = Affine2 { matrix2, translation: pair("offset", 0.0) };
    if moved.is_finite() { moved } else { Affine2::IDENTITY }
}

/// What makes two uses the same texture of the scene: image, decoding, wrap, filter, bits of the transform.
type Key = (usize, Transfer, [Wrap; 2], TexelFilter, [u32; 6]);

/// The textures of a file, made when they are asked for.
#[derive(Default)]
pub(super) struct Textures {
    images: HashMap<usize, Arc<Texels>>,
    /// Index in the scene's textures.
    made: HashMap<Key, u32>,
    bytes: u64,
}

impl Textures {
    /// Index of the scene's texture for a use; `transfer` is linear for data.
    pub(super) fn index(
        &mut self,
        source: &Source,
        scene_textures: &mut Vec<Texture>,
        used: TextureUse,
        data: bool,
    ) -> Result<u32, SceneError> {
        let texels = self.texels(source, used)?;
        let texture = texture(source, used)?;
        let sampler = texture.sampler();
        let wrap = [sampler.wrap_s(), sampler.wrap_t()].map(|mode| match mode {
            WrappingMode::ClampToEdge => Wrap::Clamp,
            WrappingMode::MirroredRepeat => Wrap::Mirror,
            WrappingMode::Repeat => Wrap::Repeat,
        });
        let filter = match sampler.mag_filter() {
            Some(MagFilter::Nearest) => TexelFilter::Nearest,
            Some(MagFilter::Linear) | None => TexelFilter::Linear,
        };
        let transfer = if data { Transfer::Linear } else { texels.transfer() };
        let bits = used.texture_from_surface.to_cols_array().map(f32::to_bits);
        let key = (texture.source().index(), transfer, wrap, filter, bits);
        if let Some(&index) = self.made.get(&key) {
            return Ok(index);
        }
        let index = scene_textures.len() as u32;
        let kind = TextureKind::Image(ImageTexture { texels, transfer, wrap, filter });
        scene_textures.push(Texture { kind, texture_from_surface: used.texture_from_surface });
        self.made.insert(key, index);
        Ok(index)
    }

    /// The texels of a use.
    pub(super) fn texels(&mut self, source: &Source, used: TextureUse) -> Result<Arc<Texels>, SceneError> {
        let image = texture(source, used)?.source();
        if let Some(texels) = self.images.get(&image.index()) {
            return Ok(texels.clone());
        }
        let name = format!("{}: image {}", source.file, image.index());
        let read = Arc::new(match image.source() {
            gltf::image::Source::View { view, .. } => texels(&name, source.view(&view)?)?,
            gltf::image::Source::Uri { uri, .. } => texels(&name, &read_uri(&source.file, &source.folder, uri)?)?,
        });
        self.bytes += read.bytes();
        check_limit(&source.file, "bytes of images", MAX_IMAGE_BYTES, self.bytes)?;
        self.images.insert(image.index(), read.clone());
        Ok(read)
    }
}

fn texture(source: &Source, used: TextureUse) -> Result<gltf::Texture<'_>, SceneError> {
    let textures = source.document.textures();
    let count = textures.len();
    let missing = || source.malformed(format!("texture {}: expected one of {count} textures", used.texture));
    source.document.textures().nth(used.texture).ok_or_else(missing)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_transform_scales_turns_and_moves_as_the_extension_says() {
        // The extension's own example: the lower left quadrant of the image, turned clockwise by 90 degrees.
        let transform = json!({"offset": [0, 1], "rotation": std::f32::consts::FRAC_PI_2, "scale": [0.5, 0.5]});
        let map = texture_from_surface(&transform);
        for (surface, image) in [
            (Vec2::ZERO, Vec2::new(0.0, 1.0)),
            (Vec2::X, Vec2::new(0.0, 0.5)),
            (Vec2::Y, Vec2::new(0.5, 1.0)),
            (Vec2::ONE, Vec2::new(0.5, 0.5)),
        ] {
            assert!((map.transform_point2(surface) - image).length() < 1e-6, "{surface}");
        }
        let flipped = texture_from_surface(&json!({"offset": [0, 1], "scale": [1, -1]}));
        assert_eq!(flipped.transform_point2(Vec2::new(0.25, 0.25)), Vec2::new(0.25, 0.75));
        for bad in [json!({"scale": "x"}), json!(3), json!({"scale": [1e300, 0]}), json!({"offset": []})] {
            assert!(texture_from_surface(&bad).is_finite(), "{bad}");
        }
    }

    #[test]
    fn a_transform_may_choose_the_texture_coordinates() {
        let used = TextureUse::of_value(&json!({
            "index": 3, "texCoord": 1, "extensions": {"KHR_texture_transform": {"texCoord": 2}}
        }));
        assert!(matches!(used, Some(TextureUse { texture: 3, uv_set: 2, .. })));
        let used = TextureUse::of_value(&json!({"index": 3, "texCoord": 1}));
        assert!(used.is_some_and(|used| used.uv_set == 1 && used.texture_from_surface == Affine2::IDENTITY));
        assert!(TextureUse::of_value(&json!({"texCoord": 1})).is_none());
        assert!(TextureUse::of_value(&json!({"index": -1})).is_none());
    }
}
