//! Eight floats: a vector of AVX2, with FMA.
//!
//! The intrinsics are sound only where the processor has the instructions. Nothing here checks that: values of these
//! types are made and used only in kernels that [`super::Level`] lets run. All functions are `inline(always)`, since
//! only inside such a kernel do they become single instructions.
#![allow(unsafe_code, reason = "intrinsics; see above. What reads or writes memory says why it may")]

use super::texel::{DROPPED, EXPONENT, Texel};
use super::{Floats, Integers, Mask, shortest};
use glam::Vec4;
use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

const LANES: usize = 8;

/// Eight floats.
#[derive(Clone, Copy, Debug)]
pub(crate) struct F32x8(__m256);

/// Eight integers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct I32x8(__m256i);

/// Eight truth values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mask8(__m256);

macro_rules! binary {
    ($type:ident, $($trait:ident $method:ident $intrinsic:ident);* $(;)?) => {$(
        impl $trait for $type {
            type Output = $type;
            #[inline(always)]
            fn $method(self, other: $type) -> $type {
                // SAFETY: arithmetic, in a kernel of this level.
                $type(unsafe { $intrinsic(self.0, other.0) })
            }
        }
    )*};
}

binary!(F32x8, Add add _mm256_add_ps; Sub sub _mm256_sub_ps; Mul mul _mm256_mul_ps; Div div _mm256_div_ps);
binary!(I32x8, Add add _mm256_add_epi32; Mul mul _mm256_mullo_epi32);
binary!(Mask8, BitAnd bitand _mm256_and_ps; BitOr bitor _mm256_or_ps);

impl Not for Mask8 {
    type Output = Mask8;
    #[inline(always)]
    fn not(self) -> Mask8 {
        // SAFETY: arithmetic, in a kernel of this level.
        Mask8(unsafe { _mm256_xor_ps(self.0, _mm256_castsi256_ps(_mm256_set1_epi32(-1))) })
    }
}

impl Mask for Mask8 {
    #[inline(always)]
    fn bits(self) -> u32 {
        // SAFETY: arithmetic, in a kernel of this level.
        (unsafe { _mm256_movemask_ps(self.0) }) as u32
    }
}

impl Neg for F32x8 {
    type Output = F32x8;
    #[inline(always)]
    fn neg(self) -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_xor_ps(self.0, _mm256_set1_ps(-0.0)) })
    }
}

impl Integers for I32x8 {
    type Floats = F32x8;
    #[inline(always)]
    fn splat(value: i32) -> I32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x8(unsafe { _mm256_set1_epi32(value) })
    }
    #[inline(always)]
    fn to_floats(self) -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_cvtepi32_ps(self.0) })
    }
    #[inline(always)]
    fn as_floats(self) -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_castsi256_ps(self.0) })
    }
    #[inline(always)]
    fn shift_up(self) -> I32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x8(unsafe { _mm256_slli_epi32::<16>(self.0) })
    }
    #[inline(always)]
    fn shift_left_23(self) -> I32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x8(unsafe { _mm256_slli_epi32::<23>(self.0) })
    }
    #[inline(always)]
    fn shift_down(self) -> I32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x8(unsafe { _mm256_srli_epi32::<16>(self.0) })
    }
    #[inline(always)]
    fn lower_half(self) -> I32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x8(unsafe { _mm256_and_si256(self.0, _mm256_set1_epi32(0xffff)) })
    }
    #[inline(always)]
    fn upper_half(self) -> I32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x8(unsafe { _mm256_and_si256(self.0, _mm256_set1_epi32(!0xffff)) })
    }
    #[inline(always)]
    fn store_colors(self, to: &mut [[u8; 3]], at: usize) {
        // SAFETY: arithmetic, in a kernel of this level, which includes SSSE3.
        let bytes = unsafe {
            let order = _mm_setr_epi8(0, 1, 2, 4, 5, 6, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1);
            let halves = _mm_packs_epi32(_mm256_castsi256_si128(self.0), _mm256_extracti128_si256::<1>(self.0));
            _mm_cvtsi128_si64(_mm_shuffle_epi8(_mm_packus_epi16(halves, halves), order)).to_le_bytes()
        };
        let to = to[at..].as_flattened_mut();
        let count = to.len().min(6);
        to[..count].copy_from_slice(&bytes[..count]);
    }
    #[inline(always)]
    fn store(self, to: &mut [u32], at: usize) {
        let to = &mut to[at..];
        if to.len() >= LANES {
            // SAFETY: there is room for all lanes, and the store needs no alignment.
            unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), self.0) };
        } else {
            let mut lanes = [0_u32; LANES];
            // SAFETY: the array has room for all lanes.
            unsafe { _mm256_storeu_si256(lanes.as_mut_ptr().cast(), self.0) };
            let count = to.len();
            to.copy_from_slice(&lanes[..count]);
        }
    }
}

