//! Other ways to search a child's picture: rungs of the ladder, plain code, one pixel after the other.
//!
//! - [`Solver::Descent`]: the first design's, gradient descent on the angle between the novel ray and the way to the
//!   point that a texel shows (Lochmann, 3.2.9), slopes by differences in the picture, the step halved where it does not
//!   help or leaves the surface; more than a degree left is undefined. The start is the better of the diffuse flow and
//!   the unfolded guess (the design blends the two by their errors, which for a plane leaves neither).
//! - [`Solver::GaussNewton`]: the same residual as a vector in the plane across the ray, and its Jacobian from the
//!   points of neighbouring texels, so with the distance varying, as it really does.
//! - [`Solver::ImageDistance`]: the child taken for the image that the curved boundary makes of it (`image_distance`).
//! - [`Solver::Unfolded`]: the child taken for something behind the surface, at the length of the whole way: exact for
//!   a planar mirror, wrong for everything else.
//!
//! They cost 10 to 100 times the frozen-distance step and serve comparisons.

use super::image_distance;
use crate::warp::prepared::Prepared;
use glam::{Mat2, Vec2, Vec3};

/// How a child's picture is searched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Solver {
    /// Intersection with the patch of a texel, its distance from the boundary being held.
    FrozenDistance {
        /// How many; by default two behind one boundary and three behind more.
        steps: Option<u8>,
    },
    /// Steps with the full Jacobian.
    GaussNewton {
        /// How many.
        steps: u8,
    },
    /// Gradient descent on the angle.
    Descent {
        /// How many steps; the first design takes 10.
        steps: u8,
    },
    /// A depth warp at the distance of the image that the curved boundary makes.
    ImageDistance,
    /// One depth warp at the unfolded depth.
    Unfolded,
}

impl Default for Solver {
    fn default() -> Solver {
        Solver::FrozenDistance { steps: None }
    }
}

impl std::fmt::Display for Solver {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Solver::FrozenDistance { steps: None } => f.write_str("frozen-distance"),
            Solver::FrozenDistance { steps: Some(steps) } => write!(f, "frozen-distance:{steps}"),
            Solver::GaussNewton { steps } => write!(f, "gauss-newton:{steps}"),
            Solver::Descent { steps } => write!(f, "descent:{steps}"),
            Solver::ImageDistance => f.write_str("image-distance"),
            Solver::Unfolded => f.write_str("unfolded"),
        }
    }
}

impl std::str::FromStr for Solver {
    type Err = String;
    fn from_str(text: &str) -> Result<Solver, String> {
        let (name, steps) = text.split_once(':').map_or((text, None), |(name, steps)| (name, Some(steps)));
        let steps = |default| steps.map_or(Some(default), |steps| steps.parse().ok().filter(|&steps| steps > 0));
        let solver = match name {
            "frozen-distance" if name == text => Some(Solver::default()),
            "frozen-distance" => steps(0).map(|steps| Solver::FrozenDistance { steps: Some(steps) }),
            "image-distance" if name == text => Some(Solver::ImageDistance),
            "unfolded" if name == text => Some(Solver::Unfolded),
            "gauss-newton" => steps(3).map(|steps| Solver::GaussNewton { steps }),
            "descent" => steps(10).map(|steps| Solver::Descent { steps }),
            _ => None,
        };
        solver.ok_or_else(|| {
            format!(
                "expected frozen-distance[:STEPS], gauss-newton[:STEPS], descent[:STEPS] (1 to 255), image-distance or \
                 unfolded, found '{text}'"
            )
        })
    }
}

/// Angle, in radians, above which a place found by descent is none.
const ACCEPTED_RAD: f32 = std::f32::consts::PI / 180.0;
/// First step of the descent in pixels, and the shortest that is tried.
const STEP_PX: (f32, f32) = (32.0, 1.0 / 64.0);
/// Reach of the differences: the angle has the form of a cone, and near its tip a wider one sees both sides.
const DIFFERENCE_PX: f32 = 1.0 / 16.0;
/// Steps of the unfolded depth's fixed point.
const UNFOLDED_STEPS: usize = 4;

