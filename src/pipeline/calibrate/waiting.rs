//! Shots that wait for their calibration: `calibration/waiting/KIND/NNNN/`, each the camera's own file (or two) and
//! `shot.json`.
//!
//! A shot's folder gets its name when everything in it is on the disk, so that what was acknowledged is there after
//! any crash. Once a fit can be relied on its shots are copied beside its record and do not wait any more; after a
//! fit that cannot, they wait on, for others to be added.

use super::RecordError;
use crate::calibration::guide::{Kind, Role};
use crate::codec::raw::{Photo, RawError};
use crate::pair::{Lighting, Settings};
use crate::photometry::Mosaic;
use crate::photometry::levels::MeasuredLevels;
use crate::pipeline::levels as sensor_levels;
use crate::session::{
    self, Event, FRAME_REMOVED, FRAME_STORED, Session, SessionError, WAITING, advice, store, utc_now,
};
use crate::units::{FNumber, Iso, Seconds};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Name of the record beside a shot's files.
const RECORD: &str = "shot.json";

/// Sites between those that are looked at for a frame's mean, down and across; odd, so that every colour is seen.
const STRIDE: usize = 7;

/// Why a shot could not be kept, read or removed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WaitingError {
    /// The disk refused.
    #[error("{}: {source}; {}", path.display(), advice(source))]
    Io {
        /// File or folder.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
    /// A frame cannot be decoded.
    #[error(transparent)]
    Raw(#[from] RawError),
    /// The same photograph waits already, as something else.
    #[error("this photograph waits already as shot {number} ({role}); remove that one first")]
    Twice {
        /// Number of the other.
        number: u32,
        /// Its role's name.
        role: &'static str,
    },
    /// No such shot.
    #[error("no shot {shot:?} waits for the calibration of {kind}")]
    None {
        /// Name of the kind.
        kind: &'static str,
        /// What was asked for.
        shot: String,
    },
    /// A record cannot be read.
    #[error("{} is damaged ({reason}); remove its folder and take the shot again", path.display())]
    Damaged {
        /// The record.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file is not what it was.
    #[error("{} is not the file any more that was stored; remove shot {number} and take it again", path.display())]
    Altered {
        /// The file.
        path: PathBuf,
        /// Number of the shot.
        number: u32,
    },
    /// The session's measured levels.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The session's journal.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// Where a shot comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// It was shot here.
    Camera,
    /// It was sent in.
    Upload,
}

/// One file of a shot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WaitingFile {
    /// Its name beside the record.
    pub file: String,
    /// Name that it had before.
    pub original_name: String,
    /// Length in bytes.
    pub bytes: u64,
    /// BLAKE3, hexadecimal.
    pub blake3: String,
}

/// A shot that waits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WaitingShot {
    /// Its number among those of its kind that wait.
    pub number: u32,
    /// As what it was shot.
    pub role: Role,
    /// Distance from the lens to the card in metres; of card shots alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance_m: Option<f64>,
    /// The frame.
    pub frame: WaitingFile,
    /// The same without flash, of a card shot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub off: Option<WaitingFile>,
    /// Where it comes from.
    pub origin: Origin,
    /// When it was stored, UTC.
    pub stored: String,
    /// Exposure time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shutter: Option<Seconds>,
    /// Relative aperture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aperture: Option<FNumber>,
    /// Sensitivity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso: Option<Iso>,
    /// Energy of its pulse in counts, of a frame lit by a flash whose controller measured it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub energy_counts: Option<f64>,
    /// Polariser and flash power of the session when it was stored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lighting: Option<Lighting>,
    /// Mean of the brightest colour, 0 at black and 1 at saturation.
    pub mean_share: f64,
    /// Share of the sites that clip, of the colour that does most.
    pub clipped_share: f64,
}

/// A shot on its way in.
#[derive(Clone, Copy, Debug)]
pub struct Incoming<'a> {
    /// As what it was shot.
    pub role: Role,
    /// Distance from the lens to the card in metres; of card shots alone.
    pub distance_m: Option<f64>,
    /// Name and bytes of the frame.
    pub frame: (&'a str, &'a [u8]),
    /// The same without flash, of a card shot.
    pub off: Option<(&'a str, &'a [u8])>,
    /// Where it comes from.
    pub origin: Origin,
    /// Energy of its pulse in counts, if a controller measured it.
    pub energy_counts: Option<f64>,
}

impl WaitingShot {
    /// Path of its frame from the session's folder, with slashes.
    pub fn frame_path(&self, kind: Kind) -> String {
        self.place(kind, &self.frame)
    }

    /// Path of its frame without flash from the session's folder.
    pub fn off_path(&self, kind: Kind) -> Option<String> {
        self.off.as_ref().map(|off| self.place(kind, off))
    }