impl I32x8 {
    /// Panics unless every lane is an index into something this long.
    #[inline(always)]
    fn check(self, len: usize) {
        let len = len.min(i32::MAX as usize) as i32;
        // SAFETY: arithmetic, in a kernel of this level.
        let inside = unsafe {
            {
                let above = _mm256_cmpgt_epi32(_mm256_set1_epi32(len), self.0);
                let negative = _mm256_movemask_ps(_mm256_castsi256_ps(self.0));
                _mm256_movemask_ps(_mm256_castsi256_ps(above)) == 0xff && negative == 0
            }
        };
        assert!(inside, "an index beyond the end of a plane");
    }
}

impl Floats for F32x8 {
    const LANES: usize = LANES;
    type Mask = Mask8;
    type Integers = I32x8;
    #[inline(always)]
    fn splat(value: f32) -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_set1_ps(value) })
    }
    #[inline(always)]
    fn ramp() -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_setr_ps(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0) })
    }
    #[inline(always)]
    fn load(from: &[f32], at: usize) -> F32x8 {
        let from = &from[at..];
        if from.len() >= LANES {
            // SAFETY: all lanes are inside the slice, and the load needs no alignment.
            return F32x8(unsafe { _mm256_loadu_ps(from.as_ptr()) });
        }
        let mut lanes = [0.0; LANES];
        lanes[..from.len()].copy_from_slice(from);
        // SAFETY: the array holds all lanes.
        F32x8(unsafe { _mm256_loadu_ps(lanes.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [f32], at: usize) {
        let to = &mut to[at..];
        if to.len() >= LANES {
            // SAFETY: there is room for all lanes, and the store needs no alignment.
            unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) };
        } else {
            let mut lanes = [0.0; LANES];
            // SAFETY: the array has room for all lanes.
            unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), self.0) };
            let count = to.len();
            to.copy_from_slice(&lanes[..count]);
        }
    }
    #[inline(always)]
    fn mul_add(self, factor: F32x8, addend: F32x8) -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_fmadd_ps(self.0, factor.0, addend.0) })
    }
    #[inline(always)]
    fn min(self, other: F32x8) -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: F32x8) -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_max_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn abs(self) -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
    }
    #[inline(always)]
    fn sqrt(self) -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn lt(self, other: F32x8) -> Mask8 {
        // SAFETY: arithmetic, in a kernel of this level.
        Mask8(unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) })
    }
    #[inline(always)]
    fn or(self, mask: Mask8, other: F32x8) -> F32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x8(unsafe { _mm256_blendv_ps(other.0, self.0, mask.0) })
    }
    #[inline(always)]
    fn truncate(self) -> I32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x8(unsafe { _mm256_cvttps_epi32(self.0) })
    }
    #[inline(always)]
    fn as_integers(self) -> I32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x8(unsafe { _mm256_castps_si256(self.0) })
    }
    #[inline(always)]
    fn load_vectors(from: &[Vec4], at: usize) -> F32x8 {
        let from = &from[at..];
        if from.len() >= LANES / 4 {
            // SAFETY: there are as many numbers, and the load needs no alignment.
            F32x8(unsafe { _mm256_loadu_ps(from.as_ptr().cast()) })
        } else {
            let mut lanes = [Vec4::ZERO; LANES / 4];
            lanes[..from.len()].copy_from_slice(from);
            // SAFETY: as above.
            F32x8(unsafe { _mm256_loadu_ps(lanes.as_ptr().cast()) })
        }
    }
    #[inline(always)]
    fn blend(texels: &[Texel], first: usize, pitch: usize, x: f32, y: f32) -> Vec4 {
        blend(texels, first, pitch, x, y)
    }
    #[inline(always)]
    fn pack_upper(self, low: F32x8) -> I32x8 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x8(unsafe {
            let half = _mm256_set1_epi32(0x8000);
            let upper = _mm256_add_epi32(_mm256_castps_si256(self.0), half);
            let lower = _mm256_add_epi32(_mm256_castps_si256(low.0), half);
            let upper = _mm256_and_si256(upper, _mm256_set1_epi32(!0xffff));
            _mm256_or_si256(upper, _mm256_srli_epi32::<16>(lower))
        })
    }
    #[inline(always)]
    fn gather<const N: usize>(from: [&[f32]; N], index: I32x8) -> [F32x8; N] {
        index.check(shortest(&from));
        let mut found = [F32x8::zero(); N];
        for (found, plane) in found.iter_mut().zip(from) {
            // SAFETY: every index was just found to be inside every plane.
            *found = F32x8(unsafe { _mm256_i32gather_ps::<4>(plane.as_ptr(), index.0) });
        }
        found
    }
    #[inline(always)]
    fn gather_words<const N: usize>(from: [&[u32]; N], index: I32x8) -> [I32x8; N] {
        index.check(shortest(&from));
        let mut found = [I32x8::splat(0); N];
        for (found, plane) in found.iter_mut().zip(from) {
            // SAFETY: every index was just found to be inside every plane.
            *found = I32x8(unsafe { _mm256_i32gather_epi32::<4>(plane.as_ptr().cast(), index.0) });
        }
        found
    }
    #[inline(always)]
    fn gather_records<const N: usize>(from: &[u32], first: I32x8) -> [I32x8; N] {
        first.check((from.len() + 1).saturating_sub(N));
        let mut found = [I32x8::splat(0); N];
        let mut word = 0;
        while word < N {
            // SAFETY: every record was just found to be inside, and these are words of it.
            unsafe {
                let from = from.as_ptr().add(word);
                match N - word {
                    1 => found[word] = single(from, first),
                    2 | 3 => found[word..word + 2].copy_from_slice(&pairs(from, first)),
                    _ => found[word..word + 4].copy_from_slice(&quads(from, first)),
                }
            }
            word += if N - word >= 4 {
                4
            } else if N - word >= 2 {
                2
            } else {
                1
            };
        }
        found
    }
}

