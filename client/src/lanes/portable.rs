//! Eight floats as an array: what every compiler turns into the vectors of its target.

use super::texel::{Texel, unpack};
use super::{Floats, Integers, Mask};
use glam::Vec4;
use std::array::from_fn;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

const LANES: usize = 8;

/// Eight floats.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Portable([f32; LANES]);

/// Eight integers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PortableIntegers([i32; LANES]);

/// Eight truth values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PortableMask([bool; LANES]);

macro_rules! lanewise {
    ($type:ident, $($trait:ident $method:ident |$a:ident, $b:ident| $result:expr);* $(;)?) => {$(
        impl $trait for $type {
            type Output = $type;
            #[inline(always)]
            fn $method(self, other: $type) -> $type {
                $type(from_fn(|lane| { let ($a, $b) = (self.0[lane], other.0[lane]); $result }))
            }
        }
    )*};
}

lanewise!(Portable, Add add |a, b| a + b; Sub sub |a, b| a - b; Mul mul |a, b| a * b; Div div |a, b| a / b);
lanewise!(PortableIntegers, Add add |a, b| a.wrapping_add(b); Mul mul |a, b| a.wrapping_mul(b));
lanewise!(PortableMask, BitAnd bitand |a, b| a & b; BitOr bitor |a, b| a | b);

impl Neg for Portable {
    type Output = Portable;
    #[inline(always)]
    fn neg(self) -> Portable {
        Portable(self.0.map(|a| -a))
    }
}

impl Not for PortableMask {
    type Output = PortableMask;
    #[inline(always)]
    fn not(self) -> PortableMask {
        PortableMask(self.0.map(|a| !a))
    }
}

impl Mask for PortableMask {
    #[inline(always)]
    fn bits(self) -> u32 {
        self.0.iter().enumerate().fold(0, |bits, (lane, &is)| bits | u32::from(is) << lane)
    }
}

impl Integers for PortableIntegers {
    type Floats = Portable;
    #[inline(always)]
    fn splat(value: i32) -> PortableIntegers {
        PortableIntegers([value; LANES])
    }
    #[inline(always)]
    fn to_floats(self) -> Portable {
        Portable(self.0.map(|a| a as f32))
    }
    #[inline(always)]
    fn as_floats(self) -> Portable {
        Portable(self.0.map(|a| f32::from_bits(a as u32)))
    }
    #[inline(always)]
    fn shift_up(self) -> PortableIntegers {
        PortableIntegers(self.0.map(|a| a << 16))
    }
    #[inline(always)]
    fn shift_left_23(self) -> PortableIntegers {
        PortableIntegers(self.0.map(|a| a << 23))
    }
    #[inline(always)]
    fn shift_down(self) -> PortableIntegers {
        PortableIntegers(self.0.map(|a| (a as u32 >> 16) as i32))
    }
    #[inline(always)]
    fn lower_half(self) -> PortableIntegers {
        PortableIntegers(self.0.map(|a| a & 0xffff))
    }
    #[inline(always)]
    fn upper_half(self) -> PortableIntegers {
        PortableIntegers(self.0.map(|a| a & !0xffff))
    }
    #[inline(always)]
    fn store_colors(self, to: &mut [[u8; 3]], at: usize) {
        for (to, lanes) in to[at..].iter_mut().zip(self.0.chunks_exact(4)) {
            *to = [lanes[0] as u8, lanes[1] as u8, lanes[2] as u8];
        }
    }
    #[inline(always)]
    fn store(self, to: &mut [u32], at: usize) {
        for (to, lane) in to[at..].iter_mut().zip(self.0) {
            *to = lane as u32;
        }
    }
}

