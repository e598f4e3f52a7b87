//! The operations of [`Lanes`] in AVX2, and the queries compiled for it; AVX-512 differs in comparisons only,
//! which give masks there, and in having twice the registers: 3 to 9 % less time.
//!
//! The only way to a value of [`X86`] is [`X86::detected`], so whoever holds one may run these instructions:
//! that is the reason for every `unsafe` of this file.

#![allow(unsafe_code)]

use super::Ray;
use super::hierarchy::Hierarchy;
use super::lanes::{LANES, Lanes};
use super::traverse::{self, Nearest};
use std::arch::x86_64::*;

/// Proof that this machine has AVX2 and the bit manipulation that came with it, and AVX-512 where it says so.
#[derive(Clone, Copy, Debug)]
pub(super) struct X86<const AVX512: bool>(());

impl<const AVX512: bool> X86<AVX512> {
    /// Asks the machine.
    pub(super) fn detected() -> Option<X86<AVX512>> {
        let avx2 = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt");
        let avx512 = is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vl");
        (avx2 && (avx512 || !AVX512)).then_some(X86(()))
    }

    /// Looks for a hit nearer than `nearest`.
    pub(super) fn closest(self, hierarchy: &Hierarchy, ray: &Ray, nearest: &mut Nearest) {
        // SAFETY: the features are there, or there would be no value of this type.
        unsafe {
            if AVX512 {
                closest_avx512(self, hierarchy, ray, nearest);
            } else {
                closest_avx2(self, hierarchy, ray, nearest);
            }
        }
    }

    /// Whether any surface lies nearer than `max_distance` along the ray.
    pub(super) fn occluded(self, hierarchy: &Hierarchy, ray: &Ray, max_distance: f32) -> bool {
        // SAFETY: as above.
        unsafe {
            if AVX512 {
                occluded_avx512(self, hierarchy, ray, max_distance)
            } else {
                occluded_avx2(self, hierarchy, ray, max_distance)
            }
        }
    }

    /// A bit for each lane in which a comparison holds.
    #[inline(always)]
    fn compare<const HOW: i32>(self, a: __m256, b: __m256) -> u32 {
        // SAFETY: `self` proves that the features are there.
        unsafe {
            if AVX512 {
                u32::from(_mm256_cmp_ps_mask::<HOW>(a, b))
            } else {
                _mm256_movemask_ps(_mm256_cmp_ps::<HOW>(a, b)) as u32
            }
        }
    }
}

// What is inlined into these is compiled for their features.

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
fn closest_avx2(lanes: impl Lanes, hierarchy: &Hierarchy, ray: &Ray, nearest: &mut Nearest) {
    traverse::closest(lanes, hierarchy, ray, nearest);
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
fn occluded_avx2(lanes: impl Lanes, hierarchy: &Hierarchy, ray: &Ray, max_distance: f32) -> bool {
    traverse::occluded(lanes, hierarchy, ray, max_distance)
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,avx512f,avx512vl")]
fn closest_avx512(lanes: impl Lanes, hierarchy: &Hierarchy, ray: &Ray, nearest: &mut Nearest) {
    traverse::closest(lanes, hierarchy, ray, nearest);
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,avx512f,avx512vl")]
fn occluded_avx512(lanes: impl Lanes, hierarchy: &Hierarchy, ray: &Ray, max_distance: f32) -> bool {
    traverse::occluded(lanes, hierarchy, ray, max_distance)
}

// SAFETY of all of these: `self` proves that AVX2 is there; loads and stores are of whole arrays.
impl<const AVX512: bool> Lanes for X86<AVX512> {
    type F32 = __m256;

    #[inline(always)]
    fn splat(self, value: f32) -> __m256 {
        unsafe { _mm256_set1_ps(value) }
    }
    #[inline(always)]
    fn load(self, from: &[f32; LANES]) -> __m256 {
        unsafe { _mm256_loadu_ps(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, value: __m256) -> [f32; LANES] {
        let mut to = [0.0; LANES];
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), value) };
        to
    }
    #[inline(always)]
    fn add(self, a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_add_ps(a, b) }
    }
    #[inline(always)]
    fn sub(self, a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_sub_ps(a, b) }
    }
    #[inline(always)]
    fn mul(self, a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_mul_ps(a, b) }
    }
    #[inline(always)]
    fn div(self, a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_div_ps(a, b) }
    }
    #[inline(always)]
    fn min(self, a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_min_ps(a, b) }
    }
    #[inline(always)]
    fn max(self, a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_max_ps(a, b) }
    }
    #[inline(always)]
    fn lt(self, a: __m256, b: __m256) -> u32 {
        self.compare::<_CMP_LT_OQ>(a, b)
    }
    #[inline(always)]
    fn le(self, a: __m256, b: __m256) -> u32 {
        self.compare::<_CMP_LE_OQ>(a, b)
    }
    #[inline(always)]
    fn eq(self, a: __m256, b: __m256) -> u32 {
        self.compare::<_CMP_EQ_OQ>(a, b)
    }
    #[inline(always)]
    fn prefetch<T>(self, what: &T) {
        const CACHE_LINE_BYTES: usize = 64;
        let start = std::ptr::from_ref(what).cast::<i8>();
        for offset in (0..size_of::<T>()).step_by(CACHE_LINE_BYTES) {
            // A prefetch reads nothing, so any address will do.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(start.wrapping_add(offset)) };
        }
    }
}
