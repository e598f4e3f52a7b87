//! From the latest frame to the picture for the head pose of this moment.
//!
//! decode -> **warp** -> composite. A [`Warper`] is given a frame once ([`Warper::prepare`]) and then asked
//! for a picture at every display refresh ([`Warper::show`]). One file holds one mode; [`Mode`] is the closed
//! set. A mode computes for each display pixel where in the old picture it comes from, or that nothing is known
//! (a hole); holes are then filled by push-pull in all of them.
//!
//! Modes that paint reflections onto the surface share the flattened picture of the old pose. `specular`, which
//! warps every node on its own, has its own form of a frame (`prepared`) and its own pipeline (`specular`), written
//! in vectors (`lanes`); the plain code of `diffuse` is what its root is held against.

mod diffuse;
mod exit;
mod fill;
mod lanes;
mod optic;
mod prepared;
mod reproject;
mod rotation;
mod source;
mod specular;
mod texture;
mod tone;

pub use specular::{NodeStatistics, Solver, Stage};

use fill::Pyramid;
use glam::Vec3;
use image::RgbImage;
use lanes::Level;
use prepared::Prepared;
use rayon::prelude::*;
use source::Source;
use specular::Specular;
use tone::ToneTable;
use warplight_protocol::frame::{MAX_NODES, Tree, flatten};
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
    /// Every node as what it is: reflections and refractions move as they do in the world.
    Specular,
}

impl Mode {
    /// Every mode, the simplest first.
    pub const ALL: [Mode; 4] = [Mode::None, Mode::Rotation, Mode::Diffuse, Mode::Specular];

    /// Name in reports and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Mode::None => "none",
            Mode::Rotation => "rotation",
            Mode::Diffuse => "diffuse",
            Mode::Specular => "specular",
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
    /// Pixels of which the frame does not know everything, as a fraction of all.
    pub hole_fraction: f64,
    /// By node of the plan; of mode `specular` alone.
    pub nodes: [NodeStatistics; MAX_NODES],
}

/// Radiance of a pixel that is not known.
const HOLE: Vec3 = Vec3::splat(f32::NAN);

/// Warps frames; its buffers live from picture to picture.
#[derive(Debug, Default)]
pub struct Warper {
    level: Level,
    source: Source,
    splat: diffuse::Splat,
    radiance: Vec<Vec3>,
    pyramid: Pyramid,
    prepared: Prepared,
    specular: Specular,
    tone: ToneTable,
}

impl Warper {
    /// Takes in a frame for pictures by `mode`.
    pub fn prepare(&mut self, mode: Mode, tree: &Tree) {
        match mode {
            Mode::None | Mode::Rotation | Mode::Diffuse => self.source.prepare(tree),
            Mode::Specular => self.prepared.prepare(self.level, tree),
        }
    }

    /// Chooses how mode `specular` searches the pictures of children, from the next one on.
    pub fn set_solver(&mut self, solver: Solver) {
        self.prepared.solver = solver;
    }

    /// Makes the picture for `display_pose` from `tree`, which was taken in last for the same `mode`: linear radiance
    /// times `exposure`, tone-mapped into `picture`, whose size is set to the camera's.
    pub fn show(
        &mut self,
        mode: Mode,
        tree: &Tree,
        display_pose: &Pose,
        camera: &Camera,
        exposure: f32,
        picture: &mut RgbImage,
    ) -> WarpStatistics {
        if picture.dimensions() != (camera.size.width, camera.size.height) {
            *picture = RgbImage::new(camera.size.width, camera.size.height);
        }
        match mode {
            // An unmoved head: the flow of every node is known exactly, and so is the picture.
            Mode::Specular if *display_pose == tree.render_pose && *camera == tree.camera => {
                self.show_unmoved(tree, exposure, picture);
                WarpStatistics::default()
            }
            Mode::Specular => {
                let Warper { level, prepared, specular, tone, .. } = self;
                specular.warp(*level, prepared, display_pose, camera);
                let (nodes, hole_fraction) = specular.statistics();
                specular.fill();
                specular.tone(tone, exposure, picture);
                WarpStatistics { hole_fraction, nodes }
            }
            Mode::None | Mode::Rotation | Mode::Diffuse => {
                self.show_painted(mode, display_pose, camera, exposure, picture)
            }
        }
    }

    /// Runs one stage of a picture by [`Mode::Specular`], those before it having run for the same pose: for benches.
    pub fn run(&mut self, stage: Stage, display_pose: &Pose, camera: &Camera, exposure: f32, picture: &mut RgbImage) {
        let Warper { level, prepared, specular, tone, .. } = self;
        match stage {
            Stage::Splat => specular.splat(prepared, display_pose, camera),
            Stage::Samples => specular.sample(*level, prepared, display_pose, camera),
            Stage::Tiles => specular.tiles(*level, prepared, display_pose, camera),
            Stage::Fill => specular.fill(),
            Stage::Tone => specular.tone(tone, exposure, picture),
        }
    }

    /// Fractions of the tiles of the last `specular` picture whose root, and all of whose children, were interpolated.
    pub fn smooth_tiles(&self) -> [f64; 2] {
        self.specular.smooth_fractions()
    }

    fn show_unmoved(&mut self, tree: &Tree, exposure: f32, picture: &mut RgbImage) {
        let Warper { radiance, tone, .. } = self;
        radiance.resize(tree.camera.size.pixels(), HOLE);
        let row = tree.camera.size.width as usize;
        let rows = picture.par_chunks_mut(3 * row).zip(radiance.par_chunks_mut(row));
        rows.enumerate().for_each(|(y, (codes, radiance))| {
            flatten(tree, y * row..(y + 1) * row, radiance);
            tone_row(tone, radiance, exposure, codes);
        });
    }

    fn show_painted(
        &mut self,
        mode: Mode,
        display_pose: &Pose,
        camera: &Camera,
        exposure: f32,
        picture: &mut RgbImage,
    ) -> WarpStatistics {
        let pixels = camera.size.pixels();
        self.radiance.resize(pixels, HOLE);
        let Warper { source, splat, radiance, pyramid, tone, .. } = self;
        match mode {
            Mode::None => rotation::warp(source, source.pose(), camera, radiance),
            Mode::Rotation => rotation::warp(source, display_pose, camera, radiance),
            Mode::Diffuse | Mode::Specular => diffuse::warp(source, display_pose, camera, splat, radiance),
        }
        let holes = pyramid.fill(radiance, camera.size.width as usize);
        let row = camera.size.width as usize;
        picture.par_chunks_mut(3 * row).zip(radiance.par_chunks(row)).for_each(|(codes, radiance)| {
            tone_row(tone, radiance, exposure, codes);
        });
        WarpStatistics { hole_fraction: holes as f64 / pixels.max(1) as f64, ..WarpStatistics::default() }
    }
}

fn tone_row(tone: &ToneTable, radiance: &[Vec3], exposure: f32, codes: &mut [u8]) {
    for (codes, radiance) in codes.chunks_exact_mut(3).zip(radiance) {
        for (code, value) in codes.iter_mut().zip((*radiance * exposure).to_array()) {
            *code = tone.srgb8_from_linear(value);
        }
    }
}

#[cfg(test)]
mod oracles;
#[cfg(test)]
mod tests;
