//! The root's flow: which old pixel shows what is seen at a new one (Bowles et al. 2012, "Iterative image warping").
//!
//! On the ray of a new pixel one number is unknown, the inverse depth: sample the old picture where the present guess
//! projects to, intersect the ray with the plane of that depth, and again. It contracts by slope times
//! parallax, a hundredth for a floor. Starts come from a splat of the cells of 4 x 4 texels, nearest and
//! farthest of each: the nearest first, since it hides the other. What does not settle is a disocclusion.

use super::motion::Motion;
use crate::lanes::{Floats, Integers, Mask, Vector, as_floats};
use crate::warp::exit::all;
use crate::warp::prepared::{CELL, Prepared};
use glam::Vec2;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use warplight_protocol::Camera;

/// Texels whose inverse depths differ by more than this fraction lie on different surfaces.
pub(super) const EDGE: f32 = 0.05;
/// Change of position whose step is the last: the next would be a tenth of it and less.
const LAST_STEP_PX: f32 = 1.0 / 32.0;
/// Change that is accepted after the last step.
const ACCEPTED_PX: f32 = 0.25;
/// Most steps; two or three are the rule.
const MAX_STEPS: usize = 6;

/// Texels around a position of the old picture.
struct Taps<F: Floats> {
    indices: [F::Integers; 4],
    /// From left to right and from above to below.
    x: F,
    y: F,
}

/// Inside the picture, its last texel included.
#[inline(always)]
fn clamped<F: Floats>(position: F, size: usize) -> F {
    position.within(0.0, size as f32 - 0.25)
}

/// The index of the texel that holds a position, or of the nearest one in the picture.
#[inline(always)]
pub(super) fn texel<F: Floats>(frame: &Prepared, u: F, v: F) -> F::Integers {
    let (width, height) = frame.size();
    let row = clamped(v, height).truncate();
    row * F::Integers::splat(frame.layout.pitch as i32) + clamped(u, width).truncate()
}

/// The texel whose centre lies before a position, and how far behind it that is.
#[inline(always)]
fn before<F: Floats>(position: F, size: usize) -> (F::Integers, F) {
    let position = (position - F::splat(0.5)).within(0.0, size as f32 - 1.0);
    let first = position.min(F::splat((size as f32 - 1.5).max(0.0))).truncate();
    (first, position - first.to_floats())
}

#[inline(always)]
fn taps<F: Floats>(frame: &Prepared, u: F, v: F) -> Taps<F> {
    let (width, height) = frame.size();
    let ((column, x), (row, y)) = (before(u, width), before(v, height));
    let pitch = frame.layout.pitch as i32;
    let first = row * F::Integers::splat(pitch) + column;
    let right = i32::from(width > 1);
    let below = if height > 1 { pitch } else { 0 };
    let (right, below) = (F::Integers::splat(right), F::Integers::splat(below));
    Taps { indices: [first, first + right, first + below, first + below + right], x, y }
}

#[inline(always)]
fn nearest_inverse_depth<F: Floats>(frame: &Prepared, u: F, v: F) -> F {
    let [words] = F::gather_words([frame.inverse_depth()], texel(frame, u, v));
    words.as_floats()
}

/// Inverse depth at a position: interpolated on one surface, else that of the nearest texel.
#[inline(always)]
fn inverse_depth_at<F: Floats>(frame: &Prepared, u: F, v: F) -> F {
    let taps = taps(frame, u, v);
    let mut values = [F::zero(); 4];
    for (value, index) in values.iter_mut().zip(taps.indices) {
        let [words] = F::gather_words([frame.inverse_depth()], index);
        *value = words.as_floats();
    }
    let [a, b, c, d] = values;
    let half = F::splat(0.5);
    let (is_left, is_upper) = (taps.x.lt(half), taps.y.lt(half));
    let own = a.or(is_left, b).or(is_upper, c.or(is_left, d));
    let (nearest, farthest) = (a.max(b).max(c.max(d)), a.min(b).min(c.min(d)));
    let upper = (b - a).mul_add(taps.x, a);
    let lower = (d - c).mul_add(taps.x, c);
    let between = (lower - upper).mul_add(taps.y, upper);
    own.or((nearest * F::splat(EDGE)).lt(nearest - farthest), between)
}

/// The boundary at a position of the old picture.
#[derive(Clone, Copy)]
pub(super) struct SurfaceSample<F: Floats> {
    /// 0 for none.
    pub(super) interface: F,
    pub(super) normal: Vector<F>,
    /// How much of what is mixed there shows it.
    pub(super) coverage: F,
    /// A position on it: that which was asked for, or the centre of a texel beside it.
    pub(super) on_it: (F, F),
}

