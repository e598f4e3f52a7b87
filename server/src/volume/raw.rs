//! Raw samples, .raw, with a .toml of the same name beside them that says what they are:
//!
//! ```toml
//! size = [256, 256, 128]
//! type = "uint16"
//! endian = "big"             # default little
//! channels = 1               # default 1
//! spacing = [0.5, 0.5, 1]    # of samples, in any unit; default 1
//! offset = 512               # bytes before the samples; default 0
//! ```

use super::file::{Loaded, check_axes, grid};
use super::samples::{Endian, SampleType, count_of, exactly, field, quoted};
use crate::scene::SceneError;
use crate::scene::untrusted::{MAX_FILE_BYTES, MAX_TOML_BYTES, read_file};
use glam::{DAffine3, DMat3, DVec3};
use serde::Deserialize;
use std::path::Path;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sidecar {
    size: [u32; 3],
    r#type: String,
    #[serde(default = "little")]
    endian: String,
    #[serde(default = "one")]
    channels: u8,
    #[serde(default = "unit")]
    spacing: [f64; 3],
    #[serde(default)]
    offset: u64,
}

fn little() -> String {
    "little".to_owned()
}

fn one() -> u8 {
    1
}

fn unit() -> [f64; 3] {
    [1.0; 3]
}

/// Reads samples and what stands beside them.
pub(super) fn load(path: &Path) -> Result<Loaded, SceneError> {
    let beside = path.with_extension("toml");
    let words = read_file(&beside, MAX_TOML_BYTES)?;
    parse(&path.display().to_string(), &beside.display().to_string(), &words, &read_file(path, MAX_FILE_BYTES)?)
}

/// The same with both in memory; `beside` names the sidecar.
pub(super) fn parse(file: &str, beside: &str, words: &[u8], bytes: &[u8]) -> Result<Loaded, SceneError> {
    let malformed = |reason: String| SceneError::Malformed { file: beside.to_owned(), reason };
    let text = std::str::from_utf8(words).map_err(|error| malformed(error.to_string()))?;
    let keys: Sidecar = toml::from_str(text)
        .map_err(|error| malformed(error.message().split_whitespace().collect::<Vec<_>>().join(" ")))?;
    let sample = SampleType::from_name(&keys.r#type).ok_or_else(|| {
        field(beside, "type", "uint8, int8, uint16, int16, uint32, int32, float32 or float64", quoted(&keys.r#type))
    })?;
    let endian = match keys.endian.as_str() {
        "little" => Endian::Little,
        "big" => Endian::Big,
        other => return Err(field(beside, "endian", "little or big", quoted(other))),
    };
    if ![1, 3].contains(&keys.channels) {
        return Err(field(beside, "channels", "1 or 3", keys.channels));
    }
    let count = count_of(beside, keys.size, keys.channels)?;
    let offset = usize::try_from(keys.offset).unwrap_or(usize::MAX);
    let rest = bytes.get(offset..).ok_or_else(|| field(beside, "offset", "fewer bytes than the file has", offset))?;
    let values = sample.decode(exactly(file, rest, count * sample.bytes())?, endian);
    let spacing = DMat3::from_diagonal(DVec3::from_array(keys.spacing));
    check_axes(beside, "spacing", spacing)?;
    let edges = spacing * DMat3::from_diagonal(DVec3::from_array(keys.size.map(f64::from)));
    let grid = grid(file, keys.size, keys.channels, values)?;
    Ok(Loaded { grid, space_from_unit: DAffine3::from_mat3(edges), unit_m: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    const WORDS: &str = "size = [2, 2, 1]\ntype = \"uint16\"\nendian = \"big\"\nspacing = [1, 1, 2]\noffset = 3\n";

    #[test]
    fn samples_are_read_as_the_sidecar_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.raw");
        std::fs::write(&path, [9, 9, 9, 0, 1, 0, 2, 1, 0, 0, 4]).unwrap();
        assert!(load(&path).unwrap_err().to_string().contains("scan.toml"));
        std::fs::write(path.with_extension("toml"), WORDS).unwrap();
        let loaded = super::super::load(&path, None).unwrap();
        assert_eq!(loaded.grid.values(), [1.0, 2.0, 256.0, 4.0]);
        assert_eq!(loaded.space_from_unit.transform_vector3(DVec3::ONE), DVec3::splat(2.0));
    }

    #[test]
    fn what_is_wrong_is_one_line_that_names_the_file() {
        let error = |words: &str, bytes: &[u8]| {
            let line = parse("a.raw", "a.toml", words.as_bytes(), bytes).unwrap_err().to_string();
            assert!(!line.contains('\n'), "{line}");
            line
        };
        assert_eq!(error(WORDS, &[0; 10]), "a.raw: samples: expected 8 bytes, found 7");
        assert!(error(WORDS, &[0; 2]).starts_with("a.toml: offset: expected fewer"));
        assert!(error("size = [1, 2]", &[]).starts_with("a.toml: invalid length 2"));
        assert!(error(&WORDS.replace("uint16", "int7"), &[]).contains("type: expected uint8"));
        assert!(error(&WORDS.replace("big", "middle"), &[]).contains("endian: expected little or big"));
        assert!(error(&WORDS.replace("2, 2, 1", "0, 2, 1"), &[]).contains("at least 1"));
        assert!(error(&WORDS.replace("2, 2, 1", "4000000000, 4000000000, 4000000000"), &[]).contains("at most"));
        assert!(error(&WORDS.replace("1, 1, 2", "1, nan, 2"), &[0; 11]).contains("spacing: expected three axes"));
        assert!(error(&format!("{WORDS}\nofset = 1"), &[]).contains("unknown field"));
    }
}
