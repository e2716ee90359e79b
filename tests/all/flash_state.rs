//! What the driver says of the flash's state, and the events that it passes on.

use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};
use unlit::pair::SyncSource;
use unlit::rig::flash::{FlashEvent, FlashNews, FlashSettings, SerialFlash, pulse, trial};
use unlit::rig::{Flash, FlashError};
use unlit::studio::{Board, BoardOptions, SyncContact};

use super::flash_wire::{Book, Wire, request, sealed};

const TTL: Duration = Duration::from_secs(5);
const PATIENCE: Duration = Duration::from_secs(2);

fn bench() -> (Board, SerialFlash) {
    let quick = BoardOptions { recycle: Duration::from_millis(20), ..BoardOptions::default() };
    let board = Board::start(quick).unwrap();
    let flash = SerialFlash::open(board.device()).unwrap();
    (board, flash)
}

#[track_caller]
fn says(flash: &mut SerialFlash, ready: bool, part: &str) {
    let status = flash.status();
    assert!(status.ready == ready && status.words.contains(part), "expected {part}: {status:?}");
}

/// The next event that `wanted` accepts.
#[track_caller]
fn next(events: &Receiver<FlashEvent>, wanted: impl Fn(&FlashNews) -> bool) -> FlashEvent {
    let deadline = Instant::now() + Duration::from_secs(5);
    let mut others = Vec::new();
    while let Ok(event) = events.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
        if wanted(&event.news) {
            return event;
        }
        others.push(event.news);
    }
    panic!("did not come; came: {others:?}");
}

#[test]
fn an_open_gate_is_told_with_the_time_it_has_left() {
    let (_board, mut flash) = bench();
    says(&mut flash, true, "ready");
    flash.arm(1, TTL).unwrap();
    says(&mut flash, true, "armed: the gate is open for the next sync, and closes by itself in ");
    flash.disarm().unwrap();
    says(&mut flash, true, "ready");
}

#[test]
fn a_pulse_without_light_is_told_until_one_has_light() {
    let (board, mut flash) = bench();
    board.misfire(1);
    flash.arm(1, TTL).unwrap();
    board.close();
    flash.syncs(PATIENCE).unwrap();
    flash.disarm().unwrap();
    says(&mut flash, true, "No light was seen");
    flash.arm(2, TTL).unwrap();
    board.close();
    flash.syncs(PATIENCE).unwrap();
    flash.disarm().unwrap();
    assert_eq!(flash.status().words, "ready");
}

#[test]
fn a_restart_is_told_until_the_next_frame_begins() {
    let (board, mut flash) = bench();
    let events = flash.follow();
    board.reset();
    next(&events, |news| matches!(news, FlashNews::Boot { .. }));
    says(&mut flash, true, "restarted 0 s ago");
    flash.disarm().unwrap();
    assert_eq!(flash.status().words, "ready");
}

/// A board whose `stat` the test dictates.
fn dictated(stat: &'static str) -> (Wire, SerialFlash) {
    let start = Instant::now();
    let mut book = Book { boot: 7, events: 1, shots: 0, greeted: false, clock_us: 0 };
    let wire = Wire::start(move |line| {
        book.clock_us = start.elapsed().as_micros() as u32;
        match request(line) {
            Some((seq, "stat")) => sealed(&format!("#{seq} ok t=1 fire=0 hello=1 n=0 {stat}")),
            Some((seq, "cfg")) => {
                let mut said =
                    sealed(&format!("#{seq} ok sil=1500 pulse=1000 lock=30 win=20000 rec=150 rdy=1"));
                if stat.contains("closed=1") {
                    said.extend(sealed("!2 stuck"));
                    book.events = 2;
                }
                said
            }
            _ => book.answer(line),
        }
    });
    let flash = SerialFlash::open(wire.device()).unwrap();
    (wire, flash)
}

#[test]
fn states_in_which_no_pair_can_be_shot_are_not_ready() {
    let (_wire, mut flash) = dictated("g=0 ready=0 wait=0 closed=1");
    says(&mut flash, false, "closed for more than 2 s");
    let (_wire, mut flash) = dictated("g=0 ready=0 wait=0 closed=0");
    says(&mut flash, false, "ready output is low");
    let (_wire, mut flash) = dictated("g=0 ready=0 wait=40000 closed=0");
    says(&mut flash, false, "recycling, 40 s to go");
    let (_wire, mut flash) = dictated("g=0 ready=0 wait=900 closed=0");
    says(&mut flash, true, "recycling, 900 ms to go");
}

