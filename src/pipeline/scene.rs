//! Cameras and meshes of other programs into a session, and back out of it.
//!
//! [`import()`] keeps the originals under `scene/originals/` as they are and writes `scene/scene.json`: cameras
//! in our conventions and metres, which mesh file is which, what was read and how it was scaled, and the
//! figures of a self-check. `scene.json` is replaced last, in one step, so an import that breaks off leaves
//! the former scene whole. [`load`] reads the scene again and refuses originals that were altered.

mod check;

pub use check::{SelfCheck, ViewCheck};

use crate::codec::asset::AssetError;
use crate::progress::{Cancelled, Progress};
use crate::scene::import::{self, ImportError, ImportedCameras};
use crate::scene::{Camera, Mesh, Scene, read_obj};
use crate::session::{Session, SessionError, store};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Why a scene could not be imported or loaded.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// Nothing imported yet.
    #[error("the session {} has no scene; import cameras and meshes with `unlit import scene`", .0.display())]
    NoScene(PathBuf),
    /// `scene.json` is broken.
    #[error("{} is damaged ({reason}); import the scene again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// No mesh was given.
    #[error("no mesh was given; name the object's OBJ file first, then a floor or stage, if there is one")]
    NoMesh,
    /// A scale that is not a positive number.
    #[error("the scale {0} is not a positive number; it says by how much lengths are multiplied")]
    Scale(f64),
    /// The cameras are in no known form.
    #[error(
        "{} holds no cameras that can be read; give a BlocksExchange XML file, or a folder with COLMAP's \
         cameras.txt and images.txt", .0.display()
    )]
    NoCameras(PathBuf),
    /// A camera file that does not hold together.
    #[error("{}: {source}", path.display())]
    Cameras {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong.
        source: ImportError,
    },
    /// A mesh that cannot be read.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// The file system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Unit of length of the files that are imported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    /// Metres.
    #[default]
    #[serde(rename = "m")]
    Metre,
    /// Centimetres.
    #[serde(rename = "cm")]
    Centimetre,
    /// Millimetres.
    #[serde(rename = "mm")]
    Millimetre,
}

/// How lengths in the files become metres: by the unit, then times `scale` (1 when the files are true to
/// size). Cameras and meshes are scaled alike.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lengths {
    /// Unit that the files use.
    pub unit: Unit,
    /// Further factor, for reconstructions of unknown size.
    pub scale: f64,
}

impl Default for Lengths {
    fn default() -> Self {
        Self { unit: Unit::Metre, scale: 1.0 }
    }
}

impl Lengths {
    fn metres_per_unit(self) -> Result<f64, SceneError> {
        if !(self.scale.is_finite() && self.scale > 0.0) {
            return Err(SceneError::Scale(self.scale));
        }
        let unit = match self.unit {
            Unit::Metre => 1.0,
            Unit::Centimetre => 1e-2,
            Unit::Millimetre => 1e-3,
        };
        Ok(unit * self.scale)
    }
}

/// `scene/scene.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneFile {
    /// Version of this layout.
    pub format: u32,
    /// How the originals were scaled.
    pub lengths: Lengths,
    /// Camera files as given.
    pub camera_files: Vec<Original>,
    /// Cameras in our conventions, metres.
    pub cameras: Vec<Camera>,
    /// Image paths of photos that were listed without a pose.
    pub without_pose: Vec<String>,
    /// Meshes, the object first.
    pub meshes: Vec<MeshFile>,
    /// What the import's self-check found.
    pub check: SelfCheck,
}

/// An imported file, kept as it was.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Original {
    /// Where it lies, from the session's `scene` folder.
    pub file: String,
    /// Where it came from.
    pub source: String,
    /// BLAKE3 of its bytes, hexadecimal.
    pub blake3: String,
}

/// A mesh of the scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeshFile {
    /// File stem that it was imported under.
    pub name: String,
    /// The OBJ file.
    #[serde(flatten)]
    pub original: Original,
    /// Vertices.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Whether it has texture coordinates.
    pub textured: bool,
}

const FORMAT: u32 = 1;

