//! Messages that travel seldom. This is the one file that knows bincode (2.0, no longer developed, so that
//! it can be replaced here alone): fixed-width little-endian integers, lengths checked before allocation.

use crate::camera::Projection;
use crate::codec::{DecodeError, FrameShape, Limits};
use crate::frame::{ColorCoding, FrameFormat, FrameId};
use crate::{Camera, Pose, Timestamp, Token};
use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Bytes that decoding a control message may claim.
const MAX_BYTES: usize = 64 << 10;

const CONFIG: Configuration<LittleEndian, Fixint, Limit<MAX_BYTES>> =
    bincode::config::standard().with_fixed_int_encoding().with_limit::<MAX_BYTES>();

/// Appends a message.
pub(super) fn write<T: Serialize>(message: &T, out: &mut Vec<u8>) {
    // Writing to memory fails only for a pose that is not valid, which the caller has to rule out.
    if let Ok(bytes) = bincode::serde::encode_to_vec(message, CONFIG) {
        out.extend_from_slice(&bytes);
    }
}

/// Reads a message that takes the whole of `payload`.
pub(super) fn read<T: DeserializeOwned>(payload: &[u8], field: &'static str) -> Result<T, DecodeError> {
    match bincode::serde::decode_from_slice(payload, CONFIG) {
        Ok((message, used)) if used == payload.len() => Ok(message),
        Ok(_) => Err(DecodeError::Malformed { field, expected: "nothing behind its last field" }),
        Err(bincode::error::DecodeError::LimitExceeded) => {
            Err(DecodeError::LimitExceeded { limit: Limits::default().control_bytes, requested: payload.len() })
        }
        Err(bincode::error::DecodeError::UnexpectedEnd { .. }) => Err(DecodeError::Truncated { field }),
        Err(_) => Err(DecodeError::Malformed { field, expected: "fields of this version" }),
    }
}

/// What an end can do, as a set of bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capabilities(pub u32);

impl Capabilities {
    /// Ray trees of surfaces.
    pub const RAY_TREE: Capabilities = Capabilities(1);
    /// Converged pictures on request.
    pub const STILLS: Capabilities = Capabilities(1 << 1);
    /// Radiance as pictures of a video.
    pub const VIDEO: Capabilities = Capabilities(1 << 2);
    /// Everything this version can do; all other bits are reserved.
    pub const ALL: Capabilities = Capabilities(0b111);

    /// Whether all of `other` is in the set.
    pub fn contains(self, other: Capabilities) -> bool {
        self.0 & other.0 == other.0
    }

    fn check(self) -> Result<(), DecodeError> {
        let reserved = self.0 & !Capabilities::ALL.0;
        if reserved == 0 { Ok(()) } else { Err(DecodeError::Unsupported { field: "capability bits", found: reserved }) }
    }
}

/// What live frames show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Viewport {
    /// What the display shows, and more on the sides to which the head turns.
    #[default]
    Plane,
    /// Everything around the head, on the six faces of a cube.
    Cube,
}

/// How a server continues the motion of a head.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Prediction {
    /// Not at all: a frame is rendered for the last pose.
    None,
    /// At the velocities of the last 30 ms.
    ConstantVelocity,
    /// The same, but turns die away.
    Damped,
    /// By the mixture of both, and of velocities over other times, that would have served this head best of late.
    #[default]
    Adaptive,
}

impl Prediction {
    /// All of them.
    pub const ALL: [Prediction; 4] =
        [Prediction::None, Prediction::ConstantVelocity, Prediction::Damped, Prediction::Adaptive];

    /// As it is called on command lines and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Prediction::None => "none",
            Prediction::ConstantVelocity => "constant",
            Prediction::Damped => "damped",
            Prediction::Adaptive => "adaptive",
        }
    }
}

/// What a client asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// What it can do.
    pub capabilities: Capabilities,
    /// Software and version, for logs.
    pub software: String,
    /// Camera of the display.
    pub camera: Camera,
    /// What live frames show of what is around it.
    pub viewport: Viewport,
    /// Frames per second it would like.
    pub frame_hz: f32,
    /// Formats of the planes.
    pub format: FrameFormat,
    /// Bytes per second that live frames may take, in thousands of bits; 0: as many as they need.
    pub target_kbps: u32,
    /// How its head's motion is continued.
    pub prediction: Prediction,
    /// What the server may want to hear before it serves.
    pub token: Token,
    /// Whether rate, size and coding of live frames may give way where link or client cannot keep up.
    pub adapt: bool,
}

