//! Sweeps on small frames: theory says which way the curves run.

use super::*;
use std::cell::Cell;

mod server_and_session;

/// A sweep in which every look at the clock takes a millisecond.
pub(super) fn swept(knob: &str, scene: Option<&str>, size: u32) -> Sweep {
    let ticks = Cell::new(0);
    let now = || {
        ticks.set(ticks.get() + 1);
        Duration::from_millis(ticks.get())
    };
    let trace = Trace::built_in();
    let request = Request {
        size: ImageSize::new(size, size),
        runs: 1,
        quick: true,
        trace: &trace,
        planes: None,
        reference_spp: 0,
        now: &now,
    };
    let mut last = (0, 1);
    let sweep = Knob::named(knob).unwrap().sweep(&request, scene, &mut |_, done, all| last = (done, all)).unwrap();
    assert_eq!(last.0, last.1, "progress ends at the end");
    sweep
}

pub(super) fn error_of(sweep: &Sweep, value: &str) -> f64 {
    sweep.points.iter().find(|point| point.value == value).unwrap_or_else(|| panic!("{value}")).error
}

/// What tiles that are interpolated may be off by: 0.04 px of a picture of 256 over 90 degrees, whose pixels are at
/// most 0.45 degrees wide.
const TILE_DEG: f64 = 0.04 * 0.45;

#[test]
fn more_steps_leave_less_error() {
    // So far that one step does not do: 20 cm aside.
    let trace = Trace::built_in();
    let now = || Duration::ZERO;
    let request = Request {
        size: ImageSize::new(256, 256),
        runs: 1,
        quick: true,
        trace: &trace,
        planes: None,
        reference_spp: 0,
        now: &now,
    };
    let mut far = settings::steps(&request);
    far.iter_mut().flat_map(|setting| &mut setting.moves).for_each(|by| by.position *= 4.0);
    let points = surface::measure(&request, "chrome-ball", &far, &mut |_, _| ()).unwrap();
    let of = |value: &str| points.iter().find(|point| point.value == value).unwrap();
    let [one, two, three] = [1, 2, 3].map(|steps| of(&format!("frozen-distance:{steps}")));
    // The one that is accepted is less than a pixel, whatever the number of steps; what is further off is undefined.
    assert!(two.more["undefined"] < one.more["undefined"], "{one:?} {two:?}");
    assert!(three.more["undefined"] <= two.more["undefined"], "{two:?} {three:?}");
    assert!(two.error < one.error + TILE_DEG && three.error < two.error + TILE_DEG);
    let [newton_one, newton_three] = ["gauss-newton:1", "gauss-newton:3"].map(of);
    assert!(newton_three.more["undefined"] < newton_one.more["undefined"], "{newton_one:?} {newton_three:?}");
}

#[test]
fn more_bits_of_normals_take_more_bytes_and_leave_less_error() {
    let sweep = swept("normals", Some("chrome-ball"), 256);
    let of = |value: &str| sweep.points.iter().find(|point| point.value == value).unwrap();
    let [coarse, usual, fine] = ["transmitted:8", "transmitted:10", "transmitted:12"].map(of);
    assert!(coarse.bytes < usual.bytes && usual.bytes < fine.bytes);
    // Each code is four times as fine as the one before, down to what tiles leave.
    assert!(usual.error < coarse.error && fine.error < usual.error + TILE_DEG, "{coarse:?} {usual:?} {fine:?}");
    assert!(error_of(&sweep, "from-depth-gaussian:24") < error_of(&sweep, "from-depth-gaussian:16"));
}

#[test]
fn more_bits_of_depth_leave_less_error() {
    let sweep = swept("depth-bits", Some("mirror"), 256);
    let errors = ["10/10", "12/12", "16/16"].map(|value| error_of(&sweep, value));
    // Four and sixteen times as fine.
    assert!(errors[1] < errors[0] && errors[2] < errors[1], "{errors:?}");
}

#[test]
fn a_wider_promise_about_depth_takes_fewer_bytes() {
    let sweep = swept("depth-bound", Some("mirror-room"), 128);
    let of = |value: &str| sweep.points.iter().find(|point| point.value == value).unwrap();
    let [fine, coarse, codes] = ["0.25 px", "1 px", "16 bits"].map(of);
    assert!(coarse.bytes < fine.bytes && fine.bytes < codes.bytes, "{coarse:?} {fine:?} {codes:?}");
    // All colours are the same; what depth changes of them grows with its error.
    assert!(codes.error <= fine.error && fine.error < coarse.error, "{codes:?} {fine:?} {coarse:?}");
    assert!(sweep.points.iter().all(|point| point.more["color_bits_per_pixel"] == codes.more["color_bits_per_pixel"]));
}

#[test]
fn the_coarser_colour_is_the_fewer_bytes_it_takes_and_the_more_error_it_leaves() {
    let sweep = swept("color", Some("gallery"), 128);
    let points = ["root8", "bounded:2", "video:24", "video:32"]
        .map(|value| sweep.points.iter().find(|point| point.value == value).unwrap());
    for pair in points.windows(2) {
        assert!(pair[1].bytes < pair[0].bytes && pair[1].error > pair[0].error, "{pair:?}");
    }
}

