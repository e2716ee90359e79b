//! One pair's files to its known light and the lamp that made it.

use crate::calibration::FlashCalibration;
use crate::codec::raw::{self, RawError};
use crate::pair::{PairRecord, Settings};
use crate::photometry::{IsolateError, Known, demosaic, isolate};
use crate::reflectance::observe::Lamp;
use crate::session::Session;

/// Why a pair could not be developed.
#[derive(Debug, thiserror::Error)]
pub enum DevelopError {
    /// A frame cannot be decoded.
    #[error(transparent)]
    Raw(#[from] RawError),
    /// The frames do not fit together.
    #[error("pair {name}: {source}")]
    Isolate {
        /// Pair.
        name: String,
        /// What is wrong.
        source: IsolateError,
    },
    /// The light cannot be compared with the calibration's.
    #[error(
        "pair {name}: its files do not tell the {setting} but the flash calibration's do (or the other way round); calibrate with the lens and body that took the photos"
    )]
    Unknown {
        /// Pair.
        name: String,
        /// Which setting.
        setting: &'static str,
    },
    /// The photo is of another size than its camera model.
    #[error(
        "pair {name} is {got:?} pixels but its camera in the scene {expected:?}: the scene must be reconstructed from full-size photos of this session"
    )]
    Size {
        /// Pair.
        name: String,
        /// Photo.
        got: (usize, usize),
        /// Camera.
        expected: (usize, usize),
    },
}

/// The flash's own light of a pair, as an image.
pub fn known_light(
    session: &Session,
    pair: &PairRecord,
    calibration: &FlashCalibration,
) -> Result<Known, DevelopError> {
    let folder = session.pair_dir(pair.number);
    let (on, off) =
        rayon::join(|| raw::read(&folder.join(&pair.on.file)), || raw::read(&folder.join(&pair.off.file)));
    let scale = exposure(&pair.on.settings) / exposure(&pair.off.settings);
    isolate(&on?.mosaic, &off?.mosaic, scale as f32, &calibration.noise)
        .map(|mosaic| demosaic(&mosaic, calibration.radiance))
        .map_err(|source| DevelopError::Isolate { name: pair.name.clone(), source })
}

/// The lamp as the pair's lit frame saw it: the room's light goes with t ISO / N^2, the flash's with ISO / N^2
/// alone, because a flash is over before the shutter closes.
pub fn lamp(pair: &PairRecord, calibration: &FlashCalibration) -> Result<Lamp, DevelopError> {
    let settings = &pair.on.settings;
    let unknown = |setting| DevelopError::Unknown { name: pair.name.clone(), setting };
    let ratio = |now: Option<f64>, then: Option<f64>, setting| match (now, then) {
        (Some(now), Some(then)) => Ok(now / then),
        (None, None) => Ok(1.0),
        _ => Err(unknown(setting)),
    };
    let iso = ratio(settings.iso.map(|s| s.0), calibration.iso, "ISO")?;
    let aperture = ratio(settings.aperture.map(|n| n.0), calibration.aperture, "aperture")?;
    let gain = iso / (aperture * aperture);
    Ok(Lamp {
        ring: calibration.ring,
        radiance: calibration.radiance.map(|r| r * gain),
        field: calibration.field,
    })
}

/// t ISO / N^2; what is not told counts as equal in both frames, which the pair's checks have made sure of.
fn exposure(settings: &Settings) -> f64 {
    let aperture = settings.aperture.map_or(1.0, |n| n.0);
    settings.shutter.map_or(1.0, |t| t.0) * settings.iso.map_or(1.0, |s| s.0) / (aperture * aperture)
}
