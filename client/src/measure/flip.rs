//! FLIP, the difference a viewer notices when two pictures alternate (Andersson et al. 2020), computed by
//! the authors' own code through the crate `nv-flip`. 0.65 s at 1080p.

use super::MeasureError;
use super::error::{check_sizes, covers};
use image::RgbImage;

/// Pixels per degree of the viewer's eye: the authors' default (0.7 m from a 0.7 m wide 4K display).
pub const PIXELS_PER_DEGREE: f32 = nv_flip::DEFAULT_PIXELS_PER_DEGREE;

/// The noticed difference of every pixel, 0 to 1, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorMap {
    width: u32,
    height: u32,
    values: Vec<f32>,
}

/// FLIP of two 8-bit sRGB images at `pixels_per_degree`.
///
/// # Errors
/// Images of different size or without pixels.
pub fn flip(reference: &RgbImage, shown: &RgbImage, pixels_per_degree: f32) -> Result<ErrorMap, MeasureError> {
    check_sizes(reference.dimensions(), shown.dimensions(), None)?;
    let (width, height) = reference.dimensions();
    let plane = |image: &RgbImage| nv_flip::FlipImageRgb8::with_data(width, height, image.as_raw());
    let values = nv_flip::flip(plane(reference), plane(shown), pixels_per_degree).to_vec();
    // The published filter may leave an ulp outside 0 to 1.
    let values = values.into_iter().map(|value| value.clamp(0.0, 1.0)).collect();
    Ok(ErrorMap { width, height, values })
}

impl ErrorMap {
    /// The values, row by row.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Mean over the pixels under the mask: the single number the authors recommend.
    ///
    /// # Errors
    /// A mask that does not fit or covers nothing.
    pub fn mean(&self, mask: Option<&[bool]>) -> Result<f64, MeasureError> {
        super::error::check_mask(self.values.len(), mask)?;
        let covered = self.values.iter().enumerate().filter(|(index, _)| covers(mask, *index));
        let (sum, count) =
            covered.fold((0.0, 0_usize), |(sum, count), (_, value)| (sum + f64::from(*value), count + 1));
        Ok(sum / count as f64)
    }

    /// The map in the colours of the paper (magma): black is no difference, light yellow the largest.
    pub fn to_magma(&self) -> RgbImage {
        let colours = nv_flip::magma_lut().to_vec();
        let colour = |value: f32| {
            let at = 3 * (value * 255.0).round() as usize;
            image::Rgb([colours[at], colours[at + 1], colours[at + 2]])
        };
        RgbImage::from_fn(self.width, self.height, |x, y| colour(self.values[(y * self.width + x) as usize]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn gradient(blue: u8) -> RgbImage {
        RgbImage::from_fn(40, 30, |x, y| Rgb([(6 * x) as u8, (8 * y) as u8, blue]))
    }

    #[test]
    fn identical_images_are_black_in_the_map() {
        let map = flip(&gradient(9), &gradient(9), PIXELS_PER_DEGREE).unwrap();
        assert_eq!(map.mean(None).unwrap(), 0.0);
        assert_eq!(map.to_magma().get_pixel(5, 5), map.to_magma().get_pixel(20, 20));
        assert!(map.to_magma().get_pixel(0, 0).0.iter().all(|&code| code < 8));
    }

    #[test]
    fn black_against_white_is_the_largest_difference() {
        let flat = |code: u8| RgbImage::from_pixel(32, 32, Rgb([code; 3]));
        let map = flip(&flat(0), &flat(255), PIXELS_PER_DEGREE).unwrap();
        assert!(map.mean(None).unwrap() > 0.95, "{:?}", map.mean(None));
        let Rgb([red, green, _]) = *map.to_magma().get_pixel(16, 16);
        assert!(red > 230 && green > 200);
    }

    #[test]
    fn more_difference_is_more_flip_and_the_mask_chooses() {
        let mut half = gradient(9);
        for (x, _, pixel) in half.enumerate_pixels_mut() {
            if x >= 20 {
                pixel.0[2] = 200;
            }
        }
        let map = flip(&gradient(9), &half, PIXELS_PER_DEGREE).unwrap();
        let right: Vec<bool> = (0..40 * 30).map(|index| index % 40 >= 30).collect();
        let left: Vec<bool> = (0..40 * 30).map(|index| index % 40 < 5).collect();
        let (all, right, left) = (map.mean(None), map.mean(Some(&right)), map.mean(Some(&left)));
        assert!(right.clone().unwrap() > all.clone().unwrap() && all.unwrap() > left.clone().unwrap());
        assert!(right.unwrap() > 0.3 && left.unwrap() < 0.05);
    }

    #[test]
    fn sizes_that_differ_are_refused() {
        assert!(flip(&gradient(1), &RgbImage::new(3, 3), PIXELS_PER_DEGREE).is_err());
        assert_eq!(flip(&RgbImage::new(0, 0), &RgbImage::new(0, 0), 67.0), Err(MeasureError::NoPixels));
    }
}
