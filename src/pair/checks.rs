//! What is wrong with a pair, each time with a figure, the limit it broke and a sentence.
//!
//! Takes the two frames as the sensor gave them and their settings, gives the reasons to reject the pair,
//! none if it is good. Pure: the same code judges a pair just shot and one that came in as files. Files
//! that could not be decoded never get here; their error is their reason.

use super::limits::Limits;
use super::rise::{self, Block};
use super::{Reason, ReasonCode, Settings, motion};
use crate::photometry::Mosaic;

/// One frame as the checks see it.
#[derive(Clone, Copy, Debug)]
pub struct FrameView<'a> {
    /// Sensor values.
    pub mosaic: &'a Mosaic,
    /// Settings out of the file.
    pub settings: &'a Settings,
}

/// What is known beforehand of how the pair should be.
#[derive(Clone, Copy, Debug, Default)]
pub struct Expected<'a> {
    /// The settings that were asked for; absent ones are not compared.
    pub plan: Option<&'a Settings>,
    /// An earlier accepted pair (unlit, lit) from the very same stop: its flash light is what this pair's
    /// must reach.
    pub earlier: Option<(&'a Mosaic, &'a Mosaic)>,
}

/// Judges a pair from itself alone.
pub fn judge(off: FrameView, on: FrameView, limits: &Limits) -> Vec<Reason> {
    judge_expecting(off, on, &Expected::default(), limits)
}

/// Judges a pair from itself and from what was expected of it.
pub fn judge_expecting(off: FrameView, on: FrameView, expected: &Expected, limits: &Limits) -> Vec<Reason> {
    let mut reasons = changed_settings(off.settings, on.settings, "the lit frame", "the unlit frame", limits);
    if let Some(plan) = expected.plan {
        reasons.extend(changed_settings(plan, on.settings, "the lit frame", "the plan", limits));
    }
    if let Some(reason) = changed_size(off.mosaic, on.mosaic) {
        reasons.push(reason);
        return reasons;
    }
    reasons.extend(overexposed(off.mosaic, on.mosaic, limits));

    let same_settings = reasons.iter().all(|r| r.code != ReasonCode::SettingsChanged);
    let blocks = rise::blocks(off.mosaic, on.mosaic);
    if let Some(reason) = misfire(&blocks, limits) {
        reasons.push(reason);
        return reasons;
    }
    reasons.extend(weak(&blocks, on.mosaic, limits));
    if let Some((earlier_off, earlier_on)) = expected.earlier {
        reasons.extend(weaker_than(&blocks, &rise::blocks(earlier_off, earlier_on), limits));
    }
    let moved = moved(off.mosaic, on.mosaic, limits);
    // Shifted edges darken too, and so does a shorter exposure: then nothing is known of the room's light.
    if moved.is_none() && same_settings {
        reasons.extend(ambient_changed(&blocks, limits));
    }
    reasons.extend(moved);
    reasons
}

fn reason(code: ReasonCode, figure: f64, limit: f64, sentence: String) -> Reason {
    Reason { code, figure, limit, sentence }
}

/// Differences between the settings that should be (`wanted`, called `there`) and those that are.
fn changed_settings(
    wanted: &Settings,
    found: &Settings,
    here: &str,
    there: &str,
    limits: &Limits,
) -> Vec<Reason> {
    let advice = "lock the exposure (mode M, fixed ISO and white balance) and shoot the pair again";
    let code = ReasonCode::SettingsChanged;
    let numbers = [
        ("shutter time", wanted.shutter.map(|v| v.0), found.shutter.map(|v| v.0)),
        ("aperture", wanted.aperture.map(|v| v.0), found.aperture.map(|v| v.0)),
        ("ISO", wanted.iso.map(|v| v.0), found.iso.map(|v| v.0)),
        ("focal length", wanted.focal_length_mm, found.focal_length_mm),
    ];
    let words = [
        ("camera model", &wanted.model, &found.model),
        ("camera serial number", &wanted.serial, &found.serial),
        ("lens", &wanted.lens, &found.lens),
        ("white balance", &wanted.white_balance, &found.white_balance),
        ("exposure program", &wanted.exposure_program, &found.exposure_program),
    ];
    let mut reasons = Vec::new();
    for (name, wanted, found) in numbers {
        if let (Some(wanted), Some(found)) = (wanted, found)
            && (found / wanted - 1.0).abs() > limits.setting_tolerance
        {
            let sentence = format!("The {name} is {found} in {here} but {wanted} in {there}; {advice}.");
            reasons.push(reason(code, found, wanted, sentence));
        }
    }
    for (name, wanted, found) in words {
        if let (Some(wanted), Some(found)) = (wanted, found)
            && wanted != found
        {
            let sentence = format!("The {name} is {found:?} in {here} but {wanted:?} in {there}; {advice}.");
            reasons.push(reason(code, 1.0, 0.0, sentence));
        }
    }
    reasons
}

