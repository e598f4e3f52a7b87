//! The few lines a terminal shows at the end of a replay.

use super::Report;
use crate::measure::Percentiles;
use std::fmt::Write as _;
use std::path::Path;

/// A short, aligned summary that ends with the path of the page.
pub fn summary(report: &Report, page_path: &Path) -> String {
    let mut text = String::new();
    let [width, height] = report.size;
    let (scene, trace, clock, hz) = (&report.scene, &report.trace, report.clock, report.display.hz);
    let _ = writeln!(text, "{scene}, trace {trace}, {width}x{height} at {hz:.0} Hz, {clock} clock\n");

    let mut row = |name: &str, value: String| {
        let _ = writeln!(text, "  {name:<17} {value}");
    };
    row("motion to photon", spread_ms(report.latency_ms.motion_to_photon));
    row("frame age", spread_ms(report.latency_ms.frame_age));
    let link = &report.link;
    let (shown, sent, mbps) = (link.frames_shown, link.frames_sent, link.down_mbps);
    row("link", format!("{mbps:.1} Mbit/s down, {shown} of {sent} frames shown"));
    for limit in &report.limits {
        row("limited by", format!("{} for {:.0} % of the time: {}", limit.name, 100.0 * limit.share, limit.why));
    }
    if let Some(budget) = &report.budget {
        row("budget", budget.in_words());
    }
    let (age, motion) = (report.spikes.frame_age, report.spikes.motion_to_photon);
    if age + motion > 0 {
        row("spikes", format!("{age} of frame age, {motion} of motion to photon: see the page"));
    }
    row("missed refreshes", format!("{} of {}", report.display.missed, report.display.frames));
    let has_specular = report.quality.iter().any(|quality| quality.specular.is_some());
    if !report.quality.is_empty() {
        let behind = if has_specular { "   specular pixels: PSNR dB   DSSIM    FLIP" } else { "" };
        row("\n  quality (median)", format!("PSNR dB   DSSIM    FLIP   holes{behind}"));
    }
    for quality in &report.quality {
        let median = |spread: Option<Percentiles>, scale: f64, digits: usize| {
            spread.map_or("-".into(), |spread| format!("{:.digits$}", spread.p50 * scale))
        };
        let specular = quality.specular.map_or(String::new(), |specular| {
            let (psnr, dssim) = (median(specular.psnr_db, 1.0, 2), median(specular.dssim, 1.0, 4));
            format!("{psnr:>26} {dssim:>7} {:>7}", median(specular.flip, 1.0, 4))
        });
        let (psnr, dssim) = (median(quality.psnr_db, 1.0, 2), median(quality.dssim, 1.0, 4));
        let (flip, holes) = (median(quality.flip, 1.0, 4), median(quality.hole_fraction, 100.0, 1));
        row(&quality.mode, format!("{psnr:>7} {dssim:>7} {flip:>7} {holes:>5} %{specular}"));
    }
    for warning in &report.warnings {
        let _ = writeln!(text, "\n  warning: {warning}");
    }
    let _ = write!(text, "\n{}", page_path.display());
    text
}

fn spread_ms(spread: Option<Percentiles>) -> String {
    let Some(Percentiles { p50, p95, p99, max, .. }) = spread else { return "not measured".into() };
    format!("p50 {p50:6.2}   p95 {p95:6.2}   p99 {p99:6.2}   max {max:6.2} ms")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::sample;

    #[test]
    fn the_summary_is_short_and_ends_with_the_page() {
        let text = summary(&sample::report(), Path::new("out/index.html"));
        eprintln!("{text}");
        assert!(text.ends_with("\nout/index.html"));
        assert!(text.lines().count() < 25);
        assert!(text.lines().all(|line| line.chars().count() <= 110), "{text}");
        assert!(text.contains("motion to photon  p50"));
    }

    #[test]
    fn what_was_not_measured_is_said() {
        let mut report = sample::report();
        report.latency_ms.frame_age = None;
        report.quality[0].flip = None;
        let text = summary(&report, Path::new("p"));
        assert!(text.contains("frame age         not measured") && !text.contains("NaN"), "{text}");
    }
}
