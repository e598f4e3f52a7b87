//! What a trace is like: its length, rate and gaps, and how fast the head moves.
//!
//! Speeds are differences between poses 20 ms apart, on a grid that starts at the first sample, with
//! interpolated poses: at the sample rate itself, time stamps that jitter by a millisecond make a calm
//! head look frantic. This is how the speeds of the public traces we compare with were taken.
//! O(n + duration / 20 ms).

use super::{Sample, Trace};
use crate::measure::Percentiles;
use glam::DVec3;
use serde::Serialize;

/// Seconds between the two poses that make a speed.
pub const WINDOW_SECS: f64 = 0.02;
/// An interval longer than this many median intervals is a gap: at least one sample is missing.
const GAP_INTERVALS: f64 = 1.9;

/// Mean, 95th percentile and maximum of a speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SpeedFacts {
    /// Mean.
    pub mean: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Largest.
    pub max: f64,
}

/// Facts of a trace.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TraceFacts {
    /// Number of poses.
    pub poses: usize,
    /// Seconds from the first to the last pose.
    pub duration_s: f64,
    /// Poses per second, over the whole trace.
    pub rate_hz: f64,
    /// Median interval between poses, in milliseconds.
    pub median_interval_ms: f64,
    /// Longest interval between poses, in milliseconds.
    pub max_gap_ms: f64,
    /// Intervals of about two median intervals and more, where samples are missing.
    pub gaps: usize,
    /// Angular speed in degrees per second.
    pub angular_deg_per_s: SpeedFacts,
    /// Linear speed in metres per second.
    pub linear_m_per_s: SpeedFacts,
    /// Sides of the bounding box of all positions, in metres.
    pub box_m: [f64; 3],
    /// Length of the path, in metres, at the resolution of the speeds.
    pub path_m: f64,
    /// Largest turn of the gaze away from the first heading, in degrees about the vertical.
    pub max_yaw_deg: f64,
}

impl Trace {
    /// The facts of this trace.
    pub fn facts(&self) -> TraceFacts {
        let samples = self.samples();
        let duration_s = self.duration_secs();
        let intervals: Vec<f64> = samples.windows(2).map(|pair| pair[1].time_secs - pair[0].time_secs).collect();
        let interval = Percentiles::from_samples(&intervals).unwrap_or_default();
        let (angular, linear): (Vec<f64>, Vec<f64>) = self.speeds().unzip();
        let (low, high) = samples.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), sample| {
            (low.min(sample.head_pose.position), high.max(sample.head_pose.position))
        });
        TraceFacts {
            poses: samples.len(),
            duration_s,
            rate_hz: (samples.len() - 1) as f64 / duration_s,
            median_interval_ms: interval.p50 * 1e3,
            max_gap_ms: interval.max * 1e3,
            gaps: intervals.iter().filter(|&&secs| secs > GAP_INTERVALS * interval.p50).count(),
            angular_deg_per_s: SpeedFacts::of(&angular),
            path_m: linear.iter().sum::<f64>() * WINDOW_SECS,
            linear_m_per_s: SpeedFacts::of(&linear),
            box_m: (high - low).to_array(),
            max_yaw_deg: max_yaw_deg(samples),
        }
    }

    /// Angular speed (degrees per second) and linear speed (metres per second) of every whole window.
    fn speeds(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        // A trace shorter than a window is one window.
        let windows = ((self.duration_secs() / WINDOW_SECS + 1e-9).floor() as usize).max(1);
        (0..windows).map(|window| {
            let from = self.pose_at(window as f64 * WINDOW_SECS);
            let to = self.pose_at((window + 1) as f64 * WINDOW_SECS);
            let metres = (to.position - from.position).length();
            (from.angle_to(&to).to_degrees() / WINDOW_SECS, metres / WINDOW_SECS)
        })
    }
}

impl SpeedFacts {
    fn of(speeds: &[f64]) -> SpeedFacts {
        let speed = Percentiles::from_samples(speeds).unwrap_or_default();
        SpeedFacts { mean: speed.mean, p95: speed.p95, max: speed.max }
    }
}

