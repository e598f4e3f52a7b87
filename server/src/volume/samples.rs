//! Raw samples of volume files: bytes to numbers.
//!
//! Integers keep their values, as a scanner wrote them; nothing is normalised. Beyond 2^24 an f32 rounds.

use crate::scene::SceneError;
use crate::scene::untrusted::{MAX_VOLUME_VALUES, check_limit};
use flate2::read::GzDecoder;
use std::io::Read;

/// How a number is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SampleType {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

/// The order of the bytes of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Endian {
    Little,
    Big,
}

impl SampleType {
    /// By the names that NRRD knows, which are those of C and of stdint.h.
    pub(super) fn from_name(name: &str) -> Option<SampleType> {
        Some(match name {
            "signed char" | "int8" | "int8_t" => SampleType::I8,
            "uchar" | "unsigned char" | "uint8" | "uint8_t" => SampleType::U8,
            "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => SampleType::I16,
            "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => SampleType::U16,
            "int" | "signed int" | "int32" | "int32_t" => SampleType::I32,
            "uint" | "unsigned int" | "uint32" | "uint32_t" => SampleType::U32,
            "longlong"
            | "long long"
            | "long long int"
            | "signed long long"
            | "signed long long int"
            | "int64"
            | "int64_t" => SampleType::I64,
            "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => SampleType::U64,
            "float" | "float32" => SampleType::F32,
            "double" | "float64" => SampleType::F64,
            _ => return None,
        })
    }

    /// Bytes of one number.
    pub(super) fn bytes(self) -> usize {
        match self {
            SampleType::I8 | SampleType::U8 => 1,
            SampleType::I16 | SampleType::U16 => 2,
            SampleType::I32 | SampleType::U32 | SampleType::F32 => 4,
            SampleType::I64 | SampleType::U64 | SampleType::F64 => 8,
        }
    }

    /// All numbers in `bytes`; a rest too short for one is left.
    pub(super) fn decode(self, bytes: &[u8], endian: Endian) -> Vec<f32> {
        macro_rules! numbers {
            ($type:ty, $f32_from:expr) => {
                bytes
                    .as_chunks::<{ size_of::<$type>() }>()
                    .0
                    .iter()
                    .map(|&number| match endian {
                        Endian::Little => <$type>::from_le_bytes(number),
                        Endian::Big => <$type>::from_be_bytes(number),
                    })
                    .map($f32_from)
                    .collect()
            };
        }
        match self {
            SampleType::I8 => numbers!(i8, f32::from),
            SampleType::U8 => numbers!(u8, f32::from),
            SampleType::I16 => numbers!(i16, f32::from),
            SampleType::U16 => numbers!(u16, f32::from),
            SampleType::I32 => numbers!(i32, |number| number as f32),
            SampleType::U32 => numbers!(u32, |number| number as f32),
            SampleType::I64 => numbers!(i64, |number| number as f32),
            SampleType::U64 => numbers!(u64, |number| number as f32),
            SampleType::F32 => numbers!(f32, |number| number),
            SampleType::F64 => numbers!(f64, |number| number as f32),
        }
    }
}

/// Cells times channels, if no side is zero and the product is within the limit.
pub(super) fn count_of(file: &str, size: [u32; 3], channels: u8) -> Result<usize, SceneError> {
    if size.contains(&0) {
        let found = format!("{} {} {}", size[0], size[1], size[2]);
        return Err(field(file, "sizes", "three sides of at least 1", found));
    }
    // u64 holds the product of three u32 only after two of them were bounded.
    let sides = size.map(u64::from);
    let count = sides.iter().fold(u64::from(channels), |product, &side| product.saturating_mul(side));
    check_limit(file, "values of a volume", MAX_VOLUME_VALUES, count)?;
    Ok(count as usize)
}

/// Exactly `count` bytes, or an error that says how many there are.
pub(super) fn exactly<'a>(file: &str, bytes: &'a [u8], count: usize) -> Result<&'a [u8], SceneError> {
    bytes.get(..count).ok_or_else(|| field(file, "samples", format!("{count} bytes"), bytes.len()))
}

/// Unpacks `count` bytes of gzip after `skip` others; memory follows what is really there, not what is claimed.
pub(super) fn gunzip(file: &str, packed: &[u8], skip: usize, count: usize) -> Result<Vec<u8>, SceneError> {
    let wanted = skip as u64 + count as u64;
    let most = packed.len() as u64 * HIGHEST_RATIO;
    if wanted > most {
        let expected = format!("{wanted} bytes");
        return Err(field(file, "samples", expected, format!("{} of gzip, at most {most}", packed.len())));
    }
    let mut bytes = Vec::new();
    // More than is wanted is never unpacked: a bomb stays packed.
    let outcome = GzDecoder::new(packed).take(wanted).read_to_end(&mut bytes);
    if (bytes.len() as u64) < wanted {
        let reason = outcome.err().map(|error| format!(" ({error})")).unwrap_or_default();
        return Err(field(file, "samples", format!("{wanted} bytes"), format!("{}{reason}", bytes.len())));
    }
    bytes.drain(..skip);
    Ok(bytes)
}

/// Deflate makes at most 1032 bytes of one (258 of two bits).
const HIGHEST_RATIO: u64 = 1032;

/// The error for one field of a volume file.
pub(super) fn field(
    file: &str,
    field: &str,
    expected: impl std::fmt::Display,
    found: impl std::fmt::Display,
) -> SceneError {
    SceneError::Field {
        file: file.to_owned(),
        field: field.to_owned(),
        expected: expected.to_string(),
        found: found.to_string(),
    }
}

/// Text of a file in a message: short, and on one line.
pub(super) fn quoted(text: &str) -> String {
    let short: String = text.chars().take(60).collect();
    format!("'{}'", short.escape_debug())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_is_read_in_both_byte_orders() {
        let types = [
            (SampleType::I8, vec![0xfe], -2.0),
            (SampleType::U8, vec![0xfe], 254.0),
            (SampleType::I16, vec![0xfe, 0xff], -2.0),
            (SampleType::U16, vec![0x02, 0x01], 258.0),
            (SampleType::I32, vec![0xfe, 0xff, 0xff, 0xff], -2.0),
            (SampleType::U32, vec![2, 1, 0, 0], 258.0),
            (SampleType::I64, (-3i64).to_le_bytes().to_vec(), -3.0),
            (SampleType::U64, 7u64.to_le_bytes().to_vec(), 7.0),
            (SampleType::F32, 0.25f32.to_le_bytes().to_vec(), 0.25),
            (SampleType::F64, 0.125f64.to_le_bytes().to_vec(), 0.125),
        ];
        for (kind, mut bytes, value) in types {
            assert_eq!(kind.decode(&bytes, Endian::Little), [value]);
            assert_eq!(bytes.len(), kind.bytes());
            bytes.reverse();
            assert_eq!(kind.decode(&bytes, Endian::Big), [value]);
        }
    }

    #[test]
    fn what_is_claimed_is_checked_before_it_is_unpacked() {
        let error = gunzip("a.nrrd", &[0; 10], 0, 4 << 30).unwrap_err().to_string();
        assert_eq!(error, "a.nrrd: samples: expected 4294967296 bytes, found 10 of gzip, at most 10320");
        let huge = count_of("a.nrrd", [u32::MAX; 3], 3).unwrap_err().to_string();
        assert!(huge.starts_with("a.nrrd: values of a volume: at most"), "{huge}");
        assert!(count_of("a.nrrd", [3, 0, 1], 1).unwrap_err().to_string().contains("found 3 0 1"));
    }
}
