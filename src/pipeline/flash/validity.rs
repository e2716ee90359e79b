//! Of which photographs a flash calibration is true.
//!
//! Another body, lens, focal length or polariser is refused. ISO and aperture are scaled by ISO / N^2 (by the session's
//! exposure table where it has the steps), and that is said. Another power of the flash is scaled only where the
//! controller measured the energies of both, the card shots' and the pair's, and is refused otherwise.

use super::FlashError;
use crate::calibration::exposure::ScaleSource;
use crate::calibration::{FlashCalibration, OtherRig, Record, Verdict};
use crate::pair::{FlashRecord, Lighting, PairRecord, Settings};
use crate::pipeline::develop::flash_ratio;
use crate::pipeline::scale::SessionScale;
use crate::units::{FNumber, Iso};

const OF: &str = "the flash calibration";

/// Largest relative difference of two focal lengths that are one.
const SAME_FOCAL_LENGTH: f64 = 0.01;

/// Largest relative difference of a pulse's energy from the calibration's that is not worth a word.
const USUAL_ENERGY: f64 = 0.1;

/// Most names in a sentence.
const MOST_NAMES: usize = 4;

/// Refuses what was shot with another body, lens, focal length or polariser.
pub(super) fn fits(
    calibrated: &Record<FlashCalibration>,
    name: &str,
    settings: &Settings,
    lighting: &Lighting,
) -> Result<(), FlashError> {
    let refused = |source| FlashError::OtherRig { name: name.to_owned(), source };
    calibrated.rig.same_lens(settings, OF).map_err(refused)?;
    calibrated.rig.same_polariser(lighting, OF).map_err(refused)?;
    if let (Some(found), Some(expected)) = (settings.focal_length_mm, calibrated.fit.focal_length_mm)
        && (found / expected - 1.0).abs() > SAME_FOCAL_LENGTH
    {
        let (found, expected) = (format!("{found} mm").into(), format!("{expected} mm").into());
        return Err(refused(OtherRig { what: "focal length", found, expected, of: OF }));
    }
    Ok(())
}

/// Refuses a pair that the calibration does not hold for; says what is scaled for it.
fn holds_for(
    calibrated: &Record<FlashCalibration>,
    pair: &PairRecord,
    scale: &SessionScale,
) -> Result<Vec<String>, FlashError> {
    let (fit, settings) = (&calibrated.fit, &pair.on.settings);
    let name = format!("pair {}", pair.name);
    fits(calibrated, &name, settings, &pair.lighting)?;
    let mut scaled = vec![];
    let energy = pair.flash.as_ref().and_then(FlashRecord::energy_counts);
    let ratio = energy.zip(fit.energy_counts).map(|(now, then)| now / then);
    match (pair.lighting.flash_power, calibrated.rig.lighting.flash_power) {
        (Some(found), Some(expected)) if !pair.lighting.same_power(&calibrated.rig.lighting) => {
            if ratio.is_none() {
                return Err(FlashError::OtherPower { name, found, expected });
            }
            scaled.push(format!(
                "the flash stood at {found} of its power and was calibrated at {expected}: scaled by the energies that were measured"
            ));
        }
        _ if ratio.is_some_and(|ratio| (ratio - 1.0).abs() > USUAL_ENERGY) => scaled.push(format!(
            "the flash gave more than {:.0} % less or more energy than at its calibration: scaled by the energies that were measured",
            100.0 * USUAL_ENERGY
        )),
        _ => {}
    }
    let (factor, source) = flash_ratio(&pair.name, settings, fit, scale)?;
    if source != ScaleSource::Same {
        let words = |iso: Option<Iso>, aperture: Option<FNumber>| {
            let told = [aperture.map(|n| n.to_string()), iso.map(|s| s.to_string())];
            told.into_iter().flatten().collect::<Vec<_>>().join(", ")
        };
        let by = if source == ScaleSource::Measured { "the exposure table" } else { "the nominal steps" };
        let then = fit.aperture.map(FNumber);
        let stopped = settings.aperture != then;
        scaled.push(format!(
            "shot at {}, the flash was calibrated at {}: its light is taken to be {factor:.3} times as much, by {by}{}",
            words(settings.iso, settings.aperture),
            words(fit.iso.map(Iso), then),
            if stopped { "; vignetting is taken to be that of the calibration's aperture, which it is not" } else { "" }
        ));
    }
    Ok(scaled)
}

/// Refuses pairs that the calibration does not hold for; says what is scaled for which of them, a sentence each.
pub(in crate::pipeline) fn scaled_for<'a>(
    calibrated: &Record<FlashCalibration>,
    pairs: impl IntoIterator<Item = &'a PairRecord>,
    scale: &SessionScale,
) -> Result<Vec<String>, FlashError> {
    let mut scaled: Vec<(String, Vec<&str>)> = vec![];
    for pair in pairs {
        for what in holds_for(calibrated, pair, scale)? {
            match scaled.iter_mut().find(|(known, _)| *known == what) {
                Some((_, names)) => names.push(&pair.name),
                None => scaled.push((what, vec![&pair.name])),
            }
        }
    }
    let told = |(what, names): (String, Vec<&str>)| {
        let shown = names.iter().take(MOST_NAMES).copied().collect::<Vec<_>>().join(", ");
        match names.len() {
            1 => format!("Scaled, pair {shown}: {what}."),
            n if n <= MOST_NAMES => format!("Scaled, pairs {shown}: {what}."),
            n => format!("Scaled, pairs {shown} and {} more: {what}.", n - MOST_NAMES),
        }
    };
    Ok(scaled.into_iter().map(told).collect())
}

/// What processing must say where the calibration's own verdict is against it.
pub(in crate::pipeline) fn doubt(calibrated: &Record<FlashCalibration>) -> Option<String> {
    let Verdict { good, sentences } = &calibrated.verdict;
    (!good).then(|| {
        let why = sentences.first().map_or("its verdict tells no reason", String::as_str);
        format!("THE FLASH CALIBRATION IS NOT TO BE RELIED ON, and so is no reflectance made with it: {why}")
    })
}

#[cfg(test)]
#[path = "validity_tests.rs"]
mod tests;
