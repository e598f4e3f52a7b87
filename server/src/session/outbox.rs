//! What waits to be sent: control messages, then the frame being sent, then the one behind it.
//!
//! There is no queue of frames. One is being sent; one may stand behind it, and the next replaces it as long
//! as nothing of it has left. Pictures are encoded when their frame is being sent: what has been encoded is sent.

use crate::pictures::RenderedPictures;
use std::collections::VecDeque;
use warplight_protocol::Timestamp;
use warplight_protocol::frame::FrameId;
use warplight_protocol::message::{FrameBegin, FrameEnd, FramePurpose, Message, PictureMessage, StripMessage};

/// Live frames that may be under way without an acknowledgement.
pub const MAX_UNACKNOWLEDGED: usize = 2;

#[derive(Debug, Default)]
pub(super) struct Outbox {
    control: VecDeque<Message>,
    /// Rendering has started, but there is no strip yet: it replaces nothing before that.
    prepared: Option<Outgoing>,
    pending: Option<Outgoing>,
    sending: Option<Outgoing>,
    unacknowledged: Vec<FrameId>,
    live_frames_sent: u32,
}

#[derive(Debug)]
struct Outgoing {
    begin: FrameBegin,
    strips: VecDeque<Vec<u8>>,
    pictures: Pictures,
    end: Option<FrameEnd>,
}

/// Pictures of a frame. They are encoded when the frame is being sent and not before: a frame that another replaces
/// must not have been anybody's reference.
#[derive(Debug)]
enum Pictures {
    /// The frame's format has some, and it is not rendered yet.
    Expected,
    Rendered(RenderedPictures),
    Encoding,
    /// Those that have not been sent.
    Encoded(VecDeque<PictureMessage>),
}

impl Outgoing {
    fn is_live(&self) -> bool {
        self.begin.purpose == FramePurpose::Live
    }

    /// The end, if everything before it has been handed out.
    fn end(&self) -> Option<FrameEnd> {
        let has_pictures = matches!(&self.pictures, Pictures::Encoded(pictures) if pictures.is_empty());
        self.end.filter(|_| self.strips.is_empty() && has_pictures)
    }
}

impl Outbox {
    pub(super) fn push_control(&mut self, message: Message) {
        self.control.push_back(message);
    }

    /// Messages that belong to no frame and wait.
    pub(super) fn control_messages(&self) -> usize {
        self.control.len()
    }

    pub(super) fn discard_control(&mut self) {
        self.control.clear();
    }

    /// A frame whose strips will follow.
    pub(super) fn prepare(&mut self, begin: FrameBegin) {
        let has_pictures = !begin.shape.pictures().is_empty();
        let pictures = if has_pictures { Pictures::Expected } else { Pictures::Encoded(VecDeque::new()) };
        self.prepared = Some(Outgoing { begin, strips: VecDeque::new(), pictures, end: None });
    }

    /// Takes a strip in; true where its frame thereby replaced one that was never sent.
    pub(super) fn push_strip(&mut self, frame: FrameId, strip: Vec<u8>) -> bool {
        let mut replaced = false;
        if let Some(prepared) = self.prepared.take_if(|prepared| prepared.begin.id == frame) {
            replaced = self.pending.replace(prepared).is_some();
        }
        if let Some(outgoing) = self.of(frame) {
            outgoing.strips.push_back(strip);
        }
        replaced
    }

    pub(super) fn finish(&mut self, end: FrameEnd) {
        if let Some(outgoing) = self.of(end.id) {
            outgoing.end = Some(end);
        }
    }

    /// Whether a frame has pictures that are not encoded yet.
    pub(super) fn has_pictures(&mut self, frame: FrameId) -> bool {
        self.of(frame).is_some_and(|outgoing| !matches!(outgoing.pictures, Pictures::Encoded(_)))
    }

    /// Keeps the pictures of a rendered frame until it is sent or replaced.
    pub(super) fn push_rendered(&mut self, frame: FrameId, pictures: RenderedPictures) {
        if let Some(outgoing) = self.of(frame).filter(|outgoing| matches!(outgoing.pictures, Pictures::Expected)) {
            outgoing.pictures = Pictures::Rendered(pictures);
        }
    }

