//! Points of a refresh: steps of the search and pixels of the warp.

use super::super::{Point, Progress, Request, SweepError};
use super::{Measured, error_of, walk_of};
use crate::budget::DisplayPoint;
use crate::display::{Display, Optics, View};
use crate::warp::{Mode, Warper};
use image::RgbImage;

/// Measures all points on a scene.
pub(in crate::sweep) fn measure(
    request: &Request<'_>,
    scene: &str,
    progress: Progress<'_>,
) -> Result<Vec<Point>, SweepError> {
    let (walk, references) = walk_of(request, scene)?;
    let camera = walk.shape.camera;
    let mut measured = vec![Measured::default(); DisplayPoint::ALL.len()];
    let (mut warper, mut display) = (Warper::default(), Display::default());
    let mut picture = RgbImage::default();
    let all = walk.frames.len() as u64 * (1 + u64::from(request.runs));
    let mut done = 0;
    for ((tree, &pose), reference) in walk.frames.iter().zip(&walk.display_poses).zip(&references) {
        warper.forget();
        warper.prepare(Mode::Specular, tree);
        // The first run is for the error, and fills buffers.
        for run in 0..=request.runs {
            for (point, measured) in DisplayPoint::ALL.iter().zip(&mut measured) {
                let views = [View { pose, camera: point.camera(&camera), before_secs: 0.0 }];
                warper.use_solver(point.solver);
                let (optics, exposure) = (Optics::default(), walk.shape.exposure);
                let start = (request.now)();
                display.show_enlarged(
                    &optics,
                    &mut warper,
                    Mode::Specular,
                    tree,
                    &views,
                    exposure,
                    camera.size,
                    &mut picture,
                );
                let took = (request.now)() - start;
                match run {
                    0 => measured.errors.push(error_of(reference, &picture)?),
                    _ => measured.millis.push(took.as_secs_f64() * 1e3),
                }
            }
            done += 1;
            progress(done, all);
        }
    }
    Ok(DisplayPoint::ALL.iter().zip(&measured).map(|(point, measured)| measured.point(scene, point.name())).collect())
}
