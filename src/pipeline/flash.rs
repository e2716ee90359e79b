//! The flash calibration of a session: card shots in, `calibration/flash.json` out (a [`Record`], with its figure
//! `flash.svg`). Shots are read one by one and reduced to means over cells at once.

use super::calibrate::{self, Series, SeriesError};
use crate::calibration::{
    CardShot, FieldFactor, FlashCalibration, FlashFacts, FlashFitError, OtherRig, Plane, Record, Rig, Target,
    fit_flash,
};
use crate::codec::raw::RawError;
use crate::export::chart::{self, Chart};
use crate::light::{Ring, RingError};
use crate::pair::{FlashRecord, FrameRecord, PairRecord, Settings};
use crate::photometry::{IsolateError, NoNoise, NoiseGauge};
use crate::pipeline::calibrate::RecordError;
use crate::pipeline::levels;
use crate::pipeline::{develop::exposure_ratio, scene};
use crate::progress::{Cancelled, Progress};
use crate::scene::{Distortion, Intrinsics};
use crate::session::{Session, SessionError, store};
use glam::DVec2;
use std::collections::HashSet;
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
    /// A calibration of the session cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The shots do not make a series, or `flash.json` is broken.
    #[error(transparent)]
    Series(SeriesError),
    /// A pair of another body or lens than the calibration's.
    #[error(
        "pair {name} does not fit the flash calibration: {source}; calibrate the flash with the rig that took the pairs"
    )]
    OtherRig {
        /// The pair.
        name: String,
        /// What differs.
        source: OtherRig,
    },
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl From<SeriesError> for FlashError {
    fn from(error: SeriesError) -> Self {
        match error {
            SeriesError::Cancelled(cancelled) => Self::Cancelled(cancelled),
            SeriesError::Raw(raw) => Self::Raw(raw),
            SeriesError::Record(record) => Self::Record(record),
            SeriesError::Session(session) => Self::Session(session),
            other => Self::Series(other),
        }
    }
}

/// One shot of the card.
#[derive(Clone, Debug, PartialEq)]
pub struct CardFiles {
    /// Where the card was, camera frame.
    pub plane: Plane,
    /// The frame lit by the flash.
    pub on: PathBuf,
    /// The frame without it; absent for shots in a dark room.
    pub off: Option<PathBuf>,
    /// Keeps it from the fit, to check the fit by it.
    pub held_out: bool,
}

/// What is known beforehand.
#[derive(Clone, Debug, PartialEq)]
pub struct CardFacts {
    /// What the card reflects.
    pub target: Target,
    /// Whether its reflectance is that of office paper, taken for granted.
    pub paper: bool,
    /// The lens's vignetting, where a flat field tells it.
    pub vignetting: Option<FieldFactor>,
    /// Inner and outer radius of the ring, metres.
    pub ring_radii: [f64; 2],
    /// Focal length in pixels, where no scene tells it.
    pub focal_px: Option<f64>,
}

/// Kind of the record.
const KIND: &str = "flash";

