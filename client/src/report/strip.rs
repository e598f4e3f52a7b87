//! Pictures side by side with a caption above each, as one picture that stands alone.
//!
//! The letters are a 5 x 7 raster drawn here: no font has to be found on the machine or carried along.

use image::{GenericImage, Rgb, RgbImage};

/// Pixels between two pictures.
const GAP_PX: u32 = 4;
/// Columns and rows of a letter.
const LETTER: (u32, u32) = (5, 7);
const PAPER: Rgb<u8> = Rgb([24, 24, 27]);
const INK: Rgb<u8> = Rgb([228, 228, 231]);

/// Letters as rows from above, the leftmost column in bit 4. Lower case is shown as upper case.
const LETTERS: [(char, [u8; 7]); 45] = [
    ('A', [0x0e, 0x11, 0x11, 0x1f, 0x11, 0x11, 0x11]),
    ('B', [0x1e, 0x11, 0x11, 0x1e, 0x11, 0x11, 0x1e]),
    ('C', [0x0e, 0x11, 0x10, 0x10, 0x10, 0x11, 0x0e]),
    ('D', [0x1e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x1e]),
    ('E', [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x1f]),
    ('F', [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x10]),
    ('G', [0x0e, 0x11, 0x10, 0x17, 0x11, 0x11, 0x0f]),
    ('H', [0x11, 0x11, 0x11, 0x1f, 0x11, 0x11, 0x11]),
    ('I', [0x0e, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0e]),
    ('J', [0x07, 0x02, 0x02, 0x02, 0x02, 0x12, 0x0c]),
    ('K', [0x11, 0x12, 0x14, 0x18, 0x14, 0x12, 0x11]),
    ('L', [0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x1f]),
    ('M', [0x11, 0x1b, 0x15, 0x15, 0x11, 0x11, 0x11]),
    ('N', [0x11, 0x11, 0x19, 0x15, 0x13, 0x11, 0x11]),
    ('O', [0x0e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e]),
    ('P', [0x1e, 0x11, 0x11, 0x1e, 0x10, 0x10, 0x10]),
    ('Q', [0x0e, 0x11, 0x11, 0x11, 0x15, 0x12, 0x0d]),
    ('R', [0x1e, 0x11, 0x11, 0x1e, 0x14, 0x12, 0x11]),
    ('S', [0x0f, 0x10, 0x10, 0x0e, 0x01, 0x01, 0x1e]),
    ('T', [0x1f, 0x04, 0x04, 0x04, 0x04, 0x04, 0x04]),
    ('U', [0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e]),
    ('V', [0x11, 0x11, 0x11, 0x11, 0x11, 0x0a, 0x04]),
    ('W', [0x11, 0x11, 0x11, 0x15, 0x15, 0x15, 0x0a]),
    ('X', [0x11, 0x11, 0x0a, 0x04, 0x0a, 0x11, 0x11]),
    ('Y', [0x11, 0x11, 0x11, 0x0a, 0x04, 0x04, 0x04]),
    ('Z', [0x1f, 0x01, 0x02, 0x04, 0x08, 0x10, 0x1f]),
    ('0', [0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e]),
    ('1', [0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e]),
    ('2', [0x0e, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1f]),
    ('3', [0x1f, 0x02, 0x04, 0x02, 0x01, 0x11, 0x0e]),
    ('4', [0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02]),
    ('5', [0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e]),
    ('6', [0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e]),
    ('7', [0x1f, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08]),
    ('8', [0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e]),
    ('9', [0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c]),
    (' ', [0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00]),
    ('.', [0x00, 0x00, 0x00, 0x00, 0x00, 0x0c, 0x0c]),
    (',', [0x00, 0x00, 0x00, 0x00, 0x0c, 0x04, 0x08]),
    (':', [0x00, 0x0c, 0x0c, 0x00, 0x0c, 0x0c, 0x00]),
    ('-', [0x00, 0x00, 0x00, 0x1f, 0x00, 0x00, 0x00]),
    ('_', [0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x1f]),
    ('/', [0x00, 0x01, 0x02, 0x04, 0x08, 0x10, 0x00]),
    ('%', [0x18, 0x19, 0x02, 0x04, 0x08, 0x13, 0x03]),
    ('?', [0x0e, 0x11, 0x01, 0x02, 0x04, 0x00, 0x04]),
];

