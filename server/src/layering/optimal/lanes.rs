//! The program for 16 rays at once, a lane each.
//!
//! All rays have as many borders as the longest may have; bins that a ray does not have are empty and without length, and no
//! segment starts or ends at one. A segment's end stands outside, its start runs towards the eye, so that what is best so
//! far stays in registers for all numbers of segments.
//!
//! The sums of a segment's cost are counted from its own end, so that f32 is enough: prefix sums over the whole ray would
//! cancel where a wall of great optical depth stands behind thin matter.
//!
//! Cost: about 50 instructions for a segment of 16 rays, 500 segments for 32 bins.

use super::bins::Bins;
use super::vector::{Array, LANES, Row, Vector};
use super::{CANDIDATES, EVENNESS, HIDDEN, LENGTH_EVENNESS, OPTICAL_DEPTH_WEIGHT, WALL};
use std::ops::Range;
use warplight_protocol::frame::MAX_LAYERS;

/// No cost is higher: radiance that overflows when it is squared still belongs to some segment.
const HIGHEST: f32 = 1e30;

/// Borders and states of the rays of all lanes.
#[derive(Debug)]
pub(super) struct Lanes {
    borders: [Border; CANDIDATES + 1],
    /// Least cost of what is before border j in at most s segments, and where the last of them starts; below 0 where the
    /// bin before it is empty.
    best: [[Row; MAX_LAYERS + 1]; CANDIDATES + 1],
    from: [[Row; MAX_LAYERS + 1]; CANDIDATES + 1],
}

/// A border in all lanes.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
struct Border {
    /// Place on the ray, 0 to 1.
    z: Row,
    p: [Row; 4],
    weight: Row,
    /// Transmittance from the eye, but at least what is hidden counts for.
    visible: Row,
    /// Infinite where the bin behind is empty, else 0.
    no_start: Row,
}

impl Default for Lanes {
    fn default() -> Lanes {
        let zero = [[[0.0; LANES]; MAX_LAYERS + 1]; CANDIDATES + 1];
        Lanes { borders: [Border::default(); CANDIDATES + 1], best: zero, from: zero }
    }
}

