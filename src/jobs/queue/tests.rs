//! What the queue promises.

use super::*;
use crate::jobs::Work;
use std::sync::mpsc;

fn order(kind: &'static str, coalesce: bool, work: Work) -> Order {
    Order {
        kind,
        subject: "vase".into(),
        lane: Lane::Processing,
        coalesce,
        rest: Duration::ZERO,
        order: None,
        retry_of: None,
        durable: false,
        wish: None,
        work,
    }
}

fn finished(queue: &Queue, id: JobId) -> Job {
    let end = Instant::now() + Duration::from_secs(10);
    loop {
        let job = queue.get(id).unwrap();
        if job.state.is_final() {
            return job;
        }
        assert!(Instant::now() < end, "job {id} did not end: {job:?}");
        std::thread::yield_now();
    }
}

/// A job that runs until it is let go; the first channel tells that it runs.
fn gated(queue: &Queue, kind: &'static str) -> (JobId, mpsc::Sender<()>) {
    let (running, runs) = mpsc::channel();
    let (go, gate) = mpsc::channel::<()>();
    let work: Work = Box::new(move |_| {
        running.send(()).unwrap();
        gate.recv().unwrap();
        Ok(serde_json::Value::Null)
    });
    let id = queue.enqueue(order(kind, true, work)).unwrap().id;
    runs.recv_timeout(Duration::from_secs(10)).unwrap();
    (id, go)
}

#[test]
fn a_job_reports_progress_and_ends_done_with_its_result() {
    let (tx, rx) = mpsc::channel();
    let queue = Queue::start(move |job| tx.send((job.state, job.done)).unwrap()).unwrap();
    let work: Work = Box::new(|progress| {
        progress.report("half", 1, 2);
        Ok(serde_json::json!({"texels": 7}))
    });
    let id = queue.enqueue(order("process", false, work)).unwrap().id;
    let job = finished(&queue, id);
    assert_eq!((job.state, job.result), (JobState::Done, Some(serde_json::json!({"texels": 7}))));
    let heard: Vec<_> = rx.iter().take(4).collect();
    assert_eq!(
        heard,
        [(JobState::Queued, 0), (JobState::Running, 0), (JobState::Running, 1), (JobState::Done, 1)]
    );
}

#[test]
fn who_listens_hears_of_a_job_in_the_order_in_which_it_changed() {
    let (tx, rx) = mpsc::channel();
    let queue = Queue::start(move |job| {
        // Time enough for whoever would overtake.
        if job.state == JobState::Queued {
            std::thread::sleep(Duration::from_millis(30));
        }
        tx.send((job.id, job.state)).unwrap();
    })
    .unwrap();
    for _ in 0..5 {
        let id = queue.enqueue(order("quick", false, Box::new(|_| Ok(1.into())))).unwrap().id;
        let heard: Vec<_> = rx.iter().take(3).collect();
        assert_eq!(heard, [JobState::Queued, JobState::Running, JobState::Done].map(|state| (id, state)));
    }
}

#[test]
fn a_waiting_job_swallows_its_like_and_a_running_one_does_not() {
    let queue = Queue::start(|_| {}).unwrap();
    let (running, go) = gated(&queue, "process");
    let noop = || -> Work { Box::new(|_| Ok(serde_json::Value::Null)) };
    let second = queue.enqueue(order("process", true, noop())).unwrap().id;
    let third = queue.enqueue(order("process", true, noop())).unwrap().id;
    assert_ne!(second, running);
    assert_eq!(third, second);
    go.send(()).unwrap();
    assert_eq!(finished(&queue, second).state, JobState::Done);
}

