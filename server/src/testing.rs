//! Scenes and statistics for the tests of this crate.

pub(crate) mod chi_square;

use crate::film::{Image, PixelFilter, RenderSettings, render_image};
use crate::integrator::PathTracer;
use crate::scene::{Color, Environment, Finish, Material, Mesh, RenderDefaults, Scene, Sphere, Surface};
use glam::{Vec2, Vec3};
use std::ops::ControlFlow;
use std::path::PathBuf;
use warplight_protocol::{Camera, Pose};

pub(crate) fn material(name: &str, surface: Surface, emission: Vec3) -> Material {
    Material { emission: Color::Constant(emission), ..Material::new(name, surface) }
}

pub(crate) fn diffuse(albedo: f32) -> Material {
    colored(Vec3::splat(albedo))
}

pub(crate) fn colored(albedo: Vec3) -> Material {
    material("diffuse", Surface::Diffuse { albedo: Color::Constant(albedo) }, Vec3::ZERO)
}

pub(crate) fn emitter(radiance: Vec3) -> Material {
    material("light", Surface::Diffuse { albedo: Color::Constant(Vec3::ZERO) }, radiance)
}

pub(crate) fn mirror() -> Material {
    material("mirror", Surface::Mirror { filter: Vec3::ONE }, Vec3::ZERO)
}

pub(crate) fn glass(ior: f32) -> Material {
    material("glass", solid(ior, Vec3::ONE, Vec3::ZERO), Vec3::ZERO)
}

/// A smooth transparent solid.
pub(crate) fn solid(ior: f32, filter: Vec3, absorption: Vec3) -> Surface {
    let filter = Color::Constant(filter);
    Surface::Dielectric { ior, dispersion: 0.0, filter, absorption, finish: Finish::SMOOTH }
}

/// A smooth metal.
pub(crate) fn metal(eta: Vec3, k: Vec3) -> Surface {
    Surface::Conductor { eta, k, filter: Color::Constant(Vec3::ONE), finish: Finish::SMOOTH }
}

/// Puts a scene together.
pub(crate) struct SceneBuilder {
    scene: Scene,
}

impl SceneBuilder {
    pub(crate) fn new() -> SceneBuilder {
        SceneBuilder {
            scene: Scene {
                name: "test".to_owned(),
                origin: glam::DVec3::ZERO,
                mesh: Mesh::default(),
                spheres: Vec::new(),
                materials: Vec::new(),
                textures: Vec::new(),
                media: Vec::new(),
                lights: Vec::new(),
                environment: Environment::Black,
                exposure: 1.0,
                head: Pose::IDENTITY,
                cameras: Vec::new(),
                motions: Vec::new(),
                defaults: RenderDefaults::default(),
                warnings: Vec::new(),
            },
        }
    }

    pub(crate) fn environment(mut self, environment: Environment) -> SceneBuilder {
        self.scene.environment = environment;
        self
    }

    fn material(&mut self, material: Material) -> u32 {
        self.scene.materials.push(material);
        self.scene.materials.len() as u32 - 1
    }

    pub(crate) fn sphere(mut self, centre: Vec3, radius: f32, material: Material) -> SceneBuilder {
        let material = self.material(material);
        self.scene.spheres.push(Sphere { centre, radius, material });
        self
    }

    /// Counter-clockwise seen from the outside.
    pub(crate) fn quad(mut self, corners: [Vec3; 4], material: Material) -> SceneBuilder {
        let material = self.material(material);
        self.push_quad(corners, material);
        self
    }

    fn push_quad(&mut self, corners: [Vec3; 4], material: u32) {
        let mesh = &mut self.scene.mesh;
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(corners);
        mesh.normals.extend([Vec3::ZERO; 4]);
        mesh.uvs.extend([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]);
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        mesh.materials.extend([material; 2]);
    }

    /// A horizontal square that faces up.
    pub(crate) fn floor(self, height: f32, half: f32, material: Material) -> SceneBuilder {
        let corner = |x: f32, z: f32| Vec3::new(x * half, height, z * half);
        self.quad([corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, -1.0)], material)
    }

    /// An axis-parallel cube that faces outwards.
    pub(crate) fn cube(mut self, centre: Vec3, side: f32, material: Material) -> SceneBuilder {
        let material = self.material(material);
        for axis in 0..3 {
            for sign in [-1.0, 1.0_f32] {
                let mut normal = Vec3::ZERO;
                normal[axis] = sign;
                let mut u = Vec3::ZERO;
                u[(axis + 1) % 3] = 1.0;
                let v = normal.cross(u);
                let corner = |a: f32, b: f32| centre + 0.5 * side * (normal + a * u + b * v);
                self.push_quad([corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)], material);
            }
        }
        self
    }

    /// A sphere of triangles, tessellated from an octahedron, with exact shading normals where `smooth`.
    pub(crate) fn ball(
        mut self,
        centre: Vec3,
        radius: f32,
        levels: u32,
        smooth: bool,
        material: Material,
    ) -> SceneBuilder {
        let material = self.material(material);
        let mut faces = Vec::new();
        for (x, y, z) in [(1.0, 1.0, 1.0), (1.0, 1.0, -1.0), (1.0, -1.0, 1.0), (1.0, -1.0, -1.0)] {
            for (x, y, z) in [(x, y, z), (-x, -y, -z)] {
                let corners = [Vec3::X * x, Vec3::Y * y, Vec3::Z * z];
                faces.push(if x * y * z > 0.0 { corners } else { [corners[0], corners[2], corners[1]] });
            }
        }
        for _ in 0..levels {
            let split = |[a, b, c]: [Vec3; 3]| {
                let [ab, bc, ca] = [(a + b).normalize(), (b + c).normalize(), (c + a).normalize()];
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            };
            faces = faces.into_iter().flat_map(split).collect();
        }
        let mesh = &mut self.scene.mesh;
        for face in faces {
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(face.map(|normal| centre + radius * normal));
            mesh.normals.extend(face.map(|normal| if smooth { normal } else { Vec3::ZERO }));
            mesh.uvs.extend([Vec2::ZERO; 3]);
            mesh.triangles.push([first, first + 1, first + 2]);
            mesh.materials.push(material);
        }
        self
    }

    pub(crate) fn build(self) -> Scene {
        self.scene
    }
}

