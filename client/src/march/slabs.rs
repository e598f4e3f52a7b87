//! Baseline: each layer as a picture on a coarse height field (Müller et al. 1999).
//!
//! The volume is cut into slabs, each a picture of radiance and transmittance from the render pose, and each is warped as a
//! surface: a grid of cells of 16 pixels whose corners have the mean depth of what the slab shows around them. Layer i of
//! the frame is slab i. A ray of the display is brought onto the height field by iteration (the depth found at the
//! pixel where it was last met), the slab's picture is fetched there between four pixels, and the slabs are composed in
//! the order in which they are met. Right where slabs are thin; between them gaps open, since a slab has no thickness, and
//! its opacity is the same from all sides. Where a slab shows nothing its height is continued from where it does, so that
//! its edges do not bend away. Cost: some steps of iteration per ray and slab.

use super::transport::Transport;
use super::view::{Pinhole, Ray, Rays};
use super::walk::Frame;
use glam::{DVec3, Vec2, Vec4};
use rayon::prelude::*;

/// Side of a cell.
const CELL_PX: usize = 16;
/// Steps of the iteration: heights of neighbouring rays differ little, and each begins where the last one was.
const ITERATIONS: usize = 4;
/// Rounds in which heights are continued into what is empty.
const CONTINUED_CELLS: usize = 4;

/// The slabs of a frame.
#[derive(Debug, Default)]
pub(super) struct Slabs(Vec<Slab>);

#[derive(Debug, Default)]
struct Slab {
    /// Radiance and transmittance of each pixel.
    colors: Vec<Vec4>,
    /// Depth in view at the corners of cells.
    heights_m: Vec<f32>,
    /// Whether there is anything around the corner or one next to it.
    is_near: Vec<bool>,
    mean_m: f32,
}

/// A ray by depth in the frame: its pixel is `start + along / z`.
struct Line {
    start: Vec2,
    along: Vec2,
    depth: f32,
    slope: f32,
}

impl Line {
    fn new(frame: &Pinhole, ray: &Ray) -> Line {
        let slope = ray.direction.truncate() / ray.direction.z;
        let along = frame.focal_px * (ray.origin.truncate() - ray.origin.z * slope);
        Line {
            start: (frame.focal_px * slope + frame.centre_px).as_vec2(),
            along: along.as_vec2(),
            depth: ray.origin.z as f32,
            slope: ray.direction.z as f32,
        }
    }

    /// Parameter of the ray at a depth.
    fn t(&self, depth_m: f32) -> f32 {
        (depth_m - self.depth) / self.slope
    }
}

/// Corners of cells in a row and in a column.
fn corners(size_px: [usize; 2]) -> [usize; 2] {
    size_px.map(|size| size.div_ceil(CELL_PX) + 1)
}

impl Slabs {
    pub(super) fn prepare(&mut self, frame: &Frame<'_>) {
        self.0.resize_with(frame.tree.layers.len(), Slab::default);
        self.0.iter_mut().enumerate().for_each(|(layer, slab)| slab.prepare(frame, layer));
    }

    /// The picture; rays end at `surface_m`.
    pub(super) fn march(&self, frame: &Pinhole, rays: &Rays, surface_m: &[f32], out: &mut [Vec4]) {
        let width = rays.display.size_px[0];
        out.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
            let mut heights_m: Vec<f32> = self.0.iter().map(|slab| slab.mean_m).collect();
            for (column, out) in out.iter_mut().enumerate() {
                let ray = rays.through(column, row);
                let line = Line::new(frame, &ray);
                let farthest = surface_m.get(row * width + column).map_or(f64::INFINITY, |&m| f64::from(m));
                let farthest = farthest / ray.direction.length();
                let mut gathered = Transport::default();
                for order in 0..self.0.len() {
                    let layer = if ray.direction.z >= 0.0 { order } else { self.0.len() - 1 - order };
                    let (slab, height_m) = (&self.0[layer], &mut heights_m[layer]);
                    let found = slab.meet(frame.size_px, &line, height_m);
                    if let Some(pixel) = found.filter(|_| line.t(*height_m) < farthest as f32) {
                        let [red, green, blue, transmittance] = slab.fetch(frame, pixel).to_array().map(f64::from);
                        gathered.compose(&Transport { radiance: DVec3::new(red, green, blue), transmittance });
                    }
                }
                *out = gathered.radiance.as_vec3().extend(gathered.transmittance as f32);
            }
        });
    }
}

