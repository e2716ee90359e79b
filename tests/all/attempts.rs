//! Pairs that are shot again, in the session folder: what was acknowledged is there, whole, whatever happens.

use rand::{RngExt, SeedableRng};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use unlit::pair::order::{Order, Program};
use unlit::pair::{Attempt, PairRecord, Reason, ReasonCode, Settings, Verdict};
use unlit::progress::Progress;
use unlit::session::{Commit, Damage, Event, More, NewFrame, NewPair, Session, SessionError};

fn frame(bytes: &[u8]) -> NewFrame<'_> {
    NewFrame { bytes, original_name: "a.dng", settings: Settings::default(), prepared: None, jpeg: None }
}

fn weak() -> Vec<Reason> {
    vec![Reason { code: ReasonCode::Weak, figure: 0.5, limit: 1.0, sentence: "too little".into() }]
}

/// Two frames made of these bytes, rejected, or accepted under the number of a rejected pair.
fn pair<'a>(off: &'a [u8], on: &'a [u8], again: Option<u32>, reasons: Vec<Reason>) -> NewPair<'a> {
    let more = More { again, ..More::default() };
    NewPair { name: None, off: frame(off), on: frame(on), reasons, flash: None, more }
}

fn stored(commit: Result<Commit, SessionError>) -> PairRecord {
    match commit.unwrap() {
        Commit::Stored(record) => record,
        Commit::AlreadyThere(record) => panic!("{} was there already", record.name),
    }
}

fn with_a_rejected_pair(path: &Path) -> Session {
    let session = Session::create(path, "bath").unwrap();
    let record = stored(session.commit_pair(pair(b"1", b"2", None, weak())));
    assert_eq!((record.number, record.attempt, record.verdict), (1, 1, Verdict::Rejected));
    session
}

fn without_the_last_line(journal: &Path) {
    let text = std::fs::read_to_string(journal).unwrap();
    let (before, _) = text.trim_end().rsplit_once('\n').unwrap();
    std::fs::write(journal, format!("{before}\n")).unwrap();
}

#[test]
fn further_attempts_have_folders_of_their_own_and_only_rejected_pairs_have_any() {
    let home = tempfile::tempdir().unwrap();
    let session = with_a_rejected_pair(home.path());
    assert!(matches!(
        session.intend(Some(2), Program::default()),
        Err(SessionError::NoSuchPair { number: 2, .. })
    ));
    let own = session.intend(Some(1), Program::default()).unwrap();
    assert_eq!(own, Attempt { number: 1, attempt: 2 });
    let second = stored(session.commit_pair(pair(b"3", b"4", Some(1), vec![])));
    assert_eq!((second.number, second.attempt, second.name.as_str()), (1, 2, "0001"));
    assert_eq!(std::fs::read(home.path().join("pairs/0001/off.dng")).unwrap(), b"1");
    assert_eq!(std::fs::read(home.path().join("pairs/0001-2/off.dng")).unwrap(), b"3");
    assert_eq!(session.pairs().unwrap(), [Arc::new(second)]);
    let refused = session.commit_pair(pair(b"5", b"6", Some(1), vec![]));
    assert!(matches!(refused, Err(SessionError::PairAccepted { number: 1 })), "{refused:?}");
    assert!(!home.path().join("pairs/0001-3").exists());
    assert_eq!(session.intend_pair().unwrap(), 2);
}

#[test]
fn a_session_of_before_is_read_as_it_is_and_says_so_once_it_holds_more() {
    let home = tempfile::tempdir().unwrap();
    drop(with_a_rejected_pair(home.path()));
    let manifest = home.path().join("session.json");
    let schema = || std::fs::read_to_string(&manifest).unwrap().contains("\"schema\": 3");
    let old = std::fs::read_to_string(&manifest).unwrap().replace("\"schema\": 3", "\"schema\": 2");
    std::fs::write(&manifest, old).unwrap();
    let session = Session::open(home.path()).unwrap();
    assert_eq!(session.pairs().unwrap()[0].program(), Program::default());
    stored(session.commit_pair(pair(b"3", b"4", None, vec![])));
    assert!(!schema(), "what programs of before read as well stays as it is");
    stored(session.commit_pair(pair(b"5", b"6", Some(1), vec![])));
    assert!(schema());
}

