//! Streams of pictures, there and back.

use super::*;
use crate::ImageSize;
use crate::codec::{DecodeError, PlaneKind};
use crate::frame::{ColorFormat, FrameId};
use proptest::prelude::*;

const WHITE: f32 = 2.0;

fn canvas(width: u16, height: u16) -> Canvas {
    Canvas { width, height }
}

fn whole(canvas: Canvas) -> Placement {
    Placement { canvas, x: 0, y: 0 }
}

fn size_of(canvas: Canvas) -> ImageSize {
    ImageSize::new(canvas.width.into(), canvas.height.into())
}

/// A smooth picture with an edge, seen `shift` pixels further to the right.
fn scene(size: ImageSize, shift: usize) -> [Vec<f32>; 3] {
    let channel = |phase: f32| {
        let value = |pixel: usize| {
            let (x, y) = (pixel % size.width as usize + shift, pixel / size.width as usize);
            let edge = if (x / 24 + y / 40) % 2 == 0 { 0.3 } else { 0.0 };
            0.6 + edge + 0.3 * (0.11 * x as f32 + phase).sin() * (0.07 * y as f32).cos()
        };
        (0..size.pixels()).map(value).collect()
    };
    [channel(0.0), channel(0.2), channel(0.4)]
}

fn picture_of(radiance: &[Vec<f32>; 3], known: Option<&[f32]>, size: ImageSize, placement: &Placement) -> Picture {
    let mut picture = Picture::new(placement.canvas);
    let channels = radiance.each_ref().map(Vec::as_slice);
    quantise(ColorFormat::Root8, WHITE, size, channels, known, placement, &mut picture);
    picture
}

fn radiance_of(decoded: &Decoded<'_>, size: ImageSize, placement: &Placement) -> [Vec<f32>; 3] {
    let mut planes = [(); 3].map(|()| vec![f32::NAN; size.pixels()]);
    let channels = planes.each_mut().map(Vec::as_mut_slice);
    dequantise(ColorFormat::Root8, WHITE, size, decoded, placement, channels);
    planes
}

/// Root of the mean square error in codes, over the pixels that count.
fn error(before: &[Vec<f32>; 3], after: &[Vec<f32>; 3], counts: impl Fn(usize) -> bool) -> f64 {
    let code = |value: f32| f64::from(ColorFormat::Root8.quantise(value, WHITE));
    let (mut sum, mut count) = (0.0, 0.0);
    for (before, after) in before.iter().zip(after) {
        for pixel in (0..before.len()).filter(|&pixel| counts(pixel)) {
            sum += (code(before[pixel]) - code(after[pixel])).powi(2);
            count += 1.0;
        }
    }
    f64::sqrt(sum / count)
}

/// Encodes pictures of a panning scene: their bytes, and which are key pictures.
fn pan(canvas: Canvas, quantisers: &[u8]) -> Vec<(Vec<u8>, bool)> {
    let mut encoder = PictureEncoder::new();
    let encode = |(number, &quantiser): (usize, &u8)| {
        let picture = picture_of(&scene(size_of(canvas), 3 * number), None, size_of(canvas), &whole(canvas));
        let mut bytes = Vec::new();
        let key = encoder.encode(&picture, quantiser, false, &mut bytes).unwrap();
        (bytes, key)
    };
    quantisers.iter().enumerate().map(encode).collect()
}

#[test]
fn a_picture_comes_back_within_what_its_quantiser_leaves() {
    let canvas = canvas(160, 96);
    for (quantiser, most) in [(0, 2.0), (12, 2.5), (24, 4.0), (36, 12.0)] {
        let mut decoder = PictureDecoder::default();
        for (number, (bytes, key)) in pan(canvas, &[quantiser; 4]).into_iter().enumerate() {
            let decoded = decoder.decode(canvas, key, &bytes).unwrap();
            let back = radiance_of(&decoded, size_of(canvas), &whole(canvas));
            let found = error(&scene(size_of(canvas), 3 * number), &back, |_| true);
            // The step of H.264's quantiser q is .625 * 2^(q / 6), and its error uniform: step / sqrt(12), three times
            // that for the transform of three channels into each other; half-resolution chroma and integers add 2.
            let step = 0.625 * f64::exp2(f64::from(quantiser) / 6.0);
            assert!(most <= 2.0 + 3.0 * step / 12_f64.sqrt() + 1e-9, "the derivation");
            assert!(found <= most, "{found} at {quantiser}, picture {number}");
        }
    }
}

#[test]
fn only_the_first_picture_is_a_key_picture_and_quantisers_change_without_one() {
    let canvas = canvas(160, 96);
    let pictures = pan(canvas, &[30, 30, 24, 40, 30, 30]);
    let keys: Vec<bool> = pictures.iter().map(|(_, key)| *key).collect();
    assert_eq!(keys, [true, false, false, false, false, false]);
    let bytes: Vec<usize> = pictures.iter().map(|(bytes, _)| bytes.len()).collect();
    assert!(bytes[1] < bytes[0] / 2, "predicted from the picture before: {bytes:?}");
    assert!(bytes[2] > bytes[1] && bytes[3] < bytes[2], "finer, then coarser: {bytes:?}");
    // Whoever decodes needs no word about quantisers.
    let mut decoder = PictureDecoder::default();
    assert!(pictures.iter().all(|(bytes, key)| decoder.decode(canvas, *key, bytes).is_ok()));
}

