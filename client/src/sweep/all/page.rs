//! `index.html` of all sweeps: a page in the form of the report's, whole in itself.
//!
//! For each knob what it turns, a plot for each scene with the Pareto front filled and joined, what the curve says, the
//! settings on the front as a table, and all of them one click away.

use super::{Conditions, Sweeps};
use crate::report::page::effort::hard_cases;
use crate::report::page::html::{document, escaped, figure, table};
use crate::report::page::section;
use crate::sweep::write::{COLUMNS, columns_of, kilobytes, milliseconds, plot};
use crate::sweep::{Cost, KNOBS, Point, Sweep};

/// The page as HTML text.
pub(super) fn page(all: &Sweeps) -> String {
    let body = [
        header(&all.conditions),
        overview(all),
        all.sweeps.iter().map(|sweep| knob(all, sweep)).collect(),
        skipped(all),
        section("Hard cases", &[hard_cases()]),
        footer(all),
    ];
    document("Accuracy against cost · Warplight", &body.concat(), "")
}

fn header(conditions: &Conditions) -> String {
    let [width, height] = conditions.size;
    let Conditions { date, machine, version, wire_version, runs, .. } = conditions;
    let scene = conditions.scene.as_deref().unwrap_or("those of each knob");
    let trace = conditions.trace.as_deref().unwrap_or("built in");
    let thorough = if conditions.quick { "a quick sweep" } else { "a full sweep" };
    let chips = [
        format!("{width} × {height}"),
        thorough.to_owned(),
        format!("{runs} timed run(s)"),
        format!("scenes: {scene}"),
        format!("trace: {trace}"),
        format!("version {version}, wire {wire_version}"),
    ];
    let chips: String = chips.iter().map(|chip| format!("<li>{}</li>", escaped(chip))).collect();
    format!(
        "<header>\n<p class=\"brand\">Warplight sweep</p>\n<h1>Accuracy against cost</h1>\n\
         <p class=\"lead\">Measured on <b>{}</b>, {}</p>\n\
         <ul class=\"chips\" aria-label=\"Conditions\">{chips}</ul>\n</header>\n",
        escaped(date),
        escaped(&machine.to_string()),
    )
}

/// Each knob in one line.
fn overview(all: &Sweeps) -> String {
    let row = |sweep: &Sweep| {
        let name = escaped(&sweep.knob);
        let secs = all.seconds.get(&sweep.knob).copied().unwrap_or(0.0);
        vec![
            format!("<a href=\"#{name}\">{name}</a> <small>{}</small>", escaped(about(sweep))),
            escaped(&sweep.metric),
            bought_with(sweep.cost).to_owned(),
            sweep.points.len().to_string(),
            figure(secs),
        ]
    };
    let rows: Vec<Vec<String>> = all.sweeps.iter().map(row).collect();
    let columns = ["Knob", "Error", "Bought with", "Points", "Measured in, s"];
    section("Knobs", &[table("Knobs and what they turn", &columns, &rows)])
}

fn about(sweep: &Sweep) -> &'static str {
    KNOBS.iter().find(|knob| knob.name == sweep.knob).map_or("", |knob| knob.about)
}

fn bought_with(cost: Cost) -> &'static str {
    match cost {
        Cost::Time => "time",
        Cost::Bytes => "bytes",
        Cost::Both => "bytes and time",
        Cost::None => "a circumstance",
    }
}

fn knob(all: &Sweeps, sweep: &Sweep) -> String {
    let charts: String =
        sweep.by_scene().map(|points| plot(sweep, points).to_html(&escaped(&points[0].scene))).collect();
    let says: String = sweep.resume.split("; ").map(|line| format!("<li>{}</li>", escaped(line))).collect();
    let on_front: Vec<&Point> = sweep.points.iter().filter(|point| point.pareto).collect();
    let front = match sweep.cost {
        Cost::None => String::new(),
        cost => {
            let caption = format!("No other setting is better in error or {} without being worse", bought_with(cost));
            points(&caption, sweep, &on_front)
        }
    };
    let every: Vec<&Point> = sweep.points.iter().collect();
    let settings = points("All settings", sweep, &every);
    let settings = match sweep.cost {
        Cost::None => settings,
        _ => format!("<details>\n<summary>All {} settings</summary>\n{settings}</details>\n", every.len()),
    };
    let name = escaped(&sweep.knob);
    format!(
        "<section id=\"{name}\">\n<h2>{name} <small>{}</small></h2>\n<ul class=\"says\">{says}</ul>\n\
         <div class=\"charts\">\n{charts}</div>\n{front}{settings}\
         <p class=\"hint\"><code>{}</code></p>\n</section>\n",
        escaped(about(sweep)),
        escaped(&all.conditions.command(&sweep.knob)),
    )
}

/// Points as a table: what was set, the error, and all that every point has beside it.
fn points(caption: &str, sweep: &Sweep, points: &[&Point]) -> String {
    let more = columns_of(sweep);
    let error = format!("Error, {}", escaped(&sweep.metric));
    let mut columns = vec!["Setting", "Scene", error.as_str()];
    columns.extend(more.iter().map(|column| COLUMNS[*column].1));
    columns.extend(["Time, ms", "spread", "kB"]);
    let row = |point: &&Point| {
        let mut cells = vec![
            escaped(&point.value),
            escaped(&point.scene),
            if point.error == 0.0 { "0".into() } else { small(point.error) },
        ];
        cells.extend(more.iter().map(|&column| {
            let (name, _, _, factor) = COLUMNS[column];
            figure(point.more.get(name).copied().unwrap_or(0.0) * factor)
        }));
        cells.extend([milliseconds(point.time_ms), milliseconds(point.time_spread_ms), kilobytes(point.bytes)]);
        cells
    };
    let rows: Vec<Vec<String>> = points.iter().map(row).collect();
    table(caption, &columns, &rows)
}

/// An error, which may be smaller than what other figures are read to.
fn small(error: f64) -> String {
    if error.abs() < 0.01 { format!("{error:.2e}") } else { figure(error) }
}

fn skipped(all: &Sweeps) -> String {
    let rows: Vec<Vec<String>> = all.skipped.iter().map(|(knob, why)| vec![escaped(knob), escaped(why)]).collect();
    section("Not measured", &[table("Knobs that cannot be turned on this scene", &["Knob", "Why"], &rows)])
}

fn footer(all: &Sweeps) -> String {
    let total: f64 = all.seconds.values().sum();
    format!(
        "<footer>\n<p>Filled and joined: the Pareto front. Errors and bytes are the same in every run, times are not; \
         within one sweep settings take turns where they can, so ratios hold better than figures. All of it took {} s. \
         The numbers behind this page are in <code>accuracy.json</code>, those of one knob in \
         <code>sweep-KNOB.json</code>.</p>\n</footer>\n",
        figure(total)
    )
}
