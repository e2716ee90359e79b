//! One pair's files to its known light and the lamp that made it.

use crate::calibration::exposure::ScaleSource;
use crate::calibration::{FlashCalibration, OtherRig};
use crate::codec::raw::RawError;
use crate::pair::{PairRecord, Settings};
use crate::photometry::apex::{ExposureScale, Nominal};
use crate::photometry::levels::MeasuredLevels;
use crate::photometry::{
    FlashGain, IsolateError, Known, KnownMosaic, NoiseModel, RoomLight, demosaic, isolate, isolate_mean,
};
use crate::pipeline::calibrate::exposure::SessionScale;
use crate::pipeline::calibrate::{self, RecordError};
use crate::pipeline::levels;
use crate::reflectance::observe::Lamp;
use crate::session::Session;
use crate::units::{FNumber, Iso};

/// Why a pair could not be developed.
#[derive(Debug, thiserror::Error)]
pub enum DevelopError {
    /// A frame cannot be decoded.
    #[error(transparent)]
    Raw(#[from] RawError),
    /// A calibration of the session cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
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
    /// The session's exposure table is another body's.
    #[error(
        "pair {name} needs the exposure table, since settings differ: {source}; run `unlit calibrate exposure` with the body that took the photos, or remove calibration/exposure.json"
    )]
    OtherBody {
        /// Pair.
        name: String,
        /// What differs.
        source: OtherRig,
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

/// The flash's own light of a pair, as an image: what a pulse of the reference energy would have given, `gain` being
/// the energy of this one against it.
pub fn known_light(
    session: &Session,
    pair: &PairRecord,
    calibration: &FlashCalibration,
    gain: FlashGain,
) -> Result<Known, DevelopError> {
    let sites = known_sites(session, pair, calibration)?;
    Ok(demosaic(&sites, calibration.radiance).at_reference(gain))
}

/// The flash's own light of a pair on sensor sites, at whatever energy the pulse had. Of several frames without flash
/// the mean is taken off: as [`order`](crate::pair::order) has them, every slope of the room's light cancels in it.
/// Variances are those of the session's noise calibration, where it is of this body and ISO, else the flash calibration's.
pub fn known_sites(
    session: &Session,
    pair: &PairRecord,
    calibration: &FlashCalibration,
) -> Result<KnownMosaic, DevelopError> {
    let noise = calibrate::noise::model(session, &pair.on.settings)?.unwrap_or(calibration.noise);
    isolated_sites(session, pair, &levels::load(session)?, &noise)
}

/// The same with the sensor's saturation and noise as given.
pub(super) fn isolated_sites(
    session: &Session,
    pair: &PairRecord,
    measured: &MeasuredLevels,
    noise: &NoiseModel,
) -> Result<KnownMosaic, DevelopError> {
    let folder = session.pair_dir(pair);
    let read = |file: &str| levels::read(&folder.join(file), measured);
    let (on, off) = rayon::join(|| read(&pair.on.file), || read(&pair.off.file));
    let scale = SessionScale::load(session)?;
    let scale = room_ratio(&pair.name, &scale, [&pair.on.settings, &pair.off.settings])?;
    let (on, off) = (on?.mosaic, off?.mosaic);
    let unfit = |source| DevelopError::Isolate { name: pair.name.clone(), source };
    let mut further = pair.dark_frames().skip(1).peekable();
    if further.peek().is_none() {
        return isolate(&on, &off, scale as f32, noise).map_err(unfit);
    }
    let mut room = RoomLight::of(&off);
    drop(off);
    for frame in further {
        room.add(&read(&frame.file)?.mosaic).map_err(unfit)?;
    }
    isolate_mean(&on, &room, scale as f32, noise).map_err(unfit)
}

/// The room's light in a lit frame over that in an unlit one, by the session's scale; `name` is told in errors.
pub(super) fn room_ratio(
    name: &str,
    scale: &SessionScale,
    [on, off]: [&Settings; 2],
) -> Result<f64, DevelopError> {
    let name = || name.to_owned();
    let table = scale.between(on, off).map_err(|source| DevelopError::OtherBody { name: name(), source })?;
    exposure_ratio_by(&table, on, off).map_err(|setting| DevelopError::Lacking { name: name(), setting })
}

/// The lamp as the pair's lit frame saw it. `scale` is the session's.
pub fn lamp(
    pair: &PairRecord,
    calibration: &FlashCalibration,
    scale: &SessionScale,
) -> Result<Lamp, DevelopError> {
    let (gain, _) = flash_ratio(&pair.name, &pair.on.settings, calibration, scale)?;
    Ok(Lamp {
        ring: calibration.ring,
        radiance: calibration.radiance.map(|r| r * gain),
        field: calibration.field,
    })
}

/// The flash's light at these settings over that at the calibration's, and where that comes from: the room's light goes
/// with t ISO / N^2, the flash's with ISO / N^2 alone, because a flash is over before the shutter closes.
pub(super) fn flash_ratio(
    name: &str,
    settings: &Settings,
    calibration: &FlashCalibration,
    scale: &SessionScale,
) -> Result<(f64, ScaleSource), DevelopError> {
    let unknown = |setting| DevelopError::Unknown { name: name.to_owned(), setting };
    let ratio = |now: Option<f64>, then: Option<f64>, setting| match (now, then) {
        (Some(now), Some(then)) => Ok(now / then),
        (None, None) => Ok(1.0),
        _ => Err(unknown(setting)),
    };
    let (iso, aperture) = (calibration.iso.map(Iso), calibration.aperture.map(FNumber));
    let then = Settings { iso, aperture, shutter: settings.shutter, ..Settings::default() };
    let table = scale
        .between(settings, &then)
        .map_err(|source| DevelopError::OtherBody { name: name.to_owned(), source })?;
    let source = table.source(settings, &then);
    let (iso, aperture) = (|v| table.gain(Iso(v)), |v| table.aperture(FNumber(v)));
    let gain = ratio(settings.iso.map(|s| iso(s.0)), calibration.iso.map(iso), "ISO")?
        * ratio(settings.aperture.map(|n| aperture(n.0)), calibration.aperture.map(aperture), "aperture")?;
    Ok((gain, source))
}

/// S_on / S_off with S = t ISO / N^2, by what the labels stand for. What neither frame tells counts as equal; what one of them lacks is an error
/// that names the setting.
pub(crate) fn exposure_ratio(on: &Settings, off: &Settings) -> Result<f64, &'static str> {
    exposure_ratio_by(&Nominal, on, off)
}

