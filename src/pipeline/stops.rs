//! What a session remembers of its pairs, so that later ones can be held against them.
//!
//! Signatures of the stops lie in `derived/stops/NNNN.json`, each with the digests of the two files it was made
//! from, the first frame without flash and the lit one (a number has one accepted attempt at the most), and of the exposure
//! table that scaled them; one that is missing or stale is made again by decoding. Digests of all frames tell a frame that was
//! delivered twice, the controller's counts a pulse that was weaker than usual.

use super::calibrate::RecordError;
use super::scale::SessionScale;
use crate::codec::raw;
use crate::pair::energy::median;
use crate::pair::{
    EarlierStops, EnergyExpectation, Expected, Exposure, Files, FlashRecord, Limits, PairRecord, Plan, Role,
    Settings, Stop, StopKey, Verdict,
};
use crate::progress::{Cancelled, Progress};
use crate::session::{Session, SessionError, store};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Raised when the same frames give another signature than before.
const METHOD: u32 = 1;

/// Why a session's earlier pairs could not be remembered.
#[derive(Debug, thiserror::Error)]
pub enum EarlierError {
    /// The session folder.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The session's exposure table cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// How a pair's files came in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// From a camera that just released: no frame can have been there before.
    Camera,
    /// As files, where several pairs may share one unlit frame.
    Files,
}

/// A session's pairs as far as later ones are held against them.
#[derive(Clone, Debug, Default)]
pub struct Earlier {
    /// Where the signatures lie.
    folder: PathBuf,
    /// Pairs with a signature: its gist and the pair's number.
    stops: Vec<(StopKey, u32)>,
    files: BTreeMap<String, (Role, u32)>,
    energies: Vec<f64>,
    /// How the signatures' light was scaled.
    scale: SessionScale,
    /// The photodiode has seen a pulse of an accepted pair, measured or not.
    sees_light: bool,
}

/// `derived/stops/NNNN.json`.
#[derive(Serialize, Deserialize)]
struct StopFile {
    method: u32,
    off: String,
    on: String,
    /// Digest of the exposure table; empty without one.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    scale: String,
    /// `null` for frames too dark to know a stop by.
    stop: Option<Stop>,
}

impl Earlier {
    /// Remembers all pairs of a session; signatures that are missing are made from the originals and kept.
    pub fn load(session: &Session, progress: &Progress) -> Result<Self, EarlierError> {
        let scale = SessionScale::load(session)?;
        let mut earlier = Self { folder: folder(session), scale, ..Self::default() };
        let pairs: Vec<_> = session.attempts()?.into_values().flatten().collect();
        for (done, record) in pairs.iter().enumerate() {
            progress.check()?;
            progress.report("recalling earlier pairs", done, pairs.len());
            let stop = match record.verdict {
                Verdict::Rejected => None,
                Verdict::Accepted => match earlier.read(session, record) {
                    Some(known) => known,
                    None => {
                        let stop = earlier.remade(session, record);
                        earlier.write(session, record, &stop)?;
                        stop
                    }
                },
            };
            earlier.note(record, stop);
        }
        Ok(earlier)
    }

    /// Remembers a pair just stored, and keeps its signature if it was accepted.
    pub fn add(
        &mut self,
        session: &Session,
        record: &PairRecord,
        stop: Option<Stop>,
    ) -> Result<(), SessionError> {
        if record.verdict == Verdict::Accepted {
            self.write(session, record, &stop)?;
        }
        self.note(record, stop);
        Ok(())
    }

    fn note(&mut self, record: &PairRecord, stop: Option<Stop>) {
        for (slot, frame) in record.frames() {
            let role = if slot.part.is_lit() { Role::Lit } else { Role::Unlit };
            self.files.entry(frame.blake3.clone()).or_insert((role, record.number));
        }
        if record.verdict == Verdict::Accepted {
            self.stops.extend(stop.map(|stop| (stop.key(), record.number)));
            self.energies.extend(record.flash.as_ref().and_then(FlashRecord::energy_counts));
            self.sees_light |= record.flash.as_ref().is_some_and(FlashRecord::saw_light);
        }
    }

    /// How light goes with the settings, as it did when the session was remembered.
    pub fn scale(&self) -> &SessionScale {
        &self.scale
    }

    /// Whether the session's exposure table is still the one by which its signatures were made.
    pub fn is_by(&self, scale: &SessionScale) -> bool {
        self.scale.told() == scale.told()
    }

