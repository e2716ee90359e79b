//! `certify`: known patches, left in the scene, against the finished reflectance; see docs/certificate.md.
//!
//! The model then carries a certificate: `model/certificate.json`, in `asset.extras` of its GLB, and in its report. It
//! names the digest of the texture that it speaks of; of another texture it is stale, and that is said wherever it shows.

mod look;
mod patches;
mod words;

pub use look::Source;
pub use patches::{KnownColour, KnownPatch, PatchList, Place};
pub use words::{HEAD, rows};

use super::colour::{Basis, ColoursError, SessionColours};
use super::process::{self, ProcessError};
use super::{standing, views};
use crate::calibration::Verdict;
use crate::calibration::certificate::{CertificateSummary, Comparison, PatchReading};
use crate::codec::asset::AssetError;
use crate::codec::exr_image;
use crate::pair::PairRecord;
use crate::progress::{Cancelled, Progress};
use crate::reflectance::atlas::AtlasError;
use crate::session::{Session, advice, store, utc_now};
use look::{Found, Looked, Surface};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Form of the certificates that this program writes.
pub const SCHEMA: u32 = 2;

/// Why there is no certificate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CertifyError {
    /// There is no model, or another.
    #[error("the session has no finished model that its files make now: run `unlit process` first")]
    NoModel,
    /// The list of patches cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
    /// It is none.
    #[error("the list of patches cannot be used: {0}; docs/certificate.md shows its form")]
    Patches(String),
    /// One of them cannot be.
    #[error("patch {name:?} {what}")]
    Patch {
        /// Its name.
        name: String,
        /// What is wrong.
        what: String,
    },
    /// Nobody knows the camera's colours.
    #[error(
        "of patch {0:?} the colour is known, but nobody knows this camera's colours: shoot a chart (`unlit calibrate colour`), or give the patch as `grey` or `camera_rgb`"
    )]
    NoColour(String),
    /// A picture of the model that is not what it should be.
    #[error("the pictures in {} do not fit each other: run `unlit process` again", .0.display())]
    Unfit(PathBuf),
    /// A picture cannot be read.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// Texture coordinates.
    #[error(transparent)]
    Atlas(#[from] AtlasError),
    /// The camera's colours.
    #[error(transparent)]
    Colours(#[from] ColoursError),
    /// The model, or writing.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Why a certificate that was made cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CertificateError {
    /// The disk refused.
    #[error("{}: {source}; {}", path.display(), advice(source))]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
    /// It is of an earlier program.
    #[error("{} was written by an earlier version of unlit, in a form that is not read any more: certify again, or remove it", .0.display())]
    Older(PathBuf),
    /// It is of a later program.
    #[error("{} was written by a later version of unlit (form {found}, this program knows {SCHEMA}): update unlit", path.display())]
    TooNew {
        /// The file.
        path: PathBuf,
        /// Its form.
        found: u32,
    },
    /// It is broken.
    #[error("{} is damaged ({reason}): certify again, or remove it", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
}

/// Digests (BLAKE3) of what a certificate was made from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Made {
    /// `model/reflectance.exr`.
    pub reflectance_blake3: String,
    /// `model/stddev.exr`.
    pub stddev_blake3: String,
    /// `model/views.exr`.
    pub views_blake3: String,
    /// The list of patches.
    pub patches_blake3: String,
}

/// One patch of a certificate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PatchResult {
    /// As it was given.
    #[serde(flatten)]
    pub patch: KnownPatch,
    /// Where its value was read; absent if it was not seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read: Option<Source>,
    /// Found against known; absent if it was not seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub comparison: Option<Comparison>,
    /// Why it was not seen; absent if it was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_seen: Option<String>,
}

/// A model's certificate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// [`SCHEMA`] at the time of writing.
    pub schema: u32,
    /// When it was made, UTC.
    pub made: String,
    /// Name and version of the program that made it.
    pub software: String,
    /// The session's name.
    pub session: String,
    /// What it was made from.
    pub inputs: Made,
    /// Where the camera's colours come from; absent where nobody knows them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub colour: Option<Basis>,
    /// The patches, as given.
    pub patches: Vec<PatchResult>,
    /// All together.
    pub summary: CertificateSummary,
    /// In words.
    pub verdict: Verdict,
}

/// Certifies a session's model by the patches of a file; keeps the certificate and puts it into GLB and report.
pub fn certify(session: &Session, file: &Path, progress: &Progress) -> Result<Certificate, CertifyError> {
    let bytes = std::fs::read(file).map_err(|source| CertifyError::Read { path: file.to_owned(), source })?;
    let model = standing::standing(session)?.ok_or(CertifyError::NoModel)?;
    let names: Vec<&str> = model.summary.used.iter().map(String::as_str).collect();
    let patches = PatchList::parse(&bytes, &names)?;
    let pairs: Vec<&PairRecord> = model.inputs.matched.iter().map(|(pair, _)| &**pair).collect();
    let colours = SessionColours::known(session, &pairs)?;
    if let (None, Some(patch)) = (&colours.matrix, patches.iter().find(|p| p.known.needs_matrix())) {
        return Err(CertifyError::NoColour(patch.name.clone()));
    }
    let looked = look_at(session, &model.inputs.scene, &patches, &names, progress)?;
    let results: Vec<PatchResult> =
        patches.into_iter().zip(looked).map(|(patch, looked)| result(patch, looked, &colours)).collect();
    let made = inputs(session, &bytes)?;
    let mut certificate = finish(session, results, made, colours.matrix.map(|m| m.basis));
    certificate.verdict.sentences.extend(colours.note);
    let path = path(session);
    let text = serde_json::to_vec_pretty(&certificate).map_err(std::io::Error::other);
    text.and_then(|text| store::write_atomic(&path, &text)).map_err(process::io(&path))?;
    progress.report("writing the model", 0, 1);
    model.dress(session)?;
    Ok(certificate)
}

