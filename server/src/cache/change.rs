//! Where light has changed since the last frame, and by how much.
//!
//! Belongs to the cache of live frames in scenes in which things move. How long a cell may remember is a question
//! of whether its light is still what it was. Answered from the noisy samples themselves, either small changes are
//! noticed late or chance is taken for change, and the picture flickers. So it is asked directly (Schied, Peters and
//! Dachsbacher 2018, "Gradient Estimation for Real-Time Adaptive Temporal Filtering"): some paths of the last frame are
//! walked again with the same random numbers in the scene as it is now. Where nothing has changed they find the very
//! same light, without any noise; so light that rests keeps its long memory although things move elsewhere.
//!
//! Method: what the paths found, then and now, is summed in hashed cells some of the finest cells of the cache wide, and in grids of
//! doubling width. The relative change `x = sum |now - then| / sum max(now, then)` of the finest cell that holds enough
//! paths fades the samples of the cache there, by two rules:
//! - what is a moment old counts less: `n / (1 + (dt / MEMORY_SECS) r / (r + NOTICED))` with the rate `r = x / dt`. Under light that
//!   changes steadily a mean so lags behind by little more than [`MEMORY_SECS`], whatever the rate of frames.
//! - what has become wrong counts no more than its error allows: `1/n' = 1/n + DOUBT x^2`, as in a Kalman filter whose
//!   state has jumped by x. A light that is switched empties the cells that it lights within a frame.
//!
//! Limits: what changes only where no path is walked again is noticed as much as the picture changes on the whole;
//! light that has been reflected twice is taken to change with what lights it. Cost: the paths, and one pass over the
//! blocks of the table in frames in which something has moved.

use super::cell::{Facing, Grid};
use super::{LEVELS, level_of};
use glam::Vec3;
use std::collections::HashMap;

/// Least width of the cells in which changes are summed, in the finest of the cache: wide enough for some paths.
const FINEST: f32 = 4.0;
/// Paths that a cell must hold to be believed: fewer miss a shadow that passes, more are known of wide cells only.
const ENOUGH_PATHS: f32 = 6.0;
/// Grids of doubling width.
const GRIDS: i32 = LEVELS;
/// Mean age of what cells under steadily changing light hold, in seconds. Half a second of lag is allowed, and
/// the less there is the more noise is seen while light changes.
const MEMORY_SECS: f32 = 0.3;
/// Change per second that is noticed at all: below, memory grows up to what it is in light that rests, and what is
/// shown is off by no more than about a hundredth.
const NOTICED: f32 = 0.02;
/// Weight of a squared change against that of a sample, whose relative variance is about 1. With less, a light that
/// changes by a tenth is followed late; with more, the rule of the memory would never be the narrower one.
const DOUBT: f32 = 30.0;
/// Changes that may be rounding.
const ROUNDING: f32 = 1e-5;

/// How much of the samples of a place is to be forgotten.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fade {
    keep: f32,
    doubt: f32,
}

/// Two walks of one path: what it found in the last frame, and now.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Comparison {
    pub(crate) position: Vec3,
    /// Width of the cache's finest cells here.
    pub(crate) cell_m: f32,
    /// Luminance.
    pub(crate) then: f32,
    pub(crate) now: f32,
}

#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    changed: f32,
    total: f32,
    paths: f32,
}

/// The changes of a frame.
#[derive(Debug, Default)]
pub(crate) struct Changes {
    cells: HashMap<u64, Sum>,
    everywhere: Sum,
    elapsed_secs: f32,
}

impl Changes {
    /// Forgets the last frame: this one is so much later.
    pub(crate) fn begin(&mut self, elapsed_secs: f32) {
        self.cells.clear();
        self.everywhere = Sum::default();
        self.elapsed_secs = elapsed_secs;
    }

    /// Takes in a path that was walked again.
    pub(crate) fn add(&mut self, comparison: &Comparison) {
        let Comparison { position, cell_m, then, now } = *comparison;
        if !(then.is_finite() && now.is_finite()) {
            return;
        }
        self.everywhere.add(then, now);
        let (finest, _) = level_of(FINEST * cell_m);
        for level in finest..finest + GRIDS {
            self.cells.entry(name(level, position)).or_default().add(then, now);
        }
    }

    /// Whether anything has changed at all.
    pub(crate) fn any(&self) -> bool {
        self.everywhere.changed > 0.0
    }

