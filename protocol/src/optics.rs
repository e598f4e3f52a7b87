//! Reflection, refraction and Fresnel weights: the arithmetic that server and client must share, since
//! the client puts the weight on what the server traced.
//!
//! Source: Born and Wolf, Principles of Optics; the dielectric form follows Pharr et al., Physically
//! Based Rendering (4th ed., 9.3.5), the conductor form Lagarde 2013. Cosines are against the normal on
//! the side the ray comes from, from 0 (grazing) to 1.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// The optical boundary that a specular pixel shows: what decides the weight of its two children.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Interface {
    /// Reflects everything: the ideal mirror.
    Mirror,
    /// A metal, by its complex index of refraction `eta + i k` per channel.
    Conductor {
        /// Real part, relative to the outside.
        eta: [f32; 3],
        /// Imaginary part.
        k: [f32; 3],
    },
    /// A smooth boundary between two transparent media.
    Dielectric {
        /// Index of refraction beyond the boundary over the one before it.
        eta: f32,
    },
    /// A thin plate of a transparent medium: light goes straight through, or is reflected by either face,
    /// however often it runs to and fro between them.
    Pane {
        /// Index of refraction of the plate over that around it.
        eta: f32,
    },
}

impl Interface {
    /// Fraction of radiance reflected, per channel, in [0, 1]; the rest of a dielectric or a pane goes through.
    pub fn reflectance(&self, cos_incident: f32) -> Vec3 {
        match *self {
            Interface::Mirror => Vec3::ONE,
            Interface::Conductor { eta, k } => {
                let [er, eg, eb] = eta;
                let [kr, kg, kb] = k;
                let one = |eta, k| fresnel_conductor(cos_incident, eta, k);
                Vec3::new(one(er, kr), one(eg, kg), one(eb, kb))
            }
            Interface::Dielectric { eta } => Vec3::splat(fresnel_dielectric(cos_incident, eta)),
            Interface::Pane { eta } => Vec3::splat(reflectance_of_pane(cos_incident, eta)),
        }
    }

    /// Fraction of radiance that goes through, per channel.
    pub fn transmittance(&self, cos_incident: f32) -> Vec3 {
        match self {
            Interface::Mirror | Interface::Conductor { .. } => Vec3::ZERO,
            Interface::Dielectric { .. } | Interface::Pane { .. } => Vec3::ONE - self.reflectance(cos_incident),
        }
    }

    /// Where what goes through of the direction `incident` (towards the surface, against `normal`) continues;
    /// `None` where nothing goes through.
    pub fn refracted(&self, incident: Vec3, normal: Vec3) -> Option<Vec3> {
        match *self {
            Interface::Mirror | Interface::Conductor { .. } => None,
            Interface::Dielectric { eta } => refract(incident, normal, eta),
            Interface::Pane { .. } => Some(incident),
        }
    }

    /// Finite indices within what exists (and some more): eta 1e-3 to 1e3, k 0 to 1e3.
    pub fn is_valid(&self) -> bool {
        let index = |eta: f32| (1e-3..=1e3).contains(&eta);
        match *self {
            Interface::Mirror => true,
            Interface::Conductor { eta, k } => {
                eta.into_iter().all(index) && k.into_iter().all(|k| (0.0..=1e3).contains(&k))
            }
            Interface::Dielectric { eta } | Interface::Pane { eta } => index(eta),
        }
    }
}