    fn place(&self, kind: Kind, file: &WaitingFile) -> String {
        format!("{WAITING}/{}/{:04}/{}", kind.name(), self.number, file.file)
    }
}

/// Keeps a shot; on the disk when this returns. The same photograph sent in again is the one that is there.
pub fn add(session: &Session, kind: Kind, shot: Incoming<'_>) -> Result<WaitingShot, WaitingError> {
    let measured = match kind {
        Kind::Levels => MeasuredLevels::default(),
        _ => sensor_levels::load(session)?,
    };
    let Photo { mosaic, settings, .. } = sensor_levels::decode(shot.frame.1, shot.frame.0, &measured)?;
    if let Some((name, bytes)) = shot.off {
        sensor_levels::decode(bytes, name, &measured)?;
    }
    let file = |role: &str, (name, bytes): (&str, &[u8])| WaitingFile {
        file: file_name(role, name),
        original_name: name.to_owned(),
        bytes: bytes.len() as u64,
        blake3: store::digest(bytes),
    };
    let frame = file(shot.role.name(), shot.frame);
    let there = list(session, kind)?;
    if let Some(same) = there.iter().find(|other| other.frame.blake3 == frame.blake3) {
        if same.role == shot.role && same.distance_m == shot.distance_m {
            return Ok(same.clone());
        }
        return Err(WaitingError::Twice { number: same.number, role: same.role.name() });
    }
    let Settings { shutter, aperture, iso, .. } = settings;
    let mut kept = WaitingShot {
        number: there.last().map_or(1, |last| last.number + 1),
        role: shot.role,
        distance_m: shot.distance_m,
        frame,
        off: shot.off.map(|(name, bytes)| WaitingFile {
            // It may be called like the lit one.
            file: format!("off_{}", file_name("frame", name)),
            ..file("off", (name, bytes))
        }),
        origin: shot.origin,
        stored: utc_now(),
        shutter,
        aperture,
        iso,
        energy_counts: shot.energy_counts,
        lighting: Some(session.manifest().lighting),
        mean_share: mean_share(&mosaic),
        clipped_share: mosaic.clipped_shares().into_iter().fold(0.0, f64::max),
    };
    let folder = folder(session, kind);
    std::fs::create_dir_all(&folder).map_err(io(&folder))?;
    loop {
        let aside = tempfile::Builder::new()
            .prefix(store::TEMPORARY_PREFIX)
            .tempdir_in(&folder)
            .map_err(io(&folder))?;
        let mut files = vec![(kept.frame.file.as_str(), shot.frame.1)];
        files.extend(kept.off.iter().map(|off| off.file.as_str()).zip(shot.off.map(|off| off.1)));
        let record = serde_json::to_vec_pretty(&kept).map_err(damaged(&aside.path().join(RECORD)))?;
        files.push((RECORD, &record));
        for (name, bytes) in files {
            let path = aside.path().join(name);
            store::write_atomic(&path, bytes).map_err(io(&path))?;
        }
        let own = folder.join(format!("{:04}", kept.number));
        match std::fs::rename(aside.path(), &own) {
            Ok(()) => {
                // Renamed away: there is nothing left to remove.
                let _old_name = aside.keep();
                readable(&own)?;
                store::sync_folder(&folder).map_err(io(&folder))?;
                note(session, FRAME_STORED, kind, kept.number, &kept.frame.blake3)?;
                return Ok(kept);
            }
            // Somebody was faster.
            Err(_) if own.exists() => kept.number += 1,
            Err(source) => return Err(WaitingError::Io { path: own, source }),
        }
    }
}

/// The shots of a kind that wait, by number. Folders without a record were never acknowledged and do not count.
pub fn list(session: &Session, kind: Kind) -> Result<Vec<WaitingShot>, WaitingError> {
    let folder = folder(session, kind);
    let entries = match std::fs::read_dir(&folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(vec![]),
        other => other.map_err(io(&folder))?,
    };
    let mut shots = vec![];
    for entry in entries {
        let entry = entry.map_err(io(&folder))?;
        if let Some(number) = entry.file_name().to_str().and_then(|name| name.parse().ok()) {
            shots.extend(read(&entry.path(), number)?);
        }
    }
    shots.sort_by_key(|shot| shot.number);
    Ok(shots)
}

/// The shot whose folder this is; `None` if there is no whole one.
fn read(folder: &Path, number: u32) -> Result<Option<WaitingShot>, WaitingError> {
    let path = folder.join(RECORD);
    match std::fs::read(&path) {
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
        read => {
            let shot = serde_json::from_slice(&read.map_err(io(&path))?).map_err(damaged(&path))?;
            Ok(Some(WaitingShot { number, ..shot }))
        }
    }
}

