//! The vector walk: packets of neighbouring pixels of the display through planes of the frame.
//!
//! With w = 1/z a ray's pixel in the frame is `u = u0 + b w`: on planes of constant depth all rays of a packet are where a
//! homography puts them, and planes uniform in w are passed at even steps of pixels. So a packet walks from plane to
//! plane, one per `stride` pixels of its longest line, and each lane fetches the record of the pixel that it is in half
//! way between two of them; there it crosses the segments between their depths. This holds for every motion: turned,
//! rolled, sideways, forwards with the epipole in the picture (where lanes part and each goes its way), with the eye
//! within the matter. Only rays that run nearly across the frame's view have no such planes; a packet with one of those
//! is left to the plain walk.
//!
//! Steps are adaptive: half a `stride` until every ray of the packet has met matter, since what a picture is off by lies
//! along outlines, then up to two strides, as long as no ray loses much within one; a step in which one does is taken
//! back and made again in small ones.
//!
//! Compared with the plain walk a crossing of a step is one fetch, at its middle; codes are those of [`super::packed`]. What all lanes agree on (depths of planes, empty space) is computed once, in scalars: the four
//! corners of a packet bound where its lanes are, and tiles with the nearest and the furthest code say whether anything
//! is there. A walk ends when no lane has transmittance left. Cost: linear in the length of lines and in what is not empty.

use super::packed::{CodeRange, Packed, TILE_PX, TILES_PER_BLOCK};
use super::transport::attenuation;
use super::view::{Pinhole, Rays};
use crate::lanes::{Floats, Integers, MAX_LANES, Mask, kernel};
use glam::{DVec2, Vec2, Vec3, Vec4};

/// Rows of a packet; its columns are as many as the lanes leave.
const PACKET_ROWS: usize = 2;
/// Rows of the display that are walked together, a multiple of those of a packet.
pub(super) const BAND_ROWS: usize = 16;
/// Transmittance below which nothing is asked for any more: half a code of 8 bits.
pub(super) const OPAQUE: f32 = 0.002;
/// Depth over length of a ray, in the frame, below which it runs across the view: 84 degrees from the axis.
const LEAST_SLOPE: f32 = 0.1;
/// Parts of the furthest depth within which the nearest matter is one plane: with an eye in the midst of it lines have no
/// end, and what lies within a thousandth of them would take half the steps.
const NEAREST_PART: f32 = 1.0 / 1024.0;
/// Most steps of a packet: past the vanishing point of a lane that stays, others have long left the picture.
const MAX_STEPS: f32 = 8192.0;
/// Steps that a walk has whatever the stride, but not more of them than so many per pixel: on a short line each covers much
/// of the depth, and half a pixel aside is most of what the walk is off by.
const FINE_STEPS: f32 = 24.0;
const STEPS_PER_PX: f32 = 2.0;
/// What strides shrink to when the eye is between the nearest and the furthest matter.
const STRIDE_WITHIN: f32 = 0.5;
/// Longest step in halves of a stride.
const LONGEST: usize = 4;
/// Transmittance above which a ray is taken to be still at an outline.
const MET_NOTHING: f32 = 0.98;
/// Most that a long step may take from a transmittance. On the phantoms a half of it costs a third more time and gains 5 %
/// of DSSIM on the cube at 5 degrees, 1 % elsewhere.
const MOST_LOST: f32 = 0.08;
/// Pixels between two questions about empty space.
const CHUNK_PX: f32 = 16.0;
/// Chunks between two questions to large tiles.
const CHUNKS_PER_RUN: usize = 6;

/// Radiance of what was left to the plain walk, until that has been there.
pub(super) const LEFT: f32 = f32::NAN;

/// A picture to be made.
pub(super) struct Pass<'a> {
    pub(super) packed: &'a Packed,
    focal_px: Vec2,
    centre_px: Vec2,
    origin: Vec3,
    /// Direction through the upper left corner of the display, and what it changes by from column to column and from
    /// row to row.
    corner: Vec3,
    per_column: Vec3,
    per_row: Vec3,
    width: usize,
    stride: f32,
    /// Distance at which each ray ends; empty if none does.
    surface_m: &'a [f32],
}