fn changed_size(off: &Mosaic, on: &Mosaic) -> Option<Reason> {
    let size = |m: &Mosaic| (m.dn.width(), m.dn.height());
    if size(off) == size(on) && off.cfa == on.cfa {
        return None;
    }
    let ((ow, oh), (w, h)) = (size(off), size(on));
    let sentence = format!(
        "The lit frame has {w} x {h} sites with the filter array {:?}, the unlit one {ow} x {oh} with {:?}; shoot both with one camera in one raw size.",
        on.cfa.0, off.cfa.0
    );
    Some(reason(ReasonCode::SettingsChanged, (w * h) as f64, (ow * oh) as f64, sentence))
}

/// The worst share of clipped sites of one colour in one frame.
fn overexposed(off: &Mosaic, on: &Mosaic, limits: &Limits) -> Option<Reason> {
    let shares = [("unlit", off.clipped_shares()), ("lit", on.clipped_shares())];
    let named = shares.iter().flat_map(|(frame, shares)| {
        ["red", "green", "blue"].into_iter().zip(shares).map(move |(colour, share)| (*frame, colour, *share))
    });
    let (frame, colour, worst) = named.max_by(|a, b| a.2.total_cmp(&b.2))?;
    (worst > limits.clipped_share).then(|| {
        let advice = if frame == "lit" { "lower the flash power, or close the aperture" } else { "shorten the exposure, or dim the room" };
        let sentence = format!(
            "{:.2} % of the {colour} sites of the {frame} frame are clipped, more than {:.2} %; {advice}, and shoot the pair again.",
            100.0 * worst, 100.0 * limits.clipped_share
        );
        reason(ReasonCode::Overexposed, worst, limits.clipped_share, sentence)
    })
}

/// Whether a block rose beyond its noise and beyond what the room's own light may do.
fn is_lit(block: &Block, limits: &Limits) -> bool {
    block.rise > limits.noise_sigmas * block.error && block.rise > limits.ambient_rise * block.ambient
}

fn misfire(blocks: &[Block], limits: &Limits) -> Option<Reason> {
    let lit = rise::share(blocks, |b| is_lit(b, limits));
    (lit < limits.lit_share).then(|| {
        let darker = rise::share(blocks, |b| b.rise < -limits.noise_sigmas * b.error);
        let advice = if darker > 0.5 {
            "the frames look swapped: give the unlit frame as off, the lit one as on"
        } else {
            "check the flash's cable, charge and switch, and shoot the pair again"
        };
        let sentence = format!(
            "The light rose in {:.2} % of the frame only (at least {:.2} % is expected), so the flash did not fire; {advice}.",
            100.0 * lit, 100.0 * limits.lit_share
        );
        reason(ReasonCode::Misfire, lit, limits.lit_share, sentence)
    })
}

fn weak(blocks: &[Block], on: &Mosaic, limits: &Limits) -> Option<Reason> {
    let levels = on.levels.saturation.concat().into_iter().zip(on.levels.black.concat());
    let range = levels.map(|(saturation, black)| f64::from(saturation - black)).sum::<f64>() / 4.0;
    let rise = rise::best_hundredth(blocks) / range;
    (rise < limits.least_rise).then(|| {
        let sentence = format!(
            "The flash lifts the best-lit hundredth of the frame by {:.2} % of the range only, less than {:.2} %; raise its power, open the aperture, or go nearer.",
            100.0 * rise, 100.0 * limits.least_rise
        );
        reason(ReasonCode::Weak, rise, limits.least_rise, sentence)
    })
}

/// The flash's light against that of an earlier pair from the same stop, over the blocks that were lit.
fn weaker_than(blocks: &[Block], earlier: &[Block], limits: &Limits) -> Option<Reason> {
    if blocks.len() != earlier.len() {
        return None;
    }
    let lit = || blocks.iter().zip(earlier).filter(|(_, earlier)| is_lit(earlier, limits));
    let before: f64 = lit().map(|(_, earlier)| earlier.rise).sum();
    let now: f64 = lit().map(|(now, _)| now.rise).sum();
    let share = now / before;
    (before > 0.0 && share < limits.least_rise_of_earlier).then(|| {
        let sentence = format!(
            "The flash gave {:.1} % of the light that it gave from this stop before, less than {:.1} %; let it recharge, and shoot the pair again.",
            100.0 * share, 100.0 * limits.least_rise_of_earlier
        );
        reason(ReasonCode::Weak, share, limits.least_rise_of_earlier, sentence)
    })
}

fn moved(off: &Mosaic, on: &Mosaic, limits: &Limits) -> Option<Reason> {
    let (x, y) = motion::shift(off, on)?;
    let distance = x.hypot(y);
    (distance > limits.shift_sites).then(|| {
        let sentence = format!(
            "The lit frame is displaced by {distance:.2} pixels ({x:+.2} right, {y:+.2} down), more than {:.2}; use a stand and a remote release, and shoot the pair again.",
            limits.shift_sites
        );
        reason(ReasonCode::Moved, distance, limits.shift_sites, sentence)
    })
}

