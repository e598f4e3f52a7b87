//! An unmoved head sees what the server sees: a frame of the gallery, over the wire and through the warp.

use image::RgbImage;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use warplight_client::assemble::{Assembler, ReadyFrame};
use warplight_client::warp::{Mode, Warper};
use warplight_protocol::codec::Limits;
use warplight_protocol::frame::{FrameFormat, Tree, flatten};
use warplight_protocol::message::{
    Capabilities, FrameBegin, FrameEnd, Hello, Message, PoseSample, Prediction, StripMessage, Viewport,
};
use warplight_protocol::tone::display_from_radiance;
use warplight_protocol::wire::{Deframer, write_message};
use warplight_protocol::{Camera, ImageSize, Timestamp, Token};
use warplight_server::scene::Scene;
use warplight_server::service::{Service, ServiceOptions};
use warplight_server::session::{SampleBudget, ServerSession};
use warplight_server::stream::FrameStream;

/// The picture of a tree from its own pose, tone-mapped: the server's image.
fn image_of(tree: &Tree, exposure: f32) -> RgbImage {
    let size = tree.camera.size;
    let mut radiance = vec![Default::default(); size.pixels()];
    flatten(tree, 0..size.pixels(), &mut radiance);
    let codes = radiance.iter().flat_map(|&radiance| display_from_radiance(radiance, exposure)).collect();
    RgbImage::from_raw(size.width, size.height, codes).unwrap()
}

/// A frame as it was rendered, and as it arrived.
struct Sent {
    stream: FrameStream,
    ready: Arc<ReadyFrame>,
    exposure: f32,
}

/// The first frame of the gallery for a client with this display.
fn sent(camera: Camera, viewport: Viewport) -> Sent {
    let options = ServiceOptions { samples: SampleBudget::Samples(4), seed: 3, ..ServiceOptions::default() };
    let service = Service::new(Scene::load("gallery").unwrap(), options).unwrap();
    let (head, exposure) = (service.session.head, service.session.exposure);
    let mut session = ServerSession::new(service.session.clone(), Timestamp::ZERO);
    let mut bytes = Vec::new();
    let software = "test".to_owned();
    let format = FrameFormat::exact();
    let hello = Hello {
        capabilities: Capabilities::ALL,
        software,
        camera,
        viewport,
        frame_hz: 10.0,
        format,
        target_kbps: 0,
        prediction: Prediction::default(),
        token: Token::NONE,
        adapt: false,
    };
    write_message(&Message::Hello(hello), &mut bytes);
    write_message(&Message::Poses(vec![PoseSample { time: Timestamp { micros: 1 }, pose: head }]), &mut bytes);
    session.on_bytes(Timestamp::ZERO, &bytes);
    let job = session.poll_render(Timestamp::ZERO).unwrap();

    let mut stream = FrameStream::new(service);
    let strips = Mutex::new(Vec::new());
    stream.run(&job, &|| (), &|strip| strips.lock().unwrap().push(strip));
    let mut assembler = Assembler::default();
    let frame = job.begin.id;
    assembler.begin(over_the_wire(job.begin));
    for bytes in strips.into_inner().unwrap() {
        assembler.strip(&StripMessage { frame, bytes }, || Duration::ZERO).unwrap();
    }
    let zero = Timestamp::ZERO;
    let end = FrameEnd {
        id: frame,
        pose_received: zero,
        render_start: zero,
        render_end: zero,
        encoded: zero,
        sent: zero,
        spp: 4,
    };
    Sent { stream, ready: assembler.end(end, zero, zero).unwrap(), exposure }
}

fn over_the_wire(begin: FrameBegin) -> FrameBegin {
    let mut bytes = Vec::new();
    write_message(&Message::FrameBegin(begin), &mut bytes);
    let mut deframer = Deframer::new(Limits::default());
    deframer.push(&bytes);
    match deframer.next_message().unwrap() {
        Some(Message::FrameBegin(begin)) => begin,
        other => panic!("{other:?} is no head of a frame"),
    }
}

/// What quantisation costs: the image before it differs by a code or two, and where a node saturates.
fn assert_is_but_quantised(picture: &RgbImage, stream: &FrameStream, exposure: f32) {
    let unquantised = image_of(stream.tree(), exposure);
    let differences = picture.iter().zip(unquantised.iter()).map(|(a, b)| a.abs_diff(*b));
    let beyond_two = differences.filter(|&difference| difference > 2).count() as f64 / picture.len() as f64;
    assert!(beyond_two < 0.02, "{beyond_two} of all codes are off by more than 2");
}

#[test]
fn a_frame_of_the_gallery_shown_at_its_own_pose_is_the_servers_image_to_the_bit() {
    let camera = Camera::symmetric(1.4, ImageSize::new(160, 120));
    let Sent { stream, ready, exposure } = sent(camera, Viewport::Plane);
    assert_eq!(ready.tree.plan.nodes().len(), 4, "the gallery has mirrors, water and glass");
    let mut warper = Warper::default();
    let mut picture = RgbImage::default();
    for mode in Mode::ALL {
        warper.prepare(mode, &ready.tree);
        let statistics = warper.show(mode, &ready.tree, &ready.tree.render_pose, &camera, exposure, &mut picture);
        assert_eq!(statistics.hole_fraction, 0.0);
        assert!(picture == image_of(&ready.tree, exposure), "{}: not the image of the tree sent", mode.name());
    }
    assert_is_but_quantised(&picture, &stream, exposure);
}

#[test]
fn a_cube_of_the_gallery_arrives_as_it_was_rendered_but_for_quantisation() {
    let camera = Camera::symmetric(1.4, ImageSize::new(48, 48));
    let Sent { stream, ready, exposure } = sent(camera, Viewport::Cube);
    assert_eq!(ready.tree.camera, Camera::cube(&camera, u32::MAX));
    assert_eq!(ready.tree.camera, stream.tree().camera);
    assert_is_but_quantised(&image_of(&ready.tree, exposure), &stream, exposure);
    // Distances of 16-bit codes of z, in every face as in any other.
    for (pixel, (&was, &is)) in stream.tree().nodes[0].distance.iter().zip(&ready.tree.nodes[0].distance).enumerate() {
        assert!(was == is || (is / was - 1.0).abs() < 2e-3, "pixel {pixel}: {is} m for {was} m");
    }
}
