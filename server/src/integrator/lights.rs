//! Next-event estimation: which light is drawn for a surface, and with what density.
//!
//! Three kinds: emissive surfaces ([`Emitters`]), the environment ([`Surroundings`]), and lights without extent.
//! One light is drawn per call: the environment with a fixed part of the probability where there is anything
//! beside it, the others in proportion to their power, wherever the lit point is.
//!
//! Limits: no visibility or distance in the choice: many lights of which few reach a point are noisy. Cost: a
//! binary search or two.

use super::emitters::Emitters;
use super::surroundings::Surroundings;
use crate::accel::SurfacePoint;
use crate::scene::{Light, Moved, Scene};
use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Probability of drawing from the environment where there are other lights, too.
const ENVIRONMENT_PART: f32 = 0.5;
/// The largest number below 1.
pub(super) const ALMOST_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// All lights of a scene.
#[derive(Debug)]
pub(super) struct Lights {
    emitters: Emitters,
    surroundings: Option<Surroundings>,
    /// Lights without extent, each with the sum of the probabilities up to and with it, among themselves.
    points: Vec<(Light, f32)>,
    /// Probability of the emitters, and of the lights without extent; the rest is the environment's.
    emitter_part: f32,
    point_part: f32,
}

/// A light drawn for a point.
pub(super) struct DrawnLight {
    /// Where the shadow ray starts.
    pub(super) origin: Vec3,
    pub(super) direction: Vec3,
    pub(super) distance: f32,
    /// Radiance over the density it was drawn with; of a light without extent, irradiance over its probability.
    pub(super) weight: Vec3,
    /// Density over solid angle that competes with drawing directions; `None` where they never meet the light.
    pub(super) pdf: Option<f32>,
}

impl Lights {
    pub(super) fn new(scene: &Scene) -> Lights {
        let emitters = Emitters::new(scene);
        let surroundings = Surroundings::new(&scene.environment);
        let lights = scene.lights.iter().filter(|light| light.strength() != Vec3::ZERO);
        let radius_m = radius_of(scene);
        let mut sum = 0.0;
        let mut points: Vec<(Light, f32)> = lights
            .map(|light| {
                sum += power_of(light, radius_m);
                (*light, sum)
            })
            .collect();
        points.iter_mut().for_each(|(_, up_to)| *up_to /= sum.max(f32::MIN_POSITIVE));
        let finite = sum + emitters.power();
        let others = match (finite > 0.0, &surroundings) {
            (false, _) => 0.0,
            (true, None) => 1.0,
            (true, Some(_)) => 1.0 - ENVIRONMENT_PART,
        };
        let share = |power: f32| if power > 0.0 { others * power / finite } else { 0.0 };
        Lights { emitter_part: share(emitters.power()), point_part: share(sum), emitters, surroundings, points }
    }

    /// Lights that were moved and turned: their power, and so their probabilities, stay what they were.
    pub(super) fn update(&mut self, scene: &Scene, moved: Moved) {
        if moved.surfaces {
            self.emitters = Emitters::new(scene);
        }
        let lights = scene.lights.iter().filter(|light| light.strength() != Vec3::ZERO);
        self.points.iter_mut().zip(lights).for_each(|((point, _), light)| *point = *light);
    }

    /// A light that may be seen from the point. One number chooses the light and, scaled up to what is left of
    /// it, the place on the light: so samples that are stratified are so over all lights together.
    pub(super) fn draw(&self, scene: &Scene, point: &SurfacePoint, u: Vec2) -> Option<DrawnLight> {
        if u.x < self.emitter_part {
            return self.draw_emitter(scene, point, Vec2::new(u.x / self.emitter_part, u.y));
        }
        let choice = u.x - self.emitter_part;
        if choice < self.point_part {
            return self.draw_point(point, choice / self.point_part);
        }
        let surroundings = self.surroundings.as_ref()?;
        let part = self.environment_part();
        let along = ((choice - self.point_part) / part).clamp(0.0, ALMOST_ONE);
        let (direction, pdf) = surroundings.sample(Vec2::new(along, u.y));
        let radiance = scene.environment.radiance(direction);
        (radiance != Vec3::ZERO).then(|| DrawnLight {
            origin: point.offset_towards(direction),
            direction,
            distance: f32::INFINITY,
            weight: radiance / (part * pdf),
            pdf: Some(part * pdf),
        })
    }