impl<'a> Pass<'a> {
    pub(super) fn new(packed: &'a Packed, frame: &Pinhole, rays: &Rays, stride: f32, surface_m: &'a [f32]) -> Pass<'a> {
        let corner = rays.direction(DVec2::ZERO);
        Pass {
            packed,
            focal_px: frame.focal_px.as_vec2(),
            centre_px: frame.centre_px.as_vec2(),
            origin: rays.origin.as_vec3(),
            corner: corner.as_vec3(),
            per_column: (rays.direction(DVec2::X) - corner).as_vec3(),
            per_row: (rays.direction(DVec2::Y) - corner).as_vec3(),
            width: rays.display.size_px[0],
            stride,
            surface_m,
        }
    }

    /// The line of the ray through a position: where its pixel is at infinity, and how that changes with 1/z.
    #[inline(always)]
    fn line(&self, direction: Vec3) -> Line {
        let slope = Vec2::new(direction.x, direction.y) / direction.z;
        let origin = Vec2::new(self.origin.x, self.origin.y);
        Line { start: self.focal_px * slope + self.centre_px, along: self.focal_px * (origin - self.origin.z * slope) }
    }

    /// Code of the depth 1/w, as a fraction.
    #[inline(always)]
    fn code(&self, w: f32) -> f32 {
        (1.0 / w - self.packed.depths_m[0]) * self.packed.codes_per_m()
    }
}

/// `start + along w`, in pixels of the frame.
#[derive(Clone, Copy, Debug, Default)]
struct Line {
    start: Vec2,
    along: Vec2,
}

impl Line {
    #[inline(always)]
    fn at(&self, w: f32) -> Vec2 {
        self.start + self.along * w
    }
}

/// Planes of constant depth: 1/z is `from`, `from + step`, and so on, `count` times.
struct Planes {
    from: f32,
    step: f32,
    count: usize,
}

/// The four corners of a packet, in scalars.
struct Hull {
    lines: [Line; 4],
    /// From where to where it walks, in 1/z, in the order of the walk.
    from: f32,
    to: f32,
    /// The codes of depth there; that of the nearest matter may be nearer than where the walk begins.
    ends: [f32; 2],
}

impl Hull {
    /// Where a packet can meet anything; `Err(true)` if it is to be left to the plain walk, `Err(false)` if nowhere.
    #[inline(always)]
    fn new(pass: &Pass<'_>, directions: [Vec3; 4]) -> Result<Hull, bool> {
        let is_forward = directions[0].z > 0.0;
        let mut lines = [Line::default(); 4];
        for (line, direction) in lines.iter_mut().zip(directions) {
            if direction.z.abs() < LEAST_SLOPE * direction.length() || (direction.z > 0.0) != is_forward {
                return Err(true);
            }
            *line = pass.line(direction);
        }
        let [nearest, furthest] = pass.packed.depths_m;
        let depth = pass.origin.z;
        let (start, far) = if is_forward { (nearest.max(depth), furthest) } else { (nearest, furthest.min(depth)) };
        let near = start.max(furthest * NEAREST_PART);
        if near.partial_cmp(&far) != Some(std::cmp::Ordering::Less) {
            return Err(false);
        }
        let (mut low, mut high) = (1.0 / far, 1.0 / near);
        let [width, height] = pass.packed.size_px;
        let size = Vec2::new(width as f32, height as f32);
        for axis in 0..2 {
            // Beyond an edge of the frame there is nothing, once all corners are.
            for (edge, inwards) in [(0.0, 1.0), (size[axis], -1.0)] {
                let (mut first, mut last) = (f32::INFINITY, f32::NEG_INFINITY);
                for line in &lines {
                    let (at, slope) = ((line.start[axis] - edge) * inwards, line.along[axis] * inwards);
                    if slope > 0.0 {
                        (first, last) = (first.min(-at / slope), f32::INFINITY);
                    } else if slope < 0.0 {
                        (first, last) = (f32::NEG_INFINITY, last.max(-at / slope));
                    } else if at >= 0.0 {
                        (first, last) = (f32::NEG_INFINITY, f32::INFINITY);
                    }
                }
                (low, high) = (low.max(first), high.min(last));
            }
        }
        if low.partial_cmp(&high) != Some(std::cmp::Ordering::Less) {
            return Err(false);
        }
        let near_code = pass.code(if high < 1.0 / near { high } else { 1.0 / start });
        let far_code = pass.code(low);
        Ok(if is_forward {
            Hull { lines, from: high, to: low, ends: [near_code, far_code] }
        } else {
            Hull { lines, from: low, to: high, ends: [far_code, near_code] }
        })
    }

