//! Whether everything that a session ever acknowledged is still there, byte for byte.
//!
//! Nothing is changed and nothing stops the check: a record that cannot be read is a finding like any other.

mod kept;
mod sequence;

use super::shots::{self, SHOT_RECORD, SHOT_REMOVED, SHOT_STORED};
use super::sidecars::is_sidecar;
use super::{Event, JOURNAL, PAIR_RECORD, Session, journal, store};
use crate::pair::{Attempt, FrameRecord, PairRecord};
use crate::progress::{Cancelled, Progress};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::PoisonError;

/// What is wrong with a file or folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Damage {
    /// It was stored and is not there.
    Missing,
    /// Its bytes are not those that were stored.
    Altered,
    /// It is there and cannot be read.
    Unreadable,
    /// Nobody knows it. That does no harm: another program may have put it there.
    Unknown,
}

/// One thing that is not as it was stored.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Finding {
    /// From the session's folder.
    pub path: PathBuf,
    /// What is wrong.
    pub damage: Damage,
    /// The same in words.
    pub why: String,
}

/// What a check found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verification {
    /// Pairs that were looked at; each attempt at one counts.
    pub pairs: usize,
    /// Calibration shots that were looked at.
    pub calibration_shots: usize,
    /// Originals that are as they were stored.
    pub originals: usize,
    /// Results of calibrations and files of the scene that are as they were stored.
    #[serde(default)]
    pub kept: usize,
    /// Bytes of the originals.
    pub bytes: u64,
    /// What is not as it was stored, by path.
    pub findings: Vec<Finding>,
}

impl Verification {
    /// Whether everything that was stored is as it was.
    pub fn is_whole(&self) -> bool {
        self.findings.iter().all(|finding| finding.damage == Damage::Unknown)
    }
}

/// The frames of any record that has some.
#[derive(Deserialize)]
pub(super) struct Frames {
    pub(super) off: FrameRecord,
    pub(super) on: FrameRecord,
}

const READING: &str = "reading originals again";

struct Check<'a> {
    session: &'a Session,
    /// BLAKE3 of the pairs' records.
    records: BTreeMap<Attempt, String>,
    found: Verification,
}

impl Session {
    /// Reads every original again and compares it with its BLAKE3, and so results of calibrations and the scene; compares
    /// folders and journal. Pairs may be stored meanwhile.
    pub fn verify(&self, progress: &Progress) -> Result<Verification, Cancelled> {
        let mut check = Check { session: self, records: BTreeMap::new(), found: Verification::default() };
        let folders = {
            // No pair gets its folder or its line in the journal in between.
            let _still = self.numbering.as_ref().map(|n| n.lock().unwrap_or_else(PoisonError::into_inner));
            check.folders(&self.pairs_dir())
        };
        let shots = check.folders(&self.calibration_dir().join("flash"));
        // A journal that cannot be read is told below.
        let journal = self.journal().unwrap_or_default();
        check.records = journal::records(&journal);
        let kept = check.expected(super::kept::kept(&journal));
        let all = folders.len() + shots.len() + kept.len();
        for (done, folder) in folders.iter().enumerate() {
            progress.check()?;
            progress.report(READING, done, all);
            check.pair(folder);
        }
        for (done, folder) in shots.iter().enumerate() {
            progress.check()?;
            progress.report(READING, folders.len() + done, all);
            check.shot(folder);
        }
        for (done, file) in kept.iter().enumerate() {
            progress.check()?;
            progress.report(READING, folders.len() + shots.len() + done, all);
            check.kept(file);
        }
        progress.report(READING, all, all);
        check.journal(&folders);
        check.sequence();
        check.found.findings.sort();
        Ok(check.found)
    }
}

impl Session {
    /// The same for one attempt at a pair, the first if it is given by its number: what is not as it was stored.
    pub fn verify_pair(&self, attempt: impl Into<Attempt>) -> Vec<Finding> {
        let records = journal::records(&self.journal().unwrap_or_default());
        let mut check = Check { session: self, records, found: Verification::default() };
        check.pair(&self.pair_dir(attempt));
        check.found.findings
    }
}

