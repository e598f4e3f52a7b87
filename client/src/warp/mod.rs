//! From the latest frame to the picture for the head pose of this moment.
//!
//! decode -> **warp** -> composite. A [`Warper`] is given a frame once ([`Warper::prepare`]) and then asked
//! for a picture at every display refresh ([`Warper::show`]). One file holds one mode; [`Mode`] is the closed
//! set. A mode computes for each display pixel where in the old picture it comes from, or that nothing is known
//! (a hole); holes are then filled the same way for all, so that modes are compared and not their fillings.
//!
//! Modes that paint reflections onto the surface share the flattened picture of the old pose; `specular`,
//! which warps every node on its own, stands beside them and shares only the root's flow.

mod diffuse;
mod fill;
mod reproject;
mod rotation;
mod source;

use fill::Pyramid;
use glam::Vec3;
use image::RgbImage;
use rayon::prelude::*;
use source::Source;
use warplight_protocol::frame::Tree;
use warplight_protocol::tone::ToneTable;
use warplight_protocol::{Camera, Pose};

/// How a frame is brought to a new pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Mode {
    /// Not at all: the stale picture.
    None,
    /// By a homography for the rotation alone: asynchronous timewarp (van Waveren 2016).
    Rotation,
    /// Every pixel at its surface's depth; reflections and refractions are painted on.
    Diffuse,
}

impl Mode {
    /// Every mode, the simplest first.
    pub const ALL: [Mode; 3] = [Mode::None, Mode::Rotation, Mode::Diffuse];

    /// Name in reports and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Mode::None => "none",
            Mode::Rotation => "rotation",
            Mode::Diffuse => "diffuse",
        }
    }
}

impl std::str::FromStr for Mode {
    type Err = String;
    fn from_str(text: &str) -> Result<Mode, String> {
        Mode::ALL.into_iter().find(|mode| mode.name() == text).ok_or_else(|| {
            let names = Mode::ALL.map(Mode::name).join(", ");
            format!("expected one of {names}, found '{text}'")
        })
    }
}

/// What a picture lacked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WarpStatistics {
    /// Pixels of which the frame knows nothing, as a fraction of all.
    pub hole_fraction: f64,
}

/// Radiance of a pixel that is not known.
const HOLE: Vec3 = Vec3::splat(f32::NAN);

/// Warps frames; its buffers live from picture to picture.
#[derive(Debug, Default)]
pub struct Warper {
    source: Source,
    splat: diffuse::Splat,
    radiance: Vec<Vec3>,
    pyramid: Pyramid,
    tone: ToneTable,
}

impl Warper {
    /// Takes a frame in.
    pub fn prepare(&mut self, tree: &Tree) {
        self.source.prepare(tree);
    }

    /// Makes the picture for `display_pose` by `mode` from the frame taken in last: linear radiance times
    /// `exposure`, tone-mapped into `picture`, whose size is set to the camera's.
    pub fn show(
        &mut self,
        mode: Mode,
        display_pose: &Pose,
        camera: &Camera,
        exposure: f32,
        picture: &mut RgbImage,
    ) -> WarpStatistics {
        let pixels = camera.size.pixels();
        self.radiance.resize(pixels, HOLE);
        let Warper { source, splat, radiance, pyramid, tone } = self;
        match mode {
            Mode::None => rotation::warp(source, source.pose(), camera, radiance),
            Mode::Rotation => rotation::warp(source, display_pose, camera, radiance),
            Mode::Diffuse => diffuse::warp(source, display_pose, camera, splat, radiance),
        }
        let holes = pyramid.fill(radiance, camera.size.width as usize);
        if picture.dimensions() != (camera.size.width, camera.size.height) {
            *picture = RgbImage::new(camera.size.width, camera.size.height);
        }
        let row = camera.size.width as usize;
        picture.par_chunks_mut(3 * row).zip(radiance.par_chunks(row)).for_each(|(codes, radiance)| {
            for (code, radiance) in codes.chunks_exact_mut(3).zip(radiance) {
                code.copy_from_slice(&tone.display_from_radiance(*radiance, exposure));
            }
        });
        WarpStatistics { hole_fraction: holes as f64 / pixels.max(1) as f64 }
    }
}

#[cfg(test)]
mod tests;
