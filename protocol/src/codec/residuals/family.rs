//! The family of distributions of residuals: [`ZEROS`] for how often 0 is, [`TAILS`] for how fast larger ones die out.
//!
//! Residuals of a smooth plane die out geometrically (LOCO-I, Weinberger et al. 1996, builds on it). Those of a plane with
//! noise and edges in one context are of two kinds, and two geometric series together are a better fit: without them and
//! without symbols for magnitudes above 132, the extents of a cloud's segments took a fifth more bytes
//! (docs/measurements/2026-11-22-codec.md).
//!
//! Integers only, so that both ends have the same parts. Cost: a member is made once, when it is first named, in some 10
//! microseconds, and holds 4 KB.

/// A distribution has 2^12 parts.
pub(super) const SCALE_BITS: u32 = 12;
pub(super) const SCALE: u32 = 1 << SCALE_BITS;
/// 0; -1, 1, … -6, 6; ten buckets of larger ones; all others.
pub(super) const SYMBOLS: usize = 24;
pub(super) const SINGLES: usize = 6;
pub(super) const ESCAPE: usize = SYMBOLS - 1;
/// The smallest magnitude in each bucket; bucket `b` holds `2^(b + 1)` of them.
pub(super) const BUCKETS: [u32; 10] = [7, 9, 13, 21, 37, 69, 133, 261, 517, 1029];

/// Parts of [`SCALE`] that 0 has.
pub(super) const ZEROS: [u16; 24] = [
    64, 160, 320, 512, 768, 1024, 1365, 1700, 2048, 2400, 2730, 3072, 3300, 3500, 3680, 3800, 3900, 3960, 4010, 4045,
    4065, 4080, 4088, 4092,
];
/// How much rarer each magnitude is than the one before, in parts of 2^16: of a first series and of a second that starts at
/// 1/64 of the first; 0 is none.
pub(super) const TAILS: [[u64; 2]; 10] = [
    [8192, 0],
    [20480, 0],
    [38400, 0],
    [52480, 0],
    [60160, 0],
    [64000, 0],
    [65075, 0],
    [65433, 0],
    [38400, 64000],
    [60160, 65280],
];

/// Distributions there are.
pub(super) const FAMILY: usize = ZEROS.len() * TAILS.len();

/// A part of the scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Interval {
    pub(super) start: u16,
    pub(super) width: u16,
}

/// Probabilities of the symbols.
#[derive(Clone, Debug)]
pub(super) struct Distribution {
    pub(super) intervals: [Interval; SYMBOLS],
    pub(super) symbol_of_slot: Vec<u8>,
    /// What a residual of each symbol takes.
    bits: [f32; SYMBOLS],
}

impl Distribution {
    /// Nothing but 0, which costs no bits.
    fn always_zero() -> Distribution {
        let mut intervals = [Interval::default(); SYMBOLS];
        intervals[0].width = SCALE as u16;
        Distribution { intervals, symbol_of_slot: vec![0; SCALE as usize], bits: [0.0; SYMBOLS] }
    }

    /// Member `index` of the family.
    pub(super) fn of_family(index: usize) -> Distribution {
        let (zero, [first, second]) = (ZEROS[index / TAILS.len()], TAILS[index % TAILS.len()]);
        // Masses of magnitudes in fixed point: integers, so that they are the same everywhere.
        let mut of_first = 1_u64 << 40;
        let mut of_second = if second > 0 { of_first >> 6 } else { 0 };
        let mut masses = [0_u64; SYMBOLS];
        let largest_in_bucket = 2 * BUCKETS[BUCKETS.len() - 1] - 6;
        for magnitude in 1..=largest_in_bucket + 400 {
            let mass = of_first + of_second;
            match symbol_of(magnitude as i32) {
                symbol if symbol <= 2 * SINGLES => {
                    masses[symbol - 1] += mass / 2;
                    masses[symbol] += mass / 2;
                }
                symbol => masses[symbol] += mass,
            }
            of_first = (of_first * first) >> 16;
            of_second = (of_second * second) >> 16;
        }
        let total: u64 = masses.iter().sum();
        // The escape is always possible.
        let rest = u64::from(SCALE) - u64::from(zero) - 1;
        let mut widths = masses.map(|mass| (u128::from(mass) * u128::from(rest) / u128::from(total)) as u32);
        widths[ESCAPE] += 1;
        widths[0] = SCALE - widths[1..].iter().sum::<u32>();
        let mut intervals = [Interval::default(); SYMBOLS];
        let mut symbol_of_slot = Vec::with_capacity(SCALE as usize);
        for (symbol, (interval, width)) in intervals.iter_mut().zip(widths).enumerate() {
            *interval = Interval { start: symbol_of_slot.len() as u16, width: width as u16 };
            symbol_of_slot.resize(symbol_of_slot.len() + width as usize, symbol as u8);
        }
        let bits = bits_of(&intervals);
        Distribution { intervals, symbol_of_slot, bits }
    }
}

/// Bits that a residual of each symbol takes, those behind the symbol left out.
fn bits_of(intervals: &[Interval; SYMBOLS]) -> [f32; SYMBOLS] {
    let bits = |parts: u16| SCALE_BITS as f32 - f32::from(parts).log2();
    let escaped = bits(intervals[ESCAPE].width);
    std::array::from_fn(|symbol| match intervals[symbol].width {
        // By the escape: its length, itself, its sign.
        0 => escaped + 6.0 + symbol as f32 / 3.0,
        width => bits(width),
    })
}

/// How many residuals of each symbol there are.
pub(super) struct Counted([f32; SYMBOLS]);

impl From<&[u32; SYMBOLS]> for Counted {
    fn from(counts: &[u32; SYMBOLS]) -> Counted {
        Counted(counts.map(|count| count as f32))
    }
}

impl Counted {
    /// What all of them take.
    pub(super) fn bits_by(&self, distribution: &Distribution) -> f32 {
        self.0.iter().zip(&distribution.bits).map(|(count, bits)| count * bits).sum()
    }
}

/// The symbol of a residual.
pub(super) fn symbol_of(residual: i32) -> usize {
    let magnitude = residual.unsigned_abs();
    match magnitude {
        0 => 0,
        1..=6 => 2 * magnitude as usize - usize::from(residual < 0),
        // A bucket is as wide as the distance of its start from 5.
        7..=2052 => 2 * SINGLES + (magnitude - 5).ilog2() as usize,
        _ => ESCAPE,
    }
}

/// The family, each member made when it is first needed.
#[derive(Debug)]
pub(super) struct Family {
    members: Vec<Option<Distribution>>,
    always_zero: Distribution,
}

impl Default for Family {
    fn default() -> Family {
        Family { members: vec![None; FAMILY], always_zero: Distribution::always_zero() }
    }
}

impl Family {
    pub(super) fn prepare(&mut self, index: u8) -> &Distribution {
        let index = usize::from(index);
        self.members[index].get_or_insert_with(|| Distribution::of_family(index))
    }

    /// A member that is there; without an index, the distribution of nothing but 0.
    pub(super) fn member(&self, index: Option<u8>) -> &Distribution {
        index.and_then(|index| self.members[usize::from(index)].as_ref()).unwrap_or(&self.always_zero)
    }
}
