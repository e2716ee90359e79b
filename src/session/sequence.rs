//! `sequence.json`: the plan of a sequence of positions, and which pairs belong to which position.
//!
//! Written whole before a pair is shot and after it ended, so that a program that was killed in between knows
//! on its next start to which position the last pair belongs. Verdicts are not repeated here: the pairs have them.

use super::{SEQUENCE, Session, SessionError, from_json, store, to_json};
use crate::pair::order::{Order, Program};
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;
use std::path::PathBuf;

/// The layout that this program writes.
pub const SEQUENCE_SCHEMA: u32 = 1;

const TRIGGER: &str = "trigger";
/// Most positions of a sequence.
pub const MOST_POSITIONS: u32 = 1000;
/// Longest countdown, seconds.
const LONGEST_COUNTDOWN: f64 = 3600.0;
/// Longest interval, seconds.
const LONGEST_INTERVAL: f64 = 86_400.0;
/// Most times that a rejected pair is taken again unasked.
const MOST_RETRIES: u32 = 10;
/// Longest instruction, characters.
const LONGEST_INSTRUCTION: usize = 200;

/// What a position waits for before its pair is taken.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Between {
    /// The operator's word.
    Prompt,
    /// Some seconds to walk.
    Countdown {
        /// Seconds from the end of the position before.
        seconds: f64,
    },
    /// A file that a script makes, and that is removed when the position is done.
    TriggerFile,
    /// A script's word.
    Hook,
}

/// What is to be shot, and how one gets from position to position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SequencePlan {
    /// How many positions there are.
    pub positions: u32,
    /// What each of them, the first one too, waits for.
    pub between: Between,
    /// Seconds that pass at least from the beginning of a pair to that of the next.
    #[serde(default)]
    pub interval_s: f64,
    /// How often a rejected pair is taken again unasked before the operator is asked.
    #[serde(default)]
    pub retries: u32,
    /// The order of each pair's frames.
    #[serde(default)]
    pub order: Order,
    /// Frames without flash in a row.
    #[serde(default = "one")]
    pub off_frames: u8,
    /// What to do at each position, from the first; may be shorter than there are positions.
    #[serde(default)]
    pub instructions: Vec<String>,
}

impl SequencePlan {
    /// So many positions, and nothing else asked for.
    pub fn new(positions: u32, between: Between) -> Self {
        let (order, off_frames) = (Order::default(), one());
        Self { positions, between, interval_s: 0.0, retries: 0, order, off_frames, instructions: Vec::new() }
    }

    /// What is wrong with it, in a sentence.
    pub fn fault(&self) -> Option<String> {
        let within = |value: f64, most: f64| (0.0..=most).contains(&value);
        let lines = self.instructions.len();
        let unfit = |line: &String| {
            line.chars().count() > LONGEST_INSTRUCTION || line.contains(|c: char| c.is_control())
        };
        if !(1..=MOST_POSITIONS).contains(&self.positions) {
            return Some(format!("positions is {}; a sequence has 1 to {MOST_POSITIONS}", self.positions));
        }
        if let Between::Countdown { seconds } = self.between
            && !within(seconds, LONGEST_COUNTDOWN)
        {
            return Some(format!("the countdown is {seconds} s; give 0 to {LONGEST_COUNTDOWN}"));
        }
        if !within(self.interval_s, LONGEST_INTERVAL) {
            return Some(format!("interval_s is {}; give 0 to {LONGEST_INTERVAL}", self.interval_s));
        }
        if self.retries > MOST_RETRIES {
            return Some(format!("retries is {}; give 0 to {MOST_RETRIES}", self.retries));
        }
        if let Err(error) = Program::new(self.order, self.off_frames) {
            return Some(error.to_string());
        }
        if lines > self.positions as usize {
            return Some(format!("there are {lines} instructions for {} positions", self.positions));
        }
        let at = self.instructions.iter().position(unfit)?;
        Some(format!("instruction {} must be one line of {LONGEST_INSTRUCTION} characters at most", at + 1))
    }
}

fn one() -> u8 {
    1
}

/// What became of one position.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PositionRecord {
    /// Numbers of its pairs, in the order in which they were taken; the last accepted one counts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pairs: Vec<u32>,
    /// Somebody wanted it left out.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub skipped: bool,
}

/// A pair that was about to be shot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnderWay {
    /// For which position, from 1.
    pub position: u32,
    /// The number that it would get.
    pub pair: u32,
}

/// How far a sequence had come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Not begun.
    Planned,
    /// Begun.
    Begun,
    /// Given up.
    Cancelled,
}

/// `sequence.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SequenceRecord {
    /// Version of the layout.
    pub schema: u32,
    /// What is to be shot.
    pub plan: SequencePlan,
    /// How far it had come.
    pub stage: Stage,
    /// What became of each position.
    pub positions: Vec<PositionRecord>,
    /// The pair that was being shot when this was written.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under_way: Option<UnderWay>,
    /// When the last pair was begun, milliseconds since 1970.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_begun_ms: Option<u64>,
}

impl SequenceRecord {
    /// A sequence of which nothing is done.
    pub fn planned(plan: SequencePlan) -> Self {
        let positions = vec![PositionRecord::default(); plan.positions as usize];
        Self {
            schema: SEQUENCE_SCHEMA,
            plan,
            stage: Stage::Planned,
            positions,
            under_way: None,
            last_begun_ms: None,
        }
    }
}

