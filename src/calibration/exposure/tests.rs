use super::*;
use crate::calibration::tiles::Tile;
use crate::photometry::Cfa;
use crate::photometry::apex::{ExposureScale, Nominal};
use crate::units::{FNumber, Iso, Seconds};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const ISOS: [f64; 10] = [100.0, 125.0, 160.0, 200.0, 250.0, 320.0, 400.0, 500.0, 640.0, 800.0];
const SPEEDS: [f64; 10] = [250.0, 200.0, 160.0, 125.0, 100.0, 80.0, 60.0, 50.0, 40.0, 30.0];
const APERTURES: [f64; 10] = [22.0, 20.0, 18.0, 16.0, 14.0, 13.0, 11.0, 10.0, 9.0, 8.0];
const TOP: f64 = 12_000.0;

fn settings(setting: Setting, step: usize) -> Settings {
    let at = |own: Setting, labels: [f64; 10]| labels[if setting == own { step } else { 4 }];
    Settings {
        iso: Some(Iso(at(Setting::Iso, ISOS))),
        shutter: Some(Seconds(1.0 / at(Setting::Shutter, SPEEDS))),
        aperture: Some(FNumber(at(Setting::Aperture, APERTURES))),
        ..Settings::default()
    }
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

/// A frame of `light` DN in the middle, dimmer at the borders, seen by a sensor of this gain and read noise.
fn even(light: f64, noise: [f64; 2], random: &mut ChaCha8Rng) -> Tiles {
    let (columns, rows, sites) = (6, 4, 60.0);
    let (mut tiles, mut over, mut all) = (vec![], 0.0, 0.0);
    for tile in 0..columns * rows {
        let x = (tile % columns) as f64 / 2.5 - 1.0;
        let y = (tile / columns) as f64 / 1.5 - 1.0;
        tiles.push([0.5, 1.0, 0.7].map(|colour| {
            let mean = colour * light * (1.0 - 0.1 * (x * x + y * y) / 2.0);
            let variance = (noise[0] + noise[1] * mean) / sites;
            all += 1.0;
            let tile = Tile { mean: mean + variance.sqrt() * normal(random), variance, sites };
            over += f64::from(u8::from(mean > TOP));
            (mean <= TOP).then_some(tile)
        }));
    }
    Tiles {
        size: (96, 64),
        cfa: Cfa::RGGB,
        grid: (columns, rows),
        tiles,
        over_exposed: over / all,
        cut_off: 0.0,
    }
}

/// A ladder whose steps are off by `deviations`, each shot `repeats` times with scatter `jitter`.
fn ladder(
    setting: Setting,
    deviations: &[f64],
    dark: f64,
    repeats: usize,
    jitter: f64,
    random: &mut ChaCha8Rng,
) -> Vec<EvenFrame> {
    let mut shots = vec![];
    for (step, deviation) in deviations.iter().enumerate() {
        for _ in 0..repeats {
            let light = dark * (step as f64 / 3.0).exp2() * (1.0 + deviation);
            let light = light * (1.0 + jitter * normal(random));
            let gain = if setting == Setting::Iso { 0.3 * (step as f64 / 3.0).exp2() } else { 0.3 };
            shots.push(EvenFrame {
                settings: settings(setting, step),
                tiles: even(light, [3.0, gain], random),
            });
        }
    }
    shots
}

#[test]
fn a_thousand_random_ladders_come_back_inside_their_intervals() {
    let mut random = ChaCha8Rng::seed_from_u64(32);
    let (mut inside, mut all) = (0u32, 0u32);
    for trial in 0..1000 {
        let setting = Setting::ALL[trial % 3];
        let steps = random.random_range(3..=10);
        let mut truth: Vec<f64> = (0..steps).map(|_| 0.02 * normal(&mut random)).collect();
        truth[0] = 0.0;
        // Some end over-exposed in part, some wholly.
        let dark = 100.0 * random.random_range(0.0..4.5f64).exp2();
        let shots = ladder(setting, &truth, dark, 1, 0.0, &mut random);
        let (fit, left_out) = fit_exposure(&shots).unwrap();
        assert_eq!(fit.ladders.len(), 1);
        let used = left_out.iter().filter(|why| why.is_none()).count();
        assert_eq!(fit.ladders[0].steps.len(), used);
        for (step, truth) in fit.ladders[0].steps.iter().zip(truth).skip(1) {
            let [low, high] = step.deviation_interval_95;
            inside += u32::from(low <= truth && truth <= high);
            all += 1;
            assert!((step.deviation - truth).abs() < 0.02, "{step:?}, not {truth}");
        }
    }
    let coverage = f64::from(inside) / f64::from(all);
    println!("{all} steps, {:.1} % inside", 100.0 * coverage);
    assert!((0.92..0.98).contains(&coverage), "{coverage}");
}

#[test]
fn scatter_between_repeats_is_in_the_interval_if_it_was_shot() {
    let mut random = ChaCha8Rng::seed_from_u64(33);
    let (mut inside, mut all, mut sd) = (0u32, 0u32, 0.0);
    for _ in 0..300 {
        let truth = [0.0, 0.01, -0.02, 0.005, 0.03];
        let shots = ladder(Setting::Shutter, &truth, 400.0, 3, 0.004, &mut random);
        let ladder = &fit_exposure(&shots).unwrap().0.ladders[0];
        sd += ladder.repeat_sd.unwrap().powi(2) / 300.0;
        for (step, truth) in ladder.steps.iter().zip(truth).skip(1) {
            assert_eq!(step.shots, 3);
            let [low, high] = step.deviation_interval_95;
            inside += u32::from(low <= truth && truth <= high);
            all += 1;
        }
    }
    assert!((sd.sqrt() / 0.004 - 1.0).abs() < 0.05, "{}", sd.sqrt());
    let coverage = f64::from(inside) / f64::from(all);
    assert!((0.90..0.98).contains(&coverage), "{coverage}");
}

#[test]
fn without_noise_the_figures_are_those_of_the_table_by_hand() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let truth = [0.0, 0.01, -0.03, 0.02];
    let mut shots = ladder(Setting::Aperture, &truth, 400.0, 1, 0.0, &mut random);
    for (shot, truth) in shots.iter_mut().zip(truth).enumerate().map(|(k, (shot, t))| (shot, (k, t))) {
        let light = 400.0 * (truth.0 as f64 / 3.0).exp2() * (1.0 + truth.1);
        shot.tiles.tiles.iter_mut().flatten().flatten().for_each(|tile| tile.mean = light);
    }
    let (fit, left_out) = fit_exposure(&shots).unwrap();
    assert!(left_out.iter().all(Option::is_none));
    let ladder = &fit.ladders[0];
    assert_eq!(ladder.setting, Setting::Aperture);
    assert_eq!(ladder.shared, BTreeMap::from([(Setting::Iso, 250.0), (Setting::Shutter, 0.01)]));
    for (step, truth) in ladder.steps.iter().zip(truth) {
        assert!((step.deviation - truth).abs() < 1e-12);
    }
    assert_eq!(ladder.steps[3].step_thirds, 3.0);
    assert_eq!(ladder.steps[0].deviation_interval_95, [0.0; 2]);
    let Summary { mean, max, min, sd } = ladder.summary;
    assert!((mean - 0.0).abs() < 1e-12 && (max - 0.03).abs() < 1e-12 && (min - 0.01).abs() < 1e-12);
    assert!((sd - (0.0014f64 / 2.0).sqrt()).abs() < 1e-12, "{sd}");
    assert!((ladder.between_steps.max - (1.02 / 0.97 - 1.0)).abs() < 1e-12);
    assert!((ladder.step_00_dn - 400.0).abs() < 1e-9, "{}", ladder.step_00_dn);
    assert!(ladder.repeat_sd.is_none());
    let told = verdict(&fit, false);
    assert!(told.good && told.sentences[0].contains("f/18"), "{told:?}");
    let mut dim = fit.clone();
    dim.ladders[0].step_00_dn = 125.0;
    let of_black = |fit, known| {
        let told = verdict(fit, known).sentences;
        told.iter().any(|s| s.contains("125 DN above") && s.contains("0.80 %"))
    };
    assert!(of_black(&dim, false) && !of_black(&dim, true) && !of_black(&fit, false));
    // As it is kept.
    let json = serde_json::to_value(&fit).unwrap();
    assert_eq!(json["ladders"][0]["setting"], "aperture");
    assert_eq!(serde_json::from_value::<ExposureFit>(json).unwrap(), fit);
}

