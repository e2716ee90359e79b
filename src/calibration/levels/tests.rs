//! Levels of simulated sensors.

use super::*;
use crate::calibration::Rig;
use crate::codec::raw::Masked;
use crate::photometry::{Cfa, LevelSource, Levels, Mosaic};
use crate::raster::Image;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

const BLACK: [f64; 4] = [2047.2, 2048.0, 2048.4, 2049.1];

fn frame(dn: Image<u16>) -> Mosaic {
    let levels = Levels {
        black: [[2000.0; 2]; 2],
        saturation: [[15_000.0; 2]; 2],
        black_source: LevelSource::DecoderTable,
        saturation_source: LevelSource::DecoderTable,
    };
    Mosaic { dn, cfa: Cfa::RGGB, levels }
}

/// A dark frame: read noise, three hot sites of which one flickers.
fn dark(random: &mut ChaCha8Rng, noise: f64, index: usize) -> Mosaic {
    let normal = Normal::new(0.0, noise).unwrap();
    let mut dn = Image::from_fn(160, 120, |x, y| {
        (BLACK[2 * (y & 1) + (x & 1)] + normal.sample(random)).round() as u16
    });
    *dn.at_mut(10, 10) = 9000;
    *dn.at_mut(31, 7) = 2400;
    if index == 0 {
        *dn.at_mut(80, 81) = 5000;
    }
    frame(dn)
}

#[test]
fn hot_sites_are_counted_and_move_nothing() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
    (0..4).for_each(|i| sums.add_dark(&dark(&mut random, 2.0, i)).unwrap());
    let levels = sums.levels();
    assert_eq!((levels.hot_sites, levels.dark_frames), (Some(2), 4));
    for (site, black) in levels.sites.iter().zip(BLACK) {
        assert!((site.black_dn.unwrap() - black).abs() < 0.08, "{site:?}");
        assert!((site.read_noise_dn.unwrap() - 2.0).abs() < 0.08, "{site:?}");
    }
}

#[test]
fn black_and_read_noise_of_a_thousand_random_sensors_lie_in_their_intervals() {
    let mut random = ChaCha8Rng::seed_from_u64(12);
    let (mut black, mut noise, mut sites, mut told) = (0, 0, 0.0, 0.0);
    for _ in 0..1000 {
        let read = 0.45 * 20f64.powf(random.random());
        let truth: [f64; 4] = std::array::from_fn(|_| 500.0 + random.random::<f64>());
        // Whole frames wander by up to twice what the sites' scatter makes of a mean.
        let wander = 2.0 * random.random::<f64>() * read / 480f64.sqrt();
        let (read_noise, wandering) = (Normal::new(0.0, read).unwrap(), Normal::new(0.0, wander).unwrap());
        let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
        for _ in 0..2 + 2 * random.random_range(0..3) {
            let wandered = wandering.sample(&mut random);
            let dn = Image::from_fn(48, 40, |x, y| {
                let mean = truth[2 * (y & 1) + (x & 1)] + wandered;
                (mean + read_noise.sample(&mut random)).round() as u16
            });
            let mut frame = frame(dn);
            frame.levels.black = [[500.0; 2]; 2];
            sums.add_dark(&frame).unwrap();
        }
        // One position only: all four wander together.
        let site = &sums.levels().sites[0];
        let inside = |interval: Option<[f64; 2]>, truth: f64| {
            interval.is_some_and(|[low, high]| (low..=high).contains(&truth))
        };
        assert_eq!((site.cut_off_dn, site.step_dn), (None, None), "{site:?}");
        sites += 1.0;
        black += usize::from(inside(site.black_dn_interval_95, truth[0]));
        match site.read_noise_below_dn {
            Some(bound) => assert!(bound > 0.95 * read && site.read_noise_dn.is_none(), "{read}: {site:?}"),
            None => {
                told += 1.0;
                noise += usize::from(inside(site.read_noise_dn_interval_95, read));
            }
        }
    }
    let (black, noise) = (black as f64 / sites, noise as f64 / told);
    println!("coverage: black {black}, read noise {noise} of {told}");
    assert!((0.90..=0.98).contains(&black), "black: {black}");
    assert!((0.90..=0.98).contains(&noise) && told > 900.0, "read noise: {noise} of {told}");
}

