//! The client's side of a session: a state machine without clock and socket.
//!
//! Bytes and instants go in, events and bytes come out. Strips are handed out undecoded: when and on which
//! thread they are decoded is up to whoever drives the session, who then acknowledges the frame.

mod backoff;

pub use backoff::Backoff;

use crate::net::OtherCertificate;
use std::collections::VecDeque;
use std::time::Duration;
use warplight_protocol::Timestamp;
use warplight_protocol::codec::{DecodeError, Limits};
use warplight_protocol::frame::FrameId;
use warplight_protocol::message::{
    ErrorCode, FrameAck, FrameBegin, FrameEnd, Hello, Message, PictureMessage, PoseSample, Statistics, StillRequest,
    StripMessage, VERSION, Welcome,
};
use warplight_protocol::wire::{Deframer, write_message};

/// A ping after this long without one.
pub const KEEP_ALIVE: Duration = Duration::from_millis(500);
/// A server that says nothing for this long is gone.
pub const DEAD_PEER: Duration = Duration::from_secs(2);

/// Messages that may wait to be sent before a server that goes on asking is closed.
const MAX_OUTGOING: usize = 1024;

/// What happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The server has opened the session.
    Welcome(Welcome),
    /// A frame starts.
    FrameBegin(FrameBegin),
    /// A strip of it.
    Strip(StripMessage),
    /// A picture of it.
    Picture(PictureMessage),
    /// It is whole.
    FrameEnd(FrameEnd),
    /// Running totals.
    Statistics(Statistics),
    /// A ping came back after this long.
    RoundTrip(Duration),
}

/// Why a session is over.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SessionEnd {
    /// This end said goodbye.
    #[error("the session was closed")]
    Closed,
    /// The server said goodbye.
    #[error("the server closed the session")]
    Bye,
    /// The server refused it.
    #[error("the server refused the session: {text}")]
    Refused {
        /// What kind of refusal.
        code: ErrorCode,
        /// In words.
        text: String,
    },
    /// The server sent what it must not.
    #[error("the server sent what is no message: {0}")]
    Decode(#[from] DecodeError),
    /// The server said nothing for [`DEAD_PEER`].
    #[error("the server said nothing for 2 s")]
    Silent,
    /// It is not the server that this end was told of.
    #[error("{0}")]
    Untrusted(OtherCertificate),
}

impl SessionEnd {
    /// Whether trying again cannot help. A server that has heard nothing for too long will listen again.
    pub fn is_final(&self) -> bool {
        match self {
            SessionEnd::Closed | SessionEnd::Untrusted(_) => true,
            SessionEnd::Refused { code, .. } => {
                matches!(code, ErrorCode::Version | ErrorCode::Protocol | ErrorCode::Limit | ErrorCode::Unauthorised)
            }
            SessionEnd::Bye | SessionEnd::Decode(_) | SessionEnd::Silent => false,
        }
    }
}

/// The state of one session.
#[derive(Debug)]
pub struct ClientSession {
    deframer: Deframer,
    outgoing: VecDeque<Message>,
    poses: Vec<PoseSample>,
    events: VecDeque<Event>,
    /// The frame that is arriving, and since when.
    arriving: Option<(FrameId, Timestamp)>,
    /// How long frames took to arrive that are not acknowledged yet.
    arrived: VecDeque<(FrameId, Duration)>,
    is_open: bool,
    end: Option<SessionEnd>,
    next_ping: Timestamp,
    last_heard: Timestamp,
}

impl ClientSession {
    /// A session whose link has just come up; it starts with the hello.
    pub fn new(hello: Hello, limits: Limits, now: Timestamp) -> ClientSession {
        ClientSession {
            deframer: Deframer::new(limits),
            outgoing: VecDeque::from([Message::Hello(hello)]),
            poses: Vec::new(),
            events: VecDeque::new(),
            arriving: None,
            arrived: VecDeque::new(),
            is_open: false,
            end: None,
            next_ping: now + KEEP_ALIVE,
            last_heard: now,
        }
    }

