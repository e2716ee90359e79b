//! The driver on a link that breaks, lies or restarts: no count is ever given that is not proven.

use super::flash_wire::{Book, Wire, request, sealed};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use unlit::rig::flash::{FlashNews, FlashSettings, SerialFlash};
use unlit::rig::{Flash, FlashError};
use unlit::studio::{Board, BoardOptions, SyncContact};

const TTL: Duration = Duration::from_secs(5);
const PATIENCE: Duration = Duration::from_secs(2);

fn quick() -> BoardOptions {
    BoardOptions { recycle: Duration::from_millis(20), ..BoardOptions::default() }
}

/// A name that survives replugging, as udev makes it.
struct Socket {
    _folder: tempfile::TempDir,
    name: PathBuf,
}

impl Socket {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let name = folder.path().join("usb-unlit-controller");
        Self { _folder: folder, name }
    }

    fn plug(&self, device: &Path) {
        symlink(device, &self.name).unwrap();
    }

    fn unplug(&self) {
        std::fs::remove_file(&self.name).unwrap();
    }
}

#[track_caller]
fn until(what: &str, mut done: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(10);
    while !done() {
        assert!(Instant::now() < deadline, "{what}: not within 10 s");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[track_caller]
fn is_lost<T: std::fmt::Debug>(result: Result<T, FlashError>, part: &str) {
    match result {
        Err(FlashError::Lost { reason, .. }) => assert!(reason.contains(part), "{reason}"),
        other => panic!("expected a loss ({part}), not {other:?}"),
    }
}

#[test]
fn a_sync_that_follows_an_unread_one_is_in_the_same_count() {
    let board = Board::start(quick()).unwrap();
    let mut flash = SerialFlash::open(board.device()).unwrap();
    for turn in 0..10 {
        board.close();
        std::thread::sleep(Duration::from_millis(60)); // beyond the lock: no bounce
        board.lose(turn % 2, 0);
        board.close();
        let syncs = flash.syncs(PATIENCE).unwrap();
        assert_eq!(syncs.len(), 2, "turn {turn}: {syncs:?}");
    }
}

#[test]
fn syncs_carry_their_utc_and_the_driver_says_how_well_it_knows() {
    let board = Board::start(quick()).unwrap();
    let mut flash = SerialFlash::open(board.device()).unwrap();
    let utc = || std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap().as_secs_f64();
    for _ in 0..5 {
        let before = utc();
        board.close();
        let after = utc();
        let at = flash.syncs(PATIENCE).unwrap()[0].at.unwrap();
        let known_to = flash.clock().unwrap().uncertainty_s;
        assert!(known_to < 0.2, "{known_to}");
        assert!((before - known_to..=after + known_to).contains(&at), "{before} {at} {after} +- {known_to}");
    }
}

#[test]
fn a_restart_right_behind_the_answer_to_arm_is_not_passed_over() {
    // The answer to arm and the boot event of the next life come in one packet.
    let book =
        Arc::new(Mutex::new(Book { boot: 7, events: 1, shots: 0, greeted: false, clock_us: 90_000_000 }));
    let (shared, mut resets) = (book.clone(), 1);
    let wire = Wire::start(move |line| {
        let mut book = shared.lock().unwrap();
        let mut said = book.answer(line);
        if resets > 0 && request(line).is_some_and(|(_, body)| body.starts_with("arm")) {
            resets -= 1;
            *book = Book { boot: 8, events: 1, shots: 0, greeted: false, clock_us: 10 };
            said.extend(sealed("!1 boot boot=8 rst=2"));
        }
        said
    });
    let mut flash = SerialFlash::open(wire.device()).unwrap();
    let counted = flash.arm(1, TTL).and_then(|()| flash.syncs(Duration::ZERO));
    is_lost(counted, "restarted");
    flash.arm(2, TTL).unwrap();
    assert_eq!(flash.syncs(Duration::ZERO).unwrap(), []);
}

#[test]
fn a_pulse_whose_window_was_cut_short_is_none_to_measure_with() {
    for (samples, whole) in [(1538, true), (1528, true), (900, false), (1900, false)] {
        let book = Book { boot: 7, events: 1, shots: 0, greeted: false, clock_us: 0 };
        let (book, start) = (Arc::new(Mutex::new(book)), Instant::now());
        let shared = book.clone();
        let wire = Wire::start(move |line| {
            let mut book = shared.lock().unwrap();
            book.clock_us = start.elapsed().as_micros() as u32;
            match request(line) {
                Some((seq, "get n=1")) => sealed(&format!(
                    "#{seq} ok n=1 src=sync g=1 tag=1 t=1 e=90000 pk=500 b=16 w=300 c=0 m={samples} bn=0"
                )),
                _ => book.answer(line),
            }
        });
        let mut flash = SerialFlash::open(wire.device()).unwrap();
        flash.arm(1, TTL).unwrap();
        book.lock().unwrap().shots = 1;
        let counted = flash.syncs(Duration::ZERO);
        match whole {
            true => assert_eq!(counted.unwrap().len(), 1, "{samples}"),
            false => is_lost(counted, "instead of 20.0 ms"),
        }
    }
}

#[test]
fn a_silent_restart_of_a_board_with_equal_numbers_is_noticed_by_the_missing_greeting() {
    // Same boot number (worn EEPROM), same shots, same events, a clock that goes on, no boot event.
    let book =
        Arc::new(Mutex::new(Book { boot: 7, events: 3, shots: 1, greeted: false, clock_us: 1_000_000 }));
    let shared = book.clone();
    let start = Instant::now();
    let wire = Wire::start(move |line| {
        let mut book = shared.lock().unwrap();
        book.clock_us = 1_000_000 + start.elapsed().as_micros() as u32;
        book.answer(line)
    });
    let mut flash = SerialFlash::open(wire.device()).unwrap();
    flash.disarm().unwrap();
    assert_eq!(flash.syncs(Duration::ZERO).unwrap(), []);
    flash.disarm().unwrap();
    book.lock().unwrap().greeted = false;
    is_lost(flash.syncs(Duration::ZERO), "restarted");
    // The next frame begins afresh, and its count is good again.
    flash.disarm().unwrap();
    assert_eq!(flash.syncs(Duration::ZERO).unwrap(), []);
}

#[test]
fn shots_of_the_boot_before_are_not_counted_under_equal_numbers() {
    let board = Board::start(quick()).unwrap();
    let mut flash = SerialFlash::open(board.device()).unwrap();
    flash.disarm().unwrap();
    board.close();
    flash.syncs(PATIENCE).unwrap();
    board.close(); // unread
    board.lose(1, 0);
    board.reset();
    board.close(); // again number 1
    is_lost(flash.syncs(PATIENCE), "restarted");
    flash.disarm().unwrap();
    assert!(flash.syncs(Duration::ZERO).unwrap().iter().all(|sync| !sync.triggered));
}

#[test]
fn an_order_waits_for_a_board_that_is_plugged_in_again() {
    let socket = Socket::new();
    let board = Board::start(quick()).unwrap();
    socket.plug(board.device());
    let mut flash = SerialFlash::open(&socket.name).unwrap();
    let news = flash.follow();
    drop(board);
    socket.unplug();
    until("loss", || !flash.status().ready);
    let status = flash.status();
    assert!(status.words.contains("it is looked for at") && status.words.contains("usb-unlit"), "{status:?}");
    let name = socket.name.clone();
    let plugging = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(600));
        let board = Board::start(quick()).unwrap();
        symlink(board.device(), name).unwrap();
        board
    });
    flash.disarm().unwrap();
    let board = plugging.join().unwrap();
    flash.arm(1, TTL).unwrap();
    assert!(board.close() > 0.9);
    assert_eq!(flash.syncs(PATIENCE).unwrap().len(), 1);
    assert!(flash.status().ready);
    let news: Vec<FlashNews> = news.try_iter().map(|event| event.news).collect();
    let lost = news.iter().position(|n| matches!(n, FlashNews::Lost { .. })).unwrap();
    let back =
        news.iter().position(|n| matches!(n, FlashNews::Reconnected { same_boot: false, .. })).unwrap();
    assert!(lost < back, "{news:?}");
}

