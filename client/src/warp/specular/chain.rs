//! The flow of the children: which old texel shows what a novel ray meets behind a boundary.
//!
//! **The frozen-distance step.** A child's record at a texel is a small patch of tangent plane: the point W that is
//! shown there and how it moves from texel to texel while its distance from the boundary is held. One step intersects
//! the novel ray (w, omega) with that patch:
//! `q = W - w, a = Jy x omega, b = omega x Jx, (du, dv) = -(q.a, q.b) / (Jx.a)`.
//! That takes six words and some 45 operations where descent on the angle (Lochmann, 3.2.9) takes twenty fetches
//! and 400. Two steps do for one bounce, three for a ball of glass; a further one, below a pixel, is proof.
//!
//! Assumes that the reflected scene varies less than the boundary does: on strong waves and near conjugate planes
//! there are several solutions or none, and 4 to 12 % stay undefined with every method.

use super::ladder::{Solver, Sought};
use super::motion::Motion;
use super::root::{RootSample, SurfaceSample, surface_at, texel};
use crate::lanes::{Floats, Integers, MAX_LANES, Mask, Vector, as_floats};
use crate::warp::exit::{Quadric, all};
use crate::warp::optic::leaving;
use crate::warp::prepared::Prepared;
use warplight_protocol::frame::{Arrival, MAX_NODES};

/// Longest step: beyond it the patch says nothing any more.
const LONGEST_STEP_PX: f32 = 64.0;
/// The step after the last must be shorter. On water this lets 0.04 % wrong pixels pass, where one degree of the
/// ray, the thesis's rule, lets 0.9 %.
const ACCEPTED_STEP_PX: f32 = 1.0;
/// Steps for one bounce and for more, where nobody asks for another number.
const STEPS: [usize; 2] = [2, 3];
/// Weights below do not show in 8 bits.
const LEAST_WEIGHT: f32 = 1.0 / 4096.0;

/// What a node shows at new pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample<F: Floats> {
    /// Position in the old picture.
    pub(super) u: F,
    pub(super) v: F,
    /// Factor on its radiance, per channel, from the root on; 0 where it is not seen.
    pub(super) weights: [F; 3],
    /// Whether it is seen.
    pub(super) wanted: F::Mask,
    /// Whether the position was found.
    pub(super) known: F::Mask,
}

/// A boundary met by the novel ray.
#[derive(Clone, Copy)]
struct Boundary<F: Floats> {
    point: Vector<F>,
    direction: Vector<F>,
    normal: Vector<F>,
    interface: F,
    is_there: F::Mask,
    weights: [F; 3],
}

/// Room for all nodes of the pixels under way.
pub(super) struct Chain<F: Floats> {
    boundaries: [Boundary<F>; MAX_NODES],
    pub(super) samples: [Sample<F>; MAX_NODES],
}

impl<F: Floats> Chain<F> {
    #[inline(always)]
    pub(super) fn new() -> Chain<F> {
        let (zero, none) = (F::zero(), F::zero().lt(F::zero()));
        let nowhere = Vector([zero; 3]);
        let boundary = Boundary {
            point: nowhere,
            direction: nowhere,
            normal: nowhere,
            interface: zero,
            is_there: none,
            weights: [zero; 3],
        };
        let sample = Sample { u: zero, v: zero, weights: [zero; 3], wanted: none, known: none };
        Chain { boundaries: [boundary; MAX_NODES], samples: [sample; MAX_NODES] }
    }

