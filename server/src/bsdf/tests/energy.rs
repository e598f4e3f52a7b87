//! Furnaces: no surface makes light, a white one loses none. Reciprocity.

use super::*;

/// Directions looked from: every 10 degrees or so, and grazing.
const FURNACE_COSINES: [f32; 8] = [1.0, 0.95, 0.8, 0.6, 0.4, 0.2, 0.1, 0.03];
const FURNACE_ALPHAS: [f32; 9] = [1e-4, 1e-3, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 1.0];
/// What the furnaces must keep to.
const KEPT: f32 = 5e-3;
const SAMPLES: u32 = 1 << 13;

/// The largest difference from 1, and where it is.
#[derive(Default)]
struct Worst {
    error: f32,
    name: String,
}

impl Worst {
    fn note(&mut self, albedo: Vec3, name: impl FnOnce() -> String) {
        let error = (albedo - Vec3::ONE).abs().max_element();
        if error > self.error {
            *self = Worst { error, name: format!("{}: {albedo}", name()) };
        }
    }

    fn check(self) {
        assert!(self.error < KEPT, "{}", self.name);
    }
}

#[test]
fn white_metal_keeps_all_light_at_every_roughness() {
    let mut worst = Worst::default();
    for distribution in DISTRIBUTIONS {
        for alpha in FURNACE_ALPHAS {
            let probe = Probe::new(white_metal(isotropic(distribution, alpha)));
            for mu in FURNACE_COSINES {
                let bsdf = probe.seen_from(direction(mu, 0.0));
                worst.note(albedo(&bsdf, Lobes::ALL, SAMPLES), || format!("{distribution:?} {alpha} {mu}"));
            }
        }
    }
    worst.check();
}

#[test]
fn glass_keeps_all_light_at_every_roughness_and_index() {
    for distribution in DISTRIBUTIONS {
        // Beckmann facets take long to integrate.
        let indices: &[f32] = if distribution == Distribution::Ggx { &[1.33, 1.5, 2.4] } else { &[1.5] };
        for &ior in indices {
            let mut worst = Worst::default();
            for alpha in FURNACE_ALPHAS {
                let probe = Probe::new(glass(ior, isotropic(distribution, alpha)));
                for mu in FURNACE_COSINES.into_iter().flat_map(|mu| [mu, -mu]) {
                    let bsdf = probe.seen_from(direction(mu, 0.0));
                    if bsdf.sharp().is_none() {
                        let kept = albedo(&bsdf, Lobes::ALL, SAMPLES);
                        worst.note(kept, || format!("{distribution:?} {alpha} {ior} {mu}"));
                    }
                }
            }
            worst.check();
        }
    }
}

#[test]
fn panes_keep_all_light() {
    let mut worst = Worst::default();
    for alpha in FURNACE_ALPHAS {
        let probe = Probe::new(pane(1.5, isotropic(Distribution::Ggx, alpha)));
        for mu in FURNACE_COSINES {
            worst.note(albedo(&probe.seen_from(direction(mu, 0.0)), Lobes::ALL, SAMPLES), || format!("{alpha} {mu}"));
        }
    }
    worst.check();
}

/// With what the sharp part sends on.
fn whole_albedo(bsdf: &Bsdf) -> Vec3 {
    let sharp = bsdf.sharp().map_or(Vec3::ZERO, |boundary| {
        let through = boundary.refracted.map_or(Vec3::ZERO, |through| through.factor * through.eta * through.eta);
        boundary.reflectance * boundary.reflected_factor + (Vec3::ONE - boundary.reflectance) * through
    });
    sharp + albedo(bsdf, Lobes::ALL, 2 * SAMPLES)
}

