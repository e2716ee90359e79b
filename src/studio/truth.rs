//! Writes down what the studio knows: geometry as a photographer would bring it from a reconstruction, and the
//! truth, which processing must never read.
//!
//! ```text
//! geometry/object.obj, floor.obj   metres, z up
//! geometry/cameras.xml             BlocksExchange 2.1: omega, phi, kappa in degrees, XRightYDown
//! geometry/colmap/                 the same cameras as a COLMAP text model
//! truth/albedo/NAME.tif            reflectance * 65535 as each camera sees it through its lens
//! truth/mask/NAME.tif              share of the pixel that is object * 255
//! truth/texture.tif                reflectance * 65535 in the object's texture coordinates
//! truth/scene.json                 sensor, flash, exposure, poses
//! ```
//!
//! NAME is the number of the pair (`0001` at the first stop) of a session whose operator walked once round.

use super::world::{self, WorldError};
use crate::codec::asset::AssetError;
use crate::codec::tiff16;
use crate::progress::Progress;
use crate::scene::export::{self, Photo};
use crate::scene::{Camera, write_obj};
use std::path::{Path, PathBuf};

/// Why the truth could not be written.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// The world could not be set up.
    #[error(transparent)]
    World(#[from] WorldError),
    /// A picture or mesh could not be written.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// A folder or file could not be written.
    #[error("cannot write {}: {source}; choose a folder that you may write to", path.display())]
    Io {
        /// The path.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// What was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Exported {
    /// Views with truth.
    pub views: usize,
    /// Triangles of the object.
    pub triangles: usize,
    /// Texels a side of the texture.
    pub texture_size: usize,
}

const README: &str = "\
The simulated studio of `unlit`: geometry/ is what a reconstruction would give, truth/ is what the light \
simulation was made from and must never be read by processing. Metres, z up; names are the numbers of the pairs of \
one walk round the object from stop 1.
";

/// Writes `geometry/`, `truth/` and a README into `folder`, which is made if need be.
pub fn export(folder: &Path, progress: &Progress) -> Result<Exported, TruthError> {
    let known = world::known(progress)?;
    let (geometry, truth) = (folder.join("geometry"), folder.join("truth"));
    for path in [geometry.join("colmap"), truth.join("albedo"), truth.join("mask")] {
        std::fs::create_dir_all(&path).map_err(|source| TruthError::Io { path, source })?;
    }
    let header = ["metres, z up; facet normals: the surface is exactly these triangles"];
    write_obj(&geometry.join("object.obj"), &known.object, &header)?;
    write_obj(&geometry.join("floor.obj"), &known.floor, &header)?;
    let photos = photos(&known.cameras);
    write_text(&geometry.join("cameras.xml"), &export::blocks_exchange("studio", &photos))?;
    write_text(&geometry.join("colmap/cameras.txt"), &export::colmap_cameras(&photos))?;
    write_text(&geometry.join("colmap/images.txt"), &export::colmap_images(&photos))?;
    write_text(&geometry.join("colmap/points3D.txt"), "# no points\n")?;
    for (i, (camera, view)) in known.cameras.iter().zip(&known.views).enumerate() {
        progress.report("writing the truth", i, known.cameras.len());
        let name = format!("{}.tif", camera.name);
        tiff16::write_rgb16(&truth.join("albedo").join(&name), &view.albedo)?;
        let mask = view.coverage.map(|c| (c * 255.0).round() as u8);
        tiff16::write_grey8(&truth.join("mask").join(&name), &mask)?;
    }
    tiff16::write_rgb16(&truth.join("texture.tif"), &known.texture)?;
    write_text(&truth.join("scene.json"), &format!("{:#}\n", known.facts))?;
    write_text(&folder.join("README.md"), README)?;
    Ok(Exported {
        views: known.views.len(),
        triangles: known.object.triangles.len(),
        texture_size: known.texture.width(),
    })
}

/// Writes cameras as BlocksExchange XML.
pub(super) fn write_cameras(path: &Path, cameras: &[Camera]) -> std::io::Result<()> {
    std::fs::write(path, export::blocks_exchange("studio", &photos(cameras)))
}

fn photos(cameras: &[Camera]) -> Vec<Photo<'_>> {
    cameras.iter().map(|camera| (camera, format!("{}.dng", camera.name))).collect()
}

fn write_text(path: &Path, text: &str) -> Result<(), TruthError> {
    std::fs::write(path, text).map_err(|source| TruthError::Io { path: path.to_owned(), source })
}