/// Flash adds light; a block that is darker in the lit frame tells that the room's light fell. A rise
/// cannot be told from flash.
fn ambient_changed(blocks: &[Block], limits: &Limits) -> Option<Reason> {
    let darkened = rise::share(blocks, |b| {
        b.rise < -limits.noise_sigmas * b.error && b.rise < -limits.ambient_fall * b.ambient
    });
    (darkened > limits.darkened_share).then(|| {
        let sentence = format!(
            "{:.2} % of the frame is darker with flash than without, more than {:.2} %, so the room's light fell between the frames; keep windows covered and lamps steady, and shoot the pair again.",
            100.0 * darkened, 100.0 * limits.darkened_share
        );
        reason(ReasonCode::AmbientChanged, darkened, limits.darkened_share, sentence)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource, Levels};
    use crate::raster::Image;
    use crate::units::Seconds;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    /// A frame of `light(x, y)` electrons at 3 electrons a DN with shot noise and 5 electrons of read noise.
    fn frame(seed: u64, light: impl Fn(f64, f64) -> f64) -> Mosaic {
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

    fn room(x: f64, y: f64) -> f64 {
        let waves = (x / 9.0).sin() * (y / 7.0).cos() + (x * y / 900.0).sin() + ((x + 2.0 * y) / 23.0).sin();
        3200.0 + 1000.0 * waves
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
    fn a_flash_that_gives_less_than_before_is_weak() {
        let (off, on) = (frame(1, room), frame(2, |x, y| 2.0 * room(x, y)));
        let (earlier_off, earlier_on) = (frame(3, room), frame(4, |x, y| 2.3 * room(x, y)));
        let settings = Settings::default();
        let view = |mosaic| FrameView { mosaic, settings: &settings };
        let expected = Expected { plan: None, earlier: Some((&earlier_off, &earlier_on)) };
        let reasons = judge_expecting(view(&off), view(&on), &expected, &Limits::default());
        assert_eq!(reasons.len(), 1);
        assert_eq!(reasons[0].code, ReasonCode::Weak);
        assert!((reasons[0].figure - 1.0 / 1.3).abs() < 0.01, "{reasons:?}");
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
            let (x, y) = motion::shift(&frame(1, room), &on).unwrap();
            assert!((x - dx).abs() < 0.2 && (y - dy).abs() < 0.2, "{x} {y} for {dx} {dy}");
            assert_eq!(codes(&frame(1, room), &on), [ReasonCode::Moved]);
        }
    }

    #[test]
    fn a_frame_without_structure_is_not_called_moved() {
        assert_eq!(motion::shift(&frame(1, |_, _| 3000.0), &frame(2, |_, _| 9000.0)), None);
        assert_eq!(codes(&frame(1, |_, _| 3000.0), &frame(2, |_, _| 9000.0)), []);
    }

    #[test]
    fn a_corner_that_darkens_tells_that_the_room_changed() {
        let on = frame(2, |x, y| if x < 60.0 && y < 60.0 { 0.93 * room(x, y) } else { 2.0 * room(x, y) });
        assert_eq!(codes(&frame(1, room), &on), [ReasonCode::AmbientChanged]);
    }

    #[test]
    fn settings_are_compared_with_each_other_and_with_the_plan() {
        let mosaics = (frame(1, room), frame(2, |x, y| 2.0 * room(x, y)));
        let fast = Settings { shutter: Some(Seconds(1.0 / 125.0)), ..Settings::default() };
        let slow = Settings { shutter: Some(Seconds(1.0 / 100.0)), ..Settings::default() };
        let judged = |off: &Settings, on: &Settings, plan: Option<&Settings>| {
            let off = FrameView { mosaic: &mosaics.0, settings: off };
            let on = FrameView { mosaic: &mosaics.1, settings: on };
            judge_expecting(off, on, &Expected { plan, earlier: None }, &Limits::default())
        };
        assert_eq!(judged(&fast, &fast, Some(&fast)), []);
        let reasons = judged(&fast, &slow, None);
        assert_eq!((reasons.len(), reasons[0].code), (1, ReasonCode::SettingsChanged));
        assert_eq!((reasons[0].figure, reasons[0].limit), (0.01, 0.008));
        assert_eq!(judged(&slow, &slow, Some(&fast)).len(), 1);
    }

    #[test]
    fn frames_of_different_size_are_refused_before_their_pixels_are_compared() {
        let small = Mosaic { dn: Image::filled(64, 64, 3000), ..frame(1, room) };
        assert_eq!(codes(&frame(1, room), &small), [ReasonCode::SettingsChanged]);
    }
}
