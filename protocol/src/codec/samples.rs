//! Integer planes: predict from the neighbours, fold the sign, pack the bits. zstd follows, once for all
//! channels of a plane.
//!
//! Two predictors: the gradient `a + b - c`, exact on planes (Weinberger et al. 1996 name it the planar
//! predictor), for depth, whose inverse is planar in screen space, and for normals; and their median edge
//! detector (LOCO-I) for colour, where the gradient would double the noise. Residuals are taken modulo 2^bits, so every
//! value has a residual and every residual a value. A sample that is undefined is replaced by its own
//! prediction: it costs nothing and bleeds nowhere.

use super::bits::{BitReader, BitWriter};

/// What a sample is predicted from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Predictor {
    /// left + up - upper left.
    Gradient,
    /// Median edge detector.
    Median,
}

/// How folded residuals become bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// Runs of 16 with a width of their own: best where most residuals are tiny and clean.
    Runs,
    /// Bytes by significance, lowest plane first: what entropy coding likes for noisy residuals.
    Bytes,
}

/// Residuals per run; each run spends `WIDTH_BITS` on its width.
const RUN: usize = 16;
const WIDTH_BITS: usize = 5;

/// Largest width of a sample.
pub const MAX_BITS: usize = 24;

/// The most bytes that `samples` of `bits` can take when packed either way.
pub fn max_packed_bytes(samples: usize, bits: usize) -> usize {
    (samples.div_ceil(RUN) * (WIDTH_BITS + RUN * bits)).div_ceil(8).max(samples * bits.div_ceil(8))
}

/// Replaces samples by folded residuals in `residuals`. Where `defined` is false the sample itself becomes
/// the prediction; without `defined` every sample counts.
pub fn predict(
    codes: &mut [u32],
    width: usize,
    bits: usize,
    predictor: Predictor,
    defined: Option<&[bool]>,
    residuals: &mut Vec<u32>,
) {
    residuals.clear();
    residuals.resize(codes.len(), 0);
    let nothing_above = vec![0; width];
    for row_start in (0..codes.len()).step_by(width) {
        let (above, row) = codes.split_at_mut(row_start);
        let above = if row_start == 0 { &nothing_above } else { &above[row_start - width..] };
        let row = &mut row[..width];
        if let Some(defined) = defined {
            let defined = &defined[row_start..row_start + width];
            match predictor {
                Predictor::Gradient => fill_undefined(row, above, bits, gradient, defined),
                Predictor::Median => fill_undefined(row, above, bits, median, defined),
            }
            if !defined.contains(&true) {
                continue;
            }
        }
        let residuals = &mut residuals[row_start..row_start + width];
        match predictor {
            Predictor::Gradient => row_residuals(row, above, bits, gradient, residuals),
            Predictor::Median => row_residuals(row, above, bits, median, residuals),
        }
    }
}

/// Gives undefined samples their own prediction, whose residual is 0.
#[inline(always)]
fn fill_undefined(
    row: &mut [u32],
    above: &[u32],
    bits: usize,
    predicted: impl Fn(u32, u32, u32) -> u32,
    defined: &[bool],
) {
    // From the start of a row either predictor repeats the row above.
    let start = defined.iter().position(|&defined| defined).unwrap_or(row.len());
    row[..start].copy_from_slice(&above[..start]);
    let (mut left, mut upper_left) = before(row, above, start);
    for ((code, &up), &defined) in row[start..].iter_mut().zip(&above[start..]).zip(&defined[start..]) {
        if !defined {
            *code = predicted(left, up, upper_left) & low_bits(bits);
        }
        (left, upper_left) = (*code, up);
    }
}

/// Left and upper left of the sample at `x`. Above a strip everything is 0, and the column before the first
/// repeats the first one above it, so that the first sample of a row is predicted from above.
fn before(row: &[u32], above: &[u32], x: usize) -> (u32, u32) {
    x.checked_sub(1).map_or((above[0], above[0]), |x| (row[x], above[x]))
}