#[test]
fn a_key_picture_on_request_needs_nothing_before_it() {
    let canvas = canvas(64, 64);
    let picture = picture_of(&scene(size_of(canvas), 0), None, size_of(canvas), &whole(canvas));
    let mut encoder = PictureEncoder::new();
    let mut encode = |key| {
        let mut bytes = Vec::new();
        (encoder.encode(&picture, 20, key, &mut bytes).unwrap(), bytes)
    };
    assert!(encode(false).0);
    assert!(!encode(false).0);
    let (is_key, key) = encode(true);
    assert!(is_key);
    let (_, delta) = encode(false);
    let mut late = PictureDecoder::default();
    assert!(late.decode(canvas, false, &delta).is_err(), "nothing to predict from");
    assert!(late.decode(canvas, true, &key).is_ok());
    assert!(late.decode(canvas, false, &delta).is_ok());
}

#[test]
fn another_canvas_begins_with_a_key_picture() {
    let mut encoder = PictureEncoder::new();
    let mut decoder = PictureDecoder::default();
    for (canvas, is_new) in [
        (canvas(64, 64), true),
        (canvas(64, 64), false),
        (canvas(128, 64), true),
        (canvas(128, 64), false),
        (canvas(64, 64), true),
    ] {
        let picture = picture_of(&scene(size_of(canvas), 0), None, size_of(canvas), &whole(canvas));
        let mut bytes = Vec::new();
        assert_eq!(encoder.encode(&picture, 20, false, &mut bytes), Ok(is_new));
        assert_eq!(decoder.decode(canvas, is_new, &bytes).unwrap().canvas, canvas);
    }
}

/// What nobody knows must not be seen: neither in what is beside it, nor in the bytes.
#[test]
fn what_is_unknown_changes_nothing_that_is_shown() {
    let canvas = canvas(160, 96);
    let size = size_of(canvas);
    let known: Vec<f32> = (0..size.pixels())
        .map(|pixel| {
            let (x, y) = ((pixel % 160) as f32 - 70.0, (pixel / 160) as f32 - 45.0);
            if x * x + y * y < 900.0 || x > 50.0 { 3.0 } else { 0.0 }
        })
        .collect();
    let mut pictures = Vec::new();
    for unknown in [0.0, 1e9, f32::NAN] {
        let mut radiance = scene(size, 0);
        for channel in &mut radiance {
            channel.iter_mut().zip(&known).filter(|(_, known)| **known == 0.0).for_each(|(value, _)| *value = unknown);
        }
        pictures.push(picture_of(&radiance, Some(&known), size, &whole(canvas)));
    }
    assert!(pictures.windows(2).all(|pair| pair[0] == pair[1]), "what is unknown is not read");

    let mut encoded = Vec::new();
    PictureEncoder::new().encode(&pictures[0], 20, true, &mut encoded).unwrap();
    let mut decoder = PictureDecoder::default();
    let back = radiance_of(&decoder.decode(canvas, true, &encoded).unwrap(), size, &whole(canvas));
    let found = error(&scene(size, 0), &back, |pixel| known[pixel] > 0.0);
    // As in a picture that is known everywhere; the pixels at the edges are a tenth.
    assert!(found < 3.5, "{found}");
}

#[test]
fn a_frame_lies_where_its_placement_says() {
    let (small, canvas) = (ImageSize::new(50, 38), canvas(128, 64));
    let placement = Placement { canvas, x: 36, y: 22 };
    placement.check(small).unwrap();
    let picture = picture_of(&scene(small, 0), None, small, &placement);
    assert_eq!(picture.luma[0], fill::NOTHING[0], "around it is nothing");
    let mut bytes = Vec::new();
    PictureEncoder::new().encode(&picture, 10, true, &mut bytes).unwrap();
    let mut decoder = PictureDecoder::default();
    let back = radiance_of(&decoder.decode(canvas, true, &bytes).unwrap(), small, &placement);
    assert!(error(&scene(small, 0), &back, |_| true) < 2.5);
}

#[test]
fn placements_that_hold_no_frame_are_refused() {
    let frame = ImageSize::new(100, 60);
    let good = Placement { canvas: canvas(128, 64), x: 2, y: 4 };
    assert_eq!(good.check(frame), Ok(()));
    for bad in [
        Placement { x: 30, ..good },
        Placement { y: 6, ..good },
        Placement { x: 3, ..good },
        Placement { x: u16::MAX - 1, ..good },
        Placement { canvas: canvas(120, 64), ..good },
        Placement { canvas: canvas(0, 64), ..good },
        Placement { canvas: canvas(336, 64), ..good },
        Placement { canvas: canvas(65_520, 65_520), ..good },
    ] {
        assert!(bad.check(frame).is_err(), "{bad:?}");
    }
    assert!(!canvas(8688, 8688).is_valid() && canvas(3072, 3072).is_valid());
}

