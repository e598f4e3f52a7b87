//! The shape of a frame: what both ends must know before its first strip, and so what a strip need not say.

use super::{DecodeError, Limits, PlaneKind};
use crate::camera::Projection;
use crate::frame::{ColorCoding, DepthFormat, FrameFormat, Interfaces, MAX_INTERFACES, Plan, Tree, VolumeRange};
use crate::optics::Interface;
use crate::video::{Canvas, Placement};
use crate::{Camera, Pose};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// What both ends must know of a frame before its first strip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameShape {
    /// Camera of the picture.
    pub camera: Camera,
    /// Nodes of the tree.
    pub plan: Plan,
    /// Optical boundaries.
    pub interfaces: Interfaces,
    /// Quantisation, and how many layers of volume there are.
    pub format: FrameFormat,
    /// Where the volume is.
    pub volume: VolumeRange,
    /// Rows per strip; the last strip may be shorter.
    pub strip_rows: u16,
    /// Factor on radiance before display; 1 / exposure is white.
    pub exposure: f32,
}

impl FrameShape {
    /// Exposures that are accepted: far beyond any picture, and the white of every one of them is a number.
    pub const EXPOSURE: std::ops::RangeInclusive<f32> = 1e-12..=1e12;

    /// Bytes per pixel of a strip that a decoder holds beside the planes: three channels, depths, metres and ray
    /// lengths of 4 bytes, packed samples of at most 7, a flag; and for the pyramid two grids, the parts of a level, its
    /// predictions and residuals, contexts, masks and samples.
    const SCRATCH_BYTES: usize = 64;

    /// Number of strips.
    pub fn strips(&self) -> usize {
        (self.camera.size.height as usize).div_ceil(usize::from(self.strip_rows.max(1)))
    }

    /// Rows of strip number `index`.
    pub fn rows_of(&self, index: usize) -> Range<u32> {
        let rows = u32::from(self.strip_rows.max(1));
        let start = u32::try_from(index).unwrap_or(u32::MAX).saturating_mul(rows).min(self.camera.size.height);
        start..(start + rows).min(self.camera.size.height)
    }

    /// The planes of every strip, in order, with their raw bits per pixel.
    pub fn planes(&self) -> Vec<(u8, PlaneKind, usize)> {
        let mut planes = Vec::new();
        for node in 0..self.plan.nodes().len() {
            let mut push = |kind| {
                let (channels, bits) = self.channels(node, kind);
                planes.push((node as u8, kind, channels * bits));
            };
            if node > 0 {
                push(PlaneKind::Validity);
            }
            if !self.is_picture(PlaneKind::Radiance) {
                push(PlaneKind::Radiance);
            }
            push(PlaneKind::Depth);
            if self.plan.has_children(node) && !self.interfaces.0.is_empty() {
                push(PlaneKind::Interface);
                push(PlaneKind::Normal);
                if self.has_shape_operators(node) {
                    push(PlaneKind::Shape);
                }
            }
        }
        for layer in 0..self.format.volume.layers {
            for kind in PlaneKind::OF_LAYERS.into_iter().filter(|&kind| !self.is_picture(kind)) {
                let (channels, bits) = self.channels(usize::from(layer), kind);
                planes.push((layer, kind, channels * bits));
            }
        }
        planes
    }

    /// The planes that travel as pictures instead, in order: node or layer, and kind.
    pub fn pictures(&self) -> Vec<(u8, PlaneKind)> {
        let nodes = (0..self.plan.nodes().len() as u8).map(|node| (node, PlaneKind::Radiance));
        let layers = (0..self.format.volume.layers).map(|layer| (layer, PlaneKind::Source));
        nodes.chain(layers).filter(|(_, kind)| self.is_picture(*kind)).collect()
    }

    /// Whether planes of this kind are pictures. Sources of more than 8 bits stay in strips.
    fn is_picture(&self, kind: PlaneKind) -> bool {
        let bits = match kind {
            PlaneKind::Radiance => self.format.color.bits(),
            PlaneKind::Source => self.format.volume.source.bits(),
            _ => return false,
        };
        matches!(self.format.color_coding, ColorCoding::Video { .. }) && bits == 8
    }

    /// Channels of a plane and the bits of each.
    pub(crate) fn channels(&self, node: usize, kind: PlaneKind) -> (usize, usize) {
        match kind {
            PlaneKind::Validity => (1, 1),
            PlaneKind::Radiance => (3, self.format.color.bits()),
            PlaneKind::Depth => (1, usize::from(self.depth_bits(node))),
            PlaneKind::Interface => (1, self.interfaces.bits()),
            PlaneKind::Normal => (2, usize::from(self.format.normal_bits)),
            PlaneKind::Shape => (3, usize::from(self.format.shape_bits)),
            PlaneKind::OpticalDepth => (1, usize::from(self.format.volume.optical_depth_bits)),
            PlaneKind::Extent => (2, usize::from(self.format.volume.depth_bits)),
            PlaneKind::Source => (3, self.format.volume.source.bits()),
        }
    }

