//! What happened in a replay, as plain records in the order of time.

use super::reference::{EyeCapture, MeanOfStills, Wanted};
use crate::assemble::{BytesPerPlane, ReadyFrame};
use crate::measure::{FrameTimes, Stage};
use std::sync::Arc;
use std::time::Duration;
use warplight_protocol::frame::{FrameId, Plan};
use warplight_protocol::message::{Statistics, Welcome};
use warplight_protocol::{Camera, Pose, Timestamp};

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
    /// How often the connection was made again.
    pub reconnects: u64,
    /// When the first refresh was, by the client's clock.
    pub start: Timestamp,
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
            self.statistics = statistics;
        }
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
        }
    }
}
