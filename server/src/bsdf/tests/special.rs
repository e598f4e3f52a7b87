//! Hard inputs, sharp and nearly sharp surfaces, sides.

use super::*;
use crate::bsdf::roughness::SHARP_ALPHA;
use crate::bsdf::{Boundary, interface_of};
use warplight_protocol::optics::Interface;

fn all_surfaces(finish: Finish) -> Vec<Surface> {
    let black = Color::Constant(Vec3::ZERO);
    let mut surfaces = vec![
        gold(finish),
        white_metal(finish),
        Surface::Conductor { eta: Vec3::ONE, k: Vec3::ZERO, filter: Color::Constant(Vec3::ONE), finish },
        Surface::Conductor { eta: Vec3::ONE, k: Vec3::ONE, filter: black, finish },
        Surface::Null,
        Surface::Mirror { filter: Vec3::ONE },
        Surface::Diffuse { albedo: black },
        Surface::Diffuse { albedo: Color::Constant(Vec3::ONE) },
    ];
    for ior in [1.0, 1.0_f32.next_up(), 1.001, 1.5, 2.4, 0.7, 40.0] {
        surfaces.extend([glass(ior, finish), pane(ior, finish)]);
        surfaces.push(Surface::Standard(Standard { ior, ..standard(finish) }));
    }
    for (_, standard) in standards(finish) {
        let specular_color = Color::Constant(Vec3::splat(1e3));
        surfaces.extend([
            Surface::Standard(standard),
            Surface::Standard(Standard { base: black, ..standard }),
            Surface::Standard(Standard { ior: 1.0, coat: coat(1.0, 0.0), ..standard }),
            Surface::Standard(Standard { specular: Scalar::Constant(0.0), ..standard }),
            Surface::Standard(Standard { specular_color, ..standard }),
        ]);
    }
    surfaces
}

#[test]
fn nothing_is_ever_infinite() {
    let critical = (1.0 - 1.0 / 2.25_f32).sqrt();
    let cosines = [1.0, 1.0_f32.next_down(), 0.5, critical.next_down(), critical, critical.next_up(), 1e-3, 1e-7, 0.0];
    for distribution in DISTRIBUTIONS {
        for alpha in [0.0, 1e-5, 1e-4, 0.02, 1.0, 3.0] {
            let finishes = [isotropic(distribution, alpha), Finish::along_axes(distribution, alpha.min(1.0), 1.0)];
            // Every index would need tables of its own; one distribution is enough for those.
            let compensated = distribution == Distribution::Ggx;
            let finishes = finishes.map(|finish| Finish { compensated, ..finish });
            for surface in finishes.into_iter().flat_map(all_surfaces) {
                let probe = Probe::new(surface);
                for mu in cosines.into_iter().flat_map(|mu| [mu, -mu]) {
                    let eye = direction(mu, 0.3);
                    let bsdf = probe.seen_from(eye);
                    let context = || format!("{surface:?} {mu}");
                    assert!(bsdf.albedo(Lobes::ALL).is_finite() && bsdf.diffuse().is_finite(), "{}", context());
                    if let Some(boundary) = bsdf.sharp().or(bsdf.nearly_sharp()) {
                        check_boundary(boundary, &context());
                    }
                    let grazing = [direction(1e-7, 0.3 + std::f32::consts::PI), Vec3::X, -eye, eye, Vec3::Y, -Vec3::Y];
                    for towards in grazing.into_iter().chain((0..4).map(random_direction)) {
                        let (value, pdf) =
                            (bsdf.evaluate(towards, Lobes::ALL).value, bsdf.evaluate(towards, Lobes::ALL).pdf);
                        assert!(value.is_finite() && value.min_element() >= 0.0, "{}: {value}", context());
                        assert!(pdf.is_finite() && pdf >= 0.0, "{}: {pdf}", context());
                    }
                    for u in
                        [Vec2::ZERO, Vec2::splat(1.0_f32.next_down()), Vec2::new(0.0, 0.99999994), Vec2::splat(0.3)]
                    {
                        for choice in [0.0, 0.5, 1.0_f32.next_down()] {
                            let Some(sample) = bsdf.sample(choice, u, Lobes::ALL) else { continue };
                            assert!(sample.weight.is_finite() && sample.pdf > 0.0, "{}: {sample:?}", context());
                            assert!((sample.direction.length() - 1.0).abs() < 1e-5, "{}", context());
                        }
                    }
                }
            }
        }
    }
}