#[test]
fn read_noise_that_rounding_hides_is_bounded_and_not_told() {
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
    let normal = Normal::new(0.0f64, 0.2).unwrap();
    for _ in 0..2 {
        let dn = Image::from_fn(80, 60, |_, _| (2048.3 + normal.sample(&mut random)).round() as u16);
        sums.add_dark(&frame(dn)).unwrap();
    }
    let fit = LevelsFit { levels: vec![sums.levels()], not_measured: vec![] };
    let site = &fit.levels[0].sites[2];
    assert_eq!((site.read_noise_dn, site.read_noise_below_dn), (None, Some(0.4)));
    // The mean of rounded values lies at 2048.16; its interval knows.
    let [low, high] = site.black_dn_interval_95.unwrap();
    assert!((low..=high).contains(&2048.3) && high - low < 1.1, "{site:?}");
    assert!(fit.verdict().sentences[0].contains("read noise below 0.40 DN"), "{:?}", fit.verdict());
}

#[test]
fn saturation_of_a_thousand_random_sensors_is_exact_or_as_near_as_its_own_noise_lets() {
    let mut random = ChaCha8Rng::seed_from_u64(14);
    let mut unmasked = 0;
    for number in 0..1000 {
        // Every other sensor is cut off in whole DN; the others' amplifiers add noise after it.
        let behind = if number % 2 == 0 { 0.0 } else { 2.0 * random.random::<f64>() };
        let clip = (3500.0 + 12_500.0 * random.random::<f64>()).round();
        let (light, slope) = (1.2 + 2.0 * random.random::<f64>(), 0.8 * random.random::<f64>());
        let (shot, after) = (Normal::new(0.0, 30.0).unwrap(), Normal::new(0.0, behind).unwrap());
        let (mut clipped, mut values) = (vec![], vec![]);
        let dn = Image::from_fn(96, 64, |x, y| {
            let value = clip * light * (1.0 - slope * (x as f64 / 96.0)) + shot.sample(&mut random);
            let dn = (value.min(clip) + after.sample(&mut random)).round() as u16;
            clipped.push(value >= clip && (x & 1, y & 1) == (0, 0));
            values.push(dn);
            dn
        });
        let mut frame = frame(dn);
        frame.levels.black = [[500.0; 2]; 2];
        let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
        sums.add_blown(&frame).unwrap();
        let site = &sums.levels().sites[0];
        let (found, from) = (site.saturation_dn.unwrap(), site.clipped_from_dn.unwrap());
        let reach = if behind == 0.0 { 0.0 } else { 1.0 + 1.5 * behind };
        assert!((found - clip).abs() <= reach, "{found} for {clip}, noise {behind}");
        assert!((clip - 6.0 * behind - 4.0..=clip).contains(&from), "{from} for {clip}, noise {behind}");
        let all = clipped.iter().filter(|c| **c).count();
        let below = clipped.iter().zip(&values).filter(|(c, dn)| **c && f64::from(**dn) < from).count();
        unmasked += usize::from(below as f64 > 0.01 * all as f64);
    }
    println!("frames in which more than 1 % of the clipped sites are taken for light: {unmasked} of 1000");
    assert!(unmasked <= 20, "{unmasked}");
}

/// Two dark frames of a body that takes black off and cuts off at `floor`, black being `above` that.
fn cut(random: &mut ChaCha8Rng, floor: f64, above: f64, noise: f64) -> LevelsFit {
    let normal = Normal::new(floor + above, noise).unwrap();
    let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
    for _ in 0..2 {
        let mut dn = Image::from_fn(160, 120, |_, _| normal.sample(random).round().max(floor) as u16);
        *dn.at_mut(20, 20) = floor as u16 + 600;
        let mut frame = frame(dn);
        frame.levels.black = [[floor as f32; 2]; 2];
        sums.add_dark(&frame).unwrap();
    }
    LevelsFit { levels: vec![sums.levels()], not_measured: vec![] }
}

