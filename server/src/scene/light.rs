//! Lights without extent: they are never met by a ray, only drawn.

use glam::{DAffine3, Vec3};

/// How the beam of a spot light fades between its inner and its outer angle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Falloff {
    /// Linearly in the angle (Mitsuba).
    LinearInAngle,
    /// As the square of a linear function of the cosine (KHR_lights_punctual).
    SquaredInCosine,
}

/// The closed set of lights without extent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Light {
    /// The same to all sides.
    Point {
        /// In world, in metres.
        position: Vec3,
        /// Radiant intensity: irradiance at one metre (linear RGB).
        intensity: Vec3,
    },
    /// A cone.
    Spot {
        /// In world, in metres.
        position: Vec3,
        /// Unit direction of the middle of the beam.
        axis: Vec3,
        /// Radiant intensity in the middle of the beam.
        intensity: Vec3,
        /// Angle from the axis up to which the beam is full.
        inner_rad: f32,
        /// Angle from the axis beyond which there is none; above `inner_rad`.
        outer_rad: f32,
        /// In between.
        falloff: Falloff,
    },
    /// Parallel rays from infinitely far away.
    Directional {
        /// Unit direction in which the light travels.
        direction: Vec3,
        /// On a surface across the direction (linear RGB).
        irradiance: Vec3,
    },
}

impl Light {
    /// Radiant intensity, or irradiance where it is directional, in its brightest direction.
    pub fn strength(&self) -> Vec3 {
        match *self {
            Light::Point { intensity, .. } | Light::Spot { intensity, .. } => intensity,
            Light::Directional { irradiance, .. } => irradiance,
        }
    }

    /// Radiant intensity of a light with a position into a unit direction; of a directional one its irradiance.
    pub fn towards(&self, direction: Vec3) -> Vec3 {
        match *self {
            Light::Point { intensity, .. } => intensity,
            Light::Directional { irradiance, .. } => irradiance,
            Light::Spot { axis, intensity, inner_rad, outer_rad, falloff, .. } => {
                let cosine = axis.dot(direction).clamp(-1.0, 1.0);
                intensity * falloff.of(cosine, inner_rad, outer_rad)
            }
        }
    }
}

impl Light {
    /// Moved and turned, its strength unchanged by scale.
    pub(super) fn moved(self, world_from_part: &DAffine3) -> Light {
        let point = |point: Vec3| world_from_part.transform_point3(point.as_dvec3()).as_vec3();
        let turn =
            |direction: Vec3| world_from_part.transform_vector3(direction.as_dvec3()).as_vec3().normalize_or(direction);
        match self {
            Light::Point { position, intensity } => Light::Point { position: point(position), intensity },
            Light::Spot { position, axis, intensity, inner_rad, outer_rad, falloff } => {
                Light::Spot { position: point(position), axis: turn(axis), intensity, inner_rad, outer_rad, falloff }
            }
            Light::Directional { direction, irradiance } => {
                Light::Directional { direction: turn(direction), irradiance }
            }
        }
    }
}

impl Falloff {
    fn of(self, cosine: f32, inner_rad: f32, outer_rad: f32) -> f32 {
        match self {
            Falloff::LinearInAngle => {
                let width = (outer_rad - inner_rad).max(f32::EPSILON);
                ((outer_rad - cosine.acos()) / width).clamp(0.0, 1.0)
            }
            Falloff::SquaredInCosine => {
                let (inner, outer) = (inner_rad.cos(), outer_rad.cos());
                ((cosine - outer) / (inner - outer).max(1e-3)).clamp(0.0, 1.0).powi(2)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beam_is_full_in_the_middle_and_ends_at_its_outer_angle() {
        for falloff in [Falloff::LinearInAngle, Falloff::SquaredInCosine] {
            let spot = Light::Spot {
                position: Vec3::ZERO,
                axis: Vec3::NEG_Y,
                intensity: Vec3::splat(2.0),
                inner_rad: 0.3,
                outer_rad: 0.5,
                falloff,
            };
            let at = |angle: f32| spot.towards(Vec3::new(angle.sin(), -angle.cos(), 0.0)).x;
            assert_eq!(at(0.0), 2.0);
            assert!((at(0.299) - 2.0).abs() < 1e-5 && at(0.501) == 0.0 && at(3.0) == 0.0);
            assert!(at(0.4) > 0.0 && at(0.4) < 2.0);
        }
    }
}
