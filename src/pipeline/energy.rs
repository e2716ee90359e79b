//! What a session knows of its flash's energy: gains for processing, the trend for whoever shoots, the repeatability
//! run. Read from the pairs' records every time; nothing of it is stored but the run.

use crate::calibration::FlashCalibration;
use crate::pair::energy::{EnergyScale, Repeatability, Trend, trend};
use crate::pair::{FlashRecord, PairRecord, Verdict};
use crate::session::{Session, SessionError, store};
use std::path::{Path, PathBuf};

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
    #[error("cannot access {}: {source}; check that the disk is there, writable and not full", path.display())]
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
    pub repeatability: Option<Repeatability>,
}

/// Everything that the session's records tell of its flash.
pub fn account(session: &Session) -> Result<FlashAccount, EnergyError> {
    let calibration = if super::flash::exists(session) { Some(super::flash::load(session)?) } else { None };
    let repeatability = repeatability(session)?;
    let pairs = session.pairs()?;
    let scale = scale(&pairs, calibration.as_ref(), repeatability.as_ref());
    Ok(FlashAccount { trend: trend(&pairs, &scale), scale, repeatability })
}

/// The energy scale of a session's pairs.
pub(super) fn scale(
    pairs: &[PairRecord],
    calibration: Option<&FlashCalibration>,
    repeatability: Option<&Repeatability>,
) -> EnergyScale {
    let accepted = pairs.iter().filter(|pair| pair.verdict == Verdict::Accepted);
    let records: Vec<&FlashRecord> = accepted.filter_map(|pair| pair.flash.as_ref()).collect();
    let reference = calibration.and_then(|fit| fit.energy_counts);
    EnergyScale::new(records.iter().copied(), reference, repeatability.map(Repeatability::agreement))
}

/// Where the repeatability run is kept.
fn file(session: &Session) -> PathBuf {
    session.calibration_dir().join("repeatability.json")
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> EnergyError + '_ {
    move |source| EnergyError::Io { path: path.to_owned(), source }
}

/// The session's last repeatability run, if there was one.
pub fn repeatability(session: &Session) -> Result<Option<Repeatability>, EnergyError> {
    let path = file(session);
    match std::fs::read(&path) {
        Ok(bytes) => serde_json::from_slice(&bytes)
            .map(Some)
            .map_err(|e| EnergyError::Damaged { path, reason: e.to_string() }),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(io(&path)(source)),
    }
}

/// Keeps a repeatability run as the session's last.
pub fn keep_repeatability(session: &Session, run: &Repeatability) -> Result<(), EnergyError> {
    let path = file(session);
    let bytes = serde_json::to_vec_pretty(run)
        .map_err(|e| EnergyError::Damaged { path: path.clone(), reason: e.to_string() })?;
    let folder = session.calibration_dir();
    std::fs::create_dir_all(&folder).map_err(io(&folder))?;
    store::write_atomic(&path, &bytes).map_err(io(&path))
}
