//! What a session knows of its flash's energy: gains for processing, the trend for whoever shoots, the repeatability
//! run. Read from the pairs' records every time; nothing of it is stored but the run.

use crate::calibration::{FlashCalibration, Steadiness};
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
}

/// The flash of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct FlashAccount {
    /// Reference energy and what a reading is worth.
    pub scale: EnergyScale,
    /// Pulse by pulse, with advice.
    pub trend: Trend,
    /// The last repeatability run.
    pub repeatability: Option<Steadiness>,
}

/// Everything that the session's records tell of its flash.
pub fn account(session: &Session) -> Result<FlashAccount, EnergyError> {
    let calibration = if super::flash::exists(session) { Some(super::flash::load(session)?) } else { None };
    let repeatability = repeatability(session)?;
    // Each attempt at a pair fired the flash, and what was rejected drained it as well.
    let pairs: Vec<_> = session.attempts()?.into_values().flatten().collect();
    let scale = scale(&pairs, calibration.as_ref(), repeatability.as_ref());
    Ok(FlashAccount { trend: trend(&pairs, &scale), scale, repeatability })
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
    let path = repeatability_file(session);
    match std::fs::read(&path) {
        Ok(bytes) => serde_json::from_slice(&bytes)
            .map(Some)
            .map_err(|e| EnergyError::Damaged { path, reason: e.to_string() }),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(EnergyError::Io { path, source }),
    }
}
