//! Calibrations taken over from another session, with the shots that they come from: a rig is calibrated once and used
//! for many objects.

use super::{RecordError, SeriesError, io};
use crate::calibration::guide::Kind;
use crate::calibration::{OtherRig, Record};
use crate::pair::Verdict;
use crate::progress::{Cancelled, Progress};
use crate::session::{Session, SessionError, store};
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};

/// Why calibrations were not taken over.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TakeError {
    /// No calibration of this name exists.
    #[error("{0:?} is no calibration; there are {all}", all = Kind::ALL.map(Kind::name).join(", "))]
    Unknown(String),
    /// The other session lacks it.
    #[error("{} has no calibration of {kind}; it has {has}", from.display())]
    Missing {
        /// The other session.
        from: PathBuf,
        /// What was asked for.
        kind: String,
        /// What there is.
        has: String,
    },
    /// The session's pairs are of another body.
    #[error(
        "the calibration of {kind} is not of the body that shot pair {pair}: {source}; calibrate with that body"
    )]
    OtherRig {
        /// Kind.
        kind: String,
        /// The session's first pair.
        pair: String,
        /// What differs.
        source: OtherRig,
    },
    /// A shot of the other session is not what its record says.
    #[error("{} is missing or damaged ({reason}), so that the calibration of {kind} could not be checked any more; run `unlit session verify` there", path.display())]
    Shot {
        /// Kind.
        kind: String,
        /// The shot.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Both are one session.
    #[error("{} is the session itself; name the one to take the calibrations from", .0.display())]
    Itself(PathBuf),
    /// A record cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The disk refused.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// A session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A calibration that was taken over.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Taken {
    /// Its kind.
    pub kind: &'static str,
    /// When it was measured, UTC.
    pub measured: String,
    /// How many shots came with it.
    pub shots: usize,
}

/// Copies these calibrations of the session `from`, which is only read, all that it has if none is named, into `session`:
/// record, figures and shots, each shot compared with its BLAKE3. Date, rig and figures stay those of the measurement.
/// What the session had before is kept beside, as after a new measurement, and the report is written anew. None is
/// taken if one of them cannot be, or if it is cancelled.
pub fn take(
    session: &Session,
    from: &Path,
    kinds: &[String],
    progress: &Progress,
) -> Result<Vec<Taken>, TakeError> {
    if session.path().canonicalize().ok() == from.canonicalize().ok() {
        return Err(TakeError::Itself(from.to_owned()));
    }
    let from = &Session::open_shared(from)?;
    let mut records = chosen(from, kinds)?;
    let first = session.pairs()?.into_iter().find(|pair| pair.verdict == Verdict::Accepted);
    for (kind, record) in &records {
        if let Some(pair) = &first {
            record.rig.same_body(&pair.on.settings, "the calibration").map_err(|source| {
                TakeError::OtherRig { kind: (*kind).into(), pair: pair.name.clone(), source }
            })?;
        }
        for shot in &record.shots {
            progress.check()?;
            read(from, kind, &shot.file, &shot.blake3)?;
        }
    }
    let count: usize = records.iter().map(|(_, record)| record.shots.len()).sum();
    let mut done = 0;
    for (kind, record) in &mut records {
        for shot in &mut record.shots {
            progress.check()?;
            progress.report("copying the shots", done, count);
            done += 1;
            let bytes = read(from, kind, &shot.file, &shot.blake3)?;
            shot.file = super::copy_name(kind, &shot.file, &shot.blake3);
            let copy = session.path().join(&shot.file);
            let there = std::fs::read(&copy).is_ok_and(|bytes| store::digest(&bytes) == shot.blake3);
            if !there {
                session.keep(&copy, &bytes)?;
            }
        }
    }
    progress.check()?;
    let progress = &progress.unstoppable();
    let mut taken = vec![];
    for (kind, record) in records {
        let mut figures = vec![];
        for ending in ["svg", "png"] {
            let path = from.calibration_dir().join(format!("{kind}.{ending}"));
            if path.is_file() {
                figures.push((ending, std::fs::read(&path).map_err(io(&path))?));
            }
        }
        super::store(session, kind, &record, &figures)?;
        taken.push(Taken { kind, measured: record.measured, shots: record.shots.len() });
    }
    progress.report("copying the shots", count, count);
    super::report::write(session, progress)?;
    Ok(taken)
}

type AnyRecord = Record<Map<String, Value>>;

/// The records of these kinds, of all that are there if none is named.
fn chosen(from: &Session, kinds: &[String]) -> Result<Vec<(&'static str, AnyRecord)>, TakeError> {
    let mut there = vec![];
    for kind in Kind::ALL.map(Kind::name) {
        if let Some(record) = super::load::<Map<String, Value>>(from, kind)? {
            there.push((kind, record));
        }
    }
    let has = match there.is_empty() {
        true => "none".to_owned(),
        false => there.iter().map(|(kind, _)| *kind).collect::<Vec<_>>().join(", "),
    };
    for kind in kinds {
        if !Kind::ALL.iter().any(|known| known.name() == kind) {
            return Err(TakeError::Unknown(kind.clone()));
        }
    }
    let wanted = |kind: &str| kinds.is_empty() || kinds.iter().any(|k| k == kind);
    let missing = kinds.iter().find(|kind| !there.iter().any(|(k, _)| k == kind));
    if there.is_empty() || missing.is_some() {
        let kind = missing.map_or("any kind", String::as_str).to_owned();
        return Err(TakeError::Missing { from: from.path().to_owned(), kind, has });
    }
    there.retain(|(kind, _)| wanted(kind));
    Ok(there)
}

/// A shot's bytes, which must be those of the record.
fn read(from: &Session, kind: &str, file: &str, blake3: &str) -> Result<Vec<u8>, TakeError> {
    let path = from.path().join(file);
    let refused = |reason: String| TakeError::Shot { kind: kind.to_owned(), path: path.clone(), reason };
    let bytes = std::fs::read(&path).map_err(|e| refused(e.to_string()))?;
    match store::digest(&bytes) == blake3 {
        true => Ok(bytes),
        false => Err(refused("its BLAKE3 is another".into())),
    }
}
