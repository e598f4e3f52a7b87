//! Adaptation: rate, size, coding and layers of live frames follow what the link carries and what the client decodes.
//!
//! Part of the session, between [`super::delivery`], which measures the link, and [`super::rate`], which meets a number of
//! bytes. Three steps, each only when the one before is not enough:
//!
//! 1. **Bytes**: live frames may take [`UTILISATION`] of what the link carries; colour and depth are coded as coarsely as
//!    that takes, down to a floor.
//! 2. **Rate, then size, then layers**: a ladder of [`LEVELS`]. A level is left for the next worse one when frames of it
//!    would not fit at the floor, or take the client longer to decode than there is time between them, for [`WORSE_AFTER`]
//!    frames in a row. It is left for the better one when that would use no more than [`BETTER_BELOW`] of what there is, for
//!    some seconds: at first [`FIRST_PATIENCE`], twice as long after every rise that did not last, at most
//!    [`LONGEST_PATIENCE`], so that a link between two levels does not make frames flutter.
//! 3. At the last level the floor gives way too.
//!
//! Never without need: while the link was not seen to be the limit there is no target at all, and frames are what the client
//! asked for, to the byte. What was seen is forgotten when the link carries [`ENOUGH`] times what unreduced frames take.
//!
//! Limits: decoding is taken to cost by the pixel. Cost: nothing measurable.

use super::delivery::{Deliveries, Delivery};
use super::rate::RateControl;
use std::time::Duration;
use warplight_protocol::frame::VolumeFormat;
use warplight_protocol::message::{FrameAck, LimiterKind};
use warplight_protocol::{Camera, ImageSize, Timestamp};

/// Part of what the link carries that frames may take: the rest is for statistics, answers and what was estimated wrongly.
const UTILISATION: f64 = 0.85;
/// Part of the time between frames that the client may decode.
const DECODE_PART: f64 = 0.85;
/// Frames that must not fit, one after the other, before the next level.
const WORSE_AFTER: u32 = 5;
/// What the better level may use of what there is.
const BETTER_BELOW: f64 = 0.8;
/// It must have been so for this long.
const FIRST_PATIENCE: Duration = Duration::from_secs(2);
/// And for this long at most.
const LONGEST_PATIENCE: Duration = Duration::from_secs(32);
/// How many times what frames take the link must carry to be forgotten.
const ENOUGH: f64 = 1.6;
/// Weight of the latest frame in what frames take.
const GAIN: f64 = 0.3;

/// How much of what was asked for a live frame is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    /// Of the frames per second.
    pub(super) rate: f64,
    /// Of each side.
    pub(super) scale: f64,
    /// Of the layers, rounded up.
    pub(super) layers: f64,
}

const fn level(rate: f64, scale: f64, layers: f64) -> Level {
    Level { rate, scale, layers }
}

/// From all to least. An old frame is warped well as long as it is not too old, so rate goes first; half the pixels are worse
/// than half the frames, and layers are few to begin with.
const LEVELS: [Level; 8] = [
    level(1.0, 1.0, 1.0),
    level(0.75, 1.0, 1.0),
    level(0.5, 1.0, 1.0),
    level(0.5, 0.75, 1.0),
    level(0.5, 0.5, 1.0),
    level(0.5, 0.5, 0.5),
    level(0.25, 0.5, 0.5),
    level(0.25, 0.25, 0.25),
];

impl Level {
    /// The camera of a display as frames of this level have it.
    pub(super) fn camera(self, display: &Camera) -> Camera {
        let side = |px: u32| ((f64::from(px) * self.scale).round() as u32).max(px.min(16));
        let size = ImageSize::new(side(display.size.width), side(display.size.height));
        Camera { size, ..*display }
    }

    /// The layers of a frame as frames of this level have them.
    pub(super) fn volume(self, asked: VolumeFormat) -> VolumeFormat {
        VolumeFormat { layers: (f64::from(asked.layers) * self.layers).ceil() as u8, ..asked }
    }

    /// What of the bytes per second, or of the work, is left at this level.
    fn part(self) -> f64 {
        self.rate * self.scale * self.scale
    }
}

/// The state of one session.
#[derive(Clone, Debug)]
pub(super) struct Adaptation {
    is_on: bool,
    deliveries: Deliveries,
    index: usize,
    /// What made the level what it is.
    cause: LimiterKind,
    /// Of what frames of this level take: bytes, and seconds of decoding.
    bytes: f64,
    decode_s: f64,
    /// Time between two of them.
    beat_s: f64,
    misfits: u32,
    delivered: u32,
    /// Since when the better level would fit.
    fits_since: Option<Timestamp>,
    risen_at: Option<Timestamp>,
    patience: Duration,
    changes: u32,
}

