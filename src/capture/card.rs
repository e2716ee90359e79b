//! Shots of the calibration card, kept beside the pairs.

use super::place::{Place, PlaceError, Shots, note};
use crate::pair::order::Program;
use crate::pair::{Expected, FlashRecord, FrameRecord, Lighting, Plan, Reason, Window};
use crate::photometry::levels::MeasuredLevels;
use crate::pipeline::flash::SHOT_RECORD;
use crate::pipeline::levels;
use crate::pipeline::scale::SessionScale;
use crate::session::{self, Session, SessionError, Stager, store};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// `shot.json` beside the two frames of a flash calibration shot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationShot {
    /// Name of its folder under `calibration/flash` (`d01000_1`: 1000 mm, first shot).
    pub name: String,
    /// Distance from the lens to the card along the axis, metres.
    pub distance_m: f64,
    /// Why it should not be used; empty when all is well.
    pub reasons: Vec<Reason>,
    /// The frame without flash.
    pub off: FrameRecord,
    /// The frame with flash.
    pub on: FrameRecord,
    /// The controller's account; absent for manual flashes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flash: Option<FlashRecord>,
    /// Polariser and flash power of the session when it was taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lighting: Option<Lighting>,
}

/// `calibration/flash` of a session.
fn shots_dir(session: &Session) -> PathBuf {
    session.calibration_dir().join("flash")
}

/// All flash calibration shots of a session, by name. Folders without a record were never acknowledged and
/// do not count.
pub fn calibration_shots(session: &Session) -> Result<Vec<CalibrationShot>, PlaceError> {
    let folder = shots_dir(session);
    let entries = match std::fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(PlaceError::Disk { path: folder, source }),
    };
    let mut shots = Vec::new();
    for entry in entries {
        let path = entry.map_err(disk(&folder))?.path().join(SHOT_RECORD);
        let hidden = |p: &Path| {
            p.parent()
                .and_then(Path::file_name)
                .is_some_and(|n| n.to_string_lossy().starts_with(store::TEMPORARY_PREFIX))
        };
        if hidden(&path) || !path.is_file() {
            continue;
        }
        let bytes = std::fs::read(&path).map_err(disk(&path))?;
        shots.push(
            serde_json::from_slice::<CalibrationShot>(&bytes)
                .map_err(|e| SessionError::Damaged { path: path.clone(), why: e.to_string() })?,
        );
    }
    shots.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(shots)
}

/// Removes a shot; the journal hears of it first.
pub(super) fn remove(session: &Session, name: &str) -> Result<(), PlaceError> {
    let folder = shots_dir(session);
    let own = folder.join(name);
    note(session, session::SHOT_REMOVED, json!({ "name": name }))?;
    let aside = tempfile::Builder::new()
        .prefix(store::TEMPORARY_PREFIX)
        .tempdir_in(&folder)
        .map_err(disk(&folder))?;
    std::fs::rename(&own, aside.path().join("shot")).map_err(disk(&own))?;
    store::sync_folder(&folder).map_err(disk(&folder))?;
    aside.close().map_err(disk(&folder))
}

/// The two frames' paths of a calibration shot.
pub fn calibration_frames(session: &Session, shot: &CalibrationShot) -> (PathBuf, PathBuf) {
    let folder = shots_dir(session).join(&shot.name);
    (folder.join(&shot.off.file), folder.join(&shot.on.file))
}

fn disk(path: &Path) -> impl FnOnce(std::io::Error) -> PlaceError + use<> {
    let path = path.to_owned();
    move |source| PlaceError::Disk { path, source }
}

/// A shot of the calibration card.
pub(super) struct CardPlace<'a> {
    session: &'a Session,
    distance_m: f64,
    levels: Arc<MeasuredLevels>,
    scale: SessionScale,
    name: String,
    tag: u32,
    sees_light: bool,
    stored: Option<CalibrationShot>,
}

