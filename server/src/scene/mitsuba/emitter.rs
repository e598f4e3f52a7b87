//! Mitsuba's lights that are no shapes.
//!
//! An `envmap` looks up `u = atan2(x, -z) / 2 pi` and `v = acos(y) / pi` in its own space, ours is half a turn
//! further: so the image is turned by pi about its +Y before `to_world` places it. Columns of texels lie at half
//! positions in both; its rows are spread from pole to pole, the first and the last at the poles themselves, ours lie
//! half a row within. An image of few rows is therefore resampled to finer ones; of many rows the shift, at most half
//! a row, is left.

use super::super::picture::Encoding;
use super::super::{Environment, Falloff, Light, SceneError};
use super::node::{Node, Plugin};
use super::spectrum::Role;
use super::{Loader, transform};
use glam::{DAffine3, DVec3, Mat3, Vec3};
use std::f32::consts::PI;

/// Emitters of Mitsuba that have no counterpart here.
const LEFT_OUT: [&str; 6] = ["sunsky", "sun", "sky", "projector", "directionalarea", "volumelight"];

impl<'a> Loader<'a> {
    /// Puts a light into the scene.
    pub(super) fn emitter(&mut self, node: &'a Node) -> Result<(), SceneError> {
        let plugin = Plugin::new(node);
        let to_world = match plugin.transform("to_world")? {
            Some(node) => transform::read(node)?,
            None => DAffine3::IDENTITY,
        };
        match node.kind() {
            "envmap" => {
                plugin.without_effect(&["mis_compensation"]);
                let scale = plugin.float("scale", 1.0, 0.0..=1e9)? as f32;
                let (width, height, texels) = self.picture(&plugin, Encoding::ByFormat)?;
                let (height, mut texels) = with_rows_within(width, height, texels);
                texels.iter_mut().flatten().for_each(|value| *value *= scale);
                let placed = Environment::placed_by(&to_world.matrix3.as_mat3());
                let own_from_world = placed.ok_or_else(|| node.error("a to_world that turns", "one that flattens"))?;
                let image_from_world = Mat3::from_rotation_y(PI) * own_from_world;
                self.surround(node, Environment::Image { width, height, texels, image_from_world });
            }
            "constant" => {
                let radiance = self.constant(&plugin, "radiance", Role::Emission)?.unwrap_or(Vec3::ONE);
                self.surround(node, Environment::Constant(radiance));
            }
            "point" => {
                let intensity = self.constant(&plugin, "intensity", Role::Emission)?.unwrap_or(Vec3::ONE);
                let at = plugin.point("position")?.unwrap_or(to_world.translation);
                let light = Light::Point { position: Vec3::ZERO, intensity };
                self.light(node, light, &DAffine3::from_translation(at))?;
            }
            "spot" => {
                let intensity = self.constant(&plugin, "intensity", Role::Emission)?.unwrap_or(Vec3::ONE);
                let cutoff_deg = plugin.float("cutoff_angle", 20.0, 1e-3..=180.0)?;
                let beam_deg = plugin.float("beam_width", 0.75 * cutoff_deg, 0.0..=cutoff_deg)?;
                if plugin.has("texture") {
                    self.note("textures of spot lights are left out", &node.label());
                }
                let light = Light::Spot {
                    position: Vec3::ZERO,
                    axis: Vec3::Z,
                    intensity,
                    inner_rad: beam_deg.to_radians() as f32,
                    outer_rad: cutoff_deg.to_radians() as f32,
                    falloff: Falloff::LinearInAngle,
                };
                self.light(node, light, &to_world)?;
            }
            "directional" => {
                let irradiance = self.constant(&plugin, "irradiance", Role::Emission)?.unwrap_or(Vec3::ONE);
                let along = plugin.point("direction")?.unwrap_or(to_world.transform_vector3(DVec3::Z));
                let direction = along.try_normalize().ok_or_else(|| node.error("a direction", "0"))?.as_vec3();
                self.light(node, Light::Directional { direction, irradiance }, &DAffine3::IDENTITY)?;
            }
            "area" => return Err(node.error("an area light within a <shape>", "one without")),
            other if LEFT_OUT.contains(&other) => {
                self.note(format!("emitters of type '{other}' are left out"), &node.label());
                return Ok(());
            }
            other => {
                let expected = "an emitter of type area, envmap, constant, point, spot or directional";
                return Err(node.value_error(expected, other));
            }
        }
        self.note_unused(&plugin);
        Ok(())
    }

    fn light(&mut self, node: &Node, light: Light, to_world: &DAffine3) -> Result<(), SceneError> {
        let count = self.part.lights.len() as u64 + 1;
        let most = super::super::untrusted::MAX_ITEMS;
        super::super::untrusted::check_limit(&node.place.file.name, "lights", most, count)?;
        self.part.place_light(light, to_world);
        Ok(())
    }

    fn surround(&mut self, node: &Node, environment: Environment) {
        if self.environment.replace(environment).is_some() {
            self.note("of several surroundings the last counts", &node.label());
        }
    }
}

/// Most rows of an image that is resampled: beyond, half a row is less than a tenth of a degree.
const MAX_RESAMPLED_ROWS: u32 = 1024;
/// Rows for each of an image that is resampled: so many that looking them up blurs it by an eighth of a row.
const FINER: u32 = 4;

/// The rows of an image whose first and last lie at the poles, as rows that lie half a row within.
fn with_rows_within(width: u32, height: u32, texels: Vec<[f32; 3]>) -> (u32, Vec<[f32; 3]>) {
    if !(2..=MAX_RESAMPLED_ROWS).contains(&height) {
        return (height, texels);
    }
    let rows = FINER * height;
    let mut finer = Vec::with_capacity(width as usize * rows as usize);
    for row in 0..rows {
        let at = (row as f32 + 0.5) / rows as f32 * (height - 1) as f32;
        let above = (at as u32).min(height - 2);
        let row_of = |row: u32| &texels[(row * width) as usize..((row + 1) * width) as usize];
        let pairs = row_of(above).iter().zip(row_of(above + 1));
        let between = |(upper, lower): (&[f32; 3], &[f32; 3])| {
            Vec3::from_array(*upper).lerp(Vec3::from_array(*lower), at - above as f32).to_array()
        };
        finer.extend(pairs.map(between));
    }
    (rows, finer)
}
