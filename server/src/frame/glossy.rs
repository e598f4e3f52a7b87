//! The light of rough lobes in live frames: one sampled ray per pixel and frame, made smooth.
//!
//! Part of live frames, between the light of the cache and [`super::rest`]. What a node pixel sees by way of a rough
//! lobe is kept apart ([`GlossyPoint`]), divided by the lobe's reflectance, filtered, multiplied again and added to
//! the node. Only such pixels are kept, packed one after the other with an index plane beside them: a scene without
//! rough lobes has none, and pays nothing.
//!
//! Method: spatiotemporal variance-guided filtering (Schied et al. 2017) over an edge-avoiding wavelet (Dammertz et
//! al. 2010), in three steps, each over all cores:
//! 1. [`history`]: the last result at the same surface point, found by reprojection; one bright sample is cut down to
//!    what its neighbours bear, and the history is drawn to within their scatter;
//! 2. [`change`]: where whole tiles have become brighter or darker by more than their noise, history is given up; what
//!    is left is mixed with the new sample, with the variance of the mean beside it;
//! 3. [`wavelet`]: neighbours on the same surface are averaged, as far as the lobe is blind to where they are.
//!
//! Limits: biased. Cutting bright samples and history loses light where a lobe sees a small bright thing by chance only:
//! 1.6 percent on the table of materials under its lamp and the sky, 14 percent with its lights of no extent, whose
//! caustics few paths find. The wavelet blurs what is reflected by about a quarter of the lobe. Points that move are followed by the
//! head's motion only, not by their own. Dispersion's one colour per frame is not filtered. At rest the unbiased
//! means of [`super::rest`] replace all of this. Cost: 300 bytes per
//! node pixel with a rough lobe and 8 for every other.

mod change;
mod history;
#[cfg(test)]
mod tests;
mod wavelet;

use super::{BAND_ROWS, Eye};
use change::Tile;
use glam::{Vec3, Vec4};
use history::{History, Kept, Reprojected};
use rayon::prelude::*;
use warplight_protocol::ImageSize;
use warplight_protocol::frame::TreeRows;

/// Least reflectance that light is divided by.
const MIN_ALBEDO: f32 = 1e-4;
/// Points that one task of a worker takes at least.
const TASK: usize = 512;
/// Part of a lobe's width (alpha, as an angle in radians) within which directions count as one. A lobe reflects half
/// of its light within about 2 alpha, so that the blur is not seen beside it.
const LOBE_PART: f32 = 0.5;
/// No point is in the place.
const NONE: u32 = u32::MAX;

/// What a node pixel sees by way of a rough lobe.
#[derive(Clone, Copy, Debug)]
pub(super) struct GlossyPoint {
    /// Pixel within the band.
    pub(super) offset: u32,
    pub(super) node: u8,
    pub(super) material: u32,
    /// Of the surface with the lobe.
    pub(super) position: Vec3,
    /// On the side that is seen.
    pub(super) normal: Vec3,
    pub(super) alpha: f32,
    /// Length of the way from the eye to where its light seems to be: the surface, or the image of what a nearly sharp
    /// one reflects.
    pub(super) path_m: f32,
    /// How far beyond the surface that is seen at, or infinity where nobody knows.
    pub(super) beyond_m: f32,
    /// Of the lobe, and all that lies before it.
    pub(super) albedo: Vec3,
    /// One sample.
    pub(super) radiance: Vec3,
}

/// A point's place in the planes.
#[derive(Clone, Copy, Debug)]
struct Site {
    column: u16,
    row: u16,
    node: u8,
}

/// What tells whether two points see the same.
#[derive(Clone, Copy, Debug)]
struct Guide {
    position: Vec3,
    normal: Vec3,
    material: u32,
    /// How far in pixels neighbours see nearly the same.
    footprint_px: f32,
    /// How much smaller than 1 the cosine between normals may be.
    bend: f32,
}

/// A frame's points.
#[derive(Debug)]
struct Points {
    eye: Option<Eye>,
    size: ImageSize,
    /// Rows of a face: those beyond are no neighbours.
    face_rows: u32,
    /// By node and pixel: which point is there.
    index: Vec<u32>,
    sites: Vec<Site>,
    guides: Vec<Guide>,
    history: Vec<History>,
}

/// One sample of a point, over its albedo.
#[derive(Clone, Copy, Debug)]
struct Sample {
    /// With its luminance.
    light: Vec4,
    alpha: f32,
    path_m: f32,
}

/// The filter of one viewer.
#[derive(Debug, Default)]
pub(super) struct Glossy {
    now: Points,
    before: Points,
    samples: Vec<Sample>,
    reprojected: Vec<Reprojected>,
    tiles: Vec<Tile>,
    /// Means with the variance of their luminance; one is read and the other written.
    light: Vec<Vec4>,
    filtered: Vec<Vec4>,
}

impl Glossy {
    /// Forgets the frames before: for another scene, or where there is nothing to keep.
    pub(super) fn forget(&mut self) {
        self.now.eye = None;
    }

    /// Begins a frame.
    pub(super) fn begin(&mut self, eye: &Eye, size: ImageSize, nodes: usize) {
        std::mem::swap(&mut self.now, &mut self.before);
        // A frame of another size is no obstacle: history is found by where it was seen.
        if self.before.index.len() != nodes * self.before.size.pixels() {
            self.before.eye = None;
        }
        let Points { index, sites, guides, .. } = &mut self.now;
        self.samples.clear();
        sites.clear();
        guides.clear();
        index.clear();
        index.resize(nodes * size.pixels(), NONE);
        self.now.eye = Some(*eye);
        self.now.size = size;
        self.now.face_rows = eye.camera.rows_of_face();
    }