#[test]
fn a_board_that_stays_away_is_an_error_within_seconds_and_closing_the_driver_hangs_on_nothing() {
    let socket = Socket::new();
    let board = Board::start(quick()).unwrap();
    socket.plug(board.device());
    let mut flash = SerialFlash::open(&socket.name).unwrap();
    drop(board);
    socket.unplug();
    until("loss", || !flash.status().ready);
    let start = Instant::now();
    assert!(matches!(flash.disarm(), Err(FlashError::Lost { .. })));
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
    let start = Instant::now();
    drop(flash);
    assert!(start.elapsed() < Duration::from_secs(1), "{:?}", start.elapsed());
}

#[test]
fn a_link_that_breaks_between_arming_and_count_keeps_what_the_same_boot_counted() {
    let socket = Socket::new();
    let book = Book { boot: 7, events: 1, shots: 0, greeted: false, clock_us: 0 };
    let (book, start) = (Arc::new(Mutex::new(book)), Instant::now());
    let plug = |book: &Arc<Mutex<Book>>| {
        let book = book.clone();
        Wire::start(move |line| {
            let mut book = book.lock().unwrap();
            book.clock_us = start.elapsed().as_micros() as u32;
            book.answer(line)
        })
    };
    let wire = plug(&book);
    socket.plug(wire.device());
    let mut flash = SerialFlash::open(&socket.name).unwrap();
    flash.disarm().unwrap();
    drop(wire);
    socket.unplug();
    until("loss", || !flash.status().ready);
    // The board has its own power, and counts on.
    book.lock().unwrap().shots = 2;
    let wire = plug(&book);
    socket.plug(wire.device());
    let syncs = flash.syncs(Duration::ZERO).unwrap();
    assert_eq!(syncs.iter().map(|sync| sync.number).collect::<Vec<_>>(), [1, 2]);
}

