//! The flash calibration of a session: card shots in, `calibration/flash.json` out.

use crate::calibration::{CardShot, FlashCalibration, FlashFitError, fit_flash};
use crate::codec::raw::RawError;
use crate::light::{Ring, RingError};
use crate::pair::{FlashRecord, FrameRecord, Settings};
use crate::photometry::{IsolateError, NoNoise, NoiseModel, isolate, isolate_dark};
use crate::pipeline::calibrate::{self, RecordError};
use crate::pipeline::levels;
use crate::pipeline::{develop::exposure_ratio, scene};
use crate::progress::{Cancelled, Progress};
use crate::scene::{Distortion, Intrinsics};
use crate::session::{Session, SessionError, store};
use glam::DVec2;
use std::path::{Path, PathBuf};

/// Why the flash could not be calibrated, or its calibration not be read.
#[derive(Debug, thiserror::Error)]
pub enum FlashError {
    /// None yet.
    #[error("the session {} has no flash calibration; shoot a white card and run `unlit calibrate flash`", .0.display())]
    None(PathBuf),
    /// No shot was given.
    #[error("no card shot was given: --shots takes DISTANCE_IN_METRES=FILE, for example 0.8=card80.cr2")]
    NoShots,
    /// The card's pixels cannot be turned into directions.
    #[error(
        "the lens's focal length is not known: import the scene first (`unlit import scene`), or give --focal-px (focal length in mm times image width in pixels over sensor width in mm)"
    )]
    NoLens,
    /// Settings differ between shots.
    #[error(
        "{label} was shot at other settings ({setting}) than the first shot: all card shots need one ISO and aperture"
    )]
    Settings {
        /// File.
        label: String,
        /// Which.
        setting: &'static str,
    },
    /// A shot cannot be decoded.
    #[error(transparent)]
    Raw(#[from] RawError),
    /// The frames of a shot do not fit together.
    #[error("{label}: {source}")]
    Isolate {
        /// File.
        label: String,
        /// What is wrong.
        source: IsolateError,
    },
    /// Noise could not be measured.
    #[error(transparent)]
    Noise(#[from] NoNoise),
    /// The ring's radii are impossible.
    #[error(transparent)]
    Ring(#[from] RingError),
    /// The fit failed.
    #[error(transparent)]
    Fit(#[from] FlashFitError),
    /// The file system refused.
    #[error("cannot access {}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The session's measured levels cannot be read.
    #[error(transparent)]
    Levels(#[from] RecordError),
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// `flash.json` is broken.
    #[error("{} is damaged ({reason}); run `unlit calibrate flash` again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// One shot of the card.
#[derive(Clone, Debug, PartialEq)]
pub struct CardFiles {
    /// Metres from the lens to the card.
    pub distance: f64,
    /// The frame lit by the flash.
    pub on: PathBuf,
    /// The frame without it; absent for shots in a dark room.
    pub off: Option<PathBuf>,
}

/// What is known beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CardFacts {
    /// The card's diffuse reflectance.
    pub target_reflectance: f64,
    /// Inner and outer radius of the ring, metres.
    pub ring_radii: [f64; 2],
    /// Focal length in pixels, where no scene tells it.
    pub focal_px: Option<f64>,
}

/// Fits the flash to card shots and stores the result as `calibration/flash.json`; the shots' files are kept
/// under `calibration/flash/`.
pub fn calibrate(
    session: &Session,
    shots: &[CardFiles],
    facts: CardFacts,
    progress: &Progress,
) -> Result<FlashCalibration, FlashError> {
    let ring = Ring::new(facts.ring_radii[0], facts.ring_radii[1])?;
    let measured = levels::load(session)?;
    let (mut frames, mut settings) = (vec![], None::<Settings>);
    for (i, shot) in shots.iter().enumerate() {
        progress.check()?;
        progress.report("reading card shots", i, shots.len());
        let on = levels::read(&shot.on, &measured)?;
        let off = shot.off.as_deref().map(|off| levels::read(off, &measured)).transpose()?;
        same_settings(settings.get_or_insert_with(|| on.settings.clone()), &on.settings, &shot.on)?;
        let off = match off {
            Some(off) => {
                let ratio = exposure_ratio(&on.settings, &off.settings)
                    .map_err(|setting| FlashError::Settings { label: label(&shot.on), setting })?;
                Some((off.mosaic, ratio as f32))
            }
            None => None,
        };
        frames.push((shot, on.mosaic, off));
    }
    let settings = settings.ok_or(FlashError::NoShots)?;
    progress.report("fitting the flash", 0, 1);
    let lit: Vec<_> = frames.iter().map(|(_, on, _)| on.clone()).collect();
    let noise = match calibrate::noise::model(session, &settings)? {
        Some(measured) => measured,
        None => NoiseModel::measure(&lit)?,
    };
    let intrinsics = lens(session, (lit[0].dn.width(), lit[0].dn.height()), facts.focal_px)?;
    let mut cards = vec![];
    for (shot, on, off) in &frames {
        let label = label(&shot.on);
        let known = match off {
            Some((off, ratio)) => isolate(on, off, *ratio, &noise)
                .map_err(|source| FlashError::Isolate { label: label.clone(), source })?,
            None => isolate_dark(on, &noise),
        };
        let energy_counts = energy_beside(&shot.on)?;
        cards.push(CardShot { label, distance: shot.distance, known, energy_counts });
    }
    let mut fit = fit_flash(&cards, &intrinsics, ring, facts.target_reflectance, noise)?;
    fit.iso = settings.iso.map(|s| s.0);
    fit.aperture = settings.aperture.map(|n| n.0);
    progress.check()?;
    keep(session, shots)?;
    let path = file(session);
    let bytes = serde_json::to_vec_pretty(&fit)
        .map_err(|e| FlashError::Damaged { path: path.clone(), reason: e.to_string() })?;
    session.keep(&path, &bytes)?;
    progress.report("fitting the flash", 1, 1);
    Ok(fit)
}

/// Reads the session's flash calibration.
pub fn load(session: &Session) -> Result<FlashCalibration, FlashError> {
    let path = file(session);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            return Err(FlashError::None(session.path().to_owned()));
        }
        Err(source) => return Err(FlashError::Io { path, source }),
    };
    serde_json::from_slice(&bytes).map_err(|e| FlashError::Damaged { path, reason: e.to_string() })
}

/// Whether the session has a flash calibration.
pub fn exists(session: &Session) -> bool {
    file(session).is_file()
}

pub(super) fn file(session: &Session) -> PathBuf {
    session.calibration_dir().join("flash.json")
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> FlashError + '_ {
    move |source| FlashError::Io { path: path.to_owned(), source }
}

/// File name, with its folder's where that alone would not tell shots apart (`d00700_1/on.cr2`).
fn label(path: &Path) -> String {
    let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
    let own = name(path).unwrap_or_else(|| path.display().to_string());
    match path.parent().and_then(name) {
        Some(folder) if path.file_stem().is_some_and(|stem| stem == "on") => format!("{folder}/{own}"),
        _ => own,
    }
}

/// What is read of the record that capture keeps beside a card shot's frames.
#[derive(serde::Deserialize)]
struct ShotRecord {
    on: FrameRecord,
    #[serde(default)]
    flash: Option<FlashRecord>,
}

/// Name of that record.
pub const SHOT_RECORD: &str = "shot.json";

/// Energy of a card shot's pulse, if the flash controller's account of this very frame lies beside it.
fn energy_beside(frame: &Path) -> Result<Option<f64>, FlashError> {
    let path = frame.with_file_name(SHOT_RECORD);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(FlashError::Io { path, source }),
    };
    let record: ShotRecord = match serde_json::from_slice(&bytes) {
        Ok(record) => record,
        Err(error) => {
            tracing::warn!(
                "{} is no record of a card shot ({error}); its energy is not known",
                path.display()
            );
            return Ok(None);
        }
    };
    let same = frame.file_name().is_some_and(|name| name == record.on.file.as_str())
        && store::digest_file(frame).map_err(io(frame))? == record.on.blake3;
    Ok(record.flash.as_ref().filter(|_| same).and_then(FlashRecord::energy_counts))
}

/// The flash's light goes with ISO and aperture, not with the shutter.
fn same_settings(first: &Settings, next: &Settings, path: &Path) -> Result<(), FlashError> {
    let setting = if first.iso != next.iso {
        "ISO"
    } else if first.aperture != next.aperture {
        "aperture"
    } else {
        return Ok(());
    };
    Err(FlashError::Settings { label: label(path), setting })
}

/// The lens that took the shots: the scene's camera of the same size, else the focal length given.
fn lens(session: &Session, size: (usize, usize), focal_px: Option<f64>) -> Result<Intrinsics, FlashError> {
    if let Some(focal) = focal_px.filter(|f| f.is_finite() && *f > 0.0) {
        return Ok(Intrinsics {
            width: size.0,
            height: size.1,
            focal: DVec2::splat(focal),
            principal: DVec2::new(size.0 as f64, size.1 as f64) / 2.0,
            distortion: Distortion::default(),
        });
    }
    let scene = scene::load_file(session).map_err(|_| FlashError::NoLens)?;
    let fits = |i: &Intrinsics| (i.width, i.height) == size;
    scene.cameras.iter().map(|c| c.intrinsics).find(fits).ok_or(FlashError::NoLens)
}

/// Copies the shots into the session, unless they are there.
fn keep(session: &Session, shots: &[CardFiles]) -> Result<(), FlashError> {
    let folder = session.calibration_dir().join("flash");
    let inside = |path: &Path| match (path.canonicalize(), session.path().canonicalize()) {
        (Ok(path), Ok(root)) => path.starts_with(root),
        _ => false,
    };
    for path in shots.iter().flat_map(|s| std::iter::once(&s.on).chain(&s.off)).filter(|p| !inside(p)) {
        std::fs::create_dir_all(&folder).map_err(io(&folder))?;
        let bytes = std::fs::read(path).map_err(io(path))?;
        let name = path.file_name().map_or_else(Default::default, |n| n.to_string_lossy());
        let copy = folder.join(format!("{}_{name}", &store::digest(&bytes)[..8]));
        store::write_atomic(&copy, &bytes).map_err(io(&copy))?;
    }
    Ok(())
}
