//! Nodes of an OpenVDB tree: which voxels are active, what lies in between, and their values.

use super::super::samples::field;
use super::{ACTIVE_MASK, BLOSC, Coding, Cursor, ZIP, blosc};
use crate::scene::SceneError;
use crate::scene::untrusted::check_limit;
use flate2::read::ZlibDecoder;
use half::f16;
use std::collections::HashSet;
use std::io::Read;

/// Most cubes of one value, and most leaves: what fills the largest volume, and some.
const MAX_TILES: u64 = 1 << 21;

/// A cube of one value.
#[derive(Debug)]
pub(super) struct Tile {
    pub(super) origin: [i64; 3],
    pub(super) side: i64,
    pub(super) value: f32,
    active: bool,
}

/// 8^3 values.
#[derive(Debug)]
pub(super) struct Leaf {
    pub(super) origin: [i64; 3],
    active: [u64; 8],
}

impl Leaf {
    /// Voxels along an edge.
    pub(super) const SIDE: i64 = 8;

    /// Its values from the blocks of the grid, z fastest.
    pub(super) fn values(&self, cursor: &mut Cursor, coding: &Coding, background: f32) -> Result<Vec<f32>, SceneError> {
        let active = mask(cursor, 512)?;
        values(cursor, coding, &active, background)
    }
}

/// What a tree is made of.
#[derive(Debug)]
pub(super) struct Topology {
    pub(super) background: f32,
    /// Those that are active or not the background.
    pub(super) tiles: Vec<Tile>,
    /// In the order of their values.
    pub(super) leaves: Vec<Leaf>,
}

impl Topology {
    pub(super) fn read(cursor: &mut Cursor, coding: &Coding) -> Result<Topology, SceneError> {
        let file = cursor.file;
        let buffers = cursor.u32("buffers")?;
        if buffers != 1 {
            return Err(field(file, "buffers", "1", buffers));
        }
        let background = cursor.f32("background")?;
        let [tiles, children] = [cursor.u32("tiles")?, cursor.u32("nodes")?];
        let mut topology = Topology { background, tiles: Vec::new(), leaves: Vec::new() };
        // Nodes that lie over each other could make a small file take long.
        let mut seen = HashSet::new();
        let mut origin = |cursor: &mut Cursor| -> Result<[i64; 3], SceneError> {
            let mut origin = [0; 3];
            for axis in &mut origin {
                *axis = i64::from(cursor.u32("node: origin")? as i32);
                if *axis % 4096 != 0 {
                    return Err(field(file, "node: origin", "a multiple of 4096", *axis));
                }
            }
            if !seen.insert(origin) {
                return Err(field(file, "node: origin", "another for each node", format_args!("{origin:?} twice")));
            }
            Ok(origin)
        };
        for _ in 0..tiles {
            let origin = origin(cursor)?;
            let (value, active) = (cursor.f32("tile")?, cursor.u8("tile")? != 0);
            topology.push(file, Tile { origin, side: 4096, value, active })?;
        }
        for _ in 0..children {
            let origin = origin(cursor)?;
            topology.internal(cursor, coding, origin, 5, 7)?;
        }
        Ok(topology)
    }

    /// A node of (2^log2)^3 children of side 2^log2_child each, and all below it.
    fn internal(
        &mut self,
        cursor: &mut Cursor,
        coding: &Coding,
        origin: [i64; 3],
        log2: u32,
        log2_child: u32,
    ) -> Result<(), SceneError> {
        let count = 1usize << (3 * log2);
        let [children, active] = [mask(cursor, count)?, mask(cursor, count)?];
        let values = values(cursor, coding, &active, self.background)?;
        let side = 1i64 << log2_child;
        let origin_of = |index: usize| {
            let part = |shift: u32| (index >> (shift * log2) & ((1 << log2) - 1)) as i64;
            [origin[0] + part(2) * side, origin[1] + part(1) * side, origin[2] + part(0) * side]
        };
        for index in (0..count).filter(|&index| !bit(&children, index)) {
            let tile = Tile { origin: origin_of(index), side, value: values[index], active: bit(&active, index) };
            self.push(cursor.file, tile)?;
        }
        drop(values);
        for index in (0..count).filter(|&index| bit(&children, index)) {
            if log2_child > 3 {
                self.internal(cursor, coding, origin_of(index), 4, 3)?;
                continue;
            }
            let mut active = [0; 8];
            active.copy_from_slice(&mask(cursor, 512)?);
            self.leaves.push(Leaf { origin: origin_of(index), active });
            check_limit(cursor.file, "leaves", MAX_TILES, self.leaves.len() as u64)?;
        }
        Ok(())
    }

    fn push(&mut self, file: &str, tile: Tile) -> Result<(), SceneError> {
        if tile.active || tile.value.to_bits() != self.background.to_bits() {
            self.tiles.push(tile);
            check_limit(file, "tiles", MAX_TILES, self.tiles.len() as u64)?;
        }
        Ok(())
    }

