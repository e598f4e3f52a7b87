//! From a render job to strips on their way: frame -> encode, a band at a time on whichever core rendered it.

use crate::cache::CacheSettings;
use crate::counters::Counters;
use crate::frame::{BAND_ROWS, FrameRenderer, FrameRequest, LayersRequest, LiveFrames};
use crate::pictures::{PictureSource, RenderedPictures};
use crate::service::{Estimator, Service};
use crate::session::RenderJob;
use std::sync::{Mutex, PoisonError};
use warplight_protocol::codec::StripEncoder;
use warplight_protocol::frame::{Interfaces, Plan, Tree, TreeRows};
use warplight_protocol::message::FramePurpose;
use warplight_protocol::{Camera, ImageSize, Pose};

/// Rows of a strip, which is a band of the renderer.
pub const STRIP_ROWS: u16 = BAND_ROWS as u16;

/// Samples that every live frame adds to the light in media: about 20 ms on two cores.
const LIGHT_SAMPLES: usize = 8192;

/// Renders and encodes the frames of one session; its buffers live from frame to frame.
#[derive(Debug)]
pub struct FrameStream {
    service: Service,
    /// The stream's own, where the scene moves.
    moving: Option<Box<FrameRenderer>>,
    tree: Tree,
    /// From the first live frame that asks for it.
    live: Option<LiveFrames>,
    encoders: Mutex<Vec<StripEncoder>>,
    pictures: PictureSource,
    counters: Counters,
}

impl FrameStream {
    /// A stream of the scene that `service` serves.
    pub fn new(service: Service) -> FrameStream {
        let camera = Camera::symmetric(1.0, ImageSize::new(1, 1));
        let tree = Tree::new(Pose::IDENTITY, camera, Plan::diffuse(), Interfaces::default());
        let renderer = &service.renderer;
        let moving = renderer.moves().then(|| Box::new(renderer.copy()));
        FrameStream {
            service,
            moving,
            tree,
            live: None,
            encoders: Mutex::default(),
            pictures: PictureSource::default(),
            counters: Counters::default(),
        }
    }

    /// Renders and encodes a frame on all cores. `on_rendered` is called when a band is rendered, `on_strip`
    /// when it is encoded; both by any worker and in no order. Returns the frame's pictures where its format has some.
    pub fn run(
        &mut self,
        job: &RenderJob,
        on_rendered: &(dyn Fn() + Sync),
        on_strip: &(dyn Fn(Vec<u8>) + Sync),
    ) -> Option<RenderedPictures> {
        let shape = &job.begin.shape;
        let format = shape.format.volume;
        let request = FrameRequest {
            render_pose: job.begin.render_pose,
            camera: shape.camera,
            plan: shape.plan.clone(),
            volume: (format.layers > 0).then_some(LayersRequest { format, range: shape.volume, exactly: false }),
            spp: job.spp,
            max_depth: self.service.options.max_depth,
            // Each frame has noise of its own, or it would stick to the screen.
            seed: self.service.options.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(u64::from(job.begin.id.0)),
        };
        let FrameStream { service, moving, tree, live, encoders, pictures, counters } = self;
        // Shared by the workers: no longer this method's alone.
        let encoders = &*encoders;
        let on_band = |band: &TreeRows<'_>| {
            on_rendered();
            let idle = encoders.lock().unwrap_or_else(PoisonError::into_inner).pop();
            let mut encoder = idle.unwrap_or_else(|| StripEncoder::new(StripEncoder::DEFAULT_LEVEL));
            let mut strip = Vec::new();
            encoder.encode(shape, band, &mut strip);
            encoders.lock().unwrap_or_else(PoisonError::into_inner).push(encoder);
            on_strip(strip);
        };
        let is_live = job.begin.purpose == FramePurpose::Live;
        let pool = if is_live { &service.live_pool } else { &service.still_pool };
        let samples = f64::from(job.samples_per_1024_px) / 1024.0 * shape.camera.size.pixels() as f64;
        if let Some(renderer) = moving {
            renderer.move_to(job.begin.scene_time);
        }
        let renderer = moving.as_deref().unwrap_or(&service.renderer);
        pool.install(|| {
            if is_live && format.layers > 0 {
                renderer.refine_light(LIGHT_SAMPLES, request.max_depth, request.seed);
            }
        });
        pool.install(|| match service.options.estimator {
            Estimator::Cached if is_live => {
                let live = live.get_or_insert_with(|| LiveFrames::new(CacheSettings::default()));
                renderer.render_live(&request, samples, live, tree, counters, &on_band);
            }
            _ => renderer.render(&request, tree, counters, &on_band),
        });
        // What is left of the frame needs whole planes: a picture is predicted from all of the one before.
        pool.install(|| pictures.render(shape, tree))
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
