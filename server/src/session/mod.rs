//! The server's side of a session: a state machine without clock and socket.
//!
//! Bytes and instants go in; render jobs and bytes come out. Whoever drives it, over TCP and real time or
//! over a modelled link and virtual time, asks three questions: is there something to render
//! ([`ServerSession::poll_render`]), something to send ([`ServerSession::poll_transmit`]), and when to ask
//! again ([`ServerSession::next_timeout`]).
//!
//! Freshness: a frame is rendered only for a pose that is new; at most [`MAX_UNACKNOWLEDGED`] live frames are
//! under way; a frame that has not begun to be sent is replaced by the next, never queued behind it.

mod adapt;
mod allowance;
mod config;
mod cost;
mod delivery;
mod end;
mod frame_budget;
mod guard;
mod limiters;
mod outbox;
mod rate;

use crate::metrics::{Metrics, SessionMetrics};
use crate::pictures::{EncodeJob, RenderedPictures};
use crate::predict::Predictor;
use adapt::Adaptation;
use allowance::Allowance;
use cost::{BudgetFit, FrameCost};
use frame_budget::FrameBudget;
use guard::Guard;
use limiters::Limiters;
use outbox::Outbox;
use rate::RateControl;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use warplight_protocol::budget::Chooser;
use warplight_protocol::codec::{DecodeError, Limits};
use warplight_protocol::frame::{ColorCoding, FrameFormat, FrameId};
use warplight_protocol::message::{
    Capabilities, FrameBegin, FrameEnd, FramePurpose, Hello, Message, PictureMessage, Statistics, StillRequest,
    Viewport, Welcome,
};
use warplight_protocol::wire::Deframer;
use warplight_protocol::{Camera, ImageSize, Pose, Timestamp, Token};

pub use allowance::{MAX_MESSAGES_PER_SEC, MAX_POSES_PER_SEC};
pub use config::{RenderJob, SampleBudget, SessionConfig};
pub use end::SessionEnd;
pub use frame_budget::FramePoint;
pub use outbox::MAX_UNACKNOWLEDGED;

/// A ping after this long without one.
pub const KEEP_ALIVE: Duration = Duration::from_millis(500);
/// A peer that says nothing for this long is gone.
pub const DEAD_PEER: Duration = Duration::from_secs(2);
/// A client that has not said hello by then never will.
pub const HANDSHAKE: Duration = Duration::from_secs(5);
/// A client that answers no ping for so long does not read, though small messages still find room on the way. Long enough
/// for what a socket holds at 0.5 Mbit/s.
pub const UNREAD: Duration = Duration::from_secs(10);
/// Answers to pings that may wait: a client that asks more often does not read.
const MAX_ANSWERS: usize = 64;
/// Poses are never predicted further ahead.
pub const MAX_HORIZON: Duration = Duration::from_millis(100);
/// Scenes that move are never shown further ahead of the last pose.
const MAX_SCENE_HORIZON: Duration = Duration::from_secs(1);
/// Stills that may wait.
const MAX_STILLS: usize = 64;
/// Share of a new measurement in the running latency.
const LATENCY_GAIN: f64 = 0.2;

/// Pixels that [`RenderJob::samples_per_1024_px`] counts for.
const PIXELS_PER_UNIT: f64 = 1024.0;
/// Fewest samples per 1024 pixels, so that light is still followed where time is short.
const LEAST_SAMPLES: f64 = PIXELS_PER_UNIT / 64.0;

/// The state of one session.
#[derive(Debug)]
pub struct ServerSession {
    config: SessionConfig,
    deframer: Deframer,
    hello: Option<Hello>,
    end: Option<SessionEnd>,
    outbox: Outbox,
    predictor: Predictor,
    pose_received: Timestamp,
    rendered_pose: Option<Timestamp>,
    rendering: Option<Rendering>,
    stills: VecDeque<StillRequest>,
    next_frame: FrameId,
    next_frame_due: Timestamp,
    next_ping: Timestamp,
    last_heard: Timestamp,
    hello_due: Timestamp,
    /// The first ping since the last answer.
    unanswered: Option<Timestamp>,
    allowance: Allowance,
    latency_secs: f64,
    guard: Guard,
    rate: RateControl,
    adaptation: Adaptation,
    limiters: Limiters,
    work: Work,
    sent: SentBytes,
    /// What a live frame shows where that is everything.
    cube: Camera,
    /// When the last live frame was begun.
    last_begun: Option<Timestamp>,
    cost: FrameCost,
    fit: BudgetFit,
    budget: Option<FrameBudget>,
    statistics: Statistics,
    metrics: Option<SessionMetrics>,
}

