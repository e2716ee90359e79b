//! Where a pair of frames goes: into the session as a pair, or beside it as a calibration shot.

use super::wish::PairWish;
use crate::pair::order::{OrderError, Program};
use crate::pair::{Drift, Expected, FlashRecord, PairRecord, Plan, Reason, Settings, Stop, Window};
use crate::photometry::levels::MeasuredLevels;
use crate::pipeline::calibrate::RecordError;
use crate::pipeline::levels;
use crate::pipeline::scale::SessionScale;
use crate::pipeline::stops::{Delivery, Earlier};
use crate::rig::Shot;
use crate::session::{
    self, Commit, More, NewFrame, NewPair, Prepared, Session, SessionError, Staged, Stager, advice,
};
use std::path::PathBuf;
use std::sync::Arc;

/// One frame as the camera delivered it, with the settings out of its EXIF.
pub(super) struct Delivered<'a> {
    pub(super) shot: &'a Shot,
    pub(super) settings: Settings,
    pub(super) blake3: String,
    /// The raw on the disk, where it was written ahead.
    pub(super) staged: Option<&'a Staged>,
}

impl<'a> Delivered<'a> {
    pub(super) fn new_frame(&self) -> NewFrame<'a> {
        NewFrame {
            bytes: &self.shot.raw.bytes,
            original_name: &self.shot.raw.name,
            settings: self.settings.clone(),
            prepared: Some(Prepared { blake3: self.blake3.clone(), staged: self.staged }),
            jpeg: self.shot.jpeg.as_ref().map(|jpeg| (jpeg.bytes.as_slice(), jpeg.name.as_str())),
        }
    }
}

/// A pair's frames, and what is known of them.
pub(super) struct Shots<'a> {
    pub(super) off: Delivered<'a>,
    pub(super) more_off: Vec<Delivered<'a>>,
    pub(super) on: Delivered<'a>,
    pub(super) after: Vec<Delivered<'a>>,
    pub(super) drift: Option<Drift>,
    pub(super) flash: Option<FlashRecord>,
    pub(super) reasons: Vec<Reason>,
    /// By which later pairs of the same stop are known.
    pub(super) stop: Option<Stop>,
}

/// Why two frames could not be stored.
#[derive(Debug, thiserror::Error)]
pub enum PlaceError {
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The disk refused.
    #[error("{path}: {source}; {}", advice(source))]
    Disk {
        /// File or folder.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
    /// The session's measured levels.
    #[error(transparent)]
    Levels(#[from] RecordError),
    /// The frames that were asked for.
    #[error(transparent)]
    Order(#[from] OrderError),
    /// A frame is missing.
    #[error("a frame of the pair is missing; take the pair again")]
    Incomplete,
}

/// Takes what the engine delivers.
pub(super) trait Place {
    /// Number by which the flash controller knows the shot; not 0.
    fn tag(&self) -> u32;
    /// Which frames are to be shot, and in which order.
    fn program(&self) -> Program;
    /// At which exposures the two frames are to be shot; as the camera stands if `None`.
    fn plan(&self) -> Option<Plan>;
    /// Makes what the camera shows the plan from now on.
    fn adopt(&mut self, plan: Plan) -> Result<(), PlaceError>;
    /// Where the object is in the frame; everywhere if `None`.
    fn region(&self) -> Option<Window>;
    /// Whether the controller's photodiode has seen this flash before.
    fn sees_light(&self) -> bool;
    /// Writes raws to the disk ahead, where the place takes them so.
    fn stager(&self) -> Option<Stager>;
    /// Levels as they were measured for the session.
    fn levels(&self) -> Arc<MeasuredLevels>;
    /// How light goes with the settings.
    fn scale(&self) -> &SessionScale;
    /// What is known beforehand of a pair whose files have the digests `off` and `on` and whose pulse measured
    /// `energy` counts.
    fn expected<'a>(&'a self, off: &'a str, on: &'a str, energy: Option<f64>) -> Expected<'a>;
    /// Writes down that the frames are about to be shot.
    fn intend(&mut self) -> Result<(), PlaceError>;
    /// Stores all frames; on the disk when this returns.
    fn store(&mut self, shots: Shots) -> Result<(), PlaceError>;
    /// Writes down that nothing was stored, and why.
    fn abandon(&mut self, why: &str) -> Result<(), PlaceError>;
}

/// The session's next pair, or a rejected one that is shot again.
pub(super) struct PairPlace<'a> {
    session: &'a Session,
    earlier: &'a mut Earlier,
    levels: Arc<MeasuredLevels>,
    number: u32,
    program: Program,
    again: Option<u32>,
    stored: Option<PairRecord>,
}

impl<'a> PairPlace<'a> {
    /// `earlier` remembers the session's pairs, and this one once it is stored.
    pub(super) fn new(
        session: &'a Session,
        wish: PairWish,
        earlier: &'a mut Earlier,
    ) -> Result<Self, PlaceError> {
        let program = wish.program(session)?;
        let levels = Arc::new(levels::load(session)?);
        let number = wish.again.map_or_else(|| session.next_pair_number(), Ok)?;
        Ok(Self { session, earlier, levels, number, program, again: wish.again, stored: None })
    }

