//! Hand-made OpenVDB files, in every compression, sound and not; and a real one.

use super::*;
use flate2::{Compression, write::ZlibEncoder};
use half::f16;
use std::io::Write;

/// What a file is to hold: one leaf at (8, 0, -8), whose voxels with an even offset are active, and beside it
/// at (16, 0, -8) an active cube of 8^3.
#[derive(Clone, Copy)]
pub(in super::super) struct Recipe {
    pub(in super::super) compression: u32,
    pub(in super::super) half: bool,
    pub(in super::super) code: u8,
}

fn value(offset: usize) -> f32 {
    // A half float has it exactly.
    0.25 + offset as f32 / 1024.0
}

const BACKGROUND: f32 = 0.5;
const TILE: f32 = 3.0;

fn text(bytes: &mut Vec<u8>, text: &str) {
    bytes.extend((text.len() as u32).to_le_bytes());
    bytes.extend(text.as_bytes());
}

/// A Blosc chunk of LZ4 that is all literals, shuffled, one stream.
fn blosc_literals(content: &[u8]) -> Vec<u8> {
    let count = content.len() / 4;
    let mut shuffled: Vec<u8> = (0..count * 4).map(|at| content[at % count * 4 + at / count]).collect();
    shuffled.extend(&content[count * 4..]);
    let mut stream = vec![0xf0];
    let mut rest = content.len() - 15;
    while rest >= 255 {
        stream.push(255);
        rest -= 255;
    }
    stream.push(rest as u8);
    stream.extend(shuffled);
    let mut chunk = vec![2, 1, 0x01 | 0x10 | 0x20, 4];
    for word in [content.len(), content.len(), 16 + 8 + stream.len(), 20, stream.len()] {
        chunk.extend((word as u32).to_le_bytes());
    }
    chunk.extend(stream);
    chunk
}

/// The values of a node as stored.
fn pack(recipe: Recipe, values: &[f32]) -> Vec<u8> {
    let plain: Vec<u8> =
        values
            .iter()
            .flat_map(|&value| {
                if recipe.half { f16::from_f32(value).to_le_bytes().to_vec() } else { value.to_le_bytes().to_vec() }
            })
            .collect();
    if recipe.half && values.is_empty() {
        return vec![];
    }
    let packed = match recipe.compression {
        compression if compression & BLOSC != 0 && plain.len() >= 64 => blosc_literals(&plain),
        compression if compression & BLOSC != 0 => {
            return [(-(plain.len() as i64)).to_le_bytes().to_vec(), plain].concat();
        }
        compression if compression & ZIP != 0 => {
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(&plain).unwrap();
            encoder.finish().unwrap()
        }
        _ => return plain,
    };
    [(packed.len() as i64).to_le_bytes().to_vec(), packed].concat()
}

/// A node's values with those of inactive voxels left out, where the recipe says so.
fn coded(recipe: Recipe, active: &[u64], values: &[f32], inactive: f32) -> Vec<u8> {
    let mut bytes = vec![recipe.code];
    match recipe.code {
        2 => bytes.extend(inactive.to_le_bytes()),
        4 | 5 => {
            bytes.extend((inactive + 1.0).to_le_bytes());
            if recipe.code == 5 {
                bytes.extend(inactive.to_le_bytes());
            }
            // All inactive ones have the second value: of code 4 that is the background.
            active.iter().for_each(|word| bytes.extend((!word).to_le_bytes()));
        }
        _ => {}
    }
    let kept: Vec<f32> = if recipe.compression & ACTIVE_MASK != 0 && recipe.code != 6 {
        values
            .iter()
            .enumerate()
            .filter(|(index, _)| active[index / 64] >> (index % 64) & 1 == 1)
            .map(|(_, v)| *v)
            .collect()
    } else {
        values.to_vec()
    };
    bytes.extend(pack(recipe, &kept));
    bytes
}

