//! Which vector instructions a walk uses: asked of the machine once, when a hierarchy is built.

use super::Ray;
use super::hierarchy::Hierarchy;
use super::lanes::Portable;
use super::traverse::{self, Nearest};
#[cfg(target_arch = "x86_64")]
use super::x86::X86;

/// A kind of instructions that this machine has.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kernel {
    #[cfg(target_arch = "x86_64")]
    Avx512(X86<true>),
    #[cfg(target_arch = "x86_64")]
    Avx2(X86<false>),
    Portable(Portable),
}

impl Kernel {
    /// Plain code, on any machine.
    pub(super) const PORTABLE: Kernel = Kernel::Portable(Portable);

    /// The fastest that this machine has.
    pub(super) fn detected() -> Kernel {
        Kernel::all().next().unwrap_or(Kernel::PORTABLE)
    }

    /// All that this machine has, the fastest first.
    pub(super) fn all() -> impl Iterator<Item = Kernel> {
        #[cfg(target_arch = "x86_64")]
        let vector = [X86::detected().map(Kernel::Avx512), X86::detected().map(Kernel::Avx2)];
        #[cfg(not(target_arch = "x86_64"))]
        let vector: [Option<Kernel>; 0] = [];
        vector.into_iter().flatten().chain([Kernel::PORTABLE])
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx512(_) => "avx512",
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2(_) => "avx2",
            Kernel::Portable(_) => "portable",
        }
    }

    /// Looks for a hit nearer than `nearest`.
    #[inline]
    pub(super) fn closest(self, hierarchy: &Hierarchy, ray: &Ray, nearest: &mut Nearest) {
        match self {
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx512(avx512) => avx512.closest(hierarchy, ray, nearest),
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2(avx2) => avx2.closest(hierarchy, ray, nearest),
            Kernel::Portable(portable) => traverse::closest(portable, hierarchy, ray, nearest),
        }
    }

    /// Whether any surface lies nearer than `max_distance` along the ray.
    #[inline]
    pub(super) fn occluded(self, hierarchy: &Hierarchy, ray: &Ray, max_distance: f32) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx512(avx512) => avx512.occluded(hierarchy, ray, max_distance),
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2(avx2) => avx2.occluded(hierarchy, ray, max_distance),
            Kernel::Portable(portable) => traverse::occluded(portable, hierarchy, ray, max_distance),
        }
    }
}
