//! The session folder: what was acknowledged is there, whole, whatever happens.

use rand::{RngExt, SeedableRng};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use unlit::pair::{Reason, ReasonCode, Settings, Verdict};
use unlit::session::{Commit, Event, NewFrame, NewPair, Session, SessionError};

fn frame<'a>(bytes: &'a [u8], original_name: &'a str) -> NewFrame<'a> {
    NewFrame { bytes, original_name, settings: Settings::default(), prepared: None, jpeg: None }
}

fn pair<'a>(name: Option<&'a str>, off: &'a [u8], on: &'a [u8]) -> NewPair<'a> {
    NewPair { name, off: frame(off, "a.DNG"), on: frame(on, "b.CR2"), reasons: Vec::new(), flash: None }
}

fn stored(commit: Commit) -> unlit::pair::PairRecord {
    match commit {
        Commit::Stored(record) => record,
        Commit::AlreadyThere(record) => panic!("{} was there already", record.name),
    }
}

fn temporaries(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        if name.starts_with(".tmp-") {
            found.push(name);
        } else if entry.path().is_dir() {
            found.extend(temporaries(&entry.path()));
        }
    }
    found
}

#[test]
fn a_committed_pair_is_there_byte_for_byte_after_reopening() {
    let home = tempfile::tempdir().unwrap();
    let path = home.path().join("bath");
    let session = Session::create(&path, "bath").unwrap();
    let first = stored(session.commit_pair(pair(Some("IMG_7"), b"dark", b"lit")).unwrap());
    let second = stored(session.commit_pair(pair(None, b"dark2", b"lit2")).unwrap());
    drop(session);

    let session = Session::open(&path).unwrap();
    assert_eq!(session.manifest().name, "bath");
    assert_eq!(session.pairs().unwrap(), [first.clone(), second.clone()]);
    assert_eq!((first.number, first.name.as_str(), first.verdict), (1, "IMG_7", Verdict::Accepted));
    assert_eq!((second.number, second.name.as_str()), (2, "0002"));
    assert_eq!((first.off.file.as_str(), first.on.file.as_str()), ("off.dng", "on.cr2"));
    assert_eq!(std::fs::read(session.pair_dir(1).join("on.cr2")).unwrap(), b"lit");
    assert!(session.originals_intact(&first).unwrap());
    std::fs::write(session.pair_dir(1).join("off.dng"), b"dork").unwrap();
    assert!(!session.originals_intact(&first).unwrap());
}

#[test]
fn the_journal_tells_intent_and_result_in_order() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    session.commit_pair(pair(Some("a"), b"1", b"2")).unwrap();
    session.record(Event::Note { what: "shutter".into(), detail: 7.into() }).unwrap();
    let events: Vec<Event> = session.journal().unwrap().into_iter().map(|e| e.event).collect();
    assert_eq!(
        events,
        [
            Event::SessionCreated,
            Event::PairIntended { number: 1, name: "a".into() },
            Event::PairCommitted { number: 1, name: "a".into(), verdict: Verdict::Accepted },
            Event::Note { what: "shutter".into(), detail: 7.into() },
        ]
    );
}

#[test]
fn a_pair_with_reasons_is_rejected() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    let reason = Reason { code: ReasonCode::Weak, figure: 0.5, limit: 1.0, sentence: "too little".into() };
    let new = NewPair { reasons: vec![reason.clone()], ..pair(Some("a"), b"1", b"2") };
    let record = stored(session.commit_pair(new).unwrap());
    assert_eq!((record.verdict, record.reasons), (Verdict::Rejected, vec![reason]));
}

#[test]
fn the_same_pair_twice_is_stored_once_and_another_of_its_name_is_refused() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    stored(session.commit_pair(pair(Some("a"), b"1", b"2")).unwrap());
    let again = session.commit_pair(pair(Some("a"), b"1", b"2")).unwrap();
    assert!(matches!(again, Commit::AlreadyThere(record) if record.number == 1));
    let other = session.commit_pair(pair(Some("a"), b"1", b"3"));
    assert!(matches!(other, Err(SessionError::DuplicateName { number: 1, .. })));
    assert_eq!(session.pairs().unwrap().len(), 1);
}

#[test]
fn a_number_is_never_used_again_even_when_its_folder_was_moved_away() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    stored(session.commit_pair(pair(None, b"1", b"2")).unwrap());
    std::fs::rename(session.pair_dir(1), home.path().join("elsewhere")).unwrap();
    drop(session);
    assert_eq!(Session::open(home.path()).unwrap().next_pair_number().unwrap(), 2);
}

