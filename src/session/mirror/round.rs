//! One look of a mirror: what is there, what is missing, and the copying of it.

use super::account::{entries, files_of, whole_lines};
use super::copy::{CopyError, bytes_of, copy, copy_aside, length_of, mirror, source, write};
use super::outcome::{Outcome, Unfit, told};
use crate::pair::Attempt;
use crate::session::journal::records;
use crate::session::kept::{Kept, kept};
use crate::session::lock::{Access, Lock};
use crate::session::shots::{self, SHOT_RECORD, WAITING};
use crate::session::{JOURNAL, LOCK, MANIFEST, Manifest, PAIR_RECORD, SEQUENCE, SessionError, store};
use std::collections::{BTreeSet, HashSet};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Folders whose own folders each hold one record and its originals, and never change; so do those in [`WAITING`].
const UNITS: [(&str, &str); 2] = [("pairs", PAIR_RECORD), (shots::SHOTS, SHOT_RECORD)];
/// Folders of single originals, named by their digests.
const ORIGINALS: [&str; 8] = [
    "calibration/flash",
    "calibration/levels",
    "calibration/noise",
    "calibration/exposure",
    "calibration/flat",
    "calibration/colour",
    "calibration/steadiness",
    "scene/originals",
];
/// Folders of the lists that speak of them, copied after them.
const LISTS: [&str; 3] = ["calibration/former", "calibration", "scene"];
/// Folders that every session has, beside those of units.
const FOLDERS: [&str; 3] = ["calibration", "scene", "scene/originals"];
/// Folders of a session whose contents can be made again.
const EMPTY: [&str; 2] = ["derived", "model"];
/// Findings that one sentence names.
const NAMED: usize = 3;

/// Copies a session; remembers what need not be looked at again.
pub(super) struct Copyist {
    session: PathBuf,
    mirrors: PathBuf,
    folder: PathBuf,
    /// The copy's lock, once it was had, and the disk on which it lies.
    held: Option<(Lock, u64)>,
    /// Units and files that never change and are there.
    there: HashSet<PathBuf>,
    warning: Option<String>,
}

/// What is to be copied, from the session's folder.
enum Missing {
    /// A folder with its record.
    Unit(PathBuf, &'static str),
    /// A file that never changes.
    Original(PathBuf),
    /// A file that is replaced when it is made anew.
    Kept(PathBuf),
}

impl Copyist {
    pub(super) fn new(session: PathBuf, mirrors: PathBuf, folder: PathBuf) -> Self {
        Self { session, mirrors, folder, held: None, there: HashSet::new(), warning: None }
    }

    /// What is to be known beside.
    pub(super) fn warning(&self) -> Option<&str> {
        self.warning.as_deref()
    }

    /// Looks once and copies what is missing. `answered` is told whenever a disk has answered how many things are still
    /// missing, and says whether to go on.
    pub(super) fn look(&mut self, answered: &dyn Fn(usize) -> bool) -> Outcome {
        let outcome = self.enter().and_then(|()| self.copy_missing(answered).map_err(Outcome::from));
        match outcome {
            Ok(unfit) if unfit.is_empty() => Outcome::Whole,
            Ok(unfit) => {
                let more = unfit.len().saturating_sub(NAMED);
                let mut words = unfit[..unfit.len() - more].join("; ");
                if more > 0 {
                    words += &format!("; and {more} more");
                }
                Outcome::Unfit(words)
            }
            Err(outcome) => {
                if matches!(outcome, Outcome::Failed(_)) {
                    // The disk may be another one, or have lost something, when it comes back.
                    self.held = None;
                    self.there.clear();
                }
                outcome
            }
        }
    }