    /// Pixels of the longest line.
    #[inline(always)]
    fn length_px(&self) -> f32 {
        let mut longest = 0.0_f32;
        for line in &self.lines {
            longest = longest.max(line.along.length_squared());
        }
        longest.sqrt() * (self.from - self.to).abs()
    }

    /// The planes that it walks over. Those of neighbouring packets are the same ones, multiples of a step, whose size
    /// changes by an eighth of an octave at a time: what a step is off by then does not change from packet to packet, which
    /// would show as blocks (1 to 10 % of DSSIM, and a decibel or more). They are half a stride apart, begin at or before
    /// the walk, where a longest step does, and end at or behind it.
    #[inline(always)]
    fn planes(&self, stride: f32) -> Planes {
        let length_px = self.length_px();
        let count = (length_px / stride).max((length_px * STEPS_PER_PX).min(FINE_STEPS)).ceil().clamp(1.0, MAX_STEPS);
        let step = (self.to - self.from) / count;
        let size = f32::from_bits(step.abs().to_bits() & !0x000f_ffff);
        if count == 1.0 || size == 0.0 {
            return Planes { from: self.from, step, count: 1 };
        }
        let is_forward = step < 0.0;
        let longest = size * LONGEST as f32 * 0.5;
        let first = if is_forward { (self.from / longest).ceil() } else { (self.from / longest).floor() };
        let (from, step) = (first * longest, if is_forward { -0.5 * size } else { 0.5 * size });
        Planes { from, step, count: ((self.to - from) / step).ceil().max(1.0) as usize }
    }

    /// The code of a plane, that of an end of the walk for what lies beyond.
    #[inline(always)]
    fn code(&self, pass: &Pass<'_>, w: f32) -> f32 {
        let is_forward = self.from > self.to;
        if (w >= self.from) == is_forward && w != self.from {
            self.ends[0]
        } else if (w > self.to) == is_forward && w != self.to {
            pass.code(w)
        } else {
            self.ends[1]
        }
    }

    /// Whether a tile that the packet may pass between two planes has anything between their codes.
    #[inline(always)]
    fn meets(&self, tiles: &[CodeRange], counts: [usize; 2], side_px: f32, w: [f32; 2], codes: [f32; 2]) -> bool {
        let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        for line in &self.lines {
            let (a, b) = (line.at(w[0]), line.at(w[1]));
            low = low.min(a.min(b));
            high = high.max(a.max(b));
        }
        // Rounding may put a lane into the pixel beside.
        let low = (low - 0.01).max(Vec2::ZERO) / side_px;
        let high = (high + 0.01).max(Vec2::ZERO) / side_px;
        let (last_column, last_row) = ((high.x as usize).min(counts[0] - 1), (high.y as usize).min(counts[1] - 1));
        let mut row = low.y as usize;
        while row <= last_row {
            let mut column = low.x as usize;
            while column <= last_column {
                let tile = tiles[row * counts[0] + column];
                if f32::from(tile[0]) < codes[1] && f32::from(tile[1]) > codes[0] {
                    return true;
                }
                column += 1;
            }
            row += 1;
        }
        false
    }
}

#[inline(always)]
fn ordered(a: f32, b: f32) -> [f32; 2] {
    if a < b { [a, b] } else { [b, a] }
}

/// Rows of a picture from `first_row` on; returns steps that were taken.
#[inline(always)]
fn walk_rows<F: Floats>(pass: &Pass<'_>, first_row: usize, out: &mut [Vec4]) -> u64 {
    match pass.packed.segments {
        1 => walk_packets::<F, 1>(pass, first_row, out),
        2 => walk_packets::<F, 2>(pass, first_row, out),
        4 => walk_packets::<F, 4>(pass, first_row, out),
        _ => walk_packets::<F, 8>(pass, first_row, out),
    }
}

