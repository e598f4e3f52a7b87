//! Surfaces behind media: the picture of a frame with layers of volume.
//!
//! warp -> **march** -> composite. Surfaces are warped into linear radiance with the inverse depth of each pixel, which says
//! where rays end; the layers are marched up to there; and both are put together. Where the display shows more than the
//! frame, media are not known, and the picture is filled from around it by push-pull.

use super::canvas::Canvas;
use super::reproject::Reprojection;
use super::specular::View;
use super::{HOLE, WarpStatistics, Warper, fit};
use crate::lanes::{Floats, kernel};
use crate::march::Method;
use glam::{Vec2, Vec3, Vec4};
use image::RgbImage;
use rayon::prelude::*;
use warplight_protocol::frame::Tree;
use warplight_protocol::{Camera, Pose};

/// The steps of a picture with media, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MediaStage {
    /// Warps the surfaces behind, as of a frame without media.
    Surfaces,
    /// Integrates the segments of the frame again.
    March,
    /// Puts the one before the other; tone.
    Composite,
}

impl MediaStage {
    /// All of them.
    pub const ALL: [MediaStage; 3] = [MediaStage::Surfaces, MediaStage::March, MediaStage::Composite];

    /// Name in benches.
    pub fn name(self) -> &'static str {
        match self {
            MediaStage::Surfaces => "surfaces",
            MediaStage::March => "march",
            MediaStage::Composite => "composite, tone",
        }
    }
}

impl Warper {
    /// Surfaces, and before them the media of the frame's layers.
    pub(super) fn paint_behind_media(
        &mut self,
        method: Method,
        tree: &Tree,
        display_pose: &Pose,
        camera: &Camera,
        canvas: &mut Canvas<'_>,
    ) -> WarpStatistics {
        let statistics = self.warp_behind_media(display_pose, camera);
        self.march_to_surfaces(method, tree, display_pose, camera);
        let holes = self.compose_media(tree, display_pose, camera, canvas);
        WarpStatistics { hole_fraction: statistics.hole_fraction.max(holes), ..statistics }
    }

    /// The surfaces, and where rays end.
    fn warp_behind_media(&mut self, display_pose: &Pose, camera: &Camera) -> WarpStatistics {
        let (pixels, width) = (camera.size.pixels(), camera.size.width as usize);
        let Warper { level, layered, pipeline, pyramid, radiance, inverse_depth, surface_m, .. } = self;
        radiance.resize(pixels, Vec3::ZERO);
        inverse_depth.resize(pixels, 0.0);
        let mut behind = Canvas::Behind { radiance, inverse_depth };
        let sources = layered.seen_from(display_pose, camera);
        let view = View { level: *level, display_pose, camera };
        pipeline.warp(&view, sources.iter(), &mut behind, pyramid);
        let (nodes, hole_fraction) = pipeline.statistics();
        surface_m.resize(pixels, f32::INFINITY);
        let rows = surface_m.par_chunks_mut(width).zip(inverse_depth.par_chunks(width));
        rows.enumerate().for_each(|(y, (surface_m, inverse_depth))| {
            for (x, (surface_m, &inverse_depth)) in surface_m.iter_mut().zip(inverse_depth).enumerate() {
                let ray = camera.ray_in_view(Vec2::new(x as f32, y as f32) + 0.5);
                *surface_m = if inverse_depth > 0.0 { ray.length() / inverse_depth } else { f32::INFINITY };
            }
        });
        WarpStatistics { hole_fraction, nodes }
    }

    fn march_to_surfaces(&mut self, method: Method, tree: &Tree, display_pose: &Pose, camera: &Camera) {
        let Warper { marcher, surface_m, media, .. } = self;
        marcher.march(method, tree, display_pose, camera, Some(surface_m), media);
    }

