//! Emissive triangles and spheres, chosen by power and sampled for next-event estimation.
//!
//! Method: one emitter per sample, with a probability in proportion to its power; triangles uniformly by
//! area, spheres uniformly in the cone they subtend (Shirley and Wang 1996), by area from inside or from
//! very near. Densities are over solid angle at the point that is lit.
//!
//! Limits: a textured emitter is chosen by its factor alone. Cost: a binary search per sample.

use super::lights::ALMOST_ONE;
use crate::accel::SurfacePoint;
use crate::bsdf::tangents;
use crate::scene::{Color, Scene};
use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Primitive that does not emit, in the table from primitives to emitters.
const NONE: u32 = u32::MAX;

#[derive(Clone, Copy, Debug)]
struct Emitter {
    primitive: u32,
    shape: Shape,
    /// Probability that it is chosen.
    probability: f32,
}

#[derive(Clone, Copy, Debug)]
enum Shape {
    Triangle { area: f32 },
    Sphere { centre: Vec3, radius: f32 },
}

/// All emissive primitives of a scene.
#[derive(Debug)]
pub(crate) struct Emitters {
    emitters: Vec<Emitter>,
    /// Sums of the probabilities up to and with each emitter; the last is 1.
    cumulative: Vec<f32>,
    emitter_of_primitive: Vec<u32>,
    power: f32,
}

/// A point on an emitter, drawn for a point that it may light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EmitterSample {
    pub(crate) point: SurfacePoint,
    /// Density over solid angle, with the choice of the emitter.
    pub(crate) pdf: f32,
}

impl Emitters {
    pub(crate) fn new(scene: &Scene) -> Emitters {
        let triangles = scene.mesh.triangles.len();
        let mut emitters = Vec::new();
        let mut powers = Vec::new();
        let mut emitter_of_primitive = Vec::new();
        for primitive in 0..triangles + scene.spheres.len() {
            let (shape, area, material) = match primitive.checked_sub(triangles) {
                None => {
                    let [a, b, c] = scene.mesh.triangles[primitive].map(|corner| scene.mesh.positions[corner as usize]);
                    let area = 0.5 * (b - a).cross(c - a).length();
                    (Shape::Triangle { area }, area, scene.mesh.materials[primitive])
                }
                Some(sphere) => {
                    let sphere = &scene.spheres[sphere];
                    let shape = Shape::Sphere { centre: sphere.centre, radius: sphere.radius };
                    (shape, 4.0 * PI * sphere.radius * sphere.radius, sphere.material)
                }
            };
            let material = &scene.materials[material as usize];
            let (Color::Constant(factor) | Color::Textured { factor, .. }) = material.emission;
            let sides = if material.emission_two_sided { 2.0 } else { 1.0 };
            let power = f64::from(PI * area) * f64::from(factor.max_element() * sides);
            if power > 0.0 && power.is_finite() {
                emitter_of_primitive.resize(primitive, NONE);
                emitter_of_primitive.push(emitters.len() as u32);
                emitters.push(Emitter { primitive: primitive as u32, shape, probability: 0.0 });
                powers.push(power);
            }
        }
        let total: f64 = powers.iter().sum();
        let mut sum = 0.0;
        let mut cumulative = Vec::with_capacity(powers.len());
        for (emitter, power) in emitters.iter_mut().zip(&powers) {
            emitter.probability = (power / total) as f32;
            sum += power / total;
            cumulative.push(sum as f32);
        }
        Emitters { emitters, cumulative, emitter_of_primitive, power: total.min(f64::from(f32::MAX)) as f32 }
    }

    /// Radiant power of the brightest channel, all together; 0 where nothing emits.
    pub(crate) fn power(&self) -> f32 {
        self.power
    }

