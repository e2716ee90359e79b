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

    let scale = agreement::room_ratio(expected.plan) as f32;
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
    let gain = agreement::flash_gain(on.settings, expected.plan);
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
pub(super) mod tests {
    use super::*;
    use crate::pair::Exposure;
    use crate::photometry::{Cfa, LevelSource, Levels};
    use crate::raster::Image;
    use crate::units::{FNumber, Iso, Seconds};
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    /// A frame of `light(x, y)` electrons at 3 electrons a DN with shot noise and 5 electrons of read noise.
    pub(in crate::pair) fn frame(seed: u64, light: impl Fn(f64, f64) -> f64) -> Mosaic {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let dn = Image::from_fn(320, 256, |x, y| {
            let signal = light(x as f64, y as f64);
            let noisy = Normal::new(signal, (signal + 25.0).sqrt()).unwrap().sample(&mut random);
            (2048.0 + noisy / 3.0).round().clamp(0.0, 15380.0) as u16
        });
        let levels = Levels {
            black: [[2048.0; 2]; 2],
            saturation: [[15380.0; 2]; 2],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        };
        Mosaic { dn, cfa: Cfa::RGGB, levels }
    }

    pub(in crate::pair) fn room(x: f64, y: f64) -> f64 {
        let waves = (x / 9.0).sin() * (y / 7.0).cos() + (x * y / 900.0).sin() + ((x + 2.0 * y) / 23.0).sin();
        3200.0 + 1000.0 * waves
    }

    fn shift(off: &Mosaic, on: &Mosaic) -> Option<(f64, f64)> {
        let [off, on] = survey::survey(off, on, 1.0, whole_frame(off)).cells;
        motion::shift(&off, &on)
    }

    fn codes(off: &Mosaic, on: &Mosaic) -> Vec<ReasonCode> {
        let settings = Settings::default();
        let view = |mosaic| FrameView { mosaic, settings: &settings };
        judge(view(off), view(on), &Limits::default()).into_iter().map(|r| r.code).collect()
    }

    #[test]
    fn a_lit_frame_that_is_brighter_everywhere_is_accepted() {
        assert_eq!(codes(&frame(1, room), &frame(2, |x, y| 2.0 * room(x, y))), []);
    }

    #[test]
    fn equal_light_is_a_misfire_even_when_the_lamps_flicker() {
        assert_eq!(codes(&frame(1, room), &frame(2, room)), [ReasonCode::Misfire]);
        assert_eq!(codes(&frame(1, room), &frame(2, |x, y| 1.05 * room(x, y))), [ReasonCode::Misfire]);
    }

    #[test]
    fn a_dim_flash_in_a_dark_room_is_weak() {
        assert_eq!(codes(&frame(1, |_, _| 30.0), &frame(2, |_, _| 330.0)), [ReasonCode::Weak]);
    }

