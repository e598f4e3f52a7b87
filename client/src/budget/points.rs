//! At which points a refresh of the display can be made: steps of the search, and pixels that are warped.

use crate::warp::Solver;
use warplight_protocol::{Camera, ImageSize};

/// One way to make the picture of a refresh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisplayPoint {
    /// How children are searched.
    pub solver: Solver,
    /// Of each side of the display, in percent; what is warped at fewer pixels is enlarged.
    pub percent: u32,
}

const fn point(steps: Option<u8>, percent: u32) -> DisplayPoint {
    DisplayPoint { solver: Solver::FrozenDistance { steps }, percent }
}

impl DisplayPoint {
    /// What is used without a budget.
    pub const USUAL: DisplayPoint = point(None, 100);

    /// All that a budget chooses from. Solvers but the default one cost ten times as much and are no better
    /// (`sweep solver`), and of a frame's points mode `specular` is the best everywhere, so other modes are none.
    pub const ALL: [DisplayPoint; 10] = [
        point(Some(4), 100),
        DisplayPoint::USUAL,
        point(Some(1), 100),
        point(None, 75),
        point(Some(1), 75),
        point(None, 50),
        point(Some(1), 50),
        point(None, 35),
        point(Some(1), 35),
        point(Some(1), 25),
    ];

    /// As tables name it.
    pub fn name(&self) -> String {
        let DisplayPoint { solver, percent } = self;
        format!("{solver} at {percent} %")
    }

    /// The point of this name.
    pub fn named(name: &str) -> Option<DisplayPoint> {
        DisplayPoint::ALL.into_iter().find(|point| point.name() == name)
    }

    /// The camera of the picture that is warped.
    pub fn camera(&self, display: &Camera) -> Camera {
        let side = |px: u32| ((u64::from(px) * u64::from(self.percent)).div_ceil(100) as u32).max(1);
        let size = ImageSize::new(side(display.size.width), side(display.size.height));
        Camera { size, ..*display }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_known_by_their_names_and_the_usual_one_is_the_display() {
        for point in DisplayPoint::ALL {
            assert_eq!(DisplayPoint::named(&point.name()), Some(point));
        }
        assert_eq!(DisplayPoint::named("unfolded at 100 %"), None);
        let display = Camera::symmetric(1.4, ImageSize::new(385, 3));
        assert_eq!(DisplayPoint::USUAL.camera(&display), display);
        let half = point(None, 50).camera(&display);
        assert_eq!((half.size, half.fov), (ImageSize::new(193, 2), display.fov));
    }
}
