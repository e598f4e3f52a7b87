//! All formats together: real files, and files that were real before they were damaged.

use super::super::vdb::tests::{Recipe, file as vdb_file};
use super::super::{mitsuba_vol, nrrd, raw, vdb};
use super::*;
use flate2::{Compression, write::GzEncoder};
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use std::io::Write;
use std::path::PathBuf;

/// The folder of test data that is not part of the project.
fn volumes() -> Option<PathBuf> {
    let folder = std::env::var_os("WARPLIGHT_DATA").map(|folder| Path::new(&folder).join("volumes"));
    if folder.is_none() {
        eprintln!("skipped: WARPLIGHT_DATA is not set, so there are no recorded volumes");
    }
    folder
}

#[test]
fn recorded_volumes_load() {
    let Some(folder) = volumes() else { return };
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if !path.extension().is_some_and(|extension| extension == "nrrd" || extension == "vdb") {
            continue;
        }
        let loaded = load(&path, None).unwrap_or_else(|error| panic!("{error}"));
        let (low, high) = loaded.grid.blocks().all();
        assert!(low < high && loaded.grid.not_finite() == 0, "{}", path.display());
        count += 1;
    }
    assert!(count >= 4, "{count}");
    let torso = load(&volumes().unwrap().join("ct_torso_3mm.nrrd"), None).unwrap();
    assert_eq!((torso.grid.size(), torso.unit_m), ([122, 101, 112], Some(1e-3)));
    assert_eq!(torso.space_from_unit.transform_vector3(glam::DVec3::X).x, 366.0);
    let (low, high) =
        torso.grid.values().iter().fold((0.0f32, 0.0f32), |(low, high), value| (low.min(*value), high.max(*value)));
    assert_eq!((low, high), (-1207.0, 3382.0));
}

/// Two programs read the same file: ours, and the one that its dense copy was made with, which kept halves: the
/// file has 198,187 values that no half float is.
#[test]
fn a_sparse_cloud_equals_its_dense_copy() {
    let Some(folder) = volumes() else { return };
    let sparse = load(&folder.join("wdas_cloud_sixteenth.vdb"), None).unwrap();
    let dense = load(&folder.join("cloud_wdas16_u16.nrrd"), None).unwrap();
    assert_eq!(sparse.grid.size(), dense.grid.size());
    for (a, b) in sparse.grid.values().iter().zip(dense.grid.values()) {
        let kept = half::f16::from_f32(*a).to_f32();
        assert!((kept - b / 65535.0).abs() <= 1.0 / 65535.0, "{a} {b}");
    }
    // A voxel of the sparse one is as large as its transform says, and lies where its box begins.
    let step = sparse.space_from_unit.transform_vector3(glam::DVec3::X).x / 126.0;
    assert!((step - 10.0 / 3.0).abs() < 1e-6, "{step}");
    let corner = sparse.space_from_unit.translation / step + 0.5;
    assert!((corner - glam::DVec3::new(-66.0, -21.0, -90.0)).length() < 1e-6, "{corner}");
}

#[test]
fn volumes_of_mitsuba_load() {
    let Some(folder) = volumes() else { return };
    let textures = "../reference/mitsuba_tests/tests/scenes/participating_media/textures";
    for (name, channels) in [("sigmat.vol", 1), ("albedo.vol", 3)] {
        let loaded = load(&folder.join(textures).join(name), None).unwrap();
        assert_eq!((loaded.grid.size(), loaded.grid.channels()), ([16; 3], channels));
    }
}

#[test]
fn other_endings_are_refused() {
    let error = |path: &str, grid| load(Path::new(path), grid).unwrap_err().to_string();
    assert!(error("a.dcm", None).ends_with("expected a volume that ends in .nrrd, .nhdr, .vdb, .vol or .raw"));
    assert!(error("a.nrrd", Some("density")).contains("grid: expected an OpenVDB file"));
}

/// Reads a file of one format from memory.
type Reader = Box<dyn Fn(&[u8]) -> Result<Loaded, SceneError>>;

