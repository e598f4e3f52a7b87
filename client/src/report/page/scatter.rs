//! Points over two logarithmic axes as an SVG file of its own: what is bought for what.
//!
//! Drawn by plotters like the charts of the page, and adapted the same way, but with a namespace, and with ink and
//! paper of its own, for it is opened alone. What is on the Pareto front is filled and joined by a line.

use super::chart::{Area, COLOURS, INK, TEXT, adapted};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

const WIDTH: u32 = 720;
const HEIGHT: u32 = 440;
/// Part of the horizontal range that is left free on the right, for names.
const ROOM: f64 = 0.3;
/// Errors below are drawn here: a logarithm needs a number.
const LEAST: f64 = 1e-6;

/// A point.
pub(crate) struct Dot {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) name: String,
    pub(crate) is_on_front: bool,
}

/// A plot of points.
pub(crate) struct Scatter<'a> {
    /// What it shows, for those who cannot see it.
    pub(crate) description: String,
    pub(crate) x_label: &'a str,
    pub(crate) y_label: String,
    pub(crate) dots: Vec<Dot>,
}

impl Scatter<'_> {
    /// A whole SVG document; without points, an empty one.
    pub(crate) fn to_svg(&self) -> String {
        let mut svg = String::new();
        if self.dots.is_empty() || self.draw(&mut svg).is_err() {
            svg = format!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\">\n</svg>\n");
        }
        let paper = "<svg xmlns=\"http://www.w3.org/2000/svg\" style=\"color:#1c1f24;background:#fff\" \
                     font-family=\"sans-serif\" ";
        adapted(&svg, &self.description).replacen("<svg ", paper, 1)
    }

    /// The plot as a figure of a page, in the page's ink; nothing without points. The title is HTML already.
    pub(crate) fn to_html(&self, title: &str) -> String {
        let mut svg = String::new();
        if self.dots.is_empty() || self.draw(&mut svg).is_err() {
            return String::new();
        }
        let svg = adapted(&svg, &self.description);
        format!("<figure class=\"chart\"><figcaption>{title}</figcaption>\n{svg}</figure>\n")
    }

    fn draw(&self, svg: &mut String) -> Result<(), Box<dyn std::error::Error>> {
        let area: Area<'_> = SVGBackend::with_string(svg, (WIDTH, HEIGHT)).into_drawing_area();
        let at = |dot: &Dot| (dot.x.max(LEAST), dot.y.max(LEAST));
        let range = |values: &mut dyn Iterator<Item = f64>, above: f64| {
            let (least, most) = values.fold((f64::MAX, LEAST), |(least, most), v| (v.min(least), v.max(most)));
            // At least half a decade, so that equal values are not drawn as different.
            let (least, most) = (least * 0.8, (most * 1.25).max(least * 3.2));
            least..most * (most / least).powf(above)
        };
        let xs = range(&mut self.dots.iter().map(|dot| at(dot).0), ROOM);
        let ys = range(&mut self.dots.iter().map(|dot| at(dot).1), 0.0);
        let mut chart = ChartBuilder::on(&area)
            .margin_top(12)
            .margin_right(14)
            .x_label_area_size(47)
            .y_label_area_size(84)
            .build_cartesian_2d(xs.log_scale(), ys.log_scale())?;
        let text = ("sans-serif", TEXT, &INK);
        chart
            .configure_mesh()
            .axis_style(INK.mix(0.35))
            .bold_line_style(INK.mix(0.13))
            .light_line_style(TRANSPARENT)
            .label_style(text)
            .axis_desc_style(text)
            .x_desc(self.x_label)
            .y_desc(self.y_label.as_str())
            .x_label_formatter(&|value| short(*value))
            .y_label_formatter(&|value| short(*value))
            .draw()?;
        let mut front: Vec<(f64, f64)> = self.dots.iter().filter(|dot| dot.is_on_front).map(at).collect();
        front.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        // What is on it for a third reason is filled, but no step down.
        let mut least = f64::INFINITY;
        front.retain(|&(_, y)| {
            let is_step = y < least;
            least = least.min(y);
            is_step
        });
        chart.draw_series(LineSeries::new(front, COLOURS[0].stroke_width(2)))?;
        for dot in &self.dots {
            let style = if dot.is_on_front { COLOURS[0].filled() } else { COLOURS[7].stroke_width(2) };
            chart.draw_series([Circle::new(at(dot), 5, style)])?;
            let (x, y) = chart.backend_coord(&at(dot));
            let style = TextStyle::from(("sans-serif", TEXT * 0.8).into_font()).color(&INK);
            let style = style.pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(dot.name.clone(), (x + 10, y - 8), style))?;
        }
        area.present()?;
        Ok(())
    }
}

/// A number of an axis without zeros that say nothing.
fn short(value: f64) -> String {
    let decimals = (2.0 - value.log10().floor()).clamp(0.0, 8.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_is_a_document_of_its_own_with_the_names_of_its_points() {
        let dot = |x, y, name: &str| Dot { x, y, name: name.into(), is_on_front: x < 2.0 };
        let dots = vec![dot(1.0, 0.5, "a < b"), dot(3.0, 0.0, "second"), dot(1.0, 0.5, "same")];
        let scatter = Scatter { description: "d".into(), x_label: "x", y_label: "y".into(), dots };
        let svg = scatter.to_svg();
        assert!(svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\""), "{svg}");
        assert!(svg.contains("second") && svg.contains("a &lt; b") && svg.trim_end().ends_with("</svg>"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        let html = scatter.to_html("On a page");
        assert!(html.contains("currentColor") && !html.contains("xmlns") && html.contains("On a page"), "{html}");
        assert!(Scatter { dots: Vec::new(), ..scatter }.to_svg().contains("xmlns"));
        assert_eq!([0.0012, 10.0, 1500.0, 0.5].map(short), ["0.0012", "10", "1500", "0.5"]);
    }
}
