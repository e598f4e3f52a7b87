//! How much light rough surfaces send on, and what becomes of the rest.
//!
//! A facet model that follows light to one facet only loses what meets a second: up to 60 % at alpha 1, seen
//! as rough metal that is too dark. Here is what it keeps, its directional albedo, in tables:
//!
//! - [`Albedo`], of reflection: E(mu) for facets that reflect everything, and the part of it that goes with
//!   Schlick's (1 - cos)^5, so that E = F0 a + F90 b holds for every Schlick reflectance (the split sum).
//! - [`super::transmission`], of reflection and refraction together, by relative index.
//!
//! and what gives the rest back: [`Multiple`], the lobe of Kulla and Conty 2017,
//! (1 - E(wo)) (1 - E(wi)) / (pi (1 - E_avg)), which is reciprocal and sums to 1 - E(wo).
//!
//! Tables are made once, at first use or by [`prepare`], by quadrature over the visible facets; they are the
//! same on every machine but for the last digits of its mathematical library. Between nodes, linear in the
//! square roots of alpha and of mu, where E is smooth; averages integrate just that, so that what a table
//! loses in accuracy it does not lose in energy. Anisotropic facets use the geometric mean of their alphas.
//!
//! Limits: 0.5 % of the light for isotropic facets (tested); alphas above 1 count as 1. Cost: 0.3 s
//! (GGX) to 1 s (Beckmann), on a loaded core, and 18 KiB for each distribution; a look-up is some 5 ns.

use super::microfacet::{Facets, reflect_about};
use crate::scene::Distribution;
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, TAU};
use std::sync::LazyLock;

/// Nodes over the square root of alpha, 0 to 1.
const ALPHAS: usize = 32;
/// Nodes over the square root of mu, 0 to 1.
const COSINES: usize = 48;
/// Generator and points of the quadrature's lattice: Fibonacci numbers, one after the other.
const LATTICE: [u32; 2] = [987, 1597];
/// Cosine that stands for grazing: less is lost in rounding.
const GRAZING: f32 = 1e-4;

/// a and b of all alphas.
struct Reflection {
    nodes: Vec<[Vec2; COSINES]>,
    /// Twice the integral over mu dmu.
    averages: Vec<Vec2>,
    /// Part of the lost light, (1 - E) mu dmu, below each node.
    lost_below: Vec<[f32; COSINES]>,
}

static GGX: LazyLock<Reflection> = LazyLock::new(|| Reflection::of(Distribution::Ggx));
static BECKMANN: LazyLock<Reflection> = LazyLock::new(|| Reflection::of(Distribution::Beckmann));

/// Makes the tables of a distribution, so that no path has to wait for them.
pub(crate) fn prepare(distribution: Distribution) {
    LazyLock::force(reflection(distribution));
}

fn reflection(distribution: Distribution) -> &'static LazyLock<Reflection> {
    match distribution {
        Distribution::Ggx => &GGX,
        Distribution::Beckmann => &BECKMANN,
    }
}

impl Reflection {
    fn of(distribution: Distribution) -> Reflection {
        let row = |index: usize| {
            let alpha = (index as f32 / (ALPHAS - 1) as f32).powi(2);
            std::array::from_fn(|node| {
                let mu = mu_of(node);
                if index == 0 { smooth(mu) } else { albedo_by_quadrature(distribution, alpha, mu) }
            })
        };
        let nodes: Vec<[Vec2; COSINES]> = (0..ALPHAS).map(row).collect();
        let averages = nodes.iter().map(average).collect();
        let lost_below = nodes.iter().map(lost_below).collect();
        Reflection { nodes, averages, lost_below }
    }
}

/// a and b of a smooth surface.
fn smooth(mu: f32) -> Vec2 {
    let schlick = (1.0 - mu).powi(5);
    Vec2::new(1.0 - schlick, schlick)
}

/// 2 E mu dmu with E linear in t = sqrt(mu): 4 E t^3 dt, exactly.
fn average(row: &[Vec2; COSINES]) -> Vec2 {
    let step = 1.0 / (COSINES - 1) as f64;
    let mut sum = glam::DVec2::ZERO;
    for (index, pair) in row.windows(2).enumerate() {
        let (t0, t1) = (index as f64 * step, (index + 1) as f64 * step);
        let [at_0, at_1] = [pair[0].as_dvec2(), pair[1].as_dvec2()];
        // E = p + q t.
        let q = (at_1 - at_0) / step;
        let p = at_0 - q * t0;
        sum += p * (t1.powi(4) - t0.powi(4)) + q * (0.8 * (t1.powi(5) - t0.powi(5)));
    }
    sum.as_vec2()
}