/// Of the frame that is being sent.
#[derive(Clone, Copy, Debug, Default)]
struct SentBytes {
    is_live: bool,
    strips: u64,
    pictures: u64,
}

/// What the last live frame took the server, and what stood in its way.
#[derive(Clone, Copy, Debug, Default)]
struct Work {
    render: Duration,
    encode: Duration,
    /// When pictures began to be encoded.
    encoding_since: Option<Timestamp>,
    /// From one live frame to the next.
    beat: Duration,
    /// It had the fewest samples.
    has_least_samples: bool,
    /// A wider frame would have exceeded the limits.
    is_cut: bool,
}

#[derive(Clone, Copy, Debug)]
struct Rendering {
    id: FrameId,
    is_live: bool,
    samples_per_1024_px: u32,
    pixels: usize,
    end: FrameEnd,
}

impl ServerSession {
    /// A session whose link has just come up.
    pub fn new(config: SessionConfig, now: Timestamp) -> ServerSession {
        ServerSession {
            // No client has strips to send: of what it says nothing is long.
            deframer: Deframer::new(Limits { strip_bytes: config.limits.control_bytes, ..config.limits }),
            guard: Guard::new(config.guard_rad),
            rate: RateControl::new(0, FrameFormat::default()),
            adaptation: Adaptation::new(false, now),
            limiters: Limiters::default(),
            work: Work::default(),
            sent: SentBytes::default(),
            cube: Camera::symmetric(1.0, ImageSize::new(1, 1)),
            last_begun: None,
            config,
            hello: None,
            end: None,
            outbox: Outbox::default(),
            predictor: Predictor::default(),
            pose_received: now,
            rendered_pose: None,
            rendering: None,
            stills: VecDeque::new(),
            next_frame: FrameId(1),
            next_frame_due: now,
            next_ping: now + KEEP_ALIVE,
            last_heard: now,
            hello_due: now + HANDSHAKE,
            unanswered: None,
            allowance: Allowance::new(now),
            latency_secs: 0.0,
            cost: FrameCost::default(),
            fit: BudgetFit::default(),
            budget: None,
            statistics: Statistics::default(),
            metrics: None,
        }
    }

    /// Notes what happens from now on, also in `metrics`.
    pub fn set_metrics(&mut self, metrics: Arc<Metrics>) {
        self.metrics = Some(SessionMetrics::new(metrics));
    }

