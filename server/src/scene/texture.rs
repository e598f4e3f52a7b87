//! Textures: decoded images and procedural patterns, looked up in linear light.
//!
//! Texture coordinates repeat with period 1; (0, 0) is the upper left corner of an image and v grows
//! downwards. One lookup is one point, without a footprint: patterns therefore fade over some width
//! instead of jumping, and a scene's images should not be much finer than a pixel.

use super::pattern::Pattern;
use glam::{Vec2, Vec3};

/// A texture.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// What it shows.
    pub kind: TextureKind,
}

/// The closed set of textures.
#[derive(Clone, Debug, PartialEq)]
pub enum TextureKind {
    /// Linear RGB texels, row 0 at the top; repeats in both directions, bilinear.
    Image {
        /// Texels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Linear RGB.
        texels: Vec<[f32; 3]>,
    },
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

impl Texture {
    /// The colour (linear RGB) at texture coordinates.
    pub fn sample(&self, uv: Vec2) -> Vec3 {
        match &self.kind {
            TextureKind::Image { width, height, texels } => bilinear(*width, *height, texels, uv),
            TextureKind::Checker { a, b, squares } => {
                let cell = (uv * Vec2::from_array(*squares)).floor();
                let odd = (cell.x + cell.y).rem_euclid(2.0) >= 1.0;
                Vec3::from_array(if odd { *b } else { *a })
            }
            TextureKind::Pattern(pattern) => pattern.color(uv),
        }
    }

    /// Texels held in memory.
    pub(super) fn texels(&self) -> u64 {
        match &self.kind {
            TextureKind::Image { texels, .. } => texels.len() as u64,
            TextureKind::Checker { .. } | TextureKind::Pattern(_) => 0,
        }
    }
}

/// Bilinear lookup with texel centres at half-integer positions; repeats in both directions.
pub(super) fn bilinear(width: u32, height: u32, texels: &[[f32; 3]], uv: Vec2) -> Vec3 {
    if width == 0 || height == 0 || !uv.is_finite() {
        return Vec3::ZERO;
    }
    let size = Vec2::new(width as f32, height as f32);
    let position = (uv - uv.floor()) * size - 0.5;
    let corner = position.floor();
    let weight = position - corner;
    let texel = |dx: i64, dy: i64| {
        let column = (corner.x as i64 + dx).rem_euclid(i64::from(width)) as usize;
        let row = (corner.y as i64 + dy).rem_euclid(i64::from(height)) as usize;
        texels.get(row * width as usize + column).map_or(Vec3::ZERO, |&texel| Vec3::from_array(texel))
    };
    let upper = texel(0, 0).lerp(texel(1, 0), weight.x);
    let lower = texel(0, 1).lerp(texel(1, 1), weight.x);
    upper.lerp(lower, weight.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image() -> Texture {
        let texels = vec![[0.0; 3], [1.0; 3], [2.0; 3], [3.0; 3]];
        Texture { kind: TextureKind::Image { width: 2, height: 2, texels } }
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
    fn coordinates_that_are_no_number_do_no_harm() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30] {
            assert!(image().sample(Vec2::new(bad, 0.5)).is_finite());
        }
    }

    #[test]
    fn checker_squares_alternate_also_below_zero() {
        let kind = TextureKind::Checker { a: [0.0; 3], b: [1.0; 3], squares: [2.0, 2.0] };
        let checker = Texture { kind };
        let at = |u, v| checker.sample(Vec2::new(u, v)).x;
        assert_eq!(
            [at(0.1, 0.1), at(0.6, 0.1), at(0.6, 0.6), at(-0.1, 0.1), at(-0.1, -0.1)],
            [0.0, 1.0, 0.0, 1.0, 0.0]
        );
    }
}
