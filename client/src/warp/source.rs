//! A frame made ready to be warped: its picture from its own pose, and the inverse depth of what it shows.
//!
//! A pixel of the old picture is the homogeneous point (ray, w) with w = 1 / z: in a new view it lies along
//! `R ray + t w`, which holds for w = 0, at infinity, too.

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use warplight_protocol::frame::{Tree, flatten};
use warplight_protocol::pose::RigidMotion;
use warplight_protocol::{Camera, ImageSize, Pose};

/// Steps of a texel's width that a sample position is rounded to, as texture units do: rounding errors of a
/// thousandth of a pixel then change nothing, and the picture of an unmoved head is the old one to the bit.
const SUBTEXELS: f32 = 256.0;

/// Texels whose inverse depths differ by more than this fraction lie on different surfaces.
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
            for (x, inverse_depth) in inverse_depth.iter_mut().enumerate() {
                let ray = tree.camera.ray_in_view(tree.camera.size.pixel_centre(first + x));
                *inverse_depth = ray.length() / tree.nodes[0].distance[first + x];
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
    pub(super) fn inverse_depth(&self, texel: usize) -> f32 {
        self.inverse_depth[texel]
    }

    /// The texel that holds a position, if it is in the picture.
    pub(super) fn texel_at(&self, pixel: Vec2) -> Option<usize> {
        let size = self.camera.size;
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < size.width as f32 && pixel.y < size.height as f32;
        inside.then(|| pixel.y as usize * size.width as usize + pixel.x as usize)
    }

    /// Where the point seen at `pixel` lies in a new view, up to scale: `R ray + t w`, with w interpolated where
    /// the texels around are of one surface, else that of the texel itself.
    pub(super) fn point_at(&self, pixel: Vec2, new_from_old: &RigidMotion) -> Option<Vec3> {
        let texel = self.texel_at(pixel)?;
        let own = self.inverse_depth[texel];
        let Footprint { texels, fraction } = self.footprint(pixel);
        let [a, b, c, d] = texels.map(|texel| self.inverse_depth[texel]);
        let same_surface = [a, b, c, d].into_iter().all(|other| is_same_surface(own, other));
        let w = if same_surface { lerp(lerp(a, b, fraction.x), lerp(c, d, fraction.x), fraction.y) } else { own };
        Some(new_from_old.rotation * self.camera.ray_in_view(pixel) + new_from_old.translation * w)
    }

    /// Radiance at a position, bilinear; `None` outside the picture.
    pub(super) fn radiance_at(&self, pixel: Vec2) -> Option<Vec3> {
        self.texel_at(pixel)?;
        let Footprint { texels, fraction } = self.footprint(pixel);
        let [a, b, c, d] = texels.map(|texel| self.radiance[texel]);
        let upper = a + (b - a) * fraction.x;
        let lower = c + (d - c) * fraction.x;
        Some(upper + (lower - upper) * fraction.y)
    }

    /// Radiance at a position, bilinear over those texels that show the same surface as the nearest one.
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

    fn footprint(&self, pixel: Vec2) -> Footprint {
        let size = self.camera.size;
        let (last_x, last_y) = (size.width as i32 - 1, size.height as i32 - 1);
        let steps = ((pixel - 0.5) * SUBTEXELS).round();
        let corner = (steps / SUBTEXELS).floor();
        let fraction = steps / SUBTEXELS - corner;
        let (x, y) = (corner.x as i32, corner.y as i32);
        let texel = |x: i32, y: i32| y.clamp(0, last_y) as usize * size.width as usize + x.clamp(0, last_x) as usize;
        Footprint { texels: [texel(x, y), texel(x + 1, y), texel(x, y + 1), texel(x + 1, y + 1)], fraction }
    }
}

fn is_same_surface(a: f32, b: f32) -> bool {
    (a - b).abs() <= EDGE * a.max(b)
}

fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}
