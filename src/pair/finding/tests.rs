//! Scenes of random room and flash light before a simulated sensor.

use super::*;
use crate::pair::plan::Window;
use crate::photometry::apex::Nominal;
use crate::photometry::{Cfa, LevelSource, Levels};
use crate::raster::Image;
use crate::units::FNumber;
use proptest::prelude::*;
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};

/// The region as sites of the simulated frames, and as shares of them.
const REGION: Region = Region { x: 21, y: 10, width: 130, height: 97 };
const WINDOW: Window =
    Window { x: 21.5 / 180.0, y: 10.5 / 120.0, width: 129.0 / 180.0, height: 96.0 / 120.0 };
const BLACK: f64 = 2048.0;
const RANGE: f64 = 12_000.0;

/// Light at unit S and unit ISO / N^2 by colour, as shares of the range.
#[derive(Clone, Copy, Debug)]
struct Scene {
    room: [f64; 3],
    flash: [f64; 3],
    /// Contrast of the object's reflectance.
    contrast: f64,
    noise: f64,
}

impl Scene {
    /// A frame at true exposure steps; without `seed` free of noise.
    fn shoot(&self, e: Exposure, flash: bool, seed: Option<u64>) -> Mosaic {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed.unwrap_or(0));
        let (room, gain) = (Nominal.room(e.shutter, e.aperture, e.iso), Nominal.flash(e.aperture, e.iso));
        // Noise in electrons grows with amplification.
        let electrons = RANGE / 12_000.0 * Nominal.gain(e.iso) / 100.0 / 4.0 * self.noise;
        let dn = Image::from_fn(180, 120, |x, y| {
            let (fx, fy) = (x as f64, y as f64);
            let pattern = 0.5 + 0.25 * ((fx / 17.0).sin() + (fy / 11.0 + fx / 40.0).cos());
            let reflectance = (1.0 - self.contrast) + self.contrast * pattern;
            let near = 1.0 - 0.4 * ((fx - 90.0) / 90.0).powi(2);
            let c = Cfa::RGGB.colour(x, y);
            let lit = if flash { self.flash[c] * gain * near } else { 0.0 };
            let light = RANGE * reflectance * (self.room[c] * room * (0.7 + 0.3 * fy / 120.0) + lit);
            let sd = if seed.is_some() { (light * electrons + 9.0 * electrons.max(0.3)).sqrt() } else { 0.0 };
            let noise = Normal::new(0.0, sd).unwrap().sample(&mut random);
            (BLACK + light + noise).round().clamp(0.0, BLACK + RANGE) as u16
        });
        let levels = Levels {
            black: [[BLACK as f32; 2]; 2],
            saturation: [[(BLACK + RANGE) as f32; 2]; 2],
            black_source: LevelSource::MaskedPixels,
            saturation_source: LevelSource::Measured,
        };
        Mosaic { dn, cfa: Cfa::RGGB, levels }
    }

    /// The brightest channel's true share of saturation, beyond 1 where it would be clipped.
    fn share(&self, e: Exposure) -> f64 {
        let darker = 1.0 / 64.0;
        let dim =
            Scene { room: self.room.map(|v| v * darker), flash: self.flash.map(|v| v * darker), ..*self };
        let seen = brightness(&dim.shoot(e, true, None), REGION);
        seen.iter().map(|b| b.top).fold(0.0, f64::max) / darker
    }
}

fn thirds(from: f64, to: f64, unit: f64) -> Vec<f64> {
    (0..)
        .map(|k| unit * 2f64.powf(f64::from(k) / 3.0))
        .skip_while(|v| *v < from * 0.99)
        .take_while(|v| *v < to * 1.01)
        .collect()
}

fn offered() -> Offered {
    Offered {
        shutters: thirds(1.0 / 8000.0, 30.0, 1.0 / 8192.0).into_iter().map(Seconds).collect(),
        apertures: thirds(4.0, 512.0, 4.0).into_iter().map(|n| FNumber(n.sqrt())).collect(),
        isos: thirds(100.0, 6400.0, 100.0).into_iter().map(Iso).collect(),
    }
}

const START: Exposure = Exposure { shutter: Seconds(1.0 / 128.0), aperture: FNumber(11.31), iso: Iso(100.0) };

/// Runs a search to its end; gives the result and the shots it took.
fn search(
    scene: &Scene,
    wish: Wish,
    offered: &Offered,
    start: Exposure,
) -> (Result<Found, FindingError>, Vec<(Exposure, bool)>) {
    let mut finding = Finding::new(wish, offered, start, Nominal).unwrap();
    let mut shots = vec![];
    loop {
        match finding.next() {
            Err(error) => return (Err(error), shots),
            Ok(Next::Done(found)) => return (Ok(found), shots),
            Ok(Next::Shoot { exposure, flash }) => {
                shots.push((exposure, flash));
                assert!(shots.len() <= MOST_SHOTS, "{shots:?}");
                finding.observe(&scene.shoot(exposure, flash, Some(shots.len() as u64))).unwrap();
            }
        }
    }
}

