//! Messages and their stream: what is written is read, however it is cut; what is not a message is refused.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod fixed;
#[path = "../src/stability.rs"]
mod stability;

use fixed::{framed, messages};
use glam::{DQuat, DVec3};
use proptest::prelude::*;
use warplight_protocol::codec::{DecodeError, Limits};
use warplight_protocol::frame::UNDEFINED;
use warplight_protocol::message::{
    ErrorCode, FrameBegin, MAX_ERROR_TEXT_BYTES, MAX_POSE_SAMPLES, Message, MessageKind, PoseSample, VERSION,
};
use warplight_protocol::optics::Interface;
use warplight_protocol::wire::{Deframer, HEADER_BYTES, write_message};
use warplight_protocol::{Pose, Timestamp};

fn read(kind: MessageKind, payload: &[u8]) -> Result<Message, DecodeError> {
    Message::read_payload(kind, payload, &Limits::default())
}

fn read_all(deframer: &mut Deframer) -> Vec<Message> {
    std::iter::from_fn(|| deframer.next_message().unwrap()).collect()
}

fn payload(message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    message.write_payload(&mut bytes);
    bytes
}

/// Reads what a hostile peer might send; if it is a message, it can be sent on.
fn try_read(kind: MessageKind, payload: &[u8]) {
    if let Ok(message) = read(kind, payload) {
        let again = self::payload(&message);
        assert_eq!(self::payload(&read(kind, &again).unwrap()), again);
    }
}

#[test]
fn every_message_comes_back() {
    let kinds: Vec<_> = messages().iter().map(Message::kind).collect();
    assert_eq!(kinds, MessageKind::ALL);
    for message in messages() {
        assert_eq!(read(message.kind(), &payload(&message)), Ok(message));
    }
}

#[test]
fn a_stream_cut_at_any_byte_gives_the_same_messages() {
    let stream: Vec<u8> = messages().iter().flat_map(framed).collect();
    for cut in 0..=stream.len() {
        let mut deframer = Deframer::new(Limits::default());
        deframer.push(&stream[..cut]);
        let mut received = read_all(&mut deframer);
        deframer.push(&stream[cut..]);
        received.extend(read_all(&mut deframer));
        assert_eq!(received, messages());
        assert_eq!(deframer.pending_bytes(), 0);
    }
    let mut deframer = Deframer::new(Limits::default());
    let mut received = Vec::new();
    for byte in stream {
        deframer.push(&[byte]);
        received.extend(read_all(&mut deframer));
    }
    assert_eq!(received, messages());
}

#[test]
fn a_payload_cut_at_any_byte_is_refused_or_shorter() {
    for message in messages() {
        let bytes = payload(&message);
        for end in 0..bytes.len() {
            match read(message.kind(), &bytes[..end]) {
                Err(_) => {}
                // These have no length of their own: the framing's is all there is.
                Ok(Message::Poses(samples)) => assert!(samples.is_empty() && end == 0),
                Ok(Message::Strip(_) | Message::Picture(_) | Message::Error { .. }) => {}
                Ok(other) => panic!("{end} of {} bytes are {other:?}", bytes.len()),
            }
        }
        if !matches!(message, Message::Strip(_) | Message::Picture(_) | Message::Error { .. }) {
            assert!(read(message.kind(), &[&bytes[..], &[0]].concat()).is_err(), "a byte too many: {message:?}");
        }
    }
}

