//! What a frame costs: a part per pixel, and a part per sample.
//!
//! Method: recursive least squares with forgetting (Kalman filter of two constants that drift) on the measured
//! times of frames. Where all frames have the same samples per pixel only their sum is known, and the split
//! stays what it was. Frames differ in size (see `guard`), so samples are counted per pixel. Limits: at most [`MAX_STEP`] times more samples from one frame to the next, since a cost
//! that was never measured may be wrong.

/// Largest growth of the number of samples from frame to frame.
const MAX_STEP: f64 = 2.0;
/// Weight of the past in each step: half of it is gone after five frames.
const MEMORY: f64 = 0.87;
/// Share of the first frame's time that is taken as its pixels' before a second one is measured.
const FIRST_FIXED: f64 = 0.5;

/// The cost of frames of one session, in milliseconds.
#[derive(Clone, Debug, Default)]
pub(super) struct FrameCost {
    model: Option<Model>,
}

#[derive(Clone, Debug)]
struct Model {
    /// Samples per pixel of the first frame, and its pixels: the units here, so that both parts are of the same size.
    unit: f64,
    pixels: f64,
    /// Part of one unit of pixels, and of one unit of samples.
    parts: [f64; 2],
    /// Their covariance, over that of a measurement.
    covariance: [[f64; 2]; 2],
    last: f64,
}

impl FrameCost {
    /// A frame with so many pixels and samples per pixel (of any unit, but always the same) took so long.
    pub(super) fn measure(&mut self, pixels: f64, samples: f64, millis: f64) {
        let (pixels, samples) = (pixels.max(1.0), samples.max(f64::MIN_POSITIVE));
        let Some(model) = &mut self.model else {
            let parts = [millis * FIRST_FIXED, millis * (1.0 - FIRST_FIXED)];
            let covariance = [[0.5, -0.5], [-0.5, 0.5]];
            self.model = Some(Model { unit: samples, pixels, parts, covariance, last: samples });
            return;
        };
        let size = pixels / model.pixels;
        let x = [size, size * samples / model.unit];
        let p = &mut model.covariance;
        let px = [p[0][0] * x[0] + p[0][1] * x[1], p[1][0] * x[0] + p[1][1] * x[1]];
        let innovation = MEMORY + x[0] * px[0] + x[1] * px[1];
        let error = millis - model.parts[0] * x[0] - model.parts[1] * x[1];
        for row in 0..2 {
            model.parts[row] = (model.parts[row] + px[row] / innovation * error).max(0.0);
            for column in 0..2 {
                // Bounded: what is not observed would be forgotten without end.
                p[row][column] = ((p[row][column] - px[row] * px[column] / innovation) / MEMORY).clamp(-10.0, 10.0);
            }
        }
        model.last = samples;
    }

    /// Samples per pixel of a frame of so many pixels that takes `budget_millis`; `first` where nothing has been
    /// measured yet.
    pub(super) fn samples_within(&self, pixels: f64, budget_millis: f64, first: f64) -> f64 {
        let Some(model) = &self.model else { return first };
        let units = (budget_millis * model.pixels / pixels.max(1.0) - model.parts[0]) / model.parts[1].max(1e-3);
        (units * model.unit).clamp(model.last / MAX_STEP, model.last * MAX_STEP)
    }

    /// What a frame of so many pixels with so many samples per pixel is expected to take; 0 where nothing was measured.
    pub(super) fn millis_of(&self, pixels: f64, samples: f64) -> f64 {
        let of = |model: &Model| (model.parts[0] + model.parts[1] * samples / model.unit) * pixels / model.pixels;
        self.model.as_ref().map_or(0.0, of)
    }
}

/// Whether the budget is too small for a frame with hardly any samples.
#[derive(Clone, Debug, Default)]
pub(super) struct BudgetFit {
    late_in_a_row: u32,
    told: bool,
}

impl BudgetFit {
    /// Takes in whether a frame with the fewest samples was late; true once, when that has become a habit.
    pub(super) fn does_not(&mut self, late: bool) -> bool {
        const HABIT: u32 = 5;
        self.late_in_a_row = if late { self.late_in_a_row + 1 } else { 0 };
        let tell = self.late_in_a_row >= HABIT && !self.told;
        self.told |= tell;
        tell
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: f64 = 1e5;

    #[test]
    fn a_budget_that_is_too_small_is_told_once() {
        let mut fit = BudgetFit::default();
        let told = [true, true, true, false, true, true, true, true, true, true, true].map(|late| fit.does_not(late));
        assert_eq!(told.iter().filter(|told| **told).count(), 1);
        assert!(told[8] && (0..100).all(|_| !fit.does_not(true)));
    }

    /// Frames of a machine with these costs, each with the samples that the model allows it.
    fn run(fixed: f64, per_sample: f64, budget: f64, frames: u32) -> Vec<f64> {
        let mut cost = FrameCost::default();
        let mut times = Vec::new();
        for frame in 0..frames {
            let samples = cost.samples_within(PIXELS, budget, 1000.0).max(1.0);
            // A machine is never quite the same.
            let millis = (fixed + per_sample * samples) * (1.0 + 0.03 * (f64::from(frame) * 2.4).sin());
            cost.measure(PIXELS, samples, millis);
            times.push(millis);
        }
        times
    }

    #[test]
    fn frames_come_to_take_the_time_they_have() {
        for (fixed, per_sample) in [(0.0, 0.01), (50.0, 0.001), (70.0, 0.1), (1.0, 1.0), (10.0, 1e-4)] {
            let times = run(fixed, per_sample, 80.0, 60);
            for time in &times[30..] {
                assert!((60.0..100.0).contains(time), "{fixed} + {per_sample} n: {times:?}");
            }
        }
    }

    #[test]
    fn where_the_fixed_part_is_too_much_few_samples_are_left() {
        let times = run(200.0, 0.01, 80.0, 30);
        assert!(times[29] < 210.0);
    }

    #[test]
    fn costs_that_change_are_followed() {
        let mut cost = FrameCost::default();
        let mut millis = 0.0;
        for frame in 0..80 {
            let samples = cost.samples_within(PIXELS, 80.0, 1000.0).max(1.0);
            millis = if frame < 40 { 20.0 + 0.001 * samples } else { 40.0 + 0.004 * samples };
            cost.measure(PIXELS, samples, millis);
        }
        assert!((millis - 80.0).abs() < 12.0, "{millis}");
    }

    #[test]
    fn a_frame_that_grows_gets_fewer_samples_before_it_is_late() {
        let mut cost = FrameCost::default();
        for frame in 0..60 {
            let size = if frame % 20 < 10 { 1.0 } else { 1.6 };
            let samples = cost.samples_within(size * PIXELS, 80.0, 1000.0).max(1.0);
            let millis = size * (30.0 + 0.01 * samples);
            cost.measure(size * PIXELS, samples, millis);
            if frame >= 20 {
                assert!(millis < 88.0, "frame {frame} of size {size}: {millis} ms");
            }
            // Going back to the smaller size, samples take two frames to grow by more than twice.
            if frame >= 20 && frame % 10 >= 2 {
                assert!(millis > 72.0, "frame {frame} of size {size}: {millis} ms");
            }
        }
    }
}