    /// The pictures of the frame that is being sent, once.
    pub(super) fn take_rendered(&mut self) -> Option<(&FrameBegin, RenderedPictures)> {
        let sending = self.sending.as_mut()?;
        match std::mem::replace(&mut sending.pictures, Pictures::Encoding) {
            Pictures::Rendered(pictures) => Some((&sending.begin, pictures)),
            other => {
                sending.pictures = other;
                None
            }
        }
    }

    /// The pictures of the frame that is being sent are ready to follow its strips.
    pub(super) fn push_encoded(&mut self, now: Timestamp, frame: FrameId, pictures: Vec<PictureMessage>) {
        if let Some(outgoing) = self.of(frame).filter(|outgoing| matches!(outgoing.pictures, Pictures::Encoding)) {
            outgoing.pictures = Pictures::Encoded(pictures.into());
            outgoing.end = outgoing.end.map(|end| FrameEnd { encoded: now, ..end });
        }
    }

    fn of(&mut self, frame: FrameId) -> Option<&mut Outgoing> {
        [&mut self.pending, &mut self.sending].into_iter().flatten().find(|outgoing| outgoing.begin.id == frame)
    }

    /// Whether the acknowledgement was waited for.
    pub(super) fn acknowledge(&mut self, frame: FrameId) -> bool {
        let before = self.unacknowledged.len();
        // Frames arrive in order, so what came before this one has arrived or never will.
        self.unacknowledged.retain(|&waiting| waiting > frame);
        self.unacknowledged.len() < before
    }

    /// Nothing of a frame is waiting or under way.
    pub(super) fn is_idle(&self) -> bool {
        self.prepared.is_none() && self.pending.is_none() && self.sending.is_none()
    }

    /// A still waits to be sent.
    pub(super) fn holds_still(&self) -> bool {
        self.pending.as_ref().is_some_and(|pending| !pending.is_live())
    }

    /// Bytes of encoded planes that wait to be sent.
    pub(super) fn waiting_bytes(&self) -> usize {
        let frames = [&self.prepared, &self.pending, &self.sending].into_iter().flatten();
        let of_pictures = |outgoing: &Outgoing| match &outgoing.pictures {
            Pictures::Encoded(pictures) => pictures.iter().map(|picture| picture.bytes.len()).sum(),
            Pictures::Expected | Pictures::Rendered(_) | Pictures::Encoding => 0,
        };
        frames.map(|outgoing| outgoing.strips.iter().map(Vec::len).sum::<usize>() + of_pictures(outgoing)).sum()
    }

    pub(super) fn live_frames_sent(&self) -> u32 {
        self.live_frames_sent
    }

    /// The next message; only control messages once the session is `closing`.
    pub(super) fn next_message(&mut self, now: Timestamp, closing: bool) -> Option<Message> {
        if let Some(message) = self.control.pop_front() {
            return Some(message);
        }
        if closing {
            return None;
        }
        if let Some(sending) = &mut self.sending {
            let id = sending.begin.id;
            if let Some(bytes) = sending.strips.pop_front() {
                return Some(Message::Strip(StripMessage { frame: id, bytes }));
            }
            if let Pictures::Encoded(pictures) = &mut sending.pictures
                && sending.end.is_some()
                && let Some(picture) = pictures.pop_front()
            {
                return Some(Message::Picture(picture));
            }
            let end = sending.end()?;
            self.live_frames_sent += u32::from(sending.is_live());
            self.sending = None;
            return Some(Message::FrameEnd(FrameEnd { sent: now, ..end }));
        }
        let may_begin = |pending: &mut Outgoing| !pending.is_live() || self.unacknowledged.len() < MAX_UNACKNOWLEDGED;
        let pending = self.pending.take_if(may_begin)?;
        if pending.is_live() {
            self.unacknowledged.push(pending.begin.id);
        }
        let begin = pending.begin.clone();
        self.sending = Some(pending);
        Some(Message::FrameBegin(begin))
    }
}