#[test]
fn names_that_would_leave_the_folder_are_refused() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    for name in ["", "..", "../x", "a/b", ".hidden", "a\nb"] {
        let refused = session.commit_pair(pair(Some(name), b"1", b"2"));
        assert!(matches!(refused, Err(SessionError::BadName { .. })), "{name:?}");
    }
}

#[test]
fn one_writer_at_a_time_or_several_readers() {
    let home = tempfile::tempdir().unwrap();
    let writer = Session::create(home.path(), "bath").unwrap();
    assert!(matches!(Session::open(home.path()), Err(SessionError::Locked { .. })));
    assert!(matches!(Session::open_shared(home.path()), Err(SessionError::Locked { .. })));
    drop(writer);
    let reader = Session::open_shared(home.path()).unwrap();
    let other = Session::open_shared(home.path()).unwrap();
    assert!(matches!(Session::open(home.path()), Err(SessionError::Locked { .. })));
    assert!(matches!(reader.commit_pair(pair(None, b"1", b"2")), Err(SessionError::ReadOnly { .. })));
    assert_eq!(other.pairs().unwrap(), []);
}

#[test]
fn what_is_no_session_or_not_empty_is_named() {
    let home = tempfile::tempdir().unwrap();
    assert!(matches!(Session::open(home.path()), Err(SessionError::NotASession { .. })));
    std::fs::write(home.path().join("holiday.jpg"), b"x").unwrap();
    assert!(matches!(Session::create(home.path(), "x"), Err(SessionError::NotEmpty { .. })));
}

#[test]
fn a_damaged_record_is_an_error_that_names_it() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    stored(session.commit_pair(pair(None, b"1", b"2")).unwrap());
    let file = session.pair_dir(1).join("pair.json");
    std::fs::write(&file, b"{\"number\": 1").unwrap();
    let error = session.pairs().unwrap_err();
    assert!(error.to_string().contains(&file.display().to_string()), "{error}");
}

const CHILD_FOLDER: &str = "UNLIT_TEST_COMMIT_UNTIL_KILLED";

/// Run by the test below in a process of its own: commits pairs for ever, says each number once committed.
#[test]
fn commits_until_killed() {
    let Some(folder) = std::env::var_os(CHILD_FOLDER) else { return };
    let session = Session::open(Path::new(&folder)).unwrap();
    let orphan_guard = Instant::now() + Duration::from_secs(60);
    while Instant::now() < orphan_guard {
        let number = session.next_pair_number().unwrap();
        let bytes = vec![number as u8; 40_000];
        stored(session.commit_pair(pair(None, &bytes, &bytes[..20_000])).unwrap());
        println!("\ncommitted {number}");
    }
}

#[test]
fn kill_9_at_any_moment_loses_nothing_that_was_acknowledged() {
    let home = tempfile::tempdir().unwrap();
    drop(Session::create(home.path(), "bath").unwrap());
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(9);
    let mut acknowledged = Vec::new();
    for _ in 0..12 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "session::commits_until_killed", "--nocapture"])
            .env(CHILD_FOLDER, home.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let wanted = random.random_range(1..4);
        let mut seen = 0;
        let number_in = |line: &str| line.strip_prefix("committed ").map(|n| n.parse::<u32>().unwrap());
        while seen < wanted {
            if let Some(number) = number_in(&lines.next().expect("the child ended by itself").unwrap()) {
                acknowledged.push(number);
                seen += 1;
            }
        }
        // The moment inside the next commit at which the blow falls; its length is the point of the test.
        std::thread::sleep(Duration::from_micros(random.random_range(0..8000)));
        child.kill().unwrap();
        child.wait().unwrap();
        acknowledged.extend(lines.map_while(Result::ok).filter_map(|line| number_in(&line)));

        let session = Session::open(home.path()).unwrap();
        let pairs = session.pairs().unwrap();
        let numbers: Vec<u32> = pairs.iter().map(|p| p.number).collect();
        for number in &acknowledged {
            assert!(numbers.contains(number), "pair {number} was acknowledged and is lost");
        }
        assert!(pairs.iter().all(|p| session.originals_intact(p).unwrap()));
        assert_eq!(temporaries(home.path()), Vec::<String>::new());
        session.journal().unwrap();
    }
    assert!(acknowledged.len() >= 12);
    assert!(acknowledged.is_sorted_by(|a, b| a < b), "a number was given twice: {acknowledged:?}");
}
