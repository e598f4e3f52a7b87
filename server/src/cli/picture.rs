//! Pictures as files: OpenEXR in linear light, PNG for the eye. A file is written whole or not at all.

use crate::film::Image;
use anyhow::{Context, Result, anyhow};
use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Layer, LayerAttributes, WritableImage};
use glam::Vec3;
use std::fs::{File, remove_file, rename};
use std::path::{Path, PathBuf};
use warplight_protocol::ImageSize;
use warplight_protocol::frame::{Tree, flatten};
use warplight_protocol::tone::display_from_radiance;

/// The kinds of files, by their extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PictureKind {
    Exr,
    Png,
}

impl PictureKind {
    /// The kind that a path asks for.
    pub(super) fn of(path: &Path) -> Result<PictureKind> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("exr") => Ok(PictureKind::Exr),
            Some("png") => Ok(PictureKind::Png),
            _ => Err(anyhow!("{}: expected a path that ends in .exr or .png", path.display())),
        }
    }
}

/// A file that comes to be under its name only when it is whole; until then it lies beside it.
#[derive(Debug)]
pub(super) struct WholeFile {
    path: PathBuf,
    unfinished: PathBuf,
}

impl WholeFile {
    /// Makes sure at once that the file can be written: a long rendering should not end in nothing.
    pub(super) fn create(path: &Path) -> Result<WholeFile> {
        let name = path.file_name().with_context(|| format!("{}: expected a file", path.display()))?;
        if path.is_dir() {
            return Err(anyhow!("{}: expected a file, found a folder", path.display()));
        }
        let unfinished = path.with_file_name(format!(".{}.{}.part", name.to_string_lossy(), std::process::id()));
        File::create(&unfinished).with_context(|| format!("{}: cannot be written", path.display()))?;
        Ok(WholeFile { path: path.to_owned(), unfinished })
    }

    /// Writes the contents by `write` and gives the file its name.
    fn finish(self, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
        write(&self.unfinished)
            .and_then(|()| Ok(rename(&self.unfinished, &self.path)?))
            .with_context(|| format!("{}: cannot be written", self.path.display()))
    }

    /// Writes bytes as they are.
    pub(super) fn write_bytes(self, bytes: &[u8]) -> Result<()> {
        self.finish(|path| Ok(std::fs::write(path, bytes)?))
    }

    /// Writes linear RGB as OpenEXR.
    pub(super) fn write_exr(self, image: &Image, with_error: bool) -> Result<()> {
        let mut planes = rgb_planes("", &image.radiance);
        if with_error {
            planes.extend(rgb_planes("standard_error.", &image.standard_error));
        }
        self.finish(|path| write_planes(path, image.size, planes))
    }

    /// Writes tone-mapped RGB as PNG.
    pub(super) fn write_png(self, image: &Image, exposure: f32) -> Result<()> {
        let bytes: Vec<u8> =
            image.radiance.iter().flat_map(|&radiance| display_from_radiance(radiance, exposure)).collect();
        let ImageSize { width, height } = image.size;
        self.finish(|path| {
            Ok(image::save_buffer_with_format(
                path,
                &bytes,
                width,
                height,
                image::ColorType::Rgb8,
                image::ImageFormat::Png,
            )?)
        })
    }

    /// Writes all planes of a tree as layers of one OpenEXR picture, named by node: `root.R`,
    /// `reflect.distance`, `refract.normal.X`. The channels without a layer are the composited picture.
    pub(super) fn write_tree(self, tree: &Tree) -> Result<()> {
        let mut picture = vec![Vec3::ZERO; tree.camera.size.pixels()];
        flatten(tree, 0..picture.len(), &mut picture);
        let mut channels = rgb_planes("", &picture);
        for (node, planes) in tree.nodes.iter().enumerate() {
            let layer = tree.plan.name(node);
            let mut push = |name: &str, samples: &[f32]| channels.push((format!("{layer}.{name}"), samples.to_vec()));
            for (name, samples) in ["R", "G", "B"].into_iter().zip(&planes.radiance) {
                push(name, samples);
            }
            push("distance", &planes.distance);
            if tree.plan.has_children(node) {
                push("interface", &planes.interface.iter().map(|&index| f32::from(index)).collect::<Vec<_>>());
                for (name, samples) in ["normal.X", "normal.Y", "normal.Z"].into_iter().zip(&planes.normal) {
                    push(name, samples);
                }
            }
        }
        self.finish(|path| write_planes(path, tree.camera.size, channels))
    }
}

impl Drop for WholeFile {
    fn drop(&mut self) {
        // Gone already if it has become the file.
        let _ = remove_file(&self.unfinished);
    }
}

fn rgb_planes(prefix: &str, pixels: &[Vec3]) -> Vec<(String, Vec<f32>)> {
    let channel =
        |(index, name): (usize, &str)| (format!("{prefix}{name}"), pixels.iter().map(|pixel| pixel[index]).collect());
    ["R", "G", "B"].into_iter().enumerate().map(channel).collect()
}

fn write_planes(path: &Path, size: ImageSize, planes: Vec<(String, Vec<f32>)>) -> Result<()> {
    let channels =
        planes.into_iter().map(|(name, samples)| AnyChannel::new(name.as_str(), FlatSamples::F32(samples))).collect();
    let layer = Layer::new(
        (size.width as usize, size.height as usize),
        LayerAttributes::default(),
        Encoding::FAST_LOSSLESS,
        AnyChannels::sort(channels),
    );
    Ok(exr::prelude::Image::from_layer(layer).write().to_file(path)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> Image {
        let size = ImageSize::new(3, 2);
        let radiance = (0..6).map(|index| Vec3::new(index as f32, 0.5, 1e4)).collect();
        Image { size, radiance, standard_error: vec![Vec3::ZERO; 6], spp: 1 }
    }

    #[test]
    fn an_exr_has_row_0_at_the_top_and_loses_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        WholeFile::create(&path).unwrap().write_exr(&picture(), false).unwrap();
        let read = exr::prelude::read_first_rgba_layer_from_file(
            &path,
            |size, _| vec![vec![Vec3::ZERO; size.0]; size.1],
            |rows, at, (r, g, b, _): (f32, f32, f32, f32)| rows[at.1][at.0] = Vec3::new(r, g, b),
        );
        let rows = read.unwrap().layer_data.channel_data.pixels;
        assert_eq!(rows.concat(), picture().radiance);
    }

    #[test]
    fn a_file_is_whole_or_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let unfinished = WholeFile::create(&path).unwrap();
        assert!(!path.exists());
        drop(unfinished);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        WholeFile::create(&path).unwrap().write_png(&picture(), 1.0).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(WholeFile::create(&folder.path().join("nowhere/a.png")).is_err());
        assert!(WholeFile::create(folder.path()).is_err());
    }
}
