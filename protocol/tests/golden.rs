//! The bytes of one message of each kind and of a small frame. Where this test fails, the wire has changed: then
//! the version does, and so does docs/wire-format.md. What zstd makes of a plane is its own affair: where only a
//! new zstd changes the strips, the old bytes must still decode to the same frame, and that is all.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod fixed;

use fixed::{framed, hex, messages, shape, strips, tree};
use warplight_protocol::codec::{StripDecoder, StripEncoder};
use warplight_protocol::frame::ColorFormat;
use warplight_protocol::message::MessageKind;

const MESSAGES: [(MessageKind, &str); 14] = [
    (
        MessageKind::Hello,
        "\
        7d00000001574152500600070000000600000000000000636c69656e740400000003000000000080bf0000803f000040\
        bf0000403f00000000000000000000f0410100000000000000000000001010000000000c0800020000000c0a01000000\
        00000000020000001000000000000000\
        7369787465656e2d616e642d6d6f726501",
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
    (MessageKind::FrameAck, "110000000707000000409c000028230000a00f0000"),
    (
        MessageKind::Statistics,
        "\
        5e000000080a00000009000000010000000000000040420f00000000000100000000000000010000000190d003000000\
        00000400000000000000736c6f7701000000000000000c00000000000000726179732e7072696d6172797b0000000000\
        0000",
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

const SRGB8_STRIP: &str = "\
        000002000a0002000000402100000028b52ffd2018c10000ed664a3c000000004b19110d000000006620493b00000000\
        0003000000401100000028b52ffd2010450000100100010032c0020004000000000b000000080a880000000080051e00\
        000500000000170000000b00088807008289f6096d0d00088807008289f6096d0d0101000000000b000000080a880000\
        000080051e000102000000401d00000028b52ffd2018a50000600000b2003300590000000000020060e0011001010300\
        00e0401900000028b52ffd201081000000000000000001000000000000000000001000000000150000000b0008ac0050\
        00009aa632000000a4570003e1a43f0011000000000f000000030000800000a45700fe34ed68df200012be47003f1900\
        000028b52ffd20188500005001009500000000000000010032c002";
const RGB9E5_STRIP: &str = "\
        000002000a0002000000403300000028b52ffd20305501003402ff008080000000003e040003000000007f003f400080\
        7f00000000010000000000000001000fc0040003000000401100000028b52ffd2010450000100100010032c002000400\
        0000000b000000080a880000000080051e00000500000000170000000b00088807008289f6096d0d00088807008289f6\
        096d0d0101000000000b000000080a880000000080051e000102000000402400000028b52ffd2030dd00009000003400\
        37009900010067000200000000000514000318634c0401030000e0401900000028b52ffd201081000000000000000001\
        000000000000000000001000000000150000000b0008ac005000009aa632000000a4570003e1a43f0011000000000f00\
        0000030000800000a45700fe34ed68df200012be47003f1900000028b52ffd2018850000500100950000000000000001\
        0032c002";

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

/// By hand: 0.125, 0.25 and 1 of a white of 1.
#[test]
fn codes_of_a_colour() {
    let codes = |color: ColorFormat| color.quantise_color([0.125, 0.25, 1.0], 1.0);
    assert_eq!(codes(ColorFormat::Linear8), [32, 64, 255]);
    assert_eq!(codes(ColorFormat::Root8), [90, 128, 255]);
    assert_eq!(codes(ColorFormat::Root10), [362, 512, 1023]);
    assert_eq!(codes(ColorFormat::Half), [0x3000, 0x3400, 0x3c00]);
    assert_eq!(codes(ColorFormat::Srgb8), [99, 137, 255]);
    // The exponent of 1 is 16; its steps are 2^-8.
    assert_eq!(codes(ColorFormat::Rgb9e5), [16 * 512 + 32, 16 * 512 + 64, 16 * 512 + 256]);
}

/// The first strip of the frame with colour in the formats that no message above has.
#[test]
fn strips_of_other_formats_have_these_bytes() {
    for (color, expected) in [(ColorFormat::Srgb8, SRGB8_STRIP), (ColorFormat::Rgb9e5, RGB9E5_STRIP)] {
        let mut shape = shape();
        shape.format.color = color;
        let (mut tree, mut strip) = (tree(), Vec::new());
        StripEncoder::default().encode(&shape, &tree.bands_mut(2)[0], &mut strip);
        assert_eq!(hex(&strip), expected, "{color:?}");
        // And they say what was said, within what the format keeps: half a step of 255, a step of 511.
        let mut decoded = fixed::tree();
        decoded.nodes[0].radiance.iter_mut().for_each(|plane| plane.fill(0.0));
        StripDecoder::default().decode(&shape, &unhex(expected), &mut decoded.bands_mut(2)[0]).unwrap();
        let (was, is) = (tree.nodes[0].radiance_at(5), decoded.nodes[0].radiance_at(5));
        assert!((was - is).abs().max_element() < 0.01 * was.max_element(), "{was} {is}");
    }
}