#[test]
fn half_a_dark_frames_noise_is_quoted_neither_as_black_nor_as_read_noise() {
    let mut random = ChaCha8Rng::seed_from_u64(41);
    for (floor, noise) in [(0.0, 0.6), (0.0, 4.0), (0.0, 20.0), (600.0, 4.0)] {
        let fit = cut(&mut random, floor, 0.0, noise);
        for site in &fit.levels[0].sites {
            assert_eq!((site.black_dn, site.cut_off_dn), (Some(floor), Some(floor)), "{noise}: {site:?}");
            assert_eq!((site.black_dn_standard_error, site.black_dn_interval_95), (None, None), "{site:?}");
            assert_eq!((site.read_noise_dn, site.read_noise_below_dn), (None, None), "{site:?}");
        }
        assert_eq!(fit.levels[0].hot_sites, Some(1));
        let said = fit.verdict().sentences.concat();
        assert!(
            said.contains(&format!("cut off at {floor:.0} DN")) && said.contains("read noise is not told"),
            "{said}"
        );
    }
}

#[test]
fn black_above_the_cut_off_is_the_median_and_lies_in_its_interval() {
    let mut random = ChaCha8Rng::seed_from_u64(43);
    let (mut inside, mut sites, mut whole, mut told) = (0.0, 0.0, 0, 0);
    for _ in 0..300 {
        let noise = 1.5 + 8.0 * random.random::<f64>();
        let above = noise * 4.0 * random.random::<f64>() + 0.7;
        let site = &cut(&mut random, 0.0, above, noise).levels[0].sites[0];
        if site.cut_off_dn.is_none() {
            // So little is cut off that it moves nothing.
            assert!(above > 2.3 * noise, "{above}, {noise}");
            let [low, high] = site.read_noise_dn_interval_95.unwrap();
            (whole, told) = (whole + 1, told + usize::from((low..=high).contains(&noise)));
            continue;
        }
        assert_eq!((site.read_noise_dn, site.read_noise_below_dn), (None, None), "{site:?}");
        assert!(above < 2.9 * noise, "{above}, {noise}");
        let Some([low, high]) = site.black_dn_interval_95 else {
            assert!(above < 1.0, "{above}: {site:?}");
            continue;
        };
        sites += 1.0;
        inside += f64::from(u8::from((low..=high).contains(&above)));
    }
    println!(
        "black inside {} of {sites}; read noise inside {told} of {whole} that are not cut off",
        inside / sites
    );
    assert!(sites > 100.0 && whole > 50, "{sites}, {whole}");
    assert!((0.90..=0.995).contains(&(inside / sites)), "{}", inside / sites);
    assert!(told as f64 > 0.88 * f64::from(whole), "{told} of {whole}");
}

#[test]
fn read_noise_of_raws_with_steps_is_free_of_the_steps_rounding() {
    let mut random = ChaCha8Rng::seed_from_u64(47);
    let mut with = |noise: f64| {
        let normal = Normal::new(2049.0, noise).unwrap();
        let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
        for _ in 0..4 {
            let dn = Image::from_fn(160, 120, |_, _| 4 * (normal.sample(&mut random) / 4.0).round() as u16);
            sums.add_dark(&frame(dn)).unwrap();
        }
        LevelsFit { levels: vec![sums.levels()], not_measured: vec![] }
    };
    let fit = with(3.0);
    for site in &fit.levels[0].sites {
        assert_eq!(site.step_dn, Some(4.0));
        let [low, high] = site.read_noise_dn_interval_95.unwrap();
        // Rounding to 4 DN alone is 1.15 DN, and would make 3.21 of it.
        assert!(low < 3.0 && 3.0 < high && high < 3.15, "{site:?}");
        let [low, high] = site.black_dn_interval_95.unwrap();
        assert!((low..=high).contains(&2049.0), "{site:?}");
    }
    assert!(fit.verdict().sentences.concat().contains("every 4.00 DN only"), "{:?}", fit.verdict());
    let hidden = &with(1.2).levels[0].sites[0];
    assert_eq!(hidden.read_noise_dn, None);
    assert!((1.6..2.0).contains(&hidden.read_noise_below_dn.unwrap()), "{hidden:?}");
}

