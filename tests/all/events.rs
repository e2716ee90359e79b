//! Two pages and a script at once: the same state, the same events in the same order, nothing lost and nothing twice.

use crate::api::{House, PATIENCE, agent};
use crate::fake_rig::Room;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::time::Instant;
use unlit::capture::Topic;

/// One event as it came.
#[derive(Clone, Debug, PartialEq)]
struct Heard {
    id: String,
    topic: String,
    data: Value,
}

/// A listener as a browser has one.
struct Listener(Box<dyn Iterator<Item = std::io::Result<String>>>);

impl Listener {
    fn join(house: &House, last: Option<&str>) -> Self {
        let mut request = agent().get(house.url("/api/v1/events")).header("Accept", "text/event-stream");
        if let Some(last) = last {
            request = request.header("Last-Event-ID", last);
        }
        Self::of(request.call().unwrap())
    }

    fn of(reply: ureq::http::Response<ureq::Body>) -> Self {
        Self(Box::new(BufReader::new(reply.into_body().into_reader()).lines()))
    }

    fn next(&mut self) -> Heard {
        let (mut id, mut topic, mut data) = (String::new(), String::new(), Value::Null);
        loop {
            let line = self.0.next().expect("the stream ended").unwrap();
            match line.split_once(": ") {
                Some(("id", text)) => id = text.to_owned(),
                Some(("event", text)) => topic = text.to_owned(),
                Some(("data", text)) => data = serde_json::from_str(text).unwrap(),
                _ if line.is_empty() && !topic.is_empty() => return Heard { id, topic, data },
                _ => {}
            }
        }
    }

    /// The state, which comes first, without the room on the disk: other programs write to it, too.
    fn state(&mut self) -> Heard {
        let mut state = self.next();
        assert_eq!(state.topic, "state");
        assert!(state.data["about"]["room"].take()["free_bytes"].as_u64().unwrap() > 0);
        state
    }

    /// Everything up to the event of this id.
    fn until(&mut self, id: &str) -> Vec<Heard> {
        let mut heard = vec![self.next()];
        while heard.last().is_some_and(|last| last.id != id) {
            heard.push(self.next());
        }
        heard
    }
}

/// Tells something that everybody hears, and gives its id.
fn told(house: &House, words: &str) -> String {
    let events = house.desk.events();
    events.tell(Topic::Studio, words, json!({ "words": words }));
    events.mark(events.listen().0)
}

/// Nothing goes on any more that would change between two questions.
fn at_rest(house: &House) {
    let end = Instant::now() + PATIENCE;
    while !house.desk.queue().list().iter().all(|job| job.state.is_final()) {
        assert!(Instant::now() < end, "{:?}", house.desk.queue().list());
        std::thread::yield_now();
    }
}

fn number(id: &str) -> u64 {
    id.rsplit_once('.').unwrap().1.parse().unwrap()
}

#[test]
fn two_pages_and_a_script_see_the_same_in_the_same_order() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    house.take_pair();
    at_rest(&house);
    // One that never reads, from before to after everything.
    let mut deaf = TcpStream::connect(("127.0.0.1", house.port)).unwrap();
    write!(deaf, "GET /api/v1/events HTTP/1.1\r\nHost: 127.0.0.1:{}\r\n\r\n", house.port).unwrap();

    let (mut left, mut right) = (Listener::join(&house, None), Listener::join(&house, None));
    let (state, same) = (left.state(), right.state());
    assert_eq!(state, same);
    // The script sees what the pages see.
    let (_, vase) = house.get("/api/v1/sessions/vase");
    let (_, pair) = house.get("/api/v1/sessions/vase/pairs/1");
    let (_, jobs) = house.get("/api/v1/jobs");
    assert_eq!((&state.data["session"], &state.data["about"]["pairs"]), (&json!("vase"), &vase["pairs"]));
    assert_eq!((&state.data["last_pair"], &state.data["jobs"]), (&pair, &jobs));

    // One page shoots, the script makes a session, the other page only looks.
    house.take_pair();
    house.post("/api/v1/sessions", &json!({ "name": "bowl" }));
    house.take_pair();
    at_rest(&house);
    let end = told(&house, "the end");
    let (seen, also) = (left.until(&end), right.until(&end));
    assert_eq!(seen, also);
    let topics: Vec<_> = seen.iter().map(|e| e.topic.as_str()).collect();
    assert_eq!(topics.iter().filter(|t| **t == "pair").count(), 2, "{topics:?}");
    assert!(topics.contains(&"session"));
    for (before, after) in [&state].into_iter().chain(&seen).zip(&seen) {
        assert_eq!(number(&before.id) + 1, number(&after.id), "{before:?} {after:?}");
    }
    // Who comes late knows the same from the state alone.
    let late = Listener::join(&house, None).next();
    assert_eq!((late.id.as_str(), &late.data["session"]), (end.as_str(), &json!("bowl")));
    assert_eq!(late.data["last_pair"]["number"], 1);
    drop(deaf);
}

#[test]
fn who_was_lost_and_comes_back_misses_nothing_and_hears_nothing_twice() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    let (mut faithful, mut fickle) = (Listener::join(&house, None), Listener::join(&house, None));
    assert_eq!(faithful.state(), fickle.state());
    house.take_pair();
    let middle = told(&house, "the middle");
    let mut heard = fickle.until(&middle);
    heard.truncate(3);
    drop(fickle);
    house.take_pair();
    let end = told(&house, "the end");
    // By header, as a browser does, and by query, as scripts may.
    let last = heard.last().unwrap().id.clone();
    heard.extend(Listener::join(&house, Some(&last)).until(&end));
    let all = faithful.until(&end);
    assert_eq!(heard, all);
    let by_query = agent().get(house.url(&format!("/api/v1/events?last_event_id={last}"))).call().unwrap();
    assert_eq!(Listener::of(by_query).until(&end), all[3..]);

    // Another run of the daemon, or nonsense: the state comes first.
    for strange in ["1234.5", "nonsense", "7"] {
        assert_eq!(Listener::join(&house, Some(strange)).next().topic, "state", "{strange}");
    }
}

#[test]
fn who_is_slow_holds_nobody_up_and_still_hears_all() {
    const TOLD: u64 = 3000;
    let house = House::open(Room::default().rig());
    let (mut slow, mut quick) = (Listener::join(&house, None), Listener::join(&house, None));
    let begin = number(&slow.next().id);
    quick.next();
    // More than sockets and channels hold for a client that does not read.
    let words = "x".repeat(8 << 10);
    let end = (0..TOLD).map(|_| told(&house, &words)).last().unwrap();
    assert_eq!(quick.until(&end).len() as u64, TOLD);
    assert_eq!(house.take_pair()["verdict"], "accepted");
    let numbers: Vec<u64> = slow.until(&end).iter().map(|event| number(&event.id)).collect();
    assert_eq!(numbers, (begin + 1..=begin + TOLD).collect::<Vec<_>>());
}
