//! Tone mapping by one look-up per channel, to the bit what [`warplight_protocol::tone::srgb8_from_linear`] says.
//!
//! The upper bits of a float, its exponent and 7 of the mantissa, name an interval so short that at most one code
//! begins inside it: the table holds the code before and where that one begins. 13 KiB, 6 instructions.

use warplight_protocol::tone::srgb8_from_linear;

/// Bits below the intervals.
const SHIFT: u32 = 16;
/// The first interval starts at 2^-13, below which all is black: code 1 begins at 1.5e-4.
const FIRST: u32 = (127 - 13) << 7;
const INTERVALS: usize = 13 << 7;

/// The table.
#[derive(Clone, Debug)]
pub(super) struct ToneTable {
    /// Where the next code begins (as bits), and the code before it.
    intervals: Vec<(u32, u32)>,
}

impl Default for ToneTable {
    fn default() -> ToneTable {
        let intervals = (0..=INTERVALS as u32).map(|interval| {
            let first = (FIRST + interval) << SHIFT;
            let code = |bits: u32| u32::from(srgb8_from_linear(f32::from_bits(bits)));
            let (mut below, mut at) = (first, first + (1 << SHIFT));
            let before = code(below);
            // Positive floats order like their bits.
            while at - below > 1 {
                let middle = below + (at - below) / 2;
                if code(middle) > before { at = middle } else { below = middle }
            }
            (at, before)
        });
        ToneTable { intervals: intervals.collect() }
    }
}

impl ToneTable {
    /// The display code of a linear channel value.
    #[inline(always)]
    pub(super) fn srgb8_from_linear(&self, linear: f32) -> u8 {
        const BLACK: f32 = f32::from_bits(FIRST << SHIFT);
        // What is not a number is black.
        let value = if linear > BLACK { linear } else { BLACK };
        let bits = (if value < 1.0 { value } else { 1.0 }).to_bits();
        let (next, before) = self.intervals[((bits >> SHIFT) - FIRST) as usize];
        (before + u32::from(bits >= next)) as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_equals_the_formula() {
        let table = ToneTable::default();
        let starts = table.intervals.iter().flat_map(|&(next, _)| [next - 1, next, next + 1]).map(f32::from_bits);
        let steps = (0..=400_000).map(|step| step as f32 / 390_000.0);
        let extremes = [f32::NAN, f32::NEG_INFINITY, f32::INFINITY, -0.0, 1e-40, 1e8, 1.2e-4, 1e-4];
        for value in starts.chain(steps).chain(extremes) {
            assert_eq!(table.srgb8_from_linear(value), srgb8_from_linear(value), "{value}");
        }
    }

    #[test]
    fn no_two_codes_begin_in_one_interval() {
        let table = ToneTable::default();
        let starts: std::collections::BTreeSet<u32> =
            table.intervals.windows(2).filter(|pair| pair[1].1 > pair[0].1).map(|pair| pair[0].0).collect();
        assert_eq!(starts.len(), 255);
        assert!(table.intervals.windows(2).all(|pair| pair[1].1 - pair[0].1 <= 1));
    }
}