#[test]
fn heads_come_back_and_what_cannot_be_is_refused() {
    let head = PictureHead {
        frame: FrameId(9),
        node: 2,
        kind: PlaneKind::Source,
        reference: Some(FrameId(7)),
        placement: Placement { canvas: canvas(128, 64), x: 2, y: 4 },
        white: 0.5,
    };
    assert_eq!(PictureHead::from_bytes(&head.to_bytes()), Ok(head));
    let key = PictureHead { reference: None, kind: PlaneKind::Radiance, ..head };
    assert_eq!(PictureHead::from_bytes(&key.to_bytes()), Ok(key));
    let spoiled = |at: usize, with: &[u8]| {
        let mut bytes = head.to_bytes();
        bytes[at..at + with.len()].copy_from_slice(with);
        PictureHead::from_bytes(&bytes).unwrap_err().to_string()
    };
    assert!(spoiled(5, &[3]).contains("kind of picture"));
    for white in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(spoiled(18, &f32::to_le_bytes(white)).contains("white"), "{white}");
    }
}

/// Both ends write the parameter sets: the encoder refuses to go on where OpenH264 wrote others.
#[test]
fn parameter_sets_are_those_of_the_codec_for_every_canvas() {
    for canvas in [canvas(16, 16), canvas(16, 272), canvas(1024, 1024), canvas(1088, 1152), canvas(3072, 3072)] {
        let mut bytes = Vec::new();
        assert_eq!(PictureEncoder::new().encode(&Picture::new(canvas), 30, false, &mut bytes), Ok(true), "{canvas:?}");
        let mut decoder = PictureDecoder::default();
        let decoded = decoder.decode(canvas, true, &bytes).unwrap();
        assert!(decoded.planes[0].0.iter().take(16).all(|&luma| luma.abs_diff(fill::NOTHING[0]) <= 2), "{canvas:?}");
    }
}

fn refused(result: Result<Decoded<'_>, DecodeError>) -> bool {
    result.is_err()
}

#[test]
fn units_that_are_no_slice_are_refused_before_the_codec_sees_them() {
    let canvas = canvas(64, 64);
    let (bytes, _) = pan(canvas, &[30]).remove(0);
    let mut decoder = PictureDecoder::default();
    for unit in [7, 8, 1, 14, 20, 24] {
        let mut bytes = bytes.clone();
        bytes[0] = bytes[0] & 0xe0 | unit;
        assert!(refused(decoder.decode(canvas, true, &bytes)), "type {unit}");
    }
    let twice = [&bytes[..], &[0, 0, 1], &bytes[..]].concat();
    assert!(refused(decoder.decode(canvas, true, &twice)), "two slices");
    assert!(refused(decoder.decode(canvas, false, &bytes)), "a key picture that says it is none");
    assert!(refused(decoder.decode(canvas, true, &[])));
    assert!(decoder.decode(canvas, true, &bytes).is_ok());
}

#[test]
fn a_picture_cut_anywhere_is_refused_or_whole() {
    let canvas = canvas(64, 64);
    let pictures = pan(canvas, &[30; 2]);
    for (bytes, key) in &pictures {
        for cut in 0..bytes.len() {
            let mut decoder = PictureDecoder::default();
            if !key {
                decoder.decode(canvas, true, &pictures[0].0).unwrap();
            }
            let _ = decoder.decode(canvas, *key, &bytes[..cut]).map(|decoded| {
                assert_eq!(radiance_of(&decoded, size_of(canvas), &whole(canvas))[0].len(), 64 * 64);
            });
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Damaged, spliced and of the wrong canvas: refused, or pictures of finite radiance; and a key picture mends it.
    #[test]
    fn damaged_streams_are_refused_or_pictures(
        flips in prop::collection::vec((0..4_usize, any::<prop::sample::Index>(), any::<u8>()), 1..12),
        splice in any::<prop::sample::Index>(),
        wide in any::<bool>(),
    ) {
        let other = canvas(if wide { 96 } else { 64 }, 64);
        let canvas = canvas(64, 64);
        let mut pictures = pan(canvas, &[30; 4]);
        let good = pictures[0].0.clone();
        for (number, at, with) in flips {
            let bytes = &mut pictures[number].0;
            let at = at.index(bytes.len());
            bytes[at] ^= with;
        }
        let tail = pictures[1].0[splice.index(pictures[1].0.len())..].to_vec();
        pictures[2].0.extend(tail);
        let mut decoder = PictureDecoder::default();
        for (number, (bytes, key)) in pictures.iter().enumerate() {
            let canvas = if number == 3 { other } else { canvas };
            if let Ok(decoded) = decoder.decode(canvas, *key, bytes) {
                let planes = radiance_of(&decoded, size_of(canvas), &whole(canvas));
                prop_assert!(planes.iter().flatten().all(|value| value.is_finite() && *value >= 0.0));
            }
        }
        prop_assert!(decoder.decode(canvas, true, &good).is_ok());
    }
}
