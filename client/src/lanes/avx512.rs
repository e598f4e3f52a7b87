//! Sixteen floats: a vector of AVX-512 F.
//!
//! The intrinsics are sound only where the processor has the instructions. Nothing here checks that: values of these
//! types are made and used only in kernels that [`super::Level`] lets run. All functions are `inline(always)`, since
//! only inside such a kernel do they become single instructions.
#![allow(unsafe_code, reason = "intrinsics; see above. What reads or writes memory says why it may")]

use super::texel::Texel;
use super::{Floats, Integers, Mask, shortest};
use glam::Vec4;
use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

const LANES: usize = 16;

/// Sixteen floats.
#[derive(Clone, Copy, Debug)]
pub(crate) struct F32x16(__m512);

/// Sixteen integers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct I32x16(__m512i);

/// Sixteen truth values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mask16(__mmask16);

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

binary!(F32x16, Add add _mm512_add_ps; Sub sub _mm512_sub_ps; Mul mul _mm512_mul_ps; Div div _mm512_div_ps);
binary!(I32x16, Add add _mm512_add_epi32; Mul mul _mm512_mullo_epi32);

impl BitAnd for Mask16 {
    type Output = Mask16;
    #[inline(always)]
    fn bitand(self, other: Mask16) -> Mask16 {
        Mask16(self.0 & other.0)
    }
}

impl BitOr for Mask16 {
    type Output = Mask16;
    #[inline(always)]
    fn bitor(self, other: Mask16) -> Mask16 {
        Mask16(self.0 | other.0)
    }
}

impl Not for Mask16 {
    type Output = Mask16;
    #[inline(always)]
    fn not(self) -> Mask16 {
        Mask16(!self.0)
    }
}

impl Mask for Mask16 {
    #[inline(always)]
    fn bits(self) -> u32 {
        u32::from(self.0)
    }
}

impl Neg for F32x16 {
    type Output = F32x16;
    #[inline(always)]
    fn neg(self) -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe { _mm512_sub_ps(_mm512_set1_ps(-0.0), self.0) })
    }
}

impl Integers for I32x16 {
    type Floats = F32x16;
    #[inline(always)]
    fn splat(value: i32) -> I32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x16(unsafe { _mm512_set1_epi32(value) })
    }
    #[inline(always)]
    fn to_floats(self) -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe { _mm512_cvtepi32_ps(self.0) })
    }
    #[inline(always)]
    fn as_floats(self) -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe { _mm512_castsi512_ps(self.0) })
    }
    #[inline(always)]
    fn shift_up(self) -> I32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x16(unsafe { _mm512_slli_epi32::<16>(self.0) })
    }
    #[inline(always)]
    fn shift_left_23(self) -> I32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x16(unsafe { _mm512_slli_epi32::<23>(self.0) })
    }
    #[inline(always)]
    fn shift_down(self) -> I32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x16(unsafe { _mm512_srli_epi32::<16>(self.0) })
    }
    #[inline(always)]
    fn lower_half(self) -> I32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x16(unsafe { _mm512_and_si512(self.0, _mm512_set1_epi32(0xffff)) })
    }
    #[inline(always)]
    fn upper_half(self) -> I32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x16(unsafe { _mm512_and_si512(self.0, _mm512_set1_epi32(!0xffff)) })
    }
    #[inline(always)]
    fn store_colors(self, to: &mut [[u8; 3]], at: usize) {
        // SAFETY: arithmetic, in a kernel of this level; AVX-512 includes SSE4.1.
        let (low, high) = unsafe {
            let order = _mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1);
            let packed = _mm_shuffle_epi8(_mm512_cvtepi32_epi8(self.0), order);
            (_mm_cvtsi128_si64(packed), _mm_extract_epi32::<2>(packed))
        };
        let to = to[at..].as_flattened_mut();
        match to.first_chunk_mut::<12>() {
            Some(to) => {
                to[..8].copy_from_slice(&low.to_le_bytes());
                to[8..].copy_from_slice(&high.to_le_bytes());
            }
            None => {
                let bytes = low.to_le_bytes().into_iter().chain(high.to_le_bytes());
                to.iter_mut().zip(bytes).for_each(|(to, byte)| *to = byte);
            }
        }
    }
    #[inline(always)]
    fn store(self, to: &mut [u32], at: usize) {
        let to = &mut to[at..];
        if to.len() >= LANES {
            // SAFETY: there is room for all lanes, and the store needs no alignment.
            unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), self.0) };
        } else {
            let mut lanes = [0_u32; LANES];
            // SAFETY: the array has room for all lanes.
            unsafe { _mm512_storeu_si512(lanes.as_mut_ptr().cast(), self.0) };
            let count = to.len();
            to.copy_from_slice(&lanes[..count]);
        }
    }
}

