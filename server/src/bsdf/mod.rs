//! What a surface does with light at one point, seen along one ray.
//!
//! Between accel and integrator: a material's parameters are looked up at the point (textures, sides), and the
//! answer is a [`Bsdf`]: a sharp part, whose rays are certain ([`Boundary`], nodes of a ray tree), and lobes,
//! which have a density and can be evaluated, drawn from, and weighted against drawing lights.
//!
//! Directions point away from the surface, but for the direction of the ray that met it. What is evaluated has
//! the cosine in it. Which side of the surface a direction is on says the geometric normal, its value the
//! shading normal; the two never let light through an opaque surface.
//!
//! One file for each behaviour: [`lambert`], [`boundary`] (all that is smooth), [`conductor`], [`dielectric`],
//! [`thin`] (panes), [`standard`] (glTF's metal and plastic); below them the facets of rough surfaces
//! ([`microfacet`]), what a finish says of them at a point ([`roughness`]), the energy that they lose
//! ([`energy`], [`transmission`]), and what a filter needs to know of them ([`gloss`]).
//!
//! Cost: one is made at every surface that a path meets. A Lambert surface is done after its albedo; the
//! others pay for their own lobes only.

mod boundary;
mod conductor;
mod dielectric;
mod enclosure;
mod energy;
mod erf;
mod gloss;
mod lambert;
mod lobes;
mod microfacet;
mod roughness;
mod standard;
#[cfg(test)]
mod tests;
mod thin;
mod transmission;

pub(crate) use boundary::{Boundary, interface_of};
pub(crate) use enclosure::{Enclosure, MAX_MEDIA};
pub(crate) use gloss::Gloss;
#[cfg(test)]
pub(crate) use lambert::pdf_cosine;
pub(crate) use lambert::{Lambert, sample_cosine, tangents};
pub(crate) use lobes::{Evaluated, Lobes, LobesOf, Scatters};

use crate::accel::SurfacePoint;
use crate::scene::{Distribution, Finish, Scene, Surface};
use conductor::RoughConductor;
use dielectric::RoughDielectric;
use glam::{Vec2, Vec3};
use microfacet::Facets;
use roughness::{facets_at, is_narrow};
use standard::Layers;
use thin::RoughPane;
use warplight_protocol::optics::Interface;

/// The colour that a path follows after light has been dispersed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Channel {
    Red,
    Green,
    Blue,
}

/// A surface as one ray sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bsdf {
    glossy: Glossy,
    /// What the surface would be if it were smooth, where it is smooth or nearly so.
    boundary: Option<Boundary>,
    is_sharp: bool,
    /// Part of the irradiance over pi that scattering below the surface sends back along the ray.
    diffuse: Vec3,
    /// Shading normal on the side that the ray met.
    normal: Vec3,
    geometric_normal: Vec3,
    /// The frame of the facets, and in it the direction that the surface is seen from.
    frame: Frame,
    wo: Vec3,
    medium: Enclosure,
    /// Behind the surface.
    beyond: Enclosure,
    /// Squared relative index behind the surface.
    eta2: f32,
}

/// The lobes of facets.
#[derive(Clone, Copy, Debug)]
enum Glossy {
    None,
    Conductor(RoughConductor),
    Dielectric(RoughDielectric),
    Pane(RoughPane),
    Standard(Layers),
}

/// Orthonormal axes in world; z is the normal.
#[derive(Clone, Copy, Debug)]
struct Frame {
    x: Vec3,
    y: Vec3,
    z: Vec3,
}

impl Frame {
    const WORLD: Frame = Frame { x: Vec3::X, y: Vec3::Y, z: Vec3::Z };

    /// About a normal, with x along `axis` as far as it can be.
    fn new(normal: Vec3, axis: Option<Vec3>) -> Frame {
        match axis.and_then(|axis| axis.reject_from_normalized(normal).try_normalize()) {
            Some(x) => Frame { x, y: normal.cross(x), z: normal },
            None => {
                let (x, y) = tangents(normal);
                Frame { x, y, z: normal }
            }
        }
    }

