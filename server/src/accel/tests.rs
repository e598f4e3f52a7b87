//! The hierarchy against the plain intersector, leaks, and rays that leave a surface.

use super::brute::BruteForce;
use super::{Accel, Ray, SurfacePoint};
use crate::integrator::sampler::Sampler;
use crate::scene::Scene;
use crate::stability::bound;
use crate::testing::{SceneBuilder, diffuse};
use glam::{Vec3, Vec3Swizzles};
use rayon::prelude::*;
use std::sync::Arc;

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

/// Axis-parallel rays, origin on a plane, slivers, 1e-6 and 1e6 scale, 10 km from the origin: the same hits as brute force, to
/// the bit, with each kind of instructions.
#[test]
fn stability_ray_and_box() {
    let mut differing = bound!("ray and box", "hits that are not those of brute force, of 20,000 rays", 0.0);
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
            let expected = brute.closest(&ray);
            hits += u32::from(expected.is_some());
            for accel in accel.by_instructions() {
                let found = accel.closest(&ray);
                differing.count(found != expected, format!("{ray:?} at scale {scale} by {}", accel.instructions()));
                for limit in expected.map(|hit| [hit.distance * 0.999, hit.distance * 1.001]).into_iter().flatten() {
                    let differs = accel.occluded(&ray, limit) != brute.occluded(&ray, limit);
                    differing.count(differs, format!("{ray:?} up to {limit}"));
                }
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

#[test]
fn rays_that_are_no_rays_hit_nothing() {
    let accel = Accel::new(&jumble(1.0, Vec3::ZERO));
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for accel in accel.by_instructions() {
            for axis in 0..3 {
                let mut ray = Ray { origin: Vec3::ZERO, direction: Vec3::Z };
                ray.origin[axis] = bad;
                assert!(accel.closest(&ray).is_none() && !accel.occluded(&ray, f32::INFINITY));
                let mut ray = Ray { origin: Vec3::ZERO, direction: Vec3::Z };
                ray.direction[axis] = bad;
                assert!(accel.closest(&ray).is_none() && !accel.occluded(&ray, f32::INFINITY));
            }
            let nowhere = Ray { origin: Vec3::ZERO, direction: Vec3::ZERO };
            assert!(accel.closest(&nowhere).is_none() && !accel.occluded(&nowhere, f32::INFINITY));
        }
    }
}

/// Planes that hold the origin, the ray or both; coordinates 0, at which padding is least.
#[test]
fn axis_parallel_rays_in_the_planes_of_boxes_meet_what_is_there() {
    let scene = SceneBuilder::new().cube(Vec3::splat(0.5), 1.0, diffuse(0.5)).floor(0.0, 1.0, diffuse(0.5)).build();
    let (accel, brute) = (Accel::new(&scene), BruteForce::new(&scene));
    for (x, y, z) in (0..125).map(|i| (i % 5, i / 5 % 5, i / 25)) {
        let origin = 0.5 * Vec3::new(x as f32 - 1.0, y as f32 - 1.0, z as f32 - 1.0);
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            for direction in [axis, -axis, -0.0 * axis + axis.yzx(), (axis + axis.yzx()).normalize()] {
                let ray = Ray { origin, direction };
                for accel in accel.by_instructions() {
                    assert_eq!(accel.closest(&ray), brute.closest(&ray), "{ray:?}");
                    assert_eq!(accel.occluded(&ray, 1.0), brute.occluded(&ray, 1.0), "{ray:?}");
                }
            }
        }
    }
}

/// From so far away that rounding along the ray is more than the padding of boxes.
#[test]
fn far_away_rays_at_vertices_meet_what_brute_force_meets() {
    let scene = SceneBuilder::new().ball(Vec3::ZERO, 1.0, 2, false, diffuse(0.5)).build();
    let (accel, brute) = (Accel::new(&scene), BruteForce::new(&scene));
    let mut hits = 0;
    for index in 0..40_000 {
        let mut sampler = Sampler::new(16, index, 0);
        let origin = 10.0_f32.powf(1.0 + 4.0 * sampler.value()) * unit(&mut sampler);
        let corner = (sampler.value() * scene.mesh.positions.len() as f32) as usize;
        let ray = Ray { origin, direction: (scene.mesh.positions[corner] - origin).normalize() };
        let expected = brute.closest(&ray);
        hits += u32::from(expected.is_some());
        for accel in accel.by_instructions() {
            assert_eq!(accel.closest(&ray), expected, "{ray:?}");
        }
    }
    assert!(hits > 20_000, "{hits}");
}

