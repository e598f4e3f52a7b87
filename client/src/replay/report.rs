//! From records to the report: sums and percentiles, nothing else.

use super::clock::{clock_line, epochs};
use super::spikes::spikes_of;
use super::{AssessedRefresh, Assessment, FrameRecord, QualityRun, Recording, ReplayPlan};
use crate::budget::DisplayBudget;
use crate::display::{Eye, Optics};
use crate::link::LinkModel;
use crate::measure::{ImageError, Interval, Percentiles, Stage};
use crate::report::{
    ClockKind, Display, DisplaySeries, EyeQuality, FrameSeries, Latency, Limit, Link, ModeQuality, NodeReport,
    OpticsUsed, Prediction, QualitySeries, Reference, Report, SCHEMA, Series, SpecularQuality, SpecularReport,
    Viewport, doubts,
};
use crate::warp::{Mode, NodeStatistics};
use std::collections::BTreeMap;
use std::time::Duration;
use warplight_protocol::camera::Projection;
use warplight_protocol::message::Limiter;
use warplight_protocol::{Camera, Pose};

/// What the records themselves do not say.
#[derive(Clone, Debug)]
pub struct Circumstances {
    /// Name or path of the trace.
    pub trace: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Which clock ran.
    pub clock: ClockKind,
    /// The link, where it was modelled.
    pub link: Option<LinkModel>,
    /// What was noticed on the way.
    pub warnings: Vec<String>,
}

/// Makes the report of a replay.
pub fn report_from(
    plan: &ReplayPlan,
    recording: &Recording,
    quality: &QualityRun,
    circumstances: Circumstances,
) -> Report {
    let mut report = Report {
        schema: SCHEMA,
        scene: recording.welcome.as_ref().map_or_else(String::new, |welcome| welcome.scene.clone()),
        trace: circumstances.trace,
        seed: circumstances.seed,
        clock: circumstances.clock,
        size: [plan.camera.size.width, plan.camera.size.height],
        mode: plan.mode.name().to_owned(),
        effects: recording.welcome.as_ref().map_or_else(Vec::new, |welcome| welcome.effects.clone()),
        display: Display {
            hz: plan.display_hz,
            frames: plan.refreshes(),
            missed: plan.refreshes() - recording.displays.iter().filter(|display| !display.missed).count() as u64,
        },
        latency_ms: latency(recording, circumstances.clock),
        spikes: spikes_of(recording, circumstances.clock),
        limits: limits(recording),
        budget: recording.budget.as_ref().map(DisplayBudget::report),
        prediction: prediction(plan, recording),
        viewport: viewport(plan, recording),
        link: link(plan, recording, circumstances.link),
        optics: optics(&plan.optics),
        quality: plan
            .modes
            .iter()
            .filter(|&&mode| is_shown(quality, mode))
            .map(|&mode| mode_quality(quality, mode))
            .collect(),
        reference: (!quality.refreshes.is_empty()).then(|| Reference {
            spp: u64::from(plan.quality_spp),
            noise_psnr_db: quality.noise_psnr_db,
            specular_noise_psnr_db: quality.specular_noise_psnr_db,
        }),
        specular: specular(plan, recording, quality),
        counters: recording.totals().counters.into_iter().collect(),
        warnings: circumstances.warnings,
        series: series(recording, quality),
    };
    let own = doubts(&report);
    report.warnings.extend(own);
    report
}

