//! Planes of a strip: their kinds, and the header that stands before each payload.

use super::DecodeError;
use super::samples::{Packing, Predictor};
use crate::curvature::MAX_CURVATURE_PER_M;
use crate::frame::Plan;

/// The kinds of planes, by wire code: those of nodes below 16, those of the layers of a volume from there on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum PlaneKind {
    /// Which pixels the node knows; never sent for the root, which knows all.
    Validity = 1,
    /// Linear RGB radiance.
    Radiance = 2,
    /// Inverse depth.
    Depth = 3,
    /// Index of the optical boundary.
    Interface = 4,
    /// Octahedral normal, where there is a boundary.
    Normal = 5,
    /// Shape operator of the surface, where there is a boundary; never sent for the root.
    Shape = 6,
    /// Logarithm of a segment's optical depth; which pixels have the segment.
    OpticalDepth = 16,
    /// Where a segment starts and ends.
    Extent = 17,
    /// Linear RGB source radiance of a segment.
    Source = 18,
}

impl PlaneKind {
    /// Every kind there is.
    pub const ALL: [PlaneKind; 9] = [
        PlaneKind::Validity,
        PlaneKind::Radiance,
        PlaneKind::Depth,
        PlaneKind::Interface,
        PlaneKind::Normal,
        PlaneKind::Shape,
        PlaneKind::OpticalDepth,
        PlaneKind::Extent,
        PlaneKind::Source,
    ];

    /// The kinds of a layer, in their order.
    pub(crate) const OF_LAYERS: [PlaneKind; 3] = [PlaneKind::OpticalDepth, PlaneKind::Extent, PlaneKind::Source];

    /// Whether its index names a layer of the volume, not a node of the plan.
    pub fn is_of_layer(self) -> bool {
        PlaneKind::OF_LAYERS.contains(&self)
    }

    /// Name of a plane in reports: `root.radiance`, `volume.0.source`.
    pub fn name_in(self, plan: &Plan, node: u8) -> String {
        let of = if self.is_of_layer() { format!("volume.{node}") } else { plan.name(usize::from(node)) };
        format!("{of}.{}", self.name())
    }

    /// Name of the kind.
    pub fn name(self) -> &'static str {
        match self {
            PlaneKind::Validity => "validity",
            PlaneKind::Radiance => "radiance",
            PlaneKind::Depth => "depth",
            PlaneKind::Interface => "interface",
            PlaneKind::Normal => "normal",
            PlaneKind::Shape => "shape",
            PlaneKind::OpticalDepth => "optical_depth",
            PlaneKind::Extent => "extent",
            PlaneKind::Source => "source",
        }
    }

    /// How the codes of this kind are coded where they must come back as they were: row by row, or, with `None`, from coarse
    /// to fine. The figures behind it are in docs/measurements. Within a bound all are coded from coarse to fine.
    pub fn coding(self) -> Option<(Predictor, Packing)> {
        match self {
            PlaneKind::Validity
            | PlaneKind::Interface
            | PlaneKind::Normal
            | PlaneKind::OpticalDepth
            | PlaneKind::Extent => None,
            PlaneKind::Radiance | PlaneKind::Source => Some((Predictor::Median, Packing::Bytes)),
            PlaneKind::Shape => Some((Predictor::Median, Packing::Runs)),
            PlaneKind::Depth => Some((Predictor::Gradient, Packing::Bytes)),
        }
    }
}

/// Bytes that one plane took in one strip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlaneBytes {
    /// Node of the plan, or layer of the volume.
    pub node: u8,
    /// Kind.
    pub kind: PlaneKind,
    /// Bytes with their header.
    pub bytes: usize,
}

/// What stands before a plane's payload.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlaneHeader {
    pub(crate) node: u8,
    pub(crate) kind: PlaneKind,
    /// Radiance, source and shape: the value of the largest code; depth: the nearest; otherwise 0.
    pub(crate) scale: f32,
    pub(crate) payload_bytes: u32,
}

/// Bytes before the payload of a plane: node, kind, scale, length of the payload.
pub const PLANE_HEADER_BYTES: usize = 10;