    /// Paints both; returns the fraction of pixels that show more than the frame.
    fn compose_media(&mut self, tree: &Tree, display_pose: &Pose, camera: &Camera, canvas: &mut Canvas<'_>) -> f64 {
        let width = camera.size.width as usize;
        let Warper { level, media, radiance, marcher, pyramid, .. } = self;
        let level = *level;
        let beyond = Beyond::new(marcher.depths_m(), tree, display_pose, camera);
        let Some(beyond) = beyond.filter(|_| marcher.reaches_border()) else {
            let rows = media.par_chunks_mut(width).zip(radiance.par_chunks(width)).zip(canvas.runs(width));
            rows.for_each(|((media, radiance), mut canvas)| through_media(level, media, radiance, &mut canvas));
            return 0.0;
        };
        // Beyond the border of the frame media are not known: what is around goes on.
        let rows = media.par_chunks_mut(width).zip(radiance.par_chunks_mut(width));
        rows.enumerate().for_each(|(y, (media, surfaces))| {
            for (x, (media, surface)) in media.iter().zip(surfaces).enumerate() {
                let is_beyond = beyond.holds(Vec2::new(x as f32, y as f32) + 0.5);
                *surface = if is_beyond { HOLE } else { media.truncate() + media.w * *surface };
            }
        });
        let holes = pyramid.fill(radiance, width);
        canvas.runs(width).zip(radiance.par_chunks(width)).for_each(|(mut canvas, radiance)| {
            canvas.paint_exactly(0, radiance);
        });
        holes as f64 / radiance.len().max(1) as f64
    }

    /// Runs one stage of a picture with media by `Mode::Specular`, those before it having run for the same pose: for
    /// benches.
    pub fn run_media(
        &mut self,
        stage: MediaStage,
        tree: &Tree,
        display_pose: &Pose,
        camera: &Camera,
        exposure: f32,
        picture: &mut RgbImage,
    ) {
        match stage {
            MediaStage::Surfaces => {
                self.warp_behind_media(display_pose, camera);
            }
            MediaStage::March => self.march_to_surfaces(Method::Layers, tree, display_pose, camera),
            MediaStage::Composite => {
                fit(picture, camera);
                let (codes, _) = picture.as_chunks_mut::<3>();
                self.compose_media(tree, display_pose, camera, &mut Canvas::Codes { codes, exposure });
            }
        }
    }
}

/// Where a picture shows more than its frame, at the near or the far end of a volume.
struct Beyond {
    old_from_new: Reprojection,
    inverse_depths: [f32; 2],
    size: Vec2,
}

impl Beyond {
    /// `None` where the frame covers the picture.
    fn new([near_m, far_m]: [f32; 2], tree: &Tree, display_pose: &Pose, camera: &Camera) -> Option<Beyond> {
        let old_from_new = Reprojection::new(camera, display_pose, &tree.camera, &tree.render_pose);
        let size = Vec2::new(tree.camera.size.width as f32, tree.camera.size.height as f32);
        // An eye within the volume moves beyond every frame of what is next to it: that is let pass.
        let near_m = near_m.max(0.25 * far_m).max(1e-6);
        let beyond = Beyond { old_from_new, inverse_depths: [1.0 / near_m, 1.0 / far_m.max(near_m)], size };
        let [right, bottom] = [camera.size.width as f32 - 0.5, camera.size.height as f32 - 0.5];
        let corners = [(0.5, 0.5), (right, 0.5), (0.5, bottom), (right, bottom)];
        // A frame is convex, and so is what it covers.
        corners.iter().any(|&(x, y)| beyond.holds(Vec2::new(x, y))).then_some(beyond)
    }

    fn holds(&self, pixel: Vec2) -> bool {
        self.inverse_depths.iter().any(|&inverse_depth| {
            let h = self.old_from_new.homogeneous(pixel, inverse_depth);
            let old = h.truncate() / h.z;
            !(h.z > 0.0 && old.cmpge(Vec2::ZERO).all() && old.cmple(self.size).all())
        })
    }
}

/// Paints a row of surfaces as seen through media, which become the sums of both.
#[inline(always)]
fn cover<F: Floats>(media: &mut [Vec4], surfaces: &[Vec3], canvas: &mut Canvas<'_>) {
    for (media, &surface) in media.iter_mut().zip(surfaces) {
        *media += media.w * surface.extend(0.0);
    }
    canvas.paint::<F>(0, media);
}

kernel!(fn through_media = cover(media: &mut [Vec4], surfaces: &[Vec3], canvas: &mut Canvas<'_>));
