//! `unlit flash` as its user runs it: the program itself, simulated boards, and the real avrdude.

use std::ffi::OsString;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use unlit::rig::flash::ports::Port;
use unlit::rig::flash::upload::{BoardKind, FIRMWARE, SILENCE, Upload, UploadError};
use unlit::rig::system::Holder;
use unlit::studio::{BlankBoard, BoardOptions};

fn unlit(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).arg("flash").args(words).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn ports_shows_a_simulated_board_and_asks_who_it_is() {
    let output = unlit(&["ports", "--studio", "--ask"]);
    let text = said(&output);
    assert!(output.status.success(), "{text}");
    assert!(text.contains("/dev/pts/") && text.contains("flash controller, firmware"), "{text}");
    let output = unlit(&["ports", "--studio", "--ask", "--json"]);
    let rows: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(rows[0]["controller"]["firmware"].is_string() && rows[0]["port"]["usable"] == true, "{rows}");
}

#[test]
fn test_fires_and_judges_the_photodiode() {
    let output = unlit(&["test", "--studio", "--shots", "3", "--recycle", "0.2"]);
    let text = said(&output);
    assert!(output.status.success(), "{text}");
    for part in
        ["Recycle time 200 ms", "fires 3 times NOW", "Shot 3: energy", "stands well", "standard deviation"]
    {
        assert!(text.contains(part), "no {part}: {text}");
    }
    let output = unlit(&["test", "--studio", "--json", "--mains", "60"]);
    let outcome: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(outcome["shots"][0]["placement"], "good", "{outcome}");
    assert_eq!(outcome["before"]["settings"]["window_us"], 25_000, "{outcome}");
}

#[test]
fn watch_shows_events_as_they_happen() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_unlit"))
        .args(["flash", "watch", "--studio", "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let (tell, told) = std::sync::mpsc::channel();
    let mut out = BufReader::new(child.stdout.take().unwrap());
    std::thread::spawn(move || {
        let mut line = String::new();
        out.read_line(&mut line).unwrap();
        // A test that gave up waiting has failed already.
        let _ = tell.send(line);
    });
    let line = told.recv_timeout(Duration::from_secs(30));
    child.kill().unwrap();
    child.wait().unwrap();
    let line = line.expect("no event within 30 s, though the simulated camera releases every 2 s");
    let event: serde_json::Value = serde_json::from_str(&line).unwrap();
    assert_eq!((&event["event"], &event["sync"]["triggered"]), (&"shot".into(), &false.into()), "{event}");
}

#[test]
fn a_port_that_is_not_there_is_an_error_that_names_it_and_what_to_do() {
    let output = unlit(&["test", "/dev/unlit-no-such-port"]);
    let text = said(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("/dev/unlit-no-such-port") && text.contains("unlit flash ports"), "{text}");
}

/// A program of `length` bytes, and its Intel HEX file.
fn program(folder: &Path, length: usize) -> (PathBuf, Vec<u8>) {
    let bytes: Vec<u8> = (0..length).map(|k| (k * 7 + k / 256) as u8).collect();
    let mut text = String::new();
    for (row, data) in bytes.chunks(16).enumerate() {
        let mut record = vec![data.len() as u8, ((row * 16) >> 8) as u8, (row * 16) as u8, 0];
        record.extend(data);
        let sum = record.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte)).wrapping_neg();
        record.push(sum);
        text += ":";
        record.iter().for_each(|byte| text += &format!("{byte:02X}"));
        text += "\n";
    }
    text += ":00000001FF\n";
    let path = folder.join("program.hex");
    std::fs::write(&path, text).unwrap();
    (path, bytes)
}

struct Bench {
    folder: tempfile::TempDir,
    board: BlankBoard,
}

impl Bench {
    /// `None`, and says so, where avrdude is not installed.
    fn new() -> Option<Self> {
        if Command::new("avrdude").arg("-?").output().is_err() {
            eprintln!("skipped: avrdude is not installed");
            return None;
        }
        let board = BlankBoard::start(BoardOptions::default()).unwrap();
        Some(Self { folder: tempfile::tempdir().unwrap(), board })
    }

    fn upload(&self, hex: &Path, kinds: &[BoardKind]) -> Upload {
        Upload {
            port: self.board.port(),
            kinds: kinds.to_vec(),
            hex: Some(hex.to_owned()),
            avrdude: OsString::from("avrdude"),
            silence: SILENCE,
        }
    }
}

#[test]
fn upload_writes_every_byte_and_greets_the_board_that_comes_of_it() {
    let Some(bench) = Bench::new() else { return };
    let (hex, bytes) = program(bench.folder.path(), 5000);
    let mut words = String::new();
    let greeting = bench.upload(&hex, &[BoardKind::Uno]).run(|part| words += part).unwrap();
    assert_eq!(greeting.mcu, "native");
    let flash = bench.board.flash();
    assert_eq!(flash[..bytes.len()], bytes);
    assert!(flash[5120..].iter().all(|byte| *byte == 0xFF), "nothing beyond the last page");
    assert!(words.contains("verified"), "{words}");
}

