//! The frame: a ray tree of planes, what it is quantised to, and how it is seen from its own pose.
//!
//! Method: RGBZ ray trees, Lochmann et al. 2014 (VMV, "Real-time reflective and refractive novel-view
//! synthesis"). The root holds what the first surface sends to the eye apart from its sharp specular
//! part; each child holds what arrives by reflection or refraction, without the Fresnel weight, which is
//! the client's to apply for the pose it shows.

mod flatten;
mod format;
mod layers;
mod plan;
mod thesis;
mod tree;

pub use flatten::flatten;
pub use format::{ColorCoding, ColorFormat, DepthBound, DepthCoding, DepthFormat, FrameFormat, Layering, VolumeFormat};
pub use layers::{LayerPlanes, LayerRows, MAX_LAYERS, VolumeRange, VolumeSegment};
pub use plan::{Arrival, MAX_NODES, Node, Plan, PlanError};
pub use thesis::{ThesisError, decode_thesis, encode_thesis, thesis_bits};
pub use tree::{Interfaces, MAX_INTERFACES, NodePlanes, NodeRows, Tree, TreeRows, UNDEFINED};

use serde::{Deserialize, Serialize};

/// One identity that follows a frame from the pose it answers to the display that shows it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct FrameId(pub u32);

impl std::fmt::Display for FrameId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "frame {}", self.0)
    }
}
