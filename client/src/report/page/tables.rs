//! The tables of the page.

use super::html::{bytes, count, escaped, figure, table};
use crate::measure::{Interval, Percentiles};
use crate::report::{Report, Spike};

/// Image error of every mode.
pub(super) fn quality(report: &Report) -> String {
    let row = |quality: &crate::report::ModeQuality| {
        let with_tail = |spread: Option<Percentiles>, tail: fn(&Percentiles) -> f64, scale: f64| match spread {
            Some(spread) => [figure(spread.p50 * scale), figure(tail(&spread) * scale)],
            None => ["–".into(), "–".into()],
        };
        let mut cells = vec![escaped(&quality.mode)];
        cells.extend(with_tail(quality.psnr_db, |spread| spread.min, 1.0));
        cells.extend(with_tail(quality.dssim, |spread| spread.p95, 1.0));
        cells.extend(with_tail(quality.flip, |spread| spread.p95, 1.0));
        cells.extend(with_tail(quality.hole_fraction, |spread| spread.p95, 100.0));
        cells.push(count(quality.compared_frames));
        cells
    };
    let specular = specular(report);
    let columns = ["Mode", "PSNR, dB", "worst", "DSSIM", "p95", "FLIP", "p95", "Holes, %", "p95", "Frames"];
    let rows: Vec<Vec<String>> = report.quality.iter().map(row).collect();
    table("Image error by mode, medians and tails", &columns, &rows) + &specular + &eyes(report)
}

fn median(spread: Option<Percentiles>, scale: f64) -> String {
    spread.map_or("–".into(), |spread| figure(spread.p50 * scale))
}

/// Over the pixels that show a specular surface; nothing where no compared picture has any.
fn specular(report: &Report) -> String {
    let rows: Vec<Vec<String>> = report
        .quality
        .iter()
        .filter_map(|quality| {
            let specular = quality.specular?;
            let metrics = [specular.psnr_db, specular.dssim, specular.flip].map(|spread| median(spread, 1.0));
            let mut cells = vec![escaped(&quality.mode)];
            cells.extend(metrics);
            cells.push(median(specular.pixel_fraction, 100.0));
            Some(cells)
        })
        .collect();
    let columns = ["Mode", "PSNR, dB", "DSSIM", "FLIP", "Pixels, %"];
    let caption = "Over the pixels of the reference that show a mirror, water or glass, medians";
    if rows.is_empty() { String::new() } else { table(caption, &columns, &rows) }
}

/// By eye, where each has its own picture.
fn eyes(report: &Report) -> String {
    let rows: Vec<Vec<String>> = report
        .quality
        .iter()
        .flat_map(|quality| {
            quality.eyes.iter().map(|(eye, of_eye)| {
                let metrics = [of_eye.psnr_db, of_eye.dssim, of_eye.flip].map(|spread| median(spread, 1.0));
                let mut cells = vec![format!("{} <small>{}</small>", escaped(&quality.mode), escaped(eye))];
                cells.extend(metrics);
                cells
            })
        })
        .collect();
    let caption = "By eye, each against its own reference, medians";
    if rows.is_empty() { String::new() } else { table(caption, &["Mode", "PSNR, dB", "DSSIM", "FLIP"], &rows) }
}

/// What each node of mode `specular` lacked.
pub(super) fn nodes(report: &Report) -> String {
    let specular = &report.specular;
    let row = |node: &crate::report::NodeReport| {
        let mut cells = vec![escaped(&node.node)];
        for spread in [node.seen, node.undefined, node.filled] {
            cells.extend([spread.p50, spread.p95].map(|fraction| figure(100.0 * fraction)));
        }
        cells
    };
    let caption =
        format!("Nodes of mode specular: solver {}, normals {}", escaped(&specular.solver), escaped(&specular.normals));
    let columns = ["Node", "Seen, % of the picture", "p95", "Not found, % of it", "p95", "Filled, % of it", "p95"];
    table(&caption, &columns, &specular.nodes.iter().map(row).collect::<Vec<_>>())
}

/// Delays end to end, the prediction that hides them, and delays per stage in the order of the pipeline.
pub(super) fn latency(report: &Report) -> String {
    const COLUMNS: [&str; 6] = ["ms", "p50", "p95", "p99", "max", "Samples"];
    let latency = &report.latency_ms;
    let whole = [("motion to photon", latency.motion_to_photon), ("frame age", latency.frame_age)];
    let whole: Vec<Vec<String>> =
        whole.into_iter().filter_map(|(name, spread)| Some(row(name.into(), spread?))).collect();

    let mut stages: Vec<(&String, &Percentiles)> = latency.stages.iter().collect();
    let place = |name: &str| Interval::STEPS.iter().position(|step| step.name() == Some(name));
    stages.sort_by_key(|(name, _)| (place(name).unwrap_or(usize::MAX), *name));
    let stage = |(name, spread): (&String, &Percentiles)| {
        let ends = match Interval::named(name) {
            Some(interval) => format!("<small>{interval}</small>"),
            None if name == "warp" => "<small>per display frame</small>".into(),
            None => String::new(),
        };
        row(format!("{} {ends}", escaped(name)), *spread)
    };
    let stages: Vec<Vec<String>> = stages.into_iter().map(stage).collect();
    format!(
        "<div class=\"tables\">\n<div>{}{}{}</div>\n<div>{}</div></div>\n",
        table("End to end", &COLUMNS, &whole),
        prediction(report),
        viewport(report),
        table("Per stage", &COLUMNS, &stages)
    )
}

