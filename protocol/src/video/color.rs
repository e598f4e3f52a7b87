//! Red, green and blue codes to luma and chroma, and back.
//!
//! The weights are those of ITU-R BT.601 at full range, which JPEG has too: luma is .299 red + .587 green + .114 blue;
//! chroma are blue and red less luma, scaled to 8 bits about 128. All is in 16-bit integers, so that sixteen pixels go
//! through one instruction of AVX2 and eight of SSE2, and so that both ends and all machines give the same codes. The
//! floating-point form is the tests' oracle.
//!
//! Limits: the integers are off by up to one code there and three there and back; grey is exact both ways. What that costs
//! lies below the quantiser's noise from 20 on.

/// Luma of codes of 0 to 255.
#[inline(always)]
pub fn luma([red, green, blue]: [u16; 3]) -> u8 {
    // At most 255 * 256 + 128, which 16 bits hold.
    ((77 * red + 150 * green + 29 * blue + 128) >> 8) as u8
}

/// Chroma, blue and red, of codes of 0 to 255.
#[inline(always)]
pub fn chroma([red, green, blue]: [i16; 3]) -> [u8; 2] {
    // Within 16 bits by a hair: rounded by 127, because 128 * 255 + 128 would be 32768.
    let from_blue = ((128 * blue - 43 * red - 85 * green + 127) >> 8) + 128;
    let from_red = ((128 * red - 107 * green - 21 * blue + 127) >> 8) + 128;
    [from_blue as u8, from_red as u8]
}

/// Red, green and blue of luma and chroma, whose chroma is less 128.
#[inline(always)]
pub fn rgb(luma: u8, [blue, red]: [i16; 2]) -> [u8; 3] {
    let luma = i16::from(luma);
    // The weights times 64: 1.402, .344, .714 and 1.772.
    let add = |weighted: i16| (luma + ((weighted + 32) >> 6)).clamp(0, 255) as u8;
    [add(90 * red), add(-22 * blue - 46 * red), add(113 * blue)]
}

/// A row of chroma less 128 at every pixel of luma, from the row of chroma that is next to it and from the one on the
/// other side: three parts of what is near and one of what is far, both ways.
pub(super) fn upsample(near: &[u8], far: &[u8], vertical: &mut Vec<i16>, out: &mut Vec<i16>) {
    vertical.clear();
    vertical.extend(near.iter().zip(far).map(|(&near, &far)| 3 * i16::from(near) + i16::from(far)));
    out.clear();
    out.resize(2 * vertical.len(), 0);
    let (Some(&first), Some(&last)) = (vertical.first(), vertical.last()) else { return };
    let count = vertical.len();
    for (pair, three) in out[2..].chunks_exact_mut(2).zip(vertical.windows(3)) {
        pair[0] = ((3 * three[1] + three[0] + 8) >> 4) - 128;
        pair[1] = ((3 * three[1] + three[2] + 8) >> 4) - 128;
    }
    let (second, last_but_one) = (vertical[1.min(count - 1)], vertical[count.saturating_sub(2)]);
    out[0] = ((4 * first + 8) >> 4) - 128;
    out[1] = ((3 * first + second + 8) >> 4) - 128;
    out[2 * count - 2] = ((3 * last + last_but_one + 8) >> 4) - 128;
    out[2 * count - 1] = ((4 * last + 8) >> 4) - 128;
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEPS: [i16; 12] = [0, 1, 17, 63, 64, 100, 127, 128, 200, 240, 254, 255];

    fn all_codes() -> impl Iterator<Item = [i16; 3]> {
        STEPS.into_iter().flat_map(|red| STEPS.into_iter().flat_map(move |green| STEPS.map(|blue| [red, green, blue])))
    }

    /// The definition, in f64.
    fn exact([red, green, blue]: [f64; 3]) -> [f64; 3] {
        let luma = 0.299 * red + 0.587 * green + 0.114 * blue;
        [luma, (blue - luma) / 1.772 + 128.0, (red - luma) / 1.402 + 128.0]
    }

    #[test]
    fn integers_are_within_a_code_of_the_definition() {
        for codes in all_codes() {
            let [luma_exact, blue, red] = exact(codes.map(f64::from));
            assert!((f64::from(luma(codes.map(|code| code as u16))) - luma_exact).abs() <= 1.0, "{codes:?}");
            let found = chroma(codes);
            // Half a code of rounding, up to half a code of weights in 256ths, and 255.5 that does not fit a byte.
            assert!((f64::from(found[0]) - blue).abs() <= 1.0, "{codes:?} {found:?} {blue}");
            assert!((f64::from(found[1]) - red).abs() <= 1.0, "{codes:?} {found:?} {red}");
        }
    }

    #[test]
    fn there_and_back_is_within_three_codes_and_grey_is_exact() {
        for codes in all_codes() {
            let [blue, red] = chroma(codes);
            let back = rgb(luma(codes.map(|code| code as u16)), [i16::from(blue) - 128, i16::from(red) - 128]);
            for (back, code) in back.into_iter().zip(codes) {
                // Luma is off by up to 1, chroma by up to 1 times 1.772, and rounding by a half.
                assert!((i16::from(back) - code).abs() <= 3, "{codes:?} {back:?}");
            }
        }
        for grey in 0..=255 {
            let [blue, red] = chroma([grey; 3]);
            assert_eq!([blue, red], [128, 128]);
            assert_eq!(rgb(luma([grey as u16; 3]), [0, 0]), [grey as u8; 3]);
        }
    }

    #[test]
    fn a_ramp_of_chroma_is_a_ramp_at_every_pixel() {
        let ramp: Vec<u8> = (0..16).map(|column| 40 + 8 * column).collect();
        let (mut vertical, mut out) = (Vec::new(), Vec::new());
        upsample(&ramp, &ramp, &mut vertical, &mut out);
        assert_eq!(out.len(), 32);
        // Sample k lies between pixels 2 k and 2 k + 1; the ends have nothing beyond.
        for (pixel, &value) in out.iter().enumerate().take(31).skip(1) {
            assert_eq!(value, 40 - 128 + 4 * pixel as i16 - 2, "{pixel}");
        }
        for few in [1, 2] {
            upsample(&ramp[..few], &ramp[..few], &mut vertical, &mut out);
            assert_eq!(out.len(), 2 * few);
            assert_eq!(out[0], 40 - 128);
        }
    }
}
