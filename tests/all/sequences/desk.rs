//! The desk conducts: goes, pauses, rejected pairs, others who shoot in between.

use crate::fake_rig::Room;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use unlit::capture::{
    Desk, DeskError, Engine, Events, FlashKind, PairWish, RigSource, SequenceError, SequenceEvent,
    SequenceState, SequenceView, Topic, Works,
};
use unlit::jobs::{Job, WorkError};
use unlit::pair::Limits;
use unlit::session::{Between, SequencePlan, SequenceRecord, Session, Stage, UnderWay};

const PATIENCE: Duration = Duration::from_secs(60);

/// Processing that nobody asks for here.
fn no_works() -> Works {
    fn none() -> WorkError {
        WorkError::failed("none", "this desk processes nothing")
    }
    Works {
        process: Arc::new(|_, (), _| Err(none())),
        calibrate_flash: Arc::new(|_, _, _| Err(none())),
        calibrate: Arc::new(|_, _, _| Err(none())),
        import_scene: Arc::new(|_, _, _| Err(none())),
        has_scene: Arc::new(|_| false),
        has_flash_calibration: Arc::new(|_| false),
        needs_processing: Arc::new(|_| false),
    }
}

fn desk_in(folder: &Path, rig: RigSource) -> Desk {
    let events = Events::default();
    let engine = Arc::new(Engine::new(rig, Limits::default(), events.clone()));
    Desk::open(engine, events, folder, no_works(), None).unwrap()
}

/// A desk with the session "vase" and a sequence.
pub(super) struct Studio {
    folder: TempDir,
    pub(super) desk: Desk,
}

