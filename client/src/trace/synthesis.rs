//! A head trace from a seed, with the statistics of recorded ones.
//!
//! A standing person looks around a scene. The gaze holds still on a target (with the slow drift of a
//! living neck), then turns to the next one; now and then the person shifts the weight or takes a step,
//! within a box of about a metre. Every movement from one place to another follows the minimum-jerk
//! profile (Flash and Hogan 1985, eq. 3: `10 s^3 - 15 s^4 + 6 s^5`), its duration grows with its size as
//! head turns do (Freedman 2008: peak speed rises with amplitude), and what never rests is a sum of three
//! slow sines. So the trace is smooth: a closed form in time that is sampled at any rate.
//!
//! The constants were fitted to the ranges of nine recorded traces of 9 to 133 s: angular speed mean 13 to 66,
//! p95 42 to 194, maximum 82 to 598 degrees per second; linear speed mean 0.06 to 0.67, p95 0.15 to 1.02,
//! maximum 0.30 to 1.69 m/s. No tracker noise is added: it belongs to a device.

use super::{MAX_DURATION_SECS, Sample, Trace, TraceError, check_rate, pose_count};
use glam::{DQuat, DVec3};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};
use std::f64::consts::TAU;
use warplight_protocol::Pose;

/// Seed of the built-in trace; chosen because already its first ten seconds have the speeds of a whole
/// recording.
pub const BUILT_IN_SEED: u64 = 53;
/// Length of the built-in trace in seconds.
pub const BUILT_IN_SECS: f64 = 60.0;
/// Rate of the built-in trace in hertz: that of the headsets whose traces we know.
pub const BUILT_IN_RATE_HZ: f64 = 90.0;

/// The gaze leaves the first heading by at most this, in radians: what the scene wants to show stays near.
const YAW_REACH_RAD: f64 = 52.0 * DEGREE;
/// Targets of the gaze lie between these pitches, in radians; people look down more than up.
const PITCH_REACH_RAD: (f64, f64) = (-26.0 * DEGREE, 12.0 * DEGREE);
/// Seconds of the shortest turn, and how much each radian adds; 60 degrees then take half a second.
const TURN_SECS: (f64, f64) = (0.34, 0.36);
/// Seconds the gaze rests on a target, shortest and longest.
const FIXATION_SECS: (f64, f64) = (0.06, 0.6);
/// Half the side of the box in which the person stands, in metres.
const STANDING_REACH_M: f64 = 0.42;
/// Seconds of the shortest step, and how much each metre adds.
const STEP_SECS: (f64, f64) = (0.6, 1.2);
/// Seconds between steps, shortest and longest.
const STANDING_SECS: (f64, f64) = (0.3, 1.9);
/// How far the head goes down when it leans to look at something, in metres.
const LEAN_M: f64 = 0.16;
/// Height of the eyes of a standing person, in metres.
const EYE_HEIGHT_M: f64 = 1.6;
const DEGREE: f64 = std::f64::consts::PI / 180.0;

impl Trace {
    /// A trace of `duration_secs` at `rate_hz`, determined by `seed`; the first heading is -Z, the eyes are
    /// 1.6 m above the floor.
    ///
    /// # Errors
    /// A duration or rate that is not positive or asks for more poses than a trace may have.
    pub fn synthesise(seed: u64, duration_secs: f64, rate_hz: f64) -> Result<Trace, TraceError> {
        if !(duration_secs > 0.0 && duration_secs <= MAX_DURATION_SECS) {
            let expected = format!("a duration above 0 and at most {MAX_DURATION_SECS} s");
            return Err(TraceError::Parameter { field: "duration-s", expected, found: duration_secs.to_string() });
        }
        check_rate(rate_hz)?;
        let count = pose_count(duration_secs, rate_hz)?;
        Ok(Person::new(seed, duration_secs).sampled(count, rate_hz))
    }

