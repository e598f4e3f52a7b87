//! Holds docs/wire-format.md against the code: its tables, its numbers and its bytes.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod fixed;

use fixed::{framed, messages, shape, strips};
use std::collections::BTreeMap;
use warplight_protocol::codec::samples::{Packing, Predictor};
use warplight_protocol::codec::{FrameShape, Limits, PLANE_HEADER_BYTES, PlaneKind, STRIP_HEADER_BYTES, StripDecoder};
use warplight_protocol::frame::{
    ColorCoding, ColorFormat, DepthBound, DepthCoding, FrameFormat, Layering, MAX_INTERFACES, MAX_LAYERS, MAX_NODES,
    Plan, VolumeFormat, thesis_bits,
};
use warplight_protocol::message::{
    Capabilities, ErrorCode, MAGIC, MAX_ERROR_TEXT_BYTES, MAX_POSE_SAMPLES, Message, MessageKind, Prediction, VERSION,
};
use warplight_protocol::wire::{Deframer, HEADER_BYTES};
use warplight_protocol::{Camera, ImageSize, Pose};

const DOCUMENT: &str = include_str!("../../docs/wire-format.md");

/// Rows of every table whose head is `head`, as cells.
fn rows(head: &str) -> Vec<Vec<&'static str>> {
    let cells = |line: &'static str| line.trim().trim_matches('|').split('|').map(str::trim).collect::<Vec<_>>();
    let wanted: Vec<_> = head.split('|').map(str::trim).collect();
    let mut rows = Vec::new();
    let mut lines = DOCUMENT.lines();
    while let Some(line) = lines.next() {
        if line.trim().starts_with('|') && cells(line) == wanted {
            let body = lines.by_ref().skip(1).take_while(|line| line.trim().starts_with('|'));
            rows.extend(body.map(cells));
        }
    }
    assert!(!rows.is_empty(), "the document has a table with the head '{head}'");
    rows
}

/// The bytes of the blocks named in the document; what follows a `#` is comment.
fn blocks() -> BTreeMap<&'static str, Vec<u8>> {
    let mut blocks = BTreeMap::new();
    for block in DOCUMENT.split("```hex ").skip(1) {
        let (name, rest) = block.split_once('\n').unwrap();
        let body = rest.split_once("```").unwrap().0;
        let digits: String = body.lines().map(|line| line.split('#').next().unwrap().trim()).collect();
        let byte = |at: usize| u8::from_str_radix(&digits[2 * at..2 * at + 2], 16).unwrap();
        blocks.insert(name, (0..digits.len() / 2).map(byte).collect());
    }
    blocks
}

#[test]
fn numbers_are_those_of_the_code() {
    let limits = Limits::default();
    let numbers: Vec<(&str, String)> =
        rows("name | value | what").iter().map(|row| (row[0], row[1].to_owned())).collect();
    let code = [
        ("VERSION", VERSION.to_string()),
        ("MAGIC", String::from_utf8(MAGIC.to_vec()).unwrap()),
        ("HEADER_BYTES", HEADER_BYTES.to_string()),
        ("STRIP_HEADER_BYTES", STRIP_HEADER_BYTES.to_string()),
        ("PLANE_HEADER_BYTES", PLANE_HEADER_BYTES.to_string()),
        ("Pose::WIRE_BYTES", Pose::WIRE_BYTES.to_string()),
        ("Pose::HALF_BYTES", Pose::HALF_BYTES.to_string()),
        ("MAX_POSE_SAMPLES", MAX_POSE_SAMPLES.to_string()),
        ("MAX_ERROR_TEXT_BYTES", MAX_ERROR_TEXT_BYTES.to_string()),
        ("MAX_NODES", MAX_NODES.to_string()),
        ("MAX_INTERFACES", MAX_INTERFACES.to_string()),
        ("MAX_LAYERS", MAX_LAYERS.to_string()),
        ("ImageSize::MAX_SIDE", ImageSize::MAX_SIDE.to_string()),
        ("Limits::control_bytes", limits.control_bytes.to_string()),
        ("Limits::strip_bytes", limits.strip_bytes.to_string()),
        ("Limits::frame_pixels", limits.frame_pixels.to_string()),
        ("Limits::frame_bytes", limits.frame_bytes.to_string()),
    ];
    assert_eq!(numbers, code);
}

#[test]
fn kinds_of_messages_are_those_of_the_code() {
    let table = rows("code | kind | from | payload");
    let names: Vec<_> = table.iter().map(|row| (row[0].to_owned(), row[1].to_owned())).collect();
    let code: Vec<_> = MessageKind::ALL.iter().map(|&kind| ((kind as u8).to_string(), format!("{kind:?}"))).collect();
    assert_eq!(names, code);
    // The flow names each of them, and says the same of who sends it.
    let flow: BTreeMap<_, _> = rows("message | from | when")
        .into_iter()
        .flat_map(|row| row[0].split(", ").map(|kind| (kind, row[1])).collect::<Vec<_>>())
        .collect();
    assert_eq!(flow, table.iter().map(|row| (row[1], row[2])).collect());
    // One less or one more is nothing yet.
    for code in [0, 15, 255] {
        assert!(MessageKind::from_code(code).is_err());
    }
}

