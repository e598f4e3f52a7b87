//! Knobs of the renderer, of the session and of the marches, on small pictures.

use super::*;
use warplight_protocol::frame::Plan;

fn errors(sweep: &Sweep) -> Vec<f64> {
    sweep.points.iter().map(|point| point.error).collect()
}

fn more(sweep: &Sweep, name: &str) -> Vec<f64> {
    sweep.points.iter().map(|point| point.more[name]).collect()
}

fn falls(values: &[f64]) -> bool {
    values.is_sorted_by(|a, b| a > b)
}

#[test]
fn noise_falls_with_samples_at_least_as_one_over_their_number() {
    let sweep = swept("spp", Some("cornell"), 32);
    let errors = errors(&sweep);
    // A squared error is the mean over 1024 pixels of squares whose own deviation is about twice their mean: 6 %. Five
    // deviations of a ratio are 45 %, of one half that is at most 0.73.
    assert!(falls(&errors), "{errors:?}");
    // Stratified samples leave no more than independent ones do, to those deviations.
    assert!(errors[4] * 16.0 < errors[0] * 1.45, "{errors:?}");
    assert!(falls(&more(&sweep, "rays_per_px").into_iter().rev().collect::<Vec<_>>()));
}

#[test]
fn longer_paths_only_add_light_and_leave_less_of_it_missing_in_every_step() {
    // What a path of fewer segments has found is a prefix of what the longer one of the same numbers has: no tolerance.
    let sweep = swept("path-depth", Some("cornell"), 24);
    assert!(falls(&errors(&sweep)), "{sweep:?}");
    let missing = more(&sweep, "missing_light");
    assert!(falls(&missing) && missing.iter().all(|part| (0.0..1.0).contains(part)), "{missing:?}");
}

#[test]
fn light_from_the_cache_has_less_error_than_paths_with_more_samples() {
    let sweep = swept("denoiser", Some("cornell"), 32);
    let [one, four] = ["path:1", "path:4"].map(|value| error_of(&sweep, value));
    // To the deviations of the noise, as above.
    assert!(four < 0.25 * 1.45 * one, "{one} {four}");
    // A cell has the samples of a dozen frames and of several pixels, and a wall's light is smooth.
    let cached = error_of(&sweep, "cache:0.25");
    assert!(cached < four, "{cached} {four}");
    // Nothing is rough there: the filter has nothing to do.
    assert_eq!(cached, error_of(&sweep, "cache-unfiltered:0.25"));
}

#[test]
fn the_filter_of_rough_lobes_leaves_less_of_their_noise() {
    let sweep = swept("denoiser", Some("materials"), 32);
    let [filtered, unfiltered] = ["cache:0.25", "cache-unfiltered:0.25"].map(|value| error_of(&sweep, value));
    assert!(filtered < unfiltered, "{filtered} {unfiltered}");
}

#[test]
fn a_mirror_is_seen_better_with_its_node_and_nodes_take_bytes() {
    let sweep = swept("tree-depth", Some("mirror-room"), 64);
    let bytes: Vec<u64> = sweep.points.iter().map(|point| point.bytes).collect();
    assert!(bytes.is_sorted_by(|a, b| a < b), "{bytes:?}");
    // A picture that sticks to the mirror, against one that moves behind it; nothing there refracts.
    assert!(error_of(&sweep, "D,R") < error_of(&sweep, "D"), "{sweep:?}");
    assert_eq!(error_of(&sweep, "D,R"), error_of(&sweep, "D,R,F,FF"));
}

#[test]
fn nodes_that_a_scene_does_not_call_for_change_no_picture() {
    let sweep = swept("tree-depth", Some("cornell"), 64);
    let errors = errors(&sweep);
    assert_eq!(sweep.points.len(), 4);
    assert!(errors.iter().all(|&error| error == errors[0]), "{errors:?}");
}

