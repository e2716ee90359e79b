use super::*;
use crate::raster::Rgb;
use crate::reflectance::projection::tests::{SIZE, flat_view};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const WHITE: f32 = 4000.0;
const NOISE: f32 = 20.0;

/// A texture with structure at all scales.
fn painted() -> Texels {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let value = |i: usize, rng: &mut ChaCha8Rng| {
        let (x, y) = ((i % SIZE) as f32, (i / SIZE) as f32);
        let wave = 0.5 + 0.2 * (x * 0.5).sin() * (y * 0.4).cos();
        [wave, 0.8 * wave, 0.6 * wave].map(|v: f32| v + 0.1 * (rng.random::<f32>() - 0.5))
    };
    (0..SIZE * SIZE).map(|i| value(i, &mut rng)).collect()
}

/// Photographs of it through a lens, with noise and pulses of these energies.
fn photographs(truth: &Texels, gains: &[f64], blur: [f32; 3]) -> Vec<Photo> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let photo = |(k, gain): (usize, &f64)| {
        let mut projection = flat_view(k, WHITE);
        let lit: Rgb = projection.predict(truth, true, blur);
        for (site, lit) in projection.sites.pixels_mut().iter_mut().zip(lit.pixels()) {
            let uniform: f32 = (0..12).map(|_| rng.random::<f32>()).sum::<f32>() - 6.0;
            site.known = *gain as f32 * lit[usize::from(site.colour)] + NOISE * uniform;
            site.variance = NOISE * NOISE;
        }
        Photo { projection, gain: FlashGain { value: 1.0, deviation: 0.01 }, found: None }
    };
    gains.iter().enumerate().map(photo).collect()
}

/// Solves for the texels that the photographs speak of; the others stay as they start.
fn solve(mut photos: Vec<Photo>, start: &Texels, blur: Option<[f32; 3]>) -> Joint {
    let ground = Ground::number(SIZE, photos.iter_mut().map(|p| &mut p.projection));
    let own = ground.texels.iter().map(|&t| start[t as usize]).collect();
    let mut joint = solve_jointly(&photos, &ground, own, blur, 0.0, &Progress::silent()).unwrap();
    let mut all = start.clone();
    for (&at, rho) in ground.texels.iter().zip(&joint.texels) {
        all[at as usize] = *rho;
    }
    joint.texels = all;
    joint
}

fn rms(a: &Texels, b: &Texels, border: usize) -> f32 {
    let inside = |i: &usize| {
        let (x, y) = (i % SIZE, i / SIZE);
        x >= border && y >= border && x + border < SIZE && y + border < SIZE
    };
    let all: Vec<f32> = (0..SIZE * SIZE)
        .filter(inside)
        .flat_map(|i| (0..3).map(move |c| (a[i][c] - b[i][c]).powi(2)))
        .collect();
    (all.iter().sum::<f32>() / all.len() as f32).sqrt()
}

#[test]
fn carrying_back_is_the_transpose_of_looking() {
    let mut view = flat_view(1, WHITE);
    let ground = Ground::number(SIZE, std::iter::once(&mut view));
    let texture: Texels = ground.texels.iter().map(|&t| painted()[t as usize]).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let image = view.blank().map(|p| p.map(|_| rng.random::<f32>() - 0.5));
    let seen = view.pixels(&texture, false);
    let mut back = vec![[0.0; 3]; texture.len()];
    view.carry_back(&ground, &image, &mut back);
    for c in 0..3 {
        let there: f64 =
            seen.pixels().iter().zip(image.pixels()).map(|(a, b)| f64::from(a[c]) * f64::from(b[c])).sum();
        let here: f64 = texture.iter().zip(&back).map(|(a, b)| f64::from(a[c]) * f64::from(b[c])).sum();
        assert!((there - here).abs() < 1e-3 * there.abs().max(1.0), "{there} {here}");
    }
}

#[test]
fn texture_energies_and_the_lens_blur_come_back_from_noisy_photographs() {
    let (truth, blur) = (painted(), [1.1; 3]);
    let gains = [1.0, 0.985, 1.012, 1.003, 0.995, 1.005];
    let photos = photographs(&truth, &gains, blur);
    let start = vec![[0.45, 0.36, 0.27]; truth.len()];
    let found = solve(photos, &start, None);
    for (c, found) in found.blur.iter().enumerate() {
        assert!((found - blur[c]).abs() < 0.2, "blur {found} of colour {c}");
    }
    let mean = |all: &mut dyn Iterator<Item = f64>| all.sum::<f64>() / gains.len() as f64;
    let common = mean(&mut found.gains.iter().map(|g| g.value)) / mean(&mut gains.iter().copied());
    for (found, gain) in found.gains.iter().zip(gains) {
        assert!((found.value / common - gain).abs() < 0.002, "{} for {gain}", found.value / common);
    }
    assert!((common - 1.0).abs() < 0.005, "{common}");
    // As the lens shows it: finer detail than that no photograph tells.
    let seen = |texels: &Texels| -> Texels {
        let picture = flat_view(0, WHITE).predict(texels, false, blur);
        picture.pixels().iter().map(|p| p.map(|v| v / WHITE)).collect()
    };
    let (before, after) = (rms(&seen(&start), &seen(&truth), 8), rms(&seen(&found.texels), &seen(&truth), 8));
    assert!(after < 0.1 * before && after < 0.01, "{before} {after}");
    assert!(found.runs.windows(2).all(|r| r[1].misfit < 1.05 * r[0].misfit), "{:?}", found.runs);
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let truth = painted();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let start = vec![[0.4; 3]; truth.len()];
        pool.install(|| solve(photographs(&truth, &[1.0, 0.99, 1.01], [0.9; 3]), &start, None))
    };
    let (one, three) = (on(1), on(3));
    assert_eq!(one.texels, three.texels);
    assert_eq!((one.blur, one.runs), (three.blur, three.runs));
}

#[test]
fn a_view_in_which_everything_is_clipped_changes_nothing() {
    let truth = painted();
    let mut photos = photographs(&truth, &[1.0, 1.0], [0.8; 3]);
    let start = vec![[0.4; 3]; truth.len()];
    let without = solve(photographs(&truth, &[1.0, 1.0], [0.8; 3]), &start, None);
    let mut blown = photographs(&truth, &[1.0, 1.0, 1.0], [0.8; 3]).pop().unwrap();
    blown.projection.sites.pixels_mut().iter_mut().for_each(|s| s.variance = f32::INFINITY);
    photos.push(blown);
    let with = solve(photos, &start, None);
    assert!(rms(&with.texels, &without.texels, 0) < 2e-3, "{}", rms(&with.texels, &without.texels, 0));
}

#[test]
fn energies_and_blur_that_another_part_has_told_stay_as_they_are() {
    let truth = painted();
    let mut photos = photographs(&truth, &[1.0, 1.02, 0.98], [0.9; 3]);
    let told = FlashGain { value: 1.02, deviation: 0.001 };
    photos[1].found = Some(told);
    let found = solve(photos, &vec![[0.4; 3]; truth.len()], Some([0.9; 3]));
    assert_eq!((found.gains[1], found.blur), (told, [0.9; 3]));
    for (found, gain) in found.gains.iter().zip([1.0, 1.02, 0.98]) {
        assert!((found.value - gain).abs() < 0.004, "{} for {gain}", found.value);
    }
}
