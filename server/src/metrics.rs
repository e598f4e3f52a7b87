//! Figures of a running program, as Prometheus text: counters, gauges and histograms of the intervals.
//!
//! Beside the pipeline: sessions and replays note what happens, [`http`] hands it to whoever asks. Families are listed in
//! [`FAMILIES`], with what they mean; nothing else can be noted. The form is Prometheus' text exposition format, version
//! 0.0.4: a `# HELP` and a `# TYPE` line per family, then a line per set of labels; of a histogram the cumulative count
//! below each of [`BOUNDS_S`], then sum and count. Intervals are in seconds, as is the custom there.
//!
//! By hand, since the format is fifty lines, and its exporters bring an HTTP stack and a recorder that is global to the
//! process, where a test wants one of its own. Limits: one lock for all; a frame notes about ten figures. Cost: microseconds
//! per frame.

pub mod http;
mod session;

pub use session::SessionMetrics;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::{Mutex, PoisonError};

/// Upper bounds of the buckets of all histograms, in seconds.
pub const BOUNDS_S: [f64; 11] = [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5];

/// What a family's lines are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Only rises.
    Counter,
    /// Is what it is now.
    Gauge,
    /// Counts by size.
    Histogram,
}

/// Everything that can be noted: name, kind, meaning.
pub const FAMILIES: [(&str, Kind, &str); 12] = [
    ("warplight_sessions", Kind::Gauge, "Sessions that are open."),
    ("warplight_sessions_total", Kind::Counter, "Sessions that were opened."),
    ("warplight_frames_total", Kind::Counter, "Live frames, by what became of them."),
    ("warplight_frame_bytes_total", Kind::Counter, "Bytes of strips and pictures of live frames."),
    ("warplight_poses_ignored_total", Kind::Counter, "Poses that were refused or came too late."),
    ("warplight_interval_seconds", Kind::Histogram, "Time of a live frame between two stages of the pipeline."),
    ("warplight_frame_age_seconds", Kind::Histogram, "Age of the shown frame's pose at a refresh of the display."),
    ("warplight_motion_to_photon_seconds", Kind::Histogram, "From sampling the head pose of a refresh to its display."),
    ("warplight_refreshes_total", Kind::Counter, "Refreshes of the display, by whether their picture was in time."),
    ("warplight_reconnects_total", Kind::Counter, "Connections that were made again."),
    ("warplight_limited", Kind::Gauge, "Sessions whose live frames are now less than was asked for, by the reason."),
    ("warplight_limited_seconds_total", Kind::Counter, "Time for which they were, by the reason."),
];

#[derive(Clone, Debug)]
enum Value {
    Number(f64),
    Histogram { counts: [u64; BOUNDS_S.len()], sum: f64, count: u64 },
}

/// The figures of a program.
#[derive(Debug, Default)]
pub struct Metrics {
    values: Mutex<BTreeMap<(&'static str, String), Value>>,
}

impl Metrics {
    /// Adds to a counter or gauge. `labels` are names and values.
    pub fn add(&self, family: &'static str, labels: &[(&str, &str)], amount: f64) {
        self.change(family, labels, |number| *number += amount);
    }

    /// Sets a counter or gauge.
    pub fn set(&self, family: &'static str, labels: &[(&str, &str)], value: f64) {
        self.change(family, labels, |number| *number = value);
    }

    fn change(&self, family: &'static str, labels: &[(&str, &str)], change: impl FnOnce(&mut f64)) {
        debug_assert!(FAMILIES.iter().any(|(name, kind, _)| *name == family && *kind != Kind::Histogram), "{family}");
        let mut values = self.values.lock().unwrap_or_else(PoisonError::into_inner);
        if let Value::Number(number) = values.entry((family, text_of(labels))).or_insert(Value::Number(0.0)) {
            change(number);
        }
    }

    /// Counts an interval in a histogram.
    pub fn observe(&self, family: &'static str, labels: &[(&str, &str)], seconds: f64) {
        debug_assert!(FAMILIES.iter().any(|(name, kind, _)| *name == family && *kind == Kind::Histogram), "{family}");
        if !seconds.is_finite() {
            return;
        }
        let mut values = self.values.lock().unwrap_or_else(PoisonError::into_inner);
        let empty = Value::Histogram { counts: [0; BOUNDS_S.len()], sum: 0.0, count: 0 };
        if let Value::Histogram { counts, sum, count } = values.entry((family, text_of(labels))).or_insert(empty) {
            for (counted, bound) in counts.iter_mut().zip(BOUNDS_S) {
                *counted += u64::from(seconds <= bound);
            }
            *sum += seconds;
            *count += 1;
        }
    }

    /// All figures as Prometheus text.
    pub fn text(&self) -> String {
        let values = self.values.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let mut text = String::new();
        for (family, kind, help) in FAMILIES {
            let mut lines = values.iter().filter(|((name, _), _)| *name == family).peekable();
            if lines.peek().is_none() {
                continue;
            }
            let kind = format!("{kind:?}").to_lowercase();
            let _ = writeln!(text, "# HELP {family} {help}\n# TYPE {family} {kind}");
            for ((_, labels), value) in lines {
                match value {
                    Value::Number(number) => drop(writeln!(text, "{family}{} {number}", braced(labels, ""))),
                    Value::Histogram { counts, sum, count } => {
                        for (counted, bound) in counts.iter().zip(BOUNDS_S) {
                            let labels = braced(labels, &format!("le=\"{bound}\""));
                            let _ = writeln!(text, "{family}_bucket{labels} {counted}");
                        }
                        let all = braced(labels, "le=\"+Inf\"");
                        let labels = braced(labels, "");
                        let _ = writeln!(text, "{family}_bucket{all} {count}");
                        let _ = writeln!(text, "{family}_sum{labels} {sum}\n{family}_count{labels} {count}");
                    }
                }
            }
        }
        text
    }
}

/// Labels as they stand between braces; values may be anything.
fn text_of(labels: &[(&str, &str)]) -> String {
    let escaped = |value: &str| value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
    labels.iter().map(|(name, value)| format!("{name}=\"{}\"", escaped(value))).collect::<Vec<_>>().join(",")
}

fn braced(labels: &str, more: &str) -> String {
    let parts: Vec<&str> = [labels, more].into_iter().filter(|part| !part.is_empty()).collect();
    if parts.is_empty() { String::new() } else { format!("{{{}}}", parts.join(",")) }
}

#[cfg(test)]
pub(crate) mod tests;