    /// The trace of the main job.
    pub fn built_in() -> Trace {
        let count = (BUILT_IN_SECS * BUILT_IN_RATE_HZ) as usize + 1;
        Person::new(BUILT_IN_SEED, BUILT_IN_SECS).sampled(count, BUILT_IN_RATE_HZ)
    }
}

/// All movements of a person, ready to be asked for any time.
struct Person {
    yaw: Path,
    pitch: Path,
    east: Path,
    south: Path,
    lean: Path,
    drift: [Sway; 3],
    sway: [Sway; 3],
}

impl Person {
    fn new(seed: u64, duration_secs: f64) -> Person {
        let mut dice = Dice(Pcg64Mcg::seed_from_u64(seed));
        let (mut yaw, mut pitch, mut lean) = (Path::default(), Path::default(), Path::default());
        let (mut east, mut south) = (Path::default(), Path::default());

        // Gaze: hold, turn, hold, turn. A target near the middle is likelier than one at the edge.
        let mut secs = dice.between(FIXATION_SECS);
        while secs < duration_secs {
            let to_yaw = YAW_REACH_RAD * dice.triangular();
            let (low, high) = PITCH_REACH_RAD;
            let to_pitch = 0.5 * (low + high) + 0.5 * (high - low) * dice.triangular();
            let turn_rad = (to_yaw - yaw.end()).hypot(to_pitch - pitch.end());
            let hurry = dice.between((0.65, 1.6));
            let turn_secs = (TURN_SECS.0 + TURN_SECS.1 * turn_rad) * hurry;
            yaw.move_to(secs, turn_secs, to_yaw);
            // The head comes down a little later than it turns.
            pitch.move_to(secs + 0.1 * turn_secs, turn_secs, to_pitch);
            secs += 1.1 * turn_secs + dice.between(FIXATION_SECS);
        }

        // Feet: stand, step, stand, step; sometimes the whole body leans down to look.
        let mut secs = dice.between(STANDING_SECS);
        while secs < duration_secs {
            let (to_east, to_south) = (STANDING_REACH_M * dice.triangular(), STANDING_REACH_M * dice.triangular());
            let step_m = (to_east - east.end()).hypot(to_south - south.end());
            let step_secs = (STEP_SECS.0 + STEP_SECS.1 * step_m) * dice.between((0.75, 1.45));
            east.move_to(secs, step_secs, to_east);
            south.move_to(secs, step_secs, to_south);
            let to_lean = if dice.unit() < 0.3 { -LEAN_M * dice.unit() } else { 0.0 };
            lean.move_to(secs, step_secs.max(0.8), to_lean);
            secs += step_secs.max(0.8) + dice.between(STANDING_SECS);
        }

        let drift = [3.0, 1.8, 2.0].map(|degrees| Sway::new(&mut dice, degrees * DEGREE));
        let sway = [0.024, 0.006, 0.024].map(|metres| Sway::new(&mut dice, metres));
        Person { yaw, pitch, east, south, lean, drift, sway }
    }

    fn sampled(&self, count: usize, rate_hz: f64) -> Trace {
        let at = |index: usize| {
            let time_secs = index as f64 / rate_hz;
            Sample { time_secs, head_pose: self.head_pose(time_secs) }
        };
        Trace::from_rising((0..count).map(at).collect())
    }

    fn head_pose(&self, secs: f64) -> Pose {
        let [yaw_drift, pitch_drift, roll_drift] = self.drift.each_ref().map(|drift| drift.at(secs));
        let yaw = self.yaw.at(secs) + yaw_drift;
        let pitch = self.pitch.at(secs) + pitch_drift;
        // A head that looks aside tilts a little.
        let roll = roll_drift - 0.05 * yaw;
        let [sway_x, sway_y, sway_z] = self.sway.each_ref().map(|sway| sway.at(secs));
        // The eyes are in front of the neck and above it: turning the head moves them.
        let orientation = DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch) * DQuat::from_rotation_z(roll);
        let neck = DVec3::new(
            self.east.at(secs) + sway_x,
            EYE_HEIGHT_M - EYES_FROM_NECK_M.y + self.lean.at(secs) + sway_y,
            self.south.at(secs) + sway_z,
        );
        Pose { position: neck + orientation * EYES_FROM_NECK_M, orientation: orientation.normalize() }
    }
}

