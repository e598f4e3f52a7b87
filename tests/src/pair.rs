//! Client and server session over a modelled link in virtual time, with frames that cost nothing to render.
//!
//! What is tested here is freshness: which frames travel when, what becomes of each, and that the display goes on whatever
//! happens to link and server. So the renderer is an interval, and a frame is a
//! strip of so many bytes that nobody decodes.

use glam::DVec3;
use std::time::Duration;
use warplight_client::link::{Change, LinkModel, Route};
use warplight_client::session::{ClientSession, Event};
use warplight_protocol::codec::Limits;
use warplight_protocol::frame::{FrameFormat, FrameId, Interfaces, Plan};
use warplight_protocol::message::{Capabilities, FrameBegin, Hello, MessageKind, PoseSample, Prediction, Viewport};
use warplight_protocol::{Camera, ImageSize, Pose, Timestamp, Token};
use warplight_server::march::MediaBounds;
use warplight_server::session::{SampleBudget, ServerSession, SessionConfig};

/// What the pair is like.
#[derive(Clone, Copy, Debug)]
pub struct PairOptions {
    /// The link, both ways.
    pub link: LinkModel,
    /// Frames per second asked for.
    pub frame_hz: f32,
    /// Time to render a frame.
    pub render: Duration,
    /// Bytes of a frame.
    pub frame_bytes: usize,
    /// Refreshes of the display per second; each samples a pose and shows the latest frame.
    pub pose_hz: f64,
    /// Seed of the link.
    pub seed: u64,
}

/// A frame that arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Its identity, in its session.
    pub id: FrameId,
    /// Sessions before that one.
    pub session: u32,
    /// When.
    pub at: Timestamp,
    /// Age of the pose it answers.
    pub age: Duration,
}

/// What has become of frames, each counted where it happens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fates {
    /// Begun to be sent, at the server.
    pub sent: u64,
    /// Shown, at the display.
    pub shown: u64,
    /// Whole, but a newer one was there at the next refresh, at the display.
    pub replaced: u64,
    /// Begun but never whole: their head was lost on the link, or the connection broke before their end.
    pub lost: u64,
    /// Never begun to be sent: a newer one took their place, at the server.
    pub unsent: u64,
}

/// What the display did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Refreshes {
    /// Refreshes in all.
    pub all: u64,
    /// Those that had a frame to show.
    pub with_frame: u64,
    /// Those that showed as new what is not newer than all before.
    pub shown_twice: u64,
    /// Longest time between two.
    pub longest_pause: Duration,
}

/// The two ends and everything between them.
#[derive(Debug)]
pub struct Pair {
    options: PairOptions,
    config: SessionConfig,
    hello: Hello,
    now: Timestamp,
    start: Timestamp,
    is_posing: bool,
    sessions: u32,
    server: ServerSession,
    client: ClientSession,
    route: Route,
    rendering: Option<(Timestamp, FrameId)>,
    begin: Option<FrameBegin>,
    arrivals: Vec<Arrival>,
    waiting: Option<Arrival>,
    on_display: Option<Arrival>,
    last_refresh: Option<Timestamp>,
    refreshes: Refreshes,
    fates: Fates,
    most_waiting_bytes: usize,
}

const STRIPS: usize = 8;

impl Pair {
    /// A pair whose link has just come up.
    pub fn new(options: PairOptions) -> Pair {
        let now = Timestamp::ZERO;
        let config = SessionConfig {
            scene: "none".to_owned(),
            effects: Vec::new(),
            head: Pose::IDENTITY,
            exposure: 1.0,
            plan: Plan::diffuse(),
            interfaces: Interfaces::default(),
            media: MediaBounds::default(),
            samples: SampleBudget::Samples(1),
            costs: None,
            max_still_spp: 1,
            strip_rows: 32,
            guard_rad: 0.0,
            limits: Limits::default(),
            token: Token::NONE,
        };
        let hello = Hello {
            capabilities: Capabilities::ALL,
            software: "harness".to_owned(),
            camera: Camera::symmetric(1.0, ImageSize::new(256, 256)),
            viewport: Viewport::Plane,
            frame_hz: options.frame_hz,
            format: FrameFormat::default(),
            target_kbps: 0,
            prediction: Prediction::Adaptive,
            token: Token::NONE,
            adapt: false,
        };
        Pair {
            options,
            now,
            start: now,
            is_posing: true,
            sessions: 0,
            server: ServerSession::new(config.clone(), now),
            client: ClientSession::new(hello.clone(), Limits::default(), now),
            route: Route::new(options.link, options.seed, options.seed + 1),
            config,
            hello,
            rendering: None,
            begin: None,
            arrivals: Vec::new(),
            waiting: None,
            on_display: None,
            last_refresh: None,
            refreshes: Refreshes::default(),
            fates: Fates::default(),
            most_waiting_bytes: 0,
        }
    }