    fn draw_emitter(&self, scene: &Scene, point: &SurfacePoint, u: Vec2) -> Option<DrawnLight> {
        let sample = self.emitters.sample(scene, point.position, u)?;
        let direction = (sample.point.position - point.position).try_normalize()?;
        let radiance = emission(scene, &sample.point, direction);
        if radiance == Vec3::ZERO {
            return None;
        }
        // Aim from above the lit surface to above the emitter's.
        let origin = point.offset_towards(direction);
        let towards = sample.point.offset_towards(-direction) - origin;
        let distance = towards.length();
        let direction = towards.try_normalize()?;
        let pdf = self.emitter_part * sample.pdf;
        Some(DrawnLight { origin, direction, distance, weight: radiance / pdf, pdf: Some(pdf) })
    }

    fn draw_point(&self, point: &SurfacePoint, choice: f32) -> Option<DrawnLight> {
        let index = self.points.partition_point(|&(_, up_to)| up_to <= choice).min(self.points.len().checked_sub(1)?);
        let (light, up_to) = &self.points[index];
        let before = if index == 0 { 0.0 } else { self.points[index - 1].1 };
        let probability = self.point_part * (up_to - before);
        let (origin, direction, distance, falloff) = match *light {
            Light::Directional { direction, .. } => (point.offset_towards(-direction), -direction, f32::INFINITY, 1.0),
            Light::Point { position, .. } | Light::Spot { position, .. } => {
                let origin = point.offset_towards(position - point.position);
                let towards = position - origin;
                let distance = towards.length();
                (origin, towards.try_normalize()?, distance, 1.0 / (distance * distance))
            }
        };
        let weight = light.towards(-direction) * (falloff / probability);
        (weight != Vec3::ZERO && weight.is_finite()).then_some(DrawnLight {
            origin,
            direction,
            distance,
            weight,
            pdf: None,
        })
    }

    fn environment_part(&self) -> f32 {
        1.0 - self.emitter_part - self.point_part
    }

    /// Whether there is anything to draw.
    pub(super) fn is_empty(&self) -> bool {
        self.emitter_part == 0.0 && self.point_part == 0.0 && self.surroundings.is_none()
    }

    /// Density over solid angle at `lit` of drawing this point of an emissive surface.
    pub(super) fn pdf_of_emitter(&self, lit: Vec3, point: &SurfacePoint) -> f32 {
        self.emitter_part * self.emitters.pdf(lit, point)
    }

    /// Density over solid angle of drawing the environment in this direction.
    pub(super) fn pdf_of_environment(&self, direction: Vec3) -> f32 {
        self.surroundings.as_ref().map_or(0.0, |surroundings| self.environment_part() * surroundings.pdf(direction))
    }
}

/// Radiance emitted at a point against `direction`.
pub(super) fn emission(scene: &Scene, point: &SurfacePoint, direction: Vec3) -> Vec3 {
    let material = &scene.materials[point.material as usize];
    if material.emission.is_black() || !(material.emission_two_sided || direction.dot(point.geometric_normal) < 0.0) {
        return Vec3::ZERO;
    }
    material.emission.at(&scene.textures, point.uv)
}

/// Radiant power of the brightest channel into a scene of this radius.
fn power_of(light: &Light, radius_m: f32) -> f32 {
    let strength = light.strength().max_element();
    let power = match light {
        Light::Point { .. } => 2.0 * TAU * strength,
        Light::Spot { outer_rad, .. } => TAU * (1.0 - outer_rad.cos()).max(1e-4) * strength,
        Light::Directional { .. } => PI * radius_m * radius_m * strength,
    };
    if power.is_finite() { power } else { f32::MAX.sqrt() }
}

