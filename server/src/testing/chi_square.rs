//! Does a sampler of directions follow its own density?
//!
//! Method: Pearson's chi-square test over cells of the sphere, as Mitsuba 3 tests its samplers. The cells are polar
//! about an axis, with rings that shrink towards it, so that a lobe is resolved however narrow it is. What a cell
//! expects is integrated adaptively from the density. Cells that expect too little are pooled. A draw that
//! gives no direction is a cell of its own, which expects what the density lacks to 1.

use glam::{DVec3, Vec3};
use std::f64::consts::{PI, TAU};

/// Rings within [`INNER`], from [`INNERMOST`] on growing by a constant factor, and in each half of the sphere
/// beyond, equally wide.
const RINGS: [usize; 2] = [18, 8];
const INNERMOST: f64 = 1e-5;
const INNER: f64 = 0.1;
const SECTORS: usize = 16;
/// Below it a count is no normal variable.
const LEAST_EXPECTED: f64 = 5.0;
/// Error allowed in the integral over a cell: 0.1 of 100,000 samples.
const TOLERANCE: f64 = 1e-6;

/// What came out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outcome {
    /// How far chi-square is above what is expected, in standard deviations of a normal variable.
    pub(crate) z: f64,
    /// Integral of the density over the sphere.
    pub(crate) integral: f64,
    /// Of the cell that differs most: angle from the axis, azimuth, expected count, count.
    #[allow(dead_code, reason = "for messages")]
    pub(crate) worst: [f64; 4],
}

/// Compares `samples` draws with the density. Narrow lobes must lie about `axis`.
pub(crate) fn compare(
    axis: Vec3,
    samples: u32,
    mut draw: impl FnMut(u32) -> Option<Vec3>,
    pdf: impl Fn(Vec3) -> f32,
) -> Outcome {
    let frame = Polar::about(axis);
    let edges = ring_edges();
    let rings = edges.len() - 1;
    let mut counts = vec![0_u32; rings * SECTORS];
    let mut nowhere = 0;
    for index in 0..samples {
        match draw(index) {
            None => nowhere += 1,
            Some(direction) => {
                let (theta, phi) = frame.angles(direction);
                let ring = edges.partition_point(|&edge| edge <= theta).clamp(1, rings) - 1;
                let sector = ((phi / TAU * SECTORS as f64) as usize).min(SECTORS - 1);
                counts[ring * SECTORS + sector] += 1;
            }
        }
    }
    let mut cells = Vec::with_capacity(counts.len() + 1);
    let mut integral = 0.0;
    let (mut worst, mut most) = ([0.0; 4], 0.0);
    for (index, &count) in counts.iter().enumerate() {
        let (ring, sector) = (index / SECTORS, index % SECTORS);
        let phi = [sector, sector + 1].map(|sector| sector as f64 / SECTORS as f64 * TAU);
        let theta = [edges[ring], edges[ring + 1]];
        let density = |theta: f64, phi: f64| f64::from(pdf(frame.direction(theta, phi))) * theta.sin();
        let expected = integrate(&density, theta, phi, gauss(&density, theta, phi), TOLERANCE, 0);
        integral += expected;
        let (expected, count) = (expected * f64::from(samples), f64::from(count));
        let error = (count - expected).powi(2) / expected.max(1.0);
        if error > most {
            (worst, most) = ([theta[0], phi[0], expected, count], error);
        }
        cells.push((expected, count));
    }
    cells.push(((1.0 - integral).max(0.0) * f64::from(samples), f64::from(nowhere)));
    Outcome { z: normal_of(&mut cells), integral, worst }
}

/// Integral of a density over the sphere.
pub(crate) fn integral(axis: Vec3, pdf: impl Fn(Vec3) -> f32) -> f64 {
    compare(axis, 0, |_| None, pdf).integral
}

fn ring_edges() -> Vec<f64> {
    let [inner, outer] = RINGS;
    let mut edges = vec![0.0];
    edges.extend((0..=inner).map(|ring| INNERMOST * (INNER / INNERMOST).powf(ring as f64 / inner as f64)));
    let half = 0.5 * PI;
    edges.extend((1..=outer).map(|ring| INNER + (half - INNER) * ring as f64 / outer as f64));
    edges.extend((1..=outer).map(|ring| half + half * ring as f64 / outer as f64));
    edges
}

