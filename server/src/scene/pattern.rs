//! Procedural patterns: wood, tiles, stripes, marble, rings and painted hills.
//!
//! Method: value noise on an integer lattice with quintic interpolation (Perlin 2002, "Improving Noise",
//! for the weights), a few octaves at most, and edges that fade over a stated width, because textures are
//! looked up at points and would alias otherwise. Every pattern has period 1 in u and v where its counts
//! are whole numbers, apart from marble and hills, which are made to be seen once.

use glam::{Vec2, Vec3};

/// The closed set of procedural patterns; colours are linear RGB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pattern {
    /// Bands along v, fading into each other.
    Stripes {
        /// First colour.
        a: [f32; 3],
        /// Second colour.
        b: [f32; 3],
        /// Pairs of bands per unit of u.
        count: f32,
        /// Width of the fade as a fraction of a band, in [0, 1].
        softness: f32,
    },
    /// Planks along u with grain, each of its own shade.
    Wood {
        /// Colour between the growth rings.
        light: [f32; 3],
        /// Colour of the growth rings.
        dark: [f32; 3],
        /// Planks per unit of u and v.
        planks: [f32; 2],
    },
    /// Square tiles with joints, each of a slightly different shade.
    Tiles {
        /// Mean colour of a tile.
        tile: [f32; 3],
        /// Colour of the joints.
        joint: [f32; 3],
        /// Tiles per unit of u and v.
        count: [f32; 2],
        /// Width of a joint as a fraction of a tile, in [0, 1].
        joint_width: f32,
        /// Largest relative deviation of a tile's shade, in [0, 1].
        variation: f32,
    },
    /// Veins in stone.
    Marble {
        /// Colour of the stone.
        stone: [f32; 3],
        /// Colour of the veins.
        vein: [f32; 3],
        /// Veins per unit of texture coordinate.
        count: f32,
    },
    /// Concentric rings about the middle.
    Rings {
        /// First colour.
        a: [f32; 3],
        /// Second colour.
        b: [f32; 3],
        /// Pairs of rings from the middle to the edge.
        count: f32,
    },
    /// A painted landscape: sky, sun, and rows of hills that fade with distance.
    Hills {
        /// Sky at the top.
        sky: [f32; 3],
        /// Sky at the horizon, and the haze before far hills.
        haze: [f32; 3],
        /// The disc of the sun.
        sun: [f32; 3],
        /// The nearest hill.
        ground: [f32; 3],
        /// Chooses the shape of the hills.
        seed: u32,
    },
}

impl Pattern {
    /// The colour at texture coordinates.
    pub fn color(&self, uv: Vec2) -> Vec3 {
        // Beyond this, lattice cells are no longer whole numbers in f32; nothing visible is out there.
        let uv = if uv.is_finite() { uv.clamp(Vec2::splat(-1e4), Vec2::splat(1e4)) } else { Vec2::ZERO };
        match *self {
            Pattern::Stripes { a, b, count, softness } => mix(a, b, bands(uv.x * count, softness)),
            Pattern::Wood { light, dark, planks } => wood(uv * Vec2::from_array(planks), light, dark),
            Pattern::Tiles { tile, joint, count, joint_width, variation } => {
                let position = uv * Vec2::from_array(count);
                let cell = position.floor();
                let shade = 1.0 + variation * (2.0 * random(cell.x as i32, cell.y as i32, 17) - 1.0);
                let to_edge = (0.5 - (position - cell - 0.5).abs()).min_element();
                let inside = smoothstep(0.35 * joint_width, 0.65 * joint_width + 1e-4, to_edge);
                Vec3::from_array(joint).lerp(Vec3::from_array(tile) * shade, inside)
            }
            Pattern::Marble { stone, vein, count } => {
                let position = uv * count;
                let warped = position.x + 0.6 * position.y + 2.2 * octaves(position * 0.7, 4, 3);
                let vein_strength = (1.0 - (std::f32::consts::PI * warped).sin().abs()).powi(5);
                mix(stone, vein, 0.8 * vein_strength + 0.2 * octaves(position * 2.0, 3, 5))
            }
            Pattern::Rings { a, b, count } => {
                let wobble = 0.04 * octaves(uv * 4.0, 3, 29);
                mix(a, b, bands(((uv - 0.5).length() * 2.0 + wobble) * count, 0.35))
            }
            Pattern::Hills { sky, haze, sun, ground, seed } => hills(uv, sky, haze, sun, ground, seed),
        }
    }
}

/// Planks side by side along v, each shifted by a random part of its length.
fn wood(position: Vec2, light: [f32; 3], dark: [f32; 3]) -> Vec3 {
    let row = position.y.floor();
    let along = position.x + random(row as i32, 0, 1);
    let plank = along.floor();
    let shade = random(plank as i32, row as i32, 2);
    // Grain: noise stretched along the plank, bent a little, each plank cut from another place.
    let at = Vec2::new(along * 1.5 + 31.7 * shade, (position.y - row) * 3.0 + 17.3 * shade);
    let bent = at.y + 0.8 * octaves(at * Vec2::new(0.8, 0.6), 2, 7);
    let grain = 0.5 + 0.5 * (bent * 7.0).sin();
    let fleck = octaves(at * Vec2::new(2.0, 9.0), 2, 11);
    let wood = mix(light, dark, 0.55 * grain * grain + 0.35 * fleck) * (0.82 + 0.3 * shade);
    // Gaps between planks, in fractions of a plank's width and length.
    let across_gap = (0.5 - (position.y - row - 0.5).abs()) / 0.02;
    let along_gap = (0.5 - (along - plank - 0.5).abs()) / 0.003;
    wood * (0.45 + 0.55 * smoothstep(0.0, 1.0, across_gap.min(along_gap)))
}

