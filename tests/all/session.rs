//! The session folder: what was acknowledged is there, whole, whatever happens.

use rand::{RngExt, SeedableRng};
use serde_json::json;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use unlit::pair::{Attempt, Lighting, Polariser, Reason, ReasonCode, Settings, Verdict};
use unlit::progress::Progress;
use unlit::session::{Commit, Damage, Event, More, NewFrame, NewPair, Session, SessionError, Verification};

fn frame<'a>(bytes: &'a [u8], original_name: &'a str) -> NewFrame<'a> {
    NewFrame { bytes, original_name, settings: Settings::default(), prepared: None, jpeg: None }
}

fn pair<'a>(name: Option<&'a str>, off: &'a [u8], on: &'a [u8]) -> NewPair<'a> {
    NewPair {
        name,
        off: frame(off, "a.DNG"),
        on: frame(on, "b.CR2"),
        reasons: Vec::new(),
        flash: None,
        more: More::default(),
    }
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
fn a_lit_frame_through_a_crossed_polariser_is_kept_with_its_angle() {
    let home = tempfile::tempdir().unwrap();
    let path = home.path().join("bath");
    let session = Session::create(&path, "bath").unwrap();
    let at = |angle| Polariser { angle_degrees: Some(angle) };
    let lighting = Lighting { polariser: Some(at(30.0)), flash_power: Some(0.25) };
    session.set_lighting(lighting).unwrap();
    let plain = stored(session.commit_pair(pair(Some("plain"), b"dark", b"lit")).unwrap());
    assert_eq!((plain.lighting, plain.crossed), (lighting, None));
    let mut new = pair(Some("both"), b"dark2", b"lit2");
    new.more.crossed = Some((frame(b"crossed", "c.dng"), at(120.0)));
    let record = stored(session.commit_pair(new).unwrap());
    assert_eq!(record.crossed.as_ref().unwrap().polariser, Some(at(120.0)));
    drop(session);
    let session = Session::open(&path).unwrap();
    assert_eq!(session.pair(record.number).unwrap(), record, "as it is on the disk");
    assert_eq!(session.manifest().lighting, lighting);
    let files = record.frames().map(|(slot, frame)| format!("{slot} {}", frame.file)).collect::<Vec<_>>();
    assert_eq!(files, ["off off.dng", "on on.cr2", "crossed crossed.dng"]);
    let found = session.verify(&Progress::silent()).unwrap();
    assert!(found.findings.is_empty() && found.originals == 5, "{found:?}");
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
    assert_eq!(session.pairs().unwrap(), [first.clone(), second.clone()].map(Arc::new));
    assert_eq!((first.number, first.name.as_str(), first.verdict), (1, "IMG_7", Verdict::Accepted));
    assert_eq!((second.number, second.name.as_str()), (2, "0002"));
    assert_eq!((first.off.file.as_str(), first.on.file.as_str()), ("off.dng", "on.cr2"));
    assert_eq!(std::fs::read(session.pair_dir(1).join("on.cr2")).unwrap(), b"lit");
    assert!(session.verify_pair(first.number).is_empty());
    std::fs::write(session.pair_dir(1).join("off.dng"), b"dork").unwrap();
    assert!(!session.verify_pair(first.number).is_empty());
}

#[test]
fn the_journal_tells_intent_and_result_in_order() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    session.commit_pair(pair(Some("a"), b"1", b"2")).unwrap();
    session.record(Event::Note { what: "shutter".into(), detail: 7.into() }).unwrap();
    let record = Some(unlit::session::store::digest_file(&home.path().join("pairs/0001/pair.json")).unwrap());
    let events: Vec<Event> = session.journal().unwrap().into_iter().map(|e| e.event).collect();
    assert_eq!(
        events,
        [
            Event::SessionCreated,
            Event::PairIntended { number: 1, attempt: 1, name: "a".into() },
            Event::PairCommitted {
                number: 1,
                attempt: 1,
                name: "a".into(),
                verdict: Verdict::Accepted,
                record
            },
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
    let second = stored(session.commit_pair(pair(None, b"3", b"4")).unwrap());
    let file = session.pair_dir(1).join("pair.json");
    std::fs::write(&file, b"{\"number\": 1").unwrap();
    for error in [session.pairs().unwrap_err(), session.pair(1).unwrap_err()] {
        assert!(error.to_string().contains(&file.display().to_string()), "{error}");
    }
    assert_eq!(session.pair(2).unwrap(), second, "the others are there");
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
        assert!(pairs.iter().all(|p| session.verify_pair(p.number).is_empty()));
        assert_eq!(temporaries(home.path()), Vec::<String>::new());
        session.journal().unwrap();
    }
    assert!(acknowledged.len() >= 12);
    assert!(acknowledged.is_sorted_by(|a, b| a < b), "a number was given twice: {acknowledged:?}");
}

