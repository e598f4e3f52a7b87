//! Line charts and bars as inline SVG, drawn by plotters and adapted to the page.
//!
//! Plotters writes a fixed size, a namespace and fixed colours. On a page the size comes from the column,
//! the namespace is known, and ink has to follow the reader's light or dark setting: it is drawn in a
//! sentinel colour that becomes `currentColor`. Series have one colour for both settings, each with a
//! contrast of at least 3:1 against either background (WCAG 2.1, 1.4.11).

use super::html::escaped;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Size of a chart in its own units; small, so that its text is still readable on a phone.
const WIDTH: u32 = 560;
const HEIGHT: u32 = 300;
/// Size of the text in the same units; plotters divides by 1.24.
pub(super) const TEXT: f64 = 17.0;
/// Stands for the colour of the text; nothing else is drawn in it.
pub(super) const INK: RGBColor = RGBColor(1, 2, 3);
/// Most points of a line: two per unit of width would not be seen.
const MAX_POINTS: usize = 600;
/// Height of a bar with its gap, in chart units.
const BAR_PITCH: u32 = 30;

/// Colours of series.
pub(super) const COLOURS: [RGBColor; 8] = [
    RGBColor(42, 125, 210),
    RGBColor(217, 104, 28),
    RGBColor(22, 145, 103),
    RGBColor(150, 105, 215),
    RGBColor(214, 75, 122),
    RGBColor(140, 124, 30),
    RGBColor(24, 143, 160),
    RGBColor(120, 128, 137),
];

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// One line of a chart; a point without a value is a gap.
pub(super) struct Line {
    pub(super) name: String,
    pub(super) points: Vec<(f64, Option<f64>)>,
}

/// A line chart.
pub(super) struct Chart<'a> {
    /// Heading, HTML-safe.
    pub(super) title: &'a str,
    /// What the chart shows, for those who cannot see it.
    pub(super) description: String,
    /// Name and unit of the horizontal axis.
    pub(super) x_label: &'a str,
    /// Name and unit of the vertical axis.
    pub(super) y_label: &'a str,
    /// Whether the vertical axis starts at zero.
    pub(super) from_zero: bool,
    pub(super) lines: Vec<Line>,
}

impl Chart<'_> {
    /// The chart as a figure with its legend; nothing where there is nothing to draw.
    pub(super) fn to_html(&self) -> String {
        let known = || self.lines.iter().flat_map(|line| &line.points).filter_map(|&(x, y)| Some((x, y?)));
        let Some((xs, ys)) = ranges(known(), self.from_zero) else { return String::new() };
        let mut svg = String::new();
        if self.draw(&mut svg, xs, ys).is_err() {
            // Drawing into a string has no way to fail but a range that is empty.
            return String::new();
        }
        let svg = adapted(&svg, &self.description);
        let entry = |(index, line): (usize, &Line)| {
            let RGBColor(r, g, b) = colour(index);
            let name = escaped(&line.name);
            format!("<li><i style=\"background:rgb({r},{g},{b})\"></i>{name}</li>")
        };
        let legend: String = match self.lines.len() {
            0 | 1 => String::new(),
            _ => self.lines.iter().enumerate().map(entry).collect(),
        };
        let title = self.title;
        format!("<figure class=\"chart\"><figcaption>{title}<ul class=\"legend\">{legend}</ul></figcaption>\n{svg}</figure>\n")
            .replace("<ul class=\"legend\"></ul>", "")
    }

    fn draw(&self, svg: &mut String, xs: (f64, f64), ys: (f64, f64)) -> Result<(), Box<dyn std::error::Error>> {
        let area: Area<'_> = SVGBackend::with_string(svg, (WIDTH, HEIGHT)).into_drawing_area();
        let mut chart = ChartBuilder::on(&area)
            .margin_top(8)
            .margin_right(14)
            .x_label_area_size(47)
            .y_label_area_size(68)
            .build_cartesian_2d(xs.0..xs.1, ys.0..ys.1)?;
        let text = ("sans-serif", TEXT, &INK);
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(7)
            .y_labels(5)
            .axis_style(INK.mix(0.35))
            .bold_line_style(INK.mix(0.13))
            .light_line_style(TRANSPARENT)
            .label_style(text)
            .axis_desc_style(text)
            .x_desc(self.x_label)
            .y_desc(self.y_label)
            .x_label_formatter(&|value| tick(*value, xs.1 - xs.0))
            .y_label_formatter(&|value| tick(*value, ys.1 - ys.0))
            .draw()?;
        for (index, line) in self.lines.iter().enumerate() {
            for part in line.points.split(|(_, y)| y.is_none()) {
                let known: Vec<(f64, f64)> = part.iter().filter_map(|&(x, y)| Some((x, y?))).collect();
                // A line that fills its column becomes a band; drawn thin, its edge is still a line.
                let style = colour(index).stroke_width(if known.len() > MAX_POINTS / 2 { 1 } else { 2 });
                chart.draw_series(LineSeries::new(thinned(&known), style))?;
            }
        }
        area.present()?;
        Ok(())
    }
}

