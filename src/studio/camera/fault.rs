//! What can go wrong with the simulated body, and the script that says when.
//!
//! A fault is *armed* (by [`Faults::arm`], by a script at a given operation, or again and again by a seeded
//! rule) and then *strikes* at the first operation that suits it: a busy answer at a release, a cut at a download.
//! What has struck is kept in order, so that a test can prove that its fault was really met.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// When a late frame is announced at last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Late {
    /// At the first polling of events of the next client that connects.
    NextClient,
    /// With the next release, before that release's own frame: it looks like the new frame.
    NextRelease,
    /// At the first polling of events after this time.
    After(Duration),
}

/// What can go wrong with a body, for tests. Each strikes once unless its line says otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// No request is answered any more, until [`super::CameraServer::mend`]; then the link drops.
    Stall,
    /// One operation is neither carried out nor answered; the ones after it are.
    StallOnce,
    /// The next release is answered "busy" (0x2019).
    BusyOnce,
    /// So many releases are answered "busy".
    BusyFor(u32),
    /// The lens finds no focus: the release is refused (0x2002), which libgphoto2 reports as `Other` with the reason
    /// in its log alone.
    NoFocus,
    /// The lens hunts for so long and finds no focus: the release is answered "busy" then, as bodies with
    /// RemoteReleaseOn were reported to do.
    FocusHunt(Duration),
    /// A frame is exposed, never announced, and "done" is never said.
    NeverAnnounced,
    /// A frame is exposed and announced, with "done", only when its shot was given up long ago.
    LateObject(Late),
    /// A frame is announced twice.
    DoubledObject,
    /// The file in the body lacks its last bytes; it is announced as if it were whole, and asking for the rest is
    /// refused.
    CutObject {
        /// How many bytes are missing.
        missing: u32,
    },
    /// The file in the body lacks its last bytes; it is announced as if it were whole, and asking for the rest gives
    /// nothing and "OK": libgphoto2 then asks for ever, without a pause.
    HollowObject {
        /// How many bytes are missing.
        missing: u32,
    },
    /// The first download of the file lacks the last bytes and asking for the rest is refused; the body still has the
    /// whole file for a second download.
    CutDownload {
        /// How many bytes are missing.
        missing: u32,
    },
    /// The file in the body lacks its last bytes and is announced as short as it is.
    ShortFile {
        /// How many bytes are missing.
        missing: u32,
    },
    /// The next download loses its link half-way.
    DropInDownload,
    /// The plug is pulled half-way through the next download; see [`Fault::Unplug`].
    UnplugInDownload,
    /// The body says that there is no room for another frame; libgphoto2 then asks for ever, without a pause.
    /// Stands until mended.
    NoRoom,
    /// A set is answered "OK", the value stays, and the old one is announced.
    SetIgnored,
    /// A frame is exposed, and labelled, one stop slower than the dial shows (one stop faster at the end of the dial).
    WrongExif,
    /// The release is refused because the card is full (0x200c). Strikes while frames go to the card.
    CardFull,
    /// The battery is low: the body says so, and refuses each release. Stands until mended.
    LowBattery,
    /// A frame is exposed, but the bytes of the one before come again. Strikes from the second frame on.
    RepeatedFrame,
    /// The plug is pulled: all links drop and none is taken until [`super::CameraServer::replug`].
    Unplug,
    /// The body says "done" only after this time, and is busy until then.
    SlowReady(Duration),
}

impl Fault {
    /// Whether it lasts until mended, once it has struck.
    fn stands(self) -> bool {
        matches!(self, Self::Stall | Self::NoRoom | Self::LowBattery)
    }

    /// What is left of it after it struck once more.
    fn rest(self) -> Option<Self> {
        match self {
            Self::BusyFor(n) if n > 1 => Some(Self::BusyFor(n - 1)),
            fault if fault.stands() => Some(fault),
            _ => None,
        }
    }
}

/// What a repeating rule counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// PTP operations; one shot takes some thirty of them.
    Operations,
    /// Presses of the release, refused ones too.
    Releases,
}

/// Arms one of `faults`, picked by `random`, at every `every`th of what it counts.
struct Rule {
    count: Count,
    every: u64,
    random: ChaCha8Rng,
    faults: Vec<Fault>,
}

/// The faults of one body: armed, planned, and met.
#[derive(Default)]
pub(super) struct Faults {
    armed: VecDeque<Fault>,
    script: BTreeMap<u64, Vec<Fault>>,
    rule: Option<Rule>,
    struck: Vec<Fault>,
    /// PTP operations since the start.
    pub(super) operations: u64,
    /// Presses of the release since the start.
    pub(super) releases: u64,
}

impl Faults {
    /// Arms a fault, after those that are armed already.
    pub(super) fn arm(&mut self, fault: Fault) {
        self.armed.push_back(fault);
    }

