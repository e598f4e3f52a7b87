//! Children: rays that leave a boundary, the points they end at, and how those move from texel to texel.

use super::root::{EDGE, columns, flag};
use super::scratch::{NodeScratch, PAD, Plane, Scratch};
use super::{BAND, BOUNDARY_ENDS, Band, FAR_M, Input, MAX_HALO};
use crate::lanes::{Floats, Integers, Mask, Vector};
use crate::warp::exit::{shape_operator, turned};
use crate::warp::optic::leaving;

/// Relative second difference of a child's distance above which its block is rough: a depth edge of what is seen
/// in the boundary.
const REACH_BEND: f32 = 0.03;
/// Texels over which the shape operator is taken where it is not sent: the remaining noise of the normals falls with it.
pub(super) const SHAPE_REACH: usize = MAX_HALO;

/// A row of a node and of its parent.
#[derive(Clone, Copy)]
struct Row<'a> {
    parent_point: [&'a [f32]; 3],
    point: [&'a [f32]; 3],
    direction: [&'a [f32]; 3],
    normal: [&'a [f32]; 3],
    known: &'a [f32],
    reach: &'a [f32],
    interface: &'a [f32],
    inverse_depth: &'a [f32],
}

impl<'a> Row<'a> {
    /// Row `row`; the boundary is that of `of`.
    #[inline(always)]
    fn new(
        scratch: &'a Scratch,
        parent: &'a NodeScratch,
        own: &'a NodeScratch,
        of: &'a NodeScratch,
        row: usize,
    ) -> Row<'a> {
        Row {
            parent_point: rows(&parent.point, row),
            point: rows(&own.point, row),
            direction: rows(&own.direction, row),
            normal: rows(&own.normal, row),
            known: own.known.row(row),
            reach: own.reach.row(row),
            interface: of.interface.row(row),
            inverse_depth: scratch.inverse_depth.row(row),
        }
    }
}

#[inline(always)]
fn rows(planes: &[Plane; 3], row: usize) -> [&[f32]; 3] {
    let [a, b, c] = planes;
    [a.row(row), b.row(row), c.row(row)]
}

#[inline(always)]
fn vector<F: Floats>(rows: &[&[f32]; 3], x: usize) -> Vector<F> {
    let [a, b, c] = rows;
    Vector([F::load(a, x), F::load(b, x), F::load(c, x)])
}

/// Follows the rays of a child, those of the halo included.
#[inline(always)]
pub(super) fn trace<F: Floats>(input: &Input<'_>, first: usize, child: usize, scratch: &mut Scratch) {
    let node = input.nodes[child];
    let (before, after) = scratch.nodes.split_at_mut(child);
    let (parent, to) = (&before[usize::from(node.parent)], &mut after[0]);
    for row in 0..input.rows() {
        let Some(y) = input.image_row(first, row) else {
            to.known.row_mut(row).fill(0.0);
            continue;
        };
        let distances = &input.tree.nodes[child].distance[y * input.width..(y + 1) * input.width];
        let (parent_point, parent_direction) = (rows(&parent.point, row), rows(&parent.direction, row));
        let (parent_normal, parent_known) = (rows(&parent.normal, row), parent.known.row(row));
        let interfaces = parent.interface.row(row);
        let known = to.known.row_mut(row);
        for x in (0..input.width).step_by(F::LANES) {
            let interface = F::load(interfaces, PAD + x);
            if !F::zero().lt(interface).any() {
                F::zero().store(known, PAD + x);
                continue;
            }
            let direction = vector::<F>(&parent_direction, PAD + x);
            let normal = vector::<F>(&parent_normal, PAD + x);
            let (ray, is_there) = leaving(direction, normal, input.optics.eta(interface), node.arrival);
            let distance = F::load(distances, x);
            let is_known = F::zero().lt(interface)
                & is_there
                & F::zero().lt(distance)
                & F::zero().lt(F::load(parent_known, PAD + x));
            let reach = distance.min(F::splat(FAR_M));
            reach.store(to.reach.row_mut(row), PAD + x);
            F::splat(1.0).or(is_known, F::zero()).store(known, PAD + x);
            let point = vector::<F>(&parent_point, PAD + x).along(ray, reach);
            let is_parent = input.has_children[child];
            for axis in 0..3 {
                ray.0[axis].store(to.direction[axis].row_mut(row), PAD + x);
                if is_parent {
                    point.0[axis].store(to.point[axis].row_mut(row), PAD + x);
                }
            }
        }
    }
}

/// Two neighbours of a texel, or the texel itself in place of one that shows another surface.
struct Neighbours<F: Floats> {
    before: F::Mask,
    after: F::Mask,
    /// 1 over their distance.
    over: F,
}

impl<F: Floats> Neighbours<F> {
    /// Differences of a vector between them, per texel.
    #[inline(always)]
    fn slope(&self, own: Vector<F>, before: Vector<F>, after: Vector<F>) -> Vector<F> {
        (after.or(self.after, own) - before.or(self.before, own)) * self.over
    }
}

/// A place in a row.
#[derive(Clone, Copy)]
struct At<'a> {
    row: &'a Row<'a>,
    x: usize,
}

#[inline(always)]
fn neighbours<F: Floats>(own: At<'_>, [before, after]: [At<'_>; 2]) -> Neighbours<F> {
    let before = shows_same::<F>(own, before);
    let after = shows_same::<F>(own, after);
    let over = F::splat(0.5).or(before & after, F::splat(1.0));
    Neighbours { before, after, over }
}