/// Left + up - upper left, modulo 2^32.
#[inline(always)]
fn gradient(left: u32, up: u32, upper_left: u32) -> u32 {
    left.wrapping_add(up).wrapping_sub(upper_left)
}

/// The median of left, up and gradient, as minima and maxima of signed integers: samples have at most 24 bits.
#[inline(always)]
fn median(left: u32, up: u32, upper_left: u32) -> u32 {
    let gradient = gradient(left, up, upper_left) as i32;
    let (left, up) = (left as i32, up as i32);
    gradient.min(left.max(up)).max(left.min(up)) as u32
}

/// Residuals of a row whose samples are all known, so that no sample waits for the one before it.
#[inline(always)]
fn row_residuals(
    row: &[u32],
    above: &[u32],
    bits: usize,
    predicted: impl Fn(u32, u32, u32) -> u32,
    residuals: &mut [u32],
) {
    residuals[0] = fold(row[0].wrapping_sub(above[0]), bits);
    let here = row[1..].iter().zip(&above[1..]);
    let before = row.iter().zip(above);
    for ((residual, (&code, &up)), (&left, &upper_left)) in residuals[1..].iter_mut().zip(here).zip(before) {
        *residual = fold(code.wrapping_sub(predicted(left, up, upper_left)), bits);
    }
}

/// The inverse of [`predict`], in place: residuals of one or more channels become samples. Each sample waits
/// for the one before it, so channels go side by side to fill the time.
pub fn reconstruct<const CHANNELS: usize>(
    mut channels: [&mut [u32]; CHANNELS],
    width: usize,
    bits: usize,
    predictor: Predictor,
) {
    let nothing_above = vec![0; width];
    let samples = channels.iter().map(|channel| channel.len()).min().unwrap_or(0);
    for row_start in (0..samples).step_by(width) {
        let rows = channels.each_mut().map(|channel| {
            let (above, row) = channel.split_at_mut(row_start);
            let above = if row_start == 0 { &nothing_above } else { &above[row_start - width..] };
            (&mut row[..width], &above[..width])
        });
        match predictor {
            Predictor::Gradient => reconstruct_rows(rows, width, bits, gradient),
            Predictor::Median => reconstruct_rows(rows, width, bits, median),
        }
    }
}

#[inline(always)]
fn reconstruct_rows<const CHANNELS: usize>(
    mut rows: [(&mut [u32], &[u32]); CHANNELS],
    width: usize,
    bits: usize,
    predicted: impl Fn(u32, u32, u32) -> u32,
) {
    // From the start of a row either predictor repeats the row above.
    let as_predicted = |row: &[u32]| row.iter().position(|&residual| residual != 0).unwrap_or(width);
    let start = rows.iter().map(|(row, _)| as_predicted(row)).min().unwrap_or(width);
    for (row, above) in &mut rows {
        row[..start].copy_from_slice(&above[..start]);
    }
    let mask = low_bits(bits);
    let mut before = rows.each_ref().map(|(row, above)| before(row, above, start));
    for x in start..width {
        for ((row, above), (left, upper_left)) in rows.iter_mut().zip(&mut before) {
            let up = above[x];
            *left = predicted(*left, up, *upper_left).wrapping_add(unfold(row[x])) & mask;
            *upper_left = up;
            row[x] = *left;
        }
    }
}

/// Signed residual modulo 2^bits to unsigned: 0, -1, 1, -2, … become 0, 1, 2, 3, …
#[inline(always)]
fn fold(residual: u32, bits: usize) -> u32 {
    let shift = 32 - bits;
    let signed = ((residual << shift) as i32) >> shift;
    ((signed << 1) ^ (signed >> 31)) as u32
}

#[inline(always)]
fn unfold(folded: u32) -> u32 {
    (folded >> 1) ^ (folded & 1).wrapping_neg()
}

const fn low_bits(bits: usize) -> u32 {
    (1 << bits) - 1
}

