//! All image metrics of one displayed image at once.

use super::{ErrorMap, MeasureError, PIXELS_PER_DEGREE, dssim, flip, psnr_srgb8};
use image::RgbImage;

/// How far a displayed image is from its reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageError {
    /// Peak signal-to-noise ratio on the display codes, in dB; higher is better.
    pub psnr_db: f64,
    /// `(1 - SSIM) / 2` on luminance, 0 to 1; lower is better.
    pub dssim: f64,
    /// Mean FLIP, 0 to 1; lower is better.
    pub flip: f64,
}

/// The metrics, and where the difference is.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// The metrics.
    pub error: ImageError,
    /// FLIP of every pixel.
    pub map: ErrorMap,
}

impl Compared {
    /// The metrics over the pixels under `mask` alone, of the two images that were compared.
    ///
    /// # Errors
    /// A mask that does not fit or covers nothing.
    pub fn under_mask(
        &self,
        reference: &RgbImage,
        shown: &RgbImage,
        mask: &[bool],
    ) -> Result<ImageError, MeasureError> {
        let mask = Some(mask);
        let psnr_db = psnr_srgb8(reference, shown, mask)?;
        Ok(ImageError { psnr_db, dssim: dssim(reference, shown, mask)?, flip: self.map.mean(mask)? })
    }
}

/// Compares `shown` with `reference`, both 8-bit sRGB, under `mask` (row by row, true counts) or everywhere.
///
/// # Errors
/// Images of different size, a mask that does not fit or covers nothing.
pub fn compare(reference: &RgbImage, shown: &RgbImage, mask: Option<&[bool]>) -> Result<Compared, MeasureError> {
    let psnr_db = psnr_srgb8(reference, shown, mask)?;
    let dssim = dssim(reference, shown, mask)?;
    let map = flip(reference, shown, PIXELS_PER_DEGREE)?;
    let flip = map.mean(mask)?;
    Ok(Compared { error: ImageError { psnr_db, dssim, flip }, map })
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn all_metrics_agree_that_nothing_differs() {
        let image = RgbImage::from_fn(32, 32, |x, y| Rgb([x as u8, y as u8, 80]));
        let compared = compare(&image, &image, None).unwrap();
        assert_eq!((compared.error.psnr_db, compared.error.flip), (super::super::PSNR_CAP_DB, 0.0));
        assert!(compared.error.dssim < 1e-12);
    }

    #[test]
    fn all_metrics_agree_which_image_is_worse() {
        let image = RgbImage::from_fn(64, 64, |x, y| Rgb([(4 * x) as u8, (4 * y) as u8, 80]));
        let shifted = |by: u32| RgbImage::from_fn(64, 64, |x, y| *image.get_pixel((x + by).min(63), y));
        let (near, far) = (compare(&image, &shifted(1), None).unwrap(), compare(&image, &shifted(9), None).unwrap());
        assert!(near.error.psnr_db > far.error.psnr_db);
        assert!(near.error.dssim < far.error.dssim);
        assert!(near.error.flip < far.error.flip);
    }

    #[test]
    fn under_a_mask_it_is_what_comparing_under_the_mask_says() {
        let image = RgbImage::from_fn(64, 48, |x, y| Rgb([(4 * x) as u8, (5 * y) as u8, 80]));
        let shown = RgbImage::from_fn(64, 48, |x, y| *image.get_pixel((x + x / 32).min(63), y));
        let mask: Vec<bool> = (0..64 * 48).map(|pixel| pixel % 64 > 40).collect();
        let whole = compare(&image, &shown, None).unwrap();
        let masked = compare(&image, &shown, Some(&mask)).unwrap().error;
        assert_eq!(whole.under_mask(&image, &shown, &mask).unwrap(), masked);
        assert!(masked.psnr_db < whole.error.psnr_db);
        assert!(whole.under_mask(&image, &shown, &[false; 64 * 48]).is_err());
    }
}
