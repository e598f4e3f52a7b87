//! NRRD, "nearly raw raster data": a header of text, then samples (Kindlmann, teem.sourceforge.net/nrrd/format.html).
//!
//! Versions 1 to 5; encodings raw and gzip; samples in the file or in one other file; line and byte skip;
//! spacings or space directions. Three axes, or four whose first holds 1 or 3 channels. Refused by name: other
//! encodings, blocks, samples spread over several files. Fields that do not matter for a picture are passed over.

use super::file::Loaded;
use super::samples::{Endian, SampleType, count_of, exactly, field, gunzip, quoted};
use super::{Grid, file::grid};
use crate::scene::SceneError;
use crate::scene::untrusted::{MAX_FILE_BYTES, read_file};
use glam::{DAffine3, DMat3, DVec3};
use std::collections::HashMap;
use std::path::Path;

/// Longest header in bytes; with many key/value pairs some have a few thousand.
const MAX_HEADER_BYTES: usize = 1 << 20;

/// Reads a NRRD file; a detached header finds its samples in `folder`.
pub(super) fn parse(file: &str, bytes: &[u8], folder: &Path) -> Result<Loaded, SceneError> {
    let (header, attached) = Header::parse(file, bytes)?;
    let Some(name) = &header.data_file else {
        return header.load(file, attached);
    };
    let path = folder.join(name);
    header.load(&path.display().to_string(), &read_file(&path, MAX_FILE_BYTES)?)
}

/// What a header says, checked.
#[derive(Debug)]
struct Header {
    sample: SampleType,
    endian: Endian,
    size: [u32; 3],
    channels: u8,
    gzip: bool,
    line_skip: usize,
    /// `None` counts from the end of the file.
    byte_skip: Option<usize>,
    data_file: Option<String>,
    /// Columns: from one sample to the next along each axis, in the file's space.
    directions: DMat3,
    unit_m: Option<f64>,
}

impl Header {
    /// The header, and what follows it.
    fn parse<'a>(file: &str, bytes: &'a [u8]) -> Result<(Header, &'a [u8]), SceneError> {
        let mut lines = Lines { bytes };
        let magic = lines.next().unwrap_or_default();
        if !(magic.len() == 8 && magic.starts_with(b"NRRD000") && (b'1'..=b'5').contains(&magic[7])) {
            let found = quoted(&String::from_utf8_lossy(magic));
            return Err(field(file, "magic", "NRRD0001 to NRRD0005", found));
        }
        let mut fields: HashMap<String, String> = HashMap::new();
        // A header ends with an empty line, or with the file where the samples are in another.
        while let Some(line) = lines.next() {
            if bytes.len() - lines.bytes.len() > MAX_HEADER_BYTES {
                return Err(field(file, "header", "an empty line within 1 MiB", "none"));
            }
            if line.is_empty() {
                break;
            }
            let line = String::from_utf8_lossy(line);
            if line.starts_with('#') || line.contains(":=") {
                continue;
            }
            let Some((name, value)) = line.split_once(": ") else {
                return Err(field(file, "header", "'field: value'", quoted(&line)));
            };
            // "data file" and "datafile", "line skip" and "lineskip" are the same.
            let name = name.to_lowercase().replace(' ', "");
            if fields.insert(name.clone(), value.trim().to_owned()).is_some() {
                return Err(field(file, &name, "it once", "it twice"));
            }
        }
        Ok((Header::from_fields(file, &fields)?, lines.bytes))
    }

    fn from_fields(file: &str, fields: &HashMap<String, String>) -> Result<Header, SceneError> {
        let required =
            |name: &str| fields.get(name).map(String::as_str).ok_or_else(|| field(file, name, "a value", "none"));
        let whole = |name: &str| match fields.get(name) {
            None => Ok(0),
            Some(text) => text.parse::<i64>().map_err(|_| field(file, name, "a whole number", quoted(text))),
        };
        let unsupported = |what: String| SceneError::Unsupported { file: file.to_owned(), feature: what };
        let name = required("type")?;
        let sample = SampleType::from_name(name)
            .ok_or_else(|| field(file, "type", "an integer of 8 to 64 bits, float or double", quoted(name)))?;
        let endian = match fields.get("endian").map(String::as_str) {
            Some("little") => Endian::Little,
            Some("big") => Endian::Big,
            None if sample.bytes() == 1 => Endian::Little,
            other => return Err(field(file, "endian", "little or big", quoted(other.unwrap_or_default()))),
        };
        let gzip = match required("encoding")?.to_lowercase().as_str() {
            "raw" => false,
            "gzip" | "gz" => true,
            other => return Err(unsupported(format!("encoding {} (raw and gzip are)", quoted(other)))),
        };
        let dimension = required("dimension")?;
        let sizes = required("sizes")?;
        let axes: Vec<u32> = sizes
            .split_whitespace()
            .map(|side| side.parse().map_err(|_| field(file, "sizes", "whole numbers", quoted(sizes))))
            .collect::<Result<_, _>>()?;
        if dimension != axes.len().to_string() {
            return Err(field(file, "sizes", format!("{} sides", quoted(dimension)), axes.len()));
        }
        let (channels, size) = match axes[..] {
            [x, y, z] => (1, [x, y, z]),
            [channels @ (1 | 3), x, y, z] => (channels as u8, [x, y, z]),
            _ => return Err(field(file, "sizes", "3 axes, or 4 whose first is 1 or 3 channels", quoted(sizes))),
        };
        let line_skip = whole("lineskip")?;
        let line_skip = usize::try_from(line_skip).map_err(|_| field(file, "line skip", "at least 0", line_skip))?;
        let byte_skip = match whole("byteskip")? {
            -1 if gzip => return Err(field(file, "byte skip", "at least 0 with gzip", -1)),
            -1 => None,
            skip => Some(usize::try_from(skip).map_err(|_| field(file, "byte skip", "at least -1", skip))?),
        };
        let data_file = fields.get("datafile").cloned();
        if data_file.as_ref().is_some_and(|name| name.starts_with("LIST") || name.contains('%')) {
            return Err(unsupported("samples in several files".to_owned()));
        }
        let directions = directions(file, fields, axes.len() - 3)?;
        Ok(Header {
            sample,
            endian,
            size,
            channels,
            gzip,
            line_skip,
            byte_skip,
            data_file,
            directions,
            unit_m: fields.get("spaceunits").or(fields.get("units")).and_then(|text| unit(text)),
        })
    }

    /// The samples in `bytes`, which are those after the header, or of the data file.
    fn load(&self, file: &str, bytes: &[u8]) -> Result<Loaded, SceneError> {
        let count = count_of(file, self.size, self.channels)?;
        let wanted = count * self.sample.bytes();
        let mut lines = Lines { bytes };
        for _ in 0..self.line_skip {
            lines.next().ok_or_else(|| field(file, "line skip", "as many lines", self.line_skip))?;
        }
        let bytes = lines.bytes;
        let values = if self.gzip {
            let unpacked = gunzip(file, bytes, self.byte_skip.unwrap_or(0), wanted)?;
            self.sample.decode(&unpacked, self.endian)
        } else {
            let skip = self.byte_skip.unwrap_or(bytes.len().saturating_sub(wanted));
            let rest = bytes.get(skip..).ok_or_else(|| field(file, "byte skip", "fewer than the file has", skip))?;
            self.sample.decode(exactly(file, rest, wanted)?, self.endian)
        };
        let edges = self.directions * DMat3::from_diagonal(DVec3::from_array(self.size.map(f64::from)));
        let grid: Grid = grid(file, self.size, self.channels, values)?;
        Ok(Loaded { grid, space_from_unit: DAffine3::from_mat3(edges), unit_m: self.unit_m })
    }
}

