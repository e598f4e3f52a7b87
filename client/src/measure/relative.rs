//! Relative squared error of linear radiance: what a path tracer's noise and bias are told in.
//!
//! The squared difference of a pixel over the square of what it should be, so that dark places count as bright ones do.
//! Converged pictures have noise of their own, which the square would add to the error. So the two factors of the square
//! are differences to two independent references, `E[(x - a)(x - b)]`, whose noise cancels; where what is compared is
//! itself random and only its bias is asked for, two of it, each with a reference of its own seed, do the same.

use super::MeasureError;
use glam::Vec3;

/// Added to the square of a reference: a tenth of an ordinary wall's radiance, below which differences are not seen. Without
/// it black pixels would divide by nothing.
const DARK: f32 = 0.01;

/// Mean over pixels and channels of `(x - a)(y - b) / (m^2 + 0.01)`, where `x, y` are `shown`, `a, b` the `references` and `m` their
/// mean. For the whole error of one picture, it is shown twice.
///
/// # Errors
/// Pictures of different size, or without pixels.
pub fn relative_mse(shown: [&[Vec3]; 2], references: [&[Vec3]; 2]) -> Result<f64, MeasureError> {
    let expected = references[0].len();
    if let Some(other) = [references[1], shown[0], shown[1]].into_iter().find(|other| other.len() != expected) {
        return Err(MeasureError::SizeMismatch { expected: expected.to_string(), found: other.len().to_string() });
    }
    if expected == 0 {
        return Err(MeasureError::NoPixels);
    }
    let mut sum = 0.0;
    for pixel in 0..expected {
        let [x, y] = shown.map(|picture| picture[pixel]);
        let [a, b] = references.map(|picture| picture[pixel]);
        let mean = 0.5 * (a + b);
        let error = (x - a) * (y - b) / (mean * mean + DARK);
        sum += f64::from(error.element_sum()) / 3.0;
    }
    Ok(sum / expected as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_pcg::Pcg32;
    use rand_pcg::rand_core::Rng;

    /// Radiance 1 with uniform noise of a variance in each channel.
    fn noisy(seed: u64, variance: f32) -> Vec<Vec3> {
        let mut random = Pcg32::new(seed, 0);
        let half_width = (3.0 * variance).sqrt();
        let mut value = || 1.0 + half_width * (random.next_u32() as f32 / u32::MAX as f32 * 2.0 - 1.0);
        (0..PIXELS).map(|_| Vec3::new(value(), value(), value())).collect()
    }

    const PIXELS: usize = 20_000;

    #[test]
    fn the_noise_of_references_does_not_count() {
        let (variance, of_reference) = (0.04, 0.01);
        let picture = noisy(1, variance);
        let [a, b] = [2, 3].map(|seed| noisy(seed, of_reference));
        let error = relative_mse([&picture, &picture], [&a, &b]).unwrap();
        // The variance, but for the square of the references' mean: E[1 / m^2] is 1 + 3 Var m, and 0.01 is added. The
        // scatter of 60 000 products, each of about twice the variance, is a 120th of it; five of that.
        let expected = f64::from(variance) / 1.01 * (1.0 + 3.0 * f64::from(of_reference) / 2.0);
        assert!((error / expected - 1.0).abs() < 5.0 / 120.0 + 0.01, "{error} {expected}");
        // With one reference for both its variance is there, too: a quarter more.
        let naive = relative_mse([&picture, &picture], [&a, &a]).unwrap();
        assert!(naive > 1.15 * error, "{naive} {error}");
    }

    #[test]
    fn a_bias_is_its_square() {
        let grey = |value: f32| vec![Vec3::splat(value); 10];
        let error = relative_mse([&grey(0.9), &grey(0.9)], [&grey(1.0), &grey(1.0)]).unwrap();
        assert!((error - 0.01 / 1.01).abs() < 1e-7, "{error}");
    }

    #[test]
    fn pictures_that_do_not_fit_are_refused() {
        let grey = |count: usize| vec![Vec3::ONE; count];
        assert!(relative_mse([&grey(2), &grey(2)], [&grey(2), &grey(3)]).is_err());
        assert_eq!(relative_mse([&[], &[]], [&[], &[]]), Err(MeasureError::NoPixels));
    }
}
