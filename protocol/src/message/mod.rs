//! The messages of a session, and their bytes.
//!
//! What travels with every frame or pose is packed by hand (tables in `docs/wire-format.md`); what travels
//! seldom is bincode, confined to `control`. The head of a hello and the whole of an error never change
//! between versions, so that two versions can tell each other that they are two.

mod control;
mod frame_path;

pub use control::{
    Capabilities, ErrorCode, FrameAck, FrameBegin, FrameEnd, FramePurpose, Hello, Limiter, LimiterKind, Prediction,
    Statistics, StillRequest, Viewport, Welcome,
};
pub use frame_path::{MAX_POSE_SAMPLES, PictureMessage, PoseSample, StripMessage};

use crate::Timestamp;
use crate::codec::{DecodeError, Limits};

/// Version of the wire format; it changes with every change of bytes.
pub const VERSION: u16 = 6;

/// First bytes of every session.
pub const MAGIC: [u8; 4] = *b"WARP";

/// Longest text of an error, in bytes; what is longer is cut, so that every receiver accepts it.
pub const MAX_ERROR_TEXT_BYTES: usize = 4096;

/// Everything that one end says to the other.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// Client: who it is and what it wants. The first message.
    Hello(Hello),
    /// Server: the session is open.
    Welcome(Welcome),
    /// Client: where the head was.
    Poses(Vec<PoseSample>),
    /// Server: a frame starts.
    FrameBegin(FrameBegin),
    /// Server: rows of a frame.
    Strip(StripMessage),
    /// Server: the frame is whole.
    FrameEnd(FrameEnd),
    /// Client: the frame has arrived.
    FrameAck(FrameAck),
    /// Server: running totals of the session.
    Statistics(Statistics),
    /// Client: a converged picture, please.
    StillRequest(StillRequest),
    /// Either: are you there? Carries the sender's time.
    Ping(Timestamp),
    /// Either: the answer, with the time of the ping.
    Pong(Timestamp),
    /// Either: why the session ends. The last message.
    Error {
        /// What kind of failure.
        code: ErrorCode,
        /// In words.
        text: String,
    },
    /// Either: the session ends as it should. The last message.
    Bye,
    /// Server: radiance of a node, or source of a layer, of a frame whose strips have been sent.
    Picture(PictureMessage),
}

/// Kinds of messages, by wire code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum MessageKind {
    /// [`Message::Hello`]
    Hello = 1,
    /// [`Message::Welcome`]
    Welcome = 2,
    /// [`Message::Poses`]
    Poses = 3,
    /// [`Message::FrameBegin`]
    FrameBegin = 4,
    /// [`Message::Strip`]
    Strip = 5,
    /// [`Message::FrameEnd`]
    FrameEnd = 6,
    /// [`Message::FrameAck`]
    FrameAck = 7,
    /// [`Message::Statistics`]
    Statistics = 8,
    /// [`Message::StillRequest`]
    StillRequest = 9,
    /// [`Message::Ping`]
    Ping = 10,
    /// [`Message::Pong`]
    Pong = 11,
    /// [`Message::Error`]
    Error = 12,
    /// [`Message::Bye`]
    Bye = 13,
    /// [`Message::Picture`]
    Picture = 14,
}

impl MessageKind {
    /// Every kind there is.
    pub const ALL: [MessageKind; 14] = [
        MessageKind::Hello,
        MessageKind::Welcome,
        MessageKind::Poses,
        MessageKind::FrameBegin,
        MessageKind::Strip,
        MessageKind::FrameEnd,
        MessageKind::FrameAck,
        MessageKind::Statistics,
        MessageKind::StillRequest,
        MessageKind::Ping,
        MessageKind::Pong,
        MessageKind::Error,
        MessageKind::Bye,
        MessageKind::Picture,
    ];

    /// The kind of a wire code.
    pub fn from_code(code: u8) -> Result<MessageKind, DecodeError> {
        let known = MessageKind::ALL.into_iter().find(|&kind| kind as u8 == code);
        known.ok_or(DecodeError::Unsupported { field: "kind of message", found: u32::from(code) })
    }

    /// Longest payload that is accepted.
    pub fn max_bytes(self, limits: &Limits) -> usize {
        if matches!(self, MessageKind::Strip | MessageKind::Picture) {
            limits.strip_bytes
        } else {
            limits.control_bytes
        }
    }
}

impl Message {
    /// The kind of this message.
    pub fn kind(&self) -> MessageKind {
        match self {
            Message::Hello(_) => MessageKind::Hello,
            Message::Welcome(_) => MessageKind::Welcome,
            Message::Poses(_) => MessageKind::Poses,
            Message::FrameBegin(_) => MessageKind::FrameBegin,
            Message::Strip(_) => MessageKind::Strip,
            Message::FrameEnd(_) => MessageKind::FrameEnd,
            Message::FrameAck(_) => MessageKind::FrameAck,
            Message::Statistics(_) => MessageKind::Statistics,
            Message::StillRequest(_) => MessageKind::StillRequest,
            Message::Ping(_) => MessageKind::Ping,
            Message::Pong(_) => MessageKind::Pong,
            Message::Error { .. } => MessageKind::Error,
            Message::Bye => MessageKind::Bye,
            Message::Picture(_) => MessageKind::Picture,
        }
    }

