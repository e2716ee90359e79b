//! Meshes from and to OBJ files.

use super::Mesh;
use crate::codec::asset::AssetError;
use crate::codec::obj::{self, Obj};
use std::path::Path;

/// Reads an OBJ file whose unit is `metres_per_unit`; the mesh is named by the file's stem.
pub fn read_obj(path: &Path, metres_per_unit: f64) -> Result<Mesh, AssetError> {
    let Obj { mut positions, triangles, uvs, uv_triangles } = obj::read(path)?;
    for position in &mut positions {
        *position = (position.as_dvec3() * metres_per_unit).as_vec3();
    }
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Mesh { name, positions, triangles, uvs, uv_triangles })
}

/// Writes an OBJ file in metres; each of `header`'s lines becomes a comment.
pub fn write_obj(path: &Path, mesh: &Mesh, header: &[&str]) -> Result<(), AssetError> {
    let Mesh { name: _, positions, triangles, uvs, uv_triangles } = mesh.clone();
    obj::write(path, &Obj { positions, triangles, uvs, uv_triangles }, header)
}
