//! What the photodiode saw: dark level, energy, their resolution.

use super::*;

/// Dark samples of a pattern, as the board takes them between shots.
fn darkness(bed: &mut Bed, samples: usize, pattern: impl Fn(usize) -> u16) {
    for i in 0..samples {
        bed.core.light_sample(pattern(i));
    }
}

fn shot_of(bed: &mut Bed, pattern: impl Fn(usize) -> u16) -> Fields {
    bed.edge();
    darkness(bed, 2000, pattern);
    bed.wait_ms(60);
    bed.take_events("shot").remove(0)
}

#[test]
fn dark_level_is_kept_in_sixteenths() {
    let mut bed = Bed::greeted();
    for i in 0..20_000 {
        bed.core.light_sample(12 + u16::from(i % 4 == 0)); // mean 12.25
    }
    bed.edge();
    for i in 0..1538 {
        bed.core.light_sample(12 + u16::from(i % 4 == 0));
    }
    bed.wait_ms(60);
    let shot = bed.take_events("shot").remove(0);
    let dark = shot.uint("b").unwrap();
    assert!((195..=197).contains(&dark), "{dark} sixteenths, expected 196");
    assert!(shot.uint("e").unwrap() < 100, "a whole count of error would add up to 384");
}

#[test]
fn the_energy_of_a_dark_shot_keeps_its_sign() {
    let mut bed = Bed::greeted();
    let shot = shot_of(&mut bed, |i| if i < 100 { 10 } else { 12 });
    assert_eq!((shot.int("e"), shot.uint("m"), shot.uint("w")), (Some(-200), Some(1538), Some(0)));
    let shot = shot_of(&mut bed, |i| if i < 100 { 13 } else { 12 });
    assert_eq!(shot.int("e"), Some(100));
}

#[test]
fn a_window_cut_short_says_how_many_samples_it_has() {
    let mut bed = Bed::greeted();
    bed.edge();
    darkness(&mut bed, 37, |_| 15);
    bed.now += 30_000;
    bed.core.poll(bed.now);
    bed.heard();
    let shot = bed.take_events("shot").remove(0);
    assert_eq!((shot.int("e"), shot.uint("m")), (Some(3 * 37), Some(37)));
}

#[test]
fn the_dark_level_is_subtracted_finer_than_it_is_told() {
    // Rounded to sixteenths, 12.025 would be 12 and the sum 38 counts off.
    let mut bed = Bed::greeted();
    let pattern = |i: usize| 12 + u16::from(i.is_multiple_of(40));
    darkness(&mut bed, 20_000, pattern);
    let shot = shot_of(&mut bed, pattern);
    let e = shot.int("e").unwrap();
    assert!(e.abs() <= 8, "{e} counts");
    assert_eq!(shot.uint("b"), Some(192));
}

#[test]
fn the_dark_level_settles_within_a_quarter_of_a_second_of_boot() {
    let mut bed = Bed { core: Core::new(Config::default(), 7, 0), now: 0, seq: 0, events: Vec::new() };
    darkness(&mut bed, 256, |i| 100 + u16::from(i % 4 == 0));
    bed.ok("hello v=1 strict=1");
    let shot = shot_of(&mut bed, |_| 100);
    let dark = shot.uint("b").unwrap();
    assert!((1603..=1605).contains(&dark), "{dark} sixteenths, expected 1604");
}

#[test]
fn flicker_of_the_mains_does_not_reach_the_dark_level() {
    let mut bed = Bed::greeted();
    let flicker = |i: usize| (100.0 + 40.0 * (i as f64 * 0.2 * std::f64::consts::PI).sin()).round() as u16;
    darkness(&mut bed, 4000, flicker);
    for phase in 0..10 {
        darkness(&mut bed, 1 + phase, flicker);
        let dark = shot_of(&mut bed, |_| 100).uint("b").unwrap();
        assert!((1598..=1602).contains(&dark), "{dark} sixteenths at phase {phase}");
        darkness(&mut bed, 4000, flicker);
    }
}

#[test]
fn light_is_summed_above_dark() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=1000");
    bed.edge();
    for _ in 0..100 {
        bed.core.light_sample(12 + 500);
    }
    for _ in 0..3 {
        bed.core.light_sample(1023);
    }
    bed.wait_ms(60);
    let shot = bed.take_events("shot").remove(0);
    let number = |key| shot.uint(key).unwrap();
    assert_eq!(number("e"), 100 * 500 + 3 * (1023 - 12));
    assert_eq!((number("pk"), number("w"), number("c"), number("b")), (1011, 103, 3, 12 * 16));
}
