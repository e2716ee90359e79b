//! A pair enters the session: all originals byte for byte, `pair.json`, all or nothing. What is there is never
//! overwritten: a rejected pair that is shot again gets a folder of its own beside the first.

use super::sidecars::sidecars;
use super::{Event, Numbering, PAIR_RECORD, Session, SessionError, digests, room, store, to_json};
use crate::pair::order::{Order, Part, Program, Slot};
use crate::pair::{
    Attempt, CompanionRecord, Drift, FlashRecord, FrameRecord, Lighting, PairRecord, Polariser, Reason,
    Settings, Verdict,
};
use std::path::{Path, PathBuf};

/// One original file of a new pair.
#[derive(Clone, Debug)]
pub struct NewFrame<'a> {
    /// The file's bytes as the camera wrote them.
    pub bytes: &'a [u8],
    /// The name under which the camera or the photographer had it; gives the extension.
    pub original_name: &'a str,
    /// Settings out of its EXIF.
    pub settings: Settings,
    /// What was done beforehand, while the next frame was being shot.
    pub prepared: Option<Prepared<'a>>,
    /// The JPEG of the same release, where the camera writes RAW+JPEG: its bytes and its name.
    pub jpeg: Option<(&'a [u8], &'a str)>,
}

/// A new frame whose digest is known already, and which may lie on the disk already.
#[derive(Clone, Debug)]
pub struct Prepared<'a> {
    /// BLAKE3 of the file, hexadecimal.
    pub blake3: String,
    /// Where it lies.
    pub staged: Option<&'a Staged>,
}

/// Bytes that are safe on the disk under a temporary name, to be given their own name at the commit. Removed when
/// this is dropped before that.
#[derive(Debug)]
pub struct Staged(PathBuf);

impl Drop for Staged {
    fn drop(&mut self) {
        // Once committed it has another name; what a crash leaves is removed at the next opening.
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Writes frames of a session to the disk ahead of their commit, from any thread.
#[derive(Clone, Debug)]
pub struct Stager {
    folder: PathBuf,
}

impl Stager {
    /// Writes the bytes; on the disk when this returns.
    pub fn stage(&self, bytes: &[u8]) -> Result<Staged, SessionError> {
        let staged = Staged(store::temporary_path(&self.folder));
        store::write_synced(&staged.0, bytes).map_err(SessionError::io(&staged.0))?;
        Ok(staged)
    }
}

/// A pair to be stored.
#[derive(Clone, Debug)]
pub struct NewPair<'a> {
    /// The photo's file stem as imported; `None` for a pair just shot, which is named by its number.
    pub name: Option<&'a str>,
    /// The frame without flash.
    pub off: NewFrame<'a>,
    /// The frame with flash.
    pub on: NewFrame<'a>,
    /// What the checks found wrong; none means accepted.
    pub reasons: Vec<Reason>,
    /// The flash controller's account, if there is one.
    pub flash: Option<FlashRecord>,
    /// What a pair that is no more than one frame of each has none of.
    pub more: More<'a>,
}

/// What a pair may have beside its two frames.
#[derive(Clone, Debug, Default)]
pub struct More<'a> {
    /// The frames that it was to have, and their order.
    pub program: Program,
    /// Further frames without flash, in the order of their slots.
    pub off: Vec<NewFrame<'a>>,
    /// Frames without flash after the lit one.
    pub after: Vec<NewFrame<'a>>,
    /// A further frame with flash, and the polariser that it was seen through.
    pub crossed: Option<(NewFrame<'a>, Polariser)>,
    /// How room and tripod drifted meanwhile.
    pub drift: Option<Drift>,
    /// The rejected pair in whose stead this one was shot.
    pub again: Option<u32>,
}

impl<'a> NewPair<'a> {
    /// All frames, in the order in which a record tells them.
    fn frames(&self) -> impl Iterator<Item = &NewFrame<'a>> {
        let one = std::iter::once;
        let crossed = self.more.crossed.iter().map(|(frame, _)| frame);
        one(&self.off).chain(&self.more.off).chain(one(&self.on)).chain(&self.more.after).chain(crossed)
    }

    /// What will be told of it.
    fn record(&self, own: Attempt, name: String, lighting: Lighting) -> PairRecord {
        let row = |part: Part, from: u8, frames: &[NewFrame]| -> Vec<FrameRecord> {
            let slots = (from..).map(|index| Slot { part, index });
            frames.iter().zip(slots).map(|(frame, slot)| frame_record(&slot.to_string(), frame)).collect()
        };
        let crossed = self.more.crossed.as_ref().map(|(frame, polariser)| FrameRecord {
            polariser: Some(*polariser),
            ..frame_record(&Slot::CROSSED.to_string(), frame)
        });
        PairRecord {
            number: own.number,
            attempt: own.attempt,
            name,
            verdict: if self.reasons.is_empty() { Verdict::Accepted } else { Verdict::Rejected },
            reasons: self.reasons.clone(),
            order: if crossed.is_some() { Order::OffOnCrossed } else { self.more.program.order() },
            off_frames: self.more.program.off_frames(),
            off: frame_record("off", &self.off),
            more_off: row(Part::Off, 2, &self.more.off),
            on: frame_record("on", &self.on),
            after: row(Part::After, 1, &self.more.after),
            crossed,
            lighting,
            drift: self.more.drift,
            flash: self.flash.clone(),
        }
    }
}

