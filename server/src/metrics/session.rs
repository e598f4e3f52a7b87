//! What a session notes of itself: one value per session, which says so when the session is over.

use super::Metrics;
use std::collections::BTreeMap;
use std::sync::Arc;
use warplight_protocol::Timestamp;
use warplight_protocol::message::{FrameAck, FrameEnd, LimiterKind, Statistics};

/// The share of one session in the figures of its server.
#[derive(Debug)]
pub struct SessionMetrics {
    metrics: Arc<Metrics>,
    noted: Statistics,
}

impl SessionMetrics {
    /// A session is opened.
    pub fn new(metrics: Arc<Metrics>) -> SessionMetrics {
        metrics.add("warplight_sessions", &[], 1.0);
        metrics.add("warplight_sessions_total", &[], 1.0);
        SessionMetrics { metrics, noted: Statistics::default() }
    }

    /// A live frame was sent.
    pub(crate) fn sent(&mut self, end: &FrameEnd, bytes: u64, statistics: &Statistics) {
        let metrics = &self.metrics;
        metrics.add("warplight_frame_bytes_total", &[], bytes as f64);
        let steps: [(&str, Timestamp, Timestamp); 4] = [
            ("pose_wait", end.pose_received, end.render_start),
            ("render", end.render_start, end.render_end),
            ("encode", end.render_end, end.encoded),
            ("write", end.encoded, end.sent),
        ];
        for (name, from, to) in steps {
            metrics.observe("warplight_interval_seconds", &[("interval", name)], to.since(from).as_secs_f64());
        }
        let noted = &self.noted;
        let frames = [
            ("rendered", statistics.frames_rendered, noted.frames_rendered),
            ("sent", statistics.frames_sent, noted.frames_sent),
            ("replaced", statistics.frames_replaced, noted.frames_replaced),
        ];
        for (fate, now, before) in frames {
            metrics.add("warplight_frames_total", &[("fate", fate)], f64::from(now.saturating_sub(before)));
        }
        let ignored = statistics.poses_ignored.saturating_sub(noted.poses_ignored);
        metrics.add("warplight_poses_ignored_total", &[], f64::from(ignored));
        self.limiters(statistics);
        self.noted = Statistics { counters: Vec::new(), ..statistics.clone() };
    }

    /// One has arrived.
    pub(crate) fn acknowledged(&self, ack: &FrameAck) {
        self.metrics.add("warplight_frames_total", &[("fate", "acknowledged")], 1.0);
        for (name, micros) in [
            ("receive", ack.receive_micros),
            ("decode", ack.decode_micros),
            ("pose_to_ready", ack.pose_to_ready_micros),
        ] {
            self.metrics.observe("warplight_interval_seconds", &[("interval", name)], f64::from(micros) * 1e-6);
        }
    }

    fn limiters(&self, statistics: &Statistics) {
        let of = |statistics: &Statistics| -> BTreeMap<LimiterKind, (bool, u64)> {
            statistics
                .limiters
                .iter()
                .map(|limiter| (limiter.kind, (limiter.is_active, limiter.active_micros)))
                .collect()
        };
        let (before, now) = (of(&self.noted), of(statistics));
        for kind in LimiterKind::ALL {
            let (was, then) = before.get(&kind).copied().unwrap_or_default();
            let (is, until) = now.get(&kind).copied().unwrap_or_default();
            let labels = [("limiter", kind.name())];
            self.metrics.add("warplight_limited", &labels, f64::from(u8::from(is)) - f64::from(u8::from(was)));
            let seconds = until.saturating_sub(then) as f64 * 1e-6;
            self.metrics.add("warplight_limited_seconds_total", &labels, seconds);
        }
    }
}

impl Drop for SessionMetrics {
    fn drop(&mut self) {
        self.metrics.add("warplight_sessions", &[], -1.0);
        self.limiters(&Statistics {
            limiters: self
                .noted
                .limiters
                .iter()
                .map(|limiter| warplight_protocol::message::Limiter { is_active: false, ..limiter.clone() })
                .collect(),
            ..Statistics::default()
        });
    }
}
