//! Sampling the environment in proportion to its brightness.
//!
//! Method: the environment is looked at on a latitude-longitude grid, in the space of the image where it is one,
//! so that cells are texels up to 4096 by 2048; a direction is drawn by the cell's luminance times its solid angle
//! (Pharr et al., 4th ed., 12.5), one in ten uniformly over the sphere. Radiance is bilinear between texels and a
//! cell's luminance a mean over nine of its points, so the density is not proportional to it, but no direction has
//! density zero and its figure is exact for the draw, which is all that weighting needs. Constant and black environments need no sampling: the
//! cosine draw at the surface is already as good. Cost: two binary searches per sample; the grid takes
//! 4 bytes per cell.

use super::lights::ALMOST_ONE;
use crate::scene::Environment;
use glam::{Mat3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Part of the samples that are uniform; guards against what lies between the grid's points.
const UNIFORM_PART: f32 = 0.1;
/// Cells around and from pole to pole, at most (32 MiB); the smallest lights of larger images share a cell.
const MAX_CELLS: (u32, u32) = (4096, 2048);
/// Cells for an environment that is a formula.
const SMOOTH_CELLS: (u32, u32) = (16, 32);

/// A density over directions in proportion to the environment's luminance.
#[derive(Debug)]
pub(crate) struct Surroundings {
    columns: usize,
    rows: usize,
    /// From world to the space of the grid.
    grid_from_world: Mat3,
    /// Sums of probability along each row, each row ending with 1.
    along_row: Vec<f32>,
    /// Sums of the probability of rows; the last is 1.
    over_rows: Vec<f32>,
}

impl Surroundings {
    /// `None` where drawing from the environment would gain nothing.
    pub(crate) fn new(environment: &Environment) -> Option<Surroundings> {
        let ((columns, rows), grid_from_world) = match environment {
            Environment::Black | Environment::Constant(_) => return None,
            Environment::Gradient { .. } => (SMOOTH_CELLS, Mat3::IDENTITY),
            Environment::Image { width, height, image_from_world, .. } => {
                ((*width.min(&MAX_CELLS.0), *height.min(&MAX_CELLS.1)), *image_from_world)
            }
        };
        let world_from_grid = grid_from_world.transpose();
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
                let luminance = luminance_of_cell(environment, &world_from_grid, (column, row), (columns, rows));
                sum += f64::from(luminance) * solid_angle;
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
        Some(Surroundings { columns, rows, grid_from_world, along_row, over_rows })
    }

    /// A direction and its density over solid angle.
    pub(crate) fn sample(&self, u: Vec2) -> (Vec3, f32) {
        let direction = if u.x < UNIFORM_PART {
            let height = 1.0 - 2.0 * u.y;
            direction_of(u.x / UNIFORM_PART, height)
        } else {
            let (row, down) = draw(&self.over_rows, u.y);
            let (column, along) = draw(self.row(row), ((u.x - UNIFORM_PART) / (1.0 - UNIFORM_PART)).min(ALMOST_ONE));
            // Uniform in solid angle within the cell.
            let heights = [row, row + 1].map(|edge| (PI * edge as f32 / self.rows as f32).cos());
            direction_of((column as f32 + along) / self.columns as f32, heights[0] + (heights[1] - heights[0]) * down)
        };
        let direction = (self.grid_from_world.transpose() * direction).normalize();
        (direction, self.pdf(direction))
    }

    /// Density over solid angle of drawing this direction.
    pub(crate) fn pdf(&self, direction_in_world: Vec3) -> f32 {
        let direction = self.grid_from_world * direction_in_world;
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

/// Mean luminance over points at the middle, near the corners and near the edges of a cell: with the texels beside
/// it, which reach into it.
fn luminance_of_cell(
    environment: &Environment,
    world_from_grid: &Mat3,
    (column, row): (usize, usize),
    (columns, rows): (usize, usize),
) -> f32 {
    const ACROSS: [f32; 3] = [0.1, 0.5, 0.9];
    let mut sum = 0.0;
    for y in ACROSS {
        let height = (PI * (row as f32 + y) / rows as f32).cos();
        for x in ACROSS {
            let direction = world_from_grid * direction_of((column as f32 + x) / columns as f32, height);
            // Rec. 709.
            sum += environment.radiance(direction).dot(Vec3::new(0.2126, 0.7152, 0.0722)).max(0.0);
        }
    }
    sum / (ACROSS.len() * ACROSS.len()) as f32
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
    use crate::stability::bound;

    fn sun(bright: f32) -> Environment {
        let mut texels = vec![[0.1; 3]; 32 * 16];
        texels[5 * 32 + 7] = [bright; 3];
        let image_from_world = Mat3::from_euler(glam::EulerRot::XYZ, 0.4, 1.2, -0.7);
        Environment::Image { width: 32, height: 16, texels, image_from_world }
    }

    /// The density is that of a texel: the brightest one is drawn with 9/10 of the light that falls into it, which
    /// can only be where the cells of the grid are the texels of a turned image.
    #[test]
    fn cells_are_texels_however_the_image_is_turned() {
        let environment = sun(1e5);
        let Environment::Image { image_from_world, .. } = &environment else { panic!() };
        let surroundings = Surroundings::new(&environment).unwrap();
        let middle = direction_of((7.5) / 32.0, (PI * 5.5 / 16.0).cos());
        let [top, bottom] = [5.0_f32, 6.0].map(|edge| (PI * edge / 16.0).cos());
        let probability = surroundings.pdf(image_from_world.transpose() * middle) * TAU / 32.0 * (top - bottom);
        // The bilinear peak keeps a quarter of its weight in each half: (3/4)^2 of it is within its own texel.
        assert!(probability > 0.45 && probability < 0.65, "{probability}");
    }

    /// The density integrates to 1 where it is drawn: the inverse density averages to the whole sphere.
    #[test]
    fn stability_sampling_of_surroundings() {
        let mut sphere = bound!("sampling", "solid angle of surroundings with a texel of 1e5, relative", 0.02);
        let mut light = bound!("sampling", "their irradiance off the sum over all directions, relative", 0.02);
        assert!(Surroundings::new(&Environment::Black).is_none(), "nothing is drawn of what is black");
        let gradient =
            Environment::Gradient { zenith: Vec3::new(0.2, 0.5, 2.0), horizon: Vec3::ONE, nadir: Vec3::ZERO };
        for environment in [sun(0.1), sun(1e5), gradient] {
            let surroundings = Surroundings::new(&environment).unwrap();
            let samples = 200_000;
            let (mut drawn, mut solid_angle, mut summed) = (Vec3::ZERO, 0.0, Vec3::ZERO);
            for index in 0..samples {
                let mut sampler = Sampler::new(9, 0, index);
                let (direction, pdf) = surroundings.sample(sampler.pair());
                assert!((direction.length() - 1.0).abs() < 1e-5 && pdf > 0.0 && pdf.is_finite());
                drawn += environment.radiance(direction) / pdf / samples as f32;
                solid_angle += f64::from(1.0 / pdf) / f64::from(samples);
                let u = Sampler::new(10, 0, index).pair();
                summed += environment.radiance(direction_of(u.x, 1.0 - 2.0 * u.y)) * (2.0 * TAU / samples as f32);
            }
            let error = ((drawn - summed) / summed).abs().max_element();
            light.see(error.into(), format!("{drawn} {summed}"));
            sphere.see((solid_angle / f64::from(2.0 * TAU) - 1.0).abs(), solid_angle);
        }
    }

    #[test]
    fn what_is_the_same_everywhere_is_not_sampled() {
        assert!(Surroundings::new(&Environment::Black).is_none());
        assert!(Surroundings::new(&Environment::Constant(Vec3::ONE)).is_none());
        assert!(Surroundings::new(&sun(0.1)).is_some());
    }
}
