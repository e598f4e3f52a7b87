//! Which plots a report has: quality over the trace, latency as distribution and over time, bytes per plane.

use super::chart::{Chart, Line, bars};
use super::html::{bytes, figure};
use crate::measure::Percentiles;
use crate::report::{QualitySeries, Report};

/// Fractions at which a distribution is drawn.
const STEPS: usize = 240;

/// FLIP and PSNR of every mode over the trace.
pub(super) fn quality(report: &Report) -> String {
    let lines = |column: fn(&QualitySeries) -> &Vec<f64>| -> Vec<Line> {
        // In the order of the table, which is the order of the modes.
        let known = report.quality.iter().filter_map(|quality| {
            let series = report.series.quality.get(&quality.mode)?;
            let points = series.time_s.iter().zip(column(series)).map(|(&t, &value)| (t, Some(value))).collect();
            Some(Line { name: quality.mode.clone(), points })
        });
        known.collect()
    };
    let medians = |column: fn(&crate::report::ModeQuality) -> Option<Percentiles>| -> String {
        let median = |quality: &crate::report::ModeQuality| {
            column(quality).map(|spread| format!("{} {}", quality.mode, figure(spread.p50)))
        };
        report.quality.iter().filter_map(median).collect::<Vec<_>>().join(", ")
    };
    let flip = Chart {
        title: "FLIP over the trace <small>lower is better</small>",
        description: format!("Mean FLIP of every mode over time; medians: {}", medians(|quality| quality.flip)),
        x_label: "time, s",
        y_label: "FLIP",
        from_zero: true,
        lines: lines(|series| &series.flip),
    };
    let psnr = Chart {
        title: "PSNR over the trace <small>higher is better</small>",
        description: format!("PSNR of every mode over time; medians in dB: {}", medians(|quality| quality.psnr_db)),
        x_label: "time, s",
        y_label: "PSNR, dB",
        from_zero: false,
        lines: lines(|series| &series.psnr_db),
    };
    grid(&[flip.to_html(), psnr.to_html()])
}

/// Distribution of the delays, and the frame age over time.
pub(super) fn latency(report: &Report) -> String {
    let display = &report.series.display;
    let spread_text = |spread: Option<Percentiles>| {
        spread.map_or("not measured".into(), |spread| {
            format!("median {} ms, p95 {} ms, p99 {} ms", figure(spread.p50), figure(spread.p95), figure(spread.p99))
        })
    };
    let (motion, age) = (report.latency_ms.motion_to_photon, report.latency_ms.frame_age);
    let distributions = [("motion to photon", &display.motion_to_photon_ms), ("frame age", &display.frame_age_ms)];
    let distribution = Chart {
        title: "Latency distribution <small>part of the refreshes at or below</small>",
        description: format!(
            "Cumulative distribution. Motion to photon: {}. Frame age: {}.",
            spread_text(motion),
            spread_text(age)
        ),
        x_label: "delay, ms",
        y_label: "refreshes, %",
        from_zero: true,
        lines: distributions
            .into_iter()
            .map(|(name, samples)| Line { name: name.into(), points: cumulative(samples) })
            .collect(),
    };
    let over_time = |samples: &[Option<f64>]| display.time_s.iter().copied().zip(samples.iter().copied()).collect();
    let frame_age = Chart {
        title: "Frame age over time",
        description: format!("Age of the shown frame at every refresh: {}", spread_text(age)),
        x_label: "time, s",
        y_label: "age, ms",
        from_zero: true,
        lines: [Line { name: "frame age".into(), points: over_time(&display.frame_age_ms) }]
            .into_iter()
            .chain(spikes(report))
            .collect(),
    };
    grid(&[distribution.to_html(), frame_age.to_html()])
}

/// Frames whose age is a spike, as strokes from zero; nothing where there are none.
fn spikes(report: &Report) -> Option<Line> {
    let of_age = report.spikes.listed.iter().filter(|spike| spike.delay == "frame age");
    let stroke = |spike: &crate::report::Spike| {
        [(spike.time_s, Some(0.0)), (spike.time_s, Some(spike.ms)), (spike.time_s, None)]
    };
    let points: Vec<_> = of_age.flat_map(stroke).collect();
    (!points.is_empty()).then(|| Line { name: "spikes, when first shown".into(), points })
}

/// Bytes per plane, and the size of every frame over time.
pub(super) fn bandwidth(report: &Report) -> String {
    let mut planes: Vec<(&String, u64)> = report.link.planes.iter().map(|(name, &size)| (name, size)).collect();
    planes.sort_by_key(|&(name, size)| (std::cmp::Reverse(size), name));
    let total: u64 = planes.iter().map(|plane| plane.1).sum();
    let row = |(name, size): (&String, u64)| {
        let percent = 100.0 * size as f64 / total.max(1) as f64;
        (name.clone(), size as f64, format!("{} · {percent:.0} %", bytes(size)))
    };
    let rows: Vec<(String, f64, String)> = planes.into_iter().map(row).collect();
    let description = format!("Encoded bytes per plane, {} in all; the table of the link has the sum", bytes(total));
    let frames = &report.series.frames;
    let sizes = frames.time_s.iter().zip(&frames.bytes).map(|(&t, &size)| (t, Some(size as f64 * 1e-3))).collect();
    let frame_bytes = Chart {
        title: "Frame size over time",
        description: "Bytes of every frame that arrived".into(),
        x_label: "time, s",
        y_label: "frame, kB",
        from_zero: true,
        lines: vec![Line { name: "frame".into(), points: sizes }],
    };
    grid(&[bars("Bytes per plane <small>over all frames</small>", &description, &rows), frame_bytes.to_html()])
}

/// Percent of the samples at or below a value, from 0 to 100.
fn cumulative(samples: &[Option<f64>]) -> Vec<(f64, Option<f64>)> {
    let mut sorted: Vec<f64> = samples.iter().flatten().copied().filter(|sample| sample.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    if sorted.is_empty() {
        return Vec::new();
    }
    let at = |step: usize| {
        let fraction = step as f64 / STEPS as f64;
        let rank = (fraction * (sorted.len() - 1) as f64).round() as usize;
        (sorted[rank], Some(100.0 * (rank + 1) as f64 / sorted.len() as f64))
    };
    // From zero up to the smallest sample there is none.
    let start = [(0.0, Some(0.0)), (sorted[0].max(0.0), Some(0.0))];
    start.into_iter().filter(|_| sorted[0] > 0.0).chain((0..=STEPS).map(at)).collect()
}

fn grid(figures: &[String]) -> String {
    let figures = figures.concat();
    if figures.is_empty() { figures } else { format!("<div class=\"charts\">\n{figures}</div>\n") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distribution_rises_to_all_samples() {
        let samples: Vec<Option<f64>> = (0..1000).map(|n| (n % 7 != 0).then_some(f64::from(n % 90))).collect();
        let points = cumulative(&samples);
        assert!(points.windows(2).all(|pair| pair[0].0 <= pair[1].0 && pair[0].1 <= pair[1].1));
        assert_eq!(points.last(), Some(&(89.0, Some(100.0))));
        assert!(cumulative(&[None]).is_empty());
    }
}
