//! Whole replays in virtual time: rendered, encoded, sent, decoded, warped, compared.

use std::path::PathBuf;
use std::time::Duration;
use warplight_client::display::Optics;
use warplight_client::link::LinkModel;
use warplight_client::replay::{
    BudgetPlan, Circumstances, ModelledTimes, ReplayPlan, assess, report_from, run_virtual,
};
use warplight_client::report::{ClockKind, Link, Report};
use warplight_client::trace::Trace;
use warplight_client::warp::{Mode, Normals, Solver};
use warplight_protocol::frame::{ColorCoding, FrameFormat, VolumeFormat};
use warplight_protocol::message::{Prediction, Viewport};
use warplight_protocol::{Camera, ImageSize};
use warplight_server::costs::CostModel;
use warplight_server::scene::Scene;
use warplight_server::service::{Estimator, Service, ServiceOptions};
use warplight_server::session::SampleBudget;

pub(super) fn plan(trace: Trace, seconds: f64, size: ImageSize) -> ReplayPlan {
    ReplayPlan {
        duration: Duration::from_secs_f64(seconds.min(trace.duration_secs())),
        trace,
        camera: Camera::symmetric(1.4, size),
        frame_hz: 10.0,
        display_hz: 60.0,
        mode: Mode::Diffuse,
        modes: Mode::ALL.to_vec(),
        optics: Optics::default(),
        viewport: Viewport::Plane,
        solver: Solver::default(),
        normals: Normals::default(),
        earlier_frames: 0,
        format: FrameFormat::default(),
        target_kbps: 0,
        prediction: Prediction::default(),
        adapt: true,
        metrics: None,
        quality_every: 40,
        budget: None,
        quality_spp: 16,
    }
}

fn replay(plan: &ReplayPlan, scene: &str, spp: u32, seed: u64) -> Report {
    let link =
        LinkModel { latency: Duration::from_millis(20), jitter: Duration::from_millis(5), ..LinkModel::default() };
    replay_over(plan, scene, spp, seed, link)
}

pub(super) fn replay_over(plan: &ReplayPlan, scene: &str, spp: u32, seed: u64, link: LinkModel) -> Report {
    let (samples, estimator) = (SampleBudget::Samples(spp), Estimator::default());
    let options = ServiceOptions { samples, estimator, max_depth: 4, seed, ..ServiceOptions::default() };
    let service = Service::new(Scene::load(scene).unwrap(), options).unwrap();
    let recording = run_virtual(plan, service, link, ModelledTimes::default(), seed, &mut |_| ()).unwrap();
    let quality = assess(&recording, plan, &mut |_| ()).unwrap();
    let circumstances =
        Circumstances { trace: "test".to_owned(), seed, clock: ClockKind::Virtual, link: Some(link), warnings: vec![] };
    report_from(plan, &recording, &quality, circumstances)
}

#[test]
fn the_same_seed_gives_the_same_report_to_the_byte() {
    let plan = plan(Trace::built_in(), 2.0, ImageSize::new(64, 48));
    let first = replay(&plan, "gallery", 2, 7).to_json().unwrap();
    assert_eq!(first, replay(&plan, "gallery", 2, 7).to_json().unwrap());
    assert_ne!(first, replay(&plan, "gallery", 2, 8).to_json().unwrap());
}

#[test]
fn a_budget_is_reproducible_and_more_of_it_is_never_a_worse_point() {
    // Times are modelled as 20 ns per pixel at the usual point, and as the table says at others.
    let report = |micros: u64| {
        let plan = ReplayPlan {
            mode: Mode::Specular,
            modes: vec![Mode::Specular],
            quality_every: 50,
            budget: Some(BudgetPlan {
                time: Duration::from_micros(micros),
                table: CostModel::built_in().display,
                model: "built in".to_owned(),
            }),
            ..plan(Trace::built_in(), 1.5, ImageSize::new(64, 48))
        };
        replay(&plan, "mirror-room", 1, 7)
    };
    let reports = [5, 20, 40, 80, 400].map(report);
    let chosen = reports.each_ref().map(|report| report.budget.clone().unwrap());
    assert!(chosen.windows(2).all(|pair| pair[1].error <= pair[0].error), "{chosen:?}");
    assert!(chosen[0].error > chosen[4].error && chosen[4].next_better.is_none(), "{chosen:?}");
    for budget in &chosen[1..] {
        assert!(budget.expected_ms <= budget.budget_ms && budget.beyond_budget == 0, "{budget:?}");
    }
    assert_eq!(reports[1].to_json().unwrap(), report(20).to_json().unwrap());
    let plain = replay(&plan(Trace::built_in(), 1.0, ImageSize::new(64, 48)), "mirror-room", 1, 7);
    assert!(!plain.to_json().unwrap().contains("\"budget\""));
}