    /// Disarms whatever is armed. The script and the rule go on.
    pub(super) fn mend(&mut self) {
        self.armed.clear();
    }

    /// Adds to the script.
    pub(super) fn plan(&mut self, script: impl IntoIterator<Item = (u64, Fault)>) {
        for (at, fault) in script {
            self.script.entry(at).or_default().push(fault);
        }
    }

    /// Sets the repeating rule; without faults or with `every` 0 there is none.
    pub(super) fn repeat(&mut self, count: Count, every: u64, seed: u64, faults: &[Fault]) {
        self.rule = (every > 0 && !faults.is_empty()).then(|| Rule {
            count,
            every,
            random: ChaCha8Rng::seed_from_u64(seed),
            faults: faults.to_vec(),
        });
    }

    /// One more operation: what is due at it, or was due before it, is armed.
    pub(super) fn count_operation(&mut self) {
        self.operations += 1;
        while let Some(entry) = self.script.first_entry().filter(|e| *e.key() <= self.operations) {
            self.armed.extend(entry.remove());
        }
        self.apply_rule(Count::Operations, self.operations);
    }

    /// One more press of the release.
    pub(super) fn count_release(&mut self) {
        self.releases += 1;
        self.apply_rule(Count::Releases, self.releases);
    }

    fn apply_rule(&mut self, count: Count, number: u64) {
        if let Some(rule) = self.rule.as_mut().filter(|r| r.count == count && number.is_multiple_of(r.every))
        {
            let pick = rule.random.next_u32() as usize % rule.faults.len();
            self.armed.push_back(rule.faults[pick]);
        }
    }

    /// The first armed fault that suits strikes. A standing one is noted once, when it strikes first.
    pub(super) fn strike(&mut self, suits: impl Fn(&Fault) -> bool) -> Option<Fault> {
        let at = self.armed.iter().position(suits)?;
        let fault = self.armed.remove(at)?;
        if !(fault.stands() && self.struck.last() == Some(&fault)) {
            self.struck.push(fault);
        }
        if let Some(rest) = fault.rest() {
            self.armed.insert(at, rest);
        }
        Some(fault)
    }

    /// Notes a fault that struck from outside.
    pub(super) fn note(&mut self, fault: Fault) {
        self.struck.push(fault);
    }

    /// Whether this fault is armed.
    pub(super) fn has(&self, fault: Fault) -> bool {
        self.armed.contains(&fault)
    }

    /// What has struck, in order.
    pub(super) fn struck(&self) -> &[Fault] {
        &self.struck
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scripted_fault_waits_for_its_operation_and_then_for_one_that_suits() {
        let mut faults = Faults::default();
        faults.plan([(2, Fault::BusyOnce), (3, Fault::SetIgnored)]);
        faults.count_operation();
        assert_eq!(faults.strike(|f| *f == Fault::BusyOnce), None);
        faults.count_operation();
        faults.count_operation();
        assert_eq!(faults.strike(|f| *f == Fault::SetIgnored), Some(Fault::SetIgnored));
        assert_eq!(faults.strike(|f| *f == Fault::BusyOnce), Some(Fault::BusyOnce));
        assert_eq!(faults.strike(|f| *f == Fault::BusyOnce), None);
        assert_eq!(faults.struck(), [Fault::SetIgnored, Fault::BusyOnce]);
    }

    #[test]
    fn a_fault_for_many_releases_counts_down_and_a_standing_one_stays_until_mended() {
        let mut faults = Faults::default();
        faults.arm(Fault::BusyFor(2));
        let busy = |f: &Fault| matches!(f, Fault::BusyFor(_));
        assert!(faults.strike(busy).is_some() && faults.strike(busy).is_some());
        assert_eq!(faults.strike(busy), None);
        faults.arm(Fault::NoRoom);
        assert!((0..9).all(|_| faults.strike(|f| *f == Fault::NoRoom).is_some()));
        assert_eq!(faults.struck().iter().filter(|f| **f == Fault::NoRoom).count(), 1);
        faults.mend();
        assert!(!faults.has(Fault::NoRoom));
    }

    #[test]
    fn a_rule_arms_every_nth_and_the_same_seed_gives_the_same_row() {
        let kinds = [Fault::BusyOnce, Fault::DoubledObject, Fault::DropInDownload];
        let row = |seed| {
            let mut faults = Faults::default();
            faults.repeat(Count::Releases, 3, seed, &kinds);
            (0..60).for_each(|_| faults.count_release());
            std::iter::from_fn(|| faults.strike(|_| true)).collect::<Vec<_>>()
        };
        assert_eq!(row(1).len(), 20);
        assert_eq!(row(1), row(1));
        assert_ne!(row(1), row(2));
    }
}
