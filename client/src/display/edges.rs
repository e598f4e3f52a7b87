//! Stair-cased edges made smooth, on display codes: after FXAA (Lottes 2009).
//!
//! Frames are sampled at pixel centres, so edges between surfaces are stairs, and a warp carries them along.
//!
//! 1. Luma of a pixel and its eight neighbours. Where the four nearest differ by less than an eighth of the brightest
//!    (and by less than eight codes) there is no edge, and nothing changes.
//! 2. The direction of the edge: horizontal where second differences down the columns outweigh those along the rows.
//!    The side: the neighbour across it that differs more.
//! 3. From the pixel along the edge both ways, in steps of a pixel, to where the mean of the two sides leaves that of
//!    the edge by more than a quarter of its contrast: the ends of the step.
//! 4. The nearer end tells how much of the pixel lies beyond an ideal edge: `1/2 - near / (near + far)`, if that end
//!    turns away from the pixel's own side. As far the pixel is mixed with its neighbour across the edge.
//!
//! A pixel becomes a mean of itself and one neighbour, so it stays in the range of the two. The sub-pixel filter of
//! FXAA, a blur, is left out: textures stay sharp. Cost: 9 fetches a pixel, some 30 more at edges; rows in parallel.

use image::RgbImage;
use rayon::prelude::*;

/// Contrast that is an edge, as a fraction of the brightest neighbour: 1/8 in FXAA's own presets.
const EDGE_FRACTION: f32 = 0.125;
/// Contrast in codes below which nothing is an edge, however dark: 1/32 of the range.
const EDGE_CODES: f32 = 8.0;
/// Pixels searched in each direction: longer steps are so flat that nobody sees them.
const SEARCH_PX: i32 = 12;
/// Part of the contrast by which the ends of a step are known.
const END_FRACTION: f32 = 0.25;

/// Codes of a picture, clamped at its border.
struct Codes<'a> {
    codes: &'a [[u8; 3]],
    width: i32,
    height: i32,
}

impl Codes<'_> {
    fn at(&self, x: i32, y: i32) -> [u8; 3] {
        self.codes[(y.clamp(0, self.height - 1) * self.width + x.clamp(0, self.width - 1)) as usize]
    }

    /// Rec. 709 luma.
    fn luma(&self, x: i32, y: i32) -> f32 {
        let [r, g, b] = self.at(x, y);
        0.2126 * f32::from(r) + 0.7152 * f32::from(g) + 0.0722 * f32::from(b)
    }

    /// The pixel after smoothing.
    fn smoothed(&self, x: i32, y: i32) -> [u8; 3] {
        let own = self.luma(x, y);
        let (north, south, west, east) =
            (self.luma(x, y - 1), self.luma(x, y + 1), self.luma(x - 1, y), self.luma(x + 1, y));
        let (brightest, darkest) =
            (own.max(north).max(south).max(west.max(east)), own.min(north).min(south).min(west.min(east)));
        if brightest - darkest < (EDGE_FRACTION * brightest).max(EDGE_CODES) {
            return self.at(x, y);
        }
        let (nw, ne) = (self.luma(x - 1, y - 1), self.luma(x + 1, y - 1));
        let (sw, se) = (self.luma(x - 1, y + 1), self.luma(x + 1, y + 1));
        let bend = |a: f32, b: f32, c: f32| (a - 2.0 * b + c).abs();
        let down = bend(nw, west, sw) + 2.0 * bend(north, own, south) + bend(ne, east, se);
        let across = bend(nw, north, ne) + 2.0 * bend(west, own, east) + bend(sw, south, se);
        let is_horizontal = down >= across;
        let (before, behind) = if is_horizontal { (north, south) } else { (west, east) };
        let side = if (before - own).abs() >= (behind - own).abs() { -1 } else { 1 };
        let other = if side < 0 { before } else { behind };
        let (to_side, along) = if is_horizontal { ((0, side), (1, 0)) } else { ((side, 0), (0, 1)) };
        let edge = 0.5 * (own + other);
        let end_contrast = END_FRACTION * (own - other).abs();

        // Distance to the end of the step, and how far it is off the edge's luma there; none within reach.
        let end = |way: i32| {
            (1..=SEARCH_PX).find_map(|step| {
                let (px, py) = (x + way * step * along.0, y + way * step * along.1);
                let off = 0.5 * (self.luma(px, py) + self.luma(px + to_side.0, py + to_side.1)) - edge;
                (off.abs() >= end_contrast).then_some((step as f32, off))
            })
        };
        let (backward, forward) = (end(-1), end(1));
        let reach = |end: Option<(f32, f32)>| end.map_or(SEARCH_PX as f32 + 1.0, |(distance, _)| distance);
        let (near, far) =
            if reach(backward) <= reach(forward) { (backward, reach(forward)) } else { (forward, reach(backward)) };
        let Some((distance, off)) = near else { return self.at(x, y) };
        // Where the end turns to the pixel's own luma, the ideal edge runs through the neighbour, not through this one.
        if (off > 0.0) == (own > edge) {
            return self.at(x, y);
        }
        let part = 0.5 - (distance - 0.5) / (distance + far - 1.0).max(1.0);
        if part <= 0.0 {
            return self.at(x, y);
        }
        let (own, other) = (self.at(x, y), self.at(x + to_side.0, y + to_side.1));
        std::array::from_fn(|channel| {
            let (own, other) = (f32::from(own[channel]), f32::from(other[channel]));
            (own + (other - own) * part + 0.5) as u8
        })
    }
}

