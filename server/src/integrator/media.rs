//! A path between two surfaces, where there may be media: what scatters it on its way, and what it meets then.
//!
//! Surfaces of `Surface::Null` change the medium and nothing else; they are no segments of the path, and shadow
//! rays go through them. So do smooth panes that bound a medium, which the bsdf weights: what goes straight
//! through one counts as no segment either. (Mitsuba counts alike: its depth leaves null events out.) At a
//! scattering point one light is drawn and one direction by the phase function, weighted against each other by
//! the balance heuristic; a point is a vertex like one on a surface, and takes a segment of the path.
//!
//! Russian roulette within a medium is by throughput alone: a cap as at surfaces would make paths in thick white
//! media, which end by leaving them, ever rarer and ever brighter.
//!
//! Limits: light that refraction bends into a medium is found by chance only.

use super::PathTracer;
use super::boundaries::{MAX_PASSED, beyond};
use super::cutouts::lets_through;
use super::flight::{self, Carried, fly};
use super::path::{Arrival, Met, ROULETTE_AFTER, Scattered, Vertex};
use super::sampler::Sampler;
use crate::accel::{Ray, SurfacePoint};
use crate::bsdf::{Bsdf, Channel, Enclosure, Evaluated, LobeSample, Scatters};
use crate::counters::RayCounts;
use crate::volume::{Medium, Phase};
use glam::{Vec2, Vec3};

/// A ray that leaves a vertex, and the path before it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Departure {
    pub(crate) ray: Ray,
    pub(crate) medium: Enclosure,
    pub(crate) arrival: Arrival,
    /// Of the vertex that it will meet.
    pub(crate) segments: u32,
    pub(crate) channel: Option<Channel>,
    pub(crate) throughput: Vec3,
    /// Product of the squared indices of the media entered.
    pub(crate) eta2: f32,
}

/// What became of a path between two surfaces.
pub(crate) struct Followed {
    /// Radiance from the media on the way, with the path's throughput in it.
    pub(crate) gathered: Vec3,
    pub(crate) throughput: Vec3,
    pub(crate) arrival: Arrival,
    pub(crate) met: Met,
    /// Whether it was scattered on its way.
    pub(crate) scattered: bool,
}

/// A phase function and the direction of travel that it deflects.
#[derive(Clone, Copy, Debug)]
struct Deflection {
    phase: Phase,
    direction: Vec3,
    medium: Enclosure,
}

impl Scatters for Deflection {
    fn evaluate(&self, towards: Vec3) -> Evaluated {
        let pdf = self.phase.density(self.direction.dot(towards));
        Evaluated { value: Vec3::splat(pdf), pdf }
    }

    fn sample(&self, _choice: f32, u: Vec2) -> Option<LobeSample> {
        let direction = self.phase.sample(self.direction, u);
        let pdf = self.phase.density(self.direction.dot(direction));
        Some(LobeSample { direction, weight: Vec3::ONE, pdf, medium: self.medium, eta2: 1.0 })
    }

    fn is_glossy(&self) -> bool {
        false
    }

    fn medium_towards(&self, _towards: Vec3) -> Enclosure {
        self.medium
    }
}

