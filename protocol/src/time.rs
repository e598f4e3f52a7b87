//! Instants as both ends exchange them.
//!
//! A [`Timestamp`] counts microseconds of its owner's own clock since an epoch of its choice. No decision rests
//! on comparing the two clocks: a delay is measured by the end that sees its echo come back. A report may estimate
//! their offset, and then says how well it is known.

use serde::{Deserialize, Serialize};
use std::ops::{Add, AddAssign, Sub};
use std::time::Duration;

/// Microseconds since the epoch of the clock that made it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Timestamp {
    /// Microseconds since the epoch.
    pub micros: u64,
}

impl Timestamp {
    /// The epoch itself.
    pub const ZERO: Timestamp = Timestamp { micros: 0 };

    /// The instant `secs` after the epoch; before the epoch, not a number and out of range saturate.
    pub fn from_secs(secs: f64) -> Timestamp {
        // `as` saturates and maps NaN to zero.
        Timestamp { micros: (secs * 1e6).round() as u64 }
    }

    /// Seconds since the epoch.
    pub fn as_secs(self) -> f64 {
        self.micros as f64 * 1e-6
    }

    /// How long ago `earlier` was; zero where it lies ahead.
    pub fn since(self, earlier: Timestamp) -> Duration {
        Duration::from_micros(self.micros.saturating_sub(earlier.micros))
    }
}

impl Add<Duration> for Timestamp {
    type Output = Timestamp;
    fn add(self, duration: Duration) -> Timestamp {
        let micros = u64::try_from(duration.as_micros()).unwrap_or(u64::MAX);
        Timestamp { micros: self.micros.saturating_add(micros) }
    }
}

impl AddAssign<Duration> for Timestamp {
    fn add_assign(&mut self, duration: Duration) {
        *self = *self + duration;
    }
}

impl Sub for Timestamp {
    type Output = Duration;
    fn sub(self, earlier: Timestamp) -> Duration {
        self.since(earlier)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_saturate_instead_of_wrapping() {
        assert_eq!(Timestamp::from_secs(-1.0), Timestamp::ZERO);
        assert_eq!(Timestamp::from_secs(f64::NAN), Timestamp::ZERO);
        assert_eq!(Timestamp::from_secs(f64::INFINITY).micros, u64::MAX);
        assert_eq!(Timestamp::from_secs(1.5).micros, 1_500_000);
    }

    #[test]
    fn a_time_that_goes_back_is_no_time() {
        let early = Timestamp { micros: 5 };
        let late = Timestamp { micros: 9 };
        assert_eq!(late - early, Duration::from_micros(4));
        assert_eq!(early - late, Duration::ZERO);
    }
}
