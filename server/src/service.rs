//! A scene made ready to be served: what every session of it shares.

use crate::costs::KnownCosts;
use crate::effects::{Effects, plan_of};
use crate::frame::FrameRenderer;
use crate::march::MediaBounds;
use crate::metrics::Metrics;
use crate::scene::Scene;
use crate::session::{SampleBudget, SessionConfig};
use crate::stream::STRIP_ROWS;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::sync::{Arc, Mutex, PoisonError};
use thread_priority::{ThreadPriority, set_current_thread_priority};
use warplight_protocol::Token;
use warplight_protocol::budget::Chooser;
use warplight_protocol::codec::Limits;
use warplight_protocol::frame::Plan;

/// How live frames find the light on diffuse surfaces. Stills are always path-traced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Estimator {
    /// From a cache in world space that path samples keep filling: smooth, a little blurred.
    #[default]
    Cached,
    /// Each frame by paths of its own: unbiased and noisy.
    Path,
}

/// How a scene is served.
#[derive(Clone, Debug)]
pub struct ServiceOptions {
    /// Samples of a live frame.
    pub samples: SampleBudget,
    /// How their light is found.
    pub estimator: Estimator,
    /// Longest path in segments.
    pub max_depth: u32,
    /// Seed of all randomness.
    pub seed: u64,
    /// Threads that render live frames; 0 for one per core. An embedded server leaves the display a core.
    pub threads: usize,
    /// Threads that render stills, when nothing is displayed; 0 for one per core.
    pub still_threads: usize,
    /// Nodes of a live frame, if not those that the scene calls for.
    pub plan: Option<Plan>,
    /// How much more than the display a live frame shows at most on each side, in degrees; 0 for nothing.
    pub guard_deg: f64,
}

impl Default for ServiceOptions {
    fn default() -> ServiceOptions {
        let samples = SampleBudget::Time(std::time::Duration::from_millis(80));
        let estimator = Estimator::default();
        ServiceOptions {
            samples,
            estimator,
            max_depth: DEFAULT_MAX_DEPTH,
            seed: 1,
            threads: 0,
            still_threads: 0,
            plan: None,
            guard_deg: DEFAULT_GUARD_DEG,
        }
    }
}

/// Widest guard band by default, in degrees: a head that turns by 40 degrees a second, shown frames of up to 300 ms.
pub const DEFAULT_GUARD_DEG: f64 = 12.0;
/// Widest guard band that can be asked for.
pub const MAX_GUARD_DEG: f64 = 60.0;
/// Longest path by default: beyond, a lit room gains less than its noise.
pub const DEFAULT_MAX_DEPTH: u32 = 8;
/// A guard band in degrees, of a command line.
pub fn guard_deg(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if (0.0..=MAX_GUARD_DEG).contains(&value) => Ok(value),
        _ => Err(format!("expected an angle from 0 to {MAX_GUARD_DEG} degrees")),
    }
}

/// Samples of the light in each voxel of a medium before the first frame.
const FIRST_LIGHT_SPP: u32 = 4;

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
    /// Where live frames are rendered.
    pub live_pool: Arc<ThreadPool>,
    /// Where stills are rendered.
    pub still_pool: Arc<ThreadPool>,
    /// What its sessions note.
    pub metrics: Arc<Metrics>,
    /// The cost model that they choose from, and teach.
    pub costs: Option<Arc<Mutex<KnownCosts>>>,
}

impl Service {
    /// Makes a scene ready.
    pub fn new(scene: Scene, options: ServiceOptions) -> Result<Service, ThreadPoolBuildError> {
        let scene = Arc::new(scene);
        let renderer = Arc::new(FrameRenderer::new(scene.clone()));
        let pool = |threads| render_pool("render", threads);
        let live_pool = Arc::new(pool(options.threads)?);
        let is_same = options.threads == options.still_threads;
        let still_pool = if is_same { live_pool.clone() } else { Arc::new(pool(options.still_threads)?) };
        let session = SessionConfig {
            scene: scene.name.clone(),
            effects: Effects::of(&scene).names(),
            head: scene.head,
            exposure: scene.exposure,
            plan: options.plan.clone().unwrap_or_else(|| plan_of(&scene)),
            interfaces: renderer.interfaces().clone(),
            media: MediaBounds::of(&scene),
            samples: options.samples,
            costs: None,
            max_still_spp: MAX_STILL_SPP,
            strip_rows: STRIP_ROWS,
            guard_rad: options.guard_deg.to_radians(),
            limits: Limits::default(),
            token: Token::NONE,
        };
        // Enough to begin with; frames add to it.
        live_pool.install(|| renderer.refine_all_light(FIRST_LIGHT_SPP, options.max_depth, options.seed));
        Ok(Service { renderer, session, options, live_pool, still_pool, metrics: Arc::default(), costs: None })
    }

    /// Has the time budget choose among the points of a frame, too, and keeps what it learns.
    pub fn choose_points(&mut self, known: Arc<Mutex<KnownCosts>>) {
        let table = known.lock().unwrap_or_else(PoisonError::into_inner).model.frame.clone();
        self.session.costs = Some(Arc::new(table));
        self.costs = Some(known);
    }

    /// Writes what a session has learnt of the costs of its points, where there is a file for it.
    pub fn refresh_costs(&self, learnt: &Chooser) {
        let Some(known) = &self.costs else { return };
        if let Err(error) = known.lock().unwrap_or_else(PoisonError::into_inner).refresh(None, Some(learnt)) {
            tracing::warn!("cost model: {error}");
        }
    }
}

/// A thirtieth of the weight of an ordinary thread (nice 15 on Linux): whoever displays is not late for its sake, and
/// frames still come on a busy machine.
const RENDER_PRIORITY: u8 = 10;

/// Threads that give way, one per core where `threads` is 0.
pub(crate) fn render_pool(purpose: &'static str, threads: usize) -> Result<ThreadPool, ThreadPoolBuildError> {
    // Whoever sends, decodes or displays on the same machine goes first: rendering takes what is left.
    let give_way = |_| {
        let priority = RENDER_PRIORITY.try_into().map_or(ThreadPriority::Min, ThreadPriority::Crossplatform);
        if let Err(error) = set_current_thread_priority(priority) {
            tracing::debug!("rendering threads keep their priority: {error:?}");
        }
    };
    let name = move |index| format!("{purpose}-{index}");
    ThreadPoolBuilder::new().num_threads(threads).thread_name(name).start_handler(give_way).build()
}
