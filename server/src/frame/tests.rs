//! The tree against the plain path tracer, and what its planes mean.

use super::{FrameRenderer, FrameRequest};
use crate::counters::{Counters, RayCounts};
use crate::effects::{EffectKind, Effects, Simulated, plan_of, without};
use crate::scene::{Environment, Scene};
use crate::testing::{
    BlockMeans, SceneBuilder, colored, critical_z, diffuse, emitter, glass, material, metal, mirror, render, settings,
    solid, write_pictures,
};
use glam::{DVec3, Vec3};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use warplight_protocol::curvature::tangents;
use warplight_protocol::frame::{Interfaces, Plan, Tree, UNDEFINED, flatten};
use warplight_protocol::optics::{self, Interface, fresnel_dielectric};
use warplight_protocol::{Camera, ImageSize, Pose};

fn empty_tree() -> Tree {
    Tree::new(Pose::IDENTITY, Camera::symmetric(1.0, ImageSize::new(1, 1)), Plan::diffuse(), Interfaces::default())
}

fn tree_of(renderer: &FrameRenderer, camera: Camera, pose: Pose, plan: Plan, spp: u32, seed: u64) -> Tree {
    let mut tree = empty_tree();
    let request = FrameRequest { render_pose: pose, camera, plan, volume: None, spp, max_depth: 12, seed };
    let counters = Counters::default();
    renderer.render(&request, &mut tree, &counters, &|_| {});
    assert_eq!(counters.snapshot().dropped, 0);
    tree
}

/// A mirror, a glass ball, water with a filter, metal and diffuse things in a coloured room.
fn all_kinds() -> Scene {
    let tinted = solid(1.5, Vec3::new(0.9, 1.0, 0.8), Vec3::new(0.3, 0.1, 0.0));
    let water = solid(1.33, Vec3::new(0.7, 1.0, 0.8), Vec3::new(0.5, 0.1, 0.2));
    let gold = metal(Vec3::new(0.18, 0.42, 1.37), Vec3::new(3.42, 2.35, 1.77));
    let x = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    SceneBuilder::new()
        .floor(-1.0, 3.0, colored(x(0.7, 0.6, 0.5)))
        .quad([x(-3.0, -1.0, -3.0), x(3.0, -1.0, -3.0), x(3.0, 3.0, -3.0), x(-3.0, 3.0, -3.0)], diffuse(0.6))
        .quad(
            [x(-3.0, -1.0, 3.0), x(-3.0, -1.0, -3.0), x(-3.0, 3.0, -3.0), x(-3.0, 3.0, 3.0)],
            colored(x(0.8, 0.2, 0.2)),
        )
        .quad([x(0.4, -0.9, -2.5), x(2.5, -0.9, -1.5), x(2.5, 1.5, -1.6), x(0.4, 1.5, -2.6)], mirror())
        .quad(
            [x(-0.2, -0.7, 2.0), x(1.8, -0.7, 2.0), x(1.8, -0.7, 0.3), x(-0.2, -0.7, 0.3)],
            material("water", water, Vec3::ZERO),
        )
        .sphere(x(-0.8, -0.2, 0.0), 0.7, material("tinted", tinted, Vec3::ZERO))
        .sphere(x(0.6, 0.0, -0.6), 0.5, material("gold", gold, Vec3::ZERO))
        .sphere(x(0.0, 4.0, 1.0), 1.2, emitter(Vec3::new(9.0, 8.0, 7.0)))
        .environment(Environment::Gradient {
            zenith: x(0.3, 0.4, 0.6),
            horizon: x(0.5, 0.5, 0.5),
            nadir: x(0.1, 0.1, 0.1),
        })
        .build()
}

