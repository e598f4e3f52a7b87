//! A picture of fewer pixels, enlarged to the display's.
//!
//! Bilinear between the centres of the pixels, on display codes, in fixed point: 8 bits of position, so that equal codes
//! stay what they are to the bit. One row of the picture is made by one thread. Cost: 4 reads and 6 products per channel.

use image::RgbImage;
use rayon::prelude::*;

/// Steps between two pixels.
const STEPS: u32 = 256;

/// For a pixel of the large picture the lower of two of the small one, the upper one, and the weight of that.
fn place(at: u32, large: u32, small: u32) -> [u32; 3] {
    // Centres: (at + 0.5) * small / large - 0.5, in steps.
    let centre = (u64::from(2 * at + 1) * u64::from(small) * u64::from(STEPS) / u64::from(2 * large)) as u32;
    let from_first = centre.saturating_sub(STEPS / 2);
    let low = (from_first / STEPS).min(small - 1);
    [low, (low + 1).min(small - 1), from_first % STEPS]
}

/// Enlarges `small` into all of `picture`, which has pixels as it had before; `columns` is memory.
pub(super) fn enlarge(small: &RgbImage, picture: &mut RgbImage, columns: &mut Vec<[u32; 3]>) {
    let ((width, height), (small_width, small_height)) = (picture.dimensions(), small.dimensions());
    if width == 0 || height == 0 || small_width == 0 || small_height == 0 {
        return;
    }
    columns.clear();
    columns.extend((0..width).map(|x| place(x, width, small_width)));
    let (small_rows, columns) = (small.as_raw(), &*columns);
    let row_bytes = 3 * small_width as usize;
    let row = |y: u32| &small_rows[y as usize * row_bytes..][..row_bytes];
    picture.par_chunks_mut(3 * width as usize).enumerate().for_each(|(y, codes)| {
        let [low, high, weight] = place(y as u32, height, small_height);
        let (upper, lower) = (row(low).as_chunks::<3>().0, row(high).as_chunks::<3>().0);
        for (code, &[left, right, along]) in codes.as_chunks_mut::<3>().0.iter_mut().zip(columns) {
            let (left, right) = (left as usize, right as usize);
            for channel in 0..3 {
                let mix = |row: &[[u8; 3]]| {
                    u32::from(row[left][channel]) * (STEPS - along) + u32::from(row[right][channel]) * along
                };
                let sum = mix(upper) * (STEPS - weight) + mix(lower) * weight;
                code[channel] = ((sum + STEPS * STEPS / 2) / (STEPS * STEPS)) as u8;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn enlarged(small: &RgbImage, width: u32, height: u32) -> RgbImage {
        let mut picture = RgbImage::new(width, height);
        enlarge(small, &mut picture, &mut Vec::new());
        picture
    }

    #[test]
    fn equal_codes_and_pictures_of_the_same_size_stay_what_they_are() {
        let even = RgbImage::from_pixel(7, 5, Rgb([13, 200, 255]));
        assert!(enlarged(&even, 20, 11).pixels().all(|pixel| *pixel == Rgb([13, 200, 255])));
        let any = RgbImage::from_fn(9, 4, |x, y| Rgb([(x * 27) as u8, (y * 60) as u8, (x * y) as u8]));
        assert_eq!(enlarged(&any, 9, 4), any);
        assert_eq!(enlarged(&RgbImage::new(1, 1), 5, 5), RgbImage::new(5, 5));
    }

    #[test]
    fn a_ramp_stays_one_and_nothing_moves_aside() {
        let ramp = RgbImage::from_fn(64, 2, |x, _| Rgb([(4 * x) as u8; 3]));
        let large = enlarged(&ramp, 128, 4);
        // Its centre is at (x + 0.5) / 2 - 0.5 of the small one.
        for x in 2..126 {
            let expected = 4.0 * ((f64::from(x) + 0.5) / 2.0 - 0.5);
            let found = f64::from(large.get_pixel(x, 1).0[0]);
            assert!((found - expected).abs() <= 0.5 + 4.0 / 256.0, "{x}: {found} {expected}");
        }
    }
}
