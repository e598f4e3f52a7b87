//! glTF 2.0 (Khronos, 2021): .glb and .gltf files to a part of a scene.
//!
//! The crate `gltf` reads and validates the JSON; bytes are read here, because its readers trust offsets
//! and types. Node transforms are flattened; what a material has and no surface here can show is said in a
//! warning. Limits: see `untrusted`; files named by a .gltf must lie in its
//! own folder.

mod accessor;
mod container;
mod lights;
mod materials;
mod nodes;
mod primitive;
mod textures;
mod unsupported;

use super::untrusted::{MAX_FILE_BYTES, MAX_ITEMS, check_limit, read_file};
use super::{Part, SceneError};
use container::{Container, buffers, split};
use gltf::json::camera::Type;
use gltf::json::validation::Checked;
use std::path::Path;
use unsupported::Unsupported;

/// Extensions that a file may require. Quantised meshes cost nothing: accessors convert all number types.
const SUPPORTED: [&str; 12] = [
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// An opened file: the validated document and its bytes.
struct Source {
    /// Name for messages.
    file: String,
    document: gltf::Document,
    /// By index of the buffer.
    buffers: Vec<Vec<u8>>,
    /// Where relative names start.
    folder: std::path::PathBuf,
}

impl Source {
    fn malformed(&self, reason: impl Into<String>) -> SceneError {
        SceneError::Malformed { file: self.file.clone(), reason: reason.into() }
    }

    /// The bytes of a view, if they are all there.
    fn view(&self, view: &gltf::buffer::View) -> Result<&[u8], SceneError> {
        let end = view.offset().checked_add(view.length());
        let bytes = end.and_then(|end| self.buffers.get(view.buffer().index())?.get(view.offset()..end));
        bytes.ok_or_else(|| self.malformed(format!("buffer view {}: reaches beyond its buffer", view.index())))
    }
}

/// Reads a .glb or .gltf file.
pub(super) fn load(path: &Path) -> Result<Part, SceneError> {
    let source = open(path, &read_file(path, MAX_FILE_BYTES)?)?;
    let mut unsupported = Unsupported::default();
    let mut part = Part::default();
    let uv_sets = materials::read(&source, &mut part, &mut unsupported)?;
    nodes::read(&source, &uv_sets, &mut part, &mut unsupported)?;
    if source.document.animations().len() > 0 {
        unsupported.note("animations are not played", "");
    }
    part.warnings.extend(unsupported.warnings(&source.file));
    Ok(part)
}

fn open(path: &Path, bytes: &[u8]) -> Result<Source, SceneError> {
    let file = path.display().to_string();
    let malformed = |reason: String| SceneError::Malformed { file: file.clone(), reason };
    let Container { json, binary } = split(bytes).map_err(malformed)?;
    let mut root: gltf::json::Root =
        serde_json::from_slice(json).map_err(|error| malformed(format!("broken glTF: {error}")))?;
    if !root.asset.version.starts_with("2.") {
        let feature = format!("glTF version {:?} (2.0 is)", root.asset.version);
        return Err(SceneError::Unsupported { file, feature });
    }
    let items = root.nodes.len() + root.meshes.len() + root.accessors.len() + root.materials.len();
    check_limit(&file, "nodes, meshes, accessors and materials", MAX_ITEMS, items as u64)?;
    for name in std::mem::take(&mut root.extensions_required) {
        if !SUPPORTED.contains(&name.as_str()) {
            let feature = format!("the required extension '{}'", name.escape_debug());
            return Err(SceneError::Unsupported { file, feature });
        }
    }
    check_indices(&root).map_err(malformed)?;
    let document = gltf::Document::from_json(root).map_err(|error| malformed(validation_line(&error)))?;
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let buffers = buffers(&file, &folder, &document, binary)?;
    Ok(Source { file, document, buffers, folder })
}

/// What the crate takes for granted before or behind its own validation, and would panic about.
fn check_indices(root: &gltf::json::Root) -> Result<(), String> {
    for (index, mesh) in root.meshes.iter().enumerate() {
        let mut accessors = mesh.primitives.iter().flat_map(|primitive| primitive.attributes.values());
        if let Some(accessor) = accessors.find(|accessor| accessor.value() >= root.accessors.len()) {
            let count = root.accessors.len();
            return Err(format!("mesh {index}: expected one of {count} accessors, found {}", accessor.value()));
        }
    }
    for (index, image) in root.images.iter().enumerate() {
        if image.uri.is_none() && (image.buffer_view.is_none() || image.mime_type.is_none()) {
            return Err(format!("image {index}: expected a uri, or a bufferView with a mimeType"));
        }
    }
    for (index, camera) in root.cameras.iter().enumerate() {
        let has_lens = match camera.type_ {
            Checked::Valid(Type::Perspective) => camera.perspective.is_some(),
            Checked::Valid(Type::Orthographic) => camera.orthographic.is_some(),
            Checked::Invalid => false,
        };
        if !has_lens {
            return Err(format!("camera {index}: expected perspective or orthographic"));
        }
    }
    Ok(())
}

/// The first thing that validation found.
fn validation_line(error: &gltf::Error) -> String {
    match error {
        gltf::Error::Validation(found) => match found.first() {
            Some((path, error)) => format!("broken glTF: {path}: {error}"),
            None => "broken glTF".to_owned(),
        },
        other => format!("broken glTF: {}", super::picture::one_line(&other.to_string())),
    }
}

#[cfg(test)]
mod tests;