#[test]
fn a_link_that_breaks_while_the_gate_is_open_has_the_frame_taken_again() {
    let board = Board::start(quick()).unwrap();
    let mut flash = SerialFlash::open(board.device()).unwrap();
    flash.arm(1, TTL).unwrap();
    board.unplug(false).unwrap();
    until("loss", || !flash.status().ready);
    board.plug_in().unwrap();
    until("return", || flash.status().ready);
    assert_eq!(board.close(), 0.0, "the greeting has closed the gate");
    is_lost(flash.syncs(PATIENCE), "while the gate was open");
    // Had the sync come before, everything would be proven.
    flash.arm(2, TTL).unwrap();
    board.unplug(false).unwrap();
    assert!(board.close() > 0.9, "the board has not heard of it yet");
    board.plug_in().unwrap();
    let syncs = flash.syncs(PATIENCE).or_else(|_| flash.syncs(PATIENCE)).unwrap();
    assert_eq!(syncs.iter().map(|sync| (sync.tag, sync.triggered)).collect::<Vec<_>>(), [(2, true)]);
}

#[test]
fn settings_are_sent_again_to_a_board_that_restarted() {
    let board = Board::start(quick()).unwrap();
    let settings = FlashSettings { recycle: Some(Duration::from_millis(400)), ..FlashSettings::default() };
    let mut flash = SerialFlash::open_with(board.device(), settings).unwrap();
    assert_eq!(flash.settings().unwrap().recycle_ms, 400);
    board.reset();
    let _ = flash.syncs(Duration::from_millis(50));
    assert_eq!(flash.settings().unwrap().recycle_ms, 400);
    flash.arm(1, TTL).unwrap();
    board.close();
    let fired = Instant::now();
    flash.arm(2, TTL).unwrap();
    assert!(fired.elapsed() >= Duration::from_millis(390), "{:?}", fired.elapsed());
}

#[test]
fn settings_that_the_board_refuses_are_an_error() {
    let board = Board::start(quick()).unwrap();
    let settings = FlashSettings { silence: Some(Duration::from_millis(1)), ..FlashSettings::default() };
    let error = SerialFlash::open_with(board.device(), settings).err().unwrap();
    assert!(error.to_string().contains("sil=1"), "{error}");
}

