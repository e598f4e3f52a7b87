//! Residuals to bytes: range asymmetric numeral systems (rANS; Duda 2013), with static distributions that the sender
//! chooses per context.
//!
//! Residuals of a good predictor are nearly all 0, and how nearly is known beforehand from the samples that they were
//! predicted from. So each residual comes with a context, and each context of a plane with one of a family of
//! distributions ([`family`]), named by one byte, which is all the side information there is. A byte-wise entropy coder (the Huffman stage of zstd)
//! pays a bit for a symbol of any probability; this one pays what it is worth: a quarter of the bytes for depth, half for
//! colour (docs/measurements/2026-11-22-codec.md).
//!
//! Blocks of 16 residuals that are all 0 are skipped by one flag, which is what makes empty planes fast. A context whose
//! residuals are all 0 has no distribution, and costs nothing.
//!
//! All of it is integer arithmetic, so that both ends agree to the bit. States have 32 bits and are refilled by 16;
//! four of them take turns where there is much to code, so that one does not wait for another. The decoder ends in the
//! state that the encoder began with, or the bytes were not those that were sent.
//!
//! Cost: about 4 ns a residual in a block that is not empty, 0.3 in one that is.

mod family;

use super::DecodeError;
use family::{
    BUCKETS, Counted, Distribution, ESCAPE, FAMILY, Family, Interval, SCALE, SCALE_BITS, SINGLES, SYMBOLS, TAILS,
    ZEROS, symbol_of,
};

/// Where a state is refilled, and where every state of an encoder begins.
const LOWEST: u32 = 1 << 16;

/// Contexts of residuals that share a set of distributions.
pub(crate) const CONTEXTS: usize = 8;
/// Sets: one for the finest level, one for all others.
pub(crate) const SETS: usize = 2;
/// Residuals that one flag can skip.
const BLOCK: usize = 16;
/// Kinds of flags, by the largest context of a block.
const FLAGS: usize = 3;
/// Bytes of the masks that stand first: which of `SETS * (CONTEXTS + FLAGS)` have a distribution, and whether there is one
/// state instead of four.
const MASK_BYTES: usize = 3;
const ONE_LANE: u32 = 1 << 23;
/// Below so many symbols, three more states cost more than they save.
const FEW_SYMBOLS: usize = 1500;

/// Which distribution each context, and each kind of flag, has; none where all is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Choices {
    contexts: [Option<u8>; CONTEXTS],
    flags: [Option<u8>; FLAGS],
}

impl Choices {
    fn all(&mut self) -> impl Iterator<Item = (&mut Option<u8>, usize)> {
        let contexts = self.contexts.iter_mut().map(|choice| (choice, FAMILY));
        contexts.chain(self.flags.iter_mut().map(|choice| (choice, ZEROS.len())))
    }
}

/// The kind of flag of a block.
fn flag_of(contexts: &[u8]) -> usize {
    match contexts.iter().fold(0, |most, &context| most.max(context)) {
        0 | 1 => 0,
        2 | 3 => 1,
        _ => 2,
    }
}

/// Takes residuals level by level, then makes bytes of them; keeps its buffers from one plane to the next.
#[derive(Debug)]
pub(crate) struct ResidualEncoder {
    family: Family,
    /// Bits of a part of the scale, by how large it is.
    bits_of: Vec<f32>,
    residuals: Vec<i32>,
    contexts: Vec<u8>,
    /// Where each level ends, and its set.
    levels: Vec<(usize, usize)>,
    /// What the decoder will read, in its order: start, width, state.
    symbols: Vec<(Interval, u8)>,
    words: Vec<u16>,
}

impl Default for ResidualEncoder {
    fn default() -> ResidualEncoder {
        let bits_of = (0..=SCALE).map(|parts| SCALE_BITS as f32 - (parts as f32).log2()).collect();
        ResidualEncoder {
            family: Family::default(),
            bits_of,
            residuals: Vec::new(),
            contexts: Vec::new(),
            levels: Vec::new(),
            symbols: Vec::new(),
            words: Vec::new(),
        }
    }
}