#[test]
fn a_waiting_job_is_cancelled_at_once_and_never_runs() {
    let queue = Queue::start(|_| {}).unwrap();
    let (_, go) = gated(&queue, "first");
    let id = queue.enqueue(order("second", false, Box::new(|_| panic!("ran")))).unwrap().id;
    assert_eq!(queue.cancel(id).unwrap().state, JobState::Cancelled);
    go.send(()).unwrap();
    let after = queue.enqueue(order("third", false, Box::new(|_| Ok(1.into())))).unwrap().id;
    assert_eq!(finished(&queue, after).state, JobState::Done);
    assert_eq!(queue.get(id).unwrap().state, JobState::Cancelled);
    assert_eq!(queue.cancel(id), Err(JobsError::Finished(id)));
}

#[test]
fn a_running_job_stops_at_its_next_check() {
    let queue = Queue::start(|_| {}).unwrap();
    let (running, runs) = mpsc::channel();
    let work: Work = Box::new(move |progress| {
        running.send(()).unwrap();
        loop {
            progress.check()?;
            std::thread::yield_now();
        }
    });
    let id = queue.enqueue(order("endless", false, work)).unwrap().id;
    runs.recv_timeout(Duration::from_secs(10)).unwrap();
    queue.cancel(id).unwrap();
    assert_eq!(finished(&queue, id).state, JobState::Cancelled);
}

#[test]
fn a_panic_fails_its_job_and_spares_the_next() {
    let queue = Queue::start(|_| {}).unwrap();
    let bad = queue.enqueue(order("bad", false, Box::new(|_| panic!("boom")))).unwrap().id;
    let good = queue.enqueue(order("good", false, Box::new(|_| Ok(1.into())))).unwrap().id;
    let job = finished(&queue, bad);
    assert_eq!(job.state, JobState::Failed);
    assert!(job.problem.unwrap().words.contains("boom"));
    assert_eq!(finished(&queue, good).state, JobState::Done);
}

#[test]
fn the_lanes_do_not_wait_for_each_other() {
    let queue = Queue::start(|_| {}).unwrap();
    let (_, go) = gated(&queue, "process");
    let shot = Order { lane: Lane::Rig, ..order("pair", false, Box::new(|_| Ok(1.into()))) };
    let id = queue.enqueue(shot).unwrap().id;
    assert_eq!(finished(&queue, id).state, JobState::Done);
    go.send(()).unwrap();
}

#[test]
fn the_queue_is_bounded_and_closes() {
    let queue = Queue::start(|_| {}).unwrap();
    let (running, go) = gated(&queue, "first");
    for _ in 0..WAITING_LIMIT {
        queue.enqueue(order("more", false, Box::new(|_| Ok(1.into())))).unwrap();
    }
    let over = queue.enqueue(order("more", false, Box::new(|_| Ok(1.into()))));
    assert_eq!(over.err(), Some(JobsError::Full));
    assert!(!queue.shut_down(Duration::from_millis(1), || {}), "the first job still runs");
    go.send(()).unwrap();
    assert!(queue.shut_down(Duration::from_secs(10), || {}));
    assert_eq!(queue.get(running).unwrap().state, JobState::Done);
    let closed = queue.enqueue(order("late", false, Box::new(|_| Ok(1.into()))));
    assert_eq!(closed.err(), Some(JobsError::Closed));
}

#[test]
fn each_session_has_its_turn() {
    let (tx, rx) = mpsc::channel();
    let queue = Queue::start(|_| {}).unwrap();
    let (_, go) = gated(&queue, "first");
    for (subject, n) in [("bowl", 1), ("bowl", 2), ("bowl", 3), ("cup", 1), ("vase", 1), ("cup", 2)] {
        let tx = tx.clone();
        let work: Work = Box::new(move |_| {
            tx.send(format!("{subject} {n}")).unwrap();
            Ok(serde_json::Value::Null)
        });
        queue.enqueue(Order { subject: subject.into(), ..order("more", false, work) }).unwrap();
    }
    go.send(()).unwrap();
    let wait = Duration::from_secs(10);
    let ran: Vec<String> = (0..6).map(|_| rx.recv_timeout(wait).unwrap()).collect();
    // The vase has had its turn already: the job that all of them waited for.
    assert_eq!(ran, ["bowl 1", "cup 1", "vase 1", "bowl 2", "cup 2", "bowl 3"]);
}