    fn local(&self, world: Vec3) -> Vec3 {
        Vec3::new(world.dot(self.x), world.dot(self.y), world.dot(self.z))
    }

    fn world(&self, local: Vec3) -> Vec3 {
        local.x * self.x + local.y * self.y + local.z * self.z
    }
}

/// A direction drawn from the lobes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LobeSample {
    pub(crate) direction: Vec3,
    /// What [`Bsdf::evaluate`] gives for it over its density.
    pub(crate) weight: Vec3,
    /// Over solid angle, among the lobes that count.
    pub(crate) pdf: f32,
    /// The medium it runs through.
    pub(crate) medium: Enclosure,
    /// Squared relative index of the medium entered; 1 on the same side.
    pub(crate) eta2: f32,
}

/// Whether this is the build that knows diffuse surfaces alone, to measure what the others cost scenes without them.
pub(crate) const DIFFUSE_ONLY: bool = cfg!(feature = "diffuse-only");

/// Makes what is looked up for a scene's surfaces, so that no path has to wait for it.
pub(crate) fn prepare(scene: &Scene) {
    for material in &scene.materials {
        let is_rough = |finish: &Finish| !finish.is_smooth();
        match &material.surface {
            Surface::Conductor { finish, .. } | Surface::ThinDielectric { finish, .. } if is_rough(finish) => {
                energy::prepare(finish.distribution);
            }
            Surface::Dielectric { ior, dispersion, finish, .. } if is_rough(finish) && finish.compensated => {
                for channel in [Channel::Red, Channel::Green, Channel::Blue] {
                    let index = boundary::index_of(*ior, *dispersion, Some(channel));
                    transmission::prepare(finish.distribution, index);
                    transmission::prepare(finish.distribution, 1.0 / index);
                }
            }
            Surface::Standard(standard) => {
                if is_rough(&standard.finish) {
                    energy::prepare(standard.finish.distribution);
                }
                if standard.coat.is_some_and(|coat| coat.alpha.most() > 0.0) {
                    energy::prepare(Distribution::Ggx);
                }
            }
            _ => {}
        }
    }
}