/// What became of a pair.
#[derive(Clone, Debug, PartialEq)]
pub enum Commit {
    /// It is on the disk under a new number.
    Stored(PairRecord),
    /// The same photographs are there under the same name; nothing was written.
    AlreadyThere(PairRecord),
}

impl NewFrame<'_> {
    fn digest(&self) -> String {
        self.prepared.as_ref().map_or_else(|| store::digest(self.bytes), |prepared| prepared.blake3.clone())
    }
}

impl Session {
    /// Writes frames ahead of their commit.
    pub fn stager(&self) -> Stager {
        Stager { folder: self.pairs_dir() }
    }

    /// Stores a pair; when this returns, it is on the disk. A name that is taken by the same files
    /// changes nothing; taken by others, it is an error.
    pub fn commit_pair(&self, new: NewPair) -> Result<Commit, SessionError> {
        let usual = new.more.program == Program::default() && new.more.crossed.is_none();
        if new.more.again.is_some() || !usual {
            self.raise_schema()?;
        }
        let mut numbering = self.numbering()?;
        let (own, name) = match (new.more.again, new.name) {
            (Some(number), _) => self.again(&numbering, number)?,
            (None, Some(name)) => (Attempt::first(numbering.next), checked_name(name)?),
            (None, None) => shot_name(&numbering),
        };
        let record = new.record(own, name, self.manifest().lighting);
        if new.more.again.is_none()
            && let Some(taken) = numbering.names.get(&record.name)
        {
            let (number, files) = (taken.number, digests(&record));
            return match taken.files.iter().find(|(_, known)| *known == files) {
                Some((attempt, _)) => {
                    Ok(Commit::AlreadyThere(self.attempt(Attempt { number, attempt: *attempt })?))
                }
                None => Err(SessionError::DuplicateName { name: record.name, number }),
            };
        }
        let json = to_json(&self.pair_dir(own).join(PAIR_RECORD), &record)?;
        let intended = (own, record.name.clone());
        if numbering.intended.as_ref() != Some(&intended) {
            self.require_room_for(&numbering, room::Wanted::Bytes(room::bytes_of(&record)))?;
            self.append(&mut numbering, intent(own, &record.name))?;
        }
        numbering.intended = None;
        let (Attempt { number, attempt }, name, verdict) = (own, record.name.clone(), record.verdict);
        match self.write_pair(&record, &json, &new) {
            // The pair is there, and its folder says so; the journal hears of it as soon as it can be written.
            Ok(()) => {
                numbering.take(&record);
                let digest = Some(store::digest(&json));
                let stored = Event::PairCommitted { number, attempt, name, verdict, record: digest };
                self.append_or_owe(&mut numbering, stored);
                Ok(Commit::Stored(record))
            }
            // It has its place, but the disk failed afterwards: its number is spent, and the next opening settles it.
            Err(error) if self.pair_dir(own).exists() => {
                numbering.take(&record);
                Err(error)
            }
            Err(error) => {
                let why = error.to_string();
                self.append_or_owe(&mut numbering, Event::PairAbandoned { number, attempt, name, why });
                Err(error)
            }
        }
    }

    /// Writes to the journal that the next pair is about to be shot, and gives its number. Refuses where there is no
    /// room for it.
    pub fn intend_pair(&self) -> Result<u32, SessionError> {
        Ok(self.intend(None, Program::default())?.number)
    }

    /// The same for the frames of a program, and with `again` for the rejected pair of this number. Spends no new
    /// number then.
    pub fn intend(&self, again: Option<u32>, program: Program) -> Result<Attempt, SessionError> {
        let mut numbering = self.numbering()?;
        let (own, name) = match again {
            Some(number) => self.again(&numbering, number)?,
            None => shot_name(&numbering),
        };
        self.require_room_for(&numbering, room::Wanted::Frames(program.slots().len() as u64))?;
        self.append(&mut numbering, intent(own, &name))?;
        numbering.intended = Some((own, name));
        Ok(own)
    }

    /// Writes to the journal that nothing was stored of the pair that was intended, and why; if none was, or storing it
    /// has failed and was written down, nothing.
    pub fn abandon_pair(&self, why: &str) -> Result<(), SessionError> {
        let mut numbering = self.numbering()?;
        let Some((Attempt { number, attempt }, name)) = numbering.intended.take() else { return Ok(()) };
        let why = why.to_owned();
        self.append(&mut numbering, Event::PairAbandoned { number, attempt, name, why })
    }

