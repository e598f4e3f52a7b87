//! How a surface bends: its shape operator, three numbers in a basis of its tangent plane.
//!
//! A solid's exit surface is met, for a moved head, where the frame has no texel: the client continues it from the
//! nearest one as a quadric (`client/src/warp/exit.rs`) and needs for that how its normal turns. The server knows it
//! exactly, the codec sends it, so basis and signs stand here, for both.
//!
//! **Convention.** For a step x along the tangent plane the normal n becomes `n + S x` to first order: S is the
//! derivative of the normal, in 1/m. The normal is the one on the side the ray comes from. So a ball of radius r is
//! `+1/r` in every direction from outside and `-1/r` from inside, a plane is 0, and seen from the other side every
//! S changes its sign. S is symmetric: `s11` and `s22` stand along the tangents of [`tangents`], `s12` across.
//!
//! Limits: first order. The basis jumps where the normal's z changes sign, so S means nothing without the very normal it
//! stands for; [`ShapeOperator::turned`] takes it to another. That loses the square of the angle between them.

use glam::{Mat3, Vec3};

/// Largest entry of a shape operator that is sent, per metre: the curvature of a ball of a micrometre.
pub const MAX_CURVATURE_PER_M: f32 = 1e6;

/// Two unit vectors that make a right-handed basis with a unit normal (Duff et al. 2017, "Building an Orthonormal
/// Basis, Revisited").
#[inline(always)]
pub fn tangents(normal: Vec3) -> [Vec3; 2] {
    let sign = if normal.z < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    [
        Vec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
        Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
    ]
}

/// The shape operator of a surface at a point, per metre.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShapeOperator {
    /// Along the first tangent.
    pub s11: f32,
    /// Across.
    pub s12: f32,
    /// Along the second tangent.
    pub s22: f32,
}

impl ShapeOperator {
    /// That of a plane.
    pub const FLAT: ShapeOperator = ShapeOperator { s11: 0.0, s12: 0.0, s22: 0.0 };

    /// Of a surface with this unit normal, from the derivative of that normal: `gradient * x` is how it turns along
    /// x. What is left of the derivative across the surface is dropped, and what is not symmetric averaged.
    pub fn of_gradient(normal: Vec3, gradient: Mat3) -> ShapeOperator {
        let [t, b] = tangents(normal);
        let (along_t, along_b) = (gradient * t, gradient * b);
        ShapeOperator { s11: t.dot(along_t), s12: 0.5 * (t.dot(along_b) + b.dot(along_t)), s22: b.dot(along_b) }
    }

    /// The same surface in the basis of another normal, a little tilted.
    #[inline]
    pub fn turned(self, from: Vec3, to: Vec3) -> ShapeOperator {
        let ShapeOperator { s11, s12, s22 } = self;
        if s12 == 0.0 && s11 == s22 {
            // Alike in every direction, and so in every basis.
            return self;
        }
        let ([t, b], [u, v]) = (tangents(from), tangents(to));
        let (ut, ub, vt, vb) = (u.dot(t), u.dot(b), v.dot(t), v.dot(b));
        let (u1, u2) = (s11 * ut + s12 * ub, s12 * ut + s22 * ub);
        let (v1, v2) = (s11 * vt + s12 * vb, s12 * vt + s22 * vb);
        ShapeOperator { s11: u1 * ut + u2 * ub, s12: u1 * vt + u2 * vb, s22: v1 * vt + v2 * vb }
    }

    /// s11, s12, s22.
    pub fn to_array(self) -> [f32; 3] {
        [self.s11, self.s12, self.s22]
    }

    /// From s11, s12, s22.
    pub fn from_array([s11, s12, s22]: [f32; 3]) -> ShapeOperator {
        ShapeOperator { s11, s12, s22 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn normals() -> impl Iterator<Item = Vec3> {
        (0..400_u16).map(|index| {
            let (z, angle) = (1.0 - 2.0 * (f32::from(index) + 0.5) / 400.0, f32::from(index) * 2.4);
            Vec3::new(angle.cos(), angle.sin(), 0.0) * (1.0 - z * z).sqrt() + Vec3::Z * z
        })
    }

    #[test]
    fn tangents_and_normal_are_a_right_handed_basis() {
        for normal in normals().chain([Vec3::Z, -Vec3::Z, Vec3::X, Vec3::Y]) {
            let [t, b] = tangents(normal);
            assert!((t.cross(b) - normal).length() < 1e-6, "{normal}: {t} {b}");
            assert!(t.is_normalized() && b.is_normalized());
        }
    }

    #[test]
    fn a_cylinder_bends_around_its_axis_and_not_along_it_in_any_basis() {
        // Outward normals across +Y: the gradient is (1 - y y - n n) / r.
        let radius = 0.25;
        for index in 0..100_u16 {
            let (sine, cosine) = (f32::from(index) * 0.37).sin_cos();
            let normal = Vec3::new(cosine, 0.0, sine);
            let around = Vec3::new(-sine, 0.0, cosine);
            let gradient = Mat3::from_cols(around * around.x, around * around.y, around * around.z) * (1.0 / radius);
            let shape = ShapeOperator::of_gradient(normal, gradient);
            let [t, b] = tangents(normal);
            let turns = |x: Vec3| {
                let (x, y) = (x.dot(t), x.dot(b));
                (shape.s11 * x + shape.s12 * y) * t + (shape.s12 * x + shape.s22 * y) * b
            };
            assert!((turns(around) - around / radius).length() < 1e-5, "{shape:?}");
            assert!(turns(Vec3::Y).length() < 1e-5, "{shape:?}");
        }
    }

    #[test]
    fn turned_to_a_normal_beside_it_a_shape_says_the_same_of_every_direction() {
        let shape = ShapeOperator { s11: 3.0, s12: -1.5, s22: -0.5 };
        let say = |shape: ShapeOperator, normal: Vec3, along: Vec3| {
            let [t, b] = tangents(normal);
            let (x, y) = (along.dot(t), along.dot(b));
            shape.s11 * x * x + 2.0 * shape.s12 * x * y + shape.s22 * y * y
        };
        for normal in normals() {
            // Over the jump of the basis at z = 0 as well: the tilt is 0.3 degrees, its square 3e-5.
            let to = (normal + Vec3::new(0.003, -0.002, 0.004)).normalize();
            let turned = shape.turned(normal, to);
            for angle in [0.0_f32, 0.7, 1.9] {
                let [t, b] = tangents(to);
                let along = angle.cos() * t + angle.sin() * b;
                let (was, is) = (say(shape, normal, along), say(turned, to, along));
                assert!((was - is).abs() < 3e-4, "{normal} {angle}: {was} {is}");
            }
            assert_eq!(shape.turned(normal, normal).to_array().map(|s| (s * 1e3).round()), [3e3, -1.5e3, -0.5e3]);
        }
        let ball = ShapeOperator { s11: -2.0, s12: 0.0, s22: -2.0 };
        assert_eq!(ball.turned(Vec3::Z, Vec3::X), ball);
    }
}
