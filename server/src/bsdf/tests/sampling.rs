//! Samplers against their densities, weights against values, and densities against 1.

use super::*;
use crate::bsdf::microfacet::Facets;
use crate::stability::bound;
use crate::testing::chi_square::Outcome;
use crate::testing::{chi_square, critical_z};
use warplight_protocol::optics::{reflect, refract};

const SAMPLES: u32 = 30_000;
/// More than there are comparisons in this file.
const COMPARISONS: usize = 400;

/// Chi-square about `axis`; the density sums to 1 at most.
fn follows(name: &str, bsdf: &Bsdf, axis: Vec3, lobes: Lobes) -> Outcome {
    // A draw that sends no light gives no sample.
    let density = |towards| {
        let of = bsdf.evaluate(towards, lobes);
        if of.value == Vec3::ZERO { 0.0 } else { of.pdf }
    };
    let outcome = chi_square::compare(axis, SAMPLES, |index| draw(bsdf, lobes, index), density);
    assert!(outcome.z < critical_z(COMPARISONS, f64::INFINITY), "{name} {lobes:?}: {outcome:?}");
    // f32 densities of lobes as narrow as 1e-4 are off by a thousandth (see SMOOTH_ALPHA).
    assert!(outcome.integral < 1.003, "{name} {lobes:?}: {outcome:?}");
    outcome
}

/// From a roughness of 1e-4, which is as good as 0, to 1; albedo 1, and black.
#[test]
fn stability_sampling_of_surfaces() {
    let most_z = critical_z(COMPARISONS, f64::INFINITY);
    let mut z = bound!("sampling", "chi-square of surfaces, in standard deviations", most_z);
    let mut integral = bound!("sampling", "densities above 1 in all", 0.003);
    let mut infinite = bound!("sampling", "weights that are infinite, negative or no number", 0.0);
    for (alpha, distribution) in [(0.0, DISTRIBUTIONS[0]), (1e-4, DISTRIBUTIONS[0]), (1.0, DISTRIBUTIONS[1])] {
        let finish = isotropic(distribution, alpha);
        let black = Standard { base: Color::Constant(Vec3::ZERO), ..standard(finish) };
        let black_metal = Standard { metallic: Scalar::Constant(1.0), ..black };
        for (index, surface) in [
            white_metal(finish),
            pane(1.5, finish),
            Surface::Standard(standard(finish)),
            Surface::Standard(black),
            Surface::Standard(black_metal),
            Surface::Diffuse { albedo: Color::Constant(Vec3::ZERO) },
            Surface::Diffuse { albedo: Color::Constant(Vec3::ONE) },
        ]
        .into_iter()
        .enumerate()
        {
            let probe = Probe::new(surface);
            for mu in COSINES {
                let eye = direction(mu, 0.7);
                let bsdf = probe.seen_from(eye);
                let name = format!("{distribution:?} {alpha} {mu}, surface {index}");
                for draw in 0..500 {
                    let mut sampler = Sampler::new(21, draw, 0);
                    let sample = bsdf.sample(sampler.value(), sampler.pair(), Lobes::ALL);
                    let is_bad = |weight: Vec3| !weight.is_finite() || weight.min_element() < 0.0;
                    infinite.count(sample.is_some_and(|s| is_bad(s.weight) || s.pdf.is_nan() || s.pdf <= 0.0), &name);
                }
                let lobes = Lobes { refracted: false, ..Lobes::ALL };
                if bsdf.has(lobes) && (alpha == 0.0) == (index >= 5) {
                    let outcome = follows(&name, &bsdf, mirrored(eye), lobes);
                    z.see(outcome.z, &name);
                    integral.see((outcome.integral - 1.0).max(0.0), &name);
                }
            }
        }
    }
}

fn mirrored(towards_eye: Vec3) -> Vec3 {
    reflect(-towards_eye, Vec3::Y)
}

#[test]
fn facets_that_are_seen_cover_what_is_seen() {
    // The weak white furnace (Heitz 2014): visible facets have the area that is seen.
    for distribution in DISTRIBUTIONS {
        for alpha in [Vec2::splat(0.02), Vec2::splat(0.3), Vec2::splat(1.0), Vec2::new(0.6, 0.1)] {
            let facets = Facets::new(distribution, alpha);
            for mu in COSINES {
                let wo = Vec3::new((1.0 - mu * mu).sqrt() * 0.8, (1.0 - mu * mu).sqrt() * 0.6, mu);
                let area = chi_square::integral(Vec3::Z, |m| facets.pdf_visible(wo, m));
                assert!((area - 1.0).abs() < 1e-3, "{distribution:?} {alpha} {mu}: {area}");
                let ground = chi_square::integral(Vec3::Z, |m| facets.density(m) * m.z.max(0.0));
                assert!((ground - 1.0).abs() < 1e-3, "{distribution:?} {alpha}: {ground}");
            }
        }
    }
}

