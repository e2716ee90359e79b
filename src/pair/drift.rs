//! What two frames without flash tell of each other: how the room's light and the camera drifted between them.
//!
//! Where the flash is dark in both, everything can be compared: the room's light may be seen to rise as well as to
//! fall, colour by colour, and edges lie where they lay. Every further frame without flash is held against the pair's
//! first.

use super::checks::{FrameView, changed_size, moved, whole_frame};
use super::limits::Limits;
use super::order::Slot;
use super::plan::Plan;
use super::survey::{self, Survey};
use super::{Reason, ReasonCode, agreement, motion};
use crate::photometry::Mosaic;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Share of the range from black to saturation below which a colour's mean light tells nothing of its own change, and a
/// change in places is none: the black level itself is known no better.
const DARK: f64 = 0.001;

const COLOURS: [&str; 3] = ["red", "green", "blue"];

/// How the room and the camera drifted from one frame without flash to a later one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drift {
    /// The room's light later over its light before, by colour (R, G, B); `null` where the room is too dark to tell.
    pub ambient: [Option<f64>; 3],
    /// Displacement of the later frame in sites (right, down); absent where there is too little structure to tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shift: Option<[f64; 2]>,
}

/// Holds a further frame without flash, `slot`, against the pair's first: what is wrong with it, and how it drifted,
/// where the two can be compared at all. Both are to be shot at the plan's exposure for frames without flash.
pub fn compare_dark(
    first: FrameView,
    later: FrameView,
    slot: Slot,
    plan: Option<&Plan>,
    limits: &Limits,
) -> (Vec<Reason>, Option<Drift>) {
    let name = slot.to_string();
    let plan = plan.map(|plan| Plan { off: plan.off, on: plan.off });
    let names = ["unlit", name.as_str()];
    let mut reasons = agreement::differences(first.settings, later.settings, plan.as_ref(), names, limits);
    if let Some(reason) = changed_size(first.mosaic, later.mosaic, &name) {
        reasons.push(reason);
        return (reasons, None);
    }
    let same_settings = reasons.is_empty();
    let survey = survey::survey(first.mosaic, later.mosaic, 1.0, whole_frame(first.mosaic));
    let [before, after] = &survey.cells;
    let shift = motion::shift(before, after);
    let drift = Drift { ambient: ambient(first.mosaic, later.mosaic), shift: shift.map(|(x, y)| [x, y]) };
    let moved = moved(shift, &name, limits);
    // What moved is dark where it was bright, and another exposure is another light.
    if moved.is_none() && same_settings {
        let changed = level(&drift.ambient, &name, limits)
            .or_else(|| in_places(&survey, range(first.mosaic), &name, limits));
        reasons.extend(changed);
    }
    reasons.extend(moved);
    (reasons, Some(drift))
}

/// Ratio of the light in two frames of one size, by colour, over the sites that are clipped in neither.
fn ambient(before: &Mosaic, after: &Mosaic) -> [Option<f64>; 3] {
    let width = before.dn.width().max(1);
    let rows = before.dn.pixels().par_chunks_exact(width).zip(after.dn.pixels().par_chunks_exact(width));
    let row_sums = rows.enumerate().map(|(y, (a, b))| {
        let mut sums = [[0f64; 3]; 3];
        let (colours, of) = (before.cfa.0[y & 1], [before, after].map(|m| m.levels));
        let range =
            |frame: usize, x: usize| (of[frame].black[y & 1][x & 1], of[frame].saturation[y & 1][x & 1]);
        for (x, (&a, &b)) in a.iter().zip(b).enumerate() {
            let ((a_black, a_end), (b_black, b_end)) = (range(0, x), range(1, x));
            let (a, b) = (f32::from(a), f32::from(b));
            if a < a_end && b < b_end {
                let of_colour = &mut sums[usize::from(colours[x & 1])];
                let told = [a - a_black, b - b_black, a_end - a_black];
                for (sum, value) in of_colour.iter_mut().zip(told) {
                    *sum += f64::from(value);
                }
            }
        }
        sums
    });
    // Collected row by row and added in order: the same bits on any number of threads.
    let row_sums: Vec<[[f64; 3]; 3]> = row_sums.collect();
    [0, 1, 2].map(|c| {
        let [a, b, range] =
            row_sums.iter().fold([0.0; 3], |total, sums| std::array::from_fn(|i| total[i] + sums[c][i]));
        (a > DARK * range && range > 0.0).then(|| b / a)
    })
}