    /// Lets `duration` pass.
    pub fn drive(&mut self, duration: Duration) {
        let until = self.now + duration;
        while self.now < until {
            self.step(until);
        }
    }

    /// Lets everything that is under way arrive: the head says nothing more, so nothing new is rendered.
    pub fn drain(&mut self) {
        self.is_posing = false;
        self.drive(Duration::from_secs(10));
        self.is_posing = true;
    }

    /// The server's process is killed, and another listens after `pause`.
    pub fn restart_server(&mut self, pause: Duration) {
        self.route.restart_server(self.now, pause);
        self.on_lost();
    }

    /// Everything that is due now; then the clock moves to the next event, at most to `until`.
    pub fn step(&mut self, until: Timestamp) {
        while let Some(change) = self.route.poll(self.now) {
            match change {
                Change::Lost => self.on_lost(),
                Change::Open => self.on_open(),
            }
        }
        while self.settle() {}
        if self.now >= self.next_refresh() {
            self.refresh();
            while self.settle() {}
        }
        self.server.on_timeout(self.now);
        self.client.on_timeout(self.now);
        if self.client.end().is_some() && self.route.is_open() {
            self.route.lose(self.now);
            self.on_lost();
        }
        self.now = self.next_event().min(until).max(self.now + Duration::from_micros(1));
    }

    /// When something can happen next. What is due already waits for something else: a ping for room on the link.
    fn next_event(&self) -> Timestamp {
        let mut events = vec![
            Some(self.next_refresh()),
            self.route.next_event(),
            self.route.up.next_arrival(),
            self.route.down.next_arrival(),
            self.rendering.map(|(at, _)| at),
        ];
        if self.route.is_open() {
            events.push(Some(self.client.next_timeout()));
            events.push(self.server.end().is_none().then(|| self.server.next_timeout()));
            events.extend([&self.route.up, &self.route.down].map(|link| Some(link.room_at())));
        }
        let next = events.into_iter().flatten().filter(|&event| event > self.now).min();
        next.unwrap_or(self.next_refresh())
    }

    /// Exact, so that a long session does not drift.
    fn next_refresh(&self) -> Timestamp {
        self.start + Duration::from_secs_f64(self.refreshes.all as f64 / self.options.pose_hz)
    }

    /// The display shows what is latest, whatever has become of link and server.
    fn refresh(&mut self) {
        self.refreshes.all += 1;
        if let Some(last) = self.last_refresh.replace(self.now) {
            self.refreshes.longest_pause = self.refreshes.longest_pause.max(self.now.since(last));
        }
        if let Some(new) = self.waiting.take() {
            let is_newer = self.on_display.is_none_or(|old| (old.session, old.id) < (new.session, new.id));
            self.refreshes.shown_twice += u64::from(!is_newer);
            self.fates.shown += 1;
            self.on_display = Some(new);
        }
        self.refreshes.with_frame += u64::from(self.on_display.is_some());
        if self.is_posing && self.client.is_open() {
            let at = DVec3::X * (self.now.as_secs() * 0.7).sin();
            self.client.push_pose(PoseSample { time: self.now, pose: Pose { position: at, ..Pose::IDENTITY } });
        }
    }

