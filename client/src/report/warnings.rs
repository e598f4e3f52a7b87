//! The report doubts itself: reasons why a figure in it may not mean what it seems to.
//!
//! Each doubt says what is doubtful, the figure, and what would help. Thresholds are constants with their
//! reason; none of them hides or changes a measurement.

use super::{ClockKind, Report};

/// A 99th percentile of fewer samples than this is its largest sample or close to it.
const SAMPLES_FOR_P99: u64 = 300;
/// Fewer compared frames than this say little about a mode along a whole trace.
const FRAMES_FOR_QUALITY: u64 = 20;
/// Part of missed refreshes that a viewer notices as stutter.
const MISSED_PART: f64 = 0.01;
/// A mode's PSNR this close to the reference's own noise, in dB, is limited by the reference: with both
/// errors independent, 6 dB apart the noise still makes up a fifth of the squared error.
const NOISE_MARGIN_DB: f64 = 6.0;
/// Clock drift in parts per million that moves a delay by a millisecond within 20 seconds.
const DRIFT_PPM: f64 = 50.0;
/// Holes that are plain to see, as part of the pixels.
const HOLE_PART: f64 = 0.02;

/// All doubts about `report`, the gravest first. The caller puts them into [`Report::warnings`].
pub fn doubts(report: &Report) -> Vec<String> {
    let mut doubts = Vec::new();
    nothing_measured(report, &mut doubts);
    missed_refreshes(report, &mut doubts);
    few_samples(report, &mut doubts);
    noisy_reference(report, &mut doubts);
    clocks(report, &mut doubts);
    holes(report, &mut doubts);
    doubts
}

fn nothing_measured(report: &Report, doubts: &mut Vec<String>) {
    if report.link.frames_shown == 0 {
        doubts.push("no frame was shown: every delay and every image error is missing".into());
    }
    if report.quality.iter().all(|quality| quality.compared_frames == 0) {
        doubts.push("no displayed image was compared with a reference: quality is unknown".into());
    }
    if report.link.reconnects > 0 {
        let times = report.link.reconnects;
        doubts.push(format!("the connection was lost and made again {times} time(s): delays hold the outage"));
    }
}

fn missed_refreshes(report: &Report, doubts: &mut Vec<String>) {
    let (missed, frames) = (report.display.missed, report.display.frames);
    let part = missed as f64 / frames.max(1) as f64;
    if part > MISSED_PART {
        let percent = 100.0 * part;
        doubts.push(format!("{missed} of {frames} refreshes were missed ({percent:.1} %): the motion stutters"));
    }
}

fn few_samples(report: &Report, doubts: &mut Vec<String>) {
    let measured = [
        ("motion to photon", report.latency_ms.motion_to_photon),
        ("frame age", report.latency_ms.frame_age),
        ("prediction error", report.prediction.error_deg),
    ];
    for (what, spread) in measured {
        if let Some(spread) = spread
            && spread.count < SAMPLES_FOR_P99
        {
            let count = spread.count;
            doubts.push(format!("{what}: {count} samples; its p99 wants at least {SAMPLES_FOR_P99}"));
        }
    }
    let compared = report.quality.iter().map(|quality| quality.compared_frames).filter(|&count| count > 0).min();
    if let Some(compared) = compared.filter(|&count| count < FRAMES_FOR_QUALITY) {
        doubts
            .push(format!("quality: {compared} compared frames; at least {FRAMES_FOR_QUALITY} are wanted for a trace"));
    }
}

fn noisy_reference(report: &Report, doubts: &mut Vec<String>) {
    let Some(reference) = &report.reference else { return };
    let Some(noise_db) = reference.noise_psnr_db else {
        if report.quality.iter().any(|quality| quality.compared_frames > 0) {
            doubts.push("the noise of the reference was not measured: small image errors may be noise".into());
        }
        return;
    };
    for quality in &report.quality {
        if let Some(psnr_db) = quality.psnr_db
            && psnr_db.p50 > noise_db - NOISE_MARGIN_DB
        {
            let (mode, spp, median) = (&quality.mode, reference.spp, psnr_db.p50);
            doubts.push(format!(
                "{mode}: its median PSNR of {median:.1} dB is near the reference's own noise \
                 ({noise_db:.1} dB at {spp} spp)"
            ));
        }
    }
}

