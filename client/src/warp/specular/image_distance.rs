//! The image that a curved boundary makes: a rung of the ladder between the unfolded depth and a search.
//!
//! Light that diverges from a point seen in a boundary seems, behind it, to come from elsewhere: for a plane mirror
//! from the mirrored point, for a ball from nearer. So a child may be warped by depth alone if its depth is that of
//! the image (mirror equation `1/s' = 1/s + 2/R`; refraction at a plane `s' = s/eta`). Seen askew, a curved boundary
//! makes no point of a point but two focal lines, at distances that Coddington's equations (Coddington 1829) give in
//! the planes of incidence and across it. Their general form, for boundaries that bend in any direction (Kneisly
//! 1964), carries the curvature matrix Q of the wave through the boundary: along tangents x of a boundary with shape
//! operator S, `x Q' x = eta x Q x + (k'.n - eta k.n) x S x`, where k and k' are the ray's directions before and
//! behind it, towards the eye, and over a way d `Q' = Q (1 + d Q)^-1`. Q at the old eye has the inverse distances of
//! both lines as eigenvalues, and the ray of the pencil that reaches a new eye passes through both lines.
//!
//! The texel is found by a fixed point (as Bowles et al. 2012 do for depth): where would the content of this texel be
//! seen now, and how far is that from the ray that is asked for?
//!
//! Limits: a pencil of one point; what the ray does far from where it was, or where the curvature changes, it does
//! not know. The shape operator of the root is that of differences of its points and normals over 7 texels, of other
//! nodes the frame's. Exact for planes. Cost: some 400 operations a step, plain code.

use super::ladder::{Picture, Sought};
use crate::warp::prepared::Prepared;
use glam::{Mat2, Vec2, Vec3};
use warplight_protocol::frame::{Arrival, MAX_NODES};

/// Steps of the fixed point: each leaves the part by which the flow of a pixel differs from its neighbour's.
const STEPS: usize = 6;
/// Longest step.
const LONGEST_STEP_PX: f32 = 64.0;
/// The last step is shorter than this, or nothing was found.
const ACCEPTED_STEP_PX: f32 = 1.0;
/// Texels to either side over which the root's shape operator is taken, as for other nodes.
const SHAPE_REACH: usize = 3;
/// Neighbours of the root further apart than this, in parts of their depth, lie on different surfaces.
const EDGE: f32 = 0.05;

/// The texel whose content the image of the boundaries shows at the new ray.
pub(super) fn search(frame: &Prepared, child: usize, sought: &Sought) -> Option<Vec2> {
    let camera = &frame.camera;
    let (width, height) = frame.size();
    let inside = |pixel: Vec2| pixel.min_element() >= 0.0 && pixel.x < width as f32 && pixel.y < height as f32;
    let wanted = camera.pixel_from_view(sought.ray)?;
    let picture = Picture { frame, child };
    let path = Path::to(frame, child);
    let mut pixel = sought.start;
    let mut good = None;
    for step in 0..=STEPS {
        let texel = if inside(pixel) { path.pencil(&picture, pixel.x as usize, pixel.y as usize) } else { None };
        let Some(pencil) = texel else {
            // Half-way back to where something is shown.
            pixel = (pixel + good?) * 0.5;
            if step == STEPS {
                return None;
            }
            continue;
        };
        let centre = Vec2::new(pixel.x as usize as f32, pixel.y as usize as f32) + 0.5;
        let change = wanted - camera.pixel_from_view(pencil.seen_from(sought.eye))?;
        if step == STEPS && change.abs().max_element() >= ACCEPTED_STEP_PX {
            return None;
        }
        good = Some(centre);
        pixel = centre + change.clamp_length_max(LONGEST_STEP_PX);
    }
    inside(pixel).then_some(pixel)
}

/// Nodes from the root to a child.
struct Path {
    nodes: [usize; MAX_NODES],
    count: usize,
}

/// The light that comes from one point to the old eye.
#[derive(Clone, Copy, Debug)]
struct Pencil {
    /// From the eye along the old ray.
    direction: Vec3,
    /// Both directions across it.
    across: [Vec3; 2],
    /// Curvature of the wave at the eye, in 1/m.
    curvature: Mat2,
}

