//! Parameter recovery over random rigs.

use super::*;
use crate::photometry::{Cfa, Levels, Mosaic};
use crate::raster::Image;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution, Normal, Poisson};

/// Share of the light that each colour gets.
const SHARES: [f64; 3] = [0.5, 1.0, 0.7];

/// A rig's statistics as frames of it would give them: tiles of three colours at levels of light, variances spread as
/// those of 61 degrees of freedom do.
fn rig(random: &mut ChaCha8Rng, gain: f64, read: f64, dark: bool) -> IsoInput {
    let freedom: f64 = 61.0;
    let spread = ChiSquared::new(freedom).unwrap();
    let tile = |colour: usize, signal: f64, random: &mut ChaCha8Rng| {
        let variance = gain * signal + read * read + 1.0 / 12.0;
        let shared = variance / freedom.sqrt() * (spread.sample(random) - freedom) / (2.0 * freedom).sqrt();
        Tile { colour, signal, variance: variance * spread.sample(random) / freedom, freedom, shared }
    };
    let pair = |light: f64, random: &mut ChaCha8Rng| {
        let mut tiles = vec![];
        for (colour, share) in SHARES.into_iter().enumerate() {
            for k in 0..8 {
                tiles.push(tile(colour, light * share * (1.0 + 0.02 * f64::from(k)), random));
            }
        }
        let signal = SHARES.map(|share| Some(Signal { mean: share * light, noise: 0.0, apart: 0.0 }));
        PairTiles { tiles, signal, shot_numbers: vec![] }
    };
    let levels = (0..10).map(|k| LightLevel {
        time: Some(1.0),
        aperture: None,
        pairs: vec![pair((read * read / gain).max(2.0) * (0.9 * f64::from(k)).exp2(), random)],
    });
    let levels = levels.collect();
    let dark = if dark { vec![pair(0.0, random)] } else { vec![] };
    IsoInput {
        iso: Iso(100.0),
        levels,
        dark,
        range: [1e9; 3],
        black: [1e9; 3],
        cut_off_dn: None,
        steps: Steps::WHOLE,
        saturation_source: LevelSource::Measured,
        black_error: 0.0,
        stops: Some(0.9),
    }
}

fn inside([low, high]: [f64; 2], truth: f64) -> usize {
    usize::from((low..=high).contains(&truth))
}

#[test]
fn gain_and_read_noise_of_a_thousand_random_rigs_lie_in_their_intervals() {
    let mut random = ChaCha8Rng::seed_from_u64(17);
    let (mut gains, mut reads, mut told) = (0, 0, 0);
    for number in 0..1000 {
        let gain = 0.05 * 40f64.powf(random.random());
        let read = 0.8 * 10f64.powf(random.random());
        let fit = fit(&rig(&mut random, gain, read, number % 2 == 0)).unwrap();
        gains += inside(fit.electrons_per_dn_interval_95, 1.0 / gain);
        match (fit.read_noise_e_interval_95, fit.read_noise_below_e) {
            (Some(interval), None) => {
                told += 1;
                reads += inside(interval, read / gain);
            }
            (None, Some(bound)) => assert!(bound > read / gain, "{fit:?}"),
            both => panic!("read noise is told or bounded, not {both:?}"),
        }
        assert!(fit.chi_squared < 1.5 && fit.rejected_share < 0.02);
    }
    let (gains, reads) = (gains as f64 / 1000.0, reads as f64 / f64::from(told));
    println!("coverage: gain {gains}, read noise {reads} of {told}");
    assert!((0.90..=0.98).contains(&gains), "gain: {gains}");
    assert!((0.90..=0.98).contains(&reads) && told > 950, "read noise: {reads} of {told}");
}

/// A frame of a sensor of this gain and read noise, in DN, rounded and clipped at 0 and 4000 DN.
fn frame(light: f64, (gain, read, black): (f64, f64, f64), random: &mut ChaCha8Rng) -> Mosaic {
    let noise = Normal::new(0.0, read).unwrap();
    let cfa = Cfa::RGGB;
    let dn = Image::from_fn(96, 96, |x, y| {
        let electrons = light * SHARES[cfa.colour(x, y)] * (1.0 - 0.001 * x as f64) / gain;
        let shot = if electrons > 0.0 { gain * Poisson::new(electrons).unwrap().sample(random) } else { 0.0 };
        (black + shot + noise.sample(random)).round().clamp(0.0, 4000.0) as u16
    });
    let levels = Levels {
        black: [[black as f32; 2]; 2],
        saturation: [[4000.0; 2]; 2],
        black_source: LevelSource::FileTag,
        saturation_source: LevelSource::FileTag,
    };
    Mosaic { dn, cfa, levels }
}

