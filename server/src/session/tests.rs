use super::*;
use crate::march::MediaBounds;
use warplight_protocol::frame::{ColorFormat, Interfaces, Plan};
use warplight_protocol::message::{ErrorCode, FrameAck, PoseSample, Prediction, VERSION, Viewport};
use warplight_protocol::wire::write_message;
use warplight_protocol::{Camera, ImageSize, Token};

mod refusals;

fn config() -> SessionConfig {
    SessionConfig {
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
        strip_rows: 16,
        guard_rad: 0.0,
        limits: Limits::default(),
        token: Token::NONE,
    }
}

fn hello() -> Hello {
    Hello {
        capabilities: Capabilities::ALL,
        software: "test".to_owned(),
        camera: Camera::symmetric(1.0, ImageSize::new(16, 16)),
        viewport: Viewport::Plane,
        frame_hz: 10.0,
        format: FrameFormat::default(),
        target_kbps: 0,
        prediction: Prediction::Damped,
        token: Token::NONE,
        adapt: false,
    }
}

fn ack(id: FrameId, pose_to_ready_micros: u32) -> FrameAck {
    FrameAck { id, pose_to_ready_micros, receive_micros: 0, decode_micros: 0 }
}

fn at(millis: u64) -> Timestamp {
    Timestamp { micros: millis * 1000 }
}

fn say(session: &mut ServerSession, now: Timestamp, message: Message) {
    let mut bytes = Vec::new();
    write_message(&message, &mut bytes);
    session.on_bytes(now, &bytes);
}

fn pose(session: &mut ServerSession, now: Timestamp) {
    say(session, now, Message::Poses(vec![PoseSample { time: now, pose: Pose::IDENTITY }]));
}

fn heard(session: &mut ServerSession, now: Timestamp) -> Vec<Message> {
    let mut bytes = Vec::new();
    while session.poll_transmit(now, &mut bytes) {}
    let mut deframer = Deframer::new(Limits::default());
    deframer.push(&bytes);
    std::iter::from_fn(|| deframer.next_message().unwrap()).collect()
}

fn render(session: &mut ServerSession, now: Timestamp) -> Option<FrameId> {
    let id = session.poll_render(now)?.begin.id;
    session.on_strip(now, id, vec![7; 5]);
    session.on_render_end(now, id, now, vec![]);
    Some(id)
}

fn open() -> ServerSession {
    let mut session = ServerSession::new(config(), at(0));
    say(&mut session, at(0), Message::Hello(hello()));
    assert!(matches!(heard(&mut session, at(0))[..], [Message::Welcome(_)]));
    session
}

#[test]
fn a_frame_is_rendered_only_for_a_new_pose_and_not_faster_than_asked() {
    let mut session = open();
    assert_eq!(render(&mut session, at(1)), None, "no pose yet");
    pose(&mut session, at(2));
    assert_eq!(render(&mut session, at(2)), Some(FrameId(1)));
    pose(&mut session, at(3));
    assert_eq!(render(&mut session, at(3)), None, "10 Hz");
    assert_eq!(render(&mut session, at(102)), Some(FrameId(2)));
    assert_eq!(render(&mut session, at(300)), None, "the same pose again");
}

#[test]
fn the_latest_frame_replaces_one_that_was_not_sent() {
    let mut session = open();
    for frame in 0..6 {
        pose(&mut session, at(100 * frame + 1));
        assert!(render(&mut session, at(100 * frame + 1)).is_some());
    }
    let begun: Vec<_> =
        heard(&mut session, at(501)).into_iter().filter(|message| matches!(message, Message::FrameBegin(_))).collect();
    assert!(matches!(&begun[..], [Message::FrameBegin(begin)] if begin.id == FrameId(6)), "{begun:?}");
    assert_eq!(session.statistics.frames_replaced, 5);
}

