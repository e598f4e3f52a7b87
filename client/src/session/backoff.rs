//! How long to wait before connecting again: twice as long with every failure, up to a limit.
//!
//! Used by whoever drives the session, over TCP and over a modelled link alike. A link that is back is noticed within
//! [`Backoff::LONGEST`].

use std::time::Duration;

/// The next wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Backoff {
    next: Duration,
}

impl Default for Backoff {
    fn default() -> Backoff {
        Backoff { next: Backoff::FIRST }
    }
}

impl Backoff {
    /// The first wait after a session that was open.
    pub const FIRST: Duration = Duration::from_millis(50);
    /// No wait is longer.
    pub const LONGEST: Duration = Duration::from_millis(500);

    /// The time to wait after a failure.
    pub fn after_failure(&mut self) -> Duration {
        let wait = self.next;
        self.next = (wait * 2).min(Backoff::LONGEST);
        wait
    }

    /// A session was open: the next failure is a first one.
    pub fn reset(&mut self) {
        *self = Backoff::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_doubles_up_to_its_limit_and_starts_again() {
        let mut backoff = Backoff::default();
        let waits: Vec<u128> = (0..6).map(|_| backoff.after_failure().as_millis()).collect();
        assert_eq!(waits, [50, 100, 200, 400, 500, 500]);
        backoff.reset();
        assert_eq!(backoff.after_failure(), Backoff::FIRST);
    }
}
