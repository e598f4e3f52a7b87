//! Hand-made NRRD files, sound and not.

use super::*;
use flate2::{Compression, write::GzEncoder};
use std::io::Write;

const PLAIN: &str = "NRRD0004\n# made by hand\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\nkey:=value\n\n";

fn read(header: &str, data: &[u8]) -> Result<Loaded, SceneError> {
    parse("a.nrrd", &[header.as_bytes(), data].concat(), Path::new(""))
}

fn error(header: &str, data: &[u8]) -> String {
    let line = read(header, data).unwrap_err().to_string();
    assert!(line.starts_with("a.nrrd: ") && !line.contains('\n'), "{line}");
    line
}

fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn eight_bytes_are_eight_values() {
    let loaded = read(PLAIN, &[0, 1, 2, 3, 4, 5, 6, 7]).unwrap();
    assert_eq!(loaded.grid.values(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    assert_eq!(loaded.space_from_unit.transform_vector3(DVec3::ONE), DVec3::splat(2.0));
    assert_eq!(loaded.unit_m, None);
    // Lines may end as those of DOS.
    assert!(read(&PLAIN.replace('\n', "\r\n"), &[0; 8]).is_ok());
}

#[test]
fn byte_orders_types_and_gzip_agree() {
    let header = |kind: &str, endian: &str, encoding: &str| {
        PLAIN.replace("uint8", kind).replace("raw\n", &format!("{encoding}\nendian: {endian}\n"))
    };
    let numbers: [i16; 8] = [-1000, 0, 1, 2, 300, -5, 6, 32767];
    let little: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    let big: Vec<u8> = numbers.iter().flat_map(|number| number.to_be_bytes()).collect();
    let floats: Vec<u8> = numbers.iter().flat_map(|&number| f64::from(number).to_be_bytes()).collect();
    let expected = read(&header("short", "little", "raw"), &little).unwrap().grid;
    assert_eq!(expected.values(), numbers.map(f32::from));
    for (header, bytes) in [
        (header("int16", "big", "raw"), big.clone()),
        (header("signed short int", "little", "gzip"), packed(&little)),
        (header("int16_t", "big", "gz"), packed(&big)),
        (header("double", "big", "raw"), floats),
    ] {
        assert_eq!(read(&header, &bytes).unwrap().grid, expected, "{header}");
    }
}

#[test]
fn axes_come_from_directions_or_spacings() {
    let with = |lines: &str| read(&PLAIN.replace("encoding", &format!("{lines}encoding")), &[0; 8]);
    let turned = with("space directions: (0, 0,3) (-1,0,0) (0,2,0)\nspace units: \"mm\" \"mm\" \"mm\"\n").unwrap();
    let corner = |loaded: &Loaded, x, y, z| loaded.space_from_unit.transform_point3(DVec3::new(x, y, z));
    assert_eq!(corner(&turned, 1.0, 0.0, 0.0), DVec3::new(0.0, 0.0, 6.0));
    assert_eq!(corner(&turned, 0.0, 1.0, 0.0), DVec3::new(-2.0, 0.0, 0.0));
    assert_eq!(turned.unit_m, Some(1e-3));
    let spaced = with("spacings: 0.5 NaN 3\n").unwrap();
    assert_eq!(corner(&spaced, 1.0, 1.0, 1.0), DVec3::new(1.0, 2.0, 6.0));
    for lines in [
        "space directions: (1,0,0) (0,1,0)\n",
        "space directions: (1,0,0) (0,1,0) (0,0)\n",
        "space directions: (1,0,0) (0,1,0) (0,0,1\n",
        "space directions: (1,0,0) (1,0,0) (0,0,1)\n",
        "space directions: (1,0,0) (0,1,0) none\n",
        "space directions: (1,0,0) (0,inf,0) (0,0,1)\n",
        "spacings: 1 0 1\n",
        "spacings: 1 x 1\n",
    ] {
        let line = with(lines).unwrap_err().to_string();
        assert!(line.starts_with("a.nrrd: sp") && line.contains(": expected"), "{line}");
    }
}

#[test]
fn a_first_axis_of_three_is_colour() {
    let header = PLAIN.replace("dimension: 3\nsizes: 2 2 2", "dimension: 4\nsizes: 3 2 1 1\nspacings: NaN 1 1 4");
    let loaded = read(&header, &[1, 2, 3, 4, 5, 6]).unwrap();
    assert_eq!((loaded.grid.channels(), loaded.grid.size()), (3, [2, 1, 1]));
    assert_eq!(loaded.grid.values(), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    assert_eq!(loaded.space_from_unit.transform_vector3(DVec3::ONE), DVec3::new(2.0, 1.0, 4.0));
}

#[test]
fn lines_and_bytes_before_the_samples_are_skipped() {
    let with = |lines: &str| PLAIN.replace("\n\n", &format!("\n{lines}\n\n"));
    let data = b"a line\nanother\nxx\0\x01\x02\x03\x04\x05\x06\x07";
    let expected = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
    assert_eq!(read(&with("line skip: 2\nbyteskip: 2"), data).unwrap().grid.values(), expected);
    assert_eq!(read(&with("byte skip: -1"), data).unwrap().grid.values(), expected);
    let gzip = with("byte skip: 2").replace("raw", "gzip");
    assert_eq!(read(&gzip, &packed(&data[15..])).unwrap().grid.values(), expected);
    assert!(error(&with("line skip: 9"), data).contains("line skip: expected as many lines"));
    assert!(error(&with("byte skip: 99"), data).contains("byte skip"));
    assert!(error(&with("byte skip: -2"), data).contains("byte skip: expected at least -1"));
    assert!(error(&with("byte skip: -1").replace("raw", "gzip"), data).contains("at least 0 with gzip"));
}

#[test]
fn a_detached_header_finds_its_samples() {
    let folder = tempfile::tempdir().unwrap();
    let header = PLAIN.replace("\n\n", "\ndata file: samples.bin\n");
    std::fs::write(folder.path().join("a.nhdr"), &header).unwrap();
    let load = || super::super::load(&folder.path().join("a.nhdr"), None);
    assert!(load().unwrap_err().to_string().contains("samples.bin"));
    std::fs::write(folder.path().join("samples.bin"), [1; 8]).unwrap();
    assert_eq!(load().unwrap().grid.values(), [1.0; 8]);
    for several in ["LIST", "slice%03d.raw 1 9 1"] {
        assert!(error(&header.replace("samples.bin", several), &[]).contains("samples in several files"));
    }
}

#[test]
fn claims_are_held_against_what_is_there() {
    let four_gigabytes = PLAIN.replace("2 2 2", "1024 1024 256").replace("uint8", "double\nendian: little");
    assert_eq!(error(&four_gigabytes, &[0; 10]), "a.nrrd: samples: expected 2147483648 bytes, found 10");
    let packed_claim = four_gigabytes.replace("raw", "gzip");
    assert!(error(&packed_claim, &[0; 10]).contains("found 10 of gzip, at most 10320"));
    assert!(error(&PLAIN.replace("2 2 2", "4294967295 4294967295 4294967295"), &[0; 10]).contains("at most"));
    assert!(error(&PLAIN.replace("2 2 2", "99999999999 1 1"), &[]).contains("sizes: expected whole numbers"));
    assert!(error(&PLAIN.replace("2 2 2", "2 0 2"), &[]).contains("three sides of at least 1"));
    // A bomb: 8 MB of zeros in 8 kB, of which 8 are asked for.
    let bomb = packed(&vec![0; 8 << 20]);
    assert!(bomb.len() < 10_000);
    assert_eq!(read(&PLAIN.replace("raw", "gzip"), &bomb).unwrap().grid.values(), [0.0; 8]);
    let numbers: Vec<u8> = (0..8u8).map(|index| index.wrapping_mul(97)).collect();
    let cut = packed(&numbers);
    for length in 0..cut.len() {
        match read(&PLAIN.replace("raw", "gzip"), &cut[..length]) {
            // All eight may have come out before the checksum is missed.
            Ok(loaded) => assert_eq!(loaded.grid.values(), numbers.iter().map(|&n| f32::from(n)).collect::<Vec<_>>()),
            Err(error) => assert!(error.to_string().contains("samples: expected 8 bytes"), "{error}"),
        }
    }
    assert!(read(&PLAIN.replace("raw", "gzip"), &cut[..cut.len() - 12]).is_err());
}

#[test]
fn what_is_not_read_is_named() {
    assert_eq!(
        error(&PLAIN.replace("raw", "bzip2"), &[0; 8]),
        "a.nrrd: encoding 'bzip2' (raw and gzip are) is not supported"
    );
    assert!(error(&PLAIN.replace("raw", "ascii"), &[0; 8]).contains("'ascii'"));
    assert!(error(&PLAIN.replace("uint8", "block"), &[0; 8]).contains("type: expected an integer"));
    assert!(error(&PLAIN.replace("uint8", "uint16"), &[0; 16]).contains("endian: expected little or big"));
    assert!(error(&PLAIN.replace("type: uint8\n", ""), &[0; 8]).contains("type: expected a value, found none"));
    assert!(error(&PLAIN.replace("sizes: 2 2 2", "sizes: 2 2"), &[0; 8]).contains("sizes: expected '3' sides"));
    assert!(error(&PLAIN.replace("3\nsizes: 2 2 2", "2\nsizes: 2 2"), &[0; 8]).contains("3 axes, or 4"));
    assert!(error(&PLAIN.replace("NRRD0004", "NRRD0009"), &[]).contains("magic: expected NRRD0001"));
    assert!(error(&PLAIN.replace("# made", "made"), &[]).contains("header: expected 'field: value'"));
    assert!(error("", &[]).contains("magic"));
    assert!(error(&PLAIN.replace("type: uint8", "type: uint8\ntype: uint8"), &[]).contains("it once"));
}

#[test]
fn floats_in_the_wrong_byte_order_are_numbers_all_the_same() {
    let header = PLAIN.replace("uint8", "float").replace("raw\n", "raw\nendian: big\n").replace("2 2 2", "4 4 4");
    let little: Vec<u8> = (0..64).flat_map(|index| (index as f32 * 0.37 - 7.0).to_le_bytes()).collect();
    let loaded = read(&header, &little).unwrap();
    assert!(loaded.grid.values().iter().all(|value| value.is_finite()));
    assert!((0..100).all(|index| loaded.grid.sample(glam::Vec3::splat(index as f32 / 99.0)).is_finite()));
}
