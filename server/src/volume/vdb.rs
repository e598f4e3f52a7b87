//! OpenVDB files, .vdb: sparse trees of voxels, here made dense (Museth 2013; the bytes are those that the
//! OpenVDB library writes, file versions 222 to 224, since 2013).
//!
//! A tree has a root, internal nodes of 32^3 and 16^3 children and leaves of 8^3 values; a node's values may be
//! compressed by leaving out inactive ones (active mask), and by zlib or Blosc ([`blosc`]). Read are trees of f32,
//! also saved as half floats, and linear transforms. The grid that comes out is the box of the active voxels;
//! inactive ones inside it have what the file says. Other value types, point grids, instances and frustums
//! are refused by name.
//!
//! Why not an existing crate: the one there is (vdb-rs) sizes allocations by what a file claims, and panics, aborts
//! or hands bytes to C code where a file lies. Here a file of n bytes costs at most some multiple of n and of
//! the volume limit.

mod blosc;
mod nodes;

use super::file::{Loaded, check_axes, grid};
use super::samples::{field, quoted};
use crate::scene::SceneError;
use crate::scene::untrusted::{MAX_VOLUME_VALUES, check_limit};
use glam::{DAffine3, DMat3, DVec3};
use nodes::{Leaf, Tile, Topology};

/// First bytes of a file.
const MAGIC: u64 = 0x5644_4220;
/// The oldest version that is read, of 2013: the first whose nodes leave out inactive values.
const OLDEST: u32 = 222;
/// The newest known.
const NEWEST: u32 = 224;
/// Most grids of a file, and most entries of metadata.
const MAX_ENTRIES: u64 = 10_000;

/// Bits of a grid's compression.
const ZIP: u32 = 1;
const ACTIVE_MASK: u32 = 2;
const BLOSC: u32 = 4;

/// Reads one grid of a file: the one named, else `density`, else the only one.
pub(super) fn parse(file: &str, bytes: &[u8], name: Option<&str>) -> Result<Loaded, SceneError> {
    let mut cursor = Cursor { file, all: bytes, at: 0 };
    let magic = cursor.u64("magic")?;
    if magic != MAGIC {
        return Err(field(file, "magic", "that of an OpenVDB file", format_args!("{magic:#x}")));
    }
    let version = cursor.u32("version")?;
    if !(OLDEST..=NEWEST).contains(&version) {
        return Err(field(file, "version", format_args!("{OLDEST} to {NEWEST}"), version));
    }
    // Version of the library.
    cursor.take(8, "version")?;
    if cursor.take(1, "version")? != [1] {
        return Err(SceneError::Unsupported { file: file.to_owned(), feature: "a stream without offsets".to_owned() });
    }
    // A unique name of the file.
    cursor.take(36, "uuid")?;
    cursor.metadata()?;
    let count = cursor.u32("grid count")?;
    check_limit(file, "grids", MAX_ENTRIES, u64::from(count))?;
    let mut grids = Vec::new();
    for _ in 0..count {
        let descriptor = Descriptor::read(&mut cursor)?;
        cursor.seek(descriptor.end, "grid: end")?;
        grids.push(descriptor);
    }
    let wanted = name.unwrap_or("density");
    let position = grids.iter().position(|grid| grid.name == wanted);
    let only = (name.is_none() && grids.len() == 1).then_some(0);
    let Some(index) = position.or(only) else {
        let names: Vec<String> = grids.iter().take(8).map(|grid| quoted(&grid.name)).collect();
        return Err(field(file, "grid", format_args!("one of {}", names.join(", ")), quoted(wanted)));
    };
    grids[index].load(&mut cursor)
}

/// Where a grid is in the file.
#[derive(Debug)]
struct Descriptor {
    name: String,
    kind: String,
    parent: String,
    start: u64,
    blocks: u64,
    end: u64,
}

impl Descriptor {
    fn read(cursor: &mut Cursor) -> Result<Descriptor, SceneError> {
        let name = cursor.text("grid: name")?;
        // Grids of the same name are told apart by a number behind this separator.
        let name = name.split('\u{1e}').next().unwrap_or_default().to_owned();
        let [kind, parent] = [cursor.text("grid: type")?, cursor.text("grid: parent")?];
        let [start, blocks, end] = [cursor.u64("grid: start")?, cursor.u64("grid: blocks")?, cursor.u64("grid: end")?];
        Ok(Descriptor { name, kind, parent, start, blocks, end })
    }

