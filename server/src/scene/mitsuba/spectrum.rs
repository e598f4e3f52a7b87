//! Spectra to linear sRGB.
//!
//! Method: a sampled spectrum is linear between its samples and zero beyond them; it is weighted with the CIE's
//! 2-degree observer of 1931 (CIE 15:2004, table at 10 nm, linear between), integrated by the trapezoidal rule at 1 nm,
//! divided by the integral of y-bar (106.857 nm), and turned from XYZ to linear sRGB (IEC 61966-2-1). A reflectance,
//! or any other factor, is weighted with the illuminant D65 as well, so that a constant one comes out grey; what
//! emits is not: a constant radiance has the reddish colour of equal energy. Channels below zero, colours outside
//! of sRGB, are cut off. This is what Mitsuba's RGB variants do, at another step; error of the tables' 10 nm: below
//! half a percent for smooth spectra.

use glam::{DMat3, DVec3, Vec3};

/// First wavelength of the tables in nanometres; they have one row for every 10 nm.
const FIRST_NM: f64 = 380.0;

/// x-bar, y-bar, z-bar from 380 to 780 nm.
const OBSERVER: [[f64; 3]; 41] = [
    [0.001368, 0.000039, 0.006450],
    [0.004243, 0.000120, 0.020050],
    [0.014310, 0.000396, 0.067850],
    [0.043510, 0.001210, 0.207400],
    [0.134380, 0.004000, 0.645600],
    [0.283900, 0.011600, 1.385600],
    [0.348280, 0.023000, 1.747060],
    [0.336200, 0.038000, 1.772110],
    [0.290800, 0.060000, 1.669200],
    [0.195360, 0.090980, 1.287640],
    [0.095640, 0.139020, 0.812950],
    [0.032010, 0.208020, 0.465180],
    [0.004900, 0.323000, 0.272000],
    [0.009300, 0.503000, 0.158200],
    [0.063270, 0.710000, 0.078250],
    [0.165500, 0.862000, 0.042160],
    [0.290400, 0.954000, 0.020300],
    [0.433450, 0.994950, 0.008750],
    [0.594500, 0.995000, 0.003900],
    [0.762100, 0.952000, 0.002100],
    [0.916300, 0.870000, 0.001650],
    [1.026300, 0.757000, 0.001100],
    [1.062200, 0.631000, 0.000800],
    [1.002600, 0.503000, 0.000340],
    [0.854450, 0.381000, 0.000190],
    [0.642400, 0.265000, 0.000050],
    [0.447900, 0.175000, 0.000020],
    [0.283500, 0.107000, 0.0],
    [0.164900, 0.061000, 0.0],
    [0.087400, 0.032000, 0.0],
    [0.046770, 0.017000, 0.0],
    [0.022700, 0.008210, 0.0],
    [0.011359, 0.004102, 0.0],
    [0.005790, 0.002091, 0.0],
    [0.002899, 0.001047, 0.0],
    [0.001440, 0.000520, 0.0],
    [0.000690, 0.000249, 0.0],
    [0.000332, 0.000120, 0.0],
    [0.000166, 0.000060, 0.0],
    [0.000083, 0.000030, 0.0],
    [0.000042, 0.000015, 0.0],
];

/// Relative power of the illuminant D65 from 380 to 780 nm.
const D65: [f64; 41] = [
    49.9755, 54.6482, 82.7549, 91.4860, 93.4318, 86.6823, 104.865, 117.008, 117.812, 114.861, 115.923, 108.811,
    109.354, 107.802, 104.790, 107.689, 104.405, 104.046, 100.000, 96.3342, 95.7880, 88.6856, 90.0062, 89.5991,
    87.6987, 83.2886, 83.6992, 80.0268, 80.2146, 82.2778, 78.2842, 69.7213, 71.6091, 74.3490, 61.6040, 69.8856,
    75.0870, 63.5927, 46.4182, 66.8054, 63.3828,
];

/// What the spectrum is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// A factor from 0 to 1: seen in the light of D65.
    Reflectance,
    /// Another factor, such as an index of refraction.
    Factor,
    /// Light.
    Emission,
}

/// The colour of a spectrum given by samples (wavelength in nanometres, ascending; value).
pub(super) fn color_of_samples(samples: &[(f64, f64)], role: Role) -> Vec3 {
    color_of(
        |wavelength_nm| {
            let above = samples.partition_point(|&(at, _)| at < wavelength_nm);
            match (above.checked_sub(1).map(|below| samples[below]), samples.get(above)) {
                (_, Some(&(at, value))) if at == wavelength_nm => value,
                (Some((start, from)), Some(&(end, to))) => from + (to - from) * (wavelength_nm - start) / (end - start),
                _ => 0.0,
            }
        },
        role,
    )
}

