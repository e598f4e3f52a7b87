//! A scene in memory: surfaces, materials, lights, and where a person stands in it.
//!
//! First stage of the server: scene -> effects -> integrator -> frame. Everything is in world space (metres,
//! +Y up) once loading is done: instances are flattened, textures decoded, materials checked. Scene files
//! are not trusted: see `untrusted` for the limits.

mod built_in;
mod description;
mod environment;
mod error;
mod gltf;
mod light;
mod load;
mod material;
mod mesh;
mod metals;
mod mitsuba;
mod model;
mod motion;
mod mtl;
mod obj;
mod part;
mod pattern;
mod picture;
mod ply;
mod shapes;
mod texels;
mod texture;
pub(crate) mod untrusted;

pub use environment::Environment;
pub use error::SceneError;
pub use light::{Falloff, Light};
pub use material::{
    Anisotropy, Coat, Color, Cutout, Distribution, Finish, Material, NormalMap, Scalar, Standard, Surface,
};
pub use mesh::{Mesh, Sphere};
pub use motion::{Key, Motion, Moved, Origins, Target};
pub use pattern::Pattern;
pub use texels::{Texels, Transfer};
pub use texture::{ImageTexture, TexelFilter, Texture, TextureKind, Wrap};

use crate::volume::Medium;
use glam::DVec3;
use part::Part;
use warplight_protocol::{ImageSize, Pose};

/// The scene of the main job.
pub const DEFAULT_SCENE: &str = "gallery";

/// A named view point.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// Its name in the scene file.
    pub name: String,
    /// world_from_view.
    pub pose: Pose,
    /// Vertical field of view in radians.
    pub vertical_fov_rad: f32,
}

/// What a scene's file says about pictures of it; the command line comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderDefaults {
    /// Size of the picture.
    pub size: Option<ImageSize>,
    /// Longest path in segments.
    pub max_depth: Option<u32>,
    /// Samples per pixel.
    pub spp: Option<u32>,
}

/// Everything that is rendered. Positions of shapes and lights are counted from `origin`; poses are absolute.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name for reports: of a built-in scene, or the file's stem.
    pub name: String,
    /// In world, in metres: what positions of shapes and lights are counted from. Zero, unless the scene lies far
    /// from the world's own origin, where f32 would be too coarse.
    pub origin: DVec3,
    /// All triangles.
    pub mesh: Mesh,
    /// Analytic spheres: exact normals for chrome and glass balls.
    pub spheres: Vec<Sphere>,
    /// Materials that triangles and spheres name by index.
    pub materials: Vec<Material>,
    /// Textures that materials name by index.
    pub textures: Vec<Texture>,
    /// What fills closed surfaces and scatters light, named by materials by index. Counted from `origin`, too.
    pub media: Vec<Medium>,
    /// Lights without extent.
    pub lights: Vec<Light>,
    /// What moves, and how.
    pub motions: Vec<Motion>,
    /// What rays see that leave the scene.
    pub environment: Environment,
    /// Factor on radiance before display.
    pub exposure: f32,
    /// Where a replayed head trace is put: mean position and first heading of the trace.
    pub head: Pose,
    /// View points, at least one; the first is the default of `render`.
    pub cameras: Vec<NamedCamera>,
    /// What its file says about pictures of it.
    pub defaults: RenderDefaults,
    /// What the files asked for and is not supported, one line each.
    pub warnings: Vec<String>,
}
