//! What is put where a plane knows nothing, so that it costs nothing and does not bleed.
//!
//! A node knows few pixels, and what its planes hold elsewhere is not shown. Left as it is, it would be encoded all the
//! same; put to black, its edge would be, and would ring into what is shown. So macroblocks without a known pixel are one
//! constant, always the same, which the codec skips; in mixed ones each unknown sample continues the known ones, as in
//! MPEG-4's repetitive padding of objects of any shape (ISO/IEC 14496-2, 7.6.1): first along rows, then along columns.
//!
//! Limits: deblocking may still carry up to three samples over the edge between two macroblocks, by less than the
//! quantiser's step. Cost: only mixed macroblocks are padded.

/// Luma, blue and red of a macroblock without a known pixel: a dark grey, near the mean of what is around it.
pub const NOTHING: [u8; 3] = [64, 128, 128];

/// Continues the known samples of a block to all of it, if there is one.
pub fn extend<const SIDE: usize>(samples: &mut [[u8; SIDE]; SIDE], known: &[[bool; SIDE]; SIDE]) {
    let mut has_known = [false; SIDE];
    for ((row, known), has_known) in samples.iter_mut().zip(known).zip(&mut has_known) {
        *has_known = continue_along(row, known);
    }
    if has_known.contains(&false) && has_known.contains(&true) {
        // Whole rows at once: each column has the same gaps.
        let rows = *samples;
        for (at, row) in samples.iter_mut().enumerate().filter(|(at, _)| !has_known[*at]) {
            let before = (0..at).rev().find(|&before| has_known[before]);
            let after = (at + 1..SIDE).find(|&after| has_known[after]);
            let (before, after) = (before.or(after).unwrap_or(at), after.or(before).unwrap_or(at));
            for ((sample, &before), &after) in row.iter_mut().zip(&rows[before]).zip(&rows[after]) {
                *sample = between(before, after);
            }
        }
    }
}

/// Fills the gaps of a row: with the mean of both their ends, or with the one that there is. False where there is none.
fn continue_along<const SIDE: usize>(row: &mut [u8; SIDE], known: &[bool; SIDE]) -> bool {
    let Some(first) = known.iter().position(|&known| known) else { return false };
    let begin = row[first];
    row[..first].fill(begin);
    let mut last = first;
    for at in first + 1..SIDE {
        if known[at] {
            let value = between(row[last], row[at]);
            row[last + 1..at].fill(value);
            last = at;
        }
    }
    let end = row[last];
    row[last + 1..].fill(end);
    true
}

fn between(one: u8, other: u8) -> u8 {
    ((u16::from(one) + u16::from(other)) / 2) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(known_at: &[(usize, usize, u8)]) -> [[u8; 8]; 8] {
        let mut samples = [[99; 8]; 8];
        let mut known = [[false; 8]; 8];
        for &(row, column, value) in known_at {
            samples[row][column] = value;
            known[row][column] = true;
        }
        extend(&mut samples, &known);
        samples
    }

    #[test]
    fn one_sample_fills_its_block() {
        assert_eq!(filled(&[(3, 5, 17)]), [[17; 8]; 8]);
    }

    #[test]
    fn gaps_have_the_mean_of_their_ends() {
        let rows = filled(&[(2, 1, 10), (2, 6, 20), (6, 0, 40)]);
        assert_eq!(rows[2], [10, 10, 15, 15, 15, 15, 20, 20]);
        assert_eq!(rows[6], [40; 8]);
        assert_eq!(rows[0], rows[2]);
        assert_eq!(rows[7], rows[6]);
        assert_eq!(rows[4], [25, 25, 27, 27, 27, 27, 30, 30]);
    }

    #[test]
    fn what_is_known_stays_and_nothing_else_is_read() {
        let at: Vec<_> = (0..8).flat_map(|row| (0..8).map(move |column| (row, column))).collect();
        let chosen: Vec<_> =
            at.iter().filter(|(row, column)| row * 3 % 5 > column % 4).map(|&(r, c)| (r, c, 7)).collect();
        assert_eq!(filled(&chosen), [[7; 8]; 8]);
        assert_eq!(filled(&[]), [[99; 8]; 8], "nothing to continue");
    }
}
