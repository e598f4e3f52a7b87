//! What holds of every layering.

use super::*;
use crate::stability::bound;
use glam::Vec3;

const RANGE: VolumeRange = VolumeRange { near_m: 1.0, far_m: 4.0 };

fn every_cut(ray: &Profile, mut check: impl FnMut(&str, usize, &Segments)) {
    let mut cutter = Cutter::default();
    for count in 1..=8 {
        for layering in Layering::ALL {
            let mut segments = [Segments::new()];
            cutter.cut(layering, count, RANGE, std::slice::from_ref(ray), &mut segments);
            check(layering.name(), count, &segments[0]);
        }
        let mut segments = Segments::new();
        optimal::cut_plainly(ray, count, &mut segments);
        check("plain", count, &segments);
    }
}

fn ray(slices: usize, matter: impl Fn(f32) -> (f32, Vec3)) -> Profile {
    let mut ray = Profile::default();
    ray.start(1.2);
    let step = 2.5 / slices as f32;
    for slice in 0..slices {
        let middle = (slice as f32 + 0.5) / slices as f32;
        let (extinction, source) = matter(middle);
        ray.push(1.2 + step * (slice + 1) as f32, extinction * step, source);
    }
    ray
}

fn rays() -> Vec<(&'static str, Profile)> {
    let grey = Vec3::splat(0.5);
    let shells = |z: f32| if (z * 5.0).fract() < 0.3 { (8.0, Vec3::new(z, 1.0 - z, 0.2)) } else { (0.0, Vec3::ZERO) };
    vec![
        ("homogeneous", ray(200, |_| (1.0, grey))),
        ("shells", ray(300, shells)),
        ("rising", ray(150, |z| (20.0 * z * z, Vec3::splat(z)))),
        ("almost clear", ray(200, |z| (1e-6 * (1.0 + z), grey))),
        ("opaque at once", ray(200, |_| (1e4, grey))),
        ("saturates in the first segment", ray(200, |z| (if z < 0.1 { 200.0 } else { 0.5 }, grey))),
        ("empty", ray(100, |_| (0.0, grey))),
        ("one voxel", ray(100, |z| (if (z - 0.5).abs() < 0.006 { 3.0 } else { 0.0 }, grey))),
        ("one slice", ray(1, |_| (0.7, grey))),
        ("fewer slices than segments", ray(3, |z| (z, grey))),
        ("fog with a wall", ray(250, |z| (if z > 0.8 { 500.0 } else { 0.2 }, Vec3::new(0.1, z, 0.9)))),
        ("nothing", Profile::default()),
    ]
}

#[test]
fn stability_layering() {
    let mut disordered = bound!("layering", "borders out of order, or not numbers", 0.0);
    let mut light = bound!("layering", "radiance of all segments off the ray's, relative", 1e-5);
    let mut left_over = bound!("layering", "their transmittance off the ray's", 1e-5);
    for (name, ray) in rays() {
        let (radiance, transmittance) = ray.compose();
        every_cut(&ray, |layering, count, segments| {
            let at = format!("{name} {layering} {count}: {segments:?}");
            assert!(segments.len() <= count, "{at}");
            let (mut last_back, mut gathered, mut left) = (0.0, glam::DVec3::ZERO, 1.0_f64);
            for segment in segments.iter().filter(|segment| segment.optical_depth > 0.0) {
                // Borders inside a slice are found twice, and rounded each time.
                let in_order = segment.front_m >= last_back && segment.back_m > segment.front_m;
                disordered.count(!in_order || !segment.source.is_finite() || !segment.optical_depth.is_finite(), &at);
                gathered += left * f64::from(segment.opacity()) * segment.source.as_dvec3();
                left *= (-f64::from(segment.optical_depth)).exp();
                last_back = segment.back_m;
            }
            // As far as the thinnest ray is: relative to what it shows.
            let error = (gathered - radiance.as_dvec3()).abs().max_element();
            let shown = f64::from(radiance.max_element());
            light.see(if shown > 0.0 { error / shown } else { error }, &at);
            left_over.see((left - f64::from(transmittance)).abs(), &at);
        });
    }
}

#[test]
fn nested_shells_are_cut_at_their_faces() {
    let (_, shells) = &rays()[1];
    let mut segments = [Segments::new()];
    Cutter::default().cut(Layering::Optimal, 5, RANGE, std::slice::from_ref(shells), &mut segments);
    for (index, segment) in segments[0].iter().enumerate() {
        let face = 1.2 + 2.5 * index as f32 / 5.0;
        assert!((segment.front_m - face).abs() < 0.01, "{index} {segment:?}");
        assert!((segment.back_m - face - 0.3 * 0.5).abs() < 0.02, "{index} {segment:?}");
    }
}

#[test]
fn quantiles_stand_at_equal_steps_of_opacity() {
    let (_, ray) = &rays()[0];
    let mut segments = [Segments::new()];
    Cutter::default().cut(Layering::Quantiles, 4, RANGE, std::slice::from_ref(ray), &mut segments);
    let total = 1.0 - (-2.5_f32).exp();
    let opacities: Vec<f32> = segments[0].iter().map(|segment| 1.0 - (-(segment.front_m - 1.2)).exp()).collect();
    for (found, expected) in opacities.iter().zip([0.0, 1.0 / 6.0, 3.0 / 6.0, 5.0 / 6.0]) {
        assert!((found / total - expected).abs() < 1e-4, "{opacities:?}");
    }
}