#[test]
fn larger_frames_take_more_bytes_and_show_more() {
    let sweep = swept("resolution", Some("gallery"), 64);
    let bytes: Vec<u64> = sweep.points.iter().map(|point| point.bytes).collect();
    assert!(bytes.is_sorted_by(|a, b| a < b), "{bytes:?}");
    let errors = errors(&sweep);
    // From a texel of 4 pixels to one of 2 edges are drawn in; what is left is light, of which small frames have less.
    assert!(errors[1] < errors[0] && errors[3] < errors[0], "{errors:?}");
}

#[test]
fn more_frames_are_younger_take_more_bytes_in_a_second_and_are_nearer() {
    let sweep = swept("frame-rate", Some("gallery"), 64);
    let ages = more(&sweep, "age_ms");
    assert!(falls(&ages), "{ages:?}");
    // Latency and half a beat, which instants meet to an eighth of it.
    for (point, age) in sweep.points.iter().zip(&ages) {
        let beat_ms = 1e3 / point.value.parse::<f64>().unwrap();
        assert!((age - 50.0 - 0.5 * beat_ms).abs() <= beat_ms / 8.0 + 1e-9, "{age} {point:?}");
    }
    let bytes: Vec<u64> = sweep.points.iter().map(|point| point.bytes).collect();
    // Frames are about as large: twice as many take about twice as much.
    assert!(bytes.windows(2).all(|pair| (1.8..2.2).contains(&(pair[1] as f64 / pair[0] as f64))), "{bytes:?}");
    let errors = errors(&sweep);
    assert!(errors[3] < errors[0], "{errors:?}");
}

#[test]
fn steps_half_as_long_leave_at_most_half_the_error() {
    let sweep = swept("march-step", Some("cloud"), 48);
    let errors = errors(&sweep);
    // First order would be a half, second order is a quarter.
    assert!(errors.windows(2).all(|pair| pair[1] < 0.5 * pair[0]), "{errors:?}");
}

#[test]
fn finer_strides_come_nearer_to_the_walk_through_every_pixel() {
    let sweep = swept("march-stride", Some("cube"), 256);
    // Where lines are so short that every walk has the fewest steps, coarse strides are the same.
    let (errors, steps) = (more(&sweep, "opacity_error"), more(&sweep, "packet_steps"));
    assert!(errors.is_sorted_by(|a, b| a >= b) && errors[3] < 0.8 * errors[0], "{errors:?}");
    assert!(steps.is_sorted() && steps[3] > 2.0 * steps[0], "{steps:?}");
}

#[test]
fn optimal_segments_of_a_cloud_are_seen_better_from_elsewhere_than_those_of_other_rules() {
    let sweep = swept("layering", Some("cloud"), 96);
    let optimal = error_of(&sweep, "optimal:4");
    assert!(["slabs:4", "quantiles:4"].iter().all(|other| optimal < error_of(&sweep, other)), "{sweep:?}");
    assert!(sweep.points.iter().all(|point| point.time_ms > 0.0 && point.bytes > 0), "{sweep:?}");
}

#[test]
fn a_knob_that_costs_path_tracing_is_measured_smaller_and_says_so() {
    let trace = Trace::built_in();
    let now = || Duration::ZERO;
    let request = Request {
        size: ImageSize::new(512, 256),
        runs: 1,
        quick: true,
        trace: &trace,
        planes: None,
        reference_spp: 0,
        now: &now,
    };
    let sweep = Knob::named("tree-depth").unwrap().sweep(&request, Some("cornell"), &mut |_, _, _| ()).unwrap();
    assert_eq!(sweep.size, [128, 64]);
    assert_eq!(shrunk(ImageSize::new(100, 64), 128), ImageSize::new(100, 64));
}

#[test]
fn every_plan_of_the_sweep_is_one() {
    let trace = Trace::built_in();
    let now = || Duration::ZERO;
    let size = ImageSize::new(64, 64);
    let request = Request { size, runs: 1, quick: false, trace: &trace, planes: None, reference_spp: 0, now: &now };
    let settings = session::tree_depths(&request);
    assert_eq!(settings.len(), 7, "none was dropped because its letters are no plan");
    assert!(settings.iter().all(|setting| setting.value.parse::<Plan>().is_ok()));
}
