//! A session over a link that carries so much, in steps of a millisecond; a frame is as many bytes as its pixels and its
//! coding say.

use super::super::*;
use crate::march::MediaBounds;
use std::collections::BTreeMap;
use warplight_protocol::codec::FrameShape;
use warplight_protocol::frame::{DepthFormat, Interfaces, Plan, VolumeFormat};
use warplight_protocol::message::{FrameAck, LimiterKind, PoseSample, Prediction};
use warplight_protocol::wire::write_message;
use warplight_protocol::{Camera, ImageSize};

const SIDE: u32 = 128;
const RENDER: u64 = 30;
const LATENCY: u64 = 10;

/// What the world is like.
struct World {
    adapt: bool,
    target_kbps: u32,
    /// Bits per second at a time in milliseconds.
    carries: fn(u64) -> f64,
    decode_ns_per_px: f64,
}

/// A link that never is the limit, and a client that decodes in no time.
const FAST: World = World { adapt: true, target_kbps: 0, carries: |_| 1e9, decode_ns_per_px: 0.0 };

/// A frame that was ready to be shown.
#[derive(Clone, Debug)]
struct Shown {
    at: u64,
    age: u64,
    bytes: u64,
    shape: FrameShape,
}

/// Bits per pixel of exact colour and depth, and of colour within an error: a bit of each sample wherever it doubles.
fn bits_per_px(format: &FrameFormat) -> f64 {
    let color = match format.color_coding {
        ColorCoding::Bounded { error } => 16.0 * (1.0 - (2.0 * f64::from(error) + 1.0).log2() / 8.0),
        _ => 16.0,
    };
    color + if matches!(format.depth, DepthFormat::Codes { .. }) { 2.0 } else { 0.4 }
}

/// What the client asks for: exact colours and codes of depth, whatever the default.
fn asked() -> FrameFormat {
    FrameFormat::exact()
}

/// Bits per second of a session that is not limited.
fn needed() -> f64 {
    10.0 * f64::from(SIDE * SIDE) * bits_per_px(&asked())
}

fn at(millis: u64) -> Timestamp {
    Timestamp { micros: 1000 * millis }
}

fn session(world: &World) -> ServerSession {
    let config = SessionConfig {
        scene: "test".to_owned(),
        effects: vec![],
        head: Pose::IDENTITY,
        exposure: 1.0,
        plan: Plan::diffuse(),
        interfaces: Interfaces::default(),
        media: MediaBounds::default(),
        samples: SampleBudget::Samples(1),
        costs: None,
        max_still_spp: 16,
        strip_rows: 32,
        guard_rad: 0.0,
        limits: Limits::default(),
        token: Token::NONE,
    };
    let hello = Hello {
        capabilities: Capabilities::ALL,
        software: "test".to_owned(),
        camera: Camera::symmetric(1.0, ImageSize::new(SIDE, SIDE)),
        viewport: Viewport::Plane,
        frame_hz: 10.0,
        format: asked(),
        target_kbps: world.target_kbps,
        prediction: Prediction::Damped,
        token: Token::NONE,
        adapt: world.adapt,
    };
    let mut session = ServerSession::new(config, at(0));
    say(&mut session, at(0), Message::Hello(hello));
    session
}

fn say(session: &mut ServerSession, now: Timestamp, message: Message) {
    let mut bytes = Vec::new();
    write_message(&message, &mut bytes);
    session.on_bytes(now, &bytes);
}