#[test]
fn two_frames_may_be_unacknowledged_and_no_more() {
    let mut session = open();
    let mut begun = Vec::new();
    for frame in 0..4 {
        pose(&mut session, at(100 * frame));
        render(&mut session, at(100 * frame));
        begun.extend(heard(&mut session, at(100 * frame)).into_iter().filter_map(|message| match message {
            Message::FrameBegin(begin) => Some(begin.id),
            _ => None,
        }));
    }
    assert_eq!(begun, [FrameId(1), FrameId(2)]);
    say(&mut session, at(400), Message::FrameAck(ack(FrameId(1), 50_000)));
    assert!(
        heard(&mut session, at(400))
            .iter()
            .any(|message| matches!(message, Message::FrameBegin(begin) if begin.id == FrameId(4)))
    );
}

#[test]
fn the_measured_latency_is_predicted_ahead_up_to_a_tenth_of_a_second() {
    let mut session = open();
    pose(&mut session, at(0));
    render(&mut session, at(0));
    heard(&mut session, at(0));
    say(&mut session, at(90), Message::FrameAck(ack(FrameId(1), 60_000)));
    pose(&mut session, at(100));
    assert_eq!(session.poll_render(at(100)).unwrap().begin.horizon_micros, 60_000);
    session.on_render_end(at(101), FrameId(2), at(101), vec![]);
    session.latency_secs = 9.0;
    pose(&mut session, at(200));
    let begin = session.poll_render(at(200)).unwrap().begin;
    assert_eq!(begin.horizon_micros, 100_000);
    // The scene is known ahead, the head is not.
    assert_eq!(begin.scene_time, begin.pose_time + MAX_SCENE_HORIZON);
}

#[test]
fn strips_leave_before_the_frame_is_whole() {
    let mut session = open();
    pose(&mut session, at(0));
    let id = session.poll_render(at(0)).unwrap().begin.id;
    assert!(heard(&mut session, at(0)).is_empty());
    session.on_strip(at(5), id, vec![1]);
    assert!(matches!(heard(&mut session, at(5))[..], [Message::FrameBegin(_), Message::Strip(_)]));
    session.on_strip(at(9), id, vec![2]);
    session.on_render_end(at(9), id, at(8), vec![("rays.primary".to_owned(), 3)]);
    let last = heard(&mut session, at(10));
    let [Message::Strip(_), Message::FrameEnd(end), Message::Statistics(statistics)] = &last[..] else {
        panic!("{last:?}");
    };
    assert_eq!((end.render_start, end.render_end, end.encoded, end.sent), (at(0), at(8), at(9), at(10)));
    assert_eq!(statistics.frames_sent, 1);
    assert_eq!(statistics.counters, [("rays.primary".to_owned(), 3)]);
}

fn still(spp: u32) -> StillRequest {
    let camera = Camera::symmetric(0.7, ImageSize::new(16, 8));
    StillRequest { number: 3, pose: Pose::IDENTITY, scene_time: at(7), spp, camera, with_nodes: false }
}

#[test]
fn a_still_has_its_own_camera_and_the_nodes_of_live_frames_where_they_are_asked_for() {
    let mut session = open();
    session.config.plan = Plan::mirror();
    let request = StillRequest { with_nodes: true, ..still(1) };
    say(&mut session, at(1), Message::StillRequest(request));
    let shape = session.poll_render(at(1)).unwrap().begin.shape;
    assert_eq!((shape.camera, shape.plan), (request.camera, Plan::mirror()));
    assert_eq!(shape.format.color, ColorFormat::Half);
}

#[test]
fn a_still_larger_than_the_limits_ends_the_session() {
    let mut session = open();
    let camera = Camera::symmetric(0.7, ImageSize::new(8192, 8192));
    say(&mut session, at(1), Message::StillRequest(StillRequest { camera, ..still(1) }));
    assert!(
        matches!(session.end(), Some(SessionEnd::Decode(DecodeError::LimitExceeded { .. }))),
        "{:?}",
        session.end()
    );
}

#[test]
fn a_still_is_rendered_when_no_live_frame_is_due() {
    let mut session = open();
    say(&mut session, at(1), Message::StillRequest(still(1_000_000)));
    let job = session.poll_render(at(1)).unwrap();
    assert_eq!(job.begin.purpose, FramePurpose::Still(3));
    assert_eq!(job.begin.scene_time, at(7));
    assert_eq!(job.spp, 16, "the server's limit");
    assert_eq!(job.begin.shape.plan, Plan::diffuse());
    assert_eq!(job.begin.shape.format.color, ColorFormat::Half);
}

