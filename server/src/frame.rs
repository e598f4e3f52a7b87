//! Ray-tree frames: what is streamed.
//!
//! Fourth stage of the server: integrator -> frame -> encode. All samples of a pixel go through its centre,
//! since depth, normal and optical boundary of a pixel must belong to its colour. So the specular chain of a
//! pixel (root, reflected, refracted, ... in the plan's order) is traced once and only the radiance of each
//! of its surfaces is sampled.
//!
//! A node holds what its surface sends back apart from the specular events that have a node of their own;
//! those that have none are baked into it, with their Fresnel weight. So are the lobes of rough surfaces; but
//! where a surface is nearly smooth, or refracts colours differently, its lobes go to the nodes, too: such a
//! node shows the place where a smooth boundary's ray ends, with the radiance of all of the lobe's rays over
//! the boundary's weight, and has no children of its own. A child's radiance is multiplied by
//! what lies on its way and does not depend on the view: filters, absorption, the 1/eta^2 of refraction,
//! over the whole chain from the root; never by Fresnel, which the client applies for the pose it shows.

mod cached;
mod glossy;
mod media;
mod rest;
mod sentinels;

pub use cached::LiveFrames;
pub use media::MediaInView;

use media::Media;

use crate::accel::{Ray, SurfacePoint};
use crate::bsdf::{Boundary, Bsdf, DIFFUSE_ONLY, Enclosure, Lobes, interface_of};
use crate::counters::{Counters, RayCounts};
use crate::effects::Simulated;
use crate::integrator::sampler::Sampler;
use crate::integrator::{Departure, Events, PathTracer, Vertex};
use crate::scene::{Origins, Scene, Surface};
use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use warplight_protocol::curvature::ShapeOperator;
use warplight_protocol::frame::{
    Arrival, Interfaces, MAX_INTERFACES, MAX_NODES, NodeRows, Plan, Tree, TreeRows, UNDEFINED, VolumeFormat,
    VolumeRange,
};
use warplight_protocol::optics::Interface;
use warplight_protocol::{Camera, Pose, Timestamp};

/// Rows rendered and handed on together: a strip of the encoder.
pub const BAND_ROWS: u32 = 32;

/// What to render.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameRequest {
    /// world_from_view of the frame.
    pub render_pose: Pose,
    /// Its camera.
    pub camera: Camera,
    /// Its nodes.
    pub plan: Plan,
    /// Its layers of volume, if it has any.
    pub volume: Option<LayersRequest>,
    /// Samples per pixel and node.
    pub spp: u32,
    /// Longest path in segments: 1 shows lights only, 2 direct light.
    pub max_depth: u32,
    /// Seed of all randomness.
    pub seed: u64,
}

/// Which layers of volume to render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayersRequest {
    /// How many, and how they are cut.
    pub format: VolumeFormat,
    /// Where they are: of [`crate::march::MediaBounds`], for the pose.
    pub range: VolumeRange,
    /// Where the layering is optimal: by the plain program, which takes its time and has more candidates.
    pub exactly: bool,
}

impl FrameRequest {
    fn layers(&self) -> usize {
        self.volume.map_or(0, |volume| usize::from(volume.format.layers))
    }
}

/// Renders frames of one scene.
#[derive(Debug)]
pub struct FrameRenderer {
    tracer: PathTracer,
    interfaces: Interfaces,
    origins: Origins,
    version: SceneVersion,
    media: Media,
}

/// Which scene a renderer shows, and which of its states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SceneVersion {
    /// Differs between renderers.
    scene: u64,
    /// Counts the times that anything has moved.
    state: u64,
    /// When it was that things were where they are.
    time: Timestamp,
}

impl SceneVersion {
    /// Whether the other is the same scene with things elsewhere.
    fn has_moved_to(&self, other: &SceneVersion) -> bool {
        self.scene == other.scene && self.state != other.state
    }

    /// Time to the other, in seconds.
    fn secs_to(&self, other: &SceneVersion) -> f32 {
        (other.time.max(self.time).since(other.time.min(self.time))).as_secs_f32()
    }

