use super::*;
use crate::stability::bound;
use crate::volume::{Albedo, Grid, Phase};
use glam::{Affine3A, DVec3};
use std::sync::Arc;

const ALONG_X: Ray = Ray { origin: Vec3::new(-0.5, 0.4, 0.45), direction: Vec3::X };

pub(crate) fn homogeneous(extinction_per_m: Vec3, albedo: Vec3) -> Medium {
    Medium { matter: Matter::Homogeneous { extinction_per_m, albedo, emission: Vec3::ZERO }, phase: Phase::ISOTROPIC }
}

/// Blobs in a third of the unit cube, empty elsewhere; in one channel or in three that differ.
fn blobs(channels: u8) -> Arc<Grid> {
    let size = [40_u32, 24, 16];
    let mut values = Vec::new();
    for index in 0..size.iter().product::<u32>() {
        let [x, y, z] = [index % 40, index / 40 % 24, index / 960].map(|cell| cell as f32 * 0.37);
        let blob = (x.sin() * y.cos() + z.sin() - 0.2).max(0.0);
        values.extend((0..channels).map(|channel| blob * (1.0 + 0.8 * f32::from(channel))));
    }
    Arc::new(Grid::new(size, channels, values).unwrap())
}

fn cloud(channels: u8, extinction_per_m: Vec3) -> Medium {
    let matter = Matter::Density {
        density: blobs(channels),
        unit_from_world: Affine3A::IDENTITY,
        extinction_per_m,
        albedo: Albedo::Constant(Vec3::new(0.9, 0.5, 0.2)),
        emission: Vec3::ZERO,
    };
    Medium { matter, phase: Phase::ISOTROPIC }
}

/// Optical depth along a ray by the midpoint rule, in f64.
fn depth_along(medium: &Medium, ray: &Ray, end: f32) -> DVec3 {
    let steps = 40_000;
    let step = f64::from(end) / f64::from(steps);
    let at = |index: i32| medium.at(ray.at(((f64::from(index) + 0.5) * step) as f32)).extinction.as_dvec3() * step;
    (0..steps).map(at).sum()
}

/// Mean and standard error of samples.
fn mean_of(count: u32, mut sample: impl FnMut(&mut Sampler) -> Vec3) -> (DVec3, DVec3) {
    let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
    for index in 0..count {
        // A stream each: samples of one stream are stratified, and their scatter says nothing.
        let value = sample(&mut Sampler::new(1, u64::from(index), 0)).as_dvec3();
        sum += value;
        squares += value * value;
    }
    let mean = sum / f64::from(count);
    let variance = (squares / f64::from(count) - mean * mean).max(DVec3::ZERO) / f64::from(count);
    (mean, DVec3::new(variance.x.sqrt(), variance.y.sqrt(), variance.z.sqrt()))
}

/// 4.5 standard errors: one in 150,000 honest comparisons fails. Beside it the roundings of f32 sums.
#[track_caller]
fn agree(what: &str, (mean, error): (DVec3, DVec3), expected: DVec3) {
    let limit = 4.5 * error + 1e-5 * expected.abs() + 1e-12;
    assert!((mean - expected).abs().cmple(limit).all(), "{what}: {mean} +- {error}, expected {expected}");
}

#[test]
fn transmittance_through_a_homogeneous_medium_is_that_of_beer_and_lambert() {
    let medium = homogeneous(Vec3::new(0.0, 0.5, 40.0), Vec3::ONE);
    let mut sampler = Sampler::new(0, 0, 0);
    let left = transmittance(&medium, &ALONG_X, 1.0..3.0, &mut sampler);
    assert!((left - Vec3::new(1.0, (-1.0_f32).exp(), (-80.0_f32).exp())).abs().max_element() < 1e-6);
    assert_eq!(transmittance(&medium, &ALONG_X, 0.0..f32::INFINITY, &mut sampler), Vec3::X);
}

#[test]
fn ratio_tracking_is_unbiased_against_quadrature() {
    for (medium, end) in [
        (cloud(1, Vec3::splat(3.0)), 2.0),
        (cloud(1, Vec3::new(0.5, 6.0, 1.0)), 2.0),
        (cloud(3, Vec3::new(4.0, 1.0, 2.0)), 0.9),
        (cloud(1, Vec3::splat(60.0)), 0.7),
    ] {
        let expected = (-depth_along(&medium, &ALONG_X, end)).exp();
        let estimate = mean_of(40_000, |sampler| transmittance(&medium, &ALONG_X, 0.0..end, sampler));
        agree("ratio tracking", estimate, expected);
    }
}