/// Smooths `picture`; `unsmoothed` holds it as it was, and is kept from picture to picture.
pub fn smooth_edges(picture: &mut RgbImage, unsmoothed: &mut Vec<u8>) {
    let (width, height) = (picture.width() as i32, picture.height() as i32);
    if width == 0 || height == 0 {
        return;
    }
    unsmoothed.clear();
    unsmoothed.extend_from_slice(picture.as_raw());
    let codes = Codes { codes: unsmoothed.as_chunks::<3>().0, width, height };
    picture.par_chunks_mut(3 * width as usize).enumerate().for_each(|(y, row)| {
        for (x, code) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            *code = codes.smoothed(x as i32, y as i32);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    const SIDE: u32 = 64;

    fn smoothed(picture: &RgbImage) -> RgbImage {
        let mut after = picture.clone();
        smooth_edges(&mut after, &mut Vec::new());
        after
    }

    /// A half plane below a line of this slope: sampled at centres, or the covered part of every pixel.
    fn half_plane(slope: f64, exact: bool) -> RgbImage {
        let samples = if exact { 16 } else { 1 };
        RgbImage::from_fn(SIDE, SIDE, |x, y| {
            let mut below = 0;
            for sy in 0..samples {
                for sx in 0..samples {
                    let place = |at: u32, sub: i32| f64::from(at) + (f64::from(sub) + 0.5) / f64::from(samples);
                    below += i32::from(place(y, sy) - 24.3 > slope * place(x, sx));
                }
            }
            let part = f64::from(below) / f64::from(samples * samples);
            Rgb([(40.0 + 180.0 * part).round() as u8; 3])
        })
    }

    fn mean_square(a: &RgbImage, b: &RgbImage) -> f64 {
        let inner = |image: &RgbImage, x: u32, y: u32| f64::from(image.get_pixel(x, y).0[0]);
        let pixels = (14..SIDE - 14).flat_map(|y| (14..SIDE - 14).map(move |x| (x, y)));
        pixels.map(|(x, y)| (inner(a, x, y) - inner(b, x, y)).powi(2)).sum::<f64>()
    }

    #[test]
    fn flat_pictures_slow_gradients_and_straight_edges_along_the_pixels_stay() {
        for picture in [
            RgbImage::from_pixel(SIDE, SIDE, Rgb([90, 7, 200])),
            RgbImage::from_fn(SIDE, SIDE, |x, y| Rgb([3 * x as u8, 3 * y as u8, 100])),
            half_plane(0.0, false),
            RgbImage::from_pixel(1, 1, Rgb([5; 3])),
        ] {
            assert!(smoothed(&picture) == picture);
        }
        smooth_edges(&mut RgbImage::new(0, 0), &mut Vec::new());
    }

    /// The covered part of each pixel is the oracle.
    #[test]
    fn a_slanted_edge_comes_nearer_to_what_it_covers() {
        for slope in [0.1, 0.2, 0.35, 0.5] {
            for (stairs, exact) in [
                (half_plane(slope, false), half_plane(slope, true)),
                (
                    image::imageops::rotate90(&half_plane(slope, false)),
                    image::imageops::rotate90(&half_plane(slope, true)),
                ),
            ] {
                let (before, after) = (mean_square(&stairs, &exact), mean_square(&smoothed(&stairs), &exact));
                assert!(after < 0.5 * before, "slope {slope}: {before} to {after}");
            }
        }
    }

    #[test]
    fn no_pixel_leaves_the_range_of_itself_and_its_neighbours() {
        let picture = RgbImage::from_fn(SIDE, SIDE, |x, y| {
            let hash = (x * 7919 + y * 104_729 + x * y * 31) % 257;
            Rgb([hash.min(255) as u8, (x * 4) as u8 ^ (y * 9) as u8, if hash > 128 { 255 } else { 0 }])
        });
        let after = smoothed(&picture);
        let mut changed = 0;
        for (x, y, code) in after.enumerate_pixels() {
            let around = |channel: usize| {
                let near = |at: u32| at.saturating_sub(1)..=(at + 1).min(SIDE - 1);
                near(y).flat_map(move |y| near(x).map(move |x| (x, y))).map(move |(x, y)| (x, y, channel))
            };
            for channel in 0..3 {
                let codes = around(channel).map(|(x, y, channel)| picture.get_pixel(x, y).0[channel]);
                let (low, high) = codes.fold((255, 0), |(low, high), code| (code.min(low), code.max(high)));
                assert!((low..=high).contains(&code.0[channel]), "{x}, {y}");
            }
            changed += usize::from(picture.get_pixel(x, y) != code);
        }
        assert!(changed > 100, "{changed}");
    }
}