    /// Whether nothing has moved in between.
    fn shows_what(&self, other: &SceneVersion) -> bool {
        (self.scene, self.state) == (other.scene, other.state)
    }
}

/// Renderers made so far.
static RENDERERS: AtomicU64 = AtomicU64::new(0);

/// What a node of a pixel shows.
#[derive(Clone, Copy)]
struct Link {
    /// Where its radiance is evaluated: the surface it shows, or its parent's where that is not quite sharp.
    vertex: Vertex,
    /// What its radiance holds if nothing of it has a node of its own.
    events: Events,
    boundary: Option<Edge>,
    /// What lies on the way from the root and does not depend on the view.
    factor: Vec3,
    /// Length of the way from the eye.
    path_m: f32,
}

/// The boundary whose events may have nodes.
#[derive(Clone, Copy)]
struct Edge {
    boundary: Boundary,
    /// Whether a lobe stands for reflection and for refraction, instead of one ray.
    lobe: bool,
    /// Whether colours are refracted differently.
    dispersive: bool,
    /// Whether the surface scatters by lobes, too.
    has_lobes: bool,
    /// Pixel value of the boundary's interface; 0 where none stands for it.
    interface: u8,
}

/// The ray that a node of a pixel follows.
struct Segment {
    ray: Ray,
    medium: Enclosure,
    factor: Vec3,
    segments: u32,
    /// Length of the way to its start.
    path_m: f32,
    /// Where its radiance is evaluated, if not at the surface it meets: of what, and over which weight.
    blurred: Option<(Vertex, Events, Vec3)>,
}

/// What media do to light on a segment.
#[derive(Clone, Copy)]
struct Way {
    /// What is left of it.
    left: Vec3,
    /// What they send and scatter, with the factor of the segment.
    gathered: Vec3,
}

/// What the nodes of a pixel show, filled from the root on: a parent is there before its children.
type Chain = [Option<Link>; MAX_NODES];

/// A pixel of the image, and the same within its band.
#[derive(Clone, Copy)]
struct PixelOfBand {
    pixel: usize,
    offset: usize,
}

/// Pixels of a band in square tiles, so that rays and cells that are used one after the other are near.
fn tiled(width: u32, rows: u32) -> impl Iterator<Item = usize> {
    const TILE: u32 = 8;
    let tiles =
        move |extent: u32| (0..extent).step_by(TILE as usize).map(move |start| start..(start + TILE).min(extent));
    tiles(rows).flat_map(move |tile_rows| {
        tiles(width).flat_map(move |columns| {
            let tile_rows = tile_rows.clone();
            tile_rows.flat_map(move |row| columns.clone().map(move |column| (row * width + column) as usize))
        })
    })
}

impl FrameRenderer {
    /// Makes a scene ready.
    pub fn new(scene: Arc<Scene>) -> FrameRenderer {
        FrameRenderer::limited(scene, Simulated::ALL)
    }

    /// One that follows some events only.
    pub fn limited(scene: Arc<Scene>, simulated: Simulated) -> FrameRenderer {
        let version =
            SceneVersion { scene: RENDERERS.fetch_add(1, Ordering::Relaxed), state: 0, time: Timestamp::ZERO };
        let (interfaces, origins) = (interfaces_of(&scene), Origins::of(&scene));
        let tracer = PathTracer::limited(scene, simulated);
        let media = Media::new(&tracer);
        let mut renderer = FrameRenderer { interfaces, origins, tracer, version, media };
        renderer.move_to(Timestamp::ZERO);
        renderer
    }

    /// Moves what moves to where it is at an instant. Nothing is done in a scene in which nothing moves.
    pub fn move_to(&mut self, time: Timestamp) {
        let secs = time.since(Timestamp::ZERO).as_secs_f64();
        let origins = &self.origins;
        if self.moves() && self.tracer.change(|scene| origins.place(scene, secs)) {
            self.version.state += 1;
            self.media.forget_light();
        }
        self.version.time = time;
    }

