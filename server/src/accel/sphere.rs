//! Ray against sphere, stable for distant and for very large spheres.
//!
//! Method: the discriminant from the ray's closest approach (Hearn and Baker; Haines et al. 2019, "Precision
//! Improvements for Ray/Sphere Intersection", Ray Tracing Gems 7) and the smaller root from the product of
//! the two, so nothing cancels; in f64, so that a hit lies on the sphere to f32 from wherever it is seen, and
//! its box need not know how far the ray came. Both sides are hit.

use glam::Vec3;

/// Distance of the first hit above 0, in units of the direction's length.
pub(super) fn hit_sphere(origin: Vec3, direction: Vec3, centre: Vec3, radius: f32) -> Option<f32> {
    let direction = direction.as_dvec3();
    let from_centre = origin.as_dvec3() - centre.as_dvec3();
    let radius2 = f64::from(radius) * f64::from(radius);
    // Unit to f32 only.
    let inverse_length2 = 1.0 / direction.length_squared();
    let to_closest = -from_centre.dot(direction) * inverse_length2;
    let closest = from_centre + to_closest * direction;
    let half_chord2 = (radius2 - closest.length_squared()) * inverse_length2;
    if half_chord2 < 0.0 {
        return None;
    }
    let outside = (from_centre.length_squared() - radius2) * inverse_length2;
    let root = half_chord2.sqrt();
    let far_from_zero = if to_closest >= 0.0 { to_closest + root } else { to_closest - root };
    // A grazing ray from the surface itself divides zero by zero; NaN fails the comparisons below.
    let other = outside / far_from_zero;
    let (near, far) = if to_closest >= 0.0 { (other, far_from_zero) } else { (far_from_zero, other) };
    [near as f32, far as f32].into_iter().find(|&distance| distance > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_hit_from_outside_and_from_inside() {
        let hit = |origin| hit_sphere(origin, Vec3::Z, Vec3::new(0.0, 0.0, 5.0), 2.0);
        assert_eq!(hit(Vec3::ZERO), Some(3.0));
        assert_eq!(hit(Vec3::new(0.0, 0.0, 5.0)), Some(2.0));
        assert_eq!(hit(Vec3::new(0.0, 0.0, 8.0)), None);
        assert_eq!(hit(Vec3::new(2.1, 0.0, 0.0)), None);
    }

    /// 1e-6 and 1e6 scale, 10 km from the origin.
    #[test]
    fn small_and_far_spheres_are_hit_where_they_are() {
        for (distance, radius) in [(1.0, 1e-6), (1e4, 1e-1), (1e6, 1e5), (1e-3, 1e-6_f32)] {
            let direction = Vec3::new(0.36, 0.48, 0.8);
            let found = hit_sphere(Vec3::ZERO, direction, direction * distance, radius).unwrap();
            assert!(
                (found - (distance - radius)).abs() < 4.0 * f32::EPSILON * distance,
                "{distance} {radius}: {found}"
            );
        }
    }
}