    /// Makes sure that the copy is this session's and nobody else's.
    fn enter(&mut self) -> Result<(), Outcome> {
        let failed =
            |path: &Path, error: std::io::Error| Outcome::from(CopyError::Mirror(path.into(), error));
        let mirrors = self.mirrors.canonicalize().map_err(|error| failed(&self.mirrors, error))?;
        let disk = mirrors.metadata().map_err(|error| failed(&mirrors, error))?.dev();
        match &self.held {
            Some((_, before)) if *before == disk => return Ok(()),
            _ => self.held = None,
        }
        let session = self.session.canonicalize().map_err(source(&self.session)).map_err(Outcome::from)?;
        if session.parent().is_some_and(|own| mirrors.starts_with(own)) {
            return Err(Outcome::Failed(
                "it lies inside the sessions folder; give a folder on another disk".into(),
            ));
        }
        if session.metadata().is_ok_and(|own| own.dev() == disk) {
            let words = "It lies on the same disk as the session: that protects from nothing but mistakes; give a \
                         folder on another disk, or see whether that disk is mounted.";
            self.warning = Some(words.into());
        }
        match std::fs::create_dir(&self.folder) {
            Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
                return Err(failed(&self.folder, error));
            }
            _ => {}
        }
        self.refuse_others().map_err(|error| match error {
            Ok(why) => Outcome::Failed(why),
            Err(error) => Outcome::from(error),
        })?;
        let lock = Lock::of_session(&self.folder, Access::Alone).map_err(|error| match error {
            SessionError::Io { path, source } => failed(&path, source),
            other => Outcome::Failed(other.to_string()),
        })?;
        store::remove_temporaries(&self.folder).map_err(|error| failed(&self.folder, error))?;
        for folder in EMPTY.iter().chain(UNITS.iter().map(|(folder, _)| folder)).chain(&FOLDERS) {
            let folder = self.folder.join(folder);
            std::fs::create_dir_all(&folder).map_err(|error| failed(&folder, error))?;
        }
        store::sync_folder(&mirrors).map_err(|error| failed(&mirrors, error))?;
        self.held = Some((lock, disk));
        Ok(())
    }

    /// Refuses a folder that is another session's, or holds something else.
    fn refuse_others(&self) -> Result<(), Result<String, CopyError>> {
        let folder = self.folder.display();
        let (own, theirs) = (self.session.join(MANIFEST), self.folder.join(MANIFEST));
        let parse = |bytes: &[u8]| serde_json::from_slice::<Manifest>(bytes).ok();
        let Some(bytes) = bytes_of(&theirs).map_err(mirror(&theirs)).map_err(Err)? else {
            let ours = |name: &str| name == LOCK || name.starts_with(store::TEMPORARY_PREFIX);
            let entries = std::fs::read_dir(&self.folder).map_err(mirror(&self.folder)).map_err(Err)?;
            let mut others = entries.flatten().filter(|entry| {
                let name = entry.file_name();
                // What a first look made before it was interrupted is ours to fill.
                let made = UNITS.iter().map(|u| u.0).chain(ORIGINALS).chain(LISTS).chain(EMPTY);
                !ours(&name.to_string_lossy())
                    && made.filter_map(|f| f.split('/').next()).all(|f| name.to_string_lossy() != f)
            });
            return match others.next() {
                Some(_) => {
                    Err(Ok(format!("{folder} is there already and is no copy of a session; move it away")))
                }
                None => Ok(()),
            };
        };
        let mine = std::fs::read(&own).map_err(source(&own)).map_err(Err)?;
        match (parse(&mine), parse(&bytes)) {
            (Some(mine), Some(theirs))
                if (&mine.created, &mine.software) == (&theirs.created, &theirs.software) =>
            {
                Ok(())
            }
            _ => Err(Ok(format!("{folder} is the copy of another session of this name; move it away"))),
        }
    }

    /// Copies everything that is missing; gives sentences on what was not, because it would have had to overwrite
    /// something or is damaged itself.
    fn copy_missing(&mut self, answered: &dyn Fn(usize) -> bool) -> Result<Vec<String>, CopyError> {
        // What journal and sequence speak of from here on is there to be copied: they are written last on both sides.
        let lines = whole_lines(&self.session.join(JOURNAL))?;
        let sequence = self.session.join(SEQUENCE);
        let sequence = bytes_of(&sequence).map_err(source(&sequence))?;
        let journal = entries(&lines);
        let (files, records, removed) = (kept(&journal), records(&journal), shots::removed(&journal));
        self.copy_manifest()?;
        for path in &removed {
            // Another may have its name since.
            self.there.remove(path);
            if is_gone(&self.session.join(path))? {
                self.remove(path)?;
            }
        }
        let missing = self.missing(answered)?;
        let (mut left, mut unfit) = (missing.len() + 1, vec![]);
        for one in missing {
            let go_on = || answered(left);
            if !go_on() {
                return Err(CopyError::Stopped);
            }
            let (path, done) = match one {
                Missing::Unit(path, record) => {
                    let name = path.file_name().unwrap_or_default().to_string_lossy();
                    let pair = Attempt::from_folder(&name).filter(|_| record == PAIR_RECORD);
                    let stored = pair.and_then(|attempt| records.get(&attempt));
                    let done = self.copy_unit(&path, (record, stored), removed.contains(&path), &go_on);
                    // A shot may be thrown away, or become a record's, at any time.
                    if done.is_err() && record == SHOT_RECORD && is_gone(&self.session.join(&path))? {
                        left -= 1;
                        continue;
                    }
                    (path, done)
                }
                Missing::Original(path) => {
                    let done = self.copy_original(&path, &go_on);
                    (path, done)
                }
                Missing::Kept(path) => {
                    let done = self.copy_kept(&path, files.get(&path), &go_on);
                    // It may be replaced at any time.
                    unfit.extend(told(done)?);
                    left -= 1;
                    continue;
                }
            };
            match told(done)? {
                Some(words) => unfit.push(words),
                None => {
                    self.there.insert(path);
                }
            }
            left -= 1;
        }
        answered(left);
        self.copy_sequence(sequence.as_deref())?;
        unfit.extend(told(self.copy_journal(&lines))?);
        Ok(unfit)
    }