impl Hello {
    pub(super) fn check(&self) -> Result<(), DecodeError> {
        self.capabilities.check()?;
        if !self.camera.is_valid() || self.camera.projection != Projection::Perspective {
            return Err(DecodeError::Malformed {
                field: "camera",
                expected: "a size of 1 to 8192 pixels and a frustum that is not empty",
            });
        }
        if !(0.01..=1000.0).contains(&self.frame_hz) {
            return Err(DecodeError::Malformed { field: "frame rate", expected: "0.01 to 1000 Hz" });
        }
        if !self.format.is_valid() {
            return Err(DecodeError::Malformed {
                field: "format",
                expected: "depth of 8 to 24 bits and normals of 6 to 16; 0 to 8 layers with depths of 4 to 16 bits",
            });
        }
        let is_video = matches!(self.format.color_coding, ColorCoding::Video { .. });
        if is_video && !self.capabilities.contains(Capabilities::VIDEO) {
            return Err(DecodeError::Malformed { field: "capabilities", expected: "VIDEO, where colour is a video" });
        }
        if !self.token.is_valid() {
            return Err(DecodeError::Malformed {
                field: "token",
                expected: "nothing, or 16 to 256 visible characters",
            });
        }
        Ok(())
    }
}

/// What the server answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Welcome {
    /// What it can do.
    pub capabilities: Capabilities,
    /// Software and version, for logs.
    pub software: String,
    /// Name of the scene.
    pub scene: String,
    /// Effects that the scene calls for, by name.
    pub effects: Vec<String>,
    /// Where a person stands in the scene.
    pub head: Pose,
    /// Factor on radiance before display.
    pub exposure: f32,
}

impl Welcome {
    pub(super) fn check(&self) -> Result<(), DecodeError> {
        self.capabilities.check()?;
        if !self.head.is_valid() {
            return Err(DecodeError::Malformed { field: "head", expected: "a unit quaternion within 32 km" });
        }
        if !FrameShape::EXPOSURE.contains(&self.exposure) {
            return Err(DecodeError::Malformed { field: "exposure", expected: "1e-12 to 1e12" });
        }
        Ok(())
    }
}

/// What a frame is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum FramePurpose {
    /// To be reprojected and shown.
    Live,
    /// The answer to the still request of this number.
    Still(u32),
}

/// The head of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameBegin {
    /// Its identity.
    pub id: FrameId,
    /// What it is for.
    pub purpose: FramePurpose,
    /// When the client sampled the pose that the server knew last: the client's own time, echoed.
    pub pose_time: Timestamp,
    /// How far ahead of that pose the render pose was predicted, in microseconds.
    pub horizon_micros: u32,
    /// The instant of the scene that it shows, by the client's clock: that of its display, as far as the server can
    /// tell, or what a still was asked for.
    pub scene_time: Timestamp,
    /// The render pose in its precise wire form.
    #[serde(with = "pose_bytes")]
    pub render_pose: Pose,
    /// What its strips look like.
    pub shape: FrameShape,
}

/// The end of a frame: what it took, by the server's own clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameEnd {
    /// Its identity.
    pub id: FrameId,
    /// When the pose it answers arrived.
    pub pose_received: Timestamp,
    /// When rendering started.
    pub render_start: Timestamp,
    /// When its last rows were rendered.
    pub render_end: Timestamp,
    /// When its last strip was encoded.
    pub encoded: Timestamp,
    /// When this message was handed to the link.
    pub sent: Timestamp,
    /// Samples per pixel it got.
    pub spp: u32,
}

/// A frame has arrived and is ready to be shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameAck {
    /// The frame.
    pub id: FrameId,
    /// From sampling the pose it echoes to its being ready, by the client's clock, in microseconds: what the
    /// server should predict ahead.
    pub pose_to_ready_micros: u32,
    /// From the arrival of its head to that of its end.
    pub receive_micros: u32,
    /// Of that and after it, time spent decoding.
    pub decode_micros: u32,
}

/// Running totals of a session, from the server.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Statistics {
    /// Live frames rendered.
    pub frames_rendered: u32,
    /// Live frames sent.
    pub frames_sent: u32,
    /// Live frames that a newer one replaced before they were sent.
    pub frames_replaced: u32,
    /// Poses that were refused or came too late to be of use.
    pub poses_ignored: u32,
    /// Time since the first live frame was begun, in microseconds.
    pub live_micros: u64,
    /// Why live frames were less than was asked for; what never was a reason is not in the list.
    pub limiters: Vec<Limiter>,
    /// Counters by name, such as rays.primary.
    pub counters: Vec<(String, u64)>,
}

