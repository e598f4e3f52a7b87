//! A head that walks through a scene, and what is rendered for it: live frames as a session renders them, and converged
//! pictures.

use super::walk::{FIRST_FRAMES, FOV_RAD, SPP};
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

/// A scene, and a head that walks through it.
#[derive(Debug)]
pub struct Walker {
    /// Makes its frames.
    pub renderer: FrameRenderer,
    /// The nodes that the scene calls for.
    pub plan: Plan,
    /// Factor on radiance before it is displayed.
    pub exposure: f32,
    trace: Trace,
}

impl Walker {
    /// Through a scene by name or file, along a trace that is placed at its head.
    ///
    /// # Errors
    /// A scene that cannot be loaded.
    pub fn new(scene: &str, trace: &Trace) -> Result<Walker, SceneError> {
        let scene = Scene::load(scene)?;
        let (plan, exposure, trace) = (plan_of(&scene), scene.exposure, trace.placed_at(&scene.head));
        Ok(Walker { renderer: FrameRenderer::new(Arc::new(scene)), plan, exposure, trace })
    }

    /// Where the head is so many seconds after the trace's beginning.
    pub fn pose_at(&self, secs: f64) -> Pose {
        self.trace.pose_at(secs)
    }

    /// The camera of frames and displays of a size.
    pub fn camera(size: ImageSize) -> Camera {
        Camera::symmetric(FOV_RAD, size)
    }

    /// What frames of a camera and a plan share, in the default format.
    pub fn shape(&self, camera: Camera, plan: Plan) -> FrameShape {
        FrameShape {
            camera,
            plan,
            interfaces: self.renderer.interfaces().clone(),
            format: FrameFormat::default(),
            volume: VolumeRange::default(),
            strip_rows: STRIP_ROWS,
            exposure: self.exposure,
        }
    }

    /// Live frames of a camera and a plan, before the first.
    pub fn live(&self, camera: Camera, plan: &Plan) -> LiveWalk<'_> {
        LiveWalk {
            walker: self,
            camera,
            plan: plan.clone(),
            live: LiveFrames::new(CacheSettings::default()),
            samples: SPP * camera.size.pixels() as f64,
            rendered: 0,
        }
    }

    /// What is really seen from a pose, path-traced with so many samples per pixel: linear radiance, row by row.
    pub fn seen_from(&self, pose: &Pose, camera: Camera, spp: u32, seed: u64) -> Vec<Vec3> {
        let mut tree = Tree::new(*pose, camera, Plan::diffuse(), Interfaces::default());
        let request = request(*pose, camera, &Plan::diffuse(), spp, seed);
        self.renderer.render(&request, &mut tree, &Counters::default(), &|_| ());
        (0..camera.size.pixels()).map(|pixel| tree.nodes[0].radiance_at(pixel)).collect()
    }

    /// Where a pose sees a surface whose light may have nodes of its own, row by row.
    pub fn specular_from(&self, pose: &Pose, camera: Camera) -> Vec<bool> {
        let mut tree = Tree::new(*pose, camera, self.plan.clone(), Interfaces::default());
        self.renderer.render(&request(*pose, camera, &self.plan, 1, 0), &mut tree, &Counters::default(), &|_| ());
        let root = &tree.nodes[0];
        // A root without children has no such plane.
        (0..camera.size.pixels())
            .map(|pixel| root.interface.get(pixel).is_some_and(|&interface| interface > 0))
            .collect()
    }
}

fn request(render_pose: Pose, camera: Camera, plan: &Plan, spp: u32, seed: u64) -> FrameRequest {
    FrameRequest { render_pose, camera, plan: plan.clone(), volume: None, spp, max_depth: DEFAULT_MAX_DEPTH, seed }
}

/// Live frames of one viewer, one after the other.
#[derive(Debug)]
pub struct LiveWalk<'a> {
    walker: &'a Walker,
    camera: Camera,
    plan: Plan,
    live: LiveFrames,
    /// Paths of a frame.
    samples: f64,
    rendered: u64,
}

impl LiveWalk<'_> {
    /// With light that is kept another way, and so many paths per pixel.
    #[must_use]
    pub fn with(self, live: LiveFrames, samples_per_px: f64) -> Self {
        let samples = samples_per_px * self.camera.size.pixels() as f64;
        LiveWalk { live, samples, ..self }
    }

    /// A frame without anything in it.
    pub fn empty(&self) -> Tree {
        Tree::new(Pose::IDENTITY, self.camera, self.plan.clone(), Interfaces::default())
    }

    /// Fills in the light that a session of some seconds has, from one pose.
    pub fn fill_light(&mut self, pose: &Pose) {
        let mut tree = self.empty();
        (0..FIRST_FRAMES).for_each(|_| self.render(pose, &mut tree));
    }

    /// Renders the next frame, whose noise is its own.
    pub fn render(&mut self, pose: &Pose, tree: &mut Tree) {
        self.rendered += 1;
        let request = request(*pose, self.camera, &self.plan, 1, self.rendered);
        let LiveWalk { walker, live, samples, .. } = self;
        walker.renderer.render_live(&request, *samples, live, tree, &Counters::default(), &|_| ());
    }

    /// Renders the next frame by paths of its own instead, so many per pixel and node.
    pub fn render_by_paths(&mut self, pose: &Pose, spp: u32, tree: &mut Tree) {
        self.rendered += 1;
        let request = request(*pose, self.camera, &self.plan, spp, self.rendered);
        self.walker.renderer.render(&request, tree, &Counters::default(), &|_| ());
    }
}