/// Appends folded residuals of `bits` to `bytes`.
pub fn pack(residuals: &[u32], bits: usize, packing: Packing, bytes: Vec<u8>) -> Vec<u8> {
    match packing {
        Packing::Runs => {
            let mut writer = BitWriter::append_to(bytes);
            for run in residuals.chunks(RUN) {
                let all = run.iter().fold(0, |all, &residual| all | residual);
                let width = (32 - all.leading_zeros()) as usize;
                writer.write(width as u64, WIDTH_BITS);
                if width > 0 {
                    run.iter().for_each(|&residual| writer.write(u64::from(residual), width));
                }
            }
            writer.finish()
        }
        Packing::Bytes => {
            let mut bytes = bytes;
            for significance in 0..bits.div_ceil(8) {
                bytes.extend(residuals.iter().map(|&residual| (residual >> (8 * significance)) as u8));
            }
            bytes
        }
    }
}

/// Reads `count` residuals of `bits` from the front of `bytes` and returns what follows them; `None` where
/// the bytes end early or a residual is wider than `bits`.
pub fn unpack<'a>(
    bytes: &'a [u8],
    count: usize,
    bits: usize,
    packing: Packing,
    residuals: &mut Vec<u32>,
) -> Option<&'a [u8]> {
    residuals.clear();
    residuals.reserve(count);
    match packing {
        Packing::Runs => {
            let mut reader = BitReader::new(bytes);
            let mut used_bits = 0;
            while residuals.len() < count {
                let width = reader.read(WIDTH_BITS)? as usize;
                if width > bits {
                    return None;
                }
                let run = RUN.min(count - residuals.len());
                used_bits += WIDTH_BITS + run * width;
                if width == 0 {
                    residuals.resize(residuals.len() + run, 0);
                    continue;
                }
                for _ in 0..run {
                    residuals.push(reader.read(width)? as u32);
                }
            }
            bytes.get(used_bits.div_ceil(8)..)
        }
        Packing::Bytes => {
            let planes = bits.div_ceil(8);
            let (own, rest) = bytes.split_at_checked(count * planes)?;
            residuals.extend(own[..count].iter().map(|&byte| u32::from(byte)));
            for significance in 1..planes {
                let plane = &own[significance * count..(significance + 1) * count];
                for (residual, &byte) in residuals.iter_mut().zip(plane) {
                    *residual |= u32::from(byte) << (8 * significance);
                }
            }
            residuals.iter().all(|&residual| residual <= low_bits(bits)).then_some(rest)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn plane() -> impl Strategy<Value = (usize, usize, Vec<u32>, Vec<bool>)> {
        (1..=MAX_BITS, 1..40_usize, 1..9_usize).prop_flat_map(|(bits, width, rows)| {
            let codes = prop::collection::vec(0..=low_bits(bits), width * rows);
            let defined = prop::collection::vec(any::<bool>(), width * rows);
            (Just(bits), Just(width), codes, defined)
        })
    }

    proptest! {
        #[test]
        fn every_defined_sample_comes_back((bits, width, codes, defined) in plane(), gradient in any::<bool>(), runs in any::<bool>()) {
            let predictor = if gradient { Predictor::Gradient } else { Predictor::Median };
            let packing = if runs { Packing::Runs } else { Packing::Bytes };
            let (mut filled, mut residuals) = (codes.clone(), Vec::new());
            predict(&mut filled, width, bits, predictor, Some(&defined), &mut residuals);
            let mut bytes = pack(&residuals, bits, packing, Vec::new());
            prop_assert!(bytes.len() <= max_packed_bytes(codes.len(), bits));
            bytes.push(0xa5);

            let mut back = Vec::new();
            prop_assert_eq!(unpack(&bytes, codes.len(), bits, packing, &mut back), Some(&[0xa5_u8][..]));
            reconstruct([&mut back], width, bits, predictor);
            prop_assert_eq!(&back, &filled);
            for index in 0..codes.len() {
                prop_assert!(!defined[index] || back[index] == codes[index]);
            }
        }

        #[test]
        fn chopped_bytes_are_refused((bits, width, codes, _) in plane(), runs in any::<bool>()) {
            let packing = if runs { Packing::Runs } else { Packing::Bytes };
            let (mut codes, mut residuals) = (codes, Vec::new());
            predict(&mut codes, width, bits, Predictor::Gradient, None, &mut residuals);
            let bytes = pack(&residuals, bits, packing, Vec::new());
            for end in 0..bytes.len() {
                prop_assert_eq!(unpack(&bytes[..end], codes.len(), bits, packing, &mut residuals), None);
            }
        }
    }

    /// LOCO-I as it is written in the literature, by cases.
    fn median_by_cases(left: u32, up: u32, upper_left: u32) -> u32 {
        let (low, high) = (left.min(up), left.max(up));
        match upper_left {
            _ if upper_left >= high => low,
            _ if upper_left <= low => high,
            _ => left + up - upper_left,
        }
    }

    proptest! {
        #[test]
        fn the_median_is_the_one_by_cases(left in 0..=0xff_ffff_u32, up in 0..=0xff_ffff_u32, upper_left in 0..=0xff_ffff_u32) {
            prop_assert_eq!(median(left, up, upper_left), median_by_cases(left, up, upper_left));
        }

        /// The row form against one sample at a time, and three channels at once against each alone.
        #[test]
        fn rows_at_once_are_equal_to_samples_one_by_one((bits, width, codes, defined) in plane(), gradient in any::<bool>()) {
            let predictor = if gradient { Predictor::Gradient } else { Predictor::Median };
            let (mut filled, mut residuals) = (codes.clone(), Vec::new());
            predict(&mut filled, width, bits, predictor, Some(&defined), &mut residuals);
            let nothing_above = vec![0; width];
            let mut plain = codes;
            for start in (0..plain.len()).step_by(width) {
                for x in 0..width {
                    let above = if start == 0 { &nothing_above[..] } else { &plain[start - width..start] };
                    let (left, upper_left) = before(&plain[start..], above, x);
                    let predicted = match predictor {
                        Predictor::Gradient => left.wrapping_add(above[x]).wrapping_sub(upper_left),
                        Predictor::Median => median_by_cases(left, above[x], upper_left),
                    } & low_bits(bits);
                    if !defined[start + x] {
                        plain[start + x] = predicted;
                    }
                    let residual = plain[start + x].wrapping_sub(predicted) & low_bits(bits);
                    prop_assert_eq!(residuals[start + x], fold(residual, bits));
                }
            }
            prop_assert_eq!(&filled, &plain);

            let [mut a, mut b, mut c] = [residuals.clone(), residuals.iter().rev().copied().collect(), residuals.clone()];
            let mut b_alone: Vec<u32> = b.clone();
            reconstruct([&mut a, &mut b, &mut c], width, bits, predictor);
            reconstruct([&mut b_alone], width, bits, predictor);
            prop_assert_eq!(&a, &filled);
            prop_assert_eq!(&b, &b_alone);
            prop_assert_eq!(&c, &filled);
        }
    }

    #[test]
    fn residuals_fold_to_the_smallest_numbers() {
        for bits in 1..=10 {
            for residual in 0..1_u32 << bits {
                let folded = fold(residual, bits);
                assert!(folded <= low_bits(bits));
                assert_eq!(unfold(folded) & low_bits(bits), residual);
            }
        }
        assert_eq!([0, 255, 1, 254, 2, 128].map(|residual| fold(residual, 8)), [0, 1, 2, 3, 4, 255]);
    }

    #[test]
    fn a_tilted_plane_costs_nothing_but_its_edges() {
        let width = 64;
        let mut codes: Vec<u32> =
            (0..64 * 64).map(|index| 1000 + 3 * (index % width) as u32 + 7 * (index / width) as u32).collect();
        let mut residuals = Vec::new();
        predict(&mut codes, width, 16, Predictor::Gradient, None, &mut residuals);
        for (index, &residual) in residuals.iter().enumerate() {
            let inside = index % width > 0 && index / width > 0;
            assert!(!inside || residual == 0, "sample {index}");
        }
    }
}
