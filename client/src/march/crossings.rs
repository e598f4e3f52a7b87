//! Which pixels of a frame a ray of another pose crosses, and from where to where.
//!
//! The image of a ray is a straight line, its epipolar line, and the ray passes the frusta of the pixels on it one after
//! another. Where it goes over from one column to the next is found per boundary in closed form, not by adding up
//! steps: the point of the ray on the plane through the eye and the column's edge. So errors do not add up, and each
//! pixel comes once: along a ray columns and rows change in one direction only, since `x / z` of a ray is monotone.
//! It is the traversal of Amanatides and Woo 1987 in a perspective grid.
//!
//! A ray that turns on the spot has a point as its line and crosses one pixel, for its whole length; so has a ray
//! through the epipole. A ray along an edge of pixels belongs to the pixel to the right of it or below. Cost: two
//! divisions per pixel.

use super::view::{Pinhole, Ray};

/// A pixel, and the part of the ray that is within its frustum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Crossing {
    pub(super) column: usize,
    pub(super) row: usize,
    /// Parameters of the ray, `enter < exit`.
    pub(super) enter: f64,
    pub(super) exit: f64,
}

/// The crossings of a ray, from its origin on.
#[derive(Clone, Debug)]
pub(super) struct Crossings {
    axes: [Axis; 2],
    /// Depth along the ray: `depth[0] + t depth[1]`.
    depth: [f64; 2],
    near: f64,
    t: f64,
    end: f64,
}

/// Columns or rows.
#[derive(Clone, Copy, Debug)]
struct Axis {
    /// `focal * (origin + t direction)`, to be divided by depth.
    line: [f64; 2],
    centre: f64,
    size: usize,
    /// Where the ray is, and whether what it comes to has higher numbers; `None` if it stays.
    index: usize,
    rises: Option<bool>,
}

impl Crossings {
    /// Of a ray up to `t = farthest`, as far as its depth is within `depths` (both above zero).
    pub(super) fn new(frame: &Pinhole, ray: &Ray, depths: [f64; 2], farthest: f64) -> Crossings {
        let depth = [ray.origin.z, ray.direction.z];
        let [near, far] = depths;
        let (mut start, mut end) = (0.0, farthest);
        let mut keep = |at: f64, slope: f64| {
            // at + t slope >= 0
            let t = -at / slope;
            if slope > 0.0 {
                start = f64::max(start, t);
            } else if slope < 0.0 {
                end = f64::min(end, t);
            } else if at < 0.0 {
                end = -1.0;
            }
        };
        keep(depth[0] - near, depth[1]);
        keep(far - depth[0], -depth[1]);
        let axis = |axis: usize| {
            let line = [frame.focal_px[axis] * ray.origin[axis], frame.focal_px[axis] * ray.direction[axis]];
            let turn = line[1] * depth[0] - line[0] * depth[1];
            let rises = (turn != 0.0).then_some(turn > 0.0);
            Axis { line, centre: frame.centre_px[axis], size: frame.size_px[axis], index: 0, rises }
        };
        let mut axes = [axis(0), axis(1)];
        for axis in &axes {
            let low = [0, 1].map(|order| axis.line[order] + axis.centre * depth[order]);
            keep(low[0], low[1]);
            keep(axis.size as f64 * depth[0] - low[0], axis.size as f64 * depth[1] - low[1]);
        }
        if start < end {
            let z = depth[0] + start * depth[1];
            for axis in &mut axes {
                let position = (axis.line[0] + start * axis.line[1]) / z + axis.centre;
                axis.index = (position.max(0.0) as usize).min(axis.size - 1);
            }
        }
        Crossings { axes, depth, near, t: start, end }
    }

    /// Parameter at which the ray leaves its column or row; infinite if it does not.
    fn leaves(&self, axis: &Axis) -> f64 {
        let Some(rises) = axis.rises else { return f64::INFINITY };
        let edge = (axis.index + usize::from(rises)) as f64 - axis.centre;
        let t = (edge * self.depth[0] - axis.line[0]) / (axis.line[1] - edge * self.depth[1]);
        // An edge beyond the vanishing point is met by the ray's other end, behind the eye of the frame. All that is
        // walked through is at `near` and beyond, so half of it tells the two apart whatever the rounding.
        let is_before_the_eye = self.depth[0] + t * self.depth[1] > 0.5 * self.near;
        if is_before_the_eye { t.max(self.t) } else { f64::INFINITY }
    }
}

