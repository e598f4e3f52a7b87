//! Texels of image files, kept as they are stored and decoded when they are looked up.
//!
//! An asset of twenty images of 4096 by 4096 texels is 1.3 GB as 8-bit RGBA and 5 GB as RGBA floats; so 8 and
//! 16 bits stay what they are, and a table gives their light (IEC 61966-2-1, or proportional). Colours and data
//! (roughness, normals) may come from one image: how it is decoded is the business of who looks it up, see
//! `ImageTexture`. Alpha is always proportional.
//!
//! Cost: 1 to 4 channels of 1, 2 or 4 bytes per texel; a lookup is one table entry per channel.

use glam::Vec4;
use std::sync::LazyLock;

/// How stored numbers map to light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Transfer {
    /// IEC 61966-2-1.
    Srgb,
    /// Proportional.
    Linear,
}

/// An image as it is stored: row 0 at the top, channels of a texel side by side.
#[derive(Clone, Debug, PartialEq)]
pub struct Texels {
    width: u32,
    height: u32,
    /// 1 grey, 2 grey and alpha, 3 RGB, 4 RGBA.
    channels: usize,
    values: Values,
    /// What the format of its file says.
    transfer: Transfer,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Values {
    Bytes(Vec<u8>),
    Words(Vec<u16>),
    /// Always linear.
    Floats(Vec<f32>),
}

impl Texels {
    /// From the numbers of a file; `None` where their number is not that of such an image.
    pub(super) fn new(
        (width, height): (u32, u32),
        channels: usize,
        values: Values,
        transfer: Transfer,
    ) -> Option<Texels> {
        let length = match &values {
            Values::Bytes(values) => values.len(),
            Values::Words(values) => values.len(),
            Values::Floats(values) => values.len(),
        };
        let wanted = (width as usize).checked_mul(height as usize)?.checked_mul(channels)?;
        let fits = wanted > 0 && channels <= 4 && wanted == length;
        fits.then_some(Texels { width, height, channels, values, transfer })
    }

    /// From linear RGB, as many rows of `width` as there are.
    pub fn from_linear_rgb(width: u32, texels: Vec<[f32; 3]>) -> Option<Texels> {
        let height = (texels.len() as u32).checked_div(width)?;
        let values = Values::Floats(texels.into_flattened());
        Texels::new((width, height), 3, values, Transfer::Linear)
    }

    /// Texels per row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// What the format of its file says: sRGB for PNG and JPEG.
    pub fn transfer(&self) -> Transfer {
        self.transfer
    }

    /// The value of a channel (0 red to 3 alpha; stored numbers are taken as proportional) that is the same
    /// everywhere; `None` where it changes.
    pub(super) fn constant(&self, channel: usize) -> Option<f32> {
        fn unchanging<T: PartialEq>(values: &[T], first: usize, step: usize) -> bool {
            let mut channel = values.iter().skip(first).step_by(step);
            channel.next().is_some_and(|first| channel.all(|value| value == first))
        }
        let place = match (self.channels, channel) {
            (1, 3) | (3, 3) => return Some(1.0),
            (2, 3) => 1,
            (1 | 2, _) => 0,
            _ => channel,
        };
        let same = match &self.values {
            Values::Bytes(values) => unchanging(values, place, self.channels),
            Values::Words(values) => unchanging(values, place, self.channels),
            Values::Floats(values) => unchanging(values, place, self.channels),
        };
        same.then(|| self.at(0, 0, Transfer::Linear)[channel.min(3)])
    }

    /// Memory that it takes.
    pub fn bytes(&self) -> u64 {
        match &self.values {
            Values::Bytes(values) => values.len() as u64,
            Values::Words(values) => 2 * values.len() as u64,
            Values::Floats(values) => 4 * values.len() as u64,
        }
    }

    /// One texel as linear RGB and alpha; outside of the image black.
    pub(super) fn at(&self, column: usize, row: usize, transfer: Transfer) -> Vec4 {
        let first = (row * self.width as usize + column) * self.channels;
        match &self.values {
            Values::Bytes(values) => {
                let table = if transfer == Transfer::Srgb { &*SRGB_BYTES } else { &*LINEAR_BYTES };
                let linear = &*LINEAR_BYTES;
                self.rgba(values.get(first..), |&v| table[usize::from(v)], |&v| linear[usize::from(v)])
            }
            Values::Words(values) => {
                let linear = |&value: &u16| f32::from(value) / f32::from(u16::MAX);
                match transfer {
                    Transfer::Srgb => self.rgba(values.get(first..), |&v| SRGB_WORDS[usize::from(v)], linear),
                    Transfer::Linear => self.rgba(values.get(first..), linear, linear),
                }
            }
            Values::Floats(values) => self.rgba(values.get(first..), |&v| v, |&v| v),
        }
    }

