//! Mitsuba's grid volumes, .vol: 48 bytes of head, then f32 samples, x fastest, little-endian.
//!
//! "VOL", version 3, type 1 (f32; others are refused by number), three sides, channels, and the box that the
//! grid fills, as six f32 (Mitsuba 3 documentation, gridvolume).

use super::file::{Loaded, check_axes, grid};
use super::samples::{Endian, SampleType, count_of, exactly, field};
use crate::scene::SceneError;
use glam::{DAffine3, DMat3, DVec3};

/// Bytes before the samples.
const HEAD_BYTES: usize = 48;

/// Reads a .vol file.
pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<Loaded, SceneError> {
    let head = exactly(file, bytes, HEAD_BYTES)?;
    if &head[..3] != b"VOL" || head[3] != 3 {
        return Err(field(file, "magic", "VOL and version 3", head[..4].escape_ascii()));
    }
    let words = |range: std::ops::Range<usize>| head[range].as_chunks::<4>().0;
    let [kind, x, y, z, channels] = std::array::from_fn(|index| i32::from_le_bytes(words(4..24)[index]));
    if kind != 1 {
        let feature = format!("samples of type {kind} (1, f32, is)");
        return Err(SceneError::Unsupported { file: file.to_owned(), feature });
    }
    let side = |side: i32| u32::try_from(side).map_err(|_| field(file, "size", "sides of at least 1", side));
    let size = [side(x)?, side(y)?, side(z)?];
    let channels = u8::try_from(channels)
        .ok()
        .filter(|channels| [1, 3].contains(channels))
        .ok_or_else(|| field(file, "channels", "1 or 3", channels))?;
    let count = count_of(file, size, channels)?;
    let values = SampleType::F32.decode(exactly(file, &bytes[HEAD_BYTES..], count * 4)?, Endian::Little);
    let corners: [f64; 6] = std::array::from_fn(|index| f64::from(f32::from_le_bytes(words(24..48)[index])));
    let (low, high) = (DVec3::from_slice(&corners[..3]), DVec3::from_slice(&corners[3..]));
    let edges = DMat3::from_diagonal(high - low);
    check_axes(file, "box", edges)?;
    let space_from_unit = DAffine3 { matrix3: edges, translation: low };
    Ok(Loaded { grid: grid(file, size, channels, values)?, space_from_unit, unit_m: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2x1x1 cells.
    pub(super) fn small(channels: u8) -> Vec<u8> {
        let mut bytes = b"VOL\x03".to_vec();
        for word in [1, 2, 1, 1, i32::from(channels)] {
            bytes.extend(word.to_le_bytes());
        }
        for number in [-1.0f32, 0.0, 0.0, 1.0, 1.0, 3.0] {
            bytes.extend(number.to_le_bytes());
        }
        (0..2 * channels).for_each(|index| bytes.extend(f32::from(index).to_le_bytes()));
        bytes
    }

    #[test]
    fn samples_and_box_are_read() {
        let loaded = parse("a.vol", &small(3)).unwrap();
        assert_eq!((loaded.grid.size(), loaded.grid.channels()), ([2, 1, 1], 3));
        assert_eq!(loaded.grid.values(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(loaded.space_from_unit.transform_point3(DVec3::ONE), DVec3::new(1.0, 1.0, 3.0));
        assert_eq!(loaded.space_from_unit.transform_point3(DVec3::ZERO), DVec3::new(-1.0, 0.0, 0.0));
    }

    #[test]
    fn what_is_wrong_is_one_line() {
        let error = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = small(1);
            change(&mut bytes);
            parse("a.vol", &bytes).unwrap_err().to_string()
        };
        assert_eq!(error(&|bytes| bytes.truncate(10)), "a.vol: samples: expected 48 bytes, found 10");
        assert_eq!(error(&|bytes| bytes.truncate(50)), "a.vol: samples: expected 8 bytes, found 2");
        assert_eq!(error(&|bytes| bytes[3] = 2), "a.vol: magic: expected VOL and version 3, found VOL\\x02");
        assert_eq!(error(&|bytes| bytes[4] = 2), "a.vol: samples of type 2 (1, f32, is) is not supported");
        assert!(error(&|bytes| bytes[8..20].fill(0x7f)).contains("values of a volume: at most"));
        assert!(error(&|bytes| bytes[8] = 0).contains("sizes: expected three sides of at least 1"));
        assert!(error(&|bytes| bytes[20] = 2).contains("channels: expected 1 or 3, found 2"));
        assert!(error(&|bytes| bytes[24..48].fill(0)).contains("box: expected three axes"));
        assert!(error(&|bytes| bytes[24..48].fill(0xff)).contains("box: expected three axes"));
    }
}