    /// What the cells of a block are to forget; `cell_m` is their width, and `position` in one of them.
    pub(crate) fn fade_at(&self, position: Vec3, cell_m: f32) -> Option<Fade> {
        let (finest, _) = level_of(FINEST * cell_m);
        let known = (finest..finest + 2 * GRIDS)
            .find_map(|level| self.cells.get(&name(level, position)).filter(|sum| sum.paths >= ENOUGH_PATHS));
        let sum = known.unwrap_or(&self.everywhere);
        let change = if sum.total > 0.0 { (sum.changed / sum.total).min(1.0) } else { 0.0 };
        (change > ROUNDING).then(|| Fade {
            keep: 1.0 / (1.0 + self.elapsed_secs / MEMORY_SECS * change / (change + NOTICED * self.elapsed_secs)),
            doubt: DOUBT * change * change,
        })
    }
}

impl Fade {
    /// What is left of so many samples.
    pub(crate) fn of(&self, samples: f32) -> f32 {
        let kept = samples * self.keep;
        kept / (1.0 + kept * self.doubt)
    }
}

impl Sum {
    fn add(&mut self, then: f32, now: f32) {
        self.changed += (now - then).abs();
        self.total += now.max(then);
        self.paths += 1.0;
    }
}

/// Cells here do not ask which way a surface faces.
fn name(level: i32, position: Vec3) -> u64 {
    let [(facing, _), _] = Facing::of(Vec3::Y);
    let grid = Grid::new(level, facing);
    let address = grid.address(grid.cell(position));
    address.block ^ u64::from(address.within) << 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(now: impl Fn(f32) -> f32, elapsed_secs: f32) -> Changes {
        let mut changes = Changes::default();
        changes.begin(elapsed_secs);
        for step in 0..4000_u16 {
            let position = Vec3::new(f32::from(step % 200) * 0.005, 0.0, f32::from(step / 200) * 0.05);
            changes.add(&Comparison { position, cell_m: 0.01, then: 1.0, now: now(position.x) });
        }
        changes
    }

    #[test]
    fn light_that_rests_is_kept_to_the_last_sample_beside_light_that_changes() {
        let changes = field(|x| if x > 0.6 { 2.0 } else { 1.0 }, 0.1);
        assert!(changes.any());
        assert_eq!(changes.fade_at(Vec3::new(0.2, 0.0, 0.5), 0.01), None);
        let fade = changes.fade_at(Vec3::new(0.9, 0.0, 0.5), 0.01).unwrap();
        assert!(fade.of(4096.0) < 1.0);
        assert!(!field(|_| 1.0, 0.1).any());
    }

    /// Under light that changes steadily, a mean that is faded and given new samples each frame is late by no more
    /// than the memory, at any rate of frames.
    #[test]
    fn a_mean_lags_behind_by_no_more_than_the_memory() {
        for hz in [5.0, 10.0, 60.0_f32] {
            for per_frame in [2.0, 500.0_f32] {
                // A fifth per second.
                let rate = 0.2;
                let (mut mean, mut samples, mut light) = (1.0, 4096.0_f32, 1.0_f32);
                for _ in 0..(5.0 * hz) as u32 {
                    let before = light;
                    light += rate / hz;
                    let fade = field(|_| light / before, 1.0 / hz).fade_at(Vec3::splat(0.3) * Vec3::X, 0.01);
                    samples = fade.map_or(samples, |fade| fade.of(samples)) + per_frame;
                    mean += per_frame / samples * (light - mean);
                }
                let lag_secs = (light - mean) / rate;
                assert!(lag_secs < 1.2 * MEMORY_SECS, "{hz} Hz, {per_frame} samples: {lag_secs} s");
            }
        }
    }

    #[test]
    fn what_no_path_has_seen_fades_as_the_picture_does_on_the_whole() {
        let changes = field(|_| 1.5, 0.1);
        assert!(changes.fade_at(Vec3::splat(900.0), 0.01).unwrap().of(4096.0) < 2.0);
        let mut odd = Changes::default();
        odd.begin(0.1);
        odd.add(&Comparison { position: Vec3::ZERO, cell_m: 0.01, then: f32::NAN, now: 1.0 });
        odd.add(&Comparison { position: Vec3::ZERO, cell_m: 0.01, then: 0.0, now: 0.0 });
        assert!(!odd.any() && odd.fade_at(Vec3::ZERO, 0.01).is_none());
    }
}
