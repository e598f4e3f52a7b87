//! A replay in virtual time: both sessions, a modelled link between them, and a clock that jumps from event to
//! event. The same seed gives the same recording to the byte, on any machine.
//!
//! Frames are really rendered, encoded and decoded; only what that *takes* is modelled ([`ModelledTimes`]),
//! as is the link. A connection that a cut ends is made again as over TCP. The warp of refreshes that nobody compares is not computed.

use super::shown::Shown;
use super::{Capture, DisplayRecord, Progress, Recording, ReplayError, ReplayPlan};
use crate::assemble::{Assembler, ReadyFrame};
use crate::budget::DisplayBudget;
use crate::link::{Change, LinkModel, Route};
use crate::session::{ClientSession, Event};
use crate::trace::Trace;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use warplight_protocol::Timestamp;
use warplight_protocol::codec::{DecodeError, Limits};
use warplight_protocol::frame::FrameId;
use warplight_protocol::message::{FrameBegin, FramePurpose, PictureMessage, PoseSample};
use warplight_server::pictures::{PictureStream, RenderedPictures};
use warplight_server::service::Service;
use warplight_server::session::ServerSession;
use warplight_server::stream::{FrameStream, STRIP_ROWS};

/// What work is said to take. The defaults are medians of a two-core machine at 512x512 with four nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelledTimes {
    /// Rendering a frame.
    pub render: Duration,
    /// Encoding a pixel through all its nodes, in nanoseconds.
    pub encode_ns_per_pixel: f64,
    /// Decoding it.
    pub decode_ns_per_pixel: f64,
    /// Encoding a pixel of all pictures of a frame, where its format has some, in nanoseconds.
    pub encode_pictures_ns_per_pixel: f64,
    /// Decoding it.
    pub decode_pictures_ns_per_pixel: f64,
    /// Warping it.
    pub warp_ns_per_pixel: f64,
}

impl Default for ModelledTimes {
    fn default() -> ModelledTimes {
        ModelledTimes {
            render: Duration::from_millis(80),
            encode_ns_per_pixel: 30.0,
            decode_ns_per_pixel: 30.0,
            encode_pictures_ns_per_pixel: 20.0,
            decode_pictures_ns_per_pixel: 20.0,
            warp_ns_per_pixel: 20.0,
        }
    }
}

/// Nothing arrives for this long: the replay fails instead of running on for ever.
const PATIENCE: Duration = Duration::from_secs(30);

/// Replays `plan` against a server of `service`, over `link` both ways.
pub fn run(
    plan: &ReplayPlan,
    service: Service,
    link: LinkModel,
    times: ModelledTimes,
    seed: u64,
    progress: &mut dyn FnMut(Progress),
) -> Result<Recording, ReplayError> {
    let mut world = World::new(plan, service, link, times, seed);
    progress(Progress::Connecting);
    world.wait_for_first_frame()?;
    let refreshes = plan.refreshes();
    for number in 0..refreshes {
        world.run_until(world.recording.start + plan.refresh_time(number))?;
        world.refresh(number);
        progress(Progress::Displaying(number + 1, refreshes));
    }
    world.recording.finish(world.route.down.bytes(), world.route.up.bytes());
    world.fetch_references(progress)?;
    Ok(world.recording)
}

struct World<'a> {
    plan: &'a ReplayPlan,
    times: ModelledTimes,
    now: Timestamp,
    service: Service,
    server: ServerSession,
    stream: FrameStream,
    pictures: PictureStream,
    client: ClientSession,
    assembler: Assembler,
    route: Route,
    server_work: VecDeque<(Timestamp, ServerWork)>,
    decoding: VecDeque<(Timestamp, Arc<ReadyFrame>)>,
    trace: Option<Trace>,
    shown: Shown,
    recording: Recording,
    references_missing: usize,
}

/// What the renderer will have done by some time.
enum ServerWork {
    Strip(FrameId, Vec<u8>),
    End { frame: FrameId, render_end: Timestamp, counters: Vec<(String, u64)>, pictures: Option<RenderedPictures> },
    Encoded { frame: FrameId, pictures: Vec<PictureMessage> },
}