#[test]
fn any_flipped_bit_is_refused_or_another_message() {
    for message in messages() {
        let mut bytes = framed(&message);
        for bit in 0..bytes.len() * 8 {
            bytes[bit / 8] ^= 1 << (bit % 8);
            let mut deframer = Deframer::new(Limits::default());
            deframer.push(&bytes);
            if let Ok(Some(read)) = deframer.next_message() {
                try_read(read.kind(), &payload(&read));
            }
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_refused_or_a_message(kind in 0..14_usize, bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        try_read(MessageKind::ALL[kind], &bytes);
    }

    #[test]
    fn any_changed_bytes_are_refused_or_a_message(
        kind in 0..14_usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let mut bytes = payload(&messages()[kind]);
        for (at, value) in changes {
            if !bytes.is_empty() {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
        }
        try_read(MessageKind::ALL[kind], &bytes);
    }

    #[test]
    fn a_stream_in_any_pieces_gives_the_same_messages(sizes in prop::collection::vec(1..80_usize, 1..40)) {
        let stream: Vec<u8> = messages().iter().flat_map(framed).collect();
        let mut rest = &stream[..];
        let mut deframer = Deframer::new(Limits::default());
        let mut received = Vec::new();
        for size in sizes.into_iter().chain([usize::MAX]) {
            let (piece, behind) = rest.split_at(size.min(rest.len()));
            deframer.push(piece);
            received.extend(read_all(&mut deframer));
            rest = behind;
        }
        prop_assert_eq!(received, messages());
    }
}

#[test]
fn a_length_beyond_the_limit_is_refused_before_its_bytes_come() {
    let limits = Limits::default();
    for kind in MessageKind::ALL {
        let most = kind.max_bytes(&limits);
        for (length, is_accepted) in [(most + 1, true), (most + 2, false), (u32::MAX as usize, false), (0, false)] {
            let mut deframer = Deframer::new(limits);
            let mut header = (length as u32).to_le_bytes().to_vec();
            header.push(kind as u8);
            deframer.push(&header);
            assert_eq!(deframer.next_message().is_ok(), is_accepted, "{kind:?} of {length}");
            assert_eq!(deframer.pending_bytes(), if is_accepted { HEADER_BYTES } else { 0 });
        }
    }
}

#[test]
fn after_an_error_the_stream_is_lost() {
    let mut deframer = Deframer::new(Limits::default());
    deframer.push(&framed(&Message::Bye));
    deframer.push(&[1, 0, 0, 0, 15]);
    deframer.push(&framed(&Message::Bye));
    assert_eq!(deframer.next_message(), Ok(Some(Message::Bye)));
    for _ in 0..3 {
        let error = Err(DecodeError::Unsupported { field: "kind of message", found: 15 });
        assert_eq!(deframer.next_message(), error);
        deframer.push(&vec![0; 1 << 20]);
        assert_eq!(deframer.pending_bytes(), 0);
    }
}

#[test]
fn another_version_is_told_by_number_and_its_error_is_understood() {
    let mut bytes = payload(&messages()[0]);
    bytes[4..6].copy_from_slice(&(VERSION + 1).to_le_bytes());
    // Whatever the other version put behind its head.
    bytes.truncate(9);
    let error = read(MessageKind::Hello, &bytes).unwrap_err();
    assert_eq!(error, DecodeError::Unsupported { field: "protocol version", found: u32::from(VERSION) + 1 });
    assert_eq!(ErrorCode::from(&error), ErrorCode::Version);
    assert!(read(MessageKind::Hello, b"GET / HTTP/1.1\r\n\r\n").unwrap_err().to_string().contains("WARP"));

    let unknown = read(MessageKind::Error, &[0x77, 0x77, b'n', b'o', 0xff]).unwrap();
    assert_eq!(unknown, Message::Error { code: ErrorCode::Unknown, text: "no\u{fffd}".to_owned() });
}

/// Spoils one field of a message's payload.
fn spoiled(kind: MessageKind, at: usize, bytes: &[u8]) -> DecodeError {
    read_spoiled(kind, at, bytes).unwrap_err()
}

fn read_spoiled(kind: MessageKind, at: usize, bytes: &[u8]) -> Result<Message, DecodeError> {
    let message = messages().into_iter().find(|message| message.kind() == kind).unwrap();
    let mut payload = payload(&message);
    payload[at..at + bytes.len()].copy_from_slice(bytes);
    read(kind, &payload)
}

#[test]
fn reserved_bits_and_numbers_that_are_none_are_refused_by_name() {
    let nan = f32::NAN.to_le_bytes();
    for (kind, at, bytes, says) in [
        (MessageKind::Hello, 6, &8_u32.to_le_bytes()[..], "capability bits: 8"),
        (MessageKind::Hello, 6 + 18, &0_u32.to_le_bytes(), "camera"),
        (MessageKind::Hello, 6 + 18 + 24, &1_u32.to_le_bytes(), "camera"),
        (MessageKind::Hello, 6 + 18 + 28, &2_u32.to_le_bytes(), "hello"),
        (MessageKind::Hello, 6 + 18 + 32, &nan, "frame rate"),
        (MessageKind::Hello, 6 + 18 + 36, &9_u32.to_le_bytes(), "hello"),
        (MessageKind::Hello, 6 + 18 + 40, &3_u32.to_le_bytes(), "hello"),
        (MessageKind::Hello, 6 + 18 + 44, &2_u32.to_le_bytes(), "hello"),
        (MessageKind::Hello, 6 + 18 + 48, &[25], "format"),
        (MessageKind::Hello, 6 + 18 + 71, &4_u32.to_le_bytes(), "hello"),
        (MessageKind::Hello, 6 + 18 + 83, b" ", "token"),
        (MessageKind::Hello, 6 + 18 + 83 + 16, &[2], "hello"),
        (MessageKind::Welcome, 3, &[0x80], "capability bits"),
        (MessageKind::Welcome, 59, &f64::NAN.to_le_bytes(), "head"),
        (MessageKind::Welcome, 59 + 56, &nan, "exposure"),
        (MessageKind::StillRequest, 37, &0_u32.to_le_bytes(), "samples per pixel"),
        (MessageKind::StillRequest, 41, &0_u32.to_le_bytes(), "camera"),
        (MessageKind::StillRequest, 41 + 24, &1_u32.to_le_bytes(), "camera"),
        (MessageKind::StillRequest, 69, &[2], "still request"),
        (MessageKind::StillRequest, 28, &[0xff], "still request"),
        (MessageKind::Poses, 32, &[0xff], "pose"),
        (MessageKind::Picture, 5, &[3], "kind of picture"),
        (MessageKind::Picture, 18, &nan, "white of picture"),
        (MessageKind::FrameBegin, 4, &2_u32.to_le_bytes(), "frame begin"),
    ] {
        let error = spoiled(kind, at, bytes).to_string();
        assert!(error.contains(says), "{kind:?} at {at}: {error}");
    }
}

#[test]
fn a_frame_that_cannot_be_is_refused_at_its_head() {
    let refused = |spoil: fn(&mut FrameBegin)| {
        let Some(Message::FrameBegin(mut begin)) = messages().into_iter().nth(3) else { unreachable!() };
        spoil(&mut begin);
        read(MessageKind::FrameBegin, &payload(&Message::FrameBegin(begin))).unwrap_err()
    };
    refused(|begin| begin.shape.exposure = f32::NAN);
    refused(|begin| begin.shape.strip_rows = 0);
    refused(|begin| begin.shape.camera.size.width = 1 << 20);
    refused(|begin| begin.shape.interfaces.0 = vec![Interface::Dielectric { eta: f32::NAN }]);
    let error = refused(|begin| (begin.shape.camera.size.width, begin.shape.camera.size.height) = (8192, 8192));
    assert_eq!(error, DecodeError::LimitExceeded { limit: 4096 * 4096, requested: 8192 * 8192 });
    // The plan: a root that is its own reflection.
    assert!(
        spoiled(MessageKind::FrameBegin, 4 + 8 + 8 + 4 + 25 + 24 + 8 + 1, &[1]).to_string().contains("frame begin")
    );
}

/// Messages do not nest deeper than their types; what stands for depth is a count of things that follow.
#[test]
fn stability_decoder_of_huge_counts() {
    let mut taken = stability::bound!("decoder", "messages with a huge count that are taken", 0.0);
    for (kind, at) in [
        (MessageKind::Hello, 10),
        (MessageKind::Welcome, 4),
        (MessageKind::Welcome, 33),
        (MessageKind::Statistics, 16 + 8),
        (MessageKind::Statistics, 16 + 8 + 8 + 4 + 1 + 8 + 8 + 4),
        (MessageKind::FrameBegin, 4 + 8 + 8 + 4 + 25 + 24),
        (MessageKind::FrameBegin, 4 + 8 + 8 + 4 + 25 + 24 + 8 + 10),
    ] {
        for count in [1_u64 << 16, 1 << 40, u64::MAX] {
            taken.count(read_spoiled(kind, at, &count.to_le_bytes()).is_ok(), format!("{kind:?} {at} {count}"));
        }
    }
}

#[test]
fn of_too_many_poses_the_newest_travel_and_none_that_is_no_pose() {
    let sample = |micros: usize| PoseSample { time: Timestamp { micros: micros as u64 }, pose: Pose::IDENTITY };
    let mut samples: Vec<_> = (0..MAX_POSE_SAMPLES + 10).map(sample).collect();
    samples[12].pose.position = DVec3::NAN;
    samples[13].pose.position = DVec3::splat(40_000.0);
    samples[14].pose.orientation = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.5);
    let Ok(Message::Poses(received)) = read(MessageKind::Poses, &payload(&Message::Poses(samples.clone()))) else {
        panic!("no poses");
    };
    samples.drain(12..15);
    assert_eq!(received, samples[10..]);

    let too_many = payload(&Message::Poses(vec![sample(0)])).repeat(MAX_POSE_SAMPLES + 1);
    let limit = DecodeError::LimitExceeded { limit: MAX_POSE_SAMPLES, requested: MAX_POSE_SAMPLES + 1 };
    assert_eq!(read(MessageKind::Poses, &too_many), Err(limit));
}

#[test]
fn an_error_too_long_is_cut_between_letters() {
    let text = format!("x{}", "é".repeat(MAX_ERROR_TEXT_BYTES));
    let bytes = payload(&Message::Error { code: ErrorCode::Internal, text: text.clone() });
    let Ok(Message::Error { text: received, .. }) = read(MessageKind::Error, &bytes) else { panic!("no error") };
    assert!(text.starts_with(&received));
    assert_eq!(received.len(), MAX_ERROR_TEXT_BYTES - 1);
}

#[test]
fn the_frame_of_the_document_shows_what_was_rendered() {
    use warplight_protocol::codec::StripDecoder;
    let (shape, rendered) = (fixed::shape(), fixed::tree());
    let mut shown = rendered.clone();
    shown.nodes.iter_mut().for_each(|planes| planes.distance.fill(UNDEFINED));
    let mut decoder = StripDecoder::default();
    for (rows, strip) in shown.bands_mut(2).iter_mut().zip(fixed::strips()) {
        decoder.decode(&shape, &strip, rows).unwrap();
    }
    for (was, is) in rendered.nodes.iter().zip(&shown.nodes) {
        for (was, is) in was.distance.iter().zip(&is.distance) {
            assert!(was == is || (was - is).abs() < 1e-3 * was, "{was} {is}");
        }
    }
    assert_eq!(rendered.nodes[0].interface, shown.nodes[0].interface);
}

#[test]
fn framing_counts_the_kind_and_the_payload() {
    let mut bytes = vec![0xaa];
    write_message(&Message::Ping(Timestamp { micros: 1 }), &mut bytes);
    assert_eq!(bytes, [0xaa, 9, 0, 0, 0, 10, 1, 0, 0, 0, 0, 0, 0, 0]);
}
