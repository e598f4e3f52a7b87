//! scene.toml: the keys a scene file may have.
//!
//! `docs/scene-format.md` explains each of them. This module is the grammar alone: what is there, of which
//! type, and that nothing else is. Ranges and names are checked where the scene is composed.

mod checks;
mod compose;
#[cfg(test)]
mod examples;
mod lights;
#[cfg(test)]
mod material_tests;
mod materials;
mod motions;
mod place;
mod volumes;

pub(super) use compose::compose;

use super::SceneError;
use super::picture::one_line;
use checks::Section;
use lights::LightKeys;
use materials::MaterialEntry;
use motions::MotionKeys;
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap};
use volumes::VolumeKeys;

/// A whole scene file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Description {
    #[serde(default = "one")]
    exposure: f32,
    head: Option<HeadKeys>,
    #[serde(default)]
    camera: Vec<CameraKeys>,
    environment: Option<EnvironmentKeys>,
    #[serde(default)]
    texture: Vec<TextureEntry>,
    #[serde(default)]
    material: Vec<MaterialEntry>,
    #[serde(default)]
    light: Vec<LightKeys>,
    #[serde(default)]
    shape: Vec<ShapeKeys>,
    #[serde(default)]
    volume: Vec<VolumeKeys>,
    #[serde(default)]
    motion: Vec<MotionKeys>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct HeadKeys {
    position: [f64; 3],
    look_at: Option<[f64; 3]>,
    yaw_deg: Option<f32>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraKeys {
    name: String,
    position: [f64; 3],
    look_at: Option<[f64; 3]>,
    yaw_deg: Option<f32>,
    #[serde(default = "default_fov_deg")]
    vertical_fov_deg: f32,
}

#[derive(Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum EnvironmentKeys {
    Constant {
        radiance: Rgb,
    },
    Gradient {
        zenith: Rgb,
        horizon: Rgb,
        nadir: Rgb,
    },
    Image {
        file: String,
        #[serde(default)]
        rotation_deg: f32,
        #[serde(default = "one")]
        scale: f32,
    },
}

/// A named texture: the name beside the keys of its kind.
#[derive(Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum TextureEntry {
    Image {
        name: String,
        file: String,
        #[serde(default)]
        linear: bool,
        #[serde(default)]
        wrap: WrapKey,
        #[serde(default)]
        filter: TexelFilterKey,
    },
    Checker {
        name: String,
        a: Rgb,
        b: Rgb,
        #[serde(default = "one_by_one")]
        squares: [f32; 2],
    },
    Stripes {
        name: String,
        a: Rgb,
        b: Rgb,
        #[serde(default = "one")]
        count: f32,
        #[serde(default = "default_softness")]
        softness: f32,
    },
    Wood {
        name: String,
        light: Rgb,
        dark: Rgb,
        #[serde(default = "one_by_one")]
        planks: [f32; 2],
    },
    Tiles {
        name: String,
        tile: Rgb,
        joint: Rgb,
        #[serde(default = "one_by_one")]
        count: [f32; 2],
        #[serde(default = "default_joint_width")]
        joint_width: f32,
        #[serde(default)]
        variation: f32,
    },
    Marble {
        name: String,
        stone: Rgb,
        vein: Rgb,
        #[serde(default = "one")]
        count: f32,
    },
    Rings {
        name: String,
        a: Rgb,
        b: Rgb,
        #[serde(default = "one")]
        count: f32,
    },
    Hills {
        name: String,
        sky: Rgb,
        haze: Rgb,
        sun: Rgb,
        ground: Rgb,
        #[serde(default)]
        seed: u32,
    },
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum WrapKey {
    #[default]
    Repeat,
    Mirror,
    Clamp,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum TexelFilterKey {
    #[default]
    Linear,
    Nearest,
}

/// Where a shape is put: scaled, then turned about X, Y and Z in this order, then moved.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct TransformKeys {
    translate: Option<[f64; 3]>,
    rotate_deg: Option<[f32; 3]>,
    scale: Option<Scale>,
}