    fn load(&self, cursor: &mut Cursor) -> Result<Loaded, SceneError> {
        let file = cursor.file;
        let unsupported = |feature: String| Err(SceneError::Unsupported { file: file.to_owned(), feature });
        if !self.parent.is_empty() {
            return unsupported(format!("grid {}, an instance of another,", quoted(&self.name)));
        }
        if self.kind.strip_suffix("_HalfFloat").unwrap_or(&self.kind) != "Tree_float_5_4_3" {
            return unsupported(format!("a grid of type {} (Tree_float_5_4_3 is)", quoted(&self.kind)));
        }
        cursor.seek(self.start, "grid: start")?;
        let compression = cursor.u32("compression")?;
        if compression > (ZIP | ACTIVE_MASK | BLOSC) {
            return Err(field(file, "compression", "0 to 7", compression));
        }
        let half = cursor.metadata()? || self.kind.ends_with("_HalfFloat");
        let space_from_index = transform(cursor)?;
        let coding = Coding { compression, half };
        let topology = Topology::read(cursor, &coding)?;
        cursor.seek(self.blocks, "grid: blocks")?;
        let (low, high) = topology.active_box().ok_or_else(|| field(file, "grid", "active voxels", "none"))?;
        let sides: [u64; 3] = std::array::from_fn(|axis| (high[axis] - low[axis]) as u64);
        let count = sides.iter().fold(1u64, |product, &side| product.saturating_mul(side));
        check_limit(file, "values of a volume", MAX_VOLUME_VALUES, count)?;
        let size = sides.map(|side| side as u32);
        let mut dense = Dense { low, size, values: vec![topology.background; count as usize] };
        topology.tiles.iter().for_each(|tile| dense.fill(tile));
        for leaf in &topology.leaves {
            let values = leaf.values(cursor, &coding, topology.background)?;
            dense.copy(leaf, &values);
        }
        let values = grid(file, size, 1, dense.values)?;
        // Index coordinates are those of the middles of voxels.
        let corner = DVec3::from_array(low.map(|axis| axis as f64)) - 0.5;
        let index_from_unit =
            DAffine3 { matrix3: DMat3::from_diagonal(DVec3::from_array(size.map(f64::from))), translation: corner };
        Ok(Loaded { grid: values, space_from_unit: space_from_index * index_from_unit, unit_m: None })
    }
}

/// How the values of a grid are stored.
#[derive(Clone, Copy, Debug)]
struct Coding {
    compression: u32,
    half: bool,
}

/// The box of active voxels with all its values, x fastest.
struct Dense {
    low: [i64; 3],
    size: [u32; 3],
    values: Vec<f32>,
}

impl Dense {
    /// The part of `from..from + side` along an axis that is inside, from its low end.
    fn inside(&self, axis: usize, from: i64, side: i64) -> std::ops::Range<usize> {
        let clamped = |at: i64| (at - self.low[axis]).clamp(0, i64::from(self.size[axis])) as usize;
        clamped(from)..clamped(from + side)
    }

    fn fill(&mut self, tile: &Tile) {
        let [x, y, z] = [0, 1, 2].map(|axis| self.inside(axis, tile.origin[axis], tile.side));
        for k in z {
            for j in y.clone() {
                let row = (k * self.size[1] as usize + j) * self.size[0] as usize;
                self.values[row + x.start..row + x.end].fill(tile.value);
            }
        }
    }

    /// Within a leaf z is fastest.
    fn copy(&mut self, leaf: &Leaf, values: &[f32]) {
        let [x, y, z] = [0, 1, 2].map(|axis| self.inside(axis, leaf.origin[axis], Leaf::SIDE));
        let part = |axis: usize, at: usize| (at as i64 + self.low[axis] - leaf.origin[axis]) as usize;
        for k in z {
            for j in y.clone() {
                let row = (k * self.size[1] as usize + j) * self.size[0] as usize;
                for i in x.clone() {
                    self.values[row + i] = values[(part(0, i) * 8 + part(1, j)) * 8 + part(2, k)];
                }
            }
        }
    }
}