fn millis(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

fn spread(samples: impl IntoIterator<Item = f64>) -> Option<Percentiles> {
    Percentiles::from_samples(&samples.into_iter().collect::<Vec<_>>()).ok()
}

fn latency(recording: &Recording, clock: ClockKind) -> Latency {
    let mut stages = BTreeMap::new();
    let mut samples: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let mut latest_offset = None;
    for epoch in epochs(&recording.frames) {
        let line = clock_line(epoch, clock);
        latest_offset = line.map(|line| line.reported());
        for record in epoch {
            let mut times = record.times;
            if let Some(line) = line {
                times.set_clock_offset(line.offset_micros_of(record));
            }
            for interval in Interval::STEPS {
                if let (Some(name), Some(millis)) = (interval.name(), times.interval_ms(interval)) {
                    samples.entry(name).or_default().push(millis);
                }
            }
        }
    }
    for (name, samples) in samples {
        if let Some(spread) = spread(samples) {
            stages.insert(name.to_owned(), spread);
        }
    }
    if let Some(warp) = spread(recording.displays.iter().map(|display| millis(display.warp))) {
        stages.insert("warp".to_owned(), warp);
    }
    Latency {
        motion_to_photon: spread(recording.displays.iter().map(|display| millis(display.motion_to_photon))),
        frame_age: spread(recording.displays.iter().map(|display| millis(display.frame_age))),
        stages,
        clock_offset: latest_offset,
    }
}

fn limits(recording: &Recording) -> Vec<Limit> {
    let live = recording.statistics.live_micros.max(1) as f64;
    let limit = |limiter: &Limiter| Limit {
        name: limiter.kind.name().to_owned(),
        share: limiter.active_micros as f64 / live,
        why: limiter.why.clone(),
    };
    recording.statistics.limiters.iter().filter(|limiter| limiter.active_micros > 0).map(limit).collect()
}

fn prediction(plan: &ReplayPlan, recording: &Recording) -> Prediction {
    let shown = || recording.frames.iter().filter_map(|frame| Some((frame, frame.pose_when_shown?)));
    let horizon = spread(recording.frames.iter().map(|frame| millis(frame.horizon)));
    // The orientation of a cube is none that was predicted.
    let is_turned = |frame: &FrameRecord| frame.camera.projection == Projection::Perspective;
    let degrees = |a: &Pose, b: &Pose| a.angle_to(b).to_degrees();
    let millimetres = |a: &Pose, b: &Pose| (a.position - b.position).length() * 1e3;
    let foreseen = foreseen(plan, recording);
    let turned = || foreseen.iter().filter(|(frame, ..)| is_turned(frame));
    Prediction {
        law: plan.prediction.name().to_owned(),
        horizon_ms: horizon.map_or(0.0, |horizon| horizon.mean),
        error_deg: spread(
            shown().filter(|(frame, _)| is_turned(frame)).map(|(frame, pose)| degrees(&frame.render_pose, &pose)),
        ),
        error_mm: spread(shown().map(|(frame, pose)| millimetres(&frame.render_pose, &pose))),
        at_horizon_deg: spread(turned().map(|(frame, _, then)| degrees(&frame.render_pose, then))),
        at_horizon_mm: spread(foreseen.iter().map(|(frame, _, then)| millimetres(&frame.render_pose, then))),
        unpredicted_deg: spread(turned().map(|(_, last, then)| degrees(last, then))),
        unpredicted_mm: spread(foreseen.iter().map(|(_, last, then)| millimetres(last, then))),
    }
}

/// Frames that answer a pose of the trace, with that pose and where the head was a horizon later.
fn foreseen<'a>(plan: &ReplayPlan, recording: &'a Recording) -> Vec<(&'a FrameRecord, Pose, Pose)> {
    let Some(welcome) = &recording.welcome else { return Vec::new() };
    let trace = plan.placed_trace(&welcome.head);
    let poses = |frame: &'a FrameRecord| {
        // Before the start the head stands still.
        let asked_secs = frame.times.at(Stage::PoseSampled)?.as_secs() - recording.start.as_secs();
        let then_secs = asked_secs + frame.horizon.as_secs_f64();
        (asked_secs >= 0.0).then(|| (frame, trace.pose_at(asked_secs), trace.pose_at(then_secs)))
    };
    recording.frames.iter().filter_map(poses).collect()
}

fn link(plan: &ReplayPlan, recording: &Recording, model: Option<LinkModel>) -> Link {
    let arrived = recording.frames.len() as u64;
    let frames_shown = recording.frames.iter().filter(|frame| frame.shown).count() as u64;
    let seconds = plan.duration.as_secs_f64().max(1e-9);
    Link {
        down_bytes: recording.down_bytes,
        up_bytes: recording.up_bytes,
        down_mbps: recording.down_bytes as f64 * 8e-6 / seconds,
        frames_sent: arrived + recording.frames_lost,
        frames_shown,
        frames_replaced: arrived - frames_shown,
        frames_lost: recording.frames_lost,
        frames_unsent: u64::from(recording.totals().frames_replaced),
        reconnects: recording.reconnects,
        latency_ms: model.map(|model| millis(model.latency)),
        jitter_ms: model.map(|model| millis(model.jitter)),
        rate_mbps: model.and_then(|model| model.rate_bits_per_sec).map(|rate| rate * 1e-6),
        stall_ms: model.and_then(|model| model.stall).map(|(_, length)| millis(length)),
        stall_every_ms: model.and_then(|model| model.stall).map(|(every, _)| millis(every)),
        cut_at_s: model.and_then(|model| model.cut).map(|(at, _)| at.as_secs_f64()),
        cut_s: model.and_then(|model| model.cut).map(|(_, length)| length.as_secs_f64()),
        planes: recording
            .bytes_per_plane
            .iter()
            .filter_map(|(&(node, kind), &bytes)| Some((kind.name_in(recording.plan.as_ref()?, node), bytes)))
            .collect(),
    }
}