/// A scene that gives these shares of saturation at the start.
fn scene(room: f64, flash: f64) -> Scene {
    let (r, f) =
        (Nominal.room(START.shutter, START.aperture, START.iso), Nominal.flash(START.aperture, START.iso));
    Scene {
        room: [room / r, 0.8 * room / r, 0.4 * room / r],
        flash: [0.6 * flash / f, flash / f, 0.7 * flash / f],
        contrast: 0.8,
        noise: 1.0,
    }
}

fn assert_on_target(scene: &Scene, found: &Found) {
    let share = scene.share(found.plan.on);
    let off_by = (share / 0.85).log2().abs();
    assert!(off_by <= 1.0 / 3.0, "{share} by {found:?}");
    let clipped = scene.shoot(found.plan.on, true, Some(99)).clipped_shares();
    assert!(clipped.iter().all(|c| *c <= 0.01), "{clipped:?} by {found:?}");
}

#[test]
fn an_ordinary_object_takes_three_shots_at_base_iso() {
    let scene = scene(0.02, 0.6);
    let (found, shots) = search(&scene, Wish::of(Some(WINDOW)), &offered(), START);
    let found = found.unwrap();
    assert_on_target(&scene, &found);
    assert!(shots.len() <= 3 && !shots[0].1 && shots[1].1, "{shots:?}");
    let on = found.plan.on;
    assert_eq!((on.shutter, on.iso, found.plan.off), (START.shutter, START.iso, on));
    assert!((5.6..11.4).contains(&on.aperture.0), "{on}");
    assert!((found.flash_share / found.ambient_share / 30.0 - 1.0).abs() < 0.5, "{found:?}");
    assert_eq!(found.warnings, Vec::<String>::new());
}

#[test]
fn a_dark_room_needs_no_shot_without_flash() {
    let scene = scene(0.0, 2.0);
    let wish = Wish { flash_only: true, ..Wish::of(Some(WINDOW)) };
    let (found, shots) = search(&scene, wish, &offered(), START);
    assert_on_target(&scene, &found.unwrap());
    assert!(shots.iter().all(|s| s.1) && shots.len() <= 3, "{shots:?}");
}

#[test]
fn a_longer_unlit_frame_is_never_clipped_and_less_noisy() {
    let scene = scene(0.05, 0.5);
    let wish = Wish { separate_off: true, ..Wish::of(Some(WINDOW)) };
    let found = search(&scene, wish, &offered(), START).0.unwrap();
    let Plan { off, on } = found.plan;
    assert!(
        off.shutter.0 > 3.0 * on.shutter.0 && off.aperture == on.aperture && off.iso == on.iso,
        "{found:?}"
    );
    let frame = scene.shoot(off, false, Some(5));
    assert_eq!(frame.clipped_shares(), [0.0; 3]);
}

#[test]
fn what_cannot_be_reached_says_what_to_change() {
    let kept = Wish { keep: Keep { shutter: true, aperture: true, iso: true }, ..Wish::of(Some(WINDOW)) };
    let error = search(&scene(0.01, 0.02), kept, &offered(), START).0.unwrap_err();
    assert!(error.to_string().contains("raise the flash's power"), "{error}");
    let error = search(&scene(0.01, 900.0), Wish::of(Some(WINDOW)), &offered(), START).0.unwrap_err();
    assert!(error.to_string().contains("lower the flash's power"), "{error}");
    let error = search(&scene(900.0, 1.0), Wish::of(Some(WINDOW)), &offered(), START).0.unwrap_err();
    assert!(error.to_string().contains("dim the room"), "{error}");
    let coarse = Offered {
        apertures: vec![FNumber(4.0), FNumber(16.0)],
        isos: vec![Iso(100.0)],
        ..Offered::default()
    };
    let error = search(&scene(0.0, 0.8), Wish { flash_only: true, ..Wish::of(Some(WINDOW)) }, &coarse, START)
        .0
        .unwrap_err();
    assert!(matches!(error, FindingError::TooCoarse { .. }), "{error}");
    assert!(matches!(
        Finding::new(Wish { target_share: 1.5, ..Wish::of(Some(WINDOW)) }, &offered(), START, Nominal),
        Err(FindingError::Wish(_))
    ));
}