impl<'a> CardPlace<'a> {
    pub(super) fn new(session: &'a Session, distance_m: f64) -> Result<Self, PlaceError> {
        let taken = calibration_shots(session)?;
        let name = (1..)
            .map(|n| format!("d{:05.0}_{n}", distance_m * 1000.0))
            .find(|name| !shots_dir(session).join(name).exists())
            .unwrap_or_default();
        let tag = u32::try_from(taken.len()).unwrap_or(u32::MAX - 1).saturating_add(1);
        let sees_light = taken.iter().filter_map(|shot| shot.flash.as_ref()).any(FlashRecord::saw_light);
        let levels = Arc::new(levels::load(session)?);
        let scale = SessionScale::load(session)?;
        Ok(Self { session, distance_m, levels, scale, name, tag, sees_light, stored: None })
    }

    /// The shot, once stored.
    pub(super) fn into_shot(self) -> Option<CalibrationShot> {
        self.stored
    }

    /// Fills a folder under a temporary name, then gives it its own.
    fn write(&self, shot: &CalibrationShot, shots: &Shots) -> Result<(), PlaceError> {
        let folder = shots_dir(self.session);
        std::fs::create_dir_all(&folder).map_err(disk(&folder))?;
        let aside = tempfile::Builder::new()
            .prefix(store::TEMPORARY_PREFIX)
            .tempdir_in(&folder)
            .map_err(disk(&folder))?;
        let json = serde_json::to_vec_pretty(shot).map_err(|e| SessionError::Damaged {
            path: aside.path().join(SHOT_RECORD),
            why: e.to_string(),
        })?;
        let mut files = vec![(SHOT_RECORD, json.as_slice())];
        files.extend(session::frame_files(&shot.off, &shots.off.new_frame()));
        files.extend(session::frame_files(&shot.on, &shots.on.new_frame()));
        for (name, bytes) in files {
            let file = aside.path().join(name);
            store::write_atomic(&file, bytes).map_err(disk(&file))?;
        }
        let own = folder.join(&self.name);
        std::fs::rename(aside.path(), &own).map_err(disk(&own))?;
        // Renamed away: there is nothing left to remove.
        let _old_name = aside.keep();
        // Temporary folders are private; a session is as readable as its folder.
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            std::fs::set_permissions(&own, std::fs::Permissions::from_mode(0o755)).map_err(disk(&own))?;
        }
        store::sync_folder(&folder).map_err(disk(&folder))
    }
}

impl Place for CardPlace<'_> {
    fn tag(&self) -> u32 {
        self.tag
    }

    fn program(&self) -> Program {
        Program::default()
    }

    /// Near cards need less light than the object: they are shot as the operator set the camera.
    fn plan(&self) -> Option<Plan> {
        None
    }

    fn adopt(&mut self, _plan: Plan) -> Result<(), PlaceError> {
        Ok(())
    }

    fn region(&self) -> Option<Window> {
        None
    }

    fn sees_light(&self) -> bool {
        self.sees_light
    }

    fn stager(&self) -> Option<Stager> {
        None
    }

    fn levels(&self) -> Arc<MeasuredLevels> {
        self.levels.clone()
    }

    fn scale(&self) -> &SessionScale {
        &self.scale
    }

    fn expected<'b>(&'b self, _off: &'b str, _on: &'b str, _energy: Option<f64>) -> Expected<'b> {
        Expected::default()
    }

    fn intend(&mut self) -> Result<(), PlaceError> {
        self.session.require_room()?;
        note(self.session, session::SHOT_STARTED, json!({ "name": self.name }))
    }

    fn store(&mut self, shots: Shots) -> Result<(), PlaceError> {
        let shot = CalibrationShot {
            name: self.name.clone(),
            distance_m: self.distance_m,
            reasons: shots.reasons.clone(),
            off: session::frame_record("off", &shots.off.new_frame()),
            on: session::frame_record("on", &shots.on.new_frame()),
            flash: shots.flash.clone(),
            lighting: Some(self.session.manifest().lighting),
        };
        self.write(&shot, &shots)?;
        note(self.session, session::SHOT_STORED, json!({ "name": self.name }))?;
        self.stored = Some(shot);
        Ok(())
    }

    fn abandon(&mut self, why: &str) -> Result<(), PlaceError> {
        note(self.session, session::SHOT_ABANDONED, json!({ "name": self.name, "why": why }))
    }
}
