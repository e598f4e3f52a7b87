//! Every surface against physics: its sampler follows its density, it is reciprocal, it makes no light and
//! loses none that it should not, and it is finite whatever it is given.

mod energy;
mod sampling;
mod special;

use super::{Bsdf, Channel, Enclosure, Lobes};
use crate::accel::SurfacePoint;
use crate::integrator::sampler::Sampler;
use crate::scene::{Coat, Color, Distribution, Finish, Material, Scalar, Scene, Standard, Surface};
use crate::testing::SceneBuilder;
use glam::{Vec2, Vec3};

const DISTRIBUTIONS: [Distribution; 2] = [Distribution::Ggx, Distribution::Beckmann];
const ALPHAS: [f32; 5] = [1e-4, 0.02, 0.1, 0.3, 1.0];
/// Along the normal, oblique, grazing.
const COSINES: [f32; 3] = [1.0, 0.6, 0.05];

/// A square of one material that faces up.
struct Probe {
    scene: Scene,
    point: SurfacePoint,
}

impl Probe {
    fn new(surface: Surface) -> Probe {
        Probe::of(Material::new("probe", surface))
    }

    fn of(material: Material) -> Probe {
        let scene = SceneBuilder::new().floor(0.0, 1.0, material).build();
        let point = SurfacePoint::on_triangle(&scene, 0, [0.3, 0.3]);
        Probe { scene, point }
    }

    /// Seen from the unit vector `towards_eye`.
    fn seen_from(&self, towards_eye: Vec3) -> Bsdf {
        self.through(towards_eye, None)
    }

    fn through(&self, towards_eye: Vec3, channel: Option<Channel>) -> Bsdf {
        Bsdf::at(&self.scene, &self.point, -towards_eye, Enclosure::AIR, channel)
    }
}

/// A unit vector whose cosine with the vertical is `mu`, below 0 from beneath.
fn direction(mu: f32, azimuth: f32) -> Vec3 {
    let sine = (1.0 - mu * mu).max(0.0).sqrt();
    Vec3::new(sine * azimuth.cos(), mu, sine * azimuth.sin())
}

/// Independent directions over the whole sphere.
fn random_direction(index: u32) -> Vec3 {
    let mut sampler = Sampler::new(77, u64::from(index), 0);
    direction(2.0 * sampler.value() - 1.0, std::f32::consts::TAU * sampler.value())
}

fn isotropic(distribution: Distribution, alpha: f32) -> Finish {
    Finish::isotropic(distribution, Scalar::Constant(alpha))
}

fn single(finish: Finish) -> Finish {
    Finish { compensated: false, ..finish }
}

fn gold(finish: Finish) -> Surface {
    let (eta, k) = (Vec3::new(0.18, 0.42, 1.37), Vec3::new(3.42, 2.35, 1.77));
    Surface::Conductor { eta, k, filter: Color::Constant(Vec3::ONE), finish }
}

/// Reflects everything: 1 - R = 4 eta / k^2 = 4e-9.
fn white_metal(finish: Finish) -> Surface {
    let (eta, k) = (Vec3::splat(1e-3), Vec3::splat(1e3));
    Surface::Conductor { eta, k, filter: Color::Constant(Vec3::ONE), finish }
}

fn glass(ior: f32, finish: Finish) -> Surface {
    let (filter, absorption) = (Color::Constant(Vec3::ONE), Vec3::ZERO);
    Surface::Dielectric { ior, dispersion: 0.0, filter, absorption, finish }
}

fn pane(ior: f32, finish: Finish) -> Surface {
    Surface::ThinDielectric { ior, filter: Color::Constant(Vec3::ONE), finish }
}

/// White plastic, to be changed.
fn standard(finish: Finish) -> Standard {
    Standard {
        base: Color::Constant(Vec3::ONE),
        metallic: Scalar::Constant(0.0),
        finish,
        ior: 1.5,
        specular: Scalar::Constant(1.0),
        specular_color: Color::Constant(Vec3::ONE),
        transmission: Scalar::Constant(0.0),
        coat: None,
    }
}

fn coat(strength: f32, alpha: f32) -> Option<Coat> {
    Some(Coat { strength: Scalar::Constant(strength), alpha: Scalar::Constant(alpha) })
}

/// All kinds of standard surface at one roughness.
fn standards(finish: Finish) -> Vec<(&'static str, Standard)> {
    let white = standard(finish);
    let half = Scalar::Constant(0.5);
    let orange = Color::Constant(Vec3::new(0.9, 0.4, 0.1));
    vec![
        ("plastic", white),
        ("metal", Standard { metallic: Scalar::Constant(1.0), ..white }),
        ("mixture", Standard { metallic: half, base: orange, ..white }),
        ("coated plastic", Standard { coat: coat(1.0, 0.3), ..white }),
        ("coated metal", Standard { coat: coat(1.0, 0.02), metallic: Scalar::Constant(1.0), ..white }),
        ("thin", Standard { transmission: Scalar::Constant(1.0), ..white }),
        ("all", Standard { metallic: half, transmission: half, coat: coat(0.5, 0.1), base: orange, ..white }),
    ]
}

/// What the lobes make of the same radiance from everywhere, and what they let through of it, without the scaling of
/// radiance by the index: the mean weight of samples, lobe by lobe, so that choosing adds no noise.
fn albedo(bsdf: &Bsdf, lobes: Lobes, samples: u32) -> Vec3 {
    let mut sum = glam::DVec3::ZERO;
    for lobe in [Lobes::DIFFUSE, Lobes::BROAD, Lobes::REFLECTED, Lobes::REFRACTED] {
        if !lobes.have(lobe) || !bsdf.has(lobe) {
            continue;
        }
        for index in 0..samples {
            let mut sampler = Sampler::new(3, 1, index);
            let (u, choice) = (sampler.pair(), sampler.pair().x);
            if let Some(sample) = bsdf.sample(choice, u, lobe) {
                sum += (sample.weight * sample.eta2).as_dvec3();
            }
        }
    }
    (sum / f64::from(samples)).as_vec3()
}

/// A sample of its own for each index.
fn draw(bsdf: &Bsdf, lobes: Lobes, index: u32) -> Option<Vec3> {
    let mut sampler = Sampler::new(11, u64::from(index), 0);
    let (choice, u) = (sampler.value(), Vec2::new(sampler.value(), sampler.value()));
    bsdf.sample(choice, u, lobes).map(|sample| sample.direction)
}
