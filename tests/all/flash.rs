//! The real serial driver against the simulated board: firmware core, pseudo terminal, flash and photodiode.

use std::path::Path;
use std::time::{Duration, Instant};
use unlit::pair::FlashSync;
use unlit::rig::flash::SerialFlash;
use unlit::rig::{Flash, FlashError};
use unlit::studio::{Board, BoardOptions, SyncContact};

const TTL: Duration = Duration::from_secs(5);
const PATIENCE: Duration = Duration::from_secs(2);

fn bench(options: BoardOptions) -> (Board, SerialFlash) {
    let board = Board::start(options).unwrap();
    let flash = SerialFlash::open(board.device()).unwrap();
    (board, flash)
}

fn quick() -> BoardOptions {
    BoardOptions { recycle: Duration::from_millis(20), ..BoardOptions::default() }
}

/// The one sync that a frame gives.
fn one(flash: &mut SerialFlash) -> FlashSync {
    let shots = flash.syncs(PATIENCE).unwrap();
    assert_eq!(shots.len(), 1, "{shots:?}");
    shots[0]
}

fn mean_and_sd(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
    (mean, variance.sqrt())
}

#[test]
fn a_board_that_runs_already_is_greeted_without_waiting_for_its_boot() {
    let board = Board::start(quick()).unwrap();
    let start = Instant::now();
    let mut flash = SerialFlash::open(board.device()).unwrap();
    assert!(start.elapsed() < Duration::from_millis(1000), "{:?}", start.elapsed());
    let status = flash.status();
    assert!(status.ready, "{status:?}");
    assert_eq!(status.words, "ready");
    assert!(status.description.starts_with("unlit flash controller"), "{status:?}");
}

#[test]
fn the_gate_is_closed_from_the_side_while_somebody_else_has_the_controller() {
    let (board, mut flash) = bench(quick());
    let close = flash.closer().unwrap();
    flash.arm(3, TTL).unwrap();
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| flash.syncs(Duration::from_millis(1)));
        close().unwrap();
        waiting.join().unwrap().unwrap();
    });
    assert_eq!(board.close(), 0.0, "the gate was open");
    // It keeps nobody from letting the controller go, and closes nothing that is closed.
    drop(flash);
    close().unwrap();
}

#[test]
fn dark_frame_of_an_armed_pair_stays_dark() {
    let (board, mut flash) = bench(quick());
    flash.disarm().unwrap();
    assert_eq!(board.close(), 0.0);
    let dark = one(&mut flash);
    assert_eq!((dark.triggered, dark.tag, dark.light()), (false, 0, None));

    flash.arm(7, TTL).unwrap();
    assert!(board.close() > 0.9);
    let lit = one(&mut flash);
    assert_eq!((lit.triggered, lit.tag, lit.number), (true, 7, dark.number + 1));
    assert!(lit.light().unwrap() > 50_000.0);
    assert_eq!(board.close(), 0.0, "one shot");
}

#[test]
fn fifty_dark_and_fifty_lit_frames_give_none_and_fifty_triggers() {
    let (board, mut flash) = bench(quick());
    let (mut dark_triggers, mut lit_triggers) = (0, 0);
    for pair in 1..=50 {
        flash.disarm().unwrap();
        let energy = board.close();
        let dark = one(&mut flash);
        dark_triggers += u32::from(dark.triggered || energy > 0.0 || dark.light().is_some());
        flash.arm(pair, TTL).unwrap();
        let energy = board.close();
        let lit = one(&mut flash);
        assert_eq!(lit.tag, pair);
        lit_triggers += u32::from(lit.triggered && energy > 0.0 && lit.light().is_some());
    }
    assert_eq!((dark_triggers, lit_triggers), (0, 50));
}

#[test]
fn the_measured_energy_follows_the_flash() {
    let (board, mut flash) = bench(quick());
    let (mut given, mut ratios) = (Vec::new(), Vec::new());
    for tag in 1..=40 {
        flash.arm(tag, TTL).unwrap();
        let energy = board.close();
        given.push(energy);
        ratios.push(one(&mut flash).light().unwrap() / energy);
    }
    let (mean, sd) = mean_and_sd(&given);
    assert!((mean - 1.0).abs() < 0.002, "mean energy {mean}");
    assert!((0.0019..0.0042).contains(&sd), "jitter {sd}, expected 0.0029");
    let (mean, sd) = mean_and_sd(&ratios);
    println!("measured over given energy: {mean:.1} counts, standard deviation {:.4} %", 100.0 * sd / mean);
    assert!(sd / mean < 0.0008, "measurement noise {}", sd / mean);
    assert!(sd / mean > 0.00005, "a measurement without noise measures nothing");
}

