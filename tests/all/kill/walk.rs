//! The client that walks round: pairs in all orders, rejected ones and those shot again, by hand and as a sequence. It
//! notes what it was told.

use super::left::Attempt;
use crate::daemon::{Answer, Client};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Pairs of a session: fewer than the studio has stops, so that each has a camera in the scene and a solve takes seconds.
pub(super) const STOPS: u32 = 8;
/// Positions of its sequence; pairs that are shot by hand come in between and are none of it.
pub(super) const POSITIONS: u32 = 4;
/// The way from stop to stop takes up to so many milliseconds; one in eight is a pause in which a whole solve begins, and
/// so is every other life's beginning, for what the last kill left.
const WAY_MS: u64 = 400;
const PAUSE: Duration = Duration::from_millis(6000);

/// A pair as it was acknowledged.
#[derive(Debug, PartialEq)]
pub(super) struct Pair {
    pub(super) verdict: String,
    pub(super) order: String,
}

/// What the client was told.
#[derive(Default)]
pub(super) struct Told {
    /// Jobs that were taken.
    pub(super) jobs: BTreeSet<u64>,
    /// Attempts at pairs that are stored.
    pub(super) pairs: BTreeMap<Attempt, Pair>,
    /// Pairs that were shot by hand.
    by_hand: BTreeSet<u32>,
    /// Whether there is a sequence.
    pub(super) planned: bool,
    /// The accepted pairs of its positions.
    positions: BTreeMap<u32, u32>,
}

impl Told {
    /// A new session; jobs go on.
    pub(super) fn begin_session(&mut self) {
        *self = Self { jobs: std::mem::take(&mut self.jobs), ..Self::default() };
    }

    /// A sequence after a restart: nothing of it is lost, it took no pair that was shot by hand, and it goes on at the
    /// first position that is missing once somebody wants it.
    pub(super) fn expect_of_sequence(&self, sequence: &Value) {
        let state = sequence["state"].as_str().unwrap();
        assert!(["planned", "paused", "done"].contains(&state), "{sequence}");
        let positions = sequence["positions"].as_array().unwrap();
        for (position, pair) in &self.positions {
            assert_eq!(
                positions[*position as usize - 1]["accepted"],
                *pair,
                "position {position}: {sequence}"
            );
        }
        let taken: Vec<u64> = positions
            .iter()
            .flat_map(|at| at["pairs"].as_array().unwrap().iter().map(|pair| pair.as_u64().unwrap()))
            .collect();
        let once: BTreeSet<&u64> = taken.iter().collect();
        assert_eq!(once.len(), taken.len(), "a pair belongs to one position: {sequence}");
        let foreign = self.by_hand.iter().find(|pair| taken.contains(&u64::from(**pair)));
        assert_eq!(foreign, None, "a pair that was shot by hand is in {sequence}");
        let missing = (1..).zip(positions).find(|(_, at)| at["accepted"].is_null()).map(|(n, _): (u32, _)| n);
        assert_eq!(sequence["position"].as_u64(), missing.map(u64::from), "{sequence}");
    }
}

/// What one life of the daemon sees of the walk.
pub(super) struct Walk<'a> {
    pub(super) client: &'a Client,
    pub(super) session: &'a str,
    pub(super) told: &'a mut Told,
    pub(super) random: ChaCha8Rng,
    /// What is being done, for the log.
    pub(super) doing: &'a std::sync::Mutex<String>,
    pub(super) over: &'a AtomicBool,
}

