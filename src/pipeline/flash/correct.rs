//! One-shot mode by files: the session's flash calibration, corrected by a single shot of the card.

use super::validity::fits;
use super::{CardFacts, CardFiles, FlashError, Reader, file, lens, picture, record, tell_settings};
use crate::calibration::{FlashCalibration, OtherRig, Record, correct_flash};
use crate::pipeline::card_tags;
use crate::pipeline::develop::flash_ratio;
use crate::progress::Progress;
use crate::session::{Session, store};
use crate::units::FNumber;

/// Multiplies the radiances of the session's flash calibration such that it predicts this shot, and keeps the result in
/// its stead. The calibration before is kept beside it. ISO may differ; aperture, lens and polariser may not, since the
/// field is of one aperture.
pub fn correct(
    session: &Session,
    shots: &[CardFiles],
    facts: &CardFacts,
    progress: &Progress,
) -> Result<Record<FlashCalibration>, FlashError> {
    let [shot] = shots else { return Err(FlashError::NotOne(shots.len())) };
    let before = record(session)?;
    let path = file(session);
    let bytes = std::fs::read(&path).map_err(|source| FlashError::Io { path, source })?;
    progress.report("reading the card shot", 0, 1);
    let mut reader = Reader::new(session, facts)?;
    let mut card = reader.card(shot)?;
    if let Some(colours) = &before.fit.colour_vignetting {
        card.even_colours(colours);
    }
    let settings = reader.first.ok_or(FlashError::NoShots)?;
    let (mut series, sights, notes) = (reader.series, reader.sights, reader.notes);
    let name = card.label.clone();
    fits(&before, &name, &settings, &series.rig().lighting)?;
    let aperture = before.fit.aperture.map(FNumber);
    if let (Some(found), Some(expected)) = (settings.aperture, aperture)
        && found != expected
    {
        let (found, expected) = (found.to_string().into(), expected.to_string().into());
        let source = OtherRig { what: "aperture", found, expected, of: "the flash calibration" };
        return Err(FlashError::OtherRig { name, source });
    }
    let (light_ratio, _) = flash_ratio(&name, &settings, &before.fit, &reader.scale)?;
    let intrinsics = lens(session, card.size, facts.focal_px)?;
    let mut fit = correct_flash(&before.fit, &card, (&intrinsics, &facts.target), light_ratio)?;
    tell_settings(&mut fit, &settings);
    fit.findings.card_tags = sights;
    let blake3 = store::digest(&bytes);
    let base = format!("flash_{}.json", blake3.get(..8).unwrap_or(&blake3));
    if let Some(correction) = &mut fit.findings.correction {
        correction.base_file = format!("calibration/{base}");
        correction.base_blake3 = blake3;
    }
    series.beside(base, bytes);
    let (mut verdict, figure) = (fit.verdict(facts.paper), picture(&fit));
    verdict.sentences.extend(card_tags::sentences(&fit.findings.card_tags));
    verdict.sentences.extend(notes);
    Ok(series.keep(fit, verdict, &figure, progress)?)
}
