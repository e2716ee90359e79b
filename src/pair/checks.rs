//! What is wrong with a pair, each time with a figure, the limit it broke and a sentence.
//!
//! Takes the two frames as the sensor gave them, their settings and what was expected of them; gives the
//! reasons to reject the pair, none if it is good, and the signature of its stop for later ones. Pure: the same
//! code judges a pair just shot and one that came in as files. Files that could not be decoded never get here;
//! their error is their reason.

use super::limits::Limits;
use super::plan::Plan;
use super::stop::{EarlierStops, Stop};
use super::{Reason, ReasonCode, Settings, agreement, light, motion, survey};
use crate::photometry::Mosaic;
use crate::photometry::apex::{ExposureScale, Nominal};
use crate::photometry::inspect::Region;
use std::collections::BTreeMap;

/// One frame as the checks see it.
#[derive(Clone, Copy, Debug)]
pub struct FrameView<'a> {
    /// Sensor values.
    pub mosaic: &'a Mosaic,
    /// Settings out of the file.
    pub settings: &'a Settings,
}

/// What is known beforehand of how the pair should be; by default nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Expected<'a> {
    /// The exposures that were asked for.
    pub plan: Option<&'a Plan>,
    /// How light goes with the settings of this body; by what labels stand for without it.
    pub scale: Option<&'a dyn ExposureScale>,
    /// Where the object is; without it, everywhere.
    pub region: Option<Region>,
    /// Signatures of earlier accepted pairs, from any stops.
    pub earlier: Option<&'a dyn EarlierStops>,
    /// What the flash controller measured of this pulse and of earlier ones.
    pub energy: Option<EnergyExpectation>,
    /// What these two files must not be.
    pub files: Option<Files<'a>>,
}

/// Energy of a pulse against those before it, in the controller's own counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergyExpectation {
    /// Of this pair's pulse.
    pub counts: f64,
    /// Median of the session's earlier accepted pairs.
    pub usual: f64,
}

/// One of a pair's two frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Without flash.
    Unlit,
    /// With flash.
    Lit,
}

/// Files by their BLAKE3 (hexadecimal), to tell a frame that was delivered twice.
#[derive(Clone, Copy, Debug)]
pub struct Files<'a> {
    /// The unlit frame's.
    pub off: &'a str,
    /// The lit frame's.
    pub on: &'a str,
    /// Frames of the session's pairs: what each was, and in which pair.
    pub earlier: &'a BTreeMap<String, (Role, u32)>,
    /// Those of further unlit frames.
    pub more: &'a [String],
    /// Whether several pairs may share one unlit frame: photographers who shoot to a card may do so, a camera
    /// that just released may not.
    pub may_share_unlit: bool,
}

/// What the checks found.
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement {
    /// Why the pair must not be used; none if it is good.
    pub reasons: Vec<Reason>,
    /// The stop's signature, to be kept if the pair is accepted; absent where the frames do not match or are too
    /// dark to know a stop by.
    pub stop: Option<Stop>,
}

/// Judges a pair from itself alone.
pub fn judge(off: FrameView, on: FrameView, limits: &Limits) -> Vec<Reason> {
    judge_expecting(off, on, &Expected::default(), limits).reasons
}

/// Judges a pair from itself and from what was expected of it.
pub fn judge_expecting(off: FrameView, on: FrameView, expected: &Expected, limits: &Limits) -> Judgement {
    if let Some(repeated) = expected.files.and_then(repeated) {
        // It is no frame of this pair, so that nothing else about it is worth telling.
        return Judgement { reasons: vec![repeated], stop: None };
    }
    let mut reasons =
        agreement::differences(off.settings, on.settings, expected.plan, ["unlit", "lit"], limits);
    if let Some(reason) = changed_size(off.mosaic, on.mosaic, "lit") {
        reasons.push(reason);
        return Judgement { reasons, stop: None };
    }
    let same_settings = reasons.is_empty();
    let whole = whole_frame(on.mosaic);
    let outside = expected.region.and_then(|region| region_outside(region, whole));
    let region = if outside.is_some() { None } else { expected.region };
    reasons.extend(outside);

    let by = expected.scale.unwrap_or(&Nominal);
    let scale = agreement::room_ratio(expected.plan, by) as f32;
    let survey = survey::survey(off.mosaic, on.mosaic, scale, region.unwrap_or(whole));
    reasons.extend(light::overexposed(&survey, limits, region.is_some()));
    if let Some(reason) = light::misfire(&survey, limits, region.is_some()) {
        reasons.push(reason);
        return Judgement { reasons, stop: None };
    }
    let weak = light::weak(&survey, on.mosaic, limits);
    let [off_cells, on_cells] = &survey.cells;
    let moved = moved(motion::shift(off_cells, on_cells), "lit", limits);
    // Shifted edges darken too, and so does a shorter exposure: then nothing is known of the room's light.
    let ambient =
        if moved.is_none() && same_settings { light::ambient_changed(&survey, limits) } else { None };
    let black = [off, on].map(|f| f.mosaic.levels.black.concat().into_iter().sum::<f32>() / 4.0);
    let gain = agreement::flash_gain(on.settings, expected.plan, by);
    let stop = Stop::new(&survey.cells, black, scale, gain);
    // What moved, or was lit by another room, shows no flash light to compare.
    let comparable = same_settings && weak.is_none() && moved.is_none() && ambient.is_none();
    let before = stop.as_ref().filter(|_| comparable);
    let before =
        before.zip(expected.earlier).and_then(|(stop, earlier)| stop.flash_against_earlier(earlier, limits));
    reasons.extend(weak);
    reasons.extend(before.and_then(|share| light::weaker_than_before(share, limits)));
    reasons.extend(expected.energy.and_then(|e| light::weak_pulse(e.counts / e.usual, limits)));
    reasons.extend(moved);
    reasons.extend(ambient);
    Judgement { reasons, stop }
}