fn optics(optics: &Optics) -> Option<OpticsUsed> {
    (*optics != Optics::default()).then(|| OpticsUsed {
        eye_distance_mm: optics.eye_distance_m.map(|metres| metres * 1e3),
        aperture_mm: optics.lens.map(|lens| lens.aperture_m * 1e3),
        focus_m: optics.lens.map(|lens| lens.focus_m),
        shutter_ms: optics.shutter.map(|shutter| millis(shutter.open)),
        samples: optics.samples() as u64,
        smooth_edges: optics.smooth_edges,
    })
}

/// Spreads of the three metrics.
fn spreads<'a>(errors: impl Iterator<Item = &'a ImageError> + Clone) -> EyeQuality {
    EyeQuality {
        psnr_db: spread(errors.clone().map(|error| error.psnr_db)),
        dssim: spread(errors.clone().map(|error| error.dssim)),
        flip: spread(errors.map(|error| error.flip)),
    }
}

fn viewport(plan: &ReplayPlan, recording: &Recording) -> Viewport {
    let display = &plan.camera;
    let cameras = || recording.frames.iter().map(|frame| &frame.camera);
    Viewport {
        guard_deg: spread(
            cameras()
                .filter(|frame| frame.projection == Projection::Perspective)
                .map(|frame| guard_deg(display, frame)),
        ),
        pixels_per_display_pixel: spread(
            cameras().map(|frame| frame.size.pixels() as f64 / display.size.pixels().max(1) as f64),
        ),
    }
}

/// What a frame shows beyond the side of the display at which it shows most.
fn guard_deg(display: &Camera, frame: &Camera) -> f64 {
    let beyond = |frame: f32, display: f32| f64::from(frame.abs()).atan() - f64::from(display.abs()).atan();
    let (frame, display) = (&frame.fov, &display.fov);
    let sides = [
        beyond(frame.left, display.left),
        beyond(frame.right, display.right),
        beyond(frame.down, display.down),
        beyond(frame.up, display.up),
    ];
    sides.into_iter().fold(0.0, f64::max).to_degrees()
}

/// Whether pictures tell a mode from others; without pictures every mode is.
fn is_shown(quality: &QualityRun, mode: Mode) -> bool {
    quality.refreshes.first().is_none_or(|refresh| refresh.modes.iter().any(|shown| shown.mode == mode))
}

fn mode_quality(quality: &QualityRun, mode: Mode) -> ModeQuality {
    let all = || {
        let of_refresh = |refresh: &'_ AssessedRefresh| (refresh.eye, refresh.specular_fraction);
        let with_mode = move |assessment: &&Assessment| assessment.mode == mode;
        quality.refreshes.iter().flat_map(move |refresh| {
            refresh.modes.iter().filter(with_mode).map(move |assessment| (of_refresh(refresh), assessment))
        })
    };
    let EyeQuality { psnr_db, dssim, flip } = spreads(all().map(|(_, assessment)| &assessment.compared.error));
    let of_specular = spreads(all().filter_map(|(_, assessment)| assessment.specular.as_ref()));
    let fraction = spread(all().filter(|(_, assessment)| assessment.specular.is_some()).map(|((_, part), _)| part));
    let mut eyes = BTreeMap::new();
    for eye in [Eye::Left, Eye::Right] {
        let of_eye =
            all().filter(|((seen_by, _), _)| *seen_by == eye).map(|(_, assessment)| &assessment.compared.error);
        if of_eye.clone().next().is_some() {
            eyes.insert(eye.name().to_owned(), spreads(of_eye));
        }
    }
    ModeQuality {
        mode: mode.name().to_owned(),
        psnr_db,
        dssim,
        flip,
        hole_fraction: spread(all().map(|(_, assessment)| assessment.statistics.hole_fraction)),
        compared_frames: all().count() as u64,
        specular: fraction.map(|_| SpecularQuality {
            psnr_db: of_specular.psnr_db,
            dssim: of_specular.dssim,
            flip: of_specular.flip,
            pixel_fraction: fraction,
        }),
        eyes,
    }
}