impl Bsdf {
    /// The surface at `point` for a ray in `direction` that ran through `medium`. Where colours are refracted
    /// differently, `channel` says which counts; without one it is the middle.
    pub(crate) fn at(
        scene: &Scene,
        point: &SurfacePoint,
        direction: Vec3,
        medium: Enclosure,
        channel: Option<Channel>,
    ) -> Bsdf {
        let material = &scene.materials[point.material as usize];
        let from_outside = direction.dot(point.geometric_normal) < 0.0;
        let mut bsdf = Bsdf::black(point, direction, medium);
        if material.one_sided && !from_outside && is_opaque(&material.surface) {
            return bsdf;
        }
        let textures = &scene.textures;
        if DIFFUSE_ONLY {
            if let Surface::Diffuse { albedo } = &material.surface {
                bsdf.diffuse = albedo.at(textures, point.uv);
            }
            return bsdf;
        }
        match &material.surface {
            Surface::Diffuse { albedo } => bsdf.diffuse = albedo.at(textures, point.uv),
            Surface::Mirror { filter } => {
                let normal = bsdf.usable_normal(direction, &Interface::Mirror);
                bsdf.boundary = Some(Boundary::new(Interface::Mirror, normal, direction, *filter, None));
            }
            Surface::Null => {
                let interface = Interface::Pane { eta: 1.0 };
                bsdf.beyond = medium.across(material, from_outside);
                let through = Some((Vec3::ONE, bsdf.beyond));
                bsdf.boundary = Some(Boundary::new(interface, bsdf.geometric_normal, direction, Vec3::ONE, through));
            }
            Surface::Conductor { eta, k, filter, finish } => {
                let interface = boundary::conductor(*eta, *k);
                let filter = filter.at(textures, point.uv);
                let (facets, axis) = facets_at(scene, finish, point);
                let mu = bsdf.look(direction, &interface, axis);
                if let Some(facets) = facets {
                    bsdf.glossy = Glossy::Conductor(RoughConductor::new(finish, facets, interface, filter, mu));
                }
                bsdf.set_boundary(facets, |normal| Boundary::new(interface, normal, direction, filter, None));
            }
            Surface::Dielectric { ior, dispersion, filter, absorption, finish } => {
                let interface = boundary::dielectric(*ior, *dispersion, from_outside, channel);
                let Interface::Dielectric { eta } = interface else { return bsdf };
                let filter = filter.at(textures, point.uv);
                bsdf.beyond =
                    if from_outside { medium.within(material, *absorption) } else { medium.without(material) };
                bsdf.eta2 = eta * eta;
                let (facets, axis) = facets_at(scene, finish, point);
                let facets = facets.filter(|facets| dielectric::is_rough(facets, *ior));
                let mu = bsdf.look(direction, &interface, axis);
                if let Some(facets) = facets {
                    bsdf.glossy = Glossy::Dielectric(RoughDielectric::new(finish, facets, eta, filter, mu));
                }
                let through = Some((filter, bsdf.beyond));
                bsdf.set_boundary(facets, |normal| Boundary::new(interface, normal, direction, Vec3::ONE, through));
            }
            Surface::ThinDielectric { ior, filter, finish } => {
                let interface = Interface::Pane { eta: *ior };
                let filter = filter.at(textures, point.uv);
                let (facets, axis) = facets_at(scene, finish, point);
                let mu = bsdf.look(direction, &interface, axis);
                if let Some(facets) = facets {
                    bsdf.glossy = Glossy::Pane(RoughPane::new(finish, facets, *ior, filter, mu));
                }
                bsdf.beyond = medium.across(material, from_outside);
                let through = Some((filter, bsdf.beyond));
                bsdf.set_boundary(facets, |normal| Boundary::new(interface, normal, direction, Vec3::ONE, through));
            }
            Surface::Standard(standard) => {
                let interface = boundary::interface_of_standard(standard);
                let (facets, axis) = facets_at(scene, &standard.finish, point);
                let mu = bsdf.look(direction, &interface, axis);
                let layers = Layers::new(scene, standard, point, facets, mu);
                bsdf.diffuse = layers.diffuse();
                let sharp = layers.sharp();
                bsdf.is_sharp = sharp.is_some();
                bsdf.beyond = medium.across(material, from_outside);
                let beyond = bsdf.beyond;
                bsdf.boundary = sharp.or_else(|| layers.nearly_sharp()).map(|(reflected, through)| {
                    layers_as_boundary(interface, bsdf.frame.z, direction, reflected, through, beyond)
                });
                bsdf.glossy = Glossy::Standard(layers);
            }
        }
        bsdf
    }

    /// Sets the frame of facets, and the direction that they are seen from; returns its cosine.
    fn look(&mut self, direction: Vec3, interface: &Interface, axis: Option<Vec3>) -> f32 {
        /// A ray within the plane of the surface is as good as this far above it: what is divided by the cosine
        /// stays finite.
        const LEAST_COSINE: f32 = 1e-6;
        self.frame = Frame::new(self.usable_normal(direction, interface), axis);
        self.wo = self.frame.local(-direction);
        self.wo.z = self.wo.z.max(LEAST_COSINE);
        self.wo.z.min(1.0)
    }

    fn usable_normal(&self, direction: Vec3, interface: &Interface) -> Vec3 {
        boundary::usable_normal(direction, self.normal, self.geometric_normal, interface)
    }

    fn set_boundary(&mut self, facets: Option<Facets>, boundary: impl FnOnce(Vec3) -> Boundary) {
        self.is_sharp = facets.is_none();
        self.boundary = facets.is_none_or(|facets| is_narrow(facets.alpha)).then(|| boundary(self.frame.z));
    }