/// Looks for all places: on the object, then beside it.
fn look_at(
    session: &Session,
    scene: &crate::scene::Scene,
    patches: &[KnownPatch],
    views: &[&str],
    progress: &Progress,
) -> Result<Vec<Looked>, CertifyError> {
    progress.report("looking for the patches", 0, 1);
    let folder = session.model_dir();
    let mut surface = Surface::read(scene, &folder)?.ok_or(CertifyError::Unfit(folder))?;
    if patches.iter().any(|p| matches!(p.place, Place::Point { .. } | Place::Quad { .. })) {
        surface.lay_out()?;
    }
    progress.check()?;
    let mut looked: Vec<Looked> = patches.iter().map(|patch| surface.look(&patch.place)).collect();
    let beside: Vec<usize> = (0..looked.len()).filter(|&k| matches!(looked[k], Looked::Beside)).collect();
    if !beside.is_empty() {
        views::ensure(session, progress)?;
        let places: Vec<&Place> = beside.iter().map(|&k| &patches[k].place).collect();
        let read = |name: &str| {
            let path = session.derived_dir().join("views").join(name).join("reflectance.exr");
            let image = exr_image::read(&path)?;
            image.rgba().ok_or(CertifyError::Unfit(path))
        };
        let found = surface.look_beside(&places, views, read, progress)?;
        beside.into_iter().zip(found).for_each(|(k, found)| looked[k] = found);
    }
    Ok(looked)
}

fn result(patch: KnownPatch, looked: Looked, colours: &SessionColours) -> PatchResult {
    let matrix = colours.matrix.as_ref();
    let unseen = |patch, why| PatchResult { patch, read: None, comparison: None, not_seen: Some(why) };
    match (looked, patch.known.in_camera_rgb(matrix)) {
        (Looked::Found(Found { mean, deviation, source }), Ok(known)) => {
            let lab = matrix.map(|matrix| [known, mean].map(|rgb| matrix.lab(rgb)));
            let comparison = Comparison::of(&PatchReading { known, found: mean, deviation, lab });
            PatchResult { patch, read: Some(source), comparison: Some(comparison), not_seen: None }
        }
        (Looked::Beside, _) => unseen(patch, "no surface lies there".into()),
        (Looked::Unseen(why), _) | (_, Err(why)) => unseen(patch, why),
    }
}

fn finish(session: &Session, patches: Vec<PatchResult>, inputs: Made, colour: Option<Basis>) -> Certificate {
    let summary = CertificateSummary::of(patches.iter().map(|p| p.comparison.as_ref()));
    let names = |of: &dyn Fn(&PatchResult) -> bool| -> Vec<&str> {
        patches.iter().filter(|p| of(p)).map(|p| p.patch.name.as_str()).collect()
    };
    let unsure = names(&|p| p.comparison.as_ref().is_some_and(|c| c.within_2_percent.sure == Some(false)));
    let unseen = names(&|p| p.not_seen.is_some());
    let verdict = summary.verdict(&unsure, &unseen);
    Certificate {
        schema: SCHEMA,
        made: utc_now(),
        software: concat!("unlit ", env!("CARGO_PKG_VERSION")).into(),
        session: session.manifest().name,
        inputs,
        colour,
        patches,
        summary,
        verdict,
    }
}

fn inputs(session: &Session, patches: &[u8]) -> Result<Made, CertifyError> {
    let of = |name: &str| {
        let path = session.model_dir().join(name);
        store::digest_file(&path).map_err(|source| CertifyError::Read { path, source })
    };
    Ok(Made {
        reflectance_blake3: of("reflectance.exr")?,
        stddev_blake3: of("stddev.exr")?,
        views_blake3: of("views.exr")?,
        patches_blake3: store::digest(patches),
    })
}

fn path(session: &Session) -> PathBuf {
    session.model_dir().join("certificate.json")
}

/// A certificate and whether it is of the model that is there.
#[derive(Clone, Debug, PartialEq)]
pub struct Standing {
    /// The certificate.
    pub certificate: Certificate,
    /// It speaks of another texture.
    pub stale: bool,
}

impl Standing {
    /// The session's certificate; `None` if none was made.
    pub fn load(session: &Session) -> Result<Option<Self>, CertificateError> {
        let path = path(session);
        let bytes = match std::fs::read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            read => read.map_err(|source| CertificateError::Io { path: path.clone(), source })?,
        };
        #[derive(Deserialize)]
        struct Form {
            schema: u32,
        }
        let damaged =
            |e: serde_json::Error| CertificateError::Damaged { path: path.clone(), reason: e.to_string() };
        match serde_json::from_slice::<Form>(&bytes).map_err(damaged)?.schema {
            SCHEMA => {}
            found if found > SCHEMA => return Err(CertificateError::TooNew { path, found }),
            _ => return Err(CertificateError::Older(path)),
        }
        let certificate: Certificate = serde_json::from_slice(&bytes).map_err(damaged)?;
        let texture = session.model_dir().join("reflectance.exr");
        let stale = match store::digest_file(&texture) {
            Ok(found) => found != certificate.inputs.reflectance_blake3,
            Err(error) if error.kind() == ErrorKind::NotFound => true,
            Err(source) => return Err(CertificateError::Io { path: texture, source }),
        };
        Ok(Some(Self { certificate, stale }))
    }

    /// For files that can carry it; of a stale one that it is stale, and no figures.
    pub fn told(&self) -> Value {
        if self.stale {
            json!({ "stale": true, "made": self.certificate.made })
        } else {
            json!(self.certificate)
        }
    }
}