/// Distribution of the light lost in a row over mu, mixed with a little cosine, so that nothing has the density 0
/// that another row may lose.
fn lost_below(row: &[Vec2; COSINES]) -> [f32; COSINES] {
    const COSINE_PART: f32 = 0.05;
    let mut below = [0.0; COSINES];
    for node in 1..COSINES {
        let lost = (2.0 - row[node - 1].element_sum() - row[node].element_sum()).max(0.0);
        below[node] = below[node - 1] + lost * (mu_of(node).powi(2) - mu_of(node - 1).powi(2));
    }
    let total = below[COSINES - 1];
    let part = if total > 0.0 { (1.0 - COSINE_PART) / total } else { 0.0 };
    let cosine_part = if total > 0.0 { COSINE_PART } else { 1.0 };
    std::array::from_fn(|node| part * below[node] + cosine_part * mu_of(node).powi(2))
}

/// Cosine of a node.
fn mu_of(node: usize) -> f32 {
    (node as f32 / (COSINES - 1) as f32).powi(2)
}

/// Points of the unit square with their weights, which sum to about 1: a Fibonacci lattice (Niederreiter 1992), which
/// suffers less from kinks than a grid does; more of it where the steep facets are, which lose the light: towards 1
/// of the second coordinate for GGX, at all edges for Beckmann.
pub(super) fn lattice(distribution: Distribution, points: [u32; 2]) -> impl Iterator<Item = (Vec2, f32)> {
    let [generator, count] = points;
    let cell = 1.0 / count as f32;
    (0..count).map(move |index| {
        let x = ((index * generator % count) as f32 + 0.5) * cell;
        let y = (index as f32 + 0.5) * cell;
        match distribution {
            Distribution::Ggx => (Vec2::new(x, 1.0 - y * y), 2.0 * y * cell),
            Distribution::Beckmann => {
                let smoothstep = |v: f32| (v * v * (3.0 - 2.0 * v), 6.0 * v * (1.0 - v));
                let ((x, wx), (y, wy)) = (smoothstep(x), smoothstep(y));
                (Vec2::new(x, y), wx * wy * cell)
            }
        }
    })
}

pub(super) fn direction_of(mu: f32) -> Vec3 {
    let mu = mu.max(GRAZING);
    Vec3::new((1.0 - mu * mu).max(0.0).sqrt(), 0.0, mu)
}

fn albedo_by_quadrature(distribution: Distribution, alpha: f32, mu: f32) -> Vec2 {
    let facets = Facets::new(distribution, Vec2::splat(alpha));
    let wo = direction_of(mu);
    let (mut sum, mut weights) = (Vec2::ZERO, 0.0);
    for (u, weight) in lattice(distribution, LATTICE) {
        weights += weight;
        let m = facets.sample_visible(wo, u);
        let wi = reflect_about(wo, m);
        if wi.z > 0.0 {
            let schlick = (1.0 - wo.dot(m).clamp(0.0, 1.0)).powi(5);
            sum += weight * facets.visible(wi) * Vec2::new(1.0 - schlick, schlick);
        }
    }
    sum / weights
}

/// Node below a position from 0 to 1 and the part of the next.
pub(super) fn between(position: f32, nodes: usize) -> (usize, f32) {
    let scaled = position.clamp(0.0, 1.0) * (nodes - 1) as f32;
    let low = (scaled as usize).min(nodes - 2);
    (low, scaled - low as f32)
}

/// The albedo of one reflecting surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Albedo {
    /// Row of the table below its alpha and part of the next; `None` where it is smooth.
    row: Option<(Distribution, u16, f32)>,
}

impl Albedo {
    pub(crate) const SMOOTH: Albedo = Albedo { row: None };

    pub(crate) fn of(facets: &Facets) -> Albedo {
        let (row, part) = between(facets.mean_alpha().sqrt(), ALPHAS);
        Albedo { row: Some((facets.distribution, row as u16, part)) }
    }

    /// a and b of E = F0 a + F90 b, for a direction whose cosine is `mu`; their sum is E for F = 1.
    pub(crate) fn at(&self, mu: f32) -> Vec2 {
        let mu = mu.clamp(0.0, 1.0);
        let Some((distribution, row, part)) = self.row else { return smooth(mu) };
        let rows = &reflection(distribution).nodes;
        let (node, beyond) = between(mu.sqrt(), COSINES);
        let along = |row: &[Vec2; COSINES]| row[node].lerp(row[node + 1], beyond);
        along(&rows[usize::from(row)]).lerp(along(&rows[usize::from(row) + 1]), part)
    }

