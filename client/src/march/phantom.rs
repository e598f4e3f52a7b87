//! Volumes in closed form, to test and to measure on: a homogeneous cube, nested organs, a cloud.
//!
//! A phantom is matter about the origin of the world, within half a metre: extinction and source radiance of each point.
//! Its frames are made by marching the ray of each pixel in steps of a few millimetres and cutting it into segments of equal
//! opacity, empty space left out at their ends (quantiles of the thesis, 3.3.6, in their simplest form), its pictures
//! by marching the same way from any pose. A frame therefore is exact from its own pose, and the picture is the truth
//! for any other. These are stand-ins for scanned volumes: sharp and soft edges, hollows, thin shells, matter of
//! all densities. Cost: seconds for a picture of a megapixel.

use glam::{DVec3, Vec4};
use rayon::prelude::*;
use warplight_protocol::camera::ImageSize;
use warplight_protocol::frame::{Interfaces, Plan, Tree, VolumeSegment};
use warplight_protocol::{Camera, Pose};

use super::transport::Transport;
use super::view::{Ray, Rays};

/// A volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phantom {
    /// A cube of a metre's edge, the same throughout.
    Cube,
    /// A trunk: thin skin, faint flesh with two hollow lungs, dense spine, ribs and a heart.
    Ct,
    /// A heap of soft blobs with a rough surface, brighter towards the top.
    Cloud,
}

/// Half the edge of the cube that holds a phantom, metres.
const HALF_M: f64 = 0.5;

impl Phantom {
    /// Every phantom.
    pub const ALL: [Phantom; 3] = [Phantom::Cube, Phantom::Ct, Phantom::Cloud];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Phantom::Cube => "cube",
            Phantom::Ct => "ct",
            Phantom::Cloud => "cloud",
        }
    }

    /// Extinction per metre and source radiance at a point.
    pub fn matter(self, point: DVec3) -> (f64, DVec3) {
        match self {
            Phantom::Cube => (1.5, DVec3::new(0.9, 0.5, 0.2)),
            Phantom::Ct => trunk(point),
            Phantom::Cloud => cloud(point),
        }
    }

    /// Steps of a ray through it.
    fn steps(self) -> usize {
        match self {
            Phantom::Cube => 64,
            Phantom::Ct => 320,
            Phantom::Cloud => 128,
        }
    }

    /// What a ray gathers from it.
    pub fn radiance(self, origin: DVec3, direction: DVec3) -> Vec4 {
        let mut gathered = Transport::default();
        for bin in self.bins(&Ray { origin, direction }) {
            gathered.cross(bin.optical_depth, bin.source);
        }
        gathered.radiance.as_vec3().extend(gathered.transmittance as f32)
    }

    /// The true picture: radiance and transmittance of each pixel.
    pub fn picture(self, pose: &Pose, camera: &Camera) -> Vec<Vec4> {
        let rays = world_rays(pose, camera);
        let size = camera.size;
        let pixels = (0..size.pixels()).into_par_iter().with_min_len(size.width as usize);
        pixels
            .map(|pixel| {
                let ray = rays.through(pixel % size.width as usize, pixel / size.width as usize);
                let [origin, direction] = [ray.origin, ray.direction].map(flip);
                self.radiance(origin, direction)
            })
            .collect()
    }

    /// The frame of so many layers, without a surface.
    pub fn frame(self, pose: &Pose, camera: &Camera, layers: usize) -> Tree {
        let mut tree = Tree::new(*pose, *camera, Plan::diffuse(), Interfaces::default());
        tree.nodes[0].distance.fill(f32::INFINITY);
        tree.set_layers(layers);
        let rays = world_rays(pose, camera);
        let width = camera.size.width as usize;
        tree.bands_mut(8).into_par_iter().for_each(|mut band| {
            for (at, row) in band.rows.clone().enumerate() {
                for column in 0..width {
                    let ray = rays.through(column, row as usize);
                    let [origin, direction] = [ray.origin, ray.direction].map(flip);
                    let segments = segments(&self.bins(&Ray { origin, direction }), band.layers.len());
                    for (layer, rows) in band.layers.iter_mut().enumerate() {
                        rows.set(at * width + column, segments.get(layer));
                    }
                }
            }
        });
        tree
    }

    /// The ray in steps, each as if the matter at its middle filled it.
    fn bins(self, ray: &Ray) -> Vec<Bin> {
        let (mut start, mut end) = (0.0_f64, f64::INFINITY);
        for axis in 0..3 {
            let over = 1.0 / ray.direction[axis];
            let (a, b) = ((-HALF_M - ray.origin[axis]) * over, (HALF_M - ray.origin[axis]) * over);
            (start, end) = (start.max(a.min(b)), end.min(a.max(b)));
        }
        if start >= end {
            return Vec::new();
        }
        let (count, length) = (self.steps(), ray.direction.length());
        let step = (end - start) / count as f64;
        let bins = (0..count).map(|index| {
            let t = start + step * index as f64;
            let (extinction, source) = self.matter(ray.at(t + 0.5 * step));
            Bin { start: t, end: t + step, optical_depth: extinction * step * length, source }
        });
        bins.collect()
    }
}

