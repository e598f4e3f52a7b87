//! Metals by name: their complex index of refraction for red, green and blue.
//!
//! Source: the tables of the SOPRA and Palik collections, weighted with the CIE observer into linear sRGB,
//! with the values that Mitsuba and Tungsten users know. Accurate to some percent of reflectance.

use glam::Vec3;

/// (name, eta, k)
const METALS: [(&str, [f32; 3], [f32; 3]); 6] = [
    ("aluminium", [1.657_46, 0.880_37, 0.521_23], [9.223_87, 6.269_52, 4.837_00]),
    ("chromium", [4.369_68, 2.916_70, 1.654_70], [5.206_43, 4.231_36, 3.754_95]),
    ("copper", [0.200_44, 0.924_03, 1.102_21], [3.912_95, 2.452_85, 2.142_19]),
    ("gold", [0.143_12, 0.374_96, 1.442_48], [3.983_16, 2.385_72, 1.603_22]),
    ("silver", [0.155_26, 0.116_72, 0.138_38], [4.828_34, 3.122_25, 2.147_05]),
    ("tungsten", [4.370_68, 3.300_16, 2.998_20], [3.500_63, 2.604_77, 2.273_10]),
];

/// Real and imaginary part of the index of refraction of a metal; `None` for a name that is not known.
pub(super) fn metal(name: &str) -> Option<(Vec3, Vec3)> {
    let &(_, eta, k) = METALS.iter().find(|(known, ..)| *known == name)?;
    Some((Vec3::from_array(eta), Vec3::from_array(k)))
}

/// All names, for messages.
pub(super) fn metal_names() -> String {
    METALS.map(|(name, ..)| name).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ((eta - 1)^2 + k^2) / ((eta + 1)^2 + k^2), per channel.
    fn reflectance_at_normal_incidence(name: &str) -> Vec3 {
        let (eta, k) = metal(name).unwrap();
        ((eta - 1.0) * (eta - 1.0) + k * k) / ((eta + 1.0) * (eta + 1.0) + k * k)
    }

    #[test]
    fn metals_have_their_colours() {
        let gold = reflectance_at_normal_incidence("gold");
        assert!(gold.x > 0.9 && gold.z < 0.45 && gold.y < gold.x, "{gold}");
        let copper = reflectance_at_normal_incidence("copper");
        assert!(copper.x > 0.9 && copper.y < 0.7 && copper.z < 0.6, "{copper}");
        for (name, low, high) in [("silver", 0.88, 1.0), ("aluminium", 0.85, 0.95), ("chromium", 0.5, 0.75)] {
            let found = reflectance_at_normal_incidence(name);
            assert!(found.min_element() > low && found.max_element() < high, "{name}: {found}");
        }
        assert_eq!(metal("unobtainium"), None);
    }
}
