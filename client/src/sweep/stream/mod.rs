//! Points of the codec: what coding changes in the displayed picture, for how many bytes and how much time.
//!
//! Live frames of a scene along a head trace ([`Walk`]) go through the codec in the format of a setting, one after the other,
//! as in a session. Each is brought to the pose the head has by the time it is shown, and so is the frame before coding: the
//! error is the FLIP between the two pictures, so it is that of the codec alone, seen through mirrors and glass; where converged
//! pictures are asked for, the FLIP to those stands beside it. PSNR, the
//! encoder's and the decoder's time and the bits of colour and of all else stand beside it.

mod settings;

use super::surface::median_and_spread;
use super::{Point, Progress, Request, SweepError};
use crate::loopback::{Beat, EncodedFrame, Loopback, Walk};
use crate::measure::{MeasureError, PIXELS_PER_DEGREE, flip, psnr_srgb8};
use crate::warp::{Mode, Warper};
use image::RgbImage;
pub(super) use settings::{Setting, child_bounds, color_formats, colors, depth_bounds, zstd_levels};
use warplight_protocol::Pose;
use warplight_protocol::codec::{FrameShape, PlaneKind};
use warplight_protocol::frame::Tree;
use warplight_protocol::tone::ToneTable;

/// Scenes with mirrors, glass and water.
pub(super) const SCENES: [&str; 3] = ["gallery", "pool", "glass"];
/// A room at night with a lamp in it, and one with the sun outside.
pub(super) const DARK_AND_BRIGHT: [&str; 2] = ["lamp", "pool"];
/// As many frames per second as a session of two cores has.
const FRAME_HZ: f64 = 10.0;
/// 50 ms on the way, and half a frame until the next one.
const AGE_SECS: f64 = 0.1;
/// Into the trace, where the head has begun to move.
const START_SECS: f64 = 2.0;
/// Frames, and those of a quick sweep.
const FRAMES: [u32; 2] = [10, 4];

/// Sums over the frames of a setting.
#[derive(Default)]
struct Sums {
    flip: f64,
    flip_reference: Option<f64>,
    psnr_db: f64,
    bytes: usize,
    color_bytes: usize,
    encode_ms: Vec<f64>,
    decode_ms: Vec<f64>,
    both_ms: Vec<f64>,
}

/// Measures settings on a scene.
pub(super) fn measure(
    request: &Request<'_>,
    scene: &str,
    settings: &[Setting],
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let frames = FRAMES[usize::from(request.quick)];
    let beat = Beat { frames, frame_hz: FRAME_HZ, age_secs: AGE_SECS, start_secs: START_SECS };
    let mut walk =
        Walk::new(scene, request.trace, request.size, beat).map_err(|error| SweepError::Scene(error.to_string()))?;
    let mut warper = Warper::default();
    let mut uncoded = Vec::new();
    for (tree, display_pose) in walk.frames.iter().zip(&walk.display_poses) {
        let mut picture = RgbImage::default();
        warper.prepare(Mode::Specular, tree);
        warper.show(Mode::Specular, tree, display_pose, &walk.shape.camera, walk.shape.exposure, &mut picture);
        warper.forget();
        uncoded.push(picture);
    }
    let references: Vec<RgbImage> = match request.reference_spp {
        0 => Vec::new(),
        spp => walk.display_poses.iter().map(|pose| reference(&walk, pose, spp)).collect(),
    };
    let mut points = Vec::new();
    for setting in settings {
        let shape = FrameShape { format: setting.format, ..walk.shape.clone() };
        let mut loopback = Loopback::new(setting.zstd_level);
        let mut sums = Sums::default();
        let mut decoded = shape.tree(walk.frames[0].render_pose);
        let mut picture = RgbImage::default();
        for (frame, tree) in walk.frames.iter_mut().enumerate() {
            let encoded = timed(request, &mut loopback, tree, &shape, &mut decoded, &mut sums)?;
            sums.bytes += encoded.bytes();
            sums.color_bytes += color_bytes(&encoded);
            warper.prepare(Mode::Specular, &decoded);
            warper.show(
                Mode::Specular,
                &decoded,
                &walk.display_poses[frame],
                &shape.camera,
                shape.exposure,
                &mut picture,
            );
            warper.forget();
            let measured = |error: MeasureError| SweepError::Scene(error.to_string());
            let map = flip(&uncoded[frame], &picture, PIXELS_PER_DEGREE).map_err(measured)?;
            sums.flip += map.mean(None).map_err(measured)?;
            if let Some(reference) = references.get(frame) {
                let map = flip(reference, &picture, PIXELS_PER_DEGREE).map_err(measured)?;
                *sums.flip_reference.get_or_insert(0.0) += map.mean(None).map_err(measured)?;
            }
            sums.psnr_db += psnr_srgb8(&uncoded[frame], &picture, None).map_err(measured)?;
            progress((points.len() * frames as usize + frame + 1) as u64, settings.len() as u64 * u64::from(frames));
        }
        points.push(point(scene, setting, &shape, f64::from(frames), &sums));
    }
    Ok(points)
}