/// A file that is the other frame, or a frame of an earlier pair.
fn repeated(files: Files) -> Option<Reason> {
    let earlier = |digest: &str| files.earlier.get(digest).copied();
    let words = |role| match role {
        Role::Unlit => "unlit",
        Role::Lit => "lit",
    };
    let told = |frame: Role, (role, pair): (Role, u32)| {
        format!("The {} frame is bit for bit the {} frame of pair {pair}", words(frame), words(role))
    };
    let own: Vec<&str> =
        [files.off, files.on].into_iter().chain(files.more.iter().map(String::as_str)).collect();
    let further = |i: usize, digest: &String| own[..i + 2].contains(&digest.as_str());
    let what = if files.off == files.on {
        "The lit frame is bit for bit the unlit frame".to_owned()
    } else if files.more.iter().enumerate().any(|(i, digest)| further(i, digest)) {
        "Two of the pair's frames are bit for bit the same".to_owned()
    } else if let Some(found) = files.more.iter().find_map(|digest| earlier(digest)) {
        told(Role::Unlit, found)
    } else if let Some(found) = earlier(files.on) {
        told(Role::Lit, found)
    } else {
        let allowed = |role| files.may_share_unlit && role == Role::Unlit;
        told(Role::Unlit, earlier(files.off).filter(|(role, _)| !allowed(*role))?)
    };
    let sentence = format!(
        "{what}: the camera delivered the same frame twice; empty its buffer and shoot the pair again."
    );
    Some(Reason { code: ReasonCode::Repeated, figure: 1.0, limit: 0.0, sentence })
}

/// `name` is what the frame `on` is called.
pub(super) fn changed_size(off: &Mosaic, on: &Mosaic, name: &str) -> Option<Reason> {
    let size = |m: &Mosaic| (m.dn.width(), m.dn.height());
    if size(off) == size(on) && off.cfa == on.cfa {
        return None;
    }
    let ((ow, oh), (w, h)) = (size(off), size(on));
    let sentence = format!(
        "The {name} frame has {w} x {h} sites with the filter array {:?}, the unlit one {ow} x {oh} with {:?}; shoot both with one camera in one raw size.",
        on.cfa.0, off.cfa.0
    );
    let (figure, limit) = ((w * h) as f64, (ow * oh) as f64);
    Some(Reason { code: ReasonCode::SettingsChanged, figure, limit, sentence })
}

pub(super) fn whole_frame(mosaic: &Mosaic) -> Region {
    Region { x: 0, y: 0, width: mosaic.dn.width(), height: mosaic.dn.height() }
}

/// A region drawn on frames of another size says that the size was changed since.
fn region_outside(region: Region, whole: Region) -> Option<Reason> {
    let fits = |from: usize, size: usize, whole: usize| {
        size > 0 && from.checked_add(size).is_some_and(|end| end <= whole)
    };
    if fits(region.x, region.width, whole.width) && fits(region.y, region.height, whole.height) {
        return None;
    }
    let Region { x, y, width, height } = region;
    let sentence = format!(
        "The region {x},{y},{width},{height} is not inside the frame of {} x {} sites; set the camera back to the raw size it was drawn on, or draw it anew.",
        whole.width, whole.height
    );
    let (figure, limit) = (whole.width as f64, x.saturating_add(width) as f64);
    Some(Reason { code: ReasonCode::SettingsChanged, figure, limit, sentence })
}

/// `name` is what the frame is called that is displaced.
pub(super) fn moved(shift: Option<(f64, f64)>, name: &str, limits: &Limits) -> Option<Reason> {
    let (x, y) = shift?;
    let distance = x.hypot(y);
    (distance > limits.shift_sites).then(|| {
        let sentence = format!(
            "The {name} frame is displaced by {distance:.2} pixels ({x:+.2} right, {y:+.2} down), more than {:.2}; use a stand and a remote release, and shoot the pair again.",
            limits.shift_sites
        );
        Reason { code: ReasonCode::Moved, figure: distance, limit: limits.shift_sites, sentence }
    })
}

#[cfg(test)]
pub(super) mod tests;
