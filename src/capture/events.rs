//! What happens in the house, told to whoever listens: page, scripts, terminal.

use serde::Serialize;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};
use tokio::sync::broadcast;

/// Events that a listener may fall behind before it loses the oldest.
const BACKLOG: usize = 1024;
/// Events that are remembered for those who come back.
const REMEMBERED: usize = 4096;

/// What an event is about; the stable name on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Topic {
    /// Camera or flash came, went or changed.
    Devices,
    /// Another session is current, or one was made.
    Session,
    /// The operator is asked for something; `POST /api/v1/confirm` answers.
    Prompt,
    /// The question is settled.
    PromptDone,
    /// A pair is safe on disk, accepted or rejected.
    Pair,
    /// A calibration's frame, or its pair of them, is safe on disk.
    CalibrationShot,
    /// A calibration was measured, or its shots changed.
    Calibration,
    /// A device failed and is brought back; the pair goes on.
    Recovery,
    /// Something asked for could not be done.
    Trouble,
    /// A sequence came on, or waits for somebody.
    Sequence,
    /// A job changed.
    Job,
    /// A session's second copy came into step, or fails.
    Mirror,
    /// The simulated operator went elsewhere.
    Studio,
}

impl Topic {
    /// The name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Topic::Devices => "devices",
            Topic::Session => "session",
            Topic::Prompt => "prompt",
            Topic::PromptDone => "prompt_done",
            Topic::Pair => "pair",
            Topic::CalibrationShot => "calibration_shot",
            Topic::Calibration => "calibration",
            Topic::Recovery => "recovery",
            Topic::Trouble => "trouble",
            Topic::Sequence => "sequence",
            Topic::Job => "job",
            Topic::Mirror => "mirror",
            Topic::Studio => "studio",
        }
    }
}

/// One thing that happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// Running number from 1, without gaps.
    pub id: u64,
    /// What it is about.
    pub topic: Topic,
    /// A sentence for people; may be empty where the data says it all.
    pub words: String,
    /// The same for machines; its shape depends on the topic.
    pub data: serde_json::Value,
}

/// What a listener hears from now on.
pub type Heard = broadcast::Receiver<Arc<Event>>;

#[derive(Default)]
struct Told {
    last_id: u64,
    /// The newest events, the oldest of them first.
    recent: VecDeque<Arc<Event>>,
}

struct Hub {
    /// Tells this run of the program from others, whose numbers begin at 1, too.
    boot: String,
    told: Mutex<Told>,
    sender: broadcast::Sender<Arc<Event>>,
}

/// The channel; clones share it.
#[derive(Clone)]
pub struct Events(Arc<Hub>);

impl Default for Events {
    fn default() -> Self {
        let started = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos());
        let (boot, sender) = (format!("{started:x}"), broadcast::Sender::new(BACKLOG));
        Self(Arc::new(Hub { boot, told: Mutex::default(), sender }))
    }
}

impl Events {
    fn told(&self) -> MutexGuard<'_, Told> {
        self.0.told.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells everybody who listens now; never blocks.
    pub fn tell(&self, topic: Topic, words: impl Into<String>, data: serde_json::Value) {
        // Numbering and sending under one lock keeps the order of numbers and of arrival the same.
        let mut told = self.told();
        told.last_id += 1;
        let event = Arc::new(Event { id: told.last_id, topic, words: words.into(), data });
        if told.recent.len() == REMEMBERED {
            told.recent.pop_front();
        }
        told.recent.push_back(event.clone());
        // An error only says that nobody listens.
        let _nobody = self.0.sender.send(event);
    }

    /// Everything from now on, and the number of the last event before.
    pub fn listen(&self) -> (u64, Heard) {
        let told = self.told();
        (told.last_id, self.0.sender.subscribe())
    }

    /// An event's name among those of all runs: `BOOT.N`.
    pub fn mark(&self, id: u64) -> String {
        format!("{}.{id}", self.0.boot)
    }

    /// What happened after the event of this [`mark`](Self::mark), and everything from now on. `None` if that cannot be
    /// told: another run, too long ago, or no event at all.
    pub fn listen_after(&self, mark: &str) -> Option<(Vec<Arc<Event>>, Heard)> {
        let (boot, id) = mark.rsplit_once('.')?;
        let id: u64 = id.parse().ok().filter(|_| boot == self.0.boot)?;
        let told = self.told();
        let missed = usize::try_from(told.last_id.checked_sub(id)?).ok()?;
        let known = told.recent.len().checked_sub(missed)?;
        Some((told.recent.range(known..).cloned().collect(), self.0.sender.subscribe()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn listeners_hear_everything_after_they_came_in_order_without_gaps() {
        let events = Events::default();
        events.tell(Topic::Job, "before", serde_json::Value::Null);
        let (last, mut ear) = events.listen();
        assert_eq!(last, 1);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..50).for_each(|_| events.tell(Topic::Job, "x", serde_json::Value::Null)));
            }
        });
        for id in 2..202 {
            assert_eq!(ear.try_recv().unwrap().id, id);
        }
    }

    #[test]
    fn who_comes_back_hears_what_was_missed_once_and_in_order() {
        let events = Events::default();
        let tell = |count: u64| (0..count).for_each(|_| events.tell(Topic::Job, "", serde_json::Value::Null));
        tell(10);
        let (missed, mut heard) = events.listen_after(&events.mark(7)).unwrap();
        tell(2);
        let mut ids: Vec<u64> = missed.iter().map(|event| event.id).collect();
        ids.extend(std::iter::from_fn(|| heard.try_recv().ok()).map(|event| event.id));
        assert_eq!(ids, [8, 9, 10, 11, 12]);
        assert!(events.listen_after(&events.mark(12)).unwrap().0.is_empty());
    }

    #[test]
    fn what_cannot_be_told_any_more_is_not_told_in_part() {
        let events = Events::default();
        let started = events.mark(0);
        assert!(events.listen_after(&started).unwrap().0.is_empty());
        (0..REMEMBERED).for_each(|_| events.tell(Topic::Job, "", serde_json::Value::Null));
        assert_eq!(events.listen_after(&started).unwrap().0.len(), REMEMBERED);
        events.tell(Topic::Job, "", serde_json::Value::Null);
        assert!(events.listen_after(&started).is_none(), "the first is forgotten");
        assert!(events.listen_after(&events.mark(1)).is_some());
        let other = Events::default();
        for strange in ["", "7", ".", "x.7", &other.mark(1), &events.mark(u64::MAX), "a.b.c"] {
            assert!(events.listen_after(strange).is_none(), "{strange:?}");
        }
    }
}
