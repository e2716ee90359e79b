//! `export`: a finished model in other programs' formats and colour spaces; see docs/export.md.
//!
//! Takes what `process` left in `model/` (and per-view images from `derived/`), changes its colours if asked, and writes
//! files into a folder outside the session. Nothing is solved again, but per-view images are made where they are missing.
//! Float formats hold every value as it is; 16-bit TIFF holds 0 to 1, and what it had to clip is counted and told.

mod colour;
mod write;

use self::colour::{camera_colour, name, space, spread, transformed};
use super::certify::{CertificateError, Standing};
use super::colour::ColoursError;
use super::output::up;
use super::process::{ProcessError, ProcessSummary, stored};
use super::scene::{self, SceneError};
use super::uvs::{self, UvsError};
use super::{dress, flash, views};
use crate::calibration::colour::rows;
use crate::codec::asset::AssetError;
use crate::codec::exr_image::{self, Exr};
use crate::codec::png::PngError;
use crate::export::colour::{ACESCG, LINEAR_SRGB};
use crate::export::glb::GlbError;
use crate::progress::{Cancelled, Progress};
use crate::raster::{Image, Rgb};
use crate::scene::Mesh;
use crate::session::{Session, SessionError, store};
use glam::{DMat3, Vec3};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// What can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// `model.glb`: geometry and 8-bit sRGB base colour in one file.
    Glb,
    /// `reflectance.exr`, `stddev.exr`, `views.exr`: 32-bit float.
    Exr,
    /// `reflectance.tif`: 16 bits, linear.
    Tiff,
    /// `model.obj`, `model.mtl`, `model.png` (8-bit sRGB).
    Obj,
    /// `model.usda` and `model_reflectance.exr`.
    Usd,
    /// `views/NAME.tif` and `masks/NAME.tif`: per-view reflectance named like the photos, 16 bits, linear.
    Views,
    /// `views/NAME.exr`: the same in float, alpha 1 where known.
    ViewsExr,
}

/// Colours of what is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Colour {
    /// The camera's own, as solved.
    #[default]
    Camera,
    /// Linear, sRGB's primaries.
    Srgb,
    /// ACEScg.
    AcesCg,
}

/// What is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportOptions {
    /// Formats.
    pub formats: BTreeSet<Format>,
    /// Colours.
    pub colour: Colour,
}

/// What was written.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Exported {
    /// Files, in the order in which they were written.
    pub files: Vec<PathBuf>,
    /// What is to be known of them, in sentences.
    pub notes: Vec<String>,
}

