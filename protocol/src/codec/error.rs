//! Why bytes from a peer are refused.

/// Why bytes from a peer are no strip or message. None of these is a panic, whatever the bytes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The bytes end before they should.
    #[error("truncated: {field} is cut off")]
    Truncated {
        /// What is cut off.
        field: &'static str,
    },
    /// A field has a value that it cannot have.
    #[error("malformed {field}: expected {expected}")]
    Malformed {
        /// The field.
        field: &'static str,
        /// What it should be.
        expected: &'static str,
    },
    /// A version, kind or flag of which this build knows nothing.
    #[error("unsupported {field}: {found}")]
    Unsupported {
        /// The field.
        field: &'static str,
        /// Its value.
        found: u32,
    },
    /// More than the receiver is willing to hold.
    #[error("limit exceeded: {requested} requested, at most {limit}")]
    LimitExceeded {
        /// The limit.
        limit: usize,
        /// What was asked for.
        requested: usize,
    },
}