/// space_from_index, of the linear maps.
fn transform(cursor: &mut Cursor) -> Result<DAffine3, SceneError> {
    let file = cursor.file;
    let name = cursor.text("transform")?;
    let field_name = "transform";
    let mut vector = || -> Result<DVec3, SceneError> {
        let [x, y, z] = [cursor.f64(field_name)?, cursor.f64(field_name)?, cursor.f64(field_name)?];
        Ok(DVec3::new(x, y, z))
    };
    let map = match name.as_str() {
        // What follows the first vectors is derived from them.
        "UniformScaleMap" | "ScaleMap" => {
            let scale = vector()?;
            (0..4).try_for_each(|_| vector().map(drop))?;
            DAffine3::from_scale(scale)
        }
        "UniformScaleTranslateMap" | "ScaleTranslateMap" => {
            let (translation, scale) = (vector()?, vector()?);
            (0..4).try_for_each(|_| vector().map(drop))?;
            DAffine3 { matrix3: DMat3::from_diagonal(scale), translation }
        }
        "TranslationMap" => DAffine3::from_translation(vector()?),
        "AffineMap" | "UnitaryMap" => {
            // Four rows of four, for row vectors: the last row is the translation, the last column 0 0 0 1.
            let rows: [f64; 16] = {
                let mut rows = [0.0; 16];
                for value in &mut rows {
                    *value = cursor.f64(field_name)?;
                }
                rows
            };
            let row = |index: usize| DVec3::from_slice(&rows[4 * index..4 * index + 3]);
            DAffine3 { matrix3: DMat3::from_cols(row(0), row(1), row(2)), translation: row(3) }
        }
        other => {
            let feature = format!("a transform of type {}", quoted(other));
            return Err(SceneError::Unsupported { file: file.to_owned(), feature });
        }
    };
    check_axes(file, field_name, map.matrix3)?;
    if !map.translation.is_finite() {
        return Err(field(file, field_name, "a finite translation", "another"));
    }
    Ok(map)
}

/// Bytes, read from front to back.
struct Cursor<'a> {
    file: &'a str,
    all: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], SceneError> {
        let rest = &self.all[self.at..];
        let taken = rest.get(..count).ok_or_else(|| {
            field(self.file, what, format_args!("{count} bytes at {}", self.at), format_args!("{}", rest.len()))
        })?;
        self.at += count;
        Ok(taken)
    }

    fn seek(&mut self, at: u64, what: &str) -> Result<(), SceneError> {
        let length = self.all.len();
        self.at = usize::try_from(at)
            .ok()
            .filter(|&at| at <= length)
            .ok_or_else(|| field(self.file, what, format_args!("at most {length}, the length of the file"), at))?;
        Ok(())
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], SceneError> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N, what)?);
        Ok(bytes)
    }

    fn u8(&mut self, what: &str) -> Result<u8, SceneError> {
        Ok(self.array::<1>(what)?[0])
    }

    fn u32(&mut self, what: &str) -> Result<u32, SceneError> {
        self.array(what).map(u32::from_le_bytes)
    }

    fn u64(&mut self, what: &str) -> Result<u64, SceneError> {
        self.array(what).map(u64::from_le_bytes)
    }

    fn f32(&mut self, what: &str) -> Result<f32, SceneError> {
        self.array(what).map(f32::from_le_bytes)
    }

    fn f64(&mut self, what: &str) -> Result<f64, SceneError> {
        self.array(what).map(f64::from_le_bytes)
    }

    fn text(&mut self, what: &str) -> Result<String, SceneError> {
        let length = self.u32(what)? as usize;
        Ok(String::from_utf8_lossy(self.take(length, what)?).into_owned())
    }

    /// Passes over metadata; whether it says that values are saved as half floats.
    fn metadata(&mut self) -> Result<bool, SceneError> {
        let count = self.u32("metadata")?;
        check_limit(self.file, "entries of metadata", MAX_ENTRIES, u64::from(count))?;
        let mut half = false;
        for _ in 0..count {
            let name = self.text("metadata: name")?;
            self.text("metadata: type")?;
            let length = self.u32("metadata: length")? as usize;
            let value = self.take(length, "metadata: value")?;
            half |= name == "is_saved_as_half_float" && value == [1];
        }
        Ok(half)
    }
}

#[cfg(test)]
pub(super) mod tests;