#[test]
fn the_flattened_tree_is_the_path_traced_picture_for_every_plan() {
    let renderer = FrameRenderer::new(Arc::new(all_kinds()));
    let camera = Camera::symmetric(0.9, ImageSize::new(64, 48));
    let pose = Pose::look_at(DVec3::new(0.3, 0.9, 4.2), DVec3::new(0.1, -0.1, 0.0));
    let pixels = camera.size.pixels();
    let runs = 12;
    let expected: Vec<Vec<Vec3>> =
        (0..runs).map(|run| render(renderer.tracer(), &camera, &pose, &settings(64, 12, 100 + run)).radiance).collect();
    let reference = BlockMeans::of_runs(64, &expected);
    for (name, plan) in
        [("D", Plan::diffuse()), ("DR", Plan::mirror()), ("DRF", Plan::water()), ("DRFFF", Plan::solid())]
    {
        let found: Vec<Vec<Vec3>> = (0..runs)
            .map(|run| {
                let tree = tree_of(&renderer, camera, pose, plan.clone(), 32, run);
                let mut radiance = vec![Vec3::ZERO; pixels];
                flatten(&tree, 0..pixels, &mut radiance);
                radiance
            })
            .collect();
        let flat = BlockMeans::of_runs(64, &found);
        let z: Vec<f64> = (0..flat.mean.len())
            .map(|block| {
                // What f32 and the client's own Fresnel term may differ by, beside chance.
                let rounding = 1e-5 * reference.mean[block].abs();
                (flat.mean[block] - reference.mean[block])
                    / (flat.standard_error[block].hypot(reference.standard_error[block]).hypot(rounding))
            })
            .collect();
        let worst = z.iter().fold(0.0_f64, |worst, z| worst.max(z.abs()));
        let limit = critical_z(z.len(), 2.0 * (runs - 1) as f64);
        if worst > limit {
            let error: Vec<Vec3> = found[0].iter().zip(&expected[0]).map(|(a, b)| (*a - *b).abs()).collect();
            let at = write_pictures(
                &format!("tree-{name}"),
                64,
                &[("image", &found[0]), ("reference", &expected[0]), ("error", &error)],
            );
            panic!("plan {name}: |z| of {worst:.1} above {limit:.1}; pictures in {}", at.display());
        }
        // Chance alone: the scatter of z is that of Student's t, not of a bias in every block.
        let mean_z = z.iter().sum::<f64>() / z.len() as f64;
        assert!(mean_z.abs() < 0.35, "plan {name}: mean z {mean_z:.2}");
    }
}

#[test]
fn planes_of_a_glass_ball_mean_what_they_say() {
    let environment = Environment::Constant(Vec3::new(1.0, 2.0, 3.0));
    let scene = SceneBuilder::new().sphere(Vec3::ZERO, 1.0, glass(1.5)).environment(environment).build();
    let renderer = FrameRenderer::new(Arc::new(scene));
    // An odd size: the middle pixel looks straight through the centre.
    let camera = Camera::symmetric(0.5, ImageSize::new(33, 33));
    let pose = Pose::look_at(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO);
    let tree = tree_of(&renderer, camera, pose, Plan::solid(), 1, 1);
    let middle = 33 * 16 + 16;
    let [root, reflect, refract, leave] = [0, 1, 2, 3].map(|node| &tree.nodes[node]);
    assert!((root.distance[middle] - 3.0).abs() < 1e-5);
    assert_eq!(root.radiance_at(middle), Vec3::ZERO);
    assert!((root.normal_at(middle) - Vec3::Z).length() < 1e-5);
    assert_eq!(tree.interfaces.at(root.interface[middle]), Some(&Interface::Dielectric { eta: 1.5 }));
    assert_eq!((reflect.distance[middle], reflect.radiance_at(middle)), (f32::INFINITY, Vec3::new(1.0, 2.0, 3.0)));
    assert!((refract.distance[middle] - 2.0).abs() < 1e-5);
    assert_eq!(tree.interfaces.at(refract.interface[middle]), Some(&Interface::Dielectric { eta: 1.0 / 1.5 }));
    // Inside, on the side the ray comes from: towards the eye.
    assert!((refract.normal_at(middle) - Vec3::Z).length() < 1e-5);
    // Entering and leaving cancel in the squared index.
    assert_eq!(leave.distance[middle], f32::INFINITY);
    assert!((leave.radiance_at(middle) - Vec3::new(1.0, 2.0, 3.0)).length() < 1e-5);
    // The internal reflection has no node: it is baked into the refracted one, by its Fresnel weight.
    let inside = fresnel_dielectric(1.0, 1.0 / 1.5);
    assert!(refract.radiance_at(middle).x <= inside * 1.01);
    // Beside the ball: the sky, and no children.
    assert_eq!((root.distance[0], root.interface[0], reflect.distance[0]), (f32::INFINITY, 0, UNDEFINED));
    assert_eq!(root.radiance_at(0), Vec3::new(1.0, 2.0, 3.0));
}

