//! `bench --only codec`: live frames along the built-in trace, through the codec in each way colour can travel.
//!
//! Frames are those of a session of ten per second, so that video has its motion. Bits are means over the frames; the times
//! of a frame are those of all its planes on all cores.

use super::Failure;
use super::bench::Bench;
use crate::loopback::{Beat, Loopback, Walk, write_plane};
use crate::trace::Trace;
use anyhow::Context;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;
use warplight_protocol::codec::FrameShape;
use warplight_protocol::frame::{
    ColorCoding, DepthBound, DepthFormat, FrameFormat, Tree, decode_thesis, encode_thesis, thesis_bits,
};

/// Frames that are coded in turn.
const FRAMES: u32 = 8;
const BEAT: Beat = Beat { frames: FRAMES, frame_hz: 10.0, age_secs: 0.0, start_secs: 2.0 };

/// The formats that are timed, by what the name of the case ends with: the default, as it is, within bounds, as video.
fn formats() -> [(&'static str, FrameFormat); 5] {
    let exact = FrameFormat::exact();
    let bounded = FrameFormat { depth: DepthFormat::Bounded(DepthBound::default()), ..exact };
    let of = |color_coding| FrameFormat { color_coding, ..bounded };
    [
        ("", FrameFormat::default()),
        ("exact", exact),
        ("depth bounded", bounded),
        ("bounded", of(ColorCoding::Bounded { error: 2 })),
        ("video", of(ColorCoding::Video { quantiser: 28 })),
    ]
}

/// Runs the case `codec SCENE` in all formats; writes the planes of the last frame, before and after, where asked to.
pub(super) fn run(bench: &mut Bench, scene: &str, planes: Option<&Path>) -> Result<(), Failure> {
    let mut walk = Walk::new(scene, &Trace::built_in(), bench.camera.size, BEAT)
        .map_err(|error| Failure::Input(error.to_string()))?;
    if let (Some(folder), Some(last)) = (planes, walk.frames.last()) {
        write_planes(last, &folder.join("source")).with_context(|| format!("{}", folder.display()))?;
    }
    thesis(bench, scene, &walk, planes)?;
    for (name, format) in formats() {
        let case = format!("codec {scene} {name}").trim_end().to_owned();
        let shape = FrameShape { format, ..walk.shape.clone() };
        let mut loopback = Loopback::default();
        let mut decoded = shape.tree(walk.frames[0].render_pose);
        let [mut encode_ms, mut decode_ms] = [Vec::new(), Vec::new()];
        let mut bytes: BTreeMap<_, usize> = BTreeMap::new();
        // The first round makes the memory and is not counted.
        let rounds = 1 + bench.runs.div_ceil(FRAMES);
        for round in 0..rounds {
            for tree in &mut walk.frames {
                let start = Instant::now();
                let frame = loopback.encode(tree, &shape);
                let between = Instant::now();
                decoded.render_pose = tree.render_pose;
                loopback.decode(&frame, &shape, &mut decoded).context("decoding a frame just encoded")?;
                if round > 0 {
                    encode_ms.push((between - start).as_secs_f64() * 1e3);
                    decode_ms.push(between.elapsed().as_secs_f64() * 1e3);
                    for (plane, count) in frame.plane_bytes {
                        *bytes.entry(plane).or_default() += count;
                    }
                }
            }
        }
        let values = encode_ms.len() as f64 * bench.camera.size.pixels() as f64;
        let bits = |bytes: usize| bytes as f64 * 8.0 / values;
        let whole = Some(bits(bytes.values().sum()));
        bench.push(&case, "encode", whole, encode_ms);
        bench.push(&case, "decode", whole, decode_ms);
        for (&(node, kind), &count) in &bytes {
            bench.push(&case, &kind.name_in(&shape.plan, node), Some(bits(count)), Vec::new());
        }
        if let Some(folder) = planes {
            let name = if name.is_empty() { "default" } else { name };
            write_planes(&decoded, &folder.join(name)).with_context(|| format!("{}", folder.display()))?;
        }
    }
    Ok(())
}

/// The uncompressed frame of the thesis, of the last frame.
fn thesis(bench: &mut Bench, scene: &str, walk: &Walk, planes: Option<&Path>) -> Result<(), Failure> {
    let Some(tree) = walk.frames.last() else { return Ok(()) };
    let case = format!("codec {scene} thesis");
    let white = 1.0 / walk.shape.exposure;
    let distances = tree.nodes.iter().flat_map(|node| &node.distance).copied();
    let near_m = distances.filter(|&distance| distance > 0.0).fold(f32::MAX, f32::min);
    let [mut encode_ms, mut decode_ms] = [Vec::new(), Vec::new()];
    for round in 0..=bench.runs {
        let start = Instant::now();
        let bytes = encode_thesis(tree, white, near_m);
        let between = Instant::now();
        let (plan, interfaces) = (tree.plan.clone(), tree.interfaces.clone());
        let decoded = decode_thesis(&bytes, tree.camera, plan, interfaces, white, near_m).context("a thesis frame")?;
        if round > 0 {
            encode_ms.push((between - start).as_secs_f64() * 1e3);
            decode_ms.push(between.elapsed().as_secs_f64() * 1e3);
        }
        if let Some(folder) = planes.filter(|_| round == 0) {
            write_planes(&decoded, &folder.join("thesis")).with_context(|| format!("{}", folder.display()))?;
        }
    }
    let bits = thesis_bits(&tree.camera, &tree.plan, &tree.interfaces) as f64 / tree.camera.size.pixels() as f64;
    bench.push(&case, "encode", Some(bits), encode_ms);
    bench.push(&case, "decode", Some(bits), decode_ms);
    Ok(())
}

/// All planes of a frame, as files NODE.PLANE.f32.
fn write_planes(tree: &Tree, folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    for (node, planes) in tree.nodes.iter().enumerate() {
        let name = tree.plan.name(node);
        let interface: Vec<f32> = planes.interface.iter().map(|&index| f32::from(index)).collect();
        let [red, green, blue] = &planes.radiance;
        let [x, y, z] = &planes.normal;
        let [s11, s12, s22] = &planes.shape;
        let named = [
            ("radiance.R", red),
            ("radiance.G", green),
            ("radiance.B", blue),
            ("distance", &planes.distance),
            ("interface", &interface),
            ("normal.X", x),
            ("normal.Y", y),
            ("normal.Z", z),
            ("shape.11", s11),
            ("shape.12", s12),
            ("shape.22", s22),
        ];
        for (plane, values) in named.into_iter().filter(|(_, values)| !values.is_empty()) {
            write_plane(&folder.join(format!("{name}.{plane}.f32")), values)?;
        }
    }
    Ok(())
}
