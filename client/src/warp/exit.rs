//! Leaving a solid: where a ray meets the surface of a node, known by its point, normal and shape at one texel.
//!
//! Searching the node's own picture for the exit point fails where that picture folds, at about 50 degrees of
//! incidence on a ball. Instead the surface about a point P is taken as the quadric
//! `n . x + x_t . S x_t / 2 = 0`, x measured from P, x_t its part along the tangent plane, and S the shape operator, three
//! numbers in a basis of that plane (Duff et al. 2017). The normal is then `n + S x_t`. An error of S of 1 % costs
//! 0.02 degrees behind a glass ball.
//!
//! S is the server's, where the frame's format carries it: exact, but in the basis of the normal that was sent, from which
//! [`turned`] takes it to that of the filtered one. Without, it comes from differences of points and normals of the
//! picture, [`shape_operator`]: dearer, and noisier by twice the error (docs/measurements).

use crate::lanes::{Floats, Mask, Vector};

/// Newton steps after the plane: the second leaves less than rounding for what the head moves between frames.
const NEWTON_STEPS: usize = 2;

/// Two unit vectors that make a right-handed basis with a unit normal: the lanes of
/// [`warplight_protocol::curvature::tangents`] (Duff et al. 2017).
#[inline(always)]
pub(super) fn tangents<F: Floats>(normal: Vector<F>) -> [Vector<F>; 2] {
    let [x, y, z] = normal.0;
    let one = F::splat(1.0);
    let sign = (-one).or(z.lt(F::zero()), one);
    let a = -one / (sign + z);
    let b = x * y * a;
    [Vector([sign.mul_add(x * x * a, one), sign * b, -(sign * x)]), Vector([b, (y * y).mul_add(a, sign), -y])]
}

/// The shape operator of a surface with this normal, from the differences of point and normal along two directions:
/// its entries along the first tangent, across, and along the second. Zero, a plane, where the two are parallel.
#[inline(always)]
pub(super) fn shape_operator<F: Floats>(normal: Vector<F>, differences: [(Vector<F>, Vector<F>); 2]) -> [F; 3] {
    let [t, b] = tangents(normal);
    let [(p, m), (q, n)] = differences;
    let (p0, p1, q0, q1) = (p.dot(t), p.dot(b), q.dot(t), q.dot(b));
    let (m0, m1, n0, n1) = (m.dot(t), m.dot(b), n.dot(t), n.dot(b));
    let determinant = p0 * q1 - p1 * q0;
    let scale = p.dot(p).max(q.dot(q));
    let is_basis = (scale * F::splat(1e-3)).lt(determinant.abs());
    let over = (F::splat(1.0) / determinant).or(is_basis, F::zero());
    let across = ((n0 * p0 - m0 * q0) + (m1 * q1 - n1 * p1)) * F::splat(0.5) * over;
    [(m0 * q1 - n0 * p1) * over, across, (n1 * p0 - m1 * q0) * over]
}

/// A shape operator in the basis of one normal, taken to that of another one beside it; see
/// [`warplight_protocol::curvature::ShapeOperator::turned`].
#[inline(always)]
pub(super) fn turned<F: Floats>([s11, s12, s22]: [F; 3], from: Vector<F>, to: Vector<F>) -> [F; 3] {
    let ([t, b], [u, v]) = (tangents(from), tangents(to));
    let (ut, ub, vt, vb) = (u.dot(t), u.dot(b), v.dot(t), v.dot(b));
    let (u1, u2) = (s11.mul_add(ut, s12 * ub), s12.mul_add(ut, s22 * ub));
    let (v1, v2) = (s11.mul_add(vt, s12 * vb), s12.mul_add(vt, s22 * vb));
    [u1.mul_add(ut, u2 * ub), u1.mul_add(vt, u2 * vb), v1.mul_add(vt, v2 * vb)]
}

/// A surface about a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Quadric<F: Floats> {
    pub(super) point: Vector<F>,
    pub(super) normal: Vector<F>,
    pub(super) shape: [F; 3],
}

