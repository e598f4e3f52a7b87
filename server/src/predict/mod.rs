//! Where the head will be when the frame is shown.
//!
//! Asked once for every live frame, with the measured latency as horizon. Four laws ([`Prediction`]), which the client
//! chooses from: none; constant velocity, linear and angular; the same with an angular velocity that dies away with a time
//! constant of 0.2 s; and the mixture of velocities over several times, damped and not, that has served this head best in
//! the last seconds (`mixture`), which is the default because it alone is at or below constant velocity on all recorded
//! traces (`tests/tests/e2e/prediction.rs`).
//!
//! Assumes samples some 5 to 40 ms apart, with jitter and gaps; quaternions of either sign. A velocity over a gap of more
//! than 200 ms, or one that no head has, is none at all: then the last good pose stays.

mod mixture;

use glam::{DQuat, DVec3};
use mixture::{Mixture, SCORED_AHEAD, Velocities, WINDOWS, damped_secs};
use std::collections::VecDeque;
use std::time::Duration;
use warplight_protocol::message::{PoseSample, Prediction};
use warplight_protocol::pose::scaled_axis;
use warplight_protocol::{Pose, Timestamp};

/// Velocity of the plain laws is that over the second window, 30 ms: shorter lets the jitter of the tracker through, longer lags.
const USUAL_WINDOW: usize = 1;
/// How far back samples are kept.
const HISTORY: Duration = Duration::from_millis(200);
/// No outcome is older than this after what was forecast: a gap tells nothing about 60 ms.
const LATEST_OUTCOME: Duration = Duration::from_millis(100);
/// A head does not move faster; what does is a gap or a jump of the tracker, over which nothing is predicted.
const MAX_SPEED_M_PER_S: f64 = 10.0;
const MAX_TURN_RAD_PER_S: f64 = 30.0;

/// Velocities of a head over each window, per second: in the world, and about the axes of its view.
#[derive(Clone, Copy, Debug)]
struct Motion {
    velocity: Velocities,
    angular_velocity: Velocities,
}

/// A pose, and the motion that led to it.
#[derive(Clone, Copy, Debug)]
struct Heard {
    sample: PoseSample,
    motion: Option<Motion>,
}

/// Recent poses of one head.
#[derive(Clone, Debug, Default)]
pub struct Predictor {
    law: Prediction,
    recent: VecDeque<Heard>,
    turns: Mixture,
    shifts: Mixture,
    ignored: u32,
}

impl Predictor {
    /// A predictor by this law that has heard nothing.
    pub fn new(law: Prediction) -> Predictor {
        Predictor { law, ..Predictor::default() }
    }

    /// Takes a pose in. One that is not valid or not newer than the last is ignored and counted.
    pub fn push(&mut self, sample: PoseSample) -> bool {
        let last = self.latest_time();
        if last.is_some_and(|last| sample.time <= last) || !sample.pose.is_valid() {
            self.ignored += 1;
            return false;
        }
        while self.recent.front().is_some_and(|first| sample.time.since(first.sample.time) > HISTORY) {
            self.recent.pop_front();
        }
        if let Some(last) = last {
            self.score(&sample, sample.time.since(last));
        }
        self.recent.push_back(Heard { sample, motion: None });
        let motion = self.motion_to(&sample);
        if let Some(heard) = self.recent.back_mut() {
            heard.motion = motion;
        }
        true
    }

    /// `sample` is the outcome of what was forecast a while before it.
    fn score(&mut self, sample: &PoseSample, since_last: Duration) {
        let old_enough = |heard: &&Heard| sample.time.since(heard.sample.time) >= SCORED_AHEAD;
        let Some(Heard { sample: from, motion: Some(motion) }) = self.recent.iter().rev().find(old_enough) else {
            return;
        };
        let elapsed = sample.time.since(from.time);
        let Some((shift, turn)) = displacement(from, sample).filter(|_| elapsed <= LATEST_OUTCOME) else { return };
        let (elapsed_secs, since_last_secs) = (elapsed.as_secs_f64(), since_last.as_secs_f64());
        self.turns.score(&motion.angular_velocity, elapsed_secs, turn, since_last_secs);
        self.shifts.score(&motion.velocity, elapsed_secs, shift, since_last_secs);
    }

    /// Poses that were ignored.
    pub fn ignored(&self) -> u32 {
        self.ignored
    }

    /// The last good pose.
    pub fn latest(&self) -> Option<PoseSample> {
        self.recent.back().map(|heard| heard.sample)
    }