    /// What is not known to be there.
    fn missing(&self, answered: &dyn Fn(usize) -> bool) -> Result<Vec<Missing>, CopyError> {
        let mut missing = vec![];
        let mut units = UNITS.map(|(folder, record)| (PathBuf::from(folder), record)).to_vec();
        let kinds = self.entries(Path::new(WAITING))?.into_iter().filter(|(_, is_folder)| *is_folder);
        units.extend(kinds.map(|(folder, _)| (folder, SHOT_RECORD)));
        for (folder, record) in units {
            for (path, is_folder) in self.entries(&folder)? {
                if is_folder && !self.there.contains(&path) {
                    missing.push(Missing::Unit(path, record));
                }
            }
        }
        for folder in ORIGINALS {
            let files = self.entries(Path::new(folder))?.into_iter().filter(|(_, is_folder)| !is_folder);
            let new = files.filter(|(path, _)| !self.there.contains(path));
            missing.extend(new.map(|(path, _)| Missing::Original(path)));
        }
        for folder in LISTS {
            let files = self.entries(Path::new(folder))?.into_iter().filter(|(_, is_folder)| !is_folder);
            missing.extend(files.map(|(path, _)| Missing::Kept(path)));
        }
        answered(missing.len() + 1);
        Ok(missing)
    }

    /// Files and folders of one of the session's folders, by name, from the session's folder.
    fn entries(&self, folder: &Path) -> Result<Vec<(PathBuf, bool)>, CopyError> {
        let place = self.session.join(folder);
        let entries = match std::fs::read_dir(&place) {
            Ok(entries) => entries,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(vec![]),
            Err(error) => return Err(CopyError::Source(place, error)),
        };
        let mut found = vec![];
        for entry in entries {
            let entry = entry.map_err(source(&place))?;
            let kind = entry.file_type().map_err(source(&place))?;
            let temporary = entry.file_name().to_string_lossy().starts_with(store::TEMPORARY_PREFIX);
            // Links lead elsewhere; whatever they are, nothing of ours.
            if !temporary && (kind.is_dir() || kind.is_file()) {
                found.push((folder.join(entry.file_name()), kind.is_dir()));
            }
        }
        found.sort();
        Ok(found)
    }

    fn copy_manifest(&self) -> Result<(), CopyError> {
        let (from, to) = (self.session.join(MANIFEST), self.folder.join(MANIFEST));
        let bytes = std::fs::read(&from).map_err(source(&from))?;
        // `enter` has made sure that the one that is there is a former one of this session.
        if bytes_of(&to).map_err(mirror(&to))?.as_ref() != Some(&bytes) { write(&to, &bytes) } else { Ok(()) }
    }

    /// Takes away a shot that the session's own journal says was removed.
    fn remove(&self, path: &Path) -> Result<(), CopyError> {
        let own = self.folder.join(path);
        if !is_there(&own)? {
            return Ok(());
        }
        let parent = own.parent().unwrap_or(&self.folder);
        let aside = store::temporary_path(parent);
        let moved = std::fs::rename(&own, &aside).and_then(|()| store::sync_folder(parent));
        moved.and_then(|()| std::fs::remove_dir_all(&aside)).map_err(mirror(&own))
    }