#[test]
fn a_pair_that_was_begun_and_not_stored_is_named_and_its_number_is_used_again() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    stored(session.commit_pair(pair(None, b"1", b"2")).unwrap());
    assert_eq!(session.intend_pair().unwrap(), 2);
    // As a killed program leaves it: a stump of a folder, half a line.
    drop(session);
    std::fs::create_dir(home.path().join("pairs/.tmp-1-1")).unwrap();
    std::fs::write(home.path().join("pairs/.tmp-1-1/off.dng"), b"half").unwrap();
    let journal = home.path().join("journal.jsonl");
    let mut torn = std::fs::read(&journal).unwrap();
    torn.extend(b"{\"at\":");
    std::fs::write(&journal, torn).unwrap();

    let session = Session::open(home.path()).unwrap();
    let recovery = session.recovery();
    assert_eq!(
        recovery.interrupted.iter().map(|p| (p.number, p.name.as_str())).collect::<Vec<_>>(),
        [(2, "0002")]
    );
    assert_eq!((recovery.removed.as_slice(), recovery.cut), (&["pairs/.tmp-1-1".into()][..], 6));
    let sentences = recovery.sentences(|_| false);
    assert!(sentences[0].contains("Pair 0002 was interrupted") && sentences.len() == 3, "{sentences:?}");
    assert_eq!(recovery.sentences(|pair| pair.name == "0002").len(), 2);
    assert_eq!(session.next_pair_number().unwrap(), 2);
    let again = stored(session.commit_pair(pair(None, b"3", b"4")).unwrap());
    assert_eq!(again.number, 2);
    drop(session);
    assert_eq!(Session::open(home.path()).unwrap().recovery(), &Default::default(), "told once");
}

#[test]
fn a_pair_whose_folder_is_whole_is_stored_whatever_the_journal_lacks() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    let record = stored(session.commit_pair(pair(None, b"1", b"2")).unwrap());
    drop(session);
    let journal = home.path().join("journal.jsonl");
    let text = std::fs::read_to_string(&journal).unwrap();
    let (before, _) = text.trim_end().rsplit_once('\n').unwrap();
    std::fs::write(&journal, format!("{before}\n")).unwrap();

    let session = Session::open(home.path()).unwrap();
    assert_eq!(session.recovery().completed, [Attempt::first(1)]);
    assert_eq!((session.pairs().unwrap(), session.next_pair_number().unwrap()), (vec![Arc::new(record)], 2));
    assert!(session.verify(&Progress::silent()).unwrap().findings.is_empty());
}

#[test]
fn an_abandoned_pair_gives_its_number_back_and_says_why() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    session.intend_pair().unwrap();
    session.abandon_pair("mirror up").unwrap();
    session.abandon_pair("nothing was intended").unwrap();
    assert_eq!(stored(session.commit_pair(pair(None, b"1", b"2")).unwrap()).number, 1);
    let events: Vec<Event> = session.journal().unwrap().into_iter().map(|e| e.event).collect();
    let (number, name) = (1, "0001".to_owned());
    assert_eq!(
        events[2],
        Event::PairAbandoned { number, attempt: 1, name: name.clone(), why: "mirror up".into() }
    );
    assert_eq!(events[3..].len(), 2, "{events:?}");
    drop(session);
    assert_eq!(Session::open(home.path()).unwrap().recovery(), &Default::default());
}

