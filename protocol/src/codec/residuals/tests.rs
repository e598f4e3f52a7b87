use super::*;
use proptest::prelude::*;

type Levels = Vec<(usize, Vec<(i32, u8)>)>;
/// The levels that are whole, and what was said at the end.
type Decoded = (Vec<Vec<i32>>, Result<(), DecodeError>);

fn encode(levels: &Levels) -> Vec<u8> {
    let mut encoder = ResidualEncoder::default();
    encoder.begin();
    for (set, level) in levels {
        level.iter().for_each(|&(residual, context)| encoder.push(residual, context));
        encoder.end_level(*set);
    }
    let mut bytes = Vec::new();
    encoder.finish(&mut bytes);
    bytes
}

fn decode(bytes: &[u8], levels: &Levels) -> Result<Decoded, DecodeError> {
    let mut decoder = ResidualDecoder::default();
    decoder.begin(bytes)?;
    let mut all = Vec::new();
    for (set, level) in levels {
        let contexts: Vec<u8> = level.iter().map(|sample| sample.1).collect();
        let mut residuals = vec![9; contexts.len()];
        if decoder.level(*set, &contexts, &mut residuals).is_err() {
            return Ok((all, Err(DecodeError::Truncated { field: "level" })));
        }
        all.push(residuals);
    }
    Ok((all, decoder.finish()))
}

fn residual() -> impl Strategy<Value = i32> {
    prop_oneof![20 => Just(0), 6 => -1..=1_i32, 3 => -9..=9_i32, 1 => -200..=200_i32, 1 => any::<i32>()]
}

fn levels() -> impl Strategy<Value = Levels> {
    let level = prop::collection::vec((residual(), 0..CONTEXTS as u8), 0..900);
    prop::collection::vec((0..SETS, level), 1..6)
}

proptest! {
    #[test]
    fn residuals_come_back_and_every_prefix_is_a_prefix_of_levels(levels in levels()) {
        let bytes = encode(&levels);
        let expected: Vec<Vec<i32>> = levels.iter().map(|level| level.1.iter().map(|sample| sample.0).collect()).collect();
        prop_assert_eq!(decode(&bytes, &levels), Ok((expected.clone(), Ok(()))));
        let mut last = 0;
        for end in (0..bytes.len()).step_by(1 + bytes.len() / 50) {
            match decode(&bytes[..end], &levels) {
                Err(error) => prop_assert_eq!(error, DecodeError::Truncated { field: "distributions" }),
                Ok((whole, end)) => {
                    prop_assert!(end.is_err());
                    prop_assert!(whole.len() >= last);
                    last = whole.len();
                    prop_assert_eq!(&whole[..], &expected[..last]);
                }
            }
        }
    }

    #[test]
    fn any_bytes_are_refused_or_read(bytes in prop::collection::vec(any::<u8>(), 0..200), mask in 0..1_u32 << 24, levels in levels()) {
        let _ = decode(&bytes, &levels);
        let bytes = [&mask.to_le_bytes()[..MASK_BYTES], &bytes].concat();
        let _ = decode(&bytes, &levels);
        let names = bytes.iter().map(|byte| byte % ZEROS.len() as u8);
        let _ = decode(&mask.to_le_bytes()[..MASK_BYTES].iter().copied().chain(names).collect::<Vec<_>>(), &levels);
    }
}

#[test]
fn every_member_fills_the_scale_and_has_an_escape() {
    for index in 0..FAMILY {
        let member = Distribution::of_family(index);
        assert_eq!(member.symbol_of_slot.len(), SCALE as usize);
        assert!(member.intervals[ESCAPE].width > 0 && u32::from(member.intervals[0].width) < SCALE);
        for symbol in 1..=SINGLES {
            assert_eq!(member.intervals[2 * symbol].width, member.intervals[2 * symbol - 1].width, "signs are equal");
        }
    }
}

#[test]
fn nothing_but_zero_takes_no_bytes_but_the_mask() {
    let levels = vec![(0, vec![(0, 3); 500]), (1, vec![(0, 0); 5000])];
    assert_eq!(encode(&levels).len(), MASK_BYTES);
    // Nor do contexts that have nothing but zero among those that have more.
    let with_one = vec![(0, vec![(0, 3); 500]), (1, [vec![(0, 0); 5000], vec![(1, 7)]].concat())];
    assert!(encode(&with_one).len() < MASK_BYTES + 2 + 4 + 6, "{}", encode(&with_one).len());
}

/// Against the entropy of what was drawn: the family has a member that is near.
#[test]
fn geometric_residuals_take_their_entropy() {
    for (zero, ratio) in [(0.95, 0.2), (0.7, 0.4), (0.3, 0.7), (0.1, 0.9)] {
        let (mut state, mut bits) = (1_u64, 0.0);
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / (1_u64 << 24) as f64
        };
        let draw = |_| {
            if unit() < zero {
                bits -= f64::log2(zero);
                return (0, 4);
            }
            let magnitude = 1.0 + (unit().max(1e-9).ln() / f64::ln(ratio)).floor();
            bits -= ((1.0 - zero) * 0.5 * (1.0 - ratio) * ratio.powf(magnitude - 1.0)).log2();
            (if unit() < 0.5 { magnitude as i32 } else { -magnitude as i32 }, 4)
        };
        let levels = vec![(1, (0..60_000).map(draw).collect())];
        let bytes = encode(&levels).len() as f64;
        // Within a block that is said not to be empty, nothing is made of the fact that the last of 16 cannot be 0 when
        // all others are: at most log2(1 / (1 - zero_in_full_blocks^16)) bits each.
        let empty = f64::powi(zero, 16);
        let zero_in_full = (zero - empty) / (1.0 - empty);
        let wasted = -60_000.0 / 16.0 * (1.0 - empty) * (1.0 - zero_in_full.powi(16)).log2();
        assert!(8.0 * bytes < 1.04 * bits + wasted, "{zero} {ratio}: {} of {bits}", 8.0 * bytes);
        assert!(8.0 * bytes > 0.98 * bits, "nothing is better than the entropy");
    }
}
