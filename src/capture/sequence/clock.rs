//! The conductor's clock: a thread that lives only while time, the trigger file or a pair matters.

use super::conductor::{Conductor, Inside};
use super::machine::Event;
use std::sync::{Arc, Weak};
use std::time::Duration;

/// How often clock, trigger file and pair are looked at. The kernel's notices of files would come sooner, but not
/// from network disks.
const GLANCE: Duration = Duration::from_millis(200);
/// Shortest nap of the clock.
const SHORTEST_NAP: Duration = Duration::from_millis(5);

impl Conductor {
    /// How long until the clock has to look again; `None` while nothing is to be looked at.
    fn nap(&self, inside: &Inside) -> Option<Duration> {
        let (plan, state) = inside.sequence.as_ref()?;
        // Never a long sleep: a pause may shorten it, and whoever drops the conductor must not wait long.
        let due = state.due(plan).map(|due| due.saturating_sub(self.now()).clamp(SHORTEST_NAP, GLANCE));
        due.or((state.under_way.is_some() || state.watches(plan)).then_some(GLANCE))
    }

    pub(super) fn start_clock(self: &Arc<Self>, inside: &mut Inside) {
        if inside.ticking || self.nap(inside).is_none() {
            return;
        }
        let weak = Arc::downgrade(self);
        match std::thread::Builder::new().name("sequence".into()).spawn(move || tick(&weak)) {
            Ok(_) => inside.ticking = true,
            Err(error) => tracing::error!("no thread to be had for the sequence of {}: {error}", self.name),
        }
    }

    /// One look at clock, trigger file and pair; gives the next nap.
    fn look(self: &Arc<Self>) -> Option<Duration> {
        let mut inside = self.inside();
        if let Some((plan, state)) = &inside.sequence {
            let event = if state.under_way.is_some() {
                self.shooter.is_lost().then(|| Event::Failed("The pair was cancelled.".into()))
            } else if state.due(plan).is_some_and(|due| due <= self.now()) {
                Some(Event::Tick)
            } else {
                (state.watches(plan) && self.trigger.exists()).then_some(Event::Triggered)
            };
            if let Some(event) = event
                && let Err(error) = self.apply(&mut inside, event)
            {
                tracing::error!("the sequence of {} is stuck: {error}", self.name);
            }
        }
        let nap = self.nap(&inside);
        inside.ticking = nap.is_some();
        nap
    }
}

/// The clock's thread.
fn tick(conductor: &Weak<Conductor>) {
    let mut nap = Some(SHORTEST_NAP);
    while let Some(length) = nap {
        std::thread::sleep(length);
        // Between two looks the conductor may be dropped.
        nap = conductor.upgrade().and_then(|conductor| conductor.look());
    }
}