#[test]
fn the_same_seed_gives_the_same_flashes() {
    let run = |seed| -> Vec<f64> {
        let (board, mut flash) = bench(BoardOptions { seed, ..quick() });
        let shoot = |tag| {
            flash.arm(tag, TTL).unwrap();
            board.close()
        };
        (1..=5).map(shoot).collect()
    };
    assert_eq!(run(3), run(3));
    assert_ne!(run(3), run(4));
}

#[test]
fn arming_waits_for_the_flash_to_recycle() {
    let (board, mut flash) = bench(BoardOptions { recycle: Duration::from_millis(300), ..quick() });
    flash.arm(1, TTL).unwrap();
    board.close();
    let fired = Instant::now();
    flash.arm(2, TTL).unwrap();
    assert!(fired.elapsed() >= Duration::from_millis(290), "{:?}", fired.elapsed());
    assert!(board.close() > 0.9);
}

#[test]
fn a_recycling_too_long_to_wait_for_is_an_error_that_says_how_long() {
    let (board, mut flash) = bench(BoardOptions { recycle: Duration::from_secs(40), ..quick() });
    flash.arm(1, TTL).unwrap();
    board.close();
    match flash.arm(2, TTL) {
        Err(FlashError::NotReady { wait_ms }) => assert!((38_000..=40_000).contains(&wait_ms), "{wait_ms}"),
        other => panic!("{other:?}"),
    }
    assert!(flash.status().words.contains("recycling"));
}

#[test]
fn disarm_closes_the_gate() {
    let (board, mut flash) = bench(quick());
    flash.arm(1, TTL).unwrap();
    flash.disarm().unwrap();
    assert_eq!(board.close(), 0.0);
    assert!(!one(&mut flash).triggered);
}

#[test]
fn time_to_live_closes_the_gate() {
    let (board, mut flash) = bench(quick());
    flash.arm(1, Duration::from_millis(100)).unwrap();
    assert!(flash.syncs(Duration::from_millis(150)).unwrap().is_empty());
    assert_eq!(board.close(), 0.0);
    assert!(!one(&mut flash).triggered);
}

#[test]
fn pings_hold_the_gate_open_through_a_long_wait() {
    let (board, mut flash) = bench(quick());
    flash.arm(1, TTL).unwrap();
    assert!(flash.syncs(Duration::from_millis(2500)).unwrap().is_empty());
    assert!(board.close() > 0.9, "2.5 s are longer than the silence that closes the gate");
}

/// A host that died: the port stays open, and nobody speaks.
#[test]
fn silence_closes_the_gate() {
    use std::io::{Read, Write};
    let board = Board::start(quick()).unwrap();
    let mut host = serialport::new(board.device().to_str().unwrap(), 115_200)
        .timeout(Duration::from_millis(20))
        .open()
        .unwrap();
    host.write_all(b"hello v=1\narm tag=1 ttl=60000\n").unwrap();
    let mut heard = String::new();
    let deadline = Instant::now() + Duration::from_secs(10);
    while !heard.contains("why=silence") {
        assert!(Instant::now() < deadline, "heard only {heard}");
        let mut bytes = [0u8; 256];
        if let Ok(count) = host.read(&mut bytes) {
            heard.push_str(std::str::from_utf8(&bytes[..count]).unwrap());
        }
    }
    assert_eq!(board.close(), 0.0);
}

#[test]
fn dropping_the_driver_closes_the_gate_and_frees_the_port() {
    let (board, mut flash) = bench(quick());
    flash.arm(1, TTL).unwrap();
    drop(flash);
    assert_eq!(board.close(), 0.0);
    let mut flash = SerialFlash::open(board.device()).unwrap();
    flash.arm(2, TTL).unwrap();
    assert!(board.close() > 0.9);
}

#[test]
fn a_board_that_resets_between_arming_and_sync_is_noticed() {
    let (board, mut flash) = bench(quick());
    flash.arm(1, TTL).unwrap();
    board.reset();
    assert_eq!(board.close(), 0.0, "a board that has just started has a closed gate");
    match flash.syncs(PATIENCE) {
        Err(FlashError::Lost { reason, .. }) => assert!(reason.contains("restarted"), "{reason}"),
        other => panic!("a restart was passed over: {other:?}"),
    }
    flash.arm(2, TTL).unwrap();
    assert!(board.close() > 0.9);
    // The dark sync just after the reset may be reported first.
    let mut shots = flash.syncs(PATIENCE).unwrap();
    if shots.iter().all(|shot| shot.tag != 2) {
        shots = flash.syncs(PATIENCE).unwrap();
    }
    assert_eq!(shots.last().map(|shot| (shot.triggered, shot.tag)), Some((true, 2)));
}

