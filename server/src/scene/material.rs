//! Materials: what a surface does with light.

use super::Texture;
use glam::{Vec2, Vec3, Vec4};
use std::f32::consts::FRAC_PI_2;

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

/// A number, constant or from one channel of a texture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scalar {
    /// The same everywhere.
    Constant(f32),
    /// A channel of the texture of this index times a factor.
    Textured {
        /// Index in the scene's textures.
        texture: u32,
        /// 0 red, 1 green, 2 blue, 3 alpha.
        channel: u8,
        /// Factor.
        factor: f32,
        /// Whether the channel is squared before: it holds the square root, as images of roughness do.
        squared: bool,
    },
}

impl Scalar {
    /// Its value at texture coordinates; `textures` are the scene's. A texture that is not there counts as 1.
    pub fn at(&self, textures: &[Texture], uv: Vec2) -> f32 {
        match *self {
            Scalar::Constant(value) => value,
            Scalar::Textured { texture, channel, factor, squared } => {
                let texel = textures.get(texture as usize).map_or(Vec4::ONE, |texture| texture.sample_rgba(uv));
                let value = texel[usize::from(channel.min(3))];
                factor * if squared { value * value } else { value }
            }
        }
    }

    /// The largest value that it can have, if texels are at most 1.
    pub fn most(&self) -> f32 {
        match *self {
            Scalar::Constant(value) | Scalar::Textured { factor: value, .. } => value,
        }
    }
}

/// How the normals of the facets of a rough surface are distributed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Distribution {
    /// Trowbridge and Reitz 1975, Walter et al. 2007.
    #[default]
    Ggx,
    /// Beckmann and Spizzichino 1963.
    Beckmann,
}

/// A rough surface that is rougher in one direction than across it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Anisotropy {
    /// 0 to 1: along the direction alpha becomes `mix(alpha, 1, strength^2)` (KHR_materials_anisotropy).
    pub strength: f32,
    /// The rougher direction, counter-clockwise from the tangent (along u) in radians.
    pub rotation_rad: f32,
    /// A texture that turns and weakens it: direction in red and green (-1 to 1), strength in blue.
    pub texture: Option<u32>,
}

/// How smooth a surface is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finish {
    /// Of the facets' normals.
    pub distribution: Distribution,
    /// Root mean square slope of the facets; 0 is smooth. (glTF's roughness is its square root.)
    pub alpha: Scalar,
    /// All zero where the surface looks the same from all sides.
    pub anisotropy: Anisotropy,
    /// Whether light that meets several facets is kept (Kulla and Conty 2017); without it rough surfaces are
    /// darker, as in renderers that trace single scattering only.
    pub compensated: bool,
}

impl Finish {
    /// Perfectly smooth.
    pub const SMOOTH: Finish = Finish::isotropic(Distribution::Ggx, Scalar::Constant(0.0));

    /// The same from all sides, compensated.
    pub const fn isotropic(distribution: Distribution, alpha: Scalar) -> Finish {
        let anisotropy = Anisotropy { strength: 0.0, rotation_rad: 0.0, texture: None };
        Finish { distribution, alpha, anisotropy, compensated: true }
    }

    /// From the alphas along u and along v.
    pub fn along_axes(distribution: Distribution, alpha_u: f32, alpha_v: f32) -> Finish {
        let (low, high) = (alpha_u.min(alpha_v), alpha_u.max(alpha_v));
        let strength =
            if high > low { ((high - low) / (1.0 - low).max(f32::MIN_POSITIVE)).min(1.0).sqrt() } else { 0.0 };
        let rotation_rad = if alpha_u >= alpha_v { 0.0 } else { FRAC_PI_2 };
        let anisotropy = Anisotropy { strength, rotation_rad, texture: None };
        Finish { anisotropy, ..Finish::isotropic(distribution, Scalar::Constant(low)) }
    }

    /// Whether it is smooth everywhere.
    pub fn is_smooth(&self) -> bool {
        self.alpha.most() <= 0.0 && self.anisotropy.strength == 0.0
    }
}

/// A clear layer over everything else (KHR_materials_clearcoat): of index 1.5, without thickness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coat {
    /// Part of the surface that has it, 0 to 1.
    pub strength: Scalar,
    /// Of its facets (GGX); 0 is smooth.
    pub alpha: Scalar,
}