    /// Nothing but its normals.
    fn black(point: &SurfacePoint, direction: Vec3, medium: Enclosure) -> Bsdf {
        let side = if direction.dot(point.geometric_normal) < 0.0 { 1.0 } else { -1.0 };
        Bsdf {
            glossy: Glossy::None,
            boundary: None,
            is_sharp: true,
            diffuse: Vec3::ZERO,
            normal: side * point.shading_normal,
            geometric_normal: side * point.geometric_normal,
            frame: Frame::WORLD,
            wo: Vec3::Z,
            medium,
            beyond: medium,
            eta2: 1.0,
        }
    }

    /// Events whose direction is certain.
    pub(crate) fn sharp(&self) -> Option<&Boundary> {
        self.boundary.as_ref().filter(|_| self.is_sharp && !DIFFUSE_ONLY)
    }

    /// The boundary that stands for the [`Lobes::REFLECTED`] and [`Lobes::REFRACTED`] of a surface that is rough
    /// by [`roughness::SHARP_ALPHA`] at most, as if it were smooth. A node that shows one of them, with the geometry of
    /// this boundary's ray, holds what the lobe makes of the light over the boundary's weight
    /// (`reflectance`, or 1 - `reflectance`). `None` where the surface has sharp events or is rougher.
    pub(crate) fn nearly_sharp(&self) -> Option<&Boundary> {
        self.boundary.as_ref().filter(|_| !self.is_sharp && !DIFFUSE_ONLY)
    }

    /// What Lambert reflection makes of irradiance over pi, on average over where it comes from.
    pub(crate) fn diffuse(&self) -> Vec3 {
        self.diffuse
    }

    /// Whether any of these lobes is there.
    pub(crate) fn has(&self, lobes: Lobes) -> bool {
        let [diffuse, glossy] = self.weights(lobes);
        diffuse > 0.0 || glossy > 0.0
    }

    /// About how much of the light these lobes send on, for choosing between them and sharp events: 0 to 1.
    pub(crate) fn albedo(&self, lobes: Lobes) -> f32 {
        let [diffuse, glossy] = self.weights(lobes);
        (diffuse + glossy).min(1.0)
    }

    /// By what Lambert reflection and facets are chosen.
    fn weights(&self, lobes: Lobes) -> [f32; 2] {
        let diffuse = if lobes.have(Lobes::DIFFUSE) { self.diffuse.max_element() } else { 0.0 };
        let glossy = match &self.glossy {
            _ if DIFFUSE_ONLY => 0.0,
            Glossy::None => 0.0,
            Glossy::Conductor(lobe) => lobe.albedo(lobes),
            Glossy::Dielectric(lobe) => lobe.albedo(lobes),
            Glossy::Pane(lobe) => lobe.albedo(lobes),
            Glossy::Standard(lobe) => lobe.albedo(lobes),
        };
        [diffuse, glossy]
    }

    /// The lobes' value times the cosine for light that comes from the unit direction `towards`, and its density over
    /// solid angle in [`Bsdf::sample`].
    pub(crate) fn evaluate(&self, towards: Vec3, lobes: Lobes) -> Evaluated {
        let side = towards.dot(self.geometric_normal);
        let [diffuse, glossy] = self.weights(lobes);
        if glossy <= 0.0 {
            // Lambert alone: what most surfaces are.
            if diffuse <= 0.0 {
                return Evaluated::NOTHING;
            }
            return self.evaluate_diffuse(towards, side);
        }
        let wi = self.frame.local(towards);
        let mut sum = Evaluated::NOTHING;
        // Light from behind the surface by one normal and from before it by the other is none.
        if side * wi.z > 0.0 {
            let part = match &self.glossy {
                Glossy::None => Evaluated::NOTHING,
                Glossy::Conductor(lobe) => lobe.evaluate(self.wo, wi, lobes),
                Glossy::Dielectric(lobe) => lobe.evaluate(self.wo, wi, lobes),
                Glossy::Pane(lobe) => lobe.evaluate(self.wo, wi, lobes),
                Glossy::Standard(lobe) => lobe.evaluate(self.wo, wi, lobes),
            };
            sum.add(part.value, glossy * part.pdf);
        }
        if diffuse > 0.0 {
            let part = self.evaluate_diffuse(towards, side);
            sum.add(part.value, diffuse * part.pdf);
        }
        sum.over(diffuse + glossy)
    }

