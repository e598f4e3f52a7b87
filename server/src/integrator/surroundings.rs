//! Sampling the environment in proportion to its brightness.
//!
//! Method: the environment is looked at on a latitude-longitude grid; a direction is drawn by the cell's
//! luminance times its solid angle (Pharr et al., 4th ed., 12.5), one in ten uniformly over the sphere, so
//! that nothing the grid misses has density zero. Constant and black environments need no sampling: the
//! cosine draw at the surface is already as good. Cost: two binary searches per sample; the grid takes
//! 4 bytes per cell.

use crate::scene::Environment;
use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Part of the samples that are uniform; guards against what lies between the grid's points.
const UNIFORM_PART: f32 = 0.1;
/// Cells around and from pole to pole, at most; the smallest lights of larger images share a cell.
const MAX_CELLS: (u32, u32) = (1024, 512);
/// Cells for an environment that is a formula.
const SMOOTH_CELLS: (u32, u32) = (16, 32);

/// A density over directions in proportion to the environment's luminance.
#[derive(Debug)]
pub(crate) struct Surroundings {
    columns: usize,
    rows: usize,
    /// Sums of probability along each row, each row ending with 1.
    along_row: Vec<f32>,
    /// Sums of the probability of rows; the last is 1.
    over_rows: Vec<f32>,
}

impl Surroundings {
    /// `None` where drawing from the environment would gain nothing.
    pub(crate) fn new(environment: &Environment) -> Option<Surroundings> {
        let (columns, rows) = match environment {
            Environment::Black | Environment::Constant(_) => return None,
            Environment::Gradient { .. } => SMOOTH_CELLS,
            Environment::Image { width, height, .. } => (*width.min(&MAX_CELLS.0), *height.min(&MAX_CELLS.1)),
        };
        let (columns, rows) = (columns.max(1) as usize, rows.max(1) as usize);
        let mut along_row = Vec::with_capacity(columns * rows);
        let mut over_rows = Vec::with_capacity(rows);
        let mut total = 0.0_f64;
        for row in 0..rows {
            // Solid angle of a cell, up to a constant: what matters is the part of the whole.
            let (top, bottom) = (PI * row as f32 / rows as f32, PI * (row + 1) as f32 / rows as f32);
            let solid_angle = f64::from(top.cos()) - f64::from(bottom.cos());
            let mut sum = 0.0_f64;
            let start = along_row.len();
            for column in 0..columns {
                sum += f64::from(luminance_of_cell(environment, column, row, columns, rows)) * solid_angle;
                along_row.push(sum as f32);
            }
            normalise(&mut along_row[start..], sum);
            total += sum;
            over_rows.push(total as f32);
        }
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        normalise(&mut over_rows, total);
        Some(Surroundings { columns, rows, along_row, over_rows })
    }

    /// A direction and its density over solid angle.
    pub(crate) fn sample(&self, choice: f32, u: Vec2) -> (Vec3, f32) {
        let direction = if choice < UNIFORM_PART {
            let height = 1.0 - 2.0 * u.y;
            direction_of(u.x, height)
        } else {
            let (row, down) = draw(&self.over_rows, u.y);
            let (column, along) = draw(self.row(row), u.x);
            // Uniform in solid angle within the cell.
            let heights = [row, row + 1].map(|edge| (PI * edge as f32 / self.rows as f32).cos());
            direction_of((column as f32 + along) / self.columns as f32, heights[0] + (heights[1] - heights[0]) * down)
        };
        (direction, self.pdf(direction))
    }

    /// Density over solid angle of drawing this direction.
    pub(crate) fn pdf(&self, direction: Vec3) -> f32 {
        let around = direction.x.atan2(-direction.z) / TAU + 0.5;
        let down = direction.y.clamp(-1.0, 1.0).acos() / PI;
        let column = ((around * self.columns as f32) as usize).min(self.columns - 1);
        let row = ((down * self.rows as f32) as usize).min(self.rows - 1);
        let [top, bottom] = [row, row + 1].map(|edge| (PI * edge as f32 / self.rows as f32).cos());
        let solid_angle = TAU / self.columns as f32 * (top - bottom);
        let probability = part(&self.over_rows, row) * part(self.row(row), column);
        UNIFORM_PART / (2.0 * TAU) + (1.0 - UNIFORM_PART) * probability / solid_angle
    }

