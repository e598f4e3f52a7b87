//! From a render job to strips on their way: frame -> encode, a band at a time on whichever core rendered it.

use crate::counters::Counters;
use crate::frame::{BAND_ROWS, FrameRequest};
use crate::service::Service;
use crate::session::RenderJob;
use std::sync::{Mutex, PoisonError};
use warplight_protocol::codec::StripEncoder;
use warplight_protocol::frame::{Interfaces, Plan, Tree, TreeRows};
use warplight_protocol::{Camera, ImageSize, Pose};

/// Rows of a strip, which is a band of the renderer.
pub const STRIP_ROWS: u16 = BAND_ROWS as u16;

/// Renders and encodes the frames of one session; its buffers live from frame to frame.
#[derive(Debug)]
pub struct FrameStream {
    service: Service,
    tree: Tree,
    encoders: Mutex<Vec<StripEncoder>>,
    counters: Counters,
}

impl FrameStream {
    /// A stream of the scene that `service` serves.
    pub fn new(service: Service) -> FrameStream {
        let camera = Camera::symmetric(1.0, ImageSize::new(1, 1));
        let tree = Tree::new(Pose::IDENTITY, camera, Plan::diffuse(), Interfaces::default());
        FrameStream { service, tree, encoders: Mutex::default(), counters: Counters::default() }
    }

    /// Renders and encodes a frame on all cores. `on_rendered` is called when a band is rendered, `on_strip`
    /// when it is encoded; both by any worker and in no order.
    pub fn run(&mut self, job: &RenderJob, on_rendered: &(dyn Fn() + Sync), on_strip: &(dyn Fn(Vec<u8>) + Sync)) {
        let shape = &job.begin.shape;
        let request = FrameRequest {
            render_pose: job.begin.render_pose,
            camera: shape.camera,
            plan: shape.plan.clone(),
            spp: job.spp,
            max_depth: self.service.options.max_depth,
            // Each frame has noise of its own, or it would stick to the screen.
            seed: self.service.options.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(u64::from(job.begin.id.0)),
        };
        let FrameStream { service, tree, encoders, counters } = self;
        let on_band = |band: &TreeRows<'_>| {
            on_rendered();
            let idle = encoders.lock().unwrap_or_else(PoisonError::into_inner).pop();
            let mut encoder = idle.unwrap_or_else(|| StripEncoder::new(StripEncoder::DEFAULT_LEVEL));
            let mut strip = Vec::new();
            encoder.encode(shape, band, &mut strip);
            encoders.lock().unwrap_or_else(PoisonError::into_inner).push(encoder);
            on_strip(strip);
        };
        service.pool.install(|| service.renderer.render(&request, tree, counters, &on_band));
    }

    /// The planes of the last frame, as they were before quantisation.
    pub fn tree(&self) -> &Tree {
        &self.tree
    }

    /// Totals of the session, by name.
    pub fn counters(&self) -> Vec<(String, u64)> {
        self.counters.snapshot().named().into_iter().map(|(name, count)| (name.to_owned(), count)).collect()
    }
}
