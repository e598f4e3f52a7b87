//! `[[light]]`: lights without extent.

use super::super::SceneError;
use super::super::light::{Falloff, Light};
use super::Rgb;
use super::checks::Section;
use glam::{DVec3, Vec3};
use serde::Deserialize;

#[derive(Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum LightKeys {
    Point {
        position: [f64; 3],
        intensity: Rgb,
    },
    Spot {
        position: [f64; 3],
        look_at: [f64; 3],
        intensity: Rgb,
        #[serde(default)]
        inner_deg: f32,
        #[serde(default = "default_outer_deg")]
        outer_deg: f32,
        #[serde(default)]
        falloff: FalloffKey,
    },
    Directional {
        direction: [f32; 3],
        irradiance: Rgb,
    },
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum FalloffKey {
    #[default]
    SquaredInCosine,
    LinearInAngle,
}

fn default_outer_deg() -> f32 {
    45.0
}

/// Brightest intensity or irradiance, as in glTF files.
const MAX_STRENGTH: f32 = 1e9;

/// The light of an entry, at the origin, and where it is to be put.
pub(super) fn light(section: &Section, keys: &LightKeys) -> Result<(Light, DVec3), SceneError> {
    let strength = |field: &str, value: &Rgb| section.rgb(field, *value, 0.0..=MAX_STRENGTH);
    let direction = |field: &str, expected: &str, direction: Vec3| {
        direction.try_normalize().ok_or_else(|| section.error(field, expected, "none"))
    };
    let mut at = DVec3::ZERO;
    let light = match keys {
        LightKeys::Point { position, intensity } => {
            at = section.point("position", *position)?;
            Light::Point { position: Vec3::ZERO, intensity: strength("intensity", intensity)? }
        }
        LightKeys::Spot { position, look_at, intensity, inner_deg, outer_deg, falloff } => {
            at = section.point("position", *position)?;
            let forward = (section.point("look_at", *look_at)? - at).as_vec3();
            let outer_deg = section.number("outer_deg", *outer_deg, 0.1..=90.0)?;
            let inner_deg = section.number("inner_deg", *inner_deg, 0.0..=90.0)?;
            if inner_deg >= outer_deg {
                return Err(section.error(
                    "inner_deg",
                    format_args!("an angle below outer_deg {outer_deg}"),
                    inner_deg,
                ));
            }
            Light::Spot {
                position: Vec3::ZERO,
                axis: direction("look_at", "a point away from position", forward)?,
                intensity: strength("intensity", intensity)?,
                inner_rad: inner_deg.to_radians(),
                outer_rad: outer_deg.to_radians(),
                falloff: match falloff {
                    FalloffKey::SquaredInCosine => Falloff::SquaredInCosine,
                    FalloffKey::LinearInAngle => Falloff::LinearInAngle,
                },
            }
        }
        LightKeys::Directional { direction: along, irradiance } => Light::Directional {
            direction: direction("direction", "a direction", section.triple("direction", *along, -1e6..=1e6)?)?,
            irradiance: strength("irradiance", irradiance)?,
        },
    };
    Ok((light, at))
}