/// How often each symbol is in each context, and how often each flag is 0 and 1.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    contexts: [[u32; SYMBOLS]; CONTEXTS],
    flags: [[u32; 2]; FLAGS],
}

impl ResidualEncoder {
    /// Starts a plane.
    pub(crate) fn begin(&mut self) {
        self.residuals.clear();
        self.contexts.clear();
        self.levels.clear();
    }

    /// Takes a residual, of the context below [`CONTEXTS`].
    #[cfg(test)]
    fn push(&mut self, residual: i32, context: u8) {
        self.residuals.push(residual);
        self.contexts.push(context);
    }

    /// Takes residuals of a level; those where `defined` is false are left out.
    pub(crate) fn extend(&mut self, residuals: &[i32], contexts: &[u8], defined: Option<&[bool]>) {
        match defined {
            None => {
                self.residuals.extend_from_slice(residuals);
                self.contexts.extend_from_slice(contexts);
            }
            Some(defined) => {
                let start = self.residuals.len();
                self.residuals.resize(start + residuals.len(), 0);
                self.contexts.resize(start + residuals.len(), 0);
                let mut at = start;
                for ((&residual, &context), &defined) in residuals.iter().zip(contexts).zip(defined) {
                    (self.residuals[at], self.contexts[at]) = (residual, context);
                    at += usize::from(defined);
                }
                self.residuals.truncate(at);
                self.contexts.truncate(at);
            }
        }
    }

    /// Ends a level, whose residuals use a set of distributions below [`SETS`].
    pub(crate) fn end_level(&mut self, set: usize) {
        self.levels.push((self.residuals.len(), set));
    }

    /// Appends the bytes of all levels.
    pub(crate) fn finish(&mut self, out: &mut Vec<u8>) {
        let choices = self.choose();
        self.list_symbols(&choices);
        let mut mask = if self.symbols.len() < FEW_SYMBOLS { ONE_LANE } else { 0 };
        let mut names = Vec::with_capacity(SETS * (CONTEXTS + FLAGS));
        let mut choices = choices;
        for (bit, (choice, _)) in choices.iter_mut().flat_map(Choices::all).enumerate() {
            if let Some(name) = *choice {
                mask |= 1 << bit;
                names.push(name);
            }
        }
        out.extend_from_slice(&mask.to_le_bytes()[..MASK_BYTES]);
        out.extend_from_slice(&names);
        if self.symbols.is_empty() {
            return;
        }
        let lanes = if mask & ONE_LANE == 0 { 4 } else { 1 };
        let mut states = [LOWEST; 4];
        self.words.clear();
        // Last first: the decoder goes the other way.
        for &(Interval { start, width }, lane) in self.symbols.iter().rev() {
            let (start, width) = (u32::from(start), u32::from(width));
            let state = &mut states[usize::from(lane) & (lanes - 1)];
            if *state >= width << (32 - SCALE_BITS) {
                self.words.push(*state as u16);
                *state >>= 16;
            }
            *state = ((*state / width) << SCALE_BITS) + *state % width + start;
        }
        for state in &states[..lanes] {
            out.extend_from_slice(&state.to_le_bytes());
        }
        out.extend(self.words.iter().rev().flat_map(|word| word.to_le_bytes()));
    }

    /// Residuals and contexts of each block, with the set of its level.
    fn blocks(&self) -> impl Iterator<Item = (&[i32], &[u8], usize)> {
        let starts = std::iter::once(0).chain(self.levels.iter().map(|level| level.0));
        starts.zip(&self.levels).flat_map(|(start, &(end, set))| {
            let residuals = self.residuals[start..end].chunks(BLOCK);
            residuals
                .zip(self.contexts[start..end].chunks(BLOCK))
                .map(move |(residuals, contexts)| (residuals, contexts, set))
        })
    }

