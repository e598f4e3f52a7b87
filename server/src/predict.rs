//! Where the head will be when the frame is shown.
//!
//! Constant linear velocity; angular velocity that dies away with a time constant of 0.2 s. On recorded
//! head motion an acceleration term and a Kalman filter gain nothing over this, and the damping is what keeps
//! 100 ms ahead from overshooting. Assumes samples some 5 to 40 ms apart; quaternions of either sign.

use glam::DVec3;
use std::collections::VecDeque;
use std::time::Duration;
use warplight_protocol::message::PoseSample;
use warplight_protocol::pose::scaled_axis;
use warplight_protocol::{Pose, Timestamp};

/// Velocities are taken over this long: shorter lets the jitter of the tracker through, longer lags.
const VELOCITY_WINDOW: Duration = Duration::from_millis(30);
/// How far back samples are kept.
const HISTORY: Duration = Duration::from_millis(200);
/// Time constant of the damping of rotation.
const ROTATION_DAMPING_SECS: f64 = 0.2;
/// A head does not move faster; what does is a gap or a jump of the tracker, over which nothing is predicted.
const MAX_SPEED_M_PER_S: f64 = 10.0;
const MAX_TURN_RAD_PER_S: f64 = 30.0;

/// How long a turn of constant speed takes to get as far as the damped prediction does over `horizon`.
pub fn damped(horizon: Duration) -> Duration {
    let secs = ROTATION_DAMPING_SECS * -(-horizon.as_secs_f64() / ROTATION_DAMPING_SECS).exp_m1();
    Duration::from_secs_f64(secs.max(0.0))
}

/// Velocities of a head, per second: in the world, and about the axes of its view.
struct Motion {
    velocity: DVec3,
    angular_velocity: DVec3,
}

/// Recent poses of one head.
#[derive(Clone, Debug, Default)]
pub struct Predictor {
    recent: VecDeque<PoseSample>,
    ignored: u32,
}

impl Predictor {
    /// Takes a pose in. One that is not valid or not newer than the last is ignored and counted.
    pub fn push(&mut self, sample: PoseSample) -> bool {
        let is_newer = self.recent.back().is_none_or(|last| sample.time > last.time);
        if !is_newer || !sample.pose.is_valid() {
            self.ignored += 1;
            return false;
        }
        while self.recent.front().is_some_and(|first| sample.time.since(first.time) > HISTORY) {
            self.recent.pop_front();
        }
        self.recent.push_back(sample);
        true
    }

    /// Poses that were ignored.
    pub fn ignored(&self) -> u32 {
        self.ignored
    }

    /// The last good pose.
    pub fn latest(&self) -> Option<PoseSample> {
        self.recent.back().copied()
    }

    /// The pose `horizon` after the last good one; that one itself where there is no velocity to go by.
    pub fn predict(&self, horizon: Duration) -> Option<Pose> {
        let latest = self.latest()?;
        let Some(Motion { velocity, angular_velocity }) = self.motion() else { return Some(latest.pose) };
        let ahead_secs = horizon.as_secs_f64();
        let turn = glam::DQuat::from_scaled_axis(angular_velocity * damped(horizon).as_secs_f64());
        let turned = latest.pose.orientation * turn;
        Some(Pose { position: latest.pose.position + velocity * ahead_secs, orientation: turned.normalize() })
    }

    /// How fast the head turns, in radians per second about the axes of its own view; not at all where nobody can tell.
    pub fn turning_rad_per_s(&self) -> DVec3 {
        self.motion().map_or(DVec3::ZERO, |motion| motion.angular_velocity)
    }