#[test]
fn a_still_is_never_replaced() {
    let mut session = open();
    say(&mut session, at(1), Message::StillRequest(still(4)));
    render(&mut session, at(1)).unwrap();
    pose(&mut session, at(2));
    assert_eq!(render(&mut session, at(2)), None, "the still has not left");
    assert!(matches!(
        heard(&mut session, at(3))[..],
        [Message::FrameBegin(_), Message::Strip(_), Message::FrameEnd(_), Message::Statistics(_)]
    ));
    assert!(render(&mut session, at(3)).is_some());
}

#[test]
fn silence_ends_the_session_and_pings_prevent_it() {
    let mut session = open();
    assert!(heard(&mut session, at(499)).is_empty());
    assert!(matches!(heard(&mut session, at(500))[..], [Message::Ping(_)]));
    session.on_timeout(at(1999));
    assert_eq!(session.end(), None);
    say(&mut session, at(1999), Message::Pong(at(500)));
    session.on_timeout(at(3998));
    assert_eq!(session.end(), None);
    session.on_timeout(at(3999));
    assert_eq!(session.end(), Some(&SessionEnd::Silent));
}

#[test]
fn another_version_is_told_both_versions() {
    let mut session = ServerSession::new(config(), at(0));
    let mut bytes = Vec::new();
    write_message(&Message::Hello(hello()), &mut bytes);
    bytes[9] = 77;
    session.on_bytes(at(0), &bytes);
    let answer = heard(&mut session, at(0));
    let [Message::Error { code: ErrorCode::Version, text }] = &answer[..] else { panic!("{answer:?}") };
    assert!(text.contains(&format!("version {VERSION} ")) && text.contains("version 77"), "{text}");
    assert!(session.end().is_some());
}

#[test]
fn what_a_client_must_not_say_ends_the_session() {
    for (first, message) in [
        (None, Message::Ping(at(0))),
        (Some(hello()), Message::Hello(hello())),
        (Some(hello()), Message::Statistics(Statistics::default())),
    ] {
        let mut session = ServerSession::new(config(), at(0));
        if let Some(hello) = first {
            say(&mut session, at(0), Message::Hello(hello));
        }
        say(&mut session, at(0), message);
        assert!(matches!(session.end(), Some(SessionEnd::Decode(_))));
        assert!(matches!(heard(&mut session, at(0)).last(), Some(Message::Error { .. })));
    }
}

/// Frames of 10 Hz for a head that turns left at `rad_per_s`, each ready after 60 ms.
fn sizes_of_turning_frames(config: SessionConfig, rad_per_s: f64) -> Vec<Camera> {
    let mut session = ServerSession::new(config, at(0));
    let hello = Hello { camera: Camera::symmetric(1.0, ImageSize::new(256, 256)), ..hello() };
    say(&mut session, at(0), Message::Hello(hello));
    let mut cameras = Vec::new();
    for step in 0..100_u64 {
        let now = at(10 * step);
        let orientation = glam::DQuat::from_rotation_y(rad_per_s * 0.01 * step as f64);
        let pose = Pose { orientation, ..Pose::IDENTITY };
        say(&mut session, now, Message::Poses(vec![PoseSample { time: now, pose }]));
        let Some(job) = session.poll_render(now) else { continue };
        cameras.push(job.begin.shape.camera);
        session.on_strip(now, job.begin.id, vec![7; 5]);
        session.on_render_end(now, job.begin.id, now, vec![]);
        heard(&mut session, now);
        say(&mut session, now, Message::FrameAck(ack(job.begin.id, 60_000)));
    }
    cameras
}

