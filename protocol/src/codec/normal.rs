//! Unit vectors as two integers: the octahedral map (Meyer et al. 2010; survey: Cigolle et al. 2014).
//!
//! With 12 bits each the worst error is 0.06 degrees. The codes of neighbouring normals are
//! neighbours, but for the seams of the lower hemisphere.

use crate::frame::NodeRows;
use glam::{Vec2, Vec3};

/// The codes of a normal plane; where `has_interface` is false they are meaningless.
pub(crate) fn quantise_plane(bits: u8, planes: &NodeRows<'_>, has_interface: &[bool], codes: &mut [Vec<u32>; 3]) {
    let [first, second, _] = codes;
    first.clear();
    second.clear();
    let [x, y, z] = &planes.normal;
    for (((&x, &y), &z), &has_interface) in x.iter().zip(y.iter()).zip(z.iter()).zip(has_interface) {
        let [a, b] = if has_interface { quantise(Vec3::new(x, y, z), bits) } else { [0, 0] };
        first.push(a);
        second.push(b);
    }
}

/// Writes the unit vectors of a plane of codes.
pub(crate) fn dequantise_plane(bits: u8, codes: &[Vec<u32>; 3], planes: &mut NodeRows<'_>) {
    let [x, y, z] = &mut planes.normal;
    let axes = x.iter_mut().zip(y.iter_mut()).zip(z.iter_mut());
    for (((x, y), z), (&a, &b)) in axes.zip(codes[0].iter().zip(&codes[1])) {
        [*x, *y, *z] = dequantise([a, b], bits).to_array();
    }
}

/// The two codes of a unit vector; the zero vector and what is no number become +Z.
pub(crate) fn quantise(normal: Vec3, bits: u8) -> [u32; 2] {
    let sum = normal.x.abs() + normal.y.abs() + normal.z.abs();
    // Written so that NaN falls through as well.
    let unit = if sum > 1e-20 && sum.is_finite() { normal / sum } else { Vec3::Z };
    let folded = if unit.z >= 0.0 { unit.truncate() } else { fold(unit.truncate()) };
    let largest = ((1_u32 << bits) - 2) as f32;
    // Codes 0 to 2^bits - 2, so that the axes have codes of their own.
    let code = |value: f32| ((value * 0.5 + 0.5) * largest + 0.5).min(largest) as u32;
    [code(folded.x), code(folded.y)]
}

/// The unit vector of two codes, each below 2^bits.
pub(crate) fn dequantise(codes: [u32; 2], bits: u8) -> Vec3 {
    let largest = ((1_u32 << bits) - 2) as f32;
    let value = |code: u32| (code as i32 as f32 / largest).min(1.0) * 2.0 - 1.0;
    let (u, v) = (value(codes[0]), value(codes[1]));
    let z = 1.0 - u.abs() - v.abs();
    // Beyond the diagonals the square is folded under: each coordinate shrinks by as much as z is below 0. So
    // written, without a branch, the plane is done four pixels at a time; the length is at least 1/sqrt(3).
    let under = (-z).max(0.0);
    let (x, y) = (u - under.copysign(u), v - under.copysign(v));
    let length = (x * x + y * y + z * z).sqrt();
    Vec3::new(x / length, y / length, z / length)
}

/// Folds the lower hemisphere into the outer triangles of the square, and back.
fn fold(v: Vec2) -> Vec2 {
    Vec2::new((1.0 - v.y.abs()) * 1.0_f32.copysign(v.x), (1.0 - v.x.abs()) * 1.0_f32.copysign(v.y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_error_halves_with_every_bit(x in -1.0..1.0_f32, y in -1.0..1.0_f32, z in -1.0..1.0_f32) {
            let normal = Vec3::new(x, y, z);
            prop_assume!(normal.length() > 1e-3);
            let normal = normal.normalize();
            for bits in 6..=14_u8 {
                let back = dequantise(quantise(normal, bits), bits);
                let error_deg = back.cross(normal).length().atan2(back.dot(normal)).to_degrees();
                // Half a step h in each coordinate moves z by up to 2 h, so the point of the octahedron by
                // sqrt(6) h, and the centre of a face is sqrt(3) times as far away on the sphere.
                let half_step = 1.0 / (f32::from(bits).exp2() - 2.0);
                let bound_deg = (18.0_f32.sqrt() * half_step).to_degrees();
                prop_assert!(error_deg < bound_deg * 1.02 + 1e-4, "{} bits: {} deg", bits, error_deg);
            }
        }

        #[test]
        fn any_codes_give_a_unit_vector(a in 0..65536_u32, b in 0..65536_u32, bits in 6..=16_u8) {
            let mask = (1 << bits) - 1;
            let normal = dequantise([a & mask, b & mask], bits);
            prop_assert!((normal.length() - 1.0).abs() < 1e-5);
        }
    }

    /// The fold as Cigolle et al. write it.
    #[test]
    fn the_unfolded_form_is_the_folded_one() {
        for bits in [6, 7] {
            let largest = ((1_u32 << bits) - 2) as f32;
            for (a, b) in (0..1 << bits).flat_map(|a| (0..1 << bits).map(move |b| (a, b))) {
                let square = Vec2::new(a as f32, b as f32).min(Vec2::splat(largest)) / largest * 2.0 - 1.0;
                let z = 1.0 - square.x.abs() - square.y.abs();
                let xy = if z >= 0.0 { square } else { fold(square) };
                let plain = xy.extend(z).normalize();
                assert!((dequantise([a, b], bits) - plain).length() < 1e-6, "{a} {b}");
            }
        }
    }

    #[test]
    fn axes_are_exact() {
        for axis in Vec3::AXES.into_iter().flat_map(|axis| [axis, -axis]) {
            assert!((dequantise(quantise(axis, 12), 12) - axis).length() < 1e-6);
        }
    }

    /// Normals that are undefined.
    #[test]
    fn no_direction_gives_some_direction() {
        for bad in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY] {
            assert!((dequantise(quantise(bad, 12), 12).length() - 1.0).abs() < 1e-6);
        }
    }
}
