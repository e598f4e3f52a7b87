//! The bytes of one message of each kind and of a small frame. Where this test fails, the wire has changed: then
//! the version does, and so does docs/wire-format.md. What zstd makes of a plane is its own affair: where only a
//! new zstd changes the strips, the old bytes must still decode to the same frame, and that is all.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod fixed;

use fixed::{framed, hex, messages, shape, strips, tree};
use warplight_protocol::codec::StripDecoder;
use warplight_protocol::message::MessageKind;

const MESSAGES: [(MessageKind, &str); 14] = [
    (
        MessageKind::Hello,
        "\
        6000000001574152500500070000000600000000000000636c69656e740400000003000000000080bf0000803f000040\
        bf0000403f00000000000000000000f0410100000000000000000000001010000000000c0800020000000c0a01000000\
        00000000",
    ),
    (
        MessageKind::Welcome,
        "\
        7800000002010000000600000000000000736572766572070000000000000067616c6c65727901000000000000000a00\
        0000000000007265666c656374696f6e0000000000000000000000000000f83f00000000000000400000000000000000\
        00000000000000000000000000000000000000000000f03f0000003f",
    ),
    (MessageKind::Poses, "220000000340420f000000000000001800000000feff00000400f0ffffff974772b2ffffff7f"),
    (
        MessageKind::FrameBegin,
        "\
        b10000000407000000010000000300000040420f0000000000a861000080de0f000000000000001800000000feff0000\
        0400f0ffffff974772b2ffffff7f0400000003000000000080bf0000803f000040bf0000403f00000000020000000000\
        000000000000000001000000030000000000000000000000020000000000c03f030000000000c03f0100000000000000\
        000000001010010000000c0801020000000c0a010000000000003f0000004002000000003f",
    ),
    (
        MessageKind::Strip,
        "\
        1c0100000507000000020001000a0002000000401500000028b52ffd200c610000ff6852444b1b1913682e5143000300\
        0000401100000028b52ffd200841000001000000000000000004000000000b000000080a880000000079910500000500\
        000000130000000900088807002da8e63200088807002da8e6320101000000000b000000080a88000000007991050001\
        02000000401500000028b52ffd200c6100000000a20000002f00000051000103ffffdf401100000028b52ffd20084100\
        000000010000000000001000000000150000000b0008ac00000000799105000000a40700999576100011000000000f00\
        0000030000800000a407007661d01bd0000012be47003f1500000028b52ffd200c610000010000000000000095000000",
    ),
    (
        MessageKind::FrameEnd,
        "\
        310000000607000000010000000000000002000000000000000300000000000000040000000000000005000000000000\
        0010000000",
    ),
    (MessageKind::FrameAck, "090000000707000000409c0000"),
    (
        MessageKind::Statistics,
        "\
        35000000080a00000009000000010000000000000001000000000000000c00000000000000726179732e7072696d6172\
        797b00000000000000",
    ),
    (
        MessageKind::StillRequest,
        "\
        47000000090300000000001800000000feff00000400f0ffffff974772b2ffffff7f80841e0000000000000100000400\
        000003000000000080bf0000803f000040bf0000403f0000000001",
    ),
    (MessageKind::Ping, "090000000a0403020100000000"),
    (MessageKind::Pong, "090000000b0403020100000000"),
    (MessageKind::Error, "0b0000000c0300746f6f206d756368"),
    (MessageKind::Bye, "010000000d"),
    (MessageKind::Picture, "1a0000000e0700000001020600000080004000100020000000004061e020"),
];

/// The first strip of the frame; the second is in the strip message.
const FIRST_STRIP: &str = "\
        000002000a0002000000402100000028b52ffd2018c10000ff685244000000004b1b191300000000682e514300000000\
        0003000000401100000028b52ffd2010450000100100010032c0020004000000000b000000080a880000000080051e00\
        000500000000170000000b00088807008289f6096d0d00088807008289f6096d0d0101000000000b000000080a880000\
        000080051e000102000000401d00000028b52ffd2018a50000600000a2002f00510000000000020060e0011001010300\
        00e0401900000028b52ffd201081000000000000000001000000000000000000001000000000150000000b0008ac0050\
        00009aa632000000a4570003e1a43f0011000000000f000000030000800000a45700fe34ed68df200012be47003f1900\
        000028b52ffd20188500005001009500000000000000010032c002";

#[test]
fn messages_have_these_bytes() {
    for (message, (kind, expected)) in messages().iter().zip(MESSAGES) {
        assert_eq!(message.kind(), kind);
        assert_eq!(hex(&framed(message)), expected, "{kind:?}");
    }
}

#[test]
fn the_frame_has_these_bytes() {
    assert_eq!(hex(&strips()[0]), FIRST_STRIP);
    let (_, message) = MESSAGES[4];
    let header_digits = 2 * (5 + 4);
    assert_eq!(hex(&strips()[1]), message[header_digits..]);
}

/// The golden bytes decode, whatever zstd writes today.
#[test]
fn these_bytes_are_the_frame() {
    let second = &MESSAGES[4].1[2 * (5 + 4)..];
    let (mut from_golden, mut from_today) = (tree(), tree());
    let mut decoder = StripDecoder::default();
    for ((golden, today), strip) in [FIRST_STRIP, second].into_iter().zip(strips()).zip(0..) {
        let rows = &mut from_golden.bands_mut(2)[strip];
        decoder.decode(&shape(), &unhex(golden), rows).unwrap();
        let rows = &mut from_today.bands_mut(2)[strip];
        decoder.decode(&shape(), &today, rows).unwrap();
    }
    assert_eq!(from_golden, from_today);
}

fn unhex(digits: &str) -> Vec<u8> {
    (0..digits.len() / 2).map(|at| u8::from_str_radix(&digits[2 * at..2 * at + 2], 16).unwrap()).collect()
}
