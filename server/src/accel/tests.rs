//! The hierarchy against the plain intersector, leaks, and rays that leave a surface.

use super::brute::BruteForce;
use super::{Accel, Ray, SurfacePoint};
use crate::integrator::sampler::Sampler;
use crate::scene::Scene;
use crate::testing::{SceneBuilder, diffuse};
use glam::Vec3;
use rayon::prelude::*;

fn unit(sampler: &mut Sampler) -> Vec3 {
    loop {
        let v = Vec3::from([0; 3].map(|_| 2.0 * sampler.value() - 1.0));
        if v.length_squared() <= 1.0 && v.length_squared() > 1e-4 {
            return v.normalize();
        }
    }
}

/// Spheres, triangles of all shapes, an axis-parallel floor and cubes that touch.
fn jumble(scale: f32, shift: Vec3) -> Scene {
    let mut sampler = Sampler::new(11, 0, 0);
    let mut point = |reach: f32| shift + scale * reach * unit(&mut sampler);
    let mut builder = SceneBuilder::new().floor(shift.y - scale, 3.0 * scale, diffuse(0.5));
    for index in 0..200 {
        let [a, b] = [point(2.0), point(2.0)];
        let sliver = if index % 3 == 0 { 1e-4 } else { 0.3 };
        let c = a.lerp(b, 0.4) + sliver * (point(1.0) - shift);
        builder = builder.quad([a, b, c, a.lerp(c, 0.5)], diffuse(0.5));
        if index % 4 == 0 {
            builder = builder.sphere(point(1.5), scale * 0.1, diffuse(0.5)).cube(point(1.0), scale * 0.2, diffuse(0.5));
        }
    }
    builder.build()
}

fn rays(count: u32, scale: f32, shift: Vec3) -> impl Iterator<Item = Ray> {
    (0..count).map(move |index| {
        let mut sampler = Sampler::new(12, u64::from(index), 0);
        let mut origin = shift + scale * 3.0 * unit(&mut sampler) * sampler.value();
        let mut direction = unit(&mut sampler);
        match index % 8 {
            // Parallel to one axis or to a plane of two, from the floor's own plane, far outside.
            0 => direction = [Vec3::X, -Vec3::Y, Vec3::Z, -Vec3::X][(index / 8 % 4) as usize],
            1 => direction = Vec3::new(direction.x, 0.0, direction.z).normalize(),
            2 => origin.y = shift.y - scale,
            3 => origin = shift + (origin - shift) * 3.0,
            _ => {}
        }
        Ray { origin, direction }
    })
}

/// numerics: ray/box and ray/triangle; axis-parallel rays, origin on a plane, slivers, 1e-6 and 1e6 scale,
/// 10 km from the origin: the same hits as brute force.
#[test]
fn the_hierarchy_finds_what_brute_force_finds() {
    let places = [
        (1.0, Vec3::ZERO),
        (1e-6, Vec3::ZERO),
        (1e6, Vec3::ZERO),
        (1.0, Vec3::new(1e4, -5e3, 1e4)),
        (1e-3, Vec3::ZERO),
    ];
    for (scale, shift) in places {
        let scene = jumble(scale, shift);
        let (accel, brute) = (Accel::new(&scene), BruteForce::new(&scene));
        let mut hits = 0;
        for ray in rays(4000, scale, shift) {
            let (found, expected) = (accel.closest(&ray), brute.closest(&ray));
            // Of two primitives at the very same distance either may come first.
            assert_eq!(found.map(|hit| hit.distance), expected.map(|hit| hit.distance), "{ray:?} at scale {scale}");
            hits += u32::from(expected.is_some());
            for limit in expected.map(|hit| [hit.distance * 0.999, hit.distance * 1.001]).into_iter().flatten() {
                assert_eq!(accel.occluded(&ray, limit), brute.occluded(&ray, limit), "{ray:?} up to {limit}");
            }
        }
        assert!(hits > 1000, "{hits} hits");
    }
}

#[test]
fn an_empty_scene_is_never_hit() {
    let accel = Accel::new(&SceneBuilder::new().build());
    let ray = Ray { origin: Vec3::ZERO, direction: Vec3::X };
    assert!(accel.closest(&ray).is_none() && !accel.occluded(&ray, f32::INFINITY));
}