impl Session {
    fn sequence_file(&self) -> PathBuf {
        self.path().join(SEQUENCE)
    }

    /// The file that sets off the next position where a sequence waits for one and nobody named another.
    pub fn trigger_file(&self) -> PathBuf {
        self.path().join(TRIGGER)
    }

    /// The session's sequence, if one was planned.
    pub fn sequence(&self) -> Result<Option<SequenceRecord>, SessionError> {
        let file = self.sequence_file();
        let record: SequenceRecord = match from_json(&file) {
            Err(SessionError::Io { source, .. }) if source.kind() == ErrorKind::NotFound => return Ok(None),
            other => other?,
        };
        if record.schema > SEQUENCE_SCHEMA {
            return Err(SessionError::TooNew { path: file, found: record.schema, known: SEQUENCE_SCHEMA });
        }
        let count = record.positions.len();
        let fault = record.plan.fault().or_else(|| {
            (count != record.plan.positions as usize)
                .then(|| format!("it lists {count} positions of {}", record.plan.positions))
        });
        match fault {
            Some(why) => Err(SessionError::Damaged { path: file, why }),
            None => Ok(Some(record)),
        }
    }

    /// Writes `sequence.json`; on the disk when this returns.
    pub fn set_sequence(&self, record: &SequenceRecord) -> Result<(), SessionError> {
        let _alone = self.numbering()?;
        let file = self.sequence_file();
        store::write_atomic(&file, &to_json(&file, record)?).map_err(SessionError::io(&file))?;
        self.wake_mirror(0);
        Ok(())
    }

    /// Says whether the pair that was being shot when the program ended was stored, before its number can be another's.
    pub(super) fn settle_sequence(&self) -> Result<(), SessionError> {
        let Some(mut record) = self.sequence()? else { return Ok(()) };
        let Some(UnderWay { position, pair }) = record.under_way.take() else { return Ok(()) };
        let place = (position as usize).checked_sub(1).and_then(|at| record.positions.get_mut(at));
        if let Some(place) = place
            && !place.pairs.contains(&pair)
            && self.pair(pair).is_ok()
        {
            place.pairs.push(pair);
        }
        self.set_sequence(&record)
    }

    /// Removes `sequence.json`; its pairs stay.
    pub fn forget_sequence(&self) -> Result<(), SessionError> {
        let _alone = self.numbering()?;
        let file = self.sequence_file();
        match std::fs::remove_file(&file) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(SessionError::io(&file)(error)),
            _ => store::sync_folder(self.path()).map_err(SessionError::io(&file))?,
        }
        self.wake_mirror(0);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn senseless_plans_are_told_in_a_sentence() {
        let plan = SequencePlan::new;
        let countdown = |seconds| plan(3, Between::Countdown { seconds });
        assert_eq!(plan(1, Between::Hook).fault(), None);
        assert_eq!(countdown(0.5).fault(), None);
        let long = "x".repeat(LONGEST_INSTRUCTION + 1);
        let interval_s = f64::INFINITY;
        for (wrong, word) in [
            (plan(0, Between::Prompt), "positions is 0"),
            (plan(1001, Between::Prompt), "1 to 1000"),
            (countdown(-1.0), "countdown"),
            (countdown(f64::NAN), "countdown"),
            (SequencePlan { interval_s, ..plan(2, Between::Hook) }, "interval_s"),
            (SequencePlan { retries: 11, ..plan(2, Between::Hook) }, "retries"),
            (SequencePlan { off_frames: 0, ..plan(2, Between::Hook) }, "0 frames"),
            (SequencePlan { off_frames: 17, ..plan(2, Between::Hook) }, "1 to 16"),
            (SequencePlan { instructions: vec!["a".into(); 3], ..plan(2, Between::Hook) }, "3 instructions"),
            (SequencePlan { instructions: vec!["a\nb".into()], ..plan(2, Between::Hook) }, "instruction 1"),
            (
                SequencePlan { instructions: vec!["a".into(), long], ..plan(2, Between::Hook) },
                "instruction 2",
            ),
        ] {
            let sentence = wrong.fault().unwrap_or_else(|| panic!("{wrong:?} was taken"));
            assert!(sentence.contains(word), "{sentence}");
        }
    }

    #[test]
    fn a_sequence_is_kept_read_and_forgotten() {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("vase"), "vase").unwrap();
        assert_eq!(session.sequence().unwrap(), None);
        let plan = SequencePlan::new(2, Between::Countdown { seconds: 5.0 });
        let record = SequenceRecord {
            stage: Stage::Begun,
            positions: vec![PositionRecord { pairs: vec![1, 2], skipped: false }, PositionRecord::default()],
            under_way: Some(UnderWay { position: 2, pair: 3 }),
            ..SequenceRecord::planned(plan)
        };
        session.set_sequence(&record).unwrap();
        assert_eq!(session.sequence().unwrap(), Some(record.clone()));
        session.forget_sequence().unwrap();
        session.forget_sequence().unwrap();
        assert_eq!(session.sequence().unwrap(), None);

        session.set_sequence(&SequenceRecord { positions: vec![], ..record.clone() }).unwrap();
        assert!(matches!(session.sequence(), Err(SessionError::Damaged { .. })));
        session.set_sequence(&SequenceRecord { schema: 2, ..record }).unwrap();
        assert!(matches!(session.sequence(), Err(SessionError::TooNew { found: 2, .. })));
    }
}
