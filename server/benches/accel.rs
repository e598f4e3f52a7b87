//! What a ray costs: rays a second on one core, by the kind of ray, the scene and the instructions.
//!
//! `cargo bench -p warplight-server --bench accel`; with `WARPLIGHT_DATA` set also on the bunny of that folder.
//! The knob is the number of triangles: from a room of 32 over two procedural bodies of 70 thousand and a
//! million. Rays are those of a path tracer: through the pixels of the scene's camera, one and two diffuse
//! bounces further, and from each of those surfaces to a lamp above the scene. What is counted as an element
//! is a ray. The figures of one machine are in docs/measurements/2026-11-22-accel.md.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::{Vec2, Vec3};
use std::f32::consts::TAU;
use std::hint::black_box;
use std::path::Path;
use std::time::Duration;
use warplight_protocol::{Camera, ImageSize, Pose};
use warplight_server::accel::{Accel, Ray, SurfacePoint};
use warplight_server::integrator::sampler::Sampler;
use warplight_server::scene::{Mesh, Scene};

/// Primary rays per side of the picture.
const SIDE_PX: u32 = 192;

/// Rays of a path tracer through a scene.
struct Rays {
    /// Primary, after one bounce, after two.
    closest: [Vec<Ray>; 3],
    /// From the first and the second surface to a lamp, and how far it is.
    shadow: [Vec<(Ray, f32)>; 2],
}

impl Rays {
    fn of(scene: &Scene, accel: &Accel) -> Rays {
        let primary = primary(scene);
        let (first_bounce, first_shadow) = bounce(scene, accel, &primary, 1);
        let (second_bounce, second_shadow) = bounce(scene, accel, &first_bounce, 2);
        Rays { closest: [primary, first_bounce, second_bounce], shadow: [first_shadow, second_shadow] }
    }
}

fn primary(scene: &Scene) -> Vec<Ray> {
    let named = &scene.cameras[0];
    let camera = Camera::symmetric(named.vertical_fov_rad, ImageSize { width: SIDE_PX, height: SIDE_PX });
    let pixels = 0..(SIDE_PX * SIDE_PX) as usize;
    let ray = |index| {
        let in_view = camera.ray_in_view(camera.size.pixel_centre(index)).as_dvec3();
        let direction = (named.pose.orientation * in_view).normalize().as_vec3();
        Ray { origin: named.pose.position.as_vec3(), direction }
    };
    pixels.map(ray).collect()
}

/// Where rays go on from the surfaces that they meet, by the cosine, and the way from there to a lamp.
fn bounce(scene: &Scene, accel: &Accel, rays: &[Ray], seed: u64) -> (Vec<Ray>, Vec<(Ray, f32)>) {
    let (low, high) = scene.mesh.bounds().expect("triangles");
    let size = high - low;
    let mut onward = Vec::new();
    let mut shadow = Vec::new();
    for (index, ray) in (0..).zip(rays) {
        let Some(hit) = accel.closest(ray) else { continue };
        let mut sampler = Sampler::new(seed, index, 0);
        let point = SurfacePoint::at(scene, ray, &hit);
        let towards_ray = if point.geometric_normal.dot(ray.direction) > 0.0 { -1.0 } else { 1.0 };
        let direction = towards_ray * 1.001 * point.geometric_normal + on_unit_sphere(sampler.pair());
        onward.push(point.leave(direction.normalize()));
        let lamp = high - size * Vec3::new(0.4, 0.02, 0.4) + 0.05 * size.x * on_unit_sphere(sampler.pair());
        let to_lamp = lamp - point.position;
        shadow.push((point.leave(to_lamp.normalize()), 0.999 * to_lamp.length()));
    }
    (onward, shadow)
}

fn on_unit_sphere(at: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * at.x;
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(radius * (TAU * at.y).cos(), radius * (TAU * at.y).sin(), z)
}

