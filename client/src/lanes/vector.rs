//! Three-vectors of lanes, and the optics of rays on them.

use super::{Floats, Mask};
use glam::Vec3;
use std::ops::{Add, Mul, Sub};

/// One vector of space per lane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vector<F>(pub(crate) [F; 3]);

impl<F: Floats> Add for Vector<F> {
    type Output = Vector<F>;
    #[inline(always)]
    fn add(self, other: Vector<F>) -> Vector<F> {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Vector([a + x, b + y, c + z])
    }
}

impl<F: Floats> Sub for Vector<F> {
    type Output = Vector<F>;
    #[inline(always)]
    fn sub(self, other: Vector<F>) -> Vector<F> {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Vector([a - x, b - y, c - z])
    }
}

impl<F: Floats> Mul<F> for Vector<F> {
    type Output = Vector<F>;
    #[inline(always)]
    fn mul(self, factor: F) -> Vector<F> {
        let [x, y, z] = self.0;
        Vector([x * factor, y * factor, z * factor])
    }
}

impl<F: Floats> Vector<F> {
    /// The same vector in every lane.
    #[inline(always)]
    pub(crate) fn splat(vector: Vec3) -> Vector<F> {
        Vector([F::splat(vector.x), F::splat(vector.y), F::splat(vector.z)])
    }

    #[inline(always)]
    pub(crate) fn dot(self, other: Vector<F>) -> F {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        a.mul_add(x, b.mul_add(y, c * z))
    }

    #[inline(always)]
    pub(crate) fn cross(self, other: Vector<F>) -> Vector<F> {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Vector([b * z - c * y, c * x - a * z, a * y - b * x])
    }

    /// `self + factor * direction`.
    #[inline(always)]
    pub(crate) fn along(self, direction: Vector<F>, factor: F) -> Vector<F> {
        let ([a, b, c], [x, y, z]) = (self.0, direction.0);
        Vector([x.mul_add(factor, a), y.mul_add(factor, b), z.mul_add(factor, c)])
    }

    /// Of unit length; zero stays as it is.
    #[inline(always)]
    pub(crate) fn normalize(self) -> Vector<F> {
        self * (F::splat(1.0) / self.dot(self).max(F::splat(f32::MIN_POSITIVE)).sqrt())
    }

    /// `self` where `mask`, else `other`.
    #[inline(always)]
    pub(crate) fn or(self, mask: F::Mask, other: Vector<F>) -> Vector<F> {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Vector([a.or(mask, x), b.or(mask, y), c.or(mask, z)])
    }

    /// This direction mirrored about a unit normal.
    #[inline(always)]
    pub(crate) fn reflect(self, normal: Vector<F>) -> Vector<F> {
        let twice = F::splat(-2.0) * self.dot(normal);
        self.along(normal, twice).normalize()
    }

    /// This direction refracted at a unit normal against it, `eta` being the index beyond over the index before;
    /// and where there is such a ray: elsewhere reflection is total, and the direction has no meaning.
    #[inline(always)]
    pub(crate) fn refract(self, normal: Vector<F>, eta: F) -> (Vector<F>, F::Mask) {
        let one = F::splat(1.0);
        let over = one / eta;
        let cos_i = (-self.dot(normal)).within(0.0, 1.0);
        let sin2_t = (one - cos_i * cos_i) * over * over;
        let cos_t = (one - sin2_t).max(F::zero()).sqrt();
        let direction = (self * over).along(normal, cos_i * over - cos_t);
        (direction.normalize(), sin2_t.lt(one))
    }

    /// Whether any lane of the mask is set and so the vector is of use; a shorthand of early exits.
    #[inline(always)]
    pub(crate) fn any(mask: F::Mask) -> bool {
        mask.any()
    }
}