    /// Takes in bytes from the server. Once the session is over they are ignored.
    pub fn on_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.last_heard = now;
        self.deframer.push(bytes);
        while self.end.is_none() {
            match self.deframer.next_message() {
                Ok(Some(message)) => self.on_message(now, message),
                Ok(None) => return,
                Err(error) => self.refuse(error),
            }
        }
    }

    fn on_message(&mut self, now: Timestamp, message: Message) {
        let event = match message {
            Message::Bye => return self.end = Some(SessionEnd::Bye),
            Message::Error { code, text } => return self.end = Some(SessionEnd::Refused { code, text }),
            Message::Ping(_) if self.outgoing.len() >= MAX_OUTGOING => {
                return self.refuse(DecodeError::LimitExceeded { limit: MAX_OUTGOING, requested: MAX_OUTGOING + 1 });
            }
            Message::Ping(time) => return self.outgoing.push_back(Message::Pong(time)),
            Message::Pong(time) => Event::RoundTrip(now.since(time)),
            Message::Welcome(welcome) if !self.is_open => {
                self.is_open = true;
                Event::Welcome(welcome)
            }
            Message::FrameBegin(begin) if self.is_open => {
                self.arriving = Some((begin.id, now));
                Event::FrameBegin(begin)
            }
            Message::Strip(strip) if self.is_open => Event::Strip(strip),
            Message::Picture(picture) if self.is_open => Event::Picture(picture),
            Message::FrameEnd(end) if self.is_open => {
                /// The server has no more under way; stills are never acknowledged.
                const MOST: usize = 4;
                if let Some((_, since)) = self.arriving.take().filter(|&(id, _)| id == end.id) {
                    self.arrived.push_back((end.id, now.since(since)));
                    if self.arrived.len() > MOST {
                        self.arrived.pop_front();
                    }
                }
                Event::FrameEnd(end)
            }
            Message::Statistics(statistics) if self.is_open => Event::Statistics(statistics),
            _ => {
                let expected = "a welcome first, then only what a server says";
                return self.refuse(DecodeError::Malformed { field: "order of messages", expected });
            }
        };
        self.events.push_back(event);
    }

    /// Ends the session because of what the server sent.
    pub fn refuse(&mut self, error: DecodeError) {
        let text = match &error {
            DecodeError::Unsupported { field: "protocol version", found } => {
                format!("this client speaks version {VERSION} of the protocol, the server version {found}")
            }
            error => error.to_string(),
        };
        self.outgoing.push_back(Message::Error { code: ErrorCode::from(&error), text });
        self.end = Some(SessionEnd::Decode(error));
    }

    /// The next event.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Tells the server where the head was.
    pub fn push_pose(&mut self, sample: PoseSample) {
        /// A link that takes nothing for longer must not be flooded afterwards: old poses are of no use.
        const MOST: usize = 128;
        if self.poses.len() == MOST {
            self.poses.remove(0);
        }
        self.poses.push(sample);
    }

    /// Acknowledges a frame that is ready to be shown, and was decoded for so long.
    pub fn acknowledge(&mut self, id: FrameId, pose_to_ready: Duration, decode: Duration) {
        let micros = |duration: Duration| u32::try_from(duration.as_micros()).unwrap_or(u32::MAX);
        let arrived = self.arrived.iter().position(|(arrived, _)| *arrived == id);
        let receive =
            arrived.and_then(|at| self.arrived.drain(..=at).next_back()).map_or(Duration::ZERO, |(_, took)| took);
        self.outgoing.push_back(Message::FrameAck(FrameAck {
            id,
            pose_to_ready_micros: micros(pose_to_ready),
            receive_micros: micros(receive),
            decode_micros: micros(decode),
        }));
    }

    /// Asks for a converged picture.
    pub fn request_still(&mut self, request: StillRequest) {
        self.outgoing.push_back(Message::StillRequest(request));
    }

    /// Asks for an answer at once: its [`Event::RoundTrip`] tells how long it took.
    pub fn ping(&mut self, now: Timestamp) {
        if self.is_open() {
            self.outgoing.push_back(Message::Ping(now));
        }
    }

    /// Says goodbye.
    pub fn close(&mut self) {
        if self.end.is_none() {
            self.outgoing.push_back(Message::Bye);
            self.end = Some(SessionEnd::Closed);
        }
    }

    /// Appends the next message to `out`; false where there is none for now.
    pub fn poll_transmit(&mut self, now: Timestamp, out: &mut Vec<u8>) -> bool {
        if self.end.is_none() && self.is_open && now >= self.next_ping {
            self.outgoing.push_back(Message::Ping(now));
            self.next_ping = now + KEEP_ALIVE;
        }
        let poses_may_go = self.is_open && self.end.is_none() && !self.poses.is_empty();
        let message = match self.outgoing.pop_front() {
            Some(message) => message,
            None if poses_may_go => Message::Poses(std::mem::take(&mut self.poses)),
            None => return false,
        };
        write_message(&message, out);
        true
    }

    /// Notices a server that is gone.
    pub fn on_timeout(&mut self, now: Timestamp) {
        if self.end.is_none() && now.since(self.last_heard) >= DEAD_PEER {
            self.outgoing
                .push_back(Message::Error { code: ErrorCode::Timeout, text: "nothing heard for 2 s".to_owned() });
            self.end = Some(SessionEnd::Silent);
        }
    }

    /// When to ask again, if nothing else happens.
    pub fn next_timeout(&self) -> Timestamp {
        self.next_ping.min(self.last_heard + DEAD_PEER)
    }

    /// Whether the server has answered.
    pub fn is_open(&self) -> bool {
        self.is_open && self.end.is_none()
    }

    /// Why the session is over, once it is.
    pub fn end(&self) -> Option<&SessionEnd> {
        self.end.as_ref()
    }
}

#[cfg(test)]
mod tests;