#[test]
fn a_solids_exit_surface_comes_with_its_shape() {
    let camera = Camera::symmetric(0.5, ImageSize::new(65, 65));
    // A turned eye: the basis is that of the view.
    let pose = Pose::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO);
    let ball = SceneBuilder::new().sphere(Vec3::ZERO, 0.8, glass(1.5)).environment(Environment::Constant(Vec3::ONE));
    let tree = tree_of(&FrameRenderer::new(Arc::new(ball.build())), camera, pose, Plan::solid(), 1, 1);
    let refract = &tree.nodes[2];
    let mut inside = 0;
    for pixel in 0..camera.size.pixels() {
        let [s11, s12, s22] = refract.shape_at(pixel).unwrap().to_array();
        if refract.interface[pixel] > 0 {
            // Of the side that the ray comes from, the inner one.
            assert!((s11 + 1.25).abs() < 1e-5 && s12.abs() < 1e-5 && (s22 + 1.25).abs() < 1e-5, "{s11} {s12} {s22}");
            inside += 1;
        } else {
            assert_eq!([s11, s12, s22], [0.0; 3]);
        }
    }
    assert!(inside > 1000, "{inside}");
    // The root needs none, nor do nodes without children; plans without a solid have none.
    assert!([0, 1, 3].iter().all(|&node: &usize| tree.nodes[node].shape_at(0).is_none()));
    let cube = SceneBuilder::new().cube(Vec3::ZERO, 1.0, glass(1.5)).environment(Environment::Constant(Vec3::ONE));
    let renderer = FrameRenderer::new(Arc::new(cube.build()));
    let tree = tree_of(&renderer, camera, pose, Plan::solid(), 1, 1);
    assert!(tree.nodes[2].interface.iter().any(|&interface| interface > 0));
    assert!(tree.nodes[2].shape.iter().flatten().all(|&entry| entry == 0.0));
    let tree = tree_of(&renderer, camera, pose, Plan::water(), 1, 1);
    assert!(tree.nodes.iter().all(|planes| planes.shape_at(0).is_none()));
}

