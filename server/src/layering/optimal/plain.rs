//! The program as it is written down: one ray, in f64, with many candidates. What the fast form is compared with.

use super::reduce::reduce;
use super::{EVENNESS, FADING, HIDDEN, LENGTH_EVENNESS, MANY_CANDIDATES, OPTICAL_DEPTH_WEIGHT, WALL};
use crate::layering::{Profile, Segments};
use std::ops::Range;

/// Cuts a ray into at most `count` segments, with [`MANY_CANDIDATES`].
pub fn cut(profile: &Profile, count: usize, segments: &mut Segments) {
    let mut bins = Profile::default();
    reduce(profile, MANY_CANDIDATES, &mut bins);
    let (ranges, _) = solve(&bins, count);
    segments.extend(ranges.into_iter().filter_map(|range| bins.segment(range)));
}

/// A border between two bins: its place in the ray, P, and its weight.
struct Border {
    z: f64,
    p: [f64; 4],
    weight: f64,
    /// Transmittance from the eye, but at least what is hidden counts for.
    visible: f64,
}

/// The best at most `count` ranges of bins, and their cost.
pub(super) fn solve(bins: &Profile, count: usize) -> (Vec<Range<usize>>, f64) {
    let borders = borders(bins);
    let ends = bins.len();
    // best[s][j]: least cost of all matter before border j in at most s segments; from[s][j]: where the last of them starts,
    // or none where the bin before j is empty.
    let mut best = vec![vec![f64::INFINITY; ends + 1]; count + 1];
    let mut from = vec![vec![None; ends + 1]; count + 1];
    best.iter_mut().for_each(|best| best[0] = 0.0);
    for j in 1..=ends {
        for s in 1..=count {
            if bins.optical_depth[j - 1] <= 0.0 {
                best[s][j] = best[s][j - 1];
                continue;
            }
            for i in (0..j).filter(|&i| bins.optical_depth[i] > 0.0) {
                let cost = best[s - 1][i] + cost(&borders, i, j);
                if cost < best[s][j] {
                    (best[s][j], from[s][j]) = (cost, Some(i));
                }
            }
        }
    }
    let mut ranges = Vec::new();
    let (mut s, mut j) = (count, ends);
    while s > 0 && j > 0 {
        match from[s][j] {
            None => j -= 1,
            Some(i) => {
                ranges.push(i..j);
                (s, j) = (s - 1, i);
            }
        }
    }
    ranges.reverse();
    (ranges, best[count][ends])
}

fn borders(bins: &Profile) -> Vec<Border> {
    let length = bins.depth.last().zip(bins.depth.first()).map_or(1.0, |(last, first)| f64::from(last - first));
    let mut p = [0.0; 4];
    let mut optical_depth = 0.0;
    let mut borders = vec![Border { z: 0.0, p, weight: 0.0, visible: 1.0 }];
    for bin in 0..bins.len() {
        let own = f64::from(bins.optical_depth[bin]);
        let counted = own.min(f64::from(WALL));
        p[0] += f64::from(OPTICAL_DEPTH_WEIGHT) * counted;
        for (integral, source) in p[1..].iter_mut().zip(bins.source[bin].to_array()) {
            *integral += counted * f64::from(source);
        }
        optical_depth += own;
        let visible = (-optical_depth).exp().max(f64::from(HIDDEN) * (-f64::from(FADING) * optical_depth).exp());
        let z = f64::from(bins.depth[bin + 1] - bins.depth[0]) / length;
        borders.push(Border { z, p, weight: 0.0, visible });
    }
    for index in 0..borders.len() {
        let around = |bin: usize| 0.5 * (borders[bin + 1].z - borders[bin].z) * borders[bin].visible;
        let before = if index > 0 { around(index - 1) } else { 0.0 };
        let behind = if index + 1 < borders.len() { around(index) } else { 0.0 };
        borders[index].weight = before + behind;
    }
    borders
}

/// Cost of the segment between two borders.
fn cost(borders: &[Border], i: usize, j: usize) -> f64 {
    let (front, back) = (&borders[i], &borders[j]);
    let length = back.z - front.z;
    let squared_distance = |border: &Border| {
        let part = (border.z - front.z) / length;
        let from_chord =
            |channel: usize| border.p[channel] - front.p[channel] - part * (back.p[channel] - front.p[channel]);
        (0..4).map(|channel| from_chord(channel).powi(2)).sum::<f64>()
    };
    let distance: f64 = borders[i..=j].iter().map(|border| border.weight * squared_distance(border)).sum();
    let mass = (back.p[0] - front.p[0]) * front.visible;
    distance + f64::from(EVENNESS) * (mass * mass + f64::from(LENGTH_EVENNESS) * length * length)
}

/// What a cut costs.
#[cfg(test)]
pub(super) fn cost_of(bins: &Profile, ranges: &[Range<usize>]) -> f64 {
    let borders = borders(bins);
    ranges.iter().map(|range| cost(&borders, range.start, range.end)).sum()
}
