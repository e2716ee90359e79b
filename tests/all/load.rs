//! Pairs while others ask: 200 requests a second for status, session and files of the real daemon, and the simulated
//! studio's pairs timed with and without them.
//!
//! Both are timed in turns, in short blocks whose order is turned round each time, so that a machine that drifts slows
//! both alike. `script/test` runs the short form, which says only that all were answered. `UNLIT_SOAK=1` (script/soak)
//! runs the long one, 60 s with and 60 s without, and holds pairs and answers to their time; it means something on a
//! machine that does nothing else, in the release profile.

use crate::daemon::{Daemon, PATIENCE};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Requests a second, all clients together.
const RATE: u32 = 200;
const CLIENTS: u32 = 8;
/// Every so many requests, a whole original.
const ORIGINAL_EVERY: u32 = 40;
/// Under load, median, 95th percentile and longest of the pairs' times may be so many times those without.
const SLOWER: f64 = 1.10;
/// Seconds in which half of the answers, and 19 of 20, are there while pairs are shot.
const ANSWERED: [f64; 2] = [0.020, 0.100];

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

/// Of some times in seconds.
struct Spread {
    median: f64,
    /// 95th percentile.
    high: f64,
    longest: f64,
}

impl Spread {
    fn of(times: &[f64]) -> Self {
        let mut sorted = times.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted[(share * (sorted.len() - 1) as f64).round() as usize];
        Self { median: at(0.5), high: at(0.95), longest: at(1.0) }
    }
}

impl std::fmt::Display for Spread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [median, high, longest] = [self.median, self.high, self.longest].map(|s| 1e3 * s);
        write!(f, "{median:.1} ms (median), {high:.1} ms (95 %), {longest:.1} ms (longest)")
    }
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
    let (rounds, block) = if long { (20, Duration::from_secs(3)) } else { (2, Duration::from_secs(1)) };
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(folder.path());
    let root = format!("http://127.0.0.1:{}/api/v1", daemon.port);
    let made = agent().post(format!("{root}/sessions")).send_json(json!({ "name": "load" })).unwrap();
    assert_eq!(made.status(), 201);
    // The first ones open the devices.
    take_pairs(&root, Duration::ZERO);
    let wanted = wanted(&root, "load");

    let (mut quiet, mut loaded, mut answers, mut time) = (Vec::new(), Vec::new(), Answers::default(), 0.0);
    for round in 0..rounds {
        for with_load in [round % 2 == 1, round % 2 == 0] {
            if !with_load {
                quiet.extend(take_pairs(&root, block));
                continue;
            }
            let begun = Instant::now();
            let (pairs, more) = take_pairs_under_load(&root, &wanted, block);
            time += begun.elapsed().as_secs_f64();
            loaded.extend(pairs);
            answers.times.extend(more.times);
            answers.bytes += more.bytes;
            answers.bad.extend(more.bad);
        }
    }
    let (without, with, answered) = (Spread::of(&quiet), Spread::of(&loaded), Spread::of(&answers.times));
    let rate = answers.times.len() as f64 / time;
    println!(
        "{} pairs without load: {without}\n{} pairs with load: {with}\n\
         {} answers in {time:.1} s, {rate:.0} a second, {:.1} MB: {answered}",
        quiet.len(),
        loaded.len(),
        answers.times.len(),
        answers.bytes as f64 / 1e6,
    );
    assert!(answers.bad.is_empty(), "{} were not answered well, {}", answers.bad.len(), answers.bad[0]);
    if long {
        assert!(rate > 0.95 * f64::from(RATE), "the clients asked only {rate:.0} times a second");
        for (what, with, without) in [
            ("median", with.median, without.median),
            ("95th percentile", with.high, without.high),
            ("longest", with.longest, without.longest),
        ] {
            assert!(with <= SLOWER * without, "{what} of a pair: {with:.3} s, {without:.3} s without load");
        }
        let [half, most] = ANSWERED;
        assert!(answered.median <= half && answered.high <= most, "{answered}");
    }
}