#[test]
fn errors_capabilities_and_formats_are_those_of_the_code() {
    let errors: Vec<_> = rows("code | error").iter().map(|row| format!("{} {}", row[0], row[1])).collect();
    let known = [
        ErrorCode::Version,
        ErrorCode::Protocol,
        ErrorCode::Limit,
        ErrorCode::Timeout,
        ErrorCode::Internal,
        ErrorCode::Unauthorised,
        ErrorCode::Busy,
        ErrorCode::Unknown,
    ];
    assert_eq!(errors, known.map(|code| format!("{} {code:?}", code as u16)));

    let bits = rows("bit | capability");
    assert_eq!(bits, [["0", "RAY_TREE"], ["1", "STILLS"], ["2", "VIDEO"]]);
    assert_eq!(Capabilities::RAY_TREE.0, 1);
    assert_eq!(Capabilities::STILLS.0, 1 << 1);
    assert_eq!(Capabilities::VIDEO.0, 1 << 2);
    assert_eq!(Capabilities::ALL.0, (1 << bits.len()) - 1);

    let colors: Vec<_> = rows("code | color | bits | code of v | value of code c")
        .iter()
        .map(|row| format!("{} {} {}", row[0], row[1], row[2]))
        .collect();
    let code: Vec<_> =
        (0..).zip(ColorFormat::ALL).map(|(code, color)| format!("{code} {color:?} {}", color.bits())).collect();
    assert_eq!(colors, code);

    let allowed: BTreeMap<_, _> = rows("field | type | allowed").into_iter().map(|row| (row[0], row[2])).collect();
    let range = |range: std::ops::RangeInclusive<u8>| format!("{} to {}", range.start(), range.end());
    let wide = |range: std::ops::RangeInclusive<u16>| format!("{} to {}", range.start(), range.end());
    let says = |field: &str, what: String| assert!(allowed[field].contains(&what), "{field}: {what}");
    says(
        "format.color_coding",
        format!("Exact, Bounded(u8 error, {}; not with Half, Rgb9e5)", range(ColorCoding::ERRORS)),
    );
    says("format.color_coding", format!("Video(u8 quantiser, {};", range(ColorCoding::QUANTISERS)));
    says(
        "format.depth",
        format!("Codes(u8 bits of the root, u8 bits of a child, each {})", range(FrameFormat::DEPTH_BITS)),
    );
    says("format.depth", format!("u16 error in hundredths of a pixel, {};", wide(DepthBound::ERRORS_CENTI_PX)));
    says("format.depth", format!("u16 motion in millimetres, {};", wide(DepthBound::MOTIONS_MM)));
    says("format.depth", format!("u8 factor of a child, {})", range(DepthBound::CHILD_FACTORS)));
    assert_eq!(allowed["format.normal_bits"], range(FrameFormat::NORMAL_BITS));
    assert_eq!(allowed["format.shape_bits"], format!("0: not sent; else {}", range(FrameFormat::SHAPE_BITS)));
    assert_eq!(allowed["format.volume.layers"], format!("0 to {MAX_LAYERS}"));
    assert_eq!(allowed["format.volume.layering"], Layering::ALL.map(|layering| format!("{layering:?}")).join(", "));
    assert_eq!(allowed["format.volume.depth_bits"], range(VolumeFormat::DEPTH_BITS));
    assert_eq!(allowed["format.volume.optical_depth_bits"], range(VolumeFormat::OPTICAL_DEPTH_BITS));
    let codings = [DepthCoding::Relative, DepthCoding::Unfolded].map(|coding| format!("{coding:?}"));
    assert_eq!(allowed["format.child_depth"], codings.join(", "));
    assert_eq!(allowed["prediction"], Prediction::ALL.map(|prediction| format!("{prediction:?}")).join(", "));
}

#[test]
fn faces_of_a_cube_are_those_of_the_code() {
    let axis = |axis: glam::Vec3| {
        let at = axis.abs().max_position();
        format!("{}{}", if axis[at] > 0.0 { '+' } else { '-' }, ["x", "y", "z"][at])
    };
    let cube = Camera::cube(&Camera::symmetric(1.0, ImageSize::new(64, 64)), u32::MAX);
    let code: Vec<_> = cube
        .faces()
        .enumerate()
        .map(|(index, face)| {
            let [right, up, back] =
                [glam::Vec3::X, glam::Vec3::Y, glam::Vec3::Z].map(|own| face.view_from_face() * own);
            [format!("{index}: {}", axis(-back)), axis(right), axis(up), axis(back)]
        })
        .collect();
    assert_eq!(rows("face | right | up | back"), code);
}

