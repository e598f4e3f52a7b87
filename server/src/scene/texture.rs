//! Textures: images and procedural patterns, looked up in linear light.
//!
//! Patterns repeat with period 1; images repeat, mirror or end as their sampler says. (0, 0) is the upper left
//! corner of an image and v grows downwards. One lookup is one point, without a footprint: patterns therefore
//! fade over some width instead of jumping, and a scene's images should not be much finer than a pixel. Images
//! are interpolated after decoding, in linear light.

use super::pattern::Pattern;
use super::texels::{Texels, Transfer};
use glam::{Affine2, Vec2, Vec3, Vec4};
use std::sync::Arc;

/// A texture.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// What it shows.
    pub kind: TextureKind,
    /// Its own coordinates from those of the surface.
    pub texture_from_surface: Affine2,
}

impl Texture {
    /// In the coordinates of the surface.
    pub fn new(kind: TextureKind) -> Texture {
        Texture { kind, texture_from_surface: Affine2::IDENTITY }
    }
}

/// The closed set of textures.
#[derive(Clone, Debug, PartialEq)]
pub enum TextureKind {
    /// Of a file.
    Image(ImageTexture),
    /// Two colours in squares.
    Checker {
        /// First colour, linear RGB.
        a: [f32; 3],
        /// Second colour.
        b: [f32; 3],
        /// Squares per unit of texture coordinate.
        squares: [f32; 2],
    },
    /// A procedural pattern with soft edges.
    Pattern(Pattern),
}

/// An image and how it is read; many of them may share their texels.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageTexture {
    /// As stored.
    pub texels: Arc<Texels>,
    /// From stored numbers to light.
    pub transfer: Transfer,
    /// Beyond 0 to 1, along u and along v.
    pub wrap: [Wrap; 2],
    /// Between texel centres.
    pub filter: TexelFilter,
}

/// What an image shows beyond its edges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Wrap {
    /// Itself again.
    #[default]
    Repeat,
    /// Itself, every second time mirrored.
    Mirror,
    /// Its outermost texels.
    Clamp,
}

/// How texels are mixed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TexelFilter {
    /// Bilinear.
    #[default]
    Linear,
    /// Not at all.
    Nearest,
}

impl ImageTexture {
    /// Repeats, bilinear, decoded as its file's format says.
    pub fn new(texels: Arc<Texels>) -> ImageTexture {
        let transfer = texels.transfer();
        ImageTexture { texels, transfer, wrap: [Wrap::Repeat; 2], filter: TexelFilter::Linear }
    }

    /// Linear RGB and alpha at its own coordinates.
    fn sample(&self, uv: Vec2) -> Vec4 {
        if !uv.is_finite() {
            return Vec4::W;
        }
        let texels = &*self.texels;
        let texel = |column: usize, row: usize| texels.at(column, row, self.transfer);
        let columns = Along::new(uv.x, texels.width(), self.wrap[0]);
        let rows = Along::new(uv.y, texels.height(), self.wrap[1]);
        if self.filter == TexelFilter::Nearest {
            return texel(columns.nearest, rows.nearest);
        }
        let upper = texel(columns.low, rows.low).lerp(texel(columns.high, rows.low), columns.weight);
        let lower = texel(columns.low, rows.high).lerp(texel(columns.high, rows.high), columns.weight);
        upper.lerp(lower, rows.weight)
    }
}

/// Where a lookup falls along one axis; texel centres are at half-integer positions.
struct Along {
    low: usize,
    high: usize,
    /// Of the high one.
    weight: f32,
    nearest: usize,
}

impl Along {
    fn new(coordinate: f32, size: u32, wrap: Wrap) -> Along {
        let within = match wrap {
            Wrap::Repeat => coordinate - coordinate.floor(),
            Wrap::Clamp => coordinate.clamp(0.0, 1.0),
            // There and back again.
            Wrap::Mirror => {
                let there = coordinate.rem_euclid(2.0);
                if there > 1.0 { 2.0 - there } else { there }
            }
        };
        let last = i64::from(size) - 1;
        // The edge of a mirrored image lies between a texel and itself.
        let texel = |index: f32| match wrap {
            Wrap::Repeat => (index as i64).rem_euclid(i64::from(size)) as usize,
            Wrap::Clamp | Wrap::Mirror => (index as i64).clamp(0, last) as usize,
        };
        let position = within * size as f32;
        let corner = (position - 0.5).floor();
        Along {
            low: texel(corner),
            high: texel(corner + 1.0),
            weight: position - 0.5 - corner,
            nearest: (position.floor() as i64).clamp(0, last) as usize,
        }
    }
}

impl Texture {
    /// The colour (linear RGB) at texture coordinates.
    pub fn sample(&self, uv_of_surface: Vec2) -> Vec3 {
        self.sample_rgba(uv_of_surface).truncate()
    }

    /// The colour (linear RGB) and the opacity at texture coordinates.
    pub fn sample_rgba(&self, uv_of_surface: Vec2) -> Vec4 {
        let uv = self.texture_from_surface.transform_point2(uv_of_surface);
        let color = match &self.kind {
            TextureKind::Image(image) => return image.sample(uv),
            TextureKind::Checker { a, b, squares } => {
                let cell = (uv * Vec2::from_array(*squares)).floor();
                let odd = (cell.x + cell.y).rem_euclid(2.0) >= 1.0;
                Vec3::from_array(if odd { *b } else { *a })
            }
            TextureKind::Pattern(pattern) => pattern.color(uv),
        };
        color.extend(1.0)
    }
}

