//! What a pixel of which nothing is known is filled with.
//!
//! Between warp and composite: a mode leaves holes where the head sees what the frame did not, and [`Pyramid`] fills them. All
//! but the first of the methods give every hole some colour where anything is known at all. What each leaves and costs is
//! `sweep hole-filling`.

use super::pyramid::Pyramid;
use glam::{Vec2, Vec3, Vec4};
use warplight_protocol::{Camera, Pose};

/// A way to fill holes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HoleFilling {
    /// Not at all: they stay black.
    Leave,
    /// Push-pull, all that is known counting the same (Gortler et al. 1996, 4.3).
    Even,
    /// What is farther of the two nearest known pixels on the line along which the head's motion moves points: a hole is what
    /// something near has uncovered, and what it has uncovered continues what lies behind (Mark et al. 1997). Where the
    /// line meets nothing that is known, push-pull.
    Background,
    /// Push-pull in which what is farther counts more.
    #[default]
    PushPull,
}

impl HoleFilling {
    /// Every method.
    pub const ALL: [HoleFilling; 4] =
        [HoleFilling::Leave, HoleFilling::Even, HoleFilling::Background, HoleFilling::PushPull];

    /// Name in sweeps.
    pub fn name(self) -> &'static str {
        match self {
            HoleFilling::Leave => "leave",
            HoleFilling::Even => "even push-pull",
            HoleFilling::Background => "background",
            HoleFilling::PushPull => "push-pull",
        }
    }
}

/// The epipole of a frame in a picture: where the eye of the frame is seen, in homogeneous pixels. A point that the frame
/// knows moves along a line through it, however far away it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Epipole(Vec3);

impl Epipole {
    /// Of a frame rendered for a pose.
    pub(super) fn new(render_pose: &Pose, display_pose: &Pose, camera: &Camera) -> Epipole {
        let eye = display_pose.view_from(render_pose).translation;
        let (focal, centre) = (camera.focal_px(), camera.centre_px());
        let ahead = -eye.z;
        Epipole(Vec3::new(focal.x * eye.x + centre.x * ahead, -focal.y * eye.y + centre.y * ahead, ahead))
    }

    /// Direction of the line through a pixel, either way; `None` where it has none: an unmoved eye, or the epipole itself.
    fn direction_at(self, pixel: Vec2) -> Option<Vec2> {
        (self.0.truncate() - pixel * self.0.z).try_normalize()
    }
}

/// Background on the epipolar line through a pixel of a node; `None` where nothing is known on it.
pub(super) fn background(pyramid: &Pyramid, epipole: Epipole, node: usize, x: usize, y: usize) -> Option<Vec3> {
    let pixel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
    let direction = epipole.direction_at(pixel)?;
    let sides = [direction, -direction].map(|along| {
        let mut cells = along_line(pyramid, node, pixel, along);
        let first = cells.by_ref().find(|cell| cell.w > 0.0).unwrap_or(Vec4::ZERO);
        // Of the first that is known some pixels may not be: the one behind it is whole, if it is there.
        cells.next().filter(|next| next.w > 0.0).unwrap_or(first)
    });
    // Weights are the larger the farther the surface.
    let farther = if sides[0].w >= sides[1].w { sides[0] } else { sides[1] };
    (farther.w > 0.0).then(|| farther.truncate() / farther.w)
}

/// Sums of 2 x 2 pixels from one on, a sum's width at a time, to the border.
fn along_line(pyramid: &Pyramid, node: usize, from: Vec2, along: Vec2) -> impl Iterator<Item = Vec4> + '_ {
    let step = along / along.abs().max_element();
    (1..).map_while(move |count| pyramid.known_around(node, 0.5 * from + step * count as f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use warplight_protocol::ImageSize;

    /// The line is that on which the pixels of points of all depths lie.
    #[test]
    fn points_of_a_pixel_move_along_its_epipolar_line() {
        let camera = Camera::symmetric(1.2, ImageSize::new(200, 100));
        let render = Pose::IDENTITY;
        for aim in [glam::DVec3::new(0.0, 0.0, -5.0), glam::DVec3::new(1.0, 0.5, -3.0)] {
            for position in [glam::DVec3::X * 0.1, glam::DVec3::new(0.02, -0.1, 0.3), glam::DVec3::NEG_Z * 0.2] {
                let display = Pose::look_at(position, aim);
                let epipole = Epipole::new(&render, &display, &camera);
                let ray = camera.ray_in_view(Vec2::new(130.5, 40.5));
                let motion = display.view_from(&render);
                let [near, far] =
                    [2.0, 20.0].map(|depth: f32| camera.pixel_from_view(motion.point(ray * depth)).unwrap());
                let way = (near - far).normalize();
                let along = epipole.direction_at(far).unwrap();
                // Differences of f32 pixels of some hundred, over those of a pixel and more.
                assert!(way.perp_dot(along).abs() < 1e-3, "{position}: {way} {along}");
            }
        }
        assert_eq!(Epipole::new(&render, &render, &camera).direction_at(Vec2::ONE), None);
    }
}
