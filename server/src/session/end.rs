//! Why a session is over, and what the client is told of it.

use warplight_protocol::codec::DecodeError;
use warplight_protocol::message::{ErrorCode, Message};

/// Why a session is over.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SessionEnd {
    /// The client said goodbye.
    #[error("the client left")]
    Bye,
    /// The client reported an error.
    #[error("the client ended the session: {0}")]
    ByPeer(String),
    /// The client sent what it must not.
    #[error("{0}")]
    Decode(#[from] DecodeError),
    /// The client said nothing for [`DEAD_PEER`](super::DEAD_PEER).
    #[error("the client said nothing for 2 s")]
    Silent,
    /// No hello within [`HANDSHAKE`](super::HANDSHAKE).
    #[error("refused: the client did not say hello within 5 s")]
    NoHello,
    /// The client does not know the token.
    #[error("refused: {0}")]
    Unauthorised(&'static str),
    /// There are as many sessions as this server takes.
    #[error("refused: this server has its {0} sessions already")]
    Busy(usize),
    /// The client says too much.
    #[error("refused: more than {per_sec} {what} per second")]
    Flood {
        /// Of what.
        what: &'static str,
        /// What is allowed.
        per_sec: u32,
    },
    /// The client asks and does not read the answers, or takes nothing for [`DEAD_PEER`](super::DEAD_PEER).
    #[error("the client does not read what it is sent")]
    Unread,
    /// This end said goodbye.
    #[error("the server is stopping")]
    Stopping,
}

impl SessionEnd {
    /// What the client is told; nothing where it would not hear, or has ended the session itself.
    pub(super) fn message(&self) -> Option<Message> {
        let code = match self {
            SessionEnd::Bye | SessionEnd::ByPeer(_) => return None,
            SessionEnd::Stopping => return Some(Message::Bye),
            SessionEnd::Decode(error) => return Some(Message::Error { code: error.into(), text: refusal(error) }),
            SessionEnd::Silent | SessionEnd::NoHello | SessionEnd::Unread => ErrorCode::Timeout,
            SessionEnd::Unauthorised(_) => ErrorCode::Unauthorised,
            SessionEnd::Busy(_) => ErrorCode::Busy,
            SessionEnd::Flood { .. } => ErrorCode::Limit,
        };
        Some(Message::Error { code, text: self.to_string() })
    }
}

/// What a refused client is told: in words, and for a version with both versions.
fn refusal(error: &DecodeError) -> String {
    match error {
        DecodeError::Unsupported { field: "protocol version", found } => format!(
            "this server speaks version {} of the Warplight protocol, the client version {found}: install the same release at both ends",
            warplight_protocol::message::VERSION
        ),
        error => error.to_string(),
    }
}
