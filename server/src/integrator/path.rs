//! The random walk of a path, from the surface it has met to the lights.
//!
//! A path may begin at a surface that is already known, with some of its events left to someone else: so the
//! same walk serves whole pictures and the nodes of a ray tree.

use super::PathTracer;
use super::lights::emission;
use super::media::{Departure, Followed};
use super::sampler::Sampler;
use crate::accel::{Ray, SurfacePoint};
use crate::bsdf::{Boundary, Bsdf, Channel, DIFFUSE_ONLY, Enclosure, Lambert, Lobes, LobesOf, Scatters};
use crate::counters::RayCounts;
use crate::effects::Simulated;
use glam::Vec3;

/// Segments before Russian roulette begins: shorter paths carry most of the light.
pub(super) const ROULETTE_AFTER: u32 = 4;
/// Most likely survival: bounds the length of a path in a closed white room.
pub(super) const MAX_SURVIVAL: f32 = 0.95;
/// Part of a light's distance within which nothing counts as in its way: the roundings of its own position.
const SHADOW_END: f32 = 1.0 - 1e-5;

/// A surface met by a path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vertex {
    pub(crate) point: SurfacePoint,
    /// Direction of the ray that met it.
    pub(crate) direction: Vec3,
    /// The medium that ray ran through.
    pub(crate) medium: Enclosure,
    /// Segments from the eye to here.
    pub(crate) segments: u32,
    /// The colour that the path follows, once light has been dispersed.
    pub(crate) channel: Option<Channel>,
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
}

/// What a vertex evaluates itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Events {
    pub(crate) emission: bool,
    /// Sharp reflection.
    pub(crate) reflect: bool,
    /// Sharp refraction.
    pub(crate) refract: bool,
    pub(crate) lobes: Option<Lobes>,
}

impl Events {
    pub(crate) const ALL: Events = Events { emission: true, reflect: true, refract: true, lobes: Some(Lobes::ALL) };

    /// Those that are simulated at all.
    fn within(self, Simulated { reflection, refraction, .. }: Simulated) -> Events {
        let lobes = self.lobes.map(|lobes| Lobes {
            reflected: lobes.reflected && reflection,
            refracted: lobes.refracted && refraction,
            ..lobes
        });
        Events { reflect: self.reflect && reflection, refract: self.refract && refraction, lobes, ..self }
    }
}

/// How a path came to where it is: what decides the weight of a light that it meets there.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Arrival {
    /// From the eye or by a sharp event: nothing else could have found the light.
    Certain,
    /// In a direction drawn with this density at a point where lights were drawn, too.
    Drawn { from: Vec3, pdf: f32 },
}

/// What a path brings along to the surface from which it is walked.
#[derive(Clone, Copy, Debug)]
struct Begun {
    arrival: Arrival,
    throughput: Vec3,
    eta2: f32,
}

/// What a surface sends on: the next ray of the path.
pub(crate) struct Scattered {
    pub(crate) ray: Ray,
    /// Factor on what arrives by it, over its probability.
    pub(crate) weight: Vec3,
    pub(crate) medium: Enclosure,
    pub(crate) arrival: Arrival,
    /// Squared relative index of the medium entered; 1 otherwise.
    pub(super) eta2: f32,
    /// Whether it goes straight on into another medium: no segment of its own, and found by shadow rays, too.
    pub(super) passes: bool,
}

/// What a ray has met, or the light of the environment.
pub(crate) enum Met {
    Surface(Vertex),
    Nothing { radiance: Vec3 },
}

