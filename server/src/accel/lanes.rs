//! Eight numbers at once: what traversal asks of a machine's vector instructions, and the portable answer.
//!
//! A value of a type that implements [`Lanes`] is the proof that this machine has the instructions; so the
//! operations are safe functions, and whoever has no proof cannot call them. The code above is written once,
//! for any of them, and inlined into a function that is compiled for them: hence no closures over vectors above,
//! which would be functions of their own, without the instructions. [`Portable`] is plain arrays, which the compiler vectorises for whatever it compiles for;
//! `x86` is by hand. All round alike, operation by operation, so results are the same bits everywhere.

/// Numbers per vector.
pub(super) const LANES: usize = 8;

/// Vector instructions that are there.
pub(super) trait Lanes: Copy {
    /// Eight f32.
    type F32: Copy;

    fn splat(self, value: f32) -> Self::F32;
    fn load(self, from: &[f32; LANES]) -> Self::F32;
    fn store(self, value: Self::F32) -> [f32; LANES];
    fn add(self, a: Self::F32, b: Self::F32) -> Self::F32;
    fn sub(self, a: Self::F32, b: Self::F32) -> Self::F32;
    fn mul(self, a: Self::F32, b: Self::F32) -> Self::F32;
    fn div(self, a: Self::F32, b: Self::F32) -> Self::F32;
    /// `a` if less, else `b`.
    fn min(self, a: Self::F32, b: Self::F32) -> Self::F32;
    /// `a` if greater, else `b`.
    fn max(self, a: Self::F32, b: Self::F32) -> Self::F32;
    /// A bit for each lane in which `a < b`.
    fn lt(self, a: Self::F32, b: Self::F32) -> u32;
    /// A bit for each lane in which `a <= b`.
    fn le(self, a: Self::F32, b: Self::F32) -> u32;
    /// A bit for each lane in which `a == b`.
    fn eq(self, a: Self::F32, b: Self::F32) -> u32;
    /// Says that `what` will be read soon.
    fn prefetch<T>(self, what: &T);
}

/// Three vectors, each of one number.
#[inline(always)]
pub(super) fn splat3<L: Lanes>(l: L, [x, y, z]: [f32; 3]) -> [L::F32; 3] {
    [l.splat(x), l.splat(y), l.splat(z)]
}

/// Plain arrays.
#[derive(Clone, Copy, Debug)]
pub(super) struct Portable;

#[inline(always)]
fn each(a: [f32; LANES], b: [f32; LANES], f: impl Fn(f32, f32) -> f32) -> [f32; LANES] {
    let mut result = [0.0; LANES];
    for lane in 0..LANES {
        result[lane] = f(a[lane], b[lane]);
    }
    result
}

#[inline(always)]
fn mask(a: [f32; LANES], b: [f32; LANES], f: impl Fn(f32, f32) -> bool) -> u32 {
    let mut result = 0;
    for lane in 0..LANES {
        result |= u32::from(f(a[lane], b[lane])) << lane;
    }
    result
}

impl Lanes for Portable {
    type F32 = [f32; LANES];

    #[inline(always)]
    fn splat(self, value: f32) -> Self::F32 {
        [value; LANES]
    }
    #[inline(always)]
    fn load(self, from: &[f32; LANES]) -> Self::F32 {
        *from
    }
    #[inline(always)]
    fn store(self, value: Self::F32) -> [f32; LANES] {
        value
    }
    #[inline(always)]
    fn add(self, a: Self::F32, b: Self::F32) -> Self::F32 {
        each(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, a: Self::F32, b: Self::F32) -> Self::F32 {
        each(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, a: Self::F32, b: Self::F32) -> Self::F32 {
        each(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, a: Self::F32, b: Self::F32) -> Self::F32 {
        each(a, b, |a, b| a / b)
    }
    #[inline(always)]
    fn min(self, a: Self::F32, b: Self::F32) -> Self::F32 {
        each(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, a: Self::F32, b: Self::F32) -> Self::F32 {
        each(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn lt(self, a: Self::F32, b: Self::F32) -> u32 {
        mask(a, b, |a, b| a < b)
    }
    #[inline(always)]
    fn le(self, a: Self::F32, b: Self::F32) -> u32 {
        mask(a, b, |a, b| a <= b)
    }
    #[inline(always)]
    fn eq(self, a: Self::F32, b: Self::F32) -> u32 {
        mask(a, b, |a, b| a == b)
    }
    #[inline(always)]
    fn prefetch<T>(self, _what: &T) {}
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::super::x86::X86;
    use super::*;

    fn is_portable(l: impl Lanes) {
        let values = [0.0, -0.0, 1.5, -2.25, 1e-40, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 3e38, 0.1];
        for rotation in 0..values.len() {
            let a: [f32; LANES] = std::array::from_fn(|lane| values[lane]);
            let b: [f32; LANES] = std::array::from_fn(|lane| values[(lane + rotation) % values.len()]);
            let (x, y) = (l.load(&a), l.load(&b));
            let same = |found: [f32; LANES], expected: [f32; LANES]| {
                for (found, expected) in found.into_iter().zip(expected) {
                    // Which NaN it is, the instructions leave open.
                    assert!(found.to_bits() == expected.to_bits() || (found.is_nan() && expected.is_nan()));
                }
            };
            same(l.store(l.add(x, y)), Portable.add(a, b));
            same(l.store(l.sub(x, y)), Portable.sub(a, b));
            same(l.store(l.mul(x, y)), Portable.mul(a, b));
            same(l.store(l.div(x, y)), Portable.div(a, b));
            same(l.store(l.min(x, y)), Portable.min(a, b));
            same(l.store(l.max(x, y)), Portable.max(a, b));
            assert_eq!(l.lt(x, y), Portable.lt(a, b));
            assert_eq!(l.le(x, y), Portable.le(a, b));
            assert_eq!(l.eq(x, y), Portable.eq(a, b));
            l.prefetch(&a);
        }
    }

    #[test]
    fn vector_instructions_do_what_plain_arrays_do() {
        match X86::<false>::detected() {
            Some(avx2) => is_portable(avx2),
            None => eprintln!("skipped: this machine has no AVX2"),
        }
        match X86::<true>::detected() {
            // Without inlining into code that is compiled for it, only the results are of interest.
            Some(avx512) => is_portable(avx512),
            None => eprintln!("skipped: this machine has no AVX-512"),
        }
    }
}
