//! From the latest frame to the picture for the head pose of this moment.
//!
//! decode -> **warp** -> composite. A [`Warper`] is given a frame once ([`Warper::prepare`]) and then asked
//! for a picture at every display refresh ([`Warper::show`]). One file holds one mode; [`Mode`] is the closed
//! set. A mode computes for each display pixel where in the old picture it comes from, or that nothing is known
//! (a hole); holes are then filled by push-pull in all of them, or by another [`HoleFilling`].
//!
//! `specular` warps every node on its own: it has its own form of a frame (`prepared`) and its own pipeline
//! (`specular`), written in vectors (`lanes`). `diffuse` is the same pipeline on the flattened picture of the old pose, a
//! tree of one node: reflections are painted onto the surface. The simpler modes share that picture, too (`source`).

mod adopt;
mod canvas;
#[cfg(test)]
mod diffuse;
mod exit;
mod faces;
mod filling;
mod frames;
mod media;
mod mesh;
mod optic;
mod planar;
mod prepared;
mod pyramid;
mod reproject;
mod rotation;
mod source;
mod specular;
mod texture;
mod tone;

pub use filling::HoleFilling;
pub use media::MediaStage;
pub use prepared::Normals;
use prepared::Rung;
pub use specular::{NodeStatistics, Solver, Stage};

use crate::lanes::Level;
use crate::march::{Marcher, Method};
use canvas::Canvas;
use frames::Frames;
use glam::{Vec3, Vec4};
use image::RgbImage;
use pyramid::Pyramid;
use rayon::prelude::*;
use source::Source;
use specular::{Specular, View};
use warplight_protocol::camera::Projection;
use warplight_protocol::frame::{Interfaces, MAX_NODES, Plan, Tree, flatten};
use warplight_protocol::{Camera, Pose};

/// How a frame is brought to a new pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Mode {
    /// Not at all: the stale picture.
    None,
    /// By a homography for the rotation alone: asynchronous timewarp (van Waveren 2016).
    Rotation,
    /// By the homography of a plane at the picture's mean depth.
    Planar,
    /// Every pixel at its surface's depth; reflections and refractions are painted on.
    Diffuse,
    /// The depth as a mesh of triangles: a relief, with reflections and refractions painted on.
    Mesh,
    /// Every node as what it is: reflections and refractions move as they do in the world, and the segments of a volume
    /// are integrated again.
    Specular,
    /// The same, but of a volume every layer is a picture on a coarse surface: slabs (Müller et al. 1999).
    Slabs,
    /// The same, but a volume is one surface at its mean depth (Zellmann et al. 2012).
    MeanDepth,
}

impl Mode {
    /// Every mode, the simplest first, those of volumes last.
    pub const ALL: [Mode; 8] = [
        Mode::None,
        Mode::Rotation,
        Mode::Planar,
        Mode::Diffuse,
        Mode::Mesh,
        Mode::Specular,
        Mode::Slabs,
        Mode::MeanDepth,
    ];

    /// How it shows the layers of a volume, if it does not paint them on.
    fn of_volumes(self) -> Option<Method> {
        match self {
            Mode::Specular => Some(Method::Layers),
            Mode::Slabs => Some(Method::Slabs),
            Mode::MeanDepth => Some(Method::MeanDepth),
            Mode::None | Mode::Rotation | Mode::Planar | Mode::Diffuse | Mode::Mesh => None,
        }
    }

    /// Whether a frame tells it from mode `specular`, which it is but for volumes.
    pub fn is_told_apart_by(self, tree: &Tree) -> bool {
        !matches!(self, Mode::Slabs | Mode::MeanDepth) || !tree.layers.is_empty()
    }

    /// Whether an unmoved head sees the frame's own picture because every pixel is where it was.
    fn has_depth(self) -> bool {
        matches!(self, Mode::Diffuse | Mode::Specular | Mode::Slabs | Mode::MeanDepth)
    }

    /// Whether it can show such frames: the simplest modes know one plane only.
    pub fn shows(self, projection: Projection) -> bool {
        projection == Projection::Perspective || !matches!(self, Mode::None | Mode::Planar | Mode::Mesh)
    }

    /// Name in reports and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Mode::None => "none",
            Mode::Rotation => "rotation",
            Mode::Planar => "planar",
            Mode::Diffuse => "diffuse",
            Mode::Mesh => "mesh",
            Mode::Specular => "specular",
            Mode::Slabs => "slabs",
            Mode::MeanDepth => "mean-depth",
        }
    }
}

