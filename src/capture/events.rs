//! What happens in the house, told to whoever listens: page, scripts, terminal.

use serde::Serialize;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::broadcast;

/// Events that a listener may fall behind before it loses the oldest.
const BACKLOG: usize = 1024;

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
    /// A pair of calibration frames is safe on disk.
    CalibrationShot,
    /// A device failed and is brought back; the pair goes on.
    Recovery,
    /// Something asked for could not be done.
    Trouble,
    /// A job changed.
    Job,
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
            Topic::Recovery => "recovery",
            Topic::Trouble => "trouble",
            Topic::Job => "job",
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

struct Hub {
    last_id: Mutex<u64>,
    sender: broadcast::Sender<Arc<Event>>,
}

/// The channel; clones share it.
#[derive(Clone)]
pub struct Events(Arc<Hub>);

impl Default for Events {
    fn default() -> Self {
        Self(Arc::new(Hub { last_id: Mutex::default(), sender: broadcast::Sender::new(BACKLOG) }))
    }
}

impl Events {
    /// Tells everybody who listens now; never blocks.
    pub fn tell(&self, topic: Topic, words: impl Into<String>, data: serde_json::Value) {
        // Numbering and sending under one lock keeps the order of numbers and of arrival the same.
        let mut last_id = self.0.last_id.lock().unwrap_or_else(PoisonError::into_inner);
        *last_id += 1;
        let event = Event { id: *last_id, topic, words: words.into(), data };
        // An error only says that nobody listens.
        let _nobody = self.0.sender.send(Arc::new(event));
    }

    /// Everything from now on, and the number of the last event before.
    pub fn listen(&self) -> (u64, broadcast::Receiver<Arc<Event>>) {
        let last_id = self.0.last_id.lock().unwrap_or_else(PoisonError::into_inner);
        (*last_id, self.0.sender.subscribe())
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
}
