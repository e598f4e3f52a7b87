//! How samples are spread: exact percentiles of all samples, not of a histogram.
//!
//! Between two ranks the value is interpolated linearly (Hyndman and Fan 1996, definition 7, as numpy and R
//! do). Samples are sorted first, so neither percentiles nor mean depend on their order. O(n log n).

use super::MeasureError;
use serde::{Deserialize, Serialize};

/// Spread of a set of samples, in the unit of the samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
    /// Smallest.
    pub min: f64,
    /// Mean.
    pub mean: f64,
    /// Number of samples.
    pub count: u64,
}

impl Percentiles {
    /// Percentiles of `samples`.
    ///
    /// # Errors
    /// No samples, or one that is not finite.
    pub fn from_samples(samples: &[f64]) -> Result<Percentiles, MeasureError> {
        if let Some((index, &value)) = samples.iter().enumerate().find(|(_, value)| !value.is_finite()) {
            return Err(MeasureError::NotFinite { index, value });
        }
        let mut sorted = samples.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let (Some(&min), Some(&max)) = (sorted.first(), sorted.last()) else {
            return Err(MeasureError::NoSamples);
        };
        let at = |fraction: f64| {
            let rank = fraction * (sorted.len() - 1) as f64;
            let below = rank.floor() as usize;
            let above = (below + 1).min(sorted.len() - 1);
            sorted[below] + (sorted[above] - sorted[below]) * (rank - below as f64)
        };
        Ok(Percentiles {
            p50: at(0.50),
            p95: at(0.95),
            p99: at(0.99),
            max,
            min,
            mean: sorted.iter().sum::<f64>() / sorted.len() as f64,
            count: sorted.len() as u64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn percentiles_of_one_to_a_hundred_and_one() {
        let samples: Vec<f64> = (1..=101).rev().map(f64::from).collect();
        let spread = Percentiles::from_samples(&samples).unwrap();
        assert_eq!((spread.p50, spread.p95, spread.p99), (51.0, 96.0, 100.0));
        assert_eq!((spread.min, spread.max, spread.mean, spread.count), (1.0, 101.0, 51.0, 101));
    }

    #[test]
    fn one_sample_is_every_percentile() {
        let spread = Percentiles::from_samples(&[3.5]).unwrap();
        assert_eq!((spread.p50, spread.p99, spread.max, spread.mean), (3.5, 3.5, 3.5, 3.5));
    }

    #[test]
    fn nothing_and_no_number_are_refused() {
        assert_eq!(Percentiles::from_samples(&[]), Err(MeasureError::NoSamples));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(matches!(Percentiles::from_samples(&[1.0, bad]), Err(MeasureError::NotFinite { index: 1, .. })));
        }
    }

    proptest! {
        #[test]
        fn the_order_of_samples_does_not_matter(mut samples in prop::collection::vec(-1e6..1e6_f64, 1..200)) {
            let spread = Percentiles::from_samples(&samples).unwrap();
            samples.reverse();
            prop_assert_eq!(spread, Percentiles::from_samples(&samples).unwrap());
            let rising = [spread.min, spread.p50, spread.p95, spread.p99, spread.max];
            prop_assert!(rising.windows(2).all(|pair| pair[0] <= pair[1]));
        }
    }
}