    /// Takes in bytes from the client. Once the session is over they are ignored.
    pub fn on_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.last_heard = now;
        self.deframer.push(bytes);
        while self.end.is_none() {
            let handled = match self.deframer.next_message() {
                Ok(Some(message)) => self.on_message(now, message),
                Ok(None) => return,
                Err(error) => Err(error),
            };
            if let Err(error) = handled {
                self.close(SessionEnd::Decode(error));
            }
        }
    }

    /// Ends the session and says why, before anything else that waits; the first end counts.
    pub fn close(&mut self, end: SessionEnd) {
        if self.end.is_none() {
            self.outbox.discard_control();
            self.end.insert(end).message().into_iter().for_each(|message| self.outbox.push_control(message));
        }
    }

    /// The link came up at `connected`, and what stands between it and this session took until now: the hello is due as if
    /// that had taken no time.
    pub fn connected_at(&mut self, connected: Timestamp) {
        self.hello_due = connected + HANDSHAKE;
    }

    /// Whether a hello was accepted and the session is not over.
    pub fn is_open(&self) -> bool {
        self.hello.is_some() && self.end.is_none()
    }

    fn on_message(&mut self, now: Timestamp, message: Message) -> Result<(), DecodeError> {
        let expected = |expected| Err(DecodeError::Malformed { field: "order of messages", expected });
        let poses = if let Message::Poses(samples) = &message { samples.len() } else { 0 };
        if let Err((what, per_sec)) = self.allowance.take(now, poses) {
            self.close(SessionEnd::Flood { what, per_sec });
            return Ok(());
        }
        match message {
            Message::Bye => self.close(SessionEnd::Bye),
            Message::Error { text, .. } => self.close(SessionEnd::ByPeer(text)),
            Message::Hello(_) if self.hello.is_some() => return expected("one hello"),
            Message::Hello(hello) => self.on_hello(now, hello)?,
            _ if self.hello.is_none() => return expected("a hello first"),
            Message::Poses(samples) => {
                for sample in samples {
                    if self.predictor.push(sample) {
                        self.pose_received = now;
                        self.guard.turning(sample.time, self.predictor.turning_rad_per_s());
                    }
                }
                self.statistics.poses_ignored = self.predictor.ignored();
            }
            Message::FrameAck(ack) => {
                if self.outbox.acknowledge(ack.id) {
                    if let Some(metrics) = &self.metrics {
                        metrics.acknowledged(&ack);
                    }
                    let wished = self.hello.as_ref().map_or(0.0, |hello| f64::from(hello.target_kbps) * 125.0);
                    self.adaptation.acknowledged(now, &ack, self.work.beat, wished, &mut self.rate);
                    let measured = Duration::from_micros(u64::from(ack.pose_to_ready_micros)).as_secs_f64();
                    let gain = if self.latency_secs == 0.0 { 1.0 } else { LATENCY_GAIN };
                    self.latency_secs += gain * (measured - self.latency_secs);
                }
            }
            Message::StillRequest(_) if self.stills.len() >= MAX_STILLS => {
                return Err(DecodeError::LimitExceeded { limit: MAX_STILLS, requested: self.stills.len() + 1 });
            }
            Message::StillRequest(request) => {
                if let Some(hello) = &self.hello {
                    self.config.shape_of_still(hello, &request).check(&self.config.limits)?;
                }
                self.stills.push_back(request);
            }
            Message::Ping(_) if self.outbox.control_messages() >= MAX_ANSWERS => self.close(SessionEnd::Unread),
            Message::Ping(time) => self.outbox.push_control(Message::Pong(time)),
            Message::Pong(_) => self.unanswered = None,
            Message::Welcome(_)
            | Message::FrameBegin(_)
            | Message::Strip(_)
            | Message::Picture(_)
            | Message::FrameEnd(_)
            | Message::Statistics(_) => {
                return expected("only what a client says");
            }
        }
        Ok(())
    }

    fn on_hello(&mut self, now: Timestamp, hello: Hello) -> Result<(), DecodeError> {
        // Before anything else of it: who is not known learns nothing.
        if !self.config.token.is_none() && hello.token != self.config.token {
            let why =
                if hello.token.is_none() { "this server wants a token" } else { "the token is not this server's" };
            self.close(SessionEnd::Unauthorised(why));
            return Ok(());
        }
        if hello.viewport == Viewport::Cube && !self.config.media.is_empty() {
            let expected = "a plane: this scene has media, whose layers have no cubes";
            return Err(DecodeError::Malformed { field: "viewport", expected });
        }
        self.config.fits(&hello, hello.camera)?;
        self.cube = match hello.viewport {
            Viewport::Plane => hello.camera,
            Viewport::Cube => self.config.cube_for(&hello),
        };
        self.work.is_cut = hello.viewport == Viewport::Cube && self.cube != Camera::cube(&hello.camera, u32::MAX);
        self.config.fits(&hello, self.cube)?;
        self.outbox.push_control(Message::Welcome(Welcome {
            capabilities: Capabilities::ALL,
            software: concat!("warplight-server ", env!("CARGO_PKG_VERSION")).to_owned(),
            scene: self.config.scene.clone(),
            effects: self.config.effects.clone(),
            head: self.config.head,
            exposure: self.config.exposure,
        }));
        self.next_frame_due = now;
        self.rate = RateControl::new(hello.target_kbps, hello.format);
        self.predictor = Predictor::new(hello.prediction);
        self.budget = FrameBudget::of(&self.config, &hello, &self.cube);
        self.adaptation = Adaptation::new(hello.adapt, now);
        // Compared once, and then not kept.
        self.hello = Some(Hello { token: Token::NONE, ..hello });
        Ok(())
    }

    /// What a live frame shows that is begun after `beat` without one.
    fn live_camera(&mut self, hello: &Hello, beat: Duration, horizon: Duration) -> Camera {
        let (level, point) = (self.adaptation.level(), self.point());
        if hello.viewport == Viewport::Cube {
            let scale = level.scale * f64::from(point.percent) * 1e-2;
            let side = (f64::from(self.cube.size.width) * scale).round() as u32;
            return if scale < 1.0 { Camera::cube(&hello.camera, side) } else { self.cube };
        }
        let display = point.camera(&level.camera(&hello.camera));
        // It is shown until the next one is there, which takes as long as this one did after the last.
        let age = Duration::from_secs_f64(self.latency_secs).min(MAX_SCENE_HORIZON) + beat.min(MAX_SCENE_HORIZON);
        let wider = display.widened(self.guard.margins(&display, age, self.predictor.worth(horizon)));
        self.work.is_cut = self.config.fits(hello, wider).is_err();
        if self.work.is_cut { display } else { wider }
    }

    /// The next frame to render, if one is due and none is being rendered. Live frames go before stills.
    pub fn poll_render(&mut self, now: Timestamp) -> Option<RenderJob> {
        if self.rendering.is_some() || self.end.is_some() {
            return None;
        }
        let hello = self.hello.clone()?;
        let mut camera = hello.camera;
        let mut still_shape = None;
        let mut coding = None;
        let (purpose, pose, horizon, scene_time, samples_per_1024_px) = if self.live_frame_is_due(now) {
            let horizon = Duration::from_secs_f64(self.latency_secs).min(MAX_HORIZON);
            self.rendered_pose = self.predictor.latest_time();
            let interval = Duration::from_secs_f64(1.0 / (f64::from(hello.frame_hz) * self.adaptation.level().rate));
            // Missed beats are not made up for.
            self.next_frame_due =
                if now.since(self.next_frame_due) > interval { now + interval } else { self.next_frame_due + interval };
            // Where the head will be is guessed, where things move is known: not cut off at the same horizon.
            let latency = Duration::from_secs_f64(self.latency_secs).min(MAX_SCENE_HORIZON);
            let scene_time = self.rendered_pose? + latency;
            let beat = self.last_begun.replace(now).map_or(interval, |last| now.since(last)).max(interval);
            self.work.beat = beat;
            camera = self.live_camera(&hello, beat, horizon);
            coding = Some(self.rate.begin(now, interval));
            self.note_limiters(now, &hello);
            let mut pose = self.predictor.predict(horizon)?;
            if hello.viewport == Viewport::Cube {
                // Faces along the axes of the world: a head that only turns gets the same rays again.
                pose.orientation = glam::DQuat::IDENTITY;
            }
            (FramePurpose::Live, pose, horizon, scene_time, self.live_samples(camera.size.pixels()))
        } else if self.outbox.is_idle() {
            let still = self.stills.pop_front()?;
            let spp = still.spp.clamp(1, self.config.max_still_spp);
            still_shape = Some(self.config.shape_of_still(&hello, &still));
            (FramePurpose::Still(still.number), still.pose, Duration::ZERO, still.scene_time, spp.saturating_mul(1024))
        } else {
            return None;
        };
        let id = self.next_frame;
        self.next_frame = FrameId(id.0.wrapping_add(1));
        let is_live = purpose == FramePurpose::Live;
        // The pose as it travels, so that both ends hold the same numbers.
        let render_pose = pose.to_wire().and_then(|bytes| Pose::from_wire(&bytes))?;
        let pose_received = if is_live { self.pose_received } else { now };
        let spp = samples_per_1024_px.div_ceil(1024);
        let end = FrameEnd { id, pose_received, render_start: now, render_end: now, encoded: now, sent: now, spp };
        let mut shape = still_shape.unwrap_or_else(|| self.config.shape_for(&hello, purpose, camera, &render_pose));
        if let Some((color_coding, depth)) = coding {
            (shape.format.color_coding, shape.format.depth) = (color_coding, depth);
            shape.format.volume = self.adaptation.level().volume(shape.format.volume);
            shape.plan = self.point().plan(&shape.plan);
        }
        let pixels = shape.camera.size.pixels();
        self.rendering = Some(Rendering { id, is_live, samples_per_1024_px, pixels, end });
        let begin = FrameBegin {
            id,
            purpose,
            pose_time: if is_live { self.rendered_pose? } else { Timestamp::ZERO },
            horizon_micros: horizon.as_micros() as u32,
            scene_time,
            render_pose,
            shape,
        };
        self.outbox.prepare(begin.clone());
        Some(RenderJob { begin, spp, samples_per_1024_px })
    }

    /// A live frame would replace whatever waits to be sent, so it waits itself until a still has left.
    fn live_frame_is_due(&self, now: Timestamp) -> bool {
        now >= self.next_frame_due && self.predictor.latest_time() > self.rendered_pose && !self.outbox.holds_still()
    }

    /// Samples per 1024 pixels of the next live frame, which has so many pixels.
    fn live_samples(&self, pixels: usize) -> u32 {
        const MOST: f64 = 4096.0 * PIXELS_PER_UNIT;
        const FIRST: f64 = 0.1 * PIXELS_PER_UNIT;
        match self.config.samples {
            SampleBudget::Samples(spp) => spp.max(1).saturating_mul(PIXELS_PER_UNIT as u32),
            SampleBudget::Time(budget) => {
                self.cost.samples_within(pixels as f64, budget.as_secs_f64() * 1e3, FIRST).clamp(LEAST_SAMPLES, MOST)
                    as u32
            }
        }
    }

    /// A strip of the frame that is being rendered.
    pub fn on_strip(&mut self, now: Timestamp, frame: FrameId, strip: Vec<u8>) {
        let Some(rendering) = self.rendering.as_mut().filter(|rendering| rendering.id == frame) else {
            return;
        };
        rendering.end.encoded = now;
        if rendering.is_live {
            self.adaptation.deliveries().ready(frame, now);
        }
        if self.outbox.push_strip(frame, strip) {
            self.statistics.frames_replaced += 1;
        }
    }

    /// The pictures of the frame that is being rendered, not yet encoded, where its format has some; before
    /// [`ServerSession::on_render_end`].
    pub fn on_pictures(&mut self, frame: FrameId, pictures: RenderedPictures) {
        self.outbox.push_rendered(frame, pictures);
    }

    /// Pictures to encode, of a frame that has begun to be sent and so will not be replaced; to be asked after
    /// [`ServerSession::poll_transmit`].
    pub fn poll_encode(&mut self, now: Timestamp) -> Option<EncodeJob> {
        if self.end.is_some() {
            return None;
        }
        let (begin, pictures) = self.outbox.take_rendered()?;
        let ColorCoding::Video { quantiser } = begin.shape.format.color_coding else { return None };
        self.work.encoding_since = Some(now);
        Some(EncodeJob { frame: begin.id, quantiser, pictures })
    }

    /// The pictures of [`ServerSession::poll_encode`] are encoded.
    pub fn on_encoded(&mut self, now: Timestamp, frame: FrameId, pictures: Vec<PictureMessage>) {
        if let Some(since) = self.work.encoding_since.take() {
            self.work.encode = now.since(since);
        }
        self.outbox.push_encoded(now, frame, pictures);
    }

    /// The frame is rendered and its last strip handed over. `counters` are totals of the session.
    pub fn on_render_end(
        &mut self,
        now: Timestamp,
        frame: FrameId,
        render_end: Timestamp,
        counters: Vec<(String, u64)>,
    ) {
        let Some(mut rendering) = self.rendering.take().filter(|rendering| rendering.id == frame) else {
            return;
        };
        rendering.end.render_end = render_end;
        rendering.end.encoded = now;
        if rendering.is_live {
            let millis = now.since(rendering.end.render_start).as_secs_f64() * 1e3;
            let samples = f64::from(rendering.samples_per_1024_px);
            self.cost.measure(rendering.pixels as f64, samples, millis);
            if let Some(budget) = &mut self.budget {
                let least = self.cost.millis_of(rendering.pixels as f64, LEAST_SAMPLES);
                if budget.measured(rendering.pixels, if samples > LEAST_SAMPLES { least.min(millis) } else { millis }) {
                    // Other nodes, other pixels: what the old ones cost says little.
                    self.cost = FrameCost::default();
                }
            }
            if let SampleBudget::Time(budget) = self.config.samples {
                let budget_millis = budget.as_secs_f64() * 1e3;
                if self.fit.does_not(samples <= LEAST_SAMPLES && millis > budget_millis) {
                    tracing::warn!(
                        "a frame takes {millis:.0} ms with the fewest samples: more than the budget of {budget_millis:.0} ms; \
                         frames come later until the picture is smaller or there are more cores"
                    );
                }
            }
            self.work.render = render_end.since(rendering.end.render_start);
            if !self.outbox.has_pictures(frame) {
                self.work.encode = now.since(render_end);
            }
            self.work.has_least_samples =
                matches!(self.config.samples, SampleBudget::Time(_)) && samples <= LEAST_SAMPLES;
            self.statistics.frames_rendered += 1;
        }
        self.statistics.counters = counters;
        self.outbox.finish(rendering.end);
    }

    /// Appends the next message to `out`; false where there is none for now.
    pub fn poll_transmit(&mut self, now: Timestamp, out: &mut Vec<u8>) -> bool {
        if self.end.is_none() && self.hello.is_some() && now >= self.next_ping {
            self.outbox.push_control(Message::Ping(now));
            self.next_ping = now + KEEP_ALIVE;
        }
        let Some(message) = self.outbox.next_message(now, self.end.is_some()) else {
            return false;
        };
        match &message {
            Message::FrameBegin(begin) => {
                self.sent = SentBytes { is_live: begin.purpose == FramePurpose::Live, ..SentBytes::default() };
                if self.sent.is_live {
                    self.adaptation.deliveries().begun(begin.id, now);
                }
            }
            Message::Strip(strip) => self.sent.strips += strip.bytes.len() as u64,
            Message::Picture(picture) => self.sent.pictures += picture.bytes.len() as u64,
            Message::Ping(time) => self.unanswered = self.unanswered.or(Some(*time)),
            Message::FrameEnd(end) => {
                if let SentBytes { is_live: true, strips, pictures } = self.sent {
                    self.rate.took(strips, pictures);
                    self.adaptation.deliveries().ended(end, strips + pictures);
                }
                self.statistics.frames_sent = self.outbox.live_frames_sent();
                if let (Some(metrics), SentBytes { is_live: true, strips, pictures }) = (&mut self.metrics, self.sent) {
                    metrics.sent(end, strips + pictures, &self.statistics);
                }
                self.outbox.push_control(Message::Statistics(self.statistics.clone()));
            }
            _ => {}
        }
        warplight_protocol::wire::write_message(&message, out);
        true
    }

    /// Notices a peer that is gone.
    pub fn on_timeout(&mut self, now: Timestamp) {
        if now.since(self.last_heard) >= DEAD_PEER {
            self.close(SessionEnd::Silent);
        } else if self.unanswered.is_some_and(|ping| now.since(ping) >= UNREAD) {
            self.close(SessionEnd::Unread);
        } else if self.hello.is_none() && now >= self.hello_due {
            self.close(SessionEnd::NoHello);
        }
    }

    /// When to ask again, if nothing else happens.
    pub fn next_timeout(&self) -> Timestamp {
        let mut next = self.next_ping.min(self.last_heard + DEAD_PEER);
        if self.hello.is_none() {
            next = (self.last_heard + DEAD_PEER).min(self.hello_due);
        }
        if self.rendering.is_none() && self.predictor.latest_time() > self.rendered_pose {
            next = next.min(self.next_frame_due);
        }
        next
    }

    /// How live frames are rendered.
    fn point(&self) -> FramePoint {
        self.budget.as_ref().map_or(FramePoint::WHOLE, FrameBudget::point)
    }

    /// What the budget has learnt of the costs of its points, where there is one.
    pub fn costs(&self) -> Option<&Chooser> {
        self.budget.as_ref().map(FrameBudget::chooser)
    }

    /// Totals so far.
    pub fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// Bytes of strips and pictures that wait to be sent: of the frame being sent and the one behind it, never of more.
    pub fn waiting_bytes(&self) -> usize {
        self.outbox.waiting_bytes()
    }

    /// Why the session is over, once it is.
    pub fn end(&self) -> Option<&SessionEnd> {
        self.end.as_ref()
    }
}

#[cfg(test)]
mod tests;