/// What can keep live frames from being what was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum LimiterKind {
    /// What the link carries.
    Throughput,
    /// What the client decodes.
    DecodeTime,
    /// What the server encodes.
    EncodeTime,
    /// What the server renders.
    RenderTime,
    /// The bytes that the client wants to pay for.
    Target,
    /// The widest band around the display that the server allows.
    GuardLimit,
    /// The largest frame that the server allows.
    MemoryLimit,
}

impl LimiterKind {
    /// All there are.
    pub const ALL: [LimiterKind; 7] = [
        LimiterKind::Throughput,
        LimiterKind::DecodeTime,
        LimiterKind::EncodeTime,
        LimiterKind::RenderTime,
        LimiterKind::Target,
        LimiterKind::GuardLimit,
        LimiterKind::MemoryLimit,
    ];

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            LimiterKind::Throughput => "throughput",
            LimiterKind::DecodeTime => "decode time",
            LimiterKind::EncodeTime => "encode time",
            LimiterKind::RenderTime => "render time",
            LimiterKind::Target => "target",
            LimiterKind::GuardLimit => "guard limit",
            LimiterKind::MemoryLimit => "memory limit",
        }
    }
}

/// One reason for live frames being less than was asked for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limiter {
    /// Which.
    pub kind: LimiterKind,
    /// Whether it limits the latest live frame.
    pub is_active: bool,
    /// How long it was active, in microseconds of [`Statistics::live_micros`].
    pub active_micros: u64,
    /// What it was about when it was last active, in words.
    pub why: String,
}

/// Asks for a converged picture from any pose and through any camera; by default everything composited by the server.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StillRequest {
    /// The client's number for it.
    pub number: u32,
    /// world_from_view, in its precise wire form.
    #[serde(with = "pose_bytes")]
    pub pose: Pose,
    /// The instant of the scene, by the client's clock: things that move are where they are then.
    pub scene_time: Timestamp,
    /// Samples per pixel.
    pub spp: u32,
    /// What it is seen through: that of the display, or one of the sheared ones that make up a lens.
    pub camera: Camera,
    /// Whether it comes with all nodes of a live frame, instead of composited: which pixel shows what kind of surface.
    pub with_nodes: bool,
}

impl StillRequest {
    pub(super) fn check(&self) -> Result<(), DecodeError> {
        if !self.camera.is_valid() || self.camera.projection != Projection::Perspective {
            return Err(DecodeError::Malformed {
                field: "camera",
                expected: "a size of 1 to 8192 pixels and a frustum that is not empty",
            });
        }
        if self.spp == 0 {
            return Err(DecodeError::Malformed { field: "samples per pixel", expected: "at least 1" });
        }
        Ok(())
    }
}

/// Why a session ends early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum ErrorCode {
    /// The two ends speak different versions.
    Version = 1,
    /// Bytes that are no message.
    Protocol = 2,
    /// More than this end is willing to hold.
    Limit = 3,
    /// The peer said nothing for too long.
    Timeout = 4,
    /// A failure at this end.
    Internal = 5,
    /// The server wants another token than that of the hello.
    Unauthorised = 6,
    /// The server has as many sessions as it takes; later it may have fewer.
    Busy = 7,
    /// A code of another version.
    Unknown = 0xffff,
}

impl ErrorCode {
    /// Every code of this version.
    const KNOWN: [ErrorCode; 7] = [
        ErrorCode::Version,
        ErrorCode::Protocol,
        ErrorCode::Limit,
        ErrorCode::Timeout,
        ErrorCode::Internal,
        ErrorCode::Unauthorised,
        ErrorCode::Busy,
    ];

    pub(super) fn from_wire(code: u16) -> ErrorCode {
        ErrorCode::KNOWN.into_iter().find(|&known| known as u16 == code).unwrap_or(ErrorCode::Unknown)
    }
}

impl From<&DecodeError> for ErrorCode {
    fn from(error: &DecodeError) -> ErrorCode {
        match error {
            DecodeError::Unsupported { field: "protocol version", .. } => ErrorCode::Version,
            DecodeError::LimitExceeded { .. } => ErrorCode::Limit,
            _ => ErrorCode::Protocol,
        }
    }
}

/// A pose inside a bincode message, in its 25 bytes.
mod pose_bytes {
    use crate::Pose;
    use serde::de::Error as _;
    use serde::ser::Error as _;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(super) fn serialize<S: Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
        let bytes = pose.to_wire().ok_or_else(|| S::Error::custom("pose out of range"))?;
        bytes.serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Pose, D::Error> {
        let bytes = <[u8; Pose::WIRE_BYTES]>::deserialize(deserializer)?;
        Pose::from_wire(&bytes).ok_or_else(|| D::Error::custom("no pose"))
    }
}