#[test]
fn what_waits_for_the_rig_to_rest_begins_then_or_when_somebody_asks_for_it() {
    let queue = Queue::start(|_| {}).unwrap();
    let (running, runs) = mpsc::channel();
    let (go, gate) = mpsc::channel::<()>();
    let work: Work = Box::new(move |_| {
        running.send(()).unwrap();
        gate.recv().unwrap();
        Ok(1.into())
    });
    let pair = queue.enqueue(Order { lane: Lane::Rig, ..order("pair", false, work) }).unwrap().id;
    runs.recv_timeout(Duration::from_secs(10)).unwrap();
    let patient = |rest| Order { rest, ..order("process", true, Box::new(|_| Ok(1.into()))) };
    let rest = Duration::from_millis(300);
    let waits = queue.enqueue(patient(rest)).unwrap().id;
    let other = queue.enqueue(order("other", false, Box::new(|_| Ok(1.into())))).unwrap().id;
    assert_eq!(finished(&queue, other).state, JobState::Done, "others pass it");
    assert_eq!(queue.get(waits).unwrap().state, JobState::Queued, "the rig is at work");
    let ended = Instant::now();
    go.send(()).unwrap();
    assert_eq!(finished(&queue, pair).state, JobState::Done);
    assert_eq!(finished(&queue, waits).state, JobState::Done);
    assert!(ended.elapsed() >= rest, "{:?}", ended.elapsed());

    let waits = queue.enqueue(patient(Duration::from_secs(3600))).unwrap().id;
    assert_eq!(queue.get(waits).unwrap().state, JobState::Queued);
    assert_eq!(queue.enqueue(patient(Duration::ZERO)).unwrap().id, waits);
    assert_eq!(finished(&queue, waits).state, JobState::Done);
}

/// A queue that goes on where the one before in this folder ended.
/// A queue that goes on with the ledger in `folder` once the one before, which holds `alive`, has ended: its threads may write
/// until then.
fn resumed(folder: &std::path::Path, alive: &Arc<()>) -> Queue {
    let end = Instant::now() + Duration::from_secs(10);
    while Arc::strong_count(alive) > 1 {
        assert!(Instant::now() < end, "its threads go on");
        std::thread::yield_now();
    }
    let ledger = Ledger::open(folder, |_| "cut short".into()).unwrap();
    let held = alive.clone();
    Queue::resume(ledger, move |_| drop(held.clone()), |words| panic!("{words}")).unwrap()
}

#[test]
fn a_queue_after_another_goes_on_counting_and_knows_what_was_cut_short() {
    let folder = tempfile::tempdir().unwrap();
    let alive = Arc::new(());
    let (done, cut) = {
        let queue = resumed(folder.path(), &alive);
        let done = queue.enqueue(order("first", false, Box::new(|_| Ok(7.into())))).unwrap().id;
        assert_eq!(finished(&queue, done).state, JobState::Done);
        let (_, go) = gated(&queue, "second");
        let again = Order { order: Some(1.into()), ..order("third", false, Box::new(|_| Ok(1.into()))) };
        let cut = queue.enqueue(again).unwrap();
        assert!(cut.started.is_none() && cut.enqueued.ends_with('Z'));
        // What the program would leave if it were killed now.
        std::fs::copy(folder.path().join("jobs.jsonl"), folder.path().join("killed")).unwrap();
        go.send(()).unwrap();
        assert!(finished(&queue, cut.id).started.is_some());
        assert!(queue.shut_down(Duration::from_secs(10), || {}));
        (done, cut.id)
    };
    std::fs::copy(folder.path().join("killed"), folder.path().join("jobs.jsonl")).unwrap();
    let queue = resumed(folder.path(), &alive);
    let before = queue.get(done).unwrap();
    assert_eq!((before.state, before.result), (JobState::Done, Some(7.into())));
    assert_eq!(queue.get(cut).unwrap().state, JobState::Interrupted);
    assert_eq!(queue.to_repeat(cut).unwrap().1, 1);
    assert_eq!(queue.to_repeat(done).err(), Some(JobsError::NotRetryable(done)));
    let gone = queue.to_repeat(cut - 1).err();
    assert!(matches!(gone, Some(JobsError::NotRepeatable(id, _)) if id == cut - 1), "{gone:?}");
    assert_eq!(queue.cancel(cut), Err(JobsError::Finished(cut)));
    let next = queue.enqueue(order("next", false, Box::new(|_| Ok(1.into())))).unwrap().id;
    assert_eq!(next, cut + 1);
}