#[test]
fn formats_of_colour_are_ordered_by_their_bits_and_the_dark_wants_them_where_eyes_look() {
    let sweep = swept("color-format", Some("lamp"), 128);
    let of = |value: &str| sweep.points.iter().find(|point| point.value == value).unwrap();
    let [root8, root10, half] = ["root8", "root10", "half"].map(of);
    assert!(root10.error < root8.error && half.error < root10.error, "{root8:?} {root10:?} {half:?}");
    assert!(root8.bytes < root10.bytes && root10.bytes < half.bytes);
    // Equal steps of light are coarse where it is dark.
    assert!(of("srgb8").error < of("linear8").error && of("rgb9e5").error < root8.error, "{sweep:?}");
}

#[test]
fn the_further_a_head_has_moved_the_larger_is_the_error() {
    let sweep = swept("head-translation", Some("chrome-ball"), 256);
    assert!(error_of(&sweep, "2") < error_of(&sweep, "5"));
    let ages = swept("frame-age", Some("chrome-ball"), 128);
    assert_eq!(ages.points.len(), 2);
    assert!(ages.points.iter().all(|point| point.error.is_finite() && point.more["pixels"] > 30.0));
}

#[test]
fn a_document_has_the_form_of_its_schema() {
    let sweep = swept("depth-coding", None, 128);
    let document: serde_json::Value = serde_json::from_str(&sweep.to_json().unwrap()).unwrap();
    assert_eq!(document["schema"], SCHEMA);
    assert_eq!((&document["knob"], &document["scene"]), (&"depth-coding".into(), &"all".into()));
    assert_eq!((&document["metric"], &document["cost"]), (&"deg".into(), &"bytes".into()));
    let points = document["points"].as_array().unwrap();
    assert_eq!(points.len(), 8, "two codings on four scenes");
    for point in points {
        assert!(point["value"].is_string() && point["pareto"].is_boolean() && point["scene"].is_string());
        for field in ["time_ms", "time_spread_ms", "error", "bytes", "p95_deg", "undefined"] {
            assert!(point[field].as_f64().is_some_and(|value| value >= 0.0), "{field}: {point}");
        }
    }
    for curve in sweep.by_scene() {
        assert!(curve.iter().any(|point| point.pareto));
    }
    let resume = document["resume"].as_str().unwrap();
    assert!(["mirror: ", "chrome-ball: ", "water: ", "glass-ball: "].iter().all(|scene| resume.contains(scene)));
    assert!(!resume.contains('\n'));
    let again: Sweep = serde_json::from_value(document).unwrap();
    assert_eq!(again.points.len(), sweep.points.len());
    // Table: a head, a row for each point, the legend, the resume.
    let lines: Vec<String> = table(&sweep).lines().map(str::to_owned).collect();
    assert_eq!(lines.len(), 1 + 8 + 2, "{lines:?}");
    let folder = tempfile::tempdir().unwrap();
    let paths = write_files(&sweep, folder.path()).unwrap();
    assert_eq!(paths.len(), 1 + 4);
    assert!(paths.iter().all(|path| path.metadata().unwrap().len() > 500));
}

#[test]
fn unknown_knobs_and_scenes_are_refused_in_one_line_that_lists_the_known_ones() {
    let message = Knob::named("volume").err().unwrap().to_string();
    assert!(KNOBS.iter().all(|knob| message.contains(knob.name)) && !message.contains('\n'), "{message}");
    let trace = Trace::built_in();
    let now = || Duration::ZERO;
    let request = Request {
        size: ImageSize::new(32, 32),
        runs: 1,
        quick: true,
        trace: &trace,
        planes: None,
        reference_spp: 0,
        now: &now,
    };
    let refused = Knob::named("steps").unwrap().sweep(&request, Some("moon"), &mut |_, _, _| ()).unwrap_err();
    let message = refused.to_string();
    assert!(message.contains("mirror, chrome-ball, water, glass-ball") && !message.contains('\n'), "{message}");
}

#[test]
fn segments_show_a_cloud_better_than_slabs_and_than_one_depth() {
    let sweep = swept("angle", Some("cloud"), 128);
    let layers = error_of(&sweep, "layers:4 10 deg");
    for other in ["slabs:4 10 deg", "mean-depth 10 deg"] {
        assert!(layers < error_of(&sweep, other), "{other}: {sweep:?}");
    }
}

#[test]
fn fewer_bits_of_a_volume_take_fewer_bytes() {
    let sweep = swept("volume-compression", Some("cube"), 96);
    let of = |value: &str| sweep.points.iter().find(|point| point.value == value).unwrap();
    let [fine, usual, coarse] = ["optimal:4 Half/16/16", "optimal:4 Root8/12/8", "optimal:4 Root8/8/6"].map(of);
    assert!(coarse.bytes < usual.bytes && usual.bytes < fine.bytes);
    assert!(usual.error <= coarse.error && fine.error <= usual.error + 1e-3, "{fine:?} {usual:?} {coarse:?}");
}