    /// Draws a point for `lit`; `None` where the draw cannot light it. The first number also chooses the emitter.
    pub(crate) fn sample(&self, scene: &Scene, lit: Vec3, u: Vec2) -> Option<EmitterSample> {
        let index = self.cumulative.partition_point(|&sum| sum <= u.x).min(self.emitters.len().checked_sub(1)?);
        let emitter = &self.emitters[index];
        let before = if index == 0 { 0.0 } else { self.cumulative[index - 1] };
        let u = Vec2::new(((u.x - before) / emitter.probability).clamp(0.0, ALMOST_ONE), u.y);
        let point = match emitter.shape {
            Shape::Triangle { .. } => {
                // Uniform by folding the square along its diagonal (Heitz 2019 keeps the strata).
                let (v, w) = if u.y > u.x { (u.x * 0.5, u.y - u.x * 0.5) } else { (u.x - u.y * 0.5, u.y * 0.5) };
                SurfacePoint::on_triangle(scene, emitter.primitive, [v, w])
            }
            Shape::Sphere { centre, radius } => {
                let normal = match Cone::of(lit, centre, radius) {
                    Some(cone) => cone.normal_towards(u, radius),
                    None => uniform_direction(u),
                };
                SurfacePoint::on_sphere(scene, emitter.primitive, normal)
            }
        };
        let pdf = self.pdf(lit, &point);
        (pdf > 0.0 && pdf.is_finite()).then_some(EmitterSample { point, pdf })
    }

    /// Density over solid angle at `lit` of drawing `point`; 0 where its primitive does not emit.
    pub(crate) fn pdf(&self, lit: Vec3, point: &SurfacePoint) -> f32 {
        let index = self.emitter_of_primitive.get(point.primitive as usize).copied().unwrap_or(NONE);
        let Some(emitter) = self.emitters.get(index as usize) else {
            return 0.0;
        };
        let towards = point.position - lit;
        let from_area = |area: f32| {
            let distance2 = towards.length_squared();
            distance2 * distance2.sqrt() / (area * towards.dot(point.geometric_normal).abs())
        };
        let within = match emitter.shape {
            Shape::Triangle { area } => from_area(area),
            Shape::Sphere { centre, radius } => match Cone::of(lit, centre, radius) {
                Some(cone) => 1.0 / (TAU * cone.one_minus_cosine),
                None => from_area(4.0 * PI * radius * radius),
            },
        };
        emitter.probability * within
    }
}

/// The cone that a sphere subtends.
struct Cone {
    axis: Vec3,
    distance: f32,
    /// 1 - cos of the half-angle, without cancellation for distant spheres.
    one_minus_cosine: f32,
}

impl Cone {
    /// `None` from inside or from so near that the rim of the cone is not resolved.
    fn of(from: Vec3, centre: Vec3, radius: f32) -> Option<Cone> {
        let towards = centre - from;
        let distance = towards.length();
        let sine = radius / distance;
        (distance > radius * 1.0001).then(|| Cone {
            axis: towards / distance,
            distance,
            one_minus_cosine: sine * sine / (1.0 + (1.0 - sine * sine).sqrt()),
        })
    }

    /// Outward normal of the sphere where a uniform direction of the cone meets it first.
    fn normal_towards(&self, u: Vec2, radius: f32) -> Vec3 {
        let one_minus_cosine = u.x * self.one_minus_cosine;
        let sine2 = one_minus_cosine * (2.0 - one_minus_cosine);
        // Along the ray to the near side; then the angle at the centre, between the axis back and the point.
        let cosine_of_ray = 1.0 - one_minus_cosine;
        let half_chord = (radius * radius - self.distance * self.distance * sine2).max(0.0).sqrt();
        let along = self.distance * cosine_of_ray - half_chord;
        let cosine_at_centre = (self.distance - along * cosine_of_ray) / radius;
        let sine_at_centre = along * sine2.sqrt() / radius;
        let (tangent, bitangent) = tangents(-self.axis);
        let (sine, cosine) = (TAU * u.y).sin_cos();
        (sine_at_centre * (cosine * tangent + sine * bitangent) - cosine_at_centre * self.axis).normalize_or(-self.axis)
    }
}

