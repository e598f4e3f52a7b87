//! Holes filled from around them: push-pull (Gortler et al. 1996).
//!
//! Pull: halve the picture until nothing is unknown, averaging what is known. Push: on the way back give each
//! unknown pixel the value of the level above, interpolated. Known pixels stay as they are, to the bit.

use glam::Vec3;

/// The levels; kept from picture to picture.
#[derive(Debug, Default)]
pub(super) struct Pyramid {
    levels: Vec<Level>,
    /// Levels in use for this picture.
    depth: usize,
}

#[derive(Debug, Default)]
struct Level {
    width: usize,
    radiance: Vec<Vec3>,
}

impl Level {
    fn height(&self) -> usize {
        self.radiance.len() / self.width
    }

    fn at(&self, x: usize, y: usize) -> Vec3 {
        self.radiance[y.min(self.height() - 1) * self.width + x.min(self.width - 1)]
    }

    /// Tent interpolation at a pixel of the level below.
    fn between(&self, x: usize, y: usize) -> Vec3 {
        // The centre of a child lies a quarter off that of its parent, towards this neighbour.
        let towards = |at: usize| if at.is_multiple_of(2) { (at / 2).saturating_sub(1) } else { at / 2 + 1 };
        let (px, py, nx, ny) = (x / 2, y / 2, towards(x), towards(y));
        0.5625 * self.at(px, py) + 0.1875 * (self.at(nx, py) + self.at(px, ny)) + 0.0625 * self.at(nx, ny)
    }
}

impl Pyramid {
    /// Fills the pixels of `radiance` that are not numbers and tells how many they were. A picture without any
    /// known pixel becomes black.
    pub(super) fn fill(&mut self, radiance: &mut [Vec3], width: usize) -> usize {
        let holes = radiance.iter().filter(|radiance| radiance.is_nan()).count();
        if holes == 0 {
            return 0;
        }
        self.pull(radiance, width);
        self.push(radiance, width);
        holes
    }

    fn pull(&mut self, radiance: &[Vec3], width: usize) {
        let mut depth = 0;
        loop {
            if self.levels.len() == depth {
                self.levels.push(Level::default());
            }
            let (lower, upper) = self.levels.split_at_mut(depth);
            let below = lower.last().map_or((radiance, width), |level| (&level.radiance[..], level.width));
            let level = &mut upper[0];
            halve(below.0, below.1, level);
            depth += 1;
            if level.radiance.len() == 1 || !level.radiance.iter().any(|radiance| radiance.is_nan()) {
                break;
            }
        }
        self.depth = depth;
    }

    fn push(&mut self, radiance: &mut [Vec3], width: usize) {
        for depth in (0..self.depth).rev() {
            let (lower, upper) = self.levels.split_at_mut(depth);
            let (target, target_width) = match lower.last_mut() {
                Some(level) => (&mut level.radiance[..], level.width),
                None => (&mut *radiance, width),
            };
            for (index, radiance) in target.iter_mut().enumerate() {
                if radiance.is_nan() {
                    let value = upper[0].between(index % target_width, index / target_width);
                    *radiance = if value.is_nan() { Vec3::ZERO } else { value };
                }
            }
        }
    }
}

/// Averages the known pixels of each 2x2; odd borders have 1 or 2.
fn halve(below: &[Vec3], below_width: usize, level: &mut Level) {
    let below_height = below.len() / below_width;
    level.width = below_width.div_ceil(2);
    level.radiance.clear();
    for y in 0..below_height.div_ceil(2) {
        for x in 0..level.width {
            let (mut sum, mut known) = (Vec3::ZERO, 0.0);
            for row in 2 * y..(2 * y + 2).min(below_height) {
                for radiance in &below[row * below_width + 2 * x..row * below_width + (2 * x + 2).min(below_width)] {
                    if !radiance.is_nan() {
                        sum += *radiance;
                        known += 1.0;
                    }
                }
            }
            // 0 / 0 is not a number: still unknown.
            level.radiance.push(sum / known);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOLE: Vec3 = Vec3::NAN;

    #[test]
    fn a_picture_without_holes_is_left_alone() {
        let mut radiance = vec![Vec3::splat(0.3); 12];
        assert_eq!(Pyramid::default().fill(&mut radiance, 4), 0);
        assert!(radiance.iter().all(|&radiance| radiance == Vec3::splat(0.3)));
    }

    #[test]
    fn holes_in_a_constant_become_the_constant_and_known_pixels_stay() {
        for (width, height) in [(1, 1), (1, 7), (7, 1), (13, 9), (64, 64)] {
            let mut radiance = vec![Vec3::new(0.25, 0.5, 1.0); width * height];
            for hole in (1..radiance.len()).filter(|index| index % 3 != 0) {
                radiance[hole] = HOLE;
            }
            let mut pyramid = Pyramid::default();
            pyramid.fill(&mut radiance, width);
            assert!(radiance.iter().all(|&value| (value - Vec3::new(0.25, 0.5, 1.0)).length() < 1e-6));
        }
    }

    #[test]
    fn nothing_known_is_black() {
        let mut radiance = vec![HOLE; 35];
        assert_eq!(Pyramid::default().fill(&mut radiance, 7), 35);
        assert!(radiance.iter().all(|&radiance| radiance == Vec3::ZERO));
    }

    #[test]
    fn a_gap_is_bridged_smoothly() {
        let mut radiance: Vec<Vec3> =
            (0..64).map(|x| if (20..44).contains(&x) { HOLE } else { Vec3::splat(x as f32) }).collect();
        Pyramid::default().fill(&mut radiance, 64);
        let values: Vec<f32> = radiance.iter().map(|radiance| radiance.x).collect();
        assert!(values[20..44].iter().all(|value| (18.0..=46.0).contains(value)), "{values:?}");
        assert!(values[22] < values[32] && values[32] < values[42], "{values:?}");
    }
}
