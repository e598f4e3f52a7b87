//! Interface planes: which entry of the frame's table of optical boundaries a pixel shows, 0 for none.

use super::DecodeError;

/// The codes of pixel values; what the table does not hold is none.
pub(crate) fn quantise(interface: &[u8], entries: usize, codes: &mut Vec<u32>) {
    codes.clear();
    codes.extend(interface.iter().map(|&index| if usize::from(index) <= entries { u32::from(index) } else { 0 }));
}

/// The pixel values of codes; where `defined` is false there is none. A root is defined everywhere and has
/// no `defined`.
pub(crate) fn dequantise(
    codes: &[u32],
    entries: usize,
    defined: Option<&[bool]>,
    interface: &mut [u8],
) -> Result<(), DecodeError> {
    // What continues the codes over undefined pixels may be any number.
    let is_defined = |pixel: usize| defined.is_none_or(|defined| defined[pixel]);
    if codes.iter().enumerate().any(|(pixel, &code)| code as usize > entries && is_defined(pixel)) {
        return Err(DecodeError::Malformed { field: "interface", expected: "an entry of the table" });
    }
    for (interface, &code) in interface.iter_mut().zip(codes) {
        *interface = code as u8;
    }
    if let Some(defined) = defined {
        for (interface, &defined) in interface.iter_mut().zip(defined) {
            *interface *= u8::from(defined);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_table_does_not_hold_is_none_when_sent_and_refused_when_received() {
        let mut codes = Vec::new();
        quantise(&[0, 2, 3, 255], 2, &mut codes);
        assert_eq!(codes, [0, 2, 0, 0]);
        let mut interface = [9; 4];
        dequantise(&codes, 2, None, &mut interface).unwrap();
        assert_eq!(interface, [0, 2, 0, 0]);
        assert!(dequantise(&[3], 2, None, &mut interface).is_err());
    }

    #[test]
    fn an_undefined_pixel_has_no_interface() {
        let mut interface = [9; 2];
        dequantise(&[1, 1], 1, Some(&[true, false]), &mut interface).unwrap();
        assert_eq!(interface, [1, 0]);
        // The gradient of a first grid goes beyond the table.
        dequantise(&[1, 3], 1, Some(&[true, false]), &mut interface).unwrap();
        assert_eq!(interface, [1, 0]);
        assert!(dequantise(&[1, 3], 1, Some(&[false, true]), &mut interface).is_err());
    }
}