    /// Follows the rays of these pixels through all nodes; returns the boundary of the root, 0 for none. `at_edge` where
    /// boundaries may end.
    #[inline(always)]
    pub(super) fn follow(
        &mut self,
        frame: &Prepared,
        motion: &Motion,
        (x, y): (F, F),
        root: &RootSample<F>,
        at_edge: bool,
    ) -> F {
        let (zero, none) = (F::zero(), F::zero().lt(F::zero()));
        if frame.node_count == 1 {
            return zero;
        }
        let SurfaceSample { interface, normal, coverage, on_it } = surface_at(frame, root.u, root.v, at_edge);
        let ray = motion.ray(x, y);
        self.boundaries[0] = Boundary {
            point: Vector::splat(motion.eye).along(ray, F::splat(1.0) / root.inverse_depth.max(F::splat(1e-9))),
            direction: ray.normalize(),
            normal,
            interface,
            is_there: root.known & F::zero().lt(interface),
            weights: [coverage; 3],
        };
        for child in 1..frame.node_count {
            let node = frame.nodes[child];
            let parent = self.boundaries[usize::from(node.parent)];
            self.samples[child] = Sample { u: zero, v: zero, weights: [zero; 3], wanted: none, known: none };
            self.boundaries[child].is_there = none;
            if !parent.is_there.any() {
                continue;
            }
            let eta = frame.optics.eta(parent.interface);
            let (omega, leaves) = leaving(parent.direction, parent.normal, eta, node.arrival);
            let cosine = -parent.direction.dot(parent.normal);
            let weights = frame.optics.weights(parent.interface, eta, cosine, node.arrival);
            let ([a, b, c], [x, y, z]) = (parent.weights, weights);
            let weights = [a * x, b * y, c * z];
            let most = weights[0].max(weights[1]).max(weights[2]);
            let wanted = parent.is_there & leaves & F::splat(LEAST_WEIGHT).lt(most);
            if !wanted.any() {
                continue;
            }
            let (u, v, known) = match frame.solver {
                Solver::FrozenDistance { steps } => {
                    let steps = steps.map_or(STEPS[usize::from(node.parent != 0)], usize::from);
                    search(frame, child, (parent.point, omega), on_it, steps)
                }
                solver => {
                    search_plainly(frame, (child, solver), (parent.point, omega), (motion.eye, ray), on_it, wanted)
                }
            };
            let known = known & wanted;
            let [red, green, blue] = weights;
            let weights = [red.or(wanted, zero), green.or(wanted, zero), blue.or(wanted, zero)];
            self.samples[child] = Sample { u, v, weights, wanted, known };
            if frame.has_children[child] {
                // The exit surface is known by where the root was; a mirrored one by what was found in the mirror.
                let anchor = match node.arrival {
                    Arrival::Reflected => (u.or(known, on_it.0), v.or(known, on_it.1)),
                    _ => on_it,
                };
                self.boundaries[child] = meet(frame, child, anchor, (parent.point, omega), wanted, weights);
            }
        }
        interface
    }
}

/// Where a novel ray meets the surface of a node that has children.
#[inline(always)]
fn meet<F: Floats>(
    frame: &Prepared,
    node: usize,
    (u, v): (F, F),
    (origin, direction): (Vector<F>, Vector<F>),
    wanted: F::Mask,
    weights: [F; 3],
) -> Boundary<F> {
    let at = texel(frame, u, v);
    let [interface, a, b, c] = as_floats(F::gather_words(frame.surface(node), at));
    let [x, y, z, slopes, _, _] = F::gather_words(frame.record(node), at);
    let shape = as_floats(F::gather_words(frame.shape(node), at));
    let point = Vector(as_floats([x, y, z]));
    let quadric = Quadric { point, normal: Vector([a, b, c]), shape };
    let (point, normal, is_met) = quadric.meet(origin, direction);
    let has_record = F::zero().lt(slopes.shift_up().as_floats().abs() + slopes.upper_half().as_floats().abs());
    let is_there = all([wanted, is_met, has_record, F::zero().lt(interface)]);
    Boundary { point, direction, normal, interface, is_there, weights }
}

