//! Range checks that name the section and the field they failed in.

use super::super::SceneError;
use super::Rgb;
use glam::{DVec3, Vec2, Vec3};
use std::fmt::Display;
use std::ops::RangeInclusive;

/// A part of a scene file, such as `material 'glass'`.
pub(super) struct Section<'a> {
    pub(super) file: &'a str,
    pub(super) name: String,
}

impl Section<'_> {
    /// The error for one field.
    pub(super) fn error(&self, field: &str, expected: impl Display, found: impl Display) -> SceneError {
        let field = if self.name.is_empty() { field.to_owned() } else { format!("{}: {field}", self.name) };
        SceneError::Field {
            file: self.file.to_owned(),
            field,
            expected: expected.to_string(),
            found: found.to_string(),
        }
    }

    /// A finite number within a range.
    pub(super) fn number(&self, field: &str, value: f32, range: RangeInclusive<f32>) -> Result<f32, SceneError> {
        if range.contains(&value) {
            return Ok(value);
        }
        Err(self.error(field, format_args!("a number from {} to {}", range.start(), range.end()), value))
    }

    /// A whole number within a range.
    pub(super) fn count(&self, field: &str, value: u32, range: RangeInclusive<u32>) -> Result<u32, SceneError> {
        if range.contains(&value) {
            return Ok(value);
        }
        Err(self.error(field, format_args!("a whole number from {} to {}", range.start(), range.end()), value))
    }

    /// Two numbers within a range.
    pub(super) fn pair(&self, field: &str, value: [f32; 2], range: RangeInclusive<f32>) -> Result<Vec2, SceneError> {
        value.into_iter().try_for_each(|v| self.number(field, v, range.clone()).map(drop))?;
        Ok(Vec2::from_array(value))
    }

    /// Three numbers within a range.
    pub(super) fn triple(&self, field: &str, value: [f32; 3], range: RangeInclusive<f32>) -> Result<Vec3, SceneError> {
        value.into_iter().try_for_each(|v| self.number(field, v, range.clone()).map(drop))?;
        Ok(Vec3::from_array(value))
    }

    /// A colour whose channels are within a range.
    pub(super) fn rgb(&self, field: &str, value: Rgb, range: RangeInclusive<f32>) -> Result<Vec3, SceneError> {
        let channels = match value {
            Rgb::Grey(grey) => [grey; 3],
            Rgb::Channels(channels) => channels,
        };
        self.triple(field, channels, range)
    }

    /// A point within reach, in metres.
    pub(super) fn point(&self, field: &str, value: [f64; 3]) -> Result<DVec3, SceneError> {
        self.triple(field, value.map(|axis| axis as f32), -MAX_POINT_M..=MAX_POINT_M)?;
        Ok(DVec3::from_array(value))
    }

    /// A length in metres.
    pub(super) fn length(&self, field: &str, value: f32) -> Result<f32, SceneError> {
        self.number(field, value, MIN_LENGTH_M..=MAX_POINT_M)
    }
}

/// Shortest length of a shape: a micrometre; below it f32 rays in a room-sized scene miss.
const MIN_LENGTH_M: f32 = 1e-6;
/// As far as poses reach on the wire.
const MAX_POINT_M: f32 = 32_767.0;
