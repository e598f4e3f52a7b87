//! A modelled link, one direction: delay, jitter, rate, stalls and a cut, seeded, in virtual time.
//!
//! Like TCP it reorders nothing, and loses nothing but by a cut, which ends the connection (`route`): what is late delays
//! what is behind it. Like a socket with a small
//! buffer it takes no more than `BUFFER` ahead of what it has put on the wire, so that whoever sends
//! decides late what to send.

mod route;

pub use route::{Change, Route};

use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use std::collections::VecDeque;
use std::time::Duration;
use warplight_protocol::Timestamp;

/// How far ahead of the wire the sender may write, in time on the wire.
const BUFFER: Duration = Duration::from_millis(5);

/// What the link is like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkModel {
    /// Delay from end to end.
    pub latency: Duration,
    /// The delay varies by up to this much either way, uniformly.
    pub jitter: Duration,
    /// Bits per second; `None` is unlimited.
    pub rate_bits_per_sec: Option<f64>,
    /// Every `.0` the link stands still for `.1`.
    pub stall: Option<(Duration, Duration)>,
    /// After `.0` the link is cut for `.1`.
    pub cut: Option<(Duration, Duration)>,
}

impl LinkModel {
    /// When the link is cut and when it is back.
    fn cut_times(&self) -> Option<(Timestamp, Timestamp)> {
        let (at, length) = self.cut?;
        let start = Timestamp::ZERO + at;
        Some((start, start + length))
    }

    fn is_cut(&self, now: Timestamp) -> bool {
        self.cut_times().is_some_and(|(start, end)| start <= now && now < end)
    }
}

/// One direction of a link.
#[derive(Debug)]
pub struct Link {
    model: LinkModel,
    random: Pcg32,
    wire_free: Timestamp,
    last_arrival: Timestamp,
    in_flight: VecDeque<(Timestamp, Vec<u8>)>,
    lost: Vec<Vec<u8>>,
    bytes: u64,
}

impl Link {
    /// An empty link.
    pub fn new(model: LinkModel, seed: u64) -> Link {
        Link {
            model,
            random: Pcg32::new(seed, 0x0a02_bdbf_7bb3_c0a7),
            wire_free: Timestamp::ZERO,
            last_arrival: Timestamp::ZERO,
            in_flight: VecDeque::new(),
            lost: Vec::new(),
            bytes: 0,
        }
    }

    /// Whether more may be written now.
    pub fn has_room(&self, now: Timestamp) -> bool {
        self.wire_free <= now + BUFFER
    }

    /// When there will be room, if there is none now.
    pub fn room_at(&self) -> Timestamp {
        Timestamp { micros: self.wire_free.micros.saturating_sub(BUFFER.as_micros() as u64) }
    }

    /// Writes bytes, which must not be empty.
    pub fn send(&mut self, now: Timestamp, bytes: Vec<u8>) {
        let start = self.after_stall(self.wire_free.max(now));
        let on_wire_secs = self.model.rate_bits_per_sec.map_or(0.0, |rate| bytes.len() as f64 * 8.0 / rate);
        self.wire_free = start + Duration::from_secs_f64(on_wire_secs);
        let uniform = f64::from(self.random.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0;
        let delay_secs = self.model.latency.as_secs_f64() + uniform * self.model.jitter.as_secs_f64();
        let arrival = self.wire_free + Duration::from_secs_f64(delay_secs.max(0.0));
        self.bytes += bytes.len() as u64;
        let arrival = self.last_arrival.max(arrival);
        if self.model.cut_times().is_some_and(|(cut, back)| now < back && arrival >= cut) {
            self.lost.push(bytes);
            return;
        }
        self.last_arrival = arrival;
        self.in_flight.push_back((self.last_arrival, bytes));
    }

    /// The connection is gone, and with it all that is under way.
    fn lose_all(&mut self) {
        self.lost.extend(self.in_flight.drain(..).map(|(_, bytes)| bytes));
    }

    /// What was written and will not arrive, in order, since this was asked last.
    pub fn take_lost(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.lost)
    }

    /// The end of the stall that `time` falls into, or `time`.
    fn after_stall(&self, time: Timestamp) -> Timestamp {
        let Some((every, length)) = self.model.stall else { return time };
        let period = every.as_micros().max(1) as u64;
        let into = time.micros % period;
        let length = length.as_micros() as u64;
        // The first period starts without one, so that a session can open.
        if time.micros >= period && into < length { Timestamp { micros: time.micros - into + length } } else { time }
    }

    /// The next bytes that have arrived by now.
    pub fn receive(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        self.in_flight.pop_front_if(|(arrival, _)| *arrival <= now).map(|(_, bytes)| bytes)
    }

    /// When the next bytes arrive.
    pub fn next_arrival(&self) -> Option<Timestamp> {
        self.in_flight.front().map(|(arrival, _)| *arrival)
    }

    /// Bytes written so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Timestamp {
        Timestamp { micros: millis * 1000 }
    }

    #[test]
    fn bytes_take_their_time_on_the_wire_and_then_the_delay() {
        let model =
            LinkModel { latency: Duration::from_millis(20), rate_bits_per_sec: Some(8e6), ..LinkModel::default() };
        let mut link = Link::new(model, 1);
        link.send(at(0), vec![0; 10_000]);
        assert!(!link.has_room(at(0)));
        assert_eq!(link.next_arrival(), Some(at(30)));
        assert_eq!(link.room_at(), at(5));
        assert!(link.has_room(at(5)));
        assert_eq!(link.receive(at(29)), None);
        assert_eq!(link.receive(at(30)).unwrap().len(), 10_000);
    }

    #[test]
    fn jitter_never_reorders() {
        let model =
            LinkModel { latency: Duration::from_millis(20), jitter: Duration::from_millis(20), ..LinkModel::default() };
        let mut link = Link::new(model, 3);
        for number in 0..200_u8 {
            link.send(at(u64::from(number)), vec![number]);
        }
        let mut received = Vec::new();
        for millis in 0..300 {
            while let Some(bytes) = link.receive(at(millis)) {
                let delay = millis as i64 - i64::from(bytes[0]);
                assert!((0..=40).contains(&delay));
                received.push(bytes[0]);
            }
        }
        assert_eq!(received, (0..200).collect::<Vec<_>>());
    }

    #[test]
    fn a_stalled_link_goes_on_where_it_stood() {
        let model = LinkModel { stall: Some((Duration::from_secs(5), Duration::from_secs(1))), ..LinkModel::default() };
        let mut link = Link::new(model, 3);
        link.send(at(100), vec![0]);
        assert_eq!(link.next_arrival(), Some(at(100)));
        link.receive(at(100));
        link.send(at(5200), vec![0]);
        assert_eq!(link.next_arrival(), Some(at(6000)));
    }
}