    /// The distributions that cost least.
    fn choose(&mut self) -> [Choices; SETS] {
        let mut counts = [Counts::default(); SETS];
        for (residuals, contexts, set) in self.blocks() {
            let counts = &mut counts[set];
            let is_empty = residuals.iter().fold(0, |all, residual| all | residual) == 0;
            counts.flags[flag_of(contexts)][usize::from(!is_empty)] += 1;
            if !is_empty {
                for (&residual, &context) in residuals.iter().zip(contexts) {
                    counts.contexts[usize::from(context)][symbol_of(residual)] += 1;
                }
            }
        }
        let mut choices = [Choices::default(); SETS];
        for (choices, counts) in choices.iter_mut().zip(&counts) {
            for (choice, &[empty, full]) in choices.flags.iter_mut().zip(&counts.flags) {
                *choice = (full > 0).then(|| self.best_zero(empty, full) as u8);
            }
            for (choice, counts) in choices.contexts.iter_mut().zip(&counts.contexts) {
                let others: u32 = counts[1..].iter().sum();
                if others > 0 {
                    let zero = self.best_zero(counts[0], others);
                    *choice = Some(self.best_of_zero(zero, counts));
                }
            }
        }
        choices
    }

    /// The best entry of [`ZEROS`] for so many zeros and others.
    fn best_zero(&self, zeros: u32, others: u32) -> usize {
        let cost = |index: usize| {
            let parts = usize::from(ZEROS[index]);
            zeros as f32 * self.bits_of[parts] + others as f32 * self.bits_of[SCALE as usize - parts]
        };
        (0..ZEROS.len()).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(0)
    }

    /// The best member of the family among those near an entry of [`ZEROS`].
    fn best_of_zero(&mut self, zero: usize, counts: &[u32; SYMBOLS]) -> u8 {
        let counts = Counted::from(counts);
        let mut best = (f32::INFINITY, 0);
        for index in zero.saturating_sub(1) * TAILS.len()..((zero + 2) * TAILS.len()).min(FAMILY) {
            let bits = counts.bits_by(self.family.prepare(index as u8));
            if bits < best.0 {
                best = (bits, index as u8);
            }
        }
        best.1
    }

    fn list_symbols(&mut self, choices: &[Choices; SETS]) {
        let mut symbols = std::mem::take(&mut self.symbols);
        symbols.clear();
        for (residuals, contexts, set) in self.blocks() {
            let choices = &choices[set];
            let Some(flag) = choices.flags[flag_of(contexts)] else { continue };
            let is_empty = residuals.iter().fold(0, |all, residual| all | residual) == 0;
            let parts = ZEROS[usize::from(flag)];
            let interval = match is_empty {
                true => Interval { start: 0, width: parts },
                false => Interval { start: parts, width: SCALE as u16 - parts },
            };
            symbols.push((interval, 0));
            if is_empty {
                continue;
            }
            for (at, (&residual, &context)) in residuals.iter().zip(contexts).enumerate() {
                let Some(choice) = choices.contexts[usize::from(context)] else { continue };
                let lane = (at % 4) as u8;
                let intervals = &self.family.member(Some(choice)).intervals;
                let symbol = symbol_of(residual);
                if intervals[symbol].width == 0 || symbol == ESCAPE {
                    symbols.push((intervals[ESCAPE], lane));
                    push_escaped(residual, lane, &mut symbols);
                    continue;
                }
                symbols.push((intervals[symbol], lane));
                if symbol > 2 * SINGLES {
                    let bucket = symbol - 2 * SINGLES - 1;
                    let above = residual.unsigned_abs() - BUCKETS[bucket];
                    push_bits(above << 1 | u32::from(residual < 0), bucket as u32 + 2, lane, &mut symbols);
                }
            }
        }
        self.symbols = symbols;
    }
}

/// Bits that are as likely 0 as 1, at most 12.
fn push_bits(value: u32, bits: u32, lane: u8, symbols: &mut Vec<(Interval, u8)>) {
    let width = 1 << (SCALE_BITS - bits);
    symbols.push((Interval { start: (value * width) as u16, width: width as u16 }, lane));
}

/// The length of the magnitude, then its bits from below, then the sign.
fn push_escaped(residual: i32, lane: u8, symbols: &mut Vec<(Interval, u8)>) {
    let magnitude = residual.unsigned_abs();
    let length = 32 - magnitude.leading_zeros();
    push_bits(length, 6, lane, symbols);
    for from in (0..length).step_by(8) {
        push_bits(magnitude >> from & 0xff, 8, lane, symbols);
    }
    push_bits(u32::from(residual < 0), 1, lane, symbols);
}