    fn row(&self, row: usize) -> &[f32] {
        &self.along_row[row * self.columns..(row + 1) * self.columns]
    }
}

/// The direction at a fraction of the turn from behind (+Z) over the left, with this sine of elevation.
fn direction_of(around: f32, height: f32) -> Vec3 {
    let radius = (1.0 - height * height).max(0.0).sqrt();
    let (sine, cosine) = (TAU * (around - 0.5)).sin_cos();
    Vec3::new(radius * sine, height, -radius * cosine)
}

/// Mean luminance at the centre and near the corners of a cell.
fn luminance_of_cell(environment: &Environment, column: usize, row: usize, columns: usize, rows: usize) -> f32 {
    let points = [(0.5, 0.5), (0.1, 0.1), (0.9, 0.1), (0.1, 0.9), (0.9, 0.9)];
    let luminance = points.map(|(x, y)| {
        let height = (PI * (row as f32 + y) / rows as f32).cos();
        let radiance = environment.radiance(direction_of((column as f32 + x) / columns as f32, height));
        // Rec. 709.
        radiance.dot(Vec3::new(0.2126, 0.7152, 0.0722)).max(0.0)
    });
    luminance.iter().sum::<f32>() / points.len() as f32
}

fn normalise(cumulative: &mut [f32], total: f64) {
    let count = cumulative.len();
    for (index, sum) in cumulative.iter_mut().enumerate() {
        let whole = index + 1 == count;
        *sum = if whole || total <= 0.0 { (index + 1) as f32 / count as f32 } else { (f64::from(*sum) / total) as f32 };
    }
}

/// The entry that `choice` falls into, and where within it, from 0 to 1.
fn draw(cumulative: &[f32], choice: f32) -> (usize, f32) {
    let index = cumulative.partition_point(|&sum| sum <= choice).min(cumulative.len() - 1);
    let start = if index == 0 { 0.0 } else { cumulative[index - 1] };
    (index, ((choice - start) / part(cumulative, index)).clamp(0.0, 1.0))
}

/// Probability of an entry.
fn part(cumulative: &[f32], index: usize) -> f32 {
    cumulative[index] - if index == 0 { 0.0 } else { cumulative[index - 1] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::sampler::Sampler;

    fn sun(bright: f32) -> Environment {
        let mut texels = vec![[0.1; 3]; 32 * 16];
        texels[5 * 32 + 7] = [bright; 3];
        Environment::Image { width: 32, height: 16, texels, rotation_rad: 0.4 }
    }

    /// numerics: sampling; one bright texel of 1e5, black environment; the density integrates to 1.
    #[test]
    fn irradiance_by_sampling_equals_the_sum_over_all_directions() {
        let gradient =
            Environment::Gradient { zenith: Vec3::new(0.2, 0.5, 2.0), horizon: Vec3::ONE, nadir: Vec3::ZERO };
        for environment in [sun(0.1), sun(1e5), gradient] {
            let surroundings = Surroundings::new(&environment).unwrap();
            let samples = 200_000;
            let (mut drawn, mut solid_angle, mut summed) = (Vec3::ZERO, 0.0, Vec3::ZERO);
            for index in 0..samples {
                let mut sampler = Sampler::new(9, 0, index);
                let (direction, pdf) = surroundings.sample(sampler.value(), sampler.pair());
                assert!((direction.length() - 1.0).abs() < 1e-5 && pdf > 0.0 && pdf.is_finite());
                drawn += environment.radiance(direction) / pdf / samples as f32;
                solid_angle += f64::from(1.0 / pdf) / f64::from(samples);
                let u = Sampler::new(10, 0, index).pair();
                summed += environment.radiance(direction_of(u.x, 1.0 - 2.0 * u.y)) * (2.0 * TAU / samples as f32);
            }
            let error = ((drawn - summed) / summed).abs().max_element();
            assert!(error < 0.02, "{drawn} {summed}");
            assert!((solid_angle / f64::from(2.0 * TAU) - 1.0).abs() < 0.02, "{solid_angle}");
        }
    }

    #[test]
    fn what_is_the_same_everywhere_is_not_sampled() {
        assert!(Surroundings::new(&Environment::Black).is_none());
        assert!(Surroundings::new(&Environment::Constant(Vec3::ONE)).is_none());
        assert!(Surroundings::new(&sun(0.1)).is_some());
    }
}
