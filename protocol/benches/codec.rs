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
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;
use warplight_protocol::codec::samples::{self, Packing, Predictor};
use warplight_protocol::codec::{FrameShape, PlaneBytes, PlaneKind, StripDecoder, StripEncoder};
use warplight_protocol::frame::{ColorCoding, ColorFormat, DepthBound, DepthFormat, FrameFormat, Tree};

const STRIP_ROWS: u16 = 64;
/// Standard deviation over the mean of a pixel's radiance: none, 64 and 4 samples per pixel of a diffuse room.
const NOISE: [f32; 3] = [0.0, 0.05, 0.2];

/// What a session keeps from frame to frame: one encoder and decoder per thread, and the bytes of each strip.
struct Session {
    encoders: Vec<Mutex<StripEncoder>>,
    decoders: Vec<Mutex<StripDecoder>>,
    strips: Vec<(Vec<u8>, Vec<PlaneBytes>)>,
}

impl Session {
    fn new(shape: &FrameShape) -> Session {
        let threads = rayon::current_num_threads();
        Session {
            encoders: (0..threads).map(|_| Mutex::default()).collect(),
            decoders: (0..threads).map(|_| Mutex::default()).collect(),
            strips: vec![Default::default(); shape.strips()],
        }
    }

    fn encode(&mut self, shape: &FrameShape, tree: &mut Tree) {
        let bands = tree.bands_mut(u32::from(shape.strip_rows));
        bands.par_iter().zip(&mut self.strips).for_each(|(rows, (bytes, planes))| {
            bytes.clear();
            *planes = of_this_thread(&self.encoders).encode(shape, rows, bytes);
        });
    }

    fn decode(&self, shape: &FrameShape, tree: &mut Tree) {
        let mut bands = tree.bands_mut(u32::from(shape.strip_rows));
        bands.par_iter_mut().zip(&self.strips).for_each(|(rows, (bytes, _))| {
            of_this_thread(&self.decoders).decode(shape, bytes, rows).expect("own bytes");
        });
    }

    fn bytes(&self) -> usize {
        self.strips.iter().map(|strip| strip.0.len()).sum()
    }
}

fn of_this_thread<T>(pool: &[Mutex<T>]) -> MutexGuard<'_, T> {
    pool[rayon::current_thread_index().unwrap_or(0)].lock().expect("no thread has panicked")
}

/// CPU time of this thread so far, by the Linux scheduler: wall time lies on a machine that others share.
fn thread_cpu() -> Option<Duration> {
    let statistics = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    statistics.split(' ').next()?.parse().ok().map(Duration::from_nanos)
}

/// Mean CPU time of 20 runs; of fewer it would be coarse, for some kernels count in ticks of 4 ms.
fn cpu_ms(mut run: impl FnMut()) -> f64 {
    const RUNS: u32 = 20;
    let start = thread_cpu();
    (0..RUNS).for_each(|_| run());
    let spent = thread_cpu().zip(start).map(|(end, start)| end.saturating_sub(start));
    spent.map_or(f64::NAN, |spent| spent.as_secs_f64() * 1e3 / f64::from(RUNS))
}

/// One core's work for a frame.
fn print_cpu(shape: &FrameShape, tree: &mut Tree) {
    let (mut encoder, mut decoder) = (StripEncoder::default(), StripDecoder::default());
    let mut strips = vec![Vec::new(); shape.strips()];
    let encode_ms = cpu_ms(|| {
        for (rows, strip) in tree.bands_mut(u32::from(shape.strip_rows)).iter().zip(&mut strips) {
            strip.clear();
            encoder.encode(shape, rows, strip);
        }
    });
    let mut decoded = tree.clone();
    let decode_ms = cpu_ms(|| {
        for (rows, strip) in decoded.bands_mut(u32::from(shape.strip_rows)).iter_mut().zip(&strips) {
            decoder.decode(shape, strip, rows).expect("own bytes");
        }
    });
    println!("  CPU time of one core: encode {encode_ms:.1} ms, decode {decode_ms:.1} ms");
}

/// Depth within a quarter of a pixel for 20 cm, the default bound.
fn bounded(color_coding: ColorCoding) -> FrameFormat {
    FrameFormat { color_coding, depth: DepthFormat::Bounded(DepthBound::default()), ..FrameFormat::default() }
}

