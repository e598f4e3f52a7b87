//! One ray through one medium: where it is scattered, how much of it is left, and the light sent on its way.
//!
//! Free flight is delta tracking (Woodcock et al. 1965) by the majorants of the grid's blocks. Extinctions differ by
//! channel: tentative collisions come by the highest of them, and whether one is real is decided by the mean of
//! the channels weighted with the path's throughput so far (history-aware spectral tracking, Kutz et al. 2017,
//! section 5.1), so the sum of the throughput over channels never grows and no channel is lost. In a
//! homogeneous medium the distance is drawn in closed form by one channel, chosen by throughput, and weighted by
//! the mixture of all (single-sample balance heuristic: Wilkie et al. 2014). Where all channels are alike both are
//! the classical forms, with weight 1.
//!
//! Transmittance is ratio tracking (Novák et al. 2014) of what lies above the lowest extinction of each
//! block, which is known; in homogeneous media it is exact. It is estimated, never negative, and right on average. Below
//! [`ROULETTE_BELOW`] it goes on by Russian roulette.
//!
//! Emission is added at tentative collisions, with real and null ones alike; in homogeneous media in closed form.
//!
//! Cost: a grid sample per tentative collision; none in empty blocks.

use super::sampler::Sampler;
use crate::accel::Ray;
use crate::volume::{Matter, Medium, Optical};
use glam::{DVec3, Vec3};
use std::ops::Range;

/// Transmittance below which a shadow ray goes on by chance: what is lost to noise is small beside unoccluded ones.
const ROULETTE_BELOW: f32 = 0.1;
/// Tentative collisions, on average, along a ray through an emitting grid that hardly extinguishes.
const EMISSION_COLLISIONS: f32 = 4.0;
/// Tentative collisions after which a ray is stopped, so that it ends: an optical depth that nothing gets through, but
/// for a channel that is extinguished thousands of times less than another, whose light is lost then.
const MAX_COLLISIONS: u32 = 1 << 16;

/// What a path has gathered and has left, in absolute terms.
#[derive(Clone, Copy, Debug)]
pub(super) struct Carried {
    pub(super) throughput: Vec3,
    /// Radiance at the path's beginning.
    pub(super) gathered: Vec3,
}

/// Flies from the ray's origin towards `end`, which may be infinite: the distance at which the ray is scattered,
/// or `None` where it gets through. The throughput has the weight of either.
pub(super) fn fly(medium: &Medium, ray: &Ray, end: f32, carried: &mut Carried, sampler: &mut Sampler) -> Option<f32> {
    match &medium.matter {
        Matter::Homogeneous { extinction_per_m, albedo, emission } => {
            let albedo = albedo.clamp(Vec3::ZERO, Vec3::ONE);
            fly_homogeneous(*extinction_per_m, albedo, *emission, end, carried, sampler)
        }
        Matter::Density { .. } | Matter::Classified { .. } => fly_grid(medium, ray, end, carried, sampler),
    }
}

/// What is left of the light on a range of a ray: right on average.
pub(super) fn transmittance(medium: &Medium, ray: &Ray, range: Range<f32>, sampler: &mut Sampler) -> Vec3 {
    let Some(walk) = medium.walk(ray, range.clone()) else {
        let Matter::Homogeneous { extinction_per_m, .. } = medium.matter else { return Vec3::ONE };
        return attenuation(extinction_per_m, range.end - range.start);
    };
    let unit = walk.unit;
    let mut left = Vec3::ONE;
    // What is known of all blocks, summed up: one exponential.
    let mut known = DVec3::ZERO;
    let mut depth = exponential(sampler);
    let mut collisions = 0;
    for segment in walk {
        let highest = medium.majorant(segment.values);
        let lowest = medium.minorant(segment.values);
        let length = segment.range.end - segment.range.start;
        known += (lowest * length).as_dvec3();
        let majorant = highest - lowest.min_element();
        if majorant <= 0.0 {
            continue;
        }
        let mut at = segment.range.start;
        loop {
            let remaining = (segment.range.end - at) * majorant;
            if depth >= remaining {
                depth -= remaining;
                break;
            }
            at += depth / majorant;
            depth = exponential(sampler);
            let optical = medium.at_unit(unit.at(at));
            left *= (Vec3::ONE - (optical.extinction - lowest).max(Vec3::ZERO) / majorant).max(Vec3::ZERO);
            collisions += 1;
            if collisions > MAX_COLLISIONS {
                return Vec3::ZERO;
            }
            let most = left.max_element();
            if most < ROULETTE_BELOW {
                if most <= 0.0 || sampler.value() * ROULETTE_BELOW >= most {
                    return Vec3::ZERO;
                }
                left *= ROULETTE_BELOW / most;
            }
        }
    }
    left * attenuation(known.as_vec3(), 1.0)
}

