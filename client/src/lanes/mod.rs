//! Several pixels at once: the vocabulary in which the kernels of warp and march are written.
//!
//! A kernel is a generic function over [`Floats`]. Three types speak that language: sixteen floats of AVX-512, eight
//! of AVX2 with fused multiplication and addition, and an array of eight that any compiler vectorises as well as the
//! processor allows (SSE2, NEON). [`Level`] says at run time which to use, and [`kernel!`](crate::lanes::kernel)
//! compiles a kernel once for each.
//!
//! Everything that is unsafe about it stays in this folder: what an instruction set needs is checked by [`Level`],
//! and a position in memory by [`Floats::gather`] before it is read. The siblings differ by rounding only: a fused
//! multiplication rounds once, the portable one twice.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod portable;
mod texel;
mod vector;

#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::F32x8;
#[cfg(target_arch = "x86_64")]
pub(crate) use avx512::F32x16;
pub(crate) use portable::Portable;
pub(crate) use texel::{OFFSET, Texel, pack, unpack};
pub(crate) use vector::Vector;

use glam::Vec4;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

/// Most lanes of any level: room for one vector on the stack.
pub(crate) const MAX_LANES: usize = 16;

/// What this machine can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    /// Arrays, vectorised by the compiler.
    Portable,
    /// AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 F.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Level {
    /// Every level that this machine has, the plainest first.
    pub(crate) fn available() -> impl Iterator<Item = Level> {
        #[cfg(target_arch = "x86_64")]
        let more = [
            (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")).then_some(Level::Avx2),
            (is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("fma")).then_some(Level::Avx512),
        ];
        #[cfg(not(target_arch = "x86_64"))]
        let more = [None, None];
        std::iter::once(Level::Portable).chain(more.into_iter().flatten())
    }

    /// Name in benches and on the command line.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Level::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => "avx512",
        }
    }
}

impl std::str::FromStr for Level {
    type Err = String;
    fn from_str(text: &str) -> Result<Level, String> {
        Level::available().find(|level| level.name() == text).ok_or_else(|| {
            let names: Vec<&str> = Level::available().map(Level::name).collect();
            format!("expected one that this machine has ({}), found '{text}'", names.join(", "))
        })
    }
}

impl Default for Level {
    /// The widest that this machine has.
    fn default() -> Level {
        Level::available().last().unwrap_or(Level::Portable)
    }
}

/// Truth values, one per lane.
pub(crate) trait Mask: Copy + BitAnd<Output = Self> + BitOr<Output = Self> + Not<Output = Self> {
    /// One bit per lane, the first lowest.
    fn bits(self) -> u32;
    /// Whether any lane is true.
    #[inline(always)]
    fn any(self) -> bool {
        self.bits() != 0
    }
}

/// Integers of 32 bits, one per lane.
pub(crate) trait Integers: Copy + Add<Output = Self> + Mul<Output = Self> {
    /// The floats that go with them.
    type Floats: Floats<Integers = Self>;
    /// The same in every lane.
    fn splat(value: i32) -> Self;
    /// The nearest float.
    fn to_floats(self) -> Self::Floats;
    /// The float of these bits.
    fn as_floats(self) -> Self::Floats;
    /// Shifts left by half a word: the lower of two packed `bf16` as a float's bits.
    fn shift_up(self) -> Self;
    /// Shifts left into the place of a float's exponent.
    fn shift_left_23(self) -> Self;
    /// The upper half word as a number.
    fn shift_down(self) -> Self;
    /// The lower half word as a number.
    fn lower_half(self) -> Self;
    /// Keeps the upper half word: the upper of two packed `bf16` as a float's bits.
    fn upper_half(self) -> Self;
    /// Stores the lanes.
    fn store(self, to: &mut [u32], at: usize);
    /// Stores the lowest bytes of the first three of every four lanes into `to[at..]`, as far as it reaches.
    fn store_colors(self, to: &mut [[u8; 3]], at: usize);
}

