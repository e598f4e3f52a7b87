//! Masks: one bit per pixel, every row against the one above, so that an outline is all that is left for
//! zstd.

/// Appends the packed mask to `bytes`: rows of whole bytes, lowest bit first, XORed with the row above.
pub(crate) fn pack(width: usize, defined: &[bool], bytes: &mut Vec<u8>) {
    let row_bytes = width.div_ceil(8);
    let start = bytes.len();
    bytes.reserve(packed_bytes(width, defined.len()));
    for row in defined.chunks_exact(width) {
        let byte = |eight: &[bool]| eight.iter().rev().fold(0, |byte, &defined| byte << 1 | u8::from(defined));
        bytes.extend(row.chunks(8).map(byte));
    }
    let rows = &mut bytes[start..];
    for at in (row_bytes..rows.len()).rev() {
        rows[at] ^= rows[at - row_bytes];
    }
}

/// Bytes of a packed mask.
pub(crate) fn packed_bytes(width: usize, pixels: usize) -> usize {
    width.div_ceil(8) * (pixels / width)
}

/// Reads a mask into one bool per pixel; `None` where the length is wrong or padding is not zero.
pub(crate) fn unpack(bytes: &[u8], width: usize, pixels: usize, defined: &mut Vec<bool>) -> Option<()> {
    let row_bytes = width.div_ceil(8);
    if bytes.len() != packed_bytes(width, pixels) {
        return None;
    }
    defined.clear();
    defined.reserve(pixels);
    let mut row = vec![0_u8; row_bytes];
    for differences in bytes.chunks_exact(row_bytes) {
        for (byte, difference) in row.iter_mut().zip(differences) {
            *byte ^= difference;
        }
        for &byte in &row[..width / 8] {
            defined.extend_from_slice(&[0, 1, 2, 3, 4, 5, 6, 7].map(|bit| byte >> bit & 1 == 1));
        }
        if !width.is_multiple_of(8) {
            let last = row[row_bytes - 1];
            defined.extend((0..width % 8).map(|bit| last >> bit & 1 == 1));
            if last >> (width % 8) != 0 {
                return None;
            }
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn masks_come_back(width in 1..40_usize, rows in 1..10_usize, seed in any::<u64>()) {
            let bit = |index: usize| (seed.rotate_left(index as u32 * 7) ^ index as u64) & 1 == 1;
            let pixels: Vec<bool> = (0..width * rows).map(bit).collect();
            let mut bytes = Vec::new();
            pack(width, &pixels, &mut bytes);
            prop_assert_eq!(bytes.len(), packed_bytes(width, pixels.len()));
            let mut defined = Vec::new();
            prop_assert!(unpack(&bytes, width, width * rows, &mut defined).is_some());
            prop_assert_eq!(&defined, &pixels);
            prop_assert!(unpack(&bytes[1..], width, width * rows, &mut defined).is_none());
        }
    }

    #[test]
    fn the_first_pixel_is_the_lowest_bit_and_rows_are_differences() {
        let mut bytes = Vec::new();
        let row = [true, false, true, true, false, false, false, false, true];
        pack(9, &[row, row].concat(), &mut bytes);
        assert_eq!(bytes, [0b0000_1101, 1, 0, 0]);
        assert!(unpack(&[0, 0b10, 0, 0], 9, 18, &mut Vec::new()).is_none(), "padding");
    }

    #[test]
    fn a_vertical_edge_costs_one_row() {
        let mut bytes = Vec::new();
        let pixels: Vec<bool> = (0..32 * 8).map(|index| index % 32 < 13).collect();
        pack(32, &pixels, &mut bytes);
        assert!(bytes[4..].iter().all(|&byte| byte == 0));
    }
}
