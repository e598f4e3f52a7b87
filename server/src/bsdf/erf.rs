//! The error function and its inverse in f32, for Beckmann facets.
//!
//! Source: Abramowitz and Stegun 1964, 7.1.26 (off by 1.5e-7 at most), and Giles 2012, "Approximating the
//! erfinv function", table 5 (off by some 1e-7 of the value).

/// 2/sqrt(pi) times the integral of exp(-t^2) from 0 to x.
pub(crate) fn erf(x: f32) -> f32 {
    const A: [f32; 5] = [0.254_829_6, -0.284_496_72, 1.421_413_8, -1.453_152_1, 1.061_405_4];
    let size = x.abs();
    let t = 1.0 / (1.0 + 0.327_591_1 * size);
    let polynomial = t * (A[0] + t * (A[1] + t * (A[2] + t * (A[3] + t * A[4]))));
    (1.0 - polynomial * (-size * size).exp()).copysign(x)
}

/// The `x` whose [`erf`] is `y`, for `y` between -1 and 1; at the ends what rounding makes of it, finite.
pub(crate) fn inverse_erf(y: f32) -> f32 {
    const INNER: [f32; 9] = [
        2.810_226_4e-8,
        3.432_739_4e-7,
        -3.523_387_7e-6,
        -4.391_506_5e-6,
        2.185_808_7e-4,
        -1.253_725_1e-3,
        -4.177_681_6e-3,
        0.246_640_73,
        1.501_409_4,
    ];
    const OUTER: [f32; 9] = [
        -2.002_142_6e-4,
        1.009_505_6e-4,
        1.349_343_2e-3,
        -3.673_428_4e-3,
        5.739_507_7e-3,
        -7.622_461_3e-3,
        9.438_870_5e-3,
        1.001_674,
        2.832_976_8,
    ];
    let y = y.clamp(-1.0 + f32::EPSILON, 1.0 - f32::EPSILON);
    let w = -((1.0 - y) * (1.0 + y)).ln();
    let (coefficients, w) = if w < 5.0 { (INNER, w - 2.5) } else { (OUTER, w.sqrt() - 3.0) };
    coefficients.into_iter().fold(0.0, |sum, coefficient| sum * w + coefficient) * y
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The series, which converges everywhere.
    fn erf_of_series(x: f64) -> f64 {
        let (mut term, mut sum) = (x, x);
        for n in 1..200 {
            term *= -x * x / f64::from(n);
            sum += term / f64::from(2 * n + 1);
        }
        sum * 2.0 / std::f64::consts::PI.sqrt()
    }

    #[test]
    fn it_is_the_series_and_its_inverse() {
        for step in -350..=350 {
            let x = step as f32 / 100.0;
            // 1.5e-7 by the source and two roundings.
            assert!((f64::from(erf(x)) - erf_of_series(f64::from(x))).abs() < 3e-7, "{x}");
            let y = erf_of_series(f64::from(x)) as f32;
            // A rounding of y is this much in x.
            let slack = 1.2e-7 * 0.5 * std::f32::consts::PI.sqrt() * (x * x).exp() + 5e-7 * x.abs();
            assert!((inverse_erf(y) - x).abs() <= slack, "{x}: {}", inverse_erf(y));
        }
        assert!(inverse_erf(1.0).is_finite() && inverse_erf(-1.0).is_finite());
    }
}
