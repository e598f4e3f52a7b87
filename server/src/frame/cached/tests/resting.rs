//! A head that rests.

use super::*;
use warplight_protocol::camera::Margins;

/// Mean squared error over squared radiance against two independent references, whose own noise drops out.
fn error(picture: &[Vec3], [a, b]: &[Vec<Vec3>; 2]) -> f64 {
    let of = |(x, (a, b)): (&Vec3, (&Vec3, &Vec3))| {
        let mean = 0.5 * (*a + *b);
        f64::from(((*x - *a) * (*x - *b) / (mean * mean + 0.01)).element_sum()) / 3.0
    };
    picture.iter().zip(a.iter().zip(b)).map(of).sum::<f64>() / picture.len() as f64
}

/// Mean squared difference over squared radiance.
fn difference(a: &[Vec3], b: &[Vec3]) -> f64 {
    let of = |(a, b): (&Vec3, &Vec3)| f64::from(((a - b) * (a - b) / (*b * *b + 0.01)).element_sum()) / 3.0;
    a.iter().zip(b).map(of).sum::<f64>() / a.len() as f64
}

#[test]
fn the_error_at_rest_falls_below_the_bias_of_the_cache_as_that_of_path_tracing() {
    for name in ["cornell", "gallery"] {
        let mut viewer = Viewer::of_size(32, name);
        // More samples than a cell needs to be as good as it gets: what is left is mostly bias.
        viewer.frames(40, 2.0);
        let references = [9, 10].map(|seed| viewer.path_traced(768, seed));
        let cached = error(&viewer.picture(), &references);
        let full = f64::from(super::super::super::rest::FULL_SAMPLES);
        let mut errors: Vec<(f64, f64)> = Vec::new();
        let mut before = viewer.picture();
        for frame in 0..400 {
            // Few at first, so that the way from the one picture to the other is seen.
            viewer.still_frame(if frame < 100 { 4.0 } else { 24.0 });
            let picture = viewer.picture();
            let error = error(&picture, &references);
            errors.push((viewer.live.rest.progress(), error));
            assert!(error < 1.1 * cached, "{name}: {error:.2e} in resting frame {frame}, {cached:.2e} in motion");
            let step = difference(&picture, &before);
            assert!(step < 0.5 * cached, "{name}: frame {frame} differs from the one before by {step:.2e}");
            before = picture;
            // Further on the noise of the references would be seen: they have hardly more samples.
            if viewer.live.rest.progress() > 4.4 * full {
                break;
            }
        }
        let (last, least) = errors[errors.len() - 1];
        let quarter = errors.iter().find(|(samples, _)| *samples >= last / 4.0).map_or((0.0, 0.0), |at| *at);
        println!(
            "{name}: cached {cached:.2e}, {:.0} samples {:.2e}, {last:.0} samples {least:.2e}",
            quarter.0, quarter.1
        );
        // Four times the samples, a quarter of the squared error, which is itself known to a fifth: a few hundred of
        // the pixels carry most of it, and 0.4 is three such deviations above.
        assert!(quarter.0 > full && least < cached / 8.0, "{name}: {cached:.2e} {errors:?}");
        assert!(least < 0.4 * quarter.1, "{name}: {quarter:?}, then {least:.2e}");
    }
}

#[test]
fn any_motion_ends_a_rest_and_the_same_view_again_starts_from_nothing() {
    let mut viewer = Viewer::of_size(32, "cornell");
    viewer.frames(4, 1.0);
    for _ in 0..4 {
        viewer.still_frame(4.0);
    }
    let progress = |viewer: &Viewer| viewer.live.rest.progress();
    assert!(progress(&viewer) > 0.0);
    // A hundredth of a pixel is no motion, a tenth is.
    let px = 1.0 / f64::from(viewer.request.camera.focal_px().x);
    let turn = |viewer: &mut Viewer, px_turned: f64| {
        let turned = glam::DQuat::from_rotation_y(px_turned * px);
        viewer.request.render_pose.orientation = turned * viewer.request.render_pose.orientation;
        viewer.still_frame(1.0);
    };
    let rested = progress(&viewer);
    turn(&mut viewer, 0.01);
    assert!(progress(&viewer) > rested);
    turn(&mut viewer, 0.1);
    assert_eq!(progress(&viewer), 0.0);
    turn(&mut viewer, 0.0);
    assert!(progress(&viewer) > 0.0 && progress(&viewer) < rested);
}

#[test]
fn a_picture_that_becomes_smaller_at_rest_keeps_what_it_has_summed_up() {
    let margins = Margins { left: 16, right: 48, down: 16, up: 32 };
    let mut viewer = Viewer::of_size(32, "cornell");
    let display = viewer.request.camera;
    viewer.request.camera = display.widened(margins);
    viewer.frames(4, 1.0);
    let full = super::super::super::rest::FULL_SAMPLES;
    while !viewer.live.rest.is_full() {
        viewer.still_frame(64.0);
    }
    // From here on what is shown is the mean of at least so many samples, and nothing else.
    let wide = viewer.picture();
    let columns = viewer.request.camera.size.width as usize;
    let middle: Vec<Vec3> = (0..display.size.pixels())
        .map(|pixel| wide[(pixel / 32 + margins.up as usize) * columns + pixel % 32 + margins.left as usize])
        .collect();
    let progress = viewer.live.rest.progress();
    viewer.request.camera = display;
    viewer.still_frame(1.0);
    assert!(viewer.live.rest.progress() > progress, "the rest goes on");
    // A few samples more to 256: 1/64 of a sample's variance over that of the mean, in every single pixel.
    let added = viewer.live.rest.progress() - progress;
    assert!(added < 4.0, "{added}");
    let references = [9, 10].map(|seed| viewer.path_traced(256, seed));
    let before = error(&middle, &references);
    let after = error(&viewer.picture(), &references);
    assert!((after - before).abs() < 0.25 * before.abs(), "error {before:.2e} before and {after:.2e} after, {full}");
    assert!(difference(&viewer.picture(), &middle) < 0.1 * before, "the picture stays what it was");

    viewer.request.camera = display.widened(margins);
    viewer.still_frame(1.0);
    assert_eq!(viewer.live.rest.progress(), 0.0, "one that becomes larger begins anew");
}