/// Thin pieces by the hundred thousand, and one of optical depth 1e4.
#[test]
fn stability_transmittance_of_a_grid() {
    let mut off = bound!("transmittance", "1e5 blocks of a grid, relative", 1e-5);
    let mut negative = bound!("transmittance", "estimates that are negative or no number", 0.0);
    let size = [800_000, 1, 1];
    let constant = Arc::new(Grid::new(size, 1, vec![1.0; 800_000]).unwrap());
    let along = |extinction: f32, density: &Arc<Grid>| {
        let matter = Matter::Density {
            density: density.clone(),
            unit_from_world: Affine3A::IDENTITY,
            extinction_per_m: Vec3::new(extinction, 0.5 * extinction, 0.0),
            albedo: Albedo::Constant(Vec3::ONE),
            emission: Vec3::ZERO,
        };
        Medium { matter, phase: Phase::ISOTROPIC }
    };
    let mut sampler = Sampler::new(0, 0, 0);
    let mut left = |medium: &Medium| transmittance(medium, &ALONG_X, 0.0..f32::INFINITY, &mut sampler);
    // 100,000 blocks; what is known of each is summed up before the one exponential.
    for tau in [1e-4_f32, 2.0, 10.0] {
        let thin = left(&along(tau, &constant));
        off.see((f64::from(thin.x) / (-f64::from(tau)).exp() - 1.0).abs(), tau);
        assert_eq!(thin.z, 1.0);
    }
    assert_eq!(left(&along(1e4, &constant)), Vec3::Z);
    let rough = cloud(3, Vec3::new(1e4, 10.0, 1e-3));
    for _ in 0..1000 {
        let left = left(&rough);
        negative.count(!left.cmpge(Vec3::ZERO).all() || !left.is_finite(), left);
    }
}

/// Free flights of a grey medium, through empty blocks and dense ones: the distances follow the density
/// sigma exp(-tau).
#[test]
fn free_flight_distances_have_the_density_of_the_medium() {
    for (medium, end) in [(homogeneous(Vec3::splat(1.7), Vec3::ONE), 2.0), (cloud(1, Vec3::splat(5.0)), 2.0)] {
        let (cells, count) = (40_usize, 60_000_u32);
        let mut found = vec![0_u32; cells + 1];
        for index in 0..count {
            let mut carried = Carried { throughput: Vec3::ONE, gathered: Vec3::ZERO };
            let at = fly(&medium, &ALONG_X, end, &mut carried, &mut Sampler::new(2, u64::from(index), 0));
            let cell = at.map_or(cells, |at| ((at / end * cells as f32) as usize).min(cells - 1));
            found[cell] += 1;
        }
        // Transmittance up to each cell, by sums over its steps.
        let step = f64::from(end) / (cells * 1000) as f64;
        let mut depth = 0.0;
        let mut through = vec![1.0];
        for index in 0..cells * 1000 {
            depth += f64::from(medium.at(ALONG_X.at(((index as f64 + 0.5) * step) as f32)).extinction.x) * step;
            if index % 1000 == 999 {
                through.push((-depth).exp());
            }
        }
        let mut chi2 = 0.0;
        let mut freedom = -1.0_f64;
        for (cell, &found) in found.iter().enumerate() {
            let part = if cell == cells { through[cells] } else { through[cell] - through[cell + 1] };
            let expected = part * f64::from(count);
            if expected >= 5.0 {
                chi2 += (f64::from(found) - expected).powi(2) / expected;
                freedom += 1.0;
            } else {
                assert!(f64::from(found) <= expected + 5.0 + 5.0 * expected.sqrt(), "{cell}: {found} {expected}");
            }
        }
        // Wilson and Hilferty 1931: 99.99 % of honest samplers stay below 3.8.
        let spread = 2.0 / (9.0 * freedom);
        let z = ((chi2 / freedom).cbrt() - (1.0 - spread)) / spread.sqrt();
        assert!(freedom > 5.0 && z < 3.8, "z {z}, freedom {freedom}");
    }
}