/// Unpolarised reflectance of a dielectric boundary; `eta` is the index beyond over the index before.
/// Total internal reflection gives exactly 1.
pub fn fresnel_dielectric(cos_incident: f32, eta: f32) -> f32 {
    if eta == 1.0 {
        // No boundary; below, rounding would make one of it for a grazing ray.
        return 0.0;
    }
    let cos_i = cos_incident.clamp(0.0, 1.0);
    let sin2_t = (1.0 - cos_i * cos_i) / (eta * eta);
    if sin2_t >= 1.0 {
        return 1.0;
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    let parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    let perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    // Both denominators vanish only at cos_i = 0 together with cos_t = 0: the critical angle at grazing.
    let reflectance = 0.5 * (parallel * parallel + perpendicular * perpendicular);
    if reflectance.is_finite() { reflectance.min(1.0) } else { 1.0 }
}

/// Unpolarised reflectance of a thin plate of relative index `eta`. With R of one face, what is reflected after
/// 0, 1, 2, ... passes to and fro sums to R + (1 - R)^2 R (1 + R^2 + R^4 + ...) = 2 R / (1 + R): incoherent
/// light, no absorption. An index below 1 stands for a gap and may reflect totally.
pub fn reflectance_of_pane(cos_incident: f32, eta: f32) -> f32 {
    let face = fresnel_dielectric(cos_incident, eta);
    2.0 * face / (1.0 + face)
}

/// Unpolarised reflectance of a metal of index `eta + i k`; with `k = 0` it is the dielectric's.
pub fn fresnel_conductor(cos_incident: f32, eta: f32, k: f32) -> f32 {
    if eta == 1.0 && k == 0.0 {
        return 0.0;
    }
    // In f64: with k of some hundreds the squares below differ in their last f32 digits only.
    let cos_i = f64::from(cos_incident.clamp(0.0, 1.0));
    let (eta2, k2) = (f64::from(eta * eta), f64::from(k * k));
    let cos2 = cos_i * cos_i;
    let sin2 = 1.0 - cos2;
    let difference = eta2 - k2 - sin2;
    let a2_plus_b2 = (difference * difference + 4.0 * eta2 * k2).sqrt();
    let a = (0.5 * (a2_plus_b2 + difference)).max(0.0).sqrt();
    let perpendicular_sum = a2_plus_b2 + cos2;
    let perpendicular_mix = 2.0 * a * cos_i;
    let denominator = perpendicular_sum + perpendicular_mix;
    if denominator <= 0.0 {
        return 1.0;
    }
    let perpendicular = (perpendicular_sum - perpendicular_mix) / denominator;
    let parallel_sum = cos2 * a2_plus_b2 + sin2 * sin2;
    let parallel_mix = perpendicular_mix * sin2;
    let parallel_denominator = parallel_sum + parallel_mix;
    let parallel = if parallel_denominator > 0.0 {
        perpendicular * (parallel_sum - parallel_mix) / parallel_denominator
    } else {
        perpendicular
    };
    (0.5 * (parallel + perpendicular)).clamp(0.0, 1.0) as f32
}

/// Mirrors the direction `incident` (towards the surface) about the unit normal; unit length again even
/// where the two are off by rounding.
pub fn reflect(incident: Vec3, normal: Vec3) -> Vec3 {
    (incident - 2.0 * incident.dot(normal) * normal).normalize_or(normal)
}

/// Refracts the direction `incident` (towards the surface, against `normal`); `eta` is the index beyond
/// over the index before. `None` for total internal reflection.
pub fn refract(incident: Vec3, normal: Vec3, eta: f32) -> Option<Vec3> {
    if eta == 1.0 {
        // Straight on; below, the cosine of a grazing ray would be lost in rounding.
        return incident.try_normalize();
    }
    let cos_i = (-incident.dot(normal)).clamp(0.0, 1.0);
    let sin2_t = (1.0 - cos_i * cos_i) / (eta * eta);
    if sin2_t >= 1.0 {
        return None;
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    (incident / eta + (cos_i / eta - cos_t) * normal).try_normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;
    use proptest::prelude::*;

    #[test]
    fn glass_reflects_four_percent_at_normal_incidence() {
        assert!((fresnel_dielectric(1.0, 1.5) - 0.04).abs() < 1e-6);
        assert_eq!(fresnel_dielectric(0.0, 1.5), 1.0);
        assert_eq!(fresnel_dielectric(0.7, 1.0), 0.0);
    }

    #[test]
    fn a_pane_reflects_what_its_two_faces_send_back() {
        for (cos_i, eta) in [(1.0_f32, 1.5_f32), (0.5, 1.5), (0.05, 1.33), (0.3, 2.4)] {
            // Follow the light to and fro: at every face a part goes on and the rest stays inside.
            let face = f64::from(fresnel_dielectric(cos_i, eta));
            let (mut reflected, mut inside, mut transmitted) = (face, 1.0 - face, 0.0);
            for _ in 0..200 {
                transmitted += inside * (1.0 - face);
                inside *= face;
                reflected += inside * (1.0 - face);
                inside *= face;
            }
            let pane = Interface::Pane { eta };
            assert!((f64::from(pane.reflectance(cos_i).x) - reflected).abs() < 1e-6, "{cos_i} {eta}");
            assert!((f64::from(pane.transmittance(cos_i).y) - transmitted).abs() < 1e-6, "{cos_i} {eta}");
        }
        let clear = Interface::Pane { eta: 1.0 };
        assert!(clear.reflectance(0.3).x < 1e-12);
        let incident = Vec3::new(0.6, 0.0, -0.8);
        assert_eq!(clear.refracted(incident, Vec3::Z), Some(incident), "straight on");
        assert_eq!(Interface::Pane { eta: 1.5 }.reflectance(0.0), Vec3::ONE);
        assert!(!Interface::Pane { eta: 0.0 }.is_valid());
    }

    #[test]
    fn brewster_angle_reflects_only_one_polarisation() {
        let eta = 1.5_f32;
        let cos_i = 1.0 / (1.0 + eta * eta).sqrt();
        let perpendicular = (1.0 - eta * eta) / (1.0 + eta * eta);
        assert!((fresnel_dielectric(cos_i, eta) - 0.5 * perpendicular * perpendicular).abs() < 1e-6);
    }

    #[test]
    fn stability_fresnel() {
        // 1 - R near the critical angle is 2 (eta + 1 / eta) cos_t / cos_c, and cos_t the root of what two roundings of 1 and
        // two steps of the cosine make of 0: infinitely steep, but no jump.
        let mut jump = bound!("Fresnel", "jump at the critical angle, of what roundings explain", 1.0);
        for index in [1.000_1_f32, 1.01, 1.33, 1.5, 2.4, 40.0] {
            let eta = 1.0 / index;
            let critical = (1.0 - eta * eta).sqrt();
            let ulp = f64::from(critical.next_up() - critical);
            let (c, e) = (f64::from(critical), f64::from(eta));
            let cos_t = (4.0 * c * ulp / (e * e) + 2.0 * f64::from(f32::EPSILON)).sqrt();
            let explained = 2.0 * (e + 1.0 / e) * cos_t / c;
            for cos_i in [critical.next_down().next_down(), critical.next_down(), critical, critical.next_up()] {
                let (here, next) = (fresnel_dielectric(cos_i, eta), fresnel_dielectric(cos_i.next_up(), eta));
                jump.see(f64::from((here - next).abs()) / explained, format!("{cos_i} {eta}"));
            }
            assert_eq!(fresnel_dielectric(critical * 0.99, eta), 1.0);
        }
        let mut sum = bound!("Fresnel", "R + T off 1", 1e-6);
        let mut outside = bound!("Fresnel", "reflectances outside of 0 to 1", 0.0);
        let mut metal = bound!("Fresnel", "a metal of k = 0 off the dielectric", 1e-5);
        let etas = [1e-3, 0.4, 1.0 / 1.5, 1.0_f32.next_down(), 1.0, 1.0_f32.next_up(), 1.33, 2.4, 1e3];
        let cosines = (0..=1000).map(|step| (step as f32 / 1000.0).powi(2));
        for cos_i in cosines.chain([f32::from_bits(1), 1e-30, 1e-7, 1.0_f32.next_down(), 1.0_f32.next_up(), -0.0]) {
            for eta in etas {
                for interface in [Interface::Dielectric { eta }, Interface::Pane { eta }] {
                    let total = interface.reflectance(cos_i) + interface.transmittance(cos_i);
                    sum.see((total - Vec3::ONE).abs().max_element().into(), format!("{cos_i} {eta}"));
                }
                for k in [0.0, 1e-30, 1e-3, 1.0, 1e3] {
                    for r in [fresnel_dielectric(cos_i, eta), fresnel_conductor(cos_i, eta, k)] {
                        outside.count(!(0.0..=1.0).contains(&r), format!("{cos_i} {eta} {k}"));
                    }
                }
                let difference = fresnel_dielectric(cos_i, eta) - fresnel_conductor(cos_i, eta, 0.0);
                // One ulp off 1 a grazing ray is lost in rounding.
                if (eta - 1.0).abs() > 1e-3 || eta == 1.0 {
                    metal.see(difference.abs().into(), format!("{cos_i} {eta}"));
                }
            }
        }
    }

    #[test]
    fn stability_refract_and_reflect() {
        let mut unit = bound!("refract", "length of a direction off 1", 1e-5);
        let mut undefined = bound!("refract", "directions that are no number or go back", 0.0);
        for step in 0..20_000 {
            let part = |per_step: f32| (step as f32 * per_step).fract();
            let (z, azimuth) = (part(0.618_034).powi(4), std::f32::consts::TAU * part(0.754_878));
            let sine = (1.0 - z * z).sqrt();
            let off = 1e-4 * [-1.0, 0.0, 1.0][step % 3];
            let incident = Vec3::new(sine * azimuth.cos(), sine * azimuth.sin(), -z) * (1.0 + off);
            let normal = Vec3::Z * (1.0 - off);
            for direction in [Some(reflect(incident, normal))]
                .into_iter()
                .chain([0.4, 1.0 / 1.5, 1.0, 1.0_f32.next_up(), 1.5, 2.5].map(|eta| refract(incident, normal, eta)))
            {
                let Some(direction) = direction else { continue };
                unit.see((direction.length() - 1.0).abs().into(), format!("{incident} {normal}"));
                undefined.count(!direction.is_finite(), format!("{incident} {normal}"));
            }
        }
        // The offset of a slab, t (1 - c / sqrt(r^2 - 1 + c^2)): no acos and tan, which are 0 / 0 along the normal.
        let mut slab = bound!("refract", "offset of a slab, of its thickness", 1e-5);
        let index = 1.5_f64;
        for degrees in [0.0, 1e-6, 1e-3, 1.0, 30.0, 45.0, 60.0, 89.0, 89.99, 89.999_9, 90.0_f64] {
            let angle = degrees.to_radians();
            let incident = Vec3::new(angle.sin() as f32, 0.0, -angle.cos() as f32);
            let inside = refract(incident, Vec3::Z, index as f32).unwrap();
            let cosine = f64::from(-incident.z);
            let expected = 1.0 - cosine / (index * index - 1.0 + cosine * cosine).sqrt();
            // Similar triangles: cosine over sine before, over cosine over sine within, with the sines' ratio r.
            let offset = 1.0 - cosine / (index * f64::from(-inside.z));
            slab.see((offset - expected).abs(), degrees);
        }
    }

    #[test]
    fn a_metal_without_absorption_is_a_dielectric() {
        for step in 0..=100 {
            let cos_i = step as f32 / 100.0;
            for eta in [0.7_f32, 1.0, 1.33, 2.4] {
                let metal = fresnel_conductor(cos_i, eta, 0.0);
                let glass = fresnel_dielectric(cos_i, eta);
                assert!((metal - glass).abs() < 2e-4, "cos {cos_i} eta {eta}: {metal} {glass}");
            }
        }
    }

    /// Offset t (1 - c / sqrt(r^2 - 1 + c^2)) along the normal.
    #[test]
    fn refraction_twice_gives_the_offset_of_a_slab() {
        let (thickness, index) = (10.0_f64, 1.5_f64);
        for (degrees, expected) in
            [(0.0, 3.333_333), (30.0, 3.876_276), (45.0, 4.654_775), (60.0, 5.917_517), (89.0, 9.843_919)]
        {
            let angle = f64::to_radians(degrees);
            let incident = Vec3::new(angle.sin() as f32, 0.0, -angle.cos() as f32);
            let inside = refract(incident, Vec3::Z, index as f32).unwrap();
            let lateral = thickness * f64::from(inside.x / -inside.z);
            // The refracted ray seems to come from a point raised by the offset.
            let offset =
                if degrees == 0.0 { thickness * (1.0 - 1.0 / index) } else { thickness - lateral / angle.tan() };
            assert!((offset - expected).abs() < 2e-4 * expected, "{degrees} deg: {offset}");
            let outside = refract(inside, Vec3::Z, 1.0 / index as f32).unwrap();
            assert!((outside - incident).length() < 1e-4);
        }
    }

    proptest! {
        #[test]
        fn reflectance_is_a_fraction(cos_i in 0.0..=1.0_f32, eta in 1e-3..1e3_f32, k in 0.0..1e3_f32) {
            for r in [fresnel_dielectric(cos_i, eta), fresnel_conductor(cos_i, eta, k)] {
                prop_assert!((0.0..=1.0).contains(&r), "{}", r);
            }
            for interface in [Interface::Dielectric { eta }, Interface::Pane { eta }] {
                let sum = interface.reflectance(cos_i) + interface.transmittance(cos_i);
                prop_assert!((sum - Vec3::ONE).abs().max_element() < 1e-6);
                prop_assert!((0.0..=1.0).contains(&interface.reflectance(cos_i).x));
            }
        }

        #[test]
        fn directions_stay_unit(x in -1.0..1.0_f32, y in -1.0..1.0_f32, z in -1.0..0.0_f32, off in -1e-4..1e-4_f32, eta in 0.4..2.5_f32) {
            let incident = Vec3::new(x, y, z).normalize_or(-Vec3::Z) * (1.0 + off);
            let normal = Vec3::Z * (1.0 - off);
            prop_assert!((reflect(incident, normal).length() - 1.0).abs() < 1e-5);
            if let Some(refracted) = refract(incident, normal, eta) {
                prop_assert!((refracted.length() - 1.0).abs() < 1e-5);
                prop_assert!(refracted.z <= 1e-3);
            }
        }
    }
}