#[test]
fn upload_says_what_is_wrong_with_the_board() {
    let Some(bench) = Bench::new() else { return };
    let (hex, _) = program(bench.folder.path(), 300);
    bench.board.wear(100);
    let error = bench.upload(&hex, &[BoardKind::Uno]).run(|_| {}).unwrap_err();
    assert!(matches!(error, UploadError::Verify(_)), "{error}");
    let Some(bench) = Bench::new() else { return };
    bench.board.set_signature([0x1E, 0x98, 0x01]);
    let error = bench.upload(&hex, &[BoardKind::Uno]).run(|_| {}).unwrap_err();
    assert!(matches!(error, UploadError::WrongChip { .. }), "{error}");
}

#[test]
fn a_board_whose_boot_loader_is_silent_is_given_up_early_with_advice() {
    let Some(bench) = Bench::new() else { return };
    let (hex, _) = program(bench.folder.path(), 300);
    bench.board.set_deaf();
    let start = Instant::now();
    let mut words = String::new();
    let error = bench.upload(&hex, &[BoardKind::Nano]).run(|part| words += part).unwrap_err();
    assert!(start.elapsed() < Duration::from_secs(40), "{:?}", start.elapsed());
    assert!(error.to_string().contains("kind nano: is it the right port"), "{error}");
    assert!(words.contains("attempt 3 of 10"), "{words}");
}

#[test]
fn upload_without_avrdude_port_or_program_says_so() {
    let Some(bench) = Bench::new() else { return };
    let (hex, _) = program(bench.folder.path(), 300);
    let upload = bench.upload(&hex, &[BoardKind::Uno]);
    let run = |upload: Upload| upload.run(|_| {}).unwrap_err().to_string();
    let words = run(Upload { avrdude: "/no/avrdude".into(), ..upload.clone() });
    assert!(words.contains("/no/avrdude") && words.contains("apt install avrdude"), "{words}");
    let words = run(Upload { port: "/dev/unlit-no-such-port".into(), ..upload.clone() });
    assert!(words.contains("/dev/unlit-no-such-port is not there"), "{words}");
    let words = run(Upload { hex: Some("/no/program.hex".into()), ..upload.clone() });
    assert!(words.contains("/no/program.hex"), "{words}");
    let text = bench.folder.path().join("notes.txt");
    std::fs::write(&text, "no program\n").unwrap();
    assert!(run(Upload { hex: Some(text), ..upload.clone() }).contains("instead of a colon"));
    let short = bench.folder.path().join("short.hex");
    let whole = std::fs::read_to_string(&hex).unwrap();
    std::fs::write(&short, &whole[..whole.len() / 2]).unwrap();
    assert!(run(Upload { hex: Some(short), ..upload }).contains("end record"));
}

#[test]
fn a_port_that_somebody_has_open_is_not_programmed() {
    let port = Port {
        path: "/dev/ttyACM0".into(),
        node: "/dev/ttyACM0".into(),
        usb: None,
        usable: true,
        held_by: vec![Holder { name: "unlit".into(), id: 77 }],
    };
    let upload = Upload {
        port: port.path.clone(),
        kinds: vec![],
        hex: None,
        avrdude: "avrdude".into(),
        silence: SILENCE,
    };
    let error = upload.check_free(&port).unwrap_err().to_string();
    assert!(error.contains("by unlit (process 77)"), "{error}");
}

#[test]
fn the_command_line_fits_the_kind_of_board() {
    let upload = Upload {
        port: "/dev/ttyUSB7".into(),
        kinds: vec![],
        hex: None,
        avrdude: "avrdude".into(),
        silence: SILENCE,
    };
    let words = upload.command(BoardKind::NanoOld, Path::new("/tmp/a b.hex"));
    let words: Vec<&str> = words.iter().map(|word| word.to_str().unwrap()).collect();
    assert_eq!(
        words.join("|"),
        "avrdude|-p|m328p|-c|arduino|-b|57600|-D|-P|/dev/ttyUSB7|-U|flash:w:/tmp/a b.hex:i"
    );
}

#[test]
fn the_packed_program_goes_to_the_board_whole() {
    let Some(bench) = Bench::new() else { return };
    let upload = Upload { hex: None, ..bench.upload(Path::new(""), &[BoardKind::Uno]) };
    upload.run(|_| {}).unwrap();
    let used = bench.board.flash().iter().rposition(|byte| *byte != 0xFF).unwrap() + 1;
    let records = String::from_utf8_lossy(FIRMWARE);
    let data: usize = records
        .lines()
        .filter(|line| line.get(7..9) == Some("00"))
        .map(|line| usize::from_str_radix(&line[1..3], 16).unwrap())
        .sum();
    assert!(used.abs_diff(data) <= 16, "{used} bytes in the board, {data} in the file");
}

#[test]
fn upload_from_the_command_line_programs_a_simulated_board() {
    if Bench::new().is_none() {
        return;
    }
    let output = unlit(&["upload", "--studio"]);
    let text = said(&output);
    assert!(output.status.success() && text.contains("Programmed: flash controller"), "{text}");
}
