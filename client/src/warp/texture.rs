//! Radiance of all nodes row by row, packed (see [`crate::lanes::Texel`]), and its bilinear fetch.
//!
//! Texels that are not known have weight zero: a fetch between known and unknown ones gives the mean of the known.

use crate::lanes::{Floats, OFFSET, Texel, pack, unpack};
use glam::{Vec3, Vec4};

/// The texel of a known radiance, or of none.
#[inline(always)]
pub(super) fn texel_of(radiance: Vec3, known: bool) -> Texel {
    if known { [pack(radiance.x), pack(radiance.y), pack(radiance.z), pack(1.0)] } else { [0; 4] }
}

/// Steps of a texel's width that a position is rounded to, as texture units do.
pub(super) const SUBTEXELS: f32 = 256.0;

/// The upper left of the four texels around a position, and the fraction between them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    /// Index of the upper left texel; the others are the next one and those a row below.
    pub(super) first: usize,
    /// From left to right and from above to below.
    pub(super) x: f32,
    pub(super) y: f32,
}

/// The texels of one node within those of all: rows `pitch` apart.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texture<'a> {
    /// From the node's first texel on.
    pub(super) texels: &'a [Texel],
    /// Texels from one row to the next.
    pub(super) pitch: usize,
}

impl Texture<'_> {
    /// Radiance between the four texels, over the known ones, and the weight of those.
    #[inline(always)]
    pub(super) fn fetch<F: Floats>(&self, at: &Footprint) -> Vec4 {
        F::blend(self.texels, at.first, self.pitch, at.x, at.y) - OFFSET
    }

    /// The same over those of the four texels that `counts` names: above left, above right, below left, below right.
    #[inline(always)]
    pub(super) fn fetch_some(&self, at: &Footprint, counts: [bool; 4]) -> Vec4 {
        let indices = [at.first, at.first + 1, at.first + self.pitch, at.first + self.pitch + 1];
        let weights = [(1.0 - at.x) * (1.0 - at.y), at.x * (1.0 - at.y), (1.0 - at.x) * at.y, at.x * at.y];
        let mut sum = Vec4::ZERO;
        for ((index, weight), counts) in indices.into_iter().zip(weights).zip(counts) {
            sum += if counts { (unpack(self.texels[index]) - OFFSET) * weight } else { Vec4::ZERO };
        }
        sum
    }
}

/// Weight of known texels from which on all four are.
pub(super) const ALL_KNOWN: f32 = 0.999;

/// What was fetched over the weight of the texels that are known, that weight being 0 where too little of the footprint
/// is, and else 1.
#[inline(always)]
pub(super) fn over_known(fetched: Vec4) -> Vec4 {
    /// A quarter is the weight of the nearest texel in the worst place.
    const LEAST_WEIGHT: f32 = 0.24;
    // Interpolation may leave a rounding error below zero.
    let radiance = fetched.max(Vec4::ZERO);
    if fetched.w > ALL_KNOWN {
        radiance
    } else if fetched.w > LEAST_WEIGHT {
        radiance / fetched.w
    } else {
        Vec4::ZERO
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Portable;

    #[test]
    fn a_fetch_between_known_and_unknown_is_the_known() {
        let texels = [texel_of(Vec3::ONE, true), texel_of(Vec3::splat(9.0), false)].repeat(2);
        let texture = Texture { texels: &texels, pitch: 2 };
        for x in [0.0, 0.2, 0.5, 0.7] {
            let found = over_known(texture.fetch::<Portable>(&Footprint { first: 0, x, y: 0.0 }));
            assert!((found - Vec4::ONE).abs().max_element() < 1e-3, "{x}: {found}");
        }
        assert!(over_known(texture.fetch::<Portable>(&Footprint { first: 0, x: 1.0, y: 0.0 })) == Vec4::ZERO);
    }
}
