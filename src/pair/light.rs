//! The checks on light: clipped, missing, weak, gone.
//!
//! Each takes what the survey found and the limits, and gives a reason where a limit was broken.

use super::limits::Limits;
use super::survey::{self, Block, Survey};
use super::{Reason, ReasonCode};
use crate::photometry::Mosaic;

const COLOURS: [&str; 3] = ["red", "green", "blue"];

fn reason(code: ReasonCode, figure: f64, limit: f64, sentence: String) -> Option<Reason> {
    Some(Reason { code, figure, limit, sentence })
}

/// The colour and frame with the worst share of clipped sites, measured by its limit, inside the region and
/// outside it.
pub(super) fn overexposed(survey: &Survey, limits: &Limits, has_region: bool) -> Option<Reason> {
    let mut found = vec![];
    for (frame, clipped) in ["unlit", "lit"].into_iter().zip(survey.clipped) {
        for (c, colour) in COLOURS.into_iter().enumerate() {
            found.push((frame, colour, true, clipped.inside[c].share(), limits.clipped_share));
            found.push((frame, colour, false, clipped.outside[c].share(), limits.clipped_share_outside));
        }
    }
    let over = found.into_iter().filter(|(_, _, _, share, limit)| share > limit);
    let (frame, colour, inside, share, limit) = over.max_by(|a, b| (a.3 / a.4).total_cmp(&(b.3 / b.4)))?;
    let place = match (has_region, inside) {
        (false, _) => "",
        (true, true) => " inside the region",
        (true, false) => " outside the region",
    };
    let advice = match (frame, inside) {
        ("lit", true) => {
            "close the aperture or find the exposure anew (lower the flash power only before a session's first pair)"
        }
        (_, true) => "shorten the exposure, or dim the room",
        (_, false) => "turn the lamp or window out of the picture, or cover what shines",
    };
    let sentence = format!(
        "{:.2} % of the {colour} sites of the {frame} frame{place} are clipped, more than {:.2} %; {advice}, and shoot the pair again.",
        100.0 * share,
        100.0 * limit
    );
    reason(ReasonCode::Overexposed, share, limit, sentence)
}

/// Whether a block rose beyond its noise and beyond what the room's own light may do.
fn is_lit(block: &Block, limits: &Limits) -> bool {
    block.rise > limits.noise_sigmas * block.error && block.rise > limits.ambient_rise * block.ambient
}

/// The blocks where the flash is looked for.
fn inside(survey: &Survey) -> impl Iterator<Item = &Block> + Clone {
    survey.blocks.iter().filter(|b| b.inside)
}

pub(super) fn misfire(survey: &Survey, limits: &Limits, has_region: bool) -> Option<Reason> {
    let lit = survey::share(inside(survey), |b| is_lit(b, limits));
    if lit >= limits.lit_share {
        return None;
    }
    let darker = survey::share(inside(survey), |b| b.rise < -limits.noise_sigmas * b.error);
    let advice = if darker > 0.5 {
        "the frames look swapped: give the unlit frame as off, the lit one as on"
    } else {
        "check the flash's cable, charge and switch, and shoot the pair again"
    };
    let sentence = format!(
        "The light rose in {:.2} % of the {} only (at least {:.2} % is expected), so the flash did not fire; {advice}.",
        100.0 * lit,
        if has_region { "region" } else { "frame" },
        100.0 * limits.lit_share
    );
    reason(ReasonCode::Misfire, lit, limits.lit_share, sentence)
}

/// Flash light too little to measure with, whatever the stop.
pub(super) fn weak(survey: &Survey, on: &Mosaic, limits: &Limits) -> Option<Reason> {
    let levels = on.levels.saturation.concat().into_iter().zip(on.levels.black.concat());
    let range = levels.map(|(saturation, black)| f64::from(saturation - black)).sum::<f64>() / 4.0;
    let rise = survey::best_hundredth(inside(survey)) / range;
    if rise >= limits.least_rise {
        return None;
    }
    let sentence = format!(
        "The flash lifts the best-lit hundredth of the picture by {:.2} % of the range only, less than {:.2} %; raise its power, open the aperture, or go nearer.",
        100.0 * rise,
        100.0 * limits.least_rise
    );
    reason(ReasonCode::Weak, rise, limits.least_rise, sentence)
}

/// `share` of the flash light that the same stop gave before.
pub(super) fn weaker_than_before(share: f64, limits: &Limits) -> Option<Reason> {
    if share >= limits.least_rise_of_earlier {
        return None;
    }
    let sentence = format!(
        "The flash gave {:.1} % of the light that it gave from this stop before, less than {:.1} %; let it recharge, and shoot the pair again.",
        100.0 * share,
        100.0 * limits.least_rise_of_earlier
    );
    reason(ReasonCode::Weak, share, limits.least_rise_of_earlier, sentence)
}

/// `share` of the energy that the board measured in earlier pulses.
pub(super) fn weak_pulse(share: f64, limits: &Limits) -> Option<Reason> {
    if share >= limits.least_energy {
        return None;
    }
    let sentence = format!(
        "The flash's pulse had {:.1} % of the energy of the session's earlier ones, less than {:.1} %; let it recharge or cool, and shoot the pair again. All pairs of a session need one flash power: to change it, begin another session.",
        100.0 * share,
        100.0 * limits.least_energy
    );
    reason(ReasonCode::Weak, share, limits.least_energy, sentence)
}

/// Flash adds light; a block that is darker in the lit frame tells that the room's light fell. A rise
/// cannot be told from flash.
pub(super) fn ambient_changed(survey: &Survey, limits: &Limits) -> Option<Reason> {
    let darkened = survey::share(&survey.blocks, |b| {
        b.rise < -limits.noise_sigmas * b.error && b.rise < -limits.ambient_fall * b.ambient
    });
    if darkened <= limits.darkened_share {
        return None;
    }
    let sentence = format!(
        "{:.2} % of the frame is darker with flash than without, more than {:.2} %, so the room's light fell between the frames; keep windows covered and lamps steady, and shoot the pair again.",
        100.0 * darkened,
        100.0 * limits.darkened_share
    );
    reason(ReasonCode::AmbientChanged, darkened, limits.darkened_share, sentence)
}
