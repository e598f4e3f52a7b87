use super::*;
use proptest::prelude::*;

fn random(seed: u64) -> impl FnMut(i32) -> i32 {
    let mut state = seed | 1;
    move |below| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) % below.max(1) as u64) as i32
    }
}

/// Smooth, stepped, spiky, constant, random, all from 0 to `highest`.
fn plane(kind: usize, width: usize, height: usize, highest: i32, seed: u64) -> Vec<i32> {
    let mut random = random(seed);
    let (slope, offset) = (random(highest / 64 + 2), random(highest / 2 + 1));
    (0..width * height)
        .map(|at| {
            let (x, y) = ((at % width) as i32, (at / width) as i32);
            let smooth = offset + (x * slope + y * slope / 2) / 8;
            let value = match kind {
                0 => smooth,
                1 if x / 5 % 2 == 0 => smooth,
                1 => highest - smooth,
                2 if random(9) == 0 => random(highest),
                2 => smooth,
                3 => offset,
                4 if y < 3 => 0,
                4 => smooth,
                _ => random(highest),
            };
            value.clamp(0, highest)
        })
        .collect()
}

fn cases() -> impl Strategy<Value = (usize, usize, usize, Rounding, u64)> {
    let sides = prop_oneof![Just((1, 1)), Just((1, 40)), Just((70, 1)), Just((2, 2)), (1..80_usize, 1..70_usize)];
    let highest = prop_oneof![Just(1), Just(255), Just(4095), Just(MOST - 1)];
    let step = prop::sample::select(vec![1, 3, 5, 63, 129]);
    (0..6_usize, sides, highest, step, any::<bool>(), any::<u64>()).prop_map(
        |(kind, (width, height), highest, step, keeps_zero, seed)| {
            let lowest = if keeps_zero { -step } else { 0 };
            (kind, width, height, Rounding { step, lowest, highest, keeps_zero }, seed)
        },
    )
}

#[test]
fn levels_are_the_grid_and_nothing_twice() {
    for (width, height) in [(1, 1), (2, 1), (1, 2), (3, 3), (32, 32), (33, 33), (65, 31), (1024, 32), (17, 64)] {
        let mut grid = (0, 0);
        for (index, level) in levels(width, height).enumerate() {
            if index > 0 {
                assert_eq!((level.columns, level.rows), grid, "{width} {height} {level:?}");
            }
            grid = (level.columns + level.columns_between, level.rows + level.rows_between);
            assert!(level.rows_between < level.rows && level.columns_between <= level.columns);
            assert!(level.last_distance >= 1 && level.last_distance <= level.half, "{level:?}");
        }
        assert_eq!(grid, (width, height));
    }
}

proptest! {
    #[test]
    fn every_sample_is_within_half_a_step((kind, width, height, rounding, seed) in cases(), masked in any::<bool>()) {
        let source = plane(kind, width, height, rounding.highest, seed);
        let mut flag = random(seed ^ 77);
        let defined: Vec<bool> = source.iter().map(|_| flag(3) > 0).collect();
        let defined = masked.then_some(&defined[..]);
        let (mut pyramid, mut coded, mut bytes) = (Pyramid::default(), source.clone(), Vec::new());
        pyramid.encode(width, rounding, defined, &mut coded, &mut bytes);
        for (at, (&was, &is)) in source.iter().zip(&coded).enumerate() {
            if defined.is_none_or(|defined| defined[at]) {
                match was {
                    0 if rounding.keeps_zero => prop_assert!(is <= 0 && is > -rounding.step),
                    _ => prop_assert!((was - is).abs() <= (rounding.step - 1) / 2, "{} {}", was, is),
                }
            }
            prop_assert!(is >= rounding.lowest && is <= rounding.highest);
        }
        let mut decoded = Vec::new();
        prop_assert_eq!(pyramid.decode(width, height, rounding, defined, &bytes, &mut decoded), Ok(()));
        prop_assert_eq!(&decoded, &coded);

        // What an undefined sample holds costs nothing.
        let mut other = source.clone();
        for (at, sample) in other.iter_mut().enumerate() {
            if defined.is_some_and(|defined| !defined[at]) {
                *sample = rounding.highest - *sample;
            }
        }
        let mut again = Vec::new();
        pyramid.encode(width, rounding, defined, &mut other, &mut again);
        prop_assert_eq!(&again, &bytes);
    }

    #[test]
    fn any_bytes_are_refused_or_in_range((kind, width, height, rounding, seed) in cases(), changes in 1..5) {
        let (mut pyramid, mut bytes) = (Pyramid::default(), Vec::new());
        pyramid.encode(width, rounding, None, &mut plane(kind, width, height, rounding.highest, seed), &mut bytes);
        let mut random = random(seed ^ 5);
        for _ in 0..changes {
            let at = random(bytes.len() as i32) as usize;
            bytes[at] = random(256) as u8;
        }
        let mut decoded = Vec::new();
        if pyramid.decode(width, height, rounding, None, &bytes, &mut decoded).is_ok() {
            prop_assert_eq!(decoded.len(), width * height);
            prop_assert!(decoded.iter().all(|sample| (rounding.lowest..=rounding.highest).contains(sample)));
        }
        let _ = pyramid.decode_prefix(width, height, rounding, None, &bytes, &mut decoded);
    }
}