#[test]
fn a_ready_output_that_stays_low_is_told_within_seconds_and_in_its_own_words() {
    let start = Instant::now();
    let mut book = Book { boot: 7, events: 1, shots: 0, greeted: false, clock_us: 0 };
    let wire = Wire::start(move |line| {
        book.clock_us = start.elapsed().as_micros() as u32;
        match request(line) {
            Some((seq, "stat")) => {
                sealed(&format!("#{seq} ok t=1 g=0 fire=0 hello=1 ready=0 wait=0 closed=0 n=0"))
            }
            Some((seq, body)) if body.starts_with("cfg") => {
                sealed(&format!("#{seq} ok sil=1500 pulse=1000 lock=30 win=20000 rec=150 rdy=1"))
            }
            Some((seq, body)) if body.starts_with("arm") => sealed(&format!("#{seq} err 10 notready")),
            _ => book.answer(line),
        }
    });
    let mut flash = SerialFlash::open(wire.device()).unwrap();
    let begun = Instant::now();
    let error = flash.arm(1, TTL).unwrap_err();
    assert!(begun.elapsed() < Duration::from_secs(4), "{:?}", begun.elapsed());
    assert!(matches!(error, FlashError::ReadyLow) && error.to_string().contains("--ready-output"), "{error}");
}

#[test]
fn followers_hear_everything_with_its_time() {
    let (board, mut flash) = bench();
    let events = flash.follow();
    let utc = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap().as_secs_f64();
    flash.arm(5, TTL).unwrap();
    board.close();
    let used = next(&events, |news| matches!(news, FlashNews::Disarm { .. }));
    assert_eq!(used.news, FlashNews::Disarm { why: "used".into() });
    assert!((used.at - utc).abs() < 5.0, "{} {utc}", used.at);
    let shot = next(&events, |news| matches!(news, FlashNews::Shot { .. }));
    let FlashNews::Shot { sync, fetched: false } = &shot.news else { panic!("{shot:?}") };
    assert_eq!((sync.tag, sync.triggered), (5, true));
    assert!(sync.at.unwrap() < shot.at, "the report comes after the shot");
    assert!(shot.news.to_string().contains("sync 1 let through, tag 5: light"), "{}", shot.news);

    flash.arm(6, Duration::from_millis(30)).unwrap();
    let late = next(&events, |news| matches!(news, FlashNews::Disarm { .. }));
    assert_eq!(late.news, FlashNews::Disarm { why: "ttl".into() });

    board.lose(1, 0);
    board.close();
    flash.syncs(PATIENCE).unwrap();
    next(&events, |news| matches!(news, FlashNews::Shot { fetched: true, .. }));
    next(&events, |news| *news == FlashNews::Gap { events: 1 });

    let json = serde_json::to_value(&shot).unwrap();
    assert_eq!((&json["event"], &json["sync"]["tag"]), (&"shot".into(), &5.into()), "{json}");
    drop(flash);
    assert!(events.iter().count() < 10, "the stream ends with the driver");
}

#[test]
fn fire_gives_one_shot_on_command_under_its_tag() {
    let (_board, mut flash) = bench();
    flash.fire(9, Duration::from_millis(100)).unwrap();
    let syncs = flash.syncs(PATIENCE).unwrap();
    assert_eq!(syncs.len(), 1, "{syncs:?}");
    assert_eq!((syncs[0].source, syncs[0].tag, syncs[0].triggered), (SyncSource::Command, 9, true));
    assert!(syncs[0].light().unwrap() > 50_000.0);
    flash.fire(10, Duration::from_secs(5)).unwrap();
    flash.disarm().unwrap();
    assert_eq!(flash.syncs(Duration::from_millis(300)).unwrap(), [], "disarm cancels a delayed fire");
}

#[test]
fn a_trial_measures_how_the_flash_repeats() {
    let (_board, mut flash) = bench();
    let before = trial::before(&mut flash).unwrap();
    assert!((10.0..15.0).contains(&before.dark_counts), "{before:?}");
    let mut heard = 0;
    let outcome = trial::run(&mut flash, before, 12, |_| heard += 1).unwrap();
    assert!(heard == 12 && outcome.saw_light());
    assert!(outcome.shots.iter().all(|shot| shot.placement == pulse::Placement::Good), "{outcome:?}");
    let repeated = outcome.repeatability.unwrap();
    assert!((0.001..0.006).contains(&repeated.sd_relative), "0.29 % in the studio: {repeated:?}");
}

#[test]
fn a_trial_in_which_a_shot_stays_dark_says_so() {
    let (board, mut flash) = bench();
    board.misfire(1);
    let before = trial::before(&mut flash).unwrap();
    let outcome = trial::run(&mut flash, before, 2, |_| {}).unwrap();
    assert!(!outcome.saw_light());
    assert_eq!(outcome.shots[0].placement, pulse::Placement::Dark);
}

#[test]
fn a_recycle_time_that_is_wished_is_waited_out() {
    let board = Board::start(BoardOptions { recycle: Duration::ZERO, ..BoardOptions::default() }).unwrap();
    let wish = FlashSettings { recycle: Some(Duration::from_millis(300)), ..FlashSettings::default() };
    let mut flash = SerialFlash::open_with(board.device(), wish).unwrap();
    flash.fire(1, Duration::ZERO).unwrap();
    flash.syncs(PATIENCE).unwrap();
    says(&mut flash, true, "recycling, ");
}
