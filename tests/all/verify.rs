//! What is stored beside the pairs is checked too, and checking does not stop the work.

use crate::scene_import::{bare_session, import_birdbath};
use serde_json::json;
use std::sync::atomic::{AtomicBool, Ordering};
use unlit::pair::Settings;
use unlit::progress::{Cancelled, Progress};
use unlit::session::{
    Between, Damage, Event, InterruptedShot, More, NewFrame, NewPair, SHOT_ABANDONED, SHOT_STARTED,
    SequencePlan, SequenceRecord, Session, Stage, Verification,
};

fn verified(session: &Session) -> Verification {
    session.verify(&Progress::silent()).unwrap()
}

fn told(found: &Verification) -> Vec<(String, Damage)> {
    found.findings.iter().map(|f| (f.path.display().to_string(), f.damage)).collect()
}

#[test]
fn every_file_of_the_scene_is_checked_with_its_list() {
    let (_folder, session) = bare_session();
    let file = import_birdbath(&session, "colmap");
    let found = verified(&session);
    assert_eq!((found.kept, told(&found)), (2 + 2 + 1, vec![]));

    let scene = session.scene_dir();
    let floor = scene.join(&file.meshes[1].original.file);
    let poses = scene.join(&file.camera_files[1].file);
    let list = scene.join("scene.json");
    for (path, damage) in [(&floor, Damage::Altered), (&poses, Damage::Missing), (&list, Damage::Altered)] {
        let whole = std::fs::read(path).unwrap();
        if damage == Damage::Missing {
            std::fs::remove_file(path).unwrap();
        } else {
            let mut altered = whole.clone();
            let last = altered.len() - 1;
            altered[last] ^= 1;
            // The list stays one that can be read.
            if *path == list {
                altered = String::from_utf8(whole.clone())
                    .unwrap()
                    .replacen("\"scale\": 1.0", "\"scale\": 1.1", 1)
                    .into();
            }
            assert_ne!(altered, whole);
            std::fs::write(path, altered).unwrap();
        }
        let name = path.strip_prefix(session.path()).unwrap().display().to_string();
        let found = verified(&session);
        assert_eq!((told(&found), found.is_whole()), (vec![(name, damage)], false));
        std::fs::write(path, whole).unwrap();
    }
    // The files of a former import stay, and are known by their names.
    import_birdbath(&session, "cameras.xml");
    assert_eq!(verified(&session).kept, 5 + 1);
    std::fs::write(&poses, "1 1 0 0 0 0 0 0 1 a.jpg\n").unwrap();
    let name = poses.strip_prefix(session.path()).unwrap().display().to_string();
    assert_eq!(told(&verified(&session)), [(name, Damage::Altered)]);
}

#[test]
fn a_calibration_result_is_known_by_what_the_journal_says_of_it() {
    let (_folder, session) = bare_session();
    let file = session.calibration_dir().join("flash.json");
    session.keep(&file, b"first").unwrap();
    session.keep(&file, b"second").unwrap();
    assert_eq!((verified(&session).kept, told(&verified(&session))), (1, vec![]));
    let name = "calibration/flash.json".to_owned();
    std::fs::write(&file, b"first").unwrap();
    assert_eq!(
        told(&verified(&session)),
        [(name.clone(), Damage::Altered)],
        "a former result is not the last"
    );
    std::fs::remove_file(&file).unwrap();
    assert_eq!(told(&verified(&session)), [(name, Damage::Missing)]);
    session.keep(&file, b"third").unwrap();
    // A result of an earlier version, of which nothing was written down, harms nothing.
    std::fs::write(session.calibration_dir().join("saturation.json"), b"{}").unwrap();
    let found = verified(&session);
    assert_eq!(told(&found), [("calibration/saturation.json".to_owned(), Damage::Unknown)]);
    assert!(found.is_whole());
}

#[test]
fn calibration_shots_that_never_ended_are_settled_at_the_next_opening() {
    let (_folder, session) = bare_session();
    let path = session.path().to_owned();
    let note = |what: &str, name: &str| {
        session.record(Event::Note { what: what.into(), detail: json!({ "name": name }) }).unwrap();
    };
    // One given up and begun again, one that was renamed into place before the journal heard of it.
    for (what, name) in [
        (SHOT_STARTED, "d01000_1"),
        (SHOT_ABANDONED, "d01000_1"),
        (SHOT_STARTED, "d01000_1"),
        (SHOT_STARTED, "d01000_2"),
        (SHOT_STARTED, "d00700_1"),
        (SHOT_ABANDONED, "d00700_1"),
    ] {
        note(what, name);
    }
    let whole = session.calibration_dir().join("flash/d01000_2");
    std::fs::create_dir_all(&whole).unwrap();
    std::fs::write(whole.join("shot.json"), b"{}").unwrap();
    let begun = session.journal().unwrap()[3].at.clone();
    drop(session);

    let session = Session::open(&path).unwrap();
    let recovery = session.recovery();
    assert_eq!(recovery.interrupted_shots, [InterruptedShot { name: "d01000_1".into(), begun }]);
    assert_eq!(recovery.completed_shots, ["d01000_2"]);
    let sentences = recovery.sentences(|_| false).join(" ");
    assert!(sentences.contains("Calibration shot d01000_1 was interrupted"), "{sentences}");
    assert!(sentences.contains("Calibration shot d01000_2 was stored whole"), "{sentences}");
    drop(session);
    assert_eq!(Session::open(&path).unwrap().recovery(), &Default::default(), "told once");
}

