//! Section "Accuracy and effort": what a budget chose from, which effects the scene called for and what they took, and how
//! near hard cases came to their bounds.
//!
//! The three questions that a report answers at one look: what accuracy costs in time, which effects are simulated, and
//! whether arithmetic holds where it is hard. The last is that of this release, from the table that its tests make.

use super::html::{count, escaped, figure, table};
use super::scatter::{Dot, Scatter};
use crate::report::Report;
use warplight_server::effects::EffectKind;

/// The table of hard cases, as the tests of this release have filled it.
const HARD_CASES: &str = include_str!("../../../../docs/stability.md");

/// Points of the cost model, error over time; those that were used are filled. Nothing without a budget.
pub(super) fn budget(report: &Report) -> String {
    let Some(budget) = &report.budget else { return String::new() };
    let dot = |point: &crate::report::BudgetPoint| {
        let share = budget.shares.get(&point.point).copied().unwrap_or(0.0);
        let percent = format!("{}, {:.0} %", point.point, 100.0 * share);
        let name = if share > 0.0 { percent } else { point.point.clone() };
        Dot { x: point.expected_ms, y: point.error, name, is_on_front: share > 0.0 }
    };
    let plot = Scatter {
        description: format!("Error over time of the points of a budget. {}", budget.in_words()),
        x_label: "nine in ten refreshes take at most, ms",
        y_label: "error of the model, FLIP".to_owned(),
        dots: budget.front.iter().map(dot).collect(),
    };
    let title = format!(
        "What a budget of {} ms chose <small>filled: used, for that share of the refreshes</small>",
        figure(budget.budget_ms)
    );
    format!("<p>{}.</p>\n<div class=\"charts\">\n{}</div>\n", escaped(&budget.in_words()), plot.to_html(&title))
}

/// Every effect there is: whether the scene calls for it, and the rays that it alone caused, as bars.
pub(super) fn effects(report: &Report) -> String {
    let rays = |kind: EffectKind| kind.counter().and_then(|name| report.counters.get(name)).copied();
    let most = EffectKind::ALL.into_iter().filter_map(rays).max().unwrap_or(0).max(1) as f64;
    let row = |kind: EffectKind| {
        let is_on = report.effects.iter().any(|effect| effect == kind.name());
        let rays = rays(kind).filter(|&rays| rays > 0);
        let width = rays.map_or(0.0, |rays| 100.0 * rays as f64 / most);
        let state = if is_on { "called for" } else { "<span class=\"off\">off</span>" };
        let rays = rays.map_or_else(|| "–".to_owned(), count);
        vec![escaped(kind.name()), state.to_owned(), rays, bar(width, false)]
    };
    let rows: Vec<Vec<String>> = EffectKind::ALL.into_iter().map(row).collect();
    table("Effects, and the rays that each alone caused", &["Effect", "Scene", "Rays", ""], &rows)
}

/// How near each hard case came to its bound in the tests of this release.
pub(crate) fn hard_cases() -> String {
    let mut rows = Vec::new();
    let mut place = String::new();
    for line in HARD_CASES.lines().filter(|line| line.starts_with('|')) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [name, quantity, bound, worst, _] = cells[..] else { continue };
        if let Some((head, _)) = name.strip_prefix("**").and_then(|name| name.split_once("**")) {
            head.clone_into(&mut place);
        }
        let (Ok(bound), Ok(worst)) = (bound.parse::<f64>(), worst.parse::<f64>()) else { continue };
        let part = if bound > 0.0 { worst / bound } else { f64::from(worst > 0.0) };
        let bound_text = if bound > 0.0 { format!("{bound:.1e}") } else { "none may be".to_owned() };
        let worst_text = if worst > 0.0 { format!("{worst:.1e}") } else { "0".to_owned() };
        let name = format!("{} <small>{}</small>", escaped(&place), escaped(quantity));
        rows.push(vec![name, bound_text, worst_text, bar(100.0 * part.min(1.0), part > 1.0)]);
    }
    let within = table("Hard cases, as parts of their bounds", &["Where", "Bound", "Worst seen", ""], &rows);
    format!("<details>\n<summary>All {} bounds on hard cases</summary>\n{within}</details>\n", rows.len())
}

fn bar(percent: f64, is_bad: bool) -> String {
    let class = if is_bad { "bar bad" } else { "bar" };
    format!("<span class=\"track\"><i class=\"{class}\" style=\"width:{percent:.1}%\"></i></span>")
}

#[cfg(test)]
mod tests {
    use super::super::html::check_nesting;
    use super::*;
    use crate::report::{BudgetPoint, BudgetReport, sample};
    use std::collections::BTreeMap;

    #[test]
    fn effects_that_are_off_are_told_apart_and_bars_are_shares() {
        let mut report = Report { effects: vec!["reflection".into(), "refraction".into()], ..sample::report() };
        report.counters = BTreeMap::from([("rays.reflect".to_owned(), 4000), ("rays.refract".to_owned(), 1000)]);
        let html = effects(&report);
        check_nesting(&html);
        assert_eq!(html.matches("called for").count(), 2, "{html}");
        assert_eq!(html.matches("class=\"off\"").count(), EffectKind::ALL.len() - 2);
        assert!(html.contains("width:100.0%") && html.contains("width:25.0%"), "{html}");
    }

    #[test]
    fn every_hard_case_has_a_bar_within_its_bound() {
        let html = hard_cases();
        check_nesting(&html);
        assert!(html.matches("class=\"bar\"").count() > 40, "{html}");
        assert!(!html.contains("bar bad"), "{html}");
    }

    #[test]
    fn points_that_were_used_are_filled_and_say_how_often() {
        let point = |name: &str, expected_ms, error| BudgetPoint { point: name.to_owned(), expected_ms, error };
        let front = vec![point("coarse", 4.0, 0.3), point("fine", 9.0, 0.2), point("finest", 14.0, 0.1)];
        let budget_report = BudgetReport {
            budget_ms: 11.0,
            model: "m".into(),
            point: "fine".into(),
            expected_ms: 9.0,
            error: 0.2,
            next_better: Some(front[2].clone()),
            front,
            changes: 1,
            beyond_budget: 0,
            shares: BTreeMap::from([("coarse".to_owned(), 0.25), ("fine".to_owned(), 0.75)]),
        };
        let html = budget(&Report { budget: Some(budget_report), ..sample::report() });
        check_nesting(&html);
        assert!(html.contains("fine, 75 %") && html.contains("coarse, 25 %") && html.contains("finest"), "{html}");
        assert_eq!(budget(&Report { budget: None, ..sample::report() }), "");
    }
}
