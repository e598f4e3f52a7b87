//! When a frame passed which stage. An interval is named by its two ends.
//!
//! Instants come from two clocks: the server's for what the server does, the client's for the rest. An
//! interval within one side needs no synchronisation; one that crosses the network needs the offset of the
//! clocks, and without it there is none: a guess is not a measurement.

use std::fmt;
use warplight_protocol::Timestamp;

/// What happens to a frame, in the order of the pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// The head pose that the frame answers was read from the tracker.
    PoseSampled,
    /// The server has that pose.
    PoseReceived,
    /// Rendering begins.
    RenderStart,
    /// The last sample of the last pixel is done.
    RenderEnd,
    /// All strips are encoded.
    Encoded,
    /// The last byte was handed to the network.
    Sent,
    /// The client has the last byte.
    Received,
    /// All strips are decoded.
    Decoded,
    /// The frame was first warped to a display pose.
    Warped,
    /// The warped image was first presented.
    Presented,
}

/// Whose clock stamps a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The client's.
    Client,
    /// The server's.
    Server,
}

impl Stage {
    /// All stages in the order of the pipeline.
    pub const ALL: [Stage; 10] = [
        Stage::PoseSampled,
        Stage::PoseReceived,
        Stage::RenderStart,
        Stage::RenderEnd,
        Stage::Encoded,
        Stage::Sent,
        Stage::Received,
        Stage::Decoded,
        Stage::Warped,
        Stage::Presented,
    ];

    /// Whose clock stamps it.
    pub const fn side(self) -> Side {
        match self {
            Stage::PoseReceived | Stage::RenderStart | Stage::RenderEnd | Stage::Encoded | Stage::Sent => Side::Server,
            Stage::PoseSampled | Stage::Received | Stage::Decoded | Stage::Warped | Stage::Presented => Side::Client,
        }
    }
}

/// The time between two stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Interval {
    /// Its beginning.
    pub from: Stage,
    /// Its end.
    pub to: Stage,
}

impl Interval {
    /// The pose on its way to the server.
    pub const POSE_UP: Interval = Interval::new(Stage::PoseSampled, Stage::PoseReceived);
    /// The pose waits for the renderer.
    pub const POSE_WAIT: Interval = Interval::new(Stage::PoseReceived, Stage::RenderStart);
    /// Path tracing.
    pub const RENDER: Interval = Interval::new(Stage::RenderStart, Stage::RenderEnd);
    /// Encoding that is not hidden behind rendering.
    pub const ENCODE: Interval = Interval::new(Stage::RenderEnd, Stage::Encoded);
    /// The frame waits for its turn and is written to the network.
    pub const WRITE: Interval = Interval::new(Stage::Encoded, Stage::Sent);
    /// The frame on its way to the client.
    pub const SEND: Interval = Interval::new(Stage::Sent, Stage::Received);
    /// Decoding.
    pub const DECODE: Interval = Interval::new(Stage::Received, Stage::Decoded);
    /// Until the frame is first shown, the wait for the display's refresh and the warp itself included.
    pub const FIRST_WARP: Interval = Interval::new(Stage::Decoded, Stage::Warped);
    /// From the warp to the display.
    pub const PRESENT: Interval = Interval::new(Stage::Warped, Stage::Presented);
    /// From the head pose a frame was rendered for to the display: the frame's age when it is shown.
    pub const FRAME_AGE: Interval = Interval::new(Stage::PoseSampled, Stage::Presented);

    /// All intervals between neighbouring stages, in the order of the pipeline.
    pub const STEPS: [Interval; 9] = [
        Interval::POSE_UP,
        Interval::POSE_WAIT,
        Interval::RENDER,
        Interval::ENCODE,
        Interval::WRITE,
        Interval::SEND,
        Interval::DECODE,
        Interval::FIRST_WARP,
        Interval::PRESENT,
    ];

    /// The interval between two stages.
    pub const fn new(from: Stage, to: Stage) -> Interval {
        Interval { from, to }
    }

