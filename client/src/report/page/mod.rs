//! `index.html`: one file that holds everything and asks the network for nothing.
//!
//! Plots are inline SVG whose ink is the colour of the text, pictures are data URIs, the style follows the
//! reader's light or dark setting, and the few lines of script only add a comparison by click: the page is
//! whole without them. All text that comes from outside is escaped.

mod chart;
pub(crate) mod effort;
pub(crate) mod html;
mod pictures;
mod plots;
pub(crate) mod scatter;
mod tables;

use super::{Report, write_whole};
use crate::measure::ImageError;
use html::{document, escaped, figure};
use image::RgbImage;
use std::io;
use std::path::Path;

/// What a page is made of.
#[derive(Clone, Copy, Debug)]
pub struct PageInput<'a> {
    /// The measurements.
    pub report: &'a Report,
    /// Pictures of a few moments of the trace.
    pub pictures: &'a [PictureSet],
}

/// The same moment in every mode.
#[derive(Clone, Debug)]
pub struct PictureSet {
    /// What the moment shows.
    pub title: String,
    /// Seconds since the first pose of the trace.
    pub time_s: f64,
    /// The server's converged rendering of the display pose.
    pub reference: RgbImage,
    /// Per mode: its name, what was displayed, the coloured error map, and the error.
    pub modes: Vec<(String, RgbImage, RgbImage, ImageError)>,
}

/// Writes the page, whole or not at all.
///
/// # Errors
/// A picture that cannot be encoded, or what the operating system says.
pub fn write_page(path: &Path, input: PageInput<'_>) -> io::Result<()> {
    write_whole(path, page(input)?.as_bytes())
}

/// The page as HTML text.
///
/// # Errors
/// A picture that cannot be encoded.
pub fn page(input: PageInput<'_>) -> io::Result<String> {
    let report = input.report;
    let title = format!("{} · Warplight", report.scene);
    let sections = [
        header(report),
        cards(report),
        warnings(report),
        pictures::section(input.pictures)?,
        section("Image quality", &[plots::quality(report), tables::quality(report), tables::nodes(report)]),
        section("Latency and prediction", &[plots::latency(report), tables::spikes(report), tables::latency(report)]),
        section(
            "Bandwidth and work",
            &[plots::bandwidth(report), tables::limits(report), tables::link_and_work(report)],
        ),
        section("Accuracy and effort", &[effort::budget(report), effort::effects(report), effort::hard_cases()]),
        footer(report),
    ];
    Ok(document(&title, &sections.concat(), include_str!("compare.js")))
}

fn header(report: &Report) -> String {
    let [width, height] = report.size;
    let (hz, clock, seed) = (report.display.hz, report.clock, report.seed);
    let effects: String = report.effects.iter().map(|effect| format!("<li>{}</li>", escaped(effect))).collect();
    format!(
        "<header>\n<p class=\"brand\">Warplight replay</p>\n<h1>{}</h1>\n\
         <p class=\"lead\">Head trace <b>{}</b>, {width} × {height} at {hz:.0} Hz, {clock} clock, seed {seed}</p>\n\
         <ul class=\"chips\" aria-label=\"Effects the scene calls for\">{effects}</ul>\n</header>\n",
        escaped(&report.scene),
        escaped(&report.trace),
    )
}

/// The few numbers that matter.
fn cards(report: &Report) -> String {
    let card = |name: &str, value: String, unit: &str, detail: String| {
        format!(
            "<div class=\"card\"><dt>{name}</dt><dd><span class=\"value\">{value}</span> {unit}\
             <small>{detail}</small></dd></div>\n"
        )
    };
    let mut cards = Vec::new();
    for (name, spread) in
        [("Motion to photon", report.latency_ms.motion_to_photon), ("Frame age", report.latency_ms.frame_age)]
    {
        cards.push(match spread {
            Some(spread) => {
                let tail = format!("median; p95 {}, p99 {}", figure(spread.p95), figure(spread.p99));
                card(name, figure(spread.p50), "ms", tail)
            }
            None => card(name, "–".into(), "", "not measured".into()),
        });
    }
    let link = &report.link;
    let frames = format!("{} frames shown, {} replaced", link.frames_shown, link.frames_replaced);
    cards.push(card("Bandwidth", figure(link.down_mbps), "Mbit/s", frames));
    let percent = 100.0 * report.display.missed as f64 / report.display.frames.max(1) as f64;
    let of = format!("{} of {} refreshes", report.display.missed, report.display.frames);
    cards.push(card("Missed", figure(percent), "%", of));
    let by_flip = |quality: &&super::ModeQuality| quality.flip.map(|flip| flip.p50);
    let best = report
        .quality
        .iter()
        .filter(|quality| quality.flip.is_some())
        .min_by(|a, b| by_flip(a).unwrap_or(f64::MAX).total_cmp(&by_flip(b).unwrap_or(f64::MAX)));
    if let Some((best, flip)) = best.and_then(|best| Some((best, best.flip?))) {
        let psnr = best.psnr_db.map_or(String::new(), |psnr| format!(", PSNR {} dB", figure(psnr.p50)));
        let detail = format!("median of <b>{}</b>, the best mode{psnr}", escaped(&best.mode));
        cards.push(card("Image error", figure(flip.p50), "FLIP", detail));
    }
    format!("<dl class=\"cards\">\n{}</dl>\n", cards.concat())
}

