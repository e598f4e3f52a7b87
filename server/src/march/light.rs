//! The light in a medium: what arrives at each voxel from all directions, in the mean.
//!
//! Radiance that a medium scatters isotropically is its albedo times this mean, whatever the view, so it is computed for
//! a grid of voxels and interpolated. Every voxel near matter is sampled by the path tracer, all orders of scattering
//! included, round after round; the mean of the rounds is what rays see. Voxels without matter know nothing and weigh
//! nothing.
//!
//! Of few samples the means are smoothed, the less the more there are.
//!
//! Limits: shadows and light fronts within matter are as sharp as the voxels. Cost: one path per sample.

use crate::counters::RayCounts;
use crate::integrator::PathTracer;
use crate::integrator::sampler::Sampler;
use crate::volume::grid::between;
use crate::volume::{Matter, Medium};
use glam::{Affine3A, DVec3, Vec3, Vec4};
use rayon::prelude::*;

/// Most voxels along an axis.
const MOST_VOXELS: u32 = 64;
/// Voxels along an axis of a medium without a grid.
const VOXELS_OF_HOMOGENEOUS: u32 = 32;

/// Samples of a voxel. In f64: a session adds to it for hours, and in f32 what comes after one bright sample is lost.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    radiance: DVec3,
    samples: u32,
}

impl Sum {
    /// Adds a sample; one that is no number counts as black.
    fn add(&mut self, radiance: Vec3) {
        self.radiance += if radiance.is_finite() { radiance.as_dvec3() } else { DVec3::ZERO };
        self.samples = self.samples.saturating_add(1);
    }

    fn mean(&self) -> Vec3 {
        (self.radiance / f64::from(self.samples.max(1))).as_vec3()
    }
}

/// Mean incident radiance per voxel.
#[derive(Clone, Debug)]
pub struct LightGrid {
    size: [u32; 3],
    unit_from_world: Affine3A,
    /// Mean incident radiance, and 1 where it is known, else 0: as sampled, and as rays see it.
    means: Vec<Vec4>,
    values: Vec<Vec4>,
    scratch: Vec<Vec4>,
    /// Voxels that are sampled.
    occupied: Vec<u32>,
    /// Of each of them, the sum of its samples and their number.
    sums: Vec<Sum>,
    /// The one to be sampled next, which has the fewest.
    next: usize,
}

impl LightGrid {
    /// For a medium within bounds in world; without bounds no voxel is sampled.
    pub(super) fn new(medium: &Medium, bounds: Option<(Vec3, Vec3)>) -> LightGrid {
        let (size, unit_from_world) = match &medium.matter {
            Matter::Density { density: grid, unit_from_world, .. }
            | Matter::Classified { values: grid, unit_from_world, .. } => (coarser(grid.size()), *unit_from_world),
            Matter::Homogeneous { .. } => {
                let (low, high) = bounds.unwrap_or((Vec3::ZERO, Vec3::ONE));
                let extent = (high - low).max(Vec3::splat(1e-6));
                let unit_from_world = Affine3A::from_scale(extent.recip()) * Affine3A::from_translation(-low);
                let voxels = |part: f32| ((part * VOXELS_OF_HOMOGENEOUS as f32).ceil() as u32).max(1);
                ((extent / extent.max_element()).to_array().map(voxels), unit_from_world)
            }
        };
        let dark = vec![Vec4::ZERO; size.iter().map(|&count| count as usize).product()];
        let mut grid = LightGrid {
            size,
            unit_from_world,
            means: dark.clone(),
            values: dark,
            scratch: Vec::new(),
            occupied: Vec::new(),
            sums: Vec::new(),
            next: 0,
        };
        if bounds.is_some() {
            let voxels = 0..grid.values.len() as u32;
            grid.occupied = voxels.into_par_iter().filter(|&voxel| grid.is_near_matter(medium, voxel)).collect();
            grid.sums = vec![Sum::default(); grid.occupied.len()];
        }
        grid
    }

    /// Number of voxels that are sampled.
    pub fn occupied(&self) -> usize {
        self.occupied.len()
    }

    /// Edge of a voxel along each axis of the unit cube.
    pub(super) fn voxel(&self) -> Vec3 {
        Vec3::from_array(self.size.map(|count| 1.0 / count as f32))
    }

    /// To the unit cube of the grid.
    pub(super) fn unit_from_world(&self) -> &Affine3A {
        &self.unit_from_world
    }

    /// Forgets all samples; what is known stays until there are new ones. Sampling goes on where it was: where something moves
    /// in every frame, all voxels have their turn all the same.
    pub(super) fn forget(&mut self) {
        self.sums.fill(Sum::default());
    }

    /// Adds so many samples, voxel by voxel from where the last call ended. The result depends on their number alone.
    pub(super) fn refine(&mut self, tracer: &PathTracer, medium: u32, samples: usize, max_depth: u32, seed: u64) {
        if self.occupied.is_empty() {
            return;
        }
        let (size, voxel_extent) = (self.size, self.voxel());
        let world_from_unit = self.unit_from_world.inverse();
        let mut left = samples;
        while left > 0 {
            let range = self.next..(self.next + left).min(self.occupied.len());
            left -= range.len();
            let voxels = &self.occupied[range.clone()];
            self.sums[range.clone()].par_iter_mut().zip(voxels).for_each(|(sum, &voxel)| {
                let mut sampler = Sampler::new(seed, u64::from(voxel), sum.samples);
                let jitter = sampler.pair().extend(sampler.value()) - 0.5;
                let centre = centre(size, voxel);
                let mut counts = RayCounts::default();
                let unit = (centre + jitter * voxel_extent).clamp(Vec3::splat(1e-4), Vec3::splat(1.0 - 1e-4));
                let point = world_from_unit.transform_point3(unit);
                let incident = tracer.incident_mean(point, medium, max_depth, &mut sampler, &mut counts);
                sum.add(incident);
            });
            for (sum, &voxel) in self.sums[range.clone()].iter().zip(voxels) {
                self.means[voxel as usize] = sum.mean().extend(1.0);
            }
            self.next = range.end % self.occupied.len();
        }
        self.smooth();
    }