#[test]
fn dark_and_over_exposed_shots_are_left_out_with_their_reason_and_no_ladder_is_an_error() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let mut shots = ladder(Setting::Iso, &[0.0; 6], 400.0, 1, 0.0, &mut random);
    shots[0].tiles = even(0.0, [3.0, 0.3], &mut random);
    shots[5].tiles = even(90_000.0, [3.0, 0.3], &mut random);
    let (fit, left_out) = fit_exposure(&shots).unwrap();
    assert!(left_out[0].as_ref().unwrap().contains("too dark"), "{left_out:?}");
    assert!(left_out[5].as_ref().unwrap().contains("over-exposed over 100 %"), "{left_out:?}");
    assert_eq!(fit.ladders[0].steps.iter().map(|s| s.label).collect::<Vec<_>>(), ISOS[1..5]);
    let mut two_bodies = shots[..5].to_vec();
    two_bodies[4].tiles.size = (960, 640);
    let (fit, left_out) = fit_exposure(&two_bodies).unwrap();
    assert!(
        left_out[4].as_ref().unwrap().contains("960 x 640 pixels, the others of 96 x 64"),
        "{left_out:?}"
    );
    assert_eq!(fit.ladders[0].steps.len(), 3);
    let error = fit_exposure(&shots[3..]).unwrap_err().to_string();
    assert!(error.contains("2 usable shots of 3") && error.contains("over-exposed over"), "{error}");
}