#[test]
fn an_attempt_that_was_interrupted_is_named_and_leaves_the_pair_as_it_was() {
    let home = tempfile::tempdir().unwrap();
    let session = with_a_rejected_pair(home.path());
    let before = session.pairs().unwrap();
    session.intend(Some(1), Program::new(Order::OffOnOff, 1).unwrap()).unwrap();
    drop(session);
    let session = Session::open(home.path()).unwrap();
    let interrupted: Vec<(u32, u32)> =
        session.recovery().interrupted.iter().map(|p| (p.number, p.attempt)).collect();
    assert_eq!(interrupted, [(1, 2)]);
    let sentences = session.recovery().sentences(|pair| pair.is_among(&before));
    assert!(sentences[0].contains("shoot pair 1 again"), "{sentences:?}");
    assert_eq!((session.pairs().unwrap(), session.next_pair_number().unwrap()), (before, 2));
    let again = stored(session.commit_pair(pair(b"3", b"4", Some(1), vec![])));
    assert_eq!(again.attempt, 2);
    let now = session.pairs().unwrap();
    assert_eq!(session.recovery().sentences(|pair| pair.is_among(&now)), Vec::<String>::new());
    drop(session);
    assert_eq!(Session::open(home.path()).unwrap().recovery(), &Default::default(), "told once");
}

#[test]
fn an_attempt_whose_folder_is_whole_is_stored_whatever_the_journal_lacks() {
    let home = tempfile::tempdir().unwrap();
    let session = with_a_rejected_pair(home.path());
    let second = stored(session.commit_pair(pair(b"3", b"4", Some(1), vec![])));
    drop(session);
    without_the_last_line(&home.path().join("journal.jsonl"));
    let session = Session::open(home.path()).unwrap();
    assert_eq!(session.recovery().completed, [Attempt { number: 1, attempt: 2 }]);
    assert_eq!(session.pairs().unwrap(), [Arc::new(second)]);
    assert!(session.verify(&Progress::silent()).unwrap().findings.is_empty());
}

#[test]
fn an_attempt_is_never_numbered_twice_even_when_its_folder_was_moved_away() {
    let home = tempfile::tempdir().unwrap();
    let session = with_a_rejected_pair(home.path());
    let second = stored(session.commit_pair(pair(b"3", b"4", Some(1), weak())));
    std::fs::rename(session.pair_dir(&second), home.path().join("elsewhere")).unwrap();
    drop(session);
    let session = Session::open(home.path()).unwrap();
    assert_eq!(stored(session.commit_pair(pair(b"5", b"6", Some(1), vec![]))).attempt, 3);
    let found = session.verify(&Progress::silent()).unwrap();
    let told: Vec<(&str, Damage)> =
        found.findings.iter().map(|f| (f.path.to_str().unwrap(), f.damage)).collect();
    assert_eq!(told, [("pairs/0001-2", Damage::Missing)]);
    assert!(found.findings[0].why.contains("attempt 2 at pair 0001"), "{found:?}");
}

#[test]
fn an_imported_pair_is_shot_again_under_its_name_and_known_again_by_any_attempt() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    let imported = || NewPair { name: Some("IMG_7"), ..pair(b"1", b"2", None, weak()) };
    let first = stored(session.commit_pair(imported()));
    let second = stored(session.commit_pair(pair(b"3", b"4", Some(first.number), vec![])));
    assert_eq!((second.name.as_str(), second.number, second.attempt), ("IMG_7", first.number, 2));
    let known = session.commit_pair(imported()).unwrap();
    assert_eq!(known, Commit::AlreadyThere(first));
    let other = NewPair { name: Some("IMG_7"), ..pair(b"1", b"9", None, vec![]) };
    assert!(matches!(session.commit_pair(other), Err(SessionError::DuplicateName { number: 1, .. })));
}