fn commit(session: &Session) {
    let frame = |bytes| NewFrame {
        bytes,
        original_name: "a.dng",
        settings: Settings::default(),
        prepared: None,
        jpeg: None,
    };
    let pair = NewPair {
        name: None,
        off: frame(b"off"),
        on: frame(b"on"),
        reasons: vec![],
        flash: None,
        more: More::default(),
    };
    session.commit_pair(pair).unwrap();
}

#[test]
fn every_byte_of_a_record_counts_also_of_one_that_a_crash_left_whole() {
    let (_folder, session) = bare_session();
    commit(&session);
    let path = session.path().to_owned();
    let (file, journal) = (session.pair_dir(1).join("pair.json"), path.join("journal.jsonl"));
    drop(session);
    for crash in [false, true] {
        if crash {
            let text = std::fs::read_to_string(&journal).unwrap();
            let (before, _) = text.trim_end().rsplit_once('\n').unwrap();
            std::fs::write(&journal, format!("{before}\n")).unwrap();
        }
        let session = Session::open(&path).unwrap();
        assert_eq!(session.recovery().completed.len(), usize::from(crash));
        assert!(verified(&session).findings.is_empty());
        let whole = std::fs::read_to_string(&file).unwrap();
        let altered = whole.replace("\"name\": \"0001\"", "\"name\": \"0007\"");
        assert_ne!(altered, whole);
        std::fs::write(&file, altered).unwrap();
        let found = verified(&session);
        assert_eq!(told(&found), [("pairs/0001/pair.json".to_owned(), Damage::Altered)], "crash: {crash}");
        assert_eq!(session.verify_pair(1), found.findings);
        std::fs::write(&file, whole).unwrap();
    }
    // An entry of before, which has no digest, is as good as it was.
    let text = std::fs::read_to_string(&journal).unwrap();
    let cut = text.rfind(",\"record\":").unwrap();
    std::fs::write(&journal, format!("{}}}\n", &text[..cut])).unwrap();
    let session = Session::open(&path).unwrap();
    assert!(verified(&session).findings.is_empty());
    assert_eq!(session.recovery(), &Default::default());
}

#[test]
fn a_sequence_that_cannot_be_read_or_whose_pair_is_gone_is_told() {
    let (_folder, session) = bare_session();
    commit(&session);
    let plan = SequencePlan::new(2, Between::Hook);
    let mut record = SequenceRecord { stage: Stage::Begun, ..SequenceRecord::planned(plan) };
    record.positions[0].pairs = vec![1];
    session.set_sequence(&record).unwrap();
    assert_eq!(told(&verified(&session)), []);
    assert!(session.files().unwrap().iter().any(|file| file.path == "sequence.json"));

    record.positions[1].pairs = vec![2];
    session.set_sequence(&record).unwrap();
    let found = verified(&session);
    assert_eq!(told(&found), [("pairs/0002".to_owned(), Damage::Missing)]);
    assert!(found.findings[0].why.contains("position 2"), "{:?}", found.findings);
    // What the journal calls stored is told once.
    std::fs::rename(session.pair_dir(1), session.path().join("elsewhere")).unwrap();
    let names: Vec<_> = told(&verified(&session)).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["pairs/0001", "pairs/0002"]);

    std::fs::write(session.path().join("sequence.json"), "{").unwrap();
    let found = told(&verified(&session));
    assert!(found.contains(&("sequence.json".to_owned(), Damage::Unreadable)), "{found:?}");
}

#[test]
fn pairs_are_stored_while_a_session_is_checked_and_nothing_is_taken_for_damage() {
    let (_folder, session) = bare_session();
    commit(&session);
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            // At least one, however soon the other is done.
            loop {
                commit(&session);
                if over.load(Ordering::Relaxed) {
                    break;
                }
            }
        });
        for _ in 0..20 {
            let found = verified(&session);
            assert!(found.findings.is_empty(), "{:?}", found.findings);
        }
        over.store(true, Ordering::Relaxed);
    });
    let progress = Progress::silent();
    progress.cancel();
    assert_eq!(session.verify(&progress), Err(Cancelled));
    assert!(verified(&session).pairs > 1);
}