/// Sound files of every format, and what reads them.
fn sound_files() -> Vec<(&'static str, Vec<u8>, Reader)> {
    let header = |encoding: &str| {
        format!(
            "NRRD0004\ntype: float\ndimension: 3\nsizes: 4 4 4\nspace directions: (1,0,0) (0,1,0) (0,0,2)\n\
             endian: little\nencoding: {encoding}\n\n"
        )
    };
    let samples: Vec<u8> = (0..64).flat_map(|index| (index as f32 / 7.0).to_le_bytes()).collect();
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(&samples).unwrap();
    let packed = encoder.finish().unwrap();
    let read_nrrd = || -> Reader { Box::new(|bytes| nrrd::parse("a.nrrd", bytes, Path::new("/nowhere"))) };
    let mut vol = b"VOL\x03".to_vec();
    [1i32, 4, 4, 4, 1].iter().for_each(|word| vol.extend(word.to_le_bytes()));
    [0.0f32, 0.0, 0.0, 1.0, 1.0, 1.0].iter().for_each(|number| vol.extend(number.to_le_bytes()));
    vol.extend(&samples);
    let words = b"size = [4, 4, 4]\ntype = \"float\"\nendian = \"little\"\nspacing = [1, 2.5, 1]\noffset = 0\n";
    let data = samples.clone();
    let mut files: Vec<(&str, Vec<u8>, Reader)> = vec![
        ("raw NRRD", [header("raw").as_bytes(), &samples].concat(), read_nrrd()),
        ("gzip NRRD", [header("gzip").as_bytes(), &packed].concat(), read_nrrd()),
        ("vol", vol, Box::new(|bytes| mitsuba_vol::parse("a.vol", bytes))),
        ("raw", words.to_vec(), Box::new(move |words| raw::parse("a.raw", "a.toml", words, &data))),
    ];
    for (name, compression) in [("plain VDB", 2), ("zlib VDB", 3), ("Blosc VDB", 6), ("whole VDB", 0)] {
        let bytes =
            vdb_file(Recipe { compression, half: compression == 3, code: if compression == 6 { 5 } else { 0 } });
        files.push((name, bytes, Box::new(|bytes| vdb::parse("a.vdb", bytes, None))));
    }
    files
}

/// Bytes are flipped, replaced, taken out and doubled, the file is cut: whatever comes of it is an error of one
/// line, or a volume of finite values.
#[test]
fn damaged_files_are_refused_or_finite() {
    let mut random = Pcg32::new(1, 1);
    for (name, sound, read) in sound_files() {
        assert!(read(&sound).is_ok(), "{name}");
        let (mut read_all_the_same, mut refused) = (0, 0);
        for _ in 0..10_000 {
            let mut bytes = sound.clone();
            // Most of a VDB is masks of empty nodes: half of the damage goes to its first and last kilobyte.
            let span = bytes.len();
            for _ in 0..1 + random.next_u32() % 4 {
                let at = match random.next_u32() % 4 {
                    0 => random.next_u32() as usize % span.min(1024),
                    1 => span - 1 - random.next_u32() as usize % span.min(1024),
                    _ => random.next_u32() as usize % span,
                };
                let Some(byte) = bytes.get_mut(at) else { continue };
                match random.next_u32() % 8 {
                    0 => *byte = 0,
                    1 => *byte = 0xff,
                    2..=4 => *byte ^= 1 << (random.next_u32() % 8),
                    5 => *byte = random.next_u32() as u8,
                    6 => drop(bytes.drain(at..(at + 1 + random.next_u32() as usize % 8).min(bytes.len()))),
                    _ => bytes.truncate(at),
                }
            }
            match read(&bytes) {
                Ok(loaded) => {
                    read_all_the_same += 1;
                    assert!(loaded.grid.values().iter().take(4096).all(|value| value.is_finite()), "{name}");
                }
                Err(error) => {
                    refused += 1;
                    let line = error.to_string();
                    assert!(line.starts_with("a.") && !line.contains('\n') && line.len() < 400, "{name}: {line}");
                }
            }
        }
        // Both happen: 98 of the sidecars of raw samples survive their damage.
        assert!(read_all_the_same > 30 && refused > 100, "{name}: {read_all_the_same} {refused}");
    }
}
