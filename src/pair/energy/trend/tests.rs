use super::super::tests::sync;
use super::*;
use crate::pair::order::Order;
use crate::pair::{FrameRecord, Reason, Settings};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

fn pair(number: u32, at: f64, energy: f64) -> PairRecord {
    let frame = || FrameRecord {
        file: "off.dng".into(),
        original_name: String::new(),
        bytes: 0,
        blake3: String::new(),
        settings: Settings::default(),
        polariser: None,
        jpeg: None,
    };
    let mut on = sync(true, energy);
    on.at = Some(at);
    let mut off = sync(false, 20.0);
    off.at = Some(at - 2.0);
    PairRecord {
        number,
        attempt: 1,
        name: format!("{number:04}"),
        verdict: Verdict::Accepted,
        reasons: vec![],
        order: Order::OffOn,
        off_frames: 1,
        off: frame(),
        more_off: vec![],
        on: frame(),
        after: vec![],
        crossed: None,
        lighting: Default::default(),
        drift: None,
        flash: Some(FlashRecord { off: vec![off], on: vec![on] }),
    }
}

/// Pairs at the given times, whose flash gives `energy(number, rest, time)` with 0.3 % of jitter.
fn session(times: &[f64], energy: impl Fn(usize, f64, f64) -> f64) -> Vec<PairRecord> {
    session_of(11, times, energy)
}

fn session_of(seed: u64, times: &[f64], energy: impl Fn(usize, f64, f64) -> f64) -> Vec<PairRecord> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut before = f64::NEG_INFINITY;
    times
        .iter()
        .enumerate()
        .map(|(i, &t)| {
            let gauss: f64 = StandardNormal.sample(&mut random);
            let e = 1e5 * energy(i, t - before, t) * (1.0 + 0.003 * gauss);
            before = t;
            pair(i as u32 + 1, t, e)
        })
        .collect()
}

fn of(pairs: &[PairRecord]) -> Trend {
    let records: Vec<FlashRecord> = pairs.iter().filter_map(|p| p.flash.clone()).collect();
    trend(pairs, &EnergyScale::new(&records, None, None))
}

fn codes(trend: &Trend) -> Vec<AdviceCode> {
    trend.advice.iter().map(|a| a.code).collect()
}

/// Irregular times: a photographer walks, hurries and pauses.
fn walk(n: usize) -> Vec<f64> {
    let mut t = 1.79e9;
    (0..n)
        .map(|i| {
            t += 3.0 + 4.0 * (0.5 + 0.5 * (2.7 * i as f64).sin()) + if i % 17 == 16 { 400.0 } else { 0.0 };
            t
        })
        .collect()
}

#[test]
fn a_steady_flash_needs_no_advice() {
    let trend = of(&session(&walk(40), |_, _, _| 1.0));
    assert_eq!((codes(&trend), trend.pulses.len()), (vec![], 40));
    assert!((trend.spread.unwrap() - 0.003).abs() < 0.001, "{:?}", trend.spread);
    assert_eq!((trend.recharge_loss, trend.heat_loss, trend.droop), (None, None, None));
    assert!((trend.pulses[5].rest.unwrap() - (walk(6)[5] - walk(5)[4])).abs() < 1e-3);
}

#[test]
fn chance_alone_gives_no_advice_and_hides_no_cause() {
    let times = walk(36);
    let (mut alarms, mut found) = (0, 0);
    for seed in 0..200 {
        alarms += codes(&of(&session_of(seed, &times, |_, _, _| 1.0))).len();
        let short = of(&session_of(seed, &times, |_, rest, _| 1.0 - 0.25 * (-rest / 1.2).exp()));
        found += usize::from(codes(&short) == [AdviceCode::WaitLonger]);
    }
    assert!(alarms <= 2 && found >= 190, "{alarms} false alarms, {found} of 200 found");
}

#[test]
fn a_capacitor_that_is_not_full_asks_for_longer_rests() {
    let trend = of(&session(&walk(40), |_, rest, _| 1.0 - 0.3 * (-rest / 1.4).exp()));
    assert_eq!(codes(&trend), [AdviceCode::WaitLonger], "{trend:?}");
    // 0.3 exp(-t / 1.4) = 0.003 at 6.4 s; the shortest rest was 3 s.
    let sentence = &trend.advice[0].sentence;
    let total = ["6 s from", "7 s from", "8 s from"];
    assert!(total.iter().any(|s| sentence.contains(s)), "{sentence}");
}

