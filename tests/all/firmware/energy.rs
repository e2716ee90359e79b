//! What the photodiode's energy is worth: noise, flicker of the room light, the supply.

use crate::avr::{Desk, mean_and_sd};

#[test]
fn a_dark_shot_measures_the_noise_of_the_energy_and_a_lit_one_the_energy() {
    let mut desk = Desk::greeted();
    desk.sim.command("light noise=0.5 flicker=5 hz=100 jitter=0.0029 seed=7");
    desk.wait_ms(3000.0);
    desk.ok("hello v=1 strict=1");
    let (mut dark, mut given, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
    for tag in 1..=40 {
        // Any phase of the mains.
        let after = f64::from(tag * 7919 % 100) * 100.0;
        let frame = desk.frame(after);
        assert_eq!(frame.shot.int("m"), 20_000 / 13);
        dark.push(frame.shot.int("e") as f64);
        let frame = desk.lit_frame(tag as u32, 10_000.0 - after);
        given.push(frame.energy);
        ratios.push(frame.shot.int("e") as f64 / frame.energy);
    }
    let ((dark_mean, dark_sd), (energy, energy_sd)) = (mean_and_sd(&dark), mean_and_sd(&ratios));
    let (_, given_sd) = mean_and_sd(&given);
    println!("dark shots: mean {dark_mean:.1}, SD {dark_sd:.1} counts");
    println!(
        "energy {energy:.0} counts a unit, given SD {:.3} %, measured over given SD {:.4} %",
        100.0 * given_sd,
        100.0 * energy_sd / energy
    );
    assert!(dark.iter().any(|e| *e < 0.0) && dark.iter().any(|e| *e > 0.0), "noise has both signs: {dark:?}");
    assert!(dark_mean.abs() < 4.0 * dark_sd / 40f64.sqrt() + 2.0, "a bias of {dark_mean} counts");
    assert!(energy_sd / energy < 0.0006, "{}", energy_sd / energy);
    assert!(given_sd > 0.0015, "a flash that does not vary proves nothing");
    let predicted = dark_sd / energy;
    assert!((0.4..2.5).contains(&(energy_sd / energy / predicted)), "dark shots predict {predicted}");
}

/// A window of whole periods of the room light's flicker gathers as much of it as the dark level has.
#[test]
fn the_window_can_be_made_to_fit_the_mains() {
    let mut spread = Vec::new();
    for (hz, window) in [(100, 20_000), (120, 20_000), (120, 25_000)] {
        let mut desk = Desk::greeted();
        desk.ok(&format!("cfg win={window}"));
        desk.sim.command(&format!("light flicker=5 hz={hz} seed=3"));
        desk.wait_ms(1400.0);
        let dark: Vec<f64> =
            (0..30).map(|i| desk.frame(f64::from(i * 7919 % 100) * 100.0).shot.int("e") as f64).collect();
        let (_, sd) = mean_and_sd(&dark);
        println!("flicker of 5 counts at {hz} Hz, window {window} us: dark shots' SD {sd:.0} counts");
        spread.push(sd);
    }
    assert!(spread[0] < 120.0 && spread[1] > 300.0 && spread[2] < 160.0, "{spread:?}");
}

#[test]
fn the_energy_does_not_depend_on_the_supply() {
    let mut desk = Desk::greeted();
    desk.sim.command("light noise=0.3 seed=3");
    let mut energies = Vec::new();
    for millivolts in [5000, 4500, 5500] {
        desk.sim.command(&format!("supply {millivolts}"));
        desk.wait_ms(1000.0);
        desk.ok("ping");
        energies.push(desk.lit_frame(1, 1000.0).shot.int("e") as f64);
        println!("supply of {millivolts} mV: energy {}", energies[energies.len() - 1]);
    }
    for energy in &energies {
        assert!((energy / energies[0] - 1.0).abs() < 0.002, "{energies:?}");
    }
}