#[test]
fn a_volume_travels_in_layers_and_is_shown_by_three_methods() {
    let mut plan = plan(Trace::built_in(), 1.0, ImageSize::new(64, 48));
    plan.format.volume = VolumeFormat { layers: 3, ..VolumeFormat::default() };
    plan.modes = vec![Mode::None, Mode::Specular, Mode::Slabs, Mode::MeanDepth];
    let report = replay(&plan, "cloud", 1, 7);
    assert_eq!(report.to_json().unwrap(), replay(&plan, "cloud", 1, 7).to_json().unwrap());
    let shown: Vec<&str> = report.quality.iter().map(|quality| quality.mode.as_str()).collect();
    assert_eq!(shown, ["none", "specular", "slabs", "mean-depth"]);
    for layer in 0..3 {
        for plane in ["optical_depth", "extent", "source"] {
            assert!(report.link.planes[&format!("volume.{layer}.{plane}")] > 0, "{:?}", report.link.planes);
        }
    }
    assert!(!report.link.planes.contains_key("volume.3.source"));
    assert!(report.counters["volume.steps"] > 0);
    // Without media there are no layers, and no methods for them.
    let plain = replay(&plan, "mirror-room", 1, 7);
    assert_eq!(plain.quality.len(), 2);
    assert!(plain.link.planes.keys().all(|plane| !plane.starts_with("volume")));
    assert_eq!(plain.counters["volume.steps"], 0);
}

#[test]
fn the_report_adds_up() {
    let plan = plan(Trace::built_in(), 2.0, ImageSize::new(64, 48));
    let report = replay(&plan, "gallery", 2, 1);
    assert_eq!(report.display.frames, 120);
    assert_eq!(report.display.missed, 0);
    let link = &report.link;
    assert!(link.frames_sent >= 19 && link.frames_shown <= link.frames_sent);
    let planes: u64 = link.planes.values().sum();
    assert!(planes < link.down_bytes && planes * 10 > link.down_bytes * 8, "planes {planes} of {}", link.down_bytes);
    assert!(report.counters["rays.primary"] > 0 && report.counters["rays.refract"] > 0);
    // 80 ms of rendering, 20 +- 5 ms each way, shown for up to two frame intervals.
    let age = report.latency_ms.frame_age.unwrap();
    assert!(age.min > 110.0 && age.max < 350.0, "{age:?}");
    for quality in &report.quality {
        assert_eq!(quality.compared_frames, 3);
    }
}

#[test]
fn warping_at_depth_beats_turning_and_turning_beats_nothing() {
    // Matte surfaces only, where the depth of the surface is the depth of what it shows.
    let mut plan = plan(Trace::built_in(), 4.0, ImageSize::new(128, 128));
    plan.quality_spp = 64;
    let report = replay(&plan, "cornell", 64, 3);
    let psnr = |mode: &str| report.quality.iter().find(|quality| quality.mode == mode).unwrap().psnr_db.unwrap().p50;
    assert!(psnr("rotation") > psnr("none") + 1.0, "{} {}", psnr("rotation"), psnr("none"));
    assert!(psnr("diffuse") > psnr("rotation") + 0.5, "{} {}", psnr("diffuse"), psnr("rotation"));
}

#[test]
fn a_scene_without_specular_surfaces_sends_and_traces_nothing_of_them() {
    let plan = plan(Trace::built_in(), 1.0, ImageSize::new(64, 48));
    let report = replay(&plan, "cornell", 1, 1);
    assert!(report.link.planes.keys().all(|plane| plane.starts_with("root.")), "{:?}", report.link.planes);
    assert_eq!((report.counters["rays.reflect"], report.counters["rays.refract"]), (0, 0));
    assert!(!report.effects.iter().any(|effect| effect == "reflection" || effect == "refraction"));
}

