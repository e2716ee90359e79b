//! Whether everything that a session ever acknowledged is still there, byte for byte.
//!
//! Nothing is changed and nothing stops the check: a record that cannot be read is a finding like any other.

use super::{Event, JOURNAL, PAIR_RECORD, Session, journal, store};
use crate::pair::{FrameRecord, PairRecord};
use crate::progress::{Cancelled, Progress};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Name of the record beside a calibration shot's frames.
const SHOT_RECORD: &str = "shot.json";

/// What the journal's note of a stored card shot is called.
pub const SHOT_STORED: &str = "calibration_shot_stored";

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
    /// Pairs that were looked at.
    pub pairs: usize,
    /// Calibration shots that were looked at.
    pub calibration_shots: usize,
    /// Originals that are as they were stored.
    pub originals: usize,
    /// Their bytes.
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
struct Frames {
    off: FrameRecord,
    on: FrameRecord,
}

struct Check<'a> {
    session: &'a Session,
    found: Verification,
}

impl Session {
    /// Reads every original again and compares it with its BLAKE3; compares folders and journal.
    pub fn verify(&self, progress: &Progress) -> Result<Verification, Cancelled> {
        let mut check = Check { session: self, found: Verification::default() };
        let folders = check.folders(&self.pairs_dir());
        let shots = check.folders(&self.calibration_dir().join("flash"));
        let all = folders.len() + shots.len();
        for (done, folder) in folders.iter().enumerate() {
            progress.check()?;
            progress.report("reading originals again", done, all);
            check.pair(folder);
        }
        for (done, folder) in shots.iter().enumerate() {
            progress.check()?;
            progress.report("reading originals again", folders.len() + done, all);
            check.shot(folder);
        }
        check.journal(&folders);
        check.found.findings.sort();
        Ok(check.found)
    }
}

impl Session {
    /// The same for one pair: what is not as it was stored.
    pub fn verify_pair(&self, number: u32) -> Vec<Finding> {
        let mut check = Check { session: self, found: Verification::default() };
        check.pair(&self.pair_dir(number));
        check.found.findings
    }
}

impl Check<'_> {
    fn tell(&mut self, path: &Path, damage: Damage, why: impl Into<String>) {
        let path = path.strip_prefix(self.session.path()).unwrap_or(path).to_owned();
        self.found.findings.push(Finding { path, damage, why: why.into() });
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
        let Some(number) = number_of(&name) else {
            return self.tell(folder, Damage::Unknown, "its name is no pair's number");
        };
        self.found.pairs += 1;
        let Some(record) = self.record::<PairRecord>(&folder.join(PAIR_RECORD)) else { return };
        if record.number != number {
            let why = format!("it says that it is pair {}", record.number);
            self.tell(&folder.join(PAIR_RECORD), Damage::Altered, why);
        }
        self.frames(folder, PAIR_RECORD, [&record.off, &record.on]);
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
            (Ok(now), _) => {
                let why = format!("its BLAKE3 is {}..., and {digest}... was stored", start(&now));
                self.tell(file, Damage::Altered, why);
            }
            (Err(error), _) => self.tell(file, Damage::Unreadable, error.to_string()),
        }
    }

    fn shot(&mut self, folder: &Path) {
        self.found.calibration_shots += 1;
        if let Some(frames) = self.record::<Frames>(&folder.join(SHOT_RECORD)) {
            self.frames(folder, SHOT_RECORD, [&frames.off, &frames.on]);
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
    fn frames(&mut self, folder: &Path, record: &str, frames: [&FrameRecord; 2]) {
        let raws = frames.map(|frame| (frame.file.as_str(), frame.bytes, frame.blake3.as_str()));
        let jpegs = frames.into_iter().filter_map(|frame| frame.jpeg.as_ref());
        let jpegs = jpegs.map(|jpeg| (jpeg.file.as_str(), jpeg.bytes, jpeg.blake3.as_str()));
        let originals: Vec<_> = raws.into_iter().chain(jpegs).collect();
        for &(name, bytes, digest) in &originals {
            self.original(&folder.join(name), bytes, digest);
        }
        let known: BTreeSet<&str> =
            originals.iter().map(|original| original.0).chain(std::iter::once(record)).collect();
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if !known.contains(entry.file_name().to_string_lossy().as_ref()) {
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
            Ok(now) => {
                let why = format!("its BLAKE3 is {}..., and {}... was stored", start(&now), start(digest));
                self.tell(file, Damage::Altered, why);
            }
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
        let mut stored: BTreeMap<u32, &str> = BTreeMap::new();
        let mut begun = BTreeSet::new();
        for entry in &entries {
            match &entry.event {
                Event::PairIntended { number, .. } => {
                    begun.insert(*number);
                }
                Event::PairCommitted { number, name, .. } => {
                    stored.insert(*number, name);
                }
                Event::Note { what, detail } if what == SHOT_STORED => {
                    let name = detail.get("name").and_then(|name| name.as_str()).unwrap_or_default();
                    let folder = self.session.calibration_dir().join("flash").join(name);
                    if !folder.is_dir() {
                        let why = "this card shot was stored and is not there any more";
                        self.tell(&folder, Damage::Missing, why);
                    }
                }
                _ => {}
            }
        }
        let names = folders.iter().filter_map(|folder| folder.file_name());
        let there: BTreeSet<u32> = names.filter_map(|name| number_of(&name.to_string_lossy())).collect();
        for (number, name) in stored.iter().filter(|(number, _)| !there.contains(number)) {
            let why = format!("pair {name} was stored and is not there any more");
            self.tell(&self.session.pair_dir(*number), Damage::Missing, why);
        }
        for number in there.iter().filter(|number| !stored.contains_key(number)) {
            let why = if begun.contains(number) {
                "the journal does not call it stored; opening the session for writing settles that"
            } else {
                "the journal does not know this pair; it was copied here, or the journal is not this session's"
            };
            self.tell(&self.session.pair_dir(*number), Damage::Unknown, why);
        }
    }
}

fn is_temporary(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(store::TEMPORARY_PREFIX))
}

fn start(digest: &str) -> &str {
    digest.get(..12).unwrap_or(digest)
}

/// The number that a pair's folder is named by.
pub(super) fn number_of(name: &str) -> Option<u32> {
    let digits = name.len() >= 4 && name.bytes().all(|b| b.is_ascii_digit());
    if digits { name.parse().ok() } else { None }
}
