//! Messages on the path of every frame and pose, packed by hand.

use crate::codec::DecodeError;
use crate::frame::FrameId;
use crate::video::PictureHead;
use crate::{Pose, Timestamp};

/// Where the head was at an instant of the client's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSample {
    /// The instant, by the client's clock.
    pub time: Timestamp,
    /// world_from_view.
    pub pose: Pose,
}

/// Rows of a frame, as the codec packed them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StripMessage {
    /// The frame.
    pub frame: FrameId,
    /// What [`crate::codec::StripDecoder`] reads.
    pub bytes: Vec<u8>,
}

/// A picture of a plane of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureMessage {
    /// Whose it is, and where in it the frame lies.
    pub head: PictureHead,
    /// What [`crate::video::PictureDecoder`] reads.
    pub bytes: Vec<u8>,
}

/// Time and pose.
const SAMPLE_BYTES: usize = 8 + Pose::WIRE_BYTES;

/// Most samples in one message.
pub const MAX_POSE_SAMPLES: usize = 256;

/// Appends samples; those whose pose is not valid are left out, and of too many the oldest.
pub(super) fn write_poses(samples: &[PoseSample], out: &mut Vec<u8>) {
    for sample in &samples[samples.len().saturating_sub(MAX_POSE_SAMPLES)..] {
        if let Some(pose) = sample.pose.to_wire() {
            out.extend_from_slice(&sample.time.micros.to_le_bytes());
            out.extend_from_slice(&pose);
        }
    }
}

pub(super) fn read_poses(payload: &[u8]) -> Result<Vec<PoseSample>, DecodeError> {
    let count = payload.len() / SAMPLE_BYTES;
    if !payload.len().is_multiple_of(SAMPLE_BYTES) {
        return Err(DecodeError::Truncated { field: "pose" });
    }
    if count > MAX_POSE_SAMPLES {
        return Err(DecodeError::LimitExceeded { limit: MAX_POSE_SAMPLES, requested: count });
    }
    payload.chunks_exact(SAMPLE_BYTES).map(read_sample).collect()
}

fn read_sample(bytes: &[u8]) -> Result<PoseSample, DecodeError> {
    let malformed = DecodeError::Malformed { field: "pose", expected: "a unit quaternion within 32 km" };
    let (time, pose) = bytes.split_first_chunk::<8>().ok_or(DecodeError::Truncated { field: "pose" })?;
    let pose = pose.try_into().ok().and_then(Pose::from_wire).ok_or(malformed)?;
    Ok(PoseSample { time: Timestamp { micros: u64::from_le_bytes(*time) }, pose })
}

pub(super) fn write_strip(strip: &StripMessage, out: &mut Vec<u8>) {
    out.extend_from_slice(&strip.frame.0.to_le_bytes());
    out.extend_from_slice(&strip.bytes);
}

pub(super) fn read_strip(payload: &[u8]) -> Result<StripMessage, DecodeError> {
    let (frame, bytes) = payload.split_first_chunk::<4>().ok_or(DecodeError::Truncated { field: "strip" })?;
    Ok(StripMessage { frame: FrameId(u32::from_le_bytes(*frame)), bytes: bytes.to_vec() })
}

pub(super) fn write_picture(picture: &PictureMessage, out: &mut Vec<u8>) {
    out.extend_from_slice(&picture.head.to_bytes());
    out.extend_from_slice(&picture.bytes);
}

pub(super) fn read_picture(payload: &[u8]) -> Result<PictureMessage, DecodeError> {
    let (head, bytes) = payload.split_first_chunk().ok_or(DecodeError::Truncated { field: "head of picture" })?;
    Ok(PictureMessage { head: PictureHead::from_bytes(head)?, bytes: bytes.to_vec() })
}
