//! Both directions of a modelled link, and the connection over them: what TCP and the one who connects again do.
//!
//! A cut loses what is under way and what is written meanwhile. Nobody is told: each end finds out by hearing nothing, and
//! what is left of the old connection when the link is back is reset. Connecting fails at once while the link is cut or
//! nobody listens, is tried again by the same [`Backoff`] as over TCP, and takes one round trip.

use super::{Link, LinkModel};
use crate::session::Backoff;
use std::time::Duration;
use warplight_protocol::Timestamp;

/// What has happened to the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// It is gone, and with it what was under way.
    Lost,
    /// Another one is there: both ends start a session.
    Open,
}

#[derive(Clone, Copy, Debug)]
enum State {
    /// Since then.
    Open(Timestamp),
    /// The next try is then.
    Waiting(Timestamp),
    /// The try succeeds then.
    Connecting(Timestamp),
}

/// A link both ways with one connection over it.
#[derive(Debug)]
pub struct Route {
    /// To the server.
    pub up: Link,
    /// To the client.
    pub down: Link,
    state: State,
    backoff: Backoff,
    nobody_until: Timestamp,
}

impl Route {
    /// An open connection.
    pub fn new(model: LinkModel, up_seed: u64, down_seed: u64) -> Route {
        Route {
            up: Link::new(model, up_seed),
            down: Link::new(model, down_seed),
            state: State::Open(Timestamp::ZERO),
            backoff: Backoff::default(),
            nobody_until: Timestamp::ZERO,
        }
    }

    /// Whether there is a connection, as far as its ends know.
    pub fn is_open(&self) -> bool {
        matches!(self.state, State::Open(_))
    }

    /// What has happened to the connection by now; to be asked until it is nothing.
    pub fn poll(&mut self, now: Timestamp) -> Option<Change> {
        loop {
            match self.state {
                State::Open(_) if self.reset_at().is_some_and(|reset| now >= reset) => {
                    self.lose(now);
                    return Some(Change::Lost);
                }
                State::Waiting(at) if now >= at && self.reaches_server(now) => {
                    self.state = State::Connecting(now + 2 * self.up.model.latency);
                }
                State::Connecting(at) if now >= at && self.reaches_server(now) => {
                    self.backoff.reset();
                    self.state = State::Open(now);
                    return Some(Change::Open);
                }
                State::Waiting(at) | State::Connecting(at) if now >= at => {
                    self.state = State::Waiting(now + self.backoff.after_failure());
                }
                _ => return None,
            }
        }
    }

    /// One end has given the connection up: what is under way is lost, and another is made after a while.
    pub fn lose(&mut self, now: Timestamp) {
        self.up.lose_all();
        self.down.lose_all();
        self.state = State::Waiting(now + self.backoff.after_failure());
    }

    /// The server's process ends, and another listens after `pause`.
    pub fn restart_server(&mut self, now: Timestamp, pause: Duration) {
        self.nobody_until = now + pause;
        self.lose(now);
    }

    fn reaches_server(&self, now: Timestamp) -> bool {
        now >= self.nobody_until && !self.up.model.is_cut(now)
    }

    /// When a connection from before a cut is reset.
    fn reset_at(&self) -> Option<Timestamp> {
        let State::Open(since) = self.state else { return None };
        let (start, end) = self.up.model.cut_times()?;
        (since < start).then_some(end)
    }

    /// When something happens next.
    pub fn next_event(&self) -> Option<Timestamp> {
        match self.state {
            State::Open(_) => self.reset_at(),
            State::Waiting(at) | State::Connecting(at) => Some(at),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Timestamp {
        Timestamp { micros: millis * 1000 }
    }

    fn model() -> LinkModel {
        let cut = Some((Duration::from_secs(1), Duration::from_secs(3)));
        LinkModel { latency: Duration::from_millis(20), cut, ..LinkModel::default() }
    }

    #[test]
    fn a_cut_loses_what_is_under_way_and_what_is_written_meanwhile() {
        let mut route = Route::new(model(), 1, 2);
        route.down.send(at(970), vec![1]);
        route.down.send(at(990), vec![2]);
        route.down.send(at(2000), vec![3]);
        assert_eq!(route.down.receive(at(5000)), Some(vec![1]));
        assert_eq!(route.down.receive(at(5000)), None);
        assert_eq!(route.down.take_lost(), [[2], [3]]);
    }

    #[test]
    fn what_is_left_of_a_connection_is_reset_when_the_link_is_back() {
        let mut route = Route::new(model(), 1, 2);
        assert_eq!(route.poll(at(2000)), None, "nobody is told");
        assert!(route.is_open());
        assert_eq!(route.next_event(), Some(at(4000)));
        assert_eq!(route.poll(at(4000)), Some(Change::Lost));
        assert_eq!(route.poll(at(4049)), None);
        assert_eq!(route.poll(at(4050)), None);
        assert_eq!(route.poll(at(4090)), Some(Change::Open));
        assert_eq!((route.poll(at(9000)), route.next_event()), (None, None));
    }

    #[test]
    fn a_connection_given_up_during_a_cut_is_made_soon_after_it() {
        let mut route = Route::new(model(), 1, 2);
        route.lose(at(3000));
        let mut now = at(3000);
        loop {
            now = now.max(route.next_event().unwrap());
            match route.poll(now) {
                Some(Change::Open) => break,
                Some(Change::Lost) => panic!("it was lost already"),
                None => {}
            }
        }
        assert!(now > at(4000) && now <= at(4000) + Backoff::LONGEST + Duration::from_millis(40), "{now:?}");
    }

    #[test]
    fn a_server_that_restarts_is_found_again() {
        let mut route = Route::new(LinkModel::default(), 1, 2);
        route.down.send(at(0), vec![9]);
        route.restart_server(at(0), Duration::from_secs(1));
        assert!(!route.is_open() && route.down.receive(at(5)).is_none());
        let mut now = at(0);
        while route.poll(now) != Some(Change::Open) {
            now = route.next_event().unwrap();
        }
        assert!(now >= at(1000) && now <= at(1500), "{now:?}");
    }
}
