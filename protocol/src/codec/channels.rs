//! Channels of a plane through the pyramid ([`super::pyramid`]): codes that come back as they were, or colour within a bound.
//!
//! Bounded colour: green is coded first, then red and blue as their difference from green *as decoded*, so that the bound
//! holds on red and blue themselves. With an error of `e` codes every step is `2 e + 1` codes wide.
//!
//! Each channel but the last has its length before it, seven bits a byte from the lowest up, as in LEB128.

use super::DecodeError;
use super::pyramid::{Pyramid, Rounding};

/// Codes the channels of planes; keeps its buffers from one to the next.
#[derive(Debug, Default)]
pub(crate) struct ChannelCoder {
    pub(crate) pyramid: Pyramid,
    samples: Vec<i32>,
    green: Vec<i32>,
    bytes: Vec<u8>,
}

/// The size of a plane, and the bits of its codes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extents {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) bits: usize,
}

impl Extents {
    fn highest(self) -> i32 {
        (1 << self.bits) - 1
    }
}

/// Rounding of green, and of the differences of red and blue from it.
fn roundings(highest: i32, error: u8) -> [Rounding; 2] {
    let step = 2 * i32::from(error) + 1;
    [0, -highest].map(|lowest| Rounding { step, lowest, highest, keeps_zero: false })
}

impl ChannelCoder {
    /// Appends channels of codes, to come back as they are where `defined` is not false.
    pub(crate) fn encode_exact(
        &mut self,
        size: Extents,
        defined: Option<&[bool]>,
        channels: &[Vec<u32>],
        out: &mut Vec<u8>,
    ) {
        for (index, codes) in channels.iter().enumerate() {
            self.samples.clear();
            self.samples.extend(codes.iter().map(|&code| code as i32));
            let rounding = Rounding::exact(size.highest());
            self.encode_channel(size, rounding, defined, index + 1 == channels.len(), out);
        }
    }

    /// Reads channels of codes.
    pub(crate) fn decode_exact(
        &mut self,
        size: Extents,
        defined: Option<&[bool]>,
        mut bytes: &[u8],
        channels: &mut [Vec<u32>],
    ) -> Result<(), DecodeError> {
        let count = channels.len();
        for (index, codes) in channels.iter_mut().enumerate() {
            let rounding = Rounding::exact(size.highest());
            bytes = self.decode_channel(size, rounding, defined, index + 1 == count, bytes)?;
            codes.clear();
            codes.extend(self.samples.iter().map(|&sample| sample as u32));
        }
        Ok(())
    }

    /// Appends green, red - green and blue - green (modulo 2^bits), each colour to come back within `error`.
    pub(crate) fn encode_color(
        &mut self,
        size: Extents,
        error: u8,
        defined: Option<&[bool]>,
        channels: &[Vec<u32>],
        out: &mut Vec<u8>,
    ) {
        let [of_green, of_difference] = roundings(size.highest(), error);
        let [green, others @ ..] = channels else { return };
        self.samples.clear();
        self.samples.extend(green.iter().map(|&code| code as i32));
        self.encode_channel(size, of_green, defined, false, out);
        std::mem::swap(&mut self.samples, &mut self.green);
        for (index, codes) in others.iter().enumerate() {
            self.samples.clear();
            let codes = codes.iter().zip(green).zip(&self.green);
            self.samples.extend(codes.map(|((&difference, &green), &decoded)| {
                let code = difference.wrapping_add(green) as i32 & size.highest();
                code - decoded
            }));
            self.encode_channel(size, of_difference, defined, index + 1 == others.len(), out);
        }
    }

    /// Reads green, red - green and blue - green.
    pub(crate) fn decode_color(
        &mut self,
        size: Extents,
        error: u8,
        defined: Option<&[bool]>,
        mut bytes: &[u8],
        channels: &mut [Vec<u32>],
    ) -> Result<(), DecodeError> {
        let highest = size.highest();
        let [of_green, of_difference] = roundings(highest, error);
        let [green, others @ ..] = channels else { return Ok(()) };
        bytes = self.decode_channel(size, of_green, defined, false, bytes)?;
        green.clear();
        green.extend(self.samples.iter().map(|&sample| sample as u32));
        let count = others.len();
        for (index, codes) in others.iter_mut().enumerate() {
            bytes = self.decode_channel(size, of_difference, defined, index + 1 == count, bytes)?;
            codes.clear();
            codes.extend(self.samples.iter().zip(&*green).map(|(&difference, &green)| {
                let code = (difference + green as i32).clamp(0, highest);
                (code - green as i32) as u32
            }));
        }
        Ok(())
    }

    fn encode_channel(
        &mut self,
        size: Extents,
        rounding: Rounding,
        defined: Option<&[bool]>,
        is_last: bool,
        out: &mut Vec<u8>,
    ) {
        let mut samples = std::mem::take(&mut self.samples);
        self.encode_samples(size.width, rounding, defined, is_last, &mut samples, out);
        self.samples = samples;
    }