/// Why nothing, or not everything, was exported. Files that were written before stay.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// There is no model.
    #[error("{} has no finished model: run `unlit process` first", .0.display())]
    NoModel(PathBuf),
    /// The model and the scene part.
    #[error(
        "the scene in {} is not the one that the model was made from: run `unlit process` again", .0.display()
    )]
    Stale(PathBuf),
    /// A file of the model is not what it should be.
    #[error("{} has {found}, but {expected} is needed: run `unlit process` again", path.display())]
    Unfit {
        /// The file.
        path: PathBuf,
        /// What it has.
        found: String,
        /// What it should have.
        expected: String,
    },
    /// The target would mix with the session's own files.
    #[error("{} lies inside the session: give --to a folder outside it", .0.display())]
    Inside(PathBuf),
    /// No colour matrix.
    #[error(
        "nothing is known of this camera's colours: no chart was shot, and neither its files nor the decoder's table have \
         a matrix from XYZ to its RGB, so that sRGB and ACEScg cannot be made; shoot a chart (`unlit calibrate colour`), \
         use --colour camera, or convert the raws to DNG with a program that knows the camera and import those"
    )]
    NoColour,
    /// Session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Texture coordinates.
    #[error(transparent)]
    Uvs(#[from] UvsError),
    /// The model's certificate.
    #[error(transparent)]
    Certificate(#[from] CertificateError),
    /// The camera's colours.
    #[error(transparent)]
    Colours(#[from] ColoursError),
    /// A picture or mesh.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// The GLB.
    #[error(transparent)]
    Glb(#[from] GlbError),
    /// The PNG.
    #[error(transparent)]
    Png(#[from] PngError),
    /// Making per-view images, or writing.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Writes the formats asked for into the folder `to`, which is made if it is not there.
pub fn export(
    session: &Session,
    to: &Path,
    options: &ExportOptions,
    progress: &Progress,
) -> Result<Exported, ExportError> {
    refuse_inside(session, to)?;
    if options.formats.iter().any(|f| matches!(f, Format::Views | Format::ViewsExr)) {
        if stored(session).is_none() {
            return Err(ExportError::NoModel(session.path().to_owned()));
        }
        views::ensure(session, progress)?;
    }
    let model = Model::read(session, options.colour)?;
    let mut exported = Exported { notes: model.notes(options), ..Exported::default() };
    let total = options.formats.len();
    for (i, format) in options.formats.iter().enumerate() {
        progress.check()?;
        progress.report("exporting", i, total);
        match format {
            Format::Glb => write::glb(&model, to, &mut exported)?,
            Format::Exr => write::exr(&model, to, &mut exported)?,
            Format::Tiff => write::tiff(&model, to, &mut exported)?,
            Format::Obj => write::obj(&model, to, &mut exported)?,
            Format::Usd => write::usd(&model, to, &mut exported)?,
            Format::Views => {
                write::views(session, &model, to, write::Depth::Sixteen, &mut exported, progress)?
            }
            Format::ViewsExr => {
                write::views(session, &model, to, write::Depth::Float, &mut exported, progress)?
            }
        }
    }
    write::provenance(&model, to, &mut exported)?;
    Ok(exported)
}

/// What `process` made, in the colours asked for.
struct Model {
    summary: ProcessSummary,
    /// With texture coordinates, facing the cameras.
    mesh: Mesh,
    up: Option<Vec3>,
    /// Where it lies.
    folder: PathBuf,
    /// In the colours asked for.
    reflectance: Rgb,
    /// View counts and surface.
    counts: Exr,
    colour: Colour,
    /// From camera RGB to the colours asked for; `None` for the camera's own.
    matrix: Option<DMat3>,
    /// What is to be known of colours and certificate.
    notes: Vec<String>,
    provenance: Value,
}

impl Model {
    fn read(session: &Session, colour: Colour) -> Result<Self, ExportError> {
        let folder = session.model_dir();
        let Some(summary) = stored(session).filter(|_| folder.join("reflectance.exr").is_file()) else {
            return Err(ExportError::NoModel(session.path().to_owned()));
        };
        let mut scene = scene::load(session)?;
        let object = scene.meshes.first().ok_or(SceneError::NoMesh)?;
        if uvs::digest(object) != summary.object {
            return Err(ExportError::Stale(session.scene_dir()));
        }
        uvs::apply(session, &mut scene)?;
        let up = up(&scene.cameras);
        let mut mesh = scene.meshes.swap_remove(0);
        if summary.turned.contains(&mesh.name) {
            mesh.triangles.iter_mut().chain(&mut mesh.uv_triangles).for_each(|t| t.swap(1, 2));
        }
        let reflectance = read_rgb(&folder.join("reflectance.exr"), summary.texture_size)?;
        let counts = exr_image::read(&folder.join("views.exr"))?;
        if counts.channel("surface").is_none_or(|s| s.len() != reflectance.pixels().len()) {
            let expected = "a channel `surface` as large as the texture".into();
            let found = format!("{} channels", counts.channels.len());
            return Err(ExportError::Unfit { path: folder.join("views.exr"), found, expected });
        }
        let asked = space(colour).map(|space| camera_colour(session, &summary).map(|known| (space, known)));
        let (known, matrix, mut notes) = match asked.transpose()? {
            None => (None, None, vec![]),
            Some((space, (known, note))) => {
                let words = format!("colours: {}", known.basis.words());
                let matrix = known.to(&space);
                (Some(known), Some(matrix), note.into_iter().chain([words]).collect())
            }
        };
        let reflectance = match matrix {
            Some(matrix) => transformed(&reflectance, matrix),
            None => reflectance,
        };
        let (certificate, older) = dress::certificate(session)?;
        notes.extend(older);
        let mut provenance = provenance(session, &summary, certificate.as_ref());
        let basis = known.map(|known| known.basis);
        provenance["colour"] =
            json!({ "space": name(colour), "basis": basis, "from_camera": matrix.map(|m| rows(&m)) });
        Ok(Self { summary, mesh, up, folder, reflectance, counts, colour, matrix, notes, provenance })
    }

    /// Standard deviations in the colours asked for.
    fn deviation(&self) -> Result<Rgb, ExportError> {
        let deviation = read_rgb(&self.folder.join("stddev.exr"), self.summary.texture_size)?;
        Ok(self.matrix.map_or_else(|| deviation.clone(), |matrix| spread(&deviation, matrix)))
    }

    /// The reflectance in what display formats take for linear sRGB.
    fn shown(&self) -> Cow<'_, Rgb> {
        match self.colour {
            Colour::Camera | Colour::Srgb => Cow::Borrowed(&self.reflectance),
            Colour::AcesCg => Cow::Owned(transformed(&self.reflectance, LINEAR_SRGB.from_space(&ACESCG))),
        }
    }

    /// Whether each texel lies on the surface.
    fn on_surface(&self) -> impl Iterator<Item = bool> {
        self.counts.channel("surface").unwrap_or_default().iter().map(|s| *s > 0.5)
    }

    fn notes(&self, options: &ExportOptions) -> Vec<String> {
        let mut notes = self.summary.out_of_range.warnings();
        notes.extend(self.notes.iter().cloned());
        let display = options.formats.iter().any(|f| matches!(f, Format::Glb | Format::Obj));
        if display && options.colour == Colour::AcesCg {
            notes.push("GLB and PNG know sRGB alone: their colours are sRGB, not ACEScg".into());
        }
        if display && options.colour == Colour::Camera {
            notes.push("GLB and PNG show camera RGB as if it were sRGB; with --colour srgb it is".into());
        }
        notes
    }
}

/// A square picture of the model.
fn read_rgb(path: &Path, side: usize) -> Result<Rgb, ExportError> {
    let found = exr_image::read(path)?;
    let fits = (found.width, found.height) == (side, side);
    found.rgb().filter(|_| fits).ok_or_else(|| ExportError::Unfit {
        path: path.to_owned(),
        found: format!("{} x {} pixels of {} channels", found.width, found.height, found.channels.len()),
        expected: format!("a square RGB picture of {side}"),
    })
}

/// Where a model came from and how far it can be trusted, for files that can carry it.
pub(super) fn provenance(
    session: &Session,
    summary: &ProcessSummary,
    certificate: Option<&Standing>,
) -> Value {
    json!({
        "software": concat!("unlit ", env!("CARGO_PKG_VERSION")),
        "session": session.manifest().name,
        "session_begun": session.manifest().created,
        "pairs": summary.used,
        "left_out": summary.left_out,
        "calibration": store::digest_file(&flash::file(session)).ok(),
        "object": summary.object,
        "texture_coordinates": summary.uvs,
        "texture_size": summary.texture_size,
        "seen": summary.seen,
        "median_standard_deviation": summary.median_deviation,
        "mean_reflectance": summary.mean_reflectance,
        "out_of_range": summary.out_of_range,
        "certificate": certificate.map(Standing::told),
        "method": "flash-only light over simulated ring-flash light with bounces, weighted least squares over views",
    })
}

pub(super) fn refuse_inside(session: &Session, to: &Path) -> Result<(), ExportError> {
    // What is not there yet has a parent that is, or whose parent is.
    let place = to
        .ancestors()
        .find_map(|p| if p.as_os_str().is_empty() { Path::new(".") } else { p }.canonicalize().ok());
    let own = session.path().canonicalize().ok();
    match (place, own) {
        (Some(place), Some(own)) if place.starts_with(&own) => Err(ExportError::Inside(to.to_owned())),
        _ => Ok(()),
    }
}

/// How many of the values at the `counted` pixels lie below 0 and above 1, and how many there are.
fn clipped(image: &Image<[f32; 3]>, counted: impl Iterator<Item = bool>) -> [usize; 3] {
    let mut found = [0; 3];
    for (pixel, _) in image.pixels().iter().zip(counted).filter(|(_, c)| *c) {
        for value in pixel {
            found[0] += usize::from(*value < 0.0);
            found[1] += usize::from(*value > 1.0);
            found[2] += 1;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clipped_values_are_counted_on_the_surface_alone() {
        let image = Image::from_pixels(2, 1, vec![[-0.1, 0.5, 1.2], [2.0; 3]]).unwrap();
        assert_eq!(clipped(&image, [true, false].into_iter()), [1, 1, 3]);
        assert_eq!(clipped(&image, [true, true].into_iter()), [1, 4, 6]);
    }

    #[test]
    fn the_session_keeps_its_own_folders() {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("s"), "s").unwrap();
        for inside in ["s", "s/model", "s/new/deep"] {
            assert!(matches!(
                refuse_inside(&session, &folder.path().join(inside)),
                Err(ExportError::Inside(_))
            ));
        }
        refuse_inside(&session, &folder.path().join("out/of/it")).unwrap();
        let formats = BTreeSet::from([Format::Exr]);
        let options = ExportOptions { formats, colour: Colour::Camera };
        let nothing = export(&session, &folder.path().join("out"), &options, &Progress::silent());
        assert!(matches!(nothing, Err(ExportError::NoModel(_))));
    }
}