/// Fits the flash to card shots and stores the result as `calibration/flash.json`; the shots' files are kept
/// under `calibration/flash/`.
pub fn calibrate(
    session: &Session,
    shots: &[CardFiles],
    facts: &CardFacts,
    progress: &Progress,
) -> Result<Record<FlashCalibration>, FlashError> {
    let ring = Ring::new(facts.ring_radii[0], facts.ring_radii[1])?;
    let measured = levels::load(session)?;
    let mut series = Series::new(session, KIND)?;
    let (mut cards, mut numbers, mut first) = (vec![], vec![], None::<Settings>);
    let (mut gauge, mut rooms) = (NoiseGauge::default(), HashSet::new());
    for (i, shot) in shots.iter().enumerate() {
        progress.check()?;
        progress.report("reading card shots", i, shots.len());
        numbers.push(series.shots().len());
        let on = series.read(&shot.on)?;
        same_settings(first.get_or_insert_with(|| on.settings.clone()), &on.settings, &shot.on)?;
        let off = match &shot.off {
            // Several shots may share the frame of the room.
            Some(off) if !rooms.insert(off.clone()) => Some(levels::read(off, &measured)?),
            Some(off) => Some(series.read(off)?),
            None => None,
        };
        let label = label(&shot.on);
        let room = match &off {
            Some(off) => {
                let ratio = exposure_ratio(&on.settings, &off.settings)
                    .map_err(|setting| FlashError::Settings { label: label.clone(), setting })?;
                Some((&off.mosaic, ratio))
            }
            None => None,
        };
        gauge.add(&on.mosaic);
        let mut card = CardShot::reduce(label.clone(), shot.plane, &on.mosaic, room)
            .map_err(|source| FlashError::Isolate { label, source })?;
        card.energy_counts = energy_beside(&shot.on)?;
        card.held_out = shot.held_out;
        cards.push(card);
    }
    let settings = first.ok_or(FlashError::NoShots)?;
    let size = cards.first().map(|c| c.size).ok_or(FlashError::NoShots)?;
    progress.report("fitting the flash", 0, 1);
    let noise = match calibrate::noise::model(session, &settings)? {
        Some(measured) => measured,
        None => gauge.fit()?,
    };
    let intrinsics = lens(session, size, facts.focal_px)?;
    let known = FlashFacts {
        intrinsics: &intrinsics,
        ring,
        target: &facts.target,
        noise,
        vignetting: facts.vignetting,
    };
    let mut fit = fit_flash(&cards, &known)?;
    fit.iso = settings.iso.map(|s| s.0);
    fit.aperture = settings.aperture.map(|n| n.0);
    progress.check()?;
    for (card, number) in fit.cards.iter().zip(numbers) {
        if let Some(why) = &card.left_out {
            series.leave_out(number, why.clone());
        }
    }
    let (verdict, figure) = (fit.verdict(facts.paper), picture(&fit));
    let record = series.keep(fit, verdict, &figure, progress)?;
    progress.report("fitting the flash", 1, 1);
    Ok(record)
}

/// Each shot's light over what the fit says of its distance.
pub(super) fn picture(fit: &FlashCalibration) -> Chart {
    let points = |held_out: bool| {
        let shown = fit.cards.iter().filter(move |c| c.gain > 0.0 && c.held_out == held_out);
        shown
            .map(|c| {
                let gain = c.gain / c.measured_gain.unwrap_or(1.0);
                (c.distance, 100.0 * (gain - 1.0), 100.0 * fit.findings.jitter_deviation)
            })
            .collect::<Vec<_>>()
    };
    let named = |name: &str, held_out: bool| {
        let points = points(held_out);
        (!points.is_empty()).then(|| chart::Series { name: name.to_owned(), points })
    };
    Chart {
        caption: "Light of the card shots against the fitted flash, over the card's distance".into(),
        across: "Distance, m".into(),
        up: "Measured over fitted - 1, %".into(),
        series: [named("used for the fit", false), named("kept from the fit", true)]
            .into_iter()
            .flatten()
            .collect(),
    }
}

/// Reads the session's flash calibration with its origin.
pub fn record(session: &Session) -> Result<Record<FlashCalibration>, FlashError> {
    calibrate::load(session, KIND)?.ok_or_else(|| FlashError::None(session.path().to_owned()))
}

/// Reads the session's flash calibration.
pub fn load(session: &Session) -> Result<FlashCalibration, FlashError> {
    Ok(record(session)?.fit)
}

/// Refuses a pair of another body or lens than the calibration's.
pub(super) fn holds_for(rig: &Rig, pair: &PairRecord) -> Result<(), FlashError> {
    rig.same_lens(&pair.on.settings, "the flash calibration")
        .map_err(|source| FlashError::OtherRig { name: pair.name.clone(), source })
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
pub(super) fn label(path: &Path) -> String {
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
pub(super) fn energy_beside(frame: &Path) -> Result<Option<f64>, FlashError> {
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
