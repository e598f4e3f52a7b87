//! Replays over links that carry less than frames need: what gives way, what that is worth, and what is said of it.

use super::replays::{plan, replay_over};
use std::time::Duration;
use warplight_client::link::LinkModel;
use warplight_client::measure::Interval;
use warplight_client::report::Report;
use warplight_client::trace::Trace;
use warplight_client::warp::Mode;
use warplight_protocol::ImageSize;
use warplight_protocol::frame::FrameFormat;

fn over(rate_bits_per_sec: Option<f64>, adapt: bool, seconds: f64) -> Report {
    let mut plan = plan(Trace::built_in(), seconds, ImageSize::new(64, 48));
    (plan.adapt, plan.modes, plan.quality_every, plan.quality_spp) = (adapt, vec![Mode::Diffuse], 100, 4);
    plan.mode = Mode::Diffuse;
    plan.format = FrameFormat::exact();
    let link = LinkModel { latency: Duration::from_millis(10), rate_bits_per_sec, ..LinkModel::default() };
    replay_over(&plan, "cornell", 1, 7, link)
}

#[test]
fn a_fast_link_changes_no_byte_and_a_slow_one_what_must_be() {
    let (on, off) = (over(None, true, 2.0), over(None, false, 2.0));
    assert_eq!((&on.link.planes, on.link.frames_sent), (&off.link.planes, off.link.frames_sent));
    assert!(on.limits.iter().all(|limit| limit.name != "throughput"), "{:?}", on.limits);
    for step in Interval::STEPS {
        let spread = on.latency_ms.stages[step.name().unwrap()];
        assert!(spread.p50 <= spread.p95 && spread.p95 <= spread.p99 && spread.p99 <= spread.max, "{step}");
    }
    let bits_per_sec = off.link.planes.values().sum::<u64>() as f64 * 8.0 / 2.0;
    let [on, off] = [true, false].map(|adapt| over(Some(0.25 * bits_per_sec), adapt, 8.0));
    let [age, age_off] = [&on, &off].map(|report| report.latency_ms.frame_age.unwrap().p50);
    let [pixels, pixels_off] = [&on, &off].map(|report| report.viewport.pixels_per_display_pixel.unwrap().p50);
    eprintln!("age {age} and {age_off} ms, pixels {pixels} and {pixels_off}, {:?}", on.limits);
    assert!(age < 0.75 * age_off, "{age} of {age_off} ms");
    assert!(on.link.frames_shown > off.link.frames_shown, "{} of {}", on.link.frames_shown, off.link.frames_shown);
    let throughput = on.limits.iter().find(|limit| limit.name == "throughput").unwrap();
    assert!((0.5..=1.0).contains(&throughput.share), "{throughput:?}");
    assert!(off.limits.iter().all(|limit| limit.name != "throughput"));
    // Frames of another size are shown as any are.
    let holes = on.quality[0].hole_fraction.unwrap();
    assert!(holes.p50 < 0.05, "{holes:?}");
}
