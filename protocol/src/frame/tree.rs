//! The ray tree in memory: structure-of-arrays planes per node, in floats.
//!
//! The server fills one, the codec quantises and packs it in strips of rows, and the client unpacks the
//! strips into another of the same shape, whose values are the quantised ones.

use super::Plan;
use super::layers::{self, LayerPlanes, LayerRows, MAX_LAYERS};
use crate::curvature::ShapeOperator;
use crate::optics::Interface;
use crate::{Camera, Pose};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Distance of a pixel that its node does not know: no such ray, or nothing it could show.
pub const UNDEFINED: f32 = 0.0;

/// Most optical boundaries a frame may name.
pub const MAX_INTERFACES: usize = 255;

/// The optical boundaries a frame shows; pixel value `i > 0` stands for entry `i - 1`, 0 for none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Interfaces(pub Vec<Interface>);

impl Interfaces {
    /// The boundary of a pixel value.
    pub fn at(&self, index: u8) -> Option<&Interface> {
        usize::from(index).checked_sub(1).and_then(|entry| self.0.get(entry))
    }

    /// Bits that hold every pixel value.
    pub fn bits(&self) -> usize {
        (usize::BITS - self.0.len().leading_zeros()) as usize
    }
}

/// Planes of one node, one value per pixel, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NodePlanes {
    /// Linear RGB radiance that arrives at the parent along the ray, pre-multiplied by what does not
    /// depend on the view (filter colours, absorption, the squared-index scaling of refraction), never
    /// by Fresnel.
    pub radiance: [Vec<f32>; 3],
    /// Distance from the parent's point (root: from the eye) along the ray, in metres; infinite where the
    /// ray leaves the scene, [`UNDEFINED`] where the node knows nothing.
    pub distance: Vec<f32>,
    /// Index of the optical boundary in [`Interfaces`], 0 for none; empty for a node without children.
    pub interface: Vec<u8>,
    /// Unit normal in the view space of the render pose, on the side the ray comes from; meaningful only
    /// where there is an interface, empty for a node without children.
    pub normal: [Vec<f32>; 3],
    /// Entries s11, s12, s22 of the surface's [`crate::curvature::ShapeOperator`] in the basis of its normal, per metre;
    /// meaningful only where there is an interface, empty for the root, for a node without children, and in a frame
    /// whose format has none.
    pub shape: [Vec<f32>; 3],
}

impl NodePlanes {
    fn resize(&mut self, pixels: usize, has_children: bool, has_shape: bool) {
        for channel in &mut self.radiance {
            channel.resize(pixels, 0.0);
        }
        self.distance.resize(pixels, UNDEFINED);
        let inner = if has_children { pixels } else { 0 };
        self.interface.resize(inner, 0);
        for axis in &mut self.normal {
            axis.resize(inner, 0.0);
        }
        for entry in &mut self.shape {
            entry.resize(if has_shape { pixels } else { 0 }, 0.0);
        }
    }

    /// Radiance of a pixel.
    pub fn radiance_at(&self, pixel: usize) -> glam::Vec3 {
        glam::Vec3::new(self.radiance[0][pixel], self.radiance[1][pixel], self.radiance[2][pixel])
    }

    /// Sets the radiance of a pixel.
    pub fn set_radiance(&mut self, pixel: usize, radiance: glam::Vec3) {
        for (channel, value) in self.radiance.iter_mut().zip(radiance.to_array()) {
            channel[pixel] = value;
        }
    }

    /// Normal of a pixel, in view.
    pub fn normal_at(&self, pixel: usize) -> glam::Vec3 {
        glam::Vec3::new(self.normal[0][pixel], self.normal[1][pixel], self.normal[2][pixel])
    }

    /// Shape operator of a pixel, in the basis of its normal; `None` where the planes have none.
    pub fn shape_at(&self, pixel: usize) -> Option<ShapeOperator> {
        let [s11, s12, s22] = &self.shape;
        Some(ShapeOperator { s11: *s11.get(pixel)?, s12: *s12.get(pixel)?, s22: *s22.get(pixel)? })
    }

    /// Sets the shape operator of a pixel, in the basis of its normal; nothing where the planes have none.
    pub fn set_shape(&mut self, pixel: usize, shape: ShapeOperator) {
        for (entries, value) in self.shape.iter_mut().zip(shape.to_array()) {
            if let Some(entry) = entries.get_mut(pixel) {
                *entry = value;
            }
        }
    }

    /// Sets the normal of a pixel, in view.
    pub fn set_normal(&mut self, pixel: usize, normal_in_view: glam::Vec3) {
        for (axis, value) in self.normal.iter_mut().zip(normal_in_view.to_array()) {
            axis[pixel] = value;
        }
    }
}

/// A ray tree and the pose it was rendered for.
#[derive(Clone, Debug, PartialEq)]
pub struct Tree {
    /// world_from_view of the picture.
    pub render_pose: Pose,
    /// Its camera.
    pub camera: Camera,
    /// Its nodes.
    pub plan: Plan,
    /// The optical boundaries its pixels name.
    pub interfaces: Interfaces,
    /// Planes, one set per node of the plan.
    pub nodes: Vec<NodePlanes>,
    /// The volume before the root's surface, one set of planes per segment of a pixel; empty where there is none.
    pub layers: Vec<LayerPlanes>,
}

impl Tree {
    /// An empty tree of this shape, without layers: every pixel undefined.
    pub fn new(render_pose: Pose, camera: Camera, plan: Plan, interfaces: Interfaces) -> Tree {
        let mut tree = Tree { render_pose, camera, plan, interfaces, nodes: Vec::new(), layers: Vec::new() };
        tree.allocate(true);
        tree
    }

