//! From a session's pairs to its solved texture: raws, direct light, bounces, then the texels piece by piece.
//!
//! A piece that is solved is kept in `derived/parts` until the whole is, so that a run that was stopped goes on
//! where it was.

use super::cost::Costs;
use super::develop::{DevelopError, known_light, known_sites, lamp};
use super::manifest::{StageManifest, digest};
use super::process::{Inputs, LARGEST_TEXTURE, ProcessError, ProcessOptions, io};
use crate::calibration::FlashCalibration;
use crate::pair::PairRecord;
use crate::progress::Progress;
use crate::reflectance::atlas;
use crate::reflectance::orientation::face_cameras;
use crate::reflectance::stage::Stage;
use crate::reflectance::texture::{Part, Settled, Solver, Texture};
use crate::scene::{Camera, Mesh, Scene};
use crate::session::{Session, store};
use glam::Vec3;
use std::fs::File;
use std::io::BufReader;
use std::sync::Arc;

pub(super) fn texture_size(
    options: &ProcessOptions,
    object: &Mesh,
    matched: &[(Arc<PairRecord>, Camera)],
) -> Result<usize, ProcessError> {
    if let Some(size) = options.texture_size {
        if !(16..=LARGEST_TEXTURE).contains(&size) {
            return Err(ProcessError::TextureSize(size));
        }
        return Ok(size);
    }
    let n = object.positions.len().max(1) as f32;
    let centre = (object.positions.iter().copied().sum::<Vec3>() / n).as_dvec3();
    let finest = matched
        .iter()
        .map(|(_, camera)| (camera.centre() - centre).length() / camera.intrinsics.focal.max_element())
        .fold(f64::INFINITY, f64::min);
    Ok(atlas::fitting_size(object, finest))
}

/// The scene made ready for light: meshes face the cameras that see them. Gives the names of those turned.
pub(super) fn stage(scene: &mut Scene, views: usize) -> (Stage, Vec<String>) {
    let stage = Stage::build(&scene.meshes, views);
    let turned = face_cameras(&mut scene.meshes, &stage.elements, &scene.cameras);
    if turned.is_empty() { (stage, turned) } else { (Stage::build(&scene.meshes, views), turned) }
}

/// Solves the texture: it, the names of the meshes that were turned to face the cameras, and what it cost. `key` is
/// the digest of everything that goes in, `piece` the bytes for the views of one piece.
pub(super) fn solve(
    session: &Session,
    scene: &mut Scene,
    inputs: &Inputs,
    (size, piece): (usize, f64),
    key: &str,
    progress: &Progress,
) -> Result<(Texture, Vec<String>, Costs), ProcessError> {
    let mut costs = Costs::begin();
    let (stage, turned) = stage(scene, inputs.matched.len());
    costs.done("scene and ray kernel");
    let mut solver = Solver::new(&scene.meshes, &stage, size)?;
    let count = inputs.matched.len();
    for (i, (pair, camera)) in inputs.matched.iter().enumerate() {
        progress.report("looking through the views", i, count);
        let known = known_light(session, pair, &inputs.calibration, inputs.gain(pair))?;
        let expected = (camera.intrinsics.width, camera.intrinsics.height);
        let got = (known.rgb.width(), known.rgb.height());
        if got != expected {
            return Err(DevelopError::Size { name: pair.name.clone(), got, expected }.into());
        }
        solver.add(camera, &known, &lamp(pair, &inputs.calibration, &inputs.scale)?, progress)?;
    }
    costs.done("raws, direct light, first look");
    let mut settled = solver.settle(piece, progress)?;
    costs.done("bounces");
    let mut parts = Parts::open(session, digest(&[key.as_bytes(), &piece.to_le_bytes()]), settled.pieces());
    for piece in 0..settled.pieces() {
        let part = match parts.stored(piece) {
            Some(part) => part,
            None => {
                look_again(session, inputs, &mut settled, piece, progress)?;
                costs.done("raws, second look");
                let part = settled.solve(piece, inputs.calibration.noise.gain, progress)?;
                costs.done("texels");
                parts.keep(piece, &part)?;
                part
            }
        };
        settled.take(&part);
    }
    let measured: Vec<_> = inputs.matched.iter().map(|(pair, _)| inputs.gain(pair)).collect();
    let mut texture = settled.finish(&measured)?;
    texture.add_scale_error(scale_error(&inputs.calibration));
    Ok((texture, turned, costs))
}

/// Looks through all views that a piece needs.
fn look_again(
    session: &Session,
    inputs: &Inputs,
    settled: &mut Settled,
    piece: usize,
    progress: &Progress,
) -> Result<(), ProcessError> {
    let (count, pieces) = (inputs.matched.len(), settled.pieces());
    settled.begin(piece);
    for (i, (pair, camera)) in inputs.matched.iter().enumerate() {
        progress.report("looking again, with bounces", piece * count + i, pieces * count);
        if settled.sees(piece, i) {
            let known = known_sites(session, pair, &inputs.calibration)?;
            let lamp = lamp(pair, &inputs.calibration, &inputs.scale)?;
            settled.add(i, camera, &known, &lamp, inputs.gain(pair), progress)?;
        }
    }
    Ok(())
}

/// Folder of the pieces that are solved, from the session's.
pub(super) const PARTS: &str = "derived/parts";

/// The solved pieces of a texture that is not whole yet.
struct Parts<'a> {
    session: &'a Session,
    manifest: StageManifest,
    key: String,
    pieces: usize,
}

impl<'a> Parts<'a> {
    fn open(session: &'a Session, key: String, pieces: usize) -> Self {
        Self { session, manifest: StageManifest::load(session), key, pieces }
    }

    fn file(piece: usize) -> String {
        format!("{PARTS}/{piece:04}.cbor")
    }

    /// A piece that an earlier run has solved from the same inputs.
    fn stored(&self, piece: usize) -> Option<Part> {
        if !self.manifest.is_done(self.session, &Self::file(piece), &self.key) {
            return None;
        }
        let file = File::open(self.session.path().join(Self::file(piece))).ok()?;
        ciborium::from_reader(BufReader::new(file)).ok()
    }

    /// Keeps a piece; the only one of a texture is not worth it.
    fn keep(&mut self, piece: usize, part: &Part) -> Result<(), ProcessError> {
        if self.pieces == 1 {
            return Ok(());
        }
        let file = Self::file(piece);
        let path = self.session.path().join(&file);
        let folder = self.session.path().join(PARTS);
        std::fs::create_dir_all(&folder).map_err(io(&folder))?;
        let written = store::write_atomic_with(&path, |to| {
            ciborium::into_writer(part, to).map_err(|error| match error {
                ciborium::ser::Error::Io(error) => error,
                ciborium::ser::Error::Value(why) => std::io::Error::other(why),
            })
        });
        written.map_err(io(&path))?;
        let noted = self.manifest.note(self.session, &file, &self.key, std::slice::from_ref(&file));
        noted.map_err(io(&folder))
    }
}

/// Throws the pieces away, the texture being whole.
pub(super) fn remove_parts(session: &Session) -> Result<(), ProcessError> {
    let folder = session.path().join(PARTS);
    match std::fs::remove_dir_all(&folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(io(&folder)(error)),
        _ => Ok(()),
    }
}

/// Relative error of the lamp's radiance, which all texels share.
fn scale_error(calibration: &FlashCalibration) -> [f32; 3] {
    let error = calibration.radiance_dn_standard_error.unwrap_or_default();
    std::array::from_fn(|c| (error[c] / calibration.radiance_dn[c]) as f32)
}