/// Mean range from black to saturation, DN.
fn range(mosaic: &Mosaic) -> f64 {
    let mean = |level: [[f32; 2]; 2]| level.concat().into_iter().map(f64::from).sum::<f64>() / 4.0;
    mean(mosaic.levels.saturation) - mean(mosaic.levels.black)
}

/// The level of the room's light: the colour that changed most.
fn level(ambient: &[Option<f64>; 3], name: &str, limits: &Limits) -> Option<Reason> {
    let told = ambient.iter().zip(COLOURS).filter_map(|(ratio, colour)| Some(((*ratio)?, colour)));
    let (ratio, colour) = told.max_by(|a, b| (a.0 - 1.0).abs().total_cmp(&(b.0 - 1.0).abs()))?;
    let off = (ratio - 1.0).abs();
    (off > limits.ambient_drift).then(|| {
        let sentence = format!(
            "The room's {colour} light stood at {:.1} % in the {name} frame of what it was in the first frame without flash, off by more than {:.1} %; keep windows covered and lamps steady, and shoot the pair again.",
            100.0 * ratio,
            100.0 * limits.ambient_drift
        );
        Reason { code: ReasonCode::AmbientChanged, figure: off, limit: limits.ambient_drift, sentence }
    })
}

/// Light that changed in places while its level stayed: a shadow, a lamp that was turned.
fn in_places(survey: &Survey, range: f64, name: &str, limits: &Limits) -> Option<Reason> {
    let changed = survey::share(&survey.blocks, |b| {
        let least = (limits.noise_sigmas * b.error).max(limits.ambient_drift * b.ambient).max(DARK * range);
        b.rise.abs() > least
    });
    (changed > limits.darkened_share).then(|| {
        let sentence = format!(
            "The room lights {:.2} % of the frame otherwise in the {name} frame than in the first one without flash, more than {:.2} %; let nobody's shadow fall into the picture and keep lamps steady, and shoot the pair again.",
            100.0 * changed,
            100.0 * limits.darkened_share
        );
        Reason { code: ReasonCode::AmbientChanged, figure: changed, limit: limits.darkened_share, sentence }
    })
}

#[cfg(test)]
mod tests {
    use super::super::checks::tests::{frame, room};
    use super::super::order::Part;
    use super::*;
    use crate::pair::{Exposure, Settings};
    use crate::raster::Image;
    use crate::units::{FNumber, Iso, Seconds};

    const AFTER: Slot = Slot { part: Part::After, index: 1 };

    fn compared(later: &Mosaic) -> (Vec<Reason>, Option<Drift>) {
        let (first, settings) = (frame(1, room), Settings::default());
        let view = |mosaic| FrameView { mosaic, settings: &settings };
        compare_dark(view(&first), view(later), AFTER, None, &Limits::default())
    }

    fn codes(later: &Mosaic) -> Vec<ReasonCode> {
        compared(later).0.into_iter().map(|r| r.code).collect()
    }

    #[test]
    fn a_steady_room_and_a_steady_stand_drift_by_nothing() {
        let (reasons, drift) = compared(&frame(2, room));
        assert_eq!(reasons, []);
        let drift = drift.unwrap();
        assert!(drift.ambient.iter().all(|r| (r.unwrap() - 1.0).abs() < 1e-3), "{drift:?}");
        assert!(drift.shift.unwrap().iter().all(|s| s.abs() < 0.1), "{drift:?}");
    }