/// Lines that end in \n or \r\n.
struct Lines<'a> {
    bytes: &'a [u8],
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Option<&'a [u8]> {
        if self.bytes.is_empty() {
            return None;
        }
        let end = self.bytes.iter().position(|&byte| byte == b'\n');
        let line = &self.bytes[..end.unwrap_or(self.bytes.len())];
        self.bytes = &self.bytes[end.map_or(self.bytes.len(), |end| end + 1)..];
        Some(line.strip_suffix(b"\r").unwrap_or(line))
    }
}

/// One step along each axis: of `space directions`, else of `spacings`, else 1. The first `skip` axes hold
/// channels.
fn directions(file: &str, fields: &HashMap<String, String>, skip: usize) -> Result<DMat3, SceneError> {
    let (name, columns) = if let Some(text) = fields.get("spacedirections") {
        let bad = || field(file, "space directions", "(x,y,z) for each axis", quoted(text));
        let mut columns = Vec::new();
        let mut rest = text.trim();
        while !rest.is_empty() {
            if let Some(after) = rest.strip_prefix("none") {
                columns.push(DVec3::NAN);
                rest = after.trim_start();
                continue;
            }
            let (inside, after) = rest.strip_prefix('(').and_then(|rest| rest.split_once(')')).ok_or_else(bad)?;
            let numbers: Vec<f64> =
                inside.split(',').map(|number| number.trim().parse().map_err(|_| bad())).collect::<Result<_, _>>()?;
            columns.push(DVec3::from_array(numbers.try_into().map_err(|_| bad())?));
            rest = after.trim_start();
        }
        ("space directions", columns)
    } else if let Some(text) = fields.get("spacings") {
        let bad = |_| field(file, "spacings", "numbers", quoted(text));
        let steps: Vec<f64> =
            text.split_whitespace().map(|number| number.parse().map_err(bad)).collect::<Result<_, _>>()?;
        let column = |(index, step): (usize, &f64)| {
            let axis = [DVec3::X, DVec3::Y, DVec3::Z][index.saturating_sub(skip).min(2)];
            // A spacing that is not known is written as NaN.
            axis * if step.is_nan() { 1.0 } else { *step }
        };
        ("spacings", steps.iter().enumerate().map(column).collect())
    } else {
        return Ok(DMat3::IDENTITY);
    };
    let found = columns.len();
    if found != skip + 3 {
        return Err(field(file, name, format!("{} of them", skip + 3), found));
    }
    let steps = DMat3::from_cols(columns[skip], columns[skip + 1], columns[skip + 2]);
    super::file::check_axes(file, name, steps)?;
    Ok(steps)
}

/// Metres of a unit of the file's space, from `"mm" "mm" "mm"`.
fn unit(text: &str) -> Option<f64> {
    let mut names = text.split('"').map(str::trim).filter(|name| !name.is_empty());
    let first = names.next()?;
    if names.any(|name| name != first) {
        return None;
    }
    match first {
        "m" | "meter" | "metre" => Some(1.0),
        "cm" => Some(1e-2),
        "mm" | "millimeter" | "millimetre" => Some(1e-3),
        "um" | "micron" | "micrometer" => Some(1e-6),
        _ => None,
    }
}

#[cfg(test)]
#[path = "nrrd_tests.rs"]
mod tests;
