//! What a ray is inside of: the media whose boundaries it has crossed.
//!
//! A path carries it from surface to surface; whoever lets light through a surface says what is beyond. Media
//! nest: a ball of glass in smoke is left into the smoke. Entering puts the interior of the material on top,
//! leaving takes the topmost of its kind away, so bodies of one medium that overlap are their union. A material
//! that names its exterior says what is outside, as Mitsuba's shapes do.
//!
//! Limits: four media deep, the outermost being forgotten first; a transparent solid without a medium keeps its
//! own absorption only (KHR_materials_volume), and one that absorbs inside another that absorbs is left into air.
//! Cost: eight bytes beside the absorption, and nothing to decide in scenes without media.

use crate::scene::Material;
use glam::Vec3;

/// What a ray runs through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Enclosure {
    /// Of a transparent solid, per metre.
    absorption: Vec3,
    /// Media from the innermost on, 16 bits each: index + 1, [`CLEAR`], or 0 where there is none.
    inside: u64,
}

/// A transparent solid that has no medium, inside of one.
const CLEAR: u64 = 0xffff;
/// Media beyond this index cannot be named.
pub(crate) const MAX_MEDIA: usize = 0xfffe;

impl Enclosure {
    /// Nothing in the way.
    pub(crate) const AIR: Enclosure = Enclosure { absorption: Vec3::ZERO, inside: 0 };

    /// Within one medium of the scene's, and nothing else.
    pub(crate) fn medium(index: u32) -> Enclosure {
        Enclosure { absorption: Vec3::ZERO, inside: 0 }.and(entry(index))
    }

    /// The innermost medium: an index in the scene's.
    #[inline]
    pub(crate) fn innermost(self) -> Option<u32> {
        let top = self.inside & 0xffff;
        (top != 0 && top != CLEAR).then(|| top as u32 - 1)
    }

    /// What is left of radiance after `distance_m`, which may be infinite (Beer-Lambert), by the absorption of a
    /// transparent solid; media of the scene's are not counted.
    pub(crate) fn transmittance(&self, distance_m: f32) -> Vec3 {
        let along = |absorption: f32| if absorption > 0.0 { (-absorption * distance_m).exp() } else { 1.0 };
        if self.absorption == Vec3::ZERO { Vec3::ONE } else { Vec3::from(self.absorption.to_array().map(along)) }
    }

    /// Inside of a transparent solid of this material and absorption, met from its outside.
    pub(crate) fn within(self, material: &Material, absorption: Vec3) -> Enclosure {
        match material.interior {
            Some(index) => Enclosure { absorption: Vec3::ZERO, ..self.and(entry(index)) },
            None if self.inside == 0 => Enclosure { absorption, inside: 0 },
            None => Enclosure { absorption, ..self.and(CLEAR) },
        }
    }

    /// Outside of a transparent solid of this material, met from its inside.
    pub(crate) fn without(self, material: &Material) -> Enclosure {
        let inside = match material.exterior {
            Some(exterior) => entry(exterior),
            None if self.inside == 0 => 0,
            None => self.less(material.interior.map_or(CLEAR, entry)),
        };
        Enclosure { absorption: Vec3::ZERO, inside }
    }

    /// Beyond a surface without thickness of its own: another medium only where its material bounds one.
    #[inline]
    pub(crate) fn across(self, material: &Material, from_outside: bool) -> Enclosure {
        match (material.bounds_medium(), from_outside) {
            (false, _) => self,
            (true, true) if material.interior.is_some() => self.within(material, Vec3::ZERO),
            // An exterior alone: the inside is empty.
            (true, true) => Enclosure::AIR,
            (true, false) => self.without(material),
        }
    }

    /// And, inside of that, within a medium.
    pub(crate) fn and_medium(self, index: u32) -> Enclosure {
        self.and(entry(index))
    }