    /// Appends the payload, without the framing. A pose in a frame's head, a welcome or a still request must be
    /// valid ([`crate::Pose::is_valid`]): the receiver refuses the message otherwise.
    pub fn write_payload(&self, out: &mut Vec<u8>) {
        match self {
            Message::Hello(hello) => {
                out.extend_from_slice(&MAGIC);
                out.extend_from_slice(&VERSION.to_le_bytes());
                control::write(hello, out);
            }
            Message::Welcome(welcome) => control::write(welcome, out),
            Message::Poses(samples) => frame_path::write_poses(samples, out),
            Message::FrameBegin(begin) => control::write(begin, out),
            Message::Strip(strip) => frame_path::write_strip(strip, out),
            Message::FrameEnd(end) => control::write(end, out),
            Message::FrameAck(ack) => control::write(ack, out),
            Message::Statistics(statistics) => control::write(statistics, out),
            Message::StillRequest(request) => control::write(request, out),
            Message::Ping(time) | Message::Pong(time) => out.extend_from_slice(&time.micros.to_le_bytes()),
            Message::Error { code, text } => {
                out.extend_from_slice(&(*code as u16).to_le_bytes());
                out.extend_from_slice(&text.as_bytes()[..error_text_bytes(text)]);
            }
            Message::Bye => {}
            Message::Picture(picture) => frame_path::write_picture(picture, out),
        }
    }

    /// Reads a payload of this kind.
    pub fn read_payload(kind: MessageKind, payload: &[u8], limits: &Limits) -> Result<Message, DecodeError> {
        Ok(match kind {
            MessageKind::Hello => Message::Hello(read_hello(payload)?),
            MessageKind::Welcome => {
                let welcome: Welcome = control::read(payload, "welcome")?;
                welcome.check()?;
                Message::Welcome(welcome)
            }
            MessageKind::Poses => Message::Poses(frame_path::read_poses(payload)?),
            MessageKind::FrameBegin => {
                let begin: FrameBegin = control::read(payload, "frame begin")?;
                begin.shape.check(limits)?;
                Message::FrameBegin(begin)
            }
            MessageKind::Strip => Message::Strip(frame_path::read_strip(payload)?),
            MessageKind::FrameEnd => Message::FrameEnd(control::read(payload, "frame end")?),
            MessageKind::FrameAck => Message::FrameAck(control::read(payload, "frame acknowledgement")?),
            MessageKind::Statistics => Message::Statistics(control::read(payload, "statistics")?),
            MessageKind::StillRequest => {
                let request: StillRequest = control::read(payload, "still request")?;
                request.check()?;
                Message::StillRequest(request)
            }
            MessageKind::Ping => Message::Ping(read_time(payload)?),
            MessageKind::Pong => Message::Pong(read_time(payload)?),
            MessageKind::Error => read_error(payload)?,
            MessageKind::Picture => Message::Picture(frame_path::read_picture(payload)?),
            MessageKind::Bye if payload.is_empty() => Message::Bye,
            MessageKind::Bye => return Err(DecodeError::Malformed { field: "bye", expected: "no payload" }),
        })
    }
}

/// As many bytes of an error's text as travel: whole characters.
fn error_text_bytes(text: &str) -> usize {
    let longest = text.len().min(MAX_ERROR_TEXT_BYTES);
    (0..=longest).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0)
}

fn read_hello(payload: &[u8]) -> Result<Hello, DecodeError> {
    let (head, rest) = payload.split_first_chunk::<6>().ok_or(DecodeError::Truncated { field: "hello" })?;
    if head[..4] != MAGIC {
        return Err(DecodeError::Malformed { field: "hello", expected: "the letters WARP" });
    }
    let version = u16::from_le_bytes([head[4], head[5]]);
    if version != VERSION {
        return Err(DecodeError::Unsupported { field: "protocol version", found: u32::from(version) });
    }
    let hello: Hello = control::read(rest, "hello")?;
    hello.check()?;
    Ok(hello)
}

fn read_time(payload: &[u8]) -> Result<Timestamp, DecodeError> {
    let bytes = payload.try_into().map_err(|_| DecodeError::Malformed { field: "time", expected: "8 bytes" })?;
    Ok(Timestamp { micros: u64::from_le_bytes(bytes) })
}

fn read_error(payload: &[u8]) -> Result<Message, DecodeError> {
    let (code, text) = payload.split_first_chunk::<2>().ok_or(DecodeError::Truncated { field: "error" })?;
    // A peer's text may be anything: what is no character is replaced, not refused.
    let text = String::from_utf8_lossy(text).into_owned();
    Ok(Message::Error { code: ErrorCode::from_wire(u16::from_le_bytes(*code)), text })
}