#[test]
fn standard_surfaces_make_no_light_and_white_ones_lose_little() {
    for alpha in [0.0, 1e-4, 0.02, 0.1, 0.3, 0.6, 1.0] {
        for (name, standard) in standards(isotropic(Distribution::Ggx, alpha)) {
            let probe = Probe::new(Surface::Standard(standard));
            for mu in FURNACE_COSINES {
                let albedo = whole_albedo(&probe.seen_from(direction(mu, 0.4)));
                assert!(albedo.max_element() < 1.0 + KEPT, "{name} {alpha} {mu}: {albedo}");
                // A coat over metal weakens what is reflected to the side by the more grazing direction.
                let least = match name {
                    "plastic" | "metal" | "coated plastic" | "thin" => 1.0 - KEPT,
                    "coated metal" => 0.85,
                    _ => 0.0,
                };
                assert!(albedo.min_element() > least, "{name} {alpha} {mu}: {albedo}");
            }
        }
    }
}

#[test]
fn diffuse_is_what_a_constant_irradiance_becomes() {
    for alpha in [0.0, 0.1, 0.5] {
        for (name, standard) in standards(isotropic(Distribution::Ggx, alpha)) {
            let probe = Probe::new(Surface::Standard(standard));
            for mu in COSINES {
                let bsdf = probe.seen_from(direction(mu, 0.4));
                let drawn = albedo(&bsdf, Lobes::DIFFUSE, SAMPLES);
                assert!((drawn - bsdf.diffuse()).abs().max_element() < 2e-3, "{name} {alpha} {mu}: {drawn}");
            }
        }
    }
}

#[test]
fn single_scattering_loses_light_and_makes_none() {
    for distribution in DISTRIBUTIONS {
        for alpha in ALPHAS {
            let finish = single(isotropic(distribution, alpha));
            for surface in [white_metal(finish), glass(1.5, finish), pane(1.5, finish)] {
                let probe = Probe::new(surface);
                for mu in [1.0, 0.5, 0.05, -0.7] {
                    let kept = albedo(&probe.seen_from(direction(mu, 0.0)), Lobes::ALL, SAMPLES / 4).max_element();
                    assert!(kept < 1.0 + 1e-4, "{surface:?} {mu}: {kept}");
                }
            }
        }
        // It is a loss that can be seen.
        let rough = Probe::new(white_metal(single(isotropic(distribution, 1.0))));
        assert!(albedo(&rough.seen_from(direction(0.5, 0.0)), Lobes::ALL, SAMPLES).x < 0.8);
    }
}

/// f(wo, wi) without the cosine.
fn value(probe: &Probe, wo: Vec3, wi: Vec3) -> Vec3 {
    probe.seen_from(wo).evaluate(wi, Lobes::ALL).value / wi.y.abs()
}

#[test]
fn light_goes_both_ways_alike() {
    for alpha in [0.05, 0.3, 1.0] {
        for distribution in DISTRIBUTIONS {
            let finish = isotropic(distribution, alpha);
            let stretched = Finish::along_axes(distribution, alpha, 0.5 * alpha);
            let mut surfaces =
                vec![gold(finish), gold(stretched), glass(1.5, single(finish)), pane(1.5, single(finish))];
            surfaces.extend(standards(single(finish)).into_iter().map(|(_, standard)| Surface::Standard(standard)));
            surfaces.extend(
                standards(finish)
                    .into_iter()
                    .filter(|(name, _)| !["thin", "all"].contains(name))
                    .map(|(_, standard)| Surface::Standard(standard)),
            );
            for surface in surfaces {
                let probe = Probe::new(surface);
                for index in 0..200 {
                    let (wo, wi) = (random_direction(2 * index), random_direction(2 * index + 1));
                    let mut back = value(&probe, wi, wo);
                    if wo.y * wi.y < 0.0 && matches!(surface, Surface::Dielectric { .. }) {
                        // Radiance over the squared index is what is reciprocal (Veach 1997, 5.2).
                        back *= if wo.y > 0.0 { 1.0 / 2.25 } else { 2.25 };
                    }
                    let there = value(&probe, wo, wi);
                    let error = (there - back).abs().max_element();
                    assert!(error <= 1e-3 * there.max_element() + 1e-6, "{surface:?} {wo} {wi}: {there} {back}");
                }
            }
        }
    }
}
