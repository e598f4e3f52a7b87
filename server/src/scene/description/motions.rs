//! `[[motion]]`: lights that move along keys.

use super::super::motion::{Key, Motion, Target};
use super::super::{Part, SceneError};
use super::checks::Section;
use glam::{DQuat, EulerRot};
use serde::Deserialize;

/// Keys of one motion: each is a place in a wide scene, not a recording.
const MAX_KEYS: u32 = 4096;
/// Longest time in a scene file: a day.
const MAX_SECS: f32 = 86_400.0;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MotionKeys {
    light: u32,
    pivot: Option<[f64; 3]>,
    period_secs: Option<f64>,
    keys: Vec<MotionKey>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MotionKey {
    at_secs: f64,
    #[serde(default)]
    translate: [f64; 3],
    #[serde(default)]
    rotate_deg: [f32; 3],
}

/// The motion of an entry. The scene's own lights are `own` of the part's, its last.
pub(super) fn motion(section: &Section, keys: &MotionKeys, part: &Part, own: usize) -> Result<Motion, SceneError> {
    let index = section.count("light", keys.light, 1..=u32::try_from(own).unwrap_or(u32::MAX).max(1))?;
    if own == 0 {
        return Err(section.error("light", "the number of a [[light]]", "none"));
    }
    section.count("keys", keys.keys.len() as u32, 1..=MAX_KEYS)?;
    let secs = |field: &str, secs: f64| section.number(field, secs as f32, 0.0..=MAX_SECS).map(|_| secs);
    let key = |key: &MotionKey| {
        let degrees = section.triple("keys: rotate_deg", key.rotate_deg, -360.0..=360.0)?.as_dvec3();
        let [x, y, z] = degrees.to_array().map(f64::to_radians);
        Ok(Key {
            at_secs: secs("keys: at_secs", key.at_secs)?,
            translate: section.point("keys: translate", key.translate)?,
            // About X, then Y, then Z, as a shape's transform.
            rotate: DQuat::from_euler(EulerRot::ZYX, z, y, x),
        })
    };
    let at_key = keys.keys.iter().map(key).collect::<Result<Vec<_>, SceneError>>()?;
    if let Some(pair) = at_key.windows(2).find(|pair| pair[0].at_secs >= pair[1].at_secs) {
        return Err(section.error("keys: at_secs", "keys in the order of time", pair[1].at_secs));
    }
    let last = at_key.last().map_or(0.0, |key| key.at_secs);
    let period_secs = keys.period_secs.map(|period| secs("period_secs", period)).transpose()?;
    if let Some(period) = period_secs.filter(|period| *period <= 0.0 || *period < last) {
        return Err(section.error("period_secs", "a time above 0, not before the last key", period));
    }
    let light = part.lights.len() - own + index as usize - 1;
    let pivot = section.point("pivot", keys.pivot.unwrap_or_default())? - part.origin();
    Ok(Motion { target: Target::Light(light as u32), pivot, keys: at_key, period_secs })
}

#[cfg(test)]
mod tests {
    use super::super::super::{Light, Scene};
    use glam::Vec3;

    fn load(text: &str) -> Result<Scene, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.toml");
        let lights: String =
            (0..2).map(|x| format!("[[light]]\nkind = \"point\"\nposition = [{x}, 2, 0]\nintensity = 1\n")).collect();
        std::fs::write(&path, format!("{lights}{text}")).unwrap();
        Scene::load(path.to_str().unwrap()).map_err(|error| error.to_string())
    }

    #[test]
    fn a_light_goes_where_its_keys_say() {
        let scene = load(
            "[[motion]]\nlight = 2\nperiod_secs = 4\npivot = [0, 2, 0]\n\
             keys = [{ at_secs = 0 }, { at_secs = 2, translate = [0, 1, 0], rotate_deg = [0, 90, 0] }]",
        )
        .unwrap();
        let at = |secs: f64| match scene.at(secs).lights[..] {
            [Light::Point { position: still, .. }, Light::Point { position, .. }] => {
                assert_eq!(still, Vec3::Y * 2.0);
                position
            }
            _ => panic!(),
        };
        assert!((at(2.0) - Vec3::new(0.0, 3.0, -1.0)).length() < 1e-6 && (at(4.0) - at(0.0)).length() < 1e-6);
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_name() {
        for (text, says) in [
            ("light = 3\nkeys = [{ at_secs = 0 }]", "motion 1: light"),
            ("light = 1\nkeys = []", "motion 1: keys"),
            ("light = 1\nkeys = [{ at_secs = 1 }, { at_secs = 1 }]", "order of time"),
            ("light = 1\nperiod_secs = 0.5\nkeys = [{ at_secs = 1 }]", "period_secs"),
            ("light = 1\nkeys = [{ at_secs = nan }]", "at_secs"),
            ("light = 1\nkeys = [{ at_secs = 0, rotate_deg = [0, 1e9, 0] }]", "rotate_deg"),
        ] {
            let error = load(&format!("[[motion]]\n{text}")).unwrap_err();
            assert!(error.contains(says) && !error.contains('\n'), "{error}");
        }
    }
}