    /// Its name in `report.json`; other intervals have none.
    pub fn name(self) -> Option<&'static str> {
        Some(match self {
            Interval::POSE_UP => "pose_up",
            Interval::POSE_WAIT => "pose_wait",
            Interval::RENDER => "render",
            Interval::ENCODE => "encode",
            Interval::WRITE => "write",
            Interval::SEND => "send",
            Interval::DECODE => "decode",
            Interval::FIRST_WARP => "first_warp",
            Interval::PRESENT => "present",
            Interval::FRAME_AGE => "frame_age",
            _ => return None,
        })
    }

    /// The interval of a name in `report.json`.
    pub fn named(name: &str) -> Option<Interval> {
        let known = Interval::STEPS.into_iter().chain([Interval::FRAME_AGE]);
        known.into_iter().find(|interval| interval.name() == Some(name))
    }
}

impl fmt::Display for Interval {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?} → {:?}", self.from, self.to)
    }
}

/// When one frame passed its stages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameTimes {
    instants: [Option<Timestamp>; Stage::ALL.len()],
    server_ahead_micros: Option<i64>,
}

impl FrameTimes {
    /// The server's clock minus the client's in microseconds, where it is known; both clocks are one where
    /// it is zero.
    pub fn set_clock_offset(&mut self, server_ahead_micros: i64) {
        self.server_ahead_micros = Some(server_ahead_micros);
    }

    /// Notes a stage, on the clock of its side. The first time counts: a frame is warped often, but shown
    /// first only once.
    pub fn record(&mut self, stage: Stage, at: Timestamp) {
        self.instants[stage as usize].get_or_insert(at);
    }

    /// When `stage` was passed, on the clock of its side.
    pub fn at(&self, stage: Stage) -> Option<Timestamp> {
        self.instants[stage as usize]
    }

    /// Length of an interval in milliseconds. `None` where an end is missing or the clocks of its ends are
    /// not known to each other; negative where the offset is wrong by more than the interval.
    pub fn interval_ms(&self, interval: Interval) -> Option<f64> {
        let on_client = |stage: Stage| {
            let micros = i64::try_from(self.at(stage)?.micros).ok()?;
            match stage.side() {
                _ if interval.from.side() == interval.to.side() => Some(micros),
                Side::Client => Some(micros),
                Side::Server => micros.checked_sub(self.server_ahead_micros?),
            }
        };
        let micros = on_client(interval.to)?.checked_sub(on_client(interval.from)?)?;
        Some(micros as f64 * 1e-3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(micros: u64) -> Timestamp {
        Timestamp { micros }
    }

    #[test]
    fn neighbouring_intervals_cover_the_pipeline_without_a_gap() {
        assert!(Stage::ALL.windows(2).all(|pair| pair[0] < pair[1]));
        for (step, pair) in Interval::STEPS.iter().zip(Stage::ALL.windows(2)) {
            assert_eq!((step.from, step.to), (pair[0], pair[1]));
            assert_eq!(Interval::named(step.name().unwrap()), Some(*step));
        }
        assert_eq!(Interval::RENDER.to_string(), "RenderStart → RenderEnd");
        assert_eq!(Interval::new(Stage::Sent, Stage::Warped).name(), None);
    }

    #[test]
    fn one_side_needs_no_offset_two_sides_do() {
        let mut times = FrameTimes::default();
        times.record(Stage::RenderStart, at(1_000_000));
        times.record(Stage::RenderEnd, at(1_020_000));
        times.record(Stage::Sent, at(1_021_000));
        times.record(Stage::Received, at(26_000));
        assert_eq!(times.interval_ms(Interval::RENDER), Some(20.0));
        assert_eq!(times.interval_ms(Interval::SEND), None);
        times.set_clock_offset(1_000_000);
        assert_eq!(times.interval_ms(Interval::SEND), Some(5.0));
        assert_eq!(times.interval_ms(Interval::DECODE), None);
    }

    #[test]
    fn the_first_presentation_counts() {
        let mut times = FrameTimes::default();
        times.record(Stage::PoseSampled, at(0));
        times.record(Stage::Presented, at(40_000));
        times.record(Stage::Presented, at(51_000));
        assert_eq!(times.interval_ms(Interval::FRAME_AGE), Some(40.0));
    }
}