    /// The box around all active voxels: its low corner, and one beyond its high one.
    pub(super) fn active_box(&self) -> Option<([i64; 3], [i64; 3])> {
        let mut low = [i64::MAX; 3];
        let mut high = [i64::MIN; 3];
        let mut include = |from: [i64; 3], to: [i64; 3]| {
            for axis in 0..3 {
                low[axis] = low[axis].min(from[axis]);
                high[axis] = high[axis].max(to[axis]);
            }
        };
        for tile in self.tiles.iter().filter(|tile| tile.active) {
            include(tile.origin, tile.origin.map(|axis| axis + tile.side));
        }
        for leaf in &self.leaves {
            // A word of the mask is a plane of x; its bytes are rows of y, their bits run along z.
            for (x, &plane) in leaf.active.iter().enumerate().filter(|(_, plane)| **plane != 0) {
                for (y, row) in plane.to_le_bytes().into_iter().enumerate().filter(|(_, row)| *row != 0) {
                    let at =
                        |z: u32| [leaf.origin[0] + x as i64, leaf.origin[1] + y as i64, leaf.origin[2] + i64::from(z)];
                    let (first, last) = (row.trailing_zeros(), 7 - row.leading_zeros());
                    include(at(first), at(last).map(|axis| axis + 1));
                }
            }
        }
        (low[0] < high[0]).then_some((low, high))
    }
}

fn mask(cursor: &mut Cursor, bits: usize) -> Result<Vec<u64>, SceneError> {
    let bytes = cursor.take(bits / 8, "mask")?;
    Ok(bytes.as_chunks::<8>().0.iter().map(|&word| u64::from_le_bytes(word)).collect())
}

fn bit(mask: &[u64], index: usize) -> bool {
    mask[index / 64] >> (index % 64) & 1 == 1
}

/// The values of a node, inactive ones put back where they were left out.
fn values(cursor: &mut Cursor, coding: &Coding, active: &[u64], background: f32) -> Result<Vec<f32>, SceneError> {
    let count = active.len() * 64;
    let code = cursor.u8("node: code")?;
    // Two values of inactive voxels, and which have the second. Also those are f32 where values are halves.
    let (first, second) = match code {
        0 | 3 | 6 => (if code == 0 { background } else { -background }, background),
        1 => (-background, background),
        2 | 4 => (cursor.f32("node: inactive value")?, background),
        5 => (cursor.f32("node: inactive value")?, cursor.f32("node: inactive value")?),
        _ => return Err(field(cursor.file, "node: code", "0 to 6", code)),
    };
    let selection = if (3..=5).contains(&code) { Some(mask(cursor, count)?) } else { None };
    let left_out = coding.compression & ACTIVE_MASK != 0 && code != 6;
    let stored = if left_out { active.iter().map(|word| word.count_ones() as usize).sum() } else { count };
    let numbers = numbers(cursor, coding, stored)?;
    if stored == count {
        return Ok(numbers);
    }
    let mut numbers = numbers.into_iter();
    let value = |index: usize| {
        if bit(active, index) {
            // There is one for each active voxel.
            return numbers.next().unwrap_or(background);
        }
        let is_second = selection.as_ref().is_some_and(|selection| bit(selection, index));
        if is_second { second } else { first }
    };
    Ok((0..count).map(value).collect())
}

/// `count` stored numbers.
fn numbers(cursor: &mut Cursor, coding: &Coding, count: usize) -> Result<Vec<f32>, SceneError> {
    // Of half floats not even a length is written where there are none.
    if count == 0 && coding.half {
        return Ok(Vec::new());
    }
    let bytes = count * if coding.half { 2 } else { 4 };
    let file = cursor.file;
    let what = "node: values";
    let mut unpacked = Vec::new();
    let numbers: &[u8] = if coding.compression & (BLOSC | ZIP) == 0 {
        cursor.take(bytes, what)?
    } else {
        // A length that is not positive is that of values which are not packed after all.
        let length = cursor.u64(what)? as i64;
        let packed = cursor.take(usize::try_from(length.unsigned_abs()).unwrap_or(usize::MAX), what)?;
        if length <= 0 {
            packed
        } else if coding.compression & BLOSC != 0 {
            unpacked = blosc::unpack(packed, bytes).map_err(|reason| field(file, what, "sound Blosc", reason))?;
            &unpacked
        } else {
            ZlibDecoder::new(packed)
                .take(bytes as u64)
                .read_to_end(&mut unpacked)
                .map_err(|reason| field(file, what, "sound zlib", reason))?;
            &unpacked
        }
    };
    if numbers.len() != bytes {
        return Err(field(file, what, format_args!("{bytes} bytes"), numbers.len()));
    }
    Ok(if coding.half {
        numbers.as_chunks::<2>().0.iter().map(|&number| f16::from_le_bytes(number).to_f32()).collect()
    } else {
        numbers.as_chunks::<4>().0.iter().map(|&number| f32::from_le_bytes(number)).collect()
    })
}