impl std::str::FromStr for Mode {
    type Err = String;
    fn from_str(text: &str) -> Result<Mode, String> {
        // What it is of volumes.
        let text = if text == "layers" { Mode::Specular.name() } else { text };
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
    rung: Rung,
    earlier_frames: usize,
    source: Source,
    mean_inverse_depth: f32,
    relief: mesh::Relief,
    /// The flattened picture as a tree of one node.
    flat: Option<Tree>,
    /// Frames of mode `diffuse`, and of mode `specular`.
    painted: Frames,
    layered: Frames,
    pipeline: Specular,
    pyramid: Pyramid,
    radiance: Vec<Vec3>,
    inverse_depth: Vec<f32>,
    marcher: Marcher,
    surface_m: Vec<f32>,
    media: Vec<Vec4>,
}

impl Warper {
    /// Takes in a frame for pictures by `mode`.
    pub fn prepare(&mut self, mode: Mode, tree: &Tree) {
        let Warper { level, rung, earlier_frames, .. } = *self;
        match mode {
            Mode::None | Mode::Rotation | Mode::Mesh => self.source.prepare(tree),
            Mode::Planar => {
                self.source.prepare(tree);
                self.mean_inverse_depth = planar::mean_inverse_depth(&self.source);
            }
            Mode::Diffuse => {
                let flat = self.flat.get_or_insert_with(|| {
                    Tree::new(tree.render_pose, tree.camera, Plan::diffuse(), Interfaces::default())
                });
                flatten_tree(tree, flat);
                self.painted.take_in(level, rung, flat, earlier_frames);
            }
            Mode::Specular | Mode::Slabs | Mode::MeanDepth => {
                self.layered.take_in(level, rung, tree, earlier_frames);
                if !tree.layers.is_empty() {
                    self.marcher.prepare(tree);
                }
            }
        }
    }

    /// Chooses the instruction set, from the next frame on; the widest unless told otherwise.
    pub(crate) fn set_level(&mut self, level: Level) {
        self.level = level;
        self.marcher.choose_level(level);
    }

    /// Chooses how mode `specular` searches the pictures of children, from the next frame on.
    pub fn set_solver(&mut self, solver: Solver) {
        self.rung.solver = solver;
    }

    /// Chooses how many frames before the latest are kept, at most 4, to be asked for what that does not know.
    pub fn set_earlier_frames(&mut self, count: usize) {
        self.earlier_frames = count;
    }

    /// Forgets all frames: the next one does not follow the last.
    pub fn forget(&mut self) {
        self.painted.clear();
        self.layered.clear();
    }

    /// Chooses where mode `specular` has its normals from, from the next frame on.
    pub fn set_normals(&mut self, normals: Normals) {
        self.rung.normals = normals;
    }

    /// Chooses what pixels are filled with of which nothing is known.
    pub fn set_hole_filling(&mut self, filling: HoleFilling) {
        self.pyramid.set_filling(filling);
    }

    /// Which pixels of the last picture by [`Mode::Specular`] were filled with what is not known of them, row by row.
    pub fn filled_pixels(&self) -> Vec<bool> {
        self.pipeline.filled()
    }

    /// Says how many bits a coordinate of the transmitted normals has, if not those of the default format.
    pub fn set_normal_bits(&mut self, bits: u8) {
        self.rung.normal_bits = bits;
    }

    /// Where each node of each pixel is found in the frame that was taken in last for mode `specular`; not a number where
    /// it is not seen or was not found.
    pub fn flows(&mut self, display_pose: &Pose, camera: &Camera) -> Vec<Vec<glam::Vec2>> {
        let Warper { level, layered, pipeline, .. } = self;
        let sources = layered.seen_from(display_pose, camera);
        sources.iter().next().map_or_else(Vec::new, |frame| pipeline.flows(*level, frame, display_pose, camera))
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
        fit(picture, camera);
        let (codes, _) = picture.as_chunks_mut::<3>();
        let canvas = Canvas::Codes { codes, exposure };
        self.paint(mode, tree, display_pose, camera, canvas)
    }

    /// The same in linear radiance, row by row, for what averages several pictures.
    pub fn radiance(
        &mut self,
        mode: Mode,
        tree: &Tree,
        display_pose: &Pose,
        camera: &Camera,
        radiance: &mut Vec<Vec3>,
    ) -> WarpStatistics {
        radiance.resize(camera.size.pixels(), Vec3::ZERO);
        self.paint(mode, tree, display_pose, camera, Canvas::Radiance(radiance))
    }

    fn paint(
        &mut self,
        mode: Mode,
        tree: &Tree,
        display_pose: &Pose,
        camera: &Camera,
        mut canvas: Canvas<'_>,
    ) -> WarpStatistics {
        // An unmoved head: the flow of every node is known exactly, and so is the picture.
        if mode.has_depth()
            && *display_pose == tree.render_pose
            && let Some(offset) = camera.offset_in(&tree.camera)
        {
            self.show_unmoved(tree, offset, camera, &mut canvas);
            return WarpStatistics::default();
        }
        if let Some(method) = mode.of_volumes().filter(|_| !tree.layers.is_empty()) {
            return self.paint_behind_media(method, tree, display_pose, camera, &mut canvas);
        }
        let Warper { level, pipeline, pyramid, .. } = self;
        let sources = match mode {
            Mode::None | Mode::Rotation | Mode::Planar | Mode::Mesh => {
                return self.show_painted(mode, display_pose, camera, &mut canvas);
            }
            Mode::Diffuse => self.painted.seen_from(display_pose, camera),
            Mode::Specular | Mode::Slabs | Mode::MeanDepth => self.layered.seen_from(display_pose, camera),
        };
        let view = View { level: *level, display_pose, camera };
        pipeline.warp(&view, sources.iter(), &mut canvas, pyramid);
        let (nodes, hole_fraction) = pipeline.statistics();
        WarpStatistics { hole_fraction, nodes }
    }

