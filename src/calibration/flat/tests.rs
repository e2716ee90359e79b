use super::*;
use crate::calibration::holds;
use crate::calibration::tiles::{EvenFrame, Tile, Tiles};
use crate::photometry::Cfa;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SIZE: (usize, usize) = (120, 80);
const GRID: (usize, usize) = (15, 10);

struct Lens {
    /// Coefficients by colour.
    curve: [[f64; 3]; 3],
    gradient: [f64; 2],
    /// Where its axis meets the frame, from the middle, in half widths and half heights.
    axis: [f64; 2],
}

fn common(curve: [f64; 3]) -> Lens {
    Lens { curve: [curve; 3], gradient: [0.0; 2], axis: [0.0; 2] }
}

/// Mean over a colour's own sites of what the lens and the light do in a tile, site by site.
fn shape(lens: &Lens, tiles: &Tiles, tile: usize, colour: usize) -> f64 {
    let [x, y] = tiles.reach(tile);
    let half = [SIZE.0 as f64 / 2.0, SIZE.1 as f64 / 2.0];
    let (mut sum, mut n) = (0.0, 0.0);
    for row in y.0..y.1 {
        for column in (x.0..x.1).filter(|&column| Cfa::RGGB.colour(column, row) == colour) {
            let place = [column as f64 + 0.5 - half[0], row as f64 + 0.5 - half[1]];
            let [x, y] = [0, 1].map(|a| place[a] - lens.axis[a] * half[a]);
            let q = (x * x + y * y) / (half[0].powi(2) + half[1].powi(2));
            let [a, b, c] = lens.curve[colour];
            let slope = lens.gradient[0] * place[0] / half[0] + lens.gradient[1] * place[1] / half[1];
            sum += 1.0 + q * (a + q * (b + q * c)) + slope;
            n += 1.0;
        }
    }
    sum / n
}

/// A frame without noise, of `light` DN in the middle, with the variances that noise would have.
fn clean(lens: &Lens, light: f64) -> Tiles {
    let mut tiles = Tiles {
        size: SIZE,
        cfa: Cfa::RGGB,
        grid: GRID,
        tiles: vec![[None; 3]; GRID.0 * GRID.1],
        over_exposed: 0.0,
        cut_off: 0.0,
    };
    for tile in 0..tiles.tiles.len() {
        tiles.tiles[tile] = std::array::from_fn(|colour| {
            let mean = light * [0.5, 1.0, 0.7][colour] * shape(lens, &tiles, tile, colour);
            let sites = [16.0, 32.0, 16.0][colour];
            Some(Tile { mean, variance: (3.0 + 0.3 * mean) / sites, sites })
        });
    }
    tiles
}

fn noisy(mut tiles: Tiles, random: &mut ChaCha8Rng) -> Tiles {
    for tile in tiles.tiles.iter_mut().flatten().flatten() {
        let draw: f64 = StandardNormal.sample(random);
        tile.mean += tile.variance.sqrt() * draw;
    }
    tiles
}

fn frame(tiles: Tiles) -> EvenFrame {
    let settings =
        Settings { aperture: Some(FNumber(8.0)), focal_length_mm: Some(45.5), ..Settings::default() };
    EvenFrame { settings, tiles }
}

#[test]
fn a_curve_without_noise_comes_back_to_the_last_digits() {
    let lens = Lens { curve: [[-0.2, 0.05, -0.03]; 3], gradient: [0.004, -0.002], axis: [0.0; 2] };
    let (fit, left_out) = fit_flat(&[frame(clean(&lens, 6000.0)), frame(clean(&lens, 3000.0))]).unwrap();
    assert!(left_out.is_empty() && fit.order == 3 && !fit.per_channel, "{fit:?}");
    for (found, truth) in fit.vignetting.coefficients[1].iter().zip([-0.2, 0.05, -0.03]) {
        assert!((found - truth).abs() < 2e-4, "{fit:?}");
    }
    assert!((fit.corner[0] - 0.82).abs() < 1e-5, "{:?}", fit.corner);
    assert!((fit.light_gradient[0] - 0.004).abs() < 2e-5, "{:?}", fit.light_gradient);
    let corner = fit.vignetting.at(SIZE, DVec2::new(0.0, 80.0), 2);
    assert!((corner - fit.corner[2]).abs() < 1e-12);
    assert_eq!(fit.vignetting.at(SIZE, DVec2::new(60.0, 40.0), 0), 1.0);
    assert_eq!((fit.residual_map.len(), fit.residual_map[0].len()), (8, 12));
}