/// The largest spikes in words.
pub(super) fn spikes(report: &Report) -> String {
    /// More would be a page of their own; `report.json` has them.
    const MOST: usize = 12;
    let spikes = &report.spikes;
    if spikes.listed.is_empty() {
        return String::new();
    }
    let mut largest: Vec<&Spike> = spikes.listed.iter().collect();
    largest.sort_by(|a, b| (b.ms / b.median_ms).total_cmp(&(a.ms / a.median_ms)));
    largest.truncate(MOST);
    largest.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    let items: String = largest.iter().map(|spike| format!("<li>{}</li>", escaped(&spike.in_words()))).collect();
    let (frames, refreshes) = (count(spikes.frame_age), count(spikes.motion_to_photon));
    format!(
        "<h3>Spikes</h3>\n<p>{frames} frame(s) and {refreshes} refresh(es) took more than three times the median.</p>\n\
         <ul>{items}</ul>\n"
    )
}

/// Why frames were less than was asked for.
pub(super) fn limits(report: &Report) -> String {
    let row =
        |limit: &crate::report::Limit| vec![escaped(&limit.name), figure(100.0 * limit.share), escaped(&limit.why)];
    let rows: Vec<Vec<String>> = report.limits.iter().map(row).collect();
    table("What kept frames from being what was asked for", &["Limit", "Time, %", "Why"], &rows)
}

/// What went over the link, and what the server did for it.
pub(super) fn link_and_work(report: &Report) -> String {
    format!("<div class=\"tables\">\n<div>{}</div>\n<div>{}</div></div>\n", link(report), counters(report))
}

fn link(report: &Report) -> String {
    let link = &report.link;
    let mut rows = vec![
        vec!["from the server".into(), bytes(link.down_bytes)],
        vec!["to the server".into(), bytes(link.up_bytes)],
        vec!["mean rate down".into(), format!("{} Mbit/s", figure(link.down_mbps))],
        vec!["frames sent".into(), count(link.frames_sent)],
        vec!["frames shown".into(), count(link.frames_shown)],
        vec!["replaced by a newer one before shown".into(), count(link.frames_replaced)],
        vec!["lost with the connection".into(), count(link.frames_lost)],
        vec!["replaced by a newer one before sent".into(), count(link.frames_unsent)],
        vec!["reconnections".into(), count(link.reconnects)],
    ];
    let modelled =
        [("delay", link.latency_ms, "ms"), ("jitter", link.jitter_ms, "ms"), ("rate", link.rate_mbps, "Mbit/s")];
    for (name, value, unit) in modelled {
        if let Some(value) = value {
            rows.push(vec![format!("modelled {name}"), format!("{} {unit}", figure(value))]);
        }
    }
    table("Link", &["", "Value"], &rows)
}

/// What frames show beyond the display.
fn viewport(report: &Report) -> String {
    let viewport = &report.viewport;
    let sizes = [
        ("guard band, degrees", viewport.guard_deg),
        ("pixels for each of the display", viewport.pixels_per_display_pixel),
    ];
    let rows: Vec<Vec<String>> =
        sizes.into_iter().filter_map(|(name, spread)| Some(row(name.into(), spread?))).collect();
    table("What frames show beyond the display", &["Frame", "p50", "p95", "p99", "max", "Samples"], &rows)
}

/// How well the head pose was predicted.
fn prediction(report: &Report) -> String {
    let prediction = &report.prediction;
    let errors = [
        ("when first shown, degrees", prediction.error_deg),
        ("when first shown, mm", prediction.error_mm),
        ("at the horizon, degrees", prediction.at_horizon_deg),
        ("at the horizon, mm", prediction.at_horizon_mm),
        ("at the horizon if not predicted, degrees", prediction.unpredicted_deg),
        ("at the horizon if not predicted, mm", prediction.unpredicted_mm),
    ];
    let rows: Vec<Vec<String>> =
        errors.into_iter().filter_map(|(name, spread)| Some(row(name.into(), spread?))).collect();
    let law = escaped(&prediction.law);
    let caption = format!("Head prediction error, {} ms ahead, law {law}", figure(prediction.horizon_ms));
    table(&caption, &["Error", "p50", "p95", "p99", "max", "Samples"], &rows)
}

/// Rays and other work.
fn counters(report: &Report) -> String {
    let rows: Vec<Vec<String>> =
        report.counters.iter().map(|(name, &value)| vec![escaped(name), count(value)]).collect();
    table("Work of the server", &["Counter", "Count"], &rows)
}

fn row(name: String, spread: Percentiles) -> Vec<String> {
    let Percentiles { p50, p95, p99, max, .. } = spread;
    let mut cells = vec![name];
    cells.extend([p50, p95, p99, max].map(figure));
    cells.push(count(spread.count));
    cells
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::sample;

    #[test]
    fn every_node_has_a_row() {
        let report = sample::report();
        let html = nodes(&report);
        assert_eq!(html.matches("scope=\"row\"").count(), report.specular.nodes.len());
        assert!(html.contains("solver frozen-distance, normals transmitted"));
    }

    #[test]
    fn spikes_and_limits_are_told_in_words() {
        let report = sample::report();
        assert!(spikes(&report).contains("render took 121 ms, 102 more than usual"), "{}", spikes(&report));
        assert!(limits(&report).contains("the link carries 4.10 Mbit/s"));
        let nothing = Report { spikes: Default::default(), limits: vec![], ..report };
        assert_eq!(spikes(&nothing) + &limits(&nothing), "");
    }

    #[test]
    fn stages_stand_in_the_order_of_the_pipeline() {
        let html = latency(&sample::report());
        let at = |stage: &str| html.find(&format!(">{stage} <small>")).unwrap();
        let order = ["render", "encode", "write", "send", "decode", "warp"].map(at);
        assert!(order.windows(2).all(|pair| pair[0] < pair[1]), "{order:?}");
        assert!(html.contains("RenderStart → RenderEnd"));
    }
}
