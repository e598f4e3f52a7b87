//! Volume files by their extension, and what all of them have in common.
//!
//! .nrrd and .nhdr, .vdb (OpenVDB), .vol (Mitsuba), and .raw with a .toml of the same name beside it. None is
//! trusted: sizes are held against limits and against the bytes that are there before anything is allocated.

use super::{Grid, mitsuba_vol, nrrd, raw, vdb};
use crate::scene::SceneError;
use crate::scene::untrusted::{MAX_FILE_BYTES, read_file};
use glam::{DAffine3, DMat3};
use std::path::Path;

/// A volume as its file has it.
#[derive(Debug)]
pub struct Loaded {
    /// Its values.
    pub grid: Grid,
    /// Where the file puts the unit cube in a space of its own, in units of its own.
    pub space_from_unit: DAffine3,
    /// Metres of such a unit, where the file says so.
    pub unit_m: Option<f64>,
}

/// Reads a volume file. `grid` names one of several in an OpenVDB file; without it `density`, or the only one.
pub fn load(path: &Path, grid: Option<&str>) -> Result<Loaded, SceneError> {
    let file = path.display().to_string();
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default();
    if grid.is_some() && extension != "vdb" {
        return Err(super::samples::field(&file, "grid", "an OpenVDB file, which has several", extension));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let bytes = || read_file(path, MAX_FILE_BYTES);
    match extension.as_str() {
        "nrrd" | "nhdr" => nrrd::parse(&file, &bytes()?, folder),
        "vdb" => vdb::parse(&file, &bytes()?, grid),
        "vol" => mitsuba_vol::parse(&file, &bytes()?),
        "raw" => raw::load(path),
        _ => Err(SceneError::Malformed {
            file,
            reason: "expected a volume that ends in .nrrd, .nhdr, .vdb, .vol or .raw".to_owned(),
        }),
    }
}

/// A grid of what a file holds.
pub(super) fn grid(file: &str, size: [u32; 3], channels: u8, values: Vec<f32>) -> Result<Grid, SceneError> {
    Grid::new(size, channels, values)
        .map_err(|error| SceneError::Malformed { file: file.to_owned(), reason: error.to_string() })
}

/// Refuses axes that are not finite, or too flat or too steep to be turned round.
pub(super) fn check_axes(file: &str, name: &str, axes: DMat3) -> Result<(), SceneError> {
    let lengths = [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| axis.length());
    let product = lengths.iter().product::<f64>();
    // A volume of a thousandth of what its edges could span is a mistake; below it inverses lose their digits.
    let sound =
        lengths.iter().all(|length| (1e-12..=1e12).contains(length)) && axes.determinant().abs() > 1e-3 * product;
    if sound {
        return Ok(());
    }
    let expected = "three axes of lengths from 1e-12 to 1e12 that span a box";
    let [x, y, z] = lengths;
    Err(super::samples::field(file, name, expected, format_args!("lengths {x:e}, {y:e}, {z:e}")))
}

#[cfg(test)]
#[path = "file_tests.rs"]
mod tests;