    /// Whether anything in the scene ever moves.
    pub fn moves(&self) -> bool {
        !self.scene().motions.is_empty()
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        self.tracer.scene()
    }

    /// The path tracer behind the frames, for pictures of the same scene.
    pub fn tracer(&self) -> &PathTracer {
        &self.tracer
    }

    /// The optical boundaries of the scene's materials, as pixels name them.
    pub fn interfaces(&self) -> &Interfaces {
        &self.interfaces
    }

    /// Renders a frame into `tree`, whose memory is reused. Each band of [`BAND_ROWS`] rows is given to
    /// `on_band` by the worker that has finished it, in no order.
    pub fn render(
        &self,
        request: &FrameRequest,
        tree: &mut Tree,
        counters: &Counters,
        on_band: &(dyn Fn(&TreeRows<'_>) + Sync),
    ) {
        tree.reset(request.render_pose, request.camera, &request.plan, &self.interfaces);
        tree.set_layers(request.layers());
        let view = self.media_in_view(&request.render_pose, request.camera);
        let eye = view.eye();
        tree.bands_mut(BAND_ROWS).into_par_iter().for_each(|mut band| {
            let mut counts = RayCounts::default();
            let first = (band.rows.start * request.camera.size.width) as usize;
            let mut chain: Chain = [None; MAX_NODES];
            for offset in tiled(request.camera.size.width, band.rows.len() as u32) {
                let at = PixelOfBand { pixel: first + offset, offset };
                self.trace_pixel(request, &eye, at, &mut band.nodes, &mut chain, &mut counts, |link, node, counts| {
                    link.factor * self.surface_radiance(request, link, node, at.pixel, counts)
                });
            }
            view.march_band(request, &mut band, &mut counts);
            counters.add(&counts);
            on_band(&band);
        });
    }

    /// Follows the specular chain of a pixel and writes all its planes. `radiance_of` gives the radiance of a
    /// surface that a node shows.
    #[allow(clippy::too_many_arguments)]
    fn trace_pixel(
        &self,
        request: &FrameRequest,
        eye: &Eye,
        PixelOfBand { pixel, offset }: PixelOfBand,
        rows: &mut [NodeRows<'_>],
        chain: &mut Chain,
        counts: &mut RayCounts,
        mut radiance_of: impl FnMut(&Link, usize, &mut RayCounts) -> Vec3,
    ) {
        for (node, rows) in rows.iter_mut().enumerate() {
            let step = &request.plan.nodes()[node];
            let segment = match step.arrival {
                Arrival::Direct => {
                    counts.primary += 1;
                    let ray = eye.ray_through_centre(pixel);
                    Some(Segment {
                        ray,
                        medium: eye.inside,
                        factor: Vec3::ONE,
                        segments: 1,
                        path_m: 0.0,
                        blurred: None,
                    })
                }
                arrival if !DIFFUSE_ONLY && self.is_simulated(arrival) => {
                    chain[usize::from(step.parent)].as_ref().and_then(|parent| parent.follow(arrival, counts))
                }
                _ => None,
            };
            let segment = segment.filter(|segment| segment.segments <= request.max_depth);
            let (distance, radiance, link) = match segment {
                None => (UNDEFINED, Vec3::ZERO, None),
                Some(mut segment) => {
                    let (met, way) = self.meet(request, &mut segment, pixel * MAX_NODES + node, counts);
                    let distance = met.map_or(f32::INFINITY, |(_, distance)| distance);
                    match self.link(&segment, met.map(|(point, _)| point), distance, way.left) {
                        None => {
                            let through = segment.factor * way.left;
                            let sky = self.scene().environment.radiance(segment.ray.direction);
                            (distance, through * sky + way.gathered, None)
                        }
                        Some(link) => {
                            let radiance = radiance_of(&link, node, counts) + way.gathered;
                            // A distance that rounds to zero would read as undefined.
                            (distance.max(f32::MIN_POSITIVE), radiance, Some(link))
                        }
                    }
                }
            };
            rows.distance[offset] = distance;
            for (channel, value) in rows.radiance.iter_mut().zip(radiance.to_array()) {
                channel[offset] = value;
            }
            if !rows.interface.is_empty() {
                let edge = link.and_then(|link| link.boundary).filter(|edge| edge.interface > 0);
                let (interface, normal_in_view) =
                    edge.map_or((0, Vec3::ZERO), |edge| (edge.interface, eye.view_from_world(edge.boundary.normal)));
                rows.interface[offset] = interface;
                for (axis, value) in rows.normal.iter_mut().zip(normal_in_view.to_array()) {
                    axis[offset] = value;
                }
                // Nodes that no quadric is needed of have no such planes.
                if !rows.shape[0].is_empty() {
                    let shape = link.filter(|_| interface > 0).map_or(ShapeOperator::FLAT, |link| {
                        eye.shape_in_view(self.scene(), &link.vertex.point, normal_in_view)
                    });
                    for (entry, value) in rows.shape.iter_mut().zip(shape.to_array()) {
                        entry[offset] = value;
                    }
                }
            }
            chain[node] = link;
        }
    }

    /// The eye of a pose, and what it is inside of.
    fn eye_at(&self, pose: &Pose, camera: Camera) -> Eye {
        let eye = Eye::new(self.scene(), pose, camera);
        Eye { inside: self.tracer.enclosure_at(eye.position), ..eye }
    }

    /// The first real surface on a segment, whose medium becomes that before the surface, and what media do to light
    /// on the way. Those on the eye's own segment are for layers of volume to show, and do nothing to the root; without
    /// layers it shows them itself.
    fn meet(
        &self,
        request: &FrameRequest,
        segment: &mut Segment,
        stream: usize,
        counts: &mut RayCounts,
    ) -> (Option<(SurfacePoint, f32)>, Way) {
        if !self.tracer.has_media {
            let met = self.tracer.surface_along(&segment.ray, 0);
            let left = segment.medium.transmittance(met.map_or(f32::INFINITY, |(_, distance)| distance));
            return (met, Way { left, gathered: Vec3::ZERO });
        }
        let before = segment.medium;
        let passed = self.tracer.pass_media(&segment.ray, before, f32::INFINITY, |_| {});
        segment.medium = passed.medium;
        let met = passed.surface.map(|point| (point, passed.distance));
        let mut way = Way { left: Vec3::ONE, gathered: Vec3::ZERO };
        // A lobe's samples go through the media on their own.
        if (segment.segments > 1 || request.volume.is_none()) && segment.blurred.is_none() {
            let (arrival, segments) = (crate::integrator::Arrival::Certain, segment.segments);
            let (ray, throughput) = (segment.ray, segment.factor);
            let departure = Departure { ray, medium: before, arrival, segments, channel: None, throughput, eta2: 1.0 };
            let spp = request.spp.max(1);
            (way.left, way.gathered) = (Vec3::ZERO, Vec3::ZERO);
            for index in 0..spp {
                // Other numbers than those of the surface.
                let mut sampler = Sampler::new(!request.seed, stream as u64, index);
                let (left, gathered) =
                    self.tracer.on_the_way(departure, passed.distance, request.max_depth, &mut sampler, counts);
                way.left += left / spp as f32;
                way.gathered += gathered / spp as f32;
            }
        }
        (met, way)
    }

    /// What a node shows whose ray meets `point`; `None` where it shows the environment.
    fn link(&self, segment: &Segment, point: Option<SurfacePoint>, distance: f32, left: Vec3) -> Option<Link> {
        if let Some((vertex, events, over)) = segment.blurred {
            let path_m = segment.path_m + if point.is_some() { distance } else { 0.0 };
            return Some(Link { vertex, events, boundary: None, factor: segment.factor / over, path_m });
        }
        let direction = segment.ray.direction;
        let point = point?;
        let vertex = Vertex { point, direction, medium: segment.medium, segments: segment.segments, channel: None };
        let (factor, path_m) = (segment.factor * left, segment.path_m + distance);
        if matches!(self.scene().materials[point.material as usize].surface, Surface::Diffuse { .. }) {
            // It has no boundary, and needs no lobes to be told so.
            return Some(Link { vertex, events: Events::ALL, boundary: None, factor, path_m });
        }
        let bsdf = Bsdf::at(self.scene(), &point, direction, segment.medium, None);
        let dispersive = self.scene().materials[point.material as usize].surface.is_dispersive();
        let edge = |boundary: &Boundary, lobe| Edge {
            boundary: *boundary,
            lobe,
            dispersive,
            has_lobes: bsdf.has(Lobes::ALL),
            interface: self.pixel_value_of(&boundary.interface),
        };
        Some(Link {
            vertex,
            events: Events::ALL,
            boundary: bsdf
                .sharp()
                .map(|boundary| edge(boundary, false))
                .or_else(|| bsdf.nearly_sharp().map(|boundary| edge(boundary, true))),
            factor,
            path_m,
        })
    }

    /// Mean over the samples of what a node's surface sends back by itself.
    fn surface_radiance(
        &self,
        request: &FrameRequest,
        link: &Link,
        node: usize,
        pixel: usize,
        counts: &mut RayCounts,
    ) -> Vec3 {
        let evaluated = self.baked_events(request, link, node);
        // Without anything random left one sample says it all.
        let certain = link.boundary.is_some_and(|edge| {
            !edge.lobe
                && !evaluated.reflect
                && (!evaluated.refract || edge.boundary.refracted.is_none())
                && !edge.has_lobes
        });
        let spp = if certain { 1 } else { request.spp.max(1) };
        let stream = (pixel * MAX_NODES + node) as u64;
        let (mut sum, mut kept) = (DVec3::ZERO, 0);
        for index in 0..spp {
            let mut sampler = Sampler::new(request.seed, stream, index);
            let radiance = self.tracer.outgoing(link.vertex, evaluated, request.max_depth, &mut sampler, counts);
            if radiance.is_finite() {
                sum += radiance.as_dvec3();
                kept += 1;
            } else {
                counts.dropped += 1;
            }
        }
        (sum / f64::from(kept.max(1))).as_vec3()
    }

    fn is_simulated(&self, arrival: Arrival) -> bool {
        match arrival {
            Arrival::Direct => true,
            Arrival::Reflected => self.tracer.simulated.reflection,
            Arrival::Refracted => self.tracer.simulated.refraction,
        }
    }

    /// The events of a surface that have no node of their own.
    fn baked_events(&self, request: &FrameRequest, link: &Link, node: usize) -> Events {
        // A boundary that no pixel value stands for has no children: all is baked.
        let has_interface = link.boundary.is_some_and(|edge| edge.interface > 0);
        let shown = |arrival| has_interface && request.plan.child(node, arrival).is_some();
        let (reflect, refract) = (!shown(Arrival::Reflected), !shown(Arrival::Refracted));
        match link.boundary {
            None => link.events,
            Some(Edge { lobe: false, .. }) => Events { reflect, refract, ..link.events },
            Some(Edge { lobe: true, .. }) => {
                let lobes = link.events.lobes.map(|lobes| Lobes { reflected: reflect, refracted: refract, ..lobes });
                Events { lobes, ..link.events }
            }
        }
    }

    /// The pixel value that stands for an interface; 0 where the frame does not name it.
    fn pixel_value_of(&self, interface: &Interface) -> u8 {
        let index = self.interfaces.0.iter().position(|known| known == interface);
        index.map_or(0, |index| index as u8 + 1)
    }
}

impl Link {
    /// The ray that arrives here by reflection or refraction, if there is one.
    fn follow(&self, arrival: Arrival, counts: &mut RayCounts) -> Option<Segment> {
        const NOTHING: Events = Events { emission: false, reflect: false, refract: false, lobes: None };
        let Edge { boundary, lobe, dispersive, .. } = self.boundary.as_ref()?;
        let (direction, medium, factor, over, blurred) = match arrival {
            Arrival::Direct => return None,
            Arrival::Reflected => {
                counts.reflect += 1;
                let lobes = Lobes::REFLECTED;
                let blurred = lobe.then_some(Events { lobes: Some(lobes), ..NOTHING });
                let over = boundary.reflectance;
                (boundary.reflected, self.vertex.medium, boundary.reflected_factor, over, blurred)
            }
            Arrival::Refracted => {
                let refracted = boundary.refracted?;
                counts.refract += 1;
                let lobes = Lobes::REFRACTED;
                let blurred = match (lobe, dispersive) {
                    (true, _) => Some(Events { lobes: Some(lobes), ..NOTHING }),
                    (false, true) => Some(Events { refract: true, ..NOTHING }),
                    (false, false) => None,
                };
                (refracted.direction, refracted.medium, refracted.factor, Vec3::ONE - boundary.reflectance, blurred)
            }
        };
        let factor = if blurred.is_some() { self.factor } else { self.factor * factor };
        // Where the boundary's weight is next to nothing, so is what the client makes of this node.
        let blurred = blurred.map(|events| (self.vertex, events, over.max(Vec3::splat(MIN_WEIGHT))));
        let segments = self.vertex.segments + 1;
        let ray = self.vertex.point.leave(direction);
        Some(Segment { ray, medium, factor, segments, path_m: self.path_m, blurred })
    }
}

/// Least weight that the radiance of a blurred node is divided by: a thousandth is below what 8 bits show.
const MIN_WEIGHT: f32 = 1e-3;

/// The eye of a picture, in the tracer's precision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Eye {
    position: Vec3,
    world_from_view: Mat3,
    camera: Camera,
    /// The media around it; air unless it was asked for.
    inside: Enclosure,
}

impl Eye {
    /// The tracer's space is the world about the scene's origin.
    pub(crate) fn new(scene: &Scene, pose: &Pose, camera: Camera) -> Eye {
        let world_from_view = glam::DMat3::from_quat(pose.orientation.normalize()).as_mat3();
        Eye { position: (pose.position - scene.origin).as_vec3(), world_from_view, camera, inside: Enclosure::AIR }
    }

    /// Where it is.
    pub(crate) fn position(&self) -> Vec3 {
        self.position
    }

    /// The ray through a position of the image.
    pub(crate) fn ray_through(&self, pixel: glam::Vec2) -> Ray {
        let direction = (self.world_from_view * self.camera.ray_in_view(pixel)).normalize();
        Ray { origin: self.position, direction }
    }

    /// The ray through the centre of a pixel, counted row by row.
    pub(crate) fn ray_through_centre(&self, index: usize) -> Ray {
        self.ray_through(self.camera.size.pixel_centre(index))
    }

    fn view_from_world(&self, direction: Vec3) -> Vec3 {
        self.world_from_view.transpose() * direction
    }

    /// How the surface at a point bends, in the basis of this normal on the side that is seen.
    fn shape_in_view(&self, scene: &Scene, point: &SurfacePoint, normal_in_view: Vec3) -> ShapeOperator {
        let view_from_world = self.world_from_view.transpose();
        let outside_in_view = view_from_world * point.geometric_normal;
        let side = if outside_in_view.dot(normal_in_view) < 0.0 { -1.0 } else { 1.0 };
        let gradient_in_view = view_from_world * point.normal_gradient(scene) * self.world_from_view;
        ShapeOperator::of_gradient(normal_in_view, side * gradient_in_view)
    }
}

/// The distinct optical boundaries of a scene's materials. Those beyond [`MAX_INTERFACES`] are left out: their
/// reflections are baked.
fn interfaces_of(scene: &Scene) -> Interfaces {
    let mut interfaces: Vec<Interface> = Vec::new();
    for material in &scene.materials {
        for interface in [true, false].into_iter().filter_map(|outside| interface_of(&material.surface, outside)) {
            if interface.is_valid() && interfaces.len() < MAX_INTERFACES && !interfaces.contains(&interface) {
                interfaces.push(interface);
            }
        }
    }
    Interfaces(interfaces)
}

#[cfg(test)]
mod cube_tests;
#[cfg(test)]
mod media_tests;
#[cfg(test)]
mod tests;
