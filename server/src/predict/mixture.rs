//! Which way of continuing a motion would have served this head best of late.
//!
//! Part of the predictor, beside the plain laws. Nine forecasters each give a velocity: that over the last 8, 30 or 60 ms;
//! each of these dying away with a time constant of 0.2 s; two of them extrapolated by how they differ from that over
//! 60 ms; and rest. Each new pose is the outcome of what was forecast [`SCORED_AHEAD`] before it, so each forecaster has a
//! mean error of its own, forgotten over [`MEMORY_SECS`]. What is used is their mean weighted by
//! `exp(-SHARPNESS (error / least error - 1))`: the exponentially weighted majority (Littlestone 1994), discounted. Turns
//! and shifts are mixed apart: walkers keep their speed while their heads stop.
//!
//! Why no single law: on recorded traces the best window and damping differ by person and by tracker, by up to a fifth of
//! the mean error either way, and no fixed choice is at or below constant velocity on all of them; a noisy tracker wants
//! long windows, a quick head short ones. Weights that sum to one and coefficients that sum to at most one bound what is
//! forecast by twice the fastest velocity seen. Costs some 200 flops a pose. What it cannot know is when a head will turn
//! round: error grows with the square of the horizon as for any other law.

use glam::DVec3;
use std::time::Duration;

/// Windows over which velocities are taken, or a little more: to the newest sample that is as old. 8 ms is the sample before
/// at the rates of displays.
pub(super) const WINDOWS: [Duration; 3] =
    [Duration::from_millis(8), Duration::from_millis(30), Duration::from_millis(60)];
/// How far ahead forecasters are scored: about the latency of a link that is worth predicting over.
pub(super) const SCORED_AHEAD: Duration = Duration::from_millis(60);
/// Errors are forgotten over this: shorter follows a head from rest to walking, longer tells forecasters better apart.
const MEMORY_SECS: f64 = 10.0;
/// How much a forecaster must be better to be used alone: one worse by a tenth weighs exp(-2).
const SHARPNESS: f64 = 20.0;
/// Time constant of what dies away.
pub(super) const DAMPING_SECS: f64 = 0.2;
/// What a forecaster's errors start from, in velocity times seconds of memory: outweighed within a few tenths of a second.
const STARTING_ERROR: f64 = 0.01;
/// How much worse than velocity over 30 ms the others start.
const STARTING_HANDICAP: f64 = 1.5;

/// Velocities over each of the windows.
pub(super) type Velocities = [DVec3; WINDOWS.len()];

/// One way of continuing a motion.
#[derive(Clone, Copy, Debug)]
struct Forecaster {
    /// How much of each window's velocity it takes.
    of: [f64; WINDOWS.len()],
    /// Whether the motion dies away.
    damped: bool,
}

const FORECASTERS: [Forecaster; 9] = [
    Forecaster { of: [1.0, 0.0, 0.0], damped: false },
    Forecaster { of: [0.0, 1.0, 0.0], damped: false },
    Forecaster { of: [0.0, 0.0, 1.0], damped: false },
    Forecaster { of: [1.0, 0.0, 0.0], damped: true },
    Forecaster { of: [0.0, 1.0, 0.0], damped: true },
    Forecaster { of: [0.0, 0.0, 1.0], damped: true },
    Forecaster { of: [1.5, 0.0, -0.5], damped: false },
    Forecaster { of: [0.0, 1.5, -0.5], damped: false },
    Forecaster { of: [0.0, 0.0, 0.0], damped: false },
];
/// Velocity over 30 ms, undamped: what is used before anything is known.
const USUAL: usize = 1;

/// How long a motion of constant speed takes to get as far as one that dies away does over `horizon_secs`.
pub(super) fn damped_secs(horizon_secs: f64) -> f64 {
    DAMPING_SECS * -(-horizon_secs.max(0.0) / DAMPING_SECS).exp_m1()
}

impl Forecaster {
    fn ahead_secs(&self, horizon_secs: f64) -> f64 {
        if self.damped { damped_secs(horizon_secs) } else { horizon_secs.max(0.0) }
    }

    /// Displacement after `horizon_secs`.
    fn forecast(&self, velocities: &Velocities, horizon_secs: f64) -> DVec3 {
        let velocity: DVec3 = self.of.iter().zip(velocities).map(|(&part, &velocity)| part * velocity).sum();
        velocity * self.ahead_secs(horizon_secs)
    }
}

/// Forecasters of one kind of motion, and how well each has done.
#[derive(Clone, Debug)]
pub(super) struct Mixture {
    /// Errors as velocities, summed over time and forgotten.
    errors: [f64; FORECASTERS.len()],
    weights: [f64; FORECASTERS.len()],
}

impl Default for Mixture {
    fn default() -> Mixture {
        let mut mixture = Mixture { errors: [0.0; FORECASTERS.len()], weights: [0.0; FORECASTERS.len()] };
        mixture.weigh();
        mixture
    }
}