#[test]
fn recorded_head_traces_replay() {
    let Some(data) = std::env::var_os("WARPLIGHT_DATA").map(PathBuf::from) else {
        eprintln!("skipped: WARPLIGHT_DATA is not set, so no recorded head trace is replayed");
        return;
    };
    let mut replayed = 0;
    for entry in std::fs::read_dir(data.join("traces")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "tum") {
            let trace = Trace::read(&path).unwrap();
            let report = replay(&plan(trace, 1.5, ImageSize::new(32, 32)), "cornell", 1, 1);
            assert_eq!(report.display.missed, 0, "{}", path.display());
            assert!(report.link.frames_shown >= 10, "{}", path.display());
            replayed += 1;
        }
    }
    assert!(replayed > 0);
}

#[test]
fn a_video_is_close_to_the_exact_frames_in_a_fraction_of_their_bytes() {
    let exact = plan(Trace::built_in(), 2.0, ImageSize::new(128, 96));
    let mut video = exact.clone();
    video.format.color_coding = ColorCoding::Video { quantiser: 24 };
    let (exact, lossy) = (replay(&exact, "gallery", 2, 7), replay(&video, "gallery", 2, 7));
    assert_eq!(lossy.to_json().unwrap(), replay(&video, "gallery", 2, 7).to_json().unwrap(), "to the byte");
    let radiance = |report: &Report| report.link.planes["root.radiance"];
    assert!(radiance(&lossy) * 3 < radiance(&exact), "{} of {}", radiance(&lossy), radiance(&exact));
    for (exact, lossy) in exact.quality.iter().zip(&lossy.quality) {
        let [exact_db, lossy_db] = [exact, lossy].map(|quality| quality.psnr_db.as_ref().unwrap().p50);
        // Codes are off by 35 to 40 dB, on top of what a mode and its holes leave: 20 to 35 dB.
        assert!(lossy_db > exact_db - 2.0, "{}: {lossy_db} for {exact_db} dB", exact.mode);
    }
}

#[test]
fn over_a_link_that_is_too_slow_a_video_goes_on() {
    let mut plan = plan(Trace::built_in(), 3.0, ImageSize::new(128, 96));
    plan.format.color_coding = ColorCoding::Video { quantiser: 24 };
    let latency = Duration::from_millis(20);
    let link = LinkModel { latency, rate_bits_per_sec: Some(4e5), ..LinkModel::default() };
    // A client that lacked a reference would end the session, and with it the replay.
    let report = replay_over(&plan, "gallery", 1, 7, link);
    assert!(report.link.frames_unsent > 2, "{:?}", report.link);
    assert!(report.link.frames_shown > 5, "{:?}", report.link);
}

#[test]
fn a_replay_goes_on_over_a_link_that_is_cut_and_every_frame_has_a_fate() {
    let mut plan = plan(Trace::built_in(), 6.0, ImageSize::new(32, 32));
    plan.quality_every = 0;
    let latency = Duration::from_millis(20);
    let cut = Some((Duration::from_millis(2500), Duration::from_millis(1500)));
    let link = LinkModel { latency, cut, rate_bits_per_sec: Some(4e6), ..LinkModel::default() };
    let report = replay_over(&plan, "cornell", 1, 7, link);
    assert_eq!(report.link.reconnects, 1);
    assert_eq!((report.display.frames, report.display.missed), (360, 0), "the display goes on");
    let Link { frames_sent, frames_shown, frames_replaced, frames_lost, .. } = report.link;
    assert_eq!(frames_sent, frames_shown + frames_replaced + frames_lost);
    assert!(frames_shown > 30, "{:?}", report.link);
    // It is as old as the cut is long, and a reconnection, and fresh again at the end.
    let ages = &report.series.display.frame_age_ms;
    let oldest = ages.iter().flatten().copied().fold(0.0, f64::max);
    assert!(oldest > 1500.0 && oldest < 2900.0, "{oldest} ms");
    assert!(ages[ages.len() - 30..].iter().flatten().all(|&age| age < 400.0), "{ages:?}");
    let prediction = &report.prediction;
    let (at_horizon, unpredicted) = (prediction.at_horizon_deg.unwrap(), prediction.unpredicted_deg.unwrap());
    assert!(at_horizon.mean < unpredicted.mean, "{at_horizon:?} {unpredicted:?}");
    assert_eq!(report.to_json().unwrap(), replay_over(&plan, "cornell", 1, 7, link).to_json().unwrap());
}
