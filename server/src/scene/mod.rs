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
mod load;
mod material;
mod mesh;
mod metals;
mod model;
mod part;
mod pattern;
mod picture;
mod shapes;
mod texture;
mod untrusted;

pub use environment::Environment;
pub use error::SceneError;
pub use material::{Color, Material, Surface};
pub use mesh::{Mesh, Sphere};
pub use pattern::Pattern;
pub use texture::{Texture, TextureKind};

use part::Part;
use warplight_protocol::Pose;

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

/// Everything that is rendered.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name for reports: of a built-in scene, or the file's stem.
    pub name: String,
    /// All triangles.
    pub mesh: Mesh,
    /// Analytic spheres: exact normals for chrome and glass balls.
    pub spheres: Vec<Sphere>,
    /// Materials that triangles and spheres name by index.
    pub materials: Vec<Material>,
    /// Textures that materials name by index.
    pub textures: Vec<Texture>,
    /// What rays see that leave the scene.
    pub environment: Environment,
    /// Factor on radiance before display.
    pub exposure: f32,
    /// Where a replayed head trace is put: mean position and first heading of the trace.
    pub head: Pose,
    /// View points, at least one; the first is the default of `render`.
    pub cameras: Vec<NamedCamera>,
    /// What the files asked for and is not supported, one line each.
    pub warnings: Vec<String>,
}
