//! What kept frames from being what was asked for, and which delays were far beyond the usual: schema and words.

use serde::{Deserialize, Serialize};

/// One reason for live frames being less than was asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Limit {
    /// Name of the reason: throughput, decode time, encode time, render time, target, guard limit or memory limit.
    pub name: String,
    /// For which part of the time it was one, 0 to 1.
    pub share: f64,
    /// What it was about when it was last one, in words.
    pub why: String,
}

/// Delays of more than three times their median.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spikes {
    /// Refreshes whose motion to photon was one.
    pub motion_to_photon: u64,
    /// Frames whose age was one when they were shown first.
    pub frame_age: u64,
    /// The largest of them, at most 100, in the order of time.
    pub listed: Vec<Spike>,
}

/// One of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spike {
    /// When, in seconds since the first refresh.
    pub time_s: f64,
    /// Which delay: motion to photon or frame age.
    pub delay: String,
    /// How long it was.
    pub ms: f64,
    /// Its median over the replay.
    pub median_ms: f64,
    /// The interval that was longest beyond its own median.
    pub interval: String,
    /// How long that was.
    pub interval_ms: f64,
    /// How much longer than its median.
    pub beyond_ms: f64,
}

impl Spike {
    /// A sentence for people.
    pub fn in_words(&self) -> String {
        let Spike { time_s, delay, ms, median_ms, interval, interval_ms, beyond_ms } = self;
        format!(
            "At {time_s:.2} s {delay} was {ms:.0} ms instead of {median_ms:.0}: {interval} took {interval_ms:.0} ms, {beyond_ms:.0} more than usual."
        )
    }
}
