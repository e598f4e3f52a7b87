//! `[[volume]]`: matter that fills a box, in keys.
//!
//! A volume is a grid of values, or the same everywhere; a box that the grid fills and light passes unchanged; and
//! what the values are: densities, in proportion to which there is extinction, or those of a scanner with a
//! transfer function. It becomes a medium of the scene, and the box the boundary of it.

use super::super::material::{Material, Surface};
use super::super::untrusted::MAX_VOLUME_VALUES;
use super::super::{SceneError, shapes};
use super::checks::Section;
use super::place::transform;
use super::{MAX_RADIANCE, Rgb, Scale, TransformKeys, one};
use crate::scene::mesh::Mesh;
use crate::volume::procedural::Procedural;
use crate::volume::{Albedo, ControlPoint, Grid, Loaded, Matter, Medium, Phase, TransferFunction, load};
use glam::{Affine3A, DAffine3, DMat3, DVec3, Vec2, Vec3};
use serde::Deserialize;
use std::path::PathBuf;
use std::sync::Arc;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct VolumeKeys {
    pub(super) name: String,
    source: Option<SourceKeys>,
    size: Option<Scale>,
    voxel: Option<Scale>,
    #[serde(default)]
    up: UpKey,
    #[serde(default)]
    transform: TransformKeys,
    #[serde(default = "one")]
    value_scale: f32,
    extinction: Option<Rgb>,
    albedo: Option<Rgb>,
    emission: Option<Rgb>,
    transfer: Option<Vec<PointKeys>>,
    extinction_scale: Option<f32>,
    #[serde(default)]
    phase_g: f32,
}

/// Where its values come from.
#[derive(Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum SourceKeys {
    File {
        file: String,
        grid: Option<String>,
    },
    Cloud {
        #[serde(default)]
        seed: u32,
        resolution: Option<Resolution>,
    },
    Clouds {
        #[serde(default)]
        seed: u32,
        #[serde(default = "half")]
        cover: f32,
        resolution: Option<Resolution>,
    },
    Phantom {
        resolution: Option<Resolution>,
    },
    Shells {
        resolution: Option<Resolution>,
    },
}

/// Cells along each side, or along each axis.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(untagged, expecting = "expected a resolution: one whole number or [x, y, z]")]
enum Resolution {
    Cube(u32),
    Axes([u32; 3]),
}

/// Which axis of a grid points upwards.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
enum UpKey {
    #[serde(rename = "x")]
    X,
    #[default]
    #[serde(rename = "y")]
    Y,
    #[serde(rename = "z")]
    Z,
    #[serde(rename = "-x")]
    MinusX,
    #[serde(rename = "-y")]
    MinusY,
    #[serde(rename = "-z")]
    MinusZ,
}

/// A control point: value, colour, extinction per metre.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(expecting = "expected a point: [value, colour, extinction]")]
struct PointKeys(f32, Rgb, f32);

fn half() -> f32 {
    0.5
}

/// Cells along each side of a computed volume, unless it says otherwise: made in less than a second.
const RESOLUTION: u32 = 96;
/// Largest factor on an extinction, and largest extinction per metre: beyond it a volume is a surface.
const MAX_EXTINCTION: f32 = 1e6;
/// Largest |g|: that of the phase function.
const MAX_G: f32 = Phase::MOST;

/// What a volume adds to a scene.
pub(super) struct Volume {
    pub(super) medium: Medium,
    /// Of the box.
    pub(super) material: Material,
    /// The unit cube.
    pub(super) boundary: Mesh,
    pub(super) world_from_unit: DAffine3,
    /// Values in memory.
    pub(super) values: u64,
    pub(super) warnings: Vec<String>,
}