/// Rows of hills from far to near; v grows downwards.
fn hills(uv: Vec2, sky: [f32; 3], haze: [f32; 3], sun: [f32; 3], ground: [f32; 3], seed: u32) -> Vec3 {
    const ROWS: u32 = 5;
    let mut color = mix(sky, haze, smoothstep(0.0, 0.6, uv.y));
    let from_sun = (uv - Vec2::new(0.3 + 0.4 * random(seed as i32, 0, 41), 0.3)).length();
    color = color.lerp(Vec3::from_array(sun), 1.0 - smoothstep(0.075, 0.085, from_sun));
    for row in 0..ROWS {
        let nearness = (row + 1) as f32 / ROWS as f32;
        let wave = octaves(Vec2::new(uv.x * (3.5 - 2.0 * nearness), row as f32 * 7.0), 4, seed + row);
        let top = 0.36 + 0.5 * nearness - 0.34 * wave * (1.15 - 0.5 * nearness);
        let shade = mix(haze, ground, 0.25 + 0.75 * nearness) * (1.1 - 0.25 * smoothstep(top, top + 0.3, uv.y));
        color = color.lerp(shade, smoothstep(top - 0.004, top + 0.004, uv.y));
    }
    color
}

/// 0 in the first half of each unit and 1 in the second, fading over `softness` of a half.
fn bands(position: f32, softness: f32) -> f32 {
    // Distance to the middle of the second half, in halves: 0 there, 1 in the middle of the first.
    let distance = ((position - position.floor()) - 0.75).abs() * 2.0;
    let distance = if distance > 1.0 { 2.0 - distance } else { distance };
    let half_width = 0.5 * softness.clamp(1e-3, 1.0);
    1.0 - smoothstep(0.5 - half_width, 0.5 + half_width, distance)
}

fn mix(a: [f32; 3], b: [f32; 3], weight: f32) -> Vec3 {
    Vec3::from_array(a).lerp(Vec3::from_array(b), weight.clamp(0.0, 1.0))
}

fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Sum of octaves of value noise, normalised to [0, 1].
fn octaves(position: Vec2, count: u32, seed: u32) -> f32 {
    let (mut sum, mut weight, mut total, mut at) = (0.0, 0.5, 0.0, position);
    for octave in 0..count {
        sum += weight * value_noise(at, seed.wrapping_add(octave));
        total += weight;
        weight *= 0.5;
        at = at * 2.03 + 5.3;
    }
    sum / total
}

fn value_noise(position: Vec2, seed: u32) -> f32 {
    let cell = position.floor();
    let f = position - cell;
    let w = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let corner = |dx, dy| random(cell.x as i32 + dx, cell.y as i32 + dy, seed);
    let upper = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * w.x;
    let lower = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * w.x;
    upper + (lower - upper) * w.y
}

/// A number in [0, 1) for a lattice point: the mixer of Murmur 3 (Appleby 2011).
fn random(x: i32, y: i32, seed: u32) -> f32 {
    let mut h =
        (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77) ^ seed.wrapping_mul(0xC2B2_AE3D);
    h = (h ^ (h >> 16)).wrapping_mul(0x85EB_CA6B);
    h = (h ^ (h >> 13)).wrapping_mul(0xC2B2_AE35);
    ((h ^ (h >> 16)) >> 8) as f32 / (1 << 24) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: [f32; 3] = [0.1, 0.2, 0.3];
    const B: [f32; 3] = [0.6, 0.5, 0.4];

    fn all() -> [Pattern; 6] {
        [
            Pattern::Stripes { a: A, b: B, count: 4.0, softness: 0.2 },
            Pattern::Wood { light: B, dark: A, planks: [2.0, 8.0] },
            Pattern::Tiles { tile: B, joint: A, count: [4.0, 4.0], joint_width: 0.1, variation: 0.1 },
            Pattern::Marble { stone: B, vein: A, count: 3.0 },
            Pattern::Rings { a: A, b: B, count: 5.0 },
            Pattern::Hills { sky: A, haze: B, sun: B, ground: A, seed: 3 },
        ]
    }

    #[test]
    fn every_pattern_reflects_no_more_than_its_colours_by_a_fifth() {
        for pattern in all() {
            for step in 0..10_000_u16 {
                let uv = Vec2::new(f32::from(step % 100) * 0.013, f32::from(step / 100) * 0.011);
                let color = pattern.color(uv);
                assert!(color.min_element() >= 0.0 && color.max_element() <= 0.6 * 1.2, "{pattern:?} at {uv}: {color}");
            }
        }
    }

    #[test]
    fn patterns_have_no_jumps_finer_than_a_thousandth() {
        for pattern in all() {
            let mut steepest = 0.0_f32;
            for step in 0..20_000_u16 {
                let at = |s: f32| pattern.color(Vec2::new(s * 0.37, s * 0.61));
                let s = f32::from(step) * 1e-4;
                steepest = steepest.max((at(s + 1e-4) - at(s)).length());
            }
            assert!(steepest < 0.35, "{pattern:?}: {steepest} within 1e-4");
        }
    }

    #[test]
    fn far_coordinates_do_no_harm() {
        for pattern in all() {
            for bad in [f32::NAN, f32::INFINITY, 1e30, -1e30] {
                assert!(pattern.color(Vec2::new(bad, 0.3)).is_finite());
            }
        }
    }

    #[test]
    fn bands_are_half_and_half() {
        assert_eq!([bands(0.25, 0.2), bands(0.75, 0.2), bands(1.25, 0.2), bands(-0.25, 0.2)], [0.0, 1.0, 0.0, 1.0]);
        assert!((bands(0.5, 0.2) - 0.5).abs() < 1e-5 && (bands(1.0, 0.2) - 0.5).abs() < 1e-5);
    }
}
