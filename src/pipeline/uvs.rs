//! The object's texture coordinates: its own where they can be used, else made, and kept for whoever reads the texture.
//!
//! Made coordinates are kept in `derived/uvs.bin`, beside the digest of the mesh that they are for: magic, digest
//! (32 bytes), the number of coordinates (8 bytes), the coordinates (u, v as f32), and three indices (u32) a triangle,
//! all little-endian.

use super::process::{LARGEST_TEXTURE, ProcessError, io};
use crate::progress::Progress;
use crate::reflectance::unwrap::{Charts, Packed, UnwrapError, UvChoice, UvSource, check_own};
use crate::scene::{Mesh, Scene};
use crate::session::{Session, store};
use glam::Vec2;
use std::path::PathBuf;

/// Where made coordinates are kept.
pub(super) const FILE: &str = "derived/uvs.bin";

const MAGIC: &[u8; 8] = b"unlituv1";

/// Side of the texture in which made coordinates are packed when nobody asked for one, before it is known how large a
/// texture they need.
const FIRST: usize = 2048;

/// Made coordinates that cannot be read back.
#[derive(Debug, thiserror::Error)]
pub enum UvsError {
    /// The file system refused.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The scene was imported anew, or the file was damaged.
    #[error("{} does not belong to the session's mesh ({reason}): run `unlit process` again", path.display())]
    Stale {
        /// The file.
        path: PathBuf,
        /// How it was found out.
        reason: &'static str,
    },
}

/// Sees to it that the scene's first mesh has coordinates that can carry a texture. `fitting` gives the texture's side
/// for a mesh with coordinates; where it is `fixed`, a larger one is not tried. Gives the side and where the coordinates
/// came from.
pub(super) fn settle(
    scene: &mut Scene,
    (choice, fixed): (UvChoice, bool),
    fitting: impl Fn(&Mesh) -> Result<usize, ProcessError>,
    progress: &Progress,
) -> Result<(usize, UvSource), ProcessError> {
    let Some(object) = scene.meshes.first_mut() else { return Err(super::scene::SceneError::NoMesh.into()) };
    let why = match (choice, check_own(object)) {
        (UvChoice::New, _) => "new ones were asked for".to_owned(),
        (_, Ok(())) => return Ok((fitting(object)?, UvSource::Own)),
        (UvChoice::Own, Err(error)) => return Err(error.into()),
        (UvChoice::Auto, Err(error)) => error.reason(),
    };
    let charts = Charts::cut(object, progress)?;
    progress.report("packing the charts", 0, 1);
    // How large a texture is wanted shows only in an atlas; gutters take the more of it the smaller it is.
    let (_, trial) = pack(&charts, object, FIRST, false)?;
    let textured = Mesh { uvs: trial.uvs, uv_triangles: trial.uv_triangles, ..object.clone() };
    let (side, packed) = pack(&charts, object, fitting(&textured)?, fixed)?;
    let source = UvSource::Made(charts.told(&packed, why));
    (object.uvs, object.uv_triangles) = (packed.uvs, packed.uv_triangles);
    Ok((side, source))
}

/// Packs into a texture of `side`, or the next larger one that holds the charts.
fn pack(charts: &Charts, mesh: &Mesh, mut side: usize, fixed: bool) -> Result<(usize, Packed), UnwrapError> {
    loop {
        match charts.pack(mesh, side) {
            Ok(packed) => return Ok((side, packed)),
            Err(UnwrapError::Crowded { .. }) if !fixed && side < LARGEST_TEXTURE => side *= 2,
            Err(error) => return Err(error),
        }
    }
}

/// Digest of a mesh's surface, whatever its coordinates.
pub(super) fn digest(mesh: &Mesh) -> String {
    let mut bytes = Vec::with_capacity(12 * (mesh.positions.len() + mesh.triangles.len()));
    bytes.extend(mesh.positions.iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes));
    bytes.extend(mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()));
    store::digest(&bytes)
}

/// Keeps made coordinates, and removes those of a former run where the mesh's own are used.
pub(super) fn keep(session: &Session, mesh: &Mesh, source: &UvSource) -> Result<(), ProcessError> {
    let path = session.path().join(FILE);
    if *source == UvSource::Own {
        return match std::fs::remove_file(&path) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(io(&path)(e)),
            _ => Ok(()),
        };
    }
    let folder = session.derived_dir();
    std::fs::create_dir_all(&folder).map_err(io(&folder))?;
    let mut bytes = MAGIC.to_vec();
    bytes.extend(digest(mesh).as_bytes());
    bytes.extend((mesh.uvs.len() as u64).to_le_bytes());
    bytes.extend(mesh.uvs.iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes));
    bytes.extend(mesh.uv_triangles.iter().flatten().flat_map(|i| i.to_le_bytes()));
    store::write_atomic(&path, &bytes).map_err(io(&path))
}