/// Makes a volume whose medium will have this index; `path` finds its file.
pub(super) fn volume(
    section: &Section,
    keys: &VolumeKeys,
    medium_index: u32,
    path: impl Fn(&str) -> Result<PathBuf, SceneError>,
) -> Result<Volume, SceneError> {
    let mut warnings = Vec::new();
    let loaded = match &keys.source {
        None => None,
        Some(source) => Some(source.load(section, path)?),
    };
    let placed = placement(section, keys, loaded.as_ref())?;
    let world_from_unit = transform(section, &keys.transform)? * placed;
    let grid = match loaded {
        None => None,
        Some(Loaded { grid, .. }) => {
            if grid.not_finite() > 0 {
                let count = grid.not_finite();
                warnings.push(format!(
                    "{}: {}: {count} values are no numbers or beyond 1e30 and are 0; is their byte order right?",
                    section.file, section.name
                ));
            }
            Some(Arc::new(scaled(section, grid, keys.value_scale)?))
        }
    };
    let values = grid.as_ref().map_or(0, |grid| grid.values().len() as u64);
    let phase = Phase { g: section.number("phase_g", keys.phase_g, -MAX_G..=MAX_G)? };
    let medium = Medium { matter: matter(section, keys, grid)?, phase };
    let mut material = Material::new(format!("boundary of {}", keys.name), Surface::Null);
    material.interior = Some(medium_index);
    let mut boundary = shapes::cuboid(Vec3::ONE, Vec2::ONE);
    boundary.positions.iter_mut().for_each(|position| *position += 0.5);
    Ok(Volume { medium, material, boundary, world_from_unit, values, warnings })
}

impl SourceKeys {
    fn load(
        &self,
        section: &Section,
        path: impl Fn(&str) -> Result<PathBuf, SceneError>,
    ) -> Result<Loaded, SceneError> {
        let (procedural, resolution) = match self {
            SourceKeys::File { file, grid } => return load(&path(file)?, grid.as_deref()),
            &SourceKeys::Cloud { seed, resolution } => (Procedural::Cloud { seed }, resolution),
            &SourceKeys::Clouds { seed, cover, resolution } => {
                let cover = section.number("source: cover", cover, 0.0..=1.0)?;
                (Procedural::Clouds { seed, cover }, resolution)
            }
            &SourceKeys::Phantom { resolution } => (Procedural::Phantom, resolution),
            &SourceKeys::Shells { resolution } => (Procedural::Shells, resolution),
        };
        let size = match resolution.unwrap_or(Resolution::Cube(RESOLUTION)) {
            Resolution::Cube(side) => [side; 3],
            Resolution::Axes(axes) => axes,
        };
        size.iter().try_for_each(|&side| section.count("source: resolution", side, 1..=1024).map(drop))?;
        let grid = procedural.grid(size).map_err(|error| section.error("source", "a grid", error))?;
        // Cells are cubes.
        let edges = DMat3::from_diagonal(DVec3::from_array(size.map(f64::from)));
        Ok(Loaded { grid, space_from_unit: DAffine3::from_mat3(edges), unit_m: None })
    }
}

/// Where the unit cube stands before the volume's own transform: centred, in metres, the right way up.
fn placement(section: &Section, keys: &VolumeKeys, loaded: Option<&Loaded>) -> Result<DAffine3, SceneError> {
    let lengths = |field: &str, scale: Scale| -> Result<DVec3, SceneError> {
        let axes = match scale {
            Scale::Uniform(length) => [length; 3],
            Scale::Axes(axes) => axes,
        };
        axes.iter().try_for_each(|&length| section.length(field, length).map(drop))?;
        Ok(DVec3::from_array(axes.map(f64::from)))
    };
    // The box as the file has it, and its sides, in the file's own units.
    let edges = loaded.map_or(DMat3::IDENTITY, |loaded| loaded.space_from_unit.matrix3);
    let sides = DVec3::new(edges.x_axis.length(), edges.y_axis.length(), edges.z_axis.length());
    let cells = loaded.map_or([1; 3], |loaded| loaded.grid.size());
    let factors = match (keys.size, keys.voxel) {
        (Some(_), Some(_)) => return Err(section.error("voxel", "size or voxel", "both")),
        (None, Some(_)) if loaded.is_none() => {
            return Err(section.error("voxel", "a source, which has voxels", "none"));
        }
        // The longest side has it, and the proportions stay.
        (Some(Scale::Uniform(length)), None) => {
            lengths("size", Scale::Uniform(length))? / DVec3::splat(sides.max_element())
        }
        (Some(size), None) => lengths("size", size)? / sides,
        (None, Some(voxel)) => {
            let sides_m = lengths("voxel", voxel)? * DVec3::from_array(cells.map(f64::from));
            sides_m.to_array().iter().try_for_each(|&side| section.length("voxel", side as f32).map(drop))?;
            sides_m / sides
        }
        (None, None) => {
            let unit_m = loaded.and_then(|loaded| loaded.unit_m);
            let factor = unit_m.unwrap_or(1.0 / sides.max_element());
            section.length("size", (sides.max_element() * factor) as f32)?;
            DVec3::splat(factor)
        }
    };
    let edges = edges * DMat3::from_diagonal(factors);
    // Turns, never mirrors, that bring an axis upwards.
    let turn = match keys.up {
        UpKey::Y => DMat3::IDENTITY,
        UpKey::Z => DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y),
        UpKey::MinusZ => DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
        UpKey::X => DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z),
        UpKey::MinusX => DMat3::from_cols(DVec3::NEG_Y, DVec3::X, DVec3::Z),
        UpKey::MinusY => DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
    };
    let edges = turn * edges;
    Ok(DAffine3 { matrix3: edges, translation: edges * DVec3::splat(-0.5) })
}

