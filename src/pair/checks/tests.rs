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
        let files =
            Some(Files { off: off_digest, on: on_digest, more: &more, earlier: &earlier, may_share_unlit });
        let expected = Expected { files, ..Expected::default() };
        let reasons = judge_expecting(view(&off), view(&on), &expected, &Limits::default()).reasons;
        reasons.into_iter().map(|r| (r.code, r.sentence)).next()
    };
    let judged = |off, on, may_share| judged_with(off, on, may_share, &[]);
    assert_eq!(judged("a", "b", false), None);
    assert_eq!(judged_with("a", "b", false, &["c", "d"]), None);
    for more in [["c", "c"], ["c", "b"], ["a", "c"]] {
        let (code, sentence) = judged_with("a", "b", true, &more).unwrap();
        assert!(code == ReasonCode::Repeated && sentence.contains("Two of the pair's frames"), "{sentence}");
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
    assert!(reasons[0].sentence.contains("of the lit frame outside the region are clipped"), "{reasons:?}");
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
            judge_expecting(off, on, &Expected { plan, ..Expected::default() }, &Limits::default()).reasons;
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
            let waves =
                (x / 31.0).sin() * (y / 23.0).cos() + (x / 57.0 + y / 41.0).sin() + (x * y / 90_000.0).sin();
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