    /// Time of the last good pose.
    pub fn latest_time(&self) -> Option<Timestamp> {
        self.latest().map(|sample| sample.time)
    }

    /// The pose `horizon` after the last good one; that one itself where there is no velocity to go by.
    pub fn predict(&self, horizon: Duration) -> Option<Pose> {
        let latest = self.latest()?;
        let Some(Motion { velocity, angular_velocity }) = self.motion() else { return Some(latest.pose) };
        let (usual_velocity, usual_turning) = (velocity[USUAL_WINDOW], angular_velocity[USUAL_WINDOW]);
        let ahead_secs = horizon.as_secs_f64();
        let (shift, turn) = match self.law {
            Prediction::None => return Some(latest.pose),
            Prediction::ConstantVelocity => (usual_velocity * ahead_secs, usual_turning * ahead_secs),
            Prediction::Damped => (usual_velocity * ahead_secs, usual_turning * damped_secs(ahead_secs)),
            Prediction::Adaptive => {
                (self.shifts.forecast(&velocity, horizon), self.turns.forecast(&angular_velocity, horizon))
            }
        };
        let turned = latest.pose.orientation * DQuat::from_scaled_axis(turn);
        Some(Pose { position: latest.pose.position + shift, orientation: turned.normalize() })
    }

    /// How long a turn of constant speed takes to get as far as the prediction does over `horizon`.
    pub fn worth(&self, horizon: Duration) -> Duration {
        match self.law {
            Prediction::None => Duration::ZERO,
            Prediction::ConstantVelocity => horizon,
            Prediction::Damped => Duration::from_secs_f64(damped_secs(horizon.as_secs_f64())),
            Prediction::Adaptive => Duration::from_secs_f64(self.turns.worth_secs(horizon).max(0.0)),
        }
    }

    /// How fast the head turns, in radians per second about the axes of its own view; not at all where nobody can tell.
    pub fn turning_rad_per_s(&self) -> DVec3 {
        self.motion().map_or(DVec3::ZERO, |motion| motion.angular_velocity[USUAL_WINDOW])
    }

    /// The latest velocities; `None` where there are none to go by.
    fn motion(&self) -> Option<Motion> {
        self.recent.back()?.motion
    }

    /// The velocities that lead to the newest sample.
    fn motion_to(&self, latest: &PoseSample) -> Option<Motion> {
        let mut motion = Motion { velocity: Velocities::default(), angular_velocity: Velocities::default() };
        for (index, window) in WINDOWS.into_iter().enumerate() {
            // The newest sample that is a window old, or the oldest there is.
            let earlier = self.recent.iter().rev().find(|heard| latest.time.since(heard.sample.time) >= window);
            let earlier = earlier.or(self.recent.front())?;
            let elapsed_secs = latest.time.since(earlier.sample.time).as_secs_f64();
            if elapsed_secs < 1e-3 {
                return None;
            }
            let (shift, turn) = displacement(&earlier.sample, latest)?;
            motion.velocity[index] = shift / elapsed_secs;
            motion.angular_velocity[index] = turn / elapsed_secs;
        }
        Some(motion)
    }
}