impl PlaneHeader {
    pub(crate) const BYTES: usize = PLANE_HEADER_BYTES;

    /// The header of a plane whose node knows no pixel of the strip: nothing follows it.
    pub(crate) fn empty(node: u8, kind: PlaneKind) -> PlaneHeader {
        let scale = if matches!(kind, PlaneKind::Radiance | PlaneKind::Depth | PlaneKind::Source) { 1.0 } else { 0.0 };
        PlaneHeader { node, kind, scale, payload_bytes: 0 }
    }

    pub(crate) fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[0] = self.node;
        bytes[1] = self.kind as u8;
        bytes[2..6].copy_from_slice(&self.scale.to_le_bytes());
        bytes[6..].copy_from_slice(&self.payload_bytes.to_le_bytes());
        bytes
    }

    pub(crate) fn from_bytes(bytes: &[u8; Self::BYTES]) -> Result<PlaneHeader, DecodeError> {
        let [node, kind, s0, s1, s2, s3, b0, b1, b2, b3] = *bytes;
        let known = PlaneKind::ALL.into_iter().find(|&known| known as u8 == kind);
        let kind = known.ok_or(DecodeError::Unsupported { field: "kind of plane", found: u32::from(kind) })?;
        let scale = f32::from_le_bytes([s0, s1, s2, s3]);
        let scale_is_possible = match kind {
            PlaneKind::Radiance | PlaneKind::Depth | PlaneKind::Source => scale > 0.0 && scale.is_finite(),
            PlaneKind::Shape => scale.is_sign_positive() && scale <= MAX_CURVATURE_PER_M,
            PlaneKind::Validity
            | PlaneKind::Interface
            | PlaneKind::Normal
            | PlaneKind::OpticalDepth
            | PlaneKind::Extent => scale.to_bits() == 0,
        };
        if !scale_is_possible {
            let expected = "a positive number for radiance, source and depth, 0 to 1e6 for shape, otherwise 0";
            return Err(DecodeError::Malformed { field: "scale of plane", expected });
        }
        Ok(PlaneHeader { node, kind, scale, payload_bytes: u32::from_le_bytes([b0, b1, b2, b3]) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_come_back() {
        for kind in PlaneKind::ALL {
            let scales = [PlaneKind::Radiance, PlaneKind::Depth, PlaneKind::Shape, PlaneKind::Source];
            let scale = if scales.contains(&kind) { 0.5 } else { 0.0 };
            let header = PlaneHeader { node: 3, kind, scale, payload_bytes: 0x0102_0304 };
            assert_eq!(PlaneHeader::from_bytes(&header.to_bytes()), Ok(header));
        }
    }

    #[test]
    fn kinds_of_another_version_are_refused_by_number() {
        for kind in [0, 7, 15, 19, 31, 255] {
            let bytes = [0, kind, 0, 0, 0, 0, 0, 0, 0, 0];
            let found = u32::from(kind);
            assert_eq!(
                PlaneHeader::from_bytes(&bytes),
                Err(DecodeError::Unsupported { field: "kind of plane", found })
            );
        }
    }

    #[test]
    fn a_scale_that_is_no_scale_is_refused() {
        for scale in [0.0, -0.0, -1.0, f32::INFINITY, f32::NAN] {
            let header = PlaneHeader { node: 0, kind: PlaneKind::Depth, scale, payload_bytes: 0 };
            assert!(PlaneHeader::from_bytes(&header.to_bytes()).is_err(), "{scale}");
        }
        let header = PlaneHeader { node: 0, kind: PlaneKind::Normal, scale: 1.0, payload_bytes: 0 };
        assert!(PlaneHeader::from_bytes(&header.to_bytes()).is_err());
        for scale in [-0.0, -1.0, 1.1e6, f32::INFINITY, f32::NAN] {
            let header = PlaneHeader { node: 2, kind: PlaneKind::Shape, scale, payload_bytes: 0 };
            assert!(PlaneHeader::from_bytes(&header.to_bytes()).is_err(), "{scale}");
        }
    }
}