#[test]
fn an_attempt_that_is_abandoned_is_written_down_as_such() {
    let home = tempfile::tempdir().unwrap();
    let session = with_a_rejected_pair(home.path());
    session.intend(Some(1), Program::default()).unwrap();
    session.abandon_pair("mirror up").unwrap();
    let last = session.journal().unwrap().pop().unwrap().event;
    let (number, attempt, name) = (1, 2, "0001".to_owned());
    assert_eq!(last, Event::PairAbandoned { number, attempt, name, why: "mirror up".into() });
    drop(session);
    assert_eq!(Session::open(home.path()).unwrap().recovery(), &Default::default());
}

const CHILD_FOLDER: &str = "UNLIT_TEST_ATTEMPTS_UNTIL_KILLED";

/// Run by the test below in a process of its own: each pair is rejected twice and then good, of three frames each time.
#[test]
fn shoots_again_until_killed() {
    let Some(folder) = std::env::var_os(CHILD_FOLDER) else { return };
    let session = Session::open(Path::new(&folder)).unwrap();
    let orphan_guard = Instant::now() + Duration::from_secs(60);
    while Instant::now() < orphan_guard {
        let last = session.pairs().unwrap().pop();
        let last = last.filter(|record| record.verdict == Verdict::Rejected);
        let again = last.as_ref().map(|record| record.number);
        let bytes = vec![session.journal().unwrap().len() as u8; 40_000];
        let reasons = if last.is_some_and(|record| record.attempt > 1) { vec![] } else { weak() };
        let mut new = pair(&bytes, &bytes[..20_000], again, reasons);
        new.more.program = Program::new(Order::OffOnOff, 1).unwrap();
        new.more.after = vec![frame(&bytes[..30_000])];
        session.intend(again, new.more.program).unwrap();
        println!("\ncommitted {}", Attempt::from(&stored(session.commit_pair(new))));
    }
}

#[test]
fn kill_9_at_any_moment_loses_no_attempt_that_was_acknowledged() {
    let home = tempfile::tempdir().unwrap();
    drop(Session::create(home.path(), "bath").unwrap());
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(12);
    let mut acknowledged: Vec<Attempt> = Vec::new();
    for _ in 0..10 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "attempts::shoots_again_until_killed", "--nocapture"])
            .env(CHILD_FOLDER, home.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let told = |line: &str| line.strip_prefix("committed ").map(|n| Attempt::from_folder(n).unwrap());
        for _ in 0..random.random_range(1..4) {
            acknowledged.push(lines.by_ref().find_map(|line| told(&line.unwrap())).unwrap());
        }
        // The moment inside the next commit at which the blow falls; its length is the point of the test.
        std::thread::sleep(Duration::from_micros(random.random_range(0..8000)));
        child.kill().unwrap();
        child.wait().unwrap();
        acknowledged.extend(lines.map_while(Result::ok).filter_map(|line| told(&line)));

        let session = Session::open(home.path()).unwrap();
        let there: Vec<Attempt> =
            session.attempts().unwrap().values().flatten().map(|pair| Attempt::from(&**pair)).collect();
        assert!(acknowledged.iter().all(|own| there.contains(own)), "{acknowledged:?} {there:?}");
        let found = session.verify(&Progress::silent()).unwrap();
        assert!(found.findings.is_empty() && found.originals == 3 * there.len(), "{found:?}");
    }
    assert!(acknowledged.is_sorted_by(|a, b| a < b), "an attempt was numbered twice: {acknowledged:?}");
    assert!(acknowledged.iter().any(|own| own.attempt == 3), "{acknowledged:?}");
}
