//! Image files to linear texels.
//!
//! PNG and JPEG hold sRGB (IEC 61966-2-1) unless the scene says otherwise; Radiance .hdr and OpenEXR hold
//! linear light. The size is read and checked before pixels are decoded.

use super::SceneError;
use super::untrusted::{MAX_IMAGE_SIDE, MAX_TEXELS, check_limit};
use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use std::io::Cursor;

/// How the numbers of an image file map to light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// sRGB where the format is PNG or JPEG, else linear.
    ByFormat,
    /// Numbers are proportional to light (data textures, roughness and the like).
    Linear,
}

/// A decoded image: linear RGB, row 0 at the top.
#[derive(Clone, Debug)]
pub(super) struct Picture {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) texels: Vec<[f32; 3]>,
}

/// Decodes an image file; `file` names it in messages.
pub(super) fn decode(file: &str, bytes: &[u8], encoding: Encoding) -> Result<Picture, SceneError> {
    let malformed = |reason: String| SceneError::Malformed { file: file.to_owned(), reason: one_line(&reason) };
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
    let is_srgb = encoding == Encoding::ByFormat && matches!(format, ImageFormat::Png | ImageFormat::Jpeg);
    let texels = linear_texels(&decoded, is_srgb);
    if texels.iter().flatten().any(|value| !value.is_finite()) {
        return Err(malformed("the image has texels that are no finite number".to_owned()));
    }
    Ok(Picture { width: decoded.width(), height: decoded.height(), texels })
}

fn linear_texels(decoded: &DynamicImage, is_srgb: bool) -> Vec<[f32; 3]> {
    let rgb = decoded.to_rgb32f();
    let linear = |value: f32| if is_srgb { linear_from_srgb(value) } else { value.max(0.0) };
    rgb.pixels().map(|pixel| pixel.0.map(linear)).collect()
}

/// IEC 61966-2-1, for values in [0, 1].
fn linear_from_srgb(value: f32) -> f32 {
    if value <= 0.040_45 { value.max(0.0) / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
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