fn check_boundary(boundary: &Boundary, context: &str) {
    assert!(boundary.interface.is_valid(), "{context}: {boundary:?}");
    let reflected = boundary.reflectance * boundary.reflected_factor;
    assert!(reflected.is_finite() && reflected.max_element() < 1.0001, "{context}: {boundary:?}");
    assert!((boundary.reflected.length() - 1.0).abs() < 1e-5, "{context}: {boundary:?}");
    if let Some(refracted) = boundary.refracted {
        assert!(refracted.factor.is_finite() && refracted.direction.is_finite(), "{context}: {boundary:?}");
    }
}

#[test]
fn an_index_of_one_lets_light_straight_through() {
    for alpha in [0.0, 0.02, 0.5] {
        let probe = Probe::new(glass(1.0, isotropic(Distribution::Ggx, alpha)));
        for mu in [1.0, 0.3, 1e-3, -0.4] {
            let eye = direction(mu, 0.3);
            let bsdf = probe.seen_from(eye);
            let boundary = bsdf.sharp().unwrap();
            let through = boundary.refracted.unwrap();
            assert!(through.direction.abs_diff_eq(-eye, 1e-6) && through.factor.abs_diff_eq(Vec3::ONE, 1e-6));
            assert!(boundary.reflectance.max_element() < 1e-6 && !bsdf.has(Lobes::ALL));
        }
    }
}

#[test]
fn a_smooth_layer_reflects_exactly_what_it_should_whatever_its_interface() {
    let schlick = |f0: f32, f90: f32, mu: f32| f0 + (f90 - f0) * (1.0 - mu).powi(5);
    let smooth = isotropic(Distribution::Ggx, 0.0);
    let metal = Scalar::Constant(1.0);
    for mu in [1.0, 0.6, 0.2, 0.01] {
        let reflected = |standard: Standard| {
            let probe = Probe::new(Surface::Standard(standard));
            let bsdf = probe.seen_from(direction(mu, 0.0));
            // Nothing is reflected along the normal at index 1.
            let Some(boundary) = bsdf.sharp().copied() else { return (0.0, 0.0) };
            assert_eq!(Some(boundary.interface), interface_of(&Surface::Standard(standard), true));
            let through = boundary.refracted.map_or(0.0, |through| through.factor.x);
            ((boundary.reflectance * boundary.reflected_factor).x, (1.0 - boundary.reflectance.x) * through)
        };
        let white = standard(smooth);
        let is = |(reflected, through): (f32, f32), expected: f32, beyond: f32| {
            assert!((reflected - expected).abs() < 1e-5, "{mu}: {reflected} {expected}");
            assert!((through - beyond).abs() < 1e-5, "{mu}: {through} {beyond}");
        };
        let plastic = schlick(0.04, 1.0, mu);
        is(reflected(white), plastic, 0.0);
        is(reflected(Standard { ior: 1.0, ..white }), schlick(0.0, 1.0, mu), 0.0);
        is(reflected(Standard { specular: Scalar::Constant(0.5), ..white }), 0.5 * plastic, 0.0);
        let base = Color::Constant(Vec3::splat(0.7));
        is(reflected(Standard { metallic: metal, base, ..white }), schlick(0.7, 1.0, mu), 0.0);
        is(reflected(Standard { transmission: metal, base, ..white }), plastic, 0.7 * (1.0 - plastic));
        let coated = Standard { coat: coat(0.5, 0.0), ..white };
        is(reflected(coated), 0.5 * plastic + (1.0 - 0.5 * plastic) * plastic, 0.0);
        let coated_rough = Standard { coat: coat(1.0, 0.0), ..standard(isotropic(Distribution::Ggx, 0.5)) };
        is(reflected(coated_rough), plastic, 0.0);
    }
}