/// Imports cameras (a BlocksExchange XML file, or a folder with COLMAP's texts) and meshes, the object first.
/// The session must be open for writing.
pub fn import(
    session: &Session,
    cameras: &Path,
    meshes: &[PathBuf],
    lengths: Lengths,
    progress: &Progress,
) -> Result<SceneFile, SceneError> {
    let folder = session.scene_dir();
    let metres_per_unit = lengths.metres_per_unit()?;
    if meshes.is_empty() {
        return Err(SceneError::NoMesh);
    }
    let steps = meshes.len() + 2;
    progress.report("reading cameras", 0, steps);
    let (camera_sources, imported) = read_cameras(cameras)?;
    let ImportedCameras { mut cameras, without_pose } = imported;
    import::scale_cameras(&mut cameras, metres_per_unit);

    let mut read = Vec::with_capacity(meshes.len());
    for (i, path) in meshes.iter().enumerate() {
        progress.check()?;
        progress.report("reading meshes", i + 1, steps);
        read.push(read_obj(path, metres_per_unit)?);
    }
    let check = check::check(&cameras, &read[0]);

    progress.check()?;
    progress.report("writing the scene", steps - 1, steps);
    let originals = folder.join("originals");
    std::fs::create_dir_all(&originals).map_err(io("create", &originals))?;
    let camera_files = camera_sources.iter().map(|p| keep(&folder, p)).collect::<Result<Vec<_>, _>>()?;
    let mesh_files = meshes
        .iter()
        .zip(&read)
        .map(|(path, mesh)| {
            Ok(MeshFile {
                name: mesh.name.clone(),
                original: keep(&folder, path)?,
                vertices: mesh.positions.len(),
                triangles: mesh.triangles.len(),
                textured: !mesh.uv_triangles.is_empty(),
            })
        })
        .collect::<Result<Vec<_>, SceneError>>()?;
    let file =
        SceneFile { format: FORMAT, lengths, camera_files, cameras, without_pose, meshes: mesh_files, check };
    let path = folder.join("scene.json");
    let json = serde_json::to_vec_pretty(&file)
        .map_err(|e| SceneError::Damaged { path: path.clone(), reason: e.to_string() })?;
    session.keep(&path, &json)?;
    progress.report("writing the scene", steps, steps);
    Ok(file)
}

/// Reads `scene/scene.json` alone: cameras and facts, no meshes.
pub fn load_file(session: &Session) -> Result<SceneFile, SceneError> {
    let path = session.scene_dir().join("scene.json");
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            return Err(SceneError::NoScene(session.path().to_owned()));
        }
        Err(e) => return Err(io("read", &path)(e)),
    };
    let file: SceneFile = serde_json::from_slice(&bytes)
        .map_err(|e| SceneError::Damaged { path: path.clone(), reason: e.to_string() })?;
    if file.format != FORMAT {
        let reason = format!("layout {} instead of {FORMAT}", file.format);
        return Err(SceneError::Damaged { path, reason });
    }
    Ok(file)
}

/// Reads the imported scene: cameras, and meshes scaled to metres.
pub fn load(session: &Session) -> Result<Scene, SceneError> {
    let folder = session.scene_dir();
    let SceneFile { lengths, cameras, meshes, .. } = load_file(session)?;
    let metres_per_unit = lengths.metres_per_unit()?;
    let meshes = meshes
        .into_iter()
        .map(|entry| {
            let path = folder.join(&entry.original.file);
            let bytes = std::fs::read(&path).map_err(io("read", &path))?;
            if store::digest(&bytes) != entry.original.blake3 {
                let reason = "it is not the file that was imported".to_owned();
                return Err(SceneError::Damaged { path, reason });
            }
            Ok(Mesh { name: entry.name, ..read_obj(&path, metres_per_unit)? })
        })
        .collect::<Result<Vec<_>, _>>()?;
    Ok(Scene { cameras, meshes })
}

/// The files that hold the cameras, and what they say.
fn read_cameras(path: &Path) -> Result<(Vec<PathBuf>, ImportedCameras), SceneError> {
    let wrap = |source| SceneError::Cameras { path: path.to_owned(), source };
    let read = |path: &Path| std::fs::read_to_string(path).map_err(io("read", path));
    if path.is_dir() {
        let (lenses, poses) = (path.join("cameras.txt"), path.join("images.txt"));
        if !(lenses.is_file() && poses.is_file()) {
            return Err(SceneError::NoCameras(path.to_owned()));
        }
        let imported = import::colmap_text::parse(&read(&lenses)?, &read(&poses)?).map_err(wrap)?;
        return Ok((vec![lenses, poses], imported));
    }
    let text = read(path)?;
    if !text.trim_start_matches('\u{feff}').trim_start().starts_with('<') {
        return Err(SceneError::NoCameras(path.to_owned()));
    }
    Ok((vec![path.to_owned()], import::blocks_exchange::parse(&text).map_err(wrap)?))
}

/// Copies a file under `originals/`, named by content, so that equal names do not meet and a former import's
/// files stay until its `scene.json` is replaced.
fn keep(folder: &Path, source: &Path) -> Result<Original, SceneError> {
    let bytes = std::fs::read(source).map_err(io("read", source))?;
    let digest = store::digest(&bytes);
    let name = source.file_name().unwrap_or_default().to_string_lossy();
    let file = format!("originals/{}_{name}", &digest[..12]);
    let kept = folder.join(&file);
    if std::fs::read(&kept).ok().as_ref() != Some(&bytes) {
        store::write_atomic(&kept, &bytes).map_err(io("write", &kept))?;
    }
    Ok(Original { file, source: source.display().to_string(), blake3: digest })
}

fn io<'a>(action: &'static str, path: &'a Path) -> impl FnOnce(std::io::Error) -> SceneError + 'a {
    move |source| SceneError::Io { action, path: path.to_owned(), source }
}