    /// The same on average over directions, weighted by the cosine.
    pub(crate) fn average(&self) -> Vec2 {
        let Some((distribution, row, part)) = self.row else { return Vec2::new(20.0 / 21.0, 1.0 / 21.0) };
        let averages = &reflection(distribution).averages;
        averages[usize::from(row)].lerp(averages[usize::from(row) + 1], part)
    }

    /// E for facets that reflect everything.
    pub(crate) fn white(&self, mu: f32) -> f32 {
        self.at(mu).element_sum().min(1.0)
    }
}

/// The reflectance of Schlick 1994, F0 + (F90 - F0) (1 - cos)^5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Schlick {
    pub(crate) f0: Vec3,
    pub(crate) f90: Vec3,
}

impl Schlick {
    pub(crate) fn reflectance(&self, cosine: f32) -> Vec3 {
        self.f0.lerp(self.f90, (1.0 - cosine.clamp(0.0, 1.0)).powi(5))
    }

    /// Its albedo, from the a and b of [`Albedo`].
    pub(crate) fn albedo(&self, split: Vec2) -> Vec3 {
        self.f0 * split.x + self.f90 * split.y
    }
}

/// The lobe of light that has met several facets.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Multiple {
    albedo: Albedo,
    /// Factor for the reflectance of the facets, over pi (1 - E_avg).
    scale: Vec3,
    /// 1 - E(wo).
    lost: f32,
}

impl Multiple {
    /// For light seen from a direction of cosine `mu`; `average` is the mean of the facets' reflectance F over
    /// directions. Of light that has met n facets F^n is left, and 1 - E_avg of it meets another (Kulla and
    /// Conty 2017; the square because two are met at least).
    pub(crate) fn new(albedo: Albedo, average: Vec3, mu: f32) -> Multiple {
        let kept = albedo.average().element_sum().min(1.0);
        let lost = 1.0 - kept;
        // Without anything lost there is nothing to give back, and 0 / 0.
        let scale = if lost > 1e-6 {
            average * average * kept / (Vec3::ONE - average * lost) * (FRAC_1_PI / lost)
        } else {
            Vec3::ZERO
        };
        Multiple { albedo, scale, lost: 1.0 - albedo.white(mu) }
    }

    /// Its value with the cosine for light from the direction of cosine `mu`.
    pub(crate) fn value(&self, mu: f32) -> Vec3 {
        self.scale * (self.lost * (1.0 - self.albedo.white(mu)) * mu)
    }

    /// A direction about z, about by its value: by the light lost in the row of the nearest alpha, node by node;
    /// between nodes by the cosine. The lobe of a narrow distribution is a rim at the horizon.
    pub(crate) fn sample(&self, u: Vec2) -> Vec3 {
        let below = self.lost_below();
        let node = below.partition_point(|&below| below <= u.x).clamp(1, COSINES - 1);
        let part = ((u.x - below[node - 1]) / (below[node] - below[node - 1])).clamp(0.0, 1.0);
        let mu2 = mu_of(node - 1).powi(2) + part * (mu_of(node).powi(2) - mu_of(node - 1).powi(2));
        let (sine, cosine) = (TAU * u.y).sin_cos();
        let radius = (1.0 - mu2).max(0.0).sqrt();
        Vec3::new(radius * cosine, radius * sine, mu2.sqrt())
    }

    /// Density over solid angle of [`Multiple::sample`] at the cosine `mu`.
    pub(crate) fn pdf(&self, mu: f32) -> f32 {
        let below = self.lost_below();
        let (node, _) = between(mu.clamp(0.0, 1.0).sqrt(), COSINES);
        let (low, high) = (mu_of(node).powi(2), mu_of(node + 1).powi(2));
        (below[node + 1] - below[node]) * mu * FRAC_1_PI / (high - low)
    }

    fn lost_below(&self) -> &'static [f32; COSINES] {
        // A smooth surface has no such lobe; the first row is that.
        let (distribution, row, part) = self.albedo.row.unwrap_or((Distribution::Ggx, 1, 0.0));
        &reflection(distribution).lost_below[(usize::from(row) + usize::from(part > 0.5)).max(1)]
    }

    /// What it makes of the same radiance from everywhere.
    pub(crate) fn albedo(&self) -> Vec3 {
        let lost = 1.0 - self.albedo.average().element_sum().min(1.0);
        self.scale * (self.lost * lost * std::f32::consts::PI)
    }
}