/// Metal or coloured plastic, or a mix (glTF 2.0, 3.9.2, and extensions).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standard {
    /// Albedo of the plastic, reflectance of the metal at normal incidence.
    pub base: Color,
    /// 0 plastic, 1 metal.
    pub metallic: Scalar,
    /// Of the metal, and of the plastic's reflecting layer.
    pub finish: Finish,
    /// Index of the plastic (KHR_materials_ior).
    pub ior: f32,
    /// Factor on the plastic's reflectance at all angles (KHR_materials_specular).
    pub specular: Scalar,
    /// Its colour at normal incidence; may be above 1.
    pub specular_color: Color,
    /// Part of the light that enters the plastic which goes straight through instead of being scattered
    /// (KHR_materials_transmission), 0 to 1, tinted by `base`: a thin wall.
    pub transmission: Scalar,
    /// Over it all.
    pub coat: Option<Coat>,
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
    /// Metal with exact Fresnel reflectance.
    Conductor {
        /// Real part of the index of refraction per channel.
        eta: Vec3,
        /// Imaginary part.
        k: Vec3,
        /// View-independent factor on what it reflects.
        filter: Color,
        /// Smooth or rough.
        finish: Finish,
    },
    /// Boundary of a transparent solid or liquid; the inside is where the normal points away from.
    Dielectric {
        /// Index of refraction of the inside over that of the outside.
        ior: f32,
        /// 20 over the Abbe number (KHR_materials_dispersion); 0 where all colours are refracted alike. `ior`
        /// is then the index at 587.6 nm.
        dispersion: f32,
        /// View-independent factor on what is refracted, applied at every crossing.
        filter: Color,
        /// Absorption of the inside per metre (Beer-Lambert).
        absorption: Vec3,
        /// Smooth or rough.
        finish: Finish,
    },
    /// A pane whose thickness does not matter: light goes straight through, or is reflected by its two faces.
    ThinDielectric {
        /// Index of refraction of the pane.
        ior: f32,
        /// View-independent factor on what goes through.
        filter: Color,
        /// Smooth or rough.
        finish: Finish,
    },
    /// Metal, plastic, coated or not.
    Standard(Standard),
    /// Not there for light: bounds a medium.
    Null,
}

impl Surface {
    /// Whether it refracts colours differently.
    pub fn is_dispersive(&self) -> bool {
        matches!(self, Surface::Dielectric { dispersion, .. } if *dispersion > 0.0)
    }

    /// Whether it looks different when it is turned about its normal.
    pub fn is_anisotropic(&self) -> bool {
        match self {
            Surface::Conductor { finish, .. }
            | Surface::Dielectric { finish, .. }
            | Surface::ThinDielectric { finish, .. }
            | Surface::Standard(Standard { finish, .. }) => finish.anisotropy.strength > 0.0,
            Surface::Diffuse { .. } | Surface::Mirror { .. } | Surface::Null => false,
        }
    }
}

/// A texture that tilts the shading normal (glTF 2.0, 3.9.3): tangent, bitangent and normal in red, green and
/// blue, from -1 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalMap {
    /// Index in the scene's textures.
    pub texture: u32,
    /// Factors on the tilt along tangent and bitangent; a negative second one for pictures whose green runs down.
    pub scale: Vec2,
}

/// Where a surface is not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cutout {
    /// How much of the surface is there, 0 to 1.
    pub opacity: Scalar,
    /// It is there from this opacity on; without a threshold `opacity` is a probability.
    pub threshold: Option<f32>,
}

impl Cutout {
    /// Whether light that arrives here goes on as if there were nothing; `random` is uniform in [0, 1), and
    /// asked for only where the opacity is a probability.
    pub fn passes(&self, textures: &[Texture], uv: Vec2, random: impl FnOnce() -> f32) -> bool {
        let opacity = self.opacity.at(textures, uv);
        match self.threshold {
            Some(threshold) => opacity < threshold,
            None => random() >= opacity,
        }
    }
}

/// A material.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name for messages.
    pub name: String,
    /// Behaviour.
    pub surface: Surface,
    /// Whether the back of an opaque surface is black instead of like its front.
    pub one_sided: bool,
    /// Tilts the shading normal.
    pub normal_map: Option<NormalMap>,
    /// Holes.
    pub cutout: Option<Cutout>,
    /// Emitted radiance (linear RGB), on the side that the geometric normal points to only.
    pub emission: Color,
    /// Whether emission shows on both sides.
    pub emission_two_sided: bool,
    /// What fills the inside of the surface: an index in the scene's media. It takes the place of the
    /// absorption of a dielectric.
    pub interior: Option<u32>,
    /// What lies outside; without one, whatever the surface stands in.
    pub exterior: Option<u32>,
}

impl Material {
    /// A material that neither emits nor has holes.
    pub fn new(name: impl Into<String>, surface: Surface) -> Material {
        Material {
            name: name.into(),
            surface,
            one_sided: false,
            normal_map: None,
            cutout: None,
            emission: Color::Constant(Vec3::ZERO),
            emission_two_sided: false,
            interior: None,
            exterior: None,
        }
    }
}

impl Material {
    /// Whether a ray that passes the surface comes into another medium of the scene's.
    pub fn bounds_medium(&self) -> bool {
        self.interior.is_some() || self.exterior.is_some()
    }

    /// Makes its texture indices count from `first`.
    pub(super) fn shift_textures(&mut self, first: u32) {
        let (colors, scalars, others) = self.parameters_mut();
        for color in colors {
            if let Color::Textured { texture, .. } = color {
                *texture += first;
            }
        }
        for scalar in scalars {
            if let Scalar::Textured { texture, .. } = scalar {
                *texture += first;
            }
        }
        others.into_iter().for_each(|texture| *texture += first);
    }

