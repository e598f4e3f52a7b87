//! The server's clock as the client sees it, with a bound of the error, from what frames carry anyway.
//!
//! Part of the report. The offset of two clocks lies between what the fastest pose up and the fastest frame down say, as with
//! NTP's one packet each way (Mills 1991): its estimate is the middle, its error at most half of their sum. Clocks drift, so
//! an epoch is cut into windows of [`WINDOW`] frames and more, each has its own estimate, and a line through them, the surer
//! ones weighing more, is the offset at every instant. **Error** is the largest distance between the line and anything that a
//! window allows: in the middle of each window the true offset is within it, but for what the clocks drift within a window.
//!
//! Limits: delays that differ between the ways are not seen, they are in the error. A restarted server has a clock of its
//! own; [`epochs`] tells them apart. Cost: nothing measurable.

use super::FrameRecord;
use crate::measure::Stage;
use crate::report::{ClockKind, ClockOffset};

/// Fewest frames in a window: the fastest of them should have met an idle link.
const WINDOW: usize = 20;
/// Most windows.
const MOST_WINDOWS: usize = 12;
/// Over less than this no drift is seen.
const SHORTEST_SECS: f64 = 1.0;

/// Server's clock minus client's, as a line over the client's time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ClockLine {
    middle_secs: f64,
    offset_ms: f64,
    ms_per_s: f64,
    error_ms: f64,
}

impl ClockLine {
    /// The offset when the client's clock shows so many seconds, in milliseconds.
    pub(super) fn offset_ms_at(&self, secs: f64) -> f64 {
        self.offset_ms + self.ms_per_s * (secs - self.middle_secs)
    }

    /// The same for a frame.
    pub(super) fn offset_micros_of(&self, record: &FrameRecord) -> i64 {
        let secs = record.times.at(Stage::Received).map_or(self.middle_secs, |at| at.as_secs());
        (self.offset_ms_at(secs) * 1e3).round() as i64
    }

    /// As it is reported: in the middle of the epoch.
    pub(super) fn reported(&self) -> ClockOffset {
        ClockOffset { offset_ms: self.offset_ms, error_ms: self.error_ms, drift_ppm: 1e3 * self.ms_per_s }
    }
}

/// What one window allows.
struct Window {
    at_secs: f64,
    offset_ms: f64,
    error_ms: f64,
}

/// Frames by the server's clock that stamped them: a restarted server has a new one.
pub(super) fn epochs(frames: &[FrameRecord]) -> impl Iterator<Item = &[FrameRecord]> {
    frames.chunk_by(|before, after| after.times.at(Stage::Sent) >= before.times.at(Stage::Sent))
}

/// The server's clock, from the frames of one epoch. In virtual time there is only one clock.
pub(super) fn clock_line(frames: &[FrameRecord], clock: ClockKind) -> Option<ClockLine> {
    if clock == ClockKind::Virtual {
        return Some(ClockLine { middle_secs: 0.0, offset_ms: 0.0, ms_per_s: 0.0, error_ms: 0.0 });
    }
    let count = (frames.len() / WINDOW).clamp(1, MOST_WINDOWS);
    let windows: Vec<Window> = frames.chunks(frames.len().div_ceil(count).max(1)).filter_map(window).collect();
    let weights: Vec<f64> = windows.iter().map(|window| window.error_ms.max(1e-3).powi(-2)).collect();
    let weight: f64 = weights.iter().sum();
    if windows.is_empty() || !weight.is_finite() {
        return None;
    }
    let weighted = |value: fn(&Window) -> f64| {
        windows.iter().zip(&weights).map(|(window, weight)| value(window) * weight).sum::<f64>() / weight
    };
    let (middle_secs, offset_ms) = (weighted(|window| window.at_secs), weighted(|window| window.offset_ms));
    let (mut covariance, mut variance) = (0.0, 0.0);
    for (window, weight) in windows.iter().zip(&weights) {
        let away_secs = window.at_secs - middle_secs;
        covariance += weight * away_secs * (window.offset_ms - offset_ms);
        variance += weight * away_secs * away_secs;
    }
    let span_secs = windows.last()?.at_secs - windows.first()?.at_secs;
    let ms_per_s = if span_secs > SHORTEST_SECS { covariance / variance } else { 0.0 };
    let line = ClockLine { middle_secs, offset_ms, ms_per_s, error_ms: 0.0 };
    let beyond = |window: &Window| (line.offset_ms_at(window.at_secs) - window.offset_ms).abs() + window.error_ms;
    Some(ClockLine { error_ms: windows.iter().map(beyond).fold(0.0, f64::max), ..line })
}

