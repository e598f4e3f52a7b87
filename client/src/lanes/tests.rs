//! Every level says the same.

use super::*;

#[inline(always)]
fn everything<F: Floats>(numbers: &[f32], words: &mut [u32], results: &mut [f32]) {
    for at in (0..numbers.len()).step_by(F::LANES) {
        let a = F::load(numbers, at);
        let b = a.mul_add(F::splat(0.37), F::ramp() + F::splat(0.5 + at as f32));
        let quotient = a / (b.abs() + F::splat(0.25));
        let least = quotient.min(b).max(-b).sqrt();
        let index = (a.abs() * F::splat(7.0)).within(0.0, numbers.len() as f32 - 0.5).truncate();
        let [taken, other] = F::gather([numbers, numbers], index);
        let [packed] = F::gather_words([words], index);
        let chosen = taken.or(a.lt(b) & !b.lt(F::zero()), other + least);
        (chosen + packed.shift_up().as_floats() + packed.upper_half().as_floats()).store(results, at);
    }
    for at in (0..numbers.len()).step_by(F::LANES) {
        F::load(results, at).pack_upper(F::load(numbers, at)).store(words, at);
    }
}

kernel!(fn run_everything = everything(numbers: &[f32], words: &mut [u32], results: &mut [f32]));

#[test]
fn every_level_computes_the_same_but_for_rounding() {
    let numbers: Vec<f32> = (0..333).map(|index| (index as f32 * 0.71).sin() * 40.0).collect();
    let run = |level| {
        let (mut words, mut results) = (vec![0x3f80_4000; numbers.len()], vec![0.0; numbers.len()]);
        run_everything(level, &numbers, &mut words, &mut results);
        (words, results)
    };
    let (_, plain) = run(Level::Portable);
    for level in Level::available() {
        let (words, results) = run(level);
        for (index, (a, b)) in plain.iter().zip(&results).enumerate() {
            assert!(
                (a - b).abs() <= 1e-5 * a.abs().max(1.0) || (a.is_nan() && b.is_nan()),
                "{level:?} {index}: {a} {b}"
            );
        }
        for (word, (result, number)) in words.iter().zip(results.iter().zip(&numbers)) {
            let half = |value: f32| f32::from_bits(value.to_bits().wrapping_add(0x8000) & !0xffff);
            assert!(result.is_nan() || *word & !0xffff == half(*result).to_bits());
            assert_eq!(f32::from_bits(word << 16), half(*number));
        }
    }
}

#[test]
fn an_index_beyond_the_end_is_refused_by_every_level() {
    #[inline(always)]
    fn beyond<F: Floats>(index: i32) -> f32 {
        let [found] = F::gather([&[1.0; 40]], F::Integers::splat(index));
        found.lanes()[0]
    }
    kernel!(fn run_beyond = beyond(index: i32) -> f32);
    for level in Level::available() {
        assert_eq!(run_beyond(level, 39), 1.0);
        for index in [40, -1, i32::MIN, i32::MAX] {
            assert!(std::panic::catch_unwind(|| run_beyond(level, index)).is_err(), "{level:?} {index}");
        }
    }
}

#[test]
fn every_level_gathers_whole_records_and_refuses_half_ones() {
    #[inline(always)]
    fn records<F: Floats, const N: usize>(words: &[u32], firsts: &[f32]) -> Vec<Vec<u32>> {
        let found = F::gather_records::<N>(words, F::load(firsts, 0).truncate());
        let mut lanes = Vec::new();
        for word in found {
            let mut stored = [0; MAX_LANES];
            word.store(&mut stored, 0);
            lanes.push(stored[..F::LANES].to_vec());
        }
        lanes
    }
    #[inline(always)]
    fn all_sizes<F: Floats>(words: &[u32], firsts: &[f32]) -> [Vec<Vec<u32>>; 4] {
        let (one, two) = (records::<F, 1>(words, firsts), records::<F, 2>(words, firsts));
        [one, two, records::<F, 4>(words, firsts), records::<F, 8>(words, firsts)]
    }
    kernel!(fn run_all_sizes = all_sizes(words: &[u32], firsts: &[f32]) -> [Vec<Vec<u32>>; 4]);
    let words: Vec<u32> = (0..100).map(|word| word * 0x0101_0101).collect();
    let firsts: Vec<f32> = (0..MAX_LANES).map(|lane| (lane * 37 % 93) as f32).collect();
    for level in Level::available() {
        for (size, found) in [1, 2, 4, 8].into_iter().zip(run_all_sizes(level, &words, &firsts)) {
            assert_eq!(found.len(), size);
            for (word, lanes) in found.iter().enumerate() {
                for (lane, value) in lanes.iter().enumerate() {
                    assert_eq!(*value, words[firsts[lane] as usize + word], "{level:?} {size} {word} {lane}");
                }
            }
        }
        let beyond: Vec<f32> = firsts.iter().map(|first| first + 3.0).collect();
        let past = std::panic::catch_unwind(|| run_all_sizes(level, &words, &beyond));
        assert_eq!(past.is_err(), beyond.iter().any(|&first| first > 92.0), "{level:?}");
    }
}