impl Mixture {
    /// Learns that `elapsed_secs` after these velocities the displacement was `outcome`; the pose before was heard
    /// `since_last_secs` ago.
    pub(super) fn score(&mut self, velocities: &Velocities, elapsed_secs: f64, outcome: DVec3, since_last_secs: f64) {
        let kept = (-since_last_secs / MEMORY_SECS).exp();
        for (error, forecaster) in self.errors.iter_mut().zip(&FORECASTERS) {
            let missed = (forecaster.forecast(velocities, elapsed_secs) - outcome).length() / elapsed_secs;
            *error = *error * kept + missed * since_last_secs;
        }
        self.weigh();
    }

    fn weigh(&mut self) {
        let start = |index: usize| STARTING_ERROR * if index == USUAL { 1.0 } else { STARTING_HANDICAP };
        let error = |index: usize| self.errors[index] + start(index);
        let least = (0..FORECASTERS.len()).map(error).fold(f64::INFINITY, f64::min);
        let weights: [f64; FORECASTERS.len()] =
            std::array::from_fn(|index| (-SHARPNESS * (error(index) / least - 1.0)).exp());
        let sum: f64 = weights.iter().sum();
        self.weights = weights.map(|weight| weight / sum);
    }

    /// Displacement after `horizon`.
    pub(super) fn forecast(&self, velocities: &Velocities, horizon: Duration) -> DVec3 {
        let each = |forecaster: &Forecaster| forecaster.forecast(velocities, horizon.as_secs_f64());
        self.weights.iter().zip(&FORECASTERS).map(|(&weight, forecaster)| weight * each(forecaster)).sum()
    }

    /// How long a motion of constant speed takes to get as far.
    pub(super) fn worth_secs(&self, horizon: Duration) -> f64 {
        let each =
            |forecaster: &Forecaster| forecaster.of.iter().sum::<f64>() * forecaster.ahead_secs(horizon.as_secs_f64());
        self.weights.iter().zip(&FORECASTERS).map(|(&weight, forecaster)| weight * each(forecaster)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEAT_SECS: f64 = 1.0 / 90.0;

    /// A motion along one axis with its velocity over each window, scored for `secs`.
    fn learned(secs: f64, at: impl Fn(f64) -> f64) -> Mixture {
        let mut mixture = Mixture::default();
        for beat in 0..(secs / BEAT_SECS) as u32 {
            let now = f64::from(beat) * BEAT_SECS;
            let outcome = DVec3::X * (at(now + 0.06) - at(now));
            mixture.score(&velocities(now, &at), 0.06, outcome, BEAT_SECS);
        }
        mixture
    }

    fn velocities(now: f64, at: impl Fn(f64) -> f64) -> Velocities {
        WINDOWS.map(|window| DVec3::X * (at(now) - at(now - window.as_secs_f64())) / window.as_secs_f64())
    }

    #[test]
    fn weights_are_a_mean_and_start_at_constant_velocity() {
        let mixture = Mixture::default();
        assert!((mixture.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(mixture.weights[USUAL] > 0.99, "{:?}", mixture.weights);
    }

    #[test]
    fn steady_motion_stays_at_constant_velocity() {
        let at = |secs: f64| 0.7 * secs;
        let mixture = learned(10.0, at);
        let ahead = mixture.forecast(&velocities(10.0, at), Duration::from_millis(60)).x;
        assert!((ahead - 0.7 * 0.06).abs() < 1e-9, "{ahead}");
        assert!((mixture.worth_secs(Duration::from_millis(60)) - 0.06).abs() < 1e-9);
    }

    /// A sine of 1 Hz: acceleration counts, and forecasters that see it win.
    #[test]
    fn a_swinging_head_is_followed_better_than_at_constant_velocity() {
        let at = |secs: f64| (std::f64::consts::TAU * secs).sin();
        let mixture = learned(10.0, at);
        let (mut mixed, mut constant) = (0.0, 0.0);
        for step in 0..100 {
            let now = 10.0 + f64::from(step) * 0.01;
            let (velocities, outcome) = (velocities(now, at), at(now + 0.06) - at(now));
            mixed += (mixture.forecast(&velocities, Duration::from_millis(60)).x - outcome).abs();
            constant += (FORECASTERS[USUAL].forecast(&velocities, 0.06).x - outcome).abs();
        }
        assert!(mixed < 0.75 * constant, "{mixed} against {constant}");
    }

    /// A tracker that shakes about a point: the best forecast is none, and it is found.
    #[test]
    fn of_a_shaking_tracker_nothing_is_predicted() {
        let at = |secs: f64| 1e-3 * ((secs * 90.0).round() * 12.9898).sin();
        let mixture = learned(10.0, at);
        assert!(mixture.worth_secs(Duration::from_millis(60)) < 0.01, "{:?}", mixture.weights);
    }
}
