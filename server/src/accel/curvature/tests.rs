//! Differences of the normals that rays meet, and the ellipsoid in closed form.

use super::*;
use crate::scene::Mesh;
use crate::testing::{SceneBuilder, glass};
use glam::{DAffine3, DQuat};

/// Half axes of the ellipsoid, in metres.
const AXES: DVec3 = DVec3::new(0.6, 0.4, 0.25);

/// An ellipsoid of triangles with exact normals at its vertices, moved.
fn ellipsoid(levels: u32, world_from_ellipsoid: &DAffine3) -> Scene {
    let mut scene = SceneBuilder::new().ball(Vec3::ZERO, 1.0, levels, true, glass(1.5)).build();
    let mut mesh = Mesh::default();
    let world_from_ball = *world_from_ellipsoid * DAffine3::from_scale(AXES);
    mesh.append(&scene.mesh, &world_from_ball, "test", |material| material).unwrap();
    scene.mesh = mesh;
    scene
}

fn instances() -> [DAffine3; 3] {
    let turn = DQuat::from_euler(glam::EulerRot::YXZ, 0.7, -0.4, 1.1);
    [
        DAffine3::IDENTITY,
        DAffine3::from_rotation_translation(turn, DVec3::new(0.5, -1.0, 2.0)),
        DAffine3::from_scale_rotation_translation(DVec3::new(-1.0, 1.0, 1.0), turn, DVec3::new(-0.3, 0.2, 0.1)),
    ]
}

/// The derivative of the ellipsoid's unit normal along the surface at a point of it, in its own space: of `g / |g|` with
/// `g = (x / a^2, y / b^2, z / c^2)`.
fn gradient_of_ellipsoid(at: DVec3) -> DMat3 {
    let gradient = at / (AXES * AXES);
    let across = across(gradient.normalize());
    across * DMat3::from_diagonal(1.0 / (AXES * AXES)) * across * (1.0 / gradient.length())
}

/// Norm of the entries.
fn norm(matrix: DMat3) -> f64 {
    matrix.to_cols_array().iter().map(|entry| entry * entry).sum::<f64>().sqrt()
}

#[test]
fn a_spheres_normal_turns_by_one_over_its_radius() {
    for radius in [1e-3, 0.5, 300.0] {
        let scene = SceneBuilder::new().sphere(Vec3::new(1.0, 2.0, 3.0), radius, glass(1.5)).build();
        let outward = Vec3::new(0.48, -0.6, 0.64);
        let gradient = SurfacePoint::on_sphere(&scene, 0, outward).normal_gradient(&scene);
        let step = outward.any_orthonormal_vector();
        assert!((gradient * step - step / radius).length() < 1e-5 / radius);
        assert!((gradient * outward).length() < 1e-5 / radius);
        // Against the normals themselves; f32 normals over steps of a hundredth.
        let beside = |by: f32| SurfacePoint::on_sphere(&scene, 0, (outward + by * step).normalize()).shading_normal;
        let difference = (beside(0.01) - beside(-0.01)) / (0.02 * radius);
        assert!((gradient * step - difference).length() < 2e-4 / radius, "{radius}");
    }
}

#[test]
fn over_a_triangle_the_gradient_is_the_difference_of_its_normals() {
    for (instance, world_from_ellipsoid) in instances().iter().enumerate() {
        let scene = ellipsoid(3, world_from_ellipsoid);
        for primitive in 0..scene.mesh.triangles.len() as u32 {
            let at = |v: f32, w: f32| SurfacePoint::on_triangle(&scene, primitive, [v, w]);
            let point = at(0.3, 0.4);
            assert!(point.shading_normal.dot(point.geometric_normal) > 0.9);
            let gradient = point.normal_gradient(&scene);
            let scale = norm(gradient.as_dmat3()) as f32;
            for (v, w) in [(0.05, 0.0), (0.0, 0.05), (0.05, -0.05)] {
                let (before, after) = (at(0.3 - v, 0.4 - w), at(0.3 + v, 0.4 + w));
                let step = after.position - before.position;
                // The quadric's step is the part along the tangent plane.
                let along = step - point.shading_normal * point.shading_normal.dot(step);
                let turned = after.shading_normal - before.shading_normal;
                // Second order: the square of a hundredth of a radian between the two; f32 normals: 1e-7 of 1e-2.
                let error = (gradient * along - turned).length();
                assert!(error < 2e-3 * scale * step.length(), "instance {instance}, triangle {primitive}: {error}");
            }
        }
    }
}

#[test]
fn finer_meshes_bend_ever_more_like_their_ellipsoid() {
    for world_from_ellipsoid in instances() {
        let to_world = world_from_ellipsoid.matrix3;
        let error = |levels: u32| {
            let scene = ellipsoid(levels, &world_from_ellipsoid);
            let of_triangle = |primitive: usize| {
                let point = SurfacePoint::on_triangle(&scene, primitive as u32, [0.3, 0.4]);
                let own = world_from_ellipsoid.inverse().transform_point3(point.position.as_dvec3());
                let expected = to_world * gradient_of_ellipsoid(own) * to_world.transpose();
                norm(point.normal_gradient(&scene).as_dmat3() - expected) / norm(expected)
            };
            let mut errors: Vec<f64> = (0..scene.mesh.triangles.len()).map(of_triangle).collect();
            errors.sort_by(f64::total_cmp);
            errors[errors.len() / 2]
        };
        // The derivative of a linear interpolation is off by the side of a triangle: half at every level.
        let (coarse, fine) = (error(3), error(4));
        assert!(fine < 0.06 && fine < 0.6 * coarse, "{coarse} {fine}");
    }
}

#[test]
fn flat_and_degenerate_triangles_do_not_bend() {
    let mut scene = SceneBuilder::new().floor(0.0, 1.0, glass(1.5)).ball(Vec3::Y, 0.5, 1, false, glass(1.5)).build();
    let gradient = |scene: &Scene| SurfacePoint::on_triangle(scene, 0, [0.3, 0.3]).normal_gradient(scene);
    assert_eq!(gradient(&scene), Mat3::ZERO);
    assert_eq!(SurfacePoint::on_triangle(&scene, 5, [0.3, 0.3]).normal_gradient(&scene), Mat3::ZERO);
    scene.mesh.normals[0] = Vec3::X;
    scene.mesh.normals[1] = Vec3::Z;
    assert!(gradient(&scene) != Mat3::ZERO);
    // Two corners in one place: no area, no direction.
    let [a, b, _] = scene.mesh.triangles[0];
    scene.mesh.positions[b as usize] = scene.mesh.positions[a as usize];
    assert_eq!(gradient(&scene), Mat3::ZERO);
}
