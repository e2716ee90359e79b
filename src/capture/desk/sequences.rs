//! Sequences over the desk: each pair is an ordinary job of the rig's lane, so that others may shoot in between.

use super::retry::POSITION;
use super::works::Ask;
use super::{Desk, DeskError, For, Inner};
use crate::capture::events::Topic;
use crate::capture::place::name_of;
use crate::capture::sequence::{Conductor, SequenceEvent, SequenceView, Shooter, read as read_sequence};
use crate::jobs::{JobId, Lane};
use crate::session::{SequencePlan, Session, SessionError};
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// Sequences by their session's name.
#[derive(Default)]
pub(super) struct Sequences {
    /// Of sessions that are open.
    conducted: Mutex<BTreeMap<String, Arc<Conductor>>>,
    /// Those that an earlier program left under way, as they were found; nobody has taken them up.
    left: Mutex<BTreeMap<String, SequenceView>>,
}

impl Desk {
    fn conductors(&self) -> MutexGuard<'_, BTreeMap<String, Arc<Conductor>>> {
        // Conductors are inserted whole.
        self.0.sequences.conducted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn conductor(&self, session: &Arc<Session>) -> Result<Arc<Conductor>, DeskError> {
        let name = name_of(session);
        if let Some(conductor) = self.conductors().get(&name) {
            return Ok(conductor.clone());
        }
        let (desk, job) = (Arc::downgrade(&self.0), Mutex::default());
        let shooter = Box::new(ByJobs { desk, session: session.clone(), job });
        // From the network no file can be named: it is always the session's own.
        let trigger = session.trigger_file();
        let conductor = Conductor::open(session.clone(), shooter, self.0.events.clone(), trigger)?;
        self.left().remove(&name);
        // Whoever was faster in the meantime has taken it up.
        Ok(self.conductors().entry(name).or_insert(conductor).clone())
    }

    /// Takes up the sequence of a session that somebody has entered, paused, and tells how it stands.
    pub(super) fn take_up_sequence(&self, session: &Arc<Session>) {
        if let Err(error) = self.conductor(session) {
            let words = format!("The sequence of {} cannot be taken up: {error}", name_of(session));
            self.0.events.tell(Topic::Trouble, words, json!({ "session": name_of(session) }));
        }
    }

    /// Tells a session's sequence of a rejected pair that was shot again by hand and is good. One that nobody conducts
    /// reads it from the pairs when it is taken up.
    pub(super) fn mend_sequence(&self, session: &Session, pair: u32) {
        let conductor = self.conductors().get(&name_of(session)).cloned();
        match conductor {
            Some(conductor) => conductor.mended(pair),
            // It was told as it was found at the start, and may stand otherwise now.
            None if self.left().remove(&name_of(session)).is_some() => self.note_left_sequence(session),
            None => {}
        }
    }

    /// Has a session's sequence written down as it stands, if a disk refused that before: else it could take somebody else's
    /// pair for its own after a restart.
    pub(super) fn keep_sequence(&self, session: &Session) -> Result<(), SessionError> {
        let conductor = self.conductors().get(&name_of(session)).cloned();
        conductor.map_or(Ok(()), |conductor| conductor.write_down())
    }

    fn left(&self) -> MutexGuard<'_, BTreeMap<String, SequenceView>> {
        // Views are inserted whole.
        self.0.sequences.left.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells of a sequence that an earlier program left under way.
    pub(super) fn note_left_sequence(&self, session: &Session) {
        // What cannot be read is told to whoever enters the session.
        let Ok(view) = read_sequence(session) else { return };
        if view.state.is_under_way() && !self.conductors().contains_key(&view.session) {
            self.0.events.tell(Topic::Sequence, view.words.clone(), json!(view));
            self.left().insert(view.session.clone(), view);
        }
    }

    /// The sequences of the sessions that are open, and those that an earlier program left under way, as it left them;
    /// never waits for a disk.
    pub fn sequences(&self) -> Vec<SequenceView> {
        let conducted = self.conductors();
        let left = self.left();
        let left =
            left.iter().filter(|(name, _)| !conducted.contains_key(*name)).map(|(_, view)| view.clone());
        conducted.values().filter_map(|conductor| conductor.view().ok()).chain(left).collect()
    }

    /// How a session's sequence stands. A session that is not open is looked at and kept from nobody.
    pub fn sequence(&self, session: &str) -> Result<SequenceView, DeskError> {
        match self.entered_session(session) {
            Some(session) => Ok(self.conductor(&session)?.view()?),
            None => Ok(read_sequence(&*self.reader(session)?)?),
        }
    }

    /// Plans a session's sequence, or changes how it goes on; says whether a new one was begun.
    pub fn plan_sequence(
        &self,
        session: &str,
        plan: SequencePlan,
    ) -> Result<(SequenceView, bool), DeskError> {
        let conductor = self.conductor(&self.session(session)?)?;
        let made = conductor.plan(plan)?;
        Ok((conductor.view()?, made))
    }

    /// Tells a session's sequence what somebody wants; `position`, where given, is the only one that is meant.
    pub fn direct_sequence(
        &self,
        session: &str,
        wish: SequenceEvent,
        position: Option<u32>,
    ) -> Result<SequenceView, DeskError> {
        Ok(self.conductor(&self.session(session)?)?.wish(wish, position)?)
    }

    /// Removes a session's sequence; its pairs stay.
    pub fn remove_sequence(&self, session: &str) -> Result<(), DeskError> {
        Ok(self.conductor(&self.session(session)?)?.forget()?)
    }
}

/// Has each pair taken by a job.
struct ByJobs {
    /// The desk has the conductor, which has this.
    desk: Weak<Inner>,
    session: Arc<Session>,
    job: Mutex<Option<JobId>>,
}

impl ByJobs {
    fn desk(&self) -> Option<Desk> {
        self.desk.upgrade().map(|inner| Desk(inner, For::default()))
    }

    fn job(&self) -> MutexGuard<'_, Option<JobId>> {
        self.job.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Shooter for ByJobs {
    fn begin(&self, conductor: &Arc<Conductor>, position: u32) -> Result<(), String> {
        let desk = self.desk().ok_or("the program is ending")?;
        let (conductor, session, own) = (conductor.clone(), self.session.clone(), desk.clone());
        let ask = Ask::new("pair", Lane::Rig).again(json!({ POSITION: position }));
        let queued = desk.ask(ask, name_of(&self.session), move |progress| {
            let record = conductor.take_pair(&own.0.engine, own.0.after_pair.as_ref(), progress)?;
            own.go_on_from(&session, &record);
            Ok(json!({
                "session": name_of(&session), "number": record.number, "attempt": record.attempt,
                "verdict": record.verdict, "position": position,
            }))
        });
        *self.job() = Some(queued.map_err(|error| error.to_string())?.id);
        Ok(())
    }

    fn stop(&self) {
        if let (Some(desk), Some(job)) = (self.desk(), *self.job()) {
            // A job that ended in the meantime is what was wanted.
            let _ended_already = desk.0.queue.cancel(job);
        }
    }

    fn is_lost(&self) -> bool {
        let (Some(desk), Some(job)) = (self.desk(), *self.job()) else { return true };
        desk.0.queue.get(job).map_or(true, |job| job.state.is_final())
    }
}