    /// Indices of the textures of its colours and numbers; normal maps and directions are not among them.
    pub fn textures(&self) -> impl Iterator<Item = u32> {
        let mut copy = self.clone();
        let (colors, scalars, _) = copy.parameters_mut();
        let of_colors = colors.into_iter().filter_map(|color| match *color {
            Color::Textured { texture, .. } => Some(texture),
            Color::Constant(_) => None,
        });
        let of_scalars = scalars.into_iter().filter_map(|scalar| match *scalar {
            Scalar::Textured { texture, .. } => Some(texture),
            Scalar::Constant(_) => None,
        });
        of_colors.chain(of_scalars).collect::<Vec<_>>().into_iter()
    }

    /// All that may come from textures: colours, numbers, and the indices of textures that hold directions.
    pub fn parameters_mut(&mut self) -> (Vec<&mut Color>, Vec<&mut Scalar>, Vec<&mut u32>) {
        let (mut colors, mut scalars, mut others) = (vec![&mut self.emission], Vec::new(), Vec::new());
        others.extend(self.normal_map.as_mut().map(|map| &mut map.texture));
        scalars.extend(self.cutout.as_mut().map(|cutout| &mut cutout.opacity));
        match &mut self.surface {
            Surface::Mirror { .. } | Surface::Null => {}
            Surface::Diffuse { albedo } => colors.push(albedo),
            Surface::Conductor { filter, finish, .. }
            | Surface::Dielectric { filter, finish, .. }
            | Surface::ThinDielectric { filter, finish, .. } => {
                colors.push(filter);
                scalars.push(&mut finish.alpha);
                others.extend(finish.anisotropy.texture.as_mut());
            }
            Surface::Standard(Standard {
                base,
                metallic,
                finish,
                ior: _,
                specular,
                specular_color,
                transmission,
                coat,
            }) => {
                colors.extend([base, specular_color]);
                scalars.extend([metallic, &mut finish.alpha, specular, transmission]);
                others.extend(finish.anisotropy.texture.as_mut());
                scalars.extend(coat.iter_mut().flat_map(|Coat { strength, alpha }| [strength, alpha]));
            }
        }
        (colors, scalars, others)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ImageTexture, Texels, TextureKind};
    use super::*;
    use std::sync::Arc;

    /// Two texels: 0.2 and 0.6 in green, opaque.
    fn ramp() -> Vec<Texture> {
        let texels = Texels::from_linear_rgb(2, vec![[0.0, 0.2, 1.0], [0.0, 0.6, 1.0]]).unwrap();
        vec![Texture::new(TextureKind::Image(ImageTexture::new(Arc::new(texels))))]
    }

    #[test]
    fn roughness_is_squared_after_it_is_interpolated() {
        let alpha = Scalar::Textured { texture: 0, channel: 1, factor: 0.25, squared: true };
        let middle = alpha.at(&ramp(), Vec2::new(0.5, 0.5));
        // Half way from 0.2 to 0.6 with roughness factor 0.5: (0.5 * 0.4)^2.
        assert!((middle - 0.04).abs() < 1e-6, "{middle}");
        assert_eq!(alpha.most(), 0.25);
    }

    #[test]
    fn a_threshold_cuts_and_an_opacity_is_a_probability() {
        let opacity = Scalar::Textured { texture: 0, channel: 1, factor: 1.0, squared: false };
        let [thin, thick] = [Vec2::new(0.25, 0.5), Vec2::new(0.75, 0.5)];
        let mask = Cutout { opacity, threshold: Some(0.5) };
        assert!(mask.passes(&ramp(), thin, || 0.0) && !mask.passes(&ramp(), thick, || 0.999));
        let blend = Cutout { opacity, threshold: None };
        let passed = (0..1000_u16).filter(|&i| blend.passes(&ramp(), thin, || f32::from(i) / 1000.0)).count();
        assert_eq!(passed, 800);
        let full = Cutout { opacity: Scalar::Constant(1.0), threshold: None };
        assert!(!full.passes(&[], thin, || 1.0 - f32::EPSILON));
        assert!(Cutout { opacity: Scalar::Constant(0.0), ..full }.passes(&[], thin, || 0.0));
    }

    #[test]
    fn alphas_along_both_axes_come_back_from_strength_and_rotation() {
        for (alpha_u, alpha_v) in [(0.1, 0.1), (0.3, 0.1), (0.1, 0.4), (1.0, 0.2)] {
            let finish = Finish::along_axes(Distribution::Ggx, alpha_u, alpha_v);
            let Scalar::Constant(across) = finish.alpha else { panic!() };
            let along = across + (1.0 - across) * finish.anisotropy.strength.powi(2);
            let (u, v) = if finish.anisotropy.rotation_rad == 0.0 { (along, across) } else { (across, along) };
            assert!((u - alpha_u).abs() < 1e-6 && (v - alpha_v).abs() < 1e-6, "{u} {v}");
        }
    }
}