/// Whole frames on all cores: the rate a session can hold.
fn frames(c: &mut Criterion) {
    let mut group = c.benchmark_group("frame");
    let formats = [
        ("root8", FrameFormat::default()),
        ("root8 bounded", bounded(ColorCoding::Bounded { error: 2 })),
        ("bounded without colour", bounded(ColorCoding::Video { quantiser: 26 })),
        ("root10 d24", FrameFormat { color: ColorFormat::Root10, ..FrameFormat::default() }.with_depth_bits(24, 16)),
    ];
    for (name, format) in formats {
        for noise in NOISE {
            let (shape, mut tree) = room::frame(1024, noise, format, STRIP_ROWS);
            let mut session = Session::new(&shape);
            session.encode(&shape, &mut tree);
            let pixels = tree.camera.size.pixels();
            let bits = |bytes: usize| 8.0 * bytes as f64 / pixels as f64;
            println!("\n{name}, noise {noise}: {:.2} bits/pixel", bits(session.bytes()));
            for (plane, (node, kind, _)) in shape.planes().into_iter().enumerate() {
                let bytes = session.strips.iter().map(|strip| strip.1[plane].bytes).sum();
                println!(
                    "  {:<18} {:.3} bits/pixel",
                    format!("{}.{}", shape.plan.name(node.into()), kind.name()),
                    bits(bytes)
                );
            }
            print_cpu(&shape, &mut tree);
            let raw_bits: usize = shape.planes().iter().map(|plane| plane.2).sum();
            group.throughput(Throughput::Bytes((pixels * raw_bits / 8) as u64));
            group.bench_function(BenchmarkId::new(format!("encode {name}"), noise), |b| {
                b.iter(|| session.encode(&shape, &mut tree));
            });
            let mut decoded = tree.clone();
            group.bench_function(BenchmarkId::new(format!("decode {name}"), noise), |b| {
                b.iter(|| session.decode(&shape, &mut decoded));
            });
        }
    }
    group.finish();
}

/// Shape operators of a solid that bends differently everywhere: bytes, and the error of an entry over the largest of its
/// pixel.
fn shapes(_: &mut Criterion) {
    let format = FrameFormat { shape_bits: 0, ..FrameFormat::default() };
    let (shape, mut tree) = room::solid::frame(1024, format, STRIP_ROWS);
    println!("solid without shapes");
    print_cpu(&shape, &mut tree);
    for shape_bits in [6, 8, 10, 12] {
        let format = FrameFormat { shape_bits, ..FrameFormat::default() };
        let (shape, mut tree) = room::solid::frame(1024, format, STRIP_ROWS);
        let (codes, defined) = room::solid::shape_codes(&shape, &tree);
        for predictor in [Predictor::Gradient, Predictor::Median] {
            for packing in [Packing::Runs, Packing::Bytes] {
                let strips = code_all(&codes, usize::from(shape_bits), &defined, predictor, packing);
                let bits = 8.0 * strips.iter().map(Vec::len).sum::<usize>() as f64 / defined.len() as f64;
                println!("refract.shape of {shape_bits} bits, {predictor:?} {packing:?}: {bits:.3} bits/pixel");
            }
        }
        print_cpu(&shape, &mut tree);
        let mut session = Session::new(&shape);
        session.encode(&shape, &mut tree);
        let plane = shape.planes().iter().position(|plane| plane.1 == PlaneKind::Shape).expect("a solid");
        let bytes: usize = session.strips.iter().map(|strip| strip.1[plane].bytes).sum();
        let mut decoded = shape.tree(tree.render_pose);
        session.decode(&shape, &mut decoded);
        let (sent, got) = (&tree.nodes[2], &decoded.nodes[2]);
        let known: Vec<usize> = (0..sent.interface.len()).filter(|&pixel| got.interface[pixel] > 0).collect();
        let mut errors: Vec<f32> = known
            .iter()
            .filter_map(|&pixel| {
                // In the basis of the normal as it came.
                let was = sent.shape_at(pixel)?.turned(sent.normal_at(pixel), got.normal_at(pixel)).to_array();
                let is = got.shape_at(pixel)?.to_array();
                let size = was.iter().fold(0.0_f32, |size, entry| size.max(entry.abs()));
                Some([0, 1, 2].map(|entry: usize| (is[entry] - was[entry]).abs() / size))
            })
            .flatten()
            .collect();
        errors.sort_by(f32::total_cmp);
        println!(
            "refract.shape of {shape_bits} bits: {:.3} bits/pixel, {:.2} per pixel of the solid; error over the largest entry of the pixel: median {:.2} %, largest {:.2} %",
            8.0 * bytes as f64 / sent.interface.len() as f64,
            8.0 * bytes as f64 / known.len() as f64,
            100.0 * errors[errors.len() / 2],
            100.0 * errors[errors.len() - 1]
        );
    }
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
                    let bits_per_pixel = 8.0 * bytes as f64 / defined.len() as f64;
                    let encode_ms = cpu_ms(|| drop(code_all(&channels, bits, &defined, predictor, packing)));
                    let decode_ms =
                        cpu_ms(|| decode_all(&strips, channels.len(), bits, defined.len(), predictor, packing));
                    println!(
                        "{case}, noise {noise}: {bits_per_pixel:.3} bits/pixel, CPU encode {encode_ms:.2} ms, decode {decode_ms:.2} ms"
                    );
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

fn decode_all(strips: &[Vec<u8>], channels: usize, bits: usize, pixels: usize, predictor: Predictor, packing: Packing) {
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
    targets = shapes, frames, codings
}
criterion_main!(benches);
