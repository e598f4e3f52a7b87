//! Framing: messages to a byte stream and back, without reading or writing it.
//!
//! Each message is a length (u32, little-endian, counting what follows), a kind (u8) and a payload. Push
//! bytes in as they come, however they are cut; take messages out. The length is checked against the limit
//! of the kind as soon as five bytes are there, before anything is reserved.

use crate::codec::{DecodeError, Limits};
use crate::message::{Message, MessageKind};

/// Bytes before a payload.
pub const HEADER_BYTES: usize = 5;

/// Appends a message with its framing to `out`.
pub fn write_message(message: &Message, out: &mut Vec<u8>) {
    let start = out.len();
    out.extend_from_slice(&[0, 0, 0, 0, message.kind() as u8]);
    message.write_payload(out);
    let length = (out.len() - start - 4) as u32;
    out[start..start + 4].copy_from_slice(&length.to_le_bytes());
}

/// Takes a byte stream apart.
#[derive(Debug)]
pub struct Deframer {
    limits: Limits,
    buffer: Vec<u8>,
    consumed: usize,
    failed: Option<DecodeError>,
}

impl Deframer {
    /// A deframer at the start of a stream.
    pub fn new(limits: Limits) -> Deframer {
        Deframer { limits, buffer: Vec::new(), consumed: 0, failed: None }
    }

    /// Adds bytes in the order of their arrival.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.consumed > 0 {
            self.buffer.drain(..self.consumed);
            self.consumed = 0;
        }
        if self.failed.is_none() {
            self.buffer.extend_from_slice(bytes);
        }
    }

    /// The next whole message, or `None` until more bytes are pushed. After an error the stream is lost:
    /// the same error comes again.
    pub fn next_message(&mut self) -> Result<Option<Message>, DecodeError> {
        if let Some(error) = &self.failed {
            return Err(error.clone());
        }
        self.parse().inspect_err(|error| {
            self.failed = Some(error.clone());
            self.buffer = Vec::new();
            self.consumed = 0;
        })
    }

    fn parse(&mut self) -> Result<Option<Message>, DecodeError> {
        let rest = &self.buffer[self.consumed..];
        let Some((header, rest)) = rest.split_first_chunk::<HEADER_BYTES>() else {
            return Ok(None);
        };
        let length = u32::from_le_bytes([header[0], header[1], header[2], header[3]]) as usize;
        let kind = MessageKind::from_code(header[4])?;
        let payload_bytes = length
            .checked_sub(1)
            .ok_or(DecodeError::Malformed { field: "length of message", expected: "at least 1" })?;
        let limit = kind.max_bytes(&self.limits);
        if payload_bytes > limit {
            return Err(DecodeError::LimitExceeded { limit, requested: payload_bytes });
        }
        let Some(payload) = rest.get(..payload_bytes) else {
            return Ok(None);
        };
        let message = Message::read_payload(kind, payload, &self.limits)?;
        self.consumed += HEADER_BYTES + payload_bytes;
        Ok(Some(message))
    }

    /// Bytes held that are not yet a message.
    pub fn pending_bytes(&self) -> usize {
        self.buffer.len() - self.consumed
    }
}