#[test]
fn a_thousand_random_lenses_have_their_corner_inside_its_interval() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let (mut inside, mut slopes, mut orders) = (0u32, 0u32, [0u32; 4]);
    for _ in 0..1000 {
        let mut draw = |range: std::ops::Range<f64>| random.random_range(range);
        let curve = [draw(-0.4..0.0), draw(-0.1..0.1), draw(-0.03..0.03)];
        // Lenses of each order.
        let order = draw(0.0..4.0) as usize;
        let curve = std::array::from_fn(|n| if n < order { curve[n] } else { 0.0 });
        let lens = Lens { curve: [curve; 3], gradient: [draw(-0.005..0.005), 0.0], axis: [0.0; 2] };
        let plain = clean(&lens, draw(500.0..8000.0));
        let truth = 1.0 + curve.iter().sum::<f64>();
        let (fit, _) = fit_flat(&[frame(noisy(plain, &mut random))]).unwrap();
        orders[fit.order] += 1;
        inside += u32::from(holds(fit.corner_interval_95[1], truth));
        slopes += u32::from(holds(fit.light_gradient_interval_95[0], lens.gradient[0]));
    }
    println!("corner {inside}, slope {slopes} of 1000 inside; orders {orders:?}");
    assert!((900..=980).contains(&inside), "{inside}");
    assert!((900..=980).contains(&slopes), "{slopes}");
}

#[test]
fn colours_have_their_own_curves_where_they_differ_and_one_where_they_do_not() {
    let mut random = ChaCha8Rng::seed_from_u64(12);
    let curve = |a: f64| [a, -0.02, 0.0];
    let lens = Lens { curve: [curve(-0.11), curve(-0.10), curve(-0.08)], gradient: [0.0; 2], axis: [0.0; 2] };
    let frames: Vec<EvenFrame> = (0..20).map(|_| frame(noisy(clean(&lens, 8000.0), &mut random))).collect();
    let (fit, _) = fit_flat(&frames).unwrap();
    assert!(fit.per_channel, "{:?}", fit.f_values);
    for (corner, truth) in fit.corner.iter().zip([0.87, 0.88, 0.90]) {
        assert!((corner - truth).abs() < 0.002, "{:?}", fit.corner);
    }
    let frames: Vec<EvenFrame> =
        (0..20).map(|_| frame(noisy(clean(&common([-0.11, -0.02, 0.0]), 8000.0), &mut random))).collect();
    let (fit, _) = fit_flat(&frames).unwrap();
    assert!(!fit.per_channel && fit.order == 2, "{:?}", fit.f_values);
    let verdict = fit.verdict(0);
    assert!(verdict.good && verdict.sentences[0].contains("one curve for all colours"), "{verdict:?}");
    let json = serde_json::to_value(&fit).unwrap();
    assert_eq!(serde_json::from_value::<FlatCalibration>(json).unwrap(), fit);
}

