//! However a stream is cut and in whichever order its strips are decoded: the same messages, the same tree.

#![no_main]

use arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;
use warplight_protocol::frame::FrameId;
use warplight_protocol::message::{FrameBegin, FramePurpose, Message, StripMessage};
use warplight_protocol::wire::{Deframer, write_message};
use warplight_protocol::{Pose, Timestamp};
use warplight_protocol_fuzz::{LIMITS, decode, encode, shape, tree};

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let shape = shape(&mut u)?;
    let cuts: Vec<u16> = (0..8).map(|_| u.arbitrary()).collect::<Result<_>>()?;
    let swaps: Vec<(u8, u8)> = (0..4).map(|_| u.arbitrary()).collect::<Result<_>>()?;
    let mut tree = tree(&shape, &mut u)?;
    let frame = FrameId(7);
    let mut messages = vec![
        Message::Ping(Timestamp { micros: 5 }),
        Message::FrameBegin(FrameBegin {
            id: frame,
            purpose: FramePurpose::Live,
            pose_time: Timestamp::ZERO,
            horizon_micros: 20_000,
            scene_time: Timestamp { micros: 20_000 },
            render_pose: Pose::IDENTITY,
            shape: shape.clone(),
        }),
    ];
    messages.extend(encode(&shape, &mut tree).into_iter().map(|bytes| Message::Strip(StripMessage { frame, bytes })));
    messages.push(Message::Bye);
    let mut stream = Vec::new();
    messages.iter().for_each(|message| write_message(message, &mut stream));

    // The stream in pieces.
    let mut ends: Vec<usize> = cuts.iter().map(|&cut| usize::from(cut) % (stream.len() + 1)).collect();
    ends.push(stream.len());
    ends.sort_unstable();
    let mut deframer = Deframer::new(LIMITS);
    let mut received = Vec::new();
    let mut start = 0;
    for end in ends {
        deframer.push(&stream[start..end]);
        start = end;
        while let Some(message) = deframer.next_message().expect("own messages") {
            received.push(message);
        }
    }
    assert_eq!(received, messages);
    assert_eq!(deframer.pending_bytes(), 0);

    // The strips in another order.
    let strip = |message| if let Message::Strip(strip) = message { Some(strip.bytes) } else { None };
    let mut strips: Vec<Vec<u8>> = received.into_iter().filter_map(strip).collect();
    let in_order = decode(&shape, strips.iter().map(Vec::as_slice)).expect("own bytes");
    let count = strips.len();
    swaps.iter().for_each(|&(a, b)| strips.swap(usize::from(a) % count, usize::from(b) % count));
    let in_another = decode(&shape, strips.iter().map(Vec::as_slice)).expect("own bytes");
    assert_eq!(in_order, in_another);
    Ok(())
}