/// A word of each lane.
///
/// # Safety
/// It must be there; in a kernel of this level. So for the following.
#[inline(always)]
unsafe fn single(from: *const u32, first: I32x8) -> I32x8 {
    // SAFETY: as said.
    I32x8(unsafe { _mm256_i32gather_epi32::<4>(from.cast(), first.0) })
}

/// Two words of each lane: half as many loads as words.
#[inline(always)]
unsafe fn pairs(from: *const u32, first: I32x8) -> [I32x8; 2] {
    // SAFETY: as said.
    unsafe {
        let low = _mm256_i32gather_epi64::<4>(from.cast(), _mm256_castsi256_si128(first.0));
        let high = _mm256_i32gather_epi64::<4>(from.cast(), _mm256_extracti128_si256::<1>(first.0));
        let (low, high) = (_mm256_castsi256_ps(low), _mm256_castsi256_ps(high));
        let even = _mm256_castps_si256(_mm256_shuffle_ps::<0b10_00_10_00>(low, high));
        let odd = _mm256_castps_si256(_mm256_shuffle_ps::<0b11_01_11_01>(low, high));
        [I32x8(_mm256_permute4x64_epi64::<0b11_01_10_00>(even)), I32x8(_mm256_permute4x64_epi64::<0b11_01_10_00>(odd))]
    }
}

/// Four words of each lane: one load of 16 bytes each, and a transposition.
#[inline(always)]
unsafe fn quads(from: *const u32, first: I32x8) -> [I32x8; 4] {
    let mut at = [0_u32; LANES];
    first.store(&mut at, 0);
    // SAFETY: as said.
    unsafe {
        let mut rows = [_mm256_setzero_si256(); 4];
        for (lane, row) in rows.iter_mut().enumerate() {
            *row = _mm256_castsi128_si256(_mm_loadu_si128(from.add(at[lane] as usize).cast()));
            *row = _mm256_inserti128_si256::<1>(*row, _mm_loadu_si128(from.add(at[lane + 4] as usize).cast()));
        }
        let [a, b, c, d] = rows;
        let (ab, cd) = (_mm256_unpacklo_epi32(a, b), _mm256_unpacklo_epi32(c, d));
        let (ab_high, cd_high) = (_mm256_unpackhi_epi32(a, b), _mm256_unpackhi_epi32(c, d));
        [
            I32x8(_mm256_unpacklo_epi64(ab, cd)),
            I32x8(_mm256_unpackhi_epi64(ab, cd)),
            I32x8(_mm256_unpacklo_epi64(ab_high, cd_high)),
            I32x8(_mm256_unpackhi_epi64(ab_high, cd_high)),
        ]
    }
}

/// Both texels of a row at once, then both rows, then the halves of what that gives.
#[inline(always)]
pub(super) fn blend(texels: &[Texel], first: usize, pitch: usize, x: f32, y: f32) -> Vec4 {
    assert!(first < texels.len() && first + pitch + 1 < texels.len() && pitch > 0, "texels around {first}");
    // SAFETY: arithmetic, in a kernel of this level or of AVX-512, which has all that this one has. Both pairs of texels
    // were just found to be there.
    unsafe {
        let upper = texels.as_ptr().add(first);
        let (upper, lower) = (widened(upper), widened(upper.add(pitch)));
        let column = _mm256_fmadd_ps(_mm256_sub_ps(lower, upper), _mm256_set1_ps(y), upper);
        let (left, right) = (_mm256_castps256_ps128(column), _mm256_extractf128_ps::<1>(column));
        Vec4::from(_mm_fmadd_ps(_mm_sub_ps(right, left), _mm_set1_ps(x), left))
    }
}

/// The floats of two texels.
///
/// # Safety
/// They must be there; in a kernel of AVX2.
#[inline(always)]
unsafe fn widened(pair: *const Texel) -> __m256 {
    // SAFETY: sixteen bytes are read, those of two texels.
    unsafe {
        let codes = _mm256_cvtepu16_epi32(_mm_loadu_si128(pair.cast()));
        let bits = _mm256_slli_epi32::<{ DROPPED as i32 }>(codes);
        _mm256_castsi256_ps(_mm256_add_epi32(bits, _mm256_set1_epi32(EXPONENT as i32)))
    }
}