/// Horizontal bars, longest first as they are given: name, value, and the value as text.
pub(super) fn bars(title: &str, description: &str, rows: &[(String, f64, String)]) -> String {
    let largest = rows.iter().map(|row| row.1).fold(0.0, f64::max);
    if largest <= 0.0 {
        return String::new();
    }
    let mut svg = String::new();
    if draw_bars(&mut svg, rows, largest).is_err() {
        return String::new();
    }
    let svg = adapted(&svg, description);
    format!("<figure class=\"chart\"><figcaption>{title}</figcaption>\n{svg}</figure>\n")
}

fn draw_bars(svg: &mut String, rows: &[(String, f64, String)], largest: f64) -> Result<(), Box<dyn std::error::Error>> {
    /// Room for the names on the left and the values on the right.
    const NAMES: i32 = 164;
    const VALUES: i32 = 146;
    let height = (rows.len() as u32 * BAR_PITCH).max(HEIGHT.min(4 * BAR_PITCH));
    let area: Area<'_> = SVGBackend::with_string(svg, (WIDTH, height)).into_drawing_area();
    let text = TextStyle::from(("sans-serif", TEXT).into_font()).color(&INK);
    for (index, (name, value, value_text)) in rows.iter().enumerate() {
        let top = index as i32 * BAR_PITCH as i32;
        let middle = top + BAR_PITCH as i32 / 2;
        let length = (value / largest * f64::from(WIDTH as i32 - NAMES - VALUES)).max(1.0) as i32;
        let name: String = name.chars().take(24).collect();
        area.draw(&Text::new(name, (NAMES - 10, middle), text.clone().pos(Pos::new(HPos::Right, VPos::Center))))?;
        area.draw(&Rectangle::new([(NAMES, top + 5), (NAMES + length, top + 25)], COLOURS[0].filled()))?;
        let at = (NAMES + length + 8, middle);
        area.draw(&Text::new(value_text.as_str(), at, text.clone().pos(Pos::new(HPos::Left, VPos::Center))))?;
    }
    area.present()?;
    Ok(())
}

fn colour(index: usize) -> RGBColor {
    COLOURS[index % COLOURS.len()]
}

/// Ranges of both axes with a little room above and below; `None` without points.
fn ranges(points: impl Iterator<Item = (f64, f64)>, from_zero: bool) -> Option<((f64, f64), (f64, f64))> {
    let mut bounds: Option<[f64; 4]> = None;
    for (x, y) in points.filter(|(x, y)| x.is_finite() && y.is_finite()) {
        let [x0, x1, y0, y1] = bounds.unwrap_or([x, x, y, y]);
        bounds = Some([x0.min(x), x1.max(x), y0.min(y), y1.max(y)]);
    }
    let [x0, x1, mut y0, y1] = bounds?;
    let room = ((y1 - y0) * 0.06).max(y1.abs() * 1e-3).max(1e-6);
    y0 = if from_zero { y0.min(0.0) } else { y0 - room };
    Some(((x0, x1.max(x0 + 1e-3)), (y0, y1 + room)))
}

