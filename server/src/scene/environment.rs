//! What a ray sees that leaves the scene.

use super::texture::bilinear;
use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// The surroundings, infinitely far away.
#[derive(Clone, Debug, PartialEq)]
pub enum Environment {
    /// Nothing.
    Black,
    /// The same radiance from everywhere.
    Constant(Vec3),
    /// Radiance that changes linearly with the height (the sine of the elevation) from horizon to zenith
    /// and from horizon to nadir.
    Gradient {
        /// Straight up.
        zenith: Vec3,
        /// Level.
        horizon: Vec3,
        /// Straight down.
        nadir: Vec3,
    },
    /// A latitude-longitude image: the centre column is -Z, the top row +Y.
    Image {
        /// Texels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Linear RGB radiance.
        texels: Vec<[f32; 3]>,
        /// Turn about +Y in radians.
        rotation_rad: f32,
    },
}

impl Environment {
    /// Radiance (linear RGB) that arrives from a direction of unit length.
    pub fn radiance(&self, direction_in_world: Vec3) -> Vec3 {
        match self {
            Environment::Black => Vec3::ZERO,
            Environment::Constant(radiance) => *radiance,
            Environment::Gradient { zenith, horizon, nadir } => {
                let height = direction_in_world.y.clamp(-1.0, 1.0);
                horizon.lerp(if height > 0.0 { *zenith } else { *nadir }, height.abs())
            }
            Environment::Image { width, height, texels, rotation_rad } => {
                let uv = uv_from_world(direction_in_world, *rotation_rad);
                // Around the horizon the image repeats; beyond the poles it must not.
                let half_texel = 0.5 / *height as f32;
                let uv = Vec2::new(uv.x, uv.y.clamp(half_texel, 1.0 - half_texel));
                bilinear(*width, *height, texels, uv)
            }
        }
    }

    /// Whether any direction sends light.
    pub fn is_black(&self) -> bool {
        match self {
            Environment::Black => true,
            Environment::Constant(radiance) => *radiance == Vec3::ZERO,
            Environment::Gradient { zenith, horizon, nadir } => *zenith + *horizon + *nadir == Vec3::ZERO,
            Environment::Image { texels, .. } => texels.iter().all(|&texel| texel == [0.0; 3]),
        }
    }
}

/// Where in a latitude-longitude image a direction is found.
fn uv_from_world(direction_in_world: Vec3, rotation_rad: f32) -> Vec2 {
    let azimuth = direction_in_world.x.atan2(-direction_in_world.z) + rotation_rad;
    let polar = direction_in_world.y.clamp(-1.0, 1.0).acos();
    Vec2::new(0.5 + azimuth / TAU, polar / PI)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four columns: back-left, front-left, front-right, back-right; two rows: up and down.
    fn image(rotation_rad: f32) -> Environment {
        let texels = (0..8_u8).map(|index| [f32::from(index); 3]).collect();
        Environment::Image { width: 4, height: 2, texels, rotation_rad }
    }

    #[test]
    fn the_centre_column_is_ahead_and_the_top_row_above() {
        let up_ahead = Vec3::new(0.0, 1.0, -1.0).normalize();
        assert!((image(0.0).radiance(up_ahead).x - 1.5).abs() < 1e-4);
        let down_right = Vec3::new(1.0, -1.0, 0.0).normalize();
        assert!((image(0.0).radiance(down_right).x - 6.5).abs() < 1e-4);
    }

    #[test]
    fn rotation_turns_the_surroundings_counter_clockwise_seen_from_above() {
        // What was straight ahead (-Z) is on the left (-X) after a quarter turn about +Y.
        let ahead = image(0.0).radiance(Vec3::new(0.0, 1.0, -1.0).normalize());
        let left = image(PI / 2.0).radiance(Vec3::new(-1.0, 1.0, 0.0).normalize());
        assert!((ahead - left).length() < 1e-4);
    }

    #[test]
    fn the_gradient_meets_its_three_colours() {
        let sky = Environment::Gradient { zenith: Vec3::X, horizon: Vec3::Y, nadir: Vec3::Z };
        for (direction, expected) in [(Vec3::Y, Vec3::X), (Vec3::X, Vec3::Y), (-Vec3::Y, Vec3::Z)] {
            assert_eq!(sky.radiance(direction), expected);
        }
        assert_eq!(Environment::Black.radiance(Vec3::Y), Vec3::ZERO);
        assert_eq!(Environment::Constant(Vec3::ONE).radiance(Vec3::Y), Vec3::ONE);
    }

    #[test]
    fn a_constant_image_is_constant_in_every_direction() {
        let sky = Environment::Image { width: 8, height: 4, texels: vec![[0.25; 3]; 32], rotation_rad: 1.0 };
        for step in 0..1000_u16 {
            let angle = f32::from(step);
            let direction = Vec3::new(angle.sin(), (angle * 1.7).cos(), (angle * 0.3).cos()).normalize();
            assert!((sky.radiance(direction) - Vec3::splat(0.25)).length() < 1e-5);
        }
        assert!(sky.radiance(Vec3::Y).is_finite() && sky.radiance(Vec3::ZERO).is_finite());
    }
}
