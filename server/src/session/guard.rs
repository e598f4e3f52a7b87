//! The guard band: how much more than the display a frame shows, so that a head that turns does not run out of it.
//!
//! Part of the session, asked once for every live frame. A frame is rendered for a predicted pose and shown until the
//! next one is there; by then the head may have turned further than was predicted, or less. The band covers both:
//!
//! - **ahead**: a head that keeps its speed is past the predicted orientation by `speed * (age - predicted)`, where age
//!   is that of the frame's pose when the frame is shown for the last time, and predicted what the (damped) prediction
//!   adds up to;
//! - **behind**: one that stops at once is short of it by `speed * predicted`, on the other side.
//!
//! Speeds are those of yaw and pitch, towards each side on its own, so the band grows to where the head turns.
//! Peaks are held and die away with [`HOLD_SECS`]: a head that looks around turns back. The display's border, turned by
//! each of these angles, is projected into the frame; what sticks out, in whole [`STEP_PX`], is the band. Its pixels are
//! those of the display's own grid, continued: an unmoved head sees the server's picture to the bit.
//!
//! On synthetic traces (`trace synth`, seeds 1 to 3, five frames a second of up to 470 ms) turns alone carry 14 % of the
//! display's pixels out of a frame of its size, and 6 % out of one with a band of up to 12 degrees, which has 1.8 times
//! the pixels. Held for twice as long it would be 5 % at 2.1 times.
//!
//! Limits: the beginning of a turn is not foreseen, nor is roll, nor yaw and pitch at once. At most the angle that the server allows, and half a
//! side of the display on each side; a frame that would exceed the limits of the session has no band. Cost: nothing
//! measurable for the session; the frame has the more pixels.

use glam::{DMat3, DVec3};
use std::time::Duration;
use warplight_protocol::camera::Margins;
use warplight_protocol::{Camera, Timestamp};

/// Time constant of held peaks of speed, in seconds: about the length of a turn. Longer bands cover more turns back, and
/// cost their pixels for longer.
const HOLD_SECS: f64 = 0.5;
/// Sides of a frame change by so many pixels at a time; smaller ones change the frame's size more often.
const STEP_PX: f64 = 16.0;
/// Part of a step that is left uncovered rather than begin another: what a tracker's jitter comes to.
const SLACK: f64 = 0.25;
/// Part of each edge of the display, about its middle, that is covered. A turn carries corners furthest out: covering
/// them takes whole rows of pixels for small triangles.
const COVERED_EDGE: f64 = 0.5;
/// Most pixels on a side, as a part of the display's: a turn through a right angle would need infinitely many.
const MOST: f64 = 0.5;

/// The band of one session.
#[derive(Clone, Debug)]
pub(super) struct Guard {
    /// Most that it covers on a side.
    most_rad: f64,
    /// Held speeds towards left, right, down and up.
    held_rad_per_s: [f64; 4],
    heard: Option<Timestamp>,
    margins: Margins,
    /// The last band was as wide as it may be.
    is_at_most: bool,
}

impl Guard {
    /// A band of at most `most_rad` on each side; 0 for none.
    pub(super) fn new(most_rad: f64) -> Guard {
        Guard { most_rad, held_rad_per_s: [0.0; 4], heard: None, margins: Margins::default(), is_at_most: false }
    }

    /// At `time` the head turns so fast, in its own view.
    pub(super) fn turning(&mut self, time: Timestamp, rad_per_s: DVec3) {
        let elapsed_secs = self.heard.replace(time).map_or(0.0, |heard| time.since(heard).as_secs_f64());
        let kept = (-elapsed_secs / HOLD_SECS).exp();
        // About +Y is to the left, about +X is up.
        let now = [rad_per_s.y, -rad_per_s.y, -rad_per_s.x, rad_per_s.x];
        for (held, now) in self.held_rad_per_s.iter_mut().zip(now) {
            // What is no number leaves what is held.
            *held = (*held * kept).max(now);
        }
    }

