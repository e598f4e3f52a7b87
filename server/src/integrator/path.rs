//! The random walk of a path, from the surface it has met to the lights.
//!
//! A path may begin at a surface that is already known, with some of its specular events left to someone
//! else: so the same walk serves whole pictures and the nodes of a ray tree.

use super::lambert::{pdf_cosine, sample_cosine};
use super::sampler::Sampler;
use super::{Boundary, Medium, PathTracer};
use crate::accel::{Ray, SurfacePoint};
use crate::counters::RayCounts;
use crate::scene::Surface;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Segments before Russian roulette begins: shorter paths carry most of the light.
pub(super) const ROULETTE_AFTER: u32 = 4;
/// Most likely survival: bounds the length of a path in a closed white room.
const MAX_SURVIVAL: f32 = 0.95;
/// Part of a light's distance within which nothing counts as in its way: the roundings of its own position.
const SHADOW_END: f32 = 1.0 - 1e-5;
/// Probability of drawing from the environment where there are emissive surfaces too.
const ENVIRONMENT_PART: f32 = 0.5;

/// A surface met by a path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vertex {
    pub(crate) point: SurfacePoint,
    /// Direction of the ray that met it.
    pub(crate) direction: Vec3,
    /// The medium that ray ran through.
    pub(crate) medium: Medium,
    /// Segments from the eye to here.
    pub(crate) segments: u32,
}

impl Vertex {
    /// 1 where the ray met the outside of its surface, -1 inside.
    fn side(&self) -> f32 {
        if self.direction.dot(self.point.geometric_normal) < 0.0 { 1.0 } else { -1.0 }
    }

    /// The shading normal on the side that the ray met.
    pub(crate) fn lit_normal(&self) -> Vec3 {
        self.side() * self.point.shading_normal
    }

    /// Whether a direction leaves to the side that the ray met.
    fn is_above(&self, direction: Vec3) -> bool {
        direction.dot(self.point.geometric_normal) * self.side() > 0.0
    }
}

/// Specular events that a vertex evaluates itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SpecularEvents {
    pub(crate) reflect: bool,
    pub(crate) refract: bool,
}

impl SpecularEvents {
    pub(crate) const ALL: SpecularEvents = SpecularEvents { reflect: true, refract: true };
}

/// How a path came to where it is: what decides the weight of a light that it meets there.
#[derive(Clone, Copy)]
pub(super) enum Arrival {
    /// From the eye or a specular surface: nothing else could have found the light.
    Certain,
    /// In a direction drawn with this density at a diffuse point, where lights were drawn, too.
    Drawn { from: Vec3, pdf: f32 },
}

/// What a surface sends on: the next ray of the path.
pub(super) struct Scattered {
    pub(super) ray: Ray,
    /// Factor on what arrives by it, over its probability.
    pub(super) weight: Vec3,
    pub(super) medium: Medium,
    pub(super) arrival: Arrival,
    /// Squared relative index of the medium entered; 1 otherwise.
    eta2: f32,
}

impl PathTracer {
    /// Radiance that arrives at the origin of an eye ray.
    pub(crate) fn radiance(&self, ray: &Ray, max_depth: u32, sampler: &mut Sampler, counts: &mut RayCounts) -> Vec3 {
        counts.primary += 1;
        match self.surface_along(ray) {
            None => self.scene.environment.radiance(ray.direction),
            Some((point, _)) => {
                let vertex = Vertex { point, direction: ray.direction, medium: Medium::AIR, segments: 1 };
                self.outgoing(vertex, SpecularEvents::ALL, max_depth, sampler, counts)
            }
        }
    }

    /// The first surface along a ray and its distance.
    pub(crate) fn surface_along(&self, ray: &Ray) -> Option<(SurfacePoint, f32)> {
        let hit = self.accel.closest(ray)?;
        Some((SurfacePoint::at(&self.scene, ray, &hit), hit.distance))
    }

