//! Pairs that were shot to a card: from two folders of files into the session, judged on the way.
//!
//! Files are matched by their stem (`IMG_0007.CR2` with `IMG_0007.CR2`), which becomes the pair's name.
//! Every pair is stored, the rejected ones too, with what is wrong with them: by itself, and against the
//! session's earlier pairs from the same stop. A pair that is there already (same name, same bytes) is passed
//! over; a name that is there with other bytes is an error.

use crate::calibration::exposure::ExposureTable;
use crate::codec::{exif::settings as settings_of, raw};
use crate::pair::order::Slot;
use crate::pair::{
    self, Drift, Expected, FrameView, Judgement, Limits, PairRecord, Plan, Reason, ReasonCode, Settings,
    Verdict,
};
use crate::photometry::inspect::Region;
use crate::photometry::levels::MeasuredLevels;
use crate::pipeline::calibrate::RecordError;
use crate::pipeline::levels;
use crate::pipeline::scale::{RatioError, SessionScale};
use crate::pipeline::stops::{Delivery, Earlier, EarlierError};
use crate::progress::{Cancelled, Progress};
use crate::session::{Commit, Manifest, More, NewFrame, NewPair, Prepared, Session, SessionError, store};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// What cameras and programs lay beside their raws, not raws themselves.
const SIDECARS: [&str; 12] =
    ["jpg", "jpeg", "heif", "hif", "xmp", "thm", "txt", "md", "json", "pp3", "wav", "mp4"];

/// One pair of the import.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// The pair as stored.
    pub record: PairRecord,
    /// Whether it had been stored by an earlier import.
    pub already_there: bool,
}

/// What an import did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Summary {
    /// All matched pairs, in order of their names.
    pub imported: Vec<Imported>,
    /// Files without flash that have no partner.
    pub unmatched_off: Vec<PathBuf>,
    /// Files with flash that have no partner.
    pub unmatched_on: Vec<PathBuf>,
    /// Why the session's own sensor levels do not count for some of them.
    pub remarks: BTreeSet<String>,
}

