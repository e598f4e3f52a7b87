//! Head traces: recorded or synthesised poses over time, the input of every replay.
//!
//! A trace says where a head was; the replay asks it where the head is *now*. Between two samples the pose
//! is interpolated (position linearly, orientation along the shorter arc), before the first and after the
//! last it stands still. Nothing is smoothed and no gap is filled: jitter and dropped samples of a real
//! headset are part of what is measured, and [`TraceFacts`] counts them.
//!
//! `tum` reads and writes the file format, `placement` puts a trace into a scene, `synthesis` makes
//! one from a seed.

pub mod cli;
mod error;
mod facts;
mod placement;
mod synthesis;
mod tum;

pub use error::TraceError;
pub use facts::{SpeedFacts, TraceFacts, WINDOW_SECS};
pub use placement::heading_rad;
pub use synthesis::{BUILT_IN_RATE_HZ, BUILT_IN_SECS, BUILT_IN_SEED};
pub use tum::MAX_FILE_BYTES;

use warplight_protocol::Pose;

/// Most poses of a trace: an hour at 1 kHz, 256 MB.
pub const MAX_POSES: usize = 3_600_000;
/// Longest trace in seconds: a day. Keeps everything that walks along a trace bounded.
pub const MAX_DURATION_SECS: f64 = 86_400.0;
/// Highest rate a trace is sampled at, in hertz; trackers reach 1 kHz.
pub const MAX_RATE_HZ: f64 = 10_000.0;

/// A head pose and when it was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Seconds since the first sample of the trace.
    pub time_secs: f64,
    /// world_from_head.
    pub head_pose: Pose,
}

/// Head poses in the order of time: at least two, strictly rising from 0, neighbouring quaternions in the
/// same hemisphere.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    samples: Vec<Sample>,
}

impl Trace {
    /// A trace of `samples` whose times are already known to rise strictly; they are moved to start at 0
    /// and their quaternions are aligned.
    fn from_rising(mut samples: Vec<Sample>) -> Trace {
        debug_assert!(samples.len() >= 2 && samples.windows(2).all(|pair| pair[0].time_secs < pair[1].time_secs));
        let start = samples.first().map_or(0.0, |first| first.time_secs);
        let mut previous = glam::DQuat::IDENTITY;
        for sample in &mut samples {
            sample.time_secs -= start;
            // q and -q are one rotation; a sign that flips between samples would send anything that
            // filters or predicts through the long way round (Guel 2020).
            if sample.head_pose.orientation.dot(previous) < 0.0 {
                sample.head_pose.orientation = -sample.head_pose.orientation;
            }
            previous = sample.head_pose.orientation;
        }
        Trace { samples }
    }

    /// All samples, in the order of time.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Seconds from the first to the last sample.
    pub fn duration_secs(&self) -> f64 {
        self.samples.last().map_or(0.0, |last| last.time_secs)
    }

    /// The head pose `secs` after the first sample: interpolated, clamped to the ends; not a number gives
    /// the first pose. O(log n).
    pub fn pose_at(&self, secs: f64) -> Pose {
        let after = self.samples.partition_point(|sample| sample.time_secs <= secs);
        match (after.checked_sub(1).map(|before| &self.samples[before]), self.samples.get(after)) {
            (Some(before), Some(after)) => {
                let t = (secs - before.time_secs) / (after.time_secs - before.time_secs);
                before.head_pose.interpolate(&after.head_pose, t)
            }
            (Some(only), None) | (None, Some(only)) => only.head_pose,
            (None, None) => Pose::IDENTITY,
        }
    }

    /// The trace at a constant rate, interpolated; gaps are bridged.
    ///
    /// # Errors
    /// A rate that is not positive or leaves fewer than two or more than [`MAX_POSES`] poses.
    pub fn resampled(&self, rate_hz: f64) -> Result<Trace, TraceError> {
        check_rate(rate_hz)?;
        let count = pose_count(self.duration_secs(), rate_hz)?;
        let at = |index: usize| {
            let time_secs = index as f64 / rate_hz;
            Sample { time_secs, head_pose: self.pose_at(time_secs) }
        };
        Ok(Trace::from_rising((0..count).map(at).collect()))
    }

    /// The part from `from_secs` to `to_secs`, whose times start at 0 again. The poses at both cuts are
    /// interpolated.
    ///
    /// # Errors
    /// Cuts that are not in order or not within the trace.
    pub fn cut(&self, from_secs: f64, to_secs: f64) -> Result<Trace, TraceError> {
        let duration = self.duration_secs();
        if !(from_secs >= 0.0 && from_secs < to_secs && from_secs < duration) {
            return Err(TraceError::Parameter {
                field: "from-s and to-s",
                expected: format!("0 <= from < to, within {duration:.3} s"),
                found: format!("{from_secs} to {to_secs}"),
            });
        }
        let to_secs = to_secs.min(duration);
        let cut_at = |time_secs: f64| Sample { time_secs, head_pose: self.pose_at(time_secs) };
        let inner = self.samples.iter().filter(|sample| sample.time_secs > from_secs && sample.time_secs < to_secs);
        let mut samples = vec![cut_at(from_secs)];
        samples.extend(inner);
        samples.push(cut_at(to_secs));
        Ok(Trace::from_rising(samples))
    }
}

