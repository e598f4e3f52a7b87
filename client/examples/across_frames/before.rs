//! Normals guessed from the frame before: both ends hold it as decoded, and look up where each pixel's point was seen.
//!
//! Of all planes but colour, normals cost the most where water is in view, and of all predictions across frames this one
//! pays: a wave that an interpolation within the frame has to spell out was there in the frame before. Depths are
//! coded first and alone; with them a pixel's point is known, moves rigidly into the view of the frame before, and is found
//! there by its projection (backward warping, as in the reverse reprojection cache of Nehab et al. 2007). Where the same
//! boundary was seen at that distance, the four normals around the place are interpolated, turned to the new view and
//! quantised: the guess. It is right for surfaces that stand still, and a guess only, for the residual is coded. What it
//! saves, and why colours and depths are not guessed: docs/measurements/2026-11-22-across-frames.md.
//!
//! Both ends agree to the bit on every machine with IEEE arithmetic: sums, products, quotients, roots and floors of f32, in a
//! fixed order and never fused, and the same of f64 between the poses; no function of a mathematics library. Both must
//! be given the same: poses and cameras as they travel, and distances, boundaries and normals as decoded. After a key frame,
//! or for whoever connects again, there is no frame before, and no guess.
//!
//! Limits: the root's normals only. Those of a child lie behind a surface that bends rays: guessed through the unfolded
//! point they save little at a calm head and cost more at a fast one. No stream uses the guesses yet: a pixel with a
//! boundary costs some 90 ns, of which a receiver has not enough.

use glam::{Vec2, Vec3};
use std::ops::Range;
use warplight_protocol::frame::Tree;
use warplight_protocol::{Camera, Pose};

/// What stands for no guess; no code of a normal is that large.
pub(super) const NO_GUESS: [u16; 2] = [u16::MAX; 2];

/// A point counts as seen before where the distance there differs by no more than this part: less than a surface's change
/// over a pixel at grazing angles, more than that between a ball and the wall behind. Only which pixels have a guess depends on it.
const SAME_DISTANCE: f32 = 1.0 / 16.0;

/// The root of the frame before, as both ends have it.
#[derive(Debug)]
pub(super) struct NormalsBefore {
    camera: Camera,
    render_pose: Pose,
    distance: Vec<f32>,
    interface: Vec<u8>,
    normal: Vec<Vec3>,
}

impl NormalsBefore {
    /// Keeps what the next frame needs of a decoded one.
    pub(super) fn new(decoded: &Tree) -> NormalsBefore {
        let (camera, render_pose) = (decoded.camera, decoded.render_pose);
        let mut before =
            NormalsBefore { camera, render_pose, distance: Vec::new(), interface: Vec::new(), normal: Vec::new() };
        before.remember(decoded);
        before
    }

    /// The same, into memory that is there already.
    pub(super) fn remember(&mut self, decoded: &Tree) {
        let root = &decoded.nodes[0];
        self.camera = decoded.camera;
        self.render_pose = decoded.render_pose;
        self.distance.clone_from(&root.distance);
        // A plan without children has no boundaries.
        self.interface.clone_from(&root.interface);
        self.interface.resize(root.distance.len(), 0);
        self.normal.clear();
        let [x, y, z] = &root.normal;
        self.normal.extend(x.iter().zip(y).zip(z).map(|((&x, &y), &z)| Vec3::new(x, y, z)));
        self.normal.resize(root.distance.len(), Vec3::ZERO);
    }

    /// Guesses the codes of `bits` bits of the root's normals in some rows of a new frame, of which distances and boundaries
    /// are known; [`NO_GUESS`] where there is no boundary, or where it was not seen before.
    pub(super) fn guess(
        &self,
        camera: &Camera,
        render_pose: &Pose,
        rows: Range<u32>,
        (distance, interface): (&[f32], &[u8]),
        bits: u8,
        guesses: &mut Vec<[u16; 2]>,
    ) {
        let before_from_now = self.render_pose.view_from(render_pose);
        let now_from_before = render_pose.view_from(&self.render_pose);
        let first = rows.start as usize * camera.size.width as usize;
        guesses.clear();
        guesses.extend(distance.iter().zip(interface).enumerate().map(|(index, (&distance, &interface))| {
            if interface == 0 {
                return NO_GUESS;
            }
            let ray = camera.ray_in_view(camera.size.pixel_centre(first + index));
            let point = before_from_now.point(ray * (distance / ray.length()));
            match self.normal_seen(point, interface) {
                Some(normal) => octahedral(now_from_before.direction(normal), bits),
                None => NO_GUESS,
            }
        }));
    }

    /// The normal that was seen at a point of the frame before's view, not of unit length.
    fn normal_seen(&self, point_in_view: Vec3, interface: u8) -> Option<Vec3> {
        let size = self.camera.size;
        let place = self.camera.pixel_from_view(point_in_view)?;
        let inside = place.x >= 0.0 && place.y >= 0.0 && place.x < size.width as f32 && place.y < size.height as f32;
        if !inside {
            return None;
        }
        let width = size.width as usize;
        let nearest = place.y as usize * width + place.x as usize;
        let expected = point_in_view.length();
        // Written so that what is no number is not seen.
        let is_same = (self.distance[nearest] - expected).abs() <= SAME_DISTANCE * expected;
        if !(is_same && self.interface[nearest] == interface) {
            return None;
        }
        let corner = (place - 0.5).floor().max(Vec2::ZERO);
        let last = Vec2::new(size.width as f32 - 1.0, size.height as f32 - 1.0);
        let beyond = (corner + 1.0).min(last);
        let t = (place - 0.5 - corner).max(Vec2::ZERO);
        let pixels = [(corner.x, corner.y), (beyond.x, corner.y), (corner.x, beyond.y), (beyond.x, beyond.y)];
        let pixels = pixels.map(|(x, y)| y as usize * width + x as usize);
        if pixels.iter().any(|&pixel| self.interface[pixel] != interface) {
            return Some(self.normal[nearest]);
        }
        let [a, b, c, d] = pixels.map(|pixel| self.normal[pixel]);
        let (upper, lower) = (a + (b - a) * t.x, c + (d - c) * t.x);
        Some(upper + (lower - upper) * t.y)
    }
}

/// The codes of a direction in the octahedral map, as frames have them.
fn octahedral(normal: Vec3, bits: u8) -> [u16; 2] {
    let unit = normal / (normal.x.abs() + normal.y.abs() + normal.z.abs());
    let under = Vec2::new((1.0 - unit.y.abs()) * 1_f32.copysign(unit.x), (1.0 - unit.x.abs()) * 1_f32.copysign(unit.y));
    let folded = if unit.z >= 0.0 { unit.truncate() } else { under };
    let largest = ((1_u32 << bits) - 2) as f32;
    let code = |value: f32| ((value * 0.5 + 0.5) * largest + 0.5).min(largest) as u16;
    [code(folded.x), code(folded.y)]
}