/// Why a level cannot be read: the bytes end within it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct EndsWithin;

/// Reads residuals level by level; keeps its tables from one plane to the next.
#[derive(Debug, Default)]
pub(crate) struct ResidualDecoder {
    family: Family,
    choices: [Choices; SETS],
    lanes: usize,
    states: [u32; 4],
    words: Vec<u16>,
    at: usize,
    /// Whether the bytes end in the middle of a word: of a prefix only.
    has_odd_byte: bool,
}

impl ResidualDecoder {
    /// Starts a plane of these bytes. A truncated error means that they end before the first residual.
    pub(crate) fn begin(&mut self, bytes: &[u8]) -> Result<(), DecodeError> {
        let truncated = DecodeError::Truncated { field: "distributions" };
        let (mask, mut rest) = bytes.split_first_chunk::<MASK_BYTES>().ok_or(truncated.clone())?;
        let [low, middle, high] = *mask;
        let mask = u32::from_le_bytes([low, middle, high, 0]);
        if (mask & !ONE_LANE) >> (SETS * (CONTEXTS + FLAGS)) != 0 {
            let expected = "only distributions that there are";
            return Err(DecodeError::Malformed { field: "distributions", expected });
        }
        for (bit, (choice, count)) in self.choices.iter_mut().flat_map(Choices::all).enumerate() {
            *choice = None;
            if mask >> bit & 1 == 1 {
                let (&name, behind) = rest.split_first().ok_or(truncated.clone())?;
                if usize::from(name) >= count {
                    let expected = "a member of the family";
                    return Err(DecodeError::Malformed { field: "distributions", expected });
                }
                (*choice, rest) = (Some(name), behind);
            }
        }
        for choices in &self.choices {
            for &name in choices.contexts.iter().flatten() {
                self.family.prepare(name);
            }
        }
        // Without a flag no block has anything but 0, and no state is needed.
        self.lanes = match mask & ONE_LANE {
            _ if self.choices.iter().all(|choices| choices.flags == [None; FLAGS]) => 0,
            0 => 4,
            _ => 1,
        };
        self.states = [LOWEST; 4];
        for state in &mut self.states[..self.lanes] {
            let (bytes, behind) = rest.split_first_chunk().ok_or(truncated.clone())?;
            (*state, rest) = (u32::from_le_bytes(*bytes), behind);
            if *state < LOWEST {
                return Err(DecodeError::Malformed { field: "state", expected: "at least 2^16" });
            }
        }
        let (words, odd) = rest.as_chunks::<2>();
        self.words.clear();
        self.words.extend(words.iter().map(|&word| u16::from_le_bytes(word)));
        self.has_odd_byte = !odd.is_empty();
        self.at = 0;
        Ok(())
    }

    /// Whether no residual is anything but 0.
    pub(crate) fn is_all_zero(&self) -> bool {
        self.lanes == 0
    }

    /// Reads the residuals of a level, one for every context.
    pub(crate) fn level(&mut self, set: usize, contexts: &[u8], residuals: &mut [i32]) -> Result<(), EndsWithin> {
        match self.lanes {
            0 => residuals.fill(0),
            1 => self.level_of::<1>(set, contexts, residuals),
            _ => self.level_of::<4>(set, contexts, residuals),
        }
        if self.at > self.words.len() { Err(EndsWithin) } else { Ok(()) }
    }