impl Adaptation {
    /// For a client that wants it or not.
    pub(super) fn new(is_on: bool, now: Timestamp) -> Adaptation {
        Adaptation {
            is_on,
            deliveries: Deliveries::new(now),
            index: 0,
            cause: LimiterKind::Throughput,
            bytes: 0.0,
            decode_s: 0.0,
            beat_s: 0.0,
            misfits: 0,
            delivered: 0,
            fits_since: None,
            risen_at: None,
            patience: FIRST_PATIENCE,
            changes: 0,
        }
    }

    /// What is told of frames on their way.
    pub(super) fn deliveries(&mut self) -> &mut Deliveries {
        &mut self.deliveries
    }

    /// What of the frames is sent now.
    pub(super) fn level(&self) -> Level {
        LEVELS[self.index]
    }

    /// What made it so, where that is less than everything.
    pub(super) fn cause(&self) -> Option<LimiterKind> {
        (self.index > 0).then_some(self.cause)
    }

    /// Bytes per second that live frames may take because of the link.
    pub(super) fn bytes_per_s(&self) -> Option<f64> {
        self.deliveries.bytes_per_s().map(|carried| UTILISATION * carried)
    }

    /// What the link carries, where that is known because it was the limit.
    pub(super) fn carried_bytes_per_s(&self) -> Option<f64> {
        self.deliveries.bytes_per_s()
    }

    /// Seconds that the client decodes a frame for.
    pub(super) fn decode_s(&self) -> f64 {
        self.decode_s
    }

    /// How often the level changed.
    #[cfg(test)]
    pub(super) fn changes(&self) -> u32 {
        self.changes
    }

    /// A live frame has arrived, of a session that begins one every `beat` and whose client wishes to pay for so many bytes
    /// per second, 0 for any.
    pub(super) fn acknowledged(
        &mut self,
        now: Timestamp,
        ack: &FrameAck,
        beat: Duration,
        wished_bytes_per_s: f64,
        rate: &mut RateControl,
    ) {
        let Some(Delivery { bytes, decode }) = self.deliveries.acknowledged(now, ack, beat) else { return };
        // Frames that were under way when the level changed are of the one before.
        let gain = if self.delivered <= super::MAX_UNACKNOWLEDGED as u32 { 1.0 } else { GAIN };
        self.delivered += 1;
        self.bytes += gain * (bytes as f64 - self.bytes);
        self.decode_s += gain * (decode.as_secs_f64() - self.decode_s);
        self.beat_s = beat.as_secs_f64();
        if !self.is_on {
            return;
        }
        self.climb(now, rate);
        if let Some(budget) = self.bytes_per_s()
            && self.index == 0
            && !rate.gives_way()
            && ENOUGH * self.bytes / self.beat_s < budget
        {
            self.deliveries.is_enough();
        }
        let wished = if wished_bytes_per_s > 0.0 { wished_bytes_per_s } else { f64::INFINITY };
        match self.bytes_per_s().filter(|budget| *budget < wished) {
            Some(budget) => rate.aim(budget, true, self.index + 1 < LEVELS.len()),
            None => rate.aim(wished_bytes_per_s, false, false),
        }
    }

    /// Goes a level up or down, where that is due.
    fn climb(&mut self, now: Timestamp, rate: &RateControl) {
        if self.delivered <= super::MAX_UNACKNOWLEDGED as u32 {
            return;
        }
        let link = self.bytes_per_s().map_or(0.0, |budget| self.bytes * rate.smallest() / self.beat_s / budget);
        let decode = self.decode_s / (DECODE_PART * self.beat_s);
        let pressure = link.max(decode);
        self.misfits = if pressure > 1.0 { self.misfits + 1 } else { 0 };
        if self.misfits >= WORSE_AFTER && self.index + 1 < LEVELS.len() {
            if self.risen_at.take().is_some_and(|risen| now.since(risen) < 4 * self.patience) {
                self.patience = (2 * self.patience).min(LONGEST_PATIENCE);
            }
            self.cause = if decode > link { LimiterKind::DecodeTime } else { LimiterKind::Throughput };
            return self.change(self.index + 1);
        }
        let Some(better) = self.index.checked_sub(1) else { return };
        let growth = LEVELS[better].part() / LEVELS[self.index].part();
        if pressure * growth.max(1.0) > BETTER_BELOW {
            self.fits_since = None;
        } else if now.since(*self.fits_since.get_or_insert(now)) >= self.patience {
            self.risen_at = Some(now);
            self.change(better);
        }
    }

    fn change(&mut self, index: usize) {
        (self.index, self.misfits, self.delivered, self.fits_since) = (index, 0, 0, None);
        self.changes += 1;
    }
}

#[cfg(test)]
mod tests;