impl Walk<'_> {
    fn one_in(&mut self, n: u32) -> bool {
        self.random.next_u32().is_multiple_of(n)
    }

    fn doing(&self, what: String) {
        *self.doing.lock().unwrap() = what;
    }

    fn path(&self, rest: &str) -> String {
        format!("/sessions/{}{rest}", self.session)
    }

    /// Shoots pair after pair until the daemon is gone or the walk is over.
    pub(super) fn go(&mut self, rested: bool) -> Answer<()> {
        let as_sequence = self.one_in(2);
        if rested {
            self.rest(PAUSE);
        }
        loop {
            let draw = self.random.next_u64();
            self.rest(match draw % 8 {
                0 => PAUSE,
                _ => Duration::from_millis(draw / 8 % WAY_MS),
            });
            if !((as_sequence && self.next_of_sequence()?) || self.next_by_hand()?) {
                self.doing("nothing is left to shoot".into());
                return Ok(());
            }
        }
    }

    fn rest(&self, length: Duration) {
        self.doing(format!("on the way for {} ms", length.as_millis()));
        let end = Instant::now() + length;
        while Instant::now() < end && !self.over.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// The stored pairs, each as the attempt that counts.
    fn pairs(&self) -> Answer<BTreeMap<u32, Value>> {
        let pairs = self.client.get(&self.path("/pairs"))?;
        let number = |pair: &Value| u32::try_from(pair["number"].as_u64().unwrap()).unwrap();
        Ok(pairs.as_array().unwrap().iter().map(|pair| (number(pair), pair.clone())).collect())
    }

    /// The next pair, or a rejected one again; says whether there was any left to shoot.
    fn next_by_hand(&mut self) -> Answer<bool> {
        let pairs = self.pairs()?;
        let next = pairs.keys().last().map_or(1, |last| last + 1);
        let rejected =
            pairs.iter().find(|(_, pair)| pair["verdict"] == "rejected").map(|(number, _)| *number);
        match rejected {
            Some(number) if next > STOPS || self.one_in(2) => self.shoot(number, Some(number), false)?,
            _ if next > STOPS => return Ok(false),
            _ => {
                let cap = self.one_in(4);
                self.shoot(next, None, cap)?;
            }
        }
        Ok(true)
    }

    /// One pair at its stop, or with the cap on the lens, which is rejected; in one request, or asked for and looked at.
    pub(super) fn shoot(&mut self, number: u32, again: Option<u32>, cap: bool) -> Answer<()> {
        let (order, off_frames) = match self.random.next_u32() % 5 {
            0 => ("on_off", 1),
            1 => ("off_on_off", 1),
            2 => ("off_on", 2),
            3 => ("off_on_off", 2),
            _ => ("off_on", 1),
        };
        self.stage(number, cap)?;
        let wish =
            json!({ "session": self.session, "order": order, "off_frames": off_frames, "again": again });
        self.doing(format!("pair {number}, {order}, {off_frames} off{}", again.map_or("", |_| ", again")));
        let job = if self.one_in(2) {
            self.client.post("/pairs?wait=true", wish)?
        } else {
            let job = self.client.post("/pairs", wish)?;
            let (id, last) = (job["id"].as_u64().unwrap(), self.told.jobs.last());
            assert!(last.is_none_or(|last| id > *last), "number {id} was given before");
            self.told.jobs.insert(id);
            self.client.ended(job)?
        };
        assert_eq!(job["state"], "done", "{job}");
        let result = &job["result"];
        assert_eq!(result["number"], number, "the right number: {job}");
        assert_eq!(result["verdict"], if cap { "rejected" } else { "accepted" }, "{job}");
        self.told.jobs.insert(job["id"].as_u64().unwrap());
        let verdict = result["verdict"].as_str().unwrap().to_owned();
        let attempt = u32::try_from(result["attempt"].as_u64().unwrap()).unwrap();
        self.told.pairs.insert((number, attempt), Pair { verdict, order: order.into() });
        if again.is_none() {
            self.told.by_hand.insert(number);
        }
        Ok(())
    }

    fn stage(&self, stop: u32, cap: bool) -> Answer<()> {
        self.client.stage(if cap { json!({ "lens_cap": true }) } else { json!({ "stop": stop }) })
    }

    fn sequence(&self) -> Answer<Value> {
        self.client.get(&self.path("/sequence"))
    }

    fn wish(&self, wish: &str, body: Value) -> Answer<Value> {
        self.client.post(&self.path(&format!("/sequence/{wish}")), body)
    }

    /// The next pair of the sequence, which is begun or gone on with first; says whether there was any left to shoot.
    fn next_of_sequence(&mut self) -> Answer<bool> {
        if !self.told.planned {
            self.doing("planning the sequence".into());
            let plan = json!({ "positions": POSITIONS, "between": { "kind": "hook" } });
            let (status, answer) = self.client.ask("PUT", &self.path("/sequence"), Some(plan))?;
            assert!([200, 201].contains(&status), "{status} {answer}");
            self.told.planned = true;
        }
        let mut now = self.sequence()?;
        if let Some(wish) = match now["state"].as_str().unwrap() {
            "planned" => Some("start"),
            "paused" => Some("resume"),
            _ => None,
        } {
            self.doing(format!("sequence: {wish}"));
            now = self.wish(wish, json!({}))?;
        }
        let wish = match now["state"].as_str().unwrap() {
            "waiting" => "next",
            "asking" => "retry",
            "done" => return Ok(false),
            _ => panic!("{now}"),
        };
        let position = now["position"].as_u64().unwrap();
        let pairs = self.pairs()?;
        let before = now["positions"][position as usize - 1]["pairs"].as_array().unwrap().last();
        let before = before.and_then(Value::as_u64).map(|pair| pair as u32);
        let again = before.filter(|number| pairs[number]["verdict"] == "rejected");
        let number = again.unwrap_or_else(|| pairs.keys().last().map_or(1, |last| last + 1));
        if number > STOPS {
            return Ok(false);
        }
        let cap = again.is_none() && self.one_in(4);
        self.stage(number, cap)?;
        let repeated = again.map_or("", |_| " again");
        self.doing(format!("sequence: {wish} of position {position}, pair {number}{repeated}"));
        let mut now = self.wish(wish, json!({ "position": position }))?;
        while now["state"] == "shooting" {
            std::thread::sleep(Duration::from_millis(20));
            now = self.sequence()?;
        }
        assert_eq!(now["state"] == "asking", cap, "{now}");
        let pair = self.client.get(&self.path(&format!("/pairs/{number}")))?;
        let verdict = if cap { "rejected" } else { "accepted" };
        assert_eq!(pair["verdict"], verdict, "{pair}");
        let attempt = u32::try_from(pair["attempt"].as_u64().unwrap()).unwrap();
        let order = pair["order"].as_str().unwrap().to_owned();
        self.told.pairs.insert((number, attempt), Pair { verdict: verdict.into(), order });
        if !cap {
            assert_eq!(now["positions"][position as usize - 1]["accepted"], number, "{now}");
            self.told.positions.insert(position as u32, number);
        }
        Ok(true)
    }
}