/// From the fastest pose up and the fastest frame down.
fn window(frames: &[FrameRecord]) -> Option<Window> {
    let fastest_ms = |from: Stage, to: Stage| {
        let of =
            move |record: &FrameRecord| Some((record.times.at(to)?.as_secs() - record.times.at(from)?.as_secs()) * 1e3);
        frames.iter().filter_map(of).min_by(f64::total_cmp)
    };
    let up_ms = fastest_ms(Stage::PoseSampled, Stage::PoseReceived)?;
    let down_ms = fastest_ms(Stage::Sent, Stage::Received)?;
    let at_secs = frames.get(frames.len() / 2)?.times.at(Stage::Received)?.as_secs();
    Some(Window { at_secs, offset_ms: (up_ms - down_ms) / 2.0, error_ms: ((up_ms + down_ms) / 2.0).abs() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{Link, LinkModel};
    use crate::measure::Interval;
    use crate::replay::report::tests::frame;
    use std::time::Duration;
    use warplight_protocol::Timestamp;

    #[test]
    fn the_offset_of_two_clocks_is_found_within_its_error() {
        let frames: Vec<_> = (0..20).map(|number| frame(1_000_000 + 100_000 * number, 7_000_000)).collect();
        let offset = clock_line(&frames, ClockKind::Real).unwrap().reported();
        assert!((offset.offset_ms - 7000.0).abs() <= offset.error_ms + 1e-6);
        assert!((offset.error_ms - 15.0).abs() < 1e-6 && offset.drift_ppm.abs() < 1.0);
        assert_eq!(clock_line(&[], ClockKind::Real), None);
    }

    #[test]
    fn a_clock_that_runs_faster_is_seen_to_drift() {
        let frames: Vec<_> = (0..100).map(|number| frame(100_000 * number, 7_000_000 + 20 * number)).collect();
        let offset = clock_line(&frames, ClockKind::Real).unwrap().reported();
        assert!((offset.drift_ppm - 200.0).abs() < 5.0, "{}", offset.drift_ppm);
    }

    /// Two minutes over links with jitter, up slower than down, to a server whose clock gains 80 ppm: 9.6 ms.
    #[test]
    fn over_a_link_with_jitter_drift_is_followed_and_the_error_holds() {
        const DRIFT: f64 = 80e-6;
        let model = |latency: u64| LinkModel {
            latency: Duration::from_millis(latency),
            jitter: Duration::from_millis(15),
            ..LinkModel::default()
        };
        let (mut up, mut down) = (Link::new(model(30), 5), Link::new(model(20), 6));
        let server =
            |client: Timestamp| Timestamp { micros: 7_000_000 + (client.micros as f64 * (1.0 + DRIFT)).round() as u64 };
        let mut frames = Vec::new();
        for number in 0..1200_u64 {
            let sampled = Timestamp { micros: 1_000_000 + 100_000 * number };
            up.send(sampled, vec![0; 30]);
            let heard = up.next_arrival().unwrap();
            up.receive(heard);
            let sent = heard + Duration::from_millis(40);
            down.send(sent, vec![0; 3000]);
            let received = down.next_arrival().unwrap();
            down.receive(received);
            let mut record = frame(0, 0);
            record.times = crate::measure::FrameTimes::default();
            record.times.record(Stage::PoseSampled, sampled);
            record.times.record(Stage::PoseReceived, server(heard));
            record.times.record(Stage::Sent, server(sent));
            record.times.record(Stage::Received, received);
            frames.push(record);
        }
        let line = clock_line(&frames, ClockKind::Real).unwrap();
        let reported = line.reported();
        assert!((reported.drift_ppm - 80.0).abs() < 10.0, "{reported:?}");
        // The fastest are 15 ms up and 5 ms down: the middle is off by 5 ms and sure to 10 ms, give and take a window's luck.
        assert!((10.0..16.0).contains(&reported.error_ms), "{reported:?}");
        let mut sends = Vec::new();
        for record in &mut frames {
            let received = record.times.at(Stage::Received).unwrap();
            let true_ms = (server(received).as_secs() - received.as_secs()) * 1e3;
            let off = (line.offset_ms_at(received.as_secs()) - true_ms).abs();
            assert!(off <= reported.error_ms, "{off} at {received:?}: {reported:?}");
            record.times.set_clock_offset(line.offset_micros_of(record));
            sends.push(record.times.interval_ms(Interval::SEND).unwrap());
        }
        let mean = sends.iter().sum::<f64>() / sends.len() as f64;
        assert!((mean - 20.0).abs() <= reported.error_ms, "{mean}");
    }
}