    #[test]
    fn light_that_rises_is_told_as_well_as_light_that_falls() {
        for (factor, wanted) in [
            (1.03, vec![]),
            (0.97, vec![]),
            (1.06, vec![ReasonCode::AmbientChanged]),
            (0.94, vec![ReasonCode::AmbientChanged]),
        ] {
            let later = frame(2, |x, y| factor * room(x, y));
            assert_eq!(codes(&later), wanted, "{factor}");
            let drift = compared(&later).1.unwrap();
            assert!(drift.ambient.iter().all(|r| (r.unwrap() - factor).abs() < 1e-3), "{drift:?}");
        }
    }

    #[test]
    fn one_colour_alone_is_enough() {
        let mut later = frame(2, room);
        let cfa = later.cfa;
        later.dn = Image::from_fn(320, 256, |x, y| {
            let above = f32::from(*later.dn.at(x, y)) - 2048.0;
            (2048.0 + if cfa.colour(x, y) == 2 { 1.08 * above } else { above }).round() as u16
        });
        let reasons = compared(&later).0;
        assert_eq!(reasons.len(), 1);
        assert!(reasons[0].sentence.contains("blue light stood at 108.0 %"), "{reasons:?}");
    }

    #[test]
    fn a_shadow_in_a_corner_is_told_although_the_level_stays() {
        let later = frame(2, |x, y| if x < 60.0 && y < 60.0 { 0.8 * room(x, y) } else { room(x, y) });
        let (reasons, drift) = compared(&later);
        assert!(drift.unwrap().ambient.iter().all(|r| (r.unwrap() - 1.0).abs() < 0.04));
        assert_eq!(reasons[0].code, ReasonCode::AmbientChanged);
        assert!(reasons[0].sentence.contains("shadow") && reasons[0].sentence.contains("after frame"));
    }

    #[test]
    fn a_tripod_that_sank_has_moved_and_by_how_much_is_told() {
        let later = frame(2, |x, y| room(x, y - 1.5));
        let (reasons, drift) = compared(&later);
        assert_eq!(reasons.iter().map(|r| r.code).collect::<Vec<_>>(), [ReasonCode::Moved]);
        assert!(reasons[0].sentence.starts_with("The after frame is displaced by 1."), "{reasons:?}");
        let [x, y] = drift.unwrap().shift.unwrap();
        assert!(x.abs() < 0.2 && (y - 1.5).abs() < 0.2, "{x} {y}");
    }

    #[test]
    fn in_the_dark_nothing_is_said_of_the_room() {
        let settings = Settings::default();
        let (first, later) = (frame(1, |_, _| 6.0), frame(2, |_, _| 9.0));
        let view = |mosaic| FrameView { mosaic, settings: &settings };
        let (reasons, drift) = compare_dark(view(&first), view(&later), AFTER, None, &Limits::default());
        assert_eq!((reasons, drift.unwrap().ambient), (vec![], [None; 3]));
    }

    #[test]
    fn another_exposure_or_size_is_a_changed_setting() {
        let told =
            |t: f64| Settings { shutter: Some(Seconds(t)), iso: Some(Iso(100.0)), ..Settings::default() };
        let exposure = Exposure { shutter: Seconds(0.01), aperture: FNumber(8.0), iso: Iso(100.0) };
        // The lit frame's own exposure is nothing to a frame without flash.
        let plan = Plan { off: exposure, on: Exposure { shutter: Seconds(0.1), ..exposure } };
        let (first, later) = (frame(1, room), frame(2, |x, y| 2.0 * room(x, y)));
        let reasons = |t: f64, later: &Mosaic| {
            let (a, b) = (told(0.01), told(t));
            let first = FrameView { mosaic: &first, settings: &a };
            let later = FrameView { mosaic: later, settings: &b };
            compare_dark(first, later, AFTER, Some(&plan), &Limits::default()).0
        };
        assert_eq!(reasons(0.01, &frame(3, room)), []);
        let found = reasons(0.02, &later);
        assert_eq!(found.iter().map(|r| r.code).collect::<Vec<_>>(), [ReasonCode::SettingsChanged]);
        assert!(found[0].sentence.contains("in the after frame"), "{found:?}");
        let small = Mosaic { dn: Image::filled(64, 64, 3000), ..frame(1, room) };
        assert!(reasons(0.01, &small)[0].sentence.contains("The after frame has 64 x 64 sites"));
    }
}
