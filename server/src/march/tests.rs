//! The light grid, and the march against the path tracer.

use super::*;
use crate::counters::RayCounts;
use crate::integrator::sampler::Sampler;
use crate::scene::{Environment, Material, Scene, Surface};
use crate::testing::SceneBuilder;
use crate::volume::{Albedo, Grid, Matter, Medium, Phase};
use glam::{Affine3A, Vec3, Vec4};
use std::sync::Arc;

/// A cube of 2 m about the origin, filled, in a sky that is brighter above.
fn scene(matter: Matter) -> Arc<Scene> {
    let boundary = Material { interior: Some(0), ..Material::new("boundary", Surface::Null) };
    let sky = Environment::Gradient { zenith: Vec3::splat(2.0), horizon: Vec3::ONE, nadir: Vec3::splat(0.5) };
    let mut scene = SceneBuilder::new().environment(sky).cube(Vec3::ZERO, 2.0, boundary).build();
    scene.media = vec![Medium { matter, phase: Phase::ISOTROPIC }];
    Arc::new(scene)
}

fn homogeneous() -> Matter {
    let albedo = Vec3::new(0.8, 0.5, 0.2);
    Matter::Homogeneous { extinction_per_m: Vec3::splat(0.8), albedo, emission: Vec3::splat(0.1) }
}

/// Densities that rise and fall twice along each axis.
fn grid() -> Matter {
    const SIDE: u32 = 32;
    let wave = |index: u32| (0.2 * index as f32).sin();
    let values = (0..SIDE * SIDE * SIDE)
        .map(|index| 1.0 + wave(index % SIDE) * wave(index / SIDE % SIDE) * wave(index / SIDE / SIDE))
        .collect();
    Matter::Density {
        density: Arc::new(Grid::new([SIDE; 3], 1, values).unwrap()),
        unit_from_world: Affine3A::from_scale_rotation_translation(
            Vec3::splat(0.5),
            glam::Quat::IDENTITY,
            Vec3::splat(0.5),
        ),
        extinction_per_m: Vec3::splat(0.8),
        albedo: Albedo::Constant(Vec3::new(0.8, 0.5, 0.2)),
        emission: Vec3::ZERO,
    }
}

/// What rays from 4 m away see: by the march, with the sky behind, and by the path tracer.
fn seen(matter: Matter) -> (Vec3, Vec3) {
    const RAYS: u32 = 64;
    const SPP: u32 = 512;
    let scene = scene(matter);
    let tracer = PathTracer::new(Arc::clone(&scene));
    let mut marcher = Marcher::new(&tracer);
    marcher.refine_all(&tracer, 16, 64, 1);
    let (mut marched, mut traced) = (Vec3::ZERO, Vec3::ZERO);
    let (mut work, mut profile) = (Work::default(), Profile::default());
    for index in 0..RAYS {
        let origin = Vec3::new(0.6, 0.3, 4.0);
        let target = Vec3::new((index % 8) as f32 / 8.0 - 0.44, (index / 8) as f32 / 8.0 - 0.44, 0.0);
        let ray = Ray { origin, direction: (target - origin).normalize() };
        marcher.march(&tracer, &ray, Enclosure::AIR, f32::INFINITY, 1.0, &mut work, &mut profile);
        let (radiance, transmittance) = profile.compose();
        marched += (radiance + transmittance * scene.environment.radiance(ray.direction)) / RAYS as f32;
        for sample in 0..SPP {
            let mut sampler = Sampler::new(2, u64::from(index), sample);
            let mut counts = RayCounts::default();
            let radiance = tracer.radiance(&ray, Enclosure::AIR, 64, &mut sampler, &mut counts);
            traced += radiance / (RAYS * SPP) as f32;
        }
    }
    (marched, traced)
}

/// Voxels of 1/16 m, smoothed once, are a twentieth of a free path h: interpolation and smoothing are off by h^2 / 4 of the
/// light, and half a voxel at each face by h / 4 in 1/32 of the way: 0.1 %. A path of up to 2 gives a mean of 32768 a
/// standard error of 0.4 %. Altogether 1.5 %.
fn agree(matter: Matter) {
    let (marched, traced) = seen(matter);
    let difference = ((marched - traced) / traced).abs().max_element();
    assert!(difference < 0.015, "{marched} {traced}");
}

#[test]
fn a_homogeneous_medium_looks_as_if_it_were_path_traced() {
    agree(homogeneous());
}

#[test]
fn a_grid_looks_as_if_it_were_path_traced() {
    agree(grid());
}

#[test]
fn the_light_depends_on_the_number_of_samples_alone() {
    let scene = scene(grid());
    let tracer = PathTracer::new(Arc::clone(&scene));
    let light = |calls: &[usize]| {
        let mut light = LightGrid::new(&scene.media[0], bounds::bounds_of(&scene, 0));
        calls.iter().for_each(|&samples| light.refine(&tracer, 0, samples, 4, 7));
        light
    };
    let occupied = light(&[]).occupied();
    assert_eq!(occupied, 32 * 32 * 32);
    let whole = light(&[occupied + 1000]);
    let parts = light(&[1, 999, occupied - 500, 0, 500]);
    assert!(whole.values() == parts.values() && whole.values().iter().all(|value| value.is_finite()));
    assert!(whole.values() != light(&[occupied + 999]).values(), "one more sample is seen");
    // In a pool of one thread.
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert!(whole.values() == alone.install(|| light(&[occupied + 1000])).values());
}

/// As by a lamp that moves in every frame: what is forgotten is the light, not whose turn it is.
#[test]
fn every_voxel_has_its_turn_though_all_is_forgotten_in_between() {
    let scene = scene(grid());
    let tracer = PathTracer::new(Arc::clone(&scene));
    let mut light = LightGrid::new(&scene.media[0], bounds::bounds_of(&scene, 0));
    let third = light.occupied().div_ceil(3);
    for frame in 0..3 {
        light.forget();
        light.refine(&tracer, 0, third, 4, frame);
    }
    let known = light.values().iter().filter(|value| value.w > 0.0).count();
    assert_eq!(known, light.occupied());
}

#[test]
fn smoothing_keeps_what_is_constant() {
    let scene = scene(grid());
    let mut light = LightGrid::new(&scene.media[0], bounds::bounds_of(&scene, 0));
    let constant = Vec3::new(0.25, 1.0, 3e4);
    // Every third voxel is known.
    light.smooth_of(|voxel| if voxel % 3 == 0 { constant.extend(1.0) } else { Vec4::ZERO });
    let known = light.values().iter().filter(|value| value.w > 0.0).count();
    assert!(known > 32 * 32 * 32 / 3, "{known}");
    for value in light.values().iter().filter(|value| value.w > 0.0) {
        // Nine means of three, each rounded.
        assert!(((value.truncate() - constant) / constant).abs().max_element() < 1e-5, "{value}");
        assert!((value.w - 1.0).abs() < 1e-5, "{value}");
    }
}