impl Lanes {
    /// Finds the best cuts of as many rays as there are lanes, or fewer, into at most `count` segments.
    pub(super) fn solve(&mut self, count: usize, bins: &[Bins]) {
        let longest = bins.iter().map(Bins::len).max().unwrap_or(0);
        if longest == 0 {
            return;
        }
        self.fill(bins, longest);
        #[cfg(target_arch = "x86_64")]
        {
            if std::arch::is_x86_feature_detected!("avx512f") && std::arch::is_x86_feature_detected!("fma") {
                // SAFETY: the features have been found.
                #[allow(unsafe_code)]
                return unsafe { self.run_avx512(count, longest) };
            }
            if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
                // SAFETY: the features have been found.
                #[allow(unsafe_code)]
                return unsafe { self.run_avx2(count, longest) };
            }
        }
        self.run::<Array>(count, longest);
    }

    /// Gives the ranges of bins of a lane's segments to `found`, in the order of the ray.
    pub(super) fn for_each_segment(&self, lane: usize, count: usize, bins: usize, mut found: impl FnMut(Range<usize>)) {
        let mut ranges: [Range<usize>; MAX_LAYERS] = Default::default();
        let (mut s, mut j) = (count.min(MAX_LAYERS), bins);
        let first = s;
        while s > 0 && j > 0 {
            let from = self.from[j][s][lane];
            if from < 0.0 {
                j -= 1;
            } else {
                // A start is before its end, whatever stands there.
                let i = (from as usize).min(j - 1);
                ranges[s - 1] = i..j;
                (s, j) = (s - 1, i);
            }
        }
        ranges[s..first].iter().cloned().for_each(&mut found);
    }

    fn fill(&mut self, bins: &[Bins], longest: usize) {
        for lane in 0..LANES {
            let own = bins.get(lane).map_or(0, Bins::len);
            self.borders[0].z[lane] = 0.0;
            if let Some(ray) = bins.get(lane).filter(|_| own > 0) {
                let per_length = 1.0 / ray.length_m();
                for bin in 0..own {
                    let (end_m, optical_depth, source) = ray.at(bin);
                    self.borders[bin].no_start[lane] = if optical_depth > 0.0 { 0.0 } else { f32::INFINITY };
                    let border = &mut self.borders[bin + 1];
                    border.z[lane] = end_m * per_length;
                    // Optical depth and source of the bin, until `run` sums them up.
                    border.p[0][lane] = optical_depth;
                    border.p[1][lane] = source.x;
                    border.p[2][lane] = source.y;
                    border.p[3][lane] = source.z;
                }
            }
            for bin in own..longest {
                self.borders[bin].no_start[lane] = f32::INFINITY;
                let border = &mut self.borders[bin + 1];
                border.z[lane] = 1.0;
                border.p[0][lane] = 0.0;
                border.p[1][lane] = 0.0;
                border.p[2][lane] = 0.0;
                border.p[3][lane] = 0.0;
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,fma")]
    fn run_avx512(&mut self, count: usize, longest: usize) {
        self.run::<super::vector::Register>(count, longest);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn run_avx2(&mut self, count: usize, longest: usize) {
        self.run::<Array>(count, longest);
    }

    #[inline(always)]
    fn run<V: Vector>(&mut self, count: usize, longest: usize) {
        self.integrate(longest);
        // As many as are in registers: those of numbers that nobody asked for are thrown away.
        if count <= 4 { self.program::<V, 4>(longest) } else { self.program::<V, MAX_LAYERS>(longest) }
    }

    /// P, weights and transmittances at all borders.
    #[inline(always)]
    fn integrate(&mut self, longest: usize) {
        let mut optical_depth = [0.0_f32; LANES];
        self.borders[0].p = [[0.0; LANES]; 4];
        self.borders[0].visible = [1.0; LANES];
        for bin in 0..longest {
            let (before, behind) = self.borders.split_at_mut(bin + 1);
            let (before, border) = (&before[bin].p, &mut behind[0]);
            for lane in 0..LANES {
                let own = border.p[0][lane];
                let counted = own.min(WALL);
                border.p[0][lane] = before[0][lane] + OPTICAL_DEPTH_WEIGHT * counted;
                border.p[1][lane] = before[1][lane] + counted * border.p[1][lane];
                border.p[2][lane] = before[2][lane] + counted * border.p[2][lane];
                border.p[3][lane] = before[3][lane] + counted * border.p[3][lane];
                optical_depth[lane] += own;
                // Powers of exp(-x / 64) by its series: a weight need not be exact, and beyond 64 it is nothing.
                let x = optical_depth[lane].min(64.0) * (1.0 / 64.0);
                let root = 1.0 - x * (1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0))));
                let squared = root * root;
                let fourth = squared * squared;
                let eighth = fourth * fourth;
                let sixteenth = eighth * eighth;
                let whole = (sixteenth * sixteenth) * (sixteenth * sixteenth);
                border.visible[lane] = whole.max(HIDDEN * sixteenth);
            }
        }
        for index in 0..=longest {
            let (before, behind) = (index.saturating_sub(1), (index + 1).min(longest));
            for lane in 0..LANES {
                let length_before = self.borders[index].z[lane] - self.borders[before].z[lane];
                let length_behind = self.borders[behind].z[lane] - self.borders[index].z[lane];
                self.borders[index].weight[lane] = 0.5
                    * (length_before * self.borders[before].visible[lane]
                        + length_behind * self.borders[index].visible[lane]);
            }
        }
    }

    /// Finds the best start of the last segment before every border, for up to K segments.
    #[inline(always)]
    fn program<V: Vector, const K: usize>(&mut self, longest: usize) {
        // At the eye nothing is before it, in however many segments.
        self.best[0] = [[0.0; LANES]; MAX_LAYERS + 1];
        self.from[0] = [[-1.0; LANES]; MAX_LAYERS + 1];
        let (zero, two, highest) = (V::splat(0.0), V::splat(2.0), V::splat(HIGHEST));
        let (evenness, length_evenness) = (V::splat(EVENNESS), V::splat(EVENNESS * LENGTH_EVENNESS));
        for j in 1..=longest {
            let end = &self.borders[j];
            let end_z = V::load(&end.z);
            let end_p = [V::load(&end.p[0]), V::load(&end.p[1]), V::load(&end.p[2]), V::load(&end.p[3])];
            let mut best = [V::splat(f32::INFINITY); K];
            let mut from = [V::splat(-1.0); K];
            // Sums over the borders from i to the end, counted from there: of w dP dP, w dz dP and w dz dz.
            let mut squares = zero;
            let mut products = [zero; 4];
            let mut lengths = zero;
            for i in (0..j).rev() {
                let start = &self.borders[i];
                let weight = V::load(&start.weight);
                let dz = end_z.minus(V::load(&start.z));
                let d0 = end_p[0].minus(V::load(&start.p[0]));
                let d1 = end_p[1].minus(V::load(&start.p[1]));
                let d2 = end_p[2].minus(V::load(&start.p[2]));
                let d3 = end_p[3].minus(V::load(&start.p[3]));
                let norm = d0.times(d0).plus(d1.times(d1)).plus(d2.times_plus(d2, d3.times(d3)));
                let weighted = weight.times(dz);
                squares = weight.times_plus(norm, squares);
                products[0] = weighted.times_plus(d0, products[0]);
                products[1] = weighted.times_plus(d1, products[1]);
                products[2] = weighted.times_plus(d2, products[2]);
                products[3] = weighted.times_plus(d3, products[3]);
                lengths = weighted.times_plus(dz, lengths);
                let inverse = V::splat(1.0).over(dz);
                let product = d0.times_plus(products[0], d1.times(products[1]));
                let product = product.plus(d2.times_plus(products[2], d3.times(products[3])));
                let slope = two.times(product).minus(lengths.times(inverse).times(norm));
                let distance = squares.minus(inverse.times(slope)).at_least(zero);
                let mass = d0.times(V::load(&start.visible));
                let even = mass.times(mass).times_plus(evenness, dz.times(dz).times(length_evenness));
                let cost = distance.plus(even).at_most(highest).plus(V::load(&start.no_start));
                let at = V::splat(i as f32);
                for s in 0..K {
                    let total = cost.plus(V::load(&self.best[i][s]));
                    [best[s], from[s]] = total.if_below(best[s], [(total, best[s]), (at, from[s])]);
                }
            }
            // What is before a border is what is before the last, where the bin between them is empty.
            let bin = V::load(&self.borders[j - 1].no_start);
            for s in 0..K {
                let before = V::load(&self.best[j - 1][s + 1]);
                let [best, from] = bin.if_below(V::splat(1.0), [(best[s], before), (from[s], V::splat(-1.0))]);
                best.store(&mut self.best[j][s + 1]);
                from.store(&mut self.from[j][s + 1]);
            }
            // In no segment nothing but emptiness can be.
            let none = V::load(&self.best[j - 1][0]);
            let [none, _] = bin.if_below(V::splat(1.0), [(V::splat(f32::INFINITY), none), (zero, zero)]);
            none.store(&mut self.best[j][0]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{plain, random};
    use super::*;
    use crate::layering::Profile;
    use glam::Vec3;

    /// Rays of layered, patchy and empty matter from a hash.
    fn ray(seed: u32) -> Profile {
        let mut next = random(seed);
        let mut ray = Profile::default();
        ray.start(2.0 + next());
        let bins = (next() * 32.0) as usize;
        for _ in 0..bins {
            let end = ray.depth[ray.len()] + 0.02 + 0.1 * next();
            let optical_depth = if next() < 0.2 { 0.0 } else { 10.0_f32.powf(4.0 * next() - 3.0) };
            ray.push(end, optical_depth, Vec3::new(next(), next(), next()));
        }
        // A ray of bins starts and ends with matter.
        if bins > 0 {
            ray.optical_depth[0] = 0.1;
            ray.optical_depth[bins - 1] = 0.1;
        }
        ray
    }

    #[test]
    fn lanes_find_cuts_as_cheap_as_the_plain_program() {
        let mut lanes = Lanes::default();
        for batch in 0..40 {
            let rays: Vec<_> = (0..LANES as u32).map(|lane| ray(batch * 100 + lane)).collect();
            let bins: Vec<_> = rays.iter().map(Bins::of_few).collect();
            for count in [1, 2, 4, 8] {
                lanes.solve(count, &bins);
                for (lane, ray) in rays.iter().enumerate() {
                    let (best, cost) = plain::solve(ray, count);
                    let mut found = Vec::new();
                    lanes.for_each_segment(lane, count, ray.len(), |range| found.push(range));
                    let own = plain::cost_of(ray, &found);
                    assert!(
                        own <= cost * (1.0 + 1e-3) + 1e-7,
                        "{batch} {lane} {count}: {own} {cost} {found:?} {best:?}"
                    );
                    assert!(found.len() <= count && found.windows(2).all(|pair| pair[0].end <= pair[1].start));
                    // All matter is in some segment.
                    let (whole, _) = ray.compose();
                    let optical_depth: f32 =
                        found.iter().filter_map(|range| ray.segment(range.clone())).map(|s| s.optical_depth).sum();
                    let sum: f32 = ray.optical_depth.iter().sum();
                    assert!((optical_depth - sum).abs() <= 1e-5 * sum, "{whole}");
                }
            }
        }
    }
}
