//! Slices from a peer: refused, or pictures of finite radiance; never a panic, and a key picture mends what was broken.

#![no_main]

use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;
use warplight_protocol::ImageSize;
use warplight_protocol::frame::ColorFormat;
use warplight_protocol::video::{Canvas, Picture, PictureDecoder, PictureEncoder, Placement, dequantise};

const CANVAS: Canvas = Canvas { width: 48, height: 32 };

/// A key picture and two that follow.
static STREAM: LazyLock<[Vec<u8>; 3]> = LazyLock::new(|| {
    let mut encoder = PictureEncoder::new();
    [0, 3, 6].map(|shift| {
        let mut picture = Picture::new(CANVAS);
        for (pixel, luma) in picture.luma.iter_mut().enumerate() {
            *luma = ((pixel % 48 + shift) * (pixel / 48) % 251) as u8;
        }
        let mut bytes = Vec::new();
        encoder.encode(&picture, 24, false, &mut bytes).expect("a codec");
        bytes
    })
});

fuzz_target!(|bytes: &[u8]| {
    let mut decoder = PictureDecoder::default();
    // As they are, and laid over pictures that are right.
    show(&mut decoder, true, bytes);
    let mut spoil = bytes.iter().copied().cycle();
    for (number, slice) in STREAM.iter().enumerate() {
        let every = 1 + usize::from(spoil.next().unwrap_or(0));
        let mut slice = slice.clone();
        slice.iter_mut().skip(1).step_by(every).for_each(|byte| *byte ^= spoil.next().unwrap_or(0));
        show(&mut decoder, number == 0, &slice);
        show(&mut decoder, false, bytes);
    }
    assert!(decoder.decode(CANVAS, true, &STREAM[0]).is_ok());
});

fn show(decoder: &mut PictureDecoder, key: bool, bytes: &[u8]) {
    let Ok(decoded) = decoder.decode(CANVAS, key, bytes) else { return };
    let mut planes = [(); 3].map(|()| vec![f32::NAN; 48 * 32]);
    let placement = Placement { canvas: CANVAS, x: 0, y: 0 };
    let channels = planes.each_mut().map(Vec::as_mut_slice);
    dequantise(ColorFormat::Root8, 1.0, ImageSize::new(48, 32), &decoded, &placement, channels);
    assert!(planes.iter().flatten().all(|value| value.is_finite() && *value >= 0.0));
}