#[test]
fn a_head_that_turns_is_sent_more_on_the_side_that_it_turns_to() {
    let config = SessionConfig { guard_rad: 0.2, ..config() };
    let display = Camera::symmetric(1.0, ImageSize::new(256, 256));
    let cameras = sizes_of_turning_frames(config.clone(), 1.0);
    let [left, _] = display.offset_in(cameras.last().unwrap()).unwrap();
    let right = cameras.last().unwrap().size.width - 256 - left;
    // 60 + 100 ms less the 52 ms that the damped prediction is worth, at 1 rad/s: 0.108 rad or some 33 px at the edge.
    assert!((32..=48).contains(&left) && right <= 32 && right < left, "{left} and {right}");
    assert!(sizes_of_turning_frames(config, 0.0).iter().all(|camera| *camera == display), "at rest");
    let off = SessionConfig { guard_rad: 0.0, ..self::config() };
    assert!(sizes_of_turning_frames(off, 1.0).iter().all(|camera| *camera == display), "switched off");
}

#[test]
fn a_band_beyond_the_limits_is_left_out() {
    let limits = Limits { frame_pixels: 256 * 256 + 100, ..Limits::default() };
    let config = SessionConfig { guard_rad: 0.2, limits, ..config() };
    let display = Camera::symmetric(1.0, ImageSize::new(256, 256));
    assert!(sizes_of_turning_frames(config, 1.0).iter().all(|camera| *camera == display));
}

#[test]
fn a_client_that_asks_for_cubes_gets_them_along_the_axes_of_the_world_and_flat_stills() {
    let mut session = ServerSession::new(SessionConfig { guard_rad: 0.2, ..config() }, at(0));
    say(&mut session, at(0), Message::Hello(Hello { viewport: Viewport::Cube, ..hello() }));
    let orientation = glam::DQuat::from_rotation_y(0.7);
    let head = Pose { position: glam::DVec3::new(1.0, 2.0, 3.0), orientation };
    // As it travels.
    let head = Pose::from_wire(&head.to_wire().unwrap()).unwrap();
    say(&mut session, at(1), Message::Poses(vec![PoseSample { time: at(1), pose: head }]));
    let job = session.poll_render(at(1)).unwrap();
    assert_eq!(job.begin.shape.camera, Camera::cube(&hello().camera, u32::MAX));
    assert_eq!(job.begin.render_pose, Pose { orientation: glam::DQuat::IDENTITY, ..head });
    session.on_strip(at(1), job.begin.id, vec![7; 5]);
    session.on_render_end(at(1), job.begin.id, at(1), vec![]);
    heard(&mut session, at(1));
    let request =
        StillRequest { number: 1, pose: head, scene_time: at(1), spp: 1, camera: hello().camera, with_nodes: false };
    say(&mut session, at(2), Message::StillRequest(request));
    let still = session.poll_render(at(2)).unwrap().begin;
    assert_eq!((still.shape.camera, still.render_pose), (hello().camera, head));
}

#[test]
fn a_cube_beyond_the_limits_is_coarser_and_one_that_cannot_be_is_refused() {
    let opened = |frame_pixels: usize| {
        let limits = Limits { frame_pixels, ..Limits::default() };
        let mut session = ServerSession::new(SessionConfig { limits, ..config() }, at(0));
        let camera = Camera::symmetric(1.0, ImageSize::new(48, 48));
        say(&mut session, at(0), Message::Hello(Hello { viewport: Viewport::Cube, camera, ..hello() }));
        (session.cube, session.end)
    };
    let wanted = Camera::cube(&Camera::symmetric(1.0, ImageSize::new(48, 48)), u32::MAX);
    assert_eq!(opened(1 << 24), (wanted, None));
    let (coarser, end) = opened(6 * 64 * 64);
    assert_eq!((coarser.size, end), (ImageSize::new(64, 384), None));
    assert!(matches!(opened(6 * 31 * 31).1, Some(SessionEnd::Decode(DecodeError::LimitExceeded { .. }))));
}

fn video_hello() -> Hello {
    let color_coding = ColorCoding::Video { quantiser: 30 };
    Hello { format: FrameFormat { color_coding, ..FrameFormat::default() }, ..hello() }
}

fn open_video() -> ServerSession {
    let mut session = ServerSession::new(config(), at(0));
    say(&mut session, at(0), Message::Hello(video_hello()));
    assert!(matches!(heard(&mut session, at(0))[..], [Message::Welcome(_)]));
    session
}