#[test]
fn shapes_that_moved_are_found_where_they_are() {
    let scene = |x: f32| {
        SceneBuilder::new()
            .floor(0.0, 3.0, diffuse(0.5))
            .cube(Vec3::new(x, 1.0, 0.0), 0.5, diffuse(0.5))
            .sphere(Vec3::new(0.0, 1.0, x), 0.4, diffuse(0.5))
            .build()
    };
    // Two triangles of the floor, twelve of the cube, and the sphere.
    let moving: Vec<bool> = (0..15).map(|primitive| primitive >= 2).collect();
    let first = Accel::with_moving(&scene(0.0), &moving);
    for x in [0.0, 0.3, -0.7] {
        let moved = first.moved(&scene(x), &moving);
        assert!(Arc::ptr_eq(&first.still, &moved.still));
        let brute = BruteForce::new(&scene(x));
        for ray in rays(2000, 1.0, Vec3::Y) {
            assert_eq!(moved.closest(&ray), brute.closest(&ray), "{ray:?} at {x}");
            assert_eq!(moved.occluded(&ray, 1.5), brute.occluded(&ray, 1.5), "{ray:?} at {x}");
        }
    }
}

/// Watertight at every scale and far from the origin, where vertices are coarse.
#[test]
fn stability_ray_and_triangle_at_any_scale() {
    let mut leaking = bound!("ray and box", "leaks of closed meshes at four scales, of 1e5 rays each", 0.0);
    let places =
        [(1e-6, Vec3::ZERO), (1e6, Vec3::ZERO), (1.0, Vec3::new(1e4, -5e3, 1e4)), (0.01, Vec3::new(500.0, 0.0, 0.0))];
    for (scale, shift) in places {
        let scene = SceneBuilder::new().ball(shift, scale, 3, false, diffuse(0.5)).build();
        let accel = Accel::new(&scene);
        for accel in accel.by_instructions() {
            let leaks: usize = (0..10_u64)
                .into_par_iter()
                .map(|chunk| {
                    let mut sampler = Sampler::new(15, chunk, 0);
                    let mut leaks = 0;
                    for _ in 0..10_000 {
                        let origin = shift + 0.4 * scale * unit(&mut sampler);
                        let corner = (sampler.value() * scene.mesh.positions.len() as f32) as usize;
                        let target = if sampler.value() < 0.5 { scene.mesh.positions[corner] } else { shift };
                        let direction = (target - origin).normalize();
                        leaks += usize::from(accel.closest(&Ray { origin, direction }).is_none());
                    }
                    leaks
                })
                .sum();
            leaking.see(leaks as f64, format!("{scale} at {shift} by {}", accel.instructions()));
        }
    }
}

/// 1e7 rays, half of them aimed at vertices and edges.
#[test]
fn stability_ray_and_triangle() {
    let mut leaking = bound!("ray and box", "leaks of closed meshes, of 1e7 rays", 0.0);
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
        leaking.see(leaks.into(), "a body");
    }
}

/// No acne and no leak at every scale and grazing angle.
#[test]
fn stability_leaving_a_surface() {
    let mut acne = bound!("leaving", "rays that meet again what they leave, of 2.4e5", 0.0);
    let mut leaking = bound!("leaving", "rays inwards that meet the place they start from", 0.0);
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
            let is_met_again = same_body && again.is_some_and(|again| again.distance <= scale);
            acne.count(is_met_again, format!("{point:?} {direction} {again:?} at scale {scale}"));
            // Inwards something else is met than the place it starts from.
            if index % 3 != 2 {
                let inwards = (across - elevation * point.geometric_normal).normalize();
                let far = accel.closest(&point.leave(inwards)).expect("a closed body");
                let is_sphere = point.primitive >= scene.mesh.triangles.len() as u32;
                let apart = if is_sphere { far.distance > elevation * scale } else { far.primitive != point.primitive };
                leaking.count(!apart, format!("{point:?} {inwards} {far:?} at scale {scale}"));
            }
            left += 1;
        }
        assert!(left > 20_000, "{left}");
    }
}
