//! Image files to texels.
//!
//! PNG and JPEG hold sRGB (IEC 61966-2-1) unless the scene says otherwise; Radiance .hdr and OpenEXR hold
//! linear light. The size is read and checked before pixels are decoded. Textures keep the numbers of the file
//! ([`texels`]), surroundings become linear floats ([`decode`]).

use super::SceneError;
use super::texels::{Texels, Transfer, Values, linear_from_srgb};
use super::untrusted::{MAX_IMAGE_SIDE, MAX_TEXELS, check_limit};
use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use std::io::Cursor;

/// How the numbers of an image file map to light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// sRGB where the format is PNG or JPEG, else linear.
    ByFormat,
    /// Numbers are proportional to light (data textures, roughness and the like).
    #[allow(dead_code, reason = "surroundings, which alone are decoded at once, are light in our scene files")]
    Linear,
}

/// A decoded image: linear RGB, row 0 at the top.
#[derive(Clone, Debug)]
pub(super) struct Picture {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) texels: Vec<[f32; 3]>,
}

/// Decodes an image file to linear light; `file` names it in messages.
pub(super) fn decode(file: &str, bytes: &[u8], encoding: Encoding) -> Result<Picture, SceneError> {
    let (decoded, transfer) = read(file, bytes)?;
    let is_srgb = encoding == Encoding::ByFormat && transfer == Transfer::Srgb;
    let linear = |value: f32| if is_srgb { linear_from_srgb(value) } else { value.max(0.0) };
    let texels: Vec<_> = decoded.to_rgb32f().pixels().map(|pixel| pixel.0.map(linear)).collect();
    if texels.iter().flatten().any(|value| !value.is_finite()) {
        return Err(malformed(file, NOT_FINITE));
    }
    Ok(Picture { width: decoded.width(), height: decoded.height(), texels })
}

/// The texels of an image file as they are stored; `file` names it in messages.
pub(super) fn texels(file: &str, bytes: &[u8]) -> Result<Texels, SceneError> {
    let (decoded, transfer) = read(file, bytes)?;
    let size = (decoded.width(), decoded.height());
    let channels = usize::from(decoded.color().channel_count());
    let values = match decoded {
        DynamicImage::ImageLuma8(image) => Values::Bytes(image.into_raw()),
        DynamicImage::ImageLumaA8(image) => Values::Bytes(image.into_raw()),
        DynamicImage::ImageRgb8(image) => Values::Bytes(image.into_raw()),
        DynamicImage::ImageRgba8(image) => Values::Bytes(image.into_raw()),
        DynamicImage::ImageLuma16(image) => Values::Words(image.into_raw()),
        DynamicImage::ImageLumaA16(image) => Values::Words(image.into_raw()),
        DynamicImage::ImageRgb16(image) => Values::Words(image.into_raw()),
        DynamicImage::ImageRgba16(image) => Values::Words(image.into_raw()),
        DynamicImage::ImageRgb32F(image) => Values::Floats(image.into_raw()),
        DynamicImage::ImageRgba32F(image) => Values::Floats(image.into_raw()),
        _ => return Err(malformed(file, "expected an image of 1 to 4 channels of 8, 16 or 32 bits")),
    };
    let values = match values {
        Values::Floats(mut values) => {
            if values.iter().any(|value| !value.is_finite()) {
                return Err(malformed(file, NOT_FINITE));
            }
            values.iter_mut().for_each(|value| *value = value.max(0.0));
            Values::Floats(values)
        }
        values => values,
    };
    Texels::new(size, channels, values, transfer).ok_or_else(|| malformed(file, "expected as many texels as it says"))
}

const NOT_FINITE: &str = "the image has texels that are no finite number";

fn malformed(file: &str, reason: &str) -> SceneError {
    SceneError::Malformed { file: file.to_owned(), reason: one_line(reason) }
}