impl PathTracer {
    /// Follows a ray through media, scattered as often as it may be, to the next surface or out of the scene.
    #[inline(never)]
    pub(super) fn travel(
        &self,
        departure: Departure,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Followed {
        let Departure { mut ray, mut medium, mut arrival, mut segments, channel, throughput, eta2 } = departure;
        let mut carried = Carried { throughput, gathered: Vec3::ZERO };
        let mut scattered = false;
        let mut passed = 0;
        let ended = |carried: Carried, arrival, scattered, met| {
            let Carried { gathered, throughput } = carried;
            Followed { gathered, throughput, arrival, met, scattered }
        };
        loop {
            let hit = self.accel.closest(&ray);
            let distance = hit.map_or(f32::INFINITY, |hit| hit.distance);
            match self.innermost(medium) {
                None => carried.throughput *= medium.transmittance(distance),
                Some(within) => {
                    if let Some(at) = fly(within, &ray, distance, &mut carried, sampler) {
                        // Scatter: light from the lights, and a new direction.
                        let nothing = Met::Nothing { radiance: Vec3::ZERO };
                        if segments >= max_depth || carried.throughput == Vec3::ZERO {
                            return ended(carried, arrival, true, nothing);
                        }
                        scattered = true;
                        let deflection = Deflection { phase: within.phase, direction: ray.direction, medium };
                        let vertex = point_in_medium(ray.at(at), &ray, medium, segments, channel);
                        let direct = self.direct_light(&vertex, &deflection, 1.0, sampler, counts);
                        carried.gathered += carried.throughput * direct;
                        let Some(next) = self.scatter_in_medium(&vertex, &deflection, sampler, counts) else {
                            return ended(carried, arrival, true, nothing);
                        };
                        if segments >= ROULETTE_AFTER {
                            let survival = carried.throughput.max_element() * eta2;
                            if survival < 1.0 {
                                if sampler.value() >= survival {
                                    return ended(carried, arrival, true, nothing);
                                }
                                carried.throughput /= survival;
                            }
                        }
                        (ray, arrival) = (next.ray, next.arrival);
                        segments += 1;
                        continue;
                    }
                }
            }
            let Some(hit) = hit else {
                let weight = self.weight_of_escape(ray.direction, arrival);
                let radiance = weight * self.scene.environment.radiance(ray.direction);
                return ended(carried, arrival, scattered, Met::Nothing { radiance });
            };
            let point = SurfacePoint::at(&self.scene, &ray, &hit);
            if passed < MAX_PASSED && lets_through(&self.scene, &ray, &hit, &point, self.salt(sampler)) {
                passed += 1;
                medium = beyond(&self.scene, medium, &point, ray.direction);
                ray = point.leave(ray.direction);
                continue;
            }
            let vertex = Vertex { point, direction: ray.direction, medium, segments, channel };
            return ended(carried, arrival, scattered, Met::Surface(vertex));
        }
    }

    fn scatter_in_medium(
        &self,
        vertex: &Vertex,
        deflection: &Deflection,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Option<Scattered> {
        let sample = deflection.sample(0.0, sampler.pair())?;
        counts.scatter += 1;
        let arrival = Arrival::Drawn { from: vertex.point.position, pdf: sample.pdf };
        let ray = Ray { origin: vertex.point.position, direction: sample.direction };
        Some(Scattered { ray, weight: Vec3::ONE, medium: deflection.medium, arrival, eta2: 1.0, passes: false })
    }

    /// What media and their boundaries leave of light that comes along a ray from `distance`; zero where a surface
    /// stops it.
    #[inline(never)]
    pub(super) fn light_along(&self, ray: &Ray, distance: f32, medium: Enclosure, sampler: &mut Sampler) -> Vec3 {
        let (mut ray, mut remaining, mut medium) = (*ray, distance, medium);
        let mut left = Vec3::ONE;
        for _ in 0..MAX_PASSED {
            let hit = self.accel.closest(&ray).filter(|hit| hit.distance < remaining);
            let hit = match hit {
                None => None,
                Some(hit) => {
                    let point = SurfacePoint::at(&self.scene, &ray, &hit);
                    if lets_through(&self.scene, &ray, &hit, &point, self.salt(sampler)) {
                        let medium = beyond(&self.scene, medium, &point, ray.direction);
                        Some((hit.distance, point, medium, Vec3::ONE))
                    } else {
                        let Some((through, medium)) = self.straight_through(&point, ray.direction, medium) else {
                            return Vec3::ZERO;
                        };
                        Some((hit.distance, point, medium, through))
                    }
                }
            };
            let end = hit.as_ref().map_or(remaining, |(distance, ..)| *distance);
            left *= match self.innermost(medium) {
                None => medium.transmittance(end),
                Some(within) => flight::transmittance(within, &ray, 0.0..end, sampler),
            };
            let Some((at, point, next, through)) = hit else { return left };
            left *= through;
            if left == Vec3::ZERO {
                return left;
            }
            medium = next;
            ray = point.leave(ray.direction);
            remaining -= at;
        }
        Vec3::ZERO
    }

    /// What a smooth pane that bounds a medium lets straight through, and into what.
    fn straight_through(&self, point: &SurfacePoint, direction: Vec3, medium: Enclosure) -> Option<(Vec3, Enclosure)> {
        if !self.scene.materials[point.material as usize].bounds_medium() || !self.simulated.refraction {
            return None;
        }
        let bsdf = Bsdf::at(&self.scene, point, direction, medium, None);
        let boundary = bsdf.sharp()?;
        let refracted = boundary.refracted.filter(|refracted| refracted.passes(medium))?;
        Some(((Vec3::ONE - boundary.reflectance) * refracted.factor, refracted.medium))
    }

    /// One sample of the mean over all directions of the radiance that arrives at a point of a medium, after any number of
    /// events up to `max_depth` segments, of which the one from the eye to the point is the first. Times its albedo that is
    /// what the medium scatters isotropically.
    pub(crate) fn incident_mean(
        &self,
        point: Vec3,
        medium: u32,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> Vec3 {
        if max_depth < 2 {
            return Vec3::ZERO;
        }
        // One body alone leaves no doubt of what is around the point.
        let is_alone = self.scene.media.len() == 1;
        let around = if is_alone { Enclosure::medium(medium) } else { self.enclosure_at(point) };
        let inside = if around.innermost() == Some(medium) { around } else { Enclosure::medium(medium) };
        let deflection = Deflection { phase: Phase::ISOTROPIC, direction: Vec3::Y, medium: inside };
        let ray = Ray { origin: point, direction: Vec3::Y };
        let vertex = point_in_medium(point, &ray, inside, 1, None);
        let direct = self.direct_light(&vertex, &deflection, 1.0, sampler, counts);
        let Some(next) = self.scatter_in_medium(&vertex, &deflection, sampler, counts) else { return direct };
        let departure = Departure {
            ray: next.ray,
            medium: inside,
            arrival: next.arrival,
            segments: 2,
            channel: None,
            throughput: Vec3::ONE,
            eta2: 1.0,
        };
        direct + self.incident(departure, max_depth, sampler, counts)
    }

    /// What media make of the first segment of a node's ray, up to a surface at `distance`, which may be infinite:
    /// the transmittance, and one sample of the light that they send and scatter.
    pub(crate) fn on_the_way(
        &self,
        departure: Departure,
        distance: f32,
        max_depth: u32,
        sampler: &mut Sampler,
        counts: &mut RayCounts,
    ) -> (Vec3, Vec3) {
        let left = self.light_along(&departure.ray, distance * (1.0 - 1e-5), departure.medium, sampler);
        let followed = self.travel(departure, max_depth, sampler, counts);
        let mut radiance = followed.gathered;
        if followed.scattered {
            radiance += self.arriving(followed, departure.eta2, max_depth, sampler, counts);
        }
        (left, radiance)
    }

    /// The innermost medium of the scene's.
    #[inline]
    fn innermost(&self, medium: Enclosure) -> Option<&Medium> {
        medium.innermost().and_then(|index| self.scene.media.get(index as usize))
    }
}

/// A vertex without a surface.
fn point_in_medium(position: Vec3, ray: &Ray, medium: Enclosure, segments: u32, channel: Option<Channel>) -> Vertex {
    let point = SurfacePoint {
        position,
        geometric_normal: -ray.direction,
        shading_normal: -ray.direction,
        uv: Vec2::ZERO,
        material: 0,
        primitive: u32::MAX,
        offset_m: 0.0,
    };
    Vertex { point, direction: ray.direction, medium, segments, channel }
}

#[cfg(test)]
pub(crate) mod tests;
