//! Accessors: typed numbers out of buffers, with every offset checked.
//!
//! Converts all component types to f32 (normalised integers as in section 3.11 of the specification) and
//! applies sparse replacements. What a file announces is held against the bytes that are there before
//! anything is allocated; an accessor without bytes counts as zeros and is limited by the vertex limit.

use super::super::SceneError;
use super::super::untrusted::{MAX_VERTICES, check_limit};
use super::Source;
use gltf::accessor::DataType;
use gltf::accessor::sparse::IndexType;

impl Source {
    /// Vectors of `N` components as f32.
    pub(super) fn vectors<const N: usize>(&self, accessor: &gltf::Accessor) -> Result<Vec<[f32; N]>, SceneError> {
        if accessor.dimensions().multiplicity() != N {
            return Err(self.broken(accessor, format!("expected {N} components")));
        }
        let (data_type, normalized) = (accessor.data_type(), accessor.normalized());
        let step = data_type.size();
        self.elements(accessor, [0.0; N], |bytes| {
            std::array::from_fn(|index| component(&bytes[index * step..], data_type, normalized))
        })
    }

    /// Indices.
    pub(super) fn indices(&self, accessor: &gltf::Accessor) -> Result<Vec<u32>, SceneError> {
        let data_type = accessor.data_type();
        let is_index = matches!(data_type, DataType::U8 | DataType::U16 | DataType::U32);
        if accessor.dimensions().multiplicity() != 1 || !is_index {
            return Err(self.broken(accessor, "expected indices".to_owned()));
        }
        self.elements(accessor, 0, |bytes| unsigned(bytes, data_type.size()))
    }

    /// All elements, each read from its own bytes; `zero` where there are none.
    fn elements<T: Copy>(
        &self,
        accessor: &gltf::Accessor,
        zero: T,
        read: impl Fn(&[u8]) -> T,
    ) -> Result<Vec<T>, SceneError> {
        let size = accessor.size();
        let count = accessor.count();
        // A triangle list has up to six indices per vertex.
        check_limit(&self.file, "elements of an accessor", 6 * MAX_VERTICES, count as u64)?;
        let beyond = || self.broken(accessor, "reaches beyond its buffer view".to_owned());
        let mut elements = match accessor.view() {
            Some(view) => {
                let bytes = self.view(&view)?.get(accessor.offset()..).ok_or_else(beyond)?;
                let stride = view.stride().unwrap_or(size).max(size);
                self.strided(bytes, stride, size, count).ok_or_else(beyond)?.map(&read).collect()
            }
            None => {
                check_limit(&self.file, "elements without bytes", MAX_VERTICES, count as u64)?;
                vec![zero; count]
            }
        };
        if let Some(sparse) = accessor.sparse() {
            let (indices, values) = (sparse.indices(), sparse.values());
            let index_size = match indices.index_type() {
                IndexType::U8 => 1,
                IndexType::U16 => 2,
                IndexType::U32 => 4,
            };
            let index_bytes = self.view(&indices.view())?.get(indices.offset()..).ok_or_else(beyond)?;
            let value_bytes = self.view(&values.view())?.get(values.offset()..).ok_or_else(beyond)?;
            let places = self.strided(index_bytes, index_size, index_size, sparse.count()).ok_or_else(beyond)?;
            let replacements = self.strided(value_bytes, size, size, sparse.count()).ok_or_else(beyond)?;
            for (place, replacement) in places.zip(replacements) {
                let place = unsigned(place, index_size) as usize;
                *elements.get_mut(place).ok_or_else(beyond)? = read(replacement);
            }
        }
        Ok(elements)
    }

    /// `count` slices of `size` bytes, `stride` apart; `None` where they are not all there.
    fn strided<'a>(
        &self,
        bytes: &'a [u8],
        stride: usize,
        size: usize,
        count: usize,
    ) -> Option<impl Iterator<Item = &'a [u8]> + use<'a>> {
        let needed = if count == 0 { 0 } else { stride.checked_mul(count - 1)?.checked_add(size)? };
        let bytes = bytes.get(..needed)?;
        Some((0..count).map(move |index| &bytes[index * stride..index * stride + size]))
    }

    fn broken(&self, accessor: &gltf::Accessor, reason: String) -> SceneError {
        self.malformed(format!("accessor {}: {reason}", accessor.index()))
    }
}

fn unsigned(bytes: &[u8], size: usize) -> u32 {
    bytes.iter().take(size).rev().fold(0, |value, &byte| value << 8 | u32::from(byte))
}

/// One component, little-endian; `bytes` holds at least its size.
fn component(bytes: &[u8], data_type: DataType, normalized: bool) -> f32 {
    let bits = unsigned(bytes, data_type.size());
    let (value, largest) = match data_type {
        DataType::F32 => return f32::from_bits(bits),
        DataType::U32 => (bits as f32, u32::MAX as f32),
        DataType::U16 => (bits as f32, 65_535.0),
        DataType::U8 => (bits as f32, 255.0),
        DataType::I16 => (f32::from(bits as u16 as i16), 32_767.0),
        DataType::I8 => (f32::from(bits as u8 as i8), 127.0),
    };
    if normalized { (value / largest).max(-1.0) } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_normalised_as_the_specification_says() {
        assert_eq!(component(&[255], DataType::U8, true), 1.0);
        assert_eq!(component(&[0x80], DataType::I8, true), -1.0);
        assert_eq!(component(&[0x81], DataType::I8, true), -1.0);
        assert_eq!(component(&[0, 0x80], DataType::I16, false), -32_768.0);
        assert_eq!(component(&[0xff, 0xff], DataType::U16, true), 1.0);
        assert_eq!(component(&1.5_f32.to_le_bytes(), DataType::F32, false), 1.5);
    }

    #[test]
    fn indices_are_little_endian() {
        assert_eq!(unsigned(&[1, 2, 3, 4], 4), 0x0403_0201);
        assert_eq!(unsigned(&[1, 2, 3, 4], 2), 0x0201);
    }
}
