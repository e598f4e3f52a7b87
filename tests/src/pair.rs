//! Client and server session over a modelled link in virtual time, with frames that cost nothing to render.
//!
//! What is tested here is freshness: which frames travel when. So the renderer is an interval, and a frame is a
//! strip of so many bytes that nobody decodes.

use std::time::Duration;
use warplight_client::link::{Link, LinkModel};
use warplight_client::session::{ClientSession, Event};
use warplight_protocol::codec::Limits;
use warplight_protocol::frame::{FrameFormat, FrameId, Interfaces, Plan};
use warplight_protocol::message::{Capabilities, FrameBegin, Hello, PoseSample, Viewport};
use warplight_protocol::{Camera, ImageSize, Pose, Timestamp};
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
    /// Poses per second.
    pub pose_hz: f64,
    /// Seed of the link.
    pub seed: u64,
}

/// A frame that arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Its identity.
    pub id: FrameId,
    /// When.
    pub at: Timestamp,
    /// Age of the pose it answers.
    pub age: Duration,
}

/// The two ends and everything between them.
#[derive(Debug)]
pub struct Pair {
    options: PairOptions,
    now: Timestamp,
    next_pose: Timestamp,
    server: ServerSession,
    client: ClientSession,
    up: Link,
    down: Link,
    rendering: Option<(Timestamp, FrameId)>,
    begin: Option<FrameBegin>,
    arrivals: Vec<Arrival>,
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
            max_still_spp: 1,
            strip_rows: 32,
            guard_rad: 0.0,
            limits: Limits::default(),
        };
        let hello = Hello {
            capabilities: Capabilities::ALL,
            software: "harness".to_owned(),
            camera: Camera::symmetric(1.0, ImageSize::new(256, 256)),
            viewport: Viewport::Plane,
            frame_hz: options.frame_hz,
            format: FrameFormat::default(),
            target_kbps: 0,
        };
        Pair {
            options,
            now,
            next_pose: now,
            server: ServerSession::new(config, now),
            client: ClientSession::new(hello, Limits::default(), now),
            up: Link::new(options.link, options.seed),
            down: Link::new(options.link, options.seed + 1),
            rendering: None,
            begin: None,
            arrivals: Vec::new(),
        }
    }

    /// Lets `duration` pass.
    pub fn drive(&mut self, duration: Duration) {
        let until = self.now + duration;
        while self.now < until {
            self.step(until);
        }
    }

    /// Everything that is due now; then the clock moves to the next event, at most to `until`.
    pub fn step(&mut self, until: Timestamp) {
        while self.settle() {}
        self.server.on_timeout(self.now);
        self.client.on_timeout(self.now);
        let mut next = until.min(self.next_pose).min(self.server.next_timeout()).min(self.client.next_timeout());
        let events = [self.up.next_arrival(), self.down.next_arrival(), self.rendering.map(|(at, _)| at)];
        for event in events.into_iter().flatten() {
            next = next.min(event);
        }
        for link in [&self.up, &self.down] {
            if !link.has_room(self.now) {
                next = next.min(link.room_at());
            }
        }
        self.now = next.max(self.now + Duration::from_micros(1)).min(until);
    }

    fn settle(&mut self) -> bool {
        let mut active = false;
        if self.now >= self.next_pose && self.client.is_open() {
            self.client.push_pose(PoseSample { time: self.now, pose: Pose::IDENTITY });
            self.next_pose = self.now + Duration::from_secs_f64(1.0 / self.options.pose_hz);
        } else if self.now >= self.next_pose {
            self.next_pose = self.now + Duration::from_millis(1);
        }
        while let Some(bytes) = self.up.receive(self.now) {
            self.server.on_bytes(self.now, &bytes);
            active = true;
        }
        while let Some(bytes) = self.down.receive(self.now) {
            self.client.on_bytes(self.now, &bytes);
            active = true;
        }
        self.render();
        while let Some(event) = self.client.poll_event() {
            self.on_event(event);
        }
        let mut bytes = Vec::new();
        while self.down.has_room(self.now) && self.server.poll_transmit(self.now, &mut bytes) {
            self.down.send(self.now, std::mem::take(&mut bytes));
            active = true;
        }
        while self.up.has_room(self.now) && self.client.poll_transmit(self.now, &mut bytes) {
            self.up.send(self.now, std::mem::take(&mut bytes));
            active = true;
        }
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
                self.client.acknowledge(end.id, age);
                self.arrivals.push(Arrival { id: end.id, at: self.now, age });
            }
            _ => {}
        }
    }

    /// Frames that arrived, in order.
    pub fn arrivals(&self) -> &[Arrival] {
        &self.arrivals
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
