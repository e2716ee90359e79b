//! An indexed triangle mesh with texture coordinates.

use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// Triangles by index. Texture coordinates have an index list of their own (as in OBJ), because a vertex on
/// a seam has several.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Mesh {
    /// File stem it came from.
    pub name: String,
    /// Vertex positions, metres, world frame.
    pub positions: Vec<Vec3>,
    /// Corner indices into `positions`, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates, v up (row 0 of a texture is at v = 1); empty when the mesh has none.
    pub uvs: Vec<Vec2>,
    /// Corner indices into `uvs`, one triple a triangle; empty when the mesh has none.
    pub uv_triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Corners of a triangle in metres.
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|i| self.positions[i as usize])
    }

    /// Texture coordinates of a triangle's corners; `None` for a mesh without.
    pub fn uv_corners(&self, triangle: usize) -> Option<[Vec2; 3]> {
        Some(self.uv_triangles.get(triangle)?.map(|i| self.uvs[i as usize]))
    }
}