#[test]
fn heat_asks_for_less_power_and_a_flat_battery_for_charging() {
    let times = walk(60);
    let heat = |i: usize| (0..i).map(|j| (-(times[i] - times[j]) / 120.0).exp()).sum::<f64>();
    let hot = of(&session(&times, |i, _, _| 1.0 - 0.004 * heat(i)));
    assert_eq!(codes(&hot), [AdviceCode::LowerPower], "{hot:?}");
    let flat = of(&session(&times, |i, _, _| 1.0 - 0.0006 * i as f64));
    assert_eq!(codes(&flat), [AdviceCode::ChargeBattery], "{flat:?}");
    assert!((flat.droop.unwrap() + 0.0354).abs() < 0.005, "{:?}", flat.droop);
}

#[test]
fn heat_that_cools_more_slowly_than_the_pairs_last_counts_as_running_down() {
    let advised = |count: usize| {
        let times = walk(count);
        let heat = |i: usize| (0..i).map(|j| (-(times[i] - times[j]) / 900.0).exp()).sum::<f64>();
        of(&session(&times, |i, _, _| 1.0 - 0.0012 * heat(i)))
    };
    // 16 pairs are shot in a minute and a half, in which such a flash does not cool.
    let short = advised(16);
    assert_eq!(codes(&short), [AdviceCode::ChargeBattery], "{short:?}");
    assert!(short.advice[0].sentence.contains("hot"), "{}", short.advice[0].sentence);
    // 130 pairs take nearly an hour, pauses included.
    let long = advised(130);
    assert_eq!(codes(&long), [AdviceCode::LowerPower], "{long:?}");
}

#[test]
fn an_unsteady_flash_misfires_and_a_blind_or_dazzled_photodiode_are_told() {
    let unsteady = of(&session(&walk(30), |i, _, _| 1.0 + 0.03 * (91.7 * (i * i) as f64).sin()));
    assert_eq!(codes(&unsteady), [AdviceCode::Unsteady]);

    let mut pairs = session(&walk(20), |_, _, _| 1.0);
    for pair in &mut pairs[4..7] {
        pair.verdict = Verdict::Rejected;
        let sentence = String::new();
        pair.reasons = vec![Reason { code: ReasonCode::Misfire, figure: 0.0, limit: 1.0, sentence }];
    }
    let trend = of(&pairs);
    assert_eq!((codes(&trend), trend.misfires, trend.pulses.len()), (vec![AdviceCode::Misfires], 3, 17));

    let mut pairs = session(&walk(5), |_, _, _| 1.0);
    for pair in &mut pairs {
        pair.flash.as_mut().unwrap().on[0].clipped_samples = 4;
    }
    assert_eq!(codes(&of(&pairs)), [AdviceCode::PhotodiodeClips]);
    for pair in &mut pairs {
        let on = &mut pair.flash.as_mut().unwrap().on[0];
        (on.clipped_samples, on.lit_samples) = (0, 0);
    }
    assert_eq!(codes(&of(&pairs)), [AdviceCode::PhotodiodeBlind]);
}

#[test]
fn readings_that_scatter_in_the_dark_tell_of_flicker() {
    let mut pairs = session(&walk(12), |_, _, _| 1.0);
    for (i, pair) in pairs.iter_mut().enumerate() {
        pair.flash.as_mut().unwrap().off[0].energy_counts = if i % 2 == 0 { 600.0 } else { -600.0 };
    }
    assert_eq!(codes(&of(&pairs)), [AdviceCode::RoomFlickers]);
}

#[test]
fn an_energy_far_from_the_calibrations_asks_whether_the_photodiode_was_moved() {
    let pairs = session(&walk(5), |_, _, _| 1.0);
    let records: Vec<FlashRecord> = pairs.iter().filter_map(|p| p.flash.clone()).collect();
    let trend = trend(&pairs, &EnergyScale::new(&records, Some(1.3e5), None));
    assert_eq!(codes(&trend), [AdviceCode::CalibrateAgain]);
}