/// Gives the scene's first mesh the coordinates that were made for it, if any were.
pub fn apply(session: &Session, scene: &mut Scene) -> Result<(), UvsError> {
    let path = session.path().join(FILE);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(source) => return Err(UvsError::Io { path, source }),
    };
    let Some(object) = scene.meshes.first_mut() else { return Ok(()) };
    let found = read(&bytes, object).map_err(|reason| UvsError::Stale { path, reason })?;
    (object.uvs, object.uv_triangles) = found;
    Ok(())
}

type Coordinates = (Vec<Vec2>, Vec<[u32; 3]>);

fn read(bytes: &[u8], mesh: &Mesh) -> Result<Coordinates, &'static str> {
    let digest = digest(mesh);
    let bytes = bytes.strip_prefix(MAGIC).ok_or("it opens otherwise")?;
    let bytes = bytes.strip_prefix(digest.as_bytes()).ok_or("they are for another mesh")?;
    let (count, bytes) = bytes.split_first_chunk::<8>().ok_or("it ends early")?;
    let length = usize::try_from(u64::from_le_bytes(*count)).ok().and_then(|n| n.checked_mul(8));
    let (uvs, triangles) = length.and_then(|n| bytes.split_at_checked(n)).ok_or("it ends early")?;
    if triangles.len() != 12 * mesh.triangles.len() {
        return Err("it has another number of triangles");
    }
    let word = |at: &[u8]| [at[0], at[1], at[2], at[3]];
    let number = |at: &[u8]| f32::from_le_bytes(word(at));
    let index = |at: &[u8]| u32::from_le_bytes(word(at));
    let uvs: Vec<Vec2> = uvs.chunks_exact(8).map(|p| Vec2::new(number(p), number(&p[4..]))).collect();
    let triangles: Vec<[u32; 3]> =
        triangles.chunks_exact(12).map(|t| [index(t), index(&t[4..]), index(&t[8..])]).collect();
    if triangles.iter().flatten().any(|&i| i as usize >= uvs.len()) {
        return Err("it names coordinates that it does not have");
    }
    Ok((uvs, triangles))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn bare() -> Mesh {
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        Mesh { name: "tetrahedron".into(), positions, triangles, ..Mesh::default() }
    }

    fn scene() -> Scene {
        Scene { cameras: vec![], meshes: vec![bare()] }
    }

    #[test]
    fn coordinates_are_made_kept_and_read_back_for_the_same_mesh_alone() {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("s"), "s").unwrap();
        let mut made = scene();
        let (side, source) =
            settle(&mut made, (UvChoice::Auto, false), |_| Ok(128), &Progress::silent()).unwrap();
        assert_eq!(side, 128);
        let UvSource::Made(told) = &source else { panic!("{source:?}") };
        assert!(told.why == "the mesh has none", "{}", told.why);
        check_own(&made.meshes[0]).unwrap();
        keep(&session, &made.meshes[0], &source).unwrap();

        let mut again = scene();
        apply(&session, &mut again).unwrap();
        assert_eq!(again, made);

        let mut other = scene();
        other.meshes[0].positions[1] *= 2.0;
        assert!(apply(&session, &mut other).unwrap_err().to_string().contains("another mesh"));
        let path = session.path().join(FILE);
        let whole = std::fs::read(&path).unwrap();
        for length in [0, 5, 30, 75, 90, whole.len() - 1] {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(matches!(apply(&session, &mut scene()), Err(UvsError::Stale { .. })), "{length} bytes");
        }
        keep(&session, &made.meshes[0], &UvSource::Own).unwrap();
        let mut own = scene();
        apply(&session, &mut own).unwrap();
        assert_eq!(own, scene());
    }

    #[test]
    fn own_coordinates_are_a_choice_that_is_refused_when_there_are_none() {
        let refused = settle(&mut scene(), (UvChoice::Own, false), |_| Ok(64), &Progress::silent());
        assert!(refused.unwrap_err().to_string().contains("no texture coordinates"));
        let mut made = scene();
        settle(&mut made, (UvChoice::New, true), |_| Ok(64), &Progress::silent()).unwrap();
        let kept =
            settle(&mut made.clone(), (UvChoice::Auto, false), |_| Ok(64), &Progress::silent()).unwrap();
        assert_eq!(kept, (64, UvSource::Own));
    }
}
