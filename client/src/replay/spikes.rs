//! Which delays were far beyond the usual, and what made each of them so.
//!
//! Part of the report. A **spike** is a refresh whose motion to photon, or a frame whose age when it was first shown, is more
//! than [`TIMES_MEDIAN`] times the median of all. A delay is the sum of its intervals, so the spike is put down to the one
//! that was largest beyond its own median. At most [`MOST_LISTED`] are listed, the largest, in the order of time; all are
//! counted. Limits: two intervals that are late together are told by the later one alone.

use super::Recording;
use super::clock::{ClockLine, epochs};
use crate::measure::Interval;
use crate::report::{ClockKind, Spike, Spikes};
use std::collections::BTreeMap;

/// How far beyond the usual: where people look twice.
const TIMES_MEDIAN: f64 = 3.0;
/// More would not be read.
const MOST_LISTED: usize = 100;

/// A delay and its parts, in milliseconds.
struct Delay {
    time_s: f64,
    whole_ms: f64,
    parts_ms: Vec<(&'static str, f64)>,
}

/// All spikes of a replay.
pub(super) fn spikes(recording: &Recording, line_of: impl Fn(&[super::FrameRecord]) -> Option<ClockLine>) -> Spikes {
    let refreshes = recording.displays.iter().map(|record| {
        let (whole, warp) = (record.motion_to_photon.as_secs_f64() * 1e3, record.warp.as_secs_f64() * 1e3);
        let parts_ms = vec![("warp", warp), ("present", whole - warp)];
        Delay { time_s: record.time.as_secs_f64(), whole_ms: whole, parts_ms }
    });
    let refreshes: Vec<Delay> = refreshes.collect();
    let mut frames = Vec::new();
    for epoch in epochs(&recording.frames) {
        let line = line_of(epoch);
        for record in epoch {
            let mut times = record.times;
            if let Some(line) = line {
                times.set_clock_offset(line.offset_micros_of(record));
            }
            let Some(whole_ms) = times.interval_ms(Interval::FRAME_AGE) else { continue };
            let Some(presented) = times.at(Interval::FRAME_AGE.to) else { continue };
            let part = |step: Interval| Some((step.name()?, times.interval_ms(step)?));
            let time_s = presented.as_secs() - recording.start.as_secs();
            frames.push(Delay { time_s, whole_ms, parts_ms: Interval::STEPS.into_iter().filter_map(part).collect() });
        }
    }
    let (of_refreshes, of_frames) = (beyond("motion to photon", &refreshes), beyond("frame age", &frames));
    let (motion_to_photon, frame_age) = (of_refreshes.len() as u64, of_frames.len() as u64);
    let mut listed: Vec<Spike> = of_refreshes.into_iter().chain(of_frames).collect();
    let height = |spike: &Spike| spike.ms / spike.median_ms.max(1e-9);
    listed.sort_by(|a, b| height(b).total_cmp(&height(a)));
    listed.truncate(MOST_LISTED);
    listed.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    Spikes { motion_to_photon, frame_age, listed }
}

fn beyond(delay: &str, all: &[Delay]) -> Vec<Spike> {
    let median_ms = median(all.iter().map(|delay| delay.whole_ms).collect());
    let mut parts: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for (name, ms) in all.iter().flat_map(|delay| &delay.parts_ms) {
        parts.entry(name).or_default().push(*ms);
    }
    let medians: BTreeMap<&str, f64> = parts.into_iter().map(|(name, all)| (name, median(all))).collect();
    let is_spike = |found: &&Delay| median_ms > 0.0 && found.whole_ms > TIMES_MEDIAN * median_ms;
    let spike = |found: &Delay| {
        let excess = |&(name, ms): &(&'static str, f64)| (name, ms, ms - medians.get(name).copied().unwrap_or(0.0));
        let most = found.parts_ms.iter().map(excess).max_by(|a, b| a.2.total_cmp(&b.2));
        let (interval, interval_ms, beyond_ms) =
            most.unwrap_or(("unknown", found.whole_ms, found.whole_ms - median_ms));
        Spike {
            time_s: found.time_s,
            delay: delay.to_owned(),
            ms: found.whole_ms,
            median_ms,
            interval: interval.to_owned(),
            interval_ms,
            beyond_ms,
        }
    };
    all.iter().filter(is_spike).map(spike).collect()
}

fn median(mut all: Vec<f64>) -> f64 {
    all.sort_unstable_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(0.0)
}

/// The same with the clock of this replay.
pub(super) fn spikes_of(recording: &Recording, clock: ClockKind) -> Spikes {
    spikes(recording, |epoch| super::clock::clock_line(epoch, clock))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::{FrameTimes, Stage};
    use crate::replay::DisplayRecord;
    use crate::replay::report::tests::frame;
    use std::time::Duration;
    use warplight_protocol::Timestamp;
    use warplight_protocol::frame::FrameId;

    /// Frames of 10 ms in each interval, but for one interval of one.
    fn recording(slow: usize, step: usize, slow_ms: u64) -> Recording {
        let mut recording = Recording::default();
        for number in 0..20_usize {
            let mut record = frame(0, 0);
            record.times = FrameTimes::default();
            let mut micros = 1_000_000 + 100_000 * number as u64;
            for (index, stage) in Stage::ALL.into_iter().enumerate() {
                record.times.record(stage, Timestamp { micros });
                micros += if number == slow && index == step { 1000 * slow_ms } else { 10_000 };
            }
            recording.frames.push(record);
            recording.displays.push(DisplayRecord {
                time: Duration::from_millis(100 * number as u64),
                motion_to_photon: Duration::from_millis(if number == 7 { 66 } else { 16 }),
                warp: Duration::from_millis(if number == 7 { 60 } else { 9 }),
                frame: FrameId(1),
                frame_age: Duration::ZERO,
                missed: false,
            });
        }
        recording
    }

    #[test]
    fn a_spike_names_the_interval_that_made_it() {
        for (step, interval) in Interval::STEPS.into_iter().enumerate() {
            let spikes = spikes_of(&recording(11, step, 300), ClockKind::Virtual);
            assert_eq!((spikes.frame_age, spikes.motion_to_photon), (1, 1));
            let [motion, age] = &spikes.listed[..] else { panic!("{spikes:?}") };
            assert_eq!((motion.interval.as_str(), motion.delay.as_str()), ("warp", "motion to photon"));
            assert!((motion.beyond_ms - 51.0).abs() < 1e-9 && (motion.time_s - 0.7).abs() < 1e-9, "{motion:?}");
            assert_eq!((age.interval.as_str(), age.delay.as_str()), (interval.name().unwrap(), "frame age"));
            assert!((age.ms - 380.0).abs() < 1e-9 && (age.median_ms - 90.0).abs() < 1e-9, "{age:?}");
            assert!((age.interval_ms - 300.0).abs() < 1e-9 && (age.beyond_ms - 290.0).abs() < 1e-9, "{age:?}");
        }
    }

    #[test]
    fn what_is_usual_is_no_spike_and_nothing_has_none() {
        assert_eq!(spikes_of(&recording(11, 3, 150), ClockKind::Virtual).frame_age, 0, "230 of 90 ms");
        assert_eq!(spikes_of(&Recording::default(), ClockKind::Virtual), Spikes::default());
    }

    #[test]
    fn all_are_counted_and_the_largest_listed() {
        let mut recording = recording(0, 0, 10);
        recording.displays.clear();
        for number in 0..1000_u64 {
            let spike = if number % 4 == 0 { 100 + number } else { 16 };
            recording.displays.push(DisplayRecord {
                time: Duration::from_millis(16 * number),
                motion_to_photon: Duration::from_millis(spike),
                warp: Duration::from_millis(8),
                frame: FrameId(1),
                frame_age: Duration::ZERO,
                missed: false,
            });
        }
        let spikes = spikes_of(&recording, ClockKind::Virtual);
        assert_eq!((spikes.motion_to_photon, spikes.listed.len()), (250, 100));
        assert!(spikes.listed.iter().all(|spike| spike.ms >= 700.0 && spike.interval == "present"));
        assert!(spikes.listed.windows(2).all(|pair| pair[0].time_s < pair[1].time_s));
    }
}