impl Slab {
    fn prepare(&mut self, frame: &Frame<'_>, layer: usize) {
        let [width, height] = frame.pinhole.size_px;
        self.colors.resize(width * height, Vec4::W);
        self.colors.par_iter_mut().enumerate().with_min_len(1024).for_each(|(pixel, color)| {
            let mut gathered = Transport::default();
            if let Some(segment) = frame.segment(pixel, layer) {
                gathered.cross(f64::from(segment.optical_depth), segment.source.as_dvec3());
            }
            *color = gathered.radiance.as_vec3().extend(gathered.transmittance as f32);
        });
        let [across, down] = corners(frame.pinhole.size_px);
        // Sums of depth times opacity, and of opacity, around each corner.
        let mut sums: Vec<[f64; 2]> = (0..across * down)
            .into_par_iter()
            .map(|corner| {
                let around = |centre: usize, size: usize| {
                    (centre * CELL_PX).saturating_sub(CELL_PX / 2)..(centre * CELL_PX + CELL_PX / 2).min(size)
                };
                let mut sum = [0.0; 2];
                for y in around(corner / across, height) {
                    for x in around(corner % across, width) {
                        if let Some(segment) = frame.segment(y * width + x, layer) {
                            let opacity = f64::from(segment.opacity());
                            sum[0] += opacity * f64::from(0.5 * (segment.front_m + segment.back_m));
                            sum[1] += opacity;
                        }
                    }
                }
                sum
            })
            .collect();
        self.is_near.clear();
        self.is_near.extend((0..across * down).map(|corner| {
            let (x, y) = (corner % across, corner / across);
            let mut rows = sums.chunks(across).take(y + 3).skip(y.saturating_sub(1));
            rows.any(|row| row.iter().take(x + 3).skip(x.saturating_sub(1)).any(|sum| sum[1] > 0.0))
        }));
        let [depths, weights] = sums.iter().fold([0.0, 0.0], |all, sum| [all[0] + sum[0], all[1] + sum[1]]);
        self.mean_m = if weights > 0.0 { (depths / weights) as f32 } else { 0.0 };
        for _ in 0..CONTINUED_CELLS {
            let before = sums.clone();
            for (corner, sum) in sums.iter_mut().enumerate().filter(|(_, sum)| sum[1] == 0.0) {
                let (x, y) = (corner % across, corner / across);
                for row in y.saturating_sub(1)..(y + 2).min(down) {
                    for neighbour in before[row * across..][..across].iter().take(x + 2).skip(x.saturating_sub(1)) {
                        *sum = [sum[0] + neighbour[0], sum[1] + neighbour[1]];
                    }
                }
            }
        }
        self.heights_m.clear();
        let mean_m = self.mean_m;
        self.heights_m
            .extend(sums.iter().map(|[sum, weight]| if *weight > 0.0 { (sum / weight) as f32 } else { mean_m }));
    }

    /// The pixel at which a ray meets the height field; `None` behind the eye, and where the slab shows nothing. `height_m`
    /// is where to begin, and then what was found.
    fn meet(&self, size_px: [usize; 2], line: &Line, height_m: &mut f32) -> Option<Vec2> {
        let [across, down] = corners(size_px);
        let last = Vec2::new(across as f32 - 1.001, down as f32 - 1.001);
        let mut pixel = Vec2::ZERO;
        for _ in 0..ITERATIONS {
            let t = line.t(*height_m);
            if !(t > 0.0 && t.is_finite() && self.mean_m > 0.0) {
                *height_m = self.mean_m;
                return None;
            }
            pixel = line.start + line.along / *height_m;
            let at = (pixel / CELL_PX as f32).clamp(Vec2::ZERO, last);
            let first = at.y as usize * across + at.x as usize;
            let part = at - at.floor();
            let [a, b] = [self.heights_m[first], self.heights_m[first + 1]];
            let [c, d] = [self.heights_m[first + across], self.heights_m[first + across + 1]];
            let (upper, lower) = (a + (b - a) * part.x, c + (d - c) * part.x);
            *height_m = upper + (lower - upper) * part.y;
        }
        let at = (pixel / CELL_PX as f32).clamp(Vec2::ZERO, last);
        self.is_near[at.y as usize * across + at.x as usize].then_some(pixel)
    }

    /// Between four pixels; nothing outside of the picture.
    fn fetch(&self, frame: &Pinhole, pixel: Vec2) -> Vec4 {
        let [width, height] = frame.size_px;
        if !(pixel.min_element() > -1.0 && pixel.x < width as f32 + 1.0 && pixel.y < height as f32 + 1.0) {
            return Vec4::W;
        }
        let at = pixel - 0.5;
        let (corner, part) = (at.floor(), at - at.floor());
        let color = |x: f32, y: f32| {
            let is_inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
            if is_inside { self.colors[y as usize * width + x as usize] } else { Vec4::W }
        };
        let row = |y: f32| color(corner.x, y).lerp(color(corner.x + 1.0, y), part.x);
        row(corner.y).lerp(row(corner.y + 1.0), part.y)
    }
}