fn quick(queue: &Queue) -> Result<Job, JobsError> {
    queue.enqueue(order("pair", false, Box::new(|_| Ok(7.into()))))
}

fn wish(key: &str, digest: &str) -> Wish {
    Wish { key: key.into(), digest: digest.into() }
}

/// A quick job that is asked for under a key.
fn keyed(queue: &Queue, key: &str, digest: &str) -> Result<(Job, bool), JobsError> {
    queue.once(wish(key, digest), |wish| {
        queue.enqueue(Order { wish: Some(wish), ..order("pair", false, Box::new(|_| Ok(7.into()))) })
    })
}

fn asked_twice(_: Wish) -> Result<Job, JobsError> {
    panic!("asked twice")
}

#[test]
fn a_key_stands_for_one_job_and_a_refused_wish_leaves_it_free() {
    let queue = Queue::start(|_| {}).unwrap();
    let refused = queue.once(wish("a", "wish"), |_| Err::<Job, _>(JobsError::Full));
    assert_eq!(refused.err(), Some(JobsError::Full));
    let (first, before) = keyed(&queue, "a", "other wish").unwrap();
    assert!(!before);
    let again = queue.once(wish("a", "other wish"), asked_twice);
    assert_eq!(again.map(|(job, before)| (job.id, before)), Ok((first.id, true)));
    assert_eq!(keyed(&queue, "a", "wish"), Err(JobsError::KeyReused("a".into())));
    assert_eq!(finished(&queue, first.id).result, Some(7.into()));
}

#[test]
fn who_takes_long_to_ask_holds_up_only_his_own_key() {
    let queue = Queue::start(|_| {}).unwrap();
    let (come, go) = (std::sync::Barrier::new(2), std::sync::Barrier::new(2));
    std::thread::scope(|scope| {
        let slow = scope.spawn(|| {
            queue.once(wish("slow", "wish"), |_| {
                come.wait();
                go.wait();
                quick(&queue)
            })
        });
        come.wait();
        let other = keyed(&queue, "other", "wish").unwrap().0;
        assert_eq!(finished(&queue, other.id).state, JobState::Done);
        go.wait();
        assert!(slow.join().unwrap().is_ok());
    });
}

#[test]
fn a_key_stands_for_the_like_job_that_waits_already() {
    let queue = Queue::start(|_| {}).unwrap();
    let (_, go) = gated(&queue, "process");
    let process = || order("process", true, Box::new(|_| Ok(7.into())));
    let waiting = queue.enqueue(process()).unwrap();
    let (like, _) =
        queue.once(wish("a", "wish"), |wish| queue.enqueue(Order { wish: Some(wish), ..process() })).unwrap();
    go.send(()).unwrap();
    finished(&queue, waiting.id);
    let again = queue.once(wish("a", "wish"), asked_twice).unwrap();
    assert_eq!((like.id, again.0.id, again.1), (waiting.id, waiting.id, true));
}