/// The same by another solver, lane by lane.
#[inline(never)]
fn search_plainly<F: Floats>(
    frame: &Prepared,
    (child, solver): (usize, Solver),
    (origin, omega): (Vector<F>, Vector<F>),
    (eye, ray): (glam::Vec3, Vector<F>),
    (u, v): (F, F),
    wanted: F::Mask,
) -> (F, F, F::Mask) {
    let mut lanes = [[0.0; MAX_LANES]; 11];
    let [u, v] = [u, v];
    let [a, b, c] = origin.0;
    let [d, e, f] = omega.0;
    let [x, y, z] = ray.0;
    for (lanes, value) in lanes.iter_mut().zip([a, b, c, d, e, f, x, y, z, u, v]) {
        value.store(lanes, 0);
    }
    let mut found = [[0.0; MAX_LANES]; 3];
    for lane in (0..F::LANES).filter(|lane| wanted.bits() >> lane & 1 == 1) {
        let at = |first: usize| glam::Vec3::new(lanes[first][lane], lanes[first + 1][lane], lanes[first + 2][lane]);
        let start = glam::Vec2::new(lanes[9][lane], lanes[10][lane]);
        let sought = Sought { origin: at(0), omega: at(3), eye, ray: at(6), start };
        if let Some(pixel) = super::ladder::search(frame, child, solver, &sought) {
            (found[0][lane], found[1][lane], found[2][lane]) = (pixel.x, pixel.y, 1.0);
        }
    }
    let [u, v, known] = &found;
    (F::load(u, 0), F::load(v, 0), F::zero().lt(F::load(known, 0)))
}

/// The old texel of a child whose point lies on the novel ray, from a first guess on, and whether there is one.
#[inline(always)]
fn search<F: Floats>(
    frame: &Prepared,
    child: usize,
    (origin, omega): (Vector<F>, Vector<F>),
    start: (F, F),
    steps: usize,
) -> (F, F, F::Mask) {
    let record = frame.record(child);
    let (width, height) = frame.size();
    let (low, high) = (-LONGEST_STEP_PX, LONGEST_STEP_PX);
    let half = F::splat(0.5);
    let (mut u, mut v) = start;
    let mut last_good = start;
    let mut known = F::zero().lt(F::zero());
    for step in 0..=steps {
        let column = u.within(0.0, width as f32 - 0.25).truncate();
        let row = v.within(0.0, height as f32 - 0.25).truncate();
        let at = row * F::Integers::splat(frame.layout.pitch as i32) + column;
        let [x, y, z, a, b, c] = F::gather_words(record, at);
        let q = Vector(as_floats([x, y, z])) - origin;
        let along_x = Vector(as_floats([a.shift_up(), b.shift_up(), c.shift_up()]));
        let along_y = Vector(as_floats([a.upper_half(), b.upper_half(), c.upper_half()]));
        // Step.
        let (across_y, across_x) = (along_y.cross(omega), omega.cross(along_x));
        let determinant = along_x.dot(across_y);
        let over = F::splat(-1.0) / determinant;
        let (du, dv) = ((q.dot(across_y) * over).within(low, high), (q.dot(across_x) * over).within(low, high));
        // A texel without a record has no slopes.
        let is_valid = F::splat(f32::MIN_POSITIVE).lt(determinant.abs());
        let (centre_u, centre_v) = (column.to_floats() + half, row.to_floats() + half);
        if step == steps {
            let is_short = du.abs().max(dv.abs()).lt(F::splat(ACCEPTED_STEP_PX));
            known = is_valid & is_short & F::zero().lt(q.dot(omega));
        }
        // Else half-way back.
        let back = ((u + last_good.0) * half, (v + last_good.1) * half);
        last_good = (centre_u.or(is_valid, last_good.0), centre_v.or(is_valid, last_good.1));
        u = (centre_u + du).or(is_valid, back.0);
        v = (centre_v + dv).or(is_valid, back.1);
    }
    // The proof's own step is taken, too; it may lead half a texel over the border.
    let known =
        known & u.lt(F::splat(width as f32)) & v.lt(F::splat(height as f32)) & !u.lt(F::zero()) & !v.lt(F::zero());
    (u, v, known)
}