#[test]
fn a_lit_frame_and_one_of_another_size_are_refused_in_words() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
    let lit = frame(Image::filled(160, 120, 4000));
    let error = sums.add_dark(&lit).unwrap_err().to_string();
    assert!(error.contains("not dark") && error.contains("lens cap"), "{error}");
    sums.add_dark(&dark(&mut random, 2.0, 0)).unwrap();
    let small = frame(Image::filled(80, 60, 2048));
    assert!(matches!(sums.add_dark(&small), Err(UnfitFrame::Size { .. })));
    let why = sums.add_blown(&dark(&mut random, 2.0, 1)).unwrap_err();
    assert!(matches!(why, UnfitFrame::NotBlown(_)), "{why}");
    let levels = sums.levels();
    assert_eq!((levels.dark_frames, levels.blown_frames), (1, 0));
    for site in &levels.sites {
        assert_eq!(
            (site.read_noise_dn, site.read_noise_below_dn),
            (None, None),
            "one frame tells no read noise"
        );
        assert!(site.black_dn.is_some() && site.saturation_dn.is_none(), "{site:?}");
    }
}

#[test]
fn green_alone_is_measured_where_green_alone_is_blown() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let normal = Normal::new(0.0f64, 40.0).unwrap();
    let dn = Image::from_fn(160, 120, |x, y| match (x & 1) + (y & 1) {
        1 => 14_733,
        _ => (9000.0 + normal.sample(&mut random)).round() as u16,
    });
    let mut sums = IsoSums::new(Iso(400.0), Cfa::RGGB);
    sums.add_blown(&frame(dn)).unwrap();
    let fit = LevelsFit { levels: vec![sums.levels()], not_measured: vec![] };
    let told: Vec<Option<f64>> = fit.levels[0].sites.iter().map(|s| s.saturation_dn).collect();
    assert_eq!(told, [None, Some(14_733.0), Some(14_733.0), None]);
    let why = fit.levels[0].sites[0].not_reached.as_deref().unwrap();
    assert!(why.contains("the red sites are not blown"), "{why}");
    let verdict = fit.verdict();
    assert!(verdict.good && verdict.sentences[1].contains("red and blue never clip "), "{verdict:?}");
    let measured = fit.measured(&Rig::default());
    assert_eq!(measured.isos[0].saturation, [[None, Some(14_731.0)], [Some(14_731.0), None]]);
    assert_eq!(measured.isos[0].black, [[None; 2]; 2]);
}

#[test]
fn a_border_that_parts_from_the_dark_frames_is_told() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
    sums.add_masked(&Masked {
        mean: [[2044.0; 2]; 2],
        standard_deviation: [[2.0; 2]; 2],
        sites: [[4000; 2]; 2],
    });
    assert_eq!(sums.levels().black_source, Some(BlackSource::MaskedPixels));
    assert_eq!(sums.levels().sites[0].black_dn, Some(2044.0));
    sums.add_dark(&dark(&mut random, 2.0, 0)).unwrap();
    let fit = LevelsFit { levels: vec![sums.levels()], not_measured: vec![] };
    assert_eq!(fit.levels[0].black_source, Some(BlackSource::DarkFrames));
    let verdict = fit.verdict();
    assert!(verdict.sentences.iter().any(|s| s.contains("masked border reads up to -5.")), "{verdict:?}");
}