fn warnings(report: &Report) -> String {
    if report.warnings.is_empty() {
        return String::new();
    }
    let items: String = report.warnings.iter().map(|warning| format!("<li>{}</li>", escaped(warning))).collect();
    format!("<section class=\"warnings\">\n<h2>Reasons to doubt this report</h2>\n<ul>{items}</ul>\n</section>\n")
}

/// A section of the parts that are not empty; nothing where all are.
pub(crate) fn section(title: &str, parts: &[String]) -> String {
    let parts = parts.concat();
    if parts.is_empty() { parts } else { format!("<section>\n<h2>{title}</h2>\n{parts}</section>\n") }
}

fn footer(report: &Report) -> String {
    let reference = report.reference.as_ref().map_or(String::new(), |reference| {
        let noise = reference
            .noise_psnr_db
            .map_or(String::new(), |noise_db| format!("; its own noise is {} dB", figure(noise_db)));
        format!(" The reference has {} samples per pixel{noise}.", reference.spp)
    });
    let optics = report.optics.map_or(String::new(), |optics| format!(" {}", optics.in_words()));
    format!(
        "<footer>\n<p>Quality compares what was displayed with the server’s converged rendering of the same display \
         pose, as 8-bit sRGB. PSNR: higher is better. DSSIM is (1 − SSIM) / 2 on luminance (Wang et al. 2004), FLIP \
         the mean noticed difference at 67 pixels per degree (Andersson et al. 2020): lower is better.{reference}{optics}\
         </p>\n\
         <p>Frame age runs from the head pose a frame was rendered for to its presentation; motion to photon from \
         the head pose an image was warped to. The numbers behind this page are in <code>report.json</code>.</p>\n\
         </footer>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::html::check_nesting;
    use super::*;
    use crate::report::sample;

    fn sample_page() -> String {
        page(PageInput { report: &sample::report(), pictures: &sample::pictures() }).unwrap()
    }

    /// Set WARPLIGHT_KEEP_PAGE to a file name to look at the page.
    #[test]
    fn the_page_stands_alone() {
        let html = sample_page();
        if let Some(path) = std::env::var_os("WARPLIGHT_KEEP_PAGE") {
            std::fs::write(path, &html).unwrap();
        }
        for outside in ["http:", "https:", "//cdn", "@import", "url(", "<link", "<iframe", "<object", "fetch("] {
            assert!(!html.contains(outside), "{outside}");
        }
        for attribute in ["src=\"", "href=\""] {
            for (at, _) in html.match_indices(attribute) {
                let value = &html[at + attribute.len()..][..10];
                assert!(value.starts_with("data:image") || value.starts_with('#'), "{attribute}{value}");
            }
        }
    }

    #[test]
    fn every_tag_is_closed_and_every_picture_described() {
        let html = sample_page();
        check_nesting(&html);
        assert_eq!(html.matches("<img ").count(), html.matches(" alt=\"").count());
        assert_eq!(html.matches("<svg ").count(), html.matches("role=\"img\" aria-label=\"").count());
        assert!(html.matches("<svg ").count() >= 5 && html.matches("<img ").count() == 26);
    }

    #[test]
    fn text_from_outside_cannot_become_markup() {
        let mut report = sample::report();
        let hostile = "<script>alert(\"x\")</script>&'";
        report.scene = hostile.into();
        report.trace = hostile.into();
        report.effects = vec![hostile.into()];
        report.warnings = vec![hostile.into()];
        report.limits[0].why = hostile.into();
        report.spikes.listed[0].interval = hostile.into();
        report.counters.insert(hostile.into(), 1);
        report.link.planes.insert(hostile.into(), 99_999_999);
        report.latency_ms.stages.insert(hostile.into(), report.latency_ms.stages["render"]);
        report.quality[0].mode = hostile.into();
        let series = report.series.quality["none"].clone();
        report.series.quality.insert(hostile.into(), series);
        let mut pictures = sample::pictures();
        pictures[0].title = hostile.into();
        pictures[0].modes[0].0 = hostile.into();
        let html = page(PageInput { report: &report, pictures: &pictures }).unwrap();
        assert!(!html.contains("<script>alert") && !html.contains("alert(\"x\")"));
        check_nesting(&html);
    }

    #[test]
    fn equal_input_gives_equal_bytes() {
        assert_eq!(sample_page(), sample_page());
    }

    /// A replay in which nothing came through still has a page.
    #[test]
    fn an_empty_report_has_a_page() {
        let mut report = sample::report();
        report.latency_ms.motion_to_photon = None;
        report.latency_ms.frame_age = None;
        report.latency_ms.stages.clear();
        report.prediction.error_deg = None;
        report.prediction.error_mm = None;
        report.spikes = crate::report::Spikes::default();
        report.limits.clear();
        report.quality.clear();
        report.counters.clear();
        report.link = crate::report::Link::default();
        report.series = crate::report::Series::default();
        report.display.frames = 0;
        let html = page(PageInput { report: &report, pictures: &[] }).unwrap();
        check_nesting(&html);
        assert!(!html.contains("NaN") && !html.contains(">inf"));
    }
}