    /// Takes a band's points, the bands one after the other.
    pub(super) fn add_band(&mut self, band: usize, points: &[GlossyPoint]) {
        let Points { eye, size, index, sites, guides, .. } = &mut self.now;
        let Some(eye) = eye else { return };
        let (columns, focal_px) = (size.width as usize, eye.camera.focal_px().min_element());
        for point in points {
            let pixel = band * BAND_ROWS as usize * columns + point.offset as usize;
            index[usize::from(point.node) * size.pixels() + pixel] = sites.len() as u32;
            let [column, row] = [pixel % columns, pixel / columns].map(|at| at as u16);
            sites.push(Site { column, row, node: point.node });
            guides.push(point.guide(focal_px));
            self.samples.push(Sample {
                light: history::with_luminance(point.demodulated()),
                alpha: point.alpha,
                path_m: point.path_m,
            });
        }
    }

    /// Filters the frame's points. Where light has changed, `kept` says how much of a history still counts.
    pub(super) fn filter(&mut self, kept: Option<&Kept<'_>>) {
        let Glossy { now, before, samples, reprojected, tiles, light, filtered } = self;
        history::reproject(now, before, samples, kept, reprojected);
        change::compare(now, reprojected, tiles);
        history::accumulate(now, reprojected, tiles, light);
        wavelet::filter(now, light, filtered);
    }

    /// Adds what the points of the bands see to the rows.
    pub(super) fn show<'a>(&self, rows: &mut [TreeRows<'_>], bands: impl Iterator<Item = &'a [GlossyPoint]>) {
        let mut start = 0;
        let parts: Vec<(&[GlossyPoint], &[Vec4])> = bands
            .map(|points| {
                let light = &self.light[start..start + points.len()];
                start += points.len();
                (points, light)
            })
            .collect();
        rows.par_iter_mut().zip(parts).for_each(|(rows, (points, light))| {
            for (point, light) in points.iter().zip(light) {
                point.add_to(rows, light.truncate() * point.albedo.max(Vec3::splat(MIN_ALBEDO)));
            }
        });
    }
}

impl GlossyPoint {
    /// Adds radiance to the node that shows this point.
    pub(super) fn add_to(&self, rows: &mut TreeRows<'_>, radiance: Vec3) {
        let channels = &mut rows.nodes[usize::from(self.node)].radiance;
        for (channel, value) in channels.iter_mut().zip(radiance.to_array()) {
            channel[self.offset as usize] += value;
        }
    }

    fn demodulated(&self) -> Vec3 {
        let light = self.radiance / self.albedo.max(Vec3::splat(MIN_ALBEDO));
        if light.is_finite() { light } else { Vec3::ZERO }
    }

    fn guide(&self, focal_px: f32) -> Guide {
        // A step aside by s on a flat mirror moves what is seen at t behind it by s t / (d + t) of its angle.
        let surface_m = (self.path_m - self.beyond_m).max(0.0);
        let aside = if self.beyond_m.is_finite() { self.beyond_m / (surface_m + self.beyond_m).max(1e-6) } else { 1.0 };
        let lobe_rad = LOBE_PART * self.alpha;
        // Nearer than that nothing can be told: half a pixel is within the sample's own place.
        Guide {
            position: self.position,
            normal: self.normal,
            material: self.material,
            footprint_px: 0.5 * lobe_rad * focal_px * aside.min(1.0),
            // Twice the angle between normals is that between reflections.
            bend: (0.125 * lobe_rad * lobe_rad).max(1e-6),
        }
    }
}

impl Default for Points {
    fn default() -> Points {
        let (index, sites, guides, history) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Points { eye: None, size: ImageSize::new(0, 0), face_rows: u32::MAX, index, sites, guides, history }
    }
}

impl Points {
    fn len(&self) -> usize {
        self.sites.len()
    }

    /// The point of a node in a column and row.
    fn at(&self, node: u8, column: i32, row: i32) -> Option<usize> {
        let ImageSize { width, height } = self.size;
        if column as u32 >= width || row as u32 >= height {
            return None;
        }
        let place = (usize::from(node) * height as usize + row as usize) * width as usize + column as usize;
        Some(self.index[place]).filter(|&point| point != NONE).map(|point| point as usize)
    }

    /// The point beside another one, in the same face.
    fn beside(&self, site: Site, columns: i32, rows: i32) -> Option<usize> {
        let row = i32::from(site.row) + rows;
        let face = |row: u32| row / self.face_rows.max(1);
        if row < 0 || face(row as u32) != face(u32::from(site.row)) {
            return None;
        }
        self.at(site.node, i32::from(site.column) + columns, row)
    }
}

impl Guide {
    /// Whether another point lies on the same surface, in the same plane as far as its neighbourhood is one.
    fn is_beside(&self, other: &Guide) -> bool {
        /// Sine of the steepest rise between neighbours.
        const RISE: f32 = 0.2;
        /// Cosine between normals.
        const BEND: f32 = 0.9;
        let step = other.position - self.position;
        let rise = self.normal.dot(step);
        self.material == other.material
            && self.normal.dot(other.normal) >= BEND
            && rise * rise <= RISE * RISE * step.length_squared() + 1e-8
    }
}

/// Runs over all points, in parallel and in order.
fn each_point<T: Send>(points: usize, into: &mut Vec<T>, value: impl Fn(usize) -> T + Sync + Send) {
    (0..points).into_par_iter().with_min_len(TASK).map(value).collect_into_vec(into);
}