/// Bytes of the images of some textures; those that share their texels count once.
pub(super) fn image_bytes(textures: &[Texture]) -> u64 {
    let mut seen = std::collections::HashSet::new();
    let images = textures.iter().filter_map(|texture| match &texture.kind {
        TextureKind::Image(image) => seen.insert(Arc::as_ptr(&image.texels)).then(|| image.texels.bytes()),
        TextureKind::Checker { .. } | TextureKind::Pattern(_) => None,
    });
    images.sum()
}

/// Bilinear lookup with texel centres at half-integer positions; repeats in both directions.
pub(super) fn bilinear(width: u32, height: u32, texels: &[[f32; 3]], uv: Vec2) -> Vec3 {
    if width == 0 || height == 0 || !uv.is_finite() {
        return Vec3::ZERO;
    }
    let columns = Along::new(uv.x, width, Wrap::Repeat);
    let rows = Along::new(uv.y, height, Wrap::Repeat);
    let texel = |column: usize, row: usize| {
        texels.get(row * width as usize + column).map_or(Vec3::ZERO, |&texel| Vec3::from_array(texel))
    };
    let upper = texel(columns.low, rows.low).lerp(texel(columns.high, rows.low), columns.weight);
    let lower = texel(columns.low, rows.high).lerp(texel(columns.high, rows.high), columns.weight);
    upper.lerp(lower, rows.weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image_with(wrap: Wrap, filter: TexelFilter) -> Texture {
        let texels = vec![[0.0; 3], [1.0; 3], [2.0; 3], [3.0; 3]];
        let texels = Arc::new(Texels::from_linear_rgb(2, texels).unwrap());
        Texture::new(TextureKind::Image(ImageTexture { wrap: [wrap; 2], filter, ..ImageTexture::new(texels) }))
    }

    fn image() -> Texture {
        image_with(Wrap::Repeat, TexelFilter::Linear)
    }

    #[test]
    fn a_texel_is_met_at_its_centre_and_mixed_between() {
        assert_eq!(image().sample(Vec2::new(0.25, 0.25)), Vec3::ZERO);
        assert_eq!(image().sample(Vec2::new(0.75, 0.25)), Vec3::ONE);
        assert_eq!(image().sample(Vec2::new(0.25, 0.75)), Vec3::splat(2.0));
        assert_eq!(image().sample(Vec2::new(0.5, 0.5)), Vec3::splat(1.5));
    }

    #[test]
    fn images_repeat_in_both_directions() {
        for shift in [-3.0, -1.0, 1.0, 7.0] {
            for uv in [Vec2::new(0.1, 0.9), Vec2::new(0.99, 0.01), Vec2::ZERO] {
                let there = image().sample(uv + Vec2::splat(shift));
                assert!((there - image().sample(uv)).length() < 1e-5);
            }
        }
    }

    #[test]
    fn mirrored_images_are_even_about_every_integer() {
        let mirrored = image_with(Wrap::Mirror, TexelFilter::Linear);
        for step in 0..40_u8 {
            let offset = Vec2::new(f32::from(step) * 0.07, f32::from(step) * 0.045);
            for about in [-2.0, -1.0, 0.0, 1.0, 3.0] {
                let (there, back) = (Vec2::splat(about) + offset, Vec2::splat(about) - offset);
                assert!((mirrored.sample(there) - mirrored.sample(back)).length() < 1e-5);
            }
        }
        // Within the image, away from its border, it is what it is when repeated.
        assert_eq!(mirrored.sample(Vec2::new(0.4, 0.6)), image().sample(Vec2::new(0.4, 0.6)));
        assert_eq!(mirrored.sample(Vec2::ZERO), Vec3::ZERO);
    }

    #[test]
    fn clamped_images_keep_their_border() {
        let clamped = image_with(Wrap::Clamp, TexelFilter::Linear);
        assert_eq!(clamped.sample(Vec2::new(-5.0, -0.1)), Vec3::ZERO);
        assert_eq!(clamped.sample(Vec2::new(9.0, 1.0)), Vec3::splat(3.0));
        assert_eq!(clamped.sample(Vec2::new(1.0, 0.0)), Vec3::ONE);
    }

    #[test]
    fn unfiltered_images_have_only_their_own_texels() {
        let nearest = image_with(Wrap::Repeat, TexelFilter::Nearest);
        let at = |u, v| nearest.sample(Vec2::new(u, v)).x;
        assert_eq!(
            [at(0.0, 0.0), at(0.49, 0.2), at(0.51, 0.2), at(0.2, 0.99), at(1.0, 1.0)],
            [0.0, 0.0, 1.0, 2.0, 0.0]
        );
    }

    #[test]
    fn coordinates_that_are_no_number_do_no_harm() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, f32::MAX, -1e-30] {
            for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
                for filter in [TexelFilter::Linear, TexelFilter::Nearest] {
                    assert!(image_with(wrap, filter).sample_rgba(Vec2::new(bad, 0.5)).is_finite());
                }
            }
        }
    }

    #[test]
    fn shared_texels_are_counted_once() {
        let one = image();
        assert_eq!(image_bytes(&[one.clone(), one.clone(), image()]), 2 * 4 * 12);
    }

    #[test]
    fn checker_squares_alternate_also_below_zero() {
        let kind = TextureKind::Checker { a: [0.0; 3], b: [1.0; 3], squares: [2.0, 2.0] };
        let checker = Texture::new(kind);
        let at = |u, v| checker.sample(Vec2::new(u, v)).x;
        assert_eq!(
            [at(0.1, 0.1), at(0.6, 0.1), at(0.6, 0.6), at(-0.1, 0.1), at(-0.1, -0.1)],
            [0.0, 1.0, 0.0, 1.0, 0.0]
        );
    }
}