impl<'a> World<'a> {
    fn new(plan: &'a ReplayPlan, service: Service, link: LinkModel, times: ModelledTimes, seed: u64) -> World<'a> {
        let now = Timestamp::ZERO;
        World {
            plan,
            times,
            now,
            server: ServerSession::new(service.session.clone(), now),
            pictures: PictureStream::new(service.options.threads),
            stream: FrameStream::new(service.clone()),
            service,
            client: ClientSession::new(plan.hello(), Limits::default(), now),
            assembler: Assembler::default(),
            route: Route::new(link, seed.wrapping_mul(2), seed.wrapping_mul(2).wrapping_add(1)),
            server_work: VecDeque::new(),
            decoding: VecDeque::new(),
            trace: None,
            shown: Shown::default(),
            recording: Recording {
                metrics: plan.metrics.clone(),
                budget: plan.display_budget(),
                ..Recording::default()
            },
            references_missing: 0,
        }
    }

    /// The head stands still at the start of the trace until there is something to see.
    fn wait_for_first_frame(&mut self) -> Result<(), ReplayError> {
        let deadline = self.now + PATIENCE;
        while self.shown.latest().is_none() {
            if self.now >= deadline {
                return Err(ReplayError::NoFrame(PATIENCE));
            }
            if let Some(trace) = &self.trace {
                self.client.push_pose(PoseSample { time: self.now, pose: trace.pose_at(0.0) });
            }
            self.run_until(self.now + self.plan.refresh_interval())?;
        }
        self.recording.start = self.now;
        Ok(())
    }

    /// Lets everything happen up to and including `until`.
    fn run_until(&mut self, until: Timestamp) -> Result<(), ReplayError> {
        loop {
            self.settle()?;
            let next = self.next_event();
            if next > until {
                self.now = self.now.max(until);
                return Ok(());
            }
            self.now = self.now.max(next);
        }
    }

    /// Everything that is due now, until nothing more is.
    fn settle(&mut self) -> Result<(), ReplayError> {
        while let Some(change) = self.route.poll(self.now) {
            match change {
                Change::Lost => self.on_lost(),
                Change::Open => self.on_open(),
            }
        }
        let mut again = self.route.is_open();
        while again {
            again = false;
            while let Some(bytes) = self.route.up.receive(self.now) {
                self.server.on_bytes(self.now, &bytes);
                again = true;
            }
            while let Some(bytes) = self.route.down.receive(self.now) {
                self.client.on_bytes(self.now, &bytes);
                again = true;
            }
            again |= self.serve()?;
            again |= self.attend()?;
        }
        if !self.route.is_open() {
            return Ok(());
        }
        self.server.on_timeout(self.now);
        self.client.on_timeout(self.now);
        match self.client.end() {
            Some(end) if end.is_final() => Err(end.clone().into()),
            Some(_) if self.route.is_open() => {
                self.route.lose(self.now);
                self.on_lost();
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// The connection is gone: what is shown stays, what was under way does not come.
    fn on_lost(&mut self) {
        self.recording.session_lost(self.assembler.abandon());
        self.route.up.take_lost();
        self.route.down.take_lost();
        self.server_work.clear();
        self.decoding.clear();
    }

    /// Both ends start anew.
    fn on_open(&mut self) {
        self.recording.reconnects += 1;
        self.server = ServerSession::new(self.service.session.clone(), self.now);
        self.pictures = PictureStream::new(self.service.options.threads);
        self.stream = FrameStream::new(self.service.clone());
        self.client = ClientSession::new(self.plan.hello(), Limits::default(), self.now);
        self.assembler.new_session();
    }

    /// The server's part.
    fn serve(&mut self) -> Result<bool, ReplayError> {
        let mut active = false;
        while let Some((_, work)) = self.server_work.pop_front_if(|(at, _)| *at <= self.now) {
            active = true;
            match work {
                ServerWork::Strip(frame, bytes) => self.server.on_strip(self.now, frame, bytes),
                ServerWork::End { frame, render_end, counters, pictures } => {
                    if let Some(pictures) = pictures {
                        self.server.on_pictures(frame, pictures);
                    }
                    self.server.on_render_end(self.now, frame, render_end, counters);
                }
                ServerWork::Encoded { frame, pictures } => self.server.on_encoded(self.now, frame, pictures),
            }
        }
        if let Some(job) = self.server.poll_render(self.now) {
            active = true;
            let strips = Mutex::new(Vec::new());
            let on_strip = |strip| strips.lock().unwrap_or_else(PoisonError::into_inner).push(strip);
            let pictures = self.stream.run(&job, &|| (), &on_strip);
            let mut strips = strips.into_inner().unwrap_or_else(PoisonError::into_inner);
            // Workers finish in any order; the first two bytes are the row.
            strips.sort_by_key(|strip| [strip[1], strip[0]]);
            self.schedule(&job.begin, strips, pictures);
        }
        let mut bytes = Vec::new();
        while self.route.down.has_room(self.now) && self.server.poll_transmit(self.now, &mut bytes) {
            self.route.down.send(self.now, std::mem::take(&mut bytes));
            active = true;
        }
        if let Some(job) = self.server.poll_encode(self.now) {
            active = true;
            let encode = self.times.encode_pictures_ns_per_pixel * 1e-9 * job.pictures.pixels() as f64;
            let encoded = self.now + Duration::from_secs_f64(encode);
            let pictures = self.pictures.encode(&job)?;
            self.add_work(encoded, ServerWork::Encoded { frame: job.frame, pictures });
        }
        Ok(active)
    }

    /// Keeps work in order: pictures of one frame are encoded while the next is rendered.
    fn add_work(&mut self, at: Timestamp, work: ServerWork) {
        let behind = self.server_work.partition_point(|(before, _)| *before <= at);
        self.server_work.insert(behind, (at, work));
    }

    /// Spreads the strips of a frame over the time it is said to take.
    fn schedule(&mut self, begin: &FrameBegin, strips: Vec<Vec<u8>>, pictures: Option<RenderedPictures>) {
        let render = if begin.purpose == FramePurpose::Live { self.times.render } else { Duration::ZERO };
        let pixels = begin.shape.camera.size.pixels() as f64;
        let count = strips.len().max(1) as f64;
        let encode = Duration::from_secs_f64(self.times.encode_ns_per_pixel * 1e-9 * pixels / count);
        for (index, strip) in strips.into_iter().enumerate() {
            let rendered = self.now + render.mul_f64((index + 1) as f64 / count);
            self.add_work(rendered + encode, ServerWork::Strip(begin.id, strip));
        }
        let render_end = self.now + render;
        let end = ServerWork::End { frame: begin.id, render_end, counters: self.stream.counters(), pictures };
        self.add_work(render_end + encode, end);
    }

    /// The client's part.
    fn attend(&mut self) -> Result<bool, ReplayError> {
        let mut active = false;
        while let Some(event) = self.client.poll_event() {
            active = true;
            if let Err(error) = self.on_event(event) {
                self.client.refuse(error);
                break;
            }
        }
        while let Some((_, frame)) = self.decoding.pop_front_if(|(at, _)| *at <= self.now) {
            active = true;
            self.on_ready(frame);
        }
        let mut bytes = Vec::new();
        while self.route.up.has_room(self.now) && self.client.poll_transmit(self.now, &mut bytes) {
            self.route.up.send(self.now, std::mem::take(&mut bytes));
            active = true;
        }
        Ok(active)
    }

    fn on_event(&mut self, event: Event) -> Result<(), DecodeError> {
        match event {
            Event::Welcome(welcome) => {
                self.trace = Some(self.plan.placed_trace(&welcome.head));
                self.recording.welcome = Some(welcome);
            }
            Event::FrameBegin(begin) => self.assembler.begin(begin),
            Event::Strip(strip) => {
                let modelled = self.strip_decode_time();
                self.assembler.strip(&strip, || modelled)?;
            }
            Event::Picture(picture) => {
                let modelled = self.pictures_decode_time() / self.assembler.pictures().max(1) as u32;
                self.assembler.picture(picture, || modelled)?;
            }
            Event::FrameEnd(end) => {
                // All strips but the last were decoded while the next one was under way; pictures at their end.
                let pictures = if self.assembler.pictures() > 0 { self.pictures_decode_time() } else { Duration::ZERO };
                let decoded = self.now + self.strip_decode_time() + pictures;
                let frame = self.assembler.end(end, self.now, decoded)?;
                self.decoding.push_back((decoded, frame));
            }
            Event::Statistics(statistics) => self.recording.statistics_arrived(statistics),
            Event::RoundTrip(_) => {}
        }
        Ok(())
    }

    /// Of the frame that is being put together, which may be larger than the display.
    fn strip_decode_time(&self) -> Duration {
        let size = self.assembler.size().unwrap_or(self.plan.camera.size);
        let pixels = u32::from(STRIP_ROWS).min(size.height) * size.width;
        Duration::from_secs_f64(self.times.decode_ns_per_pixel * 1e-9 * f64::from(pixels))
    }

    /// Of all pictures of the frame that is being put together.
    fn pictures_decode_time(&self) -> Duration {
        let size = self.assembler.size().unwrap_or(self.plan.camera.size);
        Duration::from_secs_f64(self.times.decode_pictures_ns_per_pixel * 1e-9 * size.pixels() as f64)
    }

    fn on_ready(&mut self, frame: Arc<ReadyFrame>) {
        if let FramePurpose::Still(number) = frame.begin.purpose {
            self.references_missing = self.references_missing.saturating_sub(1);
            self.recording.reference_arrived(number, &frame.tree, frame.begin.shape.exposure);
            self.assembler.retire(frame);
            return;
        }
        self.client.acknowledge(frame.begin.id, self.now.since(frame.begin.pose_time), frame.decode_time);
        self.recording.frame_arrived(&frame);
        if let Some(old) = self.shown.replace(frame, self.plan.earlier_frames) {
            self.assembler.retire(old);
        }
    }

    fn next_event(&self) -> Timestamp {
        let Route { up, down, .. } = &self.route;
        let mut events = vec![
            up.next_arrival(),
            down.next_arrival(),
            self.route.next_event(),
            self.server_work.front().map(|work| work.0),
            self.decoding.front().map(|work| work.0),
        ];
        if self.route.is_open() {
            events.push(Some(self.client.next_timeout()));
            // A session that is over asks for nothing more.
            events.push(self.server.end().is_none().then(|| self.server.next_timeout()));
            events.extend([up, down].map(|link| Some(link.room_at())));
        }
        // What is due already waits for something else: a ping for room on the link. Time moves on, whatever they say.
        let next = events.into_iter().flatten().filter(|&event| event > self.now).min();
        next.unwrap_or(self.now + PATIENCE)
    }

    fn refresh(&mut self, number: u64) {
        let (Some(trace), Some(frame)) = (&self.trace, self.shown.latest()) else { return };
        let time = self.plan.refresh_time(number);
        let display_pose = trace.pose_at(time.as_secs_f64());
        self.client.push_pose(PoseSample { time: self.now, pose: display_pose });
        let pixels = self.plan.pixels_of_a_refresh();
        let usual = Duration::from_secs_f64(self.times.warp_ns_per_pixel * 1e-9 * pixels as f64);
        let point = self.recording.budget.as_ref().map(DisplayBudget::point);
        let warp = match (&mut self.recording.budget, &self.plan.budget) {
            (Some(budget), Some(plan)) => {
                let modelled = budget.modelled(&plan.table, usual);
                budget.measured(modelled, pixels);
                modelled
            }
            _ => usual,
        };
        let interval = self.plan.refresh_interval();
        // Shown at the next refresh, or at the first one after the warp.
        let intervals = (warp.as_secs_f64() / interval.as_secs_f64()).ceil().max(1.0);
        let motion_to_photon = interval.mul_f64(intervals);
        let presented = self.now + motion_to_photon;
        self.recording.refreshed(DisplayRecord {
            time,
            motion_to_photon,
            warp,
            frame: frame.begin.id,
            frame_age: presented.since(frame.begin.pose_time),
            missed: intervals > 1.0,
        });
        self.recording.frame_shown(frame.begin.id, self.now + warp, presented, display_pose);
        if (self.recording.captures.len() as u64) < self.plan.comparisons_by(number) {
            let capture = Capture::new(self.plan, trace, time, self.now, &self.shown);
            self.recording.captures.extend(capture.map(|capture| Capture { point, ..capture }));
        }
    }

    /// Asks for all stills that the references need.
    fn fetch_references(&mut self, progress: &mut dyn FnMut(Progress)) -> Result<(), ReplayError> {
        let requests = self.recording.reference_requests(self.plan);
        let total = requests.len() as u64;
        for request in requests {
            self.client.request_still(request);
            self.references_missing = 1;
            progress(Progress::Reference(u64::from(request.number), total));
            let deadline = self.now + PATIENCE;
            while self.references_missing > 0 {
                if self.now >= deadline {
                    // Lost with its session.
                    tracing::warn!("still {} of {total} for the references did not arrive", request.number);
                    return Ok(());
                }
                self.run_until(self.now + Duration::from_millis(100))?;
            }
        }
        Ok(())
    }
}
