//! What the link carries: measured from frames on their way, never by sending more than frames.
//!
//! Part of the session, on the way back from [`FrameAck`]: the server knows when a frame was ready, when it was handed to the
//! link and whether it had to wait; the client how long its bytes took to arrive and how much of that was its own decoding.
//! The link was **the limit** of a frame if both ends say so: the frame waited at the server though it was ready, and arrived
//! for longer than the server needed to make it and the client to decode it, and than there is until the next. A long round trip makes frames wait but arrive at
//! once; jitter makes them arrive late but wait for nothing; a slow renderer or decoder spreads them out: none of these is
//! taken for a slow link. A frame alone may be unlucky (a stall, a burst of others' bytes), so the link is the limit while it
//! is that of most of the last [`WINDOW`] frames, and what it carries is the median of their rates.
//!
//! While it is not the limit, more than it carries is not known, only that frames fit: the estimate rises slowly
//! ([`GROWTH_PER_S`]) to find out, at first after [`FIRST_HOLD`], and after every try that failed twice as late, at most
//! [`LONGEST_HOLD`]. A frame that arrived at a higher rate raises it at once. Rates are bytes of strips and pictures.
//!
//! Limits: a link that carries bursts faster than it carries on is taken for the faster one until frames wait again.
//! Cost: nothing measurable.

use std::collections::VecDeque;
use std::time::Duration;
use warplight_protocol::Timestamp;
use warplight_protocol::frame::FrameId;
use warplight_protocol::message::{FrameAck, FrameEnd};

/// Frames that are looked at together.
const WINDOW: usize = 5;
/// Of them, those that make it a habit.
const HABIT: usize = 3;
/// A frame that arrives over less than this beyond its making was not held up: clocks, threads and polling are no better.
const LEAST_WAIT: Duration = Duration::from_millis(10);
/// The same as a part of its making.
const LEAST_WAIT_PART: f64 = 0.25;
/// Waiting at the server counts from this part of the time between frames.
const LEAST_HELD_PART: f64 = 0.1;
/// A frame that arrives within this part of the time between frames fits, however full the link is.
const FITS_PART: f64 = 0.95;
/// How fast the estimate rises while frames fit.
const GROWTH_PER_S: f64 = 1.25;
/// It rises after this long without the link being the limit.
const FIRST_HOLD: Duration = Duration::from_secs(2);
/// And after this long at most.
const LONGEST_HOLD: Duration = Duration::from_secs(6);
/// A try that gets this much further than before has found a faster link.
const FOUND: f64 = 1.5;

/// A live frame that was sent.
#[derive(Clone, Copy, Debug)]
struct Sent {
    id: FrameId,
    bytes: u64,
    /// From handing over its head until it was all encoded.
    made: Duration,
    /// Time that it was ready and not taken.
    held: Duration,
}

/// A live frame that arrived.
#[derive(Clone, Copy, Debug)]
pub(super) struct Delivery {
    pub(super) bytes: u64,
    pub(super) decode: Duration,
}

/// What one session's link carries.
#[derive(Clone, Debug)]
pub(super) struct Deliveries {
    /// Frame with its first strip, and when that was there.
    ready: VecDeque<(FrameId, Timestamp)>,
    begun: Option<(FrameId, Timestamp)>,
    sent: VecDeque<Sent>,
    /// Of the last frames, the rate at which each arrived, and whether the link was the limit.
    window: VecDeque<(f64, bool)>,
    bytes_per_s: Option<f64>,
    /// What was measured when the link was the limit last.
    measured: f64,
    is_limit: bool,
    limited_at: Timestamp,
    grown_at: Timestamp,
    hold: Duration,
}

impl Deliveries {
    pub(super) fn new(now: Timestamp) -> Deliveries {
        Deliveries {
            ready: VecDeque::new(),
            begun: None,
            sent: VecDeque::new(),
            window: VecDeque::new(),
            bytes_per_s: None,
            measured: 0.0,
            is_limit: false,
            limited_at: now,
            grown_at: now,
            hold: FIRST_HOLD,
        }
    }