/// A whole file with the grid `density`.
pub(in super::super) fn file(recipe: Recipe) -> Vec<u8> {
    let mut bytes = MAGIC.to_le_bytes().to_vec();
    [224u32, 11, 0].iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    bytes.push(1);
    bytes.extend([b'0'; 36]);
    bytes.extend(0u32.to_le_bytes());
    bytes.extend(1u32.to_le_bytes());
    ["density", "Tree_float_5_4_3", ""].iter().for_each(|name| text(&mut bytes, name));
    let offsets = bytes.len();
    bytes.extend([0; 24]);
    let start = bytes.len() as u64;
    bytes.extend(recipe.compression.to_le_bytes());
    bytes.extend(1u32.to_le_bytes());
    text(&mut bytes, "is_saved_as_half_float");
    text(&mut bytes, "bool");
    bytes.extend(1u32.to_le_bytes());
    bytes.push(u8::from(recipe.half));
    text(&mut bytes, "ScaleTranslateMap");
    let vectors = [[10.0, 20.0, 30.0], [0.5, 0.5, 2.0], [0.5, 0.5, 2.0], [0.0; 3], [0.0; 3], [0.0; 3]];
    vectors.as_flattened().iter().for_each(|number: &f64| bytes.extend(number.to_le_bytes()));
    bytes.extend(1u32.to_le_bytes());
    bytes.extend(BACKGROUND.to_le_bytes());
    [0u32, 1].iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    [0i32, 0, -4096].iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    // The node of 32^3: its child at (0, 0, 31) holds z from -128.
    let internal = |bytes: &mut Vec<u8>, count: usize, child: usize, tile: Option<usize>| {
        let mut masks = [vec![0u64; count / 64], vec![0u64; count / 64]];
        masks[0][child / 64] |= 1 << (child % 64);
        let mut values = vec![BACKGROUND; count];
        if let Some(tile) = tile {
            masks[1][tile / 64] |= 1 << (tile % 64);
            values[tile] = TILE;
        }
        masks.as_flattened_words().for_each(|word| bytes.extend(word.to_le_bytes()));
        bytes.extend(coded(recipe, &masks[1], &values, BACKGROUND));
    };
    internal(&mut bytes, 32 * 32 * 32, 31, None);
    // Of 16^3: the leaf at (1, 0, 15), the cube at (2, 0, 15).
    internal(&mut bytes, 16 * 16 * 16, 256 + 15, Some(2 * 256 + 15));
    let even = [0x5555_5555_5555_5555u64; 8];
    even.iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    let blocks = bytes.len() as u64;
    even.iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    let values: Vec<f32> = (0..512).map(|offset| if offset % 2 == 0 { value(offset) } else { BACKGROUND }).collect();
    bytes.extend(coded(recipe, &even, &values, BACKGROUND));
    let end = bytes.len() as u64;
    for (index, offset) in [start, blocks, end].into_iter().enumerate() {
        bytes[offsets + 8 * index..offsets + 8 * index + 8].copy_from_slice(&offset.to_le_bytes());
    }
    bytes
}

trait Words {
    fn as_flattened_words(&self) -> impl Iterator<Item = u64>;
}

impl Words for [Vec<u64>; 2] {
    fn as_flattened_words(&self) -> impl Iterator<Item = u64> {
        self.iter().flatten().copied()
    }
}

fn recipes() -> Vec<Recipe> {
    let mut recipes = Vec::new();
    for compression in [0, ZIP, BLOSC, ACTIVE_MASK, ACTIVE_MASK | ZIP, ACTIVE_MASK | BLOSC] {
        for half in [false, true] {
            for code in [0, 2, 4, 5, 6] {
                recipes.push(Recipe { compression, half, code });
            }
        }
    }
    recipes
}

#[test]
fn every_compression_gives_the_same_voxels() {
    for recipe in recipes() {
        let Recipe { compression, half, code } = recipe;
        let loaded =
            parse("a.vdb", &file(recipe), None).unwrap_or_else(|error| panic!("{compression} {half} {code}: {error}"));
        // x and y of the leaf and the cube whole, z from its first active voxel to the end of the cube.
        assert_eq!(loaded.grid.size(), [16, 8, 8], "{compression} {half} {code}");
        for (index, &found) in loaded.grid.values().iter().enumerate() {
            let [x, y, z] = [index % 16, index / 16 % 8, index / 128];
            let offset = (x % 8 * 8 + y) * 8 + z;
            let expected = match (x < 8, offset % 2) {
                (false, _) => TILE,
                (true, 0) => value(offset),
                (true, _) => BACKGROUND,
            };
            assert_eq!(found, expected, "{compression} {half} {code}: {x} {y} {z}");
        }
        // The corner is half a voxel beyond the first voxel, which is (8, 0, -8).
        let corner = loaded.space_from_unit.transform_point3(DVec3::ZERO);
        assert_eq!(corner, DVec3::new(10.0 + 0.5 * 7.5, 20.0 - 0.25, 30.0 - 17.0));
        assert_eq!(loaded.space_from_unit.transform_vector3(DVec3::ONE), DVec3::new(8.0, 4.0, 16.0));
    }
}