/// The eyes as seen from the joint about which a head turns, in metres (as VR runtimes model the neck).
const EYES_FROM_NECK_M: DVec3 = DVec3::new(0.0, 0.075, -0.08);

/// One coordinate that rests, moves, rests: minimum-jerk movements in the order of time, never overlapping.
#[derive(Default)]
struct Path {
    moves: Vec<Move>,
}

struct Move {
    start_secs: f64,
    duration_secs: f64,
    from: f64,
    to: f64,
}

impl Path {
    fn end(&self) -> f64 {
        self.moves.last().map_or(0.0, |last| last.to)
    }

    fn move_to(&mut self, start_secs: f64, duration_secs: f64, to: f64) {
        self.moves.push(Move { start_secs, duration_secs, from: self.end(), to });
    }

    fn at(&self, secs: f64) -> f64 {
        let begun = self.moves.partition_point(|movement| movement.start_secs <= secs);
        let Some(movement) = begun.checked_sub(1).and_then(|last| self.moves.get(last)) else {
            return 0.0;
        };
        let s = ((secs - movement.start_secs) / movement.duration_secs).min(1.0);
        let way = s * s * s * (10.0 + s * (6.0 * s - 15.0));
        movement.from + (movement.to - movement.from) * way
    }
}

/// What never rests: three sines between 0.1 and 0.9 Hz, with the amplitude falling as the frequency rises.
struct Sway {
    sines: [(f64, f64, f64); 3],
}

impl Sway {
    fn new(dice: &mut Dice, amplitude: f64) -> Sway {
        let bands = [((0.10, 0.20), 1.0), ((0.25, 0.45), 0.6), ((0.55, 0.90), 0.3)];
        Sway { sines: bands.map(|(hertz, part)| (TAU * dice.between(hertz), TAU * dice.unit(), amplitude * part)) }
    }

    fn at(&self, secs: f64) -> f64 {
        let sine = |&(frequency, phase, amplitude): &(f64, f64, f64)| amplitude * (frequency * secs + phase).sin();
        self.sines.iter().map(sine).sum()
    }
}

struct Dice(Pcg64Mcg);

