//! What noise makes of card shots, and what the model misses, are told apart.

use super::card::field_q;
use super::tests::{NOISE, fit, intrinsics, light, ring};
use super::{CardShot, Plane};
use crate::photometry::{Cfa, LevelSource, Levels, Mosaic};
use crate::raster::Image;
use glam::DVec2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A dim card on a small frame: 5 % of noise in a cell. `grain` is what a card's paper adds, relative.
fn dim(distance: f64, grain: f64, rng: &mut ChaCha8Rng) -> CardShot {
    let (lens, plane) = (intrinsics(), Plane::facing(distance));
    let mut gauss = || -> f64 { StandardNormal.sample(rng) };
    let dn = Image::from_fn(240, 160, |x, y| {
        let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let paper = 1.0 + if (x / 8 + y / 8) % 2 == 0 { grain } else { -grain };
        let v = paper * 2.2e3 * light(&ring(), &plane, pixel) * (1.0 - 0.1 * field_q(&lens, pixel));
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

#[test]
fn noise_of_dim_shots_does_not_make_a_calibration_bad_and_a_blotched_card_does() {
    let series = |grain: f64| {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let shots: Vec<CardShot> =
            [0.5, 0.8, 1.2].into_iter().flat_map(|d| [d; 3]).map(|d| dim(d, grain, &mut rng)).collect();
        fit(&shots).unwrap()
    };
    let (noisy, blotched) = (series(0.0), series(0.06));
    let noises = noisy.residual_rms;
    assert!(noises > 0.04 && noisy.misfit_rms < 0.3 * noises && noisy.verdict(false).good, "{noisy:?}");
    assert!(!blotched.verdict(false).good && blotched.misfit_rms > 0.03, "{blotched:?}");
}
