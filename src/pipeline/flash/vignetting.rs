//! What is known of the lens's vignetting before the flash is fitted.

use super::FlashError;
use crate::calibration::flat::{FlatCalibration, FlatField, ProfilePoint};
use crate::calibration::{FieldFactor, FlatSource, Record, Rig, Vignetting};
use crate::pair::Settings;
use crate::pipeline::calibrate::flat;
use crate::session::{Session, store};

/// The vignetting, where it comes from, and what to say of that.
#[derive(Default)]
pub(super) struct Known {
    pub(super) vignetting: Option<Vignetting>,
    /// That of each colour, where they differ.
    pub(super) colours: Option<FlatField>,
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
        let vignetting = Some(Vignetting::exact(field));
        return Ok(Known { vignetting, ..Known::default() });
    }
    let Some(record) = flat::load(session)? else { return Ok(Known::default()) };
    let known = match usable(&record, rig, settings) {
        Ok(()) if !record.verdict.good => Err("it is not to be relied on, as it says itself".to_owned()),
        Ok(()) => measured(&record.fit).ok_or_else(|| "its profile tells no curve".to_owned()),
        Err(why) => Err(why),
    };
    let vignetting = match known {
        Ok(vignetting) => vignetting,
        Err(why) => {
            let sentence = format!(
                "The session's flat field is not used: {why}. With one of these shots' lens and aperture the lobe could be told."
            );
            return Ok(Known { sentence: Some(sentence), ..Known::default() });
        }
    };
    let path = session.calibration_dir().join("flat.json");
    let blake3 = store::digest_file(&path).map_err(|source| FlashError::Io { path, source })?;
    let colours = Some(record.fit.vignetting).filter(|_| record.fit.per_channel);
    let by_colour = if colours.is_some() {
        " Each colour has its own, which is taken out of the photographs too."
    } else {
        ""
    };
    let unchecked = match record.rig.tells_body() {
        true => "",
        false => " NOBODY CHECKED OF WHICH BODY AND LENS IT IS: its frames do not tell.",
    };
    let sentence = format!(
        "The vignetting is that of the session's flat field of {}; how well that is known is in the lobe's interval.{by_colour}{unchecked}",
        record.measured
    );
    Ok(Known {
        vignetting: Some(vignetting),
        colours,
        source: Some(FlatSource { measured: record.measured, blake3 }),
        sentence: Some(sentence),
    })
}

fn usable(record: &Record<FlatCalibration>, rig: &Rig, settings: &Settings) -> Result<(), String> {
    record.fit.fits(&record.rig, settings).map_err(|other| other.to_string())?;
    record.rig.same_polariser(&rig.lighting, "the flat field").map_err(|other| other.to_string())
}

/// One curve for all colours, as the flash's field is: that of light from which the colours' differences were taken out.
fn measured(flat: &FlatCalibration) -> Option<Vignetting> {
    let curves = &flat.vignetting.coefficients;
    let coefficients = std::array::from_fn(|i| curves.iter().map(|curve| curve[i]).sum::<f64>() / 3.0);
    let even = |colour: usize| {
        let point = |p: &ProfilePoint| {
            let q = p.radius * p.radius;
            let light = p.light * flat.vignetting.mean_at_q(q) / flat.vignetting.at_q(q, colour);
            ProfilePoint { light, ..*p }
        };
        flat.profile[colour].iter().map(point).collect()
    };
    Vignetting::of_profile(FieldFactor { coefficients }, &[0, 1, 2].map(even))
}
