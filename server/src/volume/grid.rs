//! Values on a regular grid, interpolated in between.
//!
//! A grid fills the unit cube: value (i, j, k) stands at ((i + 1/2) / nx, (j + 1/2) / ny, (k + 1/2) / nz), in
//! the middle of its cell; a medium places the cube in the world. Between values it is trilinear, which along
//! a ray is a cubic within a cell; beyond the outermost values it is constant. What the values mean, density or
//! the numbers of a scanner, is the medium's business.
//!
//! Limits: a value is an f32 of magnitude at most [`MAX_VALUE`], so that no interpolation or product with an
//! extinction overflows. Cost: 4 bytes a value and channel; a sample reads 8 values in four rows.

use super::Blocks;
use glam::Vec3;

/// Largest magnitude of a value; what is larger counts as not finite. Differences and sums of eight of them are
/// finite, which at f32's largest they would not be.
pub const MAX_VALUE: f32 = 1e30;

/// Why values are no grid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GridError {
    /// A side has no cells, or their product is beyond what can be counted.
    #[error("size: expected three sides of at least 1 whose product is below 2^31, found {0}x{1}x{2}")]
    Size(u32, u32, u32),
    /// Neither grey nor RGB.
    #[error("channels: expected 1 or 3, found {0}")]
    Channels(u8),
    /// Not as many values as cells and channels ask for.
    #[error("values: expected {expected}, found {found}")]
    Length {
        /// Cells times channels.
        expected: u64,
        /// What is there.
        found: u64,
    },
}

/// Values over the unit cube, x fastest; 1 or 3 channels, interleaved.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    size: [u32; 3],
    channels: u8,
    values: Vec<f32>,
    blocks: Blocks,
    not_finite: u64,
}

impl Grid {
    /// A grid of `size` cells. Values that are not finite become 0 and are counted.
    pub fn new(size: [u32; 3], channels: u8, mut values: Vec<f32>) -> Result<Grid, GridError> {
        let cells = size.iter().try_fold(1u64, |product, &side| product.checked_mul(u64::from(side)));
        let cells =
            cells.filter(|&cells| cells > 0 && cells < 1 << 31).ok_or(GridError::Size(size[0], size[1], size[2]))?;
        if channels != 1 && channels != 3 {
            return Err(GridError::Channels(channels));
        }
        let expected = cells * u64::from(channels);
        if values.len() as u64 != expected {
            return Err(GridError::Length { expected, found: values.len() as u64 });
        }
        let mut not_finite = 0;
        for value in values.iter_mut().filter(|value| !(-MAX_VALUE..=MAX_VALUE).contains(*value)) {
            *value = 0.0;
            not_finite += 1;
        }
        let blocks = Blocks::new(size, channels, &values);
        Ok(Grid { size, channels, values, blocks, not_finite })
    }

    /// Cells along x, y and z.
    pub fn size(&self) -> [u32; 3] {
        self.size
    }

    /// 1 or 3.
    pub fn channels(&self) -> u8 {
        self.channels
    }

    /// All values, x fastest, channels interleaved; all finite.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// How many values were not finite, or too large to compute with, and were made 0.
    pub fn not_finite(&self) -> u64 {
        self.not_finite
    }

    /// Lowest and highest value within each block of cells.
    pub fn blocks(&self) -> &Blocks {
        &self.blocks
    }

    /// The first channel at a point of the unit cube; outside of it, and where the point is not a number, the
    /// value at its border.
    #[inline]
    pub fn sample(&self, unit: Vec3) -> f32 {
        let Cell { index, step, part } = self.cell(unit);
        let at = |offset: usize| self.values[index + offset];
        let along_x = |offset: usize| mix(at(offset), at(offset + step[0]), part.x);
        let along_y = |offset: usize| mix(along_x(offset), along_x(offset + step[1]), part.y);
        mix(along_y(0), along_y(step[2]), part.z)
    }

    /// All channels at a point of the unit cube, as [`Grid::sample`]; a grey grid gives its value thrice.
    #[inline]
    pub fn sample_rgb(&self, unit: Vec3) -> Vec3 {
        if self.channels == 1 {
            return Vec3::splat(self.sample(unit));
        }
        let Cell { index, step, part } = self.cell(unit);
        let at = |offset: usize| Vec3::from_slice(&self.values[index + offset..index + offset + 3]);
        let along_x = |offset: usize| mix_rgb(at(offset), at(offset + step[0]), part.x);
        let along_y = |offset: usize| mix_rgb(along_x(offset), along_x(offset + step[1]), part.y);
        mix_rgb(along_y(0), along_y(step[2]), part.z)
    }

    /// The lower of the values about a point, and where between them it is.
    #[inline]
    fn cell(&self, unit: Vec3) -> Cell {
        let [nx, ny, nz] = self.size;
        let (x, step_x, part_x) = between(unit.x, nx);
        let (y, step_y, part_y) = between(unit.y, ny);
        let (z, step_z, part_z) = between(unit.z, nz);
        let (channels, nx, ny) = (usize::from(self.channels), nx as usize, ny as usize);
        Cell {
            index: ((z * ny + y) * nx + x) * channels,
            step: [step_x * channels, step_y * nx * channels, step_z * nx * ny * channels],
            part: Vec3::new(part_x, part_y, part_z),
        }
    }
}

