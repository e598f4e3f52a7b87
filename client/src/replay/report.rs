//! From records to the report: sums and percentiles, nothing else.

use super::{AssessedRefresh, Assessment, FrameRecord, QualityRun, Recording, ReplayPlan};
use crate::display::{Eye, Optics};
use crate::link::LinkModel;
use crate::measure::{ImageError, Interval, Percentiles, Stage};
use crate::report::{
    ClockKind, ClockOffset, Display, DisplaySeries, EyeQuality, FrameSeries, Latency, Link, ModeQuality, NodeReport,
    OpticsUsed, Prediction, QualitySeries, Reference, Report, SCHEMA, Series, SpecularQuality, SpecularReport,
    Viewport, doubts,
};
use crate::warp::{Mode, NodeStatistics};
use std::collections::BTreeMap;
use std::time::Duration;
use warplight_protocol::Camera;
use warplight_protocol::camera::Projection;

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
        prediction: prediction(recording),
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
        counters: recording.statistics.counters.iter().cloned().collect(),
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

/// Frames by the server's clock that stamped them: a restarted server has a new one.
fn epochs(frames: &[FrameRecord]) -> impl Iterator<Item = &[FrameRecord]> {
    frames.chunk_by(|before, after| after.times.at(Stage::Sent) >= before.times.at(Stage::Sent))
}

/// The server's clock as the client sees it, from the frames of one epoch. In virtual time there is only one clock.
fn clock_offset(frames: &[FrameRecord], clock: ClockKind) -> Option<ClockOffset> {
    if clock == ClockKind::Virtual {
        return Some(ClockOffset { offset_ms: 0.0, error_ms: 0.0, drift_ppm: 0.0 });
    }
    let (early, late) = frames.split_at(frames.len() / 2);
    let (offset_ms, error_ms) = offset_and_error_ms(frames)?;
    Some(ClockOffset { offset_ms, error_ms, drift_ppm: drift_ppm(early, late).unwrap_or(0.0) })
}

/// From the fastest pose up and the fastest frame down, as NTP does from one packet each way (Mills 1991).
fn offset_and_error_ms(frames: &[FrameRecord]) -> Option<(f64, f64)> {
    let fastest_ms = |from: Stage, to: Stage| {
        let of =
            move |record: &FrameRecord| Some((record.times.at(to)?.as_secs() - record.times.at(from)?.as_secs()) * 1e3);
        frames.iter().filter_map(of).min_by(f64::total_cmp)
    };
    let up = fastest_ms(Stage::PoseSampled, Stage::PoseReceived)?;
    let down = fastest_ms(Stage::Sent, Stage::Received)?;
    Some(((up - down) / 2.0, ((up + down) / 2.0).abs()))
}

fn drift_ppm(early: &[FrameRecord], late: &[FrameRecord]) -> Option<f64> {
    let middle_secs =
        |frames: &[FrameRecord]| frames.get(frames.len() / 2)?.times.at(Stage::Received).map(|at| at.as_secs());
    let elapsed_secs = middle_secs(late)? - middle_secs(early)?;
    let change_ms = offset_and_error_ms(late)?.0 - offset_and_error_ms(early)?.0;
    (elapsed_secs > 1.0).then(|| change_ms * 1e3 / elapsed_secs)
}

fn latency(recording: &Recording, clock: ClockKind) -> Latency {
    let mut stages = BTreeMap::new();
    let mut samples: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let mut latest_offset = None;
    for epoch in epochs(&recording.frames) {
        latest_offset = clock_offset(epoch, clock);
        for record in epoch {
            let mut times = record.times;
            if let Some(offset) = latest_offset {
                times.set_clock_offset((offset.offset_ms * 1e3).round() as i64);
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

fn prediction(recording: &Recording) -> Prediction {
    let shown = || recording.frames.iter().filter_map(|frame| Some((frame, frame.pose_when_shown?)));
    let horizon = spread(recording.frames.iter().map(|frame| millis(frame.horizon)));
    Prediction {
        horizon_ms: horizon.map_or(0.0, |horizon| horizon.mean),
        // The orientation of a cube is none that was predicted.
        error_deg: spread(
            shown()
                .filter(|(frame, _)| frame.camera.projection == Projection::Perspective)
                .map(|(frame, pose)| frame.render_pose.angle_to(&pose).to_degrees()),
        ),
        error_mm: spread(shown().map(|(frame, pose)| (frame.render_pose.position - pose.position).length() * 1e3)),
    }
}

fn link(plan: &ReplayPlan, recording: &Recording, model: Option<LinkModel>) -> Link {
    let frames_shown = recording.frames.iter().filter(|frame| frame.shown).count() as u64;
    let seconds = plan.duration.as_secs_f64().max(1e-9);
    Link {
        down_bytes: recording.down_bytes,
        up_bytes: recording.up_bytes,
        down_mbps: recording.down_bytes as f64 * 8e-6 / seconds,
        frames_sent: u64::from(recording.statistics.frames_sent),
        frames_shown,
        frames_replaced: u64::from(recording.statistics.frames_replaced)
            + (recording.frames.len() as u64 - frames_shown),
        reconnects: recording.reconnects,
        latency_ms: model.map(|model| millis(model.latency)),
        jitter_ms: model.map(|model| millis(model.jitter)),
        rate_mbps: model.and_then(|model| model.rate_bits_per_sec).map(|rate| rate * 1e-6),
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
mod tests {
    use super::*;
    use crate::measure::FrameTimes;
    use warplight_protocol::frame::FrameId;
    use warplight_protocol::{ImageSize, Pose, Timestamp};

    /// A frame of a server whose clock is `ahead` of the client's: 10 ms up, 80 ms of rendering, 20 ms down.
    fn frame(client_micros: i64, ahead_micros: i64) -> FrameRecord {
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
    fn the_offset_of_two_clocks_is_found_within_its_error() {
        let frames: Vec<_> = (0..20).map(|number| frame(1_000_000 + 100_000 * number, 7_000_000)).collect();
        let offset = clock_offset(&frames, ClockKind::Real).unwrap();
        assert!((offset.offset_ms - 7000.0).abs() <= offset.error_ms + 1e-6);
        assert!((offset.error_ms - 15.0).abs() < 1e-6 && offset.drift_ppm.abs() < 1.0);
    }

    #[test]
    fn a_clock_that_runs_faster_is_seen_to_drift() {
        let frames: Vec<_> = (0..100).map(|number| frame(100_000 * number, 7_000_000 + 20 * number)).collect();
        let offset = clock_offset(&frames, ClockKind::Real).unwrap();
        assert!((offset.drift_ppm - 200.0).abs() < 5.0, "{}", offset.drift_ppm);
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
