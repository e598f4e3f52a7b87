//! Live frames of a scene along a head trace, as a session renders them: what codecs are measured on.
//!
//! The head walks through the scene, a frame is rendered for every beat, and each is shown for the pose that the head has
//! got to by then. Frames are those of [`warplight_server::frame::LiveFrames`], whose light was filled in by earlier frames
//! at the first pose: a session shows few frames that are younger.

use super::Walker;
use crate::trace::Trace;
use glam::Vec3;
use warplight_protocol::codec::FrameShape;
use warplight_protocol::frame::Tree;
use warplight_protocol::{ImageSize, Pose};
use warplight_server::scene::SceneError;

/// Vertical field of view of frames and display, in radians.
pub(super) const FOV_RAD: f32 = 1.4;
/// Frames that fill in the light before the first that counts.
pub(super) const FIRST_FRAMES: u32 = 20;
/// Samples per pixel of each frame: what two cores have time for.
pub(super) const SPP: f64 = 0.25;

/// When frames are rendered, and how old they are when they are shown.
#[derive(Clone, Copy, Debug)]
pub struct Beat {
    /// Frames.
    pub frames: u32,
    /// Frames per second.
    pub frame_hz: f64,
    /// From the pose of a frame to the pose it is shown for, in seconds.
    pub age_secs: f64,
    /// Where in the trace it begins, in seconds.
    pub start_secs: f64,
}

/// Frames along a trace, and where they are shown from.
#[derive(Debug)]
pub struct Walk {
    /// What all frames share, in the default format.
    pub shape: FrameShape,
    /// The frames, unquantised, in their order.
    pub frames: Vec<Tree>,
    /// Where the head is when each is shown.
    pub display_poses: Vec<Pose>,
    walker: Walker,
}

impl Walk {
    /// Renders the frames of a scene, by name or file.
    ///
    /// # Errors
    /// A scene that cannot be loaded.
    pub fn new(scene: &str, trace: &Trace, size: ImageSize, beat: Beat) -> Result<Walk, SceneError> {
        let walker = Walker::new(scene, trace)?;
        let camera = Walker::camera(size);
        let secs_of = |frame: u32| beat.start_secs + f64::from(frame) / beat.frame_hz;
        let mut live = walker.live(camera, &walker.plan);
        live.fill_light(&walker.pose_at(secs_of(0)));
        let (mut frames, mut display_poses) = (Vec::new(), Vec::new());
        for frame in 0..beat.frames {
            let mut tree = live.empty();
            live.render(&walker.pose_at(secs_of(frame)), &mut tree);
            frames.push(tree);
            display_poses.push(walker.pose_at(secs_of(frame) + beat.age_secs));
        }
        let shape = walker.shape(camera, walker.plan.clone());
        Ok(Walk { shape, frames, display_poses, walker })
    }

    /// What is really seen from a pose, path-traced with so many samples per pixel: linear radiance, row by row.
    pub fn seen_from(&self, pose: &Pose, spp: u32) -> Vec<Vec3> {
        self.walker.seen_from(pose, self.shape.camera, spp, 0)
    }
}