/// Pairs of such frames at levels of light, and a pair of dark ones.
fn frames(rig: (f64, f64, f64), lights: &[f64], random: &mut ChaCha8Rng) -> IsoInput {
    let black = [[rig.2; 2]; 2];
    let mut pair = |light: f64| {
        let (a, b) = (frame(light, rig, random), frame(light, rig, random));
        compare(&a, &b, black).unwrap()
    };
    let dark = vec![pair(0.0)];
    let level = |light: &f64| LightLevel { time: None, aperture: None, pairs: vec![pair(*light)] };
    IsoInput {
        iso: Iso(100.0),
        levels: lights.iter().map(level).collect(),
        dark,
        range: [4000.0 - rig.2; 3],
        black: [rig.2; 3],
        cut_off_dn: None,
        steps: Steps::WHOLE,
        saturation_source: LevelSource::FileTag,
        black_error: 0.01,
        stops: None,
    }
}

#[test]
fn whole_frames_of_random_sensors_tell_gain_and_read_noise() {
    let mut random = ChaCha8Rng::seed_from_u64(29);
    let lights = [20.0, 80.0, 320.0, 900.0, 1800.0, 3200.0];
    let (mut gains, mut reads) = (0, 0);
    for _ in 0..40 {
        let (gain, read) = (0.1 * 20f64.powf(random.random()), 1.0 + 4.0 * random.random::<f64>());
        let fit = fit(&frames((gain, read, 256.0), &lights, &mut random)).unwrap();
        gains += inside(fit.electrons_per_dn_interval_95, 1.0 / gain);
        reads += inside(fit.read_noise_e_interval_95.unwrap(), read / gain);
        assert!((fit.electrons_per_dn * gain - 1.0).abs() < 0.1, "{gain}: {fit:?}");
        assert!(fit.chi_squared < 1.2 && fit.rejected_share < 0.01, "{fit:?}");
    }
    // Of 40 draws of 95 %, fewer than 34 come once in a thousand times.
    println!("inside, of 40: gain {gains}, read noise {reads}");
    assert!(gains >= 34 && reads >= 34, "gain {gains}, read noise {reads}");
}

#[test]
fn noise_that_is_cut_off_at_nought_or_at_the_top_does_not_count() {
    // Black is 6 DN above 0, read noise 8 DN: every dark site may be cut off. Shot noise of 12 DN^2 per DN makes a bright
    // site's standard deviation 180 DN, where 70 % of the range is 1200 DN from the top.
    let mut random = ChaCha8Rng::seed_from_u64(31);
    let fit = fit(&frames((12.0, 8.0, 6.0), &[300.0, 900.0, 1800.0, 2700.0, 3400.0], &mut random)).unwrap();
    let gain = 1.0 / fit.electrons_per_dn;
    assert!((gain / 12.0 - 1.0).abs() < 0.05, "{gain}, {:?}", fit.electrons_per_dn_interval_95);
}

#[test]
fn read_noise_that_rounding_hides_is_bounded_and_not_told() {
    let mut random = ChaCha8Rng::seed_from_u64(37);
    for read in [0.05, 0.2, 0.3] {
        let fit = fit(&frames((0.3, read, 256.0), &[20.0, 200.0, 1000.0, 2000.0], &mut random)).unwrap();
        assert_eq!((fit.read_noise_e, fit.read_noise_dn), (None, None), "{fit:?}");
        let bound = fit.read_noise_below_e.unwrap();
        assert!((0.4 / 0.33..2.0).contains(&bound), "{bound}");
        let said = NoiseFit { noise: vec![fit], not_measured: vec![] }.verdict().sentences.concat();
        assert!(said.contains("rounding to whole DN hides it"), "{said}");
    }
}

#[test]
fn figures_verdict_and_model_belong_together() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let input = IsoInput { range: [2600.0; 3], ..rig(&mut random, 0.3, 1.5, true) };
    let noise = fit(&input).unwrap();
    assert!((noise.model.gain * noise.electrons_per_dn as f32 - 1.0).abs() < 1e-5);
    let [low, high] = noise.fixed_pattern_interval_95.unwrap();
    assert!(low < 0.01 && low < high, "{low}, {high}");
    let linearity = noise.linearity.as_ref().unwrap();
    assert!(linearity.linearity_error < 1e-9 && linearity.knee_dn.is_none(), "{linearity:?}");
    let model = noise.model;
    let fit = NoiseFit { noise: vec![noise], not_measured: vec![] };
    let verdict = fit.verdict();
    assert!(verdict.good && verdict.sentences[0].contains("electrons"), "{verdict:?}");
    let own = fit.at(Iso(100.5)).unwrap();
    assert!(own.model == model && !own.scaled);
    let other = fit.at(Iso(400.0)).unwrap();
    assert!(other.scaled && other.measured_at == Iso(100.0) && other.model.gain == 4.0 * model.gain);
    assert!(NoiseFit { noise: vec![], not_measured: vec![] }.at(Iso(100.0)).is_none());
}

