//! What noise makes of card shots, and what the model misses, are told apart.

use super::card::field_q;
use super::tests::{NOISE, fit, intrinsics, light, ring};
use super::{CardShot, FlashCalibration, Plane};
use crate::photometry::{Cfa, LevelSource, Levels, Mosaic};
use crate::raster::Image;
use glam::DVec2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A card on a small frame, whose cells have much noise. `grain` is what the card's paper adds, relative.
fn shot(radiance: f64, distance: f64, grain: f64, rng: &mut ChaCha8Rng) -> CardShot {
    let (lens, plane) = (intrinsics(), Plane::facing(distance));
    let mut gauss = || -> f64 { StandardNormal.sample(rng) };
    let dn = Image::from_fn(240, 160, |x, y| {
        let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let paper = 1.0 + if (x / 8 + y / 8) % 2 == 0 { grain } else { -grain };
        let v = paper * radiance * light(&ring(), &plane, pixel) * (1.0 - 0.1 * field_q(&lens, pixel));
        (1000.0 + v + (f64::from(NOISE.gain) * v + f64::from(NOISE.floor)).sqrt() * gauss()).round() as u16
    });
    let levels = Levels {
        black: [[1000.0; 2]; 2],
        saturation: [[9000.0; 2]; 2],
        black_source: LevelSource::FileTag,
        saturation_source: LevelSource::FileTag,
    };
    let frame = Mosaic { dn, cfa: Cfa::RGGB, levels };
    CardShot::reduce(format!("{distance}"), plane, &frame, None).unwrap()
}

/// Three shots each at three distances.
fn series(radiance: f64, distances: [f64; 3], grain: f64) -> FlashCalibration {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let places = distances.into_iter().flat_map(|d| [d; 3]);
    fit(&places.map(|d| shot(radiance, d, grain, &mut rng)).collect::<Vec<_>>()).unwrap()
}

#[test]
fn noise_of_dim_shots_does_not_make_a_calibration_bad_and_a_blotched_card_does() {
    let [noisy, blotched] = [0.0, 0.06].map(|grain| series(2.2e3, [0.5, 0.8, 1.2], grain));
    let noises = noisy.residual_rms;
    assert!(noises > 0.04 && noisy.misfit_rms < 0.3 * noises && noisy.verdict(false).good, "{noisy:?}");
    assert!(!blotched.verdict(false).good && blotched.misfit_rms > 0.03, "{blotched:?}");
}

#[test]
fn a_misfit_is_told_as_large_as_it_is_among_bright_and_dim_shots() {
    let mixed = series(6e4, [0.3, 0.8, 2.4], 0.01);
    println!("residual {}, misfit {}", mixed.residual_rms, mixed.misfit_rms);
    assert!(mixed.residual_rms > 0.014 && (mixed.misfit_rms - 0.01).abs() < 0.002, "{mixed:?}");
}
