//! Materials: what a surface does with light.

use super::Texture;
use glam::{Vec2, Vec3};

/// A linear RGB colour, constant or from a texture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Color {
    /// The same everywhere.
    Constant(Vec3),
    /// The texture of this index times a factor.
    Textured {
        /// Index in the scene's textures.
        texture: u32,
        /// Factor per channel.
        factor: Vec3,
    },
}

impl Color {
    /// The colour (linear RGB) at texture coordinates; `textures` are the scene's. A texture that is not
    /// there counts as white.
    pub fn at(&self, textures: &[Texture], uv: Vec2) -> Vec3 {
        match *self {
            Color::Constant(color) => color,
            Color::Textured { texture, factor } => {
                factor * textures.get(texture as usize).map_or(Vec3::ONE, |texture| texture.sample(uv))
            }
        }
    }

    /// Whether it is black everywhere by its factor alone.
    pub fn is_black(&self) -> bool {
        match *self {
            Color::Constant(color) | Color::Textured { factor: color, .. } => color == Vec3::ZERO,
        }
    }
}

/// The closed set of surface behaviours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// Lambert reflection.
    Diffuse {
        /// Fraction reflected, each channel in [0, 1].
        albedo: Color,
    },
    /// Ideal mirror.
    Mirror {
        /// View-independent factor on what it reflects.
        filter: Vec3,
    },
    /// Smooth metal with exact Fresnel reflectance.
    Conductor {
        /// Real part of the index of refraction per channel.
        eta: Vec3,
        /// Imaginary part.
        k: Vec3,
    },
    /// Smooth boundary of a transparent solid or liquid; the inside is where the normal points away from.
    Dielectric {
        /// Index of refraction of the inside over that of the outside.
        ior: f32,
        /// View-independent factor on what is refracted, applied at every crossing.
        filter: Vec3,
        /// Absorption of the inside per metre (Beer-Lambert).
        absorption: Vec3,
    },
}

/// A material.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name for messages.
    pub name: String,
    /// Behaviour.
    pub surface: Surface,
    /// Emitted radiance (linear RGB), on the side that the geometric normal points to only.
    pub emission: Color,
    /// Whether the back side is seen at all; a single-sided surface is still there for light from behind
    /// in a path tracer, so this only decides whether emission shows on both sides.
    pub emission_two_sided: bool,
}
