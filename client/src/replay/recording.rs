//! What happened in a replay, as plain records in the order of time.

use super::reference::{EyeCapture, MeanOfStills, Wanted};
use crate::assemble::{BytesPerPlane, ReadyFrame};
use crate::budget::{DisplayBudget, DisplayPoint};
use crate::measure::{FrameTimes, Interval, Stage};
use std::sync::Arc;
use std::time::Duration;
use warplight_protocol::frame::{FrameId, Plan};
use warplight_protocol::message::{Statistics, Welcome};
use warplight_protocol::{Camera, Pose, Timestamp};
use warplight_server::metrics::Metrics;

/// One refresh of the display.
#[derive(Clone, Debug, PartialEq)]
pub struct DisplayRecord {
    /// When its pose was sampled, since the first refresh.
    pub time: Duration,
    /// From sampling the pose to its being on the display.
    pub motion_to_photon: Duration,
    /// Time the warp took.
    pub warp: Duration,
    /// The frame it shows.
    pub frame: FrameId,
    /// Age of that frame's pose when it was on the display.
    pub frame_age: Duration,
    /// The picture came too late for its refresh.
    pub missed: bool,
}

/// One frame that arrived.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameRecord {
    /// Its identity.
    pub id: FrameId,
    /// When it passed which stage.
    pub times: FrameTimes,
    /// Bytes of its strips.
    pub bytes: u64,
    /// Samples per pixel.
    pub spp: u32,
    /// How far ahead its pose was predicted.
    pub horizon: Duration,
    /// Where it was rendered for.
    pub render_pose: Pose,
    /// What it shows.
    pub camera: Camera,
    /// Whether it was shown.
    pub shown: bool,
    /// Where the head really was when it was shown first.
    pub pose_when_shown: Option<Pose>,
}

/// A refresh that is compared with the reference.
#[derive(Clone, Debug)]
pub struct Capture {
    /// When, since the first refresh.
    pub time: Duration,
    /// The same by the client's clock, which is that of the scene.
    pub scene_time: Timestamp,
    /// world_from_view of the display.
    pub display_pose: Pose,
    /// The frame that was shown.
    pub frame: Arc<ReadyFrame>,
    /// Those before it that were kept, the newest first.
    pub earlier: Vec<Arc<ReadyFrame>>,
    /// What each eye sees, and its reference.
    pub eyes: Vec<EyeCapture>,
    /// How it was made, where a budget chose.
    pub point: Option<DisplayPoint>,
}

/// Everything that was noted.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// What the server said first.
    pub welcome: Option<Welcome>,
    /// Nodes of the frames.
    pub plan: Option<Plan>,
    /// Refreshes, in order.
    pub displays: Vec<DisplayRecord>,
    /// Frames, in order of arrival.
    pub frames: Vec<FrameRecord>,
    /// Compared refreshes, in order.
    pub captures: Vec<Capture>,
    /// A second reference of the first capture, by other samples.
    pub second_reference: MeanOfStills,
    /// What the stills are for, by their numbers.
    pub(super) wanted: Vec<Wanted>,
    /// The server's totals.
    pub statistics: Statistics,
    /// Bytes of the planes of all frames.
    pub bytes_per_plane: BytesPerPlane,
    /// Bytes from the server.
    pub down_bytes: u64,
    /// Bytes to the server.
    pub up_bytes: u64,
    /// The server's totals of sessions before this one.
    pub earlier_sessions: Statistics,
    /// Live frames that had begun to arrive when their session was lost.
    pub frames_lost: u64,
    /// How often the connection was made again.
    pub reconnects: u64,
    /// When the first refresh was, by the client's clock.
    pub start: Timestamp,
    /// The display's budget, as it was at the end.
    pub budget: Option<DisplayBudget>,
    /// Where figures go while it is made.
    pub metrics: Option<Arc<Metrics>>,
    /// The last refresh is over: what arrives now is not part of the replay.
    pub is_over: bool,
}

impl Recording {
    /// Ends the replay, with what has gone over the link so far.
    pub fn finish(&mut self, down_bytes: u64, up_bytes: u64) {
        self.down_bytes = down_bytes;
        self.up_bytes = up_bytes;
        self.is_over = true;
    }

    /// Takes in the server's totals.
    pub fn statistics_arrived(&mut self, statistics: Statistics) {
        if !self.is_over {
            if let Some(metrics) = &self.metrics {
                for limiter in &statistics.limiters {
                    let labels = [("limiter", limiter.kind.name())];
                    metrics.set("warplight_limited", &labels, f64::from(u8::from(limiter.is_active)));
                    metrics.set("warplight_limited_seconds_total", &labels, limiter.active_micros as f64 * 1e-6);
                }
                for (fate, frames) in [("sent", statistics.frames_sent), ("replaced", statistics.frames_replaced)] {
                    metrics.set("warplight_frames_total", &[("fate", fate)], f64::from(frames));
                }
            }
            self.statistics = statistics;
        }
    }

