//! Limits on what a scene file can make the server read and allocate.
//!
//! Scene files come from anywhere. Each limit is checked before the allocation it bounds; all of them
//! together keep a scene below about 4 GiB. A scene beyond them is refused, never truncated.

use super::SceneError;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Longest scene.toml in bytes; ours have a few kilobytes.
pub(crate) const MAX_TOML_BYTES: u64 = 4 << 20;
/// Longest Mitsuba file in bytes; its tree takes some twenty times that.
pub(crate) const MAX_XML_BYTES: u64 = 16 << 20;
/// Deepest nesting of elements in a Mitsuba file; scenes have less than ten levels.
pub(crate) const MAX_XML_DEPTH: usize = 64;
/// Most elements of a Mitsuba scene with all that it includes.
pub(crate) const MAX_XML_ELEMENTS: u64 = 1_000_000;
/// Most files that include each other in a row.
pub(crate) const MAX_INCLUDES: usize = 16;
/// Most bytes of an attribute after parameters are put in: parameters may hold parameters.
pub(crate) const MAX_ATTRIBUTE_BYTES: u64 = 1 << 20;
/// Longest model or image file in bytes.
pub(crate) const MAX_FILE_BYTES: u64 = 1 << 30;
/// Most triangles of a scene: their vertices and the acceleration structure take about 100 bytes each.
pub(crate) const MAX_TRIANGLES: u64 = 20_000_000;
/// Most vertices of a scene, 32 bytes each.
pub(crate) const MAX_VERTICES: u64 = 30_000_000;
/// Most texels of an image; an 8192x4096 environment, 12 bytes each, takes half of them.
pub(crate) const MAX_TEXELS: u64 = 1 << 26;
/// Most bytes of the images of a scene in memory: 16 of 4096 by 4096 texels in 8-bit RGBA.
pub(crate) const MAX_IMAGE_BYTES: u64 = 1 << 30;
/// Largest image side in texels.
pub(crate) const MAX_IMAGE_SIDE: u32 = 16_384;
/// Most materials, textures, shapes, cameras or nodes of one file.
pub(crate) const MAX_ITEMS: u64 = 100_000;
/// Most values of a volume, 4 bytes each: 640 cells a side.
pub(crate) const MAX_VOLUME_VALUES: u64 = 1 << 28;
/// Largest coordinate in metres: beyond it f32 positions are coarser than 6 cm.
pub(crate) const MAX_COORDINATE_M: f32 = 1e6;

/// Reads a regular file of at most `limit` bytes. Devices and pipes, which may never end, are refused.
pub(crate) fn read_file(path: &Path, limit: u64) -> Result<Vec<u8>, SceneError> {
    let name = path.display().to_string();
    let io_error = |source| SceneError::Io { file: name.clone(), source };
    let metadata = std::fs::metadata(path).map_err(io_error)?;
    if !metadata.is_file() {
        return Err(SceneError::Malformed { file: name, reason: "expected a regular file".to_owned() });
    }
    check_limit(&name, "bytes", limit, metadata.len())?;
    let mut bytes = Vec::with_capacity(metadata.len() as usize);
    File::open(path).map_err(io_error)?.take(limit + 1).read_to_end(&mut bytes).map_err(io_error)?;
    check_limit(&name, "bytes", limit, bytes.len() as u64)?;
    Ok(bytes)
}

/// Refuses what is beyond a limit.
pub(crate) fn check_limit(file: &str, what: &'static str, limit: u64, requested: u64) -> Result<(), SceneError> {
    if requested > limit {
        return Err(SceneError::LimitExceeded { file: file.to_owned(), what, limit, requested });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_beyond_the_limit_is_refused_before_it_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("long.toml");
        std::fs::write(&path, [b' '; 100]).unwrap();
        assert_eq!(read_file(&path, 100).unwrap().len(), 100);
        let error = read_file(&path, 99).unwrap_err().to_string();
        assert!(error.ends_with("long.toml: bytes: at most 99 are loaded, found 100"), "{error}");
    }

    #[test]
    fn a_folder_or_a_device_is_no_scene() {
        let folder = tempfile::tempdir().unwrap();
        assert!(read_file(folder.path(), 10).unwrap_err().to_string().contains("regular file"));
        if Path::new("/dev/zero").exists() {
            assert!(read_file(Path::new("/dev/zero"), 10).is_err());
        }
    }
}
