//! Meshes from and to OBJ files.

use super::Mesh;
use crate::codec::asset::AssetError;
use crate::codec::obj::{self, Obj};
use glam::Vec3;
use std::path::Path;

/// Rounding error of a position that is borne, relative to the mesh's diagonal.
const ROUNDING: f32 = 2e-5;

/// Reads an OBJ file whose unit is `metres_per_unit`; the mesh is named by the file's stem.
pub fn read_obj(path: &Path, metres_per_unit: f64) -> Result<Mesh, AssetError> {
    let Obj { mut positions, triangles, uvs, uv_triangles } = obj::read(path)?;
    for position in &mut positions {
        *position = (position.as_dvec3() * metres_per_unit).as_vec3();
    }
    refuse_far(path, &positions)?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Mesh { name, positions, triangles, uvs, uv_triangles })
}

/// Positions are kept in single precision: a mesh so far from the origin that rounding would show is refused.
fn refuse_far(path: &Path, positions: &[Vec3]) -> Result<(), AssetError> {
    let (mut low, mut high, mut farthest) = (Vec3::MAX, Vec3::MIN, 0.0f32);
    for p in positions {
        (low, high, farthest) = (low.min(*p), high.max(*p), farthest.max(p.abs().max_element()));
    }
    if farthest * f32::EPSILON > ROUNDING * (high - low).length() {
        return Err(AssetError::Unsuitable {
            path: path.into(),
            expected:
                "a mesh near the origin of its coordinates: export mesh and cameras in local coordinates"
                    .into(),
            found: format!("one of {:.3} m, {farthest:.0} m from the origin", (high - low).length()),
        });
    }
    Ok(())
}

/// Writes an OBJ file in metres; each of `header`'s lines becomes a comment.
pub fn write_obj(path: &Path, mesh: &Mesh, header: &[&str]) -> Result<(), AssetError> {
    let Mesh { name: _, positions, triangles, uvs, uv_triangles } = mesh.clone();
    obj::write(path, &Obj { positions, triangles, uvs, uv_triangles }, header)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_in_projected_coordinates_is_refused_with_advice() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("far.obj");
        let at = |x: f64| format!("v {x} 4000000 0\nv {} 4000000.3 0\nv {x} 4000000 0.3\nf 1 2 3\n", x + 0.3);
        std::fs::write(&path, at(500_000.0)).unwrap();
        assert!(read_obj(&path, 1.0).unwrap_err().to_string().contains("local coordinates"));
        std::fs::write(&path, "v 5 4 0\nv 5.3 4 0\nv 5 4 0.3\nf 1 2 3\n").unwrap();
        assert_eq!(read_obj(&path, 1.0).unwrap().triangles.len(), 1);
    }
}
