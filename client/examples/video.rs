//! Pictures of a scene's live frames along a head trace: bytes, errors and times for each quantiser.
//!
//! `cargo run --release -p warplight-client --example video -- [scene] [side] [frames]`: the built-in trace at ten frames
//! a second, 80 degrees. Errors are those of codes over the pixels that a node knows. Times are medians, planes in parallel
//! on all cores.

#![allow(clippy::unwrap_used, reason = "a measurement may panic")]

use rayon::prelude::*;
use std::time::{Duration, Instant};
use warplight_client::trace::Trace;
use warplight_protocol::codec::FrameShape;
use warplight_protocol::frame::{ColorCoding, ColorFormat, FrameFormat, FrameId, Tree, UNDEFINED, VolumeRange};
use warplight_protocol::message::{FrameBegin, FramePurpose};
use warplight_protocol::video::{PictureDecoder, dequantise};
use warplight_protocol::{Camera, ImageSize, Timestamp};
use warplight_server::pictures::{EncodeJob, PictureSource, PictureStream};
use warplight_server::scene::Scene;
use warplight_server::service::{Service, ServiceOptions};
use warplight_server::session::RenderJob;
use warplight_server::stream::{FrameStream, STRIP_ROWS};

const QUANTISERS: [u8; 7] = [16, 20, 24, 28, 32, 36, 40];

#[derive(Default)]
struct Row {
    first_bytes: Vec<usize>,
    bytes: Vec<usize>,
    squares: Vec<f64>,
    samples: Vec<f64>,
    encode: Vec<Duration>,
    decode: Vec<Duration>,
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let scene = arguments.next().unwrap_or("gallery".to_owned());
    let side: u32 = arguments.next().map_or(1024, |text| text.parse().unwrap());
    let frames: u32 = arguments.next().map_or(12, |text| text.parse().unwrap());

    let service = Service::new(Scene::load(&scene).unwrap(), ServiceOptions::default()).unwrap();
    let session = &service.session;
    let trace = Trace::built_in().placed_at(&session.head);
    let format = FrameFormat { color_coding: ColorCoding::Video { quantiser: 24 }, ..FrameFormat::default() };
    let shape = FrameShape {
        camera: Camera::symmetric(80_f32.to_radians(), ImageSize::new(side, side)),
        plan: session.plan.clone(),
        interfaces: session.interfaces.clone(),
        format: FrameFormat { volume: warplight_protocol::frame::VolumeFormat::NONE, ..format },
        volume: VolumeRange::default(),
        strip_rows: STRIP_ROWS,
        exposure: session.exposure,
    };
    let nodes = shape.plan.nodes().len();
    let mut stream = FrameStream::new(service);
    let mut source = PictureSource::default();
    let mut rows: Vec<(String, u8, bool, Row)> = Vec::new();
    let mut streams = Vec::new();
    for is_key in [false, true] {
        for quantiser in QUANTISERS {
            rows.push((if is_key { "key" } else { "predicted" }.to_owned(), quantiser, is_key, Row::default()));
            streams.push((PictureStream::new(0), decoders(nodes)));
        }
    }
    let mut draw = Vec::new();
    for number in 0..frames {
        let begin = FrameBegin {
            id: FrameId(number + 1),
            purpose: FramePurpose::Live,
            pose_time: Timestamp::ZERO,
            horizon_micros: 0,
            scene_time: Timestamp::ZERO,
            render_pose: trace.pose_at(f64::from(number) * 0.1),
            shape: shape.clone(),
        };
        let job = RenderJob { begin, spp: 1, samples_per_1024_px: 200 };
        stream.run(&job, &|| (), &|_| ());
        let mut tree = stream.tree().clone();
        let start = Instant::now();
        let pictures = source.render(&shape, &mut tree).unwrap();
        draw.push(start.elapsed());
        let mut job = EncodeJob { frame: FrameId(number + 1), quantiser: 0, pictures };
        for ((_, quantiser, is_key, row), (stream, decoders)) in rows.iter_mut().zip(&mut streams) {
            job.quantiser = *quantiser;
            if *is_key {
                (*stream, *decoders) = (PictureStream::new(0), self::decoders(nodes));
            }
            measure(row, &shape, &tree, &job, stream, decoders, number == 0);
        }
        eprintln!("frame {}", number + 1);
    }
    println!("{scene}, {side} x {side}, {frames} frames; pictures drawn in {:.1} ms", median(&mut draw));
    println!("| pictures | quantiser | bit/pixel | of each node | PSNR in dB | encode ms | decode ms |");
    println!("|---|---|---|---|---|---|---|");
    let pixels = f64::from(side) * f64::from(side);
    for (name, quantiser, _, mut row) in rows {
        let bits: Vec<f64> =
            row.bytes.iter().map(|&bytes| bytes as f64 * 8.0 / pixels / f64::from(frames.max(2) - 1)).collect();
        let list = |values: Vec<String>| values.join(", ");
        let db = row.squares.iter().zip(&row.samples).map(|(s, n)| 10.0 * (255.0 * 255.0 * n / s).log10());
        println!(
            "| {name} | {quantiser} | {:.3} | {} | {} | {:.1} | {:.1} |",
            bits.iter().sum::<f64>(),
            list(bits.iter().map(|bits| format!("{bits:.3}")).collect()),
            list(db.map(|db| format!("{db:.1}")).collect()),
            median(&mut row.encode),
            median(&mut row.decode),
        );
    }
}

fn decoders(nodes: usize) -> Vec<PictureDecoder> {
    (0..nodes).map(|_| PictureDecoder::default()).collect()
}

fn measure(
    row: &mut Row,
    shape: &FrameShape,
    tree: &Tree,
    job: &EncodeJob,
    stream: &mut PictureStream,
    decoders: &mut [PictureDecoder],
    is_first: bool,
) {
    let start = Instant::now();
    let messages = stream.encode(job).unwrap();
    row.encode.push(start.elapsed());
    let mut shown = tree.clone();
    let size = shape.camera.size;
    let start = Instant::now();
    let planes = messages.par_iter().zip(decoders).zip(&mut shown.nodes);
    planes.for_each(|((message, decoder), planes)| {
        let head = &message.head;
        let decoded = decoder.decode(head.placement.canvas, head.reference.is_none(), &message.bytes).unwrap();
        let radiance = planes.radiance.each_mut().map(Vec::as_mut_slice);
        dequantise(shape.format.color, head.white, size, &decoded, &head.placement, radiance);
    });
    row.decode.push(start.elapsed());
    let bytes = if is_first { &mut row.first_bytes } else { &mut row.bytes };
    bytes.resize(messages.len(), 0);
    row.squares.resize(messages.len(), 0.0);
    row.samples.resize(messages.len(), 0.0);
    for (node, message) in messages.iter().enumerate() {
        bytes[node] += message.bytes.len();
        let code = |value: f32| f64::from(ColorFormat::Root8.quantise(value, message.head.white));
        let (before, after) = (&tree.nodes[node], &shown.nodes[node]);
        for (before_channel, after_channel) in before.radiance.iter().zip(&after.radiance) {
            for pixel in (0..size.pixels()).filter(|&pixel| node == 0 || before.distance[pixel] != UNDEFINED) {
                row.squares[node] += (code(before_channel[pixel]) - code(after_channel[pixel])).powi(2);
                row.samples[node] += 1.0;
            }
        }
    }
}

fn median(times: &mut [Duration]) -> f64 {
    times.sort();
    times.get(times.len() / 2).map_or(0.0, |time| time.as_secs_f64() * 1e3)
}