    /// Appends a channel of samples, with its length before it but for the last, and replaces it by what it decodes to.
    pub(crate) fn encode_samples(
        &mut self,
        width: usize,
        rounding: Rounding,
        defined: Option<&[bool]>,
        is_last: bool,
        samples: &mut Vec<i32>,
        out: &mut Vec<u8>,
    ) {
        if is_last {
            self.pyramid.encode(width, rounding, defined, samples, out);
            return;
        }
        self.bytes.clear();
        self.pyramid.encode(width, rounding, defined, samples, &mut self.bytes);
        let mut length = self.bytes.len();
        while length > 0x7f {
            out.push(length as u8 | 0x80);
            length >>= 7;
        }
        out.push(length as u8);
        out.extend_from_slice(&self.bytes);
    }

    /// Reads a channel into the samples, and returns what is behind it.
    fn decode_channel<'a>(
        &mut self,
        size: Extents,
        rounding: Rounding,
        defined: Option<&[bool]>,
        is_last: bool,
        bytes: &'a [u8],
    ) -> Result<&'a [u8], DecodeError> {
        let mut samples = std::mem::take(&mut self.samples);
        let rest = self.decode_samples([size.width, size.height], rounding, defined, is_last, bytes, &mut samples);
        self.samples = samples;
        rest
    }

    /// Reads a channel of so many columns and rows, and returns what is behind it.
    pub(crate) fn decode_samples<'a>(
        &mut self,
        [width, height]: [usize; 2],
        rounding: Rounding,
        defined: Option<&[bool]>,
        is_last: bool,
        bytes: &'a [u8],
        samples: &mut Vec<i32>,
    ) -> Result<&'a [u8], DecodeError> {
        let (own, rest) = if is_last { (bytes, &[][..]) } else { split_channel(bytes)? };
        self.pyramid.decode(width, height, rounding, defined, own, samples)?;
        Ok(rest)
    }
}

/// A channel with its length before it, and what is behind.
fn split_channel(bytes: &[u8]) -> Result<(&[u8], &[u8]), DecodeError> {
    let truncated = DecodeError::Truncated { field: "channel" };
    let mut length = 0;
    // A strip has less than 2^28 bytes.
    for at in 0..4 {
        let &byte = bytes.get(at).ok_or(truncated.clone())?;
        length |= usize::from(byte & 0x7f) << (7 * at);
        if byte < 0x80 {
            return bytes[at + 1..].split_at_checked(length).ok_or(truncated);
        }
    }
    Err(DecodeError::Malformed { field: "length of channel", expected: "at most four bytes" })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn channels() -> impl Strategy<Value = (Extents, Vec<Vec<u32>>, Vec<bool>)> {
        let bits = prop::sample::select(vec![1, 8, 10, 16]);
        (bits, 1..50_usize, 1..40_usize).prop_flat_map(|(bits, width, height)| {
            let pixels = width * height;
            let channel = prop::collection::vec(0..1_u32 << bits, pixels);
            let flat = (0..1_u32 << bits).prop_map(move |code| vec![code; pixels]);
            let channels = prop::collection::vec(prop_oneof![channel, flat], 3);
            (Just(Extents { width, height, bits }), channels, prop::collection::vec(any::<bool>(), pixels))
        })
    }

    proptest! {
        #[test]
        fn codes_come_back_as_they_were((size, channels, defined) in channels(), count in 1..4_usize) {
            let (mut coder, mut bytes, mut back) = (ChannelCoder::default(), Vec::new(), vec![Vec::new(); count]);
            coder.encode_exact(size, Some(&defined), &channels[..count], &mut bytes);
            coder.decode_exact(size, Some(&defined), &bytes, &mut back).unwrap();
            for (was, is) in channels.iter().zip(&back) {
                prop_assert!(was.iter().zip(is).zip(&defined).all(|((was, is), &defined)| !defined || was == is));
            }
            for end in 0..bytes.len() {
                prop_assert!(coder.decode_exact(size, Some(&defined), &bytes[..end], &mut back).is_err());
            }
        }

        #[test]
        fn every_colour_is_within_the_bound((size, channels, defined) in channels(), error in 1..=64_u8) {
            let mask = (1_u32 << size.bits) - 1;
            let differences = [1, 2].map(|at: usize| {
                channels[at].iter().zip(&channels[0]).map(|(code, green)| code.wrapping_sub(*green) & mask).collect()
            });
            let [red, blue] = differences;
            let (mut coder, mut bytes, mut back) = (ChannelCoder::default(), Vec::new(), vec![Vec::new(); 3]);
            coder.encode_color(size, error, Some(&defined), &[channels[0].clone(), red, blue], &mut bytes);
            coder.decode_color(size, error, Some(&defined), &bytes, &mut back).unwrap();
            for at in (0..defined.len()).filter(|&at| defined[at]) {
                for channel in 0..3 {
                    let is = match channel {
                        0 => back[0][at],
                        _ => back[channel][at].wrapping_add(back[0][at]),
                    };
                    prop_assert!(is <= mask && is.abs_diff(channels[channel][at]) <= u32::from(error), "{} {}", is, channel);
                }
            }
        }
    }

    #[test]
    fn lengths_of_channels_are_checked() {
        for bytes in [&[][..], &[5, 0, 0], &[0x85], &[0x80, 0x80, 0x80, 0x80, 0]] {
            assert!(split_channel(bytes).is_err(), "{bytes:?}");
        }
        assert_eq!(split_channel(&[2, 7, 8, 9]), Ok((&[7, 8][..], &[9][..])));
    }
}
