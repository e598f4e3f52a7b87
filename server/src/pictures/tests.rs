//! Canvases and streams, against the decoder.

use super::*;
use warplight_protocol::camera::Margins;
use warplight_protocol::frame::{ColorCoding, FrameFormat, Interfaces, Plan, UNDEFINED, VolumeRange};
use warplight_protocol::video::PictureDecoder;
use warplight_protocol::{ImageSize, Pose};

fn display() -> Camera {
    Camera::symmetric(1.2, ImageSize::new(192, 128))
}

fn margins(left: u32, right: u32) -> Margins {
    Margins { left, right, up: 16, down: 0 }
}

#[test]
fn pixels_of_a_direction_stay_where_they_are_whatever_band_is_around_them() {
    let mut place = Place::default();
    let first = place.of(&display());
    assert_eq!([first.canvas.width, first.canvas.height, first.x, first.y], [192, 128, 0, 0]);
    let wide = place.of(&display().widened(margins(16, 80)));
    assert_eq!([wide.canvas.width, wide.canvas.height], [64 + 192 + 128, 64 + 128], "grown in steps of 64");
    // The display's first pixel lies 16 pixels into the wide frame.
    assert_eq!([wide.x + 16, wide.y + 16], [64, 64]);
    for band in [margins(0, 0), margins(48, 0), margins(32, 112)] {
        let again = place.of(&display().widened(band));
        assert_eq!(again.canvas, wide.canvas, "{band:?}");
        assert_eq!([u32::from(again.x) + band.left, u32::from(again.y) + band.up], [64, 64], "{band:?}");
        assert_eq!(again.check(display().widened(band).size), Ok(()));
    }
}

#[test]
fn a_canvas_that_is_not_needed_shrinks_after_a_while() {
    let mut place = Place::default();
    let wide = place.of(&display().widened(margins(16, 80))).canvas;
    let canvases: Vec<Canvas> = (0..2 * KEEP_PICTURES).map(|_| place.of(&display()).canvas).collect();
    let kept = canvases.iter().take_while(|canvas| **canvas == wide).count();
    assert_eq!(kept, KEEP_PICTURES as usize);
    assert!(canvases[kept..].iter().all(|canvas| *canvas == canvases[kept] && canvas.pixels() < wide.pixels()));
}

#[test]
fn another_grid_of_pixels_begins_anew() {
    let mut place = Place::default();
    place.of(&display().widened(margins(16, 80)));
    for other in [Camera::symmetric(0.9, ImageSize::new(100, 60)), display().widened(margins(7, 0))] {
        let placement = place.of(&other);
        assert_eq!([placement.x, placement.y], [0, 0]);
        assert_eq!(placement.check(other.size), Ok(()));
    }
}

fn shape(camera: Camera) -> FrameShape {
    FrameShape {
        camera,
        plan: Plan::mirror(),
        interfaces: Interfaces::default(),
        format: FrameFormat { color_coding: ColorCoding::Video { quantiser: 20 }, ..FrameFormat::default() },
        volume: VolumeRange::default(),
        strip_rows: 32,
        exposure: 1.0,
    }
}

/// A frame whose mirror knows its left half.
fn rendered(source: &mut PictureSource, camera: Camera, shift: usize) -> RenderedPictures {
    let shape = shape(camera);
    let mut tree = Tree::new(Pose::IDENTITY, camera, shape.plan.clone(), shape.interfaces.clone());
    let width = camera.size.width as usize;
    for (node, planes) in tree.nodes.iter_mut().enumerate() {
        for channel in &mut planes.radiance {
            let value = |pixel: usize| 0.3 + 0.2 * ((pixel % width + shift) as f32 * 0.1).sin();
            channel.iter_mut().enumerate().for_each(|(pixel, radiance)| *radiance = value(pixel));
        }
        let known = |pixel: usize| node == 0 || pixel % width < width / 2;
        let distance = |pixel| if known(pixel) { 2.0 } else { UNDEFINED };
        planes.distance.iter_mut().enumerate().for_each(|(pixel, value)| *value = distance(pixel));
    }
    source.render(&shape, &mut tree).expect("a format with pictures")
}

#[test]
fn a_frame_that_was_dropped_is_nobody_s_reference() {
    let mut source = PictureSource::default();
    let mut stream = PictureStream::new(2);
    let mut decoders = [PictureDecoder::default(), PictureDecoder::default()];
    let mut reference = None;
    for id in [1, 2, 5, 6] {
        // Frames 3 and 4 are rendered, too, and replaced.
        for dropped in [3, 4].into_iter().filter(|_| id == 5) {
            drop(rendered(&mut source, display(), dropped));
        }
        let pictures = rendered(&mut source, display(), id as usize);
        let job = EncodeJob { frame: FrameId(id), quantiser: 20, pictures };
        let messages = stream.encode(&job).expect("a codec");
        assert_eq!(messages.len(), 2);
        for ((message, decoder), node) in messages.iter().zip(&mut decoders).zip(0..) {
            let head = &message.head;
            assert_eq!((head.frame, head.node, head.reference), (FrameId(id), node, reference));
            assert_eq!(head.white, 1.0);
            assert!(decoder.decode(head.placement.canvas, reference.is_none(), &message.bytes).is_ok());
        }
        reference = Some(FrameId(id));
    }
    // A new session: nothing is known at the other end.
    let job = EncodeJob { frame: FrameId(7), quantiser: 20, pictures: rendered(&mut source, display(), 7) };
    let messages = PictureStream::new(2).encode(&job).expect("a codec");
    assert!(messages.iter().all(|message| message.head.reference.is_none()));
}

#[test]
fn a_frame_that_does_not_fit_takes_a_key_picture_and_the_next_does_not() {
    let mut source = PictureSource::default();
    let mut stream = PictureStream::new(2);
    let wide = display().widened(margins(16, 16));
    let keys: Vec<bool> = (1..)
        .zip([display(), display(), wide, display(), wide])
        .map(|(id, camera)| {
            let pictures = rendered(&mut source, camera, 0);
            let messages = stream.encode(&EncodeJob { frame: FrameId(id), quantiser: 20, pictures });
            messages.expect("a codec")[0].head.reference.is_none()
        })
        .collect();
    assert_eq!(keys, [true, false, true, false, false]);
}