#[test]
fn many_at_once_get_the_one_job_and_it_begins_only_when_its_key_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let (queue, asked) = (resumed(folder.path(), &Arc::new(())), std::sync::atomic::AtomicU32::new(0));
    let ledger = folder.path().join("jobs.jsonl");
    let start = std::sync::Barrier::new(8);
    let ask = |wish| {
        asked.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
        let ledger = ledger.clone();
        let work: Work = Box::new(move |_| Ok(std::fs::read_to_string(ledger).unwrap().into()));
        queue.enqueue(Order { wish: Some(wish), ..order("pair", false, work) })
    };
    let once = || {
        start.wait();
        queue.once(wish("many", "wish"), ask).unwrap()
    };
    let all: Vec<_> = std::thread::scope(|scope| {
        let asking: Vec<_> = (0..8).map(|_| scope.spawn(once)).collect();
        asking.into_iter().map(|one| one.join().unwrap()).collect()
    });
    assert_eq!(asked.into_inner(), 1);
    assert!(all.iter().all(|(job, _)| job.id == all[0].0.id));
    assert_eq!(all.iter().filter(|(_, before)| !before).count(), 1);
    let seen = finished(&queue, all[0].0.id).result.unwrap();
    assert!(seen.as_str().unwrap().contains("\"event\":\"claimed\",\"key\":\"many\""), "{seen}");
}

#[test]
fn keys_outlive_the_program_and_keep_their_jobs_from_being_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let alive = Arc::new(());
    let (first, cut) = {
        let queue = resumed(folder.path(), &alive);
        let (first, _) = keyed(&queue, "keyed", "wish").unwrap();
        let mut last = finished(&queue, first.id);
        for _ in 0..REMEMBERED + 10 {
            last = finished(&queue, quick(&queue).unwrap().id);
        }
        assert_eq!(queue.get(first.id + 1), Err(JobsError::Unknown(first.id + 1)));
        assert!(queue.get(first.id).is_ok() && queue.get(last.id).is_ok());
        let (_, go) = gated(&queue, "second");
        let (cut, _) = keyed(&queue, "cut", "wish").unwrap();
        std::fs::copy(folder.path().join("jobs.jsonl"), folder.path().join("killed")).unwrap();
        go.send(()).unwrap();
        assert!(queue.shut_down(Duration::from_secs(10), || {}));
        (first.id, cut.id)
    };
    std::fs::copy(folder.path().join("killed"), folder.path().join("jobs.jsonl")).unwrap();
    for _ in 0..2 {
        let queue = resumed(folder.path(), &alive);
        let again = |key| queue.once(wish(key, "wish"), asked_twice);
        let state = |key| again(key).map(|(job, before)| (job.id, job.state, before));
        assert_eq!(state("keyed"), Ok((first, JobState::Done, true)));
        assert_eq!(state("cut"), Ok((cut, JobState::Interrupted, true)));
        assert_eq!(keyed(&queue, "cut", "other"), Err(JobsError::KeyReused("cut".into())));
        assert!(queue.shut_down(Duration::from_secs(10), || {}));
    }
}

#[test]
fn a_durable_wish_that_a_waiting_job_fulfils_reaches_the_disk_too() {
    let folder = tempfile::tempdir().unwrap();
    let ledger = Ledger::open(folder.path(), |_| String::new()).unwrap();
    let (tell, told) = mpsc::channel();
    let queue = Queue::resume(ledger, |_| {}, move |words| tell.send(words).unwrap()).unwrap();
    let (_, go) = gated(&queue, "process");
    let noop = || -> Work { Box::new(|_| Ok(serde_json::Value::Null)) };
    let unasked = queue.enqueue(order("process", true, noop())).unwrap();
    // From here on the disk refuses.
    std::fs::remove_file(folder.path().join("jobs.jsonl")).unwrap();
    std::fs::create_dir(folder.path().join("jobs.jsonl")).unwrap();
    assert_eq!(queue.enqueue(order("process", true, noop())).unwrap().id, unasked.id);
    assert!(told.try_recv().is_err(), "nobody was promised anything");
    let wish = Order { durable: true, ..order("process", true, noop()) };
    assert_eq!(queue.enqueue(wish).unwrap().id, unasked.id);
    assert!(told.try_recv().unwrap().contains("could not be written"));
    go.send(()).unwrap();
}