impl Floats for Portable {
    const LANES: usize = LANES;
    type Mask = PortableMask;
    type Integers = PortableIntegers;
    #[inline(always)]
    fn splat(value: f32) -> Portable {
        Portable([value; LANES])
    }
    #[inline(always)]
    fn ramp() -> Portable {
        Portable(from_fn(|lane| lane as f32))
    }
    #[inline(always)]
    fn load(from: &[f32], at: usize) -> Portable {
        match from[at..].first_chunk() {
            Some(lanes) => Portable(*lanes),
            None => Portable(from_fn(|lane| from.get(at + lane).copied().unwrap_or(0.0))),
        }
    }
    #[inline(always)]
    fn store(self, to: &mut [f32], at: usize) {
        for (to, lane) in to[at..].iter_mut().zip(self.0) {
            *to = lane;
        }
    }
    #[inline(always)]
    fn mul_add(self, factor: Portable, addend: Portable) -> Portable {
        // Not `f32::mul_add`: without the instruction that is a call to the mathematics library.
        self * factor + addend
    }
    #[inline(always)]
    fn min(self, other: Portable) -> Portable {
        Portable(from_fn(|lane| if self.0[lane] < other.0[lane] { self.0[lane] } else { other.0[lane] }))
    }
    #[inline(always)]
    fn max(self, other: Portable) -> Portable {
        Portable(from_fn(|lane| if self.0[lane] > other.0[lane] { self.0[lane] } else { other.0[lane] }))
    }
    #[inline(always)]
    fn abs(self) -> Portable {
        Portable(self.0.map(f32::abs))
    }
    #[inline(always)]
    fn sqrt(self) -> Portable {
        Portable(self.0.map(f32::sqrt))
    }
    #[inline(always)]
    fn lt(self, other: Portable) -> PortableMask {
        PortableMask(from_fn(|lane| self.0[lane] < other.0[lane]))
    }
    #[inline(always)]
    fn or(self, mask: PortableMask, other: Portable) -> Portable {
        Portable(from_fn(|lane| if mask.0[lane] { self.0[lane] } else { other.0[lane] }))
    }
    #[inline(always)]
    fn truncate(self) -> PortableIntegers {
        PortableIntegers(self.0.map(|a| a as i32))
    }
    #[inline(always)]
    fn as_integers(self) -> PortableIntegers {
        PortableIntegers(self.0.map(|a| a.to_bits() as i32))
    }
    #[inline(always)]
    fn load_vectors(from: &[Vec4], at: usize) -> Portable {
        let mut lanes = [0.0; LANES];
        for (lanes, vector) in lanes.chunks_exact_mut(4).zip(&from[at..]) {
            lanes.copy_from_slice(&vector.to_array());
        }
        Portable(lanes)
    }
    #[inline(always)]
    fn blend(texels: &[Texel], first: usize, pitch: usize, x: f32, y: f32) -> Vec4 {
        let (a, b) = (unpack(texels[first]), unpack(texels[first + 1]));
        let (c, d) = (unpack(texels[first + pitch]), unpack(texels[first + pitch + 1]));
        let (left, right) = (a + (c - a) * y, b + (d - b) * y);
        left + (right - left) * x
    }
    #[inline(always)]
    fn pack_upper(self, low: Portable) -> PortableIntegers {
        PortableIntegers(from_fn(|lane| {
            let half = |value: f32| value.to_bits().wrapping_add(0x8000);
            ((half(self.0[lane]) & !0xffff) | (half(low.0[lane]) >> 16)) as i32
        }))
    }
    #[inline(always)]
    fn gather<const N: usize>(from: [&[f32]; N], index: PortableIntegers) -> [Portable; N] {
        from.map(|plane| Portable(index.0.map(|index| plane[index as usize])))
    }
    #[inline(always)]
    fn gather_words<const N: usize>(from: [&[u32]; N], index: PortableIntegers) -> [PortableIntegers; N] {
        from.map(|plane| PortableIntegers(index.0.map(|index| plane[index as usize] as i32)))
    }
    #[inline(always)]
    fn gather_records<const N: usize>(from: &[u32], first: PortableIntegers) -> [PortableIntegers; N] {
        let mut found = [PortableIntegers([0; LANES]); N];
        for (lane, first) in first.0.into_iter().enumerate() {
            let record = &from[first as usize..][..N];
            for (found, word) in found.iter_mut().zip(record) {
                found.0[lane] = *word as i32;
            }
        }
        found
    }
}