kernel!(pub(super) fn walk_band = walk_rows(pass: &Pass<'_>, first_row: usize, out: &mut [Vec4]) -> u64);

#[inline(always)]
fn walk_packets<F: Floats, const K: usize>(pass: &Pass<'_>, first_row: usize, out: &mut [Vec4]) -> u64 {
    let columns = F::LANES / PACKET_ROWS;
    let rows = out.len() / pass.width;
    let mut steps = 0;
    for y in (0..rows).step_by(PACKET_ROWS) {
        for x in (0..pass.width).step_by(columns) {
            let mut found = [[0.0; MAX_LANES]; 4];
            steps += walk_packet::<F, K>(pass, x, first_row + y, &mut found);
            let [red, green, blue, transmittance] = &found;
            for row in 0..PACKET_ROWS.min(rows - y) {
                let to = &mut out[(y + row) * pass.width + x..];
                for (column, to) in to.iter_mut().take(columns.min(pass.width - x)).enumerate() {
                    let lane = row * columns + column;
                    *to = Vec4::new(red[lane], green[lane], blue[lane], transmittance[lane]);
                }
            }
        }
    }
    steps
}

/// Radiance and transmittance of one packet, whose first pixel is (x, y); returns the steps it took.
#[inline(always)]
fn walk_packet<F: Floats, const K: usize>(
    pass: &Pass<'_>,
    x: usize,
    y: usize,
    found: &mut [[f32; MAX_LANES]; 4],
) -> u64 {
    let columns = F::LANES / PACKET_ROWS;
    let packed = pass.packed;
    let (left, top) = (x as f32 + 0.5, y as f32 + 0.5);
    let first = pass.corner + pass.per_column * left + pass.per_row * top;
    let (across, down) = (pass.per_column * (columns - 1) as f32, pass.per_row * (PACKET_ROWS - 1) as f32);
    found[3] = [1.0; MAX_LANES];
    let hull = match Hull::new(pass, [first, first + across, first + down, first + across + down]) {
        Ok(hull) => hull,
        Err(true) => {
            *found = [[LEFT; MAX_LANES]; 4];
            return 0;
        }
        Err(false) => return 0,
    };
    let is_forward = hull.from > hull.to;

    // Lines of the lanes, one to the right and below, where the border of the records begins.
    let one = F::splat(1.0);
    let lane_row = (F::ramp() * F::splat(1.0 / columns as f32)).truncate().to_floats();
    let lane_column = lane_row.mul_add(F::splat(-(columns as f32)), F::ramp());
    let mut direction = [F::zero(); 3];
    for axis in 0..3 {
        let start = lane_row.mul_add(F::splat(pass.per_row[axis]), F::splat(first[axis]));
        direction[axis] = lane_column.mul_add(F::splat(pass.per_column[axis]), start);
    }
    let [dx, dy, dz] = direction;
    let over_dz = one / dz;
    let (slope_x, slope_y) = (dx * over_dz, dy * over_dz);
    let u0 = slope_x.mul_add(F::splat(pass.focal_px.x), F::splat(pass.centre_px.x + 1.0));
    let v0 = slope_y.mul_add(F::splat(pass.focal_px.y), F::splat(pass.centre_px.y + 1.0));
    let toward_z = F::splat(-pass.origin.z);
    let bu = slope_x.mul_add(toward_z, F::splat(pass.origin.x)) * F::splat(pass.focal_px.x);
    let bv = slope_y.mul_add(toward_z, F::splat(pass.origin.y)) * F::splat(pass.focal_px.y);
    let length = dx.mul_add(dx, dy.mul_add(dy, dz * dz)).sqrt();
    // Powers of two, per step of code along the ray over that along the axis.
    let obliquity = length * over_dz.abs() * F::splat(std::f32::consts::LOG2_E);

    // Where rays end at a surface, as a code of depth.
    let mut ends = F::splat(if is_forward { f32::INFINITY } else { f32::NEG_INFINITY });
    if !pass.surface_m.is_empty() {
        let mut distances = [f32::INFINITY; MAX_LANES];
        for (lane, distance) in distances.iter_mut().take(F::LANES).enumerate() {
            let (column, row) = (x + lane % columns, y + lane / columns);
            let index = row * pass.width + column;
            if column < pass.width && index < pass.surface_m.len() {
                *distance = pass.surface_m[index];
            }
        }
        let distance = F::load(&distances, 0);
        let depth = distance.within(0.0, 1e30).mul_add(dz / length, F::splat(pass.origin.z));
        ends = (depth - F::splat(packed.depths_m[0])) * F::splat(packed.codes_per_m());
    }

    let [width, height] = packed.size_px;
    let pitch = F::Integers::splat(packed.pitch() as i32);
    // With the eye in their midst segments are long and near, and a pixel aside is far away.
    let is_within = packed.depths_m[0] < pass.origin.z && pass.origin.z < packed.depths_m[1];
    let stride = if is_within { pass.stride * STRIDE_WITHIN } else { pass.stride };
    let Planes { from, step, count: steps } = hull.planes(stride);
    let chunk = ((2.0 * CHUNK_PX / stride) as usize).div_ceil(LONGEST) * LONGEST;
    let mut stretch = 1;
    let small = packed.tile_counts(TILE_PX);
    let large = packed.tile_counts(TILE_PX * TILES_PER_BLOCK);

    let mut transmittance = one;
    let (mut red, mut green, mut blue) = (F::zero(), F::zero(), F::zero());
    let (mut at, mut run_end, mut taken) = (0, 0, 0);
    'walk: while at < steps {
        let end = if at + chunk < steps { at + chunk } else { steps };
        let w = from + step * at as f32;
        let mut code = hull.code(pass, w);
        if at >= run_end {
            run_end = if at + chunk * CHUNKS_PER_RUN < steps { at + chunk * CHUNKS_PER_RUN } else { steps };
            let w_end = from + step * run_end as f32;
            let codes = ordered(code, hull.code(pass, w_end));
            if !hull.meets(&packed.blocks, large, (TILE_PX * TILES_PER_BLOCK) as f32, [w, w_end], codes) {
                at = run_end;
                continue;
            }
        }
        let w_end = from + step * end as f32;
        let codes = ordered(code, hull.code(pass, w_end));
        if !hull.meets(&packed.tiles, small, TILE_PX as f32, [w, w_end], codes) {
            at = end;
            continue;
        }
        while at < end {
            let mut passed = stretch;
            while at % passed != 0 || at + passed > end {
                passed /= 2;
            }
            let (before, code_before) = ((red, green, blue, transmittance), code);
            let middle = F::splat(from + step * (at as f32 + 0.5 * passed as f32));
            at += passed;
            let next = if at == steps { hull.ends[1] } else { hull.code(pass, from + step * at as f32) };
            let codes = ordered(code, next);
            code = next;
            taken += 1;
            let u = bu.mul_add(middle, u0).within(0.0, width as f32 + 1.5);
            let v = bv.mul_add(middle, v0).within(0.0, height as f32 + 1.5);
            let record = (v.truncate() * pitch + u.truncate()) * F::Integers::splat(K as i32);
            let (mut low, mut high) = (F::splat(codes[0]), F::splat(codes[1]));
            if is_forward {
                high = high.min(ends);
            } else {
                low = low.max(ends);
            }
            let depths = F::gather_records::<K>(&packed.depths, record);
            for order in 0..K {
                let segment = if is_forward { order } else { K - 1 - order };
                let front = depths[segment].shift_down().to_floats();
                let back = depths[segment].lower_half().to_floats();
                let within = back.min(high) - front.max(low);
                if !F::zero().lt(within).any() {
                    continue;
                }
                let filling = (record + F::Integers::splat(segment as i32)) * F::Integers::splat(2);
                let [first, second] = F::gather_records::<2>(&packed.fillings, filling);
                let extinction = first.upper_half().as_floats();
                let sent = transmittance * attenuation(within.max(F::zero()) * extinction * obliquity);
                red = first.shift_up().as_floats().mul_add(sent, red);
                green = second.upper_half().as_floats().mul_add(sent, green);
                blue = second.shift_up().as_floats().mul_add(sent, blue);
                transmittance = transmittance - sent;
            }
            let loses_much = F::splat(MOST_LOST).lt(before.3 - transmittance).any();
            if passed > 1 && loses_much {
                (red, green, blue, transmittance) = before;
                code = code_before;
                at -= passed;
                stretch = 1;
                continue;
            }
            if !F::splat(OPAQUE).lt(transmittance).any() {
                break 'walk;
            }
            if loses_much || F::splat(MET_NOTHING).lt(transmittance).any() {
                stretch = 1;
            } else if stretch < LONGEST {
                stretch *= 2;
            }
        }
    }
    let [out_red, out_green, out_blue, out_transmittance] = found;
    red.store(out_red, 0);
    green.store(out_green, 0);
    blue.store(out_blue, 0);
    transmittance.max(F::zero()).store(out_transmittance, 0);
    taken
}