#[test]
fn kinds_of_planes_are_those_of_the_code() {
    let table = rows("code | kind | channels | bits | predictor | packing");
    assert_eq!(table.len(), PlaneKind::ALL.len());
    // The plan of a solid: it alone has all kinds.
    let shape = FrameShape { plan: Plan::solid(), ..shape() };
    for (row, kind) in table.iter().zip(PlaneKind::ALL) {
        assert_eq!(row[..2], [(kind as u8).to_string(), format!("{kind:?}")]);
        match kind.coding() {
            None => assert_eq!(row[4..], ["coarse to fine", "coarse to fine"]),
            Some((predictor, packing)) => assert_eq!(row[4..], [format!("{predictor:?}"), format!("{packing:?}")]),
        }
        let (_, _, bits) = shape.planes().into_iter().find(|plane| plane.1 == kind).unwrap();
        let each = match kind {
            PlaneKind::Validity => 1,
            PlaneKind::Radiance => shape.format.color.bits(),
            PlaneKind::Depth => 16,
            PlaneKind::Interface => shape.interfaces.bits(),
            PlaneKind::Normal => shape.format.normal_bits.into(),
            PlaneKind::Shape => shape.format.shape_bits.into(),
            PlaneKind::OpticalDepth => shape.format.volume.optical_depth_bits.into(),
            PlaneKind::Extent => shape.format.volume.depth_bits.into(),
            PlaneKind::Source => shape.format.volume.source.bits(),
        };
        assert_eq!(row[2].parse::<usize>().unwrap() * each, bits);
        assert_eq!((16..32).contains(&(kind as u8)), kind.is_of_layer());
    }
    let named = |head: &str| rows(head).iter().map(|row| row[0].to_owned()).collect::<Vec<_>>();
    assert_eq!(named("predictor | value"), [Predictor::Gradient, Predictor::Median].map(|p| format!("{p:?}")));
    assert_eq!(named("packing | bytes"), [Packing::Runs, Packing::Bytes].map(|p| format!("{p:?}")));
}

#[test]
fn every_message_is_shown_with_its_bytes() {
    let blocks = blocks();
    assert_eq!(blocks.len(), messages().len() + 1, "{:?}", blocks.keys());
    for message in messages() {
        let bytes = &blocks[format!("{:?}", message.kind()).as_str()];
        // A compressed plane is checked by what it decodes to: its bytes are the affair of zstd.
        if message.kind() != MessageKind::Strip {
            assert_eq!(bytes, &framed(&message), "{:?}", message.kind());
        }
        let mut deframer = Deframer::new(Limits::default());
        deframer.push(bytes);
        let Ok(Some(read)) = deframer.next_message() else { panic!("{:?} is no message", message.kind()) };
        assert_eq!(read.kind(), message.kind());
        assert_eq!(deframer.pending_bytes(), 0);
    }
}

#[test]
fn the_strips_shown_are_the_frame() {
    let blocks = blocks();
    let mut deframer = Deframer::new(Limits::default());
    deframer.push(&blocks["Strip"]);
    let Ok(Some(Message::Strip(second))) = deframer.next_message() else { panic!("no strip") };
    let (mut shown, mut today) = (fixed::tree(), fixed::tree());
    for ((index, block), strip) in [&blocks["strip"], &second.bytes].into_iter().enumerate().zip(strips()) {
        let mut decoder = StripDecoder::default();
        decoder.decode(&shape(), block, &mut shown.bands_mut(2)[index]).unwrap();
        decoder.decode(&shape(), &strip, &mut today.bands_mut(2)[index]).unwrap();
    }
    assert_eq!(shown, today);
}

/// Tables of bytes and bits by hand, against the sizes that the code has.
#[test]
fn tables_of_bytes_add_up() {
    let sum = |heading: &str, head: &str| {
        let section = DOCUMENT.split(heading).nth(1).unwrap();
        let table = section.split(head).nth(1).unwrap().lines().skip(2).take_while(|line| line.starts_with('|'));
        table.filter_map(|line| line.split('|').nth(1).unwrap().trim().parse::<usize>().ok()).sum::<usize>()
    };
    let bytes = "| bytes | field |";
    assert_eq!(sum("## Framing", bytes), HEADER_BYTES);
    assert_eq!(sum("### Hello, its head", bytes), MAGIC.len() + 2);
    assert_eq!(sum("### Poses", bytes), 8 + Pose::WIRE_BYTES);
    assert_eq!(sum("### Poses", "| bits | field |"), 8 * Pose::WIRE_BYTES);
    assert_eq!(sum("\n## Strips", bytes), STRIP_HEADER_BYTES);
    assert_eq!(sum("anything else is refused.", bytes), PLANE_HEADER_BYTES);
    let empty = messages().into_iter().filter(|message| matches!(message, Message::Ping(_) | Message::Pong(_)));
    assert!(empty.map(|message| framed(&message).len()).all(|bytes| bytes == HEADER_BYTES + 8));
}

#[test]
fn the_thesis_format_has_the_size_it_says() {
    let section = DOCUMENT.split("## The thesis format").nth(1).unwrap();
    assert!(section.contains("`P (40 N + D + M) + 192`"));
    let shape = shape();
    let (nodes, interface_bits) = (2, 2);
    let bits = thesis_bits(&shape.camera, &shape.plan, &shape.interfaces);
    assert_eq!(bits, 12 * (40 * nodes + (nodes - 1) + interface_bits) + 192);
    assert_eq!(8 * Pose::HALF_BYTES, 192);
}