/// Where a sample lies: its lowest value, the way to the next along each axis, and the part of that way.
struct Cell {
    index: usize,
    step: [usize; 3],
    part: Vec3,
}

/// Along one axis of `count` values: the lower one, 1 or (beyond the last) 0 to the next, and the part.
#[inline]
pub(crate) fn between(unit: f32, count: u32) -> (usize, usize, f32) {
    let last = (count - 1) as f32;
    // f32's own max gives 0 for what is not a number.
    let position = (unit * count as f32 - 0.5).max(0.0).min(last);
    let low = position as usize;
    // Where `last` was rounded up to a count beyond it, the last value all the same.
    let low = low.min(count as usize - 1);
    let step = usize::from(low + 1 < count as usize);
    (low, step, (position - low as f32).min(1.0))
}

/// Exact where both ends are equal, which `a (1 - t) + b t` is not: empty space stays empty.
#[inline]
fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

#[inline]
fn mix_rgb(a: Vec3, b: Vec3, t: f32) -> Vec3 {
    a + (b - a) * t
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(size: [u32; 3], channels: u8) -> Grid {
        let mut values = Vec::new();
        for z in 0..size[2] {
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let value = x as f32 + 10.0 * y as f32 - 3.0 * z as f32;
                    values.extend((0..channels).map(|channel| value * (1.0 + f32::from(channel))));
                }
            }
        }
        Grid::new(size, channels, values).unwrap()
    }

    #[test]
    fn a_linear_field_is_sampled_exactly_between_its_outermost_values() {
        for channels in [1, 3] {
            let size = [5, 7, 4];
            let grid = ramp(size, channels);
            for index in 0..1000 {
                let unit = |prime: u32, count: u32| {
                    let part = (index as f32 * (prime as f32).sqrt()).fract();
                    (0.5 + part * (count - 1) as f32) / count as f32
                };
                let point = Vec3::new(unit(2, size[0]), unit(3, size[1]), unit(5, size[2]));
                let [x, y, z] = [0, 1, 2].map(|axis| point[axis] * size[axis] as f32 - 0.5);
                let expected = x + 10.0 * y - 3.0 * z;
                // Values up to 69: some roundings of them.
                assert!((grid.sample(point) - expected).abs() < 1e-4, "{point}");
                let factors = if channels == 3 { Vec3::new(1.0, 2.0, 3.0) } else { Vec3::ONE };
                assert!((grid.sample_rgb(point) - expected * factors).abs().max_element() < 3e-4, "{point}");
            }
        }
    }

    #[test]
    fn values_stand_in_the_middle_of_their_cells_and_end_at_the_border() {
        let grid = Grid::new([2, 1, 1], 1, vec![1.0, 3.0]).unwrap();
        let along_x = |x: f32| grid.sample(Vec3::new(x, 0.5, 0.5));
        assert_eq!([0.25, 0.75, 0.5].map(along_x), [1.0, 3.0, 2.0]);
        assert_eq!([-9.0, 0.0, 0.1, 0.9, 1.0, 9.0].map(along_x), [1.0, 1.0, 1.0, 3.0, 3.0, 3.0]);
        assert_eq!([f32::INFINITY, f32::NEG_INFINITY].map(along_x), [3.0, 1.0]);
        assert_eq!(along_x(f32::NAN), 1.0);
    }

    #[test]
    fn one_value_is_a_grid() {
        let grid = Grid::new([1, 1, 1], 3, vec![1.0, 2.0, 3.0]).unwrap();
        for point in [Vec3::ZERO, Vec3::splat(0.5), Vec3::ONE, Vec3::splat(f32::MAX)] {
            assert_eq!(grid.sample_rgb(point), Vec3::new(1.0, 2.0, 3.0));
            assert_eq!(grid.sample(point), 1.0);
        }
    }

    #[test]
    fn what_is_not_finite_becomes_nothing_and_is_counted() {
        let values = vec![f32::NAN, 1.0, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -MAX_VALUE, MAX_VALUE, 0.0];
        let grid = Grid::new([2, 2, 2], 1, values).unwrap();
        assert_eq!(grid.values(), [0.0, 1.0, 0.0, 0.0, 0.0, -MAX_VALUE, MAX_VALUE, 0.0]);
        assert_eq!(grid.not_finite(), 4);
        assert!((0..100).all(|index| grid.sample(Vec3::splat(index as f32 / 99.0)).is_finite()));
        assert!(grid.blocks().all().0.is_finite() && grid.blocks().all().1.is_finite());
    }

    #[test]
    fn contradicting_sizes_are_refused_in_words() {
        let error = |size, channels, count| Grid::new(size, channels, vec![0.0; count]).unwrap_err().to_string();
        assert!(error([0, 1, 1], 1, 0).starts_with("size: expected three sides of at least 1"));
        assert!(error([u32::MAX; 3], 1, 0).ends_with("found 4294967295x4294967295x4294967295"));
        assert_eq!(error([1, 1, 1], 2, 2), "channels: expected 1 or 3, found 2");
        assert_eq!(error([2, 2, 2], 3, 8), "values: expected 24, found 8");
    }
}