/// Floats of 32 bits, one per lane.
pub(crate) trait Floats:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// How many.
    const LANES: usize;
    /// Truth values of as many lanes.
    type Mask: Mask;
    /// Integers of as many lanes.
    type Integers: Integers<Floats = Self>;
    /// The same in every lane.
    fn splat(value: f32) -> Self;
    /// 0, 1, 2, ...
    fn ramp() -> Self;
    /// `from[at..]`; zero beyond its end.
    fn load(from: &[f32], at: usize) -> Self;
    /// Into `to[at..]`, as far as it reaches.
    fn store(self, to: &mut [f32], at: usize);
    /// `self * factor + addend`, rounded once or twice.
    fn mul_add(self, factor: Self, addend: Self) -> Self;
    /// The smaller; `other` where one is not a number.
    fn min(self, other: Self) -> Self;
    /// The larger; `other` where one is not a number.
    fn max(self, other: Self) -> Self;
    /// Magnitude.
    fn abs(self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Whether below; never for what is not a number.
    fn lt(self, other: Self) -> Self::Mask;
    /// `self` where `mask`, else `other`.
    fn or(self, mask: Self::Mask, other: Self) -> Self;
    /// Rounded towards zero; meaningless beyond the range of integers.
    fn truncate(self) -> Self::Integers;
    /// The bits.
    fn as_integers(self) -> Self::Integers;
    /// The numbers of `from[at..]`, as many vectors as there is room for; zero beyond its end.
    fn load_vectors(from: &[Vec4], at: usize) -> Self;
    /// Between the texels `first`, `first + 1` and those `pitch` further, with the offset of their codes (see `texture`)
    /// still on them; `x` and `y` are the weights of the right and of the lower ones.
    fn blend(texels: &[Texel], first: usize, pitch: usize, x: f32, y: f32) -> Vec4;
    /// Upper halves of two floats, rounded to nearest: `low` in the lower half word, `self` in the upper.
    fn pack_upper(self, low: Self) -> Self::Integers;
    /// `from[index]` of each plane. Panics where an index is beyond the end of any.
    fn gather<const N: usize>(from: [&[f32]; N], index: Self::Integers) -> [Self; N];
    /// `from[index]` of each plane. Panics where an index is beyond the end of any.
    fn gather_words<const N: usize>(from: [&[u32]; N], index: Self::Integers) -> [Self::Integers; N];

    /// `from[first..first + N]` of each lane: records of words, `N` being 1, 2, 4 or 8. Panics where one is not all there.
    fn gather_records<const N: usize>(from: &[u32], first: Self::Integers) -> [Self::Integers; N];

    /// Zero.
    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }

    /// Within `[low, high]`; `low` for what is not a number.
    #[inline(always)]
    fn within(self, low: f32, high: f32) -> Self {
        self.max(Self::splat(low)).min(Self::splat(high))
    }

    /// The lanes, the first ones of an array.
    #[cfg(test)]
    fn lanes(self) -> [f32; MAX_LANES] {
        let mut lanes = [0.0; MAX_LANES];
        self.store(&mut lanes, 0);
        lanes
    }
}

/// The length of the shortest plane.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn shortest<T>(planes: &[&[T]]) -> usize {
    let mut shortest = usize::MAX;
    for plane in planes {
        shortest = if plane.len() < shortest { plane.len() } else { shortest };
    }
    shortest
}

/// Words as floats of the same bits.
#[inline(always)]
pub(crate) fn as_floats<I: Integers, const N: usize>(words: [I; N]) -> [I::Floats; N] {
    let mut floats = [I::Floats::zero(); N];
    for (float, word) in floats.iter_mut().zip(words) {
        *float = word.as_floats();
    }
    floats
}

/// Compiles a generic kernel for each level and defines `$name`, which takes the level first.
///
/// The body is a function `$generic<F: Floats>` marked `#[inline(always)]`, so that it takes on the instruction set of
/// whoever calls it; so must be all that it calls with lanes. Closures and what takes them (`map` of arrays) are not,
/// and where the compiler leaves one standing, each instruction in it becomes a call.
macro_rules! kernel {
    ($(#[$meta:meta])* $vis:vis fn $name:ident = $generic:ident($($argument:ident: $kind:ty),* $(,)?) $(-> $result:ty)?) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        #[allow(unsafe_code, reason = "calls a function compiled for an instruction set that the level says is there")]
        $vis fn $name(level: $crate::lanes::Level, $($argument: $kind),*) $(-> $result)? {
            use $crate::lanes::Level;
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($($argument: $kind),*) $(-> $result)? {
                $generic::<$crate::lanes::F32x8>($($argument),*)
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx2,fma")]
            fn avx512($($argument: $kind),*) $(-> $result)? {
                $generic::<$crate::lanes::F32x16>($($argument),*)
            }
            match level {
                Level::Portable => $generic::<$crate::lanes::Portable>($($argument),*),
                // SAFETY: `Level::available` offers this level only where the processor has AVX2 and FMA.
                #[cfg(target_arch = "x86_64")]
                Level::Avx2 => unsafe { avx2($($argument),*) },
                // SAFETY: `Level::available` offers this level only where the processor has AVX-512 F and FMA, and
                // whatever has AVX-512 has AVX2.
                #[cfg(target_arch = "x86_64")]
                Level::Avx512 => unsafe { avx512($($argument),*) },
            }
        }
    };
}
pub(crate) use kernel;

#[cfg(test)]
mod tests;
