//! Random numbers of one sample: the first pairs from a low-discrepancy sequence, the rest independent.
//!
//! Method: Sobol' points in two dimensions, Owen-scrambled and shuffled by hashing, one scramble per pair
//! (Burley 2020, "Practical Hash-based Owen Scrambling", JCGT 10(4); second dimension by the Pascal matrix in
//! five shifts, Ahmed 2024); beyond that PCG-32. A sample is a function of seed, stream and index only, so a
//! picture does not depend on the number of threads. Any number of samples may be drawn; powers of two are
//! the best stratified.

use glam::Vec2;
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;

/// Pairs drawn from the sequence: light and direction at the first three diffuse surfaces and the pixel.
/// Further bounces gain nothing from it.
const LOW_DISCREPANCY_PAIRS: u32 = 7;

/// The numbers of one sample.
#[derive(Clone, Debug)]
pub struct Sampler {
    random: Pcg32,
    /// Scrambles the sequence; the same for all samples of a stream.
    scramble: u32,
    index: u32,
    pair: u32,
}

impl Sampler {
    /// The sample `index` of a `stream` (a pixel and a node) under a seed.
    pub fn new(seed: u64, stream: u64, index: u32) -> Sampler {
        let key = mixed(seed ^ mixed(stream));
        Sampler {
            random: Pcg32::new(mixed(key.wrapping_add(u64::from(index))), key),
            scramble: (key >> 32) as u32,
            index,
            pair: 0,
        }
    }

    /// Two numbers in [0, 1), stratified together over the samples of the stream.
    pub fn pair(&mut self) -> Vec2 {
        if self.pair >= LOW_DISCREPANCY_PAIRS {
            return Vec2::new(self.value(), self.value());
        }
        let key = mixed(u64::from(self.scramble) << 32 | u64::from(self.pair));
        self.pair += 1;
        let [low, high] = [key as u32, (key >> 32) as u32];
        let x = scrambled(self.index.reverse_bits(), low);
        let y = pascal(x);
        Vec2::new(
            unit(scrambled(x.reverse_bits(), high).reverse_bits()),
            unit(scrambled(y.reverse_bits(), low ^ high.rotate_left(7)).reverse_bits()),
        )
    }

    /// A number in [0, 1), independent of all others.
    pub fn value(&mut self) -> f32 {
        unit(self.random.next_u32())
    }
}

/// [0, 1) from the upper 24 bits.
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / (1 << 24) as f32)
}

/// SplitMix64's finaliser (Steele et al. 2014).
pub(super) fn mixed(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Owen scrambling of a number whose bits are reversed: each bit is flipped by a hash of those below it
/// (Laine and Karras 2011, with the constants of Vegdahl 2021).
fn scrambled(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// The second Sobol' coordinate from the first: its product with the Pascal matrix modulo 2.
fn pascal(mut x: u32) -> u32 {
    x ^= x << 16;
    x ^= (x & 0x00ff_00ff) << 8;
    x ^= (x & 0x0f0f_0f0f) << 4;
    x ^= (x & 0x3333_3333) << 2;
    x ^ ((x & 0x5555_5555) << 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_coordinate_is_that_of_sobol() {
        // Direction numbers of the second dimension: x -> x ^ (x >> 1) from the one before.
        let mut direction = 0x8000_0000_u32;
        for bit in 0..32 {
            assert_eq!(pascal((1_u32 << bit).reverse_bits()), direction, "bit {bit}");
            direction ^= direction >> 1;
        }
    }

    #[test]
    fn every_pair_is_stratified_over_sixteen_samples() {
        for stream in 0..50 {
            let mut samplers: Vec<Sampler> = (0..16).map(|index| Sampler::new(3, stream, index)).collect();
            for _ in 0..LOW_DISCREPANCY_PAIRS {
                // A (0, 4, 2)-net in base 2: every dyadic box of area 1/16 holds one point.
                let points: Vec<Vec2> = samplers.iter_mut().map(Sampler::pair).collect();
                for (columns, rows) in [(16, 1), (8, 2), (4, 4), (2, 8), (1, 16)] {
                    let mut seen = [false; 16];
                    for point in &points {
                        let cell = (point.x * columns as f32) as usize + columns * (point.y * rows as f32) as usize;
                        assert!(!std::mem::replace(&mut seen[cell], true), "stream {stream}: {columns}x{rows}");
                    }
                }
            }
        }
    }

    #[test]
    fn numbers_of_different_streams_seeds_and_samples_are_uncorrelated() {
        let draw = |seed, stream, index| {
            let mut sampler = Sampler::new(seed, stream, index);
            [sampler.pair().x, sampler.pair().y, sampler.value(), sampler.value()]
        };
        let count = 20_000_u32;
        for number in 0..4 {
            let mut sums = [0.0_f64; 4];
            for n in 0..count {
                let base = f64::from(draw(1, u64::from(n), 0)[number]) - 0.5;
                let near = [draw(2, u64::from(n), 0), draw(1, u64::from(n) + 1, 0), draw(1, u64::from(n), 1)];
                sums[0] += base;
                for (sum, other) in sums[1..].iter_mut().zip(near) {
                    *sum += base * (f64::from(other[number]) - 0.5);
                }
            }
            let n = f64::from(count);
            assert!(sums[0].abs() < 4.5 * (n / 12.0).sqrt(), "mean of number {number}: {}", sums[0] / n);
            // Consecutive samples of one stream are stratified: anticorrelated at most.
            let limit = 4.5 * n.sqrt() / 12.0;
            let stratified = number < 2;
            assert!(sums[1].abs() < limit && sums[2].abs() < limit, "number {number}: {sums:?}");
            assert!(stratified || sums[3].abs() < limit, "number {number}: {sums:?}");
        }
    }
}