    /// Whether the planes of a node hold shape operators.
    pub(crate) fn has_shape_operators(&self, node: usize) -> bool {
        node > 0 && self.plan.has_children(node) && self.format.shape_bits > 0
    }

    /// A tree to decode such a frame into.
    pub fn tree(&self, render_pose: Pose) -> Tree {
        let mut tree = Tree::new(render_pose, self.camera, self.plan.clone(), self.interfaces.clone());
        self.fit(&mut tree, render_pose);
        tree
    }

    /// Makes of a tree one to decode such a frame into, reusing its memory; the contents are left as they fall.
    pub fn fit(&self, tree: &mut Tree, render_pose: Pose) {
        let has_shape_operators = self.format.shape_bits > 0;
        tree.reset_with(render_pose, self.camera, &self.plan, &self.interfaces, has_shape_operators);
        tree.set_layers(usize::from(self.format.volume.layers));
    }

    pub(crate) fn depth_bits(&self, node: usize) -> u8 {
        match self.format.depth {
            DepthFormat::Codes { root_bits, .. } if node == 0 => root_bits,
            DepthFormat::Codes { child_bits, .. } => child_bits,
            DepthFormat::Bounded(_) => 16,
        }
    }

    /// Whether the codes of such a plane travel from coarse to fine, and then the error that they may have.
    pub(crate) fn coarse_to_fine(&self, kind: PlaneKind) -> Option<u8> {
        match kind {
            PlaneKind::Radiance | PlaneKind::Source => match self.format.color_coding {
                ColorCoding::Bounded { error } => Some(error),
                _ => None,
            },
            kind => kind.coding().is_none().then_some(0),
        }
    }

    /// Refuses a shape that is not possible or that `limits` forbid.
    pub fn check(&self, limits: &Limits) -> Result<(), DecodeError> {
        let malformed = |field, expected| Err(DecodeError::Malformed { field, expected });
        if !self.camera.is_valid() {
            return malformed("camera", "a size of 1 to 8192 pixels and a frustum that is not empty, or six of a cube");
        }
        if !self.format.is_valid() {
            return malformed(
                "format",
                "depth of 8 to 24 bits, normals of 6 to 16, shapes of 0 or 6 to 12; 0 to 8 layers with depths and optical depths of 4 to 16 bits",
            );
        }
        if self.format.volume.layers > 0 && !self.volume.is_valid() {
            return malformed("volume", "a nearest depth of at least 0 and a farthest beyond it, at most 1e9 m");
        }
        if self.format.volume.layers > 0 && self.camera.projection != Projection::Perspective {
            return malformed("layers", "none in a cube");
        }
        if self.strip_rows == 0 {
            return malformed("strip_rows", "at least 1");
        }
        if !Self::EXPOSURE.contains(&self.exposure) {
            return malformed("exposure", "1e-12 to 1e12");
        }
        if self.interfaces.0.len() > MAX_INTERFACES || !self.interfaces.0.iter().all(Interface::is_valid) {
            return malformed("interfaces", "at most 255, with indices of refraction that exist");
        }
        if !self.pictures().is_empty() && !Canvas::around(self.camera.size).is_valid() {
            return malformed(
                "size of a frame with pictures",
                "at most 8688 pixels on a side, and 36864 blocks of 16 x 16",
            );
        }
        let within = |limit: usize, requested: usize| {
            if requested > limit { Err(DecodeError::LimitExceeded { limit, requested }) } else { Ok(()) }
        };
        within(limits.frame_pixels, self.camera.size.pixels())?;
        within(limits.frame_bytes, self.memory_bytes())
    }

