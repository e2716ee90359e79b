//! Proof of light by event: what the flash controller saw of each frame must be exactly what was asked.
//!
//! A dark frame is proven dark by one sync that found the gate closed and saw no light; a lit one by exactly one
//! sync that was let through under the pair's own tag and saw a pulse. The checks on the images ([`super::judge`])
//! are the other half of the proof, and all there is where no controller counts.

use super::{FlashSync, Reason, ReasonCode};

/// What the controller's account of the unlit frame holds against it.
pub fn dark_frame(syncs: &[FlashSync]) -> Option<Reason> {
    let triggered = syncs.iter().filter(|sync| sync.triggered).count();
    let lit = syncs.iter().filter(|sync| sync.light().is_some()).count();
    let (code, figure, limit, sentence) = if triggered > 0 {
        (
            ReasonCode::NotDark,
            triggered as f64,
            0.0,
            "The flash was triggered during the frame without flash; check that nothing else controls the flash \
             controller, and take the pair again.",
        )
    } else if lit > 0 {
        (
            ReasonCode::NotDark,
            lit as f64,
            0.0,
            "A pulse of light was measured during the frame without flash although the controller held its flash back; \
             switch off what else may fire (built-in flash, radio trigger, optical slave), shield the photodiode from \
             flickering lamps, and take the pair again.",
        )
    } else if syncs.is_empty() {
        (
            ReasonCode::Misfire,
            0.0,
            1.0,
            "The camera's sync contact never closed during the frame without flash, so that nothing proves it dark; \
             check the sync cable and that the camera uses its mechanical shutter.",
        )
    } else {
        return None;
    };
    Some(Reason { code, figure, limit, sentence: sentence.into() })
}

/// What the controller's account of the lit frame holds against it. `sees_light`: its photodiode has seen pulses of
/// this flash before, so that one without light is no pulse.
pub fn lit_frame(syncs: &[FlashSync], tag: u32, sees_light: bool) -> Option<Reason> {
    let misfire = |pulses: usize, sentence: String| {
        Some(Reason { code: ReasonCode::Misfire, figure: pulses as f64, limit: 1.0, sentence })
    };
    let triggered: Vec<&FlashSync> = syncs.iter().filter(|sync| sync.triggered).collect();
    let pulse = match triggered[..] {
        [pulse] => pulse,
        [] if syncs.is_empty() => {
            return misfire(
                0,
                "The camera's sync contact never closed, so the flash stayed dark; check the sync cable and that \
                 the camera uses its mechanical shutter."
                    .into(),
            );
        }
        [] => {
            return misfire(
                0,
                "The flash controller did not let the flash fire in the frame with flash; take the pair again."
                    .into(),
            );
        }
        _ => {
            let times = triggered.len();
            return misfire(
                times,
                format!(
                    "The flash fired {times} times during the frame with flash; switch off pre-flash and \
                     multi-flash modes."
                ),
            );
        }
    };
    if pulse.tag != tag {
        return misfire(
            0,
            format!(
                "The pulse that was counted belongs to another frame (tag {} instead of {tag}); take the pair again.",
                pulse.tag
            ),
        );
    }
    let stray = syncs.iter().filter(|sync| !sync.triggered && sync.light().is_some()).count();
    if stray > 0 {
        return misfire(
            1 + stray,
            "More than one pulse of light was measured during the frame with flash; switch off pre-flash and \
             multi-flash modes, and what else may fire."
                .into(),
        );
    }
    if pulse.light().is_none() && sees_light {
        return misfire(
            0,
            "The flash was triggered but the photodiode saw no pulse; check the flash's charge, switch and cable, and \
             that the photodiode still looks at the flash."
                .into(),
        );
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pair::SyncSource;

    fn sync(triggered: bool, tag: u32, lit: bool) -> FlashSync {
        FlashSync {
            number: 1,
            source: SyncSource::Contact,
            triggered,
            tag,
            at: None,
            energy_counts: if lit { 1000.0 } else { -3.0 },
            peak_counts: 0.0,
            dark_counts: 12.0,
            lit_samples: if lit { 200 } else { 0 },
            clipped_samples: 0,
            bounces: 0,
        }
    }

    fn code(reason: Option<Reason>) -> Option<ReasonCode> {
        reason.map(|r| r.code)
    }

    #[test]
    fn a_dark_frame_is_proven_by_one_dark_sync_that_found_the_gate_closed() {
        assert_eq!(dark_frame(&[sync(false, 0, false)]), None);
        assert_eq!(code(dark_frame(&[sync(true, 7, true)])), Some(ReasonCode::NotDark));
        assert_eq!(code(dark_frame(&[sync(true, 7, false)])), Some(ReasonCode::NotDark));
        assert_eq!(code(dark_frame(&[sync(false, 0, true)])), Some(ReasonCode::NotDark));
        assert_eq!(code(dark_frame(&[])), Some(ReasonCode::Misfire));
    }

    #[test]
    fn a_lit_frame_is_proven_by_one_pulse_under_its_own_tag() {
        let lit = |syncs: &[FlashSync]| code(lit_frame(syncs, 7, true));
        assert_eq!(lit(&[sync(true, 7, true)]), None);
        assert_eq!(lit(&[sync(false, 0, false), sync(true, 7, true)]), None);
        for wrong in [
            vec![],
            vec![sync(false, 0, false)],
            vec![sync(true, 7, true), sync(true, 7, true)],
            vec![sync(true, 6, true)],
            vec![sync(true, 7, true), sync(false, 0, true)],
            vec![sync(true, 7, false)],
        ] {
            assert_eq!(lit(&wrong), Some(ReasonCode::Misfire), "{wrong:?}");
        }
    }

    #[test]
    fn a_controller_without_a_photodiode_leaves_the_light_to_the_images() {
        assert_eq!(lit_frame(&[sync(true, 7, false)], 7, false), None);
    }
}