#[test]
fn what_is_not_read_is_named() {
    let recipe = Recipe { compression: ACTIVE_MASK, half: false, code: 0 };
    let error = |bytes: &[u8], grid: Option<&str>| {
        let line = parse("a.vdb", bytes, grid).unwrap_err().to_string();
        assert!(line.starts_with("a.vdb: ") && !line.contains('\n'), "{line}");
        line
    };
    let sound = file(recipe);
    let with = |from: &[u8], to: &[u8]| {
        let at = sound.windows(from.len()).position(|window| window == from).unwrap();
        [&sound[..at], to, &sound[at + from.len()..]].concat()
    };
    assert_eq!(error(&sound, Some("heat")), "a.vdb: grid: expected one of 'density', found 'heat'");
    // Another name of the same length is the only grid all the same.
    assert!(parse("a.vdb", &with(b"density", b"smokes!"), None).is_ok());
    assert!(error(&with(b"Tree_float_5_4_3", b"Tree_int32_5_4_3"), None).contains("'Tree_int32_5_4_3'"));
    assert!(error(&with(b"ScaleTranslateMap", b"NonlinearFrustumM"), None).contains("transform of type"));
    assert!(error(&with(&224u32.to_le_bytes(), &221u32.to_le_bytes()), None).contains("version: expected 222 to 224"));
    assert!(error(b"PK", None).contains("magic: expected 8 bytes"));
    assert!(error(&[0; 64], None).contains("magic: expected that of an OpenVDB file"));
    for length in 0..sound.len() {
        assert!(parse("a.vdb", &sound[..length], None).is_err(), "{length}");
    }
}

#[test]
fn a_chunk_of_blosc_itself_is_unpacked() {
    // c-blosc 1.21, by python-blosc: 256 numbers of 4 bytes, i * i, level 9, shuffled, LZ4.
    let chunk: Vec<u8> =
        (0..GOLDEN.len() / 2).map(|i| u8::from_str_radix(&GOLDEN[2 * i..2 * i + 2], 16).unwrap()).collect();
    let expected: Vec<u8> = (0..256u32).flat_map(|index| (index * index).to_le_bytes()).collect();
    assert_eq!(blosc::unpack(&chunk, 1024).unwrap(), expected);
    assert!(blosc::unpack(&chunk, 1020).is_err());
    for length in 0..chunk.len() {
        assert!(blosc::unpack(&chunk[..length], 1024).is_err(), "{length}");
    }
}

const GOLDEN: &str = "\
    020121040004000000040000b7010000140000008b000000ff7100010409101924314051647990a9c4e10021446990b9e4114071a4d9\
    104984c1004184c91059a4f14091e43990e944a10061c42990f964d140b124991089048100810489109924b140d164f99029c46100a1\
    44e99039e49140f1a45910c9844100c1844910d9a4714011e4b99069442100e1c4a99079645140312419100904018000685019100904\
    01f20000001b0001001201010010020100f0d503030303040404040505050506060607070708080909090a0a0a0b0b0c0c0d0d0e0e0f\
    0f1010111112121313141415151617171819191a1a1b1c1c1d1e1e1f202121222324242526272728292a2b2b2c2d2e2f303131323334\
    35363738393a3b3c3d3e3f404142434445464748494a4b4c4d4e4f51525354555657595a5b5c5d5f60616264656667696a6b6c6e6f70\
    7273747677797a7b7d7e7f8182848587888a8b8d8e909193949697999a9c9d9fa0a2a4a5a7a9aaacadafb1b2b4b6b7b9bbbdbec0c2c4\
    c5c7c9cbccced0d2d4d5d7d9dbdddfe1e2e4e6e8eaeceef0f2f4f6f8fafcfe0b0000001f000100e75000000000000b0000001f000100\
    e7500000000000\
";