#[test]
fn uneven_light_and_dust_are_told() {
    let mut random = ChaCha8Rng::seed_from_u64(13);
    let lens = Lens { curve: [[-0.1, 0.0, 0.0]; 3], gradient: [0.03, 0.0], axis: [0.0; 2] };
    let (fit, _) = fit_flat(&[frame(noisy(clean(&lens, 8000.0), &mut random))]).unwrap();
    let told = fit.verdict(0);
    assert!(
        !told.good && told.sentences.iter().any(|s| s.contains("3.0 %") && s.contains("right")),
        "{told:?}"
    );

    let mut dusty = clean(&common([-0.1, 0.0, 0.0]), 8000.0);
    dusty.tiles[3 * GRID.0 + 4].iter_mut().flatten().for_each(|tile| tile.mean *= 0.9);
    let (fit, _) = fit_flat(&[frame(noisy(dusty, &mut random))]).unwrap();
    let told = fit.verdict(0);
    assert!(told.sentences.iter().any(|s| s.contains("dust")), "{told:?}");
}

#[test]
fn frames_that_tell_nothing_are_refused_with_their_reason() {
    let lens = common([-0.1, 0.0, 0.0]);
    let good = || clean(&lens, 5000.0);
    let mut over = good();
    over.over_exposed = 0.4;
    over.tiles[0] = [None; 3];
    let dark =
        Tiles { tiles: vec![[Some(Tile { mean: 0.01, variance: 1.0, sites: 16.0 }); 3]; 150], ..good() };
    let (fit, left_out) = fit_flat(&[frame(over.clone()), frame(good()), frame(dark)]).unwrap();
    assert_eq!((fit.frames, left_out.len()), (1, 2));
    assert!(
        left_out[0].1.contains("over-exposed in 40 %") && left_out[1].1.contains("too dark"),
        "{left_out:?}"
    );
    assert!(fit_flat(&[]).is_err());
    let error = fit_flat(&[frame(over)]).unwrap_err().to_string();
    assert!(error.contains("over-exposed"), "{error}");
    // A spot of light on a dark wall.
    let spot = frame(clean(&common([-1.2, 0.2, 0.0]), 8000.0));
    assert!(matches!(fit_flat(&[spot]), Err(FlatFitError::Uneven(_))));
    let rig = Rig { model: Some("A".into()), lens: Some("50 mm".into()), ..Rig::default() };
    let refused = |change: &dyn Fn(&mut Settings)| {
        let mut settings = frame(good()).settings;
        change(&mut settings);
        fit.fits(&rig, &settings).map_err(|other| other.what)
    };
    assert_eq!(refused(&|_| ()), Ok(()));
    assert_eq!(refused(&|s| s.model = Some("B".into())), Err("camera model"));
    assert_eq!(refused(&|s| s.lens = Some("85 mm".into())), Err("lens"));
    assert_eq!(refused(&|s| s.focal_length_mm = Some(50.0)), Err("focal length"));
    assert_eq!(refused(&|s| s.aperture = Some(FNumber(9.0))), Err("aperture"));
    let mut other = frame(good());
    other.settings.aperture = Some(FNumber(5.6));
    let error = fit_flat(&[frame(good()), other.clone()]).unwrap_err().to_string();
    assert!(error.contains("frame 2: its aperture is \"f/5.6\""), "{error}");
}

#[test]
fn a_lens_whose_axis_lies_beside_the_middle_is_told_about_its_axis() {
    // The axis lies 1 % of the frame beside the middle either way, so that the corners are not alike: that goes into the
    // light's slope, and what is left is the curve about the axis.
    for curve in [[-0.11, -0.02, 0.0], [-0.35, 0.05, 0.0], [-0.6, 0.2, -0.05]] {
        let lens = Lens { axis: [0.02; 2], ..common(curve) };
        let (fit, _) = fit_flat(&[frame(clean(&lens, 8000.0))]).unwrap();
        let worst = [0.2, 0.5, 1.0].map(|q: f64| {
            let truth = 1.0 + q * (curve[0] + q * (curve[1] + q * curve[2]));
            (fit.vignetting.at_q(q, 1) / truth - 1.0).abs()
        });
        let worst = worst.into_iter().fold(0.0, f64::max);
        println!("{curve:?}: {:.4} % off, slope {:?}", 100.0 * worst, fit.light_gradient);
        assert!(worst < 0.001 && fit.light_gradient[0].abs() > 0.002, "{curve:?}: {worst}");
    }
}
