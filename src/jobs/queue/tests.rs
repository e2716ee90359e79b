//! What the queue promises.

use super::*;
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
    assert!(!queue.shut_down(Duration::from_millis(1)), "the first job still runs");
    go.send(()).unwrap();
    assert!(queue.shut_down(Duration::from_secs(10)));
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

#[test]
fn a_queue_after_another_goes_on_counting_and_knows_what_was_cut_short() {
    let folder = tempfile::tempdir().unwrap();
    let ledger = || Ledger::open(folder.path(), |_| "cut short".into()).unwrap();
    let alive = Arc::new(());
    let (done, cut) = {
        let held = alive.clone();
        let queue = Queue::resume(ledger(), move |_| drop(held.clone()), |words| panic!("{words}")).unwrap();
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
        assert!(queue.shut_down(Duration::from_secs(10)));
        (done, cut.id)
    };
    // The threads of the queue may write until they have ended.
    let end = Instant::now() + Duration::from_secs(10);
    while Arc::strong_count(&alive) > 1 {
        assert!(Instant::now() < end, "its threads go on");
        std::thread::yield_now();
    }
    std::fs::copy(folder.path().join("killed"), folder.path().join("jobs.jsonl")).unwrap();
    let queue = Queue::resume(ledger(), |_| {}, |words| panic!("{words}")).unwrap();
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
