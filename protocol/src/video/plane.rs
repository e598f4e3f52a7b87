//! A plane of radiance to a picture, and back.

use super::color::{chroma, luma, rgb, upsample};
use super::decoder::Decoded;
use super::fill::{NOTHING, extend};
use super::{Picture, Placement};
use crate::ImageSize;
use crate::frame::ColorFormat;

const BLOCK: usize = super::Canvas::BLOCK_PX;
const HALF: usize = BLOCK / 2;

/// Writes a plane of radiance into a picture of the placement's canvas: codes of `color`, 8 bits, whose largest is
/// `white`. Where `known` is given, only pixels at which it is above zero are of the plane: a node's distances, a
/// layer's optical depths.
pub fn quantise(
    color: ColorFormat,
    white: f32,
    size: ImageSize,
    radiance: [&[f32]; 3],
    known: Option<&[f32]>,
    placement: &Placement,
    picture: &mut Picture,
) {
    if picture.canvas != placement.canvas {
        *picture = Picture::new(placement.canvas);
    }
    let source = Source { white, size, radiance, known, place: [placement.x.into(), placement.y.into()] };
    // A function of its own for each format, so that neither branches by pixel.
    match color {
        ColorFormat::Linear8 => source.write(|value, white| ColorFormat::Linear8.quantise(value, white), picture),
        ColorFormat::Srgb8 => source.write(|value, white| ColorFormat::Srgb8.quantise(value, white), picture),
        _ => source.write(|value, white| ColorFormat::Root8.quantise(value, white), picture),
    }
}

struct Source<'a> {
    white: f32,
    size: ImageSize,
    radiance: [&'a [f32]; 3],
    known: Option<&'a [f32]>,
    place: [usize; 2],
}

/// Codes of a macroblock, and which of its pixels are of the plane.
struct Block {
    codes: [[[u16; BLOCK]; BLOCK]; 3],
    known: [[bool; BLOCK]; BLOCK],
}

impl Source<'_> {
    #[inline(always)]
    fn write(&self, quantise: impl Fn(f32, f32) -> u16 + Copy, picture: &mut Picture) {
        let width = usize::from(picture.canvas.width);
        let mut block = Block { codes: [[[0; BLOCK]; BLOCK]; 3], known: [[false; BLOCK]; BLOCK] };
        for top in (0..usize::from(picture.canvas.height)).step_by(BLOCK) {
            for left in (0..width).step_by(BLOCK) {
                let known = self.known_in(left, top, &mut block.known);
                let is_whole = known == BLOCK * BLOCK;
                let mut luma_block = [[NOTHING[0]; BLOCK]; BLOCK];
                let mut chroma_block = [[[NOTHING[1]; HALF]; HALF], [[NOTHING[2]; HALF]; HALF]];
                if known > 0 {
                    self.codes_in(left, top, quantise, &mut block);
                    luma_of(&block, &mut luma_block);
                    if is_whole {
                        chroma_of_whole(&block, &mut chroma_block);
                    } else {
                        extend(&mut luma_block, &block.known);
                        chroma_of_mixed(&block, &mut chroma_block);
                    }
                }
                for (row, samples) in luma_block.iter().enumerate() {
                    let at = (top + row) * width + left;
                    picture.luma[at..at + BLOCK].copy_from_slice(samples);
                }
                for (plane, block) in picture.chroma.iter_mut().zip(&chroma_block) {
                    for (row, samples) in block.iter().enumerate() {
                        let at = (top / 2 + row) * (width / 2) + left / 2;
                        plane[at..at + HALF].copy_from_slice(samples);
                    }
                }
            }
        }
    }

    /// The part of a row of a macroblock that is of the frame: columns of the block, and where they begin in the plane.
    #[inline(always)]
    fn part(&self, left: usize, row: usize) -> Option<(std::ops::Range<usize>, usize)> {
        let (width, height) = (self.size.width as usize, self.size.height as usize);
        let y = row.checked_sub(self.place[1]).filter(|&y| y < height)?;
        let begin = self.place[0].saturating_sub(left).min(BLOCK);
        let end = (self.place[0] + width).saturating_sub(left).min(BLOCK);
        (begin < end).then(|| (begin..end, y * width + left + begin - self.place[0]))
    }

    #[inline(always)]
    fn known_in(&self, left: usize, top: usize, known: &mut [[bool; BLOCK]; BLOCK]) -> usize {
        let mut count = 0;
        for (row, known) in known.iter_mut().enumerate() {
            *known = [false; BLOCK];
            let Some((columns, at)) = self.part(left, top + row) else { continue };
            let length = columns.len();
            match self.known {
                None => known[columns].fill(true),
                Some(plane) => {
                    for (known, &value) in known[columns].iter_mut().zip(&plane[at..at + length]) {
                        *known = value > 0.0;
                    }
                }
            }
            count += known.iter().map(|&known| usize::from(known)).sum::<usize>();
        }
        count
    }

    #[inline(always)]
    fn codes_in(&self, left: usize, top: usize, quantise: impl Fn(f32, f32) -> u16, block: &mut Block) {
        for row in 0..BLOCK {
            let Some((columns, at)) = self.part(left, top + row) else { continue };
            let length = columns.len();
            for (plane, codes) in self.radiance.iter().zip(&mut block.codes) {
                for (code, &value) in codes[row][columns.clone()].iter_mut().zip(&plane[at..at + length]) {
                    *code = quantise(value, self.white);
                }
            }
        }
    }
}