/// The novel ray behind a boundary.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sought {
    pub(super) origin: Vec3,
    pub(super) omega: Vec3,
    /// The new eye, and the ray from there to the boundary.
    pub(super) eye: Vec3,
    pub(super) ray: Vec3,
    /// The diffuse flow.
    pub(super) start: Vec2,
}

/// A child's picture.
#[derive(Clone, Copy)]
pub(super) struct Picture<'a> {
    pub(super) frame: &'a Prepared,
    pub(super) child: usize,
}

impl Picture<'_> {
    /// The point that a texel shows.
    pub(super) fn texel(&self, x: usize, y: usize) -> Option<Vec3> {
        let (width, height) = self.frame.size();
        if x >= width || y >= height {
            return None;
        }
        let at = y * self.frame.layout.pitch + x;
        let record = self.frame.record(self.child);
        let is_known = record[3..6].iter().any(|slopes| slopes[at] != 0);
        is_known.then(|| {
            Vec3::new(f32::from_bits(record[0][at]), f32::from_bits(record[1][at]), f32::from_bits(record[2][at]))
        })
    }

    /// The point shown at a position and its slopes along x and y, between four known texels.
    fn at(&self, pixel: Vec2) -> Option<(Vec3, Vec3, Vec3)> {
        let corner = pixel - 0.5;
        if !(corner.x >= 0.0 && corner.y >= 0.0) {
            return None;
        }
        let (x, y) = (corner.x as usize, corner.y as usize);
        let fraction = corner - Vec2::new(x as f32, y as f32);
        let (a, b) = (self.texel(x, y)?, self.texel(x + 1, y)?);
        let (c, d) = (self.texel(x, y + 1)?, self.texel(x + 1, y + 1)?);
        let (upper, lower) = (a.lerp(b, fraction.x), c.lerp(d, fraction.x));
        let along_x = (b - a).lerp(d - c, fraction.y);
        Some((upper.lerp(lower, fraction.y), along_x, lower - upper))
    }

    fn angle(&self, sought: &Sought, pixel: Vec2) -> Option<f32> {
        let (point, ..) = self.at(pixel)?;
        let way = point - sought.origin;
        Some(sought.omega.cross(way).length().atan2(sought.omega.dot(way)))
    }
}

/// Searches by a solver that is not the default.
pub(super) fn search(frame: &Prepared, child: usize, solver: Solver, sought: &Sought) -> Option<Vec2> {
    let picture = Picture { frame, child };
    match solver {
        Solver::FrozenDistance { .. } => None,
        Solver::ImageDistance => image_distance::search(frame, child, sought),
        Solver::GaussNewton { steps } => gauss_newton(&picture, sought, steps),
        Solver::Descent { steps } => descent(&picture, sought, steps),
        Solver::Unfolded => unfolded(&picture, sought),
    }
}

fn gauss_newton(picture: &Picture<'_>, sought: &Sought, steps: u8) -> Option<Vec2> {
    let (t, b) = sought.omega.any_orthonormal_pair();
    let mut pixel = sought.start;
    for step in 0..=steps {
        let (point, along_x, along_y) = picture.at(pixel)?;
        let way = point - sought.origin;
        let across = |vector: Vec3| Vec2::new(vector.dot(t), vector.dot(b));
        let jacobian = Mat2::from_cols(across(along_x), across(along_y));
        if jacobian.determinant().abs() < f32::MIN_POSITIVE {
            return None;
        }
        // A point aside of the ray may come nearer to it along the ray as well: the residual is that of the line.
        let change = -(jacobian.inverse() * across(way));
        if step == steps {
            return (change.abs().max_element() < 1.0 && way.dot(sought.omega) > 0.0).then_some(pixel + change);
        }
        let mut shorter = change.clamp_length_max(64.0);
        // Back to where something is shown.
        while picture.at(pixel + shorter).is_none() && shorter.length() > STEP_PX.1 {
            shorter *= 0.5;
        }
        pixel += shorter;
    }
    None
}