/// What is in the file, and how its format stores light.
fn read(file: &str, bytes: &[u8]) -> Result<(DynamicImage, Transfer), SceneError> {
    let malformed = |reason: String| malformed(file, &reason);
    let reader = || ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let sized = reader().map_err(|e| malformed(e.to_string()))?;
    let format = sized.format().ok_or_else(|| malformed("expected a PNG, JPEG, HDR or EXR image".to_owned()))?;
    let (width, height) = sized.into_dimensions().map_err(|e| malformed(e.to_string()))?;
    check_limit(file, "texels per image side", u64::from(MAX_IMAGE_SIDE), u64::from(width.max(height)))?;
    check_limit(file, "texels", MAX_TEXELS, u64::from(width) * u64::from(height))?;
    if width == 0 || height == 0 {
        return Err(malformed("the image is empty".to_owned()));
    }

    let mut full = reader().map_err(|e| malformed(e.to_string()))?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_IMAGE_SIDE);
    limits.max_image_height = Some(MAX_IMAGE_SIDE);
    // 16 bytes a texel (RGBA floats), with as much again as working memory of the decoder.
    limits.max_alloc = Some(32 * MAX_TEXELS);
    full.limits(limits);
    let decoded = full.decode().map_err(|e| malformed(e.to_string()))?;
    let is_srgb = matches!(format, ImageFormat::Png | ImageFormat::Jpeg);
    Ok((decoded, if is_srgb { Transfer::Srgb } else { Transfer::Linear }))
}

/// A message of somebody else's as one line of ours.
pub(super) fn one_line(message: &str) -> String {
    message.lines().map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(width: u32, height: u32, value: u8) -> Vec<u8> {
        let mut bytes = Vec::new();
        let image = image::RgbImage::from_pixel(width, height, image::Rgb([value; 3]));
        image.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png).unwrap();
        bytes
    }

    #[test]
    fn png_is_srgb_unless_said_otherwise() {
        let middle_grey = decode("a.png", &png(2, 3, 188), Encoding::ByFormat).unwrap();
        assert_eq!((middle_grey.width, middle_grey.height, middle_grey.texels.len()), (2, 3, 6));
        assert!((middle_grey.texels[0][0] - 0.5029).abs() < 1e-3);
        let plain = decode("a.png", &png(2, 3, 188), Encoding::Linear).unwrap();
        assert!((plain.texels[0][0] - 188.0 / 255.0).abs() < 1e-6);
    }

    #[test]
    fn stored_texels_decode_to_the_same_light() {
        let mut image = image::RgbaImage::new(3, 2);
        image.pixels_mut().enumerate().for_each(|(i, p)| p.0 = [i as u8 * 40, 7, 255, 100]);
        let mut bytes = Vec::new();
        image.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png).unwrap();
        let (stored, decoded) =
            (texels("a.png", &bytes).unwrap(), decode("a.png", &bytes, Encoding::ByFormat).unwrap());
        assert_eq!((stored.width(), stored.height(), stored.bytes(), stored.transfer()), (3, 2, 24, Transfer::Srgb));
        for (index, texel) in decoded.texels.iter().enumerate() {
            let found = stored.at(index % 3, index / 3, Transfer::Srgb).to_array();
            assert!((0..3).all(|channel| (found[channel] - texel[channel]).abs() < 1e-6), "{found:?} {texel:?}");
            assert!((found[3] - 100.0 / 255.0).abs() < 1e-6);
        }
        assert_eq!((stored.constant(3), stored.constant(0)), (Some(100.0 / 255.0), None));
    }

    #[test]
    fn a_damaged_image_is_one_line_that_names_it() {
        let whole = png(16, 16, 7);
        for length in 0..whole.len() {
            if let Err(error) = decode("a.png", &whole[..length], Encoding::ByFormat) {
                let line = error.to_string();
                assert!(line.starts_with("a.png: ") && !line.contains('\n'), "{line}");
            }
        }
        assert!(decode("a.png", b"hello", Encoding::ByFormat).is_err());
    }

    #[test]
    fn an_image_that_claims_to_be_huge_is_refused_before_decoding() {
        let mut bytes = png(4, 4, 7);
        // Width and height in the header, then its checksum, which the size check does not wait for.
        bytes[16..20].copy_from_slice(&60_000_u32.to_be_bytes());
        assert!(decode("a.png", &bytes, Encoding::ByFormat).is_err());
    }
}