    /// Notes that a session is over, and whether a live frame had begun to arrive and will not be whole. The server's
    /// totals start again with the next.
    pub fn session_lost(&mut self, has_begun: bool) {
        if self.is_over {
            return;
        }
        self.frames_lost += u64::from(has_begun);
        self.earlier_sessions = self.totals();
        self.statistics = Statistics::default();
    }

    /// The server's totals of all sessions.
    pub fn totals(&self) -> Statistics {
        let (mut all, last) = (self.earlier_sessions.clone(), &self.statistics);
        all.frames_rendered += last.frames_rendered;
        all.frames_sent += last.frames_sent;
        all.frames_replaced += last.frames_replaced;
        all.poses_ignored += last.poses_ignored;
        for (name, count) in &last.counters {
            match all.counters.iter_mut().find(|(known, _)| known == name) {
                Some((_, sum)) => *sum += count,
                None => all.counters.push((name.clone(), *count)),
            }
        }
        all
    }

    /// Notes a frame that is ready.
    pub fn frame_arrived(&mut self, frame: &ReadyFrame) {
        if self.is_over {
            return;
        }
        for (&plane, &bytes) in &frame.bytes_per_plane {
            *self.bytes_per_plane.entry(plane).or_default() += bytes;
        }
        let mut times = FrameTimes::default();
        let end = &frame.end;
        for (stage, at) in [
            (Stage::PoseSampled, frame.begin.pose_time),
            (Stage::PoseReceived, end.pose_received),
            (Stage::RenderStart, end.render_start),
            (Stage::RenderEnd, end.render_end),
            (Stage::Encoded, end.encoded),
            (Stage::Sent, end.sent),
            (Stage::Received, frame.received),
            (Stage::Decoded, frame.decoded),
        ] {
            times.record(stage, at);
        }
        if let Some(metrics) = &self.metrics {
            metrics.add("warplight_frames_total", &[("fate", "received")], 1.0);
            metrics.add("warplight_frame_bytes_total", &[], frame.bytes as f64);
        }
        self.observe_steps(&times, Stage::PoseReceived, Stage::Decoded);
        self.plan.get_or_insert_with(|| frame.begin.shape.plan.clone());
        self.frames.push(FrameRecord {
            id: frame.begin.id,
            times,
            bytes: frame.bytes,
            spp: end.spp,
            horizon: Duration::from_micros(u64::from(frame.begin.horizon_micros)),
            render_pose: frame.begin.render_pose,
            camera: frame.begin.shape.camera,
            shown: false,
            pose_when_shown: None,
        });
    }

    /// Notes that `frame` was shown: warped by `warped`, on the display at `presented`, where `true_pose` is
    /// where the head is by then.
    pub fn frame_shown(&mut self, frame: FrameId, warped: Timestamp, presented: Timestamp, true_pose: Pose) {
        let Some(record) = self.frames.iter_mut().rev().find(|record| record.id == frame) else { return };
        if !record.shown {
            record.shown = true;
            record.pose_when_shown = Some(true_pose);
            record.times.record(Stage::Warped, warped);
            record.times.record(Stage::Presented, presented);
            let times = record.times;
            if let Some(metrics) = &self.metrics {
                metrics.add("warplight_frames_total", &[("fate", "shown")], 1.0);
            }
            self.observe_steps(&times, Stage::Decoded, Stage::Presented);
        }
    }

    /// Notes a refresh.
    pub fn refreshed(&mut self, record: DisplayRecord) {
        if let Some(metrics) = &self.metrics {
            let fate = if record.missed { "late" } else { "in time" };
            metrics.add("warplight_refreshes_total", &[("picture", fate)], 1.0);
            metrics.observe("warplight_frame_age_seconds", &[], record.frame_age.as_secs_f64());
            metrics.observe("warplight_motion_to_photon_seconds", &[], record.motion_to_photon.as_secs_f64());
            metrics.observe("warplight_interval_seconds", &[("interval", "warp")], record.warp.as_secs_f64());
        }
        self.displays.push(record);
    }

    /// Those intervals between two stages whose ends are of one clock: how far apart two clocks are is known at the end.
    fn observe_steps(&self, times: &FrameTimes, from: Stage, to: Stage) {
        let Some(metrics) = &self.metrics else { return };
        for step in Interval::STEPS.into_iter().filter(|step| step.from >= from && step.to <= to) {
            if let (Some(name), Some(millis)) = (step.name(), times.interval_ms(step)) {
                metrics.observe("warplight_interval_seconds", &[("interval", name)], millis * 1e-3);
            }
        }
    }
}
