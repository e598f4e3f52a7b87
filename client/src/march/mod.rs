//! Layered volumes from a new pose: what a ray of the display gathers from the segments of a frame.
//!
//! decode -> **march** -> composite. A [`Marcher`] is given a frame once ([`Marcher::prepare`]) and then asked, at every
//! display refresh, for the radiance of the volume and its transmittance per pixel ([`Marcher::march`]); what is seen
//! through it is the business of the warp.
//!
//! Method of [`Method::Layers`]: Lochmann et al. 2016. A new ray is a straight line in the picture of the frame; of each
//! pixel on it the segments that the ray passes are integrated again over the length that it is within them.
//! `view` brings rays into the frame, `crossings` finds the pixels, `transport` integrates. `walk` does it plainly, and
//! is the oracle of `packets`, which does it for sixteen pixels at once over `packed` records. Two methods of others
//! are there to compare with: `mean_depth` and `slabs`. `phantom` has volumes without a file, to test and to measure all
//! of them on.
//!
//! Limits: what hides behind something opaque is not in the frame and seen as empty; extinction is grey; the picture of a
//! frame must be on a plane, of a cube nothing is shown.

mod crossings;
mod mean_depth;
mod packed;
mod packets;
pub mod phantom;
mod slabs;
mod transport;
mod view;
mod walk;

use crate::lanes::Level;
use glam::Vec4;
use mean_depth::MeanDepth;
use packed::Packed;
use rayon::prelude::*;
use slabs::Slabs;
use view::{Pinhole, Rays};
use walk::Frame;
use warplight_protocol::camera::Projection;
use warplight_protocol::frame::Tree;
use warplight_protocol::{Camera, Pose};

/// How the layers of a frame are brought to a new pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Method {
    /// Segments integrated again along epipolar lines (Lochmann et al. 2016), in vectors.
    Layers,
    /// The same ray by ray in f64, without approximation: the oracle of the former.
    Plain,
    /// Each layer as a picture on a coarse height field (Müller et al. 1999).
    Slabs,
    /// One colour and one depth per pixel (Zellmann et al. 2012).
    MeanDepth,
}

impl Method {
    /// Every method.
    pub const ALL: [Method; 4] = [Method::Layers, Method::Plain, Method::Slabs, Method::MeanDepth];

    /// Name in reports and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Method::Layers => "layers",
            Method::Plain => "plain",
            Method::Slabs => "slabs",
            Method::MeanDepth => "mean-depth",
        }
    }
}

impl std::str::FromStr for Method {
    type Err = String;
    fn from_str(text: &str) -> Result<Method, String> {
        Method::ALL.into_iter().find(|method| method.name() == text).ok_or_else(|| {
            let names = Method::ALL.map(Method::name).join(", ");
            format!("expected one of {names}, found '{text}'")
        })
    }
}

/// What a picture took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MarchStatistics {
    /// Planes that packets of the vector walk stopped at.
    pub packet_steps: u64,
    /// Rays that the vector walk left to the plain one, as a fraction of all.
    pub plain_fraction: f64,
}

/// Marches through frames; its buffers live from picture to picture.
#[derive(Debug)]
pub struct Marcher {
    level: Level,
    stride: f32,
    packed: Packed,
    reaches_border: bool,
    slabs: Slabs,
    mean_depth: MeanDepth,
    /// Whether slabs, and mean depths, are those of the frame that was taken in last.
    is_ready: [bool; 2],
}

/// Pixels of the frame between two steps of the vector walk, unless told otherwise.
pub const STRIDE_PX: f32 = 2.0;

impl Default for Marcher {
    fn default() -> Marcher {
        Marcher {
            level: Level::default(),
            stride: STRIDE_PX,
            packed: Packed::default(),
            reaches_border: false,
            slabs: Slabs::default(),
            mean_depth: MeanDepth::default(),
            is_ready: [false; 2],
        }
    }
}

impl Marcher {
    /// Takes in a frame. What the baselines need of it is made with their first picture.
    pub fn prepare(&mut self, tree: &Tree) {
        self.reaches_border = reaches_border(tree);
        self.is_ready = [false; 2];
        self.packed.pack(self.level, tree);
    }

    /// Whether the volume goes on beyond the border of the frame that was taken in last, as far as that can tell.
    pub fn reaches_border(&self) -> bool {
        self.reaches_border
    }

    /// Depths in its own view of the nearest and the farthest segment of the frame that was taken in last.
    pub fn depths_m(&self) -> [f32; 2] {
        self.packed.depths_m
    }

    /// How many instruction sets this machine has, the plainest first.
    pub fn levels() -> usize {
        Level::available().count()
    }

    /// Chooses one of them by its place in that order, from the next frame on; the widest unless told otherwise.
    pub fn set_level(&mut self, level: usize) {
        self.level = Level::available().nth(level).unwrap_or_default();
    }