/// numerics: watertight on a closed mesh: 1e7 rays, no leak; half of them aimed at vertices and edges.
#[test]
fn no_ray_leaves_a_closed_mesh() {
    let bodies = [
        SceneBuilder::new().ball(Vec3::new(0.3, -0.2, 0.1), 1.0, 3, false, diffuse(0.5)).build(),
        SceneBuilder::new().cube(Vec3::new(0.3, -0.2, 0.1), 1.5, diffuse(0.5)).build(),
    ];
    for scene in &bodies {
        let accel = Accel::new(scene);
        let leaks: u32 = (0..500_u64)
            .into_par_iter()
            .map(|chunk| {
                let mut sampler = Sampler::new(13, chunk, 0);
                (0..10_000)
                    .filter(|index| {
                        let origin = Vec3::new(0.3, -0.2, 0.1) + 0.4 * sampler.value() * unit(&mut sampler);
                        let corners =
                            scene.mesh.triangles[(sampler.value() * scene.mesh.triangles.len() as f32) as usize];
                        let [a, b] = [corners[0], corners[1]].map(|corner| scene.mesh.positions[corner as usize]);
                        let target = match index % 4 {
                            0 => a,
                            1 => a.lerp(b, sampler.value()),
                            _ => origin + unit(&mut sampler),
                        };
                        accel.closest(&Ray { origin, direction: (target - origin).normalize() }).is_none()
                    })
                    .count() as u32
            })
            .sum();
        assert_eq!(leaks, 0);
    }
}

/// numerics: leaving a surface; no acne and no leak at every scale and grazing angle.
#[test]
fn a_ray_that_leaves_a_surface_does_not_meet_it_again() {
    for (scale, shift) in
        [(1.0, Vec3::ZERO), (1e-3, Vec3::ZERO), (1e4, Vec3::ZERO), (1.0, Vec3::new(500.0, 20.0, -300.0))]
    {
        let scene = SceneBuilder::new()
            .sphere(shift, scale, diffuse(0.5))
            .ball(shift + 4.0 * scale * Vec3::X, scale, 3, false, diffuse(0.5))
            .quad(
                [Vec3::ZERO, Vec3::new(3.0, 1.0, 0.2), Vec3::new(4.0, 5.0, 1.2), Vec3::new(1.0, 4.0, 1.0)]
                    .map(|p| shift + scale * (p - 8.0 * Vec3::Z)),
                diffuse(0.5),
            )
            .build();
        let accel = Accel::new(&scene);
        let mut left = 0;
        for index in 0..60_000_u32 {
            let mut sampler = Sampler::new(14, u64::from(index), 0);
            let target = shift + scale * [Vec3::ZERO, 4.0 * Vec3::X, Vec3::new(2.0, 2.0, -8.0)][(index % 3) as usize];
            let origin = target + 3.0 * scale * unit(&mut sampler);
            let ray = Ray { origin, direction: (target + 0.9 * scale * unit(&mut sampler) - origin).normalize() };
            let Some(hit) = accel.closest(&ray) else { continue };
            let point = SurfacePoint::at(&scene, &ray, &hit);
            // From grazing to steep, to the outside of these convex bodies.
            let elevation = 10.0_f32.powf(-5.0 * sampler.value());
            let across = point.geometric_normal.cross(unit(&mut sampler)).normalize();
            let direction = (across + elevation * point.geometric_normal).normalize();
            let again = accel.closest(&point.leave(direction));
            let same_body = again.is_some_and(|again| {
                (again.primitive >= scene.mesh.triangles.len() as u32)
                    == (point.primitive >= scene.mesh.triangles.len() as u32)
            });
            assert!(
                !same_body || again.is_some_and(|again| again.distance > scale),
                "{point:?} {direction} {again:?} at scale {scale}"
            );
            // Inwards something else is met than the place it starts from.
            if index % 3 != 2 {
                let inwards = (across - elevation * point.geometric_normal).normalize();
                let far = accel.closest(&point.leave(inwards)).expect("a closed body");
                let is_sphere = point.primitive >= scene.mesh.triangles.len() as u32;
                let apart = if is_sphere { far.distance > elevation * scale } else { far.primitive != point.primitive };
                assert!(apart, "{point:?} {inwards} {far:?} at scale {scale}");
            }
            left += 1;
        }
        assert!(left > 20_000, "{left}");
    }
}
