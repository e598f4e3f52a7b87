//! Steps of a ray through one medium.

use super::LightGrid;
use super::classify::Classes;
use crate::accel::Ray;
use crate::layering::Profile;
use crate::volume::{Albedo, Majorants, Matter, Medium, Segment};
use glam::{Vec3, Vec4};
use std::ops::Range;

/// Part of a voxel per step, unless told otherwise.
const STEP_VOXELS: f32 = 0.5;
/// Most steps through a medium: the diagonal of a grid of 1000 voxels is within it.
const MOST_STEPS: f32 = 4096.0;
/// Optical depth of a step below which it counts as empty: as many steps as there may be change no 8-bit code.
const CLEAR: f32 = 1e-7;
/// Part of a light voxel after which light is sampled again along a ray; between it is linear. The light is linear between
/// its voxels itself: half a voxel misses an eighth of what changes in slope there.
const LIGHT_VOXELS: f32 = 0.5;
/// Optical depth of a step of matter that sends light and takes none away.
const GLOWING: f32 = 1e-6;

/// How a ray goes through a medium.
#[derive(Clone, Debug)]
pub(super) struct Steps {
    /// Length of a step in voxels.
    length: f32,
    /// Voxels of the medium's grid, or of its light, per unit of its cube.
    voxels: Vec3,
    /// Voxels of the light.
    light_voxels: Vec3,
    /// A grid's values up to here are empty.
    empty_until: f32,
    /// What a grid's values are, if they are classified.
    classes: Option<Classes>,
}

/// Extinction, scattering and emission of a step, per metre.
type Matters = (Vec3, Vec3, Vec3);

impl Steps {
    pub(super) fn new(medium: &Medium, light: &LightGrid) -> Steps {
        let (voxels, empty_until) = match &medium.matter {
            Matter::Homogeneous { .. } => (light.voxel().recip(), f32::NEG_INFINITY),
            Matter::Density { density, .. } => (per_unit(density.size()), 0.0),
            Matter::Classified { values, transfer, .. } => {
                let first = transfer.points().iter().position(|point| point.extinction_per_m > 0.0);
                let before = first.map_or(f32::INFINITY, |first| match first.checked_sub(1) {
                    Some(before) => transfer.points()[before].value,
                    None => f32::NEG_INFINITY,
                });
                (per_unit(values.size()), before)
            }
        };
        let classes = match &medium.matter {
            Matter::Classified { transfer, .. } => Some(Classes::new(transfer)),
            _ => None,
        };
        Steps { length: STEP_VOXELS, voxels, light_voxels: light.voxel().recip(), empty_until, classes }
    }

    /// Takes steps of so many voxels from now on.
    pub(super) fn set_length(&mut self, voxels: f32) {
        self.length = voxels.clamp(1.0 / 64.0, 64.0);
    }

    /// Adds the slices of a part of a ray to the profile; returns the number of steps in matter.
    pub(super) fn march(
        &self,
        medium: &Medium,
        light: &LightGrid,
        ray: &Ray,
        range: Range<f32>,
        depth_per_m: f32,
        profile: &mut Profile,
    ) -> u64 {
        let unit_from_world = light.unit_from_world();
        let unit = Ray {
            origin: unit_from_world.transform_point3(ray.origin),
            direction: unit_from_world.transform_vector3(ray.direction),
        };
        let walk = medium.walk(ray, range.clone());
        let range = walk.as_ref().map_or(range, Majorants::extent);
        let length = range.end - range.start;
        if !(length > 0.0 && length.is_finite()) {
            return 0;
        }
        let count = (length * (unit.direction * self.voxels).length() / self.length).ceil().clamp(1.0, MOST_STEPS);
        let step = length / count;
        let light_stride = LIGHT_VOXELS / (step * (unit.direction * self.light_voxels).length());
        let light_stride = light_stride.round().clamp(1.0, MOST_STEPS) as u32;
        let along = Along { unit, start: range.start, step, count: count as u32, light_stride, depth_per_m };
        match (&medium.matter, walk, &self.classes) {
            (Matter::Density { density, extinction_per_m, albedo, emission, .. }, Some(walk), _) => {
                let pieces = walk.filter(|Segment { values, .. }| values.1 > self.empty_until);
                let sample = |unit| density.sample_rgb(unit).max(Vec3::ZERO);
                let between = |a: Vec3, b: Vec3, unit| {
                    let albedo = match albedo {
                        Albedo::Constant(albedo) => *albedo,
                        Albedo::Grid(grid) => grid.sample_rgb(unit).clamp(Vec3::ZERO, Vec3::ONE),
                    };
                    let density = 0.5 * (a + b);
                    let extinction = density * *extinction_per_m;
                    (extinction, extinction * albedo, density * *emission)
                };
                along.march(pieces, sample, between, light, profile)
            }
            (Matter::Classified { values, extinction_scale, .. }, Some(walk), Some(classes)) => {
                let pieces =
                    walk.filter(|Segment { values, .. }| values.1 > self.empty_until && medium.majorant(*values) > 0.0);
                let between = |a, b, _| {
                    let (scattering, extinction) = classes.between(a, b);
                    (Vec3::splat(extinction * extinction_scale), scattering * *extinction_scale, Vec3::ZERO)
                };
                along.march(pieces, |unit| values.sample(unit), between, light, profile)
            }
            (Matter::Homogeneous { extinction_per_m, albedo, emission }, _, _) => {
                let whole = std::iter::once(Segment { range, values: (1.0, 1.0) });
                let matters = (*extinction_per_m, *extinction_per_m * *albedo, *emission);
                along.march(whole, |_| (), |(), (), _| matters, light, profile)
            }
            _ => 0,
        }
    }
}