impl std::fmt::Display for TraceFacts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let speed = |s: &SpeedFacts, digits: usize| {
            format!("mean {:.digits$}, p95 {:.digits$}, max {:.digits$}", s.mean, s.p95, s.max)
        };
        let [x, y, z] = self.box_m;
        writeln!(f, "poses     {} in {:.2} s, {:.1} Hz", self.poses, self.duration_s, self.rate_hz)?;
        let (median, longest, gaps) = (self.median_interval_ms, self.max_gap_ms, self.gaps);
        writeln!(f, "interval  median {median:.2} ms, longest {longest:.1} ms, {gaps} gaps")?;
        writeln!(f, "angular   {} deg/s", speed(&self.angular_deg_per_s, 1))?;
        writeln!(f, "linear    {} m/s", speed(&self.linear_m_per_s, 3))?;
        write!(f, "space     {x:.2} x {y:.2} x {z:.2} m, path {:.1} m, ", self.path_m)?;
        write!(f, "gaze within {:.0} deg of the first heading", self.max_yaw_deg)
    }
}

/// Largest turn away from the first heading, in degrees.
fn max_yaw_deg(samples: &[Sample]) -> f64 {
    let headings = samples.iter().map(|sample| super::heading_rad(&sample.head_pose));
    let first = headings.clone().next().unwrap_or_default();
    let turn = |heading: f64| {
        let turn = heading - first;
        turn.sin().atan2(turn.cos()).to_degrees().abs()
    };
    headings.map(turn).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    #[derive(serde::Deserialize)]
    struct Published {
        name: String,
        n: usize,
        dur: f64,
        med_dt_ms: f64,
        hz: f64,
        max_gap_ms: f64,
        ang_mean: f64,
        ang_p95: f64,
        ang_max: f64,
        lin_mean: f64,
        lin_p95: f64,
        lin_max: f64,
        bbox: [f64; 3],
        path_m: f64,
    }

    /// The real traces, read with the reader of the product, against figures that were computed elsewhere.
    #[test]
    fn real_traces_have_the_published_facts() {
        let Some(data) = std::env::var_os("WARPLIGHT_DATA") else {
            eprintln!("WARPLIGHT_DATA is not set: real traces are NOT checked");
            return;
        };
        let folder = PathBuf::from(data).join("traces");
        let published = std::fs::read_to_string(folder.join("stats.json")).unwrap();
        let published: Vec<Published> = serde_json::from_str(&published).unwrap();
        let mut checked = 0;
        for expected in &published {
            let path = folder.join(format!("{}.tum", expected.name));
            if !path.exists() {
                eprintln!("{} is not here: not checked", path.display());
                continue;
            }
            let facts = Trace::read(&path).unwrap().facts();
            let near = |what: &str, ours: f64, theirs: f64, within: f64| {
                assert!((ours - theirs).abs() <= within, "{} {what}: {ours} against {theirs}", expected.name);
            };
            assert_eq!(facts.poses, expected.n, "{}", expected.name);
            near("duration", facts.duration_s, expected.dur, 0.006);
            near("median interval", facts.median_interval_ms, expected.med_dt_ms, 0.002);
            near("rate", facts.rate_hz, expected.hz, 0.06);
            near("max gap", facts.max_gap_ms, expected.max_gap_ms, 0.06);
            near("angular mean", facts.angular_deg_per_s.mean, expected.ang_mean, 0.06);
            near("angular p95", facts.angular_deg_per_s.p95, expected.ang_p95, 0.06);
            near("angular max", facts.angular_deg_per_s.max, expected.ang_max, 0.2);
            near("linear mean", facts.linear_m_per_s.mean, expected.lin_mean, 6e-4);
            near("linear p95", facts.linear_m_per_s.p95, expected.lin_p95, 2e-3);
            near("linear max", facts.linear_m_per_s.max, expected.lin_max, 2e-3);
            near("path", facts.path_m, expected.path_m, 0.06);
            for axis in 0..3 {
                near("box", facts.box_m[axis], expected.bbox[axis], 0.006);
            }
            checked += 1;
        }
        assert!(checked >= 5, "only {checked} traces in {}", folder.display());
    }

    #[test]
    fn a_missing_sample_is_a_gap() {
        let even = Trace::synthesise(1, 1.0, 90.0).unwrap();
        assert_eq!(even.facts().gaps, 0);
        let mut samples = even.samples().to_vec();
        samples.remove(40);
        samples.drain(60..63);
        let facts = Trace::from_rising(samples).facts();
        assert_eq!(facts.gaps, 2);
        assert!((facts.max_gap_ms - 4.0 * 1e3 / 90.0).abs() < 1e-6);
    }

    #[test]
    fn two_poses_are_enough_for_finite_facts() {
        let facts = Trace::parse("0 0 0 0 0 0 0 1\n1e-9 0 0 0 0 0 0 1", "two").unwrap().facts();
        assert!(facts.rate_hz.is_finite() && facts.angular_deg_per_s.max.is_finite());
    }
}