    /// Makes what rays see of the means: as they are, or smoothed while there are few samples. Noise would not only be seen,
    /// it would take bits and layers, too.
    fn smooth(&mut self) {
        self.values.copy_from_slice(&self.means);
        let [nx, ny, nz] = self.size.map(|count| count as usize);
        let axes = [(1, nx), (nx, ny), (nx * ny, nz)];
        let fewest = self.sums.get(self.next).map_or(0, |sum| sum.samples);
        for _ in 0..passes(fewest) {
            for (stride, count) in axes {
                let LightGrid { values, scratch, .. } = self;
                scratch.resize(values.len(), Vec4::ZERO);
                let from = &values[..];
                scratch.par_iter_mut().enumerate().with_min_len(4096).for_each(|(voxel, value)| {
                    let at = voxel / stride % count;
                    let before = if at > 0 { from[voxel - stride] } else { Vec4::ZERO };
                    let behind = if at + 1 < count { from[voxel + stride] } else { Vec4::ZERO };
                    // What is not known weighs nothing, and stays unknown if its neighbours are.
                    let sum = before + 2.0 * from[voxel] + behind;
                    *value = if sum.w > 0.0 { sum / sum.w } else { Vec4::ZERO };
                });
                std::mem::swap(values, scratch);
            }
        }
    }

    /// Mean incident radiance at a point of the unit cube, times how much of it is known, and, as w, that.
    #[inline]
    pub(super) fn sample(&self, unit: Vec3) -> Vec4 {
        let [nx, ny, nz] = self.size;
        let ((x, to_x, u), (y, to_y, v), (z, to_z, w)) =
            (between(unit.x, nx), between(unit.y, ny), between(unit.z, nz));
        let row = |y: usize, z: usize| {
            let start = (z * ny as usize + y) * nx as usize;
            let row = &self.values[start..start + nx as usize];
            row[x] + u * (row[x + to_x] - row[x])
        };
        let slice = |z: usize| {
            let low = row(y, z);
            low + v * (row(y + to_y, z) - low)
        };
        let low = slice(z);
        low + w * (slice(z + to_z) - low)
    }

    /// Whether a ray may want to know the light of a voxel.
    fn is_near_matter(&self, medium: &Medium, voxel: u32) -> bool {
        if matches!(medium.matter, Matter::Homogeneous { .. }) {
            return true;
        }
        let (centre, extent) = (centre(self.size, voxel), self.voxel());
        // Half a voxel more than its own reach: what lies between these points is found by their neighbours.
        const STEPS: [f32; 5] = [-1.0, -0.5, 0.0, 0.5, 1.0];
        STEPS.iter().any(|z| {
            STEPS.iter().any(|y| {
                STEPS.iter().any(|x| {
                    let unit = centre + Vec3::new(*x, *y, *z) * extent;
                    medium.at_unit(unit.clamp(Vec3::ZERO, Vec3::ONE)).extinction.max_element() > 0.0
                })
            })
        })
    }
}

#[cfg(test)]
impl LightGrid {
    /// Mean incident radiance per voxel as rays see it, and whether it is known.
    pub(super) fn values(&self) -> &[Vec4] {
        &self.values
    }

    /// Smooths these means as if they were of few samples.
    pub(super) fn smooth_of(&mut self, mean: impl Fn(usize) -> Vec4) {
        self.means.iter_mut().enumerate().for_each(|(voxel, value)| *value = mean(voxel));
        self.forget();
        self.smooth();
    }
}

/// How often means of so many samples are smoothed by the binomial (1 2 1) along each axis: the noise of one sample is
/// then about that of 64 unsmoothed.
fn passes(samples: u32) -> u32 {
    match samples {
        0..4 => 3,
        4..16 => 2,
        16..64 => 1,
        _ => 0,
    }
}

fn coarser(size: [u32; 3]) -> [u32; 3] {
    let most = size.into_iter().max().unwrap_or(1).max(1);
    size.map(|count| (u64::from(count) * u64::from(most.min(MOST_VOXELS))).div_ceil(u64::from(most)).max(1) as u32)
}

fn centre([nx, ny, nz]: [u32; 3], voxel: u32) -> Vec3 {
    let (x, rest) = (voxel % nx, voxel / nx);
    let index = Vec3::new(x as f32, (rest % ny) as f32, (rest / ny) as f32);
    (index + 0.5) / Vec3::new(nx as f32, ny as f32, nz as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;

    #[test]
    fn stability_accumulation_of_light() {
        let mut off = bound!("accumulation", "mean light of a voxel, relative", 1e-5);
        for outlier in [0, 777, 999_999] {
            let (mut sum, mut exact) = (Sum::default(), 0.0_f64);
            for index in 0..1_000_000_u32 {
                let value = if index == outlier { 1e8 } else { 0.1 + (index % 97) as f32 * 1e-3 };
                sum.add(Vec3::splat(value));
                exact += f64::from(value) / 1e6;
            }
            off.see((f64::from(sum.mean().x) / exact - 1.0).abs(), outlier);
        }
    }
}
