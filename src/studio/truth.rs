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
use crate::scene::{Camera, write_obj};
use glam::{DMat3, DQuat};
use std::fmt::Write as _;
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
    write_text(&geometry.join("cameras.xml"), &blocks_exchange(&known.cameras))?;
    write_text(&geometry.join("colmap/cameras.txt"), &colmap_cameras(&known.cameras))?;
    write_text(&geometry.join("colmap/images.txt"), &colmap_images(&known.cameras))?;
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

/// Writes cameras (at least one, of one lens) as BlocksExchange XML.
pub(super) fn write_cameras(path: &Path, cameras: &[Camera]) -> std::io::Result<()> {
    std::fs::write(path, blocks_exchange(cameras))
}

fn write_text(path: &Path, text: &str) -> Result<(), TruthError> {
    std::fs::write(path, text).map_err(|source| TruthError::Io { path: path.to_owned(), source })
}

/// Angles in degrees of a rotation Rx(omega) Ry(phi) Rz(kappa).
fn omega_phi_kappa(rotation: DMat3) -> [f64; 3] {
    let (x, y, z) = (rotation.x_axis, rotation.y_axis, rotation.z_axis);
    [(-z.y).atan2(z.z), z.x.clamp(-1.0, 1.0).asin(), (-y.x).atan2(x.x)].map(f64::to_degrees)
}

fn blocks_exchange(cameras: &[Camera]) -> String {
    let mut photos = String::new();
    for (id, camera) in cameras.iter().enumerate() {
        let [omega, phi, kappa] = omega_phi_kappa(camera.world_from_camera.matrix3);
        let c = camera.centre();
        // Writing to a string cannot fail.
        let _ = writeln!(
            photos,
            "        <Photo><Id>{id}</Id><ImagePath>{}.dng</ImagePath><Pose><Rotation><Omega>{omega:.12}</Omega>\
             <Phi>{phi:.12}</Phi><Kappa>{kappa:.12}</Kappa></Rotation><Center><x>{}</x><y>{}</y><z>{}</z></Center>\
             </Pose></Photo>",
            camera.name, c.x, c.y, c.z
        );
    }
    let lens = cameras[0].intrinsics;
    let (width, height) = (lens.width, lens.height);
    // The format counts the principal point from the centre of the first pixel.
    let (cx, cy) = (lens.principal.x - 0.5, lens.principal.y - 0.5);
    let focal = lens.focal.x * 36.0 / width.max(height) as f64;
    format!(
        r#"<?xml version="1.0" encoding="utf-8"?>
<BlocksExchange version="2.1">
  <Block>
    <Name>studio</Name>
    <Photogroups>
      <Photogroup>
        <Name>camera</Name>
        <ImageDimensions><Width>{width}</Width><Height>{height}</Height></ImageDimensions>
        <CameraModelType>Perspective</CameraModelType>
        <FocalLength>{focal}</FocalLength>
        <SensorSize>36</SensorSize>
        <CameraOrientation>XRightYDown</CameraOrientation>
        <PrincipalPoint><x>{cx}</x><y>{cy}</y></PrincipalPoint>
        <Distortion><K1>0</K1><K2>0</K2><K3>0</K3><P1>0</P1><P2>0</P2></Distortion>
{photos}      </Photogroup>
    </Photogroups>
  </Block>
</BlocksExchange>
"#
    )
}

fn colmap_cameras(cameras: &[Camera]) -> String {
    let lens = cameras[0].intrinsics;
    format!(
        "# Camera list: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 PINHOLE {} {} {} {} {} {}\n",
        lens.width, lens.height, lens.focal.x, lens.focal.y, lens.principal.x, lens.principal.y
    )
}

fn colmap_images(cameras: &[Camera]) -> String {
    let mut text =
        "# Image list: IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then an empty POINTS2D line\n"
            .to_owned();
    for (id, camera) in cameras.iter().enumerate() {
        let camera_from_world = camera.world_from_camera.inverse();
        let q = DQuat::from_mat3(&camera_from_world.matrix3).normalize();
        let t = camera_from_world.translation;
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{} {} {} {} {} {} {} {} 1 {}.dng\n",
            id + 1,
            q.w,
            q.x,
            q.y,
            q.z,
            t.x,
            t.y,
            t.z,
            camera.name
        );
    }
    text
}
