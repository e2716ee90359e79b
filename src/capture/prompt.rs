//! A question to the operator that the engine waits on: "switch the flash off, then confirm".

use super::events::{Events, Topic};
use crate::progress::{Cancelled, Progress};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How often a waiting engine looks at its cancel flag.
const GLANCE: Duration = Duration::from_millis(50);

#[derive(Default)]
struct Question {
    open: Option<String>,
    confirmed: bool,
}

/// Asks, waits, is answered from another thread.
pub(super) struct Prompter {
    question: Mutex<Question>,
    answered: Condvar,
    events: Events,
}

impl Prompter {
    pub(super) fn new(events: Events) -> Self {
        Self { question: Mutex::default(), answered: Condvar::new(), events }
    }

    fn question(&self) -> MutexGuard<'_, Question> {
        self.question.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is asked at the moment.
    pub(super) fn open(&self) -> Option<String> {
        self.question().open.clone()
    }

    /// Says that it is done; `false` if nothing was asked.
    pub(super) fn confirm(&self) -> bool {
        let mut question = self.question();
        if question.open.is_none() {
            return false;
        }
        question.confirmed = true;
        self.answered.notify_all();
        true
    }

    /// Asks and blocks until it is confirmed or the work is cancelled.
    pub(super) fn ask(&self, words: &str, progress: &Progress) -> Result<(), Cancelled> {
        *self.question() = Question { open: Some(words.to_owned()), confirmed: false };
        self.events.tell(Topic::Prompt, words, serde_json::Value::Null);
        let mut question = self.question();
        let outcome = loop {
            if question.confirmed {
                break Ok(());
            }
            if let Err(cancelled) = progress.check() {
                break Err(cancelled);
            }
            question = self.answered.wait_timeout(question, GLANCE).unwrap_or_else(PoisonError::into_inner).0;
        };
        *question = Question::default();
        drop(question);
        self.events.tell(Topic::PromptDone, "", serde_json::Value::Null);
        outcome
    }
}