    /// Takes on a new shape, reusing the memory; the contents are left as they fall, and as many layers as there were.
    pub fn reset(&mut self, render_pose: Pose, camera: Camera, plan: &Plan, interfaces: &Interfaces) {
        self.reset_with(render_pose, camera, plan, interfaces, true);
    }

    /// Gives the tree so many layers, at most [`MAX_LAYERS`]; their contents are left as they fall.
    pub fn set_layers(&mut self, count: usize) {
        self.layers.resize_with(count.min(MAX_LAYERS), LayerPlanes::default);
        let pixels = self.camera.size.pixels();
        self.layers.iter_mut().for_each(|layer| layer.resize(pixels));
    }

    /// The same as [`Tree::reset`], with shape operators or without.
    pub(crate) fn reset_with(
        &mut self,
        render_pose: Pose,
        camera: Camera,
        plan: &Plan,
        interfaces: &Interfaces,
        has_shapes: bool,
    ) {
        self.render_pose = render_pose;
        self.camera = camera;
        self.plan.clone_from(plan);
        self.interfaces.clone_from(interfaces);
        self.allocate(has_shapes);
    }

    fn allocate(&mut self, has_shapes: bool) {
        let pixels = self.camera.size.pixels();
        self.nodes.resize_with(self.plan.nodes().len(), NodePlanes::default);
        for (index, planes) in self.nodes.iter_mut().enumerate() {
            let has_children = self.plan.has_children(index);
            planes.resize(pixels, has_children, has_shapes && has_children && index > 0);
        }
        self.layers.iter_mut().for_each(|layer| layer.resize(pixels));
    }
}

/// Some rows of one node's planes, to be written.
#[derive(Debug)]
pub struct NodeRows<'a> {
    /// See [`NodePlanes::radiance`].
    pub radiance: [&'a mut [f32]; 3],
    /// See [`NodePlanes::distance`].
    pub distance: &'a mut [f32],
    /// See [`NodePlanes::interface`].
    pub interface: &'a mut [u8],
    /// See [`NodePlanes::normal`].
    pub normal: [&'a mut [f32]; 3],
    /// See [`NodePlanes::shape`].
    pub shape: [&'a mut [f32]; 3],
}

/// A band of whole rows through all nodes of a tree; the first pixel of every slice is the first pixel
/// of row `rows.start`.
#[derive(Debug)]
pub struct TreeRows<'a> {
    /// The rows of the image.
    pub rows: Range<u32>,
    /// The nodes, in the order of the plan.
    pub nodes: Vec<NodeRows<'a>>,
    /// The layers, from the eye on.
    pub layers: Vec<LayerRows<'a>>,
}

impl Tree {
    /// Splits the tree into disjoint bands of `rows_per_band` rows (the last may be shorter), so that
    /// they can be written in parallel.
    pub fn bands_mut(&mut self, rows_per_band: u32) -> Vec<TreeRows<'_>> {
        let rows_per_band = rows_per_band.max(1);
        let height = self.camera.size.height;
        let band_pixels = rows_per_band as usize * self.camera.size.width as usize;
        let starts = (0..height).step_by(rows_per_band as usize);
        let mut bands: Vec<TreeRows<'_>> = starts
            .map(|start| TreeRows {
                rows: start..(start + rows_per_band).min(height),
                nodes: Vec::with_capacity(self.nodes.len()),
                layers: Vec::with_capacity(self.layers.len()),
            })
            .collect();
        for planes in &mut self.nodes {
            let [red, green, blue] = &mut planes.radiance;
            let [x, y, z] = &mut planes.normal;
            let [s11, s12, s22] = &mut planes.shape;
            let mut radiance = [red, green, blue].map(|plane| plane.chunks_mut(band_pixels));
            let mut normal = [x, y, z].map(|plane| plane.chunks_mut(band_pixels));
            let mut shape = [s11, s12, s22].map(|plane| plane.chunks_mut(band_pixels));
            let mut distance = planes.distance.chunks_mut(band_pixels);
            let mut interface = planes.interface.chunks_mut(band_pixels);
            for band in &mut bands {
                band.nodes.push(NodeRows {
                    radiance: radiance.each_mut().map(|chunks| chunks.next().unwrap_or_default()),
                    distance: distance.next().unwrap_or_default(),
                    interface: interface.next().unwrap_or_default(),
                    normal: normal.each_mut().map(|chunks| chunks.next().unwrap_or_default()),
                    shape: shape.each_mut().map(|chunks| chunks.next().unwrap_or_default()),
                });
            }
        }
        for layer in &mut self.layers {
            for (band, rows) in bands.iter_mut().zip(layers::bands(layer, band_pixels)) {
                band.layers.push(rows);
            }
        }
        bands
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ImageSize;

    #[test]
    fn bands_cover_every_row_once() {
        let camera = Camera::symmetric(1.0, ImageSize::new(5, 7));
        let mut tree = Tree::new(Pose::IDENTITY, camera, Plan::solid(), Interfaces::default());
        for band in tree.bands_mut(3) {
            let pixels = 5 * band.rows.len();
            assert_eq!(band.nodes.len(), 4);
            assert_eq!(band.nodes[0].interface.len(), pixels);
            assert!(band.nodes[1].interface.is_empty());
            for node in band.nodes {
                assert_eq!(node.distance.len(), pixels);
                node.distance.iter_mut().for_each(|distance| *distance += 1.0);
            }
        }
        assert!(tree.nodes.iter().all(|planes| planes.distance.iter().all(|&distance| distance == 1.0)));
    }

    #[test]
    fn interface_bits_hold_every_index() {
        for (entries, bits) in [(0, 0), (1, 1), (2, 2), (3, 2), (4, 3), (255, 8)] {
            assert_eq!(Interfaces(vec![Interface::Mirror; entries]).bits(), bits);
        }
    }
}