/// The grid with all values multiplied.
fn scaled(section: &Section, grid: Grid, factor: f32) -> Result<Grid, SceneError> {
    let factor = section.number("value_scale", factor, -1e9..=1e9)?;
    if factor == 1.0 {
        return Ok(grid);
    }
    let values = grid.values().iter().map(|value| value * factor).collect();
    Grid::new(grid.size(), grid.channels(), values).map_err(|error| section.error("source", "a grid", error))
}

fn matter(section: &Section, keys: &VolumeKeys, grid: Option<Arc<Grid>>) -> Result<Matter, SceneError> {
    let refuse = |field: &str, given: bool, why: &str| match given {
        true => Err(section.error(field, why, "a value")),
        false => Ok(()),
    };
    // Replaced when the scene knows its origin.
    let unit_from_world = Affine3A::IDENTITY;
    if let Some(points) = &keys.transfer {
        refuse("extinction", keys.extinction.is_some(), "nothing beside transfer, which has it")?;
        refuse("albedo", keys.albedo.is_some(), "nothing beside transfer, which has it")?;
        refuse("emission", keys.emission.is_some(), "nothing beside transfer")?;
        let Some(values) = grid else {
            return Err(section.error("transfer", "a source, which has values", "none"));
        };
        if values.channels() != 1 {
            return Err(section.error("transfer", "a source of 1 channel", values.channels()));
        }
        let scale = section.number("extinction_scale", keys.extinction_scale.unwrap_or(1.0), 0.0..=MAX_EXTINCTION)?;
        let points = points.iter().enumerate().map(|(index, &PointKeys(value, color, extinction_per_m))| {
            let field = |what: &str| format!("transfer: point {}: {what}", index + 1);
            let color = section.rgb(&field("colour"), color, 0.0..=1.0)?;
            section.number(&field("extinction"), extinction_per_m, 0.0..=MAX_EXTINCTION)?;
            Ok(ControlPoint { value, color, extinction_per_m })
        });
        let points = points.collect::<Result<Vec<_>, SceneError>>()?;
        let transfer = TransferFunction::new(points).map_err(|error| SceneError::Malformed {
            file: section.file.to_owned(),
            reason: format!("{}: {error}", section.name),
        })?;
        return Ok(Matter::Classified { values, unit_from_world, transfer: transfer.into(), extinction_scale: scale });
    }
    refuse("extinction_scale", keys.extinction_scale.is_some(), "nothing without transfer")?;
    let Some(extinction) = keys.extinction else {
        return Err(section.error("extinction", "extinction or transfer", "neither"));
    };
    let extinction_per_m = section.rgb("extinction", extinction, 0.0..=MAX_EXTINCTION)?;
    let albedo = section.rgb("albedo", keys.albedo.unwrap_or(Rgb::Grey(0.0)), 0.0..=1.0)?;
    let emission = section.rgb("emission", keys.emission.unwrap_or(Rgb::Grey(0.0)), 0.0..=MAX_RADIANCE)?;
    Ok(match grid {
        None => Matter::Homogeneous { extinction_per_m, albedo, emission },
        Some(density) => {
            Matter::Density { density, unit_from_world, extinction_per_m, albedo: Albedo::Constant(albedo), emission }
        }
    })
}

/// Refuses more values than all volumes of a scene together may have.
pub(super) fn check_total(file: &str, values: u64) -> Result<(), SceneError> {
    super::super::untrusted::check_limit(file, "values of volumes", MAX_VOLUME_VALUES, values)
}

#[cfg(test)]
#[path = "volume_tests.rs"]
mod tests;