    fn level_of<const LANES: usize>(&mut self, set: usize, contexts: &[u8], residuals: &mut [i32]) {
        let choices = self.choices[set];
        let distributions = choices.contexts.map(|choice| self.family.member(choice));
        let mut reader = Reader::<LANES> { states: [LOWEST; LANES], words: &self.words, at: self.at };
        reader.states.copy_from_slice(&self.states[..LANES]);
        for (residuals, contexts) in residuals.chunks_mut(BLOCK).zip(contexts.chunks(BLOCK)) {
            let is_full = match choices.flags[flag_of(contexts)] {
                None => false,
                Some(flag) => reader.flag(ZEROS[usize::from(flag)]),
            };
            if !is_full {
                residuals.fill(0);
                continue;
            }
            for (at, (residual, &context)) in residuals.iter_mut().zip(contexts).enumerate() {
                *residual = reader.residual(at % LANES, distributions[usize::from(context) % CONTEXTS]);
            }
        }
        self.states[..LANES].copy_from_slice(&reader.states);
        self.at = reader.at;
    }

    /// Refuses bytes of which the levels read so far are not all.
    pub(crate) fn finish(&self) -> Result<(), DecodeError> {
        let is_whole = self.at == self.words.len() && !self.has_odd_byte;
        if is_whole && self.states[..self.lanes].iter().all(|&state| state == LOWEST) {
            return Ok(());
        }
        Err(DecodeError::Malformed {
            field: "residuals",
            expected: "nothing behind the last, and the state it began with",
        })
    }
}

struct Reader<'a, const LANES: usize> {
    states: [u32; LANES],
    words: &'a [u16],
    /// Past the end, words are 0 and this goes on counting.
    at: usize,
}

impl<const LANES: usize> Reader<'_, LANES> {
    #[inline(always)]
    fn slot(&self, lane: usize) -> u32 {
        self.states[lane] & (SCALE - 1)
    }

    #[inline(always)]
    fn advance(&mut self, lane: usize, slot: u32, interval: Interval) {
        let mut state =
            u32::from(interval.width) * (self.states[lane] >> SCALE_BITS) + slot - u32::from(interval.start);
        if state < LOWEST {
            let word = self.words.get(self.at).copied().unwrap_or(0);
            state = state << 16 | u32::from(word);
            self.at += 1;
        }
        self.states[lane] = state;
    }

    #[inline(always)]
    fn flag(&mut self, parts: u16) -> bool {
        let slot = self.slot(0);
        let is_full = slot >= u32::from(parts);
        let interval = match is_full {
            false => Interval { start: 0, width: parts },
            true => Interval { start: parts, width: SCALE as u16 - parts },
        };
        self.advance(0, slot, interval);
        is_full
    }

    #[inline(always)]
    fn residual(&mut self, lane: usize, distribution: &Distribution) -> i32 {
        let slot = self.slot(lane);
        let symbol = usize::from(distribution.symbol_of_slot[slot as usize]);
        self.advance(lane, slot, distribution.intervals[symbol.min(ESCAPE)]);
        if symbol <= 2 * SINGLES {
            // 1, 2, 3, 4 are -1, 1, -2, 2.
            let magnitude = symbol.div_ceil(2) as i32;
            return if symbol % 2 == 1 { -magnitude } else { magnitude };
        }
        self.large(lane, symbol)
    }

    #[inline(never)]
    fn large(&mut self, lane: usize, symbol: usize) -> i32 {
        if symbol < ESCAPE {
            let bucket = symbol - 2 * SINGLES - 1;
            let bits = self.bits(lane, bucket as u32 + 2);
            let magnitude = (BUCKETS[bucket] + (bits >> 1)) as i32;
            return if bits & 1 == 1 { -magnitude } else { magnitude };
        }
        // What is longer than 32 bits is read as if it had so many: a receiver clamps it anyway.
        let length = self.bits(lane, 6).min(32);
        let mut magnitude = 0;
        for from in (0..length).step_by(8) {
            magnitude |= self.bits(lane, 8) << from;
        }
        let magnitude = magnitude as i32;
        if self.bits(lane, 1) == 1 { magnitude.wrapping_neg() } else { magnitude }
    }

    #[inline(always)]
    fn bits(&mut self, lane: usize, bits: u32) -> u32 {
        let slot = self.slot(lane);
        let value = slot >> (SCALE_BITS - bits);
        let width = 1 << (SCALE_BITS - bits);
        self.advance(lane, slot, Interval { start: (value * width) as u16, width: width as u16 });
        value
    }
}

#[cfg(test)]
mod tests;