impl Check<'_> {
    fn tell(&mut self, path: &Path, damage: Damage, why: impl Into<String>) {
        let path = path.strip_prefix(self.session.path()).unwrap_or(path).to_owned();
        self.found.findings.push(Finding { path, damage, why: why.into() });
    }

    fn is_told(&self, path: &Path) -> bool {
        let path = path.strip_prefix(self.session.path()).unwrap_or(path);
        self.found.findings.iter().any(|finding| finding.path == path)
    }

    /// The folders inside a folder, by name; what is none is told. No folder at all holds none.
    fn folders(&mut self, folder: &Path) -> Vec<PathBuf> {
        let entries = match std::fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return vec![],
            Err(error) => {
                self.tell(folder, Damage::Unreadable, error.to_string());
                return vec![];
            }
        };
        let mut folders = vec![];
        for entry in entries {
            match entry {
                // What is being written just now by whoever has the session open for writing is no leftover.
                Ok(entry) if is_temporary(&entry.path()) && self.session.numbering.is_some() => {}
                Ok(entry) if is_temporary(&entry.path()) => {
                    let why = "left by an interrupted run; opening the session removes it";
                    self.tell(&entry.path(), Damage::Unknown, why);
                }
                Ok(entry) if entry.path().is_dir() => folders.push(entry.path()),
                Ok(entry) => self.loose(&entry.path()),
                Err(error) => self.tell(folder, Damage::Unreadable, error.to_string()),
            }
        }
        folders.sort();
        folders
    }

    fn pair(&mut self, folder: &Path) {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let Some(attempt) = Attempt::from_folder(&name) else {
            return self.tell(folder, Damage::Unknown, "its name is no pair's number");
        };
        self.found.pairs += 1;
        let file = folder.join(PAIR_RECORD);
        let Some(record) = self.record::<PairRecord>(&file) else { return };
        match (self.records.get(&attempt), store::digest_file(&file)) {
            (Some(stored), Ok(now)) if now != *stored => {
                self.tell(&file, Damage::Altered, differs(&now, stored))
            }
            (_, Err(error)) => self.tell(&file, Damage::Unreadable, error.to_string()),
            _ if Attempt::from(&record) != attempt => {
                let why = format!("it says that it is pair {}", Attempt::from(&record));
                self.tell(&file, Damage::Altered, why);
            }
            _ => {}
        }
        let frames: Vec<&FrameRecord> = record.frames().map(|(_, frame)| frame).collect();
        self.frames(folder, PAIR_RECORD, &frames);
    }

    /// A file where folders are: copies of card shots begin with the start of their BLAKE3.
    fn loose(&mut self, file: &Path) {
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let digest = name.split_once('_').map(|(digest, _)| digest);
        let Some(digest) = digest.filter(|d| d.len() == 8 && d.bytes().all(|b| b.is_ascii_hexdigit())) else {
            return self.tell(file, Damage::Unknown, "a folder was expected here");
        };
        match (store::digest_file(file), std::fs::metadata(file)) {
            (Ok(now), Ok(data)) if now.starts_with(digest) => {
                self.found.originals += 1;
                self.found.bytes += data.len();
            }
            (Ok(now), _) => self.tell(file, Damage::Altered, differs(&now, digest)),
            (Err(error), _) => self.tell(file, Damage::Unreadable, error.to_string()),
        }
    }

    fn shot(&mut self, folder: &Path) {
        self.found.calibration_shots += 1;
        if let Some(frames) = self.record::<Frames>(&folder.join(SHOT_RECORD)) {
            self.frames(folder, SHOT_RECORD, &[&frames.off, &frames.on]);
        }
    }

    fn record<T: serde::de::DeserializeOwned>(&mut self, file: &Path) -> Option<T> {
        let bytes = match std::fs::read(file) {
            Ok(bytes) => bytes,
            Err(error) => {
                let missing = error.kind() == std::io::ErrorKind::NotFound;
                let damage = if missing { Damage::Missing } else { Damage::Unreadable };
                self.tell(file, damage, error.to_string());
                return None;
            }
        };
        let record = serde_json::from_slice(&bytes);
        record.map_err(|error| self.tell(file, Damage::Unreadable, error.to_string())).ok()
    }

    /// The originals of a folder, and whatever else lies in it.
    fn frames(&mut self, folder: &Path, record: &str, frames: &[&FrameRecord]) {
        let raws = frames.iter().map(|frame| (frame.file.as_str(), frame.bytes, frame.blake3.as_str()));
        let jpegs = frames.iter().filter_map(|frame| frame.jpeg.as_ref());
        let jpegs = jpegs.map(|jpeg| (jpeg.file.as_str(), jpeg.bytes, jpeg.blake3.as_str()));
        let originals: Vec<_> = raws.chain(jpegs).collect();
        for &(name, bytes, digest) in &originals {
            self.original(&folder.join(name), bytes, digest);
        }
        let known: BTreeSet<&str> =
            originals.iter().map(|original| original.0).chain(std::iter::once(record)).collect();
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            let sidecar = || originals.iter().any(|original| is_sidecar(&name, original.0));
            if !known.contains(name.as_ref()) && !sidecar() {
                self.tell(&entry.path(), Damage::Unknown, "not one of the files that were stored");
            }
        }
    }

    fn original(&mut self, file: &Path, bytes: u64, digest: &str) {
        let length = match std::fs::metadata(file) {
            Ok(data) => data.len(),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return self.tell(file, Damage::Missing, "this original is not there any more");
            }
            Err(error) => return self.tell(file, Damage::Unreadable, error.to_string()),
        };
        if length != bytes {
            let why = format!("it has {length} bytes, and {bytes} were stored");
            return self.tell(file, Damage::Altered, why);
        }
        match store::digest_file(file) {
            Ok(now) if now == digest => {
                self.found.originals += 1;
                self.found.bytes += bytes;
            }
            Ok(now) => self.tell(file, Damage::Altered, differs(&now, digest)),
            Err(error) => self.tell(file, Damage::Unreadable, error.to_string()),
        }
    }

    /// Pairs that the journal calls stored and that have no folder, and the other way round.
    fn journal(&mut self, folders: &[PathBuf]) {
        let file = self.session.path().join(JOURNAL);
        let entries = match journal::read(&file) {
            Ok(entries) => entries,
            Err(error) => return self.tell(&file, Damage::Unreadable, error.to_string()),
        };
        if entries.is_empty() {
            return self.tell(&file, Damage::Missing, "the journal is not there, or empty");
        }
        let mut stored: BTreeMap<Attempt, &str> = BTreeMap::new();
        let own = |number: &u32, attempt: &u32| Attempt { number: *number, attempt: *attempt };
        let (mut begun, mut cards) = (BTreeSet::new(), BTreeSet::new());
        for entry in &entries {
            match &entry.event {
                Event::PairIntended { number, attempt, .. } => {
                    begun.insert(own(number, attempt));
                }
                Event::PairCommitted { number, attempt, name, .. } => {
                    stored.insert(own(number, attempt), name);
                }
                event => match shots::told(event) {
                    Some((name, SHOT_STORED)) => _ = cards.insert(name),
                    Some((name, SHOT_REMOVED)) => _ = cards.remove(name),
                    _ => {}
                },
            }
        }
        for name in cards {
            let folder = self.session.calibration_dir().join("flash").join(name);
            if !folder.is_dir() {
                let why = "this card shot was stored and is not there any more";
                self.tell(&folder, Damage::Missing, why);
            }
        }
        let names = folders.iter().filter_map(|folder| folder.file_name());
        let there: BTreeSet<Attempt> =
            names.filter_map(|name| Attempt::from_folder(&name.to_string_lossy())).collect();
        let gone = |own: &Attempt| !there.contains(own) && !self.session.pair_dir(*own).is_dir();
        for (own, name) in stored.iter().filter(|(own, _)| gone(own)).collect::<Vec<_>>() {
            let why = match own.attempt {
                1 => format!("pair {name} was stored and is not there any more"),
                n => format!("attempt {n} at pair {name} was stored and is not there any more"),
            };
            self.tell(&self.session.pair_dir(*own), Damage::Missing, why);
        }
        for own in there.iter().filter(|own| !stored.contains_key(own)) {
            let why = if begun.contains(own) {
                "the journal does not call it stored; opening the session for writing settles that"
            } else {
                "the journal does not know this pair; it was copied here, or the journal is not this session's"
            };
            self.tell(&self.session.pair_dir(*own), Damage::Unknown, why);
        }
    }
}

fn is_temporary(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(store::TEMPORARY_PREFIX))
}

/// What is wrong with a file whose BLAKE3 is `now`.
fn differs(now: &str, stored: &str) -> String {
    let start = |digest: &str| digest.get(..12).unwrap_or(digest).to_owned();
    format!("its BLAKE3 is {}..., and {}... was stored", start(now), start(stored))
}
