//! What a session serves, and the frames that follow from it and from what a client asks for.

use crate::costs::CostTable;
use crate::march::MediaBounds;
use std::sync::Arc;
use std::time::Duration;
use warplight_protocol::codec::{DecodeError, FrameShape, Limits};
use warplight_protocol::frame::{ColorCoding, ColorFormat, FrameFormat, Interfaces, Plan, VolumeFormat, VolumeRange};
use warplight_protocol::message::{FrameBegin, FramePurpose, Hello, StillRequest};
use warplight_protocol::{Camera, Pose, Token};

/// How many samples each pixel of a live frame gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleBudget {
    /// Always so many.
    Samples(u32),
    /// As many as fit into this time, going by what the last frame cost.
    Time(Duration),
}

/// What a session serves.
#[derive(Clone, Debug)]
pub struct SessionConfig {
    /// Name of the scene.
    pub scene: String,
    /// Effects that it calls for.
    pub effects: Vec<String>,
    /// Where a person stands in it.
    pub head: Pose,
    /// Factor on radiance before display.
    pub exposure: f32,
    /// Nodes of its live frames.
    pub plan: Plan,
    /// Its optical boundaries.
    pub interfaces: Interfaces,
    /// Where its media are.
    pub media: MediaBounds,
    /// Samples of a live frame.
    pub samples: SampleBudget,
    /// What points of a frame cost, where a time budget chooses among them; without, it decides on samples alone.
    pub costs: Option<Arc<CostTable>>,
    /// Most samples of a still.
    pub max_still_spp: u32,
    /// Rows per strip.
    pub strip_rows: u16,
    /// How much more than the display a live frame shows at most, on each side.
    pub guard_rad: f64,
    /// What the peer may ask for.
    pub limits: Limits,
    /// What a client has to know; none where anybody is served.
    pub token: Token,
}

/// A frame to be rendered and encoded.
#[derive(Clone, Debug)]
pub struct RenderJob {
    /// Its head, as it will be sent.
    pub begin: FrameBegin,
    /// Samples per pixel, rounded up.
    pub spp: u32,
    /// The same as a fraction: a frame from the cache may have less than one per pixel.
    pub samples_per_1024_px: u32,
}

impl SessionConfig {
    pub(super) fn shape_for(&self, hello: &Hello, purpose: FramePurpose, camera: Camera, pose: &Pose) -> FrameShape {
        let no_layers = VolumeFormat { layers: 0, ..hello.format.volume };
        let still_format = FrameFormat {
            color: ColorFormat::Half,
            color_coding: ColorCoding::Exact,
            volume: no_layers,
            ..hello.format
        };
        let live_format =
            if self.media.is_empty() { FrameFormat { volume: no_layers, ..hello.format } } else { hello.format };
        let (plan, interfaces, format) = match purpose {
            FramePurpose::Live => (self.plan.clone(), self.interfaces.clone(), live_format),
            FramePurpose::Still(_) => (Plan::diffuse(), Interfaces::default(), still_format),
        };
        let exposure = self.exposure;
        let volume = if format.volume.layers > 0 { self.media.range(pose) } else { VolumeRange::default() };
        FrameShape { camera, plan, interfaces, format, volume, strip_rows: self.strip_rows, exposure }
    }

    /// Whether a live frame of this camera is within the limits.
    pub(super) fn fits(&self, hello: &Hello, camera: Camera) -> Result<(), DecodeError> {
        self.shape_for(hello, FramePurpose::Live, camera, &Pose::IDENTITY).check(&self.limits)
    }

    /// The cube around the display, with coarser pixels where its own would exceed the limits.
    pub(super) fn cube_for(&self, hello: &Hello) -> Camera {
        let mut camera = Camera::cube(&hello.camera, u32::MAX);
        while self.fits(hello, camera).is_err() {
            let smaller = Camera::cube(&hello.camera, camera.size.width.saturating_sub(1));
            if smaller == camera {
                break;
            }
            camera = smaller;
        }
        camera
    }

    /// A still has a camera of its own, and nodes only where they are asked for.
    pub(super) fn shape_of_still(&self, hello: &Hello, still: &StillRequest) -> FrameShape {
        let purpose = FramePurpose::Still(still.number);
        let mut shape = self.shape_for(hello, purpose, still.camera, &still.pose);
        if still.with_nodes {
            let live = self.shape_for(hello, FramePurpose::Live, still.camera, &still.pose);
            (shape.format.volume, shape.volume) = (live.format.volume, live.volume);
            shape.plan.clone_from(&self.plan);
            shape.interfaces.clone_from(&self.interfaces);
        }
        shape
    }
}