/// Whether a neighbour is known and of the same surface.
#[inline(always)]
fn shows_same<F: Floats>(own: At<'_>, at: At<'_>) -> F::Mask {
    let inverse = F::load(own.row.inverse_depth, own.x);
    let other = F::load(at.row.inverse_depth, at.x);
    F::zero().lt(F::load(at.row.known, at.x))
        & (F::load(at.row.interface, at.x) - F::load(own.row.interface, own.x)).abs().lt(F::splat(0.5))
        & (other - inverse).abs().lt(inverse.max(other) * F::splat(EDGE))
}

/// The neighbours along a row and across rows.
#[inline(always)]
fn sides<'a>(own: At<'a>, reach: usize, above: &'a Row<'a>, below: &'a Row<'a>) -> [[At<'a>; 2]; 2] {
    [
        [At { x: own.x - reach, ..own }, At { x: own.x + reach, ..own }],
        [At { row: above, ..own }, At { row: below, ..own }],
    ]
}

/// Writes the records of a child and flags where it is rough.
#[inline(always)]
pub(super) fn write<F: Floats>(input: &Input<'_>, band: &mut Band<'_>, child: usize, scratch: &Scratch) {
    let layout = input.layout;
    let stride = layout.stride;
    let (parent, own) = (&scratch.nodes[usize::from(input.nodes[child].parent)], &scratch.nodes[child]);
    let first_plane = layout.child[child] * stride;
    for row in 0..BAND.min(input.height - band.first) {
        let at_row = row * layout.pitch + first_plane;
        let (points, slopes) = band.planes[at_row..at_row + 6 * stride].split_at_mut(3 * stride);
        let at = row + input.halo;
        let above = Row::new(scratch, parent, own, parent, at - 1);
        let here = Row::new(scratch, parent, own, parent, at);
        let below = Row::new(scratch, parent, own, parent, at + 1);
        for x in (0..input.width).step_by(F::LANES) {
            let own = At { row: &here, x: PAD + x };
            let is_known = F::zero().lt(F::load(here.known, own.x));
            if !is_known.any() {
                for axis in 0..3 {
                    F::Integers::splat(0).store(&mut slopes[axis * stride..(axis + 1) * stride], x);
                }
                continue;
            }
            let reach = F::load(here.reach, own.x);
            let (point, ray) = (vector::<F>(&here.parent_point, own.x), vector::<F>(&here.direction, own.x));
            let (mut rough, mut edge) = (0, 0);
            let mut along = [Vector([F::zero(); 3]); 2];
            for (along, [before, after]) in along.iter_mut().zip(sides(own, 1, &above, &below)) {
                let pair = neighbours::<F>(own, [before, after]);
                let of_point = pair.slope(
                    point,
                    vector(&before.row.parent_point, before.x),
                    vector(&after.row.parent_point, after.x),
                );
                let of_ray =
                    pair.slope(ray, vector(&before.row.direction, before.x), vector(&after.row.direction, after.x));
                let (s, t) = (F::load(before.row.reach, before.x), F::load(after.row.reach, after.x));
                let bends = (reach * F::splat(REACH_BEND)).lt((s + t - reach - reach).abs());
                let ends = !(pair.before & pair.after) & is_known;
                rough |= ((bends & is_known) | ends).bits();
                edge |= ends.bits();
                *along = of_point.along(of_ray, reach);
            }
            flag(input, band.roughness, row, x, rough & columns(x, input.width), 1 << child);
            if input.nodes[child].parent == 0 {
                flag(input, band.roughness, row, x, edge & columns(x, input.width), BOUNDARY_ENDS);
            }
            let shown = point.along(ray, reach);
            for axis in 0..3 {
                let plane = axis * stride..(axis + 1) * stride;
                shown.0[axis].as_integers().store(&mut points[plane.clone()], x);
                let (along_x, along_y) = (along[0].0[axis], along[1].0[axis]);
                let (along_x, along_y) = (along_x.or(is_known, F::zero()), along_y.or(is_known, F::zero()));
                along_y.pack_upper(along_x).store(&mut slopes[plane], x);
            }
        }
    }
}

/// Differences of point and normal between the neighbours along a row and across rows.
#[inline(always)]
fn differences<F: Floats>(own: At<'_>, normal: Vector<F>, sides: [[At<'_>; 2]; 2]) -> [(Vector<F>, Vector<F>); 2] {
    let point = vector::<F>(&own.row.point, own.x);
    let mut differences = [(normal, normal); 2];
    for (difference, [before, after]) in differences.iter_mut().zip(sides) {
        let pair = neighbours::<F>(own, [before, after]);
        difference.0 = pair.slope(point, vector(&before.row.point, before.x), vector(&after.row.point, after.x));
        difference.1 = pair.slope(normal, vector(&before.row.normal, before.x), vector(&after.row.normal, after.x));
    }
    differences
}