/// Lets a session run for so many milliseconds.
fn run(world: &World, millis: u64) -> (ServerSession, Vec<Shown>) {
    let mut session = session(world);
    let (mut rendering, mut wire_free_ms) = (None, 0.0_f64);
    let mut down: VecDeque<(u64, Message)> = VecDeque::new();
    let mut up: BTreeMap<u64, Vec<Message>> = BTreeMap::new();
    let (mut arriving, mut decoder_free, mut shown) = (None, 0, Vec::new());
    for now in 1..=millis {
        if now % 10 == 0 {
            let sample = PoseSample { time: at(now), pose: Pose::IDENTITY };
            up.entry(now + LATENCY).or_default().push(Message::Poses(vec![sample]));
        }
        for message in up.remove(&now).unwrap_or_default() {
            say(&mut session, at(now), message);
        }
        if let Some((_, job)) = rendering.take_if(|(done, _)| *done <= now) {
            let job: RenderJob = job;
            let shape = &job.begin.shape;
            let bytes = shape.camera.size.pixels() as f64 * bits_per_px(&shape.format) / 8.0;
            let strips = shape.strips();
            for _ in 0..strips {
                session.on_strip(at(now), job.begin.id, vec![0; (bytes / strips as f64) as usize]);
            }
            session.on_render_end(at(now), job.begin.id, at(now), vec![]);
        }
        if let Some(job) = session.poll_render(at(now)) {
            rendering = Some((now + RENDER, job));
        }
        let mut bytes = Vec::new();
        while wire_free_ms <= now as f64 + 5.0 && session.poll_transmit(at(now), &mut bytes) {
            wire_free_ms = wire_free_ms.max(now as f64) + bytes.len() as f64 * 8e3 / (world.carries)(now);
            let mut deframer = Deframer::new(Limits::default());
            deframer.push(&bytes);
            let message = deframer.next_message().unwrap().unwrap();
            down.push_back((wire_free_ms.ceil() as u64 + LATENCY, message));
            bytes.clear();
        }
        while let Some((_, message)) = down.pop_front_if(|(arrival, _)| *arrival <= now) {
            match message {
                Message::FrameBegin(begin) => arriving = Some((begin, now, 0)),
                Message::Strip(strip) => arriving.as_mut().unwrap().2 += strip.bytes.len() as u64,
                Message::FrameEnd(end) => {
                    let (begin, since, bytes) = arriving.take().unwrap();
                    let decode = (world.decode_ns_per_px * 1e-6 * begin.shape.camera.size.pixels() as f64) as u64;
                    // One after the other.
                    decoder_free = now.max(decoder_free) + decode;
                    let age = decoder_free - begin.pose_time.micros / 1000;
                    let ack = FrameAck {
                        id: end.id,
                        pose_to_ready_micros: 1000 * age as u32,
                        receive_micros: 1000 * (now - since) as u32,
                        decode_micros: 1000 * decode as u32,
                    };
                    up.entry(decoder_free + LATENCY).or_default().push(Message::FrameAck(ack));
                    shown.push(Shown { at: decoder_free, age, bytes, shape: begin.shape });
                }
                Message::Ping(time) => up.entry(now + LATENCY).or_default().push(Message::Pong(time)),
                _ => {}
            }
        }
    }
    assert_eq!(session.end(), None);
    (session, shown)
}

fn is_whole(shown: &Shown) -> bool {
    let asked = asked();
    let format = &shown.shape.format;
    shown.shape.camera.size == ImageSize::new(SIDE, SIDE)
        && (format.color_coding, format.depth) == (asked.color_coding, asked.depth)
}

fn limiter(session: &ServerSession, kind: LimiterKind) -> Option<&warplight_protocol::message::Limiter> {
    session.statistics.limiters.iter().find(|limiter| limiter.kind == kind)
}

fn ages(shown: &[Shown], from: u64, to: u64) -> Vec<u64> {
    let mut ages: Vec<u64> =
        shown.iter().filter(|frame| (from..to).contains(&frame.at)).map(|frame| frame.age).collect();
    ages.sort_unstable();
    ages
}

#[test]
fn a_link_that_is_fast_enough_changes_nothing() {
    // Half of it is used, then nearly all of it.
    for carries in [FAST.carries, |_| 2.0 * needed(), |_| 1.15 * needed()] {
        let (session, with) = run(&World { carries, ..FAST }, 20_000);
        let (_, without) = run(&World { carries, adapt: false, ..FAST }, 20_000);
        assert!(with.iter().all(is_whole));
        assert_eq!(with.len(), without.len());
        assert!(session.statistics.limiters.is_empty(), "{:?}", session.statistics.limiters);
    }
}

#[test]
fn over_a_quarter_of_what_frames_need_they_are_made_to_fit_and_stay_young() {
    let world = World { carries: |_| 0.25 * needed(), ..FAST };
    let (session, with) = run(&world, 60_000);
    let (_, without) = run(&World { adapt: false, ..world }, 60_000);
    // What fits: a frame rendered, sent in the time until the next, at half the rate; and what it waits for its turn.
    let (with_ages, without_ages) = (ages(&with, 10_000, 60_000), ages(&without, 10_000, 60_000));
    let [median, median_without] = [&with_ages, &without_ages].map(|ages| ages[ages.len() / 2]);
    eprintln!(
        "median age {median} ms, without {median_without} ms, oldest {:?}, {} and {} frames",
        with_ages.last(),
        with.len(),
        without.len()
    );
    assert!(3 * median < 2 * median_without, "{median} of {median_without}");
    assert!(*with_ages.last().unwrap() < 2 * 200 + 200 + LATENCY * 2, "{:?}", with_ages.last());
    let bytes: u64 = with.iter().filter(|frame| frame.at >= 10_000).map(|frame| frame.bytes).sum();
    let used = bytes as f64 * 8.0 / 50.0 / (0.25 * needed());
    assert!((0.6..1.0).contains(&used), "{used} of the link");
    assert!(with.len() > 3 * without.len() / 2, "{} frames, {}", with.len(), without.len());
    let throughput = limiter(&session, LimiterKind::Throughput).unwrap();
    assert!(throughput.is_active && throughput.active_micros > 50_000_000, "{throughput:?}");
    assert!(throughput.why.starts_with("the link carries "), "{}", throughput.why);
    assert_eq!(session.statistics.limiters.len(), 1, "{:?}", session.statistics.limiters);
    assert!(session.adaptation.changes() <= 12, "{} changes of level", session.adaptation.changes());
}

