//! What the codec costs: bits per pixel and time, per plane and for whole frames.
//!
//! `cargo bench -p warplight-protocol --bench codec`; the figures of one machine are in
//! docs/measurements/2026-11-22-codec.md. The frame is a synthetic room with a mirror on the wall, a chrome ball
//! and a glass ball, 1024x1024, in the plan {D, R, F}; its radiance carries noise as path tracing leaves it. The
//! knob is that noise: it decides nearly all of the bytes.

mod room;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rayon::prelude::*;
use std::hint::black_box;
use std::time::Duration;
use warplight_protocol::codec::samples::{self, Packing, Predictor};
use warplight_protocol::codec::{FrameShape, PlaneKind, StripDecoder, StripEncoder};
use warplight_protocol::frame::{ColorFormat, FrameFormat, Tree};

const STRIP_ROWS: u16 = 64;
/// Standard deviation over the mean of a pixel's radiance: none, 64 and 4 samples per pixel of a diffuse room.
const NOISE: [f32; 3] = [0.0, 0.05, 0.2];

fn encode(shape: &FrameShape, tree: &mut Tree) -> Vec<(Vec<u8>, Vec<(String, usize)>)> {
    let bands = tree.bands_mut(u32::from(shape.strip_rows));
    let one = |encoder: &mut StripEncoder, rows| {
        let mut strip = Vec::new();
        let planes = encoder.encode(shape, rows, &mut strip);
        let name = |node: u8, kind: PlaneKind| format!("{}.{}", shape.plan.name(node.into()), kind.name());
        (strip, planes.into_iter().map(|plane| (name(plane.node, plane.kind), plane.bytes)).collect())
    };
    bands.par_iter().map_init(StripEncoder::default, one).collect()
}

fn decode(shape: &FrameShape, strips: &[(Vec<u8>, Vec<(String, usize)>)], tree: &mut Tree) {
    let mut bands = tree.bands_mut(u32::from(shape.strip_rows));
    bands.par_iter_mut().zip(strips).for_each_init(StripDecoder::default, |decoder, (rows, (strip, _))| {
        decoder.decode(shape, strip, rows).expect("own bytes");
    });
}

/// Whole frames on all cores: the rate a session can hold.
fn frames(c: &mut Criterion) {
    let mut group = c.benchmark_group("frame");
    let formats = [
        ("root8", FrameFormat::default()),
        ("root10 d24", FrameFormat { color: ColorFormat::Root10, root_depth_bits: 24, ..FrameFormat::default() }),
    ];
    for (name, format) in formats {
        for noise in NOISE {
            let (shape, mut tree) = room::frame(1024, noise, format, STRIP_ROWS);
            let strips = encode(&shape, &mut tree);
            let pixels = tree.camera.size.pixels();
            let bits = |bytes: usize| 8.0 * bytes as f64 / pixels as f64;
            println!("\n{name}, noise {noise}: {:.2} bits/pixel", bits(strips.iter().map(|strip| strip.0.len()).sum()));
            for (plane, (plane_name, _)) in strips[0].1.iter().enumerate() {
                let bytes = strips.iter().map(|strip| strip.1[plane].1).sum();
                println!("  {plane_name:<18} {:.3} bits/pixel", bits(bytes));
            }
            let raw_bits: usize = shape.planes().iter().map(|plane| plane.2).sum();
            group.throughput(Throughput::Bytes((pixels * raw_bits / 8) as u64));
            group.bench_function(BenchmarkId::new(format!("encode {name}"), noise), |b| {
                b.iter(|| black_box(encode(&shape, &mut tree)));
            });
            let mut decoded = tree.clone();
            group.bench_function(BenchmarkId::new(format!("decode {name}"), noise), |b| {
                b.iter(|| decode(&shape, &strips, &mut decoded));
            });
        }
    }
    group.finish();
}

/// One plane of codes under every predictor and packing, on one core: what `PlaneKind::coding` chooses from.
fn codings(c: &mut Criterion) {
    let mut group = c.benchmark_group("coding");
    for noise in NOISE {
        let (shape, tree) = room::frame(1024, noise, FrameFormat::default(), STRIP_ROWS);
        for (name, bits, channels, defined) in room::planes_of_codes(&shape, &tree) {
            if noise > 0.0 && !name.contains("radiance") {
                continue;
            }
            for predictor in [Predictor::Gradient, Predictor::Median] {
                for packing in [Packing::Runs, Packing::Bytes] {
                    let strips = code_all(&channels, bits, &defined, predictor, packing);
                    let bytes: usize = strips.iter().map(Vec::len).sum();
                    let case = format!("{name} {predictor:?} {packing:?}");
                    println!("{case}, noise {noise}: {:.3} bits/pixel", 8.0 * bytes as f64 / defined.len() as f64);
                    group.throughput(Throughput::Bytes((channels.len() * bits * defined.len() / 8) as u64));
                    group.bench_function(BenchmarkId::new(format!("encode {case}"), noise), |b| {
                        b.iter(|| black_box(code_all(&channels, bits, &defined, predictor, packing)));
                    });
                    group.bench_function(BenchmarkId::new(format!("decode {case}"), noise), |b| {
                        b.iter(|| decode_all(&strips, channels.len(), bits, defined.len(), predictor, packing));
                    });
                }
            }
        }
    }
    group.finish();
}

const WIDTH: usize = 1024;
const STRIP_PIXELS: usize = WIDTH * STRIP_ROWS as usize;

fn code_all(
    channels: &[Vec<u32>],
    bits: usize,
    defined: &[bool],
    predictor: Predictor,
    packing: Packing,
) -> Vec<Vec<u8>> {
    let (mut codes, mut residuals) = (Vec::new(), Vec::new());
    let mut compressor = zstd::bulk::Compressor::new(StripEncoder::DEFAULT_LEVEL).expect("memory");
    let strips = (0..defined.len()).step_by(STRIP_PIXELS).map(|start| {
        let strip = start..(start + STRIP_PIXELS).min(defined.len());
        let mut packed = Vec::new();
        for channel in channels {
            codes.clear();
            codes.extend_from_slice(&channel[strip.clone()]);
            samples::predict(&mut codes, WIDTH, bits, predictor, Some(&defined[strip.clone()]), &mut residuals);
            packed = samples::pack(&residuals, bits, packing, packed);
        }
        compressor.compress(&packed).expect("memory")
    });
    strips.collect()
}

fn decode_all(
    strips: &[Vec<u8>],
    channels: usize,
    bits: usize,
    pixels: usize,
    predictor: Predictor,
    packing: Packing,
) {
    let mut decompressor = zstd::bulk::Decompressor::new().expect("memory");
    let mut codes: [Vec<u32>; 3] = Default::default();
    for (index, strip) in strips.iter().enumerate() {
        let count = STRIP_PIXELS.min(pixels - index * STRIP_PIXELS);
        let packed = decompressor.decompress(strip, channels * samples::max_packed_bytes(count, bits)).expect("own");
        let mut rest = &packed[..];
        for codes in &mut codes[..channels] {
            rest = samples::unpack(rest, count, bits, packing, codes).expect("own bytes");
        }
        let [first, second, third] = &mut codes;
        match channels {
            1 => samples::reconstruct([first], WIDTH, bits, predictor),
            2 => samples::reconstruct([first, second], WIDTH, bits, predictor),
            _ => samples::reconstruct([first, second, third], WIDTH, bits, predictor),
        }
        black_box(&codes);
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(800));
    targets = frames, codings
}
criterion_main!(benches);