/// What is really seen, as it is displayed.
pub(super) fn reference(walk: &Walk, pose: &Pose, spp: u32) -> RgbImage {
    let tone = ToneTable::default();
    let radiance = walk.seen_from(pose, spp);
    let codes: Vec<u8> =
        radiance.into_iter().flat_map(|radiance| tone.display_from_radiance(radiance, walk.shape.exposure)).collect();
    let size = walk.shape.camera.size;
    RgbImage::from_raw(size.width, size.height, codes).unwrap_or_default()
}

/// Encodes and decodes a frame, and notes how long both took. The first run counts: video has a past.
fn timed(
    request: &Request<'_>,
    loopback: &mut Loopback,
    tree: &mut Tree,
    shape: &FrameShape,
    decoded: &mut Tree,
    sums: &mut Sums,
) -> Result<EncodedFrame, SweepError> {
    let start = (request.now)();
    let encoded = loopback.encode(tree, shape);
    let between = (request.now)();
    decoded.render_pose = tree.render_pose;
    loopback.decode(&encoded, shape, decoded)?;
    let end = (request.now)();
    sums.encode_ms.push((between - start).as_secs_f64() * 1e3);
    sums.decode_ms.push((end - between).as_secs_f64() * 1e3);
    sums.both_ms.push((end - start).as_secs_f64() * 1e3);
    Ok(encoded)
}

fn color_bytes(frame: &EncodedFrame) -> usize {
    let of_color = |kind: PlaneKind| matches!(kind, PlaneKind::Radiance | PlaneKind::Source);
    frame.plane_bytes.iter().filter(|((_, kind), _)| of_color(*kind)).map(|(_, bytes)| bytes).sum()
}

fn point(scene: &str, setting: &Setting, shape: &FrameShape, frames: f64, sums: &Sums) -> Point {
    let (time_ms, time_spread_ms) = median_and_spread(&sums.both_ms);
    let bits = |bytes: usize| bytes as f64 * 8.0 / (frames * shape.camera.size.pixels() as f64);
    let more = [
        ("psnr_db", sums.psnr_db / frames),
        ("bits_per_pixel", bits(sums.bytes)),
        ("color_bits_per_pixel", bits(sums.color_bytes)),
        ("mbps", sums.bytes as f64 * 8e-6 / frames * FRAME_HZ),
        ("encode_ms", median_and_spread(&sums.encode_ms).0),
        ("decode_ms", median_and_spread(&sums.decode_ms).0),
    ];
    let more = more.into_iter().chain(sums.flip_reference.map(|flip| ("flip_reference", flip / frames)));
    Point {
        value: setting.value.clone(),
        scene: scene.to_owned(),
        time_ms,
        time_spread_ms,
        error: sums.flip / frames,
        bytes: (sums.bytes as f64 / frames) as u64,
        pareto: false,
        more: more.map(|(name, value)| (name.to_owned(), value)).collect(),
    }
}
