//! Noise in space: gradients (Perlin 2002) and cells (Worley 1996), from hashes of whole coordinates.
//!
//! Nothing is tabulated and nothing repeats within 2^32 cells. Cost: a gradient noise hashes 8 corners, a cell
//! noise 27 cells.

use glam::{IVec3, Vec3};

/// 32 well mixed bits of a cell (the finaliser of MurmurHash3, Appleby).
pub(super) fn hash(cell: IVec3, seed: u32) -> u32 {
    let mix = |mut bits: u32| {
        bits = (bits ^ bits >> 16).wrapping_mul(0x85eb_ca6b);
        bits = (bits ^ bits >> 13).wrapping_mul(0xc2b2_ae35);
        bits ^ bits >> 16
    };
    let first = mix((cell.x as u32).wrapping_mul(0x9e37_79b1) ^ seed);
    let second = mix(first ^ (cell.y as u32).wrapping_mul(0x85eb_ca77));
    mix(second ^ (cell.z as u32).wrapping_mul(0xc2b2_ae3d))
}

/// Ten bits of a hash, from 0 to 1.
fn part(bits: u32, shift: u32) -> f32 {
    (bits >> shift & 1023) as f32 / 1023.0
}

/// Three independent numbers from 0 to 1.
pub(super) fn unit_cube(bits: u32) -> Vec3 {
    Vec3::new(part(bits, 0), part(bits, 10), part(bits, 20))
}

/// Gradient noise, about -1 to 1, of period 1 and mean 0; zero at whole coordinates.
pub(super) fn gradient(point: Vec3, seed: u32) -> f32 {
    let low = point.floor();
    let (cell, at) = (low.as_ivec3(), point - low);
    // The fade of Perlin 2002: first and second derivatives are continuous across cells.
    let fade = at * at * at * (at * (at * 6.0 - 15.0) + 10.0);
    let corner = |x: i32, y: i32, z: i32| {
        let direction = unit_cube(hash(cell.wrapping_add(IVec3::new(x, y, z)), seed)) * 2.0 - 1.0;
        direction.dot(at - Vec3::new(x as f32, y as f32, z as f32))
    };
    let along_x = |y: i32, z: i32| corner(0, y, z) + (corner(1, y, z) - corner(0, y, z)) * fade.x;
    let along_y = |z: i32| along_x(0, z) + (along_x(1, z) - along_x(0, z)) * fade.y;
    // Components are uniform in -1..1: this brings its extremes near 1.
    (along_y(0) + (along_y(1) - along_y(0)) * fade.z) * 1.2
}

/// Cell noise: distance to the nearest of points that are strewn one to a cell, at most about 1.
pub(super) fn cells(point: Vec3, seed: u32) -> f32 {
    let low = point.floor();
    let (cell, at) = (low.as_ivec3(), point - low);
    let mut nearest = f32::INFINITY;
    for z in -1..=1 {
        for y in -1..=1 {
            for x in -1..=1 {
                let offset = IVec3::new(x, y, z);
                let other = unit_cube(hash(cell.wrapping_add(offset), seed)) + offset.as_vec3();
                nearest = nearest.min((other - at).length_squared());
            }
        }
    }
    nearest.sqrt()
}

/// Octaves of gradient noise, each half as large and half as strong as the one before.
pub(super) fn fractal(point: Vec3, octaves: u32, seed: u32) -> f32 {
    let (mut sum, mut weight, mut scale) = (0.0, 0.5, 1.0);
    for octave in 0..octaves {
        sum += weight * gradient(point * scale, seed.wrapping_add(octave));
        // Not quite doubled: zeros at whole coordinates would fall together.
        (weight, scale) = (weight * 0.5, scale * 2.03);
    }
    sum
}

/// Octaves of bulges, 0 to 1: one minus cell noise is round where a cauliflower is.
pub(super) fn billows(point: Vec3, octaves: u32, seed: u32) -> f32 {
    let (mut sum, mut total, mut weight, mut scale) = (0.0, 0.0, 1.0, 1.0);
    for octave in 0..octaves {
        sum += weight * (1.0 - cells(point * scale, seed.wrapping_add(100 + octave)).min(1.0));
        total += weight;
        (weight, scale) = (weight * 0.5, scale * 2.03);
    }
    if total > 0.0 { sum / total } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> impl Iterator<Item = Vec3> {
        (0..20_000).map(|index| unit_cube(hash(IVec3::new(index, 0, 0), 9)) * 64.0 - 32.0)
    }

    #[test]
    fn noise_is_centred_bounded_and_continuous() {
        let (mut sum, mut squares) = (0.0, 0.0);
        for point in points() {
            let value = gradient(point, 5);
            // 3 components of at most 1 at a distance of at most sqrt(3), faded: the bound is that of the corners.
            assert!(value.abs() < 2.1, "{point}: {value}");
            (sum, squares) = (sum + f64::from(value), squares + f64::from(value * value));
            let near = gradient(point + 1e-4, 5);
            assert!((near - value).abs() < 5e-3, "{point}");
            assert!((0.0..1.8).contains(&cells(point, 5)));
            assert!((0.0..=1.0).contains(&billows(point, 3, 5)));
            assert!(fractal(point, 5, 5).abs() < 2.1);
        }
        let (mean, deviation) = (sum / 20_000.0, (squares / 20_000.0).sqrt());
        assert!(mean.abs() < 0.01 && (0.15..0.5).contains(&deviation), "{mean} {deviation}");
        assert_eq!(gradient(Vec3::new(3.0, -7.0, 12.0), 5), 0.0);
    }

    #[test]
    fn cells_are_hashed_without_patterns() {
        // Bits of neighbours: each is set in half of them.
        for bit in 0..32 {
            let set = (0..4096).filter(|&i| hash(IVec3::new(i % 16, i / 16 % 16, i / 256), 1) >> bit & 1 == 1).count();
            // Six standard deviations of a fair coin.
            assert!((set as f64 - 2048.0).abs() < 6.0 * 32.0, "{bit}: {set}");
        }
    }
}
