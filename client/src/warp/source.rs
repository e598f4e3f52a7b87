//! A frame made ready to be warped: its picture from its own pose, and the inverse depth of what it shows.

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use warplight_protocol::frame::{Tree, flatten};
use warplight_protocol::{Camera, ImageSize, Pose};

/// Steps of a texel's width that a sample position is rounded to, as texture units do: rounding errors of a
/// thousandth of a pixel then change nothing, and the picture of an unmoved head is the old one to the bit.
const SUBTEXELS: i32 = 256;

/// Texels whose inverse depths differ by more than this fraction lie on different surfaces.
#[cfg(test)]
const EDGE: f32 = 0.05;

/// The old picture.
#[derive(Debug)]
pub(super) struct Source {
    pose: Pose,
    camera: Camera,
    radiance: Vec<Vec3>,
    inverse_depth: Vec<f32>,
}

impl Default for Source {
    fn default() -> Source {
        let camera = Camera::symmetric(1.0, ImageSize::new(1, 1));
        Source { pose: Pose::IDENTITY, camera, radiance: vec![Vec3::ZERO], inverse_depth: vec![0.0] }
    }
}

/// Four texels around a position, and its fraction between them.
struct Footprint {
    texels: [usize; 4],
    fraction: Vec2,
}

impl Source {
    pub(super) fn prepare(&mut self, tree: &Tree) {
        self.pose = tree.render_pose;
        self.camera = tree.camera;
        let width = tree.camera.size.width as usize;
        let pixels = tree.camera.size.pixels();
        self.radiance.resize(pixels, Vec3::ZERO);
        self.inverse_depth.resize(pixels, 0.0);
        let rows = self.radiance.par_chunks_mut(width).zip(self.inverse_depth.par_chunks_mut(width));
        rows.enumerate().for_each(|(row, (radiance, inverse_depth))| {
            let first = row * width;
            flatten(tree, first..first + width, radiance);
            let distance = &tree.nodes[0].distance[first..first + width];
            for (x, (inverse_depth, distance)) in inverse_depth.iter_mut().zip(distance).enumerate() {
                let ray = tree.camera.ray_in_view(tree.camera.size.pixel_centre(first + x));
                *inverse_depth = ray.length() / distance;
            }
        });
    }

    pub(super) fn pose(&self) -> &Pose {
        &self.pose
    }

    pub(super) fn camera(&self) -> &Camera {
        &self.camera
    }

    /// 1 / z of a texel; 0 at infinity.
    #[inline(always)]
    pub(super) fn inverse_depth(&self, texel: usize) -> f32 {
        self.inverse_depth[texel]
    }

    /// The texel that holds a position, if it is in the picture.
    #[inline(always)]
    pub(super) fn texel_at(&self, pixel: Vec2) -> Option<usize> {
        let size = self.camera.size;
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < size.width as f32 && pixel.y < size.height as f32;
        inside.then(|| pixel.y as usize * size.width as usize + pixel.x as usize)
    }

    #[cfg(test)]
    /// 1 / z at a position: interpolated where the texels around are of one surface, else that of the texel itself.
    #[inline(always)]
    pub(super) fn inverse_depth_at(&self, pixel: Vec2) -> Option<f32> {
        let own = self.inverse_depth[self.texel_at(pixel)?];
        let Footprint { texels, fraction } = self.footprint(pixel);
        let [a, b, c, d] = texels.map(|texel| self.inverse_depth[texel]);
        let (nearest, farthest) = (a.max(b).max(c.max(d)), a.min(b).min(c.min(d)));
        let is_one_surface = is_same_surface(own, nearest) && is_same_surface(own, farthest);
        Some(if is_one_surface { lerp(lerp(a, b, fraction.x), lerp(c, d, fraction.x), fraction.y) } else { own })
    }

    /// Radiance at a position, bilinear; `None` outside the picture.
    #[inline(always)]
    pub(super) fn radiance_at(&self, pixel: Vec2) -> Option<Vec3> {
        self.texel_at(pixel)?;
        let Footprint { texels, fraction } = self.footprint(pixel);
        let [a, b, c, d] = texels.map(|texel| self.radiance[texel]);
        let upper = a + (b - a) * fraction.x;
        let lower = c + (d - c) * fraction.x;
        Some(upper + (lower - upper) * fraction.y)
    }

    #[cfg(test)]
    /// Radiance at a position, bilinear over those texels that show the same surface as the nearest one.
    #[inline(always)]
    pub(super) fn radiance_of_surface_at(&self, pixel: Vec2) -> Option<Vec3> {
        let own = self.inverse_depth[self.texel_at(pixel)?];
        let Footprint { texels, fraction } = self.footprint(pixel);
        if texels.iter().all(|&texel| is_same_surface(own, self.inverse_depth[texel])) {
            return self.radiance_at(pixel);
        }
        let Vec2 { x, y } = fraction;
        let weights = [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y];
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for (texel, weight) in texels.into_iter().zip(weights) {
            if is_same_surface(own, self.inverse_depth[texel]) {
                sum += self.radiance[texel] * weight;
                total += weight;
            }
        }
        // The nearest texel is one of the four and has a weight of at least a quarter.
        Some(sum / total)
    }

    /// The texels around a position in the picture. In integers: rounding and flooring floats are calls to the
    /// mathematics library on the oldest processors that this is built for.
    #[inline(always)]
    fn footprint(&self, pixel: Vec2) -> Footprint {
        let size = self.camera.size;
        // One texel more than the offset to its centre, so that nothing is below zero when it is truncated.
        let steps = (pixel + 0.5) * SUBTEXELS as f32 + 0.5;
        let (x, y) = (steps.x as i32, steps.y as i32);
        let fraction = Vec2::new((x % SUBTEXELS) as f32, (y % SUBTEXELS) as f32) / SUBTEXELS as f32;
        let (x, y) = (x / SUBTEXELS - 1, y / SUBTEXELS - 1);
        let width = size.width as usize;
        let (left, right) = (x.max(0) as usize, (x + 1).min(size.width as i32 - 1) as usize);
        let (upper, lower) = (y.max(0) as usize * width, (y + 1).min(size.height as i32 - 1) as usize * width);
        Footprint { texels: [upper + left, upper + right, lower + left, lower + right], fraction }
    }
}

#[cfg(test)]
#[inline(always)]
fn is_same_surface(a: f32, b: f32) -> bool {
    (a - b).abs() <= EDGE * a.max(b)
}

#[cfg(test)]
#[inline(always)]
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}