#[derive(Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum ShapeKeys {
    Sphere {
        material: String,
        centre: [f64; 3],
        radius: f32,
    },
    Box {
        material: String,
        size: [f32; 3],
        #[serde(default = "one_by_one")]
        repeat: [f32; 2],
        #[serde(default)]
        transform: TransformKeys,
    },
    Quad {
        material: String,
        corner: [f64; 3],
        edge_u: [f64; 3],
        edge_v: [f64; 3],
        #[serde(default = "one_by_one")]
        repeat: [f32; 2],
    },
    Cylinder {
        material: String,
        radius: f32,
        height: f32,
        #[serde(default = "default_segments")]
        segments: u32,
        #[serde(default = "one_by_one")]
        repeat: [f32; 2],
        #[serde(default)]
        transform: TransformKeys,
    },
    Water {
        material: String,
        size: [f32; 2],
        #[serde(default = "default_cells")]
        cells: [u32; 2],
        #[serde(default)]
        waves: Vec<WaveKeys>,
        #[serde(default = "one_by_one")]
        repeat: [f32; 2],
        #[serde(default)]
        transform: TransformKeys,
    },
    Mesh {
        file: String,
        material: Option<String>,
        #[serde(default)]
        materials: BTreeMap<String, String>,
        #[serde(default)]
        transform: TransformKeys,
    },
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WaveKeys {
    direction: [f32; 2],
    length_m: f32,
    height_m: f32,
    #[serde(default)]
    phase_deg: f32,
}

/// A colour: three numbers, or one for grey.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(untagged, expecting = "expected a colour: [red, green, blue] or one number")]
enum Rgb {
    Grey(f32),
    Channels([f32; 3]),
}

/// A colour, or a texture by name, or both.
#[derive(Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a colour: [red, green, blue], one number, a texture's name, or { texture = name, factor = colour }"
)]
enum ColorKeys {
    Plain(Rgb),
    Texture(String),
    Scaled(ScaledTextureKeys),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ScaledTextureKeys {
    texture: String,
    factor: Rgb,
}

/// A factor on lengths: one number, or one per axis.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(untagged, expecting = "expected a scale: one number or [x, y, z]")]
enum Scale {
    Uniform(f32),
    Axes([f32; 3]),
}

fn one() -> f32 {
    1.0
}

fn one_by_one() -> [f32; 2] {
    [1.0; 2]
}

fn default_fov_deg() -> f32 {
    60.0
}

fn default_softness() -> f32 {
    0.2
}

fn default_joint_width() -> f32 {
    0.05
}

fn default_segments() -> u32 {
    64
}

fn default_cells() -> [u32; 2] {
    [64; 2]
}

/// Brightest radiance: the sun's disc has about 1e9 in relative terms, which no sampler here could use.
const MAX_RADIANCE: f32 = 1e6;

/// What a name stands for; `kind` is that of the sections that have such names.
fn index_of(
    indices: &HashMap<String, u32>,
    section: &Section,
    field: &str,
    kind: &str,
    name: &str,
) -> Result<u32, SceneError> {
    let missing =
        || section.error(field, format_args!("the name of a [[{kind}]]"), format_args!("'{}'", name.escape_debug()));
    indices.get(name).copied().ok_or_else(missing)
}

/// Reads the text of a scene file; `file` names it in messages.
pub(super) fn parse(file: &str, text: &str) -> Result<Description, SceneError> {
    toml::from_str(text).map_err(|error| {
        let before = text.get(..error.span().map_or(0, |span| span.start)).unwrap_or_default();
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        SceneError::Syntax {
            file: file.to_owned(),
            line: before.matches('\n').count() + 1,
            column: before[line_start..].chars().count() + 1,
            message: one_line(error.message()),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        parse("x.toml", text).unwrap_err().to_string()
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line() {
        assert_eq!(
            error("exposure = 1\nexposrue = 2\n"),
            "x.toml: line 2, column 1: unknown field `exposrue`, expected one of `exposure`, `head`, `camera`, \
             `environment`, `texture`, `material`, `light`, `shape`, `volume`, `motion`"
        );
        let nested =
            error("[[shape]]\nkind = \"sphere\"\nmaterial = \"a\"\ncentre = [0, 0, 0]\nradius = 1\ncolour = 3\n");
        assert!(nested.contains("unknown field `colour`") && nested.starts_with("x.toml: line "), "{nested}");
    }

    #[test]
    fn what_is_no_toml_or_of_the_wrong_type_is_one_line() {
        for text in [
            "[[",
            "exposure = \"bright\"",
            "exposure = ",
            "[head]\nposition = [1, 2]",
            "[[shape]]\nkind = \"cone\"",
            "[[material]]\nname = \"a\"\nkind = \"diffuse\"\nalbedo = [1, 2]",
            "\u{feff}\u{0}",
            "a = 1\r\n\r\n= 3",
        ] {
            let line = error(text);
            assert!(line.starts_with("x.toml: line ") && !line.contains('\n'), "{line}");
        }
    }

    #[test]
    fn a_colour_of_the_wrong_shape_says_what_a_colour_is() {
        let line = error("[[material]]\nname = \"a\"\nkind = \"diffuse\"\nalbedo = [1, 2]\n");
        assert!(line.contains("expected a colour: [red, green, blue]"), "{line}");
    }
}