/// Why an import stopped. Pairs stored before stay.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// A folder or file could not be read.
    #[error("{path}: {source}; check the path and its permissions")]
    Io {
        /// Which.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
    /// Two files of one folder have one stem.
    #[error("{first} and {second} have the same name but for their ending; keep one of them")]
    Ambiguous {
        /// One.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
    /// No name occurs in both folders.
    #[error("{off} and {on} have no file name in common; the two frames of a pair must bear the same name")]
    NothingMatches {
        /// Folder of unlit frames.
        off: PathBuf,
        /// Folder of lit frames.
        on: PathBuf,
    },
    /// The file of limits is not one.
    #[error("{path} holds no limits of the checks: {source}; docs/checks.md lists them")]
    Limits {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: serde_json::Error,
    },
    /// A calibration of the session cannot be read.
    #[error(transparent)]
    Levels(#[from] RecordError),
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl From<EarlierError> for ImportError {
    fn from(error: EarlierError) -> Self {
        match error {
            EarlierError::Session(error) => error.into(),
            EarlierError::Record(error) => error.into(),
            EarlierError::Cancelled(cancelled) => cancelled.into(),
        }
    }
}

/// Limits out of a JSON file; the defaults without one.
pub fn read_limits(path: Option<&Path>) -> Result<Limits, ImportError> {
    let Some(path) = path else { return Ok(Limits::default()) };
    let bytes = std::fs::read(path).map_err(io(path))?;
    serde_json::from_slice(&bytes).map_err(|source| ImportError::Limits { path: path.to_owned(), source })
}

/// Imports all pairs that the two folders have in common; `each` is told of every pair as it is stored.
pub fn import(
    session: &Session,
    off_dir: &Path,
    on_dir: &Path,
    limits: &Limits,
    progress: &Progress,
    mut each: impl FnMut(&Imported),
) -> Result<Summary, ImportError> {
    let off_files = files_by_stem(off_dir)?;
    let mut on_files = files_by_stem(on_dir)?;
    let mut summary = Summary::default();
    let mut matched = Vec::new();
    for (stem, off) in off_files {
        match on_files.remove(&stem) {
            Some(on) => matched.push((stem, off, on)),
            None => summary.unmatched_off.push(off),
        }
    }
    summary.unmatched_on = on_files.into_values().collect();
    if matched.is_empty() {
        return Err(ImportError::NothingMatches { off: off_dir.to_owned(), on: on_dir.to_owned() });
    }
    let measured = levels::load(session)?;
    let mut earlier = Earlier::load(session, progress)?;
    let total = matched.len();
    for (done, (stem, off, on)) in matched.into_iter().enumerate() {
        progress.check()?;
        progress.report("importing pairs", done, total);
        let imported = import_pair(session, (&measured, &mut earlier), &stem, [&off, &on], limits)?;
        each(&imported);
        // Those of another body are rejected with that reason.
        if imported.record.verdict == Verdict::Accepted {
            summary.remarks.extend(levels::remark(&measured, &imported.record.on.settings));
        }
        summary.imported.push(imported);
    }
    progress.report("importing pairs", total, total);
    Ok(summary)
}

fn import_pair(
    session: &Session,
    (measured, earlier): (&MeasuredLevels, &mut Earlier),
    stem: &str,
    [off, on]: [&Path; 2],
    limits: &Limits,
) -> Result<Imported, ImportError> {
    let (off_bytes, on_bytes) = (std::fs::read(off).map_err(io(off))?, std::fs::read(on).map_err(io(on))?);
    let read = |bytes: &[u8], path: &Path| {
        (levels::decode(bytes, &path.display().to_string(), measured), store::digest(bytes))
    };
    let ((off_photo, off_digest), (on_photo, on_digest)) =
        rayon::join(|| read(&off_bytes, off), || read(&on_bytes, on));
    let manifest = session.manifest();
    let mut expected = earlier.expecting(&off_digest, &on_digest, None, Delivery::Files);
    expected.plan = manifest.plan.as_ref();
    expected.region = region_of(&manifest, &off_photo);
    let Judgement { reasons, stop } = judge(&off_photo, &on_photo, &expected, earlier.scale(), limits);
    // What cannot be decoded may still tell its settings.
    let settings = |photo: Result<raw::Photo, raw::RawError>, bytes: &[u8]| -> Settings {
        photo.map_or_else(|_| settings_of(bytes), |photo| photo.settings)
    };
    let (off_name, on_name) = (file_name(off), file_name(on));
    let new = NewPair {
        name: Some(stem),
        off: NewFrame {
            bytes: &off_bytes,
            original_name: &off_name,
            settings: settings(off_photo, &off_bytes),
            prepared: Some(Prepared { blake3: off_digest.clone(), staged: None }),
            jpeg: None,
        },
        on: NewFrame {
            bytes: &on_bytes,
            original_name: &on_name,
            settings: settings(on_photo, &on_bytes),
            prepared: Some(Prepared { blake3: on_digest.clone(), staged: None }),
            jpeg: None,
        },
        reasons,
        flash: None,
        more: More::default(),
    };
    Ok(match session.commit_pair(new)? {
        Commit::Stored(record) => {
            earlier.add(session, &record, stop)?;
            Imported { record, already_there: false }
        }
        Commit::AlreadyThere(record) => Imported { record, already_there: true },
    })
}

/// The session's region of interest in the sites of a frame of this size.
pub fn region_of(manifest: &Manifest, frame: &Result<raw::Photo, raw::RawError>) -> Option<Region> {
    let dn = &frame.as_ref().ok()?.mosaic.dn;
    manifest.region.map(|window| window.sites(dn.width(), dn.height()))
}

/// Judges a pair by its two decoded files: what decoding says, else what the checks say, exposures scaled by the
/// session's `scale`. The one entry for pairs just shot and pairs that came in as files.
pub fn judge(
    off: &Result<raw::Photo, raw::RawError>,
    on: &Result<raw::Photo, raw::RawError>,
    expected: &Expected,
    scale: &SessionScale,
    limits: &Limits,
) -> Judgement {
    match (off, on) {
        (Ok(off), Ok(on)) => {
            let (table, refused) = match scale.between(&on.settings, &off.settings) {
                Ok(table) => (table, None),
                Err(other) => (ExposureTable::default(), Some(RatioError::from(other))),
            };
            let expected = Expected { scale: Some(&table), ..*expected };
            let mut judgement = pair::judge_expecting(view(off), view(on), &expected, limits);
            // Such a pair cannot be processed either.
            judgement.reasons.extend(refused.map(|why| Reason {
                code: ReasonCode::SettingsChanged,
                figure: 1.0,
                limit: 0.0,
                sentence: format!("The two frames cannot be scaled to each other: {why}."),
            }));
            judgement
        }
        (off, on) => {
            let errors = [off, on].into_iter().filter_map(|p| p.as_ref().err());
            Judgement { reasons: errors.map(raw::RawError::reason).collect(), stop: None }
        }
    }
}

/// Holds a further frame without flash against the pair's first, as decoded: what is wrong with it, and how room and
/// camera drifted. What is wrong with the first itself is [`judge`]'s to say.
pub fn judge_dark(
    first: &Result<raw::Photo, raw::RawError>,
    later: &Result<raw::Photo, raw::RawError>,
    slot: Slot,
    plan: Option<&Plan>,
    limits: &Limits,
) -> (Vec<Reason>, Option<Drift>) {
    match (first, later) {
        (Ok(first), Ok(later)) => pair::compare_dark(view(first), view(later), slot, plan, limits),
        (_, Err(error)) => (vec![error.reason()], None),
        (Err(_), Ok(_)) => (vec![], None),
    }
}

fn view(photo: &raw::Photo) -> FrameView<'_> {
    FrameView { mosaic: &photo.mosaic, settings: &photo.settings }
}

fn files_by_stem(folder: &Path) -> Result<BTreeMap<String, PathBuf>, ImportError> {
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(io(folder))? {
        let path = entry.map_err(io(folder))?.path();
        let (Some(stem), Some(extension)) = (path.file_stem(), path.extension()) else { continue };
        let stem = stem.to_string_lossy().into_owned();
        let extension = extension.to_string_lossy().to_lowercase();
        if !path.is_file() || stem.starts_with('.') || SIDECARS.contains(&extension.as_str()) {
            continue;
        }
        if let Some(first) = files.insert(stem, path.clone()) {
            return Err(ImportError::Ambiguous { first, second: path });
        }
    }
    Ok(files)
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> ImportError + use<> {
    let path = path.to_owned();
    move |source| ImportError::Io { path, source }
}
