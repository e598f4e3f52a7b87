//! KHR_lights_punctual: point, spot and directional lights of nodes.
//!
//! A light shines along -Z of its node; scale does not change its strength. The extension measures in candela
//! and lux, which weigh light by the eye, while everything else here, emissive materials above all, has linear
//! RGB of no unit. Its numbers are taken as they are, as radiant intensity and irradiance in the scene's own
//! unit: one candela lights a white wall at one metre to a radiance of 1/pi. Ranges are a hint for renderers
//! that must stop somewhere; light here falls with the square of the distance.

use super::super::{Falloff, Light, SceneError};
use super::Source;
use super::unsupported::Unsupported;
use glam::{DAffine3, Vec3};
use gltf::khr_lights_punctual::Kind;

/// Brightest intensity or irradiance: the sun's 1e5 lux and some.
const MAX_STRENGTH: f32 = 1e9;

/// The light of a node, turned but not moved; `None` where its node leaves it no direction.
pub(super) fn read(
    source: &Source,
    light: &gltf::khr_lights_punctual::Light,
    world_from_node: &DAffine3,
    name: &str,
    unsupported: &mut Unsupported,
) -> Result<Option<Light>, SceneError> {
    let malformed = |reason: String| source.malformed(format!("light '{}': {reason}", name.escape_debug()));
    let strength = Vec3::from_array(light.color()) * light.intensity();
    if !(strength.min_element() >= 0.0 && strength.max_element() <= MAX_STRENGTH) {
        return Err(malformed(format!("expected an intensity of 0 to {MAX_STRENGTH}, found {strength}")));
    }
    if light.range().is_some() {
        unsupported.note("the ranges of lights are left out", name);
    }
    let position = Vec3::ZERO;
    let forward = world_from_node.transform_vector3(glam::DVec3::NEG_Z).try_normalize();
    Ok(match light.kind() {
        Kind::Point => Some(Light::Point { position, intensity: strength }),
        Kind::Directional => {
            forward.map(|forward| Light::Directional { direction: forward.as_vec3(), irradiance: strength })
        }
        Kind::Spot { inner_cone_angle, outer_cone_angle } => {
            if !(0.0 <= inner_cone_angle && 0.0 < outer_cone_angle && outer_cone_angle < MAX_CONE_RAD) {
                return Err(malformed(format!(
                    "expected 0 <= innerConeAngle < outerConeAngle <= pi / 2, found {inner_cone_angle} and \
                     {outer_cone_angle}"
                )));
            }
            forward.map(|forward| Light::Spot {
                position,
                axis: forward.as_vec3(),
                intensity: strength,
                inner_rad: inner_cone_angle.min(SHARPEST * outer_cone_angle),
                outer_rad: outer_cone_angle,
                falloff: Falloff::SquaredInCosine,
            })
        }
    })
}

/// A right angle, and the rounding of those who write it.
const MAX_CONE_RAD: f32 = std::f32::consts::FRAC_PI_2 + 1e-3;
/// Inner over outer angle of a beam with a hard edge, which files write with both alike.
const SHARPEST: f32 = 0.999;
