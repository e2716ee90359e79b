//! What an earlier program left undone is found when this one starts, and goes on by itself where it can.

use super::works::{Ask, REST};
use super::{Desk, DeskError, For};
use crate::capture::events::Topic;
use crate::jobs::{Job, JobState, JobsError, Lane};
use crate::session::{Session, SessionError};
use serde_json::json;

/// What it means that the program ended before this job did.
pub(super) fn words_on_interrupted(job: &Job) -> String {
    let begun = if job.started.is_some() { "in the middle of this" } else { "before this was begun" };
    let then = match job.kind.as_str() {
        "pair" => {
            "a pair that was stored is in its session; one that was not is named there, and the next pair has its number"
        }
        "process" | "develop" => "it begins again by itself if it is still needed",
        "import_scene" => "send the scene again",
        _ => "ask for it again",
    };
    format!("The program ended {begun}: {then}.")
}

impl Desk {
    /// Looks at every session of the folder: names what was interrupted, tells which sequences are under way, and sets off
    /// the processing that is due.
    /// Takes as long as reading the sessions takes; everything else goes on meanwhile.
    pub fn resume(&self) {
        let names = match self.names() {
            Ok(names) => names,
            Err(error) => {
                tracing::warn!("the sessions cannot be looked at: {error}");
                return;
            }
        };
        for name in names {
            match self.resume_session(&name) {
                Ok(()) => {}
                // The program ends already; the next one looks again.
                Err(DeskError::Jobs(JobsError::Closed)) => return,
                Err(DeskError::Session(SessionError::Locked { .. })) => {
                    let words = format!(
                        "Session {name} is in use by another program and was not looked at: open it later, and what \
                         it lacks is done then."
                    );
                    let data = json!({ "code": "session_locked", "session": name });
                    self.0.events.tell(Topic::Recovery, words, data);
                }
                Err(error) => {
                    let words = format!("Session {name} could not be looked at: {error}");
                    tracing::warn!("{words}");
                    let data = json!({ "code": "session_unreadable", "session": name });
                    self.0.events.tell(Topic::Trouble, words, data);
                }
            }
        }
    }

    fn resume_session(&self, name: &str) -> Result<(), DeskError> {
        let (session, was_open) = match self.open_session(name) {
            Some(session) => (session, true),
            None => (self.reader(name)?, false),
        };
        self.note_left_sequence(&session);
        let due = self.is_due(&session)?;
        // One that is open has told what was interrupted.
        let interrupted = if was_open { Vec::new() } else { session.recovery().sentences(|_| false) };
        drop(session);
        if due {
            // None is open, and kept from others, before its job can wait in the queue.
            self.0.queue.wait_for_room(Lane::Processing)?;
            // Opening it tells what was interrupted, and puts it right.
            let session = self.lend(name)?;
            let ask = Ask::new("process", Lane::Processing).unasked(REST);
            self.retrying_process(name).enqueue_process(session, ask)?;
        } else if !interrupted.is_empty() {
            let data = json!({ "code": "session_recovered", "session": name });
            self.0.events.tell(Topic::Recovery, format!("{name}: {}", interrupted.join(" ")), data);
        }
        Ok(())
    }

    fn is_due(&self, session: &Session) -> Result<bool, DeskError> {
        Ok(self.missing(session)?.is_empty() && (self.0.works.needs_processing)(session))
    }

    /// The desk whose next processing of this session does the interrupted one again.
    fn retrying_process(&self, name: &str) -> Desk {
        let cut =
            |job: &Job| job.kind == "process" && job.subject == name && job.state == JobState::Interrupted;
        let retry_of = self.0.queue.list().into_iter().find(cut).map(|job| job.id);
        Desk(self.0.clone(), For { retry_of, ..For::default() })
    }
}