impl<F: Floats> Quadric<F> {
    /// Where a ray meets it, the normal there, and whether it does so ahead and from the normal's side.
    #[inline(always)]
    pub(super) fn meet(&self, origin: Vector<F>, direction: Vector<F>) -> (Vector<F>, Vector<F>, F::Mask) {
        let [t, b] = tangents(self.normal);
        let from = origin - self.point;
        let [s11, s12, s22] = self.shape;
        // Along the ray, all is linear in its length.
        let (n0, n1) = (from.dot(self.normal), direction.dot(self.normal));
        let (t0, t1) = (from.dot(t), direction.dot(t));
        let (b0, b1) = (from.dot(b), direction.dot(b));
        let against = F::splat(-1e-4);
        let mut length = -n0 / n1.min(against);
        let (mut gx, mut gy) = (F::zero(), F::zero());
        for step in 0..=NEWTON_STEPS {
            let (x, y) = (t1.mul_add(length, t0), b1.mul_add(length, b0));
            (gx, gy) = (s11 * x + s12 * y, s12 * x + s22 * y);
            if step == NEWTON_STEPS {
                break;
            }
            let height = n1.mul_add(length, n0) + F::splat(0.5) * (gx * x + gy * y);
            let slope = n1 + gx * t1 + gy * b1;
            length = length - height / slope.min(against);
        }
        let normal = self.normal.along(t, gx).along(b, gy).normalize();
        let is_met = F::zero().lt(length) & normal.dot(direction).lt(against) & length.lt(F::splat(f32::MAX));
        (origin.along(direction, length), normal, is_met)
    }
}

/// Where all of some conditions hold.
#[inline(always)]
pub(super) fn all<M: Mask, const N: usize>(conditions: [M; N]) -> M {
    let mut all = conditions[0];
    for condition in conditions {
        all = all & condition;
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Portable;
    use glam::Vec3;
    use warplight_protocol::curvature::{self, ShapeOperator};

    fn splat(vector: Vec3) -> Vector<Portable> {
        Vector::splat(vector)
    }

    fn first(vector: Vector<Portable>) -> Vec3 {
        Vec3::from_array(vector.0.map(|axis| axis.lanes()[0]))
    }

    #[test]
    fn tangents_and_turns_are_those_of_the_protocol() {
        let shape = ShapeOperator { s11: 3.0, s12: -1.5, s22: -0.5 };
        for normal in
            [Vec3::Z, -Vec3::Z, Vec3::X, Vec3::new(1.0, -2.0, -1e-4).normalize(), Vec3::new(0.3, 0.2, 0.9).normalize()]
        {
            let expected = curvature::tangents(normal);
            for (lanes, plain) in tangents(splat(normal)).map(first).into_iter().zip(expected) {
                assert!((lanes - plain).length() < 1e-6, "{normal}: {lanes} {plain}");
            }
            let to = (normal + Vec3::new(1e-3, 2e-3, 2e-3)).normalize();
            let turned = turned(shape.to_array().map(Portable::splat), splat(normal), splat(to));
            for (lanes, plain) in turned.into_iter().zip(shape.turned(normal, to).to_array()) {
                assert!((lanes.lanes()[0] - plain).abs() < 1e-5, "{normal}: {} {plain}", lanes.lanes()[0]);
            }
        }
    }

    #[test]
    fn a_balls_shape_is_one_over_its_radius_and_a_ray_meets_it_there() {
        // From inside, the normal points inwards, and turns against the direction it is moved in.
        let radius = 0.5_f32;
        let on_ball = |x: f32, y: f32| Vec3::new(x, y, -1.0).normalize() * radius;
        let (point, normal) = (on_ball(0.1, -0.2), -on_ball(0.1, -0.2) / radius);
        let difference = |x: f32, y: f32| {
            let (a, b) = (on_ball(0.1 + x, -0.2 + y), on_ball(0.1 - x, -0.2 - y));
            (splat(a - b), splat((b - a) / radius))
        };
        let shape = shape_operator(splat(normal), [difference(1e-2, 0.0), difference(0.0, 1e-2)]);
        let [s11, s12, s22] = shape.map(|entry| entry.lanes()[0]);
        assert!((s11 + 2.0).abs() < 1e-3 && s12.abs() < 1e-3 && (s22 + 2.0).abs() < 1e-3, "{s11} {s12} {s22}");
        // A ray through the ball meets its far side where the closed form says.
        let quadric = Quadric { point: splat(point), normal: splat(normal), shape };
        let origin = Vec3::new(0.06, 0.02, 0.3);
        let direction = (point + Vec3::new(0.01, -0.015, 0.0) - origin).normalize();
        let along = origin.dot(direction);
        let length = -along + (along * along - origin.length_squared() + radius * radius).sqrt();
        let (met, normal, is_met) = quadric.meet(splat(origin), splat(direction));
        let expected = origin + direction * length;
        assert_eq!(is_met.bits() & 1, 1);
        assert!((first(met) - expected).length() < 1e-5, "{} {expected}", first(met));
        assert!((first(normal) + expected / radius).length() < 2e-3);
    }
}