/// How a head got from one pose to the other; `None` where no head gets so far.
fn displacement(from: &PoseSample, to: &PoseSample) -> Option<(DVec3, DVec3)> {
    let elapsed_secs = to.time.since(from.time).as_secs_f64();
    let mut turn = from.pose.orientation.inverse() * to.pose.orientation;
    if turn.w < 0.0 {
        turn = -turn;
    }
    let (shift, turn) = (to.pose.position - from.pose.position, scaled_axis(turn));
    let is_head =
        shift.length() <= MAX_SPEED_M_PER_S * elapsed_secs && turn.length() <= MAX_TURN_RAD_PER_S * elapsed_secs;
    is_head.then_some((shift, turn))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;
    use glam::DQuat;

    fn sample(millis: u64, position: DVec3, yaw: f64) -> PoseSample {
        PoseSample {
            time: Timestamp { micros: millis * 1000 },
            pose: Pose { position, orientation: DQuat::from_rotation_y(yaw) },
        }
    }

    #[test]
    fn steady_motion_is_continued() {
        let mut predictor = Predictor::new(Prediction::Damped);
        for step in 0..10_u64 {
            let t = step as f64 * 0.011;
            assert!(predictor.push(sample(step * 11, DVec3::X * (0.5 * t), 0.3 * t)));
        }
        let pose = predictor.predict(Duration::from_millis(50)).unwrap();
        assert!((pose.position.x - 0.5 * (0.099 + 0.05)).abs() < 1e-9);
        let yaw = pose.angle_to(&Pose::IDENTITY);
        let damped_secs = 0.2 * (1.0 - (-0.05_f64 / 0.2).exp());
        assert!((yaw - 0.3 * (0.099 + damped_secs)).abs() < 1e-9);
        assert!((predictor.worth(Duration::from_millis(50)).as_secs_f64() - damped_secs).abs() < 1e-8);
        assert!((predictor.turning_rad_per_s() - DVec3::Y * 0.3).length() < 1e-9);
    }

    #[test]
    fn stability_prediction() {
        let mut away = bound!("prediction", "metres from the last good pose after bad samples or a gap", 0.0);
        let mut turned = bound!("prediction", "radians from it", 0.0);
        let mut uncounted = bound!("prediction", "bad samples that are taken or not counted", 0.0);
        let horizons = [Duration::ZERO, Duration::from_millis(100), Duration::from_secs(3600)];
        let no_number = Pose { orientation: DQuat::from_xyzw(0.0, f64::NAN, 0.0, 1.0), ..Pose::IDENTITY };
        for law in Prediction::ALL {
            let mut predictor = Predictor::new(law);
            assert!(predictor.predict(Duration::ZERO).is_none());
            assert!(predictor.push(sample(100, DVec3::Y, 0.3)));
            let bad = [
                sample(100, DVec3::X, 0.0),
                sample(50, DVec3::X, 0.0),
                sample(120, DVec3::NAN, 0.0),
                sample(120, DVec3::INFINITY, 0.0),
                PoseSample { pose: no_number, ..sample(120, DVec3::ZERO, 0.0) },
                PoseSample {
                    pose: Pose { orientation: DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), ..no_number },
                    ..sample(120, DVec3::ZERO, 0.0)
                },
            ];
            for (index, sample) in bad.into_iter().enumerate() {
                let is_taken = predictor.push(sample);
                uncounted.count(is_taken || predictor.ignored() != index as u32 + 1, format!("{law:?}: {sample:?}"));
            }
            // After the one good sample; and after a gap, when nothing is left to take a velocity from.
            for last in [sample(100, DVec3::Y, 0.3), sample(5000, DVec3::Z, 1.0)] {
                predictor.push(last);
                for horizon in horizons {
                    let pose = predictor.predict(horizon).unwrap();
                    away.see((pose.position - last.pose.position).length(), format!("{law:?} {horizon:?}"));
                    turned.see(pose.angle_to(&last.pose), format!("{law:?} {horizon:?}"));
                }
            }
        }
        let mut undefined = bound!("prediction", "poses that are not valid, of hostile times", 0.0);
        for (law, step_micros) in Prediction::ALL.into_iter().flat_map(|law| [1, 999, 1001, 250_000].map(|s| (law, s)))
        {
            let mut predictor = Predictor::new(law);
            for step in 0..200_u64 {
                let mut next = sample(0, DVec3::X * (step as f64 * 1e-5), step as f64 * 1e-4);
                next.time = Timestamp { micros: step * step_micros };
                predictor.push(next);
                for horizon in horizons {
                    let pose = predictor.predict(horizon).unwrap();
                    let is_finite = pose.position.is_finite() && (pose.orientation.length() - 1.0).abs() < 1e-9;
                    undefined.count(!is_finite, format!("{law:?} {step_micros} us {horizon:?}"));
                }
            }
        }
    }

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
    fn each_law_goes_as_far_as_it_says() {
        let horizon = Duration::from_millis(50);
        for law in Prediction::ALL {
            let mut predictor = Predictor::new(law);
            for step in 0..100_u64 {
                let t = step as f64 * 0.011;
                predictor.push(sample(step * 11, DVec3::X * (0.5 * t), 0.3 * t));
            }
            let pose = predictor.predict(horizon).unwrap();
            let turned = pose.angle_to(&predictor.latest().unwrap().pose);
            assert!((turned - 0.3 * predictor.worth(horizon).as_secs_f64()).abs() < 1e-9, "{law:?}");
            let shift = pose.position.x - 0.5 * 99.0 * 0.011;
            let expected = if law == Prediction::None { 0.0 } else { 0.5 * 0.05 };
            assert!((shift - expected).abs() < 1e-9, "{law:?}: {shift}");
            assert_eq!(predictor.worth(horizon) == Duration::ZERO, law == Prediction::None);
        }
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