/// Of a sphere around all surfaces.
fn radius_of(scene: &Scene) -> f32 {
    let of_mesh = scene.mesh.bounds();
    let of_spheres = scene.spheres.iter().map(|sphere| (sphere.centre - sphere.radius, sphere.centre + sphere.radius));
    let bounds = of_mesh.into_iter().chain(of_spheres).reduce(|(l, h), (low, high)| (l.min(low), h.max(high)));
    bounds.map_or(1.0, |(low, high)| (0.5 * (high - low).length()).max(f32::MIN_POSITIVE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::sampler::Sampler;
    use crate::scene::{Environment, Falloff};
    use crate::testing::{SceneBuilder, diffuse, emitter};

    fn lights() -> Vec<Light> {
        vec![
            Light::Point { position: Vec3::new(0.0, 2.0, 0.0), intensity: Vec3::splat(3.0) },
            Light::Spot {
                position: Vec3::new(1.0, 1.0, 0.0),
                axis: Vec3::NEG_Y,
                intensity: Vec3::new(5.0, 1.0, 0.0),
                inner_rad: 0.2,
                outer_rad: 1.2,
                falloff: Falloff::LinearInAngle,
            },
            Light::Directional { direction: Vec3::new(0.6, -0.8, 0.0), irradiance: Vec3::splat(0.7) },
        ]
    }

    /// Irradiance on a floor by drawing lights is the closed form's: every light has its share, whatever its
    /// probability.
    #[test]
    fn drawn_lights_add_up_to_all_lights() {
        let mut scene = SceneBuilder::new()
            .floor(0.0, 1.0, diffuse(0.5))
            .sphere(Vec3::new(0.0, 4.0, 0.0), 0.5, emitter(Vec3::splat(2.0)))
            .environment(Environment::Gradient { zenith: Vec3::ONE, horizon: Vec3::ONE, nadir: Vec3::ZERO })
            .build();
        scene.lights = lights();
        let point = SurfacePoint::on_triangle(&scene, 0, [0.3, 0.2]);
        let drawn = Lights::new(&scene);
        let samples = 400_000;
        let mut irradiance = glam::DVec3::ZERO;
        for index in 0..samples {
            let mut sampler = Sampler::new(4, 0, index);
            let Some(light) = drawn.draw(&scene, &point, sampler.pair()) else { continue };
            irradiance += (light.weight * light.direction.y.max(0.0)).as_dvec3() / f64::from(samples);
        }
        let mut expected = Vec3::splat(PI);
        for light in &scene.lights {
            let (towards, distance2) = match *light {
                Light::Directional { direction, .. } => (-direction, 1.0),
                Light::Point { position, .. } | Light::Spot { position, .. } => {
                    let towards = position - point.position;
                    (towards.normalize(), towards.length_squared())
                }
            };
            expected += light.towards(-towards) * towards.y / distance2;
        }
        // A sphere's form factor: (r/d)^2 cos, all of it above the horizon.
        let towards = scene.spheres[0].centre - point.position;
        expected += Vec3::splat(2.0 * PI * 0.25 / towards.length_squared() * towards.normalize().y);
        assert!(((irradiance.as_vec3() - expected) / expected).abs().max_element() < 0.01, "{irradiance} {expected}");
    }

    #[test]
    fn lights_without_strength_are_not_there() {
        let mut scene = SceneBuilder::new().floor(0.0, 1.0, diffuse(0.5)).build();
        assert!(Lights::new(&scene).is_empty());
        scene.lights = vec![Light::Point { position: Vec3::Y, intensity: Vec3::ZERO }];
        assert!(Lights::new(&scene).is_empty());
        scene.lights.extend(lights());
        assert!(!Lights::new(&scene).is_empty());
    }
}