#[test]
fn metals_are_drawn_by_their_density() {
    for distribution in DISTRIBUTIONS {
        for alpha in ALPHAS {
            let probe = Probe::new(gold(isotropic(distribution, alpha)));
            for mu in COSINES {
                let eye = direction(mu, 0.7);
                follows(&format!("{distribution:?} {alpha} {mu}"), &probe.seen_from(eye), mirrored(eye), Lobes::ALL);
            }
        }
        let probe = Probe::new(gold(Finish::along_axes(distribution, 0.05, 0.4)));
        for mu in COSINES {
            let eye = direction(mu, 0.7);
            follows(&format!("stretched {distribution:?} {mu}"), &probe.seen_from(eye), mirrored(eye), Lobes::ALL);
        }
    }
}

#[test]
fn glass_is_drawn_by_its_density_from_both_sides() {
    for distribution in DISTRIBUTIONS {
        for alpha in ALPHAS {
            let probe = Probe::new(glass(1.5, isotropic(distribution, alpha)));
            for mu in COSINES.into_iter().flat_map(|mu| [mu, -mu]) {
                let eye = direction(mu, 0.7);
                let bsdf = probe.seen_from(eye);
                let name = format!("{distribution:?} {alpha} {mu}");
                let normal = Vec3::Y * mu.signum();
                // Beyond the critical angle what is refracted by tilted facets leaves about the grazing one.
                let refracted = refract(-eye, normal, if mu > 0.0 { 1.5 } else { 1.0 / 1.5 });
                if let Some(axis) = refracted {
                    follows(&name, &bsdf, axis, Lobes::REFRACTED);
                }
                follows(&name, &bsdf, mirrored(eye), Lobes::REFLECTED);
                if alpha >= 0.1 {
                    follows(&name, &bsdf, mirrored(eye), Lobes::ALL);
                }
            }
        }
    }
}

#[test]
fn panes_are_drawn_by_their_density() {
    for alpha in ALPHAS {
        let probe = Probe::new(pane(1.5, isotropic(Distribution::Ggx, alpha)));
        for mu in COSINES {
            let eye = direction(mu, 0.7);
            let bsdf = probe.seen_from(eye);
            let name = format!("{alpha} {mu}");
            follows(&name, &bsdf, -eye, Lobes::REFRACTED);
            follows(&name, &bsdf, mirrored(eye), if alpha < 0.1 { Lobes::REFLECTED } else { Lobes::ALL });
        }
    }
}

#[test]
fn standard_surfaces_are_drawn_by_their_density() {
    for alpha in [1e-4, 0.1, 0.5] {
        for (name, standard) in standards(isotropic(Distribution::Ggx, alpha)) {
            let probe = Probe::new(Surface::Standard(standard));
            for mu in COSINES {
                let eye = direction(mu, 0.7);
                let bsdf = probe.seen_from(eye);
                // A narrow transmission would be missed between the wide cells opposite to the axis.
                let through = Lobes::REFRACTED;
                let lobes = if alpha < 0.1 { Lobes { refracted: false, ..Lobes::ALL } } else { Lobes::ALL };
                follows(&format!("{name} {alpha} {mu}"), &bsdf, mirrored(eye), lobes);
                if bsdf.has(through) {
                    follows(&format!("{name} {alpha} {mu}"), &bsdf, -eye, through);
                }
            }
        }
    }
}

#[test]
fn a_sample_weighs_its_value_over_its_density() {
    let sets =
        [Lobes::ALL, Lobes::GLOSSY, Lobes::REFLECTED, Lobes::REFRACTED, Lobes { reflected: false, ..Lobes::ALL }];
    for alpha in ALPHAS {
        let finish = isotropic(Distribution::Ggx, alpha);
        let mut surfaces = vec![gold(finish), glass(1.5, finish), pane(1.3, finish)];
        surfaces.extend(standards(finish).into_iter().map(|(_, standard)| Surface::Standard(standard)));
        for surface in surfaces {
            let probe = Probe::new(surface);
            for mu in [1.0, 0.5, 0.05, -0.5] {
                let bsdf = probe.seen_from(direction(mu, -2.0));
                for (lobes, index) in sets.into_iter().flat_map(|lobes| (0..20).map(move |index| (lobes, index))) {
                    let mut sampler = Sampler::new(1, index, 0);
                    let Some(sample) = bsdf.sample(sampler.value(), sampler.pair(), lobes) else { continue };
                    let (value, pdf) =
                        (bsdf.evaluate(sample.direction, lobes).value, bsdf.evaluate(sample.direction, lobes).pdf);
                    assert!(bsdf.has(lobes));
                    assert!((pdf - sample.pdf).abs() <= 1e-5 * pdf, "{surface:?} {mu} {lobes:?}");
                    let error = (sample.weight * pdf - value).abs().max_element();
                    assert!(error <= 1e-5 * value.max_element(), "{surface:?} {mu} {lobes:?}");
                    let behind = sample.direction.y * mu < 0.0;
                    let eta = if !behind || !matches!(surface, Surface::Dielectric { .. }) {
                        1.0
                    } else if mu > 0.0 {
                        1.5
                    } else {
                        1.0 / 1.5
                    };
                    assert!((sample.eta2 - eta * eta).abs() < 1e-5);
                    assert_eq!(sample.medium, bsdf.medium_towards(sample.direction));
                }
            }
        }
    }
}
