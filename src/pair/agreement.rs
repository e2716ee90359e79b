//! Whether the settings in the files are those of the plan, and the same in both frames.
//!
//! Without a plan the two frames are held against each other in everything they tell. With one, shutter,
//! aperture and ISO are held against each frame's own planned exposure, everything else against the partner.

use super::plan::{Exposure, Plan};
use super::{Limits, Reason, ReasonCode, Settings};
use crate::photometry::apex::{ExposureScale, Nominal};
use serde_json::{Map, Value};

/// Settings that may differ between the frames: part of the plan, or no setting at all.
const EXPOSURE: [&str; 3] = ["shutter", "aperture", "iso"];
const NO_SETTING: [&str; 2] = ["make", "taken_at"];
const ADVICE: &str = "lock the exposure (mode M, fixed ISO and white balance) and shoot the pair again";

/// All differences between what the files tell and what should be; `names` are what the two frames are called.
pub(super) fn differences(
    off: &Settings,
    on: &Settings,
    plan: Option<&Plan>,
    names: [&str; 2],
    limits: &Limits,
) -> Vec<Reason> {
    let mut reasons = vec![];
    match plan {
        Some(plan) => {
            reasons.extend(against_plan(off, &plan.off, names[0], limits));
            reasons.extend(against_plan(on, &plan.on, names[1], limits));
        }
        None => reasons.extend(against_partner(off, on, names, limits, |name| EXPOSURE.contains(&name))),
    }
    let other = |name: &str| !EXPOSURE.contains(&name) && !NO_SETTING.contains(&name);
    reasons.extend(against_partner(off, on, names, limits, other));
    reasons
}

/// S_on / S_off of a plan, by this scale. Without a plan the exposures should be equal: frames that differ are rejected
/// for that, and their light is compared as it is.
pub(super) fn room_ratio(plan: Option<&Plan>, scale: &dyn ExposureScale) -> f64 {
    let room = |e: &Exposure| scale.room(e.shutter, e.aperture, e.iso);
    plan.filter(|plan| plan.off != plan.on).map_or(1.0, |plan| room(&plan.on) / room(&plan.off))
}

/// ISO / N^2 of the lit frame by this scale, by which its flash light is scaled.
pub(super) fn flash_gain(on: &Settings, plan: Option<&Plan>, scale: &dyn ExposureScale) -> Option<f64> {
    match (on.aperture, on.iso, plan) {
        (Some(aperture), Some(iso), _) => Some(scale.flash(aperture, iso)),
        (_, _, plan) => plan.map(|p| scale.flash(p.on.aperture, p.on.iso)),
    }
}

fn against_plan(found: &Settings, planned: &Exposure, frame: &str, limits: &Limits) -> Vec<Reason> {
    let (shutter, aperture, iso) = (planned.shutter, planned.aperture, planned.iso);
    let told = [
        found.shutter.map(|v| ("shutter time", v.to_string(), v.0, Nominal.time(v))),
        found.aperture.map(|v| ("aperture", v.to_string(), v.0, Nominal.aperture(v))),
        found.iso.map(|v| ("ISO", v.to_string(), v.0, Nominal.gain(v))),
    ];
    let asked = [
        (shutter.to_string(), shutter.0, Nominal.time(shutter)),
        (aperture.to_string(), aperture.0, Nominal.aperture(aperture)),
        (iso.to_string(), iso.0, Nominal.gain(iso)),
    ];
    let mut reasons = vec![];
    for (told, (planned_words, planned, planned_light)) in told.into_iter().zip(asked) {
        let Some((name, words, value, light)) = told else { continue };
        let same = |a: f64, b: f64| (a / b - 1.0).abs() <= limits.setting_tolerance;
        // Some bodies write the label, others what it stands for.
        if same(value, planned) || same(light, planned_light) {
            continue;
        }
        let sentence =
            format!("The {name} is {words} in the {frame} frame but {planned_words} in the plan; {ADVICE}.");
        reasons.push(Reason { code: ReasonCode::SettingsChanged, figure: value, limit: planned, sentence });
    }
    // Lenses without contacts tell no aperture; shutter and ISO every camera writes.
    for (name, untold) in [("shutter time", found.shutter.is_none()), ("ISO", found.iso.is_none())] {
        if untold {
            let sentence = format!(
                "The {frame} frame does not tell its {name}, so nothing proves that it kept to the plan; shoot raw files as the camera writes them."
            );
            reasons.push(Reason { code: ReasonCode::SettingsChanged, figure: 0.0, limit: 1.0, sentence });
        }
    }
    reasons
}

