//! Live frames of a scene along a head trace, as a session renders them: what codecs are measured on.
//!
//! The head walks through the scene, a frame is rendered for every beat, and each is shown for the pose that the head has
//! got to by then. Frames are those of [`LiveFrames`], whose light was filled in by earlier frames at the first pose: a
//! session shows few frames that are younger.

use crate::trace::Trace;
use glam::Vec3;
use std::sync::Arc;
use warplight_protocol::codec::FrameShape;
use warplight_protocol::frame::{FrameFormat, Interfaces, Plan, Tree, VolumeRange};
use warplight_protocol::{Camera, ImageSize, Pose};
use warplight_server::cache::CacheSettings;
use warplight_server::counters::Counters;
use warplight_server::effects::plan_of;
use warplight_server::frame::{FrameRenderer, FrameRequest, LiveFrames};
use warplight_server::scene::{Scene, SceneError};
use warplight_server::service::DEFAULT_MAX_DEPTH;
use warplight_server::stream::STRIP_ROWS;

/// Vertical field of view of frames and display, in radians.
const FOV_RAD: f32 = 1.4;
/// Frames that fill in the light before the first that counts.
const FIRST_FRAMES: u32 = 20;
/// Samples per pixel of each frame: what two cores have time for.
const SPP: f64 = 0.25;

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
    renderer: FrameRenderer,
}

impl Walk {
    /// Renders the frames of a scene, by name or file.
    ///
    /// # Errors
    /// A scene that cannot be loaded.
    pub fn new(scene: &str, trace: &Trace, size: ImageSize, beat: Beat) -> Result<Walk, SceneError> {
        let scene = Scene::load(scene)?;
        let trace = trace.placed_at(&scene.head);
        let plan = plan_of(&scene);
        let camera = Camera::symmetric(FOV_RAD, size);
        let exposure = scene.exposure;
        let renderer = FrameRenderer::new(Arc::new(scene));
        let interfaces = renderer.interfaces().clone();
        let mut live = LiveFrames::new(CacheSettings::default());
        let counters = Counters::default();
        let samples = SPP * size.pixels() as f64;
        let mut render = |pose: Pose, number: u32, tree: &mut Tree| {
            let request = FrameRequest {
                render_pose: pose,
                camera,
                plan: plan.clone(),
                volume: None,
                spp: 1,
                max_depth: DEFAULT_MAX_DEPTH,
                seed: u64::from(number) + 1,
            };
            renderer.render_live(&request, samples, &mut live, tree, &counters, &|_| ());
        };
        let empty = || Tree::new(Pose::IDENTITY, camera, plan.clone(), Interfaces::default());
        let pose_at = |frame: u32| trace.pose_at(beat.start_secs + f64::from(frame) / beat.frame_hz);
        let mut first = empty();
        (0..FIRST_FRAMES).for_each(|number| render(pose_at(0), number, &mut first));
        let (mut frames, mut display_poses) = (Vec::new(), Vec::new());
        for frame in 0..beat.frames {
            let mut tree = empty();
            render(pose_at(frame), FIRST_FRAMES + frame, &mut tree);
            frames.push(tree);
            let secs = beat.start_secs + f64::from(frame) / beat.frame_hz + beat.age_secs;
            display_poses.push(trace.pose_at(secs));
        }
        let shape = FrameShape {
            camera,
            plan: plan.clone(),
            interfaces,
            format: FrameFormat::default(),
            volume: VolumeRange::default(),
            strip_rows: STRIP_ROWS,
            exposure,
        };
        Ok(Walk { shape, frames, display_poses, renderer })
    }

    /// What is really seen from a pose, path-traced with so many samples per pixel: linear radiance, row by row.
    pub fn seen_from(&self, pose: &Pose, spp: u32) -> Vec<Vec3> {
        let camera = self.shape.camera;
        let request = FrameRequest {
            render_pose: *pose,
            camera,
            plan: Plan::diffuse(),
            volume: None,
            spp,
            max_depth: DEFAULT_MAX_DEPTH,
            seed: 0,
        };
        let mut tree = Tree::new(*pose, camera, Plan::diffuse(), Interfaces::default());
        self.renderer.render(&request, &mut tree, &Counters::default(), &|_| ());
        (0..camera.size.pixels()).map(|pixel| tree.nodes[0].radiance_at(pixel)).collect()
    }
}