impl Studio {
    pub(super) fn open(rig: RigSource, plan: SequencePlan) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let desk = desk_in(folder.path(), rig);
        desk.enter("vase").unwrap();
        let (view, made) = desk.plan_sequence("vase", plan).unwrap();
        assert_eq!((view.state, made), (SequenceState::Planned, true));
        Self { folder, desk }
    }

    pub(super) fn wish(&self, event: SequenceEvent) -> SequenceView {
        self.desk.direct_sequence("vase", event.clone(), None).unwrap_or_else(|e| panic!("{event:?}: {e}"))
    }

    fn refused(&self, event: SequenceEvent, position: Option<u32>) -> SequenceError {
        match self.desk.direct_sequence("vase", event.clone(), position) {
            Err(DeskError::Sequence(error)) => error,
            other => panic!("{event:?}: {other:?}"),
        }
    }

    pub(super) fn view(&self) -> SequenceView {
        self.desk.sequence("vase").unwrap()
    }

    /// Waits until the sequence stands so, and gives it.
    pub(super) fn until(&self, state: SequenceState, position: Option<u32>) -> SequenceView {
        let end = Instant::now() + PATIENCE;
        loop {
            let view = self.view();
            if (view.state, view.position) == (state, position) {
                return view;
            }
            assert!(Instant::now() < end, "it never was {state:?} at {position:?}: {view:?}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    pub(super) fn ended(&self, job: &Job) -> Job {
        let end = Instant::now() + PATIENCE;
        loop {
            let job = self.desk.queue().get(job.id).unwrap();
            if job.state.is_final() {
                return job;
            }
            assert!(Instant::now() < end, "{job:?}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    pub(super) fn pairs(view: &SequenceView) -> Vec<Vec<u32>> {
        view.positions.iter().map(|p| p.pairs.clone()).collect()
    }
}

#[test]
fn a_script_walks_through_while_somebody_else_shoots_too() {
    let studio = Studio::open(Room::default().rig(), SequencePlan::new(3, Between::Hook));
    let (_, mut heard) = studio.desk.events().listen();
    assert!(matches!(studio.refused(SequenceEvent::Next, None), SequenceError::Refused { .. }));
    studio.wish(SequenceEvent::Start);
    for position in 1..=3 {
        studio.until(SequenceState::Waiting, Some(position));
        let other = studio.desk.take_pair(Some("vase"), PairWish::default()).unwrap();
        studio.wish(SequenceEvent::Next);
        // A go that is repeated because its answer was lost takes no second pair.
        studio.desk.direct_sequence("vase", SequenceEvent::Next, Some(position)).unwrap_err();
        studio.ended(&other);
    }
    let view = studio.until(SequenceState::Done, None);
    assert_eq!(Studio::pairs(&view), [vec![2], vec![4], vec![6]]);
    assert_eq!((view.done, view.words.as_str()), (3, "All 3 positions are done."));
    let error = studio.refused(SequenceEvent::Next, Some(1));
    assert!(matches!(error, SequenceError::Elsewhere { asked: 1, .. }), "{error}");
    // Everybody heard it in words and as data.
    let mut words = Vec::new();
    while let Ok(event) = heard.try_recv() {
        if event.topic == Topic::Sequence {
            assert_eq!(event.data["session"], "vase");
            words.push(event.words.clone());
        }
    }
    for said in
        ["Position 2 of 3: move on; waits for the script's word.", "Position 3 of 3: taking the pair."]
    {
        assert!(words.iter().any(|w| w == said), "{words:?}");
    }
}

#[test]
fn a_pause_lets_the_pair_end_and_a_cancel_stops_it() {
    let room = Room::default();
    let studio = Studio::open(room.rig_with(|| FlashKind::Manual), SequencePlan::new(3, Between::Prompt));
    let (_, mut heard) = studio.desk.events().listen();
    let mut confirm = |flash_on| {
        while heard.blocking_recv().unwrap().topic != Topic::Prompt {}
        room.switch_flash(flash_on);
        assert!(studio.desk.confirm(), "nothing is asked");
    };
    studio.wish(SequenceEvent::Start);
    studio.wish(SequenceEvent::Next);
    assert!(studio.wish(SequenceEvent::Pause).pausing);
    confirm(false);
    confirm(true);
    let view = studio.until(SequenceState::Paused, Some(2));
    assert_eq!(view.done, 1, "{view:?}");
    assert!(matches!(studio.refused(SequenceEvent::Next, None), SequenceError::Refused { .. }));
    studio.wish(SequenceEvent::Resume);
    studio.wish(SequenceEvent::Next);
    assert_eq!(studio.wish(SequenceEvent::Cancel).state, SequenceState::Cancelled);
    for job in studio.desk.queue().list() {
        studio.ended(&job);
    }
    let view = studio.view();
    assert_eq!((view.state, view.done, view.position), (SequenceState::Cancelled, 1, None));
    assert_eq!(studio.desk.session("vase").unwrap().pairs().unwrap().len(), 1);
}

#[test]
fn the_trigger_file_is_taken_once_and_vanishes_when_its_position_is_done() {
    let studio = Studio::open(Room::default().rig(), SequencePlan::new(2, Between::TriggerFile));
    let file = studio.folder.path().join("vase/trigger");
    std::fs::write(&file, "left over").unwrap();
    studio.wish(SequenceEvent::Start);
    assert!(!file.exists(), "a file from before counts for nothing");
    for position in 1..=2 {
        studio.until(SequenceState::Waiting, Some(position));
        std::fs::write(&file, "").unwrap();
        let end = Instant::now() + PATIENCE;
        while file.exists() {
            assert!(Instant::now() < end, "{:?}", studio.view());
            std::thread::sleep(Duration::from_millis(5));
        }
        assert!(studio.view().done >= position - 1);
    }
    assert_eq!(Studio::pairs(&studio.until(SequenceState::Done, None)), [[1], [2]]);
}

#[test]
fn a_trigger_that_cannot_be_removed_pauses_instead_of_shooting_for_ever() {
    let studio = Studio::open(Room::default().rig(), SequencePlan::new(3, Between::TriggerFile));
    studio.wish(SequenceEvent::Start);
    let file = studio.folder.path().join("vase/trigger");
    std::fs::create_dir(&file).unwrap();
    let view = studio.until(SequenceState::Paused, Some(2));
    assert!(view.words.contains("trigger cannot be removed"), "{}", view.words);
    assert_eq!(view.done, 1);
    std::fs::remove_dir(&file).unwrap();
    studio.wish(SequenceEvent::Resume);
    studio.until(SequenceState::Waiting, Some(2));
}

#[test]
fn a_countdown_takes_the_pairs_by_itself_and_keeps_the_interval() {
    let order = SequencePlan { interval_s: 0.5, ..SequencePlan::new(3, Between::Countdown { seconds: 0.1 }) };
    let studio = Studio::open(Room::default().rig(), order);
    let begun = Instant::now();
    studio.wish(SequenceEvent::Start);
    assert_eq!(Studio::pairs(&studio.until(SequenceState::Done, None)), [[1], [2], [3]]);
    assert!(begun.elapsed() >= Duration::from_millis(1100), "{:?}", begun.elapsed());
}

#[test]
fn a_pair_that_somebody_cancels_before_its_turn_asks() {
    let studio =
        Studio::open(Room::default().rig_with(|| FlashKind::Manual), SequencePlan::new(2, Between::Hook));
    // Another's pair waits for the operator and holds the rig.
    let other = studio.desk.take_pair(Some("vase"), PairWish::default()).unwrap();
    studio.wish(SequenceEvent::Start);
    studio.wish(SequenceEvent::Next);
    let own = studio.desk.queue().list()[0].clone();
    assert_ne!(own.id, other.id);
    studio.desk.queue().cancel(own.id).unwrap();
    let view = studio.until(SequenceState::Asking, Some(1));
    assert!(view.words.contains("The pair was cancelled."), "{}", view.words);
    studio.desk.queue().cancel(other.id).unwrap();
    studio.ended(&other);
    let refused = studio.desk.retry(own.id).unwrap_err().to_string();
    assert!(refused.contains("position 1 of the sequence of vase; tell the sequence `retry`"), "{refused}");
}

#[test]
fn a_desk_that_is_opened_anew_waits_to_be_asked_and_goes_on_at_the_first_missing_position() {
    let room = Room::default();
    let Studio { folder, desk } = {
        let studio = Studio::open(room.rig(), SequencePlan::new(3, Between::Countdown { seconds: 0.0 }));
        studio.wish(SequenceEvent::Start);
        studio.until(SequenceState::Done, None);
        studio
    };
    drop(desk);
    // The pair of the second position is taken away: it is missing again.
    std::fs::rename(folder.path().join("vase/pairs/0002"), folder.path().join("elsewhere")).unwrap();
    let desk = desk_anew(&folder, &room);
    let studio = Studio { folder, desk };
    let shots = room.log().len();
    let read = studio.view();
    assert_eq!((read.state, read.position), (SequenceState::Paused, Some(2)), "{read:?}");
    let listed = || studio.desk.sequences().iter().map(|view| view.state).collect::<Vec<_>>();
    assert_eq!(listed(), []);
    studio.desk.resume();
    assert_eq!(
        listed(),
        [SequenceState::Paused],
        "what is under way is told before anybody enters its session"
    );
    let (_, mut heard) = studio.desk.events().listen();
    studio.desk.enter("vase").unwrap();
    assert_eq!(listed(), [SequenceState::Paused]);
    let said = std::iter::from_fn(|| heard.try_recv().ok()).find(|e| e.topic == Topic::Sequence).unwrap();
    assert_eq!(
        said.words,
        "The program was started anew: 2 of 3 positions are done, and the sequence is paused at position 2; \
         resume it when all is in place."
    );
    assert_eq!(room.log().len(), shots, "something was shot unasked");
    studio.wish(SequenceEvent::Resume);
    assert_eq!(Studio::pairs(&studio.until(SequenceState::Done, None)), [vec![1], vec![2, 4], vec![3]]);
}

/// The folder's next desk, once the one before has let go of its sessions.
fn desk_anew(folder: &TempDir, room: &Room) -> Desk {
    let end = Instant::now() + PATIENCE;
    loop {
        match unlit::session::Session::open(&folder.path().join("vase")) {
            Ok(_) => return desk_in(folder.path(), room.rig()),
            Err(error) => assert!(Instant::now() < end, "{error}"),
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_plan_changes_how_a_paused_sequence_goes_on_and_removing_it_begins_anew() {
    let studio = Studio::open(Room::default().rig(), SequencePlan::new(2, Between::Hook));
    let desk = &studio.desk;
    studio.wish(SequenceEvent::Start);
    studio.wish(SequenceEvent::Next);
    studio.until(SequenceState::Waiting, Some(2));
    let refused = |order| match desk.plan_sequence("vase", order) {
        Err(DeskError::Sequence(error)) => error,
        other => panic!("{other:?}"),
    };
    assert!(matches!(refused(SequencePlan::new(2, Between::Prompt)), SequenceError::Refused { .. }));
    studio.wish(SequenceEvent::Pause);
    assert!(matches!(
        refused(SequencePlan::new(3, Between::Prompt)),
        SequenceError::Unfinished { done: 1, positions: 2 }
    ));
    assert!(matches!(refused(SequencePlan::new(0, Between::Prompt)), SequenceError::BadPlan(_)));
    let (view, made) = desk.plan_sequence("vase", SequencePlan::new(2, Between::Prompt)).unwrap();
    assert_eq!((made, view.done, view.plan.between), (false, 1, Between::Prompt));
    desk.remove_sequence("vase").unwrap();
    assert!(matches!(desk.sequence("vase"), Err(DeskError::Sequence(SequenceError::NotPlanned(_)))));
    assert!(!studio.folder.path().join("vase/sequence.json").exists());
    let (view, made) = desk.plan_sequence("vase", SequencePlan::new(3, Between::Hook)).unwrap();
    assert_eq!((made, view.done), (true, 0));
}

#[test]
fn nothing_is_shot_that_could_not_be_written_down_before() {
    let room = Room::default();
    let studio = Studio::open(room.rig(), SequencePlan::new(2, Between::Hook));
    studio.wish(SequenceEvent::Start);
    // A folder in the file's place refuses every write, whoever we are.
    let file = studio.folder.path().join("vase/sequence.json");
    std::fs::rename(&file, file.with_extension("away")).unwrap();
    std::fs::create_dir_all(file.join("in the way")).unwrap();
    studio.wish(SequenceEvent::Next);
    let view = studio.until(SequenceState::Asking, Some(1));
    assert!(view.words.contains("sequence.json"), "{}", view.words);
    assert!(!room.log().contains(&"shoot"), "{:?}", room.log());
    let wrong = studio.desk.direct_sequence("vase", SequenceEvent::Skip, None);
    assert!(matches!(wrong, Err(DeskError::Session(_))), "{wrong:?}");
    assert_eq!(studio.view().skipped, 0, "what cannot be written is not done");

    std::fs::remove_dir_all(&file).unwrap();
    studio.wish(SequenceEvent::Retry);
    assert_eq!(Studio::pairs(&studio.until(SequenceState::Waiting, Some(2)))[0], [1]);
    assert!(studio.desk.session("vase").unwrap().sequence().unwrap().is_some(), "it is written again");
}

#[test]
fn a_pair_that_was_not_stored_leaves_its_position_even_if_another_gets_its_number() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("vase");
    let record = SequenceRecord {
        stage: Stage::Begun,
        under_way: Some(UnderWay { position: 1, pair: 1 }),
        ..SequenceRecord::planned(SequencePlan::new(2, Between::Hook))
    };
    // Killed in the middle of position 1's pair.
    Session::create(&place, "vase").unwrap().set_sequence(&record).unwrap();
    // Whoever opens it next may shoot pair 1, which is none of the sequence's.
    let session = Session::open(&place).unwrap();
    let kept = session.sequence().unwrap().unwrap();
    assert_eq!((kept.under_way, kept.positions[0].pairs.len()), (None, 0));
}