/// How mode `specular` was set, and what its nodes lacked.
fn specular(plan: &ReplayPlan, recording: &Recording, quality: &QualityRun) -> SpecularReport {
    let of_mode = |assessment: &&Assessment| assessment.mode == Mode::Specular;
    let refreshes: Vec<&[NodeStatistics]> = quality
        .refreshes
        .iter()
        .filter_map(|refresh| refresh.modes.iter().find(of_mode))
        .map(|assessment| &assessment.statistics.nodes[..])
        .collect();
    let nodes = recording.plan.as_ref().map_or_else(Vec::new, |plan| NodeReport::of(plan, &refreshes));
    SpecularReport { solver: plan.solver.to_string(), normals: plan.normals.name().to_owned(), nodes }
}

fn series(recording: &Recording, quality: &QualityRun) -> Series {
    let mut display = DisplaySeries::default();
    for record in &recording.displays {
        display.time_s.push(record.time.as_secs_f64());
        display.frame_age_ms.push(Some(millis(record.frame_age)));
        display.motion_to_photon_ms.push(Some(millis(record.motion_to_photon)));
    }
    let mut frames = FrameSeries::default();
    for record in &recording.frames {
        let received = record.times.at(Stage::Received).unwrap_or_default();
        frames.time_s.push(received.as_secs() - recording.start.as_secs());
        frames.bytes.push(record.bytes);
    }
    let mut by_mode: BTreeMap<String, QualitySeries> = BTreeMap::new();
    for refresh in &quality.refreshes {
        for assessment in &refresh.modes {
            let series = by_mode.entry(assessment.mode.name().to_owned()).or_default();
            series.time_s.push(refresh.time.as_secs_f64());
            series.specular_psnr_db.push(assessment.specular.map(|error| error.psnr_db));
            series.psnr_db.push(assessment.compared.error.psnr_db);
            series.dssim.push(assessment.compared.error.dssim);
            series.flip.push(assessment.compared.error.flip);
            series.hole_fraction.push(assessment.statistics.hole_fraction);
        }
    }
    Series { display, frames, quality: by_mode }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::measure::FrameTimes;
    use warplight_protocol::frame::FrameId;
    use warplight_protocol::{ImageSize, Timestamp};

    /// A frame of a server whose clock is `ahead` of the client's: 10 ms up, 80 ms of rendering, 20 ms down.
    pub(in crate::replay) fn frame(client_micros: i64, ahead_micros: i64) -> FrameRecord {
        let mut times = FrameTimes::default();
        let at = |micros: i64| Timestamp { micros: micros as u64 };
        times.record(Stage::PoseSampled, at(client_micros));
        times.record(Stage::PoseReceived, at(client_micros + 10_000 + ahead_micros));
        times.record(Stage::Sent, at(client_micros + 90_000 + ahead_micros));
        times.record(Stage::Received, at(client_micros + 110_000));
        let (horizon, render_pose) = (Duration::ZERO, Pose::IDENTITY);
        FrameRecord {
            id: FrameId(1),
            times,
            bytes: 0,
            spp: 1,
            horizon,
            render_pose,
            camera: Camera::symmetric(1.0, ImageSize::new(1, 1)),
            shown: false,
            pose_when_shown: None,
        }
    }

    #[test]
    fn a_restarted_server_has_a_clock_of_its_own() {
        let mut recording = Recording::default();
        recording.frames.extend((0..10).map(|number| frame(10_000_000 + 100_000 * number, 5_000_000)));
        recording.frames.extend((0..10).map(|number| frame(12_000_000 + 100_000 * number, -11_000_000)));
        let latency = latency(&recording, ClockKind::Real);
        let send = latency.stages["send"];
        assert!(send.count == 20 && (send.min - 15.0).abs() < 1e-6 && (send.max - 15.0).abs() < 1e-6, "{send:?}");
        assert!((latency.clock_offset.unwrap().offset_ms + 11_000.0).abs() < 15.0);
    }
}