/// What a flight leaves of a function of the distance, against quadrature, from any throughput: no channel is
/// wrong because another decides.
#[test]
fn flights_weigh_every_channel_right_whatever_the_others_are() {
    let chromatic = Vec3::new(0.3, 2.0, 5.0);
    for medium in [homogeneous(chromatic, Vec3::new(0.9, 0.5, 0.2)), cloud(1, chromatic), cloud(3, chromatic)] {
        for throughput in [Vec3::ONE, Vec3::new(0.05, 0.0, 2.0), Vec3::X] {
            let end = 1.6_f32;
            // Integral of sigma_s T (1 + 2 t) over the distance, and T(end).
            let (mut depth, mut scattered) = (DVec3::ZERO, DVec3::ZERO);
            let steps = 40_000;
            let step = f64::from(end) / f64::from(steps);
            for index in 0..steps {
                let t = (f64::from(index) + 0.5) * step;
                let optical = medium.at(ALONG_X.at(t as f32));
                let here = optical.extinction.as_dvec3() * step;
                scattered += (-(depth + 0.5 * here)).exp() * optical.scattering.as_dvec3() * step * (1.0 + 2.0 * t);
                depth += here;
            }
            let expected = throughput.as_dvec3();
            let mut sum = 0.0_f32;
            let flights = |through: bool| {
                mean_of(60_000, |sampler| {
                    let mut carried = Carried { throughput, gathered: Vec3::ZERO };
                    match (fly(&medium, &ALONG_X, end, &mut carried, sampler), through) {
                        (Some(at), false) => carried.throughput * (1.0 + 2.0 * at),
                        (None, true) => carried.throughput,
                        _ => Vec3::ZERO,
                    }
                })
            };
            agree("scattered", flights(false), expected * scattered);
            agree("through", flights(true), expected * (-depth).exp());
            // The sum over channels never grows.
            for index in 0..2000 {
                let mut carried = Carried { throughput, gathered: Vec3::ZERO };
                fly(&medium, &ALONG_X, end, &mut carried, &mut Sampler::new(9, index, 0));
                sum = sum.max(carried.throughput.element_sum());
            }
            assert!(sum <= throughput.element_sum() * (1.0 + 1e-3), "{sum}");
        }
    }
}

/// Integral of the transmittance times the emission, also where nothing is extinguished.
#[test]
fn emission_of_a_medium_is_its_line_integral() {
    for extinction in [Vec3::ZERO, Vec3::new(0.0, 2.0, 9.0)] {
        for medium in [homogeneous(extinction, Vec3::ZERO), cloud(1, extinction)] {
            let radiance = Vec3::new(1.0, 2.0, 0.5);
            let mut medium = medium;
            match &mut medium.matter {
                Matter::Homogeneous { emission, .. } | Matter::Density { emission, .. } => *emission = radiance,
                Matter::Classified { .. } => unreachable!(),
            }
            let end = 1.4_f32;
            let (mut depth, mut expected) = (DVec3::ZERO, DVec3::ZERO);
            let steps = 40_000;
            let step = f64::from(end) / f64::from(steps);
            for index in 0..steps {
                let optical = medium.at(ALONG_X.at(((f64::from(index) + 0.5) * step) as f32));
                let here = optical.extinction.as_dvec3() * step;
                expected += (-(depth + 0.5 * here)).exp() * optical.emission.as_dvec3() * step;
                depth += here;
            }
            let estimate = mean_of(60_000, |sampler| {
                let mut carried = Carried { throughput: Vec3::ONE, gathered: Vec3::ZERO };
                fly(&medium, &ALONG_X, end, &mut carried, sampler);
                carried.gathered
            });
            agree("emission", estimate, expected);
        }
    }
}

#[test]
fn nothing_undefined_comes_of_hostile_media() {
    for extinction in [0.0, 1e-30, 1e30, f32::MAX] {
        for albedo in [-1.0, 0.0, 1.0, 7.0] {
            let mut media = vec![homogeneous(Vec3::new(extinction, 0.0, 1.0), Vec3::splat(albedo))];
            media.push(cloud(1, Vec3::new(extinction, 0.0, 1.0)));
            for medium in media {
                for end in [0.0, 1e-20, 1.0, 1e30, f32::INFINITY] {
                    for index in 0..4 {
                        let mut sampler = Sampler::new(3, index, 0);
                        let mut carried = Carried { throughput: Vec3::new(1.0, 0.0, 1e-20), gathered: Vec3::ZERO };
                        fly(&medium, &ALONG_X, end, &mut carried, &mut sampler);
                        assert!(carried.throughput.is_finite() && carried.throughput.min_element() >= 0.0);
                        assert!(transmittance(&medium, &ALONG_X, 0.0..end, &mut sampler).is_finite());
                    }
                }
            }
        }
    }
}