/// An ellipsoid of triangles, turned and mirrored: what the frame says of its shape is how its own normals change from
/// pixel to pixel.
#[test]
fn shapes_of_a_smooth_mesh_are_the_differences_of_the_frames_own_normals() {
    let environment = Environment::Constant(Vec3::ONE);
    let unit = SceneBuilder::new().ball(Vec3::ZERO, 1.0, 4, true, glass(1.5)).environment(environment).build();
    let turn = glam::DQuat::from_euler(glam::EulerRot::YXZ, 0.7, -0.4, 1.1);
    for mirror in [1.0, -1.0] {
        let axes = DVec3::new(0.6 * mirror, 0.4, 0.25);
        let world_from_ball = glam::DAffine3::from_scale_rotation_translation(axes, turn, DVec3::new(0.1, 0.0, -0.1));
        let mut mesh = crate::scene::Mesh::default();
        mesh.append(&unit.mesh, &world_from_ball, "test", |material| material).unwrap();
        let renderer = FrameRenderer::new(Arc::new(Scene { mesh, ..unit.clone() }));
        let camera = Camera::symmetric(0.5, ImageSize::new(256, 256));
        let pose = Pose::look_at(DVec3::new(1.0, 0.5, 2.0), DVec3::ZERO);
        let tree = tree_of(&renderer, camera, pose, Plan::solid(), 1, 1);
        let [root, refract] = [0, 2].map(|node| &tree.nodes[node]);
        let exit = |pixel: usize| {
            let direction = camera.ray_in_view(camera.size.pixel_centre(pixel)).normalize();
            let inside = optics::refract(direction, root.normal_at(pixel), 1.5)?;
            let is_exit = refract.interface[pixel] > 0;
            is_exit.then(|| direction * root.distance[pixel] + inside * refract.distance[pixel])
        };
        let mut errors = Vec::new();
        for pixel in 256..255 * 256 {
            let shape = refract.shape_at(pixel).unwrap();
            let normal = refract.normal_at(pixel);
            for reach in [1, 256] {
                let (Some(before), Some(_), Some(after)) = (exit(pixel - reach), exit(pixel), exit(pixel + reach))
                else {
                    continue;
                };
                let [t, b] = tangents(normal);
                let step = after - before;
                let (x, y) = (step.dot(t), step.dot(b));
                let turned = refract.normal_at(pixel + reach) - refract.normal_at(pixel - reach);
                let said = (shape.s11 * x + shape.s12 * y) * t + (shape.s12 * x + shape.s22 * y) * b;
                errors.push(f64::from((said - turned).length() / turned.length()));
            }
        }
        errors.sort_by(f64::total_cmp);
        // A pixel is a twentieth of a triangle: most differences are taken within one. What is left is that the gradient
        // over a triangle is not symmetric, but S is: second order in a triangle's side, a tenth of the radius.
        let (median, p90) = (errors[errors.len() / 2], errors[errors.len() * 9 / 10]);
        println!("mirror {mirror}: {} differences, median {median:.4}, 90th percentile {p90:.4}", errors.len());
        assert!(errors.len() > 10_000 && median < 0.02 && p90 < 0.1, "{} {median} {p90}", errors.len());
    }
}

#[test]
fn total_internal_reflection_has_no_refracted_child() {
    // From inside a block of glass, at 60 degrees of incidence (critical angle 41.8).
    let scene =
        SceneBuilder::new().cube(Vec3::ZERO, 2.0, glass(1.5)).environment(Environment::Constant(Vec3::ONE)).build();
    let renderer = FrameRenderer::new(Arc::new(scene));
    let camera = Camera::symmetric(0.01, ImageSize::new(3, 3));
    let aside = 60.0_f64.to_radians().tan() * 0.5;
    let pose = Pose::look_at(DVec3::new(0.0, 0.5, 0.0), DVec3::new(aside, 1.0, 0.0));
    let tree = tree_of(&renderer, camera, pose, Plan::water(), 4, 1);
    assert_eq!(tree.nodes[2].distance[4], UNDEFINED);
    assert!(tree.nodes[1].distance[4] > 0.0 && tree.nodes[0].interface[4] > 0);
}