/// Boundary of the nearest texel and normal between those texels that show the same one.
///
/// `at_edge`, where a boundary may end, the other texels count as well: a footprint that is partly of a mirror shows
/// the mirror's child for that part, just as it mixes the radiance of both roots.
#[inline(always)]
pub(super) fn surface_at<F: Floats>(frame: &Prepared, u: F, v: F, at_edge: bool) -> SurfaceSample<F> {
    let planes = frame.surface(0);
    let nearest = texel(frame, u, v);
    let [own] = F::gather_words([planes[0]], nearest);
    let mut own = own.as_floats();
    let (zero, one) = (F::zero(), F::splat(1.0));
    if !at_edge && !zero.lt(own).any() {
        return SurfaceSample { interface: own, normal: Vector([zero, zero, one]), coverage: one, on_it: (u, v) };
    }
    let taps = taps(frame, u, v);
    let (x, y) = (taps.x, taps.y);
    let weights = [(one - x) * (one - y), x * (one - y), (one - x) * y, x * y];
    // Texels of another depth are not mixed.
    let always = zero.lt(one);
    let mut near = [always; 4];
    let mut on_it = (u, v);
    if at_edge {
        let [depth] = as_floats(F::gather_words([frame.inverse_depth()], nearest));
        // Centres of the taps.
        let (left, upper) = (u - x, v - y);
        let centres = [(left, upper), (left + one, upper), (left, upper + one), (left + one, upper + one)];
        for ((near, index), centre) in near.iter_mut().zip(taps.indices).zip(centres) {
            let [other, interface] = as_floats(F::gather_words([frame.inverse_depth(), planes[0]], index));
            *near = !(other.max(depth) * F::splat(EDGE)).lt((other - depth).abs());
            let is_new = *near & own.lt(F::splat(0.5)) & zero.lt(interface);
            own = interface.or(is_new, own);
            on_it = (centre.0.or(is_new, on_it.0), centre.1.or(is_new, on_it.1));
        }
    }
    let (mut sum, mut coverage, mut mixed) = (Vector([zero; 3]), zero, zero);
    for ((index, weight), near) in taps.indices.into_iter().zip(weights).zip(near) {
        let [interface, a, b, c] = as_floats(F::gather_words(planes, index));
        // Where there is no boundary, there may be no normal either.
        let same = near & (interface - own).abs().lt(F::splat(0.5));
        sum = sum.along(Vector([a, b, c]).or(same, Vector([zero; 3])), weight);
        coverage = coverage + weight.or(same, zero);
        mixed = mixed + weight.or(near, zero);
    }
    // The nearest texel has a quarter of the weight and is mixed.
    let coverage = if at_edge { coverage / mixed.max(F::splat(0.2)) } else { one };
    SurfaceSample { interface: own, normal: sum.normalize(), coverage, on_it }
}

/// What the root shows at new pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct RootSample<F: Floats> {
    /// Position in the old picture.
    pub(super) u: F,
    pub(super) v: F,
    /// New inverse depth.
    pub(super) inverse_depth: F,
    pub(super) known: F::Mask,
}

/// Solves for the root from this new inverse depth on. Positions up to `margin` pixels beyond the picture's border
/// are accepted, where it is taken to go on as at the border.
#[inline(always)]
fn solve<F: Floats>(frame: &Prepared, motion: &Motion, (x, y): (F, F), start: F, margin: f32) -> RootSample<F> {
    let at_infinity = motion.at_infinity(x, y);
    let mut inverse_depth = start;
    let (mut u, mut v, mut ratio) = motion.old_pixel(at_infinity, inverse_depth);
    let mut change = F::splat(f32::MAX);
    for step in 0..MAX_STEPS {
        // The first guess is that of a cell: the nearest texel is good enough to mend it.
        let old = if step == 0 { nearest_inverse_depth(frame, u, v) } else { inverse_depth_at(frame, u, v) };
        inverse_depth = motion.new_inverse_depth(at_infinity, old);
        let (next_u, next_v, next_ratio) = motion.old_pixel(at_infinity, inverse_depth);
        change = (next_u - u).abs().max((next_v - v).abs());
        (u, v, ratio) = (next_u, next_v, next_ratio);
        if step > 0 && !(F::splat(LAST_STEP_PX).lt(change) & change.lt(F::splat(f32::MAX))).any() {
            break;
        }
    }
    let (width, height) = frame.size();
    let (low, right, below) = (F::splat(-margin), width as f32 + margin, height as f32 + margin);
    // Each is false for what is not a number.
    let known = all([
        change.lt(F::splat(ACCEPTED_PX)),
        F::splat(1e-6).lt(ratio),
        F::splat(-1e-9).lt(inverse_depth),
        inverse_depth.lt(F::splat(1e6)),
        !u.lt(low) & u.lt(F::splat(right)),
        !v.lt(low) & v.lt(F::splat(below)),
    ]);
    RootSample { u, v, inverse_depth, known }
}