    /// Whether the flash controller's photodiode has seen a pulse of an accepted pair.
    pub fn sees_light(&self) -> bool {
        self.sees_light
    }

    /// What the next pair is held against: `off` and `on` are its files' BLAKE3, `energy` its pulse in the
    /// controller's counts. Plan and region are for the caller to add.
    pub fn expecting<'a>(
        &'a self,
        off: &'a str,
        on: &'a str,
        energy: Option<f64>,
        delivery: Delivery,
    ) -> Expected<'a> {
        let usual = median(&self.energies);
        Expected {
            earlier: Some(self),
            energy: energy.zip(usual).map(|(counts, usual)| EnergyExpectation { counts, usual }),
            files: Some(Files {
                off,
                on,
                more: &[],
                earlier: &self.files,
                may_share_unlit: delivery == Delivery::Files,
            }),
            ..Expected::default()
        }
    }
}

/// Only the gists are kept in memory; a signature that may match is read from the disk.
impl EarlierStops for Earlier {
    fn candidates(&self, stop: &Stop) -> Vec<Stop> {
        let key = stop.key();
        let alike = self.stops.iter().filter(|(other, _)| other.may_match(&key));
        alike
            .filter_map(|(_, number)| {
                let path = self.folder.join(file_name(*number));
                let found = std::fs::read(&path).map_err(|e| e.to_string());
                let found = found.and_then(|b| serde_json::from_slice(&b).map_err(|e| e.to_string()));
                match found {
                    Ok(StopFile { stop, .. }) => stop,
                    Err(error) => {
                        tracing::warn!("{}: {error}; this pair is not held against it", path.display());
                        None
                    }
                }
            })
            .collect()
    }
}

fn file_name(number: u32) -> String {
    format!("{number:04}.json")
}

fn folder(session: &Session) -> PathBuf {
    session.derived_dir().join("stops")
}

fn file(session: &Session, record: &PairRecord) -> PathBuf {
    folder(session).join(file_name(record.number))
}

impl Earlier {
    /// Of the exposure table; empty without one.
    fn digest(&self) -> String {
        self.scale.told().map(|told| store::digest(told.as_bytes())).unwrap_or_default()
    }

    /// The signature kept of a pair; `None` if there is none of these two files by this method.
    fn read(&self, session: &Session, record: &PairRecord) -> Option<Option<Stop>> {
        // What cannot be read is made again, as everything in `derived`.
        let bytes = std::fs::read(file(session, record)).ok()?;
        let found: StopFile = serde_json::from_slice(&bytes).ok()?;
        let fresh = found.method == METHOD && found.off == record.off.blake3 && found.on == record.on.blake3;
        (fresh && found.scale == self.digest()).then_some(found.stop)
    }

    fn write(&self, session: &Session, record: &PairRecord, stop: &Option<Stop>) -> Result<(), SessionError> {
        let path = file(session, record);
        let io = |path: &Path| {
            let path = path.to_owned();
            move |source| SessionError::Io { path, source }
        };
        std::fs::create_dir_all(folder(session)).map_err(io(&folder(session)))?;
        let stored = StopFile {
            method: METHOD,
            off: record.off.blake3.clone(),
            on: record.on.blake3.clone(),
            scale: self.digest(),
            stop: stop.clone(),
        };
        let bytes = serde_json::to_vec(&stored).map_err(|e| io(&path)(e.into()))?;
        store::write_atomic(&path, &bytes).map_err(io(&path))
    }

    /// The signature out of a pair's originals.
    fn remade(&self, session: &Session, record: &PairRecord) -> Option<Stop> {
        // Saturation matters to nothing in a signature.
        let read = |name: &str| raw::read(&session.pair_dir(record).join(name));
        let (off, on) = rayon::join(|| read(&record.off.file), || read(&record.on.file));
        match (off, on) {
            (Ok(off), Ok(on)) => {
                let plan =
                    exposure(&off.settings).zip(exposure(&on.settings)).map(|(off, on)| Plan { off, on });
                let expected = Expected { plan: plan.as_ref(), ..Expected::default() };
                super::pairs::judge(&Ok(off), &Ok(on), &expected, &self.scale, &Limits::default()).stop
            }
            (Err(error), _) | (_, Err(error)) => {
                tracing::warn!(pair = record.number, %error, "no later pair can be held against this one");
                None
            }
        }
    }
}

fn exposure(settings: &Settings) -> Option<Exposure> {
    Some(Exposure { shutter: settings.shutter?, aperture: settings.aperture?, iso: settings.iso? })
}