/// Values of three whole planes from a texel on; lanes behind the end of the row are of the next.
#[inline(always)]
fn load<F: Floats>(planes: &[Vec<f32>; 3], pixel: usize) -> [F; 3] {
    let [a, b, c] = planes;
    [F::load(a, pixel), F::load(b, pixel), F::load(c, pixel)]
}

/// Writes boundary and normal of a node, and but for the root the shape operator of its surface.
#[inline(always)]
pub(super) fn write_surface<F: Floats>(input: &Input<'_>, band: &mut Band<'_>, node: usize, scratch: &Scratch) {
    let layout = input.layout;
    let stride = layout.stride;
    let own = &scratch.nodes[node];
    let first_plane = layout.surface[node] * stride;
    let count = if node == 0 { 4 } else { 7 };
    let sent = &input.tree.nodes[node];
    let is_sent = !sent.shape[0].is_empty();
    for row in 0..BAND.min(input.height - band.first) {
        let at_row = row * layout.pitch + first_plane;
        let planes = &mut band.planes[at_row..at_row + count * stride];
        let at = row + input.halo;
        // Further off only what differences are taken of.
        let reach = if node == 0 || is_sent { 0 } else { SHAPE_REACH };
        let above = Row::new(scratch, own, own, own, at - reach);
        let here = Row::new(scratch, own, own, own, at);
        let below = Row::new(scratch, own, own, own, at + reach);
        for x in (0..input.width).step_by(F::LANES) {
            let own = At { row: &here, x: PAD + x };
            let is_known = F::zero().lt(F::load(here.known, own.x));
            let interface = F::load(here.interface, own.x).or(is_known, F::zero());
            interface.as_integers().store(&mut planes[..stride], x);
            if !F::zero().lt(interface).any() {
                continue;
            }
            let normal = vector::<F>(&here.normal, own.x);
            for axis in 0..3 {
                let plane = (1 + axis) * stride;
                normal.0[axis].as_integers().store(&mut planes[plane..plane + stride], x);
            }
            if node == 0 {
                continue;
            }
            let shape = if is_sent {
                let pixel = (band.first + row) * input.width + x;
                turned(load(&sent.shape, pixel), Vector(load(&sent.normal, pixel)), normal)
            } else {
                let sides = sides(own, reach, &above, &below);
                shape_operator(normal, differences::<F>(own, normal, sides))
            };
            for (index, value) in shape.into_iter().enumerate() {
                let plane = (4 + index) * stride;
                value.as_integers().store(&mut planes[plane..plane + stride], x);
            }
        }
    }
}