    /// Chooses one by itself, from the next frame on.
    pub(crate) fn choose_level(&mut self, level: Level) {
        self.level = level;
    }

    /// Chooses how many pixels of the frame [`Method::Layers`] goes over in a common step; it halves them at outlines and
    /// doubles them within matter, and time falls as they grow. At least a quarter.
    pub fn set_stride(&mut self, pixels: f32) {
        self.stride = pixels.max(0.25);
    }

    /// Makes the picture of the volume of `tree`, which was taken in last, for `display_pose`: of each pixel linear
    /// radiance and, as w, transmittance. `surface_m`, where there is one, has for each pixel the distance along its ray at
    /// which something opaque ends it, infinite where nothing does.
    pub fn march(
        &mut self,
        method: Method,
        tree: &Tree,
        display_pose: &Pose,
        camera: &Camera,
        surface_m: Option<&[f32]>,
        out: &mut Vec<Vec4>,
    ) -> MarchStatistics {
        let pixels = camera.size.pixels();
        out.resize(pixels, Vec4::W);
        let is_flat = [tree.camera.projection, camera.projection] == [Projection::Perspective; 2];
        if self.packed.segments == 0 || !is_flat {
            out.fill(Vec4::W);
            return MarchStatistics::default();
        }
        let rays = Rays::new(&tree.render_pose, display_pose, camera);
        let view = View { tree, rays: &rays, surface_m: surface_m.unwrap_or_default() };
        match method {
            Method::Layers => self.march_packets(&view, out),
            Method::Plain => {
                self.march_plainly(&view, out, |_| true);
                MarchStatistics { packet_steps: 0, plain_fraction: 1.0 }
            }
            Method::Slabs => {
                let frame = Frame::new(tree, self.packed.depths_m);
                if !std::mem::replace(&mut self.is_ready[0], true) {
                    self.slabs.prepare(&frame);
                }
                self.slabs.march(&frame.pinhole, &rays, view.surface_m, out);
                MarchStatistics::default()
            }
            Method::MeanDepth => {
                let frame = Frame::new(tree, self.packed.depths_m);
                if !std::mem::replace(&mut self.is_ready[1], true) {
                    self.mean_depth.prepare(&frame);
                }
                self.mean_depth.march(&frame.pinhole, &rays, view.surface_m, out);
                MarchStatistics::default()
            }
        }
    }

    fn march_packets(&self, view: &View<'_>, out: &mut [Vec4]) -> MarchStatistics {
        let frame = Pinhole::new(&view.tree.camera);
        let pass = packets::Pass::new(&self.packed, &frame, view.rays, self.stride, view.surface_m);
        let rows = packets::BAND_ROWS;
        let bands = out.par_chunks_mut(view.width() * rows).enumerate();
        let packet_steps = bands.map(|(band, out)| packets::walk_band(self.level, &pass, band * rows, out)).sum();
        let left = out.par_iter().filter(|found| found.w.is_nan()).count();
        if left > 0 {
            self.march_plainly(view, out, |found| found.w.is_nan());
        }
        MarchStatistics { packet_steps, plain_fraction: left as f64 / out.len().max(1) as f64 }
    }

    /// Walks the rays whose pixels are wanted.
    fn march_plainly(&self, view: &View<'_>, out: &mut [Vec4], is_wanted: impl Fn(&Vec4) -> bool + Sync) {
        let frame = Frame::new(view.tree, self.packed.depths_m);
        let width = view.width();
        out.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
            for (column, found) in out.iter_mut().enumerate().filter(|(_, found)| is_wanted(found)) {
                let ray = view.rays.through(column, row);
                let end_m = view.surface_m.get(row * width + column).copied().unwrap_or(f32::INFINITY);
                let gathered = frame.march(&ray, f64::from(end_m) / ray.direction.length());
                *found = gathered.radiance.as_vec3().extend(gathered.transmittance as f32);
            }
        });
    }
}

/// Whether any pixel along the border has a segment.
fn reaches_border(tree: &Tree) -> bool {
    let (width, height) = (tree.camera.size.width as usize, tree.camera.size.height as usize);
    let (rows, columns) = ([0, height.saturating_sub(1)], [0, width.saturating_sub(1)]);
    tree.layers.iter().any(|layer| {
        let has = |row: usize, column: usize| layer.optical_depth[row * width + column] > 0.0;
        rows.iter().any(|&row| (0..width).any(|column| has(row, column)))
            || (0..height).any(|row| columns.iter().any(|&column| has(row, column)))
    })
}

/// A picture to be made.
struct View<'a> {
    tree: &'a Tree,
    rays: &'a Rays,
    /// Empty if nothing ends a ray.
    surface_m: &'a [f32],
}

impl View<'_> {
    fn width(&self) -> usize {
        self.rays.display.size_px[0]
    }
}

#[cfg(test)]
mod tests;