#[track_caller]
fn is_foreign(wire: &Wire, part: &str) {
    let start = Instant::now();
    let error = SerialFlash::open(wire.device()).err().unwrap();
    assert!(matches!(error, FlashError::Firmware { .. }), "{error:?}");
    let words = error.to_string();
    assert!(words.contains(part) && words.contains("unlit flash upload"), "{words}");
    assert!(start.elapsed() < Duration::from_secs(6), "{:?}", start.elapsed());
}

#[test]
fn other_protocols_firmwares_and_devices_are_told_apart_from_silence() {
    let reply = |text: &'static str| {
        Wire::start(move |line| match request(line) {
            Some((seq, _)) => sealed(&format!("#{seq} {text}")),
            None => Vec::new(),
        })
    };
    is_foreign(&reply("ok v=2 fw=2.0 mcu=x boot=1 rst=1 caps=x ev=1 n=0 t=1"), "speaks protocol 2");
    is_foreign(&reply("err 5 arg"), "refuses the greeting (error 5, arg)");
    is_foreign(&reply("ok v=1 fw=1.0"), "lacks numbers");
    // A GPS receiver talks by itself.
    is_foreign(
        &Wire::start(|_| b"$GPGGA,123519,4807.038,N\r\n".to_vec()),
        "no lines of the controller's protocol",
    );
    is_foreign(&Wire::start(|_| vec![0xA5; 64]), "no lines of the controller's protocol");
    let deaf = Wire::start(|_| Vec::new());
    let error = SerialFlash::open(deaf.device()).err().unwrap();
    assert!(matches!(error, FlashError::Silent { .. }), "{error:?}");
}

#[test]
fn garbage_between_the_lines_does_not_matter() {
    let start = Instant::now();
    let mut book = Book { boot: 7, events: 1, shots: 0, greeted: false, clock_us: 0 };
    let wire = Wire::start(move |line| {
        book.clock_us = start.elapsed().as_micros() as u32;
        let mut said = b"\xFFnoise\n#\n!\n*\n".to_vec();
        said.extend(book.answer(line));
        said
    });
    let mut flash = SerialFlash::open(wire.device()).unwrap();
    for _ in 0..20 {
        flash.disarm().unwrap();
        assert_eq!(flash.syncs(Duration::ZERO).unwrap(), []);
    }
}

#[test]
fn a_board_that_counts_wildly_ends_in_an_error_and_not_in_a_long_fetch() {
    let start = Instant::now();
    let book = Book { boot: 7, events: 1, shots: 0, greeted: false, clock_us: 0 };
    let book = Arc::new(Mutex::new(book));
    let shared = book.clone();
    let wire = Wire::start(move |line| {
        let mut book = shared.lock().unwrap();
        book.clock_us = start.elapsed().as_micros() as u32;
        book.answer(line)
    });
    let mut flash = SerialFlash::open(wire.device()).unwrap();
    book.lock().unwrap().shots = 4_000_000_000;
    let begun = Instant::now();
    is_lost(flash.syncs(Duration::ZERO), "more syncs came");
    assert!(begun.elapsed() < Duration::from_secs(2), "{:?}", begun.elapsed());
}

#[test]
fn opening_and_closing_leaves_no_thread_behind() {
    // The other tests of this program have threads of their own: they are counted in a program that runs this one alone.
    const ALONE: &str = "UNLIT_TEST_ALONE";
    if std::env::var_os(ALONE).is_none() {
        let this = "flash_link::opening_and_closing_leaves_no_thread_behind";
        let output = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", this, "--nocapture"])
            .env(ALONE, "1")
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && said.contains("1 passed"), "{said}{:?}", output.stderr);
        return;
    }
    let threads = || std::fs::read_dir("/proc/self/task").unwrap().count();
    let board = Board::start(quick()).unwrap();
    let before = threads();
    for _ in 0..20 {
        let mut flash = SerialFlash::open(board.device()).unwrap();
        flash.disarm().unwrap();
        assert!(threads() > before, "the driver has a thread");
    }
    until("threads end", || threads() <= before);
}
