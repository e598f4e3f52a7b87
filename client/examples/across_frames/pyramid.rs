//! Bits of a plane coded as an interpolating pyramid, alone or with a guess from the frame before.
//!
//! A grid of every 16th sample, then levels of centres and edge midpoints, each predicted from four decoded neighbours;
//! residuals are whole steps. Two figures: zstd at level 1 over one byte per residual, and the entropy of the residuals
//! of each level within eight classes of neighbourhood, which is what an entropy coder with contexts comes close to.

/// How a guess is used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Use {
    /// Not at all.
    Alone,
    /// Wherever there is one.
    Always,
    /// Where the neighbours lie more than four steps apart; elsewhere the mean of both, where they agree.
    AtEdges,
}

impl Use {
    pub(crate) const ALL: [Use; 3] = [Use::Alone, Use::Always, Use::AtEdges];
}

/// Bits by either measure.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Bits {
    pub(crate) zstd: f64,
    pub(crate) entropy: f64,
}

impl std::ops::AddAssign for Bits {
    fn add_assign(&mut self, other: Bits) {
        self.zstd += other.zstd;
        self.entropy += other.entropy;
    }
}

/// A plane to be coded: values in steps, of which half a step may be lost, or none where they are `whole` numbers.
pub(crate) struct Plane<'a> {
    pub(crate) side: usize,
    pub(crate) values: &'a [f32],
    pub(crate) defined: &'a [bool],
    pub(crate) guess: &'a [Option<f32>],
    pub(crate) whole: bool,
}

struct Coder<'a> {
    plane: &'a Plane<'a>,
    how: Use,
    decoded: Vec<f32>,
    /// Class of neighbourhood and residual of each sample of the level.
    residuals: Vec<(u8, i32)>,
}

impl Coder<'_> {
    fn sample(&mut self, pixel: usize, inter: f32, spread: f32) {
        let guess = self.plane.guess[pixel].filter(|_| self.how != Use::Alone);
        let predicted = match guess {
            Some(guess) if self.how == Use::Always || spread > 4.0 => guess,
            Some(guess) if (guess - inter).abs() < 3.0 => (guess + inter) * 0.5,
            _ => inter,
        };
        let grid = if self.plane.whole { 1.0 } else { 64.0 };
        let predicted = (predicted * grid).round() / grid;
        self.decoded[pixel] = predicted;
        if self.plane.defined[pixel] {
            let residual = (self.plane.values[pixel] - predicted).round();
            let class = [1.0, 4.0, 16.0].iter().filter(|&&limit| spread > limit).count() as u8;
            self.residuals.push((class + if guess.is_some() { 4 } else { 0 }, residual as i32));
            self.decoded[pixel] += residual;
        }
    }

    fn end_level(&mut self, bytes: &mut Vec<u8>) -> f64 {
        for &(_, residual) in &self.residuals {
            let zigzag = ((residual << 1) ^ (residual >> 31)) as u32;
            match u8::try_from(zigzag) {
                Ok(byte) if byte < 255 => bytes.push(byte),
                _ => {
                    bytes.push(255);
                    bytes.extend(zigzag.to_le_bytes());
                }
            }
        }
        self.residuals.sort_unstable();
        let entropy = |class: &[(u8, i32)]| {
            let size = class.len() as f64;
            class.chunk_by(|a, b| a == b).map(|run| run.len() as f64 * (size / run.len() as f64).log2()).sum::<f64>()
        };
        let bits = self.residuals.chunk_by(|a, b| a.0 == b.0).map(entropy).sum();
        self.residuals.clear();
        bits
    }
}

/// Bits of a plane.
pub(crate) fn bits(plane: &Plane<'_>, how: Use) -> Bits {
    let side = plane.side;
    let mut coder = Coder { plane, how, decoded: vec![0.0; side * side], residuals: Vec::new() };
    let mut bytes = Vec::new();
    let mut stride = 16;
    for y in (0..side).step_by(stride) {
        for x in (0..side).step_by(stride) {
            let at = |y: usize, x: usize| coder.decoded[y * side + x];
            let inter = match (y, x) {
                (0, 0) => 0.0,
                (0, _) => at(0, x - stride),
                (_, 0) => at(y - stride, 0),
                _ => at(y, x - stride) + at(y - stride, x) - at(y - stride, x - stride),
            };
            coder.sample(y * side + x, inter, f32::INFINITY);
        }
    }
    let mut entropy = coder.end_level(&mut bytes);
    while stride > 1 {
        let half = stride / 2;
        for (first_y, first_x) in [(half, half), (0, half), (half, 0)] {
            for y in (first_y..side).step_by(stride) {
                for x in (first_x..side).step_by(stride) {
                    let before = |v: usize| if v >= half { v - half } else { v + half };
                    let after = |v: usize| if v + half < side { v + half } else { v - half };
                    let at = |y: usize, x: usize| coder.decoded[y * side + x];
                    let (up, down, left, right) = (before(y), after(y), before(x), after(x));
                    let [a, b, c, d] = if first_y == first_x {
                        [at(up, left), at(down, right), at(up, right), at(down, left)]
                    } else {
                        [at(y, left), at(y, right), at(up, x), at(down, x)]
                    };
                    let (first, second) = ((a - b).abs(), (c - d).abs());
                    let inter = match first - second {
                        apart if apart.abs() < 1.0 => (a + b + c + d) * 0.25,
                        apart if apart < 0.0 => (a + b) * 0.5,
                        _ => (c + d) * 0.5,
                    };
                    let spread = a.max(b).max(c.max(d)) - a.min(b).min(c.min(d));
                    coder.sample(y * side + x, inter, spread);
                }
            }
        }
        entropy += coder.end_level(&mut bytes);
        stride = half;
    }
    Bits { zstd: zstd_bits(&bytes), entropy }
}

/// Bits after zstd at level 1; memory is enough, so it does not fail.
pub(crate) fn zstd_bits(bytes: &[u8]) -> f64 {
    zstd::bulk::compress(bytes, 1).map_or(f64::NAN, |coded| 8.0 * coded.len() as f64)
}