/// A ray cut into equal steps.
struct Along {
    /// In the unit cube of the medium, its parameter the distance in metres.
    unit: Ray,
    start: f32,
    step: f32,
    count: u32,
    /// Steps after which light is sampled again.
    light_stride: u32,
    depth_per_m: f32,
}

/// Light along a ray, linear between samples.
struct LightAlong<'a> {
    light: &'a LightGrid,
    /// Number of the sample before, and the two; none before the first.
    last: Option<(u32, Vec4, Vec4)>,
}

impl LightAlong<'_> {
    /// In the middle of a step.
    #[inline(always)]
    fn at(&mut self, along: &Along, index: u32) -> Vec3 {
        let value = if along.light_stride == 1 {
            self.light.sample(along.unit.at(along.start + (index as f32 + 0.5) * along.step))
        } else {
            let number = index / along.light_stride;
            let sample = |number: u32| {
                let border = along.start + (number * along.light_stride) as f32 * along.step;
                self.light.sample(along.unit.at(border))
            };
            let (before, behind) = match self.last {
                Some((known, before, behind)) if known == number => (before, behind),
                Some((known, _, behind)) if known + 1 == number => (behind, sample(number + 1)),
                _ => (sample(number), sample(number + 1)),
            };
            self.last = Some((number, before, behind));
            let part = (index as f32 + 0.5) / along.light_stride as f32 - number as f32;
            before + part * (behind - before)
        };
        // What is not known weighs nothing.
        if value.w > 0.0 { value.truncate() / value.w } else { Vec3::ZERO }
    }
}

impl Along {
    /// Takes the steps whose middle is in one of the pieces. `sample` gives the value at an end of a step, `between` the
    /// matter of the step from the values at both.
    #[inline]
    fn march<V: Copy>(
        &self,
        pieces: impl Iterator<Item = Segment>,
        sample: impl Fn(Vec3) -> V,
        between: impl Fn(V, V, Vec3) -> Matters,
        light: &LightGrid,
        profile: &mut Profile,
    ) -> u64 {
        let border = |index: u32| self.start + index as f32 * self.step;
        let first_from = |distance: f32| ((distance - self.start) / self.step - 0.5).ceil().max(0.0) as u32;
        let mut light = LightAlong { light, last: None };
        let mut next = 0;
        let mut last: Option<(u32, V)> = None;
        let mut steps = 0;
        for piece in pieces {
            let begin = first_from(piece.range.start).max(next);
            let end = first_from(piece.range.end).min(self.count);
            for index in begin..end {
                let front = border(index);
                let value = match last {
                    Some((known, value)) if known == index => value,
                    _ => sample(self.unit.at(front)),
                };
                let back = border(index + 1);
                let beyond = sample(self.unit.at(back));
                last = Some((index + 1, beyond));
                let middle = self.unit.at(0.5 * (front + back));
                let (extinction, scattering, emission) = between(value, beyond, middle);
                let mut mean = extinction.element_sum() * (1.0 / 3.0);
                if emission != Vec3::ZERO {
                    mean = mean.max(GLOWING / self.step);
                }
                if mean * self.step > CLEAR {
                    let source = (scattering * light.at(self, index) + emission) / mean;
                    profile.start(front * self.depth_per_m);
                    profile.push(back * self.depth_per_m, mean * self.step, source);
                }
            }
            steps += u64::from(end.saturating_sub(begin));
            next = end.max(next);
        }
        steps
    }
}

fn per_unit(size: [u32; 3]) -> Vec3 {
    Vec3::from_array(size.map(|count| count as f32))
}
