//! A volume scene under study: frames of it from one pose, and what is really seen from others.
//!
//! The head goes around the scene's media, about a vertical axis through their middle, as in the thesis. What is really
//! seen is the server's own march through the same media in the same light, from the new pose; so errors are those of
//! layers and of bringing them to a new pose, and not of the light. Pictures are compared before a background: black, white,
//! or the scene's environment.

use super::super::SweepError;
use super::Setting;
use crate::loopback::{Loopback, ReceivedFrame};
use crate::measure::{dssim, psnr_srgb8};
use glam::{DQuat, DVec3, Vec3, Vec4};
use image::RgbImage;
use rayon::prelude::*;
use std::sync::Arc;
use warplight_protocol::codec::FrameShape;
use warplight_protocol::frame::{ColorCoding, FrameFormat, Layering, Plan, Tree, VolumeFormat};
use warplight_protocol::tone::ToneTable;
use warplight_protocol::{Camera, ImageSize, Pose};
use warplight_server::counters::Counters;
use warplight_server::frame::{BAND_ROWS, FrameRenderer, FrameRequest, LayersRequest};
use warplight_server::layering::optimal::cut_plainly;
use warplight_server::layering::{Cutter, Profile, Segments};
use warplight_server::march::MediaBounds;
use warplight_server::scene::Scene;

/// Longest path of the light in media: 64 scatterings leave little in the densest cloud.
const MAX_DEPTH: u32 = 64;

/// What stands behind the media.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Background {
    Black,
    White,
    Environment,
}

impl Background {
    pub(super) const ALL: [Background; 3] = [Background::Black, Background::White, Background::Environment];
}

/// A scene, its light, and the eye that frames are rendered for.
pub(in crate::sweep) struct Study {
    renderer: FrameRenderer,
    bounds: MediaBounds,
    eye: Pose,
    pub(in crate::sweep) camera: Camera,
}

/// How far a picture is from what is really seen.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PictureError {
    pub(super) dssim: f64,
    pub(super) psnr_db: f64,
}

impl Study {
    /// Of a scene by name or file, with its extinction times `density`, lit by so many samples per voxel.
    pub(super) fn new(scene: &str, density: f32, size: ImageSize, light_spp: u32) -> Result<Study, SweepError> {
        let mut scene = Scene::load(scene).map_err(|error| SweepError::Scene(error.to_string()))?;
        scene.media.iter_mut().for_each(|medium| medium.scale(density));
        let view = scene.cameras.first();
        let eye = view.map_or(scene.head, |view| view.pose);
        let bounds = MediaBounds::of(&scene);
        if bounds.is_empty() {
            return Err(SweepError::Scene(format!("--scene {}: expected one with a volume", scene.name)));
        }
        let fov = view.map_or(1.0, |view| view.vertical_fov_rad);
        let renderer = FrameRenderer::new(Arc::new(scene));
        renderer.refine_all_light(light_spp, MAX_DEPTH, 1);
        Ok(Study { renderer, bounds, eye, camera: Camera::symmetric(fov, size) })
    }

    /// The eye so many degrees further around.
    pub(in crate::sweep) fn pose(&self, degrees: f64) -> Pose {
        let turn = DQuat::from_axis_angle(DVec3::Y, degrees.to_radians());
        let middle = self.bounds.middle();
        Pose {
            position: middle + turn * (self.eye.position - middle),
            orientation: (turn * self.eye.orientation).normalize(),
        }
    }

    /// A frame for the first pose, and what it says of the ray of every pixel, before it is coded.
    pub(super) fn tree(&self, format: VolumeFormat, exactly: bool) -> Tree {
        let pose = self.pose(0.0);
        let range = self.bounds.range(&pose);
        let request = FrameRequest {
            render_pose: pose,
            camera: self.camera,
            plan: Plan::diffuse(),
            volume: Some(LayersRequest { format, range, exactly }),
            spp: 1,
            max_depth: 1,
            seed: 0,
        };
        let mut tree = Tree::new(pose, self.camera, Plan::diffuse(), Default::default());
        self.renderer.render(&request, &mut tree, &Counters::default(), &|_| {});
        tree
    }

