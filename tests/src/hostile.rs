//! The two state machines of a session against a peer that says anything: what must hold of them whatever comes.
//!
//! A **script** is bytes of a fuzzer, read as steps: bytes from the peer, framed or raw, time that passes, frames that are
//! rendered, a link that takes nothing for a while. A **mutation** is a recorded session with a few bytes
//! changed, cut, repeated or moved. Nothing is rendered or decoded here, so that a session costs microseconds.

use std::time::Duration;
use warplight_client::session::{ClientSession, Event};
use warplight_protocol::codec::Limits;
use warplight_protocol::frame::{FrameFormat, FrameId, Interfaces, Plan};
use warplight_protocol::message::{
    Capabilities, FrameAck, Hello, Message, MessageKind, PoseSample, Prediction, StillRequest, Viewport,
};
use warplight_protocol::wire::{Deframer, write_message};
use warplight_protocol::{Camera, ImageSize, Pose, Timestamp, Token};
use warplight_server::march::MediaBounds;
use warplight_server::session::{SampleBudget, ServerSession, SessionConfig};

/// Messages that one step may answer: more would be an answer that feeds itself.
const MOST_ANSWERS: usize = 20_000;
/// Bytes of a strip that stands for a rendered one.
const STRIP_BYTES: usize = 40;

fn token() -> Token {
    Token::new("a-token-of-tests").expect("16 letters")
}

fn camera() -> Camera {
    Camera::symmetric(1.0, ImageSize::new(16, 16))
}

fn config() -> SessionConfig {
    SessionConfig {
        scene: "none".to_owned(),
        effects: vec!["reflection".to_owned()],
        head: Pose::IDENTITY,
        exposure: 1.0,
        plan: Plan::diffuse(),
        interfaces: Interfaces::default(),
        media: MediaBounds::default(),
        samples: SampleBudget::Samples(1),
        costs: None,
        max_still_spp: 4,
        strip_rows: 8,
        guard_rad: 0.1,
        limits: Limits::default(),
        token: token(),
    }
}

fn hello() -> Hello {
    Hello {
        capabilities: Capabilities::ALL,
        software: "harness".to_owned(),
        camera: camera(),
        viewport: Viewport::Plane,
        frame_hz: 100.0,
        format: FrameFormat::default(),
        target_kbps: 1000,
        prediction: Prediction::Adaptive,
        token: token(),
        adapt: true,
    }
}

/// What one end said, of which every byte must be a message.
fn messages(bytes: &[u8]) -> Vec<Message> {
    let mut deframer = Deframer::new(Limits::default());
    deframer.push(bytes);
    let mut all = Vec::new();
    while let Some(message) = deframer.next_message().expect("an end says only what the other understands") {
        all.push(message);
    }
    assert_eq!(deframer.pending_bytes(), 0, "whole messages");
    all
}

/// A server's session, and a renderer that takes no time.
struct Server {
    session: ServerSession,
    now: Timestamp,
    said: Vec<u8>,
}

impl Server {
    fn new() -> Server {
        Server { session: ServerSession::new(config(), Timestamp::ZERO), now: Timestamp::ZERO, said: Vec::new() }
    }

    fn pass(&mut self, duration: Duration) {
        self.now += duration;
        self.session.on_timeout(self.now);
        let next = self.session.next_timeout();
        assert!(next.micros < self.now.micros + 3600 * 1_000_000, "somebody asks again");
    }

    fn hear(&mut self, bytes: &[u8]) {
        self.session.on_bytes(self.now, bytes);
    }

    fn render(&mut self) {
        let Some(job) = self.session.poll_render(self.now) else { return };
        assert!(self.session.is_open(), "frames are for those who said hello");
        for _ in 0..2 {
            self.session.on_strip(self.now, job.begin.id, vec![7; STRIP_BYTES]);
        }
        self.session.on_render_end(self.now, job.begin.id, self.now, vec![("rays.primary".to_owned(), 1)]);
    }