    fn evaluate_diffuse(&self, towards: Vec3, side: f32) -> Evaluated {
        let pdf = lambert::pdf_cosine(self.normal, towards);
        if side <= 0.0 {
            return Evaluated { value: Vec3::ZERO, pdf };
        }
        let factor = match &self.glossy {
            Glossy::Standard(layers) => layers.diffuse_factor(self.frame.z.dot(towards).max(0.0)),
            _ => Vec3::ONE,
        };
        Evaluated { value: self.diffuse * factor * pdf, pdf }
    }

    /// Draws where light may come from, by `choice` among the lobes; `None` where the draw sends no light.
    pub(crate) fn sample(&self, choice: f32, u: Vec2, lobes: Lobes) -> Option<LobeSample> {
        let [diffuse, glossy] = self.weights(lobes);
        let both = diffuse + glossy;
        if both <= 0.0 {
            return None;
        }
        let chosen = choice * both;
        let direction = if chosen < diffuse {
            sample_cosine(self.normal, u)
        } else {
            // Rounding must not take the choice to 1.
            let choice = ((chosen - diffuse) / glossy).clamp(0.0, 1.0 - f32::EPSILON);
            let wi = match &self.glossy {
                Glossy::None => None,
                Glossy::Conductor(lobe) => lobe.sample(self.wo, choice, u, lobes),
                Glossy::Dielectric(lobe) => lobe.sample(self.wo, choice, u, lobes),
                Glossy::Pane(lobe) => lobe.sample(self.wo, choice, u, lobes),
                Glossy::Standard(lobe) => lobe.sample(self.wo, choice, u, lobes),
            }?;
            self.frame.world(wi).try_normalize()?
        };
        let Evaluated { value, pdf } = self.evaluate(direction, lobes);
        let weight = value / pdf;
        let behind = direction.dot(self.geometric_normal) < 0.0;
        (value != Vec3::ZERO && weight.is_finite()).then_some(LobeSample {
            direction,
            weight,
            pdf,
            medium: if behind { self.beyond } else { self.medium },
            eta2: if behind { self.eta2 } else { 1.0 },
        })
    }

    /// The medium that light from `towards` runs through, on its way to this surface.
    pub(crate) fn medium_towards(&self, towards: Vec3) -> Enclosure {
        if towards.dot(self.geometric_normal) < 0.0 { self.beyond } else { self.medium }
    }
}

/// The boundary that reflects and lets through these fractions for this very ray, whatever the interface would.
fn layers_as_boundary(
    interface: Interface,
    normal: Vec3,
    direction: Vec3,
    reflected: Vec3,
    through: Vec3,
    medium: Enclosure,
) -> Boundary {
    /// A ray so grazing that a pane lets less than this through sees a little less than there is.
    const LEAST: f32 = 1e-4;
    let mut boundary = Boundary::new(interface, normal, direction, Vec3::ONE, Some((Vec3::ONE, medium)));
    boundary.reflected_factor = reflected / boundary.reflectance.max(Vec3::splat(LEAST));
    let factor = through / (Vec3::ONE - boundary.reflectance).max(Vec3::splat(LEAST));
    boundary.refracted = boundary
        .refracted
        .filter(|_| through != Vec3::ZERO)
        .map(|refracted| boundary::Refracted { factor, ..refracted });
    boundary
}

/// Whether light goes neither through nor past the surface, so that it has a back that may be black.
fn is_opaque(surface: &Surface) -> bool {
    match surface {
        Surface::Diffuse { .. } | Surface::Mirror { .. } | Surface::Conductor { .. } => true,
        Surface::Standard(standard) => standard.transmission.most() <= 0.0,
        Surface::Dielectric { .. } | Surface::ThinDielectric { .. } | Surface::Null => false,
    }
}
