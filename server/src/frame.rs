//! Ray-tree frames: what is streamed.
//!
//! Fourth stage of the server: integrator -> frame -> encode. All samples of a pixel go through its centre,
//! since depth, normal and optical boundary of a pixel must belong to its colour. So the specular chain of a
//! pixel (root, reflected, refracted, ... in the plan's order) is traced once and only the radiance of each
//! of its surfaces is sampled.
//!
//! A node holds what its surface sends back apart from the specular events that have a node of their own;
//! those that have none are baked into it, with their Fresnel weight. A child's radiance is multiplied by
//! what lies on its way and does not depend on the view: filters, absorption, the 1/eta^2 of refraction,
//! over the whole chain from the root; never by Fresnel, which the client applies for the pose it shows.

mod cached;

pub use cached::LiveFrames;

use crate::accel::Ray;
use crate::counters::{Counters, RayCounts};
use crate::integrator::sampler::Sampler;
use crate::integrator::{Boundary, Medium, PathTracer, SpecularEvents, Vertex, interface_of};
use crate::scene::Scene;
use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;
use warplight_protocol::frame::{
    Arrival, Interfaces, MAX_INTERFACES, MAX_NODES, NodeRows, Plan, Tree, TreeRows, UNDEFINED,
};
use warplight_protocol::optics::Interface;
use warplight_protocol::{Camera, Pose};

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
    /// Samples per pixel and node.
    pub spp: u32,
    /// Longest path in segments: 1 shows lights only, 2 direct light.
    pub max_depth: u32,
    /// Seed of all randomness.
    pub seed: u64,
}

/// Renders frames of one scene.
#[derive(Debug)]
pub struct FrameRenderer {
    tracer: PathTracer,
    interfaces: Interfaces,
    /// Pixel value of each material's boundary, from outside and from inside; 0 where it has none.
    interface_of_material: Vec<[u8; 2]>,
}

/// The surface that a node of a pixel shows.
#[derive(Clone, Copy)]
struct Link {
    vertex: Vertex,
    boundary: Option<Boundary>,
    /// What lies on the way from the root and does not depend on the view.
    factor: Vec3,
    /// Length of the way from the eye.
    path_m: f32,
}

/// The ray that a node of a pixel follows.
struct Segment {
    ray: Ray,
    medium: Medium,
    factor: Vec3,
    segments: u32,
    /// Length of the way to its start.
    path_m: f32,
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
        let (interfaces, interface_of_material) = interfaces_of(&scene);
        FrameRenderer { tracer: PathTracer::new(scene), interfaces, interface_of_material }
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
        let eye = Eye::new(&request.render_pose, request.camera);
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
                    Some(Segment { ray, medium: Medium::AIR, factor: Vec3::ONE, segments: 1, path_m: 0.0 })
                }
                arrival => chain[usize::from(step.parent)].as_ref().and_then(|parent| parent.follow(arrival, counts)),
            };
            let segment = segment.filter(|segment| segment.segments <= request.max_depth);
            let (distance, radiance, link) = match segment {
                None => (UNDEFINED, Vec3::ZERO, None),
                Some(segment) => match self.tracer.surface_along(&segment.ray) {
                    None => {
                        let through = segment.factor * segment.medium.transmittance(f32::INFINITY);
                        (f32::INFINITY, through * self.scene().environment.radiance(segment.ray.direction), None)
                    }
                    Some((point, distance)) => {
                        let direction = segment.ray.direction;
                        let link = Link {
                            vertex: Vertex { point, direction, medium: segment.medium, segments: segment.segments },
                            boundary: Boundary::at(self.scene(), &point, direction),
                            factor: segment.factor * segment.medium.transmittance(distance),
                            path_m: segment.path_m + distance,
                        };
                        let radiance = radiance_of(&link, node, counts);
                        // A distance that rounds to zero would read as undefined.
                        (distance.max(f32::MIN_POSITIVE), radiance, Some(link))
                    }
                },
            };
            rows.distance[offset] = distance;
            for (channel, value) in rows.radiance.iter_mut().zip(radiance.to_array()) {
                channel[offset] = value;
            }
            if !rows.interface.is_empty() {
                let boundary = link.as_ref().and_then(|link| self.interface_at(link));
                let (interface, normal_in_view) =
                    boundary.map_or((0, Vec3::ZERO), |(index, normal)| (index, eye.view_from_world(normal)));
                rows.interface[offset] = interface;
                for (axis, value) in rows.normal.iter_mut().zip(normal_in_view.to_array()) {
                    axis[offset] = value;
                }
            }
            chain[node] = link;
        }
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
        let certain = link
            .boundary
            .is_some_and(|boundary| !evaluated.reflect && (!evaluated.refract || boundary.refracted.is_none()));
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

    /// The specular events of a surface that have no node of their own.
    fn baked_events(&self, request: &FrameRequest, link: &Link, node: usize) -> SpecularEvents {
        // A boundary that no pixel value stands for has no children: all is baked.
        let shown = |arrival| self.interface_at(link).is_some() && request.plan.child(node, arrival).is_some();
        SpecularEvents { reflect: !shown(Arrival::Reflected), refract: !shown(Arrival::Refracted) }
    }

    /// Pixel value and normal in world of a node's boundary.
    fn interface_at(&self, link: &Link) -> Option<(u8, Vec3)> {
        let boundary = link.boundary.as_ref()?;
        let from_inside = link.vertex.direction.dot(link.vertex.point.geometric_normal) >= 0.0;
        let index = self.interface_of_material[link.vertex.point.material as usize][usize::from(from_inside)];
        (index > 0).then_some((index, boundary.normal))
    }
}