    fn say(&mut self) {
        let mut out = Vec::new();
        let answers = (0..MOST_ANSWERS).take_while(|_| self.session.poll_transmit(self.now, &mut out)).count();
        assert!(answers < MOST_ANSWERS, "a session is done some time");
        for message in messages(&out) {
            let is_open = self.session.is_open() || self.session.end().is_some();
            let ends = matches!(message, Message::Error { .. } | Message::Bye);
            assert!(is_open || ends, "{:?} before a hello", message.kind());
        }
        self.said.extend_from_slice(&out);
    }
}

/// A client's session, and a display that acknowledges every frame.
struct Client {
    session: ClientSession,
    now: Timestamp,
    said: Vec<u8>,
}

impl Client {
    fn new() -> Client {
        let session = ClientSession::new(hello(), Limits::default(), Timestamp::ZERO);
        Client { session, now: Timestamp::ZERO, said: Vec::new() }
    }

    fn pass(&mut self, duration: Duration) {
        self.now += duration;
        self.session.on_timeout(self.now);
    }

    fn hear(&mut self, bytes: &[u8]) {
        self.session.on_bytes(self.now, bytes);
        let mut open = self.session.is_open() || self.session.end().is_some();
        let mut events = 0;
        while let Some(event) = self.session.poll_event() {
            events += 1;
            open |= matches!(event, Event::Welcome(_));
            assert!(open || matches!(event, Event::RoundTrip(_)), "nothing before a welcome");
            if let Event::FrameEnd(end) = event {
                self.session.acknowledge(end.id, Duration::from_millis(30), Duration::from_millis(5));
            }
        }
        assert!(events <= bytes.len() + (64 << 10), "an event has bytes");
    }

    fn say(&mut self) {
        let mut out = Vec::new();
        let answers = (0..MOST_ANSWERS).take_while(|_| self.session.poll_transmit(self.now, &mut out)).count();
        assert!(answers < MOST_ANSWERS, "a session is done some time");
        messages(&out);
        self.said.extend_from_slice(&out);
    }

    fn look(&mut self) {
        self.session.push_pose(PoseSample { time: self.now, pose: Pose::IDENTITY });
    }
}

/// What both ends said in a session of a second as it should be: up, down.
pub fn recorded() -> (Vec<u8>, Vec<u8>) {
    let (mut server, mut client) = (Server::new(), Client::new());
    let (mut up, mut down) = (0, 0);
    let number = StillRequest {
        number: 3,
        pose: Pose::IDENTITY,
        scene_time: Timestamp::ZERO,
        spp: 2,
        camera: camera(),
        with_nodes: true,
    };
    for step in 0..40 {
        client.look();
        if step == 5 {
            client.session.request_still(number);
        }
        client.say();
        server.hear(&client.said[std::mem::replace(&mut up, client.said.len())..]);
        server.render();
        server.say();
        client.hear(&server.said[std::mem::replace(&mut down, server.said.len())..]);
        server.pass(Duration::from_millis(25));
        client.pass(Duration::from_millis(25));
    }
    client.session.close();
    client.say();
    assert!(server.session.end().is_none() && server.said.len() > 1000, "a session as it should be");
    (client.said, server.said)
}

/// A peer that says `bytes`, cut into pieces of the lengths that `cut` gives, to a server.
pub fn server_hears(bytes: &[u8], mut cut: impl FnMut() -> usize) {
    let mut server = Server::new();
    let mut rest = bytes;
    while !rest.is_empty() {
        let (piece, behind) = rest.split_at(cut().clamp(1, rest.len()));
        rest = behind;
        server.hear(piece);
        server.render();
        server.say();
        server.pass(Duration::from_millis(10));
    }
    server.pass(Duration::from_secs(3));
    server.say();
    assert!(server.session.end().is_some() && server.session.poll_render(server.now).is_none());
}

/// A peer that says `bytes`, cut into pieces of the lengths that `cut` gives, to a client.
pub fn client_hears(bytes: &[u8], mut cut: impl FnMut() -> usize) {
    let mut client = Client::new();
    let mut rest = bytes;
    while !rest.is_empty() {
        let (piece, behind) = rest.split_at(cut().clamp(1, rest.len()));
        rest = behind;
        client.look();
        client.hear(piece);
        client.say();
        client.pass(Duration::from_millis(10));
    }
    client.pass(Duration::from_secs(3));
    client.say();
    assert!(client.session.end().is_some());
}

/// Steps out of the bytes of a fuzzer.
struct Script<'a>(&'a [u8]);