impl Pencil {
    /// Direction in which the point is seen from an eye that has moved.
    fn seen_from(&self, eye: Vec3) -> Vec3 {
        let Pencil { direction, across: [u, v], curvature } = *self;
        let (aside, ahead) = (Vec2::new(eye.dot(u), eye.dot(v)), eye.dot(direction));
        // Through both focal lines: slopes -x / (D - z) along the axes of the matrix, that is -Q (1 - z Q)^-1 x.
        let to = (Mat2::IDENTITY - curvature * ahead).inverse() * (curvature * aside);
        direction - u * to.x - v * to.y
    }
}

/// A boundary on the way, as the wave meets it.
#[derive(Clone, Copy, Debug)]
struct Boundary {
    normal: Vec3,
    /// In the basis of [`tangents`].
    shape: Mat2,
    /// Index on the far side over that on the near one; 1 for reflection.
    eta: f32,
}

impl Boundary {
    /// Curvature behind the boundary of a wave that comes along `from` and leaves along `to`, both towards the eye.
    fn pass(&self, curvature: Mat2, from: (Vec3, [Vec3; 2]), to: (Vec3, [Vec3; 2])) -> Mat2 {
        let Boundary { normal, shape, eta } = *self;
        let [t, b] = tangents(normal);
        let onto = Mat2::from_cols_array(&[from.1[0].dot(t), from.1[1].dot(t), from.1[0].dot(b), from.1[1].dot(b)]);
        let along = onto.transpose() * curvature * onto * eta + shape * (to.0.dot(normal) - eta * from.0.dot(normal));
        // The tangent that is projected along the ray onto each direction across it.
        let [x, y] = to.1.map(|axis| axis - to.0 * (axis.dot(normal) / to.0.dot(normal)));
        let back = Mat2::from_cols_array(&[x.dot(t), x.dot(b), y.dot(t), y.dot(b)]);
        back.transpose() * along * back
    }
}

/// Curvature further on.
fn after(curvature: Mat2, way: f32) -> Mat2 {
    curvature * (Mat2::IDENTITY + curvature * way).inverse()
}

impl Path {
    fn to(frame: &Prepared, child: usize) -> Path {
        let (mut nodes, mut count, mut node) = ([0; MAX_NODES], 1, child);
        let mut depth = child;
        while depth != 0 {
            depth = usize::from(frame.nodes[depth].parent);
            count += 1;
        }
        for place in (0..count).rev() {
            nodes[place] = node;
            node = usize::from(frame.nodes[node].parent);
        }
        Path { nodes, count }
    }

    /// The pencil of what a texel shows.
    fn pencil(&self, picture: &Picture<'_>, x: usize, y: usize) -> Option<Pencil> {
        let frame = picture.frame;
        let mut points = [Vec3::ZERO; MAX_NODES];
        for (point, &node) in points.iter_mut().zip(&self.nodes[..self.count]) {
            *point = match node {
                0 => root_point(frame, x, y)?,
                child => Picture { frame, child }.texel(x, y)?,
            };
        }
        let last = self.count - 1;
        // Towards the eye, from point i + 1 to point i.
        let towards = |place: usize| {
            let way = points[place] - points[place + 1];
            Some((way.try_normalize()?, way.length()))
        };
        let (mut from, way) = towards(last - 1)?;
        let mut across = across_of(from);
        let mut curvature = Mat2::IDENTITY / way;
        for place in (0..last).rev() {
            let boundary = self.boundary(frame, place, (x, y))?;
            let (to, way) = match place {
                0 => (-points[0].try_normalize()?, points[0].length()),
                place => towards(place - 1)?,
            };
            let behind = across_of(to);
            curvature = after(boundary.pass(curvature, (from, across), (to, behind)), way);
            (from, across) = (to, behind);
        }
        curvature.is_finite().then_some(Pencil { direction: -from, across, curvature })
    }