#[test]
fn verify_names_every_damage_and_nothing_else() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    for n in 1..=5u8 {
        stored(session.commit_pair(pair(None, &[n; 50], &[n + 100; 70])).unwrap());
    }
    let whole = session.verify(&Progress::silent()).unwrap();
    assert!(whole.is_whole() && whole.findings.is_empty(), "{whole:?}");
    assert_eq!((whole.pairs, whole.originals, whole.bytes), (5, 10, 5 * 120));

    let at = |number: u32, name: &str| session.pair_dir(number).join(name);
    let mut altered = std::fs::read(at(1, "off.dng")).unwrap();
    altered[49] ^= 1;
    std::fs::write(at(1, "off.dng"), altered).unwrap();
    std::fs::write(at(2, "on.cr2"), b"short").unwrap();
    std::fs::remove_file(at(3, "off.dng")).unwrap();
    std::fs::write(at(4, "pair.json"), b"{").unwrap();
    std::fs::remove_dir_all(session.pair_dir(5)).unwrap();
    std::fs::write(at(1, "off.tif"), b"developed").unwrap();
    // Sidecars can be made again, and other programs write into them.
    std::fs::remove_file(at(1, "off.xmp")).unwrap();
    std::fs::write(at(1, "on.xmp"), b"<x/>").unwrap();
    std::fs::write(at(1, "on.cr2.xmp"), b"<x/>").unwrap();
    std::fs::create_dir(session.pairs_dir().join("holidays")).unwrap();
    // Card shots: copies that are named by their digest, one of them altered; and one that was stored and is gone.
    let cards = session.calibration_dir().join("flash");
    std::fs::create_dir(&cards).unwrap();
    for (bytes, now) in [(b"card 1", b"card 1"), (b"card 2", b"card 3")] {
        let digest = unlit::session::store::digest(bytes);
        std::fs::write(cards.join(format!("{}_card.cr2", &digest[..8])), now).unwrap();
    }
    let gone = Event::Note { what: "calibration_shot_stored".into(), detail: json!({ "name": "d01000_1" }) };
    session.record(gone).unwrap();
    let altered_card =
        format!("calibration/flash/{}_card.cr2", &unlit::session::store::digest(b"card 2")[..8]);

    let found = session.verify(&Progress::silent()).unwrap();
    let told: Vec<(&str, Damage)> =
        found.findings.iter().map(|f| (f.path.to_str().unwrap(), f.damage)).collect();
    assert_eq!(
        told,
        [
            (altered_card.as_str(), Damage::Altered),
            ("calibration/flash/d01000_1", Damage::Missing),
            ("pairs/0001/off.dng", Damage::Altered),
            ("pairs/0001/off.tif", Damage::Unknown),
            ("pairs/0002/on.cr2", Damage::Altered),
            ("pairs/0003/off.dng", Damage::Missing),
            ("pairs/0004/pair.json", Damage::Unreadable),
            ("pairs/0005", Damage::Missing),
            ("pairs/holidays", Damage::Unknown),
        ]
    );
    assert!(!found.is_whole());
    assert_eq!(found.originals, 3 + 1, "what is altered is not counted");
    // The same from the command line, while another reads.
    drop(session);
    let reader = Session::open_shared(home.path()).unwrap();
    let unlit = Command::new(env!("CARGO_BIN_EXE_unlit"))
        .args(["session", "verify", home.path().to_str().unwrap(), "--json"])
        .output()
        .unwrap();
    assert_eq!(unlit.status.code(), Some(1));
    let printed: Verification = serde_json::from_slice(&unlit.stdout).unwrap();
    assert_eq!(printed, found);
    drop(reader);
}

#[test]
fn every_byte_of_an_original_counts() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    let bytes: Vec<u8> = (0..200).collect();
    stored(session.commit_pair(pair(None, &bytes, b"2")).unwrap());
    let file = session.pair_dir(1).join("off.dng");
    for at in 0..bytes.len() {
        let mut altered = bytes.clone();
        altered[at] = altered[at].wrapping_add(1);
        std::fs::write(&file, altered).unwrap();
        assert_eq!(session.verify_pair(1).len(), 1, "byte {at}");
    }
    std::fs::write(&file, &bytes).unwrap();
    assert_eq!(session.verify_pair(1), []);
}