fn luma_of(block: &Block, out: &mut [[u8; BLOCK]; BLOCK]) {
    let [red, green, blue] = &block.codes;
    for (((out, red), green), blue) in out.iter_mut().zip(red).zip(green).zip(blue) {
        for column in 0..BLOCK {
            out[column] = luma([red[column], green[column], blue[column]]);
        }
    }
}

/// Chroma of the mean of four pixels.
fn chroma_of_whole(block: &Block, out: &mut [[[u8; HALF]; HALF]; 2]) {
    for row in 0..HALF {
        for column in 0..HALF {
            let mean = block.codes.each_ref().map(|codes| {
                let [upper, lower] = [&codes[2 * row], &codes[2 * row + 1]];
                let sum = upper[2 * column] + upper[2 * column + 1] + lower[2 * column] + lower[2 * column + 1];
                ((sum + 2) >> 2) as i16
            });
            let [blue, red] = chroma(mean);
            (out[0][row][column], out[1][row][column]) = (blue, red);
        }
    }
}

/// Chroma of the mean of the known ones of four pixels.
fn chroma_of_mixed(block: &Block, out: &mut [[[u8; HALF]; HALF]; 2]) {
    let mut known = [[false; HALF]; HALF];
    for (row, known) in known.iter_mut().enumerate() {
        for (column, known) in known.iter_mut().enumerate() {
            let mut count = 0;
            let mut sum = [0; 3];
            for (y, x) in [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(y, x)| (2 * row + y, 2 * column + x)) {
                if block.known[y][x] {
                    count += 1;
                    for (sum, codes) in sum.iter_mut().zip(&block.codes) {
                        *sum += codes[y][x];
                    }
                }
            }
            if count > 0 {
                *known = true;
                let [blue, red] = chroma(sum.map(|sum| ((sum + count / 2) / count) as i16));
                (out[0][row][column], out[1][row][column]) = (blue, red);
            }
        }
    }
    out.iter_mut().for_each(|plane| extend(plane, &known));
}

/// Writes the radiance of the frame in a decoded picture, known or not: finite and not negative, whatever it holds.
pub fn dequantise(
    color: ColorFormat,
    white: f32,
    size: ImageSize,
    decoded: &Decoded<'_>,
    placement: &Placement,
    radiance: [&mut [f32]; 3],
) {
    match color {
        ColorFormat::Linear8 => {
            read(size, decoded, placement, radiance, |code| ColorFormat::Linear8.dequantise(code.into(), white));
        }
        ColorFormat::Srgb8 => {
            read(size, decoded, placement, radiance, |code| ColorFormat::Srgb8.dequantise(code.into(), white));
        }
        _ => read(size, decoded, placement, radiance, |code| ColorFormat::Root8.dequantise(code.into(), white)),
    }
}

#[inline(always)]
fn read(
    size: ImageSize,
    decoded: &Decoded<'_>,
    placement: &Placement,
    radiance: [&mut [f32]; 3],
    dequantise: impl Fn(u8) -> f32,
) {
    let (width, height) = (size.width as usize, size.height as usize);
    let (left, top) = (usize::from(placement.x), usize::from(placement.y));
    let canvas = [usize::from(decoded.canvas.width), usize::from(decoded.canvas.height)];
    let mut vertical = Vec::new();
    let mut up = [Vec::new(), Vec::new()];
    let mut codes = [vec![0; width], vec![0; width], vec![0; width]];
    let [red, green, blue] = radiance;
    for y in 0..height {
        let row = top + y;
        let near = row / 2;
        let far = if row % 2 == 1 { (near + 1).min(canvas[1] / 2 - 1) } else { near.saturating_sub(1) };
        for ((samples, stride), up) in decoded.planes[1..].iter().zip(&mut up) {
            let chroma_row = |row: usize| &samples[row * stride..row * stride + canvas[0] / 2];
            upsample(chroma_row(near), chroma_row(far), &mut vertical, up);
        }
        let (samples, stride) = decoded.planes[0];
        let luma_row = &samples[row * stride + left..row * stride + left + width];
        let [from_blue, from_red] = up.each_ref().map(|up| &up[left..left + width]);
        let [red_codes, green_codes, blue_codes] = &mut codes;
        let pixels = red_codes.iter_mut().zip(green_codes.iter_mut()).zip(blue_codes.iter_mut());
        let samples = luma_row.iter().zip(from_blue).zip(from_red);
        for (((red, green), blue), ((&luma, &from_blue), &from_red)) in pixels.zip(samples) {
            [*red, *green, *blue] = rgb(luma, [from_blue, from_red]);
        }
        for (plane, codes) in [&mut *red, &mut *green, &mut *blue].into_iter().zip(&codes) {
            for (value, &code) in plane[y * width..(y + 1) * width].iter_mut().zip(codes) {
                *value = dequantise(code);
            }
        }
    }
}
