//! Cumulus: round heaps on a flat base, roughened by bulges and frayed by noise.
//!
//! After Ebert et al. 2003 (chapter on volumetric clouds: implicit blobs for the shape, turbulence for what is on
//! it), with the cell noise of Worley 1996 for the bulges (Schneider 2015). Shape: the highest of some blobs,
//! 1 in the middle of each and 0 at its rim, cut off smoothly below the base. Noise moves that surface; the
//! density rises from 0 to 1 within a thin skin below it.
//!
//! Cost: below a microsecond a cell near the cloud; elsewhere only the blobs.

use super::noise::{billows, fractal, hash, unit_cube};
use glam::{IVec3, Vec2, Vec3};

/// One cumulus in the unit cube.
pub(super) struct Cloud {
    blobs: Vec<Blob>,
    seed: u32,
}

struct Blob {
    centre: Vec3,
    radius: f32,
}

/// How far bulges and fringes move the surface, as part of a blob's height: more makes loose puffs.
const BULGE: f32 = 0.55;
const FRINGE: f32 = 0.28;
/// Depth of the skin in which the density rises to 1.
const SKIN: f32 = 0.16;

impl Cloud {
    /// A heap of blobs: large ones low and in the middle, smaller ones on and around them.
    pub(super) fn new(seed: u32) -> Cloud {
        let mut blobs = Vec::new();
        for index in 0..14 {
            let random = unit_cube(hash(IVec3::new(index, 1, 0), seed));
            let more = unit_cube(hash(IVec3::new(index, 2, 0), seed));
            let turn = std::f32::consts::TAU * (random.x + index as f32 * 0.618_034);
            // From the middle outwards, and upwards in the middle only.
            let out = 0.24 * (index as f32 / 14.0).sqrt() * (0.6 + 0.4 * more.x);
            let rise = 0.34 * random.z * (1.0 - out / 0.3);
            let radius = (0.2 - 0.4 * out) * (0.75 + 0.4 * random.y) * (1.0 - 0.35 * rise / 0.34);
            let centre = Vec3::new(0.5 + out * turn.cos(), 0.34 + rise, 0.5 + 0.8 * out * turn.sin());
            blobs.push(Blob { centre, radius });
        }
        Cloud { blobs, seed }
    }

    pub(super) fn density(&self, point: Vec3) -> f32 {
        let height = self.blobs.iter().map(|blob| 1.0 - point.distance(blob.centre) / blob.radius).fold(-9.0, f32::max);
        // The flat base, and nothing near the faces of the cube.
        let base = (point.y - 0.24) / 0.1;
        let faces = (0.5 - (point - 0.5).abs().max_element() - 0.03) / 0.05;
        roughened(height.min(base).min(faces), point * 7.0, self.seed)
    }
}

/// Density where a smooth shape has this height above its surface.
fn roughened(height: f32, point: Vec3, seed: u32) -> f32 {
    // Nothing that is added could bring it above zero, or below the skin.
    if height < -BULGE || height.is_nan() {
        return 0.0;
    }
    let bulge = BULGE * (2.0 * billows(point, 3, seed) - 1.0);
    let fringe = FRINGE * fractal(point * 2.3, 3, seed ^ 0x5bd1_e995);
    let part = ((height + bulge + fringe - 0.1) / SKIN).clamp(0.0, 1.0);
    // Nothing where the shape itself has ended; inside, gently uneven.
    let inside = ((height + BULGE) / 0.1).clamp(0.0, 1.0);
    part * part * (3.0 - 2.0 * part) * inside * (0.75 + 0.25 * (1.0 + fringe / FRINGE).clamp(0.0, 1.0))
}

/// Cumuli on a layer, wider than it is high, y up.
pub(super) struct Field {
    seed: u32,
    /// Of each of the three heaps of a cell, that it is there.
    probability: f32,
    /// Width and depth of the box in units of its height.
    extent: Vec2,
}

/// Area of three heaps of mean size, in cells: pi times 1.25^2 times the mean square of radii from 0.22 to 0.5.
const HEAPS_AREA: f32 = 2.0;

impl Field {
    /// The box is as wide for its height as the grid is.
    pub(super) fn new(seed: u32, cover: f32, size: [u32; 3]) -> Field {
        let [x, y, z] = size.map(|side| side.max(1) as f32);
        // Heaps that are strewn at random cover 1 - exp(-their number times their area).
        let probability = -(1.0 - cover.clamp(0.0, 0.99)).ln() / HEAPS_AREA;
        Field { seed, probability, extent: Vec2::new(x / y, z / y) }
    }

    pub(super) fn density(&self, point: Vec3) -> f32 {
        let at = Vec3::new(point.x * self.extent.x, point.y, point.z * self.extent.y);
        // The highest of the heaps of this cell and its neighbours.
        let cell = Vec2::new(at.x, at.z).floor();
        let mut height = -9.0f32;
        for z in -1..=1 {
            for x in -1..=1 {
                let cell = IVec3::new(cell.x as i32 + x, 0, cell.y as i32 + z);
                for heap in 0..3 {
                    let bits = hash(cell + IVec3::Y * heap, self.seed);
                    if (bits >> 16) as f32 / 65536.0 >= self.probability {
                        continue;
                    }
                    let random = unit_cube(hash(cell + IVec3::Y * (heap + 10), self.seed));
                    let radius = 0.22 + 0.28 * random.z;
                    let centre = Vec3::new(cell.x as f32 + random.x, 0.22 + 0.5 * radius, cell.z as f32 + random.y);
                    // Wider than high.
                    let offset = (at - centre) / Vec3::new(radius * 1.25, radius, radius * 1.25);
                    height = height.max(1.0 - offset.length());
                }
            }
        }
        let base = (point.y - 0.18) / 0.08;
        let top = (0.97 - point.y) / 0.05;
        // Cut off smoothly at the sides, too.
        let sides = (0.49 - (Vec2::new(point.x, point.z) - 0.5).abs().max_element()) / 0.02;
        roughened(height.min(base).min(top).min(sides), at * 5.0, self.seed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_much_of_the_sky_is_covered_as_is_asked_for() {
        for cover in [0.0, 0.25, 0.5, 0.75] {
            let field = Field::new(3, cover, [160, 20, 160]);
            let side = 48;
            let covered = (0..side * side)
                .filter(|index| {
                    let [x, z] = [index % side, index / side].map(|at| (at as f32 + 0.5) / side as f32);
                    (0..20).any(|y| field.density(Vec3::new(x, (y as f32 + 0.5) / 20.0, z)) > 0.0)
                })
                .count() as f32
                / (side * side) as f32;
            // Some 190 heaps at most: a tenth of chance, and noise makes them wider or narrower.
            assert!((covered - cover).abs() < 0.15, "{cover}: {covered}");
        }
    }
}
