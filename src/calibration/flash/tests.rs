use super::*;
use crate::photometry::{Cfa, LevelSource, Levels, Mosaic};
use crate::raster::Image;
use crate::scene::{Camera, Distortion};
use card::field_q;
use glam::{DAffine3, DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::f64::consts::PI;

const NOISE: NoiseModel = NoiseModel { gain: 0.3, floor: 2.0 };

fn intrinsics() -> Intrinsics {
    Intrinsics {
        width: 240,
        height: 160,
        focal: DVec2::splat(300.0),
        principal: DVec2::new(120.0, 80.0),
        distortion: Distortion::default(),
    }
}

fn ring() -> Ring {
    Ring::new(0.035, 0.085).unwrap()
}

/// What a card of reflectance 0.94 reads at a pixel, per unit radiance, before the field.
fn light(ring: &Ring, plane: &Plane, pixel: DVec2) -> f64 {
    let camera =
        Camera { name: String::new(), intrinsics: intrinsics(), world_from_camera: DAffine3::IDENTITY };
    let point = plane.meets(camera.ray(pixel)).unwrap();
    ring.irradiance(point, plane.normal) * 0.94 / PI
}

/// A frame without noise but for rounding, 64 DN finer than a sensor's so that it does not show.
fn shot(distance: f64, gain: f64, clip: f64) -> CardShot {
    let (lens, plane) = (intrinsics(), Plane::facing(distance));
    let dn = Image::from_fn(240, 160, |x, y| {
        let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let q = field_q(&lens, pixel);
        let r = [2.0e5, 4.0e5, 2.5e5][Cfa::RGGB.colour(x, y)];
        let v = gain * r * (1.0 - 0.11 * q - 0.02 * q * q) * light(&ring(), &plane, pixel);
        (1000.0 + v.min(clip)).round() as u16
    });
    let levels = Levels {
        black: [[1000.0; 2]; 2],
        saturation: [[(1000.0 + clip) as f32; 2]; 2],
        black_source: LevelSource::FileTag,
        saturation_source: LevelSource::FileTag,
    };
    let frame = Mosaic { dn, cfa: Cfa::RGGB, levels };
    CardShot::reduce(format!("{distance}"), plane, &frame, None).unwrap()
}

fn fit(shots: &[CardShot]) -> Result<FlashCalibration, FlashFitError> {
    let (intrinsics, target) = (intrinsics(), Target::lambertian(0.94));
    let facts =
        FlashFacts { intrinsics: &intrinsics, ring: ring(), target: &target, noise: NOISE, vignetting: None };
    fit_flash(shots, &facts)
}

#[test]
fn radiance_and_field_factor_of_synthetic_cards_come_back() {
    let shots = [shot(0.5, 1.0, 2e4), shot(0.8, 1.003, 2e4), shot(1.2, 0.997, 2e4)];
    let fit = fit(&shots).unwrap();
    for (got, want) in fit.radiance.iter().zip([2.0e5, 4.0e5, 2.5e5]) {
        assert!((got / want - 1.0).abs() < 2e-3, "{:?}", fit.radiance);
    }
    for q in [0.1, 0.5, 0.9] {
        let want = 1.0 - 0.11 * q - 0.02 * q * q;
        assert!((fit.field.at_q(q) - want).abs() < 1e-3, "{:?}", fit.field);
    }
    assert!(fit.rms < 1e-3 && fit.cards[1].gain > fit.cards[2].gain);
    assert!(fit.findings.offset_m.unwrap().holds(0.0), "{:?}", fit.findings);
    assert!(fit.findings.second_render_ratio.iter().all(|r| (r - 1.0).abs() < 2e-4), "{:?}", fit.findings);
}

#[test]
fn measured_energies_take_the_flashs_jitter_out_of_the_radiance() {
    let gains = [1.0, 1.02, 0.96];
    let mut shots: Vec<CardShot> =
        [0.5, 0.8, 1.2].into_iter().zip(gains).map(|(d, gain)| shot(d, gain, 2e4)).collect();
    let untold = fit(&shots).unwrap();
    assert_eq!(untold.energy_counts, None);
    shots.iter_mut().zip(gains).for_each(|(s, g)| s.energy_counts = Some(1e5 * g));
    let told = fit(&shots).unwrap();
    // The mean energy is 0.9933 of that to which the radiances below belong.
    assert!((told.energy_counts.unwrap() / 0.99333e5 - 1.0).abs() < 1e-4);
    for (got, want) in told.radiance.iter().zip([2.0e5, 4.0e5, 2.5e5]) {
        assert!((got / (0.99333 * want) - 1.0).abs() < 1e-3, "{:?}", told.radiance);
    }
    let error = |fit: &FlashCalibration| fit.radiance_error.unwrap()[1] / fit.radiance[1];
    assert!(error(&untold) > 0.01 && error(&told) < 0.001, "{} {}", error(&untold), error(&told));
    let shot = &told.cards[1];
    assert!((shot.gain / shot.measured_gain.unwrap() - 1.0).abs() < 1e-3, "{shot:?}");
    shots[2].energy_counts = None;
    assert_eq!(fit(&shots).unwrap().energy_counts, None);
}

#[test]
fn an_overexposed_shot_is_left_out_with_the_reason_and_a_series_of_them_refused() {
    let error = fit(&[shot(0.5, 1.0, 100.0)]).unwrap_err();
    assert!(error.to_string().contains("over-exposed"), "{error}");
    let fitted = fit(&[shot(0.5, 1.0, 3e3), shot(1.0, 1.0, 3e3), shot(1.5, 1.0, 3e3)]).unwrap();
    assert!(!fitted.cards[0].used && fitted.cards[1].used);
    assert!(fitted.cards[0].left_out.as_ref().unwrap().starts_with("over-exposed"), "{:?}", fitted.cards[0]);
    let verdict = fitted.verdict(true);
    assert!(verdict.sentences.iter().any(|s| s.contains("over-exposed")), "{verdict:?}");
    assert!(verdict.sentences.iter().any(|s| s.contains("not Lambertian")), "{verdict:?}");
}

#[test]
fn impossible_targets_and_places_are_refused() {
    let intrinsics = intrinsics();
    let refused = |target: Target, shots: &[CardShot]| {
        let facts = FlashFacts {
            intrinsics: &intrinsics,
            ring: ring(),
            target: &target,
            noise: NOISE,
            vignetting: None,
        };
        fit_flash(shots, &facts).unwrap_err()
    };
    assert_eq!(refused(Target::lambertian(1.4), &[]), FlashFitError::Reflectance(1.4));
    let curve = vec![[0.3, 1.0], [0.2, 0.9]];
    assert_eq!(refused(Target { reflectance: 0.9, curve }, &[]), FlashFitError::Curve);
    let mut away = shot(1.0, 1.0, 2e4);
    away.plane.normal = DVec3::Z;
    assert!(matches!(refused(Target::lambertian(0.9), &[away]), FlashFitError::Plane { .. }));
    assert!(matches!(refused(Target::lambertian(0.9), &[]), FlashFitError::Nothing(_)));
}

#[test]
fn a_single_shot_is_corrected_as_in_the_thesis_and_a_second_render_agrees() {
    let fitted = fit(&[shot(1.0, 1.0, 2e4)]).unwrap();
    assert!(fitted.findings.offset_m.is_none() && fitted.findings.jitter_assumed);
    assert!(
        fitted.findings.second_render_ratio.iter().all(|r| (r - 1.0).abs() < 2e-4),
        "{:?}",
        fitted.findings
    );
    assert!((fitted.radiance[1] / 4e5 - 1.0).abs() < 2e-3, "{:?}", fitted.radiance);
}

/// A rig whose figures are drawn at random, and its shots as cells with noise.
struct Drawn {
    ring: Ring,
    ruler: Ring,
    radiance: [f64; 3],
    field: [f64; 3],
    shots: Vec<CardShot>,
}

fn draw(seed: u64, lobe: bool) -> Drawn {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let inner = random.random_range(0.0..0.05);
    let ruler = Ring::new(inner, inner + random.random_range(0.02..0.08)).unwrap();
    let exponent = if lobe { random.random_range(0.0..1.5) } else { 0.0 };
    let ring = ruler.placed(random.random_range(-0.04..0.04), exponent);
    let green = 10f64.powf(random.random_range(5.3..5.8));
    let radiance = [0.6 * green, green, 0.7 * green];
    let field = [random.random_range(-0.3..0.0), random.random_range(-0.1..0.1), 0.0];
    let factor = FieldFactor { coefficients: field };
    let jitter = random.random_range(0.001..0.006);
    let count = random.random_range(6..12usize);
    let mut gauss = {
        let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0xabcd_ef01);
        move || -> f64 { StandardNormal.sample(&mut random) }
    };
    let mut shots = vec![];
    for i in 0..count {
        let distance = random.random_range(0.5..2.0);
        let tilt = [random.random_range(-0.3..0.3), random.random_range(-0.3..0.3)];
        let plane =
            Plane { point: distance * DVec3::Z, normal: DVec3::new(tilt[0], tilt[1], -1.0).normalize() };
        let energy = 1.0 + jitter * gauss();
        let mut cells = vec![];
        for (x, y) in (0..6).flat_map(|x| (0..4).map(move |y| (x, y))) {
            let centre = DVec2::new(20.0 + 40.0 * x as f64, 20.0 + 40.0 * y as f64);
            let g = factor.at(&intrinsics(), centre);
            let unit = energy * g * light(&ring, &plane, centre);
            let mut cell = Cell { centre, value: [0.0; 3], signal: [0.0; 3], sites: [64.0, 128.0, 64.0] };
            for c in 0..3 {
                let value = radiance[c] * unit;
                let variance = (0.3 * value + 2.0) / cell.sites[c];
                cell.value[c] = value + variance.sqrt() * gauss();
                cell.signal[c] = cell.value[c].max(0.0);
            }
            cells.push(cell);
        }
        shots.push(CardShot {
            label: format!("{i}"),
            plane,
            size: (240, 160),
            cfa: Cfa::RGGB,
            edge: 0,
            cells,
            floors: 1.0,
            clipped: 0.0,
            energy_counts: None,
            held_out: false,
        });
    }
    Drawn { ring, ruler, radiance, field, shots }
}

