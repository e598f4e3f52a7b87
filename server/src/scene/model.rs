//! Model files by their extension.

use super::{Part, SceneError, gltf, obj, ply};
use std::path::Path;

/// Reads a model: .glb, .gltf, .obj or .ply.
pub(super) fn load(path: &Path) -> Result<Part, SceneError> {
    match extension(path).as_str() {
        "glb" | "gltf" => gltf::load(path),
        "obj" => obj::load(path),
        "ply" => ply::load(path),
        _ => Err(SceneError::Malformed {
            file: path.display().to_string(),
            reason: "expected a model that ends in .glb, .gltf, .obj or .ply".to_owned(),
        }),
    }
}

/// The extension in lower case; empty where there is none.
pub(super) fn extension(path: &Path) -> String {
    path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default()
}
