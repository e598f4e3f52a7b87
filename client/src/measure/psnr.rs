//! Peak signal-to-noise ratio: `10 log10(peak^2 / MSE)` over all channels of all compared pixels, in dB.

use super::MeasureError;
use super::error::{check_mask, check_sizes, covers};
use glam::Vec3;
use image::RgbImage;

/// Identical images, and any that differ less than this, in dB: infinity has no place in a mean. A single
/// code in one channel of an 8K image is 122 dB away, so for pictures of our sizes the cap means identical.
pub const PSNR_CAP_DB: f64 = 99.0;

/// PSNR of two 8-bit sRGB images (peak 255), on the codes as they are displayed.
///
/// # Errors
/// Images of different size, a mask that does not fit or covers nothing.
pub fn psnr_srgb8(reference: &RgbImage, shown: &RgbImage, mask: Option<&[bool]>) -> Result<f64, MeasureError> {
    check_sizes(reference.dimensions(), shown.dimensions(), mask)?;
    let squares = |(a, b): (&image::Rgb<u8>, &image::Rgb<u8>)| -> u64 {
        (0..3).map(|channel| u64::from(a.0[channel].abs_diff(b.0[channel])).pow(2)).sum()
    };
    // Whole numbers, so that the sum does not depend on the order.
    let (mut sum, mut count) = (0_u64, 0_u64);
    for (index, pair) in reference.pixels().zip(shown.pixels()).enumerate() {
        if covers(mask, index) {
            sum += squares(pair);
            count += 3;
        }
    }
    Ok(decibel(255.0, sum as f64 / count as f64))
}

/// PSNR of two linear images whose white is `peak`; values beyond count as they are.
///
/// # Errors
/// Images of different size, a mask that does not fit or covers nothing, a value that is not finite.
pub fn psnr_linear(reference: &[Vec3], shown: &[Vec3], peak: f32, mask: Option<&[bool]>) -> Result<f64, MeasureError> {
    if reference.len() != shown.len() {
        let (expected, found) = (reference.len().to_string(), shown.len().to_string());
        return Err(MeasureError::SizeMismatch { expected, found });
    }
    check_mask(reference.len(), mask)?;
    let (mut sum, mut count) = (0.0, 0_u64);
    for (index, (a, b)) in reference.iter().zip(shown).enumerate().filter(|(index, _)| covers(mask, *index)) {
        let difference = a.as_dvec3() - b.as_dvec3();
        if !difference.is_finite() {
            return Err(MeasureError::NotFinite { index, value: difference.element_sum() });
        }
        sum += difference.length_squared();
        count += 3;
    }
    Ok(decibel(f64::from(peak), sum / count as f64))
}

fn decibel(peak: f64, mean_square: f64) -> f64 {
    (10.0 * (peak * peak / mean_square).log10()).min(PSNR_CAP_DB)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn flat(code: u8) -> RgbImage {
        RgbImage::from_pixel(16, 8, Rgb([code; 3]))
    }

    #[test]
    fn identical_images_reach_the_cap() {
        assert_eq!(psnr_srgb8(&flat(7), &flat(7), None).unwrap(), PSNR_CAP_DB);
        assert_eq!(psnr_linear(&[Vec3::ONE], &[Vec3::ONE], 1.0, None).unwrap(), PSNR_CAP_DB);
    }

    #[test]
    fn one_code_everywhere_is_48_decibel() {
        // 20 log10(255) = 48.1308 dB.
        assert!((psnr_srgb8(&flat(7), &flat(8), None).unwrap() - 48.130_804).abs() < 1e-5);
        let (a, b) = ([Vec3::splat(0.5); 4], [Vec3::splat(0.4); 4]);
        assert!((psnr_linear(&a, &b, 1.0, None).unwrap() - 20.0).abs() < 1e-5);
    }

    #[test]
    fn only_pixels_under_the_mask_count() {
        let (reference, mut shown) = (flat(100), flat(100));
        shown.put_pixel(0, 0, Rgb([0, 0, 0]));
        let mut mask = vec![true; 16 * 8];
        mask[0] = false;
        assert_eq!(psnr_srgb8(&reference, &shown, Some(&mask)).unwrap(), PSNR_CAP_DB);
        let only: Vec<bool> = mask.iter().map(|covered| !covered).collect();
        let expected = 20.0 * (255.0_f64 / 100.0).log10();
        assert!((psnr_srgb8(&reference, &shown, Some(&only)).unwrap() - expected).abs() < 1e-9);
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let other = RgbImage::new(8, 16);
        assert!(matches!(psnr_srgb8(&flat(1), &other, None), Err(MeasureError::SizeMismatch { .. })));
        assert_eq!(psnr_srgb8(&flat(1), &flat(1), Some(&[false; 128])), Err(MeasureError::NoPixels));
        assert!(matches!(psnr_srgb8(&flat(1), &flat(1), Some(&[true])), Err(MeasureError::SizeMismatch { .. })));
        assert_eq!(psnr_srgb8(&RgbImage::new(0, 0), &RgbImage::new(0, 0), None), Err(MeasureError::NoPixels));
        let nan = [Vec3::NAN];
        assert!(matches!(psnr_linear(&nan, &nan, 1.0, None), Err(MeasureError::NotFinite { index: 0, .. })));
    }
}