/// Removes a shot that waits; it is gone whole or not at all.
pub fn remove(session: &Session, kind: Kind, number: u32) -> Result<(), WaitingError> {
    let folder = folder(session, kind);
    let own = folder.join(format!("{number:04}"));
    let Some(shot) = read(&own, number)? else {
        return Err(WaitingError::None { kind: kind.name(), shot: number.to_string() });
    };
    let aside =
        tempfile::Builder::new().prefix(store::TEMPORARY_PREFIX).tempdir_in(&folder).map_err(io(&folder))?;
    std::fs::rename(&own, aside.path().join("shot")).map_err(io(&own))?;
    store::sync_folder(&folder).map_err(io(&folder))?;
    // Whoever hears of it, as the mirror does, finds it gone.
    note(session, FRAME_REMOVED, kind, number, &shot.frame.blake3)?;
    aside.close().map_err(io(&folder))
}

/// The paths of shots' frames, each as it was stored.
pub(super) fn frames(
    session: &Session,
    kind: Kind,
    shots: &[WaitingShot],
    role: Role,
) -> Result<Vec<PathBuf>, WaitingError> {
    let own = shots.iter().filter(|shot| shot.role == role);
    own.map(|shot| checked(session, shot.frame_path(kind), &shot.frame, shot.number)).collect()
}

/// Paths of a card shot's lit frame and of the one without flash, each as it was stored.
pub fn card_frames(
    session: &Session,
    shot: &WaitingShot,
) -> Result<(PathBuf, Option<PathBuf>), WaitingError> {
    let check = |file: &WaitingFile| checked(session, shot.place(Kind::Flash, file), file, shot.number);
    Ok((check(&shot.frame)?, shot.off.as_ref().map(check).transpose()?))
}

fn checked(
    session: &Session,
    inside: String,
    file: &WaitingFile,
    number: u32,
) -> Result<PathBuf, WaitingError> {
    let path = session.path().join(inside);
    match store::digest_file(&path).map_err(io(&path))? == file.blake3 {
        true => Ok(path),
        false => Err(WaitingError::Altered { path, number }),
    }
}

/// Polariser and flash power that the record of a shot beside its frame tells.
pub(super) fn lighting_beside(frame: &Path) -> Option<Lighting> {
    #[derive(Deserialize)]
    struct Told {
        lighting: Option<Lighting>,
    }
    let bytes = std::fs::read(frame.with_file_name(RECORD)).ok()?;
    serde_json::from_slice::<Told>(&bytes).ok()?.lighting
}

/// Whether a path from the session's folder is that of a shot that waits.
pub(super) fn is_waiting(inside: &Path) -> bool {
    inside.starts_with(WAITING)
}

/// The name that a file had, if that is plain; else one for its role.
fn file_name(role: &str, name: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if !name.is_empty()
        && name.len() <= 80
        && !name.starts_with('.')
        && name != RECORD
        && name.chars().all(plain)
    {
        return name.to_owned();
    }
    session::original_file_name(role, name)
}

/// Mean of the brightest colour, 0 at black and 1 at saturation.
fn mean_share(mosaic: &Mosaic) -> f64 {
    let (mut sums, mut counts) = ([0.0f64; 3], [0u32; 3]);
    let width = mosaic.dn.width().max(1);
    for (y, row) in mosaic.dn.pixels().chunks_exact(width).enumerate().step_by(STRIDE) {
        for (x, &dn) in row.iter().enumerate().step_by(STRIDE) {
            let (black, white) = (mosaic.levels.black[y & 1][x & 1], mosaic.levels.saturation[y & 1][x & 1]);
            if white > black {
                let colour = usize::from(mosaic.cfa.0[y & 1][x & 1]).min(2);
                sums[colour] += f64::from((f32::from(dn) - black) / (white - black));
                counts[colour] += 1;
            }
        }
    }
    let means = sums.iter().zip(counts).filter(|(_, n)| *n > 0).map(|(sum, n)| sum / f64::from(n));
    means.reduce(f64::max).unwrap_or_default()
}

/// Temporary folders are private; a session is as readable as its folder.
fn readable(folder: &Path) -> Result<(), WaitingError> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o755)).map_err(io(folder))?;
    }
    Ok(())
}

/// Tells the journal.
fn note(session: &Session, what: &str, kind: Kind, number: u32, blake3: &str) -> Result<(), WaitingError> {
    let detail = json!({ "kind": kind, "shot": number, "blake3": blake3 });
    Ok(session.record(Event::Note { what: what.to_owned(), detail })?)
}

fn folder(session: &Session, kind: Kind) -> PathBuf {
    session.path().join(WAITING).join(kind.name())
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> WaitingError + '_ {
    move |source| WaitingError::Io { path: path.to_owned(), source }
}

fn damaged(path: &Path) -> impl FnOnce(serde_json::Error) -> WaitingError + '_ {
    move |error| WaitingError::Damaged { path: path.to_owned(), reason: error.to_string() }
}