fn clocks(report: &Report, doubts: &mut Vec<String>) {
    if let Some(offset) = report.latency_ms.clock_offset {
        if offset.drift_ppm.abs() > DRIFT_PPM {
            doubts.push(format!("the clocks of client and server drift by {:.0} ppm", offset.drift_ppm));
        }
        let send = report.latency_ms.stages.get("send").map(|send| send.p50);
        if let Some(send) = send.filter(|&send| offset.error_ms > 0.5 * send.abs()) {
            let error = offset.error_ms;
            doubts.push(format!("send takes {send:.2} ms, but the clock offset is known to {error:.2} ms only"));
        }
    }
    let negative = report.latency_ms.stages.iter().find(|(_, spread)| spread.min < 0.0);
    if let Some((stage, spread)) = negative {
        doubts.push(format!("{stage}: {:.2} ms at least, which cannot be: the clock offset is wrong", spread.min));
    }
    if report.clock == ClockKind::Virtual {
        let stages = &report.latency_ms.stages;
        if stages.values().all(|spread| spread.max == 0.0) && !stages.is_empty() {
            doubts.push("every stage took no time: the virtual clock has no cost model".into());
        }
    }
}

fn holes(report: &Report, doubts: &mut Vec<String>) {
    for quality in &report.quality {
        if let Some(holes) = quality.hole_fraction
            && holes.p95 > HOLE_PART
        {
            let (mode, percent) = (&quality.mode, 100.0 * holes.p95);
            doubts.push(format!("{mode}: nothing is known for {percent:.1} % of the pixels (p95)"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{ClockOffset, Reference, sample};

    fn doubted(change: impl FnOnce(&mut Report), word: &str) {
        let mut report = sample::sound_report();
        assert_eq!(doubts(&report), Vec::<String>::new());
        change(&mut report);
        let said = doubts(&report);
        assert!(said.iter().any(|doubt| doubt.contains(word)), "{word}: {said:?}");
    }

    #[test]
    fn a_sound_report_has_no_doubts_and_each_fault_has_one() {
        doubted(|report| report.display.missed = 40, "missed");
        doubted(|report| report.link.frames_shown = 0, "no frame was shown");
        doubted(|report| report.link.reconnects = 2, "made again 2 time(s)");
        doubted(|report| report.quality.clear(), "quality is unknown");
        doubted(|report| report.quality[0].compared_frames = 3, "3 compared frames");
        doubted(
            |report| report.reference = Some(Reference { spp: 16, noise_psnr_db: None, specular_noise_psnr_db: None }),
            "was not measured",
        );
        doubted(
            |report| {
                report.reference = Some(Reference { spp: 16, noise_psnr_db: Some(25.0), specular_noise_psnr_db: None })
            },
            "own noise",
        );
        let offset = |drift_ppm, error_ms| Some(ClockOffset { offset_ms: 1.0, error_ms, drift_ppm });
        doubted(|report| report.latency_ms.clock_offset = offset(90.0, 0.1), "drift by 90 ppm");
        doubted(|report| report.latency_ms.clock_offset = offset(0.0, 20.0), "is known to 20.00 ms only");
        doubted(
            |report| {
                if let Some(age) = &mut report.latency_ms.frame_age {
                    age.count = 12;
                }
            },
            "frame age: 12 samples",
        );
        doubted(
            |report| {
                if let Some(send) = report.latency_ms.stages.get_mut("send") {
                    send.min = -0.3;
                }
            },
            "cannot be",
        );
        doubted(
            |report| {
                if let Some(holes) = &mut report.quality[0].hole_fraction {
                    holes.p95 = 0.2;
                }
            },
            "20.0 % of the pixels",
        );
    }
}
