//! Where a picture goes: to display codes, or to linear radiance for what averages several pictures.
//!
//! Codes are written as soon as a pixel is known, while its sum is still in the nearest cache: a plane of radiance
//! between would be written and read once more, 32 bytes per pixel.

use super::tone;
use crate::lanes::{Floats, Integers};
use glam::{Vec3, Vec4};
use rayon::iter::Either;
use rayon::prelude::*;

/// A picture being made, row by row.
#[derive(Debug)]
pub(super) enum Canvas<'a> {
    /// sRGB codes of radiance times exposure.
    Codes {
        /// One per pixel.
        codes: &'a mut [[u8; 3]],
        /// Factor on linear radiance.
        exposure: f32,
    },
    /// Linear radiance, one per pixel.
    Radiance(&'a mut [Vec3]),
    /// Linear radiance of what something else will be put before.
    Behind {
        /// One per pixel.
        radiance: &'a mut [Vec3],
        /// Inverse depth of the root in the new view, one per pixel; 0 where that is not known.
        inverse_depth: &'a mut [f32],
    },
}

impl Canvas<'_> {
    /// Disjoint runs of this many pixels, the last one may be shorter.
    pub(super) fn runs(&mut self, pixels: usize) -> impl IndexedParallelIterator<Item = Canvas<'_>> {
        match self {
            Canvas::Codes { codes, exposure } => {
                let exposure = *exposure;
                Either::Left(codes.par_chunks_mut(pixels).map(move |codes| Canvas::Codes { codes, exposure }))
            }
            Canvas::Radiance(radiance) => {
                Either::Right(Either::Left(radiance.par_chunks_mut(pixels).map(Canvas::Radiance)))
            }
            Canvas::Behind { radiance, inverse_depth } => {
                let runs = radiance.par_chunks_mut(pixels).zip(inverse_depth.par_chunks_mut(pixels));
                let runs = runs.map(|(radiance, inverse_depth)| Canvas::Behind { radiance, inverse_depth });
                Either::Right(Either::Right(runs))
            }
        }
    }

    /// Paints pixels from `first` on, to a code that may be one off (see [`tone`]). Fourth numbers are ignored.
    #[inline(always)]
    pub(super) fn paint<F: Floats>(&mut self, first: usize, colors: &[Vec4]) {
        match self {
            Canvas::Codes { codes, exposure } => {
                let codes = &mut codes[first..first + colors.len()];
                for at in (0..colors.len()).step_by(F::LANES / 4) {
                    let linear = F::load_vectors(colors, at) * F::splat(*exposure);
                    tone::srgb8_from_linear(linear).store_colors(codes, at);
                }
            }
            Canvas::Radiance(radiance) | Canvas::Behind { radiance, .. } => {
                for (pixel, color) in radiance[first..first + colors.len()].iter_mut().zip(colors) {
                    *pixel = color.truncate();
                }
            }
        }
    }

    /// Paints pixels from `first` on, to the exact code.
    pub(super) fn paint_exactly(&mut self, first: usize, colors: &[Vec3]) {
        match self {
            Canvas::Codes { codes, exposure } => {
                let table = tone::exact();
                for (code, color) in codes[first..first + colors.len()].iter_mut().zip(colors) {
                    *code = table.display_from_radiance(*color, *exposure);
                }
            }
            Canvas::Radiance(radiance) | Canvas::Behind { radiance, .. } => {
                radiance[first..first + colors.len()].copy_from_slice(colors)
            }
        }
    }

    /// Notes inverse depths of pixels from `first` on, if anybody asks for them; 0 where they are not `known`.
    #[inline(always)]
    pub(super) fn note_depths(&mut self, first: usize, inverse_depths: &[f32], known: &[bool]) {
        if let Canvas::Behind { inverse_depth, .. } = self {
            let noted = &mut inverse_depth[first..first + inverse_depths.len()];
            for ((noted, &inverse_depth), &known) in noted.iter_mut().zip(inverse_depths).zip(known) {
                *noted = if known { inverse_depth } else { 0.0 };
            }
        }
    }
}