impl<'a> Script<'a> {
    fn byte(&mut self) -> Option<u8> {
        let (&first, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(first)
    }

    fn bytes(&mut self) -> &'a [u8] {
        let wanted = usize::from(self.byte().unwrap_or(0)) | usize::from(self.byte().unwrap_or(0) & 7) << 8;
        let (bytes, rest) = self.0.split_at(wanted.min(self.0.len()));
        self.0 = rest;
        bytes
    }

    fn number(&mut self) -> u32 {
        u32::from_le_bytes(std::array::from_fn(|_| self.byte().unwrap_or(0)))
    }

    /// With a framing that fits, so that what is inside is reached.
    fn framed(&mut self) -> Vec<u8> {
        let kind = MessageKind::ALL[usize::from(self.byte().unwrap_or(0)) % MessageKind::ALL.len()];
        let payload = self.bytes();
        let mut bytes = (payload.len() as u32 + 1).to_le_bytes().to_vec();
        bytes.push(kind as u8);
        bytes.extend_from_slice(payload);
        bytes
    }
}

fn framed(message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_message(message, &mut bytes);
    bytes
}

/// A server's session through a script.
pub fn server_script(script: &[u8]) {
    let mut script = Script(script);
    let mut server = Server::new();
    while let Some(step) = script.byte() {
        match step % 12 {
            0 => server.hear(script.bytes()),
            1 => server.hear(&script.framed()),
            2 => server.hear(&framed(&Message::Hello(hello()))),
            3 => server.pass(Duration::from_millis(u64::from(script.byte().unwrap_or(0)))),
            4 => server.pass(Duration::from_millis(u64::from(script.byte().unwrap_or(0)) * 16)),
            5 => server.render(),
            6 => drop(server.session.poll_render(server.now)),
            7 => server.say(),
            8 => server.session.on_strip(server.now, FrameId(script.number()), vec![1; STRIP_BYTES]),
            9 => server.session.on_render_end(server.now, FrameId(script.number()), server.now, Vec::new()),
            10 => {
                let ack = FrameAck {
                    id: FrameId(script.number()),
                    pose_to_ready_micros: script.number(),
                    receive_micros: script.number(),
                    decode_micros: script.number(),
                };
                server.hear(&framed(&Message::FrameAck(ack)));
            }
            _ => {
                let time = Timestamp { micros: u64::from(script.number()) };
                let count = usize::from(script.byte().unwrap_or(0));
                server.hear(&framed(&Message::Poses(vec![PoseSample { time, pose: Pose::IDENTITY }; count])));
            }
        }
    }
    server.pass(Duration::from_secs(6));
    server.say();
    assert!(server.session.end().is_some(), "silence ends every session");
}

/// A client's session through a script. Its recorded beginning opens the session where the script wants one.
pub fn client_script(script: &[u8]) {
    static RECORDED: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    let recorded = RECORDED.get_or_init(|| recorded().1);
    let mut script = Script(script);
    let mut client = Client::new();
    let mut heard = 0;
    while let Some(step) = script.byte() {
        match step % 10 {
            0 => client.hear(script.bytes()),
            1 => client.hear(&script.framed()),
            2 => {
                let until = (heard + 16 * usize::from(script.byte().unwrap_or(0))).min(recorded.len());
                client.hear(&recorded[heard..until]);
                heard = until;
            }
            3 => client.pass(Duration::from_millis(u64::from(script.byte().unwrap_or(0)))),
            4 => client.pass(Duration::from_millis(u64::from(script.byte().unwrap_or(0)) * 16)),
            5 => client.look(),
            6 => client.say(),
            7 => {
                let id = FrameId(script.number());
                let [age, decode] = [script.number(), script.number()].map(u64::from).map(Duration::from_micros);
                client.session.acknowledge(id, age, decode);
            }
            8 => client.hear(&framed(&Message::Ping(Timestamp { micros: u64::from(script.number()) }))),
            _ => client.hear(&framed(&Message::Pong(Timestamp { micros: u64::MAX - u64::from(script.number()) }))),
        }
    }
    client.pass(Duration::from_secs(6));
    client.say();
    assert!(client.session.end().is_some(), "silence ends every session");
}
