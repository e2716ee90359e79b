//! A flash that is not full again, gets hot or runs its battery down: its simulated physics, measured by the firmware's core
//! and the real serial driver, must come out as the right advice, and divide out of the light whatever the cause.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::time::Duration;
use unlit::pair::energy::{AdviceCode, EnergyScale, Trend, trend};
use unlit::pair::order::Order;
use unlit::pair::{FlashRecord, FlashSync, FrameRecord, PairRecord, Settings, Verdict};
use unlit::rig::Flash;
use unlit::rig::flash::SerialFlash;
use unlit::studio::{Board, BoardOptions, Heat, LampOptions, Recharge, SyncContact};

const TTL: Duration = Duration::from_secs(5);
const PATIENCE: Duration = Duration::from_secs(2);
/// How much faster than the room's the lamp's time runs: seconds of rest become fractions of one.
const CLOCK: f64 = 40.0;

fn record(number: u32, off: FlashSync, on: FlashSync) -> PairRecord {
    let frame = || FrameRecord {
        file: "off.dng".into(),
        original_name: String::new(),
        bytes: 0,
        blake3: String::new(),
        settings: Settings::default(),
        polariser: None,
        jpeg: None,
    };
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

/// Pairs of pulses of such a lamp after rests of 3 to 9 s of its time, every 15th of a minute; what the flash truly gave.
fn pulses(lamp: LampOptions, count: u32) -> (Vec<PairRecord>, Vec<f64>) {
    let lamp = LampOptions { clock: CLOCK, ..lamp };
    let recycle = Duration::from_millis(20);
    let board = Board::start(BoardOptions { recycle, lamp, ..BoardOptions::default() }).unwrap();
    let mut flash = SerialFlash::open(board.device()).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut first = None;
    let mut one = |flash: &mut SerialFlash| {
        let syncs = flash.syncs(PATIENCE).unwrap();
        assert_eq!(syncs.len(), 1, "{syncs:?}");
        let at = syncs[0].at.expect("a driver that has greeted its board knows the board's clock");
        let first = *first.get_or_insert(at);
        FlashSync { at: Some(first + CLOCK * (at - first)), ..syncs[0] }
    };
    let mut pairs = Vec::new();
    for number in 1..=count {
        flash.disarm().unwrap();
        board.close();
        let off = one(&mut flash);
        let share = f64::from(random.next_u32()) / f64::from(u32::MAX);
        let rest = if number % 15 == 0 { 60.0 } else { 3.0 + 6.0 * share };
        std::thread::sleep(Duration::from_secs_f64(rest / CLOCK));
        flash.arm(number, TTL).unwrap();
        board.close();
        pairs.push(record(number, off, one(&mut flash)));
    }
    let given: Vec<f64> = board.rises().iter().map(|rise| rise.energy).collect();
    assert_eq!(given.len(), count as usize);
    (pairs, given)
}

fn told(pairs: &[PairRecord]) -> Trend {
    let records: Vec<FlashRecord> = pairs.iter().filter_map(|pair| pair.flash.clone()).collect();
    trend(pairs, &EnergyScale::new(&records, None, None))
}

/// The measured energies are the true ones but for a factor.
fn divides_out(pairs: &[PairRecord], given: &[f64]) {
    let ratios: Vec<f64> = pairs
        .iter()
        .zip(given)
        .map(|(pair, e)| pair.flash.as_ref().unwrap().energy_counts().unwrap() / e)
        .collect();
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    let sd =
        (ratios.iter().map(|r| (r / mean - 1.0).powi(2)).sum::<f64>() / (ratios.len() - 1) as f64).sqrt();
    println!(
        "given {:.3} to {:.3}; measured over given varies by {:.4} %",
        least(given),
        most(given),
        100.0 * sd
    );
    assert!(sd < 0.0008, "{ratios:?}");
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

fn most(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

fn gets(lamp: LampOptions, advice: &[AdviceCode]) -> Trend {
    let (pairs, given) = pulses(lamp, 40);
    divides_out(&pairs, &given);
    let trend = told(&pairs);
    let codes: Vec<AdviceCode> = trend.advice.iter().map(|advice| advice.code).collect();
    assert_eq!(codes, advice, "{trend:?}");
    trend
}

#[test]
fn a_steady_flash_gets_no_advice() {
    gets(LampOptions::default(), &[]);
}

#[test]
fn short_rests_are_told() {
    let recharge = Recharge { lacking: 0.3, tau: Duration::from_secs(5) };
    let trend =
        gets(LampOptions { recharge: Some(recharge), ..LampOptions::default() }, &[AdviceCode::WaitLonger]);
    // After 5 s of rest the lamp lacks 0.3 exp(-1) = 11 %; on a busy machine rests become longer.
    assert!(trend.recharge_loss.is_some_and(|loss| (-0.15..-0.001).contains(&loss)), "{trend:?}");
}

#[test]
fn a_hot_tube_is_told() {
    let heat = Heat { cooling: Duration::from_secs(120), loss: 0.008, limit: 1000.0 };
    let trend = gets(LampOptions { heat: Some(heat), ..LampOptions::default() }, &[AdviceCode::LowerPower]);
    assert!(trend.heat_loss.is_some_and(|loss| (-0.25..-0.01).contains(&loss)), "{trend:?}");
}

#[test]
fn a_battery_that_runs_down_is_told() {
    let trend = gets(LampOptions { droop: 0.0008, ..LampOptions::default() }, &[AdviceCode::ChargeBattery]);
    assert!(trend.droop.is_some_and(|droop| (droop + 0.0312).abs() < 0.006), "{trend:?}");
}

#[test]
fn a_flash_that_protects_itself_from_heat_gives_no_light_and_the_board_sees_it() {
    let heat = Heat { cooling: Duration::from_secs(3600), loss: 0.0, limit: 2.5 };
    let lamp = LampOptions { heat: Some(heat), ..LampOptions::default() };
    let recycle = Duration::from_millis(20);
    let board = Board::start(BoardOptions { recycle, lamp, ..BoardOptions::default() }).unwrap();
    let mut flash = SerialFlash::open(board.device()).unwrap();
    let lit: Vec<bool> = (1..=4)
        .map(|tag| {
            flash.arm(tag, TTL).unwrap();
            board.close();
            let syncs = flash.syncs(PATIENCE).unwrap();
            assert!(syncs.len() == 1 && syncs[0].triggered, "{syncs:?}");
            syncs[0].light().is_some()
        })
        .collect();
    assert_eq!(lit, [true, true, true, false]);
}