impl PathTracer {
    /// Radiance that arrives at the origin of an eye ray, which is inside of `eye`.
    pub(crate) fn radiance(
        &self,
        ray: &Ray,
        eye: Enclosure,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Vec3 {
        counts.primary += 1;
        if self.has_media {
            let departure = Departure {
                ray: *ray,
                medium: eye,
                arrival: Arrival::Certain,
                segments: 1,
                channel: None,
                throughput: Vec3::ONE,
                eta2: 1.0,
            };
            return self.incident(departure, max_depth, sampler, counts);
        }
        match self.surface_along(ray, self.salt(sampler)) {
            None => self.scene.environment.radiance(ray.direction),
            Some((point, _)) => {
                let medium = Enclosure::AIR;
                let vertex = Vertex { point, direction: ray.direction, medium, segments: 1, channel: None };
                self.outgoing(vertex, Events::ALL, max_depth, sampler, counts)
            }
        }
    }

    /// One sample of the radiance that the vertex sends back along its ray. At the first vertex only the
    /// `evaluated` events count.
    pub(crate) fn outgoing(
        &self,
        first: Vertex,
        evaluated: Events,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Vec3 {
        let begun = Begun { arrival: Arrival::Certain, throughput: Vec3::ONE, eta2: 1.0 };
        self.walk(first, begun, evaluated, max_depth, sampler, counts)
    }

    /// One sample of the radiance that arrives at the origin of a ray, through whatever media there are; with the
    /// throughput of the path before it.
    pub(super) fn incident(
        &self,
        departure: Departure,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Vec3 {
        let followed = self.travel(departure, max_depth, sampler, counts);
        followed.gathered + self.arriving(followed, departure.eta2, max_depth, sampler, counts)
    }

    /// What comes from where a path has ended up, without what it has gathered on its way.
    pub(super) fn arriving(
        &self,
        followed: Followed,
        eta2: f32,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Vec3 {
        let Followed { throughput, arrival, met, .. } = followed;
        match met {
            Met::Nothing { radiance } => throughput * radiance,
            Met::Surface(vertex) => {
                self.walk(vertex, Begun { arrival, throughput, eta2 }, Events::ALL, max_depth, sampler, counts)
            }
        }
    }

    /// The walk from a surface on, with the throughput of the path before it in what it returns.
    #[inline]
    fn walk(
        &self,
        first: Vertex,
        begun: Begun,
        mut evaluated: Events,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Vec3 {
        let mut vertex = first;
        // The product of the squared indices is there because inside of glass the throughput is small by the
        // scaling of radiance alone, which the roulette must not take for absorption.
        let Begun { mut arrival, mut throughput, mut eta2 } = begun;
        let mut radiance = Vec3::ZERO;
        while vertex.segments <= max_depth {
            if evaluated.emission {
                radiance += throughput * self.emitted(&vertex, arrival);
            }
            if vertex.segments == max_depth {
                break;
            }
            let lambert = Lambert::at(&self.scene, &vertex.point, vertex.direction, vertex.medium);
            let (direct, scattered) = match lambert {
                Some(lambert) => self.scatter_lambert(&vertex, &lambert, evaluated, sampler, counts),
                None if DIFFUSE_ONLY => break,
                None => {
                    throughput *= self.disperse(&mut vertex, sampler);
                    let bsdf = Bsdf::at(&self.scene, &vertex.point, vertex.direction, vertex.medium, vertex.channel);
                    self.scatter(&vertex, &bsdf, evaluated, sampler, counts)
                }
            };
            radiance += throughput * direct;
            let Some(scattered) = scattered else { break };
            evaluated = Events::ALL;
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
            let scattered = if scattered.passes { Scattered { arrival, ..scattered } } else { scattered };
            let followed = self.follow(&vertex, &scattered, throughput, eta2, max_depth, sampler, counts);
            radiance += followed.gathered;
            (throughput, arrival) = (followed.throughput, followed.arrival);
            match followed.met {
                Met::Surface(next) => vertex = next,
                Met::Nothing { radiance: escaped } => {
                    radiance += throughput * escaped;
                    break;
                }
            }
        }
        radiance
    }

    /// Traces a scattered ray to the next surface, or out of the scene; `throughput` is that of the path with the
    /// ray's own weight.
    #[allow(clippy::too_many_arguments)]
    #[inline]
    pub(crate) fn follow(
        &self,
        from: &Vertex,
        scattered: &Scattered,
        throughput: Vec3,
        eta2: f32,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Followed {
        let Scattered { ray, medium, arrival, .. } = *scattered;
        let (channel, segments) = (from.channel, from.segments + u32::from(!scattered.passes));
        if self.has_media {
            let departure = Departure { ray, medium, arrival, segments, channel, throughput, eta2 };
            return self.travel(departure, max_depth, sampler, counts);
        }
        let (through, met) = match self.surface_along(&ray, self.salt(sampler)) {
            None => {
                let weight = self.weight_of_escape(ray.direction, arrival);
                let radiance = weight * self.scene.environment.radiance(ray.direction);
                (medium.transmittance(f32::INFINITY), Met::Nothing { radiance })
            }
            Some((point, distance)) => {
                let vertex = Vertex { point, direction: ray.direction, medium, segments, channel };
                (medium.transmittance(distance), Met::Surface(vertex))
            }
        };
        Followed { gathered: Vec3::ZERO, throughput: throughput * through, arrival, met, scattered: false }
    }

    /// Chooses the colour that a path follows from here on, where the surface refracts colours differently;
    /// the factor that makes up for the others.
    pub(crate) fn disperse(&self, vertex: &mut Vertex, sampler: &mut Sampler) -> Vec3 {
        let disperses = || self.scene.materials[vertex.point.material as usize].surface.is_dispersive();
        if !self.has_dispersion || vertex.channel.is_some() || !disperses() {
            return Vec3::ONE;
        }
        let (channel, mask) = match (3.0 * sampler.value()) as u32 {
            0 => (Channel::Red, Vec3::X),
            1 => (Channel::Green, Vec3::Y),
            _ => (Channel::Blue, Vec3::Z),
        };
        vertex.channel = Some(channel);
        3.0 * mask
    }

    /// Emission towards the ray that met the vertex, with its weight against next-event estimation.
    pub(crate) fn emitted(&self, vertex: &Vertex, arrival: Arrival) -> Vec3 {
        let emission = emission(&self.scene, &vertex.point, vertex.direction);
        match arrival {
            Arrival::Drawn { from, pdf } if emission != Vec3::ZERO => {
                emission * balance(pdf, self.lights.pdf_of_emitter(from, &vertex.point))
            }
            _ => emission,
        }
    }

    /// Weight of the environment against drawing it.
    pub(super) fn weight_of_escape(&self, direction: Vec3, arrival: Arrival) -> f32 {
        match arrival {
            Arrival::Drawn { pdf, .. } => balance(pdf, self.lights.pdf_of_environment(direction)),
            Arrival::Certain => 1.0,
        }
    }

    /// One sample of the light that comes straight from the lights by the evaluated lobes, and the next ray: of
    /// a sharp event by its Fresnel weight, or of a lobe.
    pub(crate) fn scatter(
        &self,
        vertex: &Vertex,
        bsdf: &Bsdf,
        evaluated: Events,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> (Vec3, Option<Scattered>) {
        let evaluated = evaluated.within(self.simulated);
        let lobes = evaluated.lobes.filter(|&lobes| bsdf.has(lobes));
        let Some(lobes) = lobes else {
            let sharp = bsdf.sharp().and_then(|boundary| scatter_sharp(vertex, boundary, evaluated, sampler, counts));
            return (Vec3::ZERO, sharp);
        };
        let sharp = bsdf.sharp().map_or(0.0, |boundary| albedo_of_sharp(boundary, evaluated));
        let of_lobes = if sharp > 0.0 { bsdf.albedo(lobes) / (bsdf.albedo(lobes) + sharp) } else { 1.0 };
        let part = LobesOf { bsdf, lobes };
        let direct = self.direct_light(vertex, &part, of_lobes, sampler, counts);
        let choice = if sharp > 0.0 { sampler.value() } else { 0.0 };
        let scattered = match bsdf.sharp().filter(|_| choice >= of_lobes) {
            Some(boundary) => {
                let scattered = scatter_sharp(vertex, boundary, evaluated, sampler, counts);
                scattered.map(|scattered| Scattered { weight: scattered.weight / (1.0 - of_lobes), ..scattered })
            }
            None => self.scatter_lobes(vertex, &part, of_lobes, sampler, counts),
        };
        (direct, scattered)
    }

    /// [`PathTracer::scatter`] at a surface that does nothing but Lambert reflection.
    fn scatter_lambert(
        &self,
        vertex: &Vertex,
        lambert: &Lambert,
        evaluated: Events,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> (Vec3, Option<Scattered>) {
        if lambert.is_black() || !evaluated.lobes.is_some_and(|lobes| lobes.diffuse) {
            return (Vec3::ZERO, None);
        }
        let direct = self.direct_light(vertex, lambert, 1.0, sampler, counts);
        (direct, self.scatter_lobes(vertex, lambert, 1.0, sampler, counts))
    }

    /// A direction drawn from lobes that are chosen with the probability `of_lobes`.
    pub(crate) fn scatter_lobes(
        &self,
        vertex: &Vertex,
        lobes: &impl Scatters,
        of_lobes: f32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Option<Scattered> {
        let glossy = lobes.is_glossy();
        if !self.simulated.interreflection && !glossy {
            return None;
        }
        let choice = if glossy { sampler.value() } else { 0.0 };
        let sample = lobes.sample(choice, sampler.pair())?;
        *(if glossy { &mut counts.glossy } else { &mut counts.diffuse }) += 1;
        Some(Scattered {
            ray: vertex.point.leave(sample.direction),
            weight: sample.weight / of_lobes,
            medium: sample.medium,
            arrival: Arrival::Drawn { from: vertex.point.position, pdf: of_lobes * sample.pdf },
            eta2: sample.eta2,
            passes: false,
        })
    }

    /// One sample of the light that `lobes` send back straight from the lights, weighted against meeting them by
    /// drawing from the lobes with the probability `of_lobes`.
    pub(crate) fn direct_light(
        &self,
        vertex: &Vertex,
        lobes: &impl Scatters,
        of_lobes: f32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Vec3 {
        if self.lights.is_empty() {
            return Vec3::ZERO;
        }
        let Some(light) = self.lights.draw(&self.scene, &vertex.point, sampler.pair()) else {
            return Vec3::ZERO;
        };
        let reflected = lobes.evaluate(light.direction);
        if reflected.value == Vec3::ZERO {
            return Vec3::ZERO;
        }
        counts.shadow += 1;
        let ray = Ray { origin: light.origin, direction: light.direction };
        let medium = lobes.medium_towards(light.direction);
        let through = if self.has_media {
            self.light_along(&ray, light.distance * SHADOW_END, medium, sampler)
        } else if self.is_occluded(&ray, light.distance * SHADOW_END, self.salt(sampler)) {
            return Vec3::ZERO;
        } else {
            medium.transmittance(light.distance)
        };
        let mis = light.pdf.map_or(1.0, |pdf| balance(pdf, of_lobes * reflected.pdf));
        reflected.value * light.weight * through * mis
    }
}

/// How much of the light the evaluated sharp events send on: 0 to 1.
fn albedo_of_sharp(boundary: &Boundary, evaluated: Events) -> f32 {
    let reflected = boundary.reflectance * boundary.reflected_factor;
    let reflected = if evaluated.reflect { reflected.max_element() } else { 0.0 };
    let refracted = boundary.refracted.filter(|_| evaluated.refract);
    let refracted = refracted.map_or(0.0, |refracted| {
        ((Vec3::ONE - boundary.reflectance) * refracted.factor).max_element() * refracted.eta * refracted.eta
    });
    (reflected + refracted).min(1.0)
}

/// One of the sharp events that are evaluated here, by its Fresnel weight.
fn scatter_sharp(
    vertex: &Vertex,
    boundary: &Boundary,
    evaluated: Events,
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
    let mut passes = false;
    let (direction, weight, medium, eta2) = match refracted.filter(|_| choice >= probability_of_reflection) {
        None => {
            counts.reflect += 1;
            let weight = boundary.reflectance * boundary.reflected_factor / probability_of_reflection;
            (boundary.reflected, weight, vertex.medium, 1.0)
        }
        Some(refracted) => {
            counts.refract += 1;
            passes = refracted.passes(vertex.medium);
            let weight = (Vec3::ONE - boundary.reflectance) * refracted.factor / (1.0 - probability_of_reflection);
            (refracted.direction, weight, refracted.medium, refracted.eta * refracted.eta)
        }
    };
    Some(Scattered { ray: vertex.point.leave(direction), weight, medium, arrival: Arrival::Certain, eta2, passes })
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
