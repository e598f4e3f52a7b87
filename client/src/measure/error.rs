//! Why something cannot be measured.

use thiserror::Error;

/// A measurement that has no meaning.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MeasureError {
    /// Two images, or an image and its mask, do not have the same size.
    #[error("size: expected {expected} pixels as the reference, found {found}")]
    SizeMismatch {
        /// Size of the reference, `WIDTHxHEIGHT` or a count.
        expected: String,
        /// Size of the other.
        found: String,
    },
    /// No pixel is compared: the image is empty or the mask covers nothing.
    #[error("pixels: expected at least one under the mask, found none")]
    NoPixels,
    /// There is no sample to summarise.
    #[error("samples: expected at least one, found none")]
    NoSamples,
    /// A sample is not a number or infinite.
    #[error("samples: expected finite numbers, found {value} at index {index}")]
    NotFinite {
        /// Where.
        index: usize,
        /// The value.
        value: f64,
    },
}

/// Refuses images of different size and a mask that does not fit or covers nothing.
pub(super) fn check_sizes(reference: (u32, u32), shown: (u32, u32), mask: Option<&[bool]>) -> Result<(), MeasureError> {
    let as_text = |(width, height): (u32, u32)| format!("{width}x{height}");
    if reference != shown {
        return Err(MeasureError::SizeMismatch { expected: as_text(reference), found: as_text(shown) });
    }
    check_mask(reference.0 as usize * reference.1 as usize, mask)
}

/// Refuses no pixels at all, and a mask that does not fit or covers nothing.
pub(super) fn check_mask(pixels: usize, mask: Option<&[bool]>) -> Result<(), MeasureError> {
    if let Some(mask) = mask
        && mask.len() != pixels
    {
        return Err(MeasureError::SizeMismatch { expected: pixels.to_string(), found: mask.len().to_string() });
    }
    if mask.map_or(pixels == 0, |mask| !mask.contains(&true)) {
        return Err(MeasureError::NoPixels);
    }
    Ok(())
}

/// Whether pixel number `index` is compared.
pub(super) fn covers(mask: Option<&[bool]>, index: usize) -> bool {
    mask.is_none_or(|mask| mask[index])
}
