//! A session in a few words.

use super::{Desk, DeskError};
use crate::pair::{Lighting, Plan, Verdict, Window};
use crate::session::{MirrorStatus, Room};

/// A session in a few words.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionSummary {
    /// Its name, which is its folder's.
    pub name: String,
    /// When it was made, UTC.
    pub created: String,
    /// Whether new pairs go there.
    pub current: bool,
    /// Pairs stored.
    pub pairs: usize,
    /// Those that processing uses.
    pub accepted: usize,
    /// Whether a scene is there.
    pub has_scene: bool,
    /// Whether a flash calibration is there.
    pub has_flash_calibration: bool,
    /// Exposures of its pairs.
    pub plan: Option<Plan>,
    /// Where the object is; the whole frame if absent.
    pub region: Option<Window>,
    /// Polariser and flash power, as the operator told them.
    pub lighting: Lighting,
    /// Settings that the camera does not tell and the operator has confirmed.
    pub confirmed: Vec<String>,
    /// Finished results, paths inside the session.
    pub results: Vec<String>,
    /// Room on its disk.
    pub room: Option<Room>,
    /// What had to be put right when it was opened, in sentences; of one that is not open, what will have to be.
    pub recovered: Vec<String>,
    /// Its second copy; `None` without `--mirror`, and of a session that is not open for writing.
    pub mirror: Option<MirrorStatus>,
    /// Why nothing else is known of it, if so.
    pub problem: Option<String>,
}

impl Desk {
    /// All sessions of the folder, by name.
    pub fn summaries(&self) -> Result<Vec<SessionSummary>, DeskError> {
        let names = self.names()?;
        Ok(names.iter().map(|name| self.summary(name).unwrap_or_else(|e| unreadable(name, &e))).collect())
    }

    /// One session in a few words. A session that is not open is opened for reading and closed again.
    pub fn summary(&self, name: &str) -> Result<SessionSummary, DeskError> {
        let session = self.reader(name)?;
        let (current, recovery) = {
            let sessions = self.sessions();
            let recovery = sessions.recovered.get(name).unwrap_or(session.recovery());
            (sessions.current.as_deref() == Some(name), recovery.clone())
        };
        let manifest = session.manifest();
        let pairs = session.pairs()?;
        let results = ["model/model.glb", "model/report.html", "model/reflectance.exr", "model/stddev.exr"];
        Ok(SessionSummary {
            name: name.to_owned(),
            created: manifest.created,
            plan: manifest.plan,
            region: manifest.region,
            lighting: manifest.lighting,
            confirmed: manifest.confirmed,
            current,
            pairs: pairs.len(),
            accepted: pairs.iter().filter(|p| p.verdict == Verdict::Accepted).count(),
            has_scene: (self.0.works.has_scene)(&session),
            has_flash_calibration: (self.0.works.has_flash_calibration)(&session),
            results: results
                .into_iter()
                .filter(|file| session.path().join(file).is_file())
                .map(str::to_owned)
                .collect(),
            room: session.room_after(&pairs).ok(),
            recovered: recovery.sentences(|pair| pair.is_among(&pairs)),
            mirror: session.mirror(),
            problem: None,
        })
    }
}

fn unreadable(name: &str, error: &DeskError) -> SessionSummary {
    SessionSummary {
        name: name.to_owned(),
        created: String::new(),
        current: false,
        pairs: 0,
        accepted: 0,
        has_scene: false,
        has_flash_calibration: false,
        plan: None,
        region: None,
        lighting: Lighting::default(),
        confirmed: Vec::new(),
        results: Vec::new(),
        room: None,
        recovered: Vec::new(),
        mirror: None,
        problem: Some(error.to_string()),
    }
}
