//! The scene: meshes and cameras in metres, one right-handed world, and the importers that bring them there.

mod camera;
pub mod export;
pub mod import;
mod mesh;
mod mesh_file;

pub use camera::{Camera, Distortion, Intrinsics};
pub use mesh::Mesh;
pub use mesh_file::{read_obj, write_obj};

use serde::{Deserialize, Serialize};

/// Everything that light is simulated on. The first mesh is the object whose texture is solved for; the
/// others (a floor, a stage) only take part in shadows and bounces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// Posed cameras, by photo name.
    pub cameras: Vec<Camera>,
    /// Meshes, the object first.
    pub meshes: Vec<Mesh>,
}
