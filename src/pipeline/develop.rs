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
    /// The room's light cannot be scaled.
    #[error(
        "pair {name}: only one of its two frames tells the {setting}, so that the room's light cannot be taken out; shoot it again with one setting for both"
    )]
    Lacking {
        /// Pair.
        name: String,
        /// Which setting.
        setting: &'static str,
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
    let scale = exposure_ratio(&pair.on.settings, &pair.off.settings)
        .map_err(|setting| DevelopError::Lacking { name: pair.name.clone(), setting })?;
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

/// S_on / S_off with S = t ISO / N^2. What neither frame tells counts as equal; what one of them lacks is an error
/// that names the setting.
pub(super) fn exposure_ratio(on: &Settings, off: &Settings) -> Result<f64, &'static str> {
    let ratio = |on: Option<f64>, off: Option<f64>, setting| match (on, off) {
        (Some(on), Some(off)) => Ok(on / off),
        (None, None) => Ok(1.0),
        _ => Err(setting),
    };
    let time = ratio(on.shutter.map(|t| t.0), off.shutter.map(|t| t.0), "shutter")?;
    let iso = ratio(on.iso.map(|s| s.0), off.iso.map(|s| s.0), "ISO")?;
    let aperture = ratio(on.aperture.map(|n| n.0), off.aperture.map(|n| n.0), "aperture")?;
    Ok(time * iso / (aperture * aperture))
}
#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{FNumber, Iso, Seconds};

    #[test]
    fn the_rooms_light_scales_with_time_iso_and_aperture_and_not_with_what_nobody_told() {
        let on = Settings {
            shutter: Some(Seconds(1.0 / 60.0)),
            aperture: Some(FNumber(8.0)),
            iso: Some(Iso(200.0)),
            ..Settings::default()
        };
        let off = Settings { shutter: Some(Seconds(1.0 / 120.0)), iso: Some(Iso(100.0)), ..on.clone() };
        assert!((exposure_ratio(&on, &off).unwrap() - 4.0).abs() < 1e-9);
        let untold = Settings::default();
        assert_eq!(exposure_ratio(&untold, &untold), Ok(1.0));
        assert_eq!(exposure_ratio(&on, &Settings { shutter: None, ..on.clone() }), Err("shutter"));
    }
}