    /// The band of the next frame, which is shown up to an age of `age` and whose prediction is worth `predicted` at
    /// constant speed.
    pub(super) fn margins(&mut self, display: &Camera, age: Duration, predicted: Duration) -> Margins {
        let (ahead_secs, behind_secs) = (age.saturating_sub(predicted).as_secs_f64(), predicted.as_secs_f64());
        let [left, right, down, up] = self.held_rad_per_s;
        let angle = |towards: f64, away: f64| (towards * ahead_secs).max(away * behind_secs).min(self.most_rad);
        let wanted = |towards: f64, away: f64| (towards * ahead_secs).max(away * behind_secs);
        let widest = wanted(left, right).max(wanted(right, left)).max(wanted(down, up)).max(wanted(up, down));
        self.is_at_most = self.most_rad > 0.0 && widest > self.most_rad;
        let angles = [angle(left, right), angle(right, left), angle(down, up), angle(up, down)];
        let needed = needed_px(display, angles);
        let Margins { left, right, down, up } = self.margins;
        self.margins = Margins {
            left: steady(left, needed.left),
            right: steady(right, needed.right),
            down: steady(down, needed.down),
            up: steady(up, needed.up),
        };
        self.margins
    }

    /// Whether the last band was not as wide as the head's speed asked for.
    pub(super) fn is_at_most(&self) -> bool {
        self.is_at_most
    }
}

/// Grows at once, and shrinks only to half and less: each change costs the server what it has summed up at rest.
fn steady(current: u32, needed: u32) -> u32 {
    if needed > current || 2 * needed <= current { needed } else { current }
}

/// What of the display's picture sticks out of itself when it is turned by these angles to the left, right, down or up.
fn needed_px(display: &Camera, [left, right, down, up]: [f64; 4]) -> Margins {
    let fov = &display.fov;
    let [fov_left, fov_right, fov_down, fov_up] = [fov.left, fov.right, fov.down, fov.up].map(f64::from);
    let (mut lowest, mut highest) = ([fov_left, fov_down], [fov_right, fov_up]);
    for frame_from_display in [
        DMat3::from_rotation_y(left),
        DMat3::from_rotation_y(-right),
        DMat3::from_rotation_x(up),
        DMat3::from_rotation_x(-down),
    ] {
        for tangents in border([fov_left, fov_right, fov_down, fov_up]) {
            let ray = frame_from_display * DVec3::new(tangents[0], tangents[1], -1.0);
            // Aside of the frame or behind it: as far as can be.
            let depth = (-ray.z).max(1e-3);
            for (axis, value) in [ray.x / depth, ray.y / depth].into_iter().enumerate() {
                lowest[axis] = lowest[axis].min(value);
                highest[axis] = highest[axis].max(value);
            }
        }
    }
    let focal = display.focal_px().as_dvec2();
    let (width, height) = (f64::from(display.size.width), f64::from(display.size.height));
    let steps = |beyond: f64, focal: f64, side: f64| {
        let step = |px: f64| STEP_PX * px.ceil().max(0.0);
        // Whole steps, also where they are bounded.
        (step(beyond * focal / STEP_PX - SLACK)).min(STEP_PX * (MOST * side / STEP_PX).floor()) as u32
    };
    Margins {
        left: steps(fov_left - lowest[0], focal.x, width),
        right: steps(highest[0] - fov_right, focal.x, width),
        down: steps(fov_down - lowest[1], focal.y, height),
        up: steps(highest[1] - fov_up, focal.y, height),
    }
}

