//! Two eyes from one frame: the head's pose, half the distance of the eyes to either side. Both cameras are the
//! display's, parallel; what a headset shifts or turns them by is in its field of view.

use glam::DVec3;
use image::{GenericImage, RgbImage};
use warplight_protocol::Pose;

/// Whose picture it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Eye {
    /// One picture for both, from the middle of the head.
    Middle,
    /// The left one.
    Left,
    /// The right one.
    Right,
}

impl Eye {
    /// Distance of the eyes of an adult, the median in millimetres (Dodgson 2004).
    pub const DISTANCE_MM: f64 = 63.0;

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Eye::Middle => "middle",
            Eye::Left => "left",
            Eye::Right => "right",
        }
    }

    /// Where it is, `distance_m` from the other.
    pub(super) fn pose(self, head_pose: &Pose, distance_m: f64) -> Pose {
        let aside_m = match self {
            // To the bit the head's own.
            Eye::Middle => return *head_pose,
            Eye::Left => -0.5 * distance_m,
            Eye::Right => 0.5 * distance_m,
        };
        Pose { position: head_pose.position + head_pose.orientation * DVec3::X * aside_m, ..*head_pose }
    }
}

/// Two pictures of one height side by side.
pub fn beside(left: &RgbImage, right: &RgbImage) -> RgbImage {
    let mut both = RgbImage::new(left.width() + right.width(), left.height().max(right.height()));
    for (picture, x) in [(left, 0), (right, left.width())] {
        // It fits: the size is the sum.
        let _ = both.copy_from(picture, x, 0);
    }
    both
}