/// Refuses a rate that is not above 0 and at most [`MAX_RATE_HZ`].
fn check_rate(rate_hz: f64) -> Result<(), TraceError> {
    if rate_hz > 0.0 && rate_hz <= MAX_RATE_HZ {
        return Ok(());
    }
    let expected = format!("a rate above 0 and at most {MAX_RATE_HZ} Hz");
    Err(TraceError::Parameter { field: "rate-hz", expected, found: rate_hz.to_string() })
}

/// Number of poses at `rate_hz` from 0 to `duration_secs`, both ends included.
fn pose_count(duration_secs: f64, rate_hz: f64) -> Result<usize, TraceError> {
    // A hair more than the duration, so that 10 s at 90 Hz hold 901 poses whatever the rounding says.
    let count = (duration_secs * rate_hz + 1e-9).floor() as usize + 1;
    if count < 2 {
        let expected = format!("a rate of at least {:.6} Hz, so that two poses are left", 1.0 / duration_secs);
        return Err(TraceError::Parameter { field: "rate-hz", expected, found: rate_hz.to_string() });
    }
    if count > MAX_POSES {
        let (allowed, requested) = (MAX_POSES as u64, count as u64);
        return Err(TraceError::LimitExceeded { file: "trace".into(), limit: "poses", allowed, requested });
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    fn turning(times: &[f64]) -> Trace {
        let at = |&time_secs: &f64| Sample {
            time_secs,
            head_pose: Pose {
                position: DVec3::new(time_secs, 1.6, 0.0),
                orientation: DQuat::from_rotation_y(time_secs),
            },
        };
        Trace::from_rising(times.iter().map(at).collect())
    }

    #[test]
    fn between_samples_the_head_moves_evenly() {
        let trace = turning(&[0.0, 0.1, 0.5]);
        for step in 0..=50 {
            let secs = f64::from(step) * 0.01;
            let pose = trace.pose_at(secs);
            assert!((pose.position.x - secs).abs() < 1e-12);
            assert!(pose.angle_to(&Pose { orientation: DQuat::from_rotation_y(secs), ..pose }) < 1e-7);
        }
    }

    #[test]
    fn before_and_after_the_trace_the_head_stands_still() {
        let trace = turning(&[0.0, 0.1]);
        let (first, last) = (trace.samples()[0].head_pose, trace.samples()[1].head_pose);
        for secs in [-1.0, f64::NEG_INFINITY, f64::NAN] {
            assert_eq!(trace.pose_at(secs), first);
        }
        for secs in [0.1, 7.0, f64::INFINITY] {
            assert_eq!(trace.pose_at(secs), last);
        }
    }

    #[test]
    fn a_flipped_sign_is_no_turn() {
        let mut samples = turning(&[0.0, 0.1, 0.2, 0.3]).samples;
        samples[1].head_pose.orientation = -samples[1].head_pose.orientation;
        samples[3].head_pose.orientation = -samples[3].head_pose.orientation;
        let trace = Trace::from_rising(samples);
        let aligned = |pair: &[Sample]| pair[0].head_pose.orientation.dot(pair[1].head_pose.orientation) > 0.0;
        assert!(trace.samples().windows(2).all(aligned));
    }

    #[test]
    fn resampling_keeps_the_motion_and_its_own_rate() {
        let trace = turning(&[0.0, 0.013, 0.4, 1.0]);
        let even = trace.resampled(90.0).unwrap();
        assert_eq!(even.samples().len(), 91);
        assert!((even.duration_secs() - 1.0).abs() < 1e-12);
        assert!((even.pose_at(0.7).position.x - 0.7).abs() < 1e-9);
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9, 1e-3] {
            assert!(trace.resampled(rate).is_err(), "{rate}");
        }
    }

    #[test]
    fn a_cut_starts_at_zero_and_ends_where_asked() {
        let trace = turning(&[0.0, 0.1, 0.5, 1.0]);
        let part = trace.cut(0.05, 0.75).unwrap();
        assert_eq!(part.samples().len(), 4);
        assert!((part.duration_secs() - 0.7).abs() < 1e-12);
        assert!((part.samples()[0].head_pose.position.x - 0.05).abs() < 1e-12);
        assert!((trace.cut(0.5, 9.0).unwrap().duration_secs() - 0.5).abs() < 1e-12);
        for (from, to) in [(0.5, 0.5), (0.5, 0.4), (-0.1, 0.5), (1.0, 2.0), (f64::NAN, 1.0), (0.0, f64::NAN)] {
            assert!(trace.cut(from, to).is_err(), "{from} to {to}");
        }
    }

    proptest! {
        #[test]
        fn every_pose_of_a_trace_is_valid(secs in -1e3..1e3_f64) {
            prop_assert!(turning(&[0.0, 0.3, 0.31, 2.0]).pose_at(secs).is_valid());
        }
    }
}
