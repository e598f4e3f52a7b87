//! Why live frames are less than was asked for: who limits them, for how long, in words.
//!
//! Part of the session; asked once for every live frame, and sent with the statistics. A limiter is active while it makes
//! the frame that is begun smaller, coarser, later or narrower than the client's hello asks for; several may be. Time counts
//! from one live frame to the next.

use std::time::Duration;
use warplight_protocol::Timestamp;
use warplight_protocol::message::{Limiter, LimiterKind};

/// A gap between two frames counts as this much at most: nobody was limited while nobody asked.
const LONGEST_GAP: Duration = Duration::from_secs(1);

/// Limiters of one session.
#[derive(Clone, Debug, Default)]
pub(super) struct Limiters {
    known: Vec<Limiter>,
    begun: Option<Timestamp>,
    live: Duration,
}

impl Limiters {
    /// A live frame is begun that these limit.
    pub(super) fn frame(&mut self, now: Timestamp, active: Vec<(LimiterKind, String)>) {
        let gap = self.begun.replace(now).map_or(Duration::ZERO, |begun| now.since(begun)).min(LONGEST_GAP);
        self.live += gap;
        for limiter in &mut self.known {
            // What was active limited the frame before, until this one.
            if limiter.is_active {
                limiter.active_micros += gap.as_micros() as u64;
            }
            limiter.is_active = false;
        }
        for (kind, why) in active {
            match self.known.iter_mut().find(|limiter| limiter.kind == kind) {
                Some(limiter) => (limiter.is_active, limiter.why) = (true, why),
                None => self.known.push(Limiter { kind, is_active: true, active_micros: 0, why }),
            }
        }
        self.known.sort_by_key(|limiter| limiter.kind);
    }

    /// Those that were active at some time.
    pub(super) fn known(&self) -> &[Limiter] {
        &self.known
    }

    /// Time from the first live frame to the last.
    pub(super) fn live(&self) -> Duration {
        self.live
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_counts_from_frame_to_frame_while_a_limiter_is_active() {
        let at = |millis: u64| Timestamp { micros: 1000 * millis };
        let mut limiters = Limiters::default();
        let slow = || vec![(LimiterKind::RenderTime, "slow".to_owned())];
        limiters.frame(at(0), vec![]);
        assert!(limiters.known().is_empty(), "nothing is said of what is not limited");
        limiters.frame(at(100), slow());
        limiters.frame(at(300), slow());
        limiters.frame(at(600), vec![]);
        limiters.frame(at(1000), vec![]);
        let [render] = limiters.known() else { panic!("{limiters:?}") };
        assert_eq!((render.active_micros, render.is_active), (500_000, false));
        assert_eq!(limiters.live(), Duration::from_secs(1));
        limiters.frame(at(100_000), slow());
        assert_eq!(limiters.live(), Duration::from_secs(2), "a pause is not the limiter's");
    }
}