/// A step of a ray: parameters of its ends, and what fills it.
struct Bin {
    start: f64,
    end: f64,
    optical_depth: f64,
    source: DVec3,
}

/// The orbit from which phantoms are looked at, so many radians around: a cube fills 40 % of a picture of 60 degrees.
pub fn orbit(angle_rad: f64) -> Pose {
    let angle_rad = angle_rad + 0.4;
    Pose::look_at(DVec3::new(1.6 * angle_rad.sin(), 0.35, 1.6 * angle_rad.cos()), DVec3::ZERO)
}

/// A camera of 60 degrees with so many pixels on each side.
pub fn camera(side_px: u32) -> Camera {
    Camera::symmetric(60.0_f32.to_radians(), ImageSize::new(side_px, side_px))
}

/// Rays in a space with y and z the other way round than in the world; see [`flip`].
fn world_rays(pose: &Pose, camera: &Camera) -> Rays {
    Rays::new(&Pose::IDENTITY, pose, camera)
}

fn flip(vector: DVec3) -> DVec3 {
    DVec3::new(vector.x, -vector.y, -vector.z)
}

/// Cuts a ray at equal shares of its opacity. Rays have depth 1 per unit of parameter, so parameters are depths in view.
fn segments(bins: &[Bin], count: usize) -> Vec<VolumeSegment> {
    let total: f64 = bins.iter().map(|bin| bin.optical_depth).sum();
    let opacity = -(-total).exp_m1();
    let (mut found, mut passed) = (Vec::with_capacity(count), 0.0);
    let mut current: Option<(f64, f64, Transport, f64)> = None;
    for bin in bins.iter().filter(|bin| bin.optical_depth > 0.0) {
        let (start, mut end, mut within, mut depth) =
            current.take().unwrap_or((bin.start, bin.end, Transport::default(), 0.0));
        end = end.max(bin.end);
        within.cross(bin.optical_depth, bin.source);
        depth += bin.optical_depth;
        passed += bin.optical_depth;
        let share = -(-passed).exp_m1() / opacity * count as f64;
        current = Some((start, end, within, depth));
        if share >= (found.len() + 1) as f64 && found.len() + 1 < count {
            found.extend(current.take().map(segment));
        }
    }
    found.extend(current.take().map(segment));
    found
}

fn segment((start, end, within, optical_depth): (f64, f64, Transport, f64)) -> VolumeSegment {
    let source = (within.radiance / -(-optical_depth).exp_m1()).as_vec3();
    VolumeSegment { front_m: start as f32, back_m: end as f32, optical_depth: optical_depth as f32, source }
}

/// 1 within an ellipsoid and 0 outside, over a soft edge of a few millimetres.
fn ellipsoid(point: DVec3, centre: [f64; 3], radii: [f64; 3]) -> f64 {
    let radii = DVec3::from_array(radii);
    let scaled = (point - DVec3::from_array(centre)) / radii;
    ((1.0 - scaled.length()) * radii.min_element() / 0.004 + 0.5).clamp(0.0, 1.0)
}

