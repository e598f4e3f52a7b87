//! What is seen where after a move, by rays in f64, and how far from that a flow is.

use super::AnalyticScene;
use glam::{DVec2, DVec3, Vec2};
use rayon::prelude::*;
use warplight_protocol::{Camera, Pose};

/// Pixels are sampled at this stride, a prime that does not divide usual widths.
const STRIDE: usize = 37;
/// A place in the old picture within this angle shows a point: 1/4 of a pixel of 1024 over 90 degrees.
const SHOWN_DEG: f64 = 0.02;

/// How far a flow is from the truth, over the pixels that the old picture knows.
#[derive(Clone, Debug, Default)]
pub struct FlowErrors {
    /// Where something was found: angles in degrees, in rising order.
    sorted_deg: Vec<f64>,
    /// Pixels at which nothing was found.
    undefined: usize,
}

impl FlowErrors {
    /// Pixels that were looked at.
    pub fn count(&self) -> usize {
        self.sorted_deg.len() + self.undefined
    }

    /// The angle below which this fraction of the found pixels is, in degrees; 180 where none was found.
    pub fn percentile_deg(&self, fraction: f64) -> f64 {
        let rank = (self.sorted_deg.len() as f64 * fraction) as usize;
        self.sorted_deg.get(rank.min(self.sorted_deg.len().saturating_sub(1))).copied().unwrap_or(180.0)
    }

    /// Median in degrees.
    pub fn median_deg(&self) -> f64 {
        self.percentile_deg(0.5)
    }

    /// 95th percentile in degrees.
    pub fn p95_deg(&self) -> f64 {
        self.percentile_deg(0.95)
    }

    /// Part of the pixels that are off by more than a degree.
    pub fn above_a_degree(&self) -> f64 {
        let above = self.sorted_deg.len() - self.sorted_deg.partition_point(|&error| error <= 1.0);
        above as f64 / self.count().max(1) as f64
    }

    /// Part of the pixels at which nothing was found.
    pub fn undefined(&self) -> f64 {
        self.undefined as f64 / self.count().max(1) as f64
    }

    /// Errors of several moves together.
    pub fn pooled(all: impl IntoIterator<Item = FlowErrors>) -> FlowErrors {
        let mut sum = FlowErrors::default();
        for errors in all {
            sum.sorted_deg.extend(errors.sorted_deg);
            sum.undefined += errors.undefined;
        }
        sum.sorted_deg.sort_by(f64::total_cmp);
        sum
    }
}

/// A point that a pixel shows in the last boundary.
#[derive(Clone, Copy, Debug)]
struct Seen {
    pixel: usize,
    /// The last boundary, and the point seen in it.
    at: DVec3,
    point: DVec3,
    /// Whether the search found it in the old picture.
    is_shown: bool,
}

/// What is seen from a display pose.
#[derive(Debug)]
pub struct Truth {
    scene: AnalyticScene,
    camera: Camera,
    old: Pose,
    seen: Vec<Seen>,
}

impl Truth {
    /// Traces the picture of `display_pose` and looks its points up in that of `old`.
    pub fn new(scene: AnalyticScene, camera: &Camera, old: &Pose, display_pose: &Pose) -> Truth {
        let mut truth = Truth { scene, camera: *camera, old: *old, seen: Vec::new() };
        let pixels = (0..camera.size.pixels()).into_par_iter().step_by(STRIDE);
        let seen = pixels.filter_map(|pixel| {
            let chain = scene.chain_at(camera, display_pose, camera.size.pixel_centre(pixel).as_dvec2())?.1;
            let bounce = *chain.last()?;
            let (at, point) = (bounce.at, bounce.shown());
            let in_view = old.orientation.inverse() * (chain[0].at - old.position);
            let start = camera.pixel_from_view(in_view.as_vec3()).map(Vec2::as_dvec2)?;
            let is_shown = truth.searched((at, point), start) < SHOWN_DEG;
            Some(Seen { pixel, at, point, is_shown })
        });
        truth.seen = seen.collect();
        truth
    }

