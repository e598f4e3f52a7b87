//! What can be wrong with a scene, each as one line that names the file, the field and what was expected.

use std::io;

/// Why a scene did not load.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// Neither a built-in scene nor a file of a known kind.
    #[error(
        "unknown scene '{spec}': expected one of {names}, or a path that ends in .toml, .xml, .glb, .gltf, .obj or .ply",
        names = super::Scene::built_in_names().join(", "),
        spec = spec.escape_debug()
    )]
    Unknown {
        /// What was asked for.
        spec: String,
    },
    /// The file could not be read.
    #[error("{file}: {source}")]
    Io {
        /// The file.
        file: String,
        /// What the operating system says.
        source: io::Error,
    },
    /// The file is not TOML or XML, or has keys, elements or types that no scene has.
    #[error("{file}: line {line}, column {column}: {message}")]
    Syntax {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Column in characters, from 1.
        column: usize,
        /// What was expected.
        message: String,
    },
    /// A field's value is out of range or names what is not there.
    #[error("{file}: {field}: expected {expected}, found {found}")]
    Field {
        /// The file.
        file: String,
        /// Path of the field, such as `material 'glass': ior`.
        field: String,
        /// What may stand there.
        expected: String,
        /// What stands there.
        found: String,
    },
    /// The file is damaged or contradicts itself.
    #[error("{file}: {reason}")]
    Malformed {
        /// The file.
        file: String,
        /// What is wrong, and where.
        reason: String,
    },
    /// The file needs what is not there yet.
    #[error("{file}: {feature} is not supported")]
    Unsupported {
        /// The file.
        file: String,
        /// What it needs.
        feature: String,
    },
    /// More than is loaded from a file nobody vouches for.
    #[error("{file}: {what}: at most {limit} are loaded, found {requested}")]
    LimitExceeded {
        /// The file.
        file: String,
        /// What there is too much of.
        what: &'static str,
        /// How many are allowed.
        limit: u64,
        /// How many were asked for.
        requested: u64,
    },
}
