//! Colour pictures of a node: from codes to luma and chroma, gaps filled, warped, rolled, compared.
//!
//! Root8 codes to Y'CbCr (BT.601, full range), chroma halved. Undefined pixels are filled by push-pull, so that they cost
//! little and do not bleed.

use glam::Vec2;
use warplight_protocol::frame::{ColorFormat, NodePlanes};

/// Luma at full size and two chromas at half; where anything is defined.
#[derive(Clone)]
pub(crate) struct Picture {
    pub(crate) side: usize,
    pub(crate) planes: [Vec<u8>; 3],
    pub(crate) defined: Vec<bool>,
}

pub(crate) fn side_of(side: usize, plane: usize) -> usize {
    if plane == 0 { side } else { side / 2 }
}

impl Picture {
    pub(crate) fn of(node: &NodePlanes, side: usize, white: f32) -> Picture {
        let defined: Vec<bool> = node.distance.iter().map(|&distance| distance > 0.0).collect();
        let rgb: [Vec<f32>; 3] = std::array::from_fn(|channel| {
            let codes =
                node.radiance[channel].iter().map(|&value| f32::from(ColorFormat::Root8.quantise(value, white)));
            let values: Vec<Option<f32>> =
                codes.zip(&defined).map(|(code, &defined)| defined.then_some(code)).collect();
            filled(&values, side)
        });
        let mix = |weights: [f32; 3], offset: f32| -> Vec<f32> {
            (0..side * side).map(|p| (0..3).map(|c| weights[c] * rgb[c][p]).sum::<f32>() + offset).collect()
        };
        let half = |full: Vec<f32>| -> Vec<u8> {
            let at = |i: usize| {
                let (y, x) = (i / (side / 2) * 2, i % (side / 2) * 2);
                (full[y * side + x] + full[y * side + x + 1] + full[(y + 1) * side + x] + full[(y + 1) * side + x + 1])
                    * 0.25
            };
            (0..side * side / 4).map(|i| at(i).round() as u8).collect()
        };
        let luma = mix([0.299, 0.587, 0.114], 0.0).into_iter().map(|v| v.round() as u8).collect();
        let blue = half(mix([-0.168_736, -0.331_264, 0.5], 128.0));
        let red = half(mix([0.5, -0.418_688, -0.081_312], 128.0));
        Picture { side, planes: [luma, blue, red], defined }
    }

    /// Mean squared error over defined pixels, luma counting four times as much as a chroma.
    pub(crate) fn mean_squared_error(&self, shown: &Picture) -> f64 {
        let mut sum = 0.0;
        let mut count = 0.0;
        for plane in 0..3 {
            let side = side_of(self.side, plane);
            let scale = self.side / side;
            for i in 0..side * side {
                let (y, x) = (i / side * scale, i % side * scale);
                if self.defined[y * self.side + x] {
                    let error = f64::from(self.planes[plane][i]) - f64::from(shown.planes[plane][i]);
                    sum += error * error;
                    count += 1.0;
                }
            }
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }

    /// Its content moved by so many pixels, around the edges.
    pub(crate) fn rolled(&self, by: [i32; 2]) -> Picture {
        let mut rolled = self.clone();
        for plane in 0..3 {
            let side = side_of(self.side, plane);
            let scale = (self.side / side) as i32;
            for i in 0..side * side {
                let to = |v: usize, by: i32| (v as i32 + by / scale).rem_euclid(side as i32) as usize;
                rolled.planes[plane][to(i / side, by[1]) * side + to(i % side, by[0])] = self.planes[plane][i];
            }
        }
        rolled
    }

    /// This picture (of before) as `places` sees it.
    pub(crate) fn warped(&self, places: &[Option<Vec2>]) -> Picture {
        let mut warped = self.clone();
        for plane in 0..3 {
            let side = side_of(self.side, plane);
            let scale = self.side / side;
            let values: Vec<Option<f32>> = (0..side * side)
                .map(|i| {
                    let (y, x) = (i / side, i % side);
                    // A chroma lies between four pixels: where their places are, on average.
                    let mut sum = Vec2::ZERO;
                    let mut count = 0.0;
                    for j in 0..scale * scale {
                        if let Some(place) = places[(y * scale + j / scale) * self.side + x * scale + j % scale] {
                            sum += place;
                            count += 1.0;
                        }
                    }
                    (count > 0.0).then(|| cubic(&self.planes[plane], side, sum / count / scale as f32))
                })
                .collect();
            warped.planes[plane] = filled(&values, side).into_iter().map(|v| v.round() as u8).collect();
        }
        warped
    }
}

/// Catmull-Rom.
fn cubic(plane: &[u8], side: usize, place: Vec2) -> f32 {
    let (x, y) = (place.x - 0.5, place.y - 0.5);
    let weights = |t: f32| {
        [
            ((-0.5 * t + 1.0) * t - 0.5) * t,
            (1.5 * t - 2.5) * t * t + 1.0,
            ((-1.5 * t + 2.0) * t + 0.5) * t,
            (0.5 * t - 0.5) * t * t,
        ]
    };
    let (wx, wy) = (weights(x - x.floor()), weights(y - y.floor()));
    let (x, y) = (x.floor() as i32 - 1, y.floor() as i32 - 1);
    let mut sum = 0.0;
    for j in 0..4 {
        let row = (y + j).clamp(0, side as i32 - 1) as usize * side;
        for i in 0..4 {
            sum += wy[j as usize] * wx[i as usize] * f32::from(plane[row + (x + i).clamp(0, side as i32 - 1) as usize]);
        }
    }
    sum.clamp(0.0, 255.0)
}

/// Gaps filled with means of what is around them, finest first (push-pull).
fn filled(values: &[Option<f32>], side: usize) -> Vec<f32> {
    if values.iter().all(|v| v.is_some()) {
        return values.iter().map(|v| v.unwrap_or(0.0)).collect();
    }
    if side % 2 == 1 || side < 4 {
        let known: Vec<f32> = values.iter().flatten().copied().collect();
        let mean = if known.is_empty() { 128.0 } else { known.iter().sum::<f32>() / known.len() as f32 };
        return values.iter().map(|v| v.unwrap_or(mean)).collect();
    }
    let half = side / 2;
    let coarse: Vec<Option<f32>> = (0..half * half)
        .map(|i| {
            let at = i / half * 2 * side + i % half * 2;
            let four = [values[at], values[at + 1], values[at + side], values[at + side + 1]];
            let known = four.iter().flatten().count();
            (known > 0).then(|| four.iter().flatten().sum::<f32>() / known as f32)
        })
        .collect();
    let coarse = filled(&coarse, half);
    (0..side * side).map(|i| values[i].unwrap_or(coarse[i / side / 2 * half + i % side / 2])).collect()
}