impl Iterator for Crossings {
    type Item = Crossing;
    fn next(&mut self) -> Option<Crossing> {
        while self.t < self.end {
            let [column, row] = self.axes.map(|axis| axis.index);
            let leaves = [self.leaves(&self.axes[0]), self.leaves(&self.axes[1])];
            let first = usize::from(leaves[1] < leaves[0]);
            let enter = self.t;
            let exit = leaves[first].min(self.end);
            self.t = exit;
            if leaves[first] < self.end {
                let axis = &mut self.axes[first];
                match axis.rises {
                    Some(true) if axis.index + 1 < axis.size => axis.index += 1,
                    Some(false) if axis.index > 0 => axis.index -= 1,
                    _ => self.end = self.t,
                }
            }
            if enter < exit {
                return Some(Crossing { column, row, enter, exit });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;
    use glam::{DVec2, DVec3};
    use warplight_protocol::{Camera, FieldOfView, ImageSize};

    const DEPTHS: [f64; 2] = [0.3, 5.0];

    fn frame() -> Pinhole {
        let fov = FieldOfView { left: -0.9, right: 0.6, down: -0.5, up: 0.8 };
        Pinhole::new(&Camera::perspective(ImageSize::new(12, 9), fov))
    }

    /// Every pixel by itself: where the ray is between the four planes of its frustum.
    fn brute_force(frame: &Pinhole, ray: &Ray, farthest: f64) -> Vec<Crossing> {
        let mut found = Vec::new();
        for row in 0..frame.size_px[1] {
            for column in 0..frame.size_px[0] {
                let low = frame.ray(DVec2::new(column as f64, row as f64));
                let high = frame.ray(DVec2::new(column as f64 + 1.0, row as f64 + 1.0));
                let planes = [
                    (DVec3::new(1.0, 0.0, -low.x), 0.0),
                    (DVec3::new(-1.0, 0.0, high.x), 0.0),
                    (DVec3::new(0.0, 1.0, -low.y), 0.0),
                    (DVec3::new(0.0, -1.0, high.y), 0.0),
                    (DVec3::Z, -DEPTHS[0]),
                    (-DVec3::Z, DEPTHS[1]),
                ];
                let (mut enter, mut exit) = (0.0_f64, farthest);
                for (normal, offset) in planes {
                    let (at, slope) = (normal.dot(ray.origin) + offset, normal.dot(ray.direction));
                    let t = -at / slope;
                    if slope.abs() < 1e-14 {
                        exit = if at < 0.0 { -1.0 } else { exit };
                    } else if slope > 0.0 {
                        enter = enter.max(t);
                    } else {
                        exit = exit.min(t);
                    }
                }
                if enter < exit {
                    found.push(Crossing { column, row, enter, exit });
                }
            }
        }
        found.sort_by(|a, b| a.enter.total_cmp(&b.enter));
        found
    }

    /// What is longer than rounding.
    fn whole(crossings: impl IntoIterator<Item = Crossing>) -> Vec<Crossing> {
        crossings.into_iter().filter(|crossing| crossing.exit - crossing.enter > 1e-9).collect()
    }

    fn check(ray: &Ray, farthest: f64) -> usize {
        worst_of(ray, farthest).0
    }

    /// Pixels crossed, and how far an end of a crossing is from where it should be.
    fn worst_of(ray: &Ray, farthest: f64) -> (usize, f64) {
        let frame = frame();
        let mut worst = 0.0_f64;
        let all: Vec<Crossing> = Crossings::new(&frame, ray, DEPTHS, farthest).collect();
        let mut seen: Vec<_> = all.iter().map(|crossing| (crossing.column, crossing.row)).collect();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), all.len(), "each pixel once: {all:?}");
        let (walked, expected) = (whole(all), whole(brute_force(&frame, ray, farthest)));
        assert_eq!(walked.len(), expected.len(), "{ray:?}\n{walked:?}\n{expected:?}");
        for (a, b) in walked.iter().zip(&expected) {
            assert_eq!((a.column, a.row), (b.column, b.row), "{ray:?}");
            worst = worst.max((a.enter - b.enter).abs()).max((a.exit - b.exit).abs());
        }
        (walked.len(), worst)
    }

    /// Rays from everywhere to everywhere, with the epipole in the picture, behind the eye, turned around, from within the
    /// volume and from outside; each pixel that brute force finds once and no other, which `worst_of` asserts.
    #[test]
    fn stability_epipolar_walk() {
        let mut ends = bound!("epipolar", "ends of crossings off brute force, in lengths of the ray", 1e-9);
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1 << 24)
        };
        let mut crossed = 0;
        for round in 0..20_000 {
            let mut vector = |size: f64| DVec3::new(random() - 0.5, random() - 0.5, random() - 0.5) * size;
            let (origin, target) = (vector(if round % 3 == 0 { 0.2 } else { 6.0 }), vector(6.0));
            let farthest = if round % 4 == 0 { 0.5 } else { f64::INFINITY };
            let (pixels, worst) = worst_of(&Ray { origin, direction: target - origin }, farthest);
            ends.see(worst, format!("{origin} to {target}"));
            crossed += pixels;
        }
        assert!(crossed > 20_000, "{crossed}");
        let mut wrong = bound!("epipolar", "walks of a turned head or along edges that miss or repeat a pixel", 0.0);
        for edge in 0..=9 {
            let on_edge = |x: f64| frame().ray(DVec2::new(x, f64::from(edge))) * 2.0;
            let ray = Ray { origin: on_edge(-1.0), direction: on_edge(13.0) - on_edge(-1.0) };
            let all = whole(Crossings::new(&frame(), &ray, DEPTHS, f64::INFINITY));
            // The edges of the picture belong to it or not; within, all columns are crossed in one row.
            let is_row = all.len() == 12 && all.iter().enumerate().all(|(at, c)| c.row == all[0].row && c.column == at);
            wrong.count(!(is_row || (edge % 9 == 0 && all.is_empty())), edge);
        }
        for pixel in (0..12 * 9).map(|at| DVec2::new(f64::from(at % 12) + 0.5, f64::from(at / 12) + 0.5)) {
            for origin in [DVec3::ZERO, DVec3::splat(1e-17)] {
                let ray = Ray { origin, direction: frame().ray(pixel) };
                let all: Vec<Crossing> = Crossings::new(&frame(), &ray, DEPTHS, f64::INFINITY).collect();
                let is_one = all.len() == 1 && (all[0].column, all[0].row) == (pixel.x as usize, pixel.y as usize);
                wrong.count(!is_one, pixel);
            }
        }
    }

    /// The line is a point, and the pixel is crossed for the whole depth.
    #[test]
    fn a_ray_from_the_eye_crosses_one_pixel() {
        for origin in [DVec3::ZERO, DVec3::new(1e-17, -1e-17, 1e-17)] {
            for pixel in [DVec2::new(3.5, 2.5), DVec2::new(0.1, 8.9), DVec2::new(4.2, 4.1)] {
                let ray = Ray { origin, direction: frame().ray(pixel) };
                let all: Vec<Crossing> = Crossings::new(&frame(), &ray, DEPTHS, f64::INFINITY).collect();
                assert_eq!(all.len(), 1, "{all:?}");
                assert_eq!((all[0].column, all[0].row), (pixel.x as usize, pixel.y as usize));
                assert!((all[0].enter - DEPTHS[0]).abs() < 1e-12 && (all[0].exit - DEPTHS[1]).abs() < 1e-12);
            }
        }
        // Through the epipole, forwards and backwards.
        let pixel = frame().ray(DVec2::new(3.5, 2.5));
        assert_eq!(check(&Ray { origin: pixel, direction: pixel }, f64::INFINITY), 1);
        assert_eq!(check(&Ray { origin: pixel * 8.0, direction: -pixel }, f64::INFINITY), 1);
    }

    /// And through corners.
    #[test]
    fn a_ray_along_an_edge_crosses_one_row_of_pixels() {
        let frame = frame();
        let [start, end] = [DVec2::new(-1.0, 4.0), DVec2::new(13.0, 4.0)].map(|pixel| frame.ray(pixel) * 2.0);
        let ray = Ray { origin: start, direction: end - start };
        let all = whole(Crossings::new(&frame, &ray, DEPTHS, f64::INFINITY));
        assert_eq!(all.len(), 12);
        let row = all[0].row;
        assert!((row == 3 || row == 4) && all.iter().enumerate().all(|(at, c)| c.row == row && c.column == at));
        let [start, end] = [DVec2::new(0.0, 0.0), DVec2::new(9.0, 9.0)].map(|pixel| frame.ray(pixel) * 2.0);
        let all = whole(Crossings::new(&frame, &Ray { origin: start, direction: end - start }, DEPTHS, 1.0));
        let length: f64 = all.iter().map(|crossing| crossing.exit - crossing.enter).sum();
        assert!((length - 1.0).abs() < 1e-9, "nothing is left out: {length}");
        assert!(all.iter().filter(|crossing| crossing.row == crossing.column).count() == 9);
    }

    #[test]
    fn a_ray_across_the_view_has_constant_depth() {
        let ray = Ray { origin: DVec3::new(-9.0, 0.1, 1.0), direction: DVec3::X };
        assert_eq!(check(&ray, f64::INFINITY), 12);
        let beside = Ray { origin: DVec3::new(-9.0, 0.1, 0.1), direction: DVec3::X };
        assert_eq!(check(&beside, f64::INFINITY), 0, "nearer than anything in the frame");
    }
}