#[test]
fn a_start_faster_than_x_sync_is_slowed_down_to_it() {
    let start = Exposure { shutter: Seconds(1.0 / 512.0), ..START };
    let (found, shots) = search(&scene(0.05, 0.3), Wish::of(Some(WINDOW)), &offered(), start);
    let sync = Nominal.time(Wish::of(None).x_sync);
    assert!(Nominal.time(found.unwrap().plan.on.shutter) >= 0.99 * sync);
    assert!(shots.iter().all(|(e, _)| Nominal.time(e.shutter) >= 0.99 * sync), "{shots:?}");
}

#[test]
fn a_weak_flash_is_warned_about_before_the_lens_opens_beyond_f4() {
    let lens = Offered {
        apertures: thirds(2.0, 512.0, 2.0).into_iter().map(|n| FNumber(n.sqrt())).collect(),
        isos: vec![Iso(100.0)],
        ..offered()
    };
    let found = search(&scene(0.001, 0.045), Wish::of(Some(WINDOW)), &lens, START).0.unwrap();
    assert!(found.plan.on.aperture.0 < 3.9 && found.warnings[0].contains("wider than f/4"), "{found:?}");
    let found = search(&scene(0.6, 0.1), Wish::of(Some(WINDOW)), &offered(), START).0.unwrap();
    assert!(found.warnings.iter().any(|w| w.contains("dim the room")), "{found:?}");
}

#[test]
fn a_plan_is_never_so_near_to_saturation_that_its_trial_comes_out_clipped() {
    let base = scene(1.7029075733738335f64.exp2(), (-0.22509330752699702f64).exp2());
    let scene = Scene {
        room: [base.room[0] * 0.7639037603774076, base.room[1] * 0.3, base.room[2] * 0.3],
        flash: [base.flash[0] * 0.9639525340736599, base.flash[1] * 0.3, base.flash[2] * 0.3],
        contrast: 0.3149484335360408,
        noise: 1.0502476524994897,
    };
    let start = Exposure { aperture: offered().apertures[11], ..START };
    let (found, shots) = search(&scene, Wish::of(Some(WINDOW)), &offered(), start);
    let found = found.unwrap_or_else(|error| panic!("{error} after {shots:?}"));
    assert_on_target(&scene, &found);
    assert!(found.predicted_share <= 0.94, "{found:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(120))]

    /// At most four shots; on target within a third of a stop and not clipped, or truly out of reach.
    #[test]
    fn every_scene_is_exposed_right_or_said_to_be_out_of_reach(
        room in -12.0..4.0f64,
        flash in -8.0..6.0f64,
        tints in proptest::array::uniform6(0.3..1.0f64),
        contrast in 0.1..0.95f64,
        noise in 0.3..2.0f64,
        stops in 0..13usize,
        iso in 0..10usize,
        shutter in 0..9usize,
        keep in 0..8u8,
        flash_only in any::<bool>(),
        separate_off in any::<bool>(),
    ) {
        let offered = offered();
        let base = scene(room.exp2(), flash.exp2());
        let mut scene = Scene { contrast, noise, ..base };
        for c in 0..3 {
            scene.room[c] *= if flash_only { 0.0 } else { tints[c] };
            scene.flash[c] *= tints[c + 3];
        }
        let start = Exposure {
            shutter: Seconds((1.0 / 128.0) * 2f64.powf(shutter as f64 / 3.0)),
            aperture: offered.apertures[stops + 6],
            iso: offered.isos[iso],
        };
        let keep = Keep { shutter: keep & 1 > 0, aperture: keep & 2 > 0, iso: keep & 4 > 0 };
        let wish = Wish { keep, flash_only, separate_off, ..Wish::of(Some(WINDOW)) };
        let (found, shots) = search(&scene, wish, &offered, start);
        match found {
            Ok(found) => {
                assert_on_target(&scene, &found);
                prop_assert_eq!(found.shots, shots.len());
                prop_assert!(scene.shoot(found.plan.off, false, Some(98)).clipped_shares().iter().all(|c| *c <= 0.01));
            }
            Err(error) => {
                prop_assert!(!matches!(error, FindingError::Unsettled { .. }), "{error} after {shots:?}");
                let finding = Finding::new(wish, &offered, start, Nominal).unwrap();
                // On target, and noise keeps clear of saturation too.
                let top = |e: Exposure| brightness(&scene.shoot(e, true, Some(97)), REGION).map(|b| b.top);
                let within = |e: &Exposure| {
                    (scene.share(*e) / 0.85).log2().abs() < 0.12 && top(*e).iter().all(|top| *top < SAFE - 0.02)
                };
                let reach = finding.choices.iter().step_by(23).find(|e| within(e));
                prop_assert!(reach.is_none(), "{error} though {} does, after {shots:?}", reach.unwrap());
            }
        }
    }
}
