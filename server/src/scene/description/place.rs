//! Where things stand: view points and the transforms of shapes.

use super::super::SceneError;
use super::checks::Section;
use super::{Scale, TransformKeys};
use glam::{DAffine3, DMat3, DQuat, DVec3, EulerRot};
use warplight_protocol::Pose;

/// The pose at `position` that looks at a point, or along a yaw: 0 looks along -Z, 90 along -X. With
/// neither it looks along -Z.
pub(super) fn pose(
    section: &Section,
    position: [f64; 3],
    look_at: Option<[f64; 3]>,
    yaw_deg: Option<f32>,
) -> Result<Pose, SceneError> {
    let position = section.point("position", position)?;
    match (look_at, yaw_deg) {
        (Some(_), Some(_)) => Err(section.error("look_at", "look_at or yaw_deg", "both")),
        (Some(target), None) => {
            let target = section.point("look_at", target)?;
            if target.distance(position) < 1e-6 {
                return Err(section.error("look_at", "a point away from position", "position itself"));
            }
            Ok(Pose::look_at(position, target))
        }
        (None, yaw_deg) => {
            let yaw_deg = section.number("yaw_deg", yaw_deg.unwrap_or(0.0), -360.0..=360.0)?;
            Ok(Pose { position, orientation: DQuat::from_rotation_y(f64::from(yaw_deg).to_radians()) })
        }
    }
}

/// world_from_shape: scale, then turns about X, Y and Z in this order, then the translation.
pub(super) fn transform(section: &Section, keys: &TransformKeys) -> Result<DAffine3, SceneError> {
    let translation = section.point("transform: translate", keys.translate.unwrap_or_default())?;
    let turns =
        section.triple("transform: rotate_deg", keys.rotate_deg.unwrap_or_default(), -360.0..=360.0)?.as_dvec3();
    let scale = match keys.scale {
        None => [1.0; 3],
        Some(Scale::Uniform(scale)) => [scale; 3],
        Some(Scale::Axes(axes)) => axes,
    };
    let scale = section.triple("transform: scale", scale, -1e6..=1e6)?.as_dvec3();
    if scale.abs().min_element() < 1e-6 {
        return Err(section.error("transform: scale", "factors of at least 1e-6", scale));
    }
    let turns = DVec3::new(turns.x.to_radians(), turns.y.to_radians(), turns.z.to_radians());
    let rotation = DMat3::from_quat(DQuat::from_euler(EulerRot::ZYX, turns.z, turns.y, turns.x));
    Ok(DAffine3 { matrix3: rotation * DMat3::from_diagonal(scale), translation })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section() -> Section<'static> {
        Section { file: "x.toml", name: "head".to_owned() }
    }

    #[test]
    fn yaw_turns_to_the_left() {
        let left = pose(&section(), [0.0; 3], None, Some(90.0)).unwrap();
        assert!((left.orientation * DVec3::NEG_Z - DVec3::NEG_X).length() < 1e-9);
        let same = pose(&section(), [0.0; 3], Some([-1.0, 0.0, 0.0]), None).unwrap();
        assert!((same.orientation * DVec3::NEG_Z - DVec3::NEG_X).length() < 1e-9);
    }

    #[test]
    fn contradicting_directions_are_refused() {
        let both = pose(&section(), [0.0; 3], Some([1.0; 3]), Some(1.0)).unwrap_err().to_string();
        assert_eq!(both, "x.toml: head: look_at: expected look_at or yaw_deg, found both");
        assert!(pose(&section(), [1.0; 3], Some([1.0; 3]), None).is_err());
        assert!(pose(&section(), [f64::NAN; 3], None, None).is_err());
    }

    #[test]
    fn shapes_are_scaled_then_turned_about_x_y_z_then_moved() {
        let keys = TransformKeys {
            translate: Some([0.0, 0.0, 5.0]),
            rotate_deg: Some([90.0, 0.0, 90.0]),
            scale: Some(Scale::Axes([1.0, 2.0, 1.0])),
        };
        let moved = transform(&section(), &keys).unwrap().transform_point3(DVec3::Y);
        // (0,1,0) -> (0,2,0) -> about X: (0,0,2) -> about Z: (0,0,2) -> moved: (0,0,7)
        assert!((moved - DVec3::new(0.0, 0.0, 7.0)).length() < 1e-9, "{moved}");
    }
}
