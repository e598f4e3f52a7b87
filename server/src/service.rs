//! A scene made ready to be served: what every session of it shares.

use crate::effects::{Effects, plan_of};
use crate::frame::FrameRenderer;
use crate::scene::Scene;
use crate::session::{SampleBudget, SessionConfig};
use crate::stream::STRIP_ROWS;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::sync::Arc;
use warplight_protocol::codec::Limits;

/// How a scene is served.
#[derive(Clone, Copy, Debug)]
pub struct ServiceOptions {
    /// Samples of a live frame.
    pub samples: SampleBudget,
    /// Longest path in segments.
    pub max_depth: u32,
    /// Seed of all randomness.
    pub seed: u64,
    /// Threads that render; 0 for one per core.
    pub threads: usize,
}

/// Longest path by default: beyond, a lit room gains less than its noise.
pub const DEFAULT_MAX_DEPTH: u32 = 8;
/// Most samples per pixel that a client may ask of a still.
const MAX_STILL_SPP: u32 = 65_536;

/// What every session of a server shares.
#[derive(Clone, Debug)]
pub struct Service {
    /// Renders the scene.
    pub renderer: Arc<FrameRenderer>,
    /// What a new session starts with.
    pub session: SessionConfig,
    /// How it is served.
    pub options: ServiceOptions,
    /// Renders on threads of its own, so that an embedded server leaves the display its core.
    pub pool: Arc<ThreadPool>,
}

impl Service {
    /// Makes a scene ready.
    pub fn new(scene: Scene, options: ServiceOptions) -> Result<Service, ThreadPoolBuildError> {
        let scene = Arc::new(scene);
        let renderer = Arc::new(FrameRenderer::new(scene.clone()));
        let name = |index| format!("render-{index}");
        let pool = ThreadPoolBuilder::new().num_threads(options.threads).thread_name(name).build()?;
        let session = SessionConfig {
            scene: scene.name.clone(),
            effects: Effects::of(&scene).names(),
            head: scene.head,
            exposure: scene.exposure,
            plan: plan_of(&scene),
            interfaces: renderer.interfaces().clone(),
            samples: options.samples,
            max_still_spp: MAX_STILL_SPP,
            strip_rows: STRIP_ROWS,
            limits: Limits::default(),
        };
        Ok(Service { renderer, session, options, pool: Arc::new(pool) })
    }
}