    /// The latest velocities; `None` where there are none to go by.
    fn motion(&self) -> Option<Motion> {
        let latest = self.latest()?;
        // The newest sample that is a window old, or the oldest there is.
        let earlier = self.recent.iter().rev().find(|sample| latest.time.since(sample.time) >= VELOCITY_WINDOW);
        let earlier = earlier.or(self.recent.front())?;
        let elapsed_secs = latest.time.since(earlier.time).as_secs_f64();
        if elapsed_secs < 1e-3 {
            return None;
        }
        let mut turn = earlier.pose.orientation.inverse() * latest.pose.orientation;
        if turn.w < 0.0 {
            turn = -turn;
        }
        let angular_velocity = scaled_axis(turn) / elapsed_secs;
        let velocity = (latest.pose.position - earlier.pose.position) / elapsed_secs;
        let is_head = velocity.length() <= MAX_SPEED_M_PER_S && angular_velocity.length() <= MAX_TURN_RAD_PER_S;
        is_head.then_some(Motion { velocity, angular_velocity })
    }

    /// Time of the last good pose.
    pub fn latest_time(&self) -> Option<Timestamp> {
        self.latest().map(|sample| sample.time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn sample(millis: u64, position: DVec3, yaw: f64) -> PoseSample {
        PoseSample {
            time: Timestamp { micros: millis * 1000 },
            pose: Pose { position, orientation: DQuat::from_rotation_y(yaw) },
        }
    }

    #[test]
    fn steady_motion_is_continued() {
        let mut predictor = Predictor::default();
        for step in 0..10_u64 {
            let t = step as f64 * 0.011;
            assert!(predictor.push(sample(step * 11, DVec3::X * (0.5 * t), 0.3 * t)));
        }
        let pose = predictor.predict(Duration::from_millis(50)).unwrap();
        assert!((pose.position.x - 0.5 * (0.099 + 0.05)).abs() < 1e-9);
        let yaw = pose.angle_to(&Pose::IDENTITY);
        let damped_secs = 0.2 * (1.0 - (-0.05_f64 / 0.2).exp());
        assert!((yaw - 0.3 * (0.099 + damped_secs)).abs() < 1e-9);
        assert!((damped(Duration::from_millis(50)).as_secs_f64() - damped_secs).abs() < 1e-8);
        assert!((predictor.turning_rad_per_s() - DVec3::Y * 0.3).length() < 1e-9);
    }

    /// numerics: prediction with equal times, time going back, one sample, no number, a gap.
    #[test]
    fn bad_samples_leave_the_last_good_pose() {
        let mut predictor = Predictor::default();
        assert!(predictor.predict(Duration::ZERO).is_none());
        assert!(predictor.push(sample(100, DVec3::Y, 0.0)));
        assert!(!predictor.push(sample(100, DVec3::X, 0.0)), "equal times");
        assert!(!predictor.push(sample(50, DVec3::X, 0.0)), "back in time");
        assert!(!predictor.push(sample(120, DVec3::NAN, 0.0)), "no number");
        assert_eq!(predictor.ignored(), 3);
        assert_eq!(predictor.predict(Duration::from_millis(100)).unwrap().position, DVec3::Y);
        // After a gap, nothing is left to take a velocity from.
        assert!(predictor.push(sample(5000, DVec3::Z, 1.0)));
        assert_eq!(predictor.predict(Duration::from_millis(100)).unwrap().position, DVec3::Z);
    }

    #[test]
    fn a_flip_of_sign_is_no_motion() {
        let mut predictor = Predictor::default();
        let mut flipped = sample(40, DVec3::ZERO, 0.2);
        flipped.pose.orientation = -flipped.pose.orientation;
        predictor.push(sample(0, DVec3::ZERO, 0.2));
        predictor.push(flipped);
        let pose = predictor.predict(Duration::from_millis(100)).unwrap();
        assert!(pose.angle_to(&sample(0, DVec3::ZERO, 0.2).pose) < 1e-9);
    }

    #[test]
    fn a_jump_of_the_tracker_is_not_continued() {
        let mut predictor = Predictor::default();
        predictor.push(sample(0, DVec3::ZERO, 0.0));
        predictor.push(sample(35, DVec3::X * 3.0, 0.0));
        assert_eq!(predictor.predict(Duration::from_millis(100)).unwrap().position, DVec3::X * 3.0);
    }
}