/// Chi-square as a normal variable (Wilson and Hilferty 1931).
fn normal_of(cells: &mut [(f64, f64)]) -> f64 {
    cells.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut chi2, mut used) = (0.0, 0);
    let (mut expected, mut count) = (0.0, 0.0);
    for (index, cell) in cells.iter().enumerate() {
        expected += cell.0;
        count += cell.1;
        let last = index + 1 == cells.len();
        if expected >= LEAST_EXPECTED || last {
            if expected < LEAST_EXPECTED && count <= expected + 5.0 + 5.0 * expected.sqrt() {
                continue;
            }
            chi2 += (count - expected).powi(2) / expected.max(1e-3);
            used += 1;
            (expected, count) = (0.0, 0.0);
        }
    }
    let freedom = f64::from((used - 1).max(1));
    let spread = 2.0 / (9.0 * freedom);
    ((chi2 / freedom).cbrt() - (1.0 - spread)) / spread.sqrt()
}

/// Gauss's rule of three points along both angles.
fn gauss(f: &impl Fn(f64, f64) -> f64, theta: [f64; 2], phi: [f64; 2]) -> f64 {
    let points = [(-0.6_f64.sqrt(), 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.6_f64.sqrt(), 5.0 / 9.0)];
    let at = |range: [f64; 2], x: f64| 0.5 * (range[0] + range[1]) + 0.5 * (range[1] - range[0]) * x;
    let mut sum = 0.0;
    for (x, wx) in points {
        for (y, wy) in points {
            sum += wx * wy * f(at(theta, x), at(phi, y));
        }
    }
    sum * 0.25 * (theta[1] - theta[0]) * (phi[1] - phi[0])
}

fn integrate(
    f: &impl Fn(f64, f64) -> f64,
    theta: [f64; 2],
    phi: [f64; 2],
    whole: f64,
    tolerance: f64,
    depth: u32,
) -> f64 {
    /// A jump, as at a horizon, is a line through 2^6 of a cell's parts then: 1e-3 of what the cell holds.
    const DEEPEST: u32 = 7;
    let middle = |range: [f64; 2]| 0.5 * (range[0] + range[1]);
    let halves = |range: [f64; 2]| [[range[0], middle(range)], [middle(range), range[1]]];
    let mut parts = [0.0; 4];
    let quarters = halves(theta).into_iter().flat_map(|theta| halves(phi).map(|phi| (theta, phi)));
    for (part, (theta, phi)) in parts.iter_mut().zip(quarters.clone()) {
        *part = gauss(f, theta, phi);
    }
    let sum: f64 = parts.iter().sum();
    if depth >= DEEPEST || (depth >= 1 && (sum - whole).abs() <= tolerance) {
        return sum;
    }
    parts
        .into_iter()
        .zip(quarters)
        .map(|(part, (theta, phi))| integrate(f, theta, phi, part, 0.5 * tolerance, depth + 1))
        .sum()
}

/// Polar angles about an axis.
struct Polar {
    x: DVec3,
    y: DVec3,
    z: DVec3,
}

impl Polar {
    fn about(axis: Vec3) -> Polar {
        let z = axis.as_dvec3().normalize();
        let (x, y) = z.any_orthonormal_pair();
        Polar { x, y, z }
    }

    fn direction(&self, theta: f64, phi: f64) -> Vec3 {
        let (sine, cosine) = theta.sin_cos();
        (sine * (phi.cos() * self.x + phi.sin() * self.y) + cosine * self.z).as_vec3()
    }

    fn angles(&self, direction: Vec3) -> (f64, f64) {
        let direction = direction.as_dvec3();
        let (x, y, z) = (direction.dot(self.x), direction.dot(self.y), direction.dot(self.z));
        (x.hypot(y).atan2(z), y.atan2(x).rem_euclid(TAU))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bsdf::{pdf_cosine, sample_cosine};
    use crate::integrator::sampler::Sampler;

    #[test]
    fn a_sampler_passes_with_its_own_density_and_fails_with_another() {
        let normal = Vec3::new(0.3, -0.5, 0.8).normalize();
        let draw = |index| Some(sample_cosine(normal, Sampler::new(5, u64::from(index), 0).pair()));
        for axis in [normal, Vec3::X] {
            let own = compare(axis, 50_000, draw, |direction| pdf_cosine(normal, direction));
            assert!(own.z < 4.0 && (own.integral - 1.0).abs() < 1e-3, "{own:?}");
            let other = (normal + Vec3::splat(0.02)).normalize();
            assert!(compare(axis, 50_000, draw, |direction| pdf_cosine(other, direction)).z > 6.0);
            assert!(compare(axis, 50_000, draw, |direction| 1.1 * pdf_cosine(normal, direction)).z > 6.0);
        }
    }
}