/// A wrinkled ball above a floor: `4 * bands^2` triangles.
fn wrinkled(bands: u32) -> Scene {
    let mut mesh = Mesh::default();
    let (rows, columns) = (bands, 2 * bands);
    for row in 0..=rows {
        for column in 0..=columns {
            let (polar, around) = (0.5 * TAU * row as f32 / rows as f32, TAU * column as f32 / columns as f32);
            let d = Vec3::new(polar.sin() * around.cos(), polar.cos(), polar.sin() * around.sin());
            let coarse = 0.15 * (7.0 * d.x).sin() * (9.0 * d.y).cos() + 0.05 * (31.0 * d.z).sin() * (29.0 * d.x).sin();
            mesh.positions.push((1.0 + coarse + 0.01 * (131.0 * d.y).sin() * (127.0 * d.z).sin()) * d);
        }
    }
    for row in 0..rows {
        for column in 0..columns {
            let [a, b] = [row * (columns + 1) + column, (row + 1) * (columns + 1) + column];
            mesh.triangles.extend([[a, a + 1, b], [a + 1, b + 1, b]]);
        }
    }
    let first = mesh.positions.len() as u32;
    mesh.positions.extend([(-4.0, -4.0), (-4.0, 4.0), (4.0, 4.0), (4.0, -4.0)].map(|(x, z)| Vec3::new(x, -1.2, z)));
    mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    mesh.normals = vec![Vec3::ZERO; mesh.positions.len()];
    mesh.uvs = vec![Vec2::ZERO; mesh.positions.len()];
    mesh.materials = vec![0; mesh.triangles.len()];
    let mut scene = Scene::load("cornell").expect("built in");
    scene.mesh = mesh;
    scene.spheres.clear();
    scene.cameras[0].pose = Pose::look_at(glam::DVec3::new(0.5, 0.6, 2.6), glam::DVec3::ZERO);
    scene
}

fn scenes() -> Vec<(String, Scene)> {
    let built_in = ["cornell", "gallery"].map(|name| (name.to_owned(), Scene::load(name).expect("built in")));
    let mut scenes = Vec::from(built_in);
    scenes.extend([132, 500].map(|bands| (format!("wrinkled{}", 4 * bands * bands), wrinkled(bands))));
    match std::env::var("WARPLIGHT_DATA") {
        Ok(folder) => {
            let file = Path::new(&folder).join("scenes/StanfordBunny.glb");
            scenes.push(("bunny".to_owned(), Scene::load(&file.to_string_lossy()).expect("the bunny")));
        }
        Err(_) => eprintln!("no bunny: WARPLIGHT_DATA is not set"),
    }
    scenes
}

fn rays(criterion: &mut Criterion) {
    for (name, scene) in scenes() {
        let accel = Accel::new(&scene);
        let rays = Rays::of(&scene, &accel);
        let mut group = criterion.benchmark_group(&name);
        for accel in accel.by_instructions() {
            let instructions = accel.instructions();
            for (kind, rays) in ["primary", "bounce1", "bounce2"].into_iter().zip(&rays.closest) {
                group.throughput(Throughput::Elements(rays.len() as u64));
                group.bench_function(BenchmarkId::new(kind, instructions), |bencher| {
                    bencher.iter(|| rays.iter().filter(|&ray| black_box(accel.closest(ray)).is_some()).count());
                });
            }
            for (kind, rays) in ["shadow1", "shadow2"].into_iter().zip(&rays.shadow) {
                group.throughput(Throughput::Elements(rays.len() as u64));
                group.bench_function(BenchmarkId::new(kind, instructions), |bencher| {
                    bencher.iter(|| rays.iter().filter(|(ray, distance)| accel.occluded(ray, *distance)).count());
                });
            }
        }
        group.finish();
    }
}

fn builds(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("build");
    for bands in [132, 500] {
        let scene = wrinkled(bands);
        let triangles = scene.mesh.triangles.len();
        group.throughput(Throughput::Elements(triangles as u64));
        group.bench_function(BenchmarkId::from_parameter(triangles), |bencher| bencher.iter(|| Accel::new(&scene)));
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(600));
    targets = rays, builds
}
criterion_main!(benches);
