//! One pair's files to its known light and the lamp that made it.

use crate::calibration::FlashCalibration;
use crate::calibration::exposure::ScaleSource;
use crate::calibration::flat::FlatField;
use crate::codec::raw::RawError;
use crate::pair::{PairRecord, Settings};
use crate::photometry::apex::ExposureScale;
use crate::photometry::levels::MeasuredLevels;
use crate::photometry::{
    FlashGain, IsolateError, Known, KnownMosaic, NoiseModel, RoomLight, demosaic, isolate, isolate_mean,
};
use crate::pipeline::calibrate::RecordError;
use crate::pipeline::calibrate::noise::{self, SessionNoise};
use crate::pipeline::levels;
use crate::pipeline::scale::{RatioError, SessionScale, of_calibration};
use crate::reflectance::observe::Lamp;
use crate::session::Session;
use glam::DVec2;
use rayon::prelude::*;
use std::collections::BTreeSet;

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
    /// Its exposures cannot be scaled to each other or to the flash calibration's.
    #[error("pair {name}: {source}")]
    Ratio {
        /// Pair.
        name: String,
        /// Why.
        source: RatioError,
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

/// The flash's own light of a pair, as an image: what a pulse of the reference energy would have given, `gain` being
/// the energy of this one against it.
pub fn known_light(
    session: &Session,
    pair: &PairRecord,
    calibration: &FlashCalibration,
    gain: FlashGain,
) -> Result<Known, DevelopError> {
    let sites = known_sites(session, pair, calibration)?;
    Ok(demosaic(&sites, calibration.radiance_dn).at_reference(gain))
}

/// The flash's own light of a pair on sensor sites, at whatever energy the pulse had. Of several frames without flash
/// the mean is taken off: as [`order`](crate::pair::order) has them, every slope of the room's light cancels in it.
/// By what the colours' vignettings differ is taken out. Variances are those of the session's noise calibration, else the
/// flash calibration's, scaled to the pair's ISO.
pub fn known_sites(
    session: &Session,
    pair: &PairRecord,
    calibration: &FlashCalibration,
) -> Result<KnownMosaic, DevelopError> {
    let noise = noise_of(session, &pair.on.settings, calibration)?.model.unwrap_or(calibration.noise);
    let mut known = isolated_sites(session, pair, &levels::load(session)?, &noise)?;
    if let Some(vignetting) = &calibration.colour_vignetting {
        even_colours(&mut known, vignetting);
    }
    Ok(known)
}

fn even_colours(known: &mut KnownMosaic, vignetting: &FlatField) {
    let size = (known.value.width(), known.value.height());
    let cfa = known.cfa;
    let share = |at: usize| {
        let (x, y) = (at % size.0, at / size.0);
        vignetting.over_mean(size, DVec2::new(x as f64, y as f64) + 0.5, cfa.colour(x, y)) as f32
    };
    let values = known.value.pixels_mut().par_iter_mut().zip(known.variance.pixels_mut());
    values.enumerate().for_each(|(at, (value, variance))| {
        let share = share(at);
        if let Some(value) = value {
            *value /= share;
        }
        *variance /= share * share;
    });
}

/// Noise of frames of these settings: the session's own, else the flash calibration's. What was measured at another ISO is
/// scaled, and said.
fn noise_of(
    session: &Session,
    settings: &Settings,
    calibration: &FlashCalibration,
) -> Result<SessionNoise, RecordError> {
    let own = noise::of(session, settings)?;
    let (Some(from), Some(to)) = (calibration.iso.map(crate::units::Iso), settings.iso) else {
        return Ok(own);
    };
    if own.model.is_some() || from == to {
        return Ok(own);
    }
    let said = format!(
        "Variances at {to} are scaled from the flash calibration's {from}, an upper bound; `unlit calibrate noise` with frames at {to} tells the true ones."
    );
    let remark = own.remark.map_or_else(|| said.clone(), |before| format!("{before} {said}"));
    Ok(SessionNoise { model: Some(calibration.noise.at_iso(from, to)), remark: Some(remark), scaled: true })
}

/// What levels and noise of the session leave open for these pairs; an error if they are another body's.
pub(super) fn remarks<'a>(
    session: &Session,
    calibration: &FlashCalibration,
    pairs: impl Iterator<Item = &'a PairRecord>,
) -> Result<Vec<String>, DevelopError> {
    let measured = levels::load(session)?;
    let (mut frames, mut of_noise) = (vec![], BTreeSet::new());
    for pair in pairs {
        for frame in pair.dark_frames().chain([&pair.on]) {
            levels::same_body(&measured, &frame.settings, &format!("pair {}", pair.name))?;
            frames.push(&frame.settings);
        }
        of_noise.extend(noise_of(session, &pair.on.settings, calibration)?.remark);
    }
    Ok(levels::remarks(&measured, frames).into_iter().chain(of_noise).collect())
}

/// As [`known_sites`], with the sensor's saturation and noise as given.
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
    scale.room_ratio(on, off).map_err(|source| DevelopError::Ratio { name: name.to_owned(), source })
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
        radiance: calibration.radiance_dn.map(|r| r * gain),
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
    let then = of_calibration(calibration, settings);
    let table = scale
        .between(settings, &then)
        .map_err(|source| DevelopError::Ratio { name: name.to_owned(), source: source.into() })?;
    let (iso, aperture) = (|v| table.gain(v), |v| table.aperture(v));
    let gain = ratio(settings.iso.map(iso), then.iso.map(iso), "ISO")?
        * ratio(settings.aperture.map(aperture), then.aperture.map(aperture), "aperture")?;
    Ok((gain, table.source(settings, &then)))
}