impl I32x16 {
    /// Panics unless every lane is an index into something this long.
    #[inline(always)]
    fn check(self, len: usize) {
        let len = len.min(i32::MAX as usize) as i32;
        // SAFETY: arithmetic, in a kernel of this level.
        let inside = unsafe { _mm512_cmplt_epu32_mask(self.0, _mm512_set1_epi32(len)) == 0xffff };
        assert!(inside, "an index beyond the end of a plane");
    }
}

impl Floats for F32x16 {
    const LANES: usize = LANES;
    type Mask = Mask16;
    type Integers = I32x16;
    #[inline(always)]
    fn splat(value: f32) -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe { _mm512_set1_ps(value) })
    }
    #[inline(always)]
    fn ramp() -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe {
            _mm512_setr_ps(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0)
        })
    }
    #[inline(always)]
    fn load(from: &[f32], at: usize) -> F32x16 {
        let from = &from[at..];
        if from.len() >= LANES {
            // SAFETY: all lanes are inside the slice, and the load needs no alignment.
            return F32x16(unsafe { _mm512_loadu_ps(from.as_ptr()) });
        }
        let mut lanes = [0.0; LANES];
        lanes[..from.len()].copy_from_slice(from);
        // SAFETY: the array holds all lanes.
        F32x16(unsafe { _mm512_loadu_ps(lanes.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [f32], at: usize) {
        let to = &mut to[at..];
        if to.len() >= LANES {
            // SAFETY: there is room for all lanes, and the store needs no alignment.
            unsafe { _mm512_storeu_ps(to.as_mut_ptr(), self.0) };
        } else {
            let mut lanes = [0.0; LANES];
            // SAFETY: the array has room for all lanes.
            unsafe { _mm512_storeu_ps(lanes.as_mut_ptr(), self.0) };
            let count = to.len();
            to.copy_from_slice(&lanes[..count]);
        }
    }
    #[inline(always)]
    fn mul_add(self, factor: F32x16, addend: F32x16) -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe { _mm512_fmadd_ps(self.0, factor.0, addend.0) })
    }
    #[inline(always)]
    fn min(self, other: F32x16) -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe { _mm512_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: F32x16) -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe { _mm512_max_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn abs(self) -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe { _mm512_abs_ps(self.0) })
    }
    #[inline(always)]
    fn sqrt(self) -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe { _mm512_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn lt(self, other: F32x16) -> Mask16 {
        // SAFETY: arithmetic, in a kernel of this level.
        Mask16(unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) })
    }
    #[inline(always)]
    fn or(self, mask: Mask16, other: F32x16) -> F32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        F32x16(unsafe { _mm512_mask_blend_ps(mask.0, other.0, self.0) })
    }
    #[inline(always)]
    fn truncate(self) -> I32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x16(unsafe { _mm512_cvttps_epi32(self.0) })
    }
    #[inline(always)]
    fn as_integers(self) -> I32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x16(unsafe { _mm512_castps_si512(self.0) })
    }
    #[inline(always)]
    fn load_vectors(from: &[Vec4], at: usize) -> F32x16 {
        let from = &from[at..];
        if from.len() >= LANES / 4 {
            // SAFETY: there are as many numbers, and the load needs no alignment.
            F32x16(unsafe { _mm512_loadu_ps(from.as_ptr().cast()) })
        } else {
            let mut lanes = [Vec4::ZERO; LANES / 4];
            lanes[..from.len()].copy_from_slice(from);
            // SAFETY: as above.
            F32x16(unsafe { _mm512_loadu_ps(lanes.as_ptr().cast()) })
        }
    }
    #[inline(always)]
    fn blend(texels: &[Texel], first: usize, pitch: usize, x: f32, y: f32) -> Vec4 {
        super::avx2::blend(texels, first, pitch, x, y)
    }
    #[inline(always)]
    fn pack_upper(self, low: F32x16) -> I32x16 {
        // SAFETY: arithmetic, in a kernel of this level.
        I32x16(unsafe {
            let half = _mm512_set1_epi32(0x8000);
            let upper = _mm512_add_epi32(_mm512_castps_si512(self.0), half);
            let lower = _mm512_add_epi32(_mm512_castps_si512(low.0), half);
            let upper = _mm512_and_si512(upper, _mm512_set1_epi32(!0xffff));
            _mm512_or_si512(upper, _mm512_srli_epi32::<16>(lower))
        })
    }
    #[inline(always)]
    fn gather<const N: usize>(from: [&[f32]; N], index: I32x16) -> [F32x16; N] {
        index.check(shortest(&from));
        let mut found = [F32x16::zero(); N];
        for (found, plane) in found.iter_mut().zip(from) {
            // SAFETY: every index was just found to be inside every plane.
            *found = F32x16(unsafe { _mm512_i32gather_ps::<4>(index.0, plane.as_ptr()) });
        }
        found
    }
    #[inline(always)]
    fn gather_words<const N: usize>(from: [&[u32]; N], index: I32x16) -> [I32x16; N] {
        index.check(shortest(&from));
        let mut found = [I32x16::splat(0); N];
        for (found, plane) in found.iter_mut().zip(from) {
            // SAFETY: every index was just found to be inside every plane.
            *found = I32x16(unsafe { _mm512_i32gather_epi32::<4>(index.0, plane.as_ptr().cast()) });
        }
        found
    }
    #[inline(always)]
    fn gather_records<const N: usize>(from: &[u32], first: I32x16) -> [I32x16; N] {
        first.check((from.len() + 1).saturating_sub(N));
        let mut found = [I32x16::splat(0); N];
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
unsafe fn single(from: *const u32, first: I32x16) -> I32x16 {
    // SAFETY: as said.
    I32x16(unsafe { _mm512_i32gather_epi32::<4>(first.0, from.cast()) })
}

/// Two words of each lane: half as many loads as words.
#[inline(always)]
unsafe fn pairs(from: *const u32, first: I32x16) -> [I32x16; 2] {
    // SAFETY: as said.
    unsafe {
        let low = _mm512_i32gather_epi64::<4>(_mm512_castsi512_si256(first.0), from.cast());
        let high = _mm512_i32gather_epi64::<4>(_mm512_extracti64x4_epi64::<1>(first.0), from.cast());
        let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
        let odd = _mm512_setr_epi32(1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
        [I32x16(_mm512_permutex2var_epi32(low, even, high)), I32x16(_mm512_permutex2var_epi32(low, odd, high))]
    }
}

/// Four words of each lane: one load of 16 bytes each, and a transposition.
#[inline(always)]
unsafe fn quads(from: *const u32, first: I32x16) -> [I32x16; 4] {
    let mut at = [0_u32; LANES];
    first.store(&mut at, 0);
    // SAFETY: as said.
    unsafe {
        let mut rows = [_mm512_setzero_si512(); 4];
        for (lane, row) in rows.iter_mut().enumerate() {
            *row = _mm512_castsi128_si512(_mm_loadu_si128(from.add(at[lane] as usize).cast()));
            *row = _mm512_inserti32x4::<1>(*row, _mm_loadu_si128(from.add(at[lane + 4] as usize).cast()));
            *row = _mm512_inserti32x4::<2>(*row, _mm_loadu_si128(from.add(at[lane + 8] as usize).cast()));
            *row = _mm512_inserti32x4::<3>(*row, _mm_loadu_si128(from.add(at[lane + 12] as usize).cast()));
        }
        let [a, b, c, d] = rows;
        let (ab, cd) = (_mm512_unpacklo_epi32(a, b), _mm512_unpacklo_epi32(c, d));
        let (ab_high, cd_high) = (_mm512_unpackhi_epi32(a, b), _mm512_unpackhi_epi32(c, d));
        [
            I32x16(_mm512_unpacklo_epi64(ab, cd)),
            I32x16(_mm512_unpackhi_epi64(ab, cd)),
            I32x16(_mm512_unpacklo_epi64(ab_high, cd_high)),
            I32x16(_mm512_unpackhi_epi64(ab_high, cd_high)),
        ]
    }
}
