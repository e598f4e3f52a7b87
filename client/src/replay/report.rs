//! From records to the report: sums and percentiles, nothing else.

use super::{QualityRun, Recording, ReplayPlan};
use crate::link::LinkModel;
use crate::measure::{Interval, Percentiles, Stage};
use crate::report::{
    ClockKind, ClockOffset, Display, DisplaySeries, FrameSeries, Latency, Link, ModeQuality, Prediction, QualitySeries, Reference, Report, SCHEMA, Series,
    doubts,
};
use crate::warp::Mode;
use std::collections::BTreeMap;
use std::time::Duration;

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
pub fn report_from(plan: &ReplayPlan, recording: &Recording, quality: &QualityRun, circumstances: Circumstances) -> Report {
    let offset = clock_offset(recording, circumstances.clock);
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
        latency_ms: latency(recording, offset),
        prediction: prediction(recording),
        link: link(plan, recording, circumstances.link),
        quality: Mode::ALL.into_iter().map(|mode| mode_quality(quality, mode)).collect(),
        reference: (!quality.refreshes.is_empty())
            .then(|| Reference { spp: u64::from(plan.quality_spp), noise_psnr_db: quality.noise_psnr_db }),
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

/// The server's clock minus the client's, in microseconds, and its bound: from the fastest pose up and the fastest
/// frame down, as NTP does from one packet each way (Mills 1991).
fn clock_offset(recording: &Recording, clock: ClockKind) -> Option<(f64, f64)> {
    if clock == ClockKind::Virtual {
        return Some((0.0, 0.0));
    }
    let difference = |to: Stage, from: Stage| {
        let of = move |record: &super::FrameRecord| {
            Some(record.times.at(to)?.micros as f64 - record.times.at(from)?.micros as f64)
        };
        recording.frames.iter().filter_map(of).min_by(f64::total_cmp)
    };
    let up = difference(Stage::PoseReceived, Stage::PoseSampled)?;
    let down = difference(Stage::Received, Stage::Sent)?;
    Some(((up - down) / 2.0, ((up + down) / 2.0).abs()))
}

fn latency(recording: &Recording, offset: Option<(f64, f64)>) -> Latency {
    let mut stages = BTreeMap::new();
    for interval in Interval::STEPS {
        let of = |record: &super::FrameRecord| {
            let mut times = record.times;
            if let Some((offset_micros, _)) = offset {
                times.set_clock_offset(offset_micros.round() as i64);
            }
            times.interval_ms(interval)
        };
        if let (Some(name), Some(spread)) = (interval.name(), spread(recording.frames.iter().filter_map(of))) {
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
        clock_offset: offset.map(|(offset_micros, error_micros)| ClockOffset {
            offset_ms: offset_micros * 1e-3,
            error_ms: error_micros * 1e-3,
            drift_ppm: 0.0,
        }),
    }
}

fn prediction(recording: &Recording) -> Prediction {
    let shown = || recording.frames.iter().filter_map(|frame| Some((frame, frame.pose_when_shown?)));
    let horizon = spread(recording.frames.iter().map(|frame| millis(frame.horizon)));
    Prediction {
        horizon_ms: horizon.map_or(0.0, |horizon| horizon.mean),
        error_deg: spread(shown().map(|(frame, pose)| frame.render_pose.angle_to(&pose).to_degrees())),
        error_mm: spread(shown().map(|(frame, pose)| (frame.render_pose.position - pose.position).length() * 1e3)),
    }
}

fn link(plan: &ReplayPlan, recording: &Recording, model: Option<LinkModel>) -> Link {
    let frames_shown = recording.frames.iter().filter(|frame| frame.shown).count() as u64;
    let seconds = plan.duration.as_secs_f64().max(1e-9);
    let plane_name = |node: u8| recording.plan.as_ref().map_or_else(String::new, |plan| plan.name(usize::from(node)));
    Link {
        down_bytes: recording.down_bytes,
        up_bytes: recording.up_bytes,
        down_mbps: recording.down_bytes as f64 * 8e-6 / seconds,
        frames_sent: u64::from(recording.statistics.frames_sent),
        frames_shown,
        frames_replaced: u64::from(recording.statistics.frames_replaced) + (recording.frames.len() as u64 - frames_shown),
        reconnects: recording.reconnects,
        latency_ms: model.map(|model| millis(model.latency)),
        jitter_ms: model.map(|model| millis(model.jitter)),
        rate_mbps: model.and_then(|model| model.rate_bits_per_sec).map(|rate| rate * 1e-6),
        planes: recording
            .bytes_per_plane
            .iter()
            .map(|(&(node, kind), &bytes)| (format!("{}.{}", plane_name(node), kind.name()), bytes))
            .collect(),
    }
}

fn mode_quality(quality: &QualityRun, mode: Mode) -> ModeQuality {
    let all = || quality.refreshes.iter().flat_map(|refresh| &refresh.modes).filter(|assessment| assessment.mode == mode);
    ModeQuality {
        mode: mode.name().to_owned(),
        psnr_db: spread(all().map(|assessment| assessment.compared.error.psnr_db)),
        dssim: spread(all().map(|assessment| assessment.compared.error.dssim)),
        flip: spread(all().map(|assessment| assessment.compared.error.flip)),
        hole_fraction: spread(all().map(|assessment| assessment.statistics.hole_fraction)),
        compared_frames: all().count() as u64,
    }
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
            series.psnr_db.push(assessment.compared.error.psnr_db);
            series.dssim.push(assessment.compared.error.dssim);
            series.flip.push(assessment.compared.error.flip);
            series.hole_fraction.push(assessment.statistics.hole_fraction);
        }
    }
    Series { display, frames, quality: by_mode }
}
