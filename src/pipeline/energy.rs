//! What a session knows of its flash's energy: gains for processing, the trend for whoever shoots, the repeatability
//! run. Read from the pairs' records every time; nothing of it is stored but the run.

use crate::calibration::{FlashCalibration, SCHEMA, Steadiness};
use crate::pair::energy::{EnergyScale, Trend, trend};
use crate::pair::{FlashRecord, PairRecord, Verdict};
use crate::session::{Session, SessionError};
use std::borrow::Borrow;
use std::path::PathBuf;

/// Why a session's energies cannot be told.
#[derive(Debug, thiserror::Error)]
pub enum EnergyError {
    /// The session folder.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The flash calibration.
    #[error(transparent)]
    Flash(#[from] super::flash::FlashError),
    /// The file system refused.
    #[error("cannot read {}: {source}; check that it may be read", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// `repeatability.json` is broken.
    #[error("{} is damaged ({reason}); run `unlit calibrate repeatability` again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// `repeatability.json` is of an earlier program.
    #[error("{} does not count: it is of an earlier version of unlit; measure the flash's repeatability again", .0.display())]
    Older(PathBuf),
    /// It is of a later program.
    #[error("{} was written by a later version of unlit (form {found}, this program knows {SCHEMA}); update unlit", path.display())]
    TooNew {
        /// The file.
        path: PathBuf,
        /// Its form.
        found: u32,
    },
}

/// The flash of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct FlashAccount {
    /// Reference energy and what a reading is worth.
    pub scale: EnergyScale,
    /// Pulse by pulse, with advice.
    pub trend: Trend,
    /// The last repeatability run; one of an earlier version of unlit counts as none.
    pub repeatability: Option<Steadiness>,
}

/// Everything that the session's records tell of its flash.
pub fn account(session: &Session) -> Result<FlashAccount, EnergyError> {
    let calibration = if super::flash::exists(session) { Some(super::flash::load(session)?) } else { None };
    let repeatability = match repeatability(session) {
        Err(EnergyError::Older(_)) => None,
        run => run?,
    };
    // Each attempt at a pair fired the flash, and what was rejected drained it as well.
    let pairs: Vec<_> = session.attempts()?.into_values().flatten().collect();
    let scale = scale(&pairs, calibration.as_ref(), repeatability.as_ref());
    Ok(FlashAccount { trend: trend(&pairs, &scale), scale, repeatability })
}

/// What is to be said of a repeatability run that does not count.
pub(super) fn remark(session: &Session) -> Option<String> {
    match repeatability(session) {
        Err(older @ EnergyError::Older(_)) => Some(older.to_string()),
        _ => None,
    }
}

/// The energy scale of a session's pairs.
pub(super) fn scale(
    pairs: &[impl Borrow<PairRecord>],
    calibration: Option<&FlashCalibration>,
    repeatability: Option<&Steadiness>,
) -> EnergyScale {
    let accepted = pairs.iter().map(Borrow::borrow).filter(|pair| pair.verdict == Verdict::Accepted);
    let records: Vec<&FlashRecord> = accepted.filter_map(|pair| pair.flash.as_ref()).collect();
    let reference = calibration.and_then(|fit| fit.energy_counts);
    EnergyScale::new(records.iter().copied(), reference, repeatability.and_then(Steadiness::agreement))
}

/// Where the last repeatability run is kept.
pub fn repeatability_file(session: &Session) -> PathBuf {
    session.calibration_dir().join("repeatability.json")
}

/// The session's last repeatability run, if there was one.
pub fn repeatability(session: &Session) -> Result<Option<Steadiness>, EnergyError> {
    #[derive(serde::Deserialize)]
    struct Form {
        schema: Option<u32>,
    }
    let path = repeatability_file(session);
    let bytes = match std::fs::read(&path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        read => read.map_err(|source| EnergyError::Io { path: path.clone(), source })?,
    };
    let damaged = |e: serde_json::Error| EnergyError::Damaged { path: path.clone(), reason: e.to_string() };
    let Form { schema } = serde_json::from_slice(&bytes).map_err(damaged)?;
    match schema {
        Some(SCHEMA) => serde_json::from_slice(&bytes).map(Some).map_err(damaged),
        Some(found) if found > SCHEMA => Err(EnergyError::TooNew { path, found }),
        _ => Err(EnergyError::Older(path)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_run_of_an_earlier_version_counts_as_none_and_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("s"), "s").unwrap();
        let keep = |run: &str| session.keep(&repeatability_file(&session), run.as_bytes()).unwrap();
        let known = || account(&session).map(|account| account.repeatability.map(|run| run.frames.len()));
        assert_eq!((known().unwrap(), remark(&session)), (None, None), "nothing was measured");

        keep(&json!({ "taken": "2026-11-01T10:00:00Z", "spread": 0.003, "frames": [] }).to_string());
        assert_eq!(known().unwrap(), None);
        assert!(remark(&session).unwrap().contains("measure the flash's repeatability again"));

        let shot = crate::calibration::SteadyShot { light_dn: [100.0; 3], ..Default::default() };
        let run = crate::calibration::steadiness(vec![shot; 8]).unwrap();
        let mut stored = json!(run);
        stored["schema"] = json!(SCHEMA);
        keep(&stored.to_string());
        assert_eq!((known().unwrap(), remark(&session)), (Some(8), None));

        stored["schema"] = json!(SCHEMA + 1);
        keep(&stored.to_string());
        assert!(matches!(known(), Err(EnergyError::TooNew { found, .. }) if found == SCHEMA + 1));
        keep(&json!({ "schema": SCHEMA }).to_string());
        assert!(matches!(known(), Err(EnergyError::Damaged { .. })));
    }
}
