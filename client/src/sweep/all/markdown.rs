//! `accuracy.md`: all sweeps as a document of the project.

use super::{Conditions, Sweeps};
use crate::sweep::pareto::digits;
use crate::sweep::write::{kilobytes, milliseconds};
use crate::sweep::{Cost, KNOBS, Point, Sweep};

/// The document, ending with a line break.
pub(super) fn document(all: &Sweeps) -> String {
    let Conditions { date, machine, version, wire_version, size: [width, height], runs, .. } = &all.conditions;
    let mut text = format!(
        "# Accuracy against cost\n\n\
         Written by `{}` on {date}: {machine}; version {version}, wire {wire_version}; {width}x{height}, {runs} timed \
         run(s) of each setting. Errors and bytes are the same in every run of a version, times are not: medians, with \
         the distance of the quartiles. Tables list the settings that no other one beats in error or cost without \
         being beaten in the other; of circumstances, which nobody chooses, all. Plots and every setting: `index.html` \
         and `accuracy.json`, which the same command writes.\n\n",
        all.conditions.command("all").replace("sweep all", "sweep all --out DIR"),
    );
    text += "| knob | what it turns | error | bought with | measured in |\n|---|---|---|---|---:|\n";
    for sweep in &all.sweeps {
        let secs = all.seconds.get(&sweep.knob).copied().unwrap_or(0.0);
        let bought = match sweep.cost {
            Cost::Time => "time",
            Cost::Bytes => "bytes",
            Cost::Both => "bytes and time",
            Cost::None => "a circumstance",
        };
        let name = &sweep.knob;
        text += &format!("| [{name}](#{name}) | {} | {} | {bought} | {secs:.0} s |\n", about(sweep), sweep.metric);
    }
    for (knob, why) in &all.skipped {
        text += &format!("\n`{knob}` was not measured: {why}.\n");
    }
    for sweep in &all.sweeps {
        text += &knob(all, sweep);
    }
    text
}

fn about(sweep: &Sweep) -> &'static str {
    KNOBS.iter().find(|knob| knob.name == sweep.knob).map_or("", |knob| knob.about)
}

fn knob(all: &Sweeps, sweep: &Sweep) -> String {
    let mut text =
        format!("\n## {}\n\nTurns {}. `{}`\n\n", sweep.knob, about(sweep), all.conditions.command(&sweep.knob));
    text += &sweep.resume.split("; ").map(|line| format!("- {line}\n")).collect::<String>();
    text +=
        &format!("\n| scene | setting | error, {} | ms | spread | kB |\n|---|---|---:|---:|---:|---:|\n", sweep.metric);
    let shown = |point: &&Point| point.pareto || sweep.cost == Cost::None;
    for point in sweep.points.iter().filter(shown) {
        let Point { scene, value, error, time_ms, time_spread_ms, bytes, .. } = point;
        let (ms, spread) = (milliseconds(*time_ms), milliseconds(*time_spread_ms));
        let kilobytes = kilobytes(*bytes);
        text += &format!("| {scene} | {value} | {} | {ms} | {spread} | {kilobytes} |\n", digits(*error));
    }
    text
}