impl Dice {
    /// Uniform in 0 to 1.
    fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, (low, high): (f64, f64)) -> f64 {
        low + (high - low) * self.unit()
    }

    /// From -1 to 1, between an even spread and a triangle: the middle is likelier, the edge not rare.
    fn triangular(&mut self) -> f64 {
        let (a, b) = (self.unit(), self.unit());
        ((a - 0.5) * 1.35 + (b - 0.5) * 0.65).clamp(-1.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEEDS: std::ops::Range<u64> = 0..20;

    /// Against the range of the recorded traces of the project's data set (nine of 9 to 133 s).
    #[test]
    fn speeds_lie_within_those_of_recorded_heads() {
        for seed in SEEDS {
            let facts = Trace::synthesise(seed, 60.0, 90.0).unwrap().facts();
            let (turn, walk) = (facts.angular_deg_per_s, facts.linear_m_per_s);
            eprintln!("seed {seed}: {turn:?} {walk:?} box {:?} yaw {:.0}", facts.box_m, facts.max_yaw_deg);
            assert!((28.0..45.0).contains(&turn.mean), "seed {seed}: {turn:?}");
            assert!((95.0..150.0).contains(&turn.p95), "seed {seed}: {turn:?}");
            assert!((150.0..400.0).contains(&turn.max), "seed {seed}: {turn:?}");
            assert!((0.14..0.30).contains(&walk.mean), "seed {seed}: {walk:?}");
            assert!((0.45..0.80).contains(&walk.p95), "seed {seed}: {walk:?}");
            assert!((0.7..1.5).contains(&walk.max), "seed {seed}: {walk:?}");
            assert!((facts.median_interval_ms - 11.11).abs() < 0.01);
        }
    }

    #[test]
    fn the_person_stays_in_a_box_of_a_metre_and_upright() {
        for seed in SEEDS {
            let trace = Trace::synthesise(seed, 60.0, 90.0).unwrap();
            let facts = trace.facts();
            assert!(facts.box_m[0] < 1.3 && facts.box_m[1] < 0.35 && facts.box_m[2] < 1.3, "{:?}", facts.box_m);
            assert!((trace.mean_position().y - EYE_HEIGHT_M).abs() < 0.08, "{}", trace.mean_position().y);
            for sample in trace.samples() {
                let up = sample.head_pose.orientation * DVec3::Y;
                assert!(up.y > 30.0_f64.to_radians().cos(), "seed {seed}");
            }
        }
    }

    #[test]
    fn the_gaze_stays_near_the_first_heading() {
        for seed in SEEDS {
            let yaw = Trace::synthesise(seed, 60.0, 90.0).unwrap().facts().max_yaw_deg;
            assert!((30.0..60.0).contains(&yaw), "seed {seed}: {yaw}");
        }
    }

    /// Jitter would show as acceleration that grows with the sampling rate.
    #[test]
    fn the_trace_is_smooth_at_any_rate() {
        let steepest = |rate_hz: f64| {
            let trace = Trace::synthesise(2, 20.0, rate_hz).unwrap();
            let speeds: Vec<f64> = trace
                .samples()
                .windows(2)
                .map(|pair| pair[0].head_pose.angle_to(&pair[1].head_pose) * rate_hz)
                .collect();
            speeds.windows(2).map(|pair| (pair[1] - pair[0]).abs() * rate_hz).fold(0.0, f64::max)
        };
        let (slow, fast) = (steepest(90.0), steepest(720.0));
        assert!(fast < 1.25 * slow, "{slow} rad/s^2 at 90 Hz, {fast} at 720 Hz");
    }

    #[test]
    fn the_seed_decides_and_the_rate_only_samples() {
        let a = Trace::synthesise(9, 5.0, 90.0).unwrap();
        assert_eq!(a, Trace::synthesise(9, 5.0, 90.0).unwrap());
        assert_ne!(a, Trace::synthesise(10, 5.0, 90.0).unwrap());
        let fine = Trace::synthesise(9, 5.0, 900.0).unwrap();
        for (coarse, fine) in a.samples().iter().zip(fine.samples().iter().step_by(10)) {
            assert!(coarse.head_pose.angle_to(&fine.head_pose) < 1e-9);
        }
    }

    #[test]
    fn the_built_in_trace_is_one_of_these() {
        let built_in = Trace::built_in();
        assert_eq!(built_in, Trace::synthesise(BUILT_IN_SEED, BUILT_IN_SECS, BUILT_IN_RATE_HZ).unwrap());
        let ten_seconds = built_in.cut(0.0, 10.0).unwrap().facts();
        eprintln!("{ten_seconds}");
        assert!(ten_seconds.angular_deg_per_s.mean > 25.0 && ten_seconds.linear_m_per_s.mean > 0.17);
        assert!(ten_seconds.max_yaw_deg < 60.0);
    }

    #[test]
    fn senseless_parameters_are_refused_by_name() {
        for (duration, rate, field) in [
            (0.0, 90.0, "duration-s"),
            (f64::NAN, 90.0, "duration-s"),
            (1e9, 90.0, "duration-s"),
            (10.0, 0.0, "rate-hz"),
            (10.0, f64::NAN, "rate-hz"),
            (0.1, 1.0, "rate-hz"),
            (80_000.0, 1000.0, "poses"),
        ] {
            let said = Trace::synthesise(1, duration, rate).unwrap_err().to_string();
            assert!(said.contains(field), "{said}");
        }
    }
}
