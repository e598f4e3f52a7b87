//! The bytes of a glTF file: the GLB container, external files and data URIs.

use super::super::SceneError;
use super::super::untrusted::{MAX_FILE_BYTES, check_limit, read_file};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::path::{Component, Path};

/// JSON text and the binary chunk behind it.
pub(super) struct Container<'a> {
    pub(super) json: &'a [u8],
    pub(super) binary: Option<&'a [u8]>,
}

/// Takes a file apart: GLB where it starts with its magic number, else plain JSON.
pub(super) fn split(bytes: &[u8]) -> Result<Container<'_>, String> {
    if !bytes.starts_with(b"glTF") {
        return Ok(Container { json: bytes, binary: None });
    }
    let header = |at: usize| -> Result<u32, String> {
        let word = bytes.get(at..at + 4).and_then(|word| word.try_into().ok());
        word.map(u32::from_le_bytes).ok_or_else(|| "broken GLB: the header is cut off".to_owned())
    };
    let version = header(4)?;
    if version != 2 {
        return Err(format!("expected GLB version 2, found {version}"));
    }
    let length = header(8)? as usize;
    let whole =
        bytes.get(12..length).ok_or_else(|| format!("broken GLB: {length} bytes announced, {} there", bytes.len()))?;
    let (kind, json, rest) = chunk(whole)?;
    if kind != b"JSON" {
        return Err("broken GLB: the first chunk is not JSON".to_owned());
    }
    let binary = if rest.is_empty() { None } else { Some(chunk(rest)?) };
    Ok(Container { json, binary: binary.filter(|(kind, ..)| *kind == b"BIN\0").map(|(_, bytes, _)| bytes) })
}

type Chunk<'a> = (&'a [u8; 4], &'a [u8], &'a [u8]);

/// Kind and bytes of the first chunk, and what follows it.
fn chunk(bytes: &[u8]) -> Result<Chunk<'_>, String> {
    let cut = || "broken GLB: a chunk is cut off".to_owned();
    let (length, rest) = bytes.split_first_chunk::<4>().ok_or_else(cut)?;
    let (kind, rest) = rest.split_first_chunk::<4>().ok_or_else(cut)?;
    let (content, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize).ok_or_else(cut)?;
    Ok((kind, content, rest))
}

/// All buffers, each at least as long as it says.
pub(super) fn buffers(
    file: &str,
    folder: &Path,
    document: &gltf::Document,
    binary: Option<&[u8]>,
) -> Result<Vec<Vec<u8>>, SceneError> {
    let mut total = 0;
    document
        .buffers()
        .map(|buffer| {
            total += buffer.length() as u64;
            check_limit(file, "bytes of all buffers", MAX_FILE_BYTES, total)?;
            let malformed = |reason: String| SceneError::Malformed {
                file: file.to_owned(),
                reason: format!("buffer {}: {reason}", buffer.index()),
            };
            let mut bytes = match buffer.source() {
                gltf::buffer::Source::Bin => {
                    binary.ok_or_else(|| malformed("the binary chunk is missing".to_owned()))?.to_vec()
                }
                gltf::buffer::Source::Uri(uri) => read_uri(file, folder, uri)?,
            };
            if bytes.len() < buffer.length() {
                return Err(malformed(format!("{} bytes announced, {} there", buffer.length(), bytes.len())));
            }
            bytes.truncate(buffer.length());
            Ok(bytes)
        })
        .collect()
}

/// The bytes behind a URI: base64 data, or a file within the folder of the glTF file.
pub(super) fn read_uri(file: &str, folder: &Path, uri: &str) -> Result<Vec<u8>, SceneError> {
    let malformed = |reason: &str| {
        let shown: String = uri.chars().take(60).collect();
        SceneError::Malformed { file: file.to_owned(), reason: format!("uri '{}': {reason}", shown.escape_debug()) }
    };
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, encoded) = data.split_once(";base64,").ok_or_else(|| malformed("expected base64 data"))?;
        return STANDARD.decode(encoded).map_err(|_| malformed("expected base64 data"));
    }
    let name = percent_decoded(uri).ok_or_else(|| malformed("expected a file name"))?;
    let path = Path::new(&name);
    if uri.contains("://") || !path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
        return Err(malformed("expected a file in the folder of the glTF file"));
    }
    read_file(&folder.join(path), MAX_FILE_BYTES)
}

/// RFC 3986, 2.1; `None` where it is not UTF-8.
fn percent_decoded(uri: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&first, tail)) = rest.split_first() {
        let code = if first == b'%' { tail.get(..2) } else { None };
        let code = code.and_then(|digits| u8::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok());
        bytes.push(code.unwrap_or(first));
        rest = if code.is_some() { &tail[2..] } else { tail };
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_outside_the_folder_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        for uri in ["../a.bin", "/etc/passwd", "http://x/a.bin", "file:///a", "a/../../b", "%2e%2e/a.bin"] {
            let line = read_uri("a.gltf", folder.path(), uri).unwrap_err().to_string();
            assert!(line.ends_with("expected a file in the folder of the glTF file"), "{line}");
        }
    }

    #[test]
    fn data_and_files_with_spaces_are_read() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a b.bin"), [1, 2]).unwrap();
        assert_eq!(read_uri("a.gltf", folder.path(), "a%20b.bin").unwrap(), [1, 2]);
        assert_eq!(read_uri("a.gltf", folder.path(), "data:application/octet-stream;base64,AQI=").unwrap(), [1, 2]);
        assert!(read_uri("a.gltf", folder.path(), "data:text/plain,hello").is_err());
        assert_eq!(percent_decoded("100%").as_deref(), Some("100%"));
    }
}