/// Uniform over the sphere of directions.
fn uniform_direction(u: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * u.x;
    let (sine, cosine) = (TAU * u.y).sin_cos();
    let radius = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(radius * cosine, radius * sine, z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::sampler::Sampler;
    use crate::stability::bound;
    use crate::testing::{SceneBuilder, emitter};

    /// Points lie on the emitter, face the point that is lit, and 1/pdf averages to the
    /// solid angle: exactly for spheres, whose density is constant.
    #[test]
    fn drawn_points_are_seen_and_their_density_integrates_to_the_solid_angle() {
        let scene = SceneBuilder::new().sphere(Vec3::new(1.0, 2.0, -0.5), 0.5, emitter(Vec3::ONE)).build();
        let emitters = Emitters::new(&scene);
        for (lit, exact) in [(Vec3::ZERO, true), (Vec3::new(1.0, 1.4, -0.5), true), (Vec3::new(1.0, 2.1, -0.5), false)]
        {
            let mut solid_angle = 0.0;
            let count = 4096;
            for index in 0..count {
                let sample = emitters.sample(&scene, lit, Sampler::new(1, 0, index).pair()).unwrap();
                let towards = sample.point.position - lit;
                if exact {
                    assert!(towards.dot(sample.point.geometric_normal) <= 1e-3 * towards.length(), "far side");
                }
                solid_angle += 1.0 / f64::from(sample.pdf) / f64::from(count);
            }
            let distance = f64::from((scene.spheres[0].centre - lit).length());
            let sine = (0.5 / distance).min(1.0);
            let expected =
                if exact { f64::from(TAU) * (1.0 - (1.0 - sine * sine).sqrt()) } else { 2.0 * f64::from(TAU) };
            assert!((solid_angle / expected - 1.0).abs() < 2e-3, "{solid_angle} {expected}");
        }
    }

    /// Directions to the points drawn are uniform over the cone.
    #[test]
    fn directions_to_a_sphere_are_uniform_over_its_cone() {
        let scene = SceneBuilder::new().sphere(Vec3::Z * 2.0, 1.0, emitter(Vec3::ONE)).build();
        let emitters = Emitters::new(&scene);
        let mut counts = [0_u32; 16];
        let one_minus_cosine = 1.0 - 0.75_f32.sqrt();
        for index in 0..16_384 {
            let sample = emitters.sample(&scene, Vec3::ZERO, Sampler::new(2, 0, index).pair()).unwrap();
            let height = sample.point.position.normalize().z;
            counts[(((1.0 - height) / one_minus_cosine * 16.0) as usize).min(15)] += 1;
        }
        // The sequence is stratified: far closer than chance.
        assert!(counts.iter().all(|count| count.abs_diff(1024) < 8), "{counts:?}");
    }

    #[test]
    fn stability_sampling_of_emitters() {
        let mut drawn = bound!("sampling", "lights without area or radiance that are drawn", 0.0);
        let scene = SceneBuilder::new()
            .quad([Vec3::ZERO; 4], emitter(Vec3::ONE))
            .floor(0.0, 1.0, emitter(Vec3::ZERO))
            .sphere(Vec3::Y, 0.5, emitter(Vec3::ONE))
            .build();
        let emitters = Emitters::new(&scene);
        for index in 0..4096 {
            let sample = emitters.sample(&scene, Vec3::new(0.1, 3.0, 0.2), Sampler::new(4, 0, index).pair());
            let is_sphere = sample.as_ref().is_some_and(|sample| sample.pdf > 0.0 && sample.pdf.is_finite());
            drawn.count(!is_sphere, index);
        }
        assert_eq!(emitters.emitters.len(), 1);
        assert_eq!(emitters.emitters[0].primitive, 4);
        assert_eq!(Emitters::new(&SceneBuilder::new().build()).power(), 0.0);
    }
}
