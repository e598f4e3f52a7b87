//! Decoded frames, the latest first: what it does not know, an earlier one may.
//!
//! A frame that looks around is as many decoded frames as it has faces; the one that shows the middle of the display
//! is asked first, then those about it.

use super::faces::copy_face;
use super::prepared::{Prepared, Rung};
use crate::lanes::Level;
use glam::{DVec3, Vec2};
use warplight_protocol::camera::Projection;
use warplight_protocol::frame::Tree;
use warplight_protocol::{Camera, Pose};

/// Most frames before the latest that are kept.
pub(super) const MAX_EARLIER: usize = 4;
/// Faces of a frame, at most.
const MAX_FACES: usize = 6;

/// A frame by its faces.
#[derive(Debug, Default)]
struct Faces {
    faces: Vec<Prepared>,
    pose: Option<Pose>,
}

/// The latest frame, and as many earlier ones as are asked for.
#[derive(Debug, Default)]
pub(super) struct Frames {
    frames: Vec<Faces>,
    /// How many of them hold a frame.
    count: usize,
    /// A face as a tree of its own.
    face: Option<Tree>,
}

/// What a picture is made from, in the order in which it is asked.
#[derive(Debug)]
pub(super) struct Sources<'a> {
    sources: [Option<&'a Prepared>; (MAX_EARLIER + 1) * MAX_FACES],
    count: usize,
}

impl<'a> Sources<'a> {
    /// Those that are there.
    pub(super) fn iter(&self) -> impl Iterator<Item = &'a Prepared> {
        self.sources[..self.count].iter().flatten().copied()
    }
}

impl Frames {
    /// Decodes a frame, which becomes the latest, and keeps so many of the earlier ones. A frame from the pose of the
    /// latest takes its place: it knows what that knew.
    pub(super) fn take_in(&mut self, level: Level, rung: Rung, tree: &Tree, earlier: usize) {
        let kept = earlier.min(MAX_EARLIER) + 1;
        self.frames.resize_with(kept, Faces::default);
        self.count = self.count.min(kept);
        let is_again = self.count > 0 && self.frames[0].pose == Some(tree.render_pose);
        if !is_again {
            self.frames.rotate_right(1);
            self.count = (self.count + 1).min(kept);
        }
        let Frames { frames, face, .. } = self;
        let latest = &mut frames[0];
        latest.pose = Some(tree.render_pose);
        latest.faces.resize_with(tree.camera.faces().len(), Prepared::default);
        if tree.camera.projection == Projection::Perspective {
            latest.faces[0].set(rung);
            latest.faces[0].prepare(level, tree);
            return;
        }
        for (of_frame, prepared) in tree.camera.faces().zip(&mut latest.faces) {
            let face = face.get_or_insert_with(|| {
                Tree::new(tree.render_pose, of_frame.camera, tree.plan.clone(), tree.interfaces.clone())
            });
            copy_face(tree, &of_frame, face);
            prepared.set(rung);
            prepared.prepare(level, face);
        }
    }

    /// Takes over the latest frame of another one, which gets the memory of the oldest here.
    pub(super) fn adopt(&mut self, other: &mut Frames, earlier: usize) {
        if other.count == 0 {
            return;
        }
        let kept = earlier.min(MAX_EARLIER) + 1;
        self.frames.resize_with(kept, Faces::default);
        self.count = self.count.min(kept);
        if self.count == 0 || self.frames[0].pose != other.frames[0].pose {
            self.frames.rotate_right(1);
            self.count = (self.count + 1).min(kept);
        }
        std::mem::swap(&mut self.frames[0], &mut other.frames[0]);
        other.count = 0;
    }

    /// Everything that is decoded.
    pub(super) fn prepared_mut(&mut self) -> impl Iterator<Item = &mut Prepared> {
        self.frames.iter_mut().flat_map(|frame| &mut frame.faces)
    }

    /// Forgets all.
    pub(super) fn clear(&mut self) {
        self.count = 0;
    }

    /// What may be seen of the frames from this pose, the latest first, and of each the face that looks most alike.
    pub(super) fn seen_from(&self, display_pose: &Pose, camera: &Camera) -> Sources<'_> {
        let mut sources = Sources { sources: [None; (MAX_EARLIER + 1) * MAX_FACES], count: 0 };
        let axis = |pose: &Pose| pose.orientation * DVec3::NEG_Z;
        let towards = axis(display_pose);
        for frame in &self.frames[..self.count] {
            let first = sources.count;
            for face in &frame.faces {
                let apart = axis(&face.pose).dot(towards).clamp(-1.0, 1.0).acos() as f32;
                if frame.faces.len() == 1 || apart < corner_rad(&face.camera) + corner_rad(camera) {
                    sources.sources[sources.count] = Some(face);
                    sources.count += 1;
                }
            }
            let alike = |source: &Option<&Prepared>| source.map_or(-1.0, |face| axis(&face.pose).dot(towards));
            sources.sources[first..sources.count].sort_unstable_by(|a, b| alike(b).total_cmp(&alike(a)));
        }
        sources
    }
}

/// Angle between the axis and the corner farthest from it.
fn corner_rad(camera: &Camera) -> f32 {
    let reach = |low: f32, high: f32| low.abs().max(high.abs());
    let fov = camera.fov;
    Vec2::new(reach(fov.left, fov.right), reach(fov.down, fov.up)).length().atan()
}