/// Ends of the covered part of each edge, as tangents: a turned edge is straight, so its ends bound it.
fn border([left, right, down, up]: [f64; 4]) -> [[f64; 2]; 8] {
    let between = |low: f64, high: f64, part: f64| 0.5 * (low + high) + 0.5 * part * (high - low);
    let (near, far) = (between(left, right, -COVERED_EDGE), between(left, right, COVERED_EDGE));
    let (low, high) = (between(down, up, -COVERED_EDGE), between(down, up, COVERED_EDGE));
    [[left, low], [left, high], [right, low], [right, high], [near, down], [far, down], [near, up], [far, up]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use warplight_protocol::ImageSize;

    const AGE: Duration = Duration::from_millis(300);
    const PREDICTED: Duration = Duration::from_millis(50);

    fn display() -> Camera {
        Camera::symmetric(80_f64.to_radians() as f32, ImageSize::new(512, 512))
    }

    fn at(millis: u64) -> Timestamp {
        Timestamp { micros: 1000 * millis }
    }

    fn most() -> f64 {
        12_f64.to_radians()
    }

    /// The closed form of an edge's middle: an edge at tangent T, turned by an angle, is at tan(atan(T) + angle).
    #[test]
    fn a_head_that_turns_left_is_given_the_left_side() {
        let mut guard = Guard::new(most());
        guard.turning(at(0), DVec3::Y * 0.4);
        let margins = guard.margins(&display(), AGE, PREDICTED);
        let beyond_px = |angle: f64| {
            let edge = f64::from(display().fov.right);
            f64::from(display().focal_px().x) * ((edge.atan() + angle).tan() - edge)
        };
        // Up to a quarter of a step is left out, and up to a step is added.
        let needed = beyond_px(0.4 * 0.25);
        let found = f64::from(margins.left);
        assert!((needed - 4.0..=needed + 12.0).contains(&found), "{margins:?} for {needed}");
        // Stopped at once, it is short of the prediction.
        let needed = beyond_px(0.4 * 0.05);
        assert!((needed - 4.0..=needed + 12.0).contains(&f64::from(margins.right)), "{margins:?} for {needed}");
        assert!(margins.left > margins.right && margins.up == margins.down, "{margins:?}");
    }

    #[test]
    fn up_is_up_and_down_is_down() {
        for (rate, is_up) in [(DVec3::X, true), (-DVec3::X, false)] {
            let mut guard = Guard::new(most());
            guard.turning(at(0), rate);
            let margins = guard.margins(&display(), AGE, PREDICTED);
            assert_eq!(margins.up > margins.down, is_up, "{margins:?}");
            assert_eq!(margins.left, margins.right);
        }
    }

    #[test]
    fn what_a_turned_display_shows_is_in_the_frame_but_for_its_corners() {
        let display = display();
        for rad_per_s in [DVec3::X * 0.4, DVec3::X * -0.3, DVec3::Y * 0.5, DVec3::Y * -0.4] {
            let mut guard = Guard::new(most());
            guard.turning(at(0), rad_per_s);
            let frame = display.widened(guard.margins(&display, AGE, PREDICTED));
            // From a head that stops at once to one that goes on.
            for secs in [-0.05, 0.0, 0.1, 0.25] {
                let turn = glam::DQuat::from_scaled_axis(rad_per_s * secs);
                let seen = (0..display.size.pixels()).filter(|&pixel| {
                    let ray = turn * display.ray_in_view(display.size.pixel_centre(pixel)).as_dvec3();
                    frame.pixel_from_view(ray.as_vec3()).is_some_and(|at| {
                        at.min_element() >= 0.0 && at.x < frame.size.width as f32 && at.y < frame.size.height as f32
                    })
                });
                let missing = 1.0 - seen.count() as f64 / display.size.pixels() as f64;
                // Two triangles: an eighth of the edge before and after the turn's axis, by what 0.125 rad add to it
                // (6 % of half a side), are 0.8 %; and four pixels of 512 in a step's slack are as much again.
                assert!(missing < 0.016, "{missing} at {rad_per_s} for {secs} s");
            }
        }
    }

    #[test]
    fn peaks_are_held_for_a_while_and_then_forgotten() {
        let mut guard = Guard::new(most());
        guard.turning(at(0), DVec3::Y * 0.5);
        let peak = guard.margins(&display(), AGE, PREDICTED).left;
        guard.turning(at(200), DVec3::ZERO);
        assert_eq!(guard.margins(&display(), AGE, PREDICTED).left, peak, "a turn back is likely");
        let mut sizes = vec![peak];
        for millis in (300..8000).step_by(100) {
            guard.turning(at(millis), DVec3::ZERO);
            sizes.push(guard.margins(&display(), AGE, PREDICTED).left);
        }
        assert_eq!(sizes.last(), Some(&0), "a head at rest pays nothing");
        sizes.dedup();
        assert!(sizes.len() <= 5, "sizes flutter: {sizes:?}");
    }

    #[test]
    fn it_is_never_wider_than_it_may_be() {
        for (most_deg, vertical_rad) in [(0.0, 1.4), (12.0, 1.4), (90.0, 1.4), (90.0, 2.9)] {
            let display = Camera::symmetric(vertical_rad, ImageSize::new(300, 200));
            let mut guard = Guard::new(f64::to_radians(most_deg));
            for rate in [DVec3::new(20.0, 30.0, 5.0), DVec3::NAN, DVec3::new(-20.0, -30.0, 5.0)] {
                guard.turning(at(0), rate);
            }
            let margins = guard.margins(&display, Duration::from_secs(1), PREDICTED);
            assert!(margins.left <= 150 && margins.right <= 150 && margins.up <= 100 && margins.down <= 100);
            assert!(display.widened(margins).is_valid());
            assert_eq!(margins == Margins::default(), most_deg == 0.0, "{margins:?}");
        }
    }
}