/// Compares whatever both frames tell under the wanted names, so that a setting newly read out of the files is
/// compared without anybody's doing.
fn against_partner(
    off: &Settings,
    on: &Settings,
    [off_name, on_name]: [&str; 2],
    limits: &Limits,
    wanted: impl Fn(&str) -> bool,
) -> Vec<Reason> {
    let (off, on) = (entries(off), entries(on));
    let mut reasons = vec![];
    for (key, unlit) in off.iter().filter(|(key, _)| wanted(key)) {
        let Some(lit) = on.get(key) else { continue };
        let (figure, limit) = match (unlit.as_f64(), lit.as_f64()) {
            (Some(unlit), Some(lit)) if (lit / unlit - 1.0).abs() <= limits.setting_tolerance => continue,
            (Some(unlit), Some(lit)) => (lit, unlit),
            _ if unlit == lit => continue,
            _ => (1.0, 0.0),
        };
        let name = name(key);
        let sentence = format!(
            "The {name} is {lit} in the {on_name} frame but {unlit} in the {off_name} frame; {ADVICE}."
        );
        reasons.push(Reason { code: ReasonCode::SettingsChanged, figure, limit, sentence });
    }
    reasons
}

/// Everything that a frame tells, by its name in `pair.json`.
fn entries(settings: &Settings) -> Map<String, Value> {
    match serde_json::to_value(settings) {
        Ok(Value::Object(entries)) => entries,
        // A plain struct of numbers and words becomes an object, always.
        _ => Map::new(),
    }
}

fn name(key: &str) -> String {
    match key {
        "shutter" => "shutter time".to_owned(),
        "iso" => "ISO".to_owned(),
        "model" => "camera model".to_owned(),
        "serial" => "camera serial number".to_owned(),
        "focal_length_mm" => "focal length in mm".to_owned(),
        other => other.replace('_', " "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{FNumber, Iso, Seconds};

    const NAMES: [&str; 2] = ["unlit", "lit"];
    const FAST: Exposure =
        Exposure { shutter: Seconds(1.0 / 125.0), aperture: FNumber(11.0), iso: Iso(100.0) };
    const SLOW: Exposure = Exposure { shutter: Seconds(1.0 / 60.0), ..FAST };

    fn told(exposure: Exposure) -> Settings {
        Settings {
            shutter: Some(exposure.shutter),
            aperture: Some(exposure.aperture),
            iso: Some(exposure.iso),
            white_balance: Some("Manual".into()),
            ..Settings::default()
        }
    }

    #[test]
    fn frames_are_held_against_each_other_without_a_plan() {
        let limits = Limits::default();
        assert_eq!(differences(&told(FAST), &told(FAST), None, NAMES, &limits), []);
        let reasons = differences(&told(SLOW), &told(FAST), None, NAMES, &limits);
        assert_eq!((reasons.len(), reasons[0].figure, reasons[0].limit), (1, 1.0 / 125.0, 1.0 / 60.0));
        assert!(reasons[0].sentence.contains("shutter time"), "{}", reasons[0].sentence);
    }

    #[test]
    fn each_frame_is_held_against_its_own_planned_exposure() {
        let limits = Limits::default();
        let plan = Plan { off: SLOW, on: FAST };
        assert_eq!(differences(&told(SLOW), &told(FAST), Some(&plan), NAMES, &limits), []);
        let reasons = differences(&told(FAST), &told(FAST), Some(&plan), NAMES, &limits);
        assert_eq!(reasons.len(), 1);
        assert!(reasons[0].sentence.contains("1/125 s in the unlit frame but 1/60 s in the plan"));
        assert_eq!(differences(&told(SLOW), &told(SLOW), Some(&plan), NAMES, &limits).len(), 1);
        assert!((room_ratio(Some(&plan), &Nominal) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn a_body_that_writes_true_values_keeps_to_the_plan() {
        let true_values =
            Exposure { shutter: Seconds(1.0 / 64.0), aperture: FNumber(11.3137), iso: Iso(100.0) };
        let plan = Plan { off: SLOW, on: SLOW };
        assert_eq!(
            differences(&told(true_values), &told(true_values), Some(&plan), NAMES, &Limits::default()),
            []
        );
    }

    #[test]
    fn everything_but_the_exposure_is_compared_between_the_frames_even_with_a_plan() {
        let plan = Plan { off: SLOW, on: FAST };
        let auto =
            Settings { white_balance: Some("Auto".into()), taken_at: Some("now".into()), ..told(FAST) };
        let reasons = differences(&told(SLOW), &auto, Some(&plan), NAMES, &Limits::default());
        assert_eq!(reasons.len(), 1);
        assert!(reasons[0].sentence.starts_with("The white balance is \"Auto\""), "{}", reasons[0].sentence);
        let untold = Settings::default();
        assert_eq!(differences(&untold, &auto, None, NAMES, &Limits::default()), []);
        let reasons = differences(&untold, &told(FAST), Some(&plan), NAMES, &Limits::default());
        assert_eq!(reasons.len(), 2);
        assert!(reasons[0].sentence.contains("does not tell its shutter time"), "{}", reasons[0].sentence);
    }
}
