use super::*;
use crate::integrator::media::tests::{homogeneous, null, tracer};
use crate::scene::Material;
use crate::testing::{SceneBuilder, diffuse, material};

#[test]
fn an_eye_knows_what_it_is_inside_of() {
    let inner = |index| Material {
        interior: Some(index),
        ..material("glass", crate::testing::solid(1.5, Vec3::ONE, Vec3::ZERO), Vec3::ZERO)
    };
    let builder = SceneBuilder::new()
        .cube(Vec3::ZERO, 4.0, null(0))
        .ball(Vec3::new(0.5, 0.0, 0.0), 1.0, 3, true, inner(1))
        .sphere(Vec3::new(0.5, 0.2, 0.0), 0.3, null(2))
        .sphere(Vec3::new(10.0, 0.0, 0.0), 1.0, diffuse(0.5));
    let fog = homogeneous(Vec3::ONE, Vec3::ONE, 0.0);
    let tracer = tracer(builder, vec![fog.clone(), fog.clone(), fog]);
    let inside = |x: f32, y: f32| tracer.enclosure_at(Vec3::new(x, y, 0.0));
    assert_eq!(inside(9.0, 0.0), Enclosure::AIR);
    assert_eq!(inside(3.0, 0.1), Enclosure::AIR);
    assert_eq!(inside(-1.5, 0.1), Enclosure::medium(0));
    assert_eq!(inside(0.0, -0.5), Enclosure::medium(0).and_medium(1));
    assert_eq!(inside(0.5, 0.1), Enclosure::medium(0).and_medium(1).and_medium(2));
    // Exactly on an axis of the meshes, where rays run along edges.
    assert_eq!(inside(-1.0, 0.0), Enclosure::medium(0));
    for index in 0..500_u16 {
        let angle = f32::from(index);
        let point = 1.99 * Vec3::new(angle.sin(), (1.7 * angle).cos(), (2.3 * angle).sin());
        if point.distance(Vec3::new(0.5, 0.0, 0.0)) < 1.0 {
            continue;
        }
        assert_eq!(tracer.enclosure_at(point).innermost(), Some(0), "{point}");
    }
}

#[test]
fn the_media_along_a_ray_are_found_with_their_ends() {
    let builder = SceneBuilder::new().cube(Vec3::ZERO, 2.0, null(0)).sphere(Vec3::ZERO, 0.5, null(1)).sphere(
        Vec3::new(3.0, 0.0, 0.0),
        0.5,
        diffuse(0.5),
    );
    let fog = homogeneous(Vec3::ONE, Vec3::ONE, 0.0);
    let tracer = tracer(builder, vec![fog.clone(), fog]);
    let along = |origin: Vec3, max_distance| {
        let mut intervals = Vec::new();
        let ray = Ray { origin, direction: Vec3::X };
        let passed = tracer.media_along(&ray, tracer.enclosure_at(origin), max_distance, &mut intervals);
        (intervals, passed)
    };
    let close = |found: &[MediumInterval], expected: &[(f32, f32, u32)]| {
        assert_eq!(found.len(), expected.len(), "{found:?}");
        for (found, &(start, end, medium)) in found.iter().zip(expected) {
            assert!(
                (found.start - start).abs() < 1e-5 && (found.end - end).abs() < 1e-5 && found.medium == medium,
                "{found:?}"
            );
        }
    };
    let (intervals, passed) = along(Vec3::new(-3.0, 0.01, 0.02), f32::INFINITY);
    close(
        &intervals,
        &[(2.0, 2.5, 0), (2.5, 3.5, 1), (3.5, 4.0, 0)].map(|(a, b, medium)| {
            let chord = (0.25_f32 - 0.01 * 0.01 - 0.02 * 0.02).sqrt();
            let exact = |t: f32| {
                if t == 2.5 {
                    3.0 - chord
                } else if t == 3.5 {
                    3.0 + chord
                } else {
                    t
                }
            };
            (exact(a), exact(b), medium)
        }),
    );
    assert!((passed.distance - 5.5).abs() < 1e-3 && passed.medium == Enclosure::AIR && passed.surface.is_some());
    let (intervals, passed) = along(Vec3::new(-0.9, 0.0, 0.9), 1.0);
    close(&intervals, &[(0.0, 1.0, 0)]);
    assert!(passed.distance == 1.0 && passed.medium == Enclosure::medium(0) && passed.surface.is_none());
    assert_eq!(along(Vec3::new(0.0, 9.0, 0.0), f32::INFINITY).0, []);
}