    /// A strip of a live frame is there.
    pub(super) fn ready(&mut self, id: FrameId, now: Timestamp) {
        /// Being rendered, waiting, being sent.
        const MOST: usize = 4;
        if self.ready.back().is_none_or(|&(last, _)| last != id) {
            self.ready.push_back((id, now));
            if self.ready.len() > MOST {
                self.ready.pop_front();
            }
        }
    }

    /// The head of a live frame goes to the link.
    pub(super) fn begun(&mut self, id: FrameId, now: Timestamp) {
        self.begun = Some((id, now));
    }

    /// So does the end of the frame, which had so many bytes.
    pub(super) fn ended(&mut self, end: &FrameEnd, bytes: u64) {
        let Some((_, begun)) = self.begun.take().filter(|&(id, _)| id == end.id) else { return };
        let ready = self.ready.iter().find(|(id, _)| *id == end.id).map_or(begun, |&(_, at)| at);
        let made = end.encoded.since(begun);
        let held = begun.since(ready) + end.sent.since(end.encoded.max(begun));
        self.sent.push_back(Sent { id: end.id, bytes, made, held });
        if self.sent.len() > super::MAX_UNACKNOWLEDGED + 1 {
            self.sent.pop_front();
        }
    }

    /// A frame has arrived, of a session that begins one every `beat`.
    pub(super) fn acknowledged(&mut self, now: Timestamp, ack: &FrameAck, beat: Duration) -> Option<Delivery> {
        let at = self.sent.iter().position(|sent| sent.id == ack.id)?;
        let sent = self.sent.drain(..=at).next_back()?;
        let micros = |micros: u32| Duration::from_micros(u64::from(micros));
        let (receive, decode) = (micros(ack.receive_micros), micros(ack.decode_micros));
        let fits = receive < beat.mul_f64(FITS_PART);
        let late = receive.saturating_sub(decode).saturating_sub(sent.made);
        let is_limit = !fits
            && late > LEAST_WAIT.max(sent.made.mul_f64(LEAST_WAIT_PART))
            && sent.held > beat.mul_f64(LEAST_HELD_PART);
        let rate = sent.bytes as f64 / receive.as_secs_f64().max(1e-4);
        if self.window.len() == WINDOW {
            self.window.pop_front();
        }
        self.window.push_back((rate, is_limit));
        self.conclude(now);
        Some(Delivery { bytes: sent.bytes, decode })
    }

    fn conclude(&mut self, now: Timestamp) {
        let mut rates: Vec<f64> = self.window.iter().filter(|(_, is_limit)| *is_limit).map(|(rate, _)| *rate).collect();
        self.is_limit = rates.len() >= HABIT;
        if self.is_limit {
            rates.sort_by(f64::total_cmp);
            let measured = rates[rates.len() / 2];
            let tried = self.grown_at > self.limited_at && self.bytes_per_s.is_some();
            if tried {
                let found = measured > FOUND * self.measured;
                self.hold = if found { FIRST_HOLD } else { (2 * self.hold).min(LONGEST_HOLD) };
            }
            (self.measured, self.bytes_per_s) = (measured, Some(measured));
            (self.limited_at, self.grown_at) = (now, now);
            return;
        }
        let Some(bytes_per_s) = &mut self.bytes_per_s else { return };
        if now.since(self.limited_at) >= self.hold {
            let since = now.since(self.grown_at).min(Duration::from_secs(1));
            *bytes_per_s *= GROWTH_PER_S.powf(since.as_secs_f64());
            self.grown_at = now;
        } else {
            self.grown_at = self.limited_at;
        }
        if let Some(&(rate, false)) = self.window.back()
            && now.since(self.limited_at) >= FIRST_HOLD
        {
            *bytes_per_s = bytes_per_s.max(rate);
        }
    }

    /// What the link carries, in bytes per second; none while it was never the limit.
    pub(super) fn bytes_per_s(&self) -> Option<f64> {
        self.bytes_per_s
    }

    /// Forgets what it carries: there is enough of it.
    pub(super) fn is_enough(&mut self) {
        self.bytes_per_s = None;
        self.hold = FIRST_HOLD;
    }
}
