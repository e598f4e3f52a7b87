//! Sixteen floats: what the program of [`super::lanes`] is written in.
//!
//! Two siblings: a register of AVX-512, and an array, whose loops the compiler turns into vectors of AVX2 or of whatever the
//! processor has. They differ by rounding only: a fused multiplication rounds once, and the array's may round twice.

/// Floats at once.
pub(super) const LANES: usize = 16;

/// Floats in lanes.
pub(super) type Row = [f32; LANES];

/// Arithmetic on rows.
pub(super) trait Vector: Copy {
    fn splat(value: f32) -> Self;
    fn load(from: &Row) -> Self;
    fn store(self, to: &mut Row);
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    fn over(self, other: Self) -> Self;
    /// `self * factor + term`
    fn times_plus(self, factor: Self, term: Self) -> Self;
    /// `other` where `self` is not a number.
    fn at_least(self, other: Self) -> Self;
    /// `other` where `self` is not a number.
    fn at_most(self, other: Self) -> Self;
    /// Where `self` is below `bound` the first, else the second, also where one is not a number: of two pairs.
    fn if_below(self, bound: Self, values: [(Self, Self); 2]) -> [Self; 2];
}

#[derive(Clone, Copy)]
pub(super) struct Array(Row);

macro_rules! by_lane {
    (|$lane:ident| $value:expr) => {{
        let mut row = [0.0; LANES];
        for $lane in 0..LANES {
            row[$lane] = $value;
        }
        Array(row)
    }};
}

impl Vector for Array {
    #[inline(always)]
    fn splat(value: f32) -> Array {
        Array([value; LANES])
    }
    #[inline(always)]
    fn load(from: &Row) -> Array {
        Array(*from)
    }
    #[inline(always)]
    fn store(self, to: &mut Row) {
        *to = self.0;
    }
    #[inline(always)]
    fn plus(self, other: Array) -> Array {
        by_lane!(|lane| self.0[lane] + other.0[lane])
    }
    #[inline(always)]
    fn minus(self, other: Array) -> Array {
        by_lane!(|lane| self.0[lane] - other.0[lane])
    }
    #[inline(always)]
    fn times(self, other: Array) -> Array {
        by_lane!(|lane| self.0[lane] * other.0[lane])
    }
    #[inline(always)]
    fn over(self, other: Array) -> Array {
        by_lane!(|lane| self.0[lane] / other.0[lane])
    }
    #[inline(always)]
    fn times_plus(self, factor: Array, term: Array) -> Array {
        by_lane!(|lane| self.0[lane] * factor.0[lane] + term.0[lane])
    }
    #[inline(always)]
    fn at_least(self, other: Array) -> Array {
        by_lane!(|lane| if self.0[lane] > other.0[lane] { self.0[lane] } else { other.0[lane] })
    }
    #[inline(always)]
    fn at_most(self, other: Array) -> Array {
        by_lane!(|lane| if self.0[lane] < other.0[lane] { self.0[lane] } else { other.0[lane] })
    }
    #[inline(always)]
    fn if_below(self, bound: Array, [(a, b), (c, d)]: [(Array, Array); 2]) -> [Array; 2] {
        [
            by_lane!(|lane| if self.0[lane] < bound.0[lane] { a.0[lane] } else { b.0[lane] }),
            by_lane!(|lane| if self.0[lane] < bound.0[lane] { c.0[lane] } else { d.0[lane] }),
        ]
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use avx512::Register;

/// Methods must only be inlined into functions that are compiled for AVX-512 F; the one there is asks for it.
#[cfg(target_arch = "x86_64")]
mod avx512 {
    #![allow(unsafe_code, reason = "instructions of AVX-512, which the caller has found")]

    use super::{Row, Vector};
    use std::arch::x86_64::*;

    #[derive(Clone, Copy)]
    pub(in super::super) struct Register(__m512);

    // SAFETY of all: a `Register` is made and used in functions compiled for AVX-512 alone; a row is as long as a register,
    // and loads and stores ask for no alignment.
    impl Vector for Register {
        #[inline(always)]
        fn splat(value: f32) -> Register {
            Register(unsafe { _mm512_set1_ps(value) })
        }
        #[inline(always)]
        fn load(from: &Row) -> Register {
            Register(unsafe { _mm512_loadu_ps(from.as_ptr()) })
        }
        #[inline(always)]
        fn store(self, to: &mut Row) {
            unsafe { _mm512_storeu_ps(to.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        fn plus(self, other: Register) -> Register {
            Register(unsafe { _mm512_add_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn minus(self, other: Register) -> Register {
            Register(unsafe { _mm512_sub_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn times(self, other: Register) -> Register {
            Register(unsafe { _mm512_mul_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn over(self, other: Register) -> Register {
            Register(unsafe { _mm512_div_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn times_plus(self, factor: Register, term: Register) -> Register {
            Register(unsafe { _mm512_fmadd_ps(self.0, factor.0, term.0) })
        }
        #[inline(always)]
        fn at_least(self, other: Register) -> Register {
            Register(unsafe { _mm512_max_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn at_most(self, other: Register) -> Register {
            Register(unsafe { _mm512_min_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn if_below(self, bound: Register, [(a, b), (c, d)]: [(Register, Register); 2]) -> [Register; 2] {
            unsafe {
                let is_below = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, bound.0);
                [Register(_mm512_mask_blend_ps(is_below, b.0, a.0)), Register(_mm512_mask_blend_ps(is_below, d.0, c.0))]
            }
        }
    }
}