/// Samples through pixel centres, without a limit that anything in a test could reach.
pub(crate) fn settings(spp: u32, max_depth: u32, seed: u64) -> RenderSettings {
    RenderSettings { spp, max_depth, seed, filter: PixelFilter::Centre, batch_spp: None }
}

pub(crate) fn render(tracer: &PathTracer, camera: &Camera, pose: &Pose, settings: &RenderSettings) -> Image {
    let counters = crate::counters::Counters::default();
    let image = render_image(tracer, camera, pose, settings, &counters, &mut |_| ControlFlow::Continue(()));
    assert_eq!(counters.snapshot().dropped, 0, "samples that are not finite");
    image
}

/// Means over blocks of pixels and their standard errors, from some independent renderings of one picture.
pub(crate) struct BlockMeans {
    pub(crate) mean: Vec<f64>,
    pub(crate) standard_error: Vec<f64>,
}

pub(crate) const BLOCK_PX: usize = 8;

impl BlockMeans {
    /// Over the channels and blocks of pictures that differ by their seed only: their scatter is the error.
    pub(crate) fn of_runs(width: usize, runs: &[Vec<Vec3>]) -> BlockMeans {
        let means: Vec<Vec<f64>> = runs.iter().map(|run| block_means(width, run, f64::from)).collect();
        let n = runs.len() as f64;
        let mean: Vec<f64> =
            (0..means[0].len()).map(|block| means.iter().map(|run| run[block]).sum::<f64>() / n).collect();
        let deviation = |block: usize| means.iter().map(|run| (run[block] - mean[block]).powi(2)).sum::<f64>();
        let standard_error = (0..mean.len()).map(|block| (deviation(block) / (n * (n - 1.0))).sqrt()).collect();
        BlockMeans { mean, standard_error }
    }
}

/// Mean over each block and channel of `f` of the values.
pub(crate) fn block_means(width: usize, pixels: &[Vec3], f: impl Fn(f32) -> f64) -> Vec<f64> {
    let height = pixels.len() / width;
    let mut means = Vec::new();
    for top in (0..height).step_by(BLOCK_PX) {
        for left in (0..width).step_by(BLOCK_PX) {
            for channel in 0..3 {
                let rows = top..(top + BLOCK_PX).min(height);
                let columns = left..(left + BLOCK_PX).min(width);
                let count = (rows.len() * columns.len()) as f64;
                let block = rows.flat_map(|y| &pixels[y * width..][columns.clone()]);
                means.push(block.map(|pixel| f(pixel[channel])).sum::<f64>() / count);
            }
        }
    }
    means
}

/// Largest |z| that `tests` comparisons of equal things stay below with a probability of 99.9 %
/// (Sidak-corrected), for differences of Student's t with `freedom` degrees; normal above 100.
pub(crate) fn critical_z(tests: usize, freedom: f64) -> f64 {
    let two_sided = 1.0 - 0.999_f64.powf(1.0 / tests as f64);
    // Tail of the normal distribution by its asymptotic series, inverted by bisection.
    let tail = |z: f64| {
        2.0 * (-0.5 * z * z).exp() / (z * (2.0 * std::f64::consts::PI).sqrt()) * (1.0 - 1.0 / (z * z) + 3.0 / z.powi(4))
    };
    let (mut low, mut high) = (2.0, 40.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if tail(middle) > two_sided { low = middle } else { high = middle }
    }
    // Cornish-Fisher expansion from normal to Student.
    let z = low;
    if freedom > 100.0 {
        z
    } else {
        z + (z.powi(3) + z) / (4.0 * freedom)
            + (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / (96.0 * freedom * freedom)
    }
}

/// Writes pictures for a person to look at when a comparison has failed; returns where.
pub(crate) fn write_pictures(name: &str, width: usize, pictures: &[(&str, &[Vec3])]) -> PathBuf {
    // The test binary lies in target/<profile>/deps.
    let binary = std::env::current_exe().unwrap();
    let folder = binary.ancestors().nth(3).unwrap().join("tmp/failed").join(name);
    std::fs::create_dir_all(&folder).unwrap();
    for (part, pixels) in pictures {
        let path = folder.join(format!("{part}.exr"));
        exr::prelude::write_rgb_file(&path, width, pixels.len() / width, |x, y| pixels[y * width + x].into()).unwrap();
    }
    folder
}