    /// One sample of the radiance that the vertex sends back along its ray. At the first vertex only the
    /// `evaluated` specular events count.
    pub(crate) fn outgoing(
        &self,
        first: Vertex,
        mut evaluated: SpecularEvents,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Vec3 {
        let mut vertex = first;
        let mut arrival = Arrival::Certain;
        let mut radiance = Vec3::ZERO;
        let mut throughput = Vec3::ONE;
        // Product of the squared indices: inside a medium the throughput is small by the scaling of
        // radiance alone, which the roulette must not take for absorption.
        let mut eta2 = 1.0;
        while vertex.segments <= max_depth {
            radiance += throughput * self.emitted(&vertex, arrival);
            if vertex.segments == max_depth {
                break;
            }
            let scattered = match Boundary::at(&self.scene, &vertex.point, vertex.direction) {
                Some(boundary) => self.scatter_specular(&vertex, &boundary, evaluated, sampler, counts),
                None => self.scatter_diffuse(&vertex, throughput, &mut radiance, sampler, counts),
            };
            let Some(scattered) = scattered else { break };
            evaluated = SpecularEvents::ALL;
            throughput *= scattered.weight;
            eta2 *= scattered.eta2;

            if vertex.segments >= ROULETTE_AFTER {
                let survival = (throughput.max_element() * eta2).min(MAX_SURVIVAL);
                if sampler.value() >= survival {
                    break;
                }
                throughput /= survival;
            }

            // Trace the next segment.
            arrival = scattered.arrival;
            let Some((point, distance)) = self.surface_along(&scattered.ray) else {
                let weight = scattered.medium.transmittance(f32::INFINITY)
                    * self.weight_of_escape(scattered.ray.direction, arrival);
                radiance += throughput * weight * self.scene.environment.radiance(scattered.ray.direction);
                break;
            };
            throughput *= scattered.medium.transmittance(distance);
            let segments = vertex.segments + 1;
            vertex = Vertex { point, direction: scattered.ray.direction, medium: scattered.medium, segments };
        }
        radiance
    }

    /// Emission towards the ray that met the vertex, with its weight against next-event estimation.
    pub(super) fn emitted(&self, vertex: &Vertex, arrival: Arrival) -> Vec3 {
        let emission = self.emission(&vertex.point, vertex.direction);
        match arrival {
            Arrival::Drawn { from, pdf } if emission != Vec3::ZERO => {
                let light_pdf = self.emitter_part() * self.emitters.pdf(from, &vertex.point);
                emission * balance(pdf, light_pdf)
            }
            _ => emission,
        }
    }

    /// Radiance emitted at a point against `direction`.
    pub(crate) fn emission(&self, point: &SurfacePoint, direction: Vec3) -> Vec3 {
        let material = &self.scene.materials[point.material as usize];
        if material.emission.is_black() || !(material.emission_two_sided || direction.dot(point.geometric_normal) < 0.0)
        {
            return Vec3::ZERO;
        }
        material.emission.at(&self.scene.textures, point.uv)
    }

    /// Weight of the environment against drawing it.
    pub(super) fn weight_of_escape(&self, direction: Vec3, arrival: Arrival) -> f32 {
        match (arrival, &self.surroundings) {
            (Arrival::Drawn { pdf, .. }, Some(surroundings)) => {
                balance(pdf, (1.0 - self.emitter_part()) * surroundings.pdf(direction))
            }
            _ => 1.0,
        }
    }

    /// Probability that next-event estimation draws from the emissive surfaces.
    fn emitter_part(&self) -> f32 {
        match (self.emitters.is_empty(), &self.surroundings) {
            (true, _) => 0.0,
            (false, None) => 1.0,
            (false, Some(_)) => 1.0 - ENVIRONMENT_PART,
        }
    }

    /// One of the specular events that are evaluated here, by its Fresnel weight.
    pub(super) fn scatter_specular(
        &self,
        vertex: &Vertex,
        boundary: &Boundary,
        evaluated: SpecularEvents,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Option<Scattered> {
        let refracted = boundary.refracted.filter(|_| evaluated.refract);
        // Where only one event is left there is nothing to choose; else dielectrics, whose reflectance is
        // the same for all channels, choose by it.
        let probability_of_reflection = match (evaluated.reflect, refracted) {
            (false, None) => return None,
            (true, None) => 1.0,
            (false, Some(_)) => 0.0,
            (true, Some(_)) => boundary.reflectance.x,
        };
        let choice = if refracted.is_some() && evaluated.reflect { sampler.value() } else { 0.5 };
        let (direction, weight, medium, eta2) = match refracted.filter(|_| choice >= probability_of_reflection) {
            None => {
                counts.reflect += 1;
                let weight = boundary.reflectance * boundary.reflected_factor / probability_of_reflection;
                (boundary.reflected, weight, vertex.medium, 1.0)
            }
            Some(refracted) => {
                counts.refract += 1;
                let weight = (Vec3::ONE - boundary.reflectance) * refracted.factor / (1.0 - probability_of_reflection);
                (refracted.direction, weight, refracted.medium, refracted.eta * refracted.eta)
            }
        };
        Some(Scattered { ray: vertex.point.leave(direction), weight, medium, arrival: Arrival::Certain, eta2 })
    }

    /// Adds the light drawn at a diffuse vertex to `radiance` and draws the next direction.
    fn scatter_diffuse(
        &self,
        vertex: &Vertex,
        throughput: Vec3,
        radiance: &mut Vec3,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Option<Scattered> {
        let Surface::Diffuse { albedo } = &self.scene.materials[vertex.point.material as usize].surface else {
            return None;
        };
        if albedo.is_black() {
            return None;
        }
        let albedo = albedo.at(&self.scene.textures, vertex.point.uv);
        *radiance += throughput * albedo * self.direct_light(vertex, sampler, counts);
        let scattered = self.scatter_cosine(vertex, sampler, counts)?;
        Some(Scattered { weight: albedo, ..scattered })
    }

    /// One sample of the irradiance over pi that comes straight from the lights, weighted against meeting them
    /// by [`PathTracer::scatter_cosine`].
    pub(super) fn direct_light(&self, vertex: &Vertex, sampler: &mut Sampler, counts: &mut RayCounts) -> Vec3 {
        let Some(light) = self.draw_light(&vertex.point, sampler).filter(|light| vertex.is_above(light.direction))
        else {
            return Vec3::ZERO;
        };
        let normal = vertex.lit_normal();
        let cosine = normal.dot(light.direction);
        if cosine <= 0.0 {
            return Vec3::ZERO;
        }
        counts.shadow += 1;
        let ray = Ray { origin: light.origin, direction: light.direction };
        if self.accel.occluded(&ray, light.distance * SHADOW_END) {
            return Vec3::ZERO;
        }
        let weight = balance(light.pdf, pdf_cosine(normal, light.direction)) * cosine * FRAC_1_PI / light.pdf;
        light.radiance * vertex.medium.transmittance(light.distance) * weight
    }

    /// A direction drawn by the cosine about a diffuse vertex; its weight is without the albedo.
    pub(super) fn scatter_cosine(
        &self,
        vertex: &Vertex,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Option<Scattered> {
        let normal = vertex.lit_normal();
        let direction = sample_cosine(normal, sampler.pair());
        if !vertex.is_above(direction) {
            return None;
        }
        counts.diffuse += 1;
        let arrival = Arrival::Drawn { from: vertex.point.position, pdf: pdf_cosine(normal, direction) };
        let ray = vertex.point.leave(direction);
        Some(Scattered { ray, weight: Vec3::ONE, medium: vertex.medium, arrival, eta2: 1.0 })
    }

    /// Next-event estimation: a light that may be seen from the point.
    fn draw_light(&self, point: &SurfacePoint, sampler: &mut Sampler) -> Option<DrawnLight> {
        let emitter_part = self.emitter_part();
        if emitter_part == 0.0 && self.surroundings.is_none() {
            return None;
        }
        let (choice, u) = (sampler.value(), sampler.pair());
        if choice < emitter_part {
            let sample = self.emitters.sample(&self.scene, point.position, choice / emitter_part, u)?;
            let direction = (sample.point.position - point.position).try_normalize()?;
            let radiance = self.emission(&sample.point, direction);
            if radiance == Vec3::ZERO {
                return None;
            }
            // Aim from above the lit surface to above the emitter's.
            let origin = point.offset_towards(direction);
            let towards = sample.point.offset_towards(-direction) - origin;
            let distance = towards.length();
            let direction = towards.try_normalize()?;
            return Some(DrawnLight { origin, direction, distance, radiance, pdf: emitter_part * sample.pdf });
        }
        let surroundings = self.surroundings.as_ref()?;
        let (direction, pdf) = surroundings.sample((choice - emitter_part) / (1.0 - emitter_part), u);
        let pdf = (1.0 - emitter_part) * pdf;
        let radiance = self.scene.environment.radiance(direction);
        (radiance != Vec3::ZERO).then(|| DrawnLight {
            origin: point.offset_towards(direction),
            direction,
            distance: f32::INFINITY,
            radiance,
            pdf,
        })
    }
}

/// A light drawn for a point.
struct DrawnLight {
    origin: Vec3,
    direction: Vec3,
    distance: f32,
    radiance: Vec3,
    /// Over solid angle.
    pdf: f32,
}

/// Weight of a sample of density `own` where another way has the density `other` (balance heuristic).
fn balance(own: f32, other: f32) -> f32 {
    if own <= 0.0 {
        0.0
    } else if other <= own {
        1.0 / (1.0 + other / own)
    } else {
        let ratio = own / other;
        ratio / (1.0 + ratio)
    }
}