/// The colour of the same value at all wavelengths.
pub(super) fn color_of_constant(value: f64, role: Role) -> Vec3 {
    if role == Role::Emission { color_of(|_| value, role) } else { Vec3::splat(value as f32) }
}

/// The colour of a black body of this temperature in kelvin: radiance in watts per square metre, steradian and
/// nanometre, by Planck's law.
pub(super) fn color_of_black_body(kelvin: f64) -> Vec3 {
    /// 2 h c^2 in W m^2, and h c / k in m K.
    const C1: f64 = 1.191_042_972e-16;
    const C2: f64 = 1.438_776_877e-2;
    color_of(
        |wavelength_nm| {
            let metres = wavelength_nm * 1e-9;
            C1 * metres.powi(-5) / ((C2 / (metres * kelvin)).exp_m1()) * 1e-9
        },
        Role::Emission,
    )
}

fn color_of(spectrum: impl Fn(f64) -> f64, role: Role) -> Vec3 {
    let (mut sum, mut white) = (DVec3::ZERO, 0.0);
    let last = (OBSERVER.len() - 1) * 10;
    for step in 0..=last {
        let (row, within) = (step / 10, (step % 10) as f64 / 10.0);
        let next = (row + 1).min(OBSERVER.len() - 1);
        let observer = DVec3::from_array(OBSERVER[row]).lerp(DVec3::from_array(OBSERVER[next]), within);
        let light = if role == Role::Emission { 1.0 } else { D65[row] + (D65[next] - D65[row]) * within };
        let part = if step == 0 || step == last { 0.5 } else { 1.0 };
        sum += observer * (light * part * spectrum(FIRST_NM + step as f64));
        white += observer.y * light * part;
    }
    let color = (srgb_from_xyz() * (sum / white)).max(DVec3::ZERO).as_vec3();
    if role == Role::Reflectance { color.min(Vec3::ONE) } else { color }
}

/// IEC 61966-2-1.
fn srgb_from_xyz() -> DMat3 {
    DMat3::from_cols_array_2d(&[
        [3.240479, -0.969256, 0.055648],
        [-1.537150, 1.875991, -0.204043],
        [-0.498535, 0.041556, 1.057311],
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_have_the_integrals_that_are_published() {
        let sum = |channel: usize| OBSERVER.iter().map(|row| row[channel]).sum::<f64>() * 10.0;
        // CIE 15:2004: equal energy has x = y = 1/3, and the integral of y-bar is 106.857 nm.
        for channel in 0..3 {
            assert!((sum(channel) / 106.857 - 1.0).abs() < 1e-3, "{channel}: {}", sum(channel));
        }
        let white = (0..3).map(|c| OBSERVER.iter().zip(&D65).map(|(row, light)| row[c] * light).sum::<f64>());
        let white: Vec<f64> = white.collect();
        assert!(
            (white[0] / white[1] - 0.9504).abs() < 2e-3 && (white[2] / white[1] - 1.0888).abs() < 2e-3,
            "{white:?}"
        );
    }

    #[test]
    fn a_constant_reflectance_is_grey_and_a_constant_radiance_is_of_equal_energy() {
        let samples = [(300.0, 0.78), (500.0, 0.78), (900.0, 0.78)];
        let grey = color_of_samples(&samples, Role::Reflectance);
        assert!((grey - Vec3::splat(0.78)).abs().max_element() < 0.003, "{grey}");
        assert_eq!(color_of_constant(0.5, Role::Reflectance), Vec3::splat(0.5));
        let equal = color_of_constant(1.0, Role::Emission);
        assert!((equal - Vec3::new(1.2048, 0.9483, 0.9089)).abs().max_element() < 2e-3, "{equal}");
    }

    #[test]
    fn narrow_bands_have_their_colours_and_nothing_is_negative() {
        let band = |at: f64| color_of_samples(&[(at - 5.0, 0.0), (at, 1.0), (at + 5.0, 0.0)], Role::Emission);
        assert!(band(620.0).x > 0.01 && band(620.0).z == 0.0);
        assert!(band(540.0).y > 0.01 && band(540.0).x == 0.0);
        assert!(band(450.0).z > 0.01 && band(450.0).y == 0.0);
        assert_eq!(color_of_samples(&[], Role::Emission), Vec3::ZERO);
        assert_eq!(color_of_samples(&[(200.0, 1.0), (300.0, 1.0)], Role::Emission), Vec3::ZERO);
    }

    #[test]
    fn hotter_bodies_are_bluer_and_daylight_is_near_white() {
        let [candle, day, sky] = [1900.0, 6500.0, 15_000.0].map(color_of_black_body);
        assert!(candle.x > 5.0 * candle.z && sky.z > 1.3 * sky.x);
        assert!((day / day.y - 1.0).abs().max_element() < 0.1, "{day}");
    }
}