/// Two surfaces with an outline between: no prefix shows a depth of neither, none is worse than a shorter one.
#[test]
fn every_prefix_is_a_coarser_plane_of_the_same_surfaces() {
    let (width, height) = (90, 45);
    let rounding = Rounding { step: 63, lowest: 0, highest: MOST - 1, keeps_zero: false };
    let is_near = |x: i32, y: i32| (x - 40).pow(2) + (y - 20).pow(2) < 200;
    let near = |x: i32, y: i32| 900_000 + 20 * x + 10 * y;
    let far = |x: i32, y: i32| 100_000 - 7 * x + 30 * y;
    let at = |at: usize| ((at % width) as i32, (at / width) as i32);
    let surface = |(x, y)| if is_near(x, y) { near(x, y) } else { far(x, y) };
    let source: Vec<i32> = (0..width * height).map(|index| surface(at(index))).collect();
    let (mut pyramid, mut coded, mut bytes) = (Pyramid::default(), source.clone(), Vec::new());
    pyramid.encode(width, rounding, None, &mut coded, &mut bytes);
    let (mut last_levels, mut last_error, mut seen) = (0, f64::INFINITY, Vec::new());
    for end in 0..=bytes.len() {
        let mut decoded = Vec::new();
        let levels = match pyramid.decode_prefix(width, height, rounding, None, &bytes[..end], &mut decoded) {
            Ok(levels) => levels,
            Err(error) => {
                assert!(matches!(error, DecodeError::Truncated { .. }) && seen.is_empty(), "{end}: {error}");
                continue;
            }
        };
        assert!(levels >= last_levels, "{end}");
        let error: f64 = source.iter().zip(&decoded).map(|(was, is)| f64::from(was - is).abs()).sum();
        assert!(error <= last_error, "{end}: {error} {last_error}");
        (last_levels, last_error) = (levels, error);
        seen.push(levels);
        for (index, &sample) in decoded.iter().enumerate() {
            // A copy comes from at most a stride of 32 away, where the surface is by so much another.
            let (x, y) = at(index);
            let off = [near(x, y), far(x, y)].map(|surface| (surface - sample).abs());
            assert!(off[0].min(off[1]) < 40 * 37 + 63, "{end}: {sample} at {x} {y} is neither");
        }
    }
    seen.dedup();
    assert_eq!(seen, [0, 1, 2, 3, 4, 5], "every number of levels is the best of some prefix");
}

#[test]
fn a_tilted_plane_takes_hardly_a_byte_more_than_a_constant_one() {
    let rounding = Rounding { step: 63, lowest: 0, highest: MOST - 1, keeps_zero: false };
    let bytes = |value: fn(i32, i32) -> i32| {
        let mut plane: Vec<i32> = (0..1024 * 32).map(|at| value(at % 1024, at / 1024)).collect();
        let mut bytes = Vec::new();
        Pyramid::default().encode(1024, rounding, None, &mut plane, &mut bytes);
        bytes.len()
    };
    let (constant, tilted) = (bytes(|_, _| 50_000), bytes(|x, y| 50_000 + 11 * x + 3 * y));
    // The 31 differences along the first row of the first grid, of 9 bits by escapes at most, and a head.
    assert!(constant < 16 && tilted < 16 + 31 * 20 / 8, "{constant} {tilted}");
}
