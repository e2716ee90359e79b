//! Pairs while others ask: 200 requests a second for status, session and files of the real daemon, and the simulated
//! studio's pairs timed with and without them.
//!
//! `script/test` runs the short form, which says only that all were answered. `UNLIT_SOAK=1` (script/soak) runs the long one,
//! 60 s with and 60 s without in turns, and holds the pairs to their time; it means something on a machine that does
//! nothing else, in the release profile.

use crate::daemon::{Daemon, PATIENCE};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Requests a second, all clients together.
const RATE: u32 = 200;
const CLIENTS: u32 = 8;
/// Every so many requests, a whole original.
const ORIGINAL_EVERY: u32 = 40;
/// A pair may take so much longer than the longest without load.
const SLOWER: f64 = 1.10;

fn agent() -> ureq::Agent {
    ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(PATIENCE)).build().into()
}

/// What the clients were answered.
#[derive(Default)]
struct Answers {
    /// Seconds each, in no order.
    times: Vec<f64>,
    bytes: usize,
    /// Those that were not 2xx.
    bad: Vec<String>,
}

/// Addresses that the clients ask for in turn, and one of an original.
struct Wanted {
    small: Vec<String>,
    original: String,
}

/// One client's requests, evenly spread over time, until told to stop.
fn keep_asking(wanted: &Wanted, client: u32, begun: Instant, stop: &AtomicBool) -> Answers {
    let (agent, mut answers) = (agent(), Answers::default());
    for request in (client..).step_by(CLIENTS as usize) {
        let due = begun + Duration::from_secs(1) * request / RATE;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let small = &wanted.small[request as usize % wanted.small.len()];
        let url = if request.is_multiple_of(ORIGINAL_EVERY) { &wanted.original } else { small };
        let sent = Instant::now();
        match agent.get(url).call() {
            Ok(mut answer) => {
                let body = answer.body_mut().with_config().limit(1 << 30).read_to_vec();
                match (answer.status().is_success(), body) {
                    (true, Ok(body)) => answers.bytes += body.len(),
                    (_, body) => answers.bad.push(format!("{url}: {} {body:?}", answer.status())),
                }
            }
            Err(error) => answers.bad.push(format!("{url}: {error}")),
        }
        answers.times.push(sent.elapsed().as_secs_f64());
    }
    answers
}

/// Takes pairs for so long, and gives the seconds of each; two at least.
fn take_pairs(root: &str, time: Duration) -> Vec<f64> {
    let (agent, begun) = (agent(), Instant::now());
    let mut seconds = Vec::new();
    while seconds.len() < 2 || begun.elapsed() < time {
        let sent = Instant::now();
        let mut answer = agent.post(format!("{root}/pairs?wait=true")).send_empty().unwrap();
        let job: Value = answer.body_mut().read_json().unwrap();
        assert_eq!((answer.status().as_u16(), job["state"].as_str()), (200, Some("done")), "{job}");
        seconds.push(sent.elapsed().as_secs_f64());
    }
    seconds
}

/// Takes pairs for so long while the clients ask.
fn take_pairs_under_load(root: &str, wanted: &Wanted, time: Duration) -> (Vec<f64>, Answers) {
    let (stop, begun) = (AtomicBool::new(false), Instant::now());
    std::thread::scope(|scope| {
        let clients: Vec<_> = (0..CLIENTS)
            .map(|client| {
                scope.spawn({
                    let stop = &stop;
                    move || keep_asking(wanted, client, begun, stop)
                })
            })
            .collect();
        let pairs = take_pairs(root, time);
        stop.store(true, Ordering::Relaxed);
        let mut all = Answers::default();
        for client in clients {
            let answers = client.join().unwrap();
            all.times.extend(answers.times);
            all.bytes += answers.bytes;
            all.bad.extend(answers.bad);
        }
        (pairs, all)
    })
}

/// Median and largest.
fn spread(values: &[f64]) -> (f64, f64) {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    (sorted[sorted.len() / 2], sorted[sorted.len() - 1])
}

fn wanted(root: &str, session: &str) -> Wanted {
    let get = |url: String| {
        let mut answer = agent().get(url).call().unwrap();
        (answer.status().as_u16(), answer.body_mut().read_json::<Value>().unwrap())
    };
    let server = root.trim_end_matches("/api/v1");
    let (_, pairs) = get(format!("{root}/sessions/{session}/pairs"));
    let of = |key: &str| format!("{server}{}", pairs[0]["off"][key].as_str().unwrap());
    let asked = ["status", "jobs"].map(|path| format!("{root}/{path}"));
    let small = [&asked[..], &[format!("{root}/sessions/{session}"), of("thumbnail")]].concat();
    Wanted { small, original: of("url") }
}

#[test]
fn pairs_are_shot_while_two_hundred_requests_a_second_are_answered() {
    let long = std::env::var_os("UNLIT_SOAK").is_some();
    let (rounds, block) = if long { (4, Duration::from_secs(15)) } else { (1, Duration::from_secs(2)) };
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(folder.path());
    let root = format!("http://127.0.0.1:{}/api/v1", daemon.port);
    let made = agent().post(format!("{root}/sessions")).send_json(json!({ "name": "load" })).unwrap();
    assert_eq!(made.status(), 201);
    // The first ones open the devices.
    take_pairs(&root, Duration::ZERO);
    let wanted = wanted(&root, "load");

    let (mut quiet, mut loaded, mut answers, mut time) = (Vec::new(), Vec::new(), Answers::default(), 0.0);
    for _ in 0..rounds {
        quiet.extend(take_pairs(&root, block));
        let begun = Instant::now();
        let (pairs, more) = take_pairs_under_load(&root, &wanted, block);
        time += begun.elapsed().as_secs_f64();
        loaded.extend(pairs);
        answers.times.extend(more.times);
        answers.bytes += more.bytes;
        answers.bad.extend(more.bad);
    }
    let ((quiet_median, quiet_most), (loaded_median, loaded_most)) = (spread(&quiet), spread(&loaded));
    let (median, most) = spread(&answers.times);
    let rate = answers.times.len() as f64 / time;
    println!(
        "{} pairs without load: {quiet_median:.3} s (median), {quiet_most:.3} s (longest)\n\
         {} pairs with load: {loaded_median:.3} s (median), {loaded_most:.3} s (longest)\n\
         {} answers in {time:.1} s, {rate:.0} a second, {:.1} MB: {:.1} ms (median), {:.1} ms (longest)",
        quiet.len(),
        loaded.len(),
        answers.times.len(),
        answers.bytes as f64 / 1e6,
        median * 1e3,
        most * 1e3,
    );
    assert!(answers.bad.is_empty(), "{} were not answered well, {}", answers.bad.len(), answers.bad[0]);
    if long {
        assert!(rate > 0.95 * f64::from(RATE), "the clients asked only {rate:.0} times a second");
        assert!(
            loaded_most <= SLOWER * quiet_most,
            "a pair took {loaded_most:.3} s, {quiet_most:.3} s without load"
        );
    }
}