    /// A frame as it arrives.
    pub(super) fn received(
        &self,
        tree: Tree,
        volume: VolumeFormat,
        color_coding: ColorCoding,
    ) -> Result<ReceivedFrame, SweepError> {
        let shape = FrameShape {
            camera: tree.camera,
            plan: tree.plan.clone(),
            interfaces: tree.interfaces.clone(),
            format: FrameFormat { volume, color_coding, ..FrameFormat::exact() },
            volume: self.bounds.range(&tree.render_pose),
            strip_rows: BAND_ROWS as u16,
            exposure: self.exposure(),
        };
        Ok(Loopback::default().send(tree, &shape)?)
    }

    /// What is really seen of the media.
    pub(super) fn seen(&self, pose: &Pose) -> Vec<Vec4> {
        self.renderer.media_picture(pose, self.camera)
    }

    /// Has the server take steps of so many voxels.
    pub(super) fn set_march_step(&self, voxels: f32) {
        self.renderer.set_march_step(voxels);
    }

    /// What rays of the first pose go through: about so many batches of so many neighbours, spread over the frame.
    pub(super) fn rays(&self, batch: usize, batches: usize) -> Vec<Vec<Profile>> {
        let view = self.renderer.media_in_view(&self.pose(0.0), self.camera);
        let pixels = self.camera.size.pixels();
        let starts: Vec<usize> = (0..pixels).step_by((pixels / batches).max(batch)).collect();
        let of_batch = |&start: &usize| {
            let mut work = Default::default();
            let ray = |pixel| {
                let mut profile = Profile::default();
                view.profile(pixel, &mut work, &mut profile);
                profile
            };
            (start..(start + batch).min(pixels)).map(ray).collect()
        };
        starts.par_iter().map(of_batch).collect()
    }

    /// Cuts rays as a setting says, on all cores.
    pub(super) fn cut(&self, setting: &Setting, batches: &[Vec<Profile>]) {
        let range = self.bounds.range(&self.pose(0.0));
        let layers = usize::from(setting.format.layers);
        batches.par_iter().for_each_init(
            || (Cutter::default(), Vec::new()),
            |(cutter, segments), rays| {
                segments.resize_with(rays.len(), Segments::default);
                if setting.exactly && setting.format.layering == Layering::Optimal {
                    for (ray, segments) in rays.iter().zip(segments.iter_mut()) {
                        segments.clear();
                        cut_plainly(ray, layers, segments);
                    }
                } else {
                    cutter.cut(setting.format.layering, layers, range, rays, segments);
                }
            },
        );
    }

    /// How far one picture of the media is from another before a background.
    pub(super) fn error(
        &self,
        pose: &Pose,
        background: Background,
        shown: &[Vec4],
        seen: &[Vec4],
    ) -> Result<PictureError, SweepError> {
        let (shown, seen) = (self.picture(pose, background, shown), self.picture(pose, background, seen));
        let measured = |error: crate::measure::MeasureError| SweepError::Scene(error.to_string());
        Ok(PictureError {
            dssim: dssim(&seen, &shown, None).map_err(measured)?,
            psnr_db: psnr_srgb8(&seen, &shown, None).map_err(measured)?,
        })
    }

    /// The media before black.
    pub(in crate::sweep) fn before_black(&self, pose: &Pose, media: &[Vec4]) -> RgbImage {
        self.picture(pose, Background::Black, media)
    }

    /// The media before a background.
    pub(super) fn picture(&self, pose: &Pose, background: Background, media: &[Vec4]) -> RgbImage {
        let exposure = self.exposure();
        let tone = ToneTable::default();
        let environment = &self.renderer.scene().environment;
        let world_from_view = pose.orientation.as_quat();
        let pixels = media.par_iter().enumerate().flat_map_iter(|(pixel, media)| {
            let behind = match background {
                Background::Black => Vec3::ZERO,
                Background::White => Vec3::splat(1.0 / exposure),
                Background::Environment => {
                    let ray = self.camera.ray_in_view(self.camera.size.pixel_centre(pixel));
                    environment.radiance((world_from_view * ray).normalize())
                }
            };
            tone.display_from_radiance(media.truncate() + media.w * behind, exposure)
        });
        let codes: Vec<u8> = pixels.collect();
        RgbImage::from_raw(self.camera.size.width, self.camera.size.height, codes).unwrap_or_default()
    }

    fn exposure(&self) -> f32 {
        self.renderer.scene().exposure
    }
}