fn fly_homogeneous(
    extinction: Vec3,
    albedo: Vec3,
    emission: Vec3,
    end: f32,
    carried: &mut Carried,
    sampler: &mut Sampler,
) -> Option<f32> {
    let throughput = carried.throughput;
    if emission != Vec3::ZERO {
        carried.gathered += throughput * emission * attenuated_length(extinction, end);
    }
    let total = throughput.element_sum();
    if extinction == Vec3::ZERO || total <= 0.0 {
        return None;
    }
    // Draw the distance by one channel.
    let probability = throughput / total;
    let choice = sampler.value();
    let channel = if choice < probability.x {
        0
    } else if choice < probability.x + probability.y || probability.z <= 0.0 {
        1
    } else {
        2
    };
    let rate = extinction[channel];
    let distance = if rate > 0.0 { exponential(sampler) / rate } else { f32::INFINITY };
    // And weight it by all, relative to the channel that is extinguished least: nothing underflows.
    let least = extinction.min_element();
    if distance < end {
        let left = attenuation(extinction - least, distance);
        let density = (probability * extinction * left).element_sum();
        carried.throughput = throughput * albedo * extinction * left / density;
        return Some(distance);
    }
    let left = attenuation(extinction - least, end);
    carried.throughput = throughput * left / (probability * left).element_sum();
    None
}

fn fly_grid(medium: &Medium, ray: &Ray, end: f32, carried: &mut Carried, sampler: &mut Sampler) -> Option<f32> {
    let walk = medium.walk(ray, 0.0..end)?;
    let unit = walk.unit;
    let emits = medium.emission() != Vec3::ZERO;
    let extent = walk.extent();
    let mut depth = exponential(sampler);
    let mut collisions = 0;
    for segment in walk {
        let mut majorant = medium.majorant(segment.values);
        if emits && segment.values.1 > 0.0 {
            majorant = majorant.max(EMISSION_COLLISIONS / (extent.end - extent.start));
        }
        if majorant <= 0.0 {
            continue;
        }
        let mut at = segment.range.start;
        loop {
            let remaining = (segment.range.end - at) * majorant;
            if depth >= remaining {
                depth -= remaining;
                break;
            }
            at += depth / majorant;
            depth = exponential(sampler);
            let Optical { extinction, scattering, emission } = medium.at_unit(unit.at(at));
            if emits {
                carried.gathered += carried.throughput * emission / majorant;
            }
            let extinction = extinction.min(Vec3::splat(majorant));
            let total = carried.throughput.element_sum();
            if total <= 0.0 || collisions > MAX_COLLISIONS {
                carried.throughput = Vec3::ZERO;
                return None;
            }
            collisions += 1;
            let real = (carried.throughput * extinction).element_sum();
            let all = majorant * total;
            if sampler.value() * all < real {
                carried.throughput *= scattering * (total / real);
                return Some(at);
            }
            carried.throughput *= (majorant - extinction) * (total / (all - real));
        }
    }
    None
}

/// exp(-extinction distance) per channel; 1 where there is no extinction, however far.
fn attenuation(extinction: Vec3, distance: f32) -> Vec3 {
    let along = |extinction: f32| if extinction > 0.0 { (-extinction * distance).exp() } else { 1.0 };
    Vec3::new(along(extinction.x), along(extinction.y), along(extinction.z))
}

/// Integral of the transmittance up to a distance; what would be infinite is nothing.
fn attenuated_length(extinction: Vec3, distance: f32) -> Vec3 {
    let along = |extinction: f32| {
        let length = if extinction > 0.0 { -(-extinction * distance).exp_m1() / extinction } else { distance };
        if length.is_finite() { length } else { 0.0 }
    };
    Vec3::new(along(extinction.x), along(extinction.y), along(extinction.z))
}

/// An optical depth drawn by its exponential density.
fn exponential(sampler: &mut Sampler) -> f32 {
    // The value is below 1: finite.
    -(-sampler.value()).ln_1p()
}

#[cfg(test)]
pub(super) mod tests;
