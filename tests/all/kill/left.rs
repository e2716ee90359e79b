//! What lies in the folders after a kill, read without the program.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Number of a pair, and which time it was shot.
pub(super) type Attempt = (u32, u32);

/// As its folder is named.
pub(super) fn folder(attempt: Attempt) -> String {
    match attempt {
        (number, 1) => format!("{number:04}"),
        (number, n) => format!("{number:04}-{n}"),
    }
}

/// A session's folder.
pub(super) struct Left {
    /// Attempts at pairs whose folder is there.
    pub(super) pairs: BTreeSet<Attempt>,
    /// What the journal says was begun, if nothing more was heard of it.
    pub(super) begun: Option<Attempt>,
}

impl Left {
    pub(super) fn read(session: &Path) -> Self {
        let names = std::fs::read_dir(session.join("pairs")).unwrap().flatten().map(|e| e.file_name());
        let attempt = |name: &str| match name.split_once('-') {
            Some((number, attempt)) => Some((number.parse().ok()?, attempt.parse().ok()?)),
            None => Some((name.parse().ok()?, 1)),
        };
        let pairs = names.filter_map(|name| attempt(name.to_str()?)).collect();
        let mut begun = None;
        for line in lines(&session.join("journal.jsonl")) {
            let number = |key: &str| line[key].as_u64().map(|n| u32::try_from(n).unwrap());
            match line["event"].as_str() {
                Some("pair_intended") => begun = number("number").zip(Some(number("attempt").unwrap_or(1))),
                Some("pair_committed" | "pair_abandoned" | "pair_interrupted") => begun = None,
                _ => {}
            }
        }
        Self { pairs, begun }
    }

    /// What the program must say of what was begun, if anything was.
    pub(super) fn words(&self) -> Option<String> {
        let begun = self.begun?;
        Some(match begun.1 {
            _ if self.pairs.contains(&begun) => format!("Pair {} was stored whole", folder(begun)),
            1 => format!("Pair {} was interrupted", folder(begun)),
            _ => format!("Pair {:04} was being shot again when it was interrupted", begun.0),
        })
    }
}

/// Jobs that ran when the daemon was killed, as its ledger has it.
pub(super) fn jobs_that_ran(home: &Path) -> String {
    let (mut running, mut kinds) = (BTreeMap::new(), BTreeMap::new());
    for line in lines(&home.join("sessions/.unlit/jobs.jsonl")) {
        let job = line["job"].as_u64();
        match line["event"].as_str() {
            Some("job") => {
                kinds.insert(line["id"].as_u64(), line["kind"].as_str().unwrap_or_default().to_owned());
            }
            Some("started") => {
                running.insert(job, kinds.get(&job).cloned().unwrap_or_default());
            }
            Some("ended") => {
                running.remove(&job);
            }
            _ => {}
        }
    }
    let running: BTreeSet<String> = running.into_values().collect();
    if running.is_empty() { "nothing ran".into() } else { Vec::from_iter(running).join(" and ") + " ran" }
}

/// The number of the last job of which the daemon's ledger tells.
pub(super) fn last_job(home: &Path) -> u64 {
    let lines = lines(&home.join("sessions/.unlit/jobs.jsonl"));
    let of_a_job = lines.iter().filter_map(|line| line["id"].as_u64().or(line["job"].as_u64()));
    of_a_job.max().unwrap_or(0)
}

/// The whole lines of a file, which may not be there.
fn lines(file: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}