fn descent(picture: &Picture<'_>, sought: &Sought, steps: u8) -> Option<Vec2> {
    let guesses = [Some(sought.start), unfolded(picture, sought)].into_iter().flatten();
    let by_angle = guesses.filter_map(|pixel| Some((picture.angle(sought, pixel)?, pixel)));
    let (mut angle, mut pixel) = by_angle.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let mut step = STEP_PX.0;
    for _ in 0..steps {
        let slope = |direction: Vec2| match picture.angle(sought, pixel + direction * DIFFERENCE_PX) {
            Some(ahead) => (ahead - angle) / DIFFERENCE_PX,
            None => {
                let behind = picture.angle(sought, pixel - direction * DIFFERENCE_PX);
                behind.map_or(0.0, |behind| (angle - behind) / DIFFERENCE_PX)
            }
        };
        let gradient = Vec2::new(slope(Vec2::X), slope(Vec2::Y));
        let length = gradient.length();
        if length <= 0.0 {
            break;
        }
        // To where the angle would vanish if it fell on as it does here, but no further than the present step.
        let mut stride = (angle / length).min(step);
        while stride > STEP_PX.1 {
            let next = pixel - gradient / length * stride;
            match picture.angle(sought, next) {
                Some(better) if better < angle => {
                    (angle, pixel) = (better, next);
                    break;
                }
                _ => stride *= 0.5,
            }
        }
        step = (2.0 * stride).max(STEP_PX.1);
    }
    (angle < ACCEPTED_RAD).then_some(pixel)
}

fn unfolded(picture: &Picture<'_>, sought: &Sought) -> Option<Vec2> {
    let camera = &picture.frame.camera;
    let mut pixel = sought.start;
    for _ in 0..UNFOLDED_STEPS {
        let (x, y) = (pixel.x.max(0.0) as usize, pixel.y.max(0.0) as usize);
        let shown = picture.texel(x, y)?;
        let inverse_depth = f32::from_bits(picture.frame.inverse_depth()[y * picture.frame.layout.pitch + x]);
        let ray = camera.ray_in_view(camera.size.pixel_centre(y * camera.size.width as usize + x));
        let surface = ray / inverse_depth;
        // The length of the whole way along the old ray: a point behind the surface.
        let behind = ray.normalize() * (surface.length() + shown.distance(surface));
        // Where the new ray comes to the same depth.
        let reach = (behind.z - sought.eye.z) / sought.ray.z;
        pixel = camera.pixel_from_view(sought.eye + sought.ray * reach)?;
    }
    let (width, height) = picture.frame.size();
    (pixel.min_element() >= 0.0 && pixel.x < width as f32 && pixel.y < height as f32).then_some(pixel)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solvers_are_read_and_refused_in_words() {
        let solvers =
            ["frozen-distance", "frozen-distance:4", "gauss-newton:5", "descent:32", "image-distance", "unfolded"];
        for text in solvers {
            assert_eq!(text.parse::<Solver>().map(|solver| solver.to_string()), Ok(text.to_owned()));
        }
        assert_eq!("frozen-distance".parse(), Ok(Solver::default()));
        assert_eq!("descent".parse(), Ok(Solver::Descent { steps: 10 }));
        assert_eq!("gauss-newton:5".parse(), Ok(Solver::GaussNewton { steps: 5 }));
        for bad in ["", "newton", "descent:0", "descent:x", "unfolded:3", "descent:256", "frozen-distance:0"] {
            assert!(bad.parse::<Solver>().unwrap_err().contains("expected frozen-distance"), "{bad}");
        }
    }
}