fn trunk(point: DVec3) -> (f64, DVec3) {
    let skin = ellipsoid(point, [0.0; 3], [0.46, 0.48, 0.34]);
    if skin == 0.0 {
        return (0.0, DVec3::ZERO);
    }
    let inside = ellipsoid(point, [0.0; 3], [0.445, 0.465, 0.325]);
    let side = DVec3::new(point.x.abs(), point.y, point.z);
    let lung = ellipsoid(side, [0.2, 0.05, 0.02], [0.14, 0.3, 0.2]);
    let heart = ellipsoid(point, [0.05, -0.02, 0.12], [0.09, 0.11, 0.08]);
    let bumps = 1.0 + 0.25 * (point.y * 90.0).sin();
    let spine = ellipsoid(DVec3::new(point.x, 0.0, point.z), [0.0, 0.0, -0.22], [0.05 * bumps, 1.0, 0.05 * bumps]);
    let cage = ellipsoid(point, [0.0; 3], [0.40, 0.44, 0.29]) - ellipsoid(point, [0.0; 3], [0.38, 0.42, 0.27]);
    let rib = cage * (((point.y + 0.15 * point.z) * 55.0).sin() * 4.0 - 1.0).clamp(0.0, 1.0);
    let flesh = inside * (1.0 - lung) * 0.8;
    let parts = [
        (skin - inside, 12.0, DVec3::new(0.55, 0.38, 0.3)),
        (flesh, 1.0, DVec3::new(0.5, 0.12, 0.1)),
        (heart, 60.0, DVec3::new(0.7, 0.08, 0.06)),
        (spine * inside, 90.0, DVec3::new(0.9, 0.86, 0.75)),
        (rib, 120.0, DVec3::new(0.85, 0.82, 0.7)),
    ];
    let shade = 0.75 + 0.25 * (point.x * 40.0).sin() * (point.y * 37.0).sin() * (point.z * 43.0).sin();
    mixed(parts.into_iter().map(|(part, extinction, source)| (part * extinction, source * shade)))
}

fn cloud(point: DVec3) -> (f64, DVec3) {
    /// Centres and radii of the blobs.
    const BLOBS: [[f64; 4]; 9] = [
        [0.0, -0.05, 0.0, 0.16],
        [-0.2, -0.08, 0.05, 0.12],
        [0.22, -0.1, 0.02, 0.11],
        [-0.08, 0.1, -0.08, 0.11],
        [0.1, 0.12, 0.08, 0.1],
        [-0.05, -0.1, 0.2, 0.1],
        [0.08, -0.12, -0.22, 0.1],
        [0.02, 0.22, 0.0, 0.07],
        [-0.28, 0.02, -0.1, 0.07],
    ];
    let swirl = DVec3::new((point.y * 31.0).sin(), (point.z * 29.0).sin(), (point.x * 37.0).sin()) * 0.02
        + DVec3::new((point.z * 83.0).sin(), (point.x * 71.0).sin(), (point.y * 79.0).sin()) * 0.008;
    let bent = point + swirl;
    let mut density = 0.0;
    for [x, y, z, radius] in BLOBS {
        let square = (bent - DVec3::new(x, y, z)).length_squared() / (radius * radius);
        density += if square < 9.0 { (-square).exp() } else { 0.0 };
    }
    let extinction = (density - 0.12).max(0.0) * 22.0;
    let light = 0.35 + 0.9 * (point.y + 0.35).clamp(0.0, 0.7) + 0.1 * (bent.x * 23.0).sin();
    (extinction, DVec3::new(0.95, 0.97, 1.0) * light)
}

/// Extinctions add up; the source radiance is their mean.
fn mixed(parts: impl Iterator<Item = (f64, DVec3)>) -> (f64, DVec3) {
    let (extinction, sent) = parts
        .fold((0.0, DVec3::ZERO), |(sum, sent), (extinction, source)| (sum + extinction, sent + source * extinction));
    (extinction, if extinction > 0.0 { sent / extinction } else { DVec3::ZERO })
}
