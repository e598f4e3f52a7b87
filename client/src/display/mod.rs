//! What a display shows beyond one pinhole picture, all of it from one frame: a weighted sum of warps.
//!
//! decode -> warp -> composite -> **display** -> report. A frame can be warped to any pose and through any camera near
//! its own, so that eyes, lenses and shutters cost the server nothing: an eye is another pose ([`Eye`]), a lens many
//! poses in its aperture ([`Lens`], Cook, Porter and Carpenter 1984), an open shutter many poses along the way of the
//! head ([`Shutter`]). Samples are averaged in linear light, before the tone mapping. [`smooth_edges`] works on what
//! the display shows.
//!
//! Limits: the frame knows what its own eye sees; a wide aperture or a fast head uncovers more that has to be filled.
//! Cost: one warp for every sample, and nothing is allocated after the first picture.

mod edges;
mod enlarge;
mod lens;
mod shutter;
mod stereo;

pub use edges::smooth_edges;
pub use lens::Lens;
pub use shutter::Shutter;
pub use stereo::{Eye, beside};

use crate::warp::{Mode, WarpStatistics, Warper};
use glam::Vec3;
use image::RgbImage;
use rayon::prelude::*;
use warplight_protocol::frame::Tree;
use warplight_protocol::tone::ToneTable;
use warplight_protocol::{Camera, ImageSize, Pose};

/// What stands between a frame and the eye.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Optics {
    /// Distance of the eyes in metres, where there are two.
    pub eye_distance_m: Option<f64>,
    /// A lens instead of a pinhole.
    pub lens: Option<Lens>,
    /// A shutter that is open for some time.
    pub shutter: Option<Shutter>,
    /// Whether edges are smoothed.
    pub smooth_edges: bool,
}

/// One of the warps that make up a picture; all weigh the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// world_from_view.
    pub pose: Pose,
    /// Through what.
    pub camera: Camera,
    /// How long before the refresh, in seconds.
    pub before_secs: f64,
}

impl Optics {
    /// The eyes that have a picture of their own.
    pub fn eyes(&self) -> &'static [Eye] {
        if self.eye_distance_m.is_some() { &[Eye::Left, Eye::Right] } else { &[Eye::Middle] }
    }

    /// Warps of one eye's picture.
    pub fn samples(&self) -> usize {
        let (of_lens, of_shutter) = (self.lens.map_or(1, |lens| lens.samples), self.shutter.map_or(1, |it| it.samples));
        of_lens.max(of_shutter).max(1)
    }

    /// Where an eye is when the head is at `head_pose`.
    pub fn eye_pose(&self, eye: Eye, head_pose: &Pose) -> Pose {
        eye.pose(head_pose, self.eye_distance_m.unwrap_or(0.0))
    }

    /// The views of which the picture of an eye is the mean, into `views`. `head_before` tells where the head was so
    /// many seconds before the refresh.
    pub fn views(&self, eye: Eye, head_before: impl Fn(f64) -> Pose, camera: &Camera, views: &mut Vec<View>) {
        views.clear();
        let count = self.samples();
        for sample in 0..count {
            let before_secs = self.shutter.map_or(0.0, |shutter| shutter.before_secs(sample, count));
            let pose = self.eye_pose(eye, &head_before(before_secs));
            let (pose, camera) =
                self.lens.map_or((pose, *camera), |lens| lens.view(&pose, camera, lens.point_m(sample, count)));
            views.push(View { pose, camera, before_secs });
        }
    }
}

/// Makes the pictures of a display; its buffers live from picture to picture.
#[derive(Debug, Default)]
pub struct Display {
    sum: Vec<Vec3>,
    sample: Vec<Vec3>,
    tone: ToneTable,
    unsmoothed: Vec<u8>,
    /// A picture of fewer pixels than the display has, and where the display's columns lie in it.
    small: RgbImage,
    columns: Vec<[u32; 3]>,
}

impl Display {
    /// Shows the mean of `views`, of which there is at least one and whose cameras have one size, from `tree`, which
    /// `warper` took in last for the same `mode`: linear radiance times `exposure`, tone-mapped.
    #[allow(clippy::too_many_arguments, reason = "those of `Warper::show`, and what is shown of it")]
    pub fn show(
        &mut self,
        optics: &Optics,
        warper: &mut Warper,
        mode: Mode,
        tree: &Tree,
        views: &[View],
        exposure: f32,
        picture: &mut RgbImage,
    ) -> WarpStatistics {
        let statistics = match views {
            [] => return WarpStatistics::default(),
            // To the bit what a pinhole shows.
            [view] => warper.show(mode, tree, &view.pose, &view.camera, exposure, picture),
            views => self.show_mean(warper, mode, tree, views, exposure, picture),
        };
        if optics.smooth_edges {
            smooth_edges(picture, &mut self.unsmoothed);
        }
        statistics
    }

    /// The same for a display of `size`, whose views have fewer pixels: their picture is enlarged.
    #[allow(clippy::too_many_arguments, reason = "those of `show`, and the size")]
    pub fn show_enlarged(
        &mut self,
        optics: &Optics,
        warper: &mut Warper,
        mode: Mode,
        tree: &Tree,
        views: &[View],
        exposure: f32,
        size: ImageSize,
        picture: &mut RgbImage,
    ) -> WarpStatistics {
        if views.first().is_none_or(|view| view.camera.size == size) {
            return self.show(optics, warper, mode, tree, views, exposure, picture);
        }
        let mut small = std::mem::take(&mut self.small);
        let statistics = self.show(optics, warper, mode, tree, views, exposure, &mut small);
        if picture.dimensions() != (size.width, size.height) {
            *picture = RgbImage::new(size.width, size.height);
        }
        enlarge::enlarge(&small, picture, &mut self.columns);
        self.small = small;
        statistics
    }

    fn show_mean(
        &mut self,
        warper: &mut Warper,
        mode: Mode,
        tree: &Tree,
        views: &[View],
        exposure: f32,
        picture: &mut RgbImage,
    ) -> WarpStatistics {
        let Display { sum, sample, tone, .. } = self;
        let size = views[0].camera.size;
        sum.clear();
        sum.resize(size.pixels(), Vec3::ZERO);
        let mut statistics = WarpStatistics::default();
        for view in views {
            let lacked = warper.radiance(mode, tree, &view.pose, &view.camera, sample);
            // By node: of the last view, which is as good as any.
            statistics.nodes = lacked.nodes;
            statistics.hole_fraction += lacked.hole_fraction / views.len() as f64;
            sum.par_iter_mut().zip(&*sample).for_each(|(sum, sample)| *sum += *sample);
        }
        if picture.dimensions() != (size.width, size.height) {
            *picture = RgbImage::new(size.width, size.height);
        }
        let scale = exposure / views.len() as f32;
        let row = size.width as usize;
        picture.par_chunks_mut(3 * row).zip(sum.par_chunks(row)).for_each(|(codes, radiance)| {
            for (code, radiance) in codes.as_chunks_mut::<3>().0.iter_mut().zip(radiance) {
                *code = tone.display_from_radiance(*radiance, scale);
            }
        });
        statistics
    }
}

#[cfg(test)]
mod tests;