    /// The pair, once stored.
    pub(super) fn into_record(self) -> Option<PairRecord> {
        self.stored
    }
}

/// A session's name among its like: its folder's.
pub(super) fn name_of(session: &Session) -> String {
    session.path().file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

pub(super) fn note(session: &Session, what: &str, detail: serde_json::Value) -> Result<(), PlaceError> {
    Ok(session.record(session::Event::Note { what: what.to_owned(), detail })?)
}

impl Place for PairPlace<'_> {
    fn tag(&self) -> u32 {
        self.number
    }

    fn program(&self) -> Program {
        self.program
    }

    fn plan(&self) -> Option<Plan> {
        self.session.manifest().plan
    }

    fn adopt(&mut self, plan: Plan) -> Result<(), PlaceError> {
        Ok(self.session.set_plan(plan)?)
    }

    fn region(&self) -> Option<Window> {
        self.session.manifest().region
    }

    fn sees_light(&self) -> bool {
        self.earlier.sees_light()
    }

    fn stager(&self) -> Option<Stager> {
        Some(self.session.stager())
    }

    fn levels(&self) -> Arc<MeasuredLevels> {
        self.levels.clone()
    }

    fn scale(&self) -> &SessionScale {
        self.earlier.scale()
    }

    fn expected<'b>(&'b self, off: &'b str, on: &'b str, energy: Option<f64>) -> Expected<'b> {
        self.earlier.expecting(off, on, energy, Delivery::Camera)
    }

    fn intend(&mut self) -> Result<(), PlaceError> {
        self.number = self.session.intend(self.again, self.program)?.number;
        Ok(())
    }

    fn store(&mut self, shots: Shots) -> Result<(), PlaceError> {
        let commit = self.session.commit_pair(NewPair {
            name: None,
            off: shots.off.new_frame(),
            on: shots.on.new_frame(),
            reasons: shots.reasons,
            flash: shots.flash,
            more: More {
                program: self.program,
                off: shots.more_off.iter().map(Delivered::new_frame).collect(),
                after: shots.after.iter().map(Delivered::new_frame).collect(),
                crossed: None,
                drift: shots.drift,
                again: self.again,
            },
        })?;
        let (Commit::Stored(record) | Commit::AlreadyThere(record)) = commit;
        // The pair is safe; a signature that could not be kept is made again when it is needed.
        if let Err(error) = self.earlier.add(self.session, &record, shots.stop) {
            tracing::warn!("{error}");
        }
        self.stored = Some(record);
        Ok(())
    }

    fn abandon(&mut self, why: &str) -> Result<(), PlaceError> {
        Ok(self.session.abandon_pair(why)?)
    }
}