    /// The next attempt at a pair that was rejected, and its name.
    fn again(&self, numbering: &Numbering, number: u32) -> Result<(Attempt, String), SessionError> {
        let taken = numbering.names.iter().find(|(_, taken)| taken.number == number);
        let (name, taken) =
            taken.ok_or_else(|| SessionError::NoSuchPair { path: self.path.clone(), number })?;
        if taken.accepted {
            return Err(SessionError::PairAccepted { number });
        }
        Ok((Attempt { number, attempt: taken.attempts.saturating_add(1) }, name.clone()))
    }

    /// Whether the pair of this number may be shot again: it is there, and it was rejected. Gives its record.
    pub fn rejected_pair(&self, number: u32) -> Result<PairRecord, SessionError> {
        let numbering = self.numbering()?;
        self.again(&numbering, number)?;
        self.pair(number)
    }

    /// Fills a folder under a temporary name, then gives it its own. A folder of that name, should there be
    /// one, is not overwritten: the rename fails.
    fn write_pair(&self, record: &PairRecord, json: &[u8], new: &NewPair) -> Result<(), SessionError> {
        let pairs = self.pairs_dir();
        let aside = store::temporary_path(&pairs);
        std::fs::create_dir(&aside).map_err(SessionError::io(&aside))?;
        let written = self.fill_and_name(record, json, new, &aside);
        if written.is_err() {
            // On a full disk it would only take room; the first error is the one to tell.
            let _ = std::fs::remove_dir_all(&aside);
        }
        written
    }

    fn fill_and_name(
        &self,
        record: &PairRecord,
        json: &[u8],
        new: &NewPair,
        aside: &Path,
    ) -> Result<(), SessionError> {
        let pairs = self.pairs_dir();
        let mut files = vec![(PAIR_RECORD, json)];
        for ((_, record), frame) in record.frames().zip(new.frames()) {
            let own = frame_files(record, frame);
            match frame.prepared.as_ref().and_then(|prepared| prepared.staged) {
                Some(Staged(staged)) => {
                    let file = aside.join(&record.file);
                    std::fs::rename(staged, &file).map_err(SessionError::io(&file))?;
                    files.extend(own.into_iter().skip(1));
                }
                None => files.extend(own),
            }
        }
        let sidecars = sidecars(record);
        files.extend(sidecars.iter().map(|(name, text)| (name.as_str(), text.as_bytes())));
        for (name, bytes) in files {
            let file = aside.join(name);
            store::write_synced(&file, bytes).map_err(SessionError::io(&file))?;
        }
        store::sync_folder(aside).map_err(SessionError::io(aside))?;
        let own = self.pair_dir(record);
        std::fs::rename(aside, &own).map_err(SessionError::io(&own))?;
        store::sync_folder(&pairs).map_err(SessionError::io(&pairs))
    }
}

fn intent(Attempt { number, attempt }: Attempt, name: &str) -> Event {
    Event::PairIntended { number, attempt, name: name.to_owned() }
}

/// Number and name of the next pair that is shot.
fn shot_name(numbering: &Numbering) -> (Attempt, String) {
    let number = numbering.next_shot();
    (Attempt::first(number), format!("{number:04}"))
}

/// The name under which a session keeps an original: its role, and the extension that it had.
pub fn original_file_name(role: &str, original_name: &str) -> String {
    let extension = Path::new(original_name).extension().map(|e| e.to_string_lossy().to_lowercase());
    let extension = extension.filter(|e| e.len() <= 8 && e.bytes().all(|b| b.is_ascii_alphanumeric()));
    format!("{role}.{}", extension.as_deref().unwrap_or("raw"))
}

/// The record of a frame that is about to be written.
pub fn frame_record(role: &str, frame: &NewFrame) -> FrameRecord {
    FrameRecord {
        file: original_file_name(role, frame.original_name),
        original_name: frame.original_name.to_owned(),
        bytes: frame.bytes.len() as u64,
        blake3: frame.digest(),
        settings: frame.settings.clone(),
        polariser: None,
        jpeg: frame.jpeg.map(|(bytes, name)| CompanionRecord {
            file: format!("{role}.jpg"),
            original_name: name.to_owned(),
            bytes: bytes.len() as u64,
            blake3: store::digest(bytes),
        }),
    }
}

/// File names and contents of a frame: the raw first, then the JPEG where there is one.
pub fn frame_files<'a>(record: &'a FrameRecord, frame: &NewFrame<'a>) -> Vec<(&'a str, &'a [u8])> {
    let mut files = vec![(record.file.as_str(), frame.bytes)];
    if let (Some(jpeg), Some((bytes, _))) = (&record.jpeg, frame.jpeg) {
        files.push((jpeg.file.as_str(), bytes));
    }
    files
}

/// Names become file names in `derived/` and elsewhere.
fn checked_name(name: &str) -> Result<String, SessionError> {
    let bad = name.is_empty()
        || name.len() > 200
        || name.starts_with('.')
        || name.contains(|c: char| c == '/' || c == '\\' || c.is_control());
    if bad { Err(SessionError::BadName { name: name.to_owned() }) } else { Ok(name.to_owned()) }
}