#[test]
fn intervals_hold_the_truth_of_a_thousand_rigs_as_often_as_they_say() {
    const RIGS: u64 = 1000;
    let held: Vec<[Option<bool>; 4]> = (0..RIGS)
        .into_par_iter()
        .map(|seed| {
            // Every second rig's vignetting is given, and it has a lobe.
            let given = seed % 2 == 1;
            let drawn = draw(seed, given);
            let (intrinsics, target) = (intrinsics(), Target::lambertian(0.94));
            let facts = FlashFacts {
                intrinsics: &intrinsics,
                ring: drawn.ruler,
                target: &target,
                noise: NOISE,
                vignetting: given.then_some(FieldFactor { coefficients: drawn.field }),
            };
            let fit = fit_flash(&drawn.shots, &facts).unwrap_or_else(|e| panic!("rig {seed}: {e}"));
            let found = &fit.findings;
            [
                found.radiance_dn.map(|r| r[1].holds(drawn.radiance[1])),
                found.offset_m.map(|o| o.holds(drawn.ring.offset)),
                found.lobe_exponent.map(|l| l.holds(drawn.ring.lobe)),
                found.distance_exponent.map(|p| p.holds(2.0)),
            ]
        })
        .collect();
    for (figure, name) in ["radiance", "offset", "lobe", "exponent"].into_iter().enumerate() {
        let told: Vec<bool> = held.iter().filter_map(|h| h[figure]).collect();
        let share = told.iter().filter(|h| **h).count() as f64 / told.len() as f64;
        println!("{name}: {:.1} % of {} intervals hold the truth", 100.0 * share, told.len());
        assert!(told.len() > 300, "{name} is told {} times only", told.len());
        assert!((0.90..=0.98).contains(&share), "{name}: {share}");
    }
}

#[test]
fn held_out_shots_are_predicted_and_a_wrong_law_is_told() {
    let mut drawn = draw(2, false);
    drawn.shots[1].held_out = true;
    let (intrinsics, target) = (intrinsics(), Target::lambertian(0.94));
    let facts = FlashFacts {
        intrinsics: &intrinsics,
        ring: drawn.ruler,
        target: &target,
        noise: NOISE,
        vignetting: None,
    };
    let fit = fit_flash(&drawn.shots, &facts).unwrap();
    assert!(!fit.cards[1].used && fit.cards[1].held_out);
    assert!(fit.findings.held_out_error.unwrap() < 0.02, "{:?}", fit.findings);
    for shot in &mut drawn.shots {
        let wrong = shot.plane.distance().powf(0.1);
        shot.cells.iter_mut().for_each(|cell| cell.value = cell.value.map(|v| v * wrong));
    }
    let law = fit_flash(&drawn.shots, &facts).unwrap().findings.distance_exponent.unwrap();
    assert!(law.holds(1.9) && !law.holds(2.0), "{law:?}");
}
