//! Averaging neighbours that see the same: an edge-avoiding wavelet.
//!
//! Third step of the filter. Method: Dammertz et al. 2010: a small kernel (binomial, three by three) again and again
//! with its taps twice as far apart, each tap weighed by how alike the surfaces are (material, plane, normal). As in
//! Schied et al. 2017 a tap counts the less the more its luminance differs, measured by the standard error of both;
//! variances are filtered with the squared weights. Weights fall to zero at a finite difference instead of as
//! exponentials: the same in effect, and cheap.
//!
//! A step reaches no further than the lobe is blind: the footprint of a point (a part of alpha as an angle, and what
//! the distance to the mirrored thing leaves of it), and normals within half of that angle. So a lobe of alpha 0.1 is
//! averaged over three or four pixels of a flat mirror at 512 pixels across, and over none in a small ball.
//!
//! Cost: nine taps per point and step; points whose footprint is less than half a step are left out.

use super::{Points, each_point};
use crate::cache::luminance;
use glam::Vec4;

/// Steps, each with taps twice as far apart: seven pixels together. A fourth is worth its time to
/// lobes only that see more pixels alike than those.
const STEPS: u32 = 3;
/// Squared difference of two means over the sum of their variances beyond which they do not count as the same: chance
/// alone exceeds it once in four hundred.
const LIKELY: f32 = 9.0;
/// Relative to the squared luminance: differences below a thirtieth are never seen.
const UNSEEN: f32 = 1e-3;

/// Filters `light`, with its variance, over the points of a frame; `other` is memory.
pub(super) fn filter(points: &Points, light: &mut Vec<Vec4>, other: &mut Vec<Vec4>) {
    for step in 0..STEPS {
        let apart = 1 << step;
        each_point(points.len(), other, |point| smoothed(points, light, point, apart));
        std::mem::swap(light, other);
    }
}

fn smoothed(points: &Points, light: &[Vec4], point: usize, apart: i32) -> Vec4 {
    let (site, guide, own) = (points.sites[point], &points.guides[point], light[point]);
    let reach = |footprint_px: f32| (footprint_px / apart as f32 - 0.5).clamp(0.0, 1.0);
    if reach(guide.footprint_px) <= 0.0 {
        return own;
    }
    let luminance_here = luminance(own.truncate());
    let (mut weights, mut sum, mut variance) = (1.0, own, own.w);
    for row in -1..=1_i32 {
        for column in -1..=1_i32 {
            if (row, column) == (0, 0) {
                continue;
            }
            let Some(other) = points.beside(site, column * apart, row * apart) else { continue };
            let beside = &points.guides[other];
            let bent = 1.0 - guide.normal.dot(beside.normal);
            let bend = guide.bend.min(beside.bend);
            if bent >= bend || !guide.is_beside(beside) {
                continue;
            }
            let there = light[other];
            let difference = luminance(there.truncate()) - luminance_here;
            let likely = LIKELY * (own.w + there.w) + UNSEEN * luminance_here * luminance_here;
            let square = difference * difference;
            if square >= likely {
                continue;
            }
            let kernel = if row == 0 || column == 0 { 0.5 } else { 0.25 };
            let weight = kernel
                * reach(guide.footprint_px.min(beside.footprint_px))
                * (1.0 - bent / bend)
                * (1.0 - square / likely);
            weights += weight;
            variance += weight * weight * there.w;
            sum += weight * there;
        }
    }
    (sum / weights).with_w(variance / (weights * weights))
}

#[cfg(test)]
mod tests {
    use super::super::{Guide, NONE, Site};
    use super::*;
    use glam::Vec3;
    use warplight_protocol::ImageSize;

    const SIDE: u16 = 32;

    /// A flat wall, a pixel a centimetre, left of the middle of one material and right of it of another.
    fn wall(footprint_px: f32) -> Points {
        let sites: Vec<Site> =
            (0..SIDE).flat_map(|row| (0..SIDE).map(move |column| Site { column, row, node: 0 })).collect();
        let guide = |site: &Site| Guide {
            position: 0.01 * Vec3::new(f32::from(site.column), f32::from(site.row), 0.0),
            normal: Vec3::Z,
            material: u32::from(site.column >= SIDE / 2),
            footprint_px,
            bend: 1e-3,
        };
        let guides = sites.iter().map(guide).collect();
        let mut index = vec![NONE; sites.len()];
        (0..).zip(&mut index).for_each(|(point, place)| *place = point);
        let size = ImageSize::new(u32::from(SIDE), u32::from(SIDE));
        Points { size, index, sites, guides, ..Points::default() }
    }

    /// Noise of one sample about 1, and about 3 on the other material.
    fn noisy() -> Vec<Vec4> {
        (0..u32::from(SIDE) * u32::from(SIDE))
            .map(|point| {
                let mean = if point % u32::from(SIDE) >= u32::from(SIDE / 2) { 3.0 } else { 1.0 };
                let noise = (point.wrapping_mul(2_654_435_761) >> 16) as f32 / 32768.0 - 1.0;
                Vec3::splat(mean + 0.5 * noise).extend(0.25 / 3.0)
            })
            .collect()
    }

    fn filtered(footprint_px: f32) -> Vec<Vec4> {
        let (mut light, mut other) = (noisy(), Vec::new());
        filter(&wall(footprint_px), &mut light, &mut other);
        light
    }

    #[test]
    fn a_lobe_that_sees_every_pixel_apart_is_left_as_it_is() {
        assert_eq!(filtered(0.5), noisy());
    }

    #[test]
    fn a_wide_lobe_is_averaged_up_to_the_edge_of_its_surface_and_keeps_its_light() {
        let light = filtered(100.0);
        for (columns, mean) in [(0..SIDE / 2, 1.0), (SIDE / 2..SIDE, 3.0)] {
            let values: Vec<f32> = light
                .iter()
                .enumerate()
                .filter(|(point, _)| columns.contains(&((point % usize::from(SIDE)) as u16)))
                .map(|(_, light)| light.x)
                .collect();
            let found = values.iter().sum::<f32>() / values.len() as f32;
            let worst = values.iter().map(|value| (value - mean).abs()).fold(0.0, f32::max);
            // 512 samples of a standard deviation of 0.29: the mean is known to 0.013.
            assert!((found - mean).abs() < 3.0 * 0.013, "{found}");
            // Noise went up to 0.5.
            assert!(worst < 0.2, "{worst}");
        }
    }
}