/// At most [`MAX_POINTS`] points: per bucket the largest and the smallest, so that no spike is lost.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= MAX_POINTS {
        return points.to_vec();
    }
    let mut kept = Vec::with_capacity(MAX_POINTS);
    for bucket in points.chunks(points.len().div_ceil(MAX_POINTS / 2)) {
        let by_height = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let mut ends = [bucket.iter().min_by(by_height), bucket.iter().max_by(by_height)];
        ends.sort_by(|a, b| a.map_or(0.0, |a| a.0).total_cmp(&b.map_or(0.0, |b| b.0)));
        kept.extend(ends.into_iter().flatten().copied());
    }
    kept
}

/// An axis label with as many decimals as the range wants.
fn tick(value: f64, range: f64) -> String {
    let decimals = if range > 6.0 {
        0
    } else if range > 0.6 {
        1
    } else if range > 0.06 {
        2
    } else {
        3
    };
    let text = format!("{value:.decimals$}");
    if text.trim_start_matches(['-', '0', '.']).is_empty() { "0".into() } else { text }
}

/// What plotters wrote, fit for the page: scalable, in the page's ink and font, described.
pub(super) fn adapted(svg: &str, description: &str) -> String {
    let body = svg.split_once('>').map_or("", |(_, body)| body);
    let opening = svg.split_once('>').map_or("", |(opening, _)| opening);
    let view_box = opening.split_once("viewBox=\"").and_then(|(_, rest)| rest.split_once('"')).map_or("", |(b, _)| b);
    let description = escaped(description);
    let body = body.replace("#010203", "currentColor").replace(" font-family=\"sans-serif\"", "");
    format!("<svg viewBox=\"{view_box}\" role=\"img\" aria-label=\"{description}\">{body}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// WCAG 2.1 relative luminance.
    fn luminance(RGBColor(r, g, b): RGBColor) -> f64 {
        let linear = |code| f64::from(warplight_protocol::tone::linear_from_srgb8(code));
        0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b)
    }

    #[test]
    fn series_stand_out_by_day_and_by_night() {
        let (light, dark) = (luminance(RGBColor(255, 255, 255)), luminance(RGBColor(28, 31, 36)));
        for colour in COLOURS {
            let l = luminance(colour);
            assert!((light + 0.05) / (l + 0.05) >= 3.0, "{colour:?} on light");
            assert!((l + 0.05) / (dark + 0.05) >= 3.0, "{colour:?} on dark");
        }
    }

    #[test]
    fn a_chart_scales_and_takes_the_ink_of_the_page() {
        let chart = Chart {
            title: "T",
            description: "a \"line\"".into(),
            x_label: "x",
            y_label: "y",
            from_zero: true,
            lines: vec![Line { name: "n".into(), points: vec![(0.0, Some(1.0)), (1.0, None), (2.0, Some(5.0))] }],
        };
        let html = chart.to_html();
        assert!(html.contains("<svg viewBox=\"0 0 560 300\" role=\"img\" aria-label=\"a &quot;line&quot;\">"));
        assert!(html.contains("currentColor") && !html.contains("#010203") && !html.contains("xmlns"));
    }

    #[test]
    fn nothing_to_draw_is_nothing() {
        let line = |y| Line { name: "n".into(), points: vec![(0.0, y)] };
        for lines in [vec![], vec![line(None)], vec![line(Some(f64::NAN))]] {
            let description = String::new();
            let chart = Chart { title: "T", description, x_label: "x", y_label: "y", from_zero: false, lines };
            assert_eq!(chart.to_html(), "");
        }
        assert_eq!(bars("T", "d", &[]), "");
    }

    #[test]
    fn thinning_keeps_the_spike() {
        let mut points: Vec<(f64, f64)> = (0..10_000).map(|n| (f64::from(n), 1.0)).collect();
        points[4321].1 = 99.0;
        let few = thinned(&points);
        assert!(few.len() <= MAX_POINTS && few.contains(&(4321.0, 99.0)));
        assert!(few.windows(2).all(|pair| pair[0].0 <= pair[1].0));
    }
}