/// The same by a scale of a body's own.
fn exposure_ratio_by(scale: &impl ExposureScale, on: &Settings, off: &Settings) -> Result<f64, &'static str> {
    let ratio = |on: Option<f64>, off: Option<f64>, setting| match (on, off) {
        (Some(on), Some(off)) => Ok(on / off),
        (None, None) => Ok(1.0),
        _ => Err(setting),
    };
    let time = |s: &Settings| s.shutter.map(|v| scale.time(v));
    let iso = |s: &Settings| s.iso.map(|v| scale.gain(v));
    let aperture = |s: &Settings| s.aperture.map(|v| scale.aperture(v));
    Ok(ratio(time(on), time(off), "shutter")?
        * ratio(iso(on), iso(off), "ISO")?
        * ratio(aperture(on), aperture(off), "aperture")?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Seconds;

    #[test]
    fn the_rooms_light_scales_with_time_iso_and_aperture_and_not_with_what_nobody_told() {
        let on = Settings {
            shutter: Some(Seconds(1.0 / 60.0)),
            aperture: Some(FNumber(8.0)),
            iso: Some(Iso(200.0)),
            ..Settings::default()
        };
        // 1/60 and 1/125 are 2^-6 and 2^-7 s, f/8 and f/9 a third of a stop apart.
        let off = Settings { shutter: Some(Seconds(1.0 / 125.0)), iso: Some(Iso(100.0)), ..on.clone() };
        assert!((exposure_ratio(&on, &off).unwrap() - 4.0).abs() < 1e-9);
        let closed = Settings { aperture: Some(FNumber(9.0)), ..off };
        assert!((exposure_ratio(&on, &closed).unwrap() - 4.0 * 2f64.cbrt()).abs() < 1e-9);
        let untold = Settings::default();
        assert_eq!(exposure_ratio(&untold, &untold), Ok(1.0));
        assert_eq!(exposure_ratio(&on, &Settings { shutter: None, ..on.clone() }), Err("shutter"));
    }
}
