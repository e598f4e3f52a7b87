//! Layers that other codecs have had in hand: what is seen of them, beside our own codings.
//!
//! The planes of a scene's frame are written to `FOLDER/source`, as raw 32-bit floats: `LAYER.front.f32`, `LAYER.back.f32`,
//! `LAYER.optical_depth.f32`, `LAYER.source.R.f32` and so on, row by row. Whatever made of them something else puts it, in
//! the same form, into folders beside that one, with the bytes it took in a file `bytes`. Each is brought to a new pose and
//! compared as the settings of a sweep are.

use super::study::{Background, Study};
use super::{LIGHT_SPP, Setting, SweepError};
use crate::loopback::write_plane;
use crate::march::{Marcher, Method};
use crate::sweep::{Point, Request};
use std::collections::BTreeMap;
use std::path::Path;
use warplight_protocol::frame::{LayerPlanes, Tree};

/// Folder of the planes before any codec.
const SOURCE: &str = "source";

/// Writes the planes of the default setting, and measures what stands beside them.
pub(in crate::sweep) fn measure(request: &Request<'_>, scene: &str, folder: &Path) -> Result<Vec<Point>, SweepError> {
    let setting = Setting::of_default();
    let study = Study::new(scene, setting.density, request.size, LIGHT_SPP[usize::from(request.quick)])?;
    let mut tree = study.tree(setting.format, setting.exactly);
    let source = folder.join(SOURCE);
    write(&mut tree, &source).map_err(|error| SweepError::Scene(format!("{}: {error}", source.display())))?;
    let pose = study.pose(setting.degrees);
    let seen = study.seen(&pose);
    let mut marcher = Marcher::default();
    marcher.set_stride(setting.stride_px);
    let mut points = Vec::new();
    for folder in folders(folder)? {
        let bytes = read(&folder, &mut tree)?;
        let mut picture = Vec::new();
        marcher.prepare(&tree);
        marcher.march(Method::Layers, &tree, &pose, &study.camera, None, &mut picture);
        let mut dssim = [0.0; 3];
        for (dssim, background) in dssim.iter_mut().zip(Background::ALL) {
            *dssim = study.error(&pose, background, &picture, &seen)?.dssim;
        }
        let more = [
            ("dssim_white", dssim[1]),
            ("dssim_environment", dssim[2]),
            ("bits_per_pixel", bytes as f64 * 8.0 / request.size.pixels() as f64),
        ];
        points.push(Point {
            value: folder.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            scene: scene.to_owned(),
            time_ms: 0.0,
            time_spread_ms: 0.0,
            error: dssim[0],
            bytes,
            pareto: false,
            more: BTreeMap::from(more.map(|(name, value)| (name.to_owned(), value))),
        });
    }
    Ok(points)
}

/// The folders beside the source, by name; the source itself is one of them where somebody has said what it takes.
fn folders(folder: &Path) -> Result<Vec<std::path::PathBuf>, SweepError> {
    let entries =
        std::fs::read_dir(folder).map_err(|error| SweepError::Scene(format!("{}: {error}", folder.display())))?;
    let mut folders: Vec<_> =
        entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| path.join("bytes").is_file()).collect();
    folders.sort();
    Ok(folders)
}

/// The planes of a layer and their names.
fn named(planes: &mut LayerPlanes) -> [(&'static str, &mut Vec<f32>); 6] {
    let [red, green, blue] = &mut planes.source;
    [
        ("front", &mut planes.front),
        ("back", &mut planes.back),
        ("optical_depth", &mut planes.optical_depth),
        ("source.R", red),
        ("source.G", green),
        ("source.B", blue),
    ]
}

fn write(tree: &mut Tree, folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    for (layer, planes) in tree.layers.iter_mut().enumerate() {
        for (name, values) in named(planes) {
            write_plane(&folder.join(format!("{layer}.{name}.f32")), values)?;
        }
    }
    Ok(())
}

/// Reads the planes of a folder into the tree, and how many bytes they took.
fn read(folder: &Path, tree: &mut Tree) -> Result<u64, SweepError> {
    let wrong = |file: &Path, expected: &str| SweepError::Scene(format!("{}: expected {expected}", file.display()));
    for (layer, planes) in tree.layers.iter_mut().enumerate() {
        for (name, values) in named(planes) {
            let file = folder.join(format!("{layer}.{name}.f32"));
            let expected = format!("{} floats, each a finite number not below 0", values.len());
            let bytes = std::fs::read(&file).map_err(|_| wrong(&file, &expected))?;
            let (fours, rest) = bytes.as_chunks::<4>();
            let read: Vec<f32> = fours.iter().map(|&four| f32::from_le_bytes(four)).collect();
            if read.len() != values.len()
                || !rest.is_empty()
                || !read.iter().all(|value| value.is_finite() && *value >= 0.0)
            {
                return Err(wrong(&file, &expected));
            }
            *values = read;
        }
        // A segment that does not end beyond its front is none.
        for pixel in 0..planes.front.len() {
            if planes.back[pixel] <= planes.front[pixel] {
                planes.optical_depth[pixel] = 0.0;
            }
        }
    }
    let file = folder.join("bytes");
    let text = std::fs::read_to_string(&file).unwrap_or_default();
    text.trim().parse().map_err(|_| wrong(&file, "a number of bytes"))
}