#[test]
fn gain_and_read_noise_of_raws_that_are_cut_off_at_black_are_from_the_lit_frames() {
    let mut random = ChaCha8Rng::seed_from_u64(53);
    let lights = [40.0, 80.0, 160.0, 300.0, 600.0, 1200.0, 2000.0, 2600.0];
    let (mut gains, mut reads, mut bounded) = (0, 0, 0);
    for _ in 0..40 {
        let (gain, read) = (0.1 + 0.3 * random.random::<f64>(), 3.0 + 4.0 * random.random::<f64>());
        let rig = (gain, read, 0.0);
        let mut values = SensorValues::default();
        (0..2).for_each(|_| values.add(&frame(0.0, rig, &mut random), true));
        let cut = values.cut_off().unwrap();
        assert_eq!((cut.dn, cut.black), (0.0, [[0.0; 2]; 2]));
        let input = frames(rig, &lights, &mut random);
        let fit = fit(&IsoInput { cut_off_dn: Some(cut.dn), ..input }).unwrap();
        assert_eq!((fit.dark_pairs, fit.cut_off_dn, fit.dark_apart_in_errors), (0, Some(0.0), None));
        gains += inside(fit.electrons_per_dn_interval_95, 1.0 / gain);
        match (fit.read_noise_e_interval_95, fit.read_noise_below_e) {
            (Some(interval), _) => reads += inside(interval, read / gain),
            (None, bound) => bounded += usize::from(bound.unwrap() > read / gain),
        }
        let said = NoiseFit { noise: vec![fit], not_measured: vec![] }.verdict().sentences.concat();
        assert!(said.contains("cut off at 0 DN") && said.contains("intercept"), "{said}");
    }
    println!("inside, of 40: gain {gains}, read noise {reads}, bounded {bounded}");
    assert!(
        gains >= 34 && reads + bounded >= 34 && reads > 20,
        "gain {gains}, read noise {reads}, {bounded}"
    );
}

#[test]
fn dark_frames_of_a_body_that_keeps_its_black_are_whole() {
    let mut random = ChaCha8Rng::seed_from_u64(59);
    let mut values = SensorValues::default();
    values.add(&frame(0.0, (0.3, 3.0, 256.0), &mut random), true);
    values.add(&frame(900.0, (0.3, 3.0, 256.0), &mut random), false);
    assert_eq!((values.cut_off(), values.steps()), (None, Steps::WHOLE));
    assert_eq!(SensorValues::default().cut_off(), None);
}

#[test]
fn read_noise_of_raws_with_steps_is_free_of_the_steps_rounding() {
    let mut random = ChaCha8Rng::seed_from_u64(61);
    let rig = (0.3, 3.0, 256.0);
    let mut values = SensorValues::default();
    let mut shot = |light: f64, dark: bool| {
        let mut frame = frame(light, rig, &mut random);
        frame.dn.pixels_mut().iter_mut().for_each(|dn| *dn = 4 * ((*dn + 2) / 4));
        values.add(&frame, dark);
        frame
    };
    let mut pair = |light: f64| {
        let dark = light == 0.0;
        compare(&shot(light, dark), &shot(light, dark), [[256.0; 2]; 2]).unwrap()
    };
    let dark = (0..4).map(|_| pair(0.0)).collect();
    let levels = [40.0, 100.0, 300.0, 900.0, 2000.0];
    let levels = levels.map(|light| LightLevel { time: None, aperture: None, pairs: vec![pair(light)] });
    let mut bare = frames(rig, &[], &mut ChaCha8Rng::seed_from_u64(1));
    (bare.levels, bare.dark, bare.steps) = (levels.into(), dark, values.steps());
    assert_eq!(bare.steps, Steps { low: 4.0, high: 4.0 });
    let fit = fit(&bare).unwrap();
    assert_eq!((fit.step_dn, fit.companded_step_dn), (Some(4.0), None));
    // Left in, 4^2 / 12 DN^2 would make 3.21 DN of 3.
    let read = fit.read_noise_dn.unwrap();
    assert!((read - 3.0).abs() < 0.1, "{read}");
    assert_eq!(inside(fit.read_noise_e_interval_95.unwrap(), 3.0 / 0.3), 1, "{fit:?}");
    let said = NoiseFit { noise: vec![fit], not_measured: vec![] }.verdict().sentences.concat();
    assert!(said.contains("1.33 DN^2 of rounding to steps of 4.00 DN"), "{said}");
}