#[test]
fn smooth_surfaces_keep_what_they_did() {
    let eye = direction(0.6, 0.2);
    let metal = *Probe::new(gold(Finish::SMOOTH)).seen_from(eye).sharp().unwrap();
    assert!(matches!(metal.interface, Interface::Conductor { .. }) && metal.refracted.is_none());
    let probe = Probe::new(glass(1.5, Finish::SMOOTH));
    let inside = *probe.seen_from(direction(-0.9, 0.2)).sharp().unwrap();
    assert_eq!(inside.interface, Interface::Dielectric { eta: 1.0 / 1.5 });
    assert!((inside.refracted.unwrap().factor.x - 2.25).abs() < 1e-5);
    assert!(probe.seen_from(direction(-0.3, 0.2)).sharp().unwrap().refracted.is_none(), "totally reflected");
    let pane = *Probe::new(pane(1.5, Finish::SMOOTH)).seen_from(eye).sharp().unwrap();
    assert_eq!(pane.refracted.unwrap().direction, -eye);
    assert_eq!(pane.refracted.unwrap().eta, 1.0);
    let none = *Probe::new(Surface::Null).seen_from(eye).sharp().unwrap();
    assert_eq!((none.refracted.unwrap().direction, none.refracted.unwrap().factor), (-eye, Vec3::ONE));
    assert!(none.reflectance.x < 1e-12);
}

#[test]
fn colours_of_a_dispersing_glass_are_bent_differently() {
    let Surface::Dielectric { ior, filter, absorption, finish, .. } = glass(1.5, Finish::SMOOTH) else { panic!() };
    let probe = Probe::new(Surface::Dielectric { ior, dispersion: 20.0 / 50.0, filter, absorption, finish });
    let bent = |channel| probe.through(direction(0.5, 0.0), channel).sharp().unwrap().refracted.unwrap().direction.x;
    assert_eq!(bent(None), bent(Some(Channel::Green)));
    // Towards -x; blue is bent most, so its direction is the steepest.
    assert!(bent(Some(Channel::Red)) < bent(None) && bent(None) < bent(Some(Channel::Blue)));
}

#[test]
fn a_narrow_lobe_stands_for_a_sharp_event_and_a_wide_one_does_not() {
    for (alpha, is_narrow) in [(0.02, true), (SHARP_ALPHA, true), (0.11, false), (0.5, false)] {
        let finish = isotropic(Distribution::Ggx, alpha);
        let eye = direction(0.7, 1.0);
        for surface in [gold(finish), glass(1.5, finish), pane(1.5, finish), Surface::Standard(standard(finish))] {
            let bsdf = Probe::new(surface).seen_from(eye);
            assert!(bsdf.sharp().is_none());
            assert_eq!(bsdf.nearly_sharp().is_some(), is_narrow, "{surface:?}");
            if let Some(boundary) = bsdf.nearly_sharp() {
                assert_eq!(Some(boundary.interface), interface_of(&surface, true));
                // What the lobe reflects is about what the boundary would.
                let lobe = albedo(&bsdf, Lobes::REFLECTED, 4096);
                let smooth = boundary.reflectance * boundary.reflected_factor;
                assert!(
                    (lobe - smooth).abs().max_element() < 0.03 * smooth.max_element() + 0.003,
                    "{surface:?} {lobe} {smooth}"
                );
            }
        }
    }
    // A narrow coat over a rough base: the node shows the coat alone.
    let coated = Standard { coat: coat(1.0, 0.05), ..standard(isotropic(Distribution::Ggx, 0.5)) };
    let bsdf = Probe::new(Surface::Standard(coated)).seen_from(direction(1.0, 0.0));
    assert!((albedo(&bsdf, Lobes::REFLECTED, 4096).x - 0.04).abs() < 2e-3);
    let smooth = bsdf.nearly_sharp().unwrap();
    assert!((smooth.reflectance * smooth.reflected_factor).abs_diff_eq(Vec3::splat(0.04), 1e-5));
}