    /// Runs one stage of a picture by [`Mode::Specular`], those before it having run for the same pose: for benches.
    pub fn run(&mut self, stage: Stage, display_pose: &Pose, camera: &Camera, exposure: f32, picture: &mut RgbImage) {
        fit(picture, camera);
        let (codes, _) = picture.as_chunks_mut::<3>();
        let mut canvas = Canvas::Codes { codes, exposure };
        let Warper { level, layered, pipeline, pyramid, .. } = self;
        let sources = layered.seen_from(display_pose, camera);
        let mut sources = sources.iter();
        let Some(frame) = sources.next() else { return };
        let view = View { level: *level, display_pose, camera };
        match stage {
            Stage::Splat => pipeline.splat(&view, frame),
            Stage::Samples => pipeline.sample(&view, frame),
            Stage::Tiles => pipeline.tiles(&view, frame, &mut canvas, pyramid),
            Stage::Fill => pipeline.fill(&view, sources, &mut canvas, pyramid),
        }
    }

    /// Fractions of the tiles of the last picture whose root, and all of whose children, were interpolated.
    pub fn smooth_tiles(&self) -> [f64; 2] {
        self.pipeline.smooth_fractions()
    }

    /// The frame's picture, from the pixel `offset` on.
    fn show_unmoved(&mut self, tree: &Tree, offset: [u32; 2], camera: &Camera, canvas: &mut Canvas<'_>) {
        let (old_width, width) = (tree.camera.size.width as usize, camera.size.width as usize);
        self.radiance.resize(camera.size.pixels(), HOLE);
        let rows = canvas.runs(width).zip(self.radiance.par_chunks_mut(width));
        rows.enumerate().for_each(|(y, (mut canvas, radiance))| {
            let first = (y + offset[1] as usize) * old_width + offset[0] as usize;
            flatten(tree, first..first + width, radiance);
            canvas.paint_exactly(0, radiance);
        });
    }

    /// The baselines that bring the flattened picture to the new pose as a whole.
    fn show_painted(
        &mut self,
        mode: Mode,
        display_pose: &Pose,
        camera: &Camera,
        canvas: &mut Canvas<'_>,
    ) -> WarpStatistics {
        let (pixels, width) = (camera.size.pixels(), camera.size.width as usize);
        self.radiance.resize(pixels, HOLE);
        let Warper { source, mean_inverse_depth, relief, radiance, pyramid, .. } = self;
        match mode {
            Mode::Planar => planar::warp(source, *mean_inverse_depth, display_pose, camera, radiance),
            Mode::Mesh => mesh::warp(source, display_pose, camera, relief, radiance),
            Mode::None => rotation::warp(source, source.pose(), camera, radiance),
            _ => rotation::warp(source, display_pose, camera, radiance),
        }
        let holes = pyramid.fill(radiance, width);
        canvas.runs(width).zip(radiance.par_chunks(width)).for_each(|(mut canvas, radiance)| {
            canvas.paint_exactly(0, radiance);
        });
        WarpStatistics { hole_fraction: holes as f64 / pixels.max(1) as f64, ..WarpStatistics::default() }
    }
}

fn fit(picture: &mut RgbImage, camera: &Camera) {
    if picture.dimensions() != (camera.size.width, camera.size.height) {
        *picture = RgbImage::new(camera.size.width, camera.size.height);
    }
}

/// Makes `flat` what `tree` looks like from its own pose.
fn flatten_tree(tree: &Tree, flat: &mut Tree) {
    flat.reset(tree.render_pose, tree.camera, &Plan::diffuse(), &Interfaces::default());
    let width = tree.camera.size.width as usize;
    let root = &mut flat.nodes[0];
    root.distance.copy_from_slice(&tree.nodes[0].distance);
    let [red, green, blue] = &mut root.radiance;
    let rows = red.par_chunks_mut(width).zip(green.par_chunks_mut(width)).zip(blue.par_chunks_mut(width));
    rows.enumerate().for_each(|(y, ((red, green), blue))| {
        for (x, ((red, green), blue)) in red.iter_mut().zip(green).zip(blue).enumerate() {
            let mut radiance = [Vec3::ZERO];
            let pixel = y * width + x;
            flatten(tree, pixel..pixel + 1, &mut radiance);
            [*red, *green, *blue] = radiance[0].to_array();
        }
    });
}

#[cfg(test)]
mod cube_tests;
#[cfg(test)]
mod oracles;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod wider_tests;
