//! Parameter recovery over random rigs.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution};

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
        for (colour, share) in [0.5, 1.0, 0.7].into_iter().enumerate() {
            for k in 0..8 {
                tiles.push(tile(colour, light * share * (1.0 + 0.02 * f64::from(k)), random));
            }
        }
        let signal = [0.5, 1.0, 0.7].map(|share| Some(Signal { mean: share * light, error: 0.0 }));
        PairTiles { tiles, signal }
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
        saturation_source: LevelSource::Measured,
        black_error: 0.0,
        stops: Some(0.9),
    }
}

#[test]
fn gain_and_read_noise_of_a_thousand_random_rigs_lie_in_their_intervals() {
    let mut random = ChaCha8Rng::seed_from_u64(17);
    let (mut gains, mut reads, mut told) = (0, 0, 0);
    for number in 0..1000 {
        let gain = 0.05 * 40f64.powf(random.random());
        let read = 0.8 * 10f64.powf(random.random());
        let fit = fit(&rig(&mut random, gain, read, number % 2 == 0)).unwrap();
        let inside = |[low, high]: [f64; 2], truth: f64| usize::from((low..=high).contains(&truth));
        gains += inside(fit.electrons_per_dn_interval, 1.0 / gain);
        if let Some(interval) = fit.read_noise_e_interval {
            told += 1;
            reads += inside(interval, read / gain);
        }
        assert!(fit.chi_squared < 1.5 && fit.rejected_share < 0.02);
    }
    let (gains, reads) = (gains as f64 / 1000.0, reads as f64 / f64::from(told));
    println!("coverage: gain {gains}, read noise {reads} of {told}");
    assert!((0.90..=0.98).contains(&gains), "gain: {gains}");
    assert!((0.90..=0.98).contains(&reads) && told > 950, "read noise: {reads} of {told}");
}

#[test]
fn figures_verdict_and_model_belong_together() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let input = IsoInput { range: [13_000.0; 3], ..rig(&mut random, 0.3, 1.5, true) };
    let noise = fit(&input).unwrap();
    assert!((noise.model.gain * noise.electrons_per_dn as f32 - 1.0).abs() < 1e-5);
    assert!(noise.fixed_pattern_interval.is_none_or(|[low, _]| low < 0.01));
    let linearity = noise.linearity.as_ref();
    assert!(linearity.is_none_or(|l| l.linearity_error < 1e-9), "{linearity:?}");
    let fit = NoiseFit { noise: vec![noise] };
    let verdict = fit.verdict();
    assert!(verdict.good && verdict.sentences[0].contains("electrons"), "{verdict:?}");
    assert!(fit.model(Some(Iso(100.5))).is_some() && fit.model(Some(Iso(200.0))).is_none());
    assert!(fit.model(None).is_none());
}

#[test]
fn what_cannot_be_told_is_said() {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let whole = rig(&mut random, 0.3, 1.5, false);
    let untold = fit(&IsoInput { stops: None, ..whole.clone() }).unwrap();
    assert!(untold.linearity_not_measured.as_deref().unwrap().contains("--stops"));
    let sentences = NoiseFit { noise: vec![untold] }.verdict().sentences;
    assert!(sentences[1].starts_with("LINEARITY WAS NOT MEASURED"), "{sentences:?}");
    let none = fit(&IsoInput { levels: vec![], ..whole }).unwrap_err();
    assert!(none.to_string().contains("two light levels"), "{none}");
}