#[test]
fn every_band_is_handed_on_once_and_effects_that_are_off_trace_no_ray() {
    let scene =
        SceneBuilder::new().floor(0.0, 5.0, diffuse(0.5)).sphere(Vec3::Y * 3.0, 0.5, emitter(Vec3::ONE)).build();
    let renderer = FrameRenderer::new(Arc::new(scene));
    let camera = Camera::symmetric(1.0, ImageSize::new(40, 70));
    let pose = Pose::look_at(DVec3::new(0.0, 2.0, 4.0), DVec3::ZERO);
    let (bands, rows) = (AtomicU32::new(0), AtomicU32::new(0));
    let counters = Counters::default();
    let request =
        FrameRequest { render_pose: pose, camera, plan: Plan::diffuse(), volume: None, spp: 2, max_depth: 4, seed: 1 };
    renderer.render(&request, &mut empty_tree(), &counters, &|band| {
        bands.fetch_add(1, Ordering::Relaxed);
        rows.fetch_add(band.rows.end - band.rows.start, Ordering::Relaxed);
    });
    assert_eq!((bands.into_inner(), rows.into_inner()), (3, 70));
    let counts = counters.snapshot();
    assert_eq!((counts.primary, counts.reflect, counts.refract), (40 * 70, 0, 0));
    assert!(counts.diffuse > 0 && counts.shadow > 0);
}

#[test]
fn the_same_seed_gives_the_same_frame() {
    let renderer = FrameRenderer::new(Arc::new(all_kinds()));
    let camera = Camera::symmetric(1.0, ImageSize::new(24, 40));
    let pose = Pose::look_at(DVec3::new(0.0, 1.0, 4.0), DVec3::ZERO);
    let frame = |seed| tree_of(&renderer, camera, pose, Plan::solid(), 2, seed);
    assert_eq!(frame(1), frame(1));
    assert_ne!(frame(1), frame(2));
}

/// The bits of a small frame of a scene from its first camera, without an effect. What media do to light before it meets the
/// root's surface is not in the nodes, so where there are any, a picture comes with it.
fn probe(scene: &Scene, off: Option<EffectKind>) -> (Vec<u32>, RayCounts) {
    let camera = Camera::symmetric(scene.cameras[0].vertical_fov_rad, ImageSize::new(48, 36));
    let (pose, plan) = (scene.cameras[0].pose, plan_of(scene));
    let has_media = !scene.media.is_empty();
    let (scene, simulated) = off.map_or((scene.clone(), Simulated::ALL), |kind| without(scene, kind));
    let renderer = FrameRenderer::limited(Arc::new(scene), simulated);
    let mut tree = Tree::new(pose, camera, plan.clone(), Interfaces::default());
    let counters = Counters::default();
    let request = FrameRequest { render_pose: pose, camera, plan, volume: None, spp: 2, max_depth: 8, seed: 3 };
    renderer.render(&request, &mut tree, &counters, &|_| {});
    let planes = tree.nodes.iter().flat_map(|node| node.radiance.iter().flatten().chain(&node.distance));
    // Bit for bit, undefined values included.
    let mut bits: Vec<u32> = planes.map(|value| value.to_bits()).collect();
    if has_media {
        let image = render(renderer.tracer(), &camera, &pose, &settings(1, 8, 3));
        bits.extend(image.radiance.iter().flat_map(|radiance| radiance.to_array().map(f32::to_bits)));
    }
    (bits, counters.snapshot())
}

/// Over all scenes and effects: one that the scene does not call for is nowhere in its frames, neither in a bit
/// nor in a ray; one that it calls for can be seen.
#[test]
fn only_effects_that_a_scene_calls_for_are_simulated() {
    for name in Scene::built_in_names() {
        let scene = Scene::load(name).unwrap();
        let effects = Effects::of(&scene);
        let (whole, counts) = probe(&scene, None);
        let named = counts.named();
        for kind in EffectKind::ALL {
            let (rest, _) = probe(&scene, Some(kind));
            let rays = |counter| named.iter().find(|(name, _)| *name == counter).map_or(0, |&(_, rays)| rays);
            if effects.has(kind) {
                assert!(whole != rest, "{name}: {} cannot be seen", kind.name());
            } else {
                assert!(whole == rest, "{name}: {} is off and simulated", kind.name());
                assert_eq!(kind.counter().map_or(0, rays), 0, "{name}: {} is off and has rays", kind.name());
            }
        }
    }
}