    /// The boundary of the node at this place of the path.
    fn boundary(&self, frame: &Prepared, place: usize, (x, y): (usize, usize)) -> Option<Boundary> {
        let node = self.nodes[place];
        let at = y * frame.layout.pitch + x;
        let interface = f32::from_bits(frame.surface(node)[0][at]);
        if interface <= 0.0 {
            return None;
        }
        let normal = normal_at(frame, node, x, y);
        let shape = match node {
            0 => root_shape(frame, normal, (x, y)),
            _ => frame.shape(node).map(|plane| f32::from_bits(plane[at])),
        };
        let [a, b, c] = shape;
        let eta = match frame.nodes[self.nodes[place + 1]].arrival {
            Arrival::Refracted => frame.optics.eta_of(interface as u8),
            Arrival::Reflected | Arrival::Direct => 1.0,
        };
        Some(Boundary { normal, shape: Mat2::from_cols_array(&[a, b, b, c]), eta })
    }
}

fn normal_at(frame: &Prepared, node: usize, x: usize, y: usize) -> Vec3 {
    let at = y * frame.layout.pitch + x;
    let [_, nx, ny, nz] = frame.surface(node);
    Vec3::new(f32::from_bits(nx[at]), f32::from_bits(ny[at]), f32::from_bits(nz[at]))
}

fn root_point(frame: &Prepared, x: usize, y: usize) -> Option<Vec3> {
    let inverse_depth = f32::from_bits(frame.inverse_depth()[y * frame.layout.pitch + x]);
    let ray = frame.camera.ray_in_view(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
    (inverse_depth > 0.0).then(|| ray / inverse_depth)
}

/// The shape operator of the root: how its normal turns over [`SHAPE_REACH`] texels to either side.
fn root_shape(frame: &Prepared, normal: Vec3, (x, y): (usize, usize)) -> [f32; 3] {
    let (width, height) = frame.size();
    let surface = |x: usize, y: usize| frame.surface(0)[0][y * frame.layout.pitch + x];
    let own_depth = f32::from_bits(frame.inverse_depth()[y * frame.layout.pitch + x]);
    let neighbour = |at: Option<(usize, usize)>| {
        let (p, q) = at.filter(|&(p, q)| p < width && q < height && surface(p, q) == surface(x, y))?;
        let depth = f32::from_bits(frame.inverse_depth()[q * frame.layout.pitch + p]);
        let is_same = (depth - own_depth).abs() < EDGE * depth.max(own_depth);
        is_same.then_some((root_point(frame, p, q)?, normal_at(frame, 0, p, q)))
    };
    let own = (root_point(frame, x, y).unwrap_or(Vec3::ZERO), normal);
    let difference = |before: Option<(usize, usize)>, after: Option<(usize, usize)>| {
        let (before, after) = (neighbour(before).unwrap_or(own), neighbour(after).unwrap_or(own));
        (after.0 - before.0, after.1 - before.1)
    };
    let along_x = difference(x.checked_sub(SHAPE_REACH).map(|left| (left, y)), Some((x + SHAPE_REACH, y)));
    let along_y = difference(y.checked_sub(SHAPE_REACH).map(|above| (x, above)), Some((x, y + SHAPE_REACH)));
    let [t, b] = tangents(normal);
    let in_tangents = |vector: Vec3| Vec2::new(vector.dot(t), vector.dot(b));
    let points = Mat2::from_cols(in_tangents(along_x.0), in_tangents(along_y.0));
    let normals = Mat2::from_cols(in_tangents(along_x.1), in_tangents(along_y.1));
    let scale = along_x.0.length_squared().max(along_y.0.length_squared());
    if points.determinant().abs() <= 1e-3 * scale {
        return [0.0; 3];
    }
    let shape = normals * points.inverse();
    [shape.x_axis.x, 0.5 * (shape.x_axis.y + shape.y_axis.x), shape.y_axis.y]
}

/// The basis in which shape operators are given: that of [`crate::warp::exit::tangents`].
fn tangents(normal: Vec3) -> [Vec3; 2] {
    let Vec3 { x, y, z } = normal;
    let sign = if z < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + z);
    let b = x * y * a;
    [Vec3::new(1.0 + sign * x * x * a, sign * b, -sign * x), Vec3::new(b, sign + y * y * a, -y)]
}

