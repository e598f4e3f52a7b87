//! What a curve says: which settings nobody need regret, and the trade between the best and the next cheaper one.

use super::{Cost, Point};

/// Marks the points that no other one dominates: is at least as good in cost, error and what is undefined, and better
/// in one of them. Where bytes and time both count, so do both here. What is undefined counts, since a solver that gives up where it is hard has a small median.
/// O(n^2).
pub(super) fn mark(points: &mut [Point], cost: Cost) {
    let of = |point: &Point| {
        let time_ms = if cost == Cost::Both { point.time_ms } else { 0.0 };
        [point.cost(cost), time_ms, point.error, point.more.get("undefined").copied().unwrap_or(0.0)]
    };
    let all: Vec<[f64; 4]> = points.iter().map(of).collect();
    for (point, own) in points.iter_mut().zip(&all) {
        let dominates = |other: &[f64; 4]| {
            other.iter().zip(own).all(|(other, own)| other <= own) && other.iter().zip(own).any(|(a, b)| a < b)
        };
        point.pareto = !all.iter().any(dominates);
    }
}

/// One line: what the last setting of a circumstance costs over the first; of a choice, what the next cheaper point of the front costs in error, and saves.
pub(super) fn resume(points: &[Point], cost: Cost, metric: &str) -> String {
    if let (Cost::None, [first, .., last]) = (cost, points) {
        let more = digits(last.error - first.error);
        return format!("{} instead of {} costs {more} {metric}", last.value, first.value);
    }
    let front = || points.iter().filter(|point| point.pareto);
    let Some(best) = front().min_by(|a, b| a.error.total_cmp(&b.error)) else { return "nothing was measured".into() };
    // Where bytes are all the same, time is what there is to save.
    let are_equal = points.iter().all(|point| point.bytes == best.bytes);
    let cost = match cost {
        Cost::Both if are_equal => Cost::Time,
        Cost::Both => Cost::Bytes,
        cost => cost,
    };
    let cheaper = front().filter(|point| point.cost(cost) < best.cost(cost));
    let Some(next) = cheaper.max_by(|a, b| a.cost(cost).total_cmp(&b.cost(cost))) else {
        let error = digits(best.error);
        return format!("{} has the smallest error, {error} {metric}, and nothing is cheaper", best.value);
    };
    let saved = best.cost(cost) - next.cost(cost);
    let spread = best.time_spread_ms + next.time_spread_ms;
    let percent = 100.0 * saved / best.cost(cost);
    let saved_text = match cost {
        // Differences that the machine makes by itself are no saving, and one run has no spread to tell.
        Cost::Time if saved <= 0.5 * spread || spread <= 0.0 => "no time that could be told from noise".to_owned(),
        Cost::Time if saved < 0.05 => format!("{:.2} us ({percent:.0} %)", saved * 1e3),
        Cost::Time => format!("{saved:.1} ms ({percent:.0} %)"),
        Cost::None => "nothing".to_owned(),
        Cost::Bytes | Cost::Both if saved < 100.0 => format!("{saved:.0} B ({percent:.0} %)"),
        Cost::Bytes | Cost::Both => format!("{:.1} kB ({percent:.0} %)", saved * 1e-3),
    };
    format!(
        "{} instead of {} costs {} {metric} and saves {saved_text}",
        next.value,
        best.value,
        digits(next.error - best.error)
    )
}

/// Four decimals, or as many digits as there are before what matters.
pub(super) fn digits(error: f64) -> String {
    if error != 0.0 && error.abs() < 1e-3 { format!("{error:.2e}") } else { format!("{error:.4}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn point(value: &str, time_ms: f64, error: f64, undefined: f64) -> Point {
        Point {
            value: value.into(),
            scene: "s".into(),
            time_ms,
            time_spread_ms: 0.1,
            error,
            bytes: 1,
            pareto: false,
            more: BTreeMap::from([("undefined".to_owned(), undefined)]),
        }
    }

    #[test]
    fn what_is_slower_and_worse_is_not_on_the_front_and_what_gives_up_less_is() {
        let mut points = vec![
            point("fast", 1.0, 0.5, 0.0),
            point("good", 4.0, 0.1, 0.01),
            point("bad", 5.0, 0.6, 0.02),
            point("thorough", 5.0, 0.2, 0.0),
            point("same as good", 4.0, 0.1, 0.01),
        ];
        mark(&mut points, Cost::Time);
        assert_eq!(points.iter().map(|point| point.pareto).collect::<Vec<_>>(), [true, true, false, true, true]);
        assert_eq!(resume(&points, Cost::Time, "deg"), "fast instead of good costs 0.4000 deg and saves 3.0 ms (75 %)");
        // All have as many bytes: the smallest error alone is left, but for what is undefined.
        mark(&mut points, Cost::Bytes);
        assert_eq!(points.iter().map(|point| point.pareto).collect::<Vec<_>>(), [false, true, false, true, true]);
        assert!(resume(&points, Cost::Bytes, "deg").contains("nothing is cheaper"));
        assert_eq!(resume(&[], Cost::Time, "deg"), "nothing was measured");
        assert_eq!(resume(&points, Cost::None, "deg"), "same as good instead of fast costs -0.4000 deg");
    }

    #[test]
    fn a_saving_within_the_spread_is_none() {
        let mut points = vec![point("a", 4.0, 0.2, 0.0), point("b", 4.05, 0.1, 0.0)];
        mark(&mut points, Cost::Time);
        assert!(resume(&points, Cost::Time, "deg").ends_with("saves no time that could be told from noise"));
    }
}