#[test]
fn companded_raws_colours_of_other_gain_and_isos_that_tell_nothing_are_said() {
    let mut random = ChaCha8Rng::seed_from_u64(67);
    let input = IsoInput { range: [13_000.0; 3], ..rig(&mut random, 0.3, 1.5, true) };
    let one = fit(&input).unwrap();
    assert_eq!(one.colours_apart, None);
    let steps = Steps { low: 1.0, high: 9.0 };
    let companded = fit(&IsoInput { steps, ..input }).unwrap();
    assert_eq!((companded.step_dn, companded.companded_step_dn), (None, Some(9.0)));
    let said = |noise: IsoNoise| {
        let not_measured = vec![NotMeasured { iso: Iso(800.0), why: "it snowed".into() }];
        NoiseFit { noise: vec![noise], not_measured }.verdict()
    };
    let verdict = said(companded);
    let words = verdict.sentences.concat();
    assert!(words.contains("companded") && words.contains("up to 6.8 DN^2"), "{words}");
    assert!(verdict.good && words.contains("At ISO 800 NOISE WAS NOT MEASURED: it snowed."), "{words}");
    // What is more than chance but less than sensors vary by is not worth a word.
    let mut apart = one.clone();
    (apart.colours_apart, apart.colours_apart_in_errors) = (Some(0.015), 8.0);
    assert!(!said(apart.clone()).sentences.concat().contains("colours differ"));
    apart.colours_apart = Some(0.06);
    apart.colours[0].electrons_per_dn = Some(0.95 * apart.electrons_per_dn);
    let words = said(apart).sentences.concat();
    assert!(words.contains("by up to 6.0 %") && words.contains("-5.0 % for red"), "{words}");
}

#[test]
fn what_tells_the_light_is_named() {
    let mut random = ChaCha8Rng::seed_from_u64(73);
    let given = IsoInput { range: [2600.0; 3], ..rig(&mut random, 0.3, 1.5, true) };
    let mut by_shutter = IsoInput { stops: None, ..given.clone() };
    for (k, level) in by_shutter.levels.iter_mut().enumerate() {
        level.time = Some((0.9 * k as f64).exp2());
    }
    for (input, source, words) in [
        (given, LightSource::Stops, "those given (--stops)"),
        (by_shutter, LightSource::Shutter, "the shutter's labels"),
    ] {
        let noise = fit(&input).unwrap();
        assert_eq!(noise.linearity.as_ref().unwrap().light_source, source);
        let said = NoiseFit { noise: vec![noise], not_measured: vec![] }.verdict().sentences.concat();
        assert!(said.contains(words), "{said}");
    }
}

#[test]
fn an_iso_that_cannot_be_relied_on_costs_no_other() {
    let mut random = ChaCha8Rng::seed_from_u64(71);
    let good = fit(&rig(&mut random, 0.3, 1.5, true)).unwrap();
    let bad = IsoNoise { iso: Iso(200.0), chi_squared: 3.0, ..good.clone() };
    let both = NoiseFit { noise: vec![good, bad.clone()], not_measured: vec![] };
    assert!(both.verdict().good && both.verdict().sentences.concat().contains("it is not used"));
    let at = both.at(Iso(200.0)).unwrap();
    assert!(at.scaled && at.measured_at == Iso(100.0), "{at:?}");
    let alone = NoiseFit { noise: vec![bad], not_measured: vec![] };
    assert!(!alone.verdict().good && alone.at(Iso(200.0)).is_none());
}

#[test]
fn what_cannot_be_told_is_said() {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let whole = rig(&mut random, 0.3, 1.5, false);
    let untold = fit(&IsoInput { stops: None, ..whole.clone() }).unwrap();
    assert!(untold.linearity_not_measured.as_deref().unwrap().contains("--stops"));
    let sentences = NoiseFit { noise: vec![untold], not_measured: vec![] }.verdict().sentences;
    assert!(sentences[1].starts_with("LINEARITY WAS NOT MEASURED"), "{sentences:?}");
    let none = fit(&IsoInput { levels: vec![], ..whole }).unwrap_err();
    assert!(none.to_string().contains("two light levels"), "{none}");
}