impl Link {
    /// The ray that arrives here by reflection or refraction, if there is one.
    fn follow(&self, arrival: Arrival, counts: &mut RayCounts) -> Option<Segment> {
        let boundary = self.boundary.as_ref()?;
        let segments = self.vertex.segments + 1;
        match arrival {
            Arrival::Direct => None,
            Arrival::Reflected => {
                counts.reflect += 1;
                let ray = self.vertex.point.leave(boundary.reflected);
                Some(Segment {
                    ray,
                    medium: self.vertex.medium,
                    factor: self.factor * boundary.reflected_factor,
                    segments,
                    path_m: self.path_m,
                })
            }
            Arrival::Refracted => {
                let refracted = boundary.refracted?;
                counts.refract += 1;
                let ray = self.vertex.point.leave(refracted.direction);
                let factor = self.factor * refracted.factor;
                Some(Segment { ray, medium: refracted.medium, factor, segments, path_m: self.path_m })
            }
        }
    }
}

/// The eye of a picture, in the tracer's precision.
pub(crate) struct Eye {
    position: Vec3,
    world_from_view: Mat3,
    camera: Camera,
}

impl Eye {
    pub(crate) fn new(pose: &Pose, camera: Camera) -> Eye {
        let world_from_view = glam::DMat3::from_quat(pose.orientation.normalize()).as_mat3();
        Eye { position: pose.position.as_vec3(), world_from_view, camera }
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
}

/// The distinct optical boundaries of a scene's materials and, for each material, their pixel values from
/// outside and from inside. Those beyond [`MAX_INTERFACES`] get no value: their reflections are baked.
fn interfaces_of(scene: &Scene) -> (Interfaces, Vec<[u8; 2]>) {
    let mut interfaces: Vec<Interface> = Vec::new();
    let mut pixel_value = |interface: Interface| {
        if let Some(known) = interfaces.iter().position(|&known| known == interface) {
            return (known + 1) as u8;
        }
        if interfaces.len() == MAX_INTERFACES || !interface.is_valid() {
            return 0;
        }
        interfaces.push(interface);
        interfaces.len() as u8
    };
    let of_materials = scene.materials.iter().map(|material| {
        [true, false].map(|from_outside| interface_of(&material.surface, from_outside).map_or(0, &mut pixel_value))
    });
    let of_materials = of_materials.collect();
    (Interfaces(interfaces), of_materials)
}

#[cfg(test)]
mod tests;