/// Puts pictures side by side, each under its caption; letters that are not known are question marks, and a caption
/// ends where its picture does.
pub fn strip(pictures: &[(&str, &RgbImage)]) -> RgbImage {
    // Captions of some forty letters fit above their picture.
    let scale = pictures.iter().map(|(_, picture)| picture.width() / 250).max().unwrap_or(1).max(1);
    let caption_px = scale * (LETTER.1 + 4);
    let widths: u32 = pictures.iter().map(|(_, picture)| picture.width() + GAP_PX).sum();
    let height = pictures.iter().map(|(_, picture)| picture.height()).max().unwrap_or(0);
    let mut strip = RgbImage::from_pixel(widths.saturating_sub(GAP_PX), height + caption_px, PAPER);
    let mut left = 0;
    for (caption, picture) in pictures {
        // It fits: the sizes are sums.
        let _ = strip.copy_from(*picture, left, caption_px);
        write(&mut strip, caption, (left + 2 * scale, 2 * scale), left + picture.width(), scale);
        left += picture.width() + GAP_PX;
    }
    strip
}

/// Writes `text` from `(x, y)` on, as far as `right`.
fn write(strip: &mut RgbImage, text: &str, (mut x, y): (u32, u32), right: u32, scale: u32) {
    for letter in text.chars().map(|letter| letter.to_ascii_uppercase()) {
        let raster = |wanted: char| LETTERS.iter().find(|(letter, _)| *letter == wanted).map(|(_, rows)| rows);
        let Some(rows) = raster(letter).or_else(|| raster('?')) else { continue };
        if x + LETTER.0 * scale > right {
            return;
        }
        for row in 0..LETTER.1 * scale {
            for column in 0..LETTER.0 * scale {
                if rows[(row / scale) as usize] >> (LETTER.0 - 1 - column / scale) & 1 == 1 {
                    strip.put_pixel(x + column, y + row, INK);
                }
            }
        }
        x += (LETTER.0 + 1) * scale;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_stand_side_by_side_and_unchanged() {
        let picture = |red: u8| RgbImage::from_fn(300, 40, |x, y| Rgb([red, x as u8, y as u8]));
        let (first, second) = (picture(1), picture(2));
        let strip = strip(&[("reference", &first), ("specular: 31.2 dB", &second)]);
        assert_eq!(strip.dimensions(), (604, 51));
        for (x, y, code) in second.enumerate_pixels() {
            assert_eq!(strip.get_pixel(304 + x, 11 + y), code);
            assert_eq!(strip.get_pixel(x, 11 + y), first.get_pixel(x, y));
        }
    }

    #[test]
    fn a_caption_is_written_and_never_runs_into_the_next_picture() {
        let picture = RgbImage::new(40, 10);
        let long = "far too long a caption for this: 100 % \u{e4}";
        let strip = strip(&[(long, &picture), ("", &picture)]);
        let ink = |columns: std::ops::Range<u32>| {
            columns.flat_map(|x| (0..11).map(move |y| (x, y))).filter(|&(x, y)| *strip.get_pixel(x, y) == INK).count()
        };
        assert!(ink(0..40) > 30);
        assert_eq!(ink(40..84), 0);
    }

    #[test]
    fn no_two_letters_look_alike() {
        for (index, (_, rows)) in LETTERS.iter().enumerate() {
            assert!(rows.iter().all(|row| row >> LETTER.0 == 0));
            assert!(LETTERS[index + 1..].iter().all(|(_, other)| other != rows));
        }
    }

    #[test]
    fn no_pictures_are_an_empty_strip() {
        assert_eq!(strip(&[]).width(), 0);
    }
}
