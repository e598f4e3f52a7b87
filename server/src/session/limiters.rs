//! Why live frames are less than was asked for: who limits them, for how long, in words.
//!
//! Part of the session; asked once for every live frame, and sent with the statistics. A limiter is active while it makes
//! the frame that is begun smaller, coarser, later or narrower than the client's hello asks for; several may be. Time counts
//! from one live frame to the next.

use super::{ServerSession, Work};
use std::time::Duration;
use warplight_protocol::Timestamp;
use warplight_protocol::message::{Hello, Limiter, LimiterKind, Viewport};

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

impl ServerSession {
    /// Notes who limits the live frame that is begun.
    pub(super) fn note_limiters(&mut self, now: Timestamp, hello: &Hello) {
        let asked = Duration::from_secs_f64(1.0 / f64::from(hello.frame_hz));
        let millis = |duration: Duration| duration.as_secs_f64() * 1e3;
        let mbps = |bytes_per_s: f64| bytes_per_s * 8e-6;
        let (level, cause) = (self.adaptation.level(), self.adaptation.cause());
        let mut given_up = Vec::new();
        if self.rate.gives_way() {
            given_up.push("coarser colour and depth".to_owned());
        }
        if level.rate < 1.0 {
            given_up.push(format!("{:.0} % of the frames", 100.0 * level.rate));
        }
        if level.scale < 1.0 {
            given_up.push(format!("{:.0} % of each side", 100.0 * level.scale));
        }
        if level.layers < 1.0 && hello.format.volume.layers > 0 && !self.config.media.is_empty() {
            given_up.push(format!("{:.0} % of the layers", 100.0 * level.layers));
        }
        let given_up = given_up.join(", ");
        let wished = f64::from(hello.target_kbps) * 125.0;
        let fits_wish = wished == 0.0 || self.adaptation.bytes_per_s().is_some_and(|budget| budget < wished);
        let mut active = Vec::new();
        if let Some(carried) = self.adaptation.carried_bytes_per_s()
            && (cause == Some(LimiterKind::Throughput) || (self.rate.gives_way() && fits_wish))
        {
            active.push((LimiterKind::Throughput, format!("the link carries {:.2} Mbit/s: {given_up}", mbps(carried))));
        }
        if cause == Some(LimiterKind::DecodeTime) {
            let decode_ms = 1e3 * self.adaptation.decode_s();
            let why = format!("the client decodes a frame for {decode_ms:.0} ms: {given_up}");
            active.push((LimiterKind::DecodeTime, why));
        }
        let Work { render, encode, has_least_samples, is_cut, .. } = self.work;
        let late = |what: &str, took: Duration| {
            format!("a frame is {what} for {:.0} ms, one every {:.0} ms was asked for", millis(took), millis(asked))
        };
        if encode > asked {
            active.push((LimiterKind::EncodeTime, late("encoded", encode)));
        }
        if let Some(budget) = self.budget.as_ref().filter(|budget| budget.is_less()) {
            active.push((LimiterKind::RenderTime, format!("frames of {}", budget.in_words())));
        } else if render > asked || has_least_samples {
            let few = if has_least_samples { ", with the fewest samples" } else { "" };
            active.push((LimiterKind::RenderTime, late("rendered", render) + few));
        }
        if self.rate.gives_way() && !fits_wish {
            let why = format!("{:.2} Mbit/s were asked for: {given_up}", mbps(wished));
            active.push((LimiterKind::Target, why));
        }
        if hello.viewport == Viewport::Plane && self.guard.is_at_most() {
            let why = format!(
                "the head turns further than {:.0} degrees past the display",
                self.config.guard_rad.to_degrees()
            );
            active.push((LimiterKind::GuardLimit, why));
        }
        if is_cut {
            let pixels = self.config.limits.frame_pixels;
            active.push((LimiterKind::MemoryLimit, format!("a whole frame would exceed {pixels} pixels or its bytes")));
        }
        self.limiters.frame(now, active);
        self.statistics.live_micros = self.limiters.live().as_micros() as u64;
        self.statistics.limiters = self.limiters.known().to_vec();
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