    /// How far a flow of the last node is from this. A place that the flow found counts as known, too.
    pub fn errors_of(&self, flow: &[Vec2]) -> FlowErrors {
        let judged = self.seen.par_iter().filter_map(|seen| {
            let found = flow[seen.pixel].as_dvec2();
            if found.is_nan() {
                return seen.is_shown.then_some(None);
            }
            let shown = self.scene.chain_at(&self.camera, &self.old, found);
            let error = shown
                .map_or(180.0, |(_, chain)| angle_deg(chain[chain.len() - 1].shown() - seen.at, seen.point - seen.at));
            let is_shown =
                seen.is_shown || error < SHOWN_DEG || self.searched((seen.at, seen.point), found) < SHOWN_DEG;
            is_shown.then_some(Some(error))
        });
        let judged: Vec<Option<f64>> = judged.collect();
        let mut sorted_deg: Vec<f64> = judged.iter().flatten().copied().collect();
        sorted_deg.sort_by(f64::total_cmp);
        FlowErrors { undefined: judged.len() - sorted_deg.len(), sorted_deg }
    }

    /// Searches for the place in the old picture that shows `point` from `at`; its error in degrees.
    fn searched(&self, (at, point): (DVec3, DVec3), start: DVec2) -> f64 {
        let wanted = (point - at).normalize();
        let size = DVec2::new(self.camera.size.width.into(), self.camera.size.height.into());
        let t = wanted.any_orthonormal_vector();
        let b = wanted.cross(t);
        let residual = |pixel: DVec2| {
            let inside = pixel.min_element() >= 0.0 && (pixel - size).max_element() < 0.0;
            let bounce = *self.scene.chain_at(&self.camera, &self.old, pixel).filter(|_| inside)?.1.last()?;
            let found = (bounce.shown() - at).normalize();
            (found.dot(wanted) > 0.0).then(|| DVec2::new(found.dot(t), found.dot(b)))
        };
        let (mut pixel, mut best) = (start, f64::INFINITY);
        for _ in 0..20 {
            const H: f64 = 1e-3;
            let Some(here) = residual(pixel) else { break };
            best = best.min(here.length().to_degrees());
            let (Some(x), Some(y)) = (residual(pixel + DVec2::X * H), residual(pixel + DVec2::Y * H)) else { break };
            let jacobian = glam::DMat2::from_cols((x - here) / H, (y - here) / H);
            if jacobian.determinant().abs() < 1e-18 {
                break;
            }
            let step = jacobian.inverse() * here;
            pixel -= step * (20.0 / step.length()).min(1.0);
        }
        best
    }
}

fn angle_deg(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b)).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use warplight_protocol::ImageSize;

    #[test]
    fn an_unmoved_eye_sees_every_pixel_where_it_was_and_one_pixel_beside_is_an_error() {
        let camera = Camera::symmetric(std::f32::consts::FRAC_PI_2, ImageSize::new(200, 150));
        for scene in AnalyticScene::SWEPT {
            let truth = Truth::new(scene, &camera, &scene.eye(), &scene.eye());
            let centres: Vec<Vec2> = (0..camera.size.pixels()).map(|pixel| camera.size.pixel_centre(pixel)).collect();
            let exact = truth.errors_of(&centres);
            assert!(exact.count() > 30 && exact.undefined() == 0.0 && exact.p95_deg() < 1e-5, "{scene:?} {exact:?}");
            let beside: Vec<Vec2> = centres.iter().map(|centre| *centre + Vec2::X).collect();
            // A pixel is 0.76 degrees in the middle and half that in the corners; curved boundaries enlarge or reduce.
            assert!(truth.errors_of(&beside).median_deg() > 0.1, "{scene:?}");
            let nowhere = vec![Vec2::NAN; centres.len()];
            assert_eq!(truth.errors_of(&nowhere).undefined(), 1.0);
        }
    }
}
