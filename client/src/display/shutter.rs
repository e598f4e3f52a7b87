//! An open shutter from one frame: the head's poses of the last milliseconds, averaged.
//!
//! The shutter closes at the refresh, since nobody knows yet where the head goes from there. Times are one in each of
//! as many equal intervals, in bit-reversed order (van der Corput 1935), so that they are not coupled to the points of a
//! lens that are sampled along with them. What moves in the scene itself stays where the frame shows it.

use std::time::Duration;

/// A shutter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shutter {
    /// How long it is open.
    pub open: Duration,
    /// Instants.
    pub samples: usize,
}

impl Shutter {
    /// How long before it closes sample number `sample` of `count` is taken, in seconds.
    pub(super) fn before_secs(&self, sample: usize, count: usize) -> f64 {
        self.open.as_secs_f64() * (permuted(sample, count) as f64 + 0.5) / count as f64
    }
}

/// A permutation of the numbers below `count`: the rank of `sample` among them by their reversed bits.
fn permuted(sample: usize, count: usize) -> usize {
    let key = |number: usize| number.reverse_bits();
    (0..count).filter(|&other| key(other) < key(sample)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_interval_has_one_instant_and_all_are_in_the_past() {
        for samples in [1, 2, 5, 8, 16] {
            let shutter = Shutter { open: Duration::from_millis(10), samples };
            let mut times: Vec<f64> = (0..samples).map(|sample| shutter.before_secs(sample, samples)).collect();
            times.sort_by(f64::total_cmp);
            for (interval, time) in times.iter().enumerate() {
                assert!(
                    (time - 0.010 * (interval as f64 + 0.5) / samples as f64).abs() < 1e-12,
                    "{samples}: {times:?}"
                );
            }
        }
    }
}
