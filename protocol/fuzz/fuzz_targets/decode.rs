//! Bytes from a peer: an error or a valid value, never a panic, never more memory than the limits.

#![no_main]

use arbitrary::Unstructured;
use libfuzzer_sys::fuzz_target;
use warplight_protocol::codec::{CoarseDepth, FrameShape, PlaneKind, STRIP_HEADER_BYTES};
use warplight_protocol::frame::{ColorCoding, DepthFormat};
use warplight_protocol::message::Message;
use warplight_protocol::wire::{Deframer, write_message};
use warplight_protocol_fuzz::{LIMITS, decode, shape};

fuzz_target!(|bytes: &[u8]| {
    stream(bytes);
    let mut u = Unstructured::new(bytes);
    if let Ok(mut shape) = shape(&mut u) {
        shape.strip_rows = 9;
        let rest = u.take_rest();
        let _ = decode(&shape, [rest]);
        let (width, height) = (shape.camera.size.width as usize, shape.rows_of(0).len());
        if let Ok(coarse) = CoarseDepth::from_prefix(width, height, 1e-3, None, rest) {
            assert!(coarse.depths_m.len() == width * height && coarse.depths_m.iter().all(|&depth| depth > 0.0));
        }
        let _ = decode(&shape, [&behind_header(&shape, rest)[..]]);
        let _ = decode(&shape, [&behind_compression(&shape, rest)[..]]);
    }
});

/// As a stream of messages; what is read can be written and read again.
fn stream(bytes: &[u8]) {
    let mut deframer = Deframer::new(LIMITS);
    let mut current: Option<FrameShape> = None;
    deframer.push(bytes);
    while let Ok(Some(message)) = deframer.next_message() {
        let mut again = Vec::new();
        write_message(&message, &mut again);
        let mut second = Deframer::new(LIMITS);
        second.push(&again);
        let read = second.next_message().expect("a written message is a message").expect("and whole");
        let mut twice = Vec::new();
        write_message(&read, &mut twice);
        assert_eq!(again, twice);
        match message {
            Message::FrameBegin(begin) => current = Some(begin.shape),
            Message::Strip(strip) => drop(current.as_ref().map(|shape| decode(shape, [&strip.bytes[..]]))),
            _ => {}
        }
    }
    assert!(deframer.pending_bytes() <= bytes.len());
}

/// The header of the first strip, and then whatever comes.
fn behind_header(shape: &FrameShape, rest: &[u8]) -> Vec<u8> {
    let rows = shape.rows_of(0).len() as u8;
    let mut strip = vec![0, 0, rows, 0, shape.planes().len() as u8];
    debug_assert_eq!(strip.len(), STRIP_HEADER_BYTES);
    strip.extend_from_slice(rest);
    strip
}

/// Planes in order, their samples whatever comes: what mutation alone hardly gets through zstd.
fn behind_compression(shape: &FrameShape, mut rest: &[u8]) -> Vec<u8> {
    let mut strip = behind_header(shape, &[]);
    for (node, kind, bits) in shape.planes() {
        let Some((head, behind)) = rest.split_first_chunk::<6>() else { return strip };
        // As many samples as there should be, unless the head says otherwise.
        let pixels = shape.rows_of(0).len() * shape.camera.size.width as usize;
        let wanted = if head[5] == 0 { usize::from(head[4]) } else { pixels * bits.div_ceil(8) };
        let (samples, behind) = behind.split_at(wanted.min(behind.len()));
        let mut samples = samples.to_vec();
        samples.resize(wanted, 0);
        // From coarse to fine there is no zstd to get behind.
        let is_coarse_to_fine = match kind {
            PlaneKind::Depth => matches!(shape.format.depth, DepthFormat::Bounded(_)),
            PlaneKind::Radiance | PlaneKind::Source => shape.format.color_coding != ColorCoding::Exact,
            kind => kind.coding().is_none(),
        };
        let payload = match is_coarse_to_fine {
            true => samples,
            false => zstd::bulk::compress(&samples, 1).expect("memory"),
        };
        strip.extend_from_slice(&[node, kind as u8]);
        strip.extend_from_slice(&head[..4]);
        strip.extend_from_slice(&(payload.len() as u32).to_le_bytes());
        strip.extend_from_slice(&payload);
        rest = behind;
    }
    strip
}