/// Both directions across a ray: any will do, as long as they are kept.
fn across_of(direction: Vec3) -> [Vec3; 2] {
    let (u, v) = direction.any_orthonormal_pair();
    [u, v]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Floats, Portable, Vector};
    use crate::warp::exit;

    /// Of a wave from `way` ahead of the boundary, the inverse distances of both focal lines behind it.
    fn images(boundary: Boundary, incident: Vec3, leaving: Vec3, way: f32) -> [f32; 2] {
        let (from, to) = (-leaving, -incident);
        let behind = boundary.pass(Mat2::IDENTITY / way, (from, across_of(from)), (to, across_of(to)));
        let (mean, difference) = (behind.x_axis.x + behind.y_axis.y, behind.x_axis.x - behind.y_axis.y);
        let root = (difference * difference + 4.0 * behind.x_axis.y * behind.x_axis.y).sqrt();
        [0.5 * (mean - root), 0.5 * (mean + root)]
    }

    #[test]
    fn a_plane_mirror_keeps_the_distance_and_water_shortens_it() {
        let mirror = Boundary { normal: Vec3::Z, shape: Mat2::ZERO, eta: 1.0 };
        for inverse in images(mirror, Vec3::new(0.6, 0.0, -0.8), Vec3::new(0.6, 0.0, 0.8), 2.0) {
            assert!((inverse - 0.5).abs() < 1e-6);
        }
        let water = Boundary { eta: 1.33, ..mirror };
        for inverse in images(water, -Vec3::Z, -Vec3::Z, 2.0) {
            assert!((inverse - 1.33 / 2.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_ball_obeys_coddingtons_equations() {
        let (radius, way, cosine) = (0.5_f32, 2.0, 0.8_f32);
        let (incident, leaving) = (Vec3::new(0.6, 0.0, -0.8), Vec3::new(0.6, 0.0, 0.8));
        let ball = Boundary { normal: Vec3::Z, shape: Mat2::IDENTITY / radius, eta: 1.0 };
        let [sagittal, tangential] = images(ball, incident, leaving, way);
        assert!((sagittal - (1.0 / way + 2.0 * cosine / radius)).abs() < 1e-5);
        assert!((tangential - (1.0 / way + 2.0 / (radius * cosine))).abs() < 1e-5);
        // Refraction: n' cos^2 I' / s' - n cos^2 I / s = (n' cos I' - n cos I) / R, and without the squares across.
        let eta = 1.5_f32;
        let sine = 0.6 / eta;
        let inside = (1.0 - sine * sine).sqrt();
        let glass = Boundary { eta, ..ball };
        let found = images(glass, incident, Vec3::new(sine, 0.0, -inside), way);
        let power = (cosine - eta * inside) / radius;
        let sagittal = eta / way + power;
        let tangential = (eta * inside * inside / way + power) / (cosine * cosine);
        for expected in [sagittal, tangential] {
            assert!(found.iter().any(|found| (found - expected).abs() < 1e-5), "{found:?} {expected}");
        }
    }

    #[test]
    fn a_point_is_seen_where_it_is_from_any_eye() {
        let point = Vec3::new(0.3, -0.2, -3.0);
        let direction = point.normalize();
        let curvature = Mat2::IDENTITY / point.length();
        let pencil = Pencil { direction, across: across_of(direction), curvature };
        for eye in [Vec3::X, Vec3::new(0.1, 0.2, -0.5), Vec3::Z * 0.3] {
            let seen = pencil.seen_from(eye);
            assert!(seen.angle_between(point - eye) < 1e-3, "{seen}");
        }
    }

    #[test]
    fn tangents_are_those_of_the_frames_shape_operators() {
        for normal in [Vec3::Z, -Vec3::Z, Vec3::X, Vec3::new(0.3, 0.2, 0.9), Vec3::new(1.0, -2.0, -0.5)] {
            let normal = normal.normalize();
            let lanes = exit::tangents(Vector::<Portable>::splat(normal));
            for (plain, lanes) in tangents(normal).into_iter().zip(lanes) {
                let lanes = Vec3::from_array(lanes.0.map(|axis| axis.lanes()[0]));
                assert!((plain - lanes).length() < 1e-6, "{normal}");
            }
        }
    }
}