#[test]
fn a_reset_whose_boot_event_is_lost_is_noticed() {
    let (board, mut flash) = bench(quick());
    flash.arm(1, TTL).unwrap();
    board.close();
    one(&mut flash);
    board.lose(1, 0);
    board.reset();
    match flash.syncs(PATIENCE) {
        Err(FlashError::Lost { reason, .. }) => assert!(reason.contains("restarted"), "{reason}"),
        other => panic!("a restart was passed over: {other:?}"),
    }
}

#[test]
fn a_board_plugged_in_again_is_found_under_its_name_and_must_be_armed_anew() {
    let folder = tempfile::tempdir().unwrap();
    let by_id = folder.path().join("usb-unlit-controller");
    let board = Board::start(quick()).unwrap();
    std::os::unix::fs::symlink(board.device(), &by_id).unwrap();
    let mut flash = SerialFlash::open(&by_id).unwrap();
    flash.arm(1, TTL).unwrap();
    drop(board);
    let board = Board::start(quick()).unwrap();
    std::fs::remove_file(&by_id).unwrap();
    std::os::unix::fs::symlink(board.device(), &by_id).unwrap();
    let deadline = Instant::now() + Duration::from_secs(10);
    while !flash.status().ready {
        assert!(Instant::now() < deadline, "{:?}", flash.status());
    }
    assert_eq!(board.close(), 0.0);
    let error = flash.syncs(PATIENCE).unwrap_err();
    assert!(error.to_string().contains("restarted"), "{error}");
    flash.arm(2, TTL).unwrap();
    assert!(board.close() > 0.9);
}

#[test]
fn a_lost_report_is_fetched() {
    let (board, mut flash) = bench(quick());
    flash.arm(1, TTL).unwrap();
    board.lose(2, 0); // "disarm why=used" and the shot itself
    assert!(board.close() > 0.9);
    let first = one(&mut flash);
    assert_eq!((first.number, first.tag, first.triggered), (1, 1, true));
    assert!(first.light().is_some());

    flash.disarm().unwrap();
    board.lose(1, 0);
    board.close();
    let dark = one(&mut flash);
    assert_eq!((dark.number, dark.triggered), (2, false));
}

#[test]
fn lost_answers_are_asked_for_again() {
    let (board, mut flash) = bench(quick());
    flash.disarm().unwrap();
    board.lose(0, 2);
    flash.arm(3, TTL).unwrap();
    assert!(board.close() > 0.9);
    assert_eq!(board.close(), 0.0);
    assert_eq!(one(&mut flash).tag, 3);
}

#[test]
fn a_misfire_is_a_trigger_without_light() {
    let (board, mut flash) = bench(quick());
    board.misfire(1);
    flash.arm(1, TTL).unwrap();
    assert_eq!(board.close(), 0.0);
    let shot = one(&mut flash);
    assert_eq!((shot.triggered, shot.light()), (true, None));
    flash.arm(2, TTL).unwrap();
    assert!(board.close() > 0.9);
}

#[test]
fn an_unplugged_board_is_an_error_in_words() {
    let (board, mut flash) = bench(quick());
    flash.arm(1, TTL).unwrap();
    drop(board);
    let error = flash.syncs(Duration::from_millis(100)).unwrap_err();
    assert!(matches!(error, FlashError::Lost { .. } | FlashError::Open { .. }), "{error}");
    let status = flash.status();
    assert!(!status.ready && status.words.contains("flash controller"), "{status:?}");
}

#[test]
fn a_refused_request_is_an_error_with_its_reason() {
    let (_board, mut flash) = bench(quick());
    let error = flash.arm(0, TTL).unwrap_err();
    assert!(matches!(error, FlashError::Refused { code: 5, .. }), "{error}");
    let error = flash.arm(1, Duration::from_secs(120)).unwrap_err();
    assert!(matches!(error, FlashError::Refused { code: 5, .. }), "{error}");
}

#[test]
fn a_port_that_is_not_there_is_an_error_that_names_it() {
    let error = SerialFlash::open(Path::new("/dev/unlit-no-such-port")).err().unwrap();
    assert!(error.to_string().contains("/dev/unlit-no-such-port"), "{error}");
}

#[test]
fn a_second_driver_on_the_same_port_is_refused() {
    let (board, mut flash) = bench(quick());
    let error = SerialFlash::open(board.device()).err().unwrap();
    assert!(matches!(error, FlashError::Open { .. }), "{error}");
    assert!(flash.status().ready);
}