    #[test]
    fn a_flash_that_gives_less_than_before_or_less_energy_is_weak() {
        let (off, on) = (frame(1, room), frame(2, |x, y| 2.0 * room(x, y)));
        let (earlier_off, earlier_on) = (frame(3, room), frame(4, |x, y| 2.3 * room(x, y)));
        let settings = Settings::default();
        let view = |mosaic| FrameView { mosaic, settings: &settings };
        let judged =
            |off, on, expected: &Expected| judge_expecting(view(off), view(on), expected, &Limits::default());
        let before = judged(&earlier_off, &earlier_on, &Expected::default());
        assert_eq!(before.reasons, []);
        let earlier = vec![before.stop.unwrap()];
        let reasons = judged(&off, &on, &Expected { earlier: Some(&earlier), ..Expected::default() }).reasons;
        assert_eq!(reasons.len(), 1);
        assert_eq!(reasons[0].code, ReasonCode::Weak);
        assert!((reasons[0].figure - 1.0 / 1.3).abs() < 0.01, "{reasons:?}");

        for (counts, expected) in [(950.0, vec![]), (890.0, vec![ReasonCode::Weak])] {
            let energy = Some(EnergyExpectation { counts, usual: 1000.0 });
            let reasons = judged(&off, &on, &Expected { energy, ..Expected::default() }).reasons;
            assert_eq!(reasons.iter().map(|r| r.code).collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn a_frame_that_was_there_before_is_called_repeated_and_nothing_else() {
        let (off, on) = (frame(1, room), frame(2, |x, y| 2.0 * room(x, y)));
        let settings = Settings::default();
        let view = |mosaic| FrameView { mosaic, settings: &settings };
        let earlier = BTreeMap::from([("u".to_owned(), (Role::Unlit, 7)), ("l".to_owned(), (Role::Lit, 7))]);
        let judged_with = |off_digest, on_digest, may_share_unlit, more: &[&str]| {
            let more: Vec<String> = more.iter().map(|d| (*d).to_owned()).collect();
            let files = Some(Files {
                off: off_digest,
                on: on_digest,
                more: &more,
                earlier: &earlier,
                may_share_unlit,
            });
            let expected = Expected { files, ..Expected::default() };
            let reasons = judge_expecting(view(&off), view(&on), &expected, &Limits::default()).reasons;
            reasons.into_iter().map(|r| (r.code, r.sentence)).next()
        };
        let judged = |off, on, may_share| judged_with(off, on, may_share, &[]);
        assert_eq!(judged("a", "b", false), None);
        assert_eq!(judged_with("a", "b", false, &["c", "d"]), None);
        for more in [["c", "c"], ["c", "b"], ["a", "c"]] {
            let (code, sentence) = judged_with("a", "b", true, &more).unwrap();
            assert!(
                code == ReasonCode::Repeated && sentence.contains("Two of the pair's frames"),
                "{sentence}"
            );
        }
        assert!(judged_with("a", "b", false, &["c", "l"]).unwrap().1.contains("lit frame of pair 7"));
        assert_eq!(judged("u", "b", true), None);
        for (off, on, shared, words) in [
            ("a", "a", true, "the unlit frame:"),
            ("a", "l", true, "The lit frame is bit for bit the lit frame of pair 7"),
            ("l", "b", true, "The unlit frame is bit for bit the lit frame of pair 7"),
            ("u", "b", false, "The unlit frame is bit for bit the unlit frame of pair 7"),
        ] {
            let (code, sentence) = judged(off, on, shared).unwrap();
            assert_eq!(code, ReasonCode::Repeated);
            assert!(sentence.contains(words), "{sentence}");
        }
    }

    #[test]
    fn light_is_looked_for_and_clipping_is_judged_where_the_object_is() {
        let settings = Settings::default();
        let judged = |on: &Mosaic, region| {
            let off = frame(1, room);
            let view = |mosaic| FrameView { mosaic, settings: &settings };
            let expected = Expected { region, ..Expected::default() };
            judge_expecting(view(&off), view(on), &expected, &Limits::default()).reasons
        };
        let left = Some(Region { x: 0, y: 0, width: 160, height: 256 });
        // A blown lamp in the right half, and flash light everywhere.
        let lamp = |share: f64| {
            frame(2, move |x, y| if x > 160.0 + 160.0 * (1.0 - share) { 60_000.0 } else { 2.0 * room(x, y) })
        };
        assert_eq!(judged(&lamp(0.1), left), []);
        let reasons = judged(&lamp(0.1), None);
        assert_eq!(reasons[0].code, ReasonCode::Overexposed);
        let reasons = judged(&lamp(0.5), left);
        assert_eq!(reasons[0].code, ReasonCode::Overexposed);
        assert!(
            reasons[0].sentence.contains("of the lit frame outside the region are clipped"),
            "{reasons:?}"
        );
        // Flash on the wall beside the object is no flash on the object.
        let beside = frame(2, |x, y| if x > 200.0 { 2.0 * room(x, y) } else { room(x, y) });
        assert_eq!(judged(&beside, None), []);
        assert_eq!(judged(&beside, left)[0].code, ReasonCode::Misfire);
        let astray = Some(Region { x: 300, y: 0, width: 21, height: 10 });
        assert!(judged(&beside, astray)[0].sentence.contains("not inside the frame of 320 x 256"));
    }

    #[test]
    fn unequal_exposures_by_plan_are_compared_in_one_scale() {
        let exposure = |t: f64| Exposure { shutter: Seconds(t), aperture: FNumber(8.0), iso: Iso(100.0) };
        let told = |e: Exposure| Settings {
            shutter: Some(e.shutter),
            aperture: Some(e.aperture),
            iso: Some(e.iso),
            ..Settings::default()
        };
        // The unlit frame is exposed four times as long; 1/30 and 1/125 are 2^-5 and 2^-7 s.
        let plan = Plan { off: exposure(1.0 / 30.0), on: exposure(1.0 / 125.0) };
        let (off_told, on_told) = (told(plan.off), told(plan.on));
        let off = frame(1, |x, y| 4.0 * room(x, y));
        let judged = |on: &Mosaic, plan| {
            let off = FrameView { mosaic: &off, settings: &off_told };
            let on = FrameView { mosaic: on, settings: &on_told };
            let reasons =
                judge_expecting(off, on, &Expected { plan, ..Expected::default() }, &Limits::default())
                    .reasons;
            reasons.iter().map(|r| r.code).collect::<Vec<_>>()
        };
        let lit = frame(2, |x, y| 1.5 * room(x, y));
        assert_eq!(judged(&lit, Some(&plan)), []);
        assert_eq!(judged(&lit, None), [ReasonCode::SettingsChanged, ReasonCode::Misfire]);
        assert_eq!(judged(&frame(2, room), Some(&plan)), [ReasonCode::Misfire]);
        let fallen = frame(2, |x, y| if x < 60.0 && y < 60.0 { 0.93 * room(x, y) } else { 2.0 * room(x, y) });
        assert_eq!(judged(&fallen, Some(&plan)), [ReasonCode::AmbientChanged]);
    }

    #[test]
    fn light_beyond_saturation_is_overexposed() {
        let on = frame(2, |x, y| room(x, y) + if x < 40.0 { 60_000.0 } else { 3000.0 });
        assert_eq!(codes(&frame(1, room), &on), [ReasonCode::Overexposed]);
    }

    #[test]
    fn a_displaced_frame_is_moved_and_by_how_much_is_told() {
        for (dx, dy) in [(1.0, 0.0), (-3.0, 2.0), (5.0, 18.0)] {
            let on = frame(2, |x, y| 2.0 * room(x - dx, y - dy));
            let (x, y) = shift(&frame(1, room), &on).unwrap();
            assert!((x - dx).abs() < 0.2 && (y - dy).abs() < 0.2, "{x} {y} for {dx} {dy}");
            assert_eq!(codes(&frame(1, room), &on), [ReasonCode::Moved]);
        }
    }

    #[test]
    fn a_frame_wider_than_the_finest_level_tells_a_known_shift_in_sites() {
        let (width, height) = (5200, 1200);
        let wide = |dx: f32, dy: f32, seed: u32| {
            let mut state = seed;
            let dn = Image::from_fn(width, height, |x, y| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let (x, y) = (x as f32 - dx, y as f32 - dy);
                let waves = (x / 31.0).sin() * (y / 23.0).cos()
                    + (x / 57.0 + y / 41.0).sin()
                    + (x * y / 90_000.0).sin();
                (3200.0 + 250.0 * waves + (state >> 26) as f32) as u16
            });
            Mosaic { dn, ..frame(1, |_, _| 0.0) }
        };
        let still = wide(0.0, 0.0, 1);
        for (dx, dy) in [(0.0, 0.0), (0.4, -0.3), (1.0, 2.0), (-9.5, 6.25)] {
            let (x, y) = shift(&still, &wide(dx, dy, 2)).unwrap();
            let miss = (x - f64::from(dx)).hypot(y - f64::from(dy));
            assert!(miss < 0.1, "{x} {y} for {dx} {dy}");
        }
    }

    #[test]
    fn a_frame_without_structure_is_not_called_moved() {
        assert_eq!(shift(&frame(1, |_, _| 3000.0), &frame(2, |_, _| 9000.0)), None);
        assert_eq!(codes(&frame(1, |_, _| 3000.0), &frame(2, |_, _| 9000.0)), []);
    }

    #[test]
    fn a_corner_that_darkens_tells_that_the_room_changed() {
        let on = frame(2, |x, y| if x < 60.0 && y < 60.0 { 0.93 * room(x, y) } else { 2.0 * room(x, y) });
        assert_eq!(codes(&frame(1, room), &on), [ReasonCode::AmbientChanged]);
    }

    #[test]
    fn frames_of_different_size_are_refused_before_their_pixels_are_compared() {
        let small = Mosaic { dn: Image::filled(64, 64, 3000), ..frame(1, room) };
        assert_eq!(codes(&frame(1, room), &small), [ReasonCode::SettingsChanged]);
    }
}
