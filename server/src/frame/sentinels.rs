//! Paths that are walked twice, to see where light has changed: see [`crate::cache::Changes`].
//!
//! Part of live frames, in scenes in which things move only: there each frame leaves some paths, with what they found,
//! and the next one walks them again before it uses the cache. They end after the first reflection: light that has
//! been reflected more often is smooth, and changes with that. Cost: two paths of up to five rays for one diffuse point
//! in [`POINTS`].

use super::cached::Shaded;
use super::{FrameRenderer, FrameRequest};
use crate::cache::{Comparison, Deposits, IrradianceCache, luminance};
use crate::counters::RayCounts;
use crate::integrator::Gather;
use crate::integrator::sampler::Sampler;

/// One diffuse point in so many leaves a path: fewer miss small shadows, more take time from the picture.
const POINTS: usize = 64;
/// A small frame leaves more, down to one point in [`LEAST_POINTS`].
const LEAST_PER_BAND: usize = 100;
const LEAST_POINTS: usize = 4;
/// Segments of a path behind the surface that it begins at.
const SEGMENTS: u32 = 2;

/// A path, and what it found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sentinel {
    point: Shaded,
    seed: u64,
    index: u32,
    /// Luminance of irradiance over pi.
    found: f32,
}

impl FrameRenderer {
    /// Leaves paths from some of a band's points, instead of those before.
    pub(super) fn leave_sentinels(
        &self,
        request: &FrameRequest,
        cache: &IrradianceCache,
        points: &[Shaded],
        sentinels: &mut Vec<Sentinel>,
        counts: &mut RayCounts,
    ) {
        sentinels.clear();
        let spacing = (points.len() / LEAST_PER_BAND).clamp(LEAST_POINTS, POINTS);
        // Other points each time.
        let first = (Sampler::new(request.seed, u64::MAX, 1).value() * spacing as f32) as usize;
        let mut unused = Deposits::default();
        for (index, point) in (0_u32..).zip(points.iter().skip(first).step_by(spacing)) {
            let mut sentinel = Sentinel { point: *point, seed: request.seed, index, found: 0.0 };
            sentinel.found = self.walk(request, cache, &sentinel, &mut unused, counts);
            sentinels.push(sentinel);
        }
    }

    /// Walks a band's paths again in the scene as it is now.
    pub(super) fn compare_sentinels(
        &self,
        request: &FrameRequest,
        cache: &IrradianceCache,
        cell_per_m: f32,
        sentinels: &[Sentinel],
        comparisons: &mut Vec<Comparison>,
        counts: &mut RayCounts,
    ) {
        comparisons.clear();
        let mut unused = Deposits::default();
        comparisons.extend(sentinels.iter().map(|sentinel| Comparison {
            position: sentinel.point.vertex.point.position,
            cell_m: sentinel.point.path_m * cell_per_m,
            then: sentinel.found,
            now: self.walk(request, cache, sentinel, &mut unused, counts),
        }));
    }

    fn walk(
        &self,
        request: &FrameRequest,
        cache: &IrradianceCache,
        sentinel: &Sentinel,
        unused: &mut Deposits,
        counts: &mut RayCounts,
    ) -> f32 {
        unused.clear();
        let Shaded { vertex, path_m, .. } = &sentinel.point;
        let sampler = Sampler::new(sentinel.seed, u64::MAX - 1, sentinel.index);
        let max_depth = request.max_depth.min(vertex.segments + SEGMENTS);
        // The width of cells does not matter to a path that is not to end in one.
        let mut gather =
            Gather { cache, cell_per_m: 1.0, may_end: false, max_depth, sampler, counts, deposits: unused };
        luminance(self.tracer.irradiance(vertex, *path_m, &mut gather))
    }
}
