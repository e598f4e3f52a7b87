//! What a ray sees that leaves the scene.

use super::texture::bilinear;
use glam::{Mat3, Vec2, Vec3};
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
    /// A latitude-longitude image: in its own space the centre column is -Z, the top row +Y.
    Image {
        /// Texels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Linear RGB radiance.
        texels: Vec<[f32; 3]>,
        /// Turns directions in world into directions in the image's own space; orthogonal, also with a reflection.
        image_from_world: Mat3,
    },
}

impl Environment {
    /// `image_from_world` of an image turned about +Y, counter-clockwise seen from above.
    pub fn turned_about_y(rotation_rad: f32) -> Mat3 {
        Mat3::from_rotation_y(-rotation_rad)
    }

    /// `image_from_world` of an image whose own space is placed in the world by `world_from_image`, of which only
    /// rotation and reflection count; `None` where it has neither, being singular.
    pub fn placed_by(world_from_image: &Mat3) -> Option<Mat3> {
        let x = world_from_image.x_axis.try_normalize()?;
        let y = (world_from_image.y_axis - x * x.dot(world_from_image.y_axis)).try_normalize()?;
        let z = x.cross(y);
        let z = if z.dot(world_from_image.z_axis) < 0.0 { -z } else { z };
        (world_from_image.determinant() != 0.0).then(|| Mat3::from_cols(x, y, z).transpose())
    }

    /// Radiance (linear RGB) that arrives from a direction of unit length.
    pub fn radiance(&self, direction_in_world: Vec3) -> Vec3 {
        match self {
            Environment::Black => Vec3::ZERO,
            Environment::Constant(radiance) => *radiance,
            Environment::Gradient { zenith, horizon, nadir } => {
                let height = direction_in_world.y.clamp(-1.0, 1.0);
                horizon.lerp(if height > 0.0 { *zenith } else { *nadir }, height.abs())
            }
            Environment::Image { width, height, texels, image_from_world } => {
                let uv = uv_in_image(*image_from_world * direction_in_world);
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
pub(crate) fn uv_in_image(direction_in_image: Vec3) -> Vec2 {
    let azimuth = direction_in_image.x.atan2(-direction_in_image.z);
    let polar = direction_in_image.y.clamp(-1.0, 1.0).acos();
    Vec2::new(0.5 + azimuth / TAU, polar / PI)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four columns: back-left, front-left, front-right, back-right; two rows: up and down.
    fn image(rotation_rad: f32) -> Environment {
        let texels = (0..8_u8).map(|index| [f32::from(index); 3]).collect();
        Environment::Image { width: 4, height: 2, texels, image_from_world: Environment::turned_about_y(rotation_rad) }
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
    fn an_image_placed_by_a_matrix_shows_in_the_world_what_it_shows_in_its_own_space() {
        // +Z up, scaled and mirrored.
        let placings = [
            Mat3::from_rotation_x(PI / 2.0),
            Mat3::from_rotation_z(0.7) * 3.0,
            Mat3::from_diagonal(Vec3::new(-1.0, 1.0, 1.0)) * Mat3::from_rotation_y(0.4),
        ];
        for world_from_image in placings {
            let Environment::Image { width, height, texels, .. } = image(0.0) else { panic!() };
            let image_from_world = Environment::placed_by(&world_from_image).unwrap();
            let placed = Environment::Image { width, height, texels, image_from_world };
            for own in [Vec3::new(0.3, 0.8, -0.4), Vec3::new(-0.7, -0.2, 0.5)] {
                let there = placed.radiance((world_from_image * own).normalize());
                assert!((there - image(0.0).radiance(own.normalize())).length() < 1e-4);
            }
        }
        assert_eq!(Environment::placed_by(&Mat3::ZERO), None);
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
        let image_from_world = Mat3::from_euler(glam::EulerRot::XYZ, 1.0, 2.0, 3.0);
        let sky = Environment::Image { width: 8, height: 4, texels: vec![[0.25; 3]; 32], image_from_world };
        for step in 0..1000_u16 {
            let angle = f32::from(step);
            let direction = Vec3::new(angle.sin(), (angle * 1.7).cos(), (angle * 0.3).cos()).normalize();
            assert!((sky.radiance(direction) - Vec3::splat(0.25)).length() < 1e-5);
        }
        assert!(sky.radiance(Vec3::Y).is_finite() && sky.radiance(Vec3::ZERO).is_finite());
    }
}