#[test]
fn what_was_given_up_comes_back_within_seconds_of_the_link() {
    let world =
        World { carries: |now| if (10_000..30_000).contains(&now) { 0.25 * needed() } else { 4.0 * needed() }, ..FAST };
    let (session, shown) = run(&world, 60_000);
    assert!(shown.iter().filter(|frame| frame.at < 10_000).all(is_whole));
    assert!(shown.iter().filter(|frame| (15_000..30_000).contains(&frame.at)).all(|frame| !is_whole(frame)));
    let back = shown.iter().rev().take_while(|frame| is_whole(frame)).last().unwrap().at;
    eprintln!("whole again {} ms after the link", back - 30_000);
    assert!(back < 45_000, "whole again at {back} ms");
    let last = &shown[shown.len() - 10..];
    assert!(last.windows(2).all(|pair| (95..=105).contains(&(pair[1].at - pair[0].at))), "and as often");
    assert!(!limiter(&session, LimiterKind::Throughput).unwrap().is_active);
    assert!(session.adaptation.changes() <= 16, "{} changes of level", session.adaptation.changes());
}

#[test]
fn a_stall_now_and_then_is_no_slow_link() {
    let carries = |now| if now > 5000 && now % 5000 < 400 { 0.1 * needed() } else { 20.0 * needed() };
    let (session, shown) = run(&World { carries, ..FAST }, 40_000);
    assert!(shown.iter().all(is_whole));
    assert!(limiter(&session, LimiterKind::Throughput).is_none(), "{:?}", session.statistics.limiters);
}

#[test]
fn a_client_that_decodes_slowly_gets_fewer_and_then_smaller_frames() {
    // 150 ms for a frame, of which there were to be ten a second.
    let world = World { decode_ns_per_px: 150e6 / f64::from(SIDE * SIDE), ..FAST };
    let (session, shown) = run(&world, 40_000);
    let decode = limiter(&session, LimiterKind::DecodeTime).unwrap();
    assert!(decode.is_active && decode.why.contains("decodes a frame for 150 ms"), "{decode:?}");
    assert!(limiter(&session, LimiterKind::Throughput).is_none(), "the link is not to blame: {:?}", session.statistics);
    let late = ages(&shown, 10_000, 40_000);
    // Rendered, decoded, and nothing waits for the decoder.
    assert!(*late.last().unwrap() < 150 + RENDER + 2 * LATENCY + 30, "{:?}", late.last());
    let slower = World { decode_ns_per_px: 4.0 * world.decode_ns_per_px, ..FAST };
    let (_, shown) = run(&slower, 40_000);
    assert!(shown.last().unwrap().shape.camera.size.width < SIDE);
}

#[test]
fn a_target_is_the_clients_and_exact_colour_stays_exact_for_it() {
    let world = World { target_kbps: (0.5e-3 * needed()) as u32, ..FAST };
    let (session, shown) = run(&world, 20_000);
    assert!(shown.iter().all(is_whole));
    assert!(limiter(&session, LimiterKind::Throughput).is_none());
}

#[test]
fn levels_are_cameras_of_the_same_view() {
    let display = Camera::symmetric(1.2, ImageSize::new(640, 480));
    for level in super::LEVELS {
        let camera = level.camera(&display);
        assert!(camera.is_valid() && camera.fov == display.fov);
        assert!((f64::from(camera.size.width) / 640.0 - level.scale).abs() < 1e-3);
        assert_eq!(level.volume(VolumeFormat::NONE).layers, 0);
        assert!(level.volume(VolumeFormat { layers: 1, ..VolumeFormat::default() }).layers == 1, "never none");
    }
    assert!(super::LEVELS.windows(2).all(|pair| pair[1].part() <= pair[0].part()));
}
