//! How much a client may say: token buckets, so that a link that stood still may deliver what it held back.
//!
//! Not the token of `protocol/src/trust.rs`: the algorithm's name is older. A bucket fills at a rate, holds at most
//! what [`BURST`] fills it with, and whoever finds it empty is refused by name instead of being slowed down: a client
//! of ours never comes near.

use std::time::Duration;
use warplight_protocol::Timestamp;

/// Poses per second: twice as many as the fastest display (1000 Hz) has refreshes.
pub const MAX_POSES_PER_SEC: u32 = 2000;
/// Messages of any kind per second: the poses one by one, and as many acknowledgements.
pub const MAX_MESSAGES_PER_SEC: u32 = 4000;
/// What may come at once is what this long would have brought: as long as a link may stand still and live.
const BURST: Duration = super::DEAD_PEER;

/// A bucket that fills with time.
#[derive(Debug)]
struct Bucket {
    per_sec: u32,
    level: f64,
    filled: Timestamp,
}

impl Bucket {
    fn full(per_sec: u32, now: Timestamp) -> Bucket {
        Bucket { per_sec, level: f64::from(per_sec) * BURST.as_secs_f64(), filled: now }
    }

    fn take(&mut self, now: Timestamp, count: usize) -> bool {
        let per_sec = f64::from(self.per_sec);
        self.level = (self.level + now.since(self.filled).as_secs_f64() * per_sec).min(per_sec * BURST.as_secs_f64());
        self.filled = self.filled.max(now);
        self.level -= count as f64;
        self.level >= 0.0
    }
}

/// What is left of it.
#[derive(Debug)]
pub(super) struct Allowance {
    messages: Bucket,
    poses: Bucket,
}

impl Allowance {
    pub(super) fn new(now: Timestamp) -> Allowance {
        Allowance { messages: Bucket::full(MAX_MESSAGES_PER_SEC, now), poses: Bucket::full(MAX_POSES_PER_SEC, now) }
    }

    /// A message with so many poses; what there is too much of, and how much would have been allowed.
    pub(super) fn take(&mut self, now: Timestamp, poses: usize) -> Result<(), (&'static str, u32)> {
        if !self.messages.take(now, 1) {
            return Err(("messages", MAX_MESSAGES_PER_SEC));
        }
        if !self.poses.take(now, poses) {
            return Err(("poses", MAX_POSES_PER_SEC));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(micros: u64) -> Timestamp {
        Timestamp { micros }
    }

    #[test]
    fn the_fastest_display_is_never_refused_not_even_after_a_stall() {
        let mut allowance = Allowance::new(at(0));
        for refresh in 0..20_000_u64 {
            assert_eq!(allowance.take(at(refresh * 1000), 1), Ok(()));
        }
        // Two seconds later everything comes at once, in batches of 128.
        for _ in 0..2000 / 128 {
            assert_eq!(allowance.take(at(22_000_000), 128), Ok(()));
        }
    }

    #[test]
    fn twice_the_rate_is_refused_once_the_burst_is_used_up() {
        let mut allowance = Allowance::new(at(0));
        let refused = (0..1_000_000_u64).find(|&number| allowance.take(at(number * 250), 1).is_err());
        // Filled at 2000 and emptied at 4000 a second, 4000 last 2 s: 8000 poses.
        assert!(refused.is_some_and(|number| (7990..8010).contains(&number)), "{refused:?}");
        assert_eq!(allowance.take(at(2_000_000), 1), Err(("poses", MAX_POSES_PER_SEC)));
    }

    #[test]
    fn messages_without_poses_count_as_well() {
        let mut allowance = Allowance::new(at(0));
        let allowed = (0..100_000).take_while(|_| allowance.take(at(7), 0).is_ok()).count();
        assert_eq!(allowed, 2 * MAX_MESSAGES_PER_SEC as usize);
        assert_eq!(allowance.take(at(7), 0), Err(("messages", MAX_MESSAGES_PER_SEC)));
    }

    #[test]
    fn a_clock_that_steps_back_gives_nothing() {
        let mut allowance = Allowance::new(at(5_000_000));
        while allowance.take(at(5_000_000), 1).is_ok() {}
        assert!(allowance.take(at(0), 1).is_err() && allowance.take(at(5_000_000), 1).is_err());
    }
}