#[test]
fn lobes_add_up() {
    let finish = isotropic(Distribution::Ggx, 0.3);
    let mut surfaces = vec![gold(finish), glass(1.5, finish), pane(1.5, finish)];
    surfaces.extend(standards(finish).into_iter().map(|(_, standard)| Surface::Standard(standard)));
    for surface in surfaces {
        let probe = Probe::new(surface);
        for index in 0..50 {
            let bsdf = probe.seen_from(random_direction(2 * index));
            let towards = random_direction(2 * index + 1);
            let sum: Vec3 = [Lobes::DIFFUSE, Lobes::BROAD, Lobes::REFLECTED, Lobes::REFRACTED]
                .map(|lobes| bsdf.evaluate(towards, lobes).value)
                .into_iter()
                .sum();
            let all = bsdf.evaluate(towards, Lobes::ALL).value;
            assert!((sum - all).abs().max_element() <= 1e-5 * all.max_element(), "{surface:?}: {sum} {all}");
        }
    }
}

#[test]
fn the_back_of_a_one_sided_surface_is_black() {
    let finish = isotropic(Distribution::Ggx, 0.3);
    for surface in
        [gold(finish), gold(Finish::SMOOTH), Surface::Standard(standard(finish)), Surface::Mirror { filter: Vec3::ONE }]
    {
        let probe = Probe::of(Material { one_sided: true, ..Material::new("one-sided", surface) });
        let back = probe.seen_from(direction(-0.5, 0.0));
        assert!(back.sharp().is_none() && back.nearly_sharp().is_none() && !back.has(Lobes::ALL));
        let front = probe.seen_from(direction(0.5, 0.0));
        assert!(front.sharp().is_some() || front.has(Lobes::ALL));
    }
    let glass = Material { one_sided: true, ..Material::new("glass", glass(1.5, Finish::SMOOTH)) };
    assert!(Probe::of(glass).seen_from(direction(-0.9, 0.0)).sharp().is_some(), "glass has no back");
}

#[test]
fn shading_normals_let_no_light_through() {
    let tilted = Vec3::new(0.6, 0.8, 0.0);
    let finish = isotropic(Distribution::Ggx, 0.5);
    let surfaces =
        [gold(finish), Surface::Standard(standard(finish)), Surface::Diffuse { albedo: Color::Constant(Vec3::ONE) }];
    for surface in surfaces {
        let mut probe = Probe::new(surface);
        probe.point.shading_normal = tilted;
        for index in 0..500 {
            let eye = random_direction(index);
            let bsdf = probe.seen_from(eye);
            let towards = random_direction(index + 1000);
            if towards.y * eye.y <= 0.0 {
                assert_eq!(bsdf.evaluate(towards, Lobes::ALL).value, Vec3::ZERO);
            }
            let mut sampler = Sampler::new(9, u64::from(index), 0);
            if let Some(sample) = bsdf.sample(sampler.value(), sampler.pair(), Lobes::ALL) {
                assert!(sample.direction.y * eye.y > 0.0);
            }
        }
    }
}

#[test]
fn the_rougher_direction_spreads_light_more() {
    // u runs along +x on the floor's first triangle.
    let probe = Probe::new(gold(Finish::along_axes(Distribution::Ggx, 0.4, 0.05)));
    let bsdf = probe.seen_from(Vec3::Y);
    let (across, along) = (direction(0.9, std::f32::consts::FRAC_PI_2), direction(0.9, 0.0));
    assert!(bsdf.evaluate(along, Lobes::REFLECTED).value.x > 10.0 * bsdf.evaluate(across, Lobes::REFLECTED).value.x);
}