/// The same from what is nearest around each pixel, and where that fails from what is farthest: the nearest hides the
/// other.
#[inline(always)]
pub(super) fn solve_from<F: Floats>(
    frame: &Prepared,
    motion: &Motion,
    pixels: (F, F),
    (nearest, farthest): (F, F),
    margin: f32,
) -> RootSample<F> {
    let mut root = solve(frame, motion, pixels, nearest, margin);
    if (!root.known).any() {
        let again = solve(frame, motion, pixels, farthest, margin);
        root.u = root.u.or(root.known, again.u);
        root.v = root.v.or(root.known, again.v);
        root.inverse_depth = root.inverse_depth.or(root.known, again.inverse_depth);
        root.known = root.known | again.known;
    }
    root
}

/// Nearest and farthest of what is splat into each cell of the new picture.
#[derive(Debug, Default)]
pub(super) struct Splat {
    nearest: Vec<AtomicU32>,
    farthest: Vec<AtomicU32>,
    columns: usize,
    rows: usize,
}

impl Splat {
    /// Projects all cells of the frame.
    pub(super) fn forward(&mut self, frame: &Prepared, motion: &Motion, camera: &Camera) {
        self.columns = (camera.size.width as usize).div_ceil(CELL);
        self.rows = (camera.size.height as usize).div_ceil(CELL);
        self.nearest.resize_with(self.columns * self.rows, AtomicU32::default);
        self.farthest.resize_with(self.columns * self.rows, AtomicU32::default);
        for (nearest, farthest) in self.nearest.iter_mut().zip(&mut self.farthest) {
            *nearest.get_mut() = 0;
            *farthest.get_mut() = u32::MAX;
        }
        let columns = frame.size().0.div_ceil(CELL);
        let (width, height) = (camera.size.width as f32, camera.size.height as f32);
        frame.cells.par_chunks(columns).enumerate().for_each(|(row, cells)| {
            for (column, cell) in cells.iter().enumerate() {
                let centre = Vec2::new(column as f32 + 0.5, row as f32 + 0.5) * CELL as f32;
                let [nearest, farthest] = *cell;
                // One surface needs one projection.
                let is_one = nearest - farthest <= EDGE * nearest;
                for inverse_depth in [nearest, farthest].into_iter().take(if is_one { 1 } else { 2 }) {
                    let h = motion.forward.homogeneous(centre, inverse_depth);
                    let pixel = h.truncate() / h.z;
                    let is_inside = h.z > 1e-6
                        && pixel.x >= 0.0
                        && pixel.y >= 0.0
                        && pixel.x < width
                        && pixel.y < height
                        && inverse_depth < f32::INFINITY;
                    if is_inside {
                        let at = pixel.y as usize / CELL * self.columns + pixel.x as usize / CELL;
                        // Floats that are not negative order like their bits; one more, so that 0 is none.
                        let bits = (inverse_depth / h.z).max(0.0).to_bits() + 1;
                        self.nearest[at].fetch_max(bits, Relaxed);
                        self.farthest[at].fetch_min(bits, Relaxed);
                    }
                }
            }
        });
    }

    /// Nearest and farthest inverse depth in the box of these pixels and a cell around it; `None` where nothing is.
    #[inline(always)]
    pub(super) fn around(&self, left: f32, right: f32, above: f32, below: f32) -> Option<(f32, f32)> {
        let cell = |pixel: f32, count: usize| (pixel.max(0.0) as usize / CELL).min(count - 1);
        let (first, last) =
            (cell(left, self.columns).saturating_sub(1), (cell(right, self.columns) + 2).min(self.columns));
        let (top, bottom) = (cell(above, self.rows).saturating_sub(1), (cell(below, self.rows) + 2).min(self.rows));
        let (mut nearest, mut farthest) = (0, u32::MAX);
        for row in top..bottom {
            let cells = row * self.columns + first..row * self.columns + last;
            for (near, far) in self.nearest[cells.clone()].iter().zip(&self.farthest[cells]) {
                nearest = nearest.max(near.load(Relaxed));
                farthest = farthest.min(far.load(Relaxed));
            }
        }
        (nearest > 0).then(|| (f32::from_bits(nearest - 1), f32::from_bits(farthest - 1)))
    }
}