#[test]
fn a_lamp_that_failed_and_a_lens_that_vignettes_are_told() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let shots = ladder(Setting::Iso, &[0.0, 0.0, -0.3, 0.01], 400.0, 1, 0.0, &mut random);
    let told = verdict(&fit_exposure(&shots).unwrap().0, true);
    assert!(!told.good && told.sentences[0].contains("more than half a step"), "{told:?}");
    // Of two ladders the other stands.
    let truth = [0.0, 0.01, -0.02, 0.01];
    let both = [shots, ladder(Setting::Shutter, &truth, 400.0, 1, 0.0, &mut random)].concat();
    let fit = fit_exposure(&both).unwrap().0;
    let told = verdict(&fit, true);
    assert!(told.good && told.sentences[0].contains("THIS LADDER IS NOT USED"), "{told:?}");
    let table = ExposureTable::of(&fit, true);
    let [iso, shutter] = [Setting::Iso, Setting::Shutter].map(|s| (settings(s, 0), settings(s, 2)));
    assert_eq!(table.source(&iso.0, &iso.1), ScaleSource::Nominal);
    assert_eq!(table.source(&shutter.0, &shutter.1), ScaleSource::Measured);

    let mut shots = ladder(Setting::Aperture, &[0.0; 4], 1000.0, 1, 0.0, &mut random);
    for (tile, row) in shots[3].tiles.tiles.iter_mut().enumerate() {
        row.iter_mut().flatten().for_each(|t| t.mean *= if tile % 2 == 0 { 1.03 } else { 0.97 });
    }
    let fit = fit_exposure(&shots).unwrap().0;
    let steps = &fit.ladders[0].steps;
    assert!((steps[3].pattern_sd - 0.03).abs() < 0.006, "{steps:?}");
    assert!(verdict(&fit, true).sentences.iter().any(|s| s.contains("vignetting moves")));
}

#[test]
fn the_table_gives_measured_ratios_and_nominal_ones_where_nothing_was_measured() {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let truth = [0.0, 0.03, -0.02, 0.01];
    let shots = ladder(Setting::Shutter, &truth, 2000.0, 1, 0.0, &mut random);
    let fit = fit_exposure(&shots).unwrap().0;
    let table = ExposureTable::of(&fit, true);
    let steps = &fit.ladders[0].steps;
    let time = |k: usize| table.time(Seconds(1.0 / SPEEDS[k]));
    assert!((time(2) / time(1) - steps[2].factor / steps[1].factor).abs() < 1e-12);
    assert_eq!(time(7), Nominal.time(Seconds(1.0 / SPEEDS[7])));
    assert_eq!(table.gain(Iso(400.0)), Nominal.gain(Iso(400.0)));
    let at = |k| settings(Setting::Shutter, k);
    assert_eq!(table.source(&at(0), &at(3)), ScaleSource::Measured);
    assert_eq!(table.source(&at(0), &at(7)), ScaleSource::Nominal);
    assert_eq!(table.source(&at(7), &at(7)), ScaleSource::Same);

    let shots = ladder(Setting::Aperture, &truth, 2000.0, 1, 0.0, &mut random);
    let fit = fit_exposure(&shots).unwrap().0;
    let stops = |table: &ExposureTable| table.aperture(FNumber(20.0)) / table.aperture(FNumber(22.0));
    assert!((stops(&ExposureTable::of(&fit, true)) - fit.ladders[0].steps[1].factor).abs() < 1e-12);
    assert!((stops(&ExposureTable::of(&fit, false)) - 2f64.cbrt()).abs() < 1e-12);
}
