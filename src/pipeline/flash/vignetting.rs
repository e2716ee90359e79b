//! What is known of the lens's vignetting before the flash is fitted.

use super::FlashError;
use crate::calibration::flat::{Figure, FlatCalibration};
use crate::calibration::{FieldFactor, FlatSource, Record, Rig, Vignetting};
use crate::pair::Settings;
use crate::pipeline::calibrate::flat;
use crate::session::{Session, store};

/// 97.5 % point of the normal distribution.
const NORMAL: f64 = 1.959_964;

/// The vignetting, where it comes from, and what to say of that.
#[derive(Default)]
pub(super) struct Known {
    pub(super) vignetting: Option<Vignetting>,
    pub(super) source: Option<FlatSource>,
    pub(super) sentence: Option<String>,
}

/// As given, else by the session's flat field if it is good and of the shots' body, lens, focal length and aperture.
pub(super) fn of(
    session: &Session,
    rig: &Rig,
    settings: &Settings,
    given: Option<FieldFactor>,
) -> Result<Known, FlashError> {
    if let Some(field) = given {
        let vignetting = Some(Vignetting { field, corner_error: 0.0 });
        return Ok(Known { vignetting, ..Known::default() });
    }
    let Some(record) = flat::load(session)? else { return Ok(Known::default()) };
    let unfit = match (usable(&record, rig, settings), record.verdict.good) {
        (Err(why), _) => Some(why),
        (Ok(()), false) => Some("it is not to be relied on, as it says itself".to_owned()),
        (Ok(()), true) => None,
    };
    if let Some(why) = unfit {
        let sentence = format!(
            "The session's flat field is not used: {why}. With one of these shots' lens and aperture the lobe could be told."
        );
        return Ok(Known { sentence: Some(sentence), ..Known::default() });
    }
    let path = session.calibration_dir().join("flat.json");
    let blake3 = store::digest_file(&path).map_err(|source| FlashError::Io { path, source })?;
    let vignetting = mean(&record.fit);
    let sentence = format!(
        "The vignetting is that of the session's flat field of {}, known to {:.2} % in the corner.",
        record.measured,
        100.0 * NORMAL * vignetting.corner_error
    );
    Ok(Known {
        vignetting: Some(vignetting),
        source: Some(FlatSource { measured: record.measured, blake3 }),
        sentence: Some(sentence),
    })
}

fn usable(record: &Record<FlatCalibration>, rig: &Rig, settings: &Settings) -> Result<(), String> {
    record.fit.fits(&record.rig, settings).map_err(|other| other.to_string())?;
    record.rig.same_polariser(&rig.lighting, "the flat field").map_err(|other| other.to_string())
}

/// One curve for all colours, as the flash's field is: their mean. What they differ by is part of its error.
fn mean(flat: &FlatCalibration) -> Vignetting {
    let curves = &flat.vignetting.coefficients;
    let coefficients = std::array::from_fn(|i| curves.iter().map(|curve| curve[i]).sum::<f64>() / 3.0);
    let error = |figure: &Figure| (figure.interval_95[1] - figure.interval_95[0]) / (2.0 * NORMAL);
    let middle = flat.corner.iter().map(|corner| corner.value).sum::<f64>() / 3.0;
    let spread = flat.corner.iter().map(|corner| (corner.value - middle).abs()).fold(0.0, f64::max);
    let widest = flat.corner.iter().map(error).fold(0.0, f64::max);
    Vignetting { field: FieldFactor { coefficients }, corner_error: widest.hypot(spread) }
}
