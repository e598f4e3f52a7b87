//! What can be wrong with a head trace, in one line that names file, place, field and expectation.

use std::path::Path;

/// A head trace that cannot be used. Every variant is the fault of the input, never of this program, so a
/// command that meets one ends with exit status 2.
#[derive(Debug, thiserror::Error)]
pub enum TraceError {
    /// The file cannot be opened, read or written.
    #[error("{file}: {source}")]
    Io {
        /// Path as given.
        file: String,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// A line is not a pose.
    #[error("{file}:{line}: {field}: expected {expected}, found {found}")]
    Malformed {
        /// Path as given.
        file: String,
        /// Line number, counted from 1.
        line: usize,
        /// Column of the TUM format, or `columns`.
        field: &'static str,
        /// What was expected.
        expected: String,
        /// What is there, cut to a readable length.
        found: String,
    },
    /// There are fewer poses than a trace needs.
    #[error("{file}: poses: expected at least {expected}, found {found}")]
    TooFewPoses {
        /// Path as given.
        file: String,
        /// Smallest number of poses.
        expected: usize,
        /// Poses that are there.
        found: usize,
    },
    /// More is asked for than we are ready to hold.
    #[error("{file}: {limit}: expected at most {allowed}, found {requested}")]
    LimitExceeded {
        /// Path as given, or the name of the parameter.
        file: String,
        /// Which limit, with its unit.
        limit: &'static str,
        /// Largest value that is accepted.
        allowed: u64,
        /// Value that was asked for.
        requested: u64,
    },
    /// A parameter of a conversion or of a synthesis is out of range.
    #[error("{field}: expected {expected}, found {found}")]
    Parameter {
        /// Name of the flag.
        field: &'static str,
        /// What was expected.
        expected: String,
        /// What was given.
        found: String,
    },
}

impl TraceError {
    /// An input or output error that names its file.
    pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> TraceError + '_ {
        |source| TraceError::Io { file: path.display().to_string(), source }
    }
}