fn render_pictures(session: &mut ServerSession, now: Timestamp) -> FrameId {
    pose(session, now);
    let job = session.poll_render(now).unwrap();
    session.on_strip(now, job.begin.id, vec![7; 5]);
    session.on_pictures(job.begin.id, RenderedPictures::default());
    session.on_render_end(now, job.begin.id, now, vec![]);
    job.begin.id
}

fn picture(frame: FrameId) -> PictureMessage {
    use warplight_protocol::codec::PlaneKind;
    use warplight_protocol::video::{Canvas, PictureHead, Placement};
    let placement = Placement { canvas: Canvas { width: 16, height: 16 }, x: 0, y: 0 };
    let head = PictureHead { frame, node: 0, kind: PlaneKind::Radiance, reference: None, placement, white: 1.0 };
    PictureMessage { head, bytes: vec![1, 2, 3] }
}

#[test]
fn pictures_are_encoded_when_their_frame_is_being_sent_and_stand_before_its_end() {
    let mut session = open_video();
    let frame = render_pictures(&mut session, at(1));
    assert!(session.poll_encode(at(0)).is_none(), "nothing of it has left");
    let messages = heard(&mut session, at(2));
    assert!(matches!(&messages[..], [Message::FrameBegin(_), Message::Strip(_)]), "{messages:?}");
    let job = session.poll_encode(at(0)).unwrap();
    assert_eq!((job.frame, job.quantiser), (frame, 30));
    assert!(session.poll_encode(at(0)).is_none(), "once");
    assert!(heard(&mut session, at(3)).is_empty(), "no end without its pictures");
    session.on_encoded(at(4), frame, vec![picture(frame)]);
    let messages = heard(&mut session, at(5));
    let [Message::Picture(sent), Message::FrameEnd(end), Message::Statistics(_)] = &messages[..] else {
        panic!("{messages:?}")
    };
    assert_eq!(sent, &picture(frame));
    assert_eq!((end.encoded, end.sent), (at(4), at(5)));
}

/// What is encoded is sent: otherwise the next picture would be predicted from one that nobody has.
#[test]
fn over_a_slow_link_a_frame_that_is_replaced_was_never_encoded() {
    let mut session = open_video();
    let (mut encoded, mut ended) = (Vec::new(), Vec::new());
    let mut bytes = Vec::new();
    let mut deframer = Deframer::new(Limits::default());
    for step in 0..60 {
        let now = at(50 * step + 1);
        if step % 2 == 0 {
            render_pictures(&mut session, now);
        }
        // A message every 50 ms: a frame of four and its statistics take as long as two and a half to render.
        bytes.clear();
        session.poll_transmit(now, &mut bytes);
        deframer.push(&bytes);
        if let Some(job) = session.poll_encode(at(0)) {
            encoded.push(job.frame);
            session.on_encoded(now, job.frame, vec![picture(job.frame)]);
        }
        if let Some(Message::FrameEnd(end)) = deframer.next_message().unwrap() {
            ended.push(end.id);
            say(&mut session, now, Message::FrameAck(ack(end.id, 50_000)));
        }
    }
    assert!(session.statistics.frames_replaced > 10, "{:?}", session.statistics);
    assert!(ended.len() > 8, "{ended:?}");
    assert!(encoded.len() - ended.len() <= 1, "the last may be under way: {encoded:?}, {ended:?}");
    assert_eq!(encoded[..ended.len()], ended);
    assert!(encoded.windows(2).all(|pair| pair[0] < pair[1]));
}

#[test]
fn stills_have_no_pictures() {
    let mut session = open_video();
    let (camera, pose) = (hello().camera, Pose::IDENTITY);
    let request = StillRequest { number: 1, pose, scene_time: at(0), spp: 1, camera, with_nodes: true };
    say(&mut session, at(1), Message::StillRequest(request));
    let job = session.poll_render(at(1)).unwrap();
    assert!(job.begin.shape.pictures().is_empty());
    assert_eq!(job.begin.shape.check(&Limits::default()), Ok(()));
}