    fn rgba<T>(&self, values: Option<&[T]>, color: impl Fn(&T) -> f32, alpha: impl Fn(&T) -> f32) -> Vec4 {
        match (self.channels, values) {
            (1, Some([grey, ..])) => Vec4::from((glam::Vec3::splat(color(grey)), 1.0)),
            (2, Some([grey, opacity, ..])) => Vec4::from((glam::Vec3::splat(color(grey)), alpha(opacity))),
            (3, Some([red, green, blue, ..])) => Vec4::new(color(red), color(green), color(blue), 1.0),
            (4, Some([red, green, blue, opacity, ..])) => {
                Vec4::new(color(red), color(green), color(blue), alpha(opacity))
            }
            _ => Vec4::W,
        }
    }
}

static LINEAR_BYTES: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|value| value as f32 / 255.0));
static SRGB_BYTES: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|value| linear_from_srgb(value as f32 / 255.0)));
/// 256 KiB, made only where a picture of 16 bits is looked up.
static SRGB_WORDS: LazyLock<Vec<f32>> =
    LazyLock::new(|| (0..=u16::MAX).map(|value| linear_from_srgb(f32::from(value) / f32::from(u16::MAX))).collect());

/// IEC 61966-2-1, for values in [0, 1].
pub(super) fn linear_from_srgb(value: f32) -> f32 {
    if value <= 0.040_45 { value.max(0.0) / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_and_words_decode_alike_and_alpha_is_never_srgb() {
        for value in [0_u8, 1, 9, 100, 188, 255] {
            let bytes = Texels::new((1, 1), 4, Values::Bytes(vec![value; 4]), Transfer::Srgb).unwrap();
            let words = Texels::new((1, 1), 2, Values::Words(vec![u16::from(value) * 257; 2]), Transfer::Srgb).unwrap();
            for transfer in [Transfer::Srgb, Transfer::Linear] {
                let (a, b) = (bytes.at(0, 0, transfer), words.at(0, 0, transfer));
                assert!((a - b).abs().max_element() < 1e-6, "{a} {b}");
                assert!((a.w - f32::from(value) / 255.0).abs() < 1e-7);
            }
            let expected = linear_from_srgb(f32::from(value) / 255.0);
            assert_eq!(bytes.at(0, 0, Transfer::Srgb).x, expected);
        }
    }

    #[test]
    fn texels_take_the_memory_of_their_file_format() {
        let image = |channels: usize| {
            Texels::new((16, 8), channels, Values::Bytes(vec![255; 128 * channels]), Transfer::Srgb).unwrap()
        };
        assert_eq!([1, 2, 3, 4].map(|channels| image(channels).bytes()), [128, 256, 384, 512]);
        assert_eq!(image(1).at(3, 3, Transfer::Srgb), Vec4::ONE);
    }

    #[test]
    fn numbers_that_are_no_image_are_none() {
        assert!(Texels::new((2, 2), 3, Values::Bytes(vec![0; 11]), Transfer::Srgb).is_none());
        assert!(Texels::new((0, 2), 3, Values::Bytes(Vec::new()), Transfer::Srgb).is_none());
        assert!(Texels::new((u32::MAX, u32::MAX), 4, Values::Bytes(Vec::new()), Transfer::Srgb).is_none());
        assert!(Texels::from_linear_rgb(0, vec![[0.0; 3]]).is_none());
        assert!(Texels::from_linear_rgb(2, vec![[0.0; 3]; 3]).is_none());
    }

    #[test]
    fn a_channel_that_never_changes_is_a_constant() {
        let mut values = vec![255; 16];
        values[9] = 51;
        let image = |channels: usize, values: &[u8]| {
            Texels::new((2, 2), channels, Values::Bytes(values[..4 * channels].to_vec()), Transfer::Srgb).unwrap()
        };
        let rgba = image(4, &values);
        assert_eq!([0, 1, 2, 3].map(|channel| rgba.constant(channel)), [Some(1.0), None, Some(1.0), Some(1.0)]);
        let grey = image(1, &[51; 4]);
        assert_eq!([0, 1, 2, 3].map(|channel| grey.constant(channel)), [Some(0.2), Some(0.2), Some(0.2), Some(1.0)]);
        let with_alpha = image(2, &[51, 0, 51, 255, 51, 255, 51, 255]);
        assert_eq!([0, 2, 3].map(|channel| with_alpha.constant(channel)), [Some(0.2), Some(0.2), None]);
    }
}