    /// A folder with its record: all at once where there is none, or that of a shot that was removed, else what it
    /// lacks.
    fn copy_unit(
        &self,
        path: &Path,
        (record, stored): (&str, Option<&String>),
        replaced: bool,
        go_on: &dyn Fn() -> bool,
    ) -> Result<(), Unfit> {
        let (from, to) = (self.session.join(path), self.folder.join(path));
        let Some(bytes) = bytes_of(&from.join(record)).map_err(source(&from))? else {
            return Err(Unfit::Words(format!("{} has no {record}, and was not copied", from.display())));
        };
        let originals = files_of(&serde_json::from_slice(&bytes).unwrap_or_default());
        let names: BTreeSet<PathBuf> = self
            .entries(path)?
            .into_iter()
            .filter(|(_, is_folder)| !is_folder)
            .map(|(path, _)| path)
            .collect();
        let digest = |file: &Path| {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            match originals.get(name.as_ref()) {
                None if name == record => stored.map(String::as_str),
                original => original.map(|(_, digest)| digest.as_str()),
            }
        };
        let theirs = to.join(record);
        if replaced && bytes_of(&theirs).map_err(mirror(&theirs))?.is_some_and(|theirs| theirs != bytes) {
            self.remove(path)?;
        }
        if !is_there(&to)? {
            let parent = to.parent().unwrap_or(&self.folder);
            std::fs::create_dir_all(parent).map_err(mirror(parent))?;
            let aside = store::temporary_path(parent);
            std::fs::create_dir(&aside).map_err(mirror(&aside))?;
            let filled = names.iter().try_for_each(|file| {
                let name = file.file_name().unwrap_or_default();
                copy(&self.session.join(file), &aside.join(name), digest(file), go_on)
            });
            let named = filled
                .and_then(|()| store::sync_folder(&aside).map_err(mirror(&aside)))
                .and_then(|()| std::fs::rename(&aside, &to).map_err(mirror(&to)));
            if named.is_err() {
                // The first error is the one to tell; what stays is removed at the next opening.
                let _ = std::fs::remove_dir_all(&aside);
            }
            named?;
            return Ok(store::sync_folder(parent).map_err(mirror(parent))?);
        }
        for file in &names {
            let (from, to) = (self.session.join(file), self.folder.join(file));
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            let same = match (length_of(&to).map_err(mirror(&to))?, originals.get(name.as_ref())) {
                (None, _) => {
                    copy_aside(&from, &to, digest(file), go_on)?;
                    continue;
                }
                (Some(length), Some((bytes, _))) => length == *bytes,
                (Some(_), None) if name == record => {
                    bytes_of(&to).map_err(mirror(&to))? == Some(bytes.clone())
                }
                // Sidecars can be made again, and other programs write into them.
                (Some(_), None) => true,
            };
            if !same {
                return Err(Unfit::differs(&to));
            }
        }
        Ok(())
    }

    fn copy_original(&self, path: &Path, go_on: &dyn Fn() -> bool) -> Result<(), Unfit> {
        let (from, to) = (self.session.join(path), self.folder.join(path));
        match length_of(&to).map_err(mirror(&to))? {
            None => Ok(copy_aside(&from, &to, None, go_on)?),
            length if length == length_of(&from).map_err(source(&from))? => Ok(()),
            _ => Err(Unfit::differs(&to)),
        }
    }

    /// A file that is replaced whole: over a former one of which the journal knows, and over nothing else.
    fn copy_kept(&self, path: &Path, known: Option<&Kept>, go_on: &dyn Fn() -> bool) -> Result<(), Unfit> {
        let (from, to) = (self.session.join(path), self.folder.join(path));
        let digest = store::digest_file(&from).map_err(source(&from))?;
        if known.is_some_and(|known| !known.digests.contains(&digest)) {
            return Err(CopyError::Altered(from).into());
        }
        let Some(bytes) = bytes_of(&to).map_err(mirror(&to))? else {
            return Ok(copy_aside(&from, &to, Some(&digest), go_on)?);
        };
        let theirs = store::digest(&bytes);
        if theirs == digest {
            return Ok(());
        }
        if !known.is_some_and(|known| known.former.contains(&theirs)) {
            return Err(Unfit::differs(&to));
        }
        Ok(copy_aside(&from, &to, Some(&digest), go_on)?)
    }

    /// The sequence as it stood when this look began, or none where there was none.
    fn copy_sequence(&self, bytes: Option<&[u8]>) -> Result<(), CopyError> {
        let to = self.folder.join(SEQUENCE);
        let there = bytes_of(&to).map_err(mirror(&to))?;
        match bytes {
            bytes if there.as_deref() == bytes => Ok(()),
            Some(bytes) => write(&to, bytes),
            None => {
                std::fs::remove_file(&to).and_then(|()| store::sync_folder(&self.folder)).map_err(mirror(&to))
            }
        }
    }

    fn copy_journal(&self, lines: &[u8]) -> Result<(), Unfit> {
        let to = self.folder.join(JOURNAL);
        match bytes_of(&to).map_err(mirror(&to))? {
            Some(there) if there == lines => Ok(()),
            Some(there) if !lines.starts_with(&there) => Err(Unfit::differs(&to)),
            _ => Ok(write(&to, lines)?),
        }
    }
}

/// Whether the copy has this.
fn is_there(path: &Path) -> Result<bool, CopyError> {
    path.try_exists().map_err(mirror(path))
}

/// Whether the session has this no more.
fn is_gone(path: &Path) -> Result<bool, CopyError> {
    path.try_exists().map(|there| !there).map_err(source(path))
}
