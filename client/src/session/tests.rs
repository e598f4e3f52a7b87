use super::*;
use warplight_protocol::frame::FrameFormat;
use warplight_protocol::message::{Capabilities, Prediction, Viewport};
use warplight_protocol::{Camera, ImageSize, Pose, Token};

fn at(millis: u64) -> Timestamp {
    Timestamp { micros: millis * 1000 }
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

fn welcome() -> Message {
    Message::Welcome(Welcome {
        capabilities: Capabilities::ALL,
        software: "test".to_owned(),
        scene: "test".to_owned(),
        effects: vec![],
        head: Pose::IDENTITY,
        exposure: 1.0,
    })
}

fn hear(session: &mut ClientSession, now: Timestamp, message: &Message) {
    let mut bytes = Vec::new();
    write_message(message, &mut bytes);
    session.on_bytes(now, &bytes);
}

fn said(session: &mut ClientSession, now: Timestamp) -> Vec<Message> {
    let mut bytes = Vec::new();
    while session.poll_transmit(now, &mut bytes) {}
    let mut deframer = Deframer::new(Limits::default());
    deframer.push(&bytes);
    std::iter::from_fn(|| deframer.next_message().unwrap()).collect()
}

fn pose(millis: u64) -> PoseSample {
    PoseSample { time: at(millis), pose: Pose::IDENTITY }
}

#[test]
fn poses_wait_for_the_welcome_and_then_go_together() {
    let mut session = ClientSession::new(hello(), Limits::default(), at(0));
    session.push_pose(pose(1));
    session.push_pose(pose(2));
    assert!(matches!(said(&mut session, at(2))[..], [Message::Hello(_)]));
    hear(&mut session, at(3), &welcome());
    assert!(session.is_open());
    assert_eq!(said(&mut session, at(3)), [Message::Poses(vec![pose(1), pose(2)])]);
}

#[test]
fn a_link_that_takes_nothing_is_not_flooded_with_old_poses() {
    let mut session = ClientSession::new(hello(), Limits::default(), at(0));
    hear(&mut session, at(0), &welcome());
    said(&mut session, at(0));
    (0..1000).for_each(|millis| session.push_pose(pose(millis)));
    let said = said(&mut session, at(10));
    let [Message::Poses(poses)] = &said[..] else { panic!("{said:?}") };
    assert_eq!(poses.len(), 128);
    assert_eq!(poses.last(), Some(&pose(999)));
}

#[test]
fn a_ping_measures_the_round_trip() {
    let mut session = ClientSession::new(hello(), Limits::default(), at(0));
    hear(&mut session, at(0), &welcome());
    said(&mut session, at(499));
    assert_eq!(said(&mut session, at(500)), [Message::Ping(at(500))]);
    hear(&mut session, at(523), &Message::Pong(at(500)));
    session.poll_event();
    assert_eq!(session.poll_event(), Some(Event::RoundTrip(Duration::from_millis(23))));
    hear(&mut session, at(530), &Message::Ping(at(7)));
    assert_eq!(said(&mut session, at(530)), [Message::Pong(at(7))]);
}

#[test]
fn silence_ends_the_session_but_another_may_follow() {
    let mut session = ClientSession::new(hello(), Limits::default(), at(0));
    session.on_timeout(at(1999));
    assert_eq!(session.end(), None);
    session.on_timeout(at(2000));
    assert_eq!(session.end(), Some(&SessionEnd::Silent));
    assert!(!SessionEnd::Silent.is_final());
}

#[test]
fn a_refusal_is_final_and_in_words() {
    let mut session = ClientSession::new(hello(), Limits::default(), at(0));
    hear(&mut session, at(1), &Message::Error { code: ErrorCode::Version, text: "1 and 2".to_owned() });
    let end = session.end().unwrap();
    assert!(end.is_final());
    assert!(end.to_string().ends_with("1 and 2"));
}

#[test]
fn a_server_that_heard_nothing_is_tried_again() {
    let mut session = ClientSession::new(hello(), Limits::default(), at(0));
    hear(&mut session, at(1), &Message::Error { code: ErrorCode::Timeout, text: "nothing heard".to_owned() });
    assert!(!session.end().unwrap().is_final());
}

#[test]
fn what_a_server_must_not_say_ends_the_session() {
    for message in [Message::Hello(hello()), Message::Statistics(Statistics::default()), Message::Poses(vec![])] {
        let mut session = ClientSession::new(hello(), Limits::default(), at(0));
        hear(&mut session, at(0), &message);
        assert!(matches!(session.end(), Some(SessionEnd::Decode(_))));
    }
}