    fn on_lost(&mut self) {
        let begun = |bytes: &Vec<u8>| bytes.get(4) == Some(&(MessageKind::FrameBegin as u8));
        self.fates.lost += self.route.down.take_lost().iter().filter(|bytes| begun(bytes)).count() as u64;
        self.fates.lost += u64::from(self.begin.take().is_some());
        self.route.up.take_lost();
        self.rendering = None;
    }

    fn on_open(&mut self) {
        self.sessions += 1;
        self.fates.unsent += u64::from(self.server.statistics().frames_replaced);
        self.server = ServerSession::new(self.config.clone(), self.now);
        self.client = ClientSession::new(self.hello.clone(), Limits::default(), self.now);
    }

    fn settle(&mut self) -> bool {
        if !self.route.is_open() {
            return false;
        }
        let mut active = false;
        while let Some(bytes) = self.route.up.receive(self.now) {
            self.server.on_bytes(self.now, &bytes);
            active = true;
        }
        while let Some(bytes) = self.route.down.receive(self.now) {
            self.client.on_bytes(self.now, &bytes);
            active = true;
        }
        self.render();
        while let Some(event) = self.client.poll_event() {
            self.on_event(event);
        }
        let mut bytes = Vec::new();
        while self.route.down.has_room(self.now) && self.server.poll_transmit(self.now, &mut bytes) {
            self.fates.sent += u64::from(bytes.get(4) == Some(&(MessageKind::FrameBegin as u8)));
            self.route.down.send(self.now, std::mem::take(&mut bytes));
            active = true;
        }
        while self.route.up.has_room(self.now) && self.client.poll_transmit(self.now, &mut bytes) {
            self.route.up.send(self.now, std::mem::take(&mut bytes));
            active = true;
        }
        self.most_waiting_bytes = self.most_waiting_bytes.max(self.server.waiting_bytes());
        active
    }

    fn render(&mut self) {
        if let Some((_, id)) = self.rendering.take_if(|(at, _)| *at <= self.now) {
            for _ in 0..STRIPS {
                self.server.on_strip(self.now, id, vec![0; self.options.frame_bytes / STRIPS]);
            }
            self.server.on_render_end(self.now, id, self.now, Vec::new());
        }
        if let Some(job) = self.server.poll_render(self.now) {
            self.rendering = Some((self.now + self.options.render, job.begin.id));
        }
    }

    fn on_event(&mut self, event: Event) {
        match event {
            Event::FrameBegin(begin) => self.begin = Some(begin),
            Event::FrameEnd(end) => {
                let Some(begin) = self.begin.take().filter(|begin| begin.id == end.id) else { return };
                let age = self.now.since(begin.pose_time);
                self.client.acknowledge(end.id, age, Duration::ZERO);
                let arrival = Arrival { id: end.id, session: self.sessions, at: self.now, age };
                self.arrivals.push(arrival);
                self.fates.replaced += u64::from(self.waiting.replace(arrival).is_some());
            }
            _ => {}
        }
    }

    /// Frames that arrived, in order, since they were forgotten.
    pub fn arrivals(&self) -> &[Arrival] {
        &self.arrivals
    }

    /// Forgets frames that arrived: a long session would collect them.
    pub fn forget_arrivals(&mut self) {
        self.arrivals.clear();
    }

    /// What has become of frames. After [`Pair::drain`], all that were sent are shown, replaced or lost.
    pub fn fates(&self) -> Fates {
        let unsent = self.fates.unsent + u64::from(self.server.statistics().frames_replaced);
        Fates { unsent, ..self.fates }
    }

    /// What the display did.
    pub fn refreshes(&self) -> Refreshes {
        self.refreshes
    }

    /// How often the connection was made again.
    pub fn reconnects(&self) -> u32 {
        self.sessions
    }

    /// Most bytes of frames that ever waited at the server.
    pub fn most_waiting_bytes(&self) -> usize {
        self.most_waiting_bytes
    }

    /// The server's end.
    pub fn server(&self) -> &ServerSession {
        &self.server
    }

    /// The client's end.
    pub fn client(&self) -> &ClientSession {
        &self.client
    }

    /// The virtual clock.
    pub fn now(&self) -> Timestamp {
        self.now
    }
}