    fn and(self, entry: u64) -> Enclosure {
        Enclosure { inside: self.inside << 16 | entry, ..self }
    }

    /// Without the topmost entry of this kind.
    fn less(self, entry: u64) -> u64 {
        for shift in [0, 16, 32, 48] {
            if self.inside >> shift & 0xffff == entry {
                let below = (1_u64 << shift) - 1;
                return self.inside & below | (self.inside >> shift >> 16) << shift;
            }
        }
        self.inside
    }
}

fn entry(index: u32) -> u64 {
    u64::from(index) + 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Surface;

    fn bounding(interior: Option<u32>, exterior: Option<u32>) -> Material {
        Material { interior, exterior, ..Material::new("boundary", Surface::Null) }
    }

    #[test]
    fn an_absorbing_solid_lets_nothing_through_from_infinity() {
        let glass = bounding(None, None);
        let inside = Enclosure::AIR.within(&glass, Vec3::new(0.0, 1.0, 1e-3));
        assert_eq!(inside.transmittance(f32::INFINITY), Vec3::X);
        assert_eq!(inside.transmittance(0.0), Vec3::ONE);
        assert_eq!(Enclosure::AIR.transmittance(f32::INFINITY), Vec3::ONE);
        assert!((inside.transmittance(2.0).y - (-2.0_f32).exp()).abs() < 1e-7);
        assert_eq!(inside.without(&glass), Enclosure::AIR);
    }

    #[test]
    fn media_nest_and_come_back_in_any_order() {
        let [smoke, ink, glass] = [bounding(Some(4), None), bounding(Some(7), None), bounding(None, None)];
        let in_smoke = Enclosure::AIR.across(&smoke, true);
        let in_ink = in_smoke.across(&ink, true);
        assert_eq!((in_smoke.innermost(), in_ink.innermost()), (Some(4), Some(7)));
        assert_eq!(in_ink.across(&ink, false), in_smoke);
        assert_eq!(in_smoke.across(&smoke, false), Enclosure::AIR);
        // Overlapping bodies: the one that was entered first is left first.
        let rest = in_ink.across(&smoke, false);
        assert_eq!((rest.innermost(), rest.across(&ink, false)), (Some(7), Enclosure::AIR));
        // Two bodies of one medium are their union.
        let twice = in_smoke.across(&smoke, true);
        assert_eq!(twice.across(&smoke, false), in_smoke);
        // A ball of absorbing glass in smoke.
        let in_glass = in_smoke.within(&glass, Vec3::ONE);
        assert_eq!((in_glass.innermost(), in_glass.transmittance(f32::INFINITY)), (None, Vec3::ZERO));
        assert_eq!(in_glass.without(&glass), in_smoke);
    }

    #[test]
    fn an_exterior_is_where_one_comes_to() {
        let ball = bounding(Some(0), Some(1));
        let outside = Enclosure::AIR.across(&ball, true).across(&ball, false);
        assert_eq!(outside, Enclosure::medium(1));
        let hollow = bounding(None, Some(1));
        assert_eq!(Enclosure::medium(1).across(&hollow, true), Enclosure::AIR);
        assert_eq!(Enclosure::AIR.across(&hollow, false).innermost(), Some(1));
    }

    #[test]
    fn leaving_what_was_never_entered_changes_nothing_and_depth_is_bounded() {
        let smoke = bounding(Some(0), None);
        assert_eq!(Enclosure::medium(3).across(&smoke, false), Enclosure::medium(3));
        assert_eq!(Enclosure::AIR.across(&smoke, false), Enclosure::AIR);
        let deep = (0..10).fold(Enclosure::AIR, |deep, index| deep.across(&bounding(Some(index), None), true));
        assert_eq!(deep.innermost(), Some(9));
        let back = (6..10).rev().fold(deep, |deep, index| deep.across(&bounding(Some(index), None), false));
        assert_eq!(back, Enclosure::AIR);
    }
}
