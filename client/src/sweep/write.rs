//! A sweep as people and programs read it: a table, a JSON document, and a plot for each scene.

use super::pareto::digits;
use super::{Cost, Point, Sweep};
use crate::report::page::scatter::{Dot, Scatter};
use crate::report::{rounded_json, write_whole};
use std::io;
use std::path::{Path, PathBuf};

/// Columns of measurements that have one, by their names: heading, decimals, factor.
pub(super) const COLUMNS: &[(&str, &str, usize, f64)] = &[
    ("p95_deg", "p95 deg", 4, 1.0),
    ("mean_mm", "mm", 4, 1.0),
    ("p95_mm", "p95 mm", 4, 1.0),
    ("mean_deg", "deg", 6, 1.0),
    ("worst_px", "worst px", 4, 1.0),
    ("unpredicted_deg", "unpredicted", 4, 1.0),
    ("flip_whole", "whole picture", 4, 1.0),
    ("filled", "filled %", 2, 100.0),
    ("above_a_degree", "> 1 deg %", 2, 100.0),
    ("undefined", "undef. %", 2, 100.0),
    ("prepare_ms", "prepare ms", 2, 1.0),
    ("warp_ms", "warp ms", 2, 1.0),
    ("least_ms", "least ms", 2, 1.0),
    ("flip_reference", "to reference", 4, 1.0),
    ("psnr_db", "PSNR dB", 1, 1.0),
    ("bits_per_pixel", "bit/px", 3, 1.0),
    ("color_bits_per_pixel", "of colour", 3, 1.0),
    ("mbps", "Mbit/s", 1, 1.0),
    ("encode_ms", "encode ms", 1, 1.0),
    ("decode_ms", "decode ms", 1, 1.0),
    ("flip_of_all", "of all", 4, 1.0),
    ("age_ms", "age ms", 0, 1.0),
    ("render_ms", "server ms", 1, 1.0),
    ("rays_per_px", "rays/px", 1, 1.0),
    ("missing_light", "missing %", 2, 100.0),
    ("bias", "bias %", 2, 100.0),
    ("times_better", "path / error", 1, 1.0),
    ("opacity_error", "of opacity", 5, 1.0),
    ("micros_per_ray", "us/ray", 2, 1.0),
];

impl Sweep {
    /// The JSON document, ending with a line break.
    ///
    /// # Errors
    /// What serde_json refuses; nothing in a sweep is of that kind.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        rounded_json(self)
    }
}

/// Places in [`COLUMNS`] of those that every point of a sweep has.
pub(super) fn columns_of(sweep: &Sweep) -> Vec<usize> {
    let everywhere = |&column: &usize| sweep.points.iter().all(|point| point.more.contains_key(COLUMNS[column].0));
    (0..COLUMNS.len()).filter(everywhere).collect()
}

/// The table, with a star for what is on the Pareto front, and the resume below.
pub fn table(sweep: &Sweep) -> String {
    let columns: Vec<_> = columns_of(sweep).into_iter().map(|column| COLUMNS[column]).collect();
    let mut head = vec!["scene".to_owned(), sweep.knob.clone(), String::new(), format!("error, {}", sweep.metric)];
    head.extend(columns.iter().map(|(_, heading, ..)| (*heading).to_owned()));
    head.extend(["time ms", "spread", "kB"].map(str::to_owned));
    let mut rows = vec![head];
    for point in &sweep.points {
        let star = if point.pareto { "*" } else { "" };
        let mut row = vec![point.scene.clone(), point.value.clone(), star.to_owned(), digits(point.error)];
        row.extend(columns.iter().map(|&(name, _, decimals, factor)| {
            let value = point.more.get(name).copied().unwrap_or(0.0) * factor;
            format!("{value:.decimals$}")
        }));
        row.extend([milliseconds(point.time_ms), milliseconds(point.time_spread_ms), kilobytes(point.bytes)]);
        rows.push(row);
    }
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..rows[0].len()).map(width).collect();
    let mut text = String::new();
    for row in &rows {
        let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| match column {
            // Words to the left, numbers to the right.
            0..=2 => format!("{cell:<width$}"),
            _ => format!("{cell:>width$}"),
        });
        let line = cells.collect::<Vec<_>>().join("  ");
        text.push_str(line.trim_end());
        text.push('\n');
    }
    let cost = match sweep.cost {
        Cost::Time => "time",
        Cost::Bytes => "bytes",
        Cost::Both => "bytes or time",
        Cost::None => "what is undefined",
    };
    text.push_str(&format!("* no other is better in error or {cost} without being worse in one\n"));
    text.push_str(&sweep.resume);
    if let Some(doubt) = doubt(sweep) {
        text.push('\n');
        text.push_str(&doubt);
    }
    text
}

/// Two decimals, or as many as there are before what matters: poses take microseconds.
pub(super) fn milliseconds(ms: f64) -> String {
    if ms != 0.0 && ms.abs() < 0.01 { format!("{ms:.6}") } else { format!("{ms:.2}") }
}

/// One decimal, or all there are: poses take bytes.
pub(super) fn kilobytes(bytes: u64) -> String {
    if (1..1000).contains(&bytes) {
        format!("{:.3}", bytes as f64 * 1e-3)
    } else {
        format!("{:.1}", bytes as f64 * 1e-3)
    }
}

/// Why the times are not to be believed, if they are not: quartiles further apart than half the median.
fn doubt(sweep: &Sweep) -> Option<String> {
    let restless = sweep.points.iter().filter(|point| point.time_spread_ms > 0.5 * point.time_ms).count();
    let of = sweep.points.len();
    (restless > 0).then(|| {
        format!(
            "times of {restless} of {of} settings vary by more than half: the machine was busy, the least is nearer"
        )
    })
}

/// Writes `sweep-KNOB.json` and a plot `sweep-KNOB-SCENE.svg` for each scene; returns their paths.
///
/// # Errors
/// What the operating system says.
pub fn write_files(sweep: &Sweep, folder: &Path) -> io::Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder)?;
    let mut paths = vec![folder.join(format!("sweep-{}.json", sweep.knob))];
    write_whole(&paths[0], sweep.to_json()?.as_bytes())?;
    for points in sweep.by_scene() {
        let path = folder.join(format!("sweep-{}-{}.svg", sweep.knob, points[0].scene));
        write_whole(&path, plot(sweep, points).to_svg().as_bytes())?;
        paths.push(path);
    }
    Ok(paths)
}

/// The curve of a scene: error over what it is paid with.
pub(super) fn plot<'a>(sweep: &'a Sweep, points: &[Point]) -> Scatter<'a> {
    // Of settings that take the same bytes, time is what there is to see.
    let cost = match sweep.cost {
        Cost::Both if points.iter().all(|point| point.bytes == points[0].bytes) => Cost::Time,
        cost => cost,
    };
    let dot = |point: &Point| Dot {
        x: match cost {
            Cost::Time => point.time_ms,
            Cost::None => point.value.parse().unwrap_or(point.time_ms),
            Cost::Bytes | Cost::Both => point.bytes as f64 * 1e-3,
        },
        y: point.error,
        name: point.value.clone(),
        is_on_front: point.pareto,
    };
    Scatter {
        description: format!("Error by {} on {}. {}", sweep.knob, points[0].scene, sweep.resume),
        x_label: match cost {
            Cost::Time => "time, ms",
            Cost::None => &sweep.knob,
            Cost::Bytes | Cost::Both => "kB",
        },
        y_label: format!("error, {}", sweep.metric),
        dots: points.iter().map(dot).collect(),
    }
}