    /// Bytes that a receiver holds for the frame: its planes, and what decoding one strip takes.
    fn memory_bytes(&self) -> usize {
        let node_bytes = |node| {
            let shape_bytes = if self.has_shape_operators(node) { 12 } else { 0 };
            shape_bytes + if self.plan.has_children(node) { 29 } else { 16 }
        };
        let layer_bytes = 24 * usize::from(self.format.volume.layers);
        let pixel_bytes = (0..self.plan.nodes().len()).map(node_bytes).sum::<usize>() + layer_bytes;
        // Decoding layers takes the code of the last back, too.
        let scratch = Self::SCRATCH_BYTES + if layer_bytes > 0 { 4 } else { 0 };
        // A decoder of pictures keeps two for reference and makes one, each of up to the largest canvas.
        let side = |px: u32| 2 * px as usize + Placement::SLACK_PX;
        let canvas_pixels =
            (side(self.camera.size.width) * side(self.camera.size.height)).min(Canvas::MAX_BLOCKS * 256);
        let picture_bytes = self.pictures().len() * canvas_pixels * 9 / 2;
        picture_bytes
            + self.camera.size.pixels() * pixel_bytes
            + self.rows_of(0).len() * self.camera.size.width as usize * scratch
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ImageSize;

    fn shape(size: ImageSize) -> FrameShape {
        FrameShape {
            camera: Camera::symmetric(1.0, size),
            plan: Plan::solid(),
            interfaces: Interfaces(vec![Interface::Mirror; 5]),
            format: FrameFormat::default(),
            volume: VolumeRange::default(),
            strip_rows: 4,
            exposure: 1.0,
        }
    }

    #[test]
    fn strips_cover_every_row_once() {
        let shape = shape(ImageSize::new(7, 10));
        let rows: Vec<_> = (0..shape.strips()).map(|index| shape.rows_of(index)).collect();
        assert_eq!(rows, [0..4, 4..8, 8..10]);
        assert!(shape.rows_of(3).is_empty());
        assert!(shape.rows_of(usize::MAX).is_empty());
    }

    #[test]
    fn planes_stand_in_pre_order() {
        use PlaneKind::{Depth, Interface, Normal, Radiance, Shape, Validity};
        let planes = [
            (0, Radiance, 24),
            (0, Depth, 16),
            (0, Interface, 3),
            (0, Normal, 24),
            (1, Validity, 1),
            (1, Radiance, 24),
            (1, Depth, 16),
            (2, Validity, 1),
            (2, Radiance, 24),
            (2, Depth, 16),
            (2, Interface, 3),
            (2, Normal, 24),
            (2, Shape, 24),
            (3, Validity, 1),
            (3, Radiance, 24),
            (3, Depth, 16),
        ];
        let mut shape = shape(ImageSize::new(8, 8));
        assert_eq!(shape.planes(), planes);
        shape.format.shape_bits = 0;
        assert_eq!(shape.planes(), planes.into_iter().filter(|plane| plane.1 != Shape).collect::<Vec<_>>());
    }

    #[test]
    fn what_cannot_be_or_is_too_large_is_refused_by_name() {
        let good = shape(ImageSize::new(64, 64));
        let limits = Limits::default();
        assert_eq!(good.check(&limits), Ok(()));
        let refused = |spoil: fn(&mut FrameShape)| {
            let mut bad = good.clone();
            spoil(&mut bad);
            bad.check(&limits).unwrap_err().to_string()
        };
        assert!(refused(|shape| shape.camera.size.width = 0).contains("camera"));
        assert!(refused(|shape| shape.camera.fov.left = f32::NAN).contains("camera"));
        assert!(refused(|shape| shape.format.normal_bits = 17).contains("format"));
        assert!(refused(|shape| shape.format = shape.format.with_depth_bits(16, 25)).contains("format"));
        assert!(refused(|shape| shape.format.shape_bits = 5).contains("format"));
        assert!(refused(|shape| shape.format.shape_bits = 13).contains("format"));
        assert!(refused(|shape| shape.strip_rows = 0).contains("strip_rows"));
        for exposure in [0.0, -1.0, 1e-40, f32::INFINITY, f32::NAN] {
            let bad = FrameShape { exposure, ..good.clone() };
            assert!(bad.check(&limits).unwrap_err().to_string().contains("exposure"), "{exposure}");
        }
        assert!(refused(|shape| shape.interfaces.0 = vec![Interface::Mirror; 256]).contains("interfaces"));
        assert!(refused(|shape| shape.interfaces.0 = vec![Interface::Dielectric { eta: 0.0 }]).contains("interfaces"));
        assert!(refused(|shape| shape.camera.size = ImageSize::new(8192, 8192)).contains("limit"));
        assert!(refused(|shape| shape.camera.size = ImageSize::new(4096, 4096)).contains("limit"));
    }

    #[test]
    fn a_whole_frame_in_one_strip_counts_its_scratch() {
        let mut shape = shape(ImageSize::new(100, 100));
        let limits = Limits { frame_bytes: 10_000 * (29 + 16 + 41 + 16) + 400 * 64, ..Limits::default() };
        assert_eq!(shape.check(&limits), Ok(()));
        shape.strip_rows = 100;
        assert!(shape.check(&limits).is_err());
        // Without shape operators there is room for it.
        shape.format.shape_bits = 0;
        assert_eq!(
            shape.check(&limits),
            Err(DecodeError::LimitExceeded { limit: limits.frame_bytes, requested: 10_000 * (90 + 64) })
        );
    }
}
